"""Which way a signal is going, sample by sample, whatever noise, rounding and holding do to its steps."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dbo_cli.reports.running_statistics import Floats

# A turn must be larger than this many standard deviations of the noise: the greatest and the least of 10,000
# normal samples lie 8 apart.
TURN_IN_NOISE = 10.0
# ... but never need be larger than this part of the range, lest the turns of a signal of few samples a cycle,
# whose second difference is motion and not noise, go unseen.
LARGEST_TURN = 0.1
# Mean of |second difference| to standard deviation, for normal noise: the difference has the variance 6.
_TO_DEVIATION = math.sqrt(math.pi / 2.0) / math.sqrt(6.0)


class NoiseLevel:
    """Standard deviation of what changes from sample to sample, from the mean |second difference|.

    For white noise it is that of the noise; what bends slowly hardly counts, and a jump counts once, not with
    its square. An upper bound, therefore: for signals of few samples a cycle a high one.
    """

    def __init__(self) -> None:
        self._sum = 0.0
        self._count = 0

    def add(self, values: Floats) -> None:
        """Take one batch."""
        if len(values) > 2:
            self._sum += float(np.abs(np.diff(values, 2)).sum())
            self._count += len(values) - 2

    @property
    def deviation(self) -> float:
        """Standard deviation so far; 0 before the third sample."""
        return _TO_DEVIATION * self._sum / self._count if self._count else 0.0


@dataclass(frozen=True)
class Directions:
    """The way every sample of a batch goes: 1 up, -1 down, 0 neither.

    From the place ``open_from`` on it is not known yet (the zeros there mean nothing). ``earlier`` says what
    became of the samples that were open before this batch: 1, -1, 0 (neither), or None: still open.
    """

    ways: NDArray[np.int8]
    open_from: int
    earlier: int | None


class DirectionTracker:
    """Tell up from down by the last turn that stands out of the noise.

    A sample that has gone further than any since the turn settles all before it: they went the same way, so
    a held or rounded signal keeps its direction on every plateau. One that has gone back by more than the
    least turn starts the other way. The samples between the furthest one and that (the rest at a turn, the
    noise around it) belong to neither way; so do those before the first way and after the last.
    """

    def __init__(self) -> None:
        self._noise = NoiseLevel()
        self._low, self._high = math.inf, -math.inf
        self._way = 0
        self._furthest = -math.inf  # value times way, since the last turn

    def add(self, values: Floats) -> Directions:
        """Take one batch (finite, not empty)."""
        self._noise.add(values)
        before = self._low, self._high
        self._low, self._high = min(self._low, float(values.min())), max(self._high, float(values.max()))
        least = min(TURN_IN_NOISE * self._noise.deviation, LARGEST_TURN * (self._high - self._low))
        stops, ways = self._settled(values, least, *before)
        lengths = np.diff([0, *stops, len(values)])
        return Directions(
            np.repeat(np.array([*ways, 0], dtype=np.int8), lengths),
            stops[-1] if stops else 0,
            ways[0] if ways else None,
        )

    def _settled(self, values: Floats, least: float, low: float, high: float) -> tuple[list[int], list[int]]:
        """Return runs of samples whose way is known now: where each ends, and its way."""
        stops: list[int] = []
        ways: list[int] = []
        way, furthest = self._way, self._furthest
        begin = 0  # of the monotone stretch that ends at ``place``
        places = monotone_ends(values)
        for place, value in zip(places.tolist(), values[places].tolist(), strict=True):
            turned = 0
            if way == 0:
                low, high = min(low, value), max(high, value)
                turned = 1 if value - low > least else -1 if high - value > least else 0
                back = low if turned == 1 else -high
            elif way * value > furthest:
                furthest = way * value
                stops.append(place + 1)
                ways.append(way)
            elif furthest - way * value > least:
                turned, back = -way, -furthest
            if turned:
                stretch = turned * values[begin : place + 1]
                stops += [begin + int(np.argmax(stretch - back > least)), place + 1]
                ways += [0, turned]
                way, furthest = turned, turned * value
            begin = place + 1
        self._way, self._furthest = way, furthest
        return stops, ways


def monotone_ends(values: Floats) -> NDArray[np.int64]:
    """Return the places where the direction changes and the two ends; in between nothing can turn."""
    step = np.sign(np.diff(values))
    inner = np.flatnonzero(step[1:] != step[:-1]) + 1
    if not len(values):
        return np.empty(0, np.int64)
    return np.unique(np.concatenate([[0], inner, [len(values) - 1]]))
