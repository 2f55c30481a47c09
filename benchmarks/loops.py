"""Looped moves: the settled drive against the last period of a long computed run, and its seam.

    python benchmarks/loops.py [--seconds S]

Five actuators with creep, a lag before the gears and a resonance; models whose loop is 5 % wrong; sines and
rounded triangles at 1/200 and 1/20 of the resonance. The settled drive is repeated for so many seconds, and
so is a trajectory of as many periods computed in one run; both are played, and the RMS errors of their last
periods compared. Prints the ratio and the drive's step at the seam over the largest inside. Exits 1 where the
ratio exceeds 1.2 or the step at the seam is larger than any inside.
"""

from __future__ import annotations

import argparse
import sys
import warnings

import numpy as np
from numpy.typing import NDArray

from dbo_cli.hysteresis.cascade import slow_output_range
from dbo_cli.hysteresis.dynamics import DynamicsStage, Lag, Resonance
from dbo_cli.hysteresis.model import ActuatorModel, BacklashStage, Quantity, Relaxation, ScaleStage, Stage
from dbo_cli.hysteresis.smoothing import ZeroPhaseLowPass
from dbo_cli.runs.model import Model

Floats = NDArray[np.float64]
RATE = 20_000.0
MOST_RATIO = 1.2
ONE = 1.0 + 1e-9  # a step that is as large as the largest inside


def actuator(loop: float, frequency: float) -> ActuatorModel:
    slopes = 1.0 - loop + 2.0 * loop * np.linspace(0.0, 1.0, 200)
    widths = np.full(200, 0.5)
    creep = Relaxation(0.0, (0.2, 1.0), (0.001, 0.002))
    stages: list[Stage] = [
        BacklashStage(widths, 0.1 * widths * slopes, 0.0, 0.0, creep),
        ScaleStage(1.2, 0.5),
    ]
    low, high = slow_output_range(stages, 0.0, 100.0)
    stages = [DynamicsStage((Lag(2e-4),)), *stages, DynamicsStage((Resonance(frequency, 0.02),))]
    voltage, displacement = Quantity("voltage", "V", 0.0, 100.0), Quantity("displacement", "um", low, high)
    return ActuatorModel("forward", voltage, displacement, tuple(stages))


def period_of(shape: str, count: int) -> Floats:
    phase = 2.0 * np.pi * np.arange(count) / count
    if shape == "sine":
        return 6.0 + 4.0 * np.sin(phase)
    corners = 6.0 + 4.0 * (2.0 / np.pi) * np.arcsin(np.sin(phase))
    rounded: Floats = ZeroPhaseLowPass(5.0 * RATE / count, 1.0 / RATE).loop(corners)
    return rounded


def rms(x: Floats) -> float:
    return float(np.sqrt(np.mean(x * x)))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=12.0)
    seconds = parser.parse_args().seconds
    wide = {"sample_rate": RATE, "v_min": -40.0, "v_max": 140.0}
    warnings.simplefilter("ignore")  # a run that begins on the move rings at first; its last period counts
    bad = 0
    for k in range(5):
        loop, frequency = 0.30 + 0.05 * k, 650.0 + 60.0 * k
        plant, model = actuator(loop, frequency), Model(actuator(0.95 * loop, frequency))
        for shape in ("sine", "triangle"):
            for part in (200.0, 20.0):
                count = round(RATE * part / frequency)
                period = period_of(shape, count)
                times = round(seconds * RATE / count)
                settled = model.compensate(period, periodic=True, **wide)
                run = model.compensate(np.tile(period, times), **wide)
                errors = []
                for drive in (np.tile(settled, times), run):
                    begun = plant.start(float(drive[0]), "auto")
                    reached = plant.simulate(drive, begun, time_step=1.0 / RATE).y
                    errors.append(rms(reached[-2 * count : -count] - period))  # the run's last lacks a future
                ratio = errors[0] / errors[1]
                seam = abs(float(settled[0] - settled[-1])) / float(np.abs(np.diff(settled)).max())
                wrong = ratio > MOST_RATIO or seam > ONE
                bad += wrong
                print(
                    f"actuator {k}, {shape:8} f_r/{part:<4.0f} settled {errors[0]:.4f} um, long run "
                    f"{errors[1]:.4f} um, ratio {ratio:.3f}; seam {seam:.3f} of the largest step"
                    f"{'  BAD' if wrong else ''}",
                    flush=True,
                )
    print(f"{bad} of 20 beyond their bounds")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
