#!/usr/bin/env python3
"""The drive of dbo beside a sensor and a PI controller, on the simulated bench: docs/closed-loop.md.

    python closed_loop.py

Every move goes from 1 to 11 um and back. The model comes from ``identification.csv``;
the bench is ``virtual_actuator.py``, sample by sample. The controller sees the noisy
sensor and adds its voltage to the feedforward's. Printed is the RMS of desired -
displacement without noise, the first cycle left out.
"""

from __future__ import annotations

import dataclasses
import math
import warnings
from functools import cache
from pathlib import Path

import numpy as np
from virtual_actuator import (
    PRESETS,
    ActuatorParameters,
    Signal,
    VirtualActuator,
    read_drive,
)

import dbo_cli as dbo

RATE = 5000.0  # samples a second
CYCLES = 4
LOW, HIGH = 1.0, 11.0  # um
# Hz, of the open loop: a sensor's lag of 0.8 ms leaves 78 degrees at the second
CROSSOVERS = (10.0, 40.0)


class Bench(VirtualActuator):
    """The simulated actuator, a sample at a time; at first at rest, the drive at the lower end."""

    def __init__(self, parameters: ActuatorParameters, seed: int = 1) -> None:
        super().__init__(parameters)
        p = self.parameters
        self._plays = p.v_min + self.radii
        self._rest = float(self.weights @ self._plays)
        self._past: dict[object, tuple[float, float]] = {}
        self._noise = np.random.default_rng(seed)

    def step(self, volts: float) -> tuple[float, float]:
        """Return the displacement after one more sample, and what the sensor shows, in um."""
        p = self.parameters
        v = self._follow("amplifier", volts, p.amplifier_lag)
        np.minimum(
            np.maximum(self._plays, v - self.radii), v + self.radii, out=self._plays
        )
        summed = float(self.weights @ self._plays) - self._rest
        x = (self.direct * (v - p.v_min) + summed) / (p.v_max - p.v_min)
        shape = (
            x + p.bend * x * (1.0 - x) + p.bend_cubic * x * (1.0 - x) * (1.0 - 2.0 * x)
        )
        crept = shape + sum(
            share * (self._follow(tau, shape, tau) - shape) for tau, share in p.creep
        )
        true = p.offset + p.stroke * self._follow("sensor", crept, p.sensor_lag)
        return true, true + p.noise * float(self._noise.standard_normal())

    def _follow(self, which: object, value: float, tau: float) -> float:
        """Return a first-order lag's answer to straight lines between samples (``VirtualActuator._lag``)."""
        if which not in self._past:
            self._past[which] = (value, value)
            return value
        before, answer = self._past[which]
        decay, hold = _decay_and_hold(tau)
        answer = decay * answer + value * (1.0 - hold) + before * (hold - decay)
        self._past[which] = (value, answer)
        return answer


@cache
def _decay_and_hold(tau: float) -> tuple[float, float]:
    ratio = 1.0 / (RATE * tau)
    return math.exp(-ratio), -math.expm1(-ratio) / ratio


def track(
    bench: Bench, desired: Signal, feedforward: Signal | None, crossover: float | None
) -> float:
    """Follow a move and return the RMS of the error in um.

    Parameters
    ----------
    feedforward
        The drive in V, from ``dbo`` or a straight line; None: the voltage of the
        lower end, from where a controller starts.
    crossover
        Where the open loop of controller and actuator has the gain 1, in Hz; None: no
        controller.
    """
    p = bench.parameters
    slope = p.stroke / (p.v_max - p.v_min)  # um a volt
    gain = 0.0 if crossover is None else 2.0 * math.pi * crossover / slope
    proportional, integral = gain * p.amplifier_lag, 0.0
    base = np.full(len(desired), p.v_min) if feedforward is None else feedforward
    errors, error = np.empty(len(desired)), 0.0
    for k, (wanted, volts) in enumerate(
        zip(desired.tolist(), base.tolist(), strict=True)
    ):
        asked = volts + proportional * error + integral + gain * error / RATE
        drive = min(max(asked, p.v_min), p.v_max)
        if drive == asked:  # the integral waits where the amplifier is at its limit
            integral += gain * error / RATE
        true, measured = bench.step(drive)
        # of one instant: both are of this sample
        errors[k], error = wanted - true, wanted - measured
    first = len(desired) // CYCLES
    return float(np.sqrt(np.mean(errors[first:] ** 2)))


def move(frequency: float) -> Signal:
    """Return some cycles of a sine from the lower end, in um."""
    time = np.arange(int(CYCLES / frequency * RATE)) / RATE
    return LOW + (HIGH - LOW) * (0.5 - 0.5 * np.cos(2.0 * np.pi * frequency * time))


def table() -> str:
    """Return the errors, a line a move."""
    log = Path(__file__).with_name("identification.csv")
    model = dbo.identify(str(log))
    with log.open(encoding="utf-8") as file:
        recorded = read_drive(file)
    # as straight_line.py
    line = np.polyfit(recorded["displacement"], recorded["voltage"], 1)
    stack = PRESETS["stack"]
    loaded = dataclasses.replace(stack, stroke=0.95 * stack.stroke)
    loops = [f"PI {one:g} Hz" for one in CROSSOVERS]
    heads = [
        *loops,
        *(f"line, {one}" for one in loops),
        "dbo",
        *(f"dbo, {one}" for one in loops),
    ]
    lines = [f"{'move':24}" + "".join(f"{head:>16}" for head in heads)]
    for frequency, bench in (
        (1.0, stack),
        (5.0, stack),
        (20.0, stack),
        (1.0, loaded),
        (5.0, loaded),
    ):
        desired = move(frequency)
        with warnings.catch_warnings():
            # 20 Hz is faster than the log's drive
            warnings.simplefilter("ignore", dbo.DboWarning)
            drive = model.compensate(
                desired, sample_rate=RATE, v_min=stack.v_min, v_max=stack.v_max
            )
        errors = [track(Bench(bench), desired, None, one) for one in CROSSOVERS]
        straight = np.clip(np.polyval(line, desired), stack.v_min, stack.v_max)
        errors += [track(Bench(bench), desired, straight, one) for one in CROSSOVERS]
        errors += [
            track(Bench(bench), desired, drive, one) for one in (None, *CROSSOVERS)
        ]
        name = f"{frequency:g} Hz" + (", gain 5 % lower" if bench is loaded else "")
        lines.append(f"{name:24}" + "".join(f"{one:16.4f}" for one in errors))
    return "\n".join(lines)


if __name__ == "__main__":
    print(table())
