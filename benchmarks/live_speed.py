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


def main() -> None:
    """Print microseconds a sample for several numbers of gears."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 20_000
    wanted = (6.0 + 5.0 * np.sin(2 * np.pi * 20.0 * np.arange(count) / RATE)).tolist()
    print("gears   plan + commit   one-sample call of the model   (us)")
    for gears in (25, 256, 1152):
        made = model(gears)
        live = made.controller(RATE)
        live.step(wanted[0])

        def stepped(value: float, live: object = live) -> None:
            live.plan(value)  # type: ignore[attr-defined]
            live.commit()  # type: ignore[attr-defined]

        limits, core = DriveLimits(0.0, 100.0), made.actuator
        state = core.compensate(
            [6.0], core.start_compensation(6.0, "auto", limits), limits=limits, time_step=1 / RATE
        )

        def called(value: float) -> None:
            nonlocal state
            state = core.compensate([value], state.state, limits=limits, time_step=1 / RATE)

        print(f"{gears:5d} {each(stepped, wanted):15.2f} {each(called, wanted[:2000]):30.1f}")


if __name__ == "__main__":
    main()
