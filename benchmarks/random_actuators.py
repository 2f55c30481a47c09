"""Random actuators, moves and limits, from a seed: what ``exactness.py`` and the attacks run."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import ModelError
from dbo_cli.model import (
    Amplifier,
    Cascade,
    Delay,
    Dynamics,
    Lag,
    Quantity,
    Resonance,
    Section,
)

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "model"))
from random_models import random_model

Floats = NDArray[np.float64]
Random = np.random.Generator
MOVES = ("sine", "walk", "jumps", "rest", "beyond", "ramp")


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
