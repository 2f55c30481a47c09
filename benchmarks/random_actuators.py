"""Random actuators, moves and limits, from a seed: what ``exactness.py`` and the attacks run."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import ModelError
from dbo_cli.model import (
    Delay,
    Dynamics,
    Lag,
    Model,
    Quantity,
    Resonance,
    Scale,
    Section,
    Stage,
)

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "model"))
from random_models import random_gears, random_points

Floats = NDArray[np.float64]
Random = np.random.Generator
MOVES = ("sine", "walk", "jumps", "rest", "beyond", "ramp")


def random_actuator(rng: Random, dt: float) -> Model:
    """Return a model of gears and perhaps points, a scale, dynamics, a delay; ``dt`` (s) is its step."""
    while True:
        try:
            return _attempt(rng, dt)
        except ModelError:  # stages that do not fit together
            continue


def _attempt(rng: Random, dt: float) -> Model:
    """Return such a model, or raise ModelError."""
    gears = random_gears(rng)
    low, high = gears.x_range
    stages: list[Stage] = []
    if rng.random() < 0.3:
        stages.append(random_points(rng, low, high))
    stages.append(gears)
    if rng.random() < 0.3:
        stages.append(random_points(rng, *gears.y_range))
    if rng.random() < 0.5:
        gain = float(rng.choice([-3.0, 0.01, 12.5]))
        stages.append(Scale(gain, gain * float(rng.normal())))
    static = _reaching(stages, low, high)
    if rng.random() < 0.3:
        stages.append(Dynamics(random_sections(rng, dt)))
    if rng.random() < 0.3:
        stages.append(Delay(float(rng.choice([1.0, 1.23, 7.0])) * dt))
    return Model("forward", static.input, static.output, tuple(stages))


def random_sections(rng: Random, dt: float) -> tuple[Section, ...]:
    """Return a lag, a resonance, or both."""
    lag = Lag(dt * float(10.0 ** rng.uniform(-0.5, 1.5)))
    damping = float(rng.choice([0.01, 0.05, 0.3]))
    mode = Resonance(1.0 / (dt * float(10.0 ** rng.uniform(0.8, 2.0))), damping)
    choices: list[tuple[Section, ...]] = [(lag,), (mode,), (lag, mode)]
    return choices[int(rng.integers(3))]


def _reaching(stages: list[Stage], low: float, high: float) -> Model:
    """Return a static model whose output range is what it reaches at rest."""
    voltage = Quantity("voltage", "V", low, high)
    guess = Quantity("displacement", "um", -1e12, 1e12)
    model = Model("forward", voltage, guess, tuple(stages))
    ends = []
    for end, start in ((low, "empty"), (high, "full")):
        run = model.run(np.array([end]), model.start(end, start), 1.0)  # type: ignore[arg-type]
        ends.append(float(run.y[0]))
    reached = Quantity("displacement", "um", min(ends), max(ends))
    return Model("forward", voltage, reached, tuple(stages))


def random_move(rng: Random, model: Model, rows: int) -> Floats:
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
