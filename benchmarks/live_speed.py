#!/usr/bin/env python3
"""What one live sample costs: ``plan`` and ``commit`` of a controller, beside one-sample calls of the model.

    python benchmarks/live_speed.py [SAMPLES]

A model of 1,152 gears with six relaxation terms and a scale, as identify makes them.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import numpy as np

from dbo_cli import Model
from dbo_cli.hysteresis.model import (
    ActuatorModel,
    BacklashStage,
    DriveLimits,
    Quantity,
    Relaxation,
    ScaleStage,
)

RATE = 5000.0


def model(gears: int) -> Model:
    """Return a model of a piezo stage of 100 V and 12 um."""
    heights = np.linspace(0.5, 1.5, gears) / gears
    memory = Relaxation(0.0, (0.002, 0.02, 0.2, 1.0, 5.0, 30.0), tuple([0.0002] * 6))
    stages = (BacklashStage(np.full(gears, 100.0 / gears), heights, 0.0, 0.0, memory), ScaleStage(12.0, 0.0))
    return Model(
        ActuatorModel(
            "forward", Quantity("voltage", "V", 0, 100), Quantity("displacement", "um", 0, 13), stages
        )
    )


def each(call: Callable[[float], object], wanted: list[float]) -> float:
    """Return microseconds a call, the best of five passes."""
    best = float("inf")
    for _ in range(5):
        begin = time.perf_counter()
        for value in wanted:
            call(value)
        best = min(best, time.perf_counter() - begin)
    return 1e6 * best / len(wanted)


def stepping(made: Model, first: float) -> Callable[[float], object]:
    """Return a call that plans and commits one sample."""
    live = made.controller(RATE)
    live.step(first)

    def step(value: float) -> None:
        live.plan(value)
        live.commit()

    return step


def calling(made: Model, first: float) -> Callable[[float], object]:
    """Return a call of the model's block method with one sample."""
    core, limits = made.actuator, DriveLimits(0.0, 100.0)
    begun = core.start_compensation(first, "auto", limits)
    last = [core.compensate([first], begun, limits=limits, time_step=1 / RATE)]

    def step(value: float) -> None:
        last[0] = core.compensate([value], last[0].state, limits=limits, time_step=1 / RATE)

    return step


def main() -> None:
    """Print microseconds a sample for several numbers of gears."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 20_000
    wanted = (6.0 + 5.0 * np.sin(2 * np.pi * 20.0 * np.arange(count) / RATE)).tolist()
    print("gears   plan + commit   one-sample call of the model   (us)")
    for gears in (25, 256, 1152):
        made = model(gears)
        live, block = each(stepping(made, wanted[0]), wanted), each(calling(made, wanted[0]), wanted[:2000])
        print(f"{gears:5d} {live:15.2f} {block:30.1f}")


if __name__ == "__main__":
    main()
