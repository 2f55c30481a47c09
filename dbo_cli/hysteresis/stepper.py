"""One operator or many, one sample at a time: the kernel with states that stay where they are.

``DiscreteBacklashOperator.run`` checks, allocates and converts for every block, which a
block pays once and a live sample would pay each time (``benchmarks/live_speed.py``).
The bits are the same. A mirror of a thousand actuators asks for a thousand voltages a
frame: a bank works through the steppers of all of them, and what stands before and
behind their gears, in one call.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.hysteresis import kernel
from dbo_cli.hysteresis.cascade import MemoryFree, ScaleStage
from dbo_cli.hysteresis.kernel import Floats, Words
from dbo_cli.hysteresis.operators import (
    BacklashState,
    DiscreteBacklashOperator,
    OutputLimits,
)

ROUNDING = 8.0 * 2.0**-52
"""Of the larger voltage: the last digits of a step between two rows, each rounded once or twice on its way
through points and scales. A slew limit is kept to that, a range exactly.
"""


def may_follow(volts: float, last: float, low: float, high: float, most: float) -> bool:
    """Return whether a voltage may follow ``last``: ``DriveGate`` for one row.

    It is within ``low`` to ``high``, or on the way there where ``last`` is outside; and
    no further away than ``most``. NaN: there is no last one, any change is allowed.
    """
    inside = low <= volts <= high
    if not inside and last < low:
        inside = last <= volts <= low
    elif not inside and last > high:
        inside = high <= volts <= last
    # infinity is inside a range without an end
    if not (inside and math.isfinite(volts)):
        return False
    return not abs(volts - last) > most + ROUNDING * max(abs(last), abs(volts))


def inwards(last: float, low: float, high: float, most: float) -> float | None:
    """Return where a drive goes from further outside its range than one step: inwards by that step.

    None where it is nearer, or inside; NaN as in ``may_follow``.
    """
    if last - high > most:
        return last - most
    if low - last > most:
        return last + most
    return None


class PythonStepper:
    """The extension's ``Stepper`` in Python: the operator's ``constants``, then what each step needs.

    That is ``decay`` (one row), ``limited``, ``low``, ``high`` and ``slack``, as
    ``kernel.backlash_run`` has them, and ``step``, the largest change of the output, or
    NaN.
    """

    def __init__(self, *numbers: Any) -> None:
        (
            gears,
            guide,
            n,
            run,
            x0,
            y0,
            extend,
            gain,
            reference,
            memory_on_output,
            self._decay,
            *limits,
        ) = numbers
        self._table = (
            gears,
            guide,
            n,
            run,
            x0,
            y0,
            extend,
            gain,
            reference,
            memory_on_output,
        )
        limited, low, high, slack, step = limits
        exchanged = np.ascontiguousarray(gears[:, [1, 0, 2, 3, 5, 4]])
        exchanged[:, 2] = gears[:, 0] / gears[:, 1]
        self._exchanged = (
            exchanged,
            guide,
            n,
            run,
            y0,
            x0,
            extend,
            gain,
            reference,
            not memory_on_output,
        )
        steps = np.array([] if math.isnan(step) else [step])
        self._limits = limited, low, high, slack, steps
        self._words = np.zeros(kernel.state_words(n), np.uint64)
        self._memory, self.last = np.zeros(gain.size), math.nan
        self._planned: tuple[Words, Floats, float] | None = None
        self._cannot_apply = gain.size > 0 and not memory_on_output
        self.clipped = 0

    def plan(self, x: float) -> float:
        """Return the output for an input, without going on to the state that it leads to."""
        words, memory, y = self._words.copy(), self._memory.copy(), np.empty(1)
        counts = kernel.backlash_run(
            *self._table,
            words,
            memory,
            self.last,
            np.array([x], np.float64),
            y,
            self._decay,
            *self._limits,
        )
        self.clipped = counts[2]
        self._planned = words, memory, y.item()
        return self._planned[2]

    def commit(self) -> None:
        """Go on to the state that was worked out last."""
        if self._planned is None:
            raise ValueError("nothing was planned to be committed")
        self._words, self._memory, self.last = self._planned
        self._planned = None

    def follow(self, y: float) -> None:
        """Work out the state that this output leads to, without going on to it."""
        if self._cannot_apply:
            raise ValueError("memory on the input: its output does not give the state")
        words, memory = self._words.copy(), self._memory.copy()
        kernel.backlash_run(
            *self._exchanged, words, memory, math.nan, np.array([y], np.float64), np.empty(1),
            self._decay, False, 0.0, 0.0, 0.0, np.array([]),
        )  # fmt: skip
        self.clipped = 0
        self._planned = words, memory, float(y)

    def set(self, words: Words, memory: Floats, last: float) -> None:
        """Take over the bits, the memory and the output before."""
        self._words[:] = words
        self._memory[:] = memory
        self.last = last
        self._planned = None

    def get(self, words: Words, memory: Floats) -> float:
        """Fill the bits and the memory; return the output before."""
        words[:], memory[:] = self._words, self._memory
        return self.last


class BacklashStepper:
    """Steps an operator at an even rate from a committed state; a step counts once it is committed.

    Parameters
    ----------
    operator : DiscreteBacklashOperator
        What is stepped.
    state : BacklashState
        Where it starts; its memory, where the operator relaxes, must not be at rest.
    last : float
        The output before (for the slew limit), or NaN.
    time_step : float, optional
        Seconds between samples; needed with relaxation.
    limits : OutputLimits, optional
        Limits on the output, with a single number as largest step.

    Attributes
    ----------
    plan : callable
        ``plan(x) -> y``: the output for an input; nothing changes yet.
    commit : callable
        ``commit()``: go on to the state that was worked out last. ValueError where none
        was.
    follow : callable
        ``follow(y)``: work out the state that this output leads to, that of the
        operator with exchanged axes driven by it; nothing changes yet. ValueError where
        memory follows the input.
    """

    def __init__(
        self,
        operator: DiscreteBacklashOperator,
        state: BacklashState,
        last: float,
        time_step: float | None,
        limits: OutputLimits | None = None,
    ) -> None:
        terms = operator.relaxation
        bound = limits or OutputLimits()
        decay = np.zeros((0, 0))
        if terms and time_step is not None:
            decay = terms.decay(time_step)
        step = math.nan
        if bound.step is not None:
            step = float(np.asarray(bound.step))
        make: Any = PythonStepper
        if kernel.CHOSEN is not kernel.PythonKernel:
            make = kernel.CHOSEN.Stepper
        self._operator = operator
        self._made_with = (time_step, limits)
        self.inner = make(
            *operator.constants(True),
            decay,
            limits is not None,
            bound.low,
            bound.high,
            bound.slack,
            step,
        )
        self._words = operator._words(state)
        self._memory = np.zeros(operator._gain.size)
        self.plan = self.inner.plan
        self.commit = self.inner.commit
        self.follow = self.inner.follow
        self.set(state, last)

    def __reduce__(self) -> Any:
        """Pickle the committed state; what was planned stays behind."""
        return BacklashStepper, (
            self._operator,
            self.state,
            self.last,
            *self._made_with,
        )

    @property
    def clipped(self) -> int:
        """1 where the last plan met the limits, else 0."""
        return int(self.inner.clipped)

    @property
    def state(self) -> BacklashState:
        """The committed state."""
        self.inner.get(self._words, self._memory)
        memory = None
        if self._operator.relaxation is not None:
            memory = tuple(self._memory.tolist())
        return BacklashState(self._operator._bits(self._words), memory)

    @property
    def last(self) -> float:
        """The output of the last step committed."""
        return float(self.inner.last)

    def set(self, state: BacklashState, last: float) -> None:
        """Take a state over from this operator or the exchanged one: its bits and memory mean the same."""
        memory = np.array(state.memory or (), dtype=np.float64)
        self.inner.set(self._operator._words(state), memory, last)


class PythonBank:
    """The extension's ``Bank`` in Python: the same arguments, the same bits.

    Parameters
    ----------
    steppers
        Of every channel, with a state.
    before, before_places, after, after_places, back, back_places
        The curves of every channel (``packed``): before the gears, behind them, and
        what undoes those behind.
    limits
        Rows low, high, most, last, a column of each channel: the range, the largest
        change (or NaN), and the voltage that stands (or NaN); then the least and the
        greatest input, and the least and the greatest voltage played: what is not
        between them is refused.
    """

    def __init__(self, steppers: tuple[Any, ...], *curves_and_limits: Any) -> None:
        *curves, limits = curves_and_limits
        self._steppers = steppers
        self._curves: list[list[list[float]]] = []
        for numbers, places in zip(curves[::2], curves[1::2], strict=True):
            edges = itertools.pairwise(places.tolist())
            self._curves.append([numbers[a:b].tolist() for a, b in edges])
        rows = limits.reshape(8, -1).copy()
        self._low, self._high, self._most, self._last = rows[:4]
        self._wanted, self._played = rows[4:6], rows[6:]
        self._volts = np.zeros(len(steppers))
        self._planned = False

    def plan(self, x: Floats, y: Floats, clipped: NDArray[np.uint8], gate: bool) -> int:
        """Fill ``y`` and ``clipped``; -1, or k where input k is refused, or -2 - k where limits break."""
        self._planned = False
        bad = _first_outside(x, self._wanted)
        if bad >= 0:
            return bad
        for k, wanted in enumerate(x.tolist()):
            volts, held_back = self._planned_volts(k, wanted, gate)
            clipped[k] = held_back
            y[k] = self._volts[k] = volts
            if gate and not may_follow(volts, *self._limits(k)):
                return -2 - k
        self._planned = True
        return -1

    def check(self, volts: Floats) -> int:
        """Return the first channel whose voltage may not follow the last one, or -1."""
        for k, value in enumerate(volts.tolist()):
            if not may_follow(value, *self._limits(k)):
                return k
        return -1

    def commit(self) -> None:
        """Go on to the states that were worked out last."""
        if not self._planned:
            raise ValueError("nothing was planned to be committed")
        for stepper in self._steppers:
            stepper.commit()
        self._last[:], self._planned = self._volts, False

    def follow(self, volts: Floats) -> int:
        """Work out the states that these voltages lead to; -1, or k where voltage k is refused."""
        bad = _first_outside(volts, self._played)
        if bad >= 0:
            return bad
        for k, stepper in enumerate(self._steppers):
            stepper.follow(_run(self._curves[2][k], float(volts[k])))
        self._volts[:], self._planned = volts, True
        return -1

    def _limits(self, k: int) -> tuple[float, float, float, float]:
        """Return last, low, high and most of a channel, as ``may_follow`` takes them."""
        return (
            float(self._last[k]),
            float(self._low[k]),
            float(self._high[k]),
            float(self._most[k]),
        )

    def _planned_volts(self, k: int, wanted: float, gate: bool) -> tuple[float, bool]:
        """Return the voltage of one channel, and whether its limits hold it back."""
        stepper = self._steppers[k]
        if gate:
            inner = inwards(*self._limits(k))
            if inner is not None:
                stepper.follow(_run(self._curves[2][k], inner))
                return inner, True
        volts = float(stepper.plan(_run(self._curves[0][k], wanted)))
        if self._curves[1][k]:
            low, high = float(self._low[k]), float(self._high[k])
            volts = min(max(_run(self._curves[1][k], volts), low), high)
        return volts, stepper.clipped != 0


def _first_outside(values: Floats, ends: Floats) -> int:
    """Return the first place where a value is not between its ends, or -1."""
    bad = ~((ends[0] < values) & (values < ends[1]))
    if not bad.any():
        return -1
    return int(np.argmax(bad))


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


def packed(stages: Sequence[MemoryFree]) -> tuple[Floats, Words]:
    """Return the curves of every channel as numbers, and where each channel's begin.

    A scale is ``0, gain, offset``; points are ``1, m, x0, y0`` and three numbers a
    segment.
    """
    rows: list[Floats] = []
    for group in stages:
        parts = [np.empty(0)]
        for stage in group:
            if isinstance(stage, ScaleStage):
                parts.append(np.array([0.0, stage.gain, stage.offset]))
            else:
                head = np.array([1.0, float(len(stage.segments)), stage.x0, stage.y0])
                parts += [
                    head,
                    np.asarray(stage.segments, dtype=np.float64).reshape(-1),
                ]
        rows.append(np.concatenate(parts))
    places = np.concatenate([[0], np.cumsum([row.size for row in rows])]).astype(
        np.uint64
    )
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
    make: Any = (
        PythonBank if kernel.CHOSEN is kernel.PythonKernel else kernel.CHOSEN.Bank
    )
    back = [tuple(stage.inverse() for stage in reversed(group)) for group in after]
    curves: list[Any] = [
        part for stages in (before, after, back) for part in packed(stages)
    ]
    return make(
        tuple(stepper.inner for stepper in steppers),
        *curves,
        np.ascontiguousarray(limits),
    )
