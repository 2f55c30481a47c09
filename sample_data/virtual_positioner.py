#!/usr/bin/env python3
"""A stand-in for a fast stage: what moves is a mass on springs behind an amplifier.

Nothing here was recorded, and the structure is its own, not that of a model of dbo: a
converter of 16 bits, an amplifier that lags, plays with a smooth density, creep that
follows their sum, then one or two modes that add up (so that a second one comes with an
antiresonance), and a sensor with noise. Samples are joined by straight lines; the modes
answer them exactly.

    python virtual_positioner.py drive.csv -o measured.csv --preset scanner --seed 1

reads the columns ``time_s`` and ``voltage_V``, evenly sampled, and writes ``time_s``,
``voltage_V``, ``displacement_um`` and, where the drive has it, ``desired_um``. As a
module:

    VirtualPositioner(PRESETS["scanner"]).play(voltage, sample_rate=20_000, seed=1)
"""

from __future__ import annotations

import argparse
import dataclasses
import sys

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import expm
from scipy.signal import lfilter
from virtual_actuator import Signal, read_drive, write_table


@dataclasses.dataclass(frozen=True)
class PositionerParameters:
    """What the simulated stage is made of; lengths in µm, voltages in V, times in s, frequencies in Hz.

    ``modes`` are (frequency, damping, share of the displacement); the shares add up to
    1. ``loop`` is the share of the slope that the plays carry, ``reach`` how far up the
    range their density extends. ``creep`` pairs a time constant with the share of the
    displacement that follows it. ``noise`` is a share of the stroke.
    """

    modes: tuple[tuple[float, float, float], ...] = ((800.0, 0.02, 1.0),)
    amplifier_lag: float = 2e-4
    v_min: float = 0.0
    v_max: float = 100.0
    stroke: float = 10.0
    loop: float = 0.40
    reach: float = 0.15
    bend: float = 0.06
    creep: tuple[tuple[float, float], ...] = ((0.5, 0.006), (8.0, 0.010))
    noise: float = 2e-4
    bits: int = 16
    plays: int = 60


PRESETS = {
    "scanner": PositionerParameters(),
    "mirror": PositionerParameters(
        modes=((520.0, 0.05, 1.0),),
        amplifier_lag=1e-4,
        loop=0.30,
        bend=-0.05,
        stroke=30.0,
    ),
    "stiff": PositionerParameters(
        modes=((1_200.0, 0.01, 1.0),), amplifier_lag=5e-5, loop=0.45, stroke=5.0
    ),
    "two-mode": PositionerParameters(
        modes=((700.0, 0.02, 0.92), (1_650.0, 0.015, 0.08)),
        amplifier_lag=1.5e-4,
        stroke=12.0,
    ),
    "slow-amplifier": PositionerParameters(
        modes=((640.0, 0.03, 0.95), (1_900.0, 0.02, 0.05)),
        amplifier_lag=6e-4,
        loop=0.35,
        stroke=20.0,
    ),
}


class VirtualPositioner:
    """One simulated stage; ``play`` starts it anew, at rest, the drive last at the lower end."""

    def __init__(self, parameters: PositionerParameters | None = None) -> None:
        self.parameters = parameters or PositionerParameters()
        p = self.parameters
        span = p.v_max - p.v_min
        self.radii = (np.arange(p.plays) + 0.5) / p.plays * 0.5 * span
        density = (self.radii / span) ** 0.5 * np.exp(-self.radii / (p.reach * span))
        self.weights = (
            p.loop
            * span
            * density
            / float(density @ np.maximum(0.0, span - 2.0 * self.radii))
        )

    def play(self, voltage: ArrayLike, sample_rate: float, seed: int = 0) -> Signal:
        """Return the measured displacement in µm of a drive in V at ``sample_rate`` in Hz."""
        moved = self.displacement(voltage, sample_rate)
        p = self.parameters
        noisy: Signal = moved + p.noise * p.stroke * np.random.default_rng(
            seed
        ).standard_normal(moved.size)
        return noisy

    def displacement(self, voltage: ArrayLike, sample_rate: float) -> Signal:
        """Return the displacement in µm itself."""
        p, step = self.parameters, 1.0 / sample_rate
        span = p.v_max - p.v_min
        counts = np.rint(
            (np.asarray(voltage, dtype=np.float64) - p.v_min) / span * (2**p.bits - 1)
        )
        applied = _lag(p.v_min + counts * span / (2**p.bits - 1), p.amplifier_lag, step)
        x = self._hysteresis(applied)
        shape = x + p.bend * x * (1.0 - x)
        crept = shape + sum(
            share * (_lag(shape, tau, step) - shape) for tau, share in p.creep
        )
        moved = sum(
            share * _mode(crept, frequency, damping, step)
            for frequency, damping, share in p.modes
        )
        placed: Signal = p.stroke * np.asarray(moved)
        return placed

    def _hysteresis(self, voltage: Signal) -> Signal:
        """Return the plays' weighted sum, 0 at the lower and 1 at the upper end of the first full loading."""
        p = self.parameters
        upper = p.v_min + self.radii
        state = np.maximum(upper, voltage[0] - self.radii)
        summed = np.empty(voltage.size)
        for k, v in enumerate(voltage.tolist()):
            np.clip(state, v - self.radii, v + self.radii, out=state)
            summed[k] = self.weights @ state
        whole: Signal = (
            (1.0 - p.loop) * (voltage - p.v_min) + summed - float(self.weights @ upper)
        )
        return whole / (p.v_max - p.v_min)


def _lag(x: Signal, tau: float, step: float) -> Signal:
    """Follow ``x``, straight between samples, with the time constant ``tau``, at rest at first."""
    if tau <= 0.0:
        return x
    ratio = step / tau
    decay = np.exp(-ratio)
    hold = -np.expm1(-ratio) / ratio
    answer: Signal = x[0] + lfilter([1.0 - hold, hold - decay], [1.0, -decay], x - x[0])
    return answer


def _mode(x: Signal, frequency: float, damping: float, step: float) -> Signal:
    """Return the answer of one mode of gain 1 to ``x``, straight between samples, at rest at first."""
    w = 2.0 * np.pi * frequency
    # The state, the input and its slope over a step, as one free system: its
    # exponential is the answer.
    system = np.zeros((4, 4))
    system[0, 1], system[1, :3], system[2, 3] = (
        1.0,
        (-w * w, -2.0 * damping * w, w * w),
        1.0,
    )
    after = expm(system * step)
    (a, b), (c, d) = after[0, :2], after[1, :2]
    by_slope = after[:2, 3] / step  # of the change of the input over the step
    by_start = after[:2, 2]
    first, second = by_start - by_slope, by_slope
    numerator = [
        second[0],
        first[0] + b * second[1] - d * second[0],
        b * first[1] - d * first[0],
    ]
    answer: Signal = x[0] + lfilter(numerator, [1.0, -(a + d), a * d - b * c], x - x[0])
    return answer


def main() -> None:
    """Play a drive file through the simulated stage and write what its sensor shows."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument(
        "drive",
        help="CSV with the columns time_s and voltage_V; - is the standard input",
    )
    parser.add_argument(
        "-o",
        "--output",
        default="-",
        help="the measured CSV; - (default): standard output",
    )
    parser.add_argument(
        "--preset", choices=sorted(PRESETS), default="scanner", help="default: scanner"
    )
    parser.add_argument(
        "--seed", type=int, default=0, help="seed of the sensor noise (default: 0)"
    )
    options = parser.parse_args()
    if options.drive == "-":
        drive = read_drive(sys.stdin)
    else:
        with open(options.drive, encoding="utf-8") as file:
            drive = read_drive(file)
    if not {"time", "voltage"} <= drive.keys():
        parser.error(
            f"{options.drive}: no columns time_s and voltage_V; there are: {', '.join(drive)}"
        )
    rate = (len(drive["time"]) - 1) / float(drive["time"][-1] - drive["time"][0])
    measured = VirtualPositioner(PRESETS[options.preset]).play(
        drive["voltage"], rate, options.seed
    )
    columns = {"time_s": (drive["time"], ""), "voltage_V": (drive["voltage"], "")}
    if "desired" in drive:
        columns["desired_um"] = (drive["desired"], "")
    write_table(options.output, columns | {"displacement_um": (measured, ".5f")})


if __name__ == "__main__":
    main()
