"""Cut a stream of pairs into cycles of the desired signal, or into spans of time."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import numpy as np

from dbo_cli.errors import UsageError
from dbo_cli.reports.direction import monotone_ends
from dbo_cli.reports.running_statistics import Floats
from dbo_cli.reports.sample_pairs import PairBlock, released

PATIENCE = 1 << 18


def cycles(
    blocks: Iterable[PairBlock], part: float = 0.05, patience: int = PATIENCE
) -> Iterator[PairBlock | None]:
    """Yield the same samples, and None at the end of every cycle of the desired signal but the last.

    A cycle ends at a minimum. Turns smaller than ``part`` of the range seen so far are noise or rest and end
    none. What follows the lowest sample so far is held back until the signal has risen by that much, at
    most ``patience`` samples: a longer rest belongs to the cycle before it.
    """
    turns = _Turns(part)
    held: list[PairBlock] = []
    start = end = 0  # stream positions of what is held
    for block in blocks:
        held.append(block)
        end += len(block)
        for minimum in turns.minima(block.desired):
            yield from released(held, minimum - start)
            yield None
            start = max(start, minimum)
        sure = max(turns.candidate, end - patience)
        if sure > start:
            yield from released(held, sure - start)
            start = sure
    yield from held


def spans(
    blocks: Iterable[PairBlock], seconds: float, sample_rate: float | None
) -> Iterator[PairBlock | None]:
    """Yield the same samples, and None at the end of every span of ``seconds`` but the last.

    Without times, a span is ``seconds * sample_rate`` samples (UsageError where that is not known either).
    """
    if not seconds > 0.0:
        raise UsageError(f"`segment` {seconds:g}: a segment must last longer than 0 seconds")
    origin = math.nan
    current = 0.0
    position = 0
    for block in blocks:
        if block.time is not None:
            time = block.time
        elif sample_rate is not None:
            time = (position + np.arange(len(block))) / sample_rate
        else:
            raise UsageError("`segment` in seconds needs a time column or `sample_rate`")
        position += len(block)
        if math.isnan(origin):
            origin = float(time[0])
        # a clock that restarts or steps back must not open a segment twice: only forward steps cut
        number = np.fmax.accumulate(np.concatenate([[current], np.floor((time - origin) / seconds + 1e-9)]))
        current = float(number[-1])
        done = 0
        for place in np.flatnonzero(np.diff(number)).tolist():
            if place > done:
                yield block.part(done, place)
            yield None
            done = place
        yield block.part(done, len(block))


class _Turns:
    """Find the minima of a stream that stand deeper than a part of the range seen so far."""

    def __init__(self, part: float) -> None:
        self._part = part
        self._seen = 0
        self._low = math.inf
        self._high = -math.inf
        self._falling = True
        self._extreme = math.inf
        self.candidate = 0  # stream position before which no minimum can be found any more

    def minima(self, desired: Floats) -> list[int]:
        """Return the stream positions of the minima that this block confirms."""
        found: list[int] = []
        places = monotone_ends(desired)
        places = places[np.isfinite(desired[places])]
        for place, value in zip(places.tolist(), desired[places].tolist(), strict=True):
            position = self._seen + place
            self._low, self._high = min(self._low, value), max(self._high, value)
            threshold = self._part * (self._high - self._low)
            if self._falling:
                if value <= self._extreme:
                    self._extreme, self.candidate = value, position
                elif value - self._extreme > threshold:
                    if self.candidate > 0:
                        found.append(self.candidate)
                    self._falling, self._extreme = False, value
            elif value >= self._extreme:
                self._extreme = value
            elif self._extreme - value > threshold:
                self._falling, self._extreme, self.candidate = True, value, position
        self._seen += len(desired)
        if not self._falling:
            self.candidate = self._seen
        return found
