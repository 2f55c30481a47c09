"""Random actuators, moves and limits, from a seed: what ``exactness.py``, the attacks and the tests run."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dbo_cli.drive.simulate import Simulator
from dbo_cli.errors import ModelError
from dbo_cli.model import (
    Amplifier,
    Cascade,
    Delay,
    Dynamics,
    Gears,
    Lag,
    Points,
    Quantity,
    Relaxation,
    Resonance,
    Scale,
    Section,
    Stage,
    State,
    Steps,
)

Floats = NDArray[np.float64]
Random = np.random.Generator
DT = 1e-3
MOVES = ("sine", "walk", "jumps", "rest", "beyond", "ramp")


def random_gears(rng: Random, negative: bool | None = None) -> Gears:
    """Gears of one to some hundred, uneven or in runs; relaxation of both signs."""
    n = int(rng.integers(1, 300))
    dx = rng.uniform(0.2, 1.0, n)
    dy = rng.uniform(0.2, 1.0, n) * 10.0 ** rng.uniform(-3, 3)
    if rng.random() < 0.3:
        dx = np.full(n, 0.7)
        dy = np.repeat(dy, 5)[:n]
    x0, y0 = rng.normal() * dx.sum(), rng.normal() * dy.sum()
    if rng.random() < 0.5 and not negative:
        return Gears(dx, dy, x0, y0)
    terms = int(rng.integers(1, 6))
    mean = dy.sum() / dx.sum()
    gain = rng.uniform(0.0, 0.5, terms) * mean
    room = float((dy / dx).min()) - 0.03 * mean
    if room > 0.0 and (negative or rng.random() < 0.6):
        chosen = rng.random(terms) < 0.5
        chosen[0] = True
        share = rng.dirichlet(np.ones(chosen.sum())) * room * rng.uniform(0.1, 0.999)
        gain[chosen] = -share
    tau = 10.0 ** rng.uniform(-4, 2, terms)
    memories = Relaxation(x0 + rng.normal(), tuple(tau.tolist()), tuple(gain.tolist()))
    return Gears(dx, dy, x0, y0, memories)


def random_points(rng: Random, low: float, high: float) -> Points:
    """Return a curve over a range, with a range of its own for its values."""
    m = int(rng.integers(1, 12))
    widths = rng.uniform(0.5, 1.0, m)
    heights = rng.uniform(0.5, 1.0, m)
    return Points(
        widths * ((high - low) / widths.sum()),
        heights * ((high - low) / heights.sum()),
        low,
        low,
    )


def random_model(
    rng: Random, delays: bool = True, negative: bool | None = None
) -> Cascade:
    """Return a forward model of gears, points on either side, a scale, and a delay of whole samples."""
    gears = random_gears(rng, negative)
    low, high = gears.x_range
    stages: list[Stage] = []
    if rng.random() < 0.5:
        stages.append(random_points(rng, low, high))
    stages.append(gears)
    if rng.random() < 0.5:
        stages.append(random_points(rng, *gears.y_range))
    if rng.random() < 0.7:
        gain = float(rng.choice([-3.0, 0.01, 12.5]))
        stages.append(Scale(gain, rng.normal() * gain * gears.height))
    if delays and rng.random() < 0.5:
        stages.append(Delay(DT * int(rng.integers(0, 20))))
    drive = Quantity("voltage", "V", low, high)
    span = 100.0 * float(np.abs(gears.y_range).max()) + 10.0
    return Cascade(
        "forward", drive, Quantity("displacement", "um", -span, span), tuple(stages)
    )


def random_drive(rng: Random, low: float, high: float, rows: int) -> Floats:
    """Return a walk, smooth or rough, over most of a range; some rows stand on gear edges or at rest."""
    walk = np.cumsum(rng.normal(size=rows + 30))
    if rng.random() < 0.5:
        walk = np.convolve(walk, np.ones(25) / 25, "same")
    walk = walk[15 : rows + 15]
    part = (walk - walk.min()) / np.ptp(walk)
    drive = low + (0.02 + 0.96 * part) * (high - low)
    drive[rows // 2 : rows // 2 + 20] = drive[rows // 2]
    return drive


def random_actuator(rng: Random, dt: float) -> Cascade:
    """Return a random model, perhaps with an amplifier, dynamics and a delay; ``dt`` (s) is its step."""
    while True:
        try:
            static = random_model(rng, delays=False)
            stages = list(static.stages)
            if rng.random() < 0.2:
                lag = dt * float(10.0 ** rng.uniform(-1.0, 1.0))
                stages.insert(0, Amplifier(lag))
            if rng.random() < 0.3:
                stages.append(Dynamics(random_sections(rng, dt)))
            if rng.random() < 0.3:
                stages.append(Delay(float(rng.choice([1.0, 1.23, 7.0])) * dt))
            reached = reach_of(static)
            return Cascade("forward", static.input, reached, tuple(stages))
        except ModelError:  # stages that do not fit together
            continue


def random_sections(rng: Random, dt: float) -> tuple[Section, ...]:
    """Return a lag, a resonance, or both."""
    lag = Lag(dt * float(10.0 ** rng.uniform(-0.5, 1.5)))
    damping = float(rng.choice([0.01, 0.05, 0.3]))
    mode = Resonance(1.0 / (dt * float(10.0 ** rng.uniform(0.8, 2.0))), damping)
    choices: list[tuple[Section, ...]] = [(lag,), (mode,), (lag, mode)]
    return choices[int(rng.integers(3))]


def reach_of(static: Cascade) -> Quantity:
    """Return the output range that a static model reaches at rest."""
    ends = []
    for end, start in ((static.input.min, "empty"), (static.input.max, "full")):
        run = static.run(np.array([end]), static.start(end, start), 1.0)
        ends.append(float(run.y[0]))
    return Quantity("displacement", "um", min(ends), max(ends))


def undone(
    model: Cascade, displacement: Floats, dt: Steps, state: str | State = "auto"
) -> tuple[Floats, State | str]:
    """Return the drive that the inverse of a model gives for a displacement, and the state after it."""
    simulator = Simulator(model.inverse(), state)
    ready = simulator.rows(displacement, dt)
    return np.concatenate([ready.y, simulator.finish().y]), simulator.state


def random_move(rng: Random, model: Cascade, rows: int) -> Floats:
    """Return a displacement of some kind, in and beyond what the model reaches."""
    low, span = model.output.min, model.output.span
    part = np.arange(rows) / rows
    kind = str(rng.choice(MOVES))
    if kind == "sine":
        swing = span * rng.uniform(0.1, 0.6)
        phase = rng.uniform(0.0, 6.0) + 2.0 * np.pi * rng.choice([1.0, 2.0, 7.3]) * part
        return low + 0.5 * span + swing * np.sin(phase)
    if kind == "walk":
        return low + 0.5 * span + np.cumsum(rng.normal(0.0, 0.05 * span, rows))
    if kind == "jumps":
        return low + span * rng.uniform(-0.2, 1.2, 5)[rng.integers(0, 5, rows)]
    if kind == "beyond":
        return low + span * rng.uniform(-3.0, 4.0, rows)
    if kind == "ramp":
        return low + span * (rng.uniform(0.0, 1.0) + rng.uniform(-1.0, 1.0) * part)
    return np.full(rows, low + span * rng.uniform(0.0, 1.0))


def random_limits(rng: Random, voltage: Quantity) -> dict[str, float | bool | None]:
    """Return what a user may type as limits of a voltage."""
    low = voltage.min + float(rng.uniform(-0.5, 0.5)) * voltage.span
    high = voltage.min + float(rng.uniform(0.4, 1.5)) * voltage.span
    slews: list[float | None] = [None, None, 0.5, 5.0, 100.0]
    slew = slews[int(rng.integers(5))]
    both = rng.random() < 0.3
    return {
        "v_min": low if both or rng.random() < 0.4 else None,
        "v_max": high if both or rng.random() < 0.4 else None,
        "max_slew": None if slew is None else slew * voltage.span,
        "extrapolate": bool(both and rng.random() < 0.5),
    }
