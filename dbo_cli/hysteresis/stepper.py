"""One operator, one sample at a time: the kernel called with buffers that stay where they are.

``DiscreteBacklashOperator.run`` checks, allocates and converts for every block, which a block pays once and a
live sample would pay each time (180 µs; here a few µs, ``benchmarks/live_speed.py``). The bits are the same.
"""

from __future__ import annotations

import math

import numpy as np

from dbo_cli.hysteresis import kernel
from dbo_cli.hysteresis.operators import BacklashState, DiscreteBacklashOperator, OutputLimits


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
        self._operator = operator
        self._run = kernel.CHOSEN.backlash_run
        self._words = operator._words(state)
        self._planned_words = self._words.copy()
        self._memory = np.array(state.memory or (), dtype=np.float64)
        self._planned_memory = self._memory.copy()
        self._last, self._planned_last = last, math.nan
        self._x, self._y = np.zeros(1), np.zeros(1)
        bound = limits or OutputLimits()
        step = np.array([] if bound.step is None else [float(np.asarray(bound.step))], dtype=np.float64)
        gain = np.array(terms.gain if terms else (), dtype=np.float64)
        reference = terms.reference if terms else 0.0
        on_output = operator.memory_on == "output"
        table = (operator.gears, operator.n, operator.equal_run, operator.x0, operator.y0)
        self._before = (*table, True, gain, reference, on_output)
        decay = terms.decay(time_step) if terms and time_step is not None else np.zeros((0, 0))
        self._after = (decay, limits is not None, bound.low, bound.high, bound.slack, step)
        self._remembers = terms is not None
        self.clipped = 0

    def plan(self, x: float) -> float:
        """Return the output for an input, without going on to the state that it leads to."""
        self._planned_words[:] = self._words
        if self._remembers:
            self._planned_memory[:] = self._memory
        self._x[0] = x
        counts = self._run(
            *self._before,
            self._planned_words,
            self._planned_memory,
            self._last,
            self._x,
            self._y,
            *self._after,
        )
        self._planned_last = y = self._y.item()
        self.clipped = counts[2]
        return y

    def commit(self) -> None:
        """Go on to the state that the last plan leads to."""
        self._words, self._planned_words = self._planned_words, self._words
        self._memory, self._planned_memory = self._planned_memory, self._memory
        self._last = self._planned_last

    @property
    def state(self) -> BacklashState:
        """The committed state."""
        held = tuple(self._memory.tolist()) if self._remembers else None
        return BacklashState(self._operator._bits(self._words), held)

    @property
    def last(self) -> float:
        """The output of the last step committed."""
        return self._last

    def take(self, other: BacklashStepper, last: float = math.nan) -> None:
        """Go on from the committed state of the exchanged operator: bits and memory mean the same."""
        self._words[:] = other._words
        self._memory[:] = other._memory
        self._last = last
