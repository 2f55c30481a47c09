"""What a model and its inverse leave of each other, as two tables.

    python benchmarks/exactness.py [MODELS]                  1,000 of the first kind

``static``: random gears, points, relaxation and whole-sample delays: inverse after
forward and forward after inverse, worst error of any sample over the range; exit 1
above 1e-12. ``dynamics``: random actuators with lags and resonances, a move between two
rests through the inverse and back through the model; exit 1 above 1e-9 of the range.
"""

from __future__ import annotations

import sys
import time
from itertools import pairwise

import numpy as np
from random_actuators import (
    DT,
    Floats,
    Random,
    random_actuator,
    random_drive,
    random_model,
    undone,
)

from dbo_cli.model import Cascade

ROWS = 300
REST = 25  # rows at either end, longer than any delay here
STATIC_BOUND, DYNAMIC_BOUND = 1e-12, 1e-9


def static(count: int) -> float:
    """Print the worst of many round trips with and without negative gains; return the worst of all."""
    print(f"static: {count:,} models; worst error of a sample, of the range")
    print(f"{'':26}inverse after forward   forward after inverse")
    worst = 0.0
    for name, negative in (("gains of one sign", False), ("negative gains", True)):
        errors = []
        for seed in range(count // 2):
            rng = np.random.default_rng([seed, negative])
            model = random_model(rng, negative=negative)
            errors.append(round_trip(rng, model))
        there, back = np.max(errors, axis=0)
        print(f"{name:26}{there:21.1e}{back:24.1e}")
        worst = max(worst, float(there), float(back))
    return worst


def round_trip(rng: Random, model: Cascade) -> tuple[float, float]:
    """Return the worst errors of drive and displacement, each over its range."""
    low, high = model.input.min, model.input.max
    drive = random_drive(rng, low, high, ROWS)
    drive[:REST], drive[-REST:] = drive[0], drive[-1]
    begun = model.start(float(drive[0]))
    displacement, _ = model.simulate(drive, dt=DT, state=begun)
    back, _ = undone(model, displacement, DT, begun)
    again, _ = model.simulate(back, dt=DT, state=begun)
    there = np.abs(back - drive)[:-REST].max() / (high - low)
    span = np.ptp(displacement)
    return float(there), float(np.abs(again - displacement)[:-REST].max() / span)


def driven(model: Cascade, wanted: Floats, state: str = "auto") -> Floats:
    """Return the drive of a whole move without limits; the last value is held."""
    ahead = np.full(model.inverter(DT).ahead, wanted[-1])
    target, _ = model.inverter(DT).run(np.concatenate([wanted, ahead]))
    begun = model.start_drive(float(target[0]), state)
    return np.asarray(model.drive(target, begun, DT).y)


def dynamics(count: int) -> float:
    """Print quantiles of what models with dynamics leave of a move; return the worst."""
    errors: list[float] = []
    seed = 0
    while len(errors) < count:
        seed += 1
        rng = np.random.default_rng([seed, 2])
        model = random_actuator(rng, DT)
        if model.dynamics is None or model.delay_seconds % DT > 1e-9:
            continue  # a delay between samples is not undone exactly
        wanted = between_rests(rng, model)
        drive = driven(model, wanted, "empty")
        came, _ = model.simulate(drive, dt=DT, state="empty")
        errors.append(float(np.abs(came - wanted)[:-REST].max()) / model.output.span)
    middle, most = np.quantile(errors, (0.5, 1.0))
    print(f"\ndynamics: {count} actuators; worst error of a sample, of the range")
    print(f"{'median':>10}{middle:10.1e}\n{'worst':>10}{most:10.1e}")
    return float(most)


def between_rests(rng: Random, model: Cascade) -> Floats:
    """Return a smooth move from rest at the lower end of the drive to a rest inside the reach."""
    bottom, _ = model.simulate([model.input.min], dt=DT, state="empty")
    knots = rng.uniform(0.25, 0.75, 12)
    knots[0] = (bottom[0] - model.output.min) / model.output.span
    part = np.full(REST, knots[0])
    for before, after in pairwise(knots.tolist()):
        rise = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, 61) / 60)
        part = np.concatenate([part, before + (after - before) * rise])
    part = np.concatenate([part, np.full(2 * REST, knots[-1])])
    return np.asarray(model.output.min + part * model.output.span)


def main() -> int:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    begun = time.perf_counter()
    worst = static(count)
    moving = dynamics(max(count // 5, 10))
    print(f"\n{time.perf_counter() - begun:.0f} s")
    return int(worst > STATIC_BOUND or moving > DYNAMIC_BOUND)


if __name__ == "__main__":
    sys.exit(main())
