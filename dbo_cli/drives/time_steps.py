"""The time between samples across blocks and across runs, for models that remember by time."""

from __future__ import annotations

import numpy as np

from dbo_cli.errors import InputError
from dbo_cli.logs.sample_block import FloatArray, SampleBlock
from dbo_cli.logs.sources import Source

SAME_STEP = 1e-6
"""A run goes on without a pause where its first sample comes one step after the last one's, to this fraction.

Time stamps are row numbers over a rate, rounded; a rounding error is 1e-9 of a step after 10^7 rows.
"""


class TimeSteps:
    """Tells the seconds since the sample before.

    Parameters
    ----------
    source : Source
        Where the samples come from.
    why : str, optional
        Why the time is needed, for the refusal of a source without; None: it is not needed.
    last : float, optional
        When the sample before the first one was (s), from a state that knows it.
    """

    def __init__(self, source: Source, why: str | None, last: float | None = None) -> None:
        self.needed = why is not None
        self.name = source.name
        if why is not None:
            source.require_time(why)
        # One number where samples are evenly spaced by definition: a delay of whole samples is exact then.
        rate = source.even_rate
        self.step = None if rate is None else 1.0 / rate
        self._last = last
        self._begun = False

    def of(self, block: SampleBlock) -> float | FloatArray | None:
        """Return one number, or one for each sample of the block; None where no time is needed.

        Raises
        ------
        InputError
            Time goes backwards.
        """
        if not self.needed or block.time is None:
            return None
        if not self._begun:
            self._begin(block.time)
        if self.step is not None:
            return self.step
        steps: FloatArray = np.diff(block.time, prepend=0.0 if self._last is None else self._last)
        if (steps < 0.0).any():
            place = block.place(self.name, int(np.flatnonzero(steps < 0.0)[0]))
            raise InputError(
                f"{place}: time goes backwards, and this model's lag and creep depend on the time between "
                "samples (cut the log with `rows` A:B)"
            )
        self._last = float(block.time[-1])
        return steps

    def follow(self, last: float) -> None:
        """Let the first sample come after one at ``last`` (s)."""
        self._last = last

    def _begin(self, time: FloatArray) -> None:
        """Find when the sample before the first one was.

        Only after a saved state does the very first step count. Where the state does not know its time, or
        the clock began anew since, the first sample comes one step after it. The stamp of the state's own
        last sample is a repeated one: no time has passed.
        """
        self._begun = True
        first = float(time[0])
        usual = self.step if self.step is not None else float(time[1]) - first if len(time) > 1 else 0.0
        if self._last is None or self._last > first or (self.step is not None and self._last == first):
            self._last = first - usual
        elif self.step is not None and abs(first - self._last - self.step) > SAME_STEP * self.step:
            self.step = None  # a pause: from here on the stamps count
