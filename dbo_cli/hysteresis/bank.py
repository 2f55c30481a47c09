"""Many operators, one sample each at a time: the kernel's ``Bank``, and its twin in Python.

A mirror of a thousand actuators asks for a thousand voltages a frame. Each has a stepper (``stepper.py``);
the bank works through all of them, and what stands before and behind their gears, in one call.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.hysteresis import kernel
from dbo_cli.hysteresis.cascade import MemoryFree, ScaleStage
from dbo_cli.hysteresis.stepper import BacklashStepper

Floats = NDArray[np.float64]

ROUNDING = 8.0 * 2.0**-52
"""Of the larger voltage: the last digits of a step between two rows, each rounded once or twice on its way
through points and scales. A slew limit is kept to that, a range exactly."""


class PythonBank:
    """The extension's ``Bank`` in Python: the same arguments, the same bits.

    Parameters
    ----------
    steppers
        Of every channel, with a state.
    before, before_places, after, after_places, back, back_places
        The curves of every channel (``packed``): before the gears, behind them, and what undoes those behind.
    limits
        Rows low, high, most, last, a column of each channel: the range, the largest change (or NaN), and the
        voltage that stands (or NaN).
    """

    def __init__(
        self,
        steppers: tuple[Any, ...],
        before: Floats,
        before_places: NDArray[np.uint64],
        after: Floats,
        after_places: NDArray[np.uint64],
        back: Floats,
        back_places: NDArray[np.uint64],
        limits: Floats,
    ) -> None:
        self._steppers = steppers
        self._curves = [
            [(numbers[a:b].tolist()) for a, b in itertools.pairwise(places.tolist())]
            for numbers, places in ((before, before_places), (after, after_places), (back, back_places))
        ]
        self._low, self._high, self._most, self._last = limits.reshape(4, -1).copy()
        self._volts = np.zeros(len(steppers))
        self._planned = False

    def plan(self, x: Floats, y: Floats, clipped: NDArray[np.uint8], gate: bool) -> int:
        """Fill ``y`` and ``clipped``; -1, or k where input k is no number, or -2 - k where limits break."""
        self._planned = False
        bad = np.flatnonzero(~np.isfinite(x))
        if bad.size:
            return int(bad[0])
        for k, stepper in enumerate(self._steppers):
            volts = stepper.plan(_run(self._curves[0][k], float(x[k])))
            clipped[k] = stepper.clipped != 0
            if self._curves[1][k]:
                volts = min(max(_run(self._curves[1][k], volts), self._low[k]), self._high[k])
            y[k] = self._volts[k] = volts
            if gate and not self._may_pass(k, float(volts)):
                return -2 - k
        self._planned = True
        return -1

    def check(self, volts: Floats) -> int:
        """Return the first channel whose voltage may not follow the last one, or -1."""
        return next((k for k, one in enumerate(volts.tolist()) if not self._may_pass(k, one)), -1)

    def commit(self) -> None:
        """Go on to the states that the last plan leads to."""
        if not self._planned:
            raise ValueError("nothing was planned to be committed")
        for stepper in self._steppers:
            stepper.commit()
        self._last[:], self._planned = self._volts, False

    def apply(self, volts: Floats) -> int:
        """Go on to the states that these voltages lead to; -1, or k where voltage k is no number."""
        bad = np.flatnonzero(~np.isfinite(volts))
        if bad.size:
            return int(bad[0])
        for k, stepper in enumerate(self._steppers):
            stepper.apply(_run(self._curves[2][k], float(volts[k])))
        self._last[:], self._planned = volts, False
        return -1

    def _may_pass(self, k: int, volts: float) -> bool:
        low, high, most, last = (float(one[k]) for one in (self._low, self._high, self._most, self._last))
        inside = low <= volts <= high
        if last == last and not inside and not low <= last <= high:
            inside = last <= volts <= low if last < low else high <= volts <= last
        if inside and last == last and most == most:
            inside = abs(volts - last) <= most + ROUNDING * max(abs(last), abs(volts))
        return inside


def _run(numbers: list[float], x: float) -> float:
    """Pass a number through packed curves."""
    place = 0
    while place < len(numbers):
        if numbers[place] == 0.0:
            x = numbers[place + 1] * x + numbers[place + 2]
            place += 3
            continue
        count, x0, y0 = int(numbers[place + 1]), numbers[place + 2], numbers[place + 3]
        segments = np.array(numbers[place + 4 : place + 4 + 3 * count]).reshape(-1, 3)
        y = np.empty(1)
        kernel.point_run(segments, x0, y0, np.array([x]), y)
        x, place = float(y[0]), place + 4 + 3 * count
    return x


def packed(stages: Sequence[MemoryFree]) -> tuple[Floats, NDArray[np.uint64]]:
    """Return the curves of every channel as numbers, and where each channel's begin.

    A scale is ``0, gain, offset``; points are ``1, m, x0, y0`` and three numbers a segment.
    """
    rows: list[Floats] = []
    for one in stages:
        parts = [np.empty(0)]
        for stage in one:
            if isinstance(stage, ScaleStage):
                parts.append(np.array([0.0, stage.gain, stage.offset]))
            else:
                head = np.array([1.0, float(len(stage.segments)), stage.x0, stage.y0])
                parts += [head, np.asarray(stage.segments, dtype=np.float64).reshape(-1)]
        rows.append(np.concatenate(parts))
    places = np.concatenate([[0], np.cumsum([row.size for row in rows])]).astype(np.uint64)
    return np.concatenate(rows), places


def make_bank(
    steppers: Sequence[BacklashStepper],
    before: Sequence[MemoryFree],
    after: Sequence[MemoryFree],
    limits: Floats,
) -> Any:
    """Return the bank of the chosen kernel, which has the methods of ``PythonBank``.

    Parameters
    ----------
    steppers
        Of every channel, with a state.
    before, after
        The memory-free stages of every channel's inverse, before and behind the gears.
    limits
        As ``PythonBank`` has them.
    """
    make: Any = PythonBank if kernel.CHOSEN is kernel.PythonKernel else kernel.CHOSEN.Bank
    back = [tuple(stage.inverse() for stage in reversed(one)) for one in after]
    curves: list[Any] = [part for stages in (before, after, back) for part in packed(stages)]
    return make(tuple(one.inner for one in steppers), *curves, np.ascontiguousarray(limits))
