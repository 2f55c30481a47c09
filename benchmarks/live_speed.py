#!/usr/bin/env python3
"""What one live sample costs: a controller's calls, beside one-sample calls of the model and an empty method.

    python benchmarks/live_speed.py [SAMPLES]

Models of six relaxation terms and a scale, with an asymmetry of 16 segments before the
last row, as identify makes them. ``commit(v)`` says what was really played; ``dac=``
answers with codes of 16 bits.
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
    PointStage,
    Quantity,
    Relaxation,
    ScaleStage,
    Stage,
)

RATE = 5000.0


def model(gears: int, segments: int = 0) -> Model:
    """Return a model of a piezo stage of 100 V and 12 um."""
    heights = np.linspace(0.5, 1.5, gears) / gears
    memory = Relaxation(0.0, (0.002, 0.02, 0.2, 1.0, 5.0, 30.0), tuple([0.0002] * 6))
    backlash = BacklashStage(np.full(gears, 100.0 / gears), heights, 0.0, 0.0, memory)
    stages: list[Stage] = [backlash, ScaleStage(12.0, 0.0)]
    if segments:
        width = np.full(segments, 1.1 / segments)
        stages.insert(1, PointStage(width, np.linspace(0.9, 1.1, segments) * width))
    return Model(
        ActuatorModel(
            "forward",
            Quantity("voltage", "V", 0, 100),
            Quantity("displacement", "um", 0, 13),
            tuple(stages),
        )
    )


def each(call: Callable[[float], object], wanted: list[float]) -> float:
    """Return microseconds a call, the best of five passes."""
    best = float("inf")
    for _ in range(5):
        begin = time.process_time()
        for value in wanted:
            call(value)
        best = min(best, time.process_time() - begin)
    return 1e6 * best / len(wanted)


def stepping(made: Model, first: float) -> Callable[[float], object]:
    """Return a call that plans and commits one sample."""
    live = made.controller(RATE)
    live.step(first)

    def step(value: float) -> None:
        live.plan(value)
        live.commit()

    return step


def correcting(made: Model, first: float) -> Callable[[float], object]:
    """Return a call that plans one sample and commits what a coarser source played."""
    live = made.controller(RATE)
    live.step(first)
    return lambda value: live.commit(round(live.plan(value), 2))


def converting(made: Model, first: float) -> Callable[[float], object]:
    """Return a call that steps a converter of 16 bits."""
    live = made.controller(RATE, dac=np.linspace(0.0, 100.0, 1 << 16))
    live.step(first)
    return live.step


class Empty:
    """A method that does nothing, called as the others are."""

    def call(self, value: float) -> None:
        """Do nothing."""


def calling(made: Model, first: float) -> Callable[[float], object]:
    """Return a call of the model's block method with one sample."""
    core, limits = made.actuator, DriveLimits(0.0, 100.0)
    begun = core.start_compensation(first, "auto", limits)
    last = [core.compensate([first], begun, limits=limits, time_step=1 / RATE)]

    def step(value: float) -> None:
        last[0] = core.compensate(
            [value], last[0].state, limits=limits, time_step=1 / RATE
        )

    return step


def main() -> None:
    """Print microseconds a sample for several numbers of gears."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 20_000
    wanted = (6.0 + 5.0 * np.sin(2 * np.pi * 20.0 * np.arange(count) / RATE)).tolist()
    print(
        "gears  segments  plan + commit  commit(v)   dac=  one-sample call  empty method   (us)"
    )
    for gears, segments in ((25, 0), (256, 0), (1152, 0), (1280, 16)):
        made = model(gears, segments)
        costs = [
            each(way(made, wanted[0]), wanted)
            for way in (stepping, correcting, converting)
        ]
        block, empty = (
            each(calling(made, wanted[0]), wanted[:2000]),
            each(Empty().call, wanted),
        )
        print(
            f"{gears:5d} {segments:9d} {costs[0]:14.2f} {costs[1]:10.2f} {costs[2]:6.2f} {block:16.1f}"
            f" {empty:13.3f}"
        )


if __name__ == "__main__":
    main()
