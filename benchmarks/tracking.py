"""How well simulated stages follow a trajectory: a straight line's drive, the model's, and what it states.

    python benchmarks/tracking.py [SEEDS]                    1 seed

For each parameter set of ``sample_data/virtual_actuator.py`` and
``virtual_positioner.py`` (benches that are no backlash operators): the sample drive is
played, a model is identified with everything automatic, and the sample trajectory is
compensated and played again with other noise. RMS errors include that noise; they are
those of a bench that repeats to 0.05 % of its range, real piezos repeat to 0.16 to 1.5.
Exit 1 where a model leaves more than 0.06 of the straight line's error and more than
twice the noise. Fast moves stand in ``fast_moves.py``.
"""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbo_cli.drive import Limits, plan
from dbo_cli.identification import Recording, identify

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "sample_data"))
import virtual_actuator
import virtual_positioner
from make_samples import RATE, identification_drive, trajectory

Floats = NDArray[np.float64]
BOUND = 0.06  # of the straight line's error
NOISE_BOUND = 2.0  # of the sensor's noise


class Bench(NamedTuple):
    """One simulated stage: its range (V), the sensor's noise (um), and how it plays a drive."""

    name: str
    low: float
    high: float
    falling: bool
    noise: float
    play: Callable[[Floats, int], Floats]


def benches() -> Iterator[Bench]:
    """Yield every parameter set of both simulations."""
    for name, p in virtual_actuator.PRESETS.items():
        actuator = virtual_actuator.VirtualActuator(p)
        noise = float(np.hypot(p.noise, p.resolution / np.sqrt(12.0)))

        def played(drive: Floats, seed: int, actuator: object = actuator) -> Floats:
            return actuator.play(np.arange(drive.size) / RATE, drive, seed)  # type: ignore[attr-defined]

        yield Bench(name, p.v_min, p.v_max, p.stroke < 0.0, noise, played)
    for name, q in virtual_positioner.PRESETS.items():
        stage = virtual_positioner.VirtualPositioner(q)

        def moved(drive: Floats, seed: int, stage: object = stage) -> Floats:
            return stage.play(drive, RATE, seed)  # type: ignore[attr-defined]

        yield Bench(name, q.v_min, q.v_max, False, q.noise * q.stroke, moved)


def scaled(signal: Floats, low: float, high: float) -> Floats:
    """Stretch a signal to a range."""
    return low + (high - low) * (signal - signal.min()) / float(np.ptp(signal))


def tracked(bench: Bench, seed: int) -> tuple[list[float], list[float | None]]:
    """Return the RMS errors (um) of both drives, and what was stated, for an unknown past and a known one."""
    clock, shape = identification_drive()
    voltage = scaled(shape, bench.low, bench.high)
    displacement = bench.play(voltage, seed)
    model = identify([Recording(bench.name, voltage, displacement, clock)])
    low, span = model.output.min, model.output.span
    desired = scaled(trajectory()[1], low + 0.04 * span, low + 0.92 * span)
    if bench.falling:
        desired = 2.0 * low + span - desired  # begins at the lower end of the voltage
    slope, level = np.polyfit(voltage, displacement, 1)
    line = np.clip((desired - level) / slope, bench.low, bench.high)
    limits = Limits.within(model.input)
    drive = plan(model, desired, 1.0 / RATE, limits, state="empty", on_limit="clip")
    errors = []
    for played in (line, drive.voltage):
        came = bench.play(played, seed + 1000)
        errors.append(float(np.sqrt(np.mean((came - desired) ** 2))))
    return errors, [drive.expected_error, drive.expected_known]


def main() -> int:
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 1
    warnings.simplefilter("ignore")
    begun = time.perf_counter()
    print(
        "RMS error, um     straight line    model   ratio    stated  if past known     noise"
    )
    missed = 0
    for bench in benches():
        for seed in range(1, seeds + 1):
            (line, error), stated = tracked(bench, seed)
            good = error <= max(BOUND * line, NOISE_BOUND * bench.noise)
            missed += not good
            mark = "" if good else "   MISSED"
            told = ""
            for value in stated:
                told += f"{'none':>12}" if value is None else f"{value:12.4f}"
            print(f"{bench.name:16}{line:13.4f}{error:11.4f}{error / line:8.3f}"
                  f"{told}{bench.noise:12.4f}{mark}", flush=True)  # fmt: skip
    print(f"{missed} above the bound; {time.perf_counter() - begun:.0f} s")
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main())
