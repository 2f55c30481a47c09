#!/usr/bin/env python3
"""What a frame of a mirror costs live: ``plan`` and ``commit`` of a bank, beside a controller a channel.

    python benchmarks/bank_speed.py [CHANNELS]

Models of 1,152 gears with six relaxation terms, each with its own gain, as identify
makes them. A smooth frame moves by less than a gear, a fast one by several. Times are
CPU times, the least of several passes.
"""

from __future__ import annotations

import dataclasses
import sys
import time
from collections.abc import Callable

import numpy as np
from live_speed import model
from numpy.typing import NDArray

from dbo_cli import Model, ModelSet
from dbo_cli.hysteresis.model import BacklashStage, ScaleStage

RATE = 2000.0
FRAMES = 400


def mirror(channels: int) -> ModelSet:
    """Return models with a table of gears and a gain each."""
    base = model(1152).actuator
    gears = base.backlash

    def one(number: int) -> Model:
        own = BacklashStage(gears.dx, gears.dy, gears.x0, gears.y0, gears.relaxation)
        return Model(
            dataclasses.replace(
                base, stages=(own, ScaleStage(12.0 + 0.001 * number, 0.0))
            )
        )

    return ModelSet({str(number): one(number) for number in range(channels)})


def cost(
    step: Callable[[NDArray[np.float64]], object],
    frames: NDArray[np.float64],
    passes: int,
) -> float:
    """Return microseconds of CPU a frame, the least of some passes."""
    best = float("inf")
    for _ in range(passes):
        begin = time.process_time()
        for frame in frames:
            step(frame)
        best = min(best, time.process_time() - begin)
    return 1e6 * best / len(frames)


def main() -> None:
    """Print the cost of a frame for both ways and two speeds."""
    channels = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    made = mirror(channels)
    seconds = np.arange(FRAMES)[:, None] / RATE
    print(f"{channels} channels, {FRAMES} frames at {RATE:g} Hz")
    for name, frequency in (("smooth, 0.5 Hz", 0.5), ("fast, 7 Hz", 7.0)):
        phases = np.linspace(0.0, 6.0, channels)[None, :]
        frames = 6.0 + 3.0 * np.sin(2.0 * np.pi * frequency * seconds + phases)
        bank = made.controller(RATE, v_min=0.0, v_max=100.0)
        alone = [one.controller(RATE, v_min=0.0, v_max=100.0) for one in made.values()]
        bank.step(frames[0])
        for one, value in zip(alone, frames[0].tolist(), strict=True):
            one.step(value)

        def each(frame: NDArray[np.float64], alone: list[object] = alone) -> None:
            for one, value in zip(alone, frame.tolist(), strict=True):
                one.plan(value)  # type: ignore[attr-defined]
                one.commit()  # type: ignore[attr-defined]

        together, apart = cost(bank.step, frames[1:], 5), cost(each, frames[1:60], 2)
        print(
            f"{name}: {together:.0f} us a frame, {1e3 * together / channels:.0f} ns a channel; a controller a"
            f" channel {apart:.0f} us, {apart / together:.1f} times as much"
        )


if __name__ == "__main__":
    main()
