"""One operator, one sample at a time: the kernel with a state that stays where it is.

``DiscreteBacklashOperator.run`` checks, allocates and converts for every block, which a block pays once and a
live sample would pay each time (``benchmarks/live_speed.py``). The bits are the same.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.hysteresis import kernel
from dbo_cli.hysteresis.operators import BacklashState, DiscreteBacklashOperator, OutputLimits

Floats = NDArray[np.float64]
Words = NDArray[np.uint64]


class PythonStepper:
    """The extension's ``Stepper`` in Python; arguments are those of ``kernel.backlash_run``.

    ``decay`` is one row, and ``step`` the largest change of the output, or NaN.
    """

    def __init__(
        self,
        gears: Floats,
        n: int,
        run: int,
        x0: float,
        y0: float,
        extend: bool,
        gain: Floats,
        reference: float,
        memory_on_output: bool,
        decay: Floats,
        limited: bool,
        low: float,
        high: float,
        slack: float,
        step: float,
    ) -> None:
        self._table = gears, n, run, x0, y0, extend, gain, reference, memory_on_output
        exchanged = np.ascontiguousarray(gears[:, [1, 0, 2, 3]])
        exchanged[:, 2] = gears[:, 0] / gears[:, 1]
        self._exchanged = exchanged, n, run, y0, x0, extend, gain, reference, not memory_on_output
        steps = np.array([] if math.isnan(step) else [step])
        self._decay, self._limits = decay, (limited, low, high, slack, steps)
        self._words = np.zeros(kernel.buffer_words(n), np.uint64)
        self._memory, self.last = np.zeros(gain.size), math.nan
        self._planned: tuple[Words, Floats, float] | None = None
        self._cannot_apply = gain.size > 0 and not memory_on_output
        self.clipped = 0

    def plan(self, x: float) -> float:
        """Return the output for an input, without going on to the state that it leads to."""
        words, memory, y = self._words.copy(), self._memory.copy(), np.empty(1)
        counts = kernel.backlash_run(
            *self._table, words, memory, self.last, np.array([x], np.float64), y, self._decay, *self._limits
        )
        self.clipped = counts[2]
        self._planned = words, memory, y.item()
        return self._planned[2]

    def commit(self) -> None:
        """Go on to the state that the last plan leads to."""
        if self._planned is None:
            raise ValueError("nothing was planned to be committed")
        self._words, self._memory, self.last = self._planned
        self._planned = None

    def apply(self, y: float) -> None:
        """Go on to the state that this output leads to, whatever was planned."""
        if self._cannot_apply:
            raise ValueError("memory on the input: its output does not give the state")
        kernel.backlash_run(
            *self._exchanged, self._words, self._memory, math.nan, np.array([y], np.float64), np.empty(1),
            self._decay, False, 0.0, 0.0, 0.0, np.array([]),
        )  # fmt: skip
        self.last, self._planned = float(y), None

    def set(self, words: Words, memory: Floats, last: float) -> None:
        """Take over the bits, the memory and the output before."""
        self._words[:], self._memory[:], self.last, self._planned = words, memory, last, None

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
        ``commit()``: go on to the state that the last plan leads to. ValueError where nothing was planned.
    apply : callable
        ``apply(y)``: go on to the state that this output leads to, whatever was planned: that of the operator
        with exchanged axes driven by it. ValueError where memory follows the input.
    """

    def __init__(
        self,
        operator: DiscreteBacklashOperator,
        state: BacklashState,
        last: float,
        time_step: float | None,
        limits: OutputLimits | None = None,
    ) -> None:
        terms, bound = operator.relaxation, limits or OutputLimits()
        gain = np.array(terms.gain if terms else (), dtype=np.float64)
        decay = terms.decay(time_step) if terms and time_step is not None else np.zeros((0, 0))
        step = math.nan if bound.step is None else float(np.asarray(bound.step))
        make = PythonStepper if kernel.CHOSEN is kernel.PythonKernel else kernel.CHOSEN.Stepper
        self._operator, self._made_with = operator, (time_step, limits)
        self.inner = make(
            operator.gears, operator.n, operator.equal_run, operator.x0, operator.y0, True, gain,
            terms.reference if terms else 0.0, operator.memory_on == "output", decay, limits is not None,
            bound.low, bound.high, bound.slack, step,
        )  # fmt: skip
        self._words, self._memory = operator._words(state), np.zeros(gain.size)
        self.plan, self.commit, self.apply = self.inner.plan, self.inner.commit, self.inner.apply
        self.set(state, last)

    def __reduce__(self) -> Any:
        """Pickle the committed state; what was planned stays behind."""
        return BacklashStepper, (self._operator, self.state, self.last, *self._made_with)

    @property
    def clipped(self) -> int:
        """1 where the last plan met the limits, else 0."""
        return int(self.inner.clipped)

    @property
    def state(self) -> BacklashState:
        """The committed state."""
        self.inner.get(self._words, self._memory)
        held = tuple(self._memory.tolist()) if self._operator.relaxation is not None else None
        return BacklashState(self._operator._bits(self._words), held)

    @property
    def last(self) -> float:
        """The output of the last step committed."""
        return float(self.inner.last)

    def set(self, state: BacklashState, last: float) -> None:
        """Take a state over from this operator or the exchanged one: its bits and memory mean the same."""
        memory = np.array(state.memory or (), dtype=np.float64)
        self.inner.set(self._operator._words(state), memory, last)
