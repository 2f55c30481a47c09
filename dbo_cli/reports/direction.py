"""Which way a signal is going, sample by sample, whatever noise, rounding and holding do to its steps."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

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


class _Turn(NamedTuple):
    """Where the way changed: what was settled before it, and the stretch in which it stands out."""

    settled: int
    begin: int
    end: int
    furthest: float
    way: int


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
        self._furthest = 0.0  # of the samples since the last turn

    def add(self, values: Floats) -> Directions:
        """Take one batch (finite, not empty)."""
        self._noise.add(values)
        before = self._way, self._low, self._high
        self._low, self._high = min(self._low, float(values.min())), max(self._high, float(values.max()))
        least = min(TURN_IN_NOISE * self._noise.deviation, LARGEST_TURN * (self._high - self._low))
        turns, settled = self._turns(values, least, *before[1:])
        stops, ways = [], []
        way = before[0]
        for turn, first in zip(turns, _first_beyond(values, turns, least), strict=True):
            stops += [turn.settled, first]
            ways += [way, 0]
            way = turn.way
        lengths = np.diff([0, *stops, settled, len(values)])
        told = turns[0].settled if turns else settled
        return Directions(
            np.repeat(np.array([*ways, way, 0], dtype=np.int8), lengths),
            settled,
            before[0] if told else 0 if turns else None,
        )

    def _turns(self, values: Floats, least: float, low: float, high: float) -> tuple[list[_Turn], int]:
        """Return the turns of a batch, and how many samples of it are settled. Every turning point is met."""
        turns: list[_Turn] = []
        way, furthest, settled = self._way, self._furthest, 0
        begin = 0  # of the monotone stretch that ends at ``place``
        places = monotone_ends(values)
        for place, value in zip(places.tolist(), values[places].tolist(), strict=True):
            turned = 0
            if way > 0:
                if value > furthest:
                    furthest, settled = value, place + 1
                elif furthest - value > least:
                    turned = -1
            elif way < 0:
                if value < furthest:
                    furthest, settled = value, place + 1
                elif value - furthest > least:
                    turned = 1
            else:
                low, high = min(low, value), max(high, value)
                turned = 1 if value - low > least else -1 if high - value > least else 0
                furthest = low if turned > 0 else high
            if turned:
                turns.append(_Turn(settled, begin, place, furthest, turned))
                way, furthest, settled = turned, value, place + 1
            begin = place + 1
        self._way, self._furthest = way, furthest
        return turns, settled


def _first_beyond(values: Floats, turns: list[_Turn], least: float) -> list[int]:
    """Return for each turn the first sample of its stretch that is further back than ``least``.

    The stretches are monotone: halved, all at once, until one sample is left.
    """
    begin = np.array([turn.begin for turn in turns], dtype=np.int64)
    end = np.array([turn.end for turn in turns], dtype=np.int64)
    way = np.array([turn.way for turn in turns], dtype=np.float64)
    furthest = np.array([turn.furthest for turn in turns], dtype=np.float64)
    while (begin < end).any():
        middle = (begin + end) // 2
        beyond = way * (values[middle] - furthest) > least
        end = np.where(beyond, middle, end)
        begin = np.where(beyond, begin, np.minimum(middle + 1, end))
    return [int(place) for place in end]


def monotone_ends(values: Floats) -> NDArray[np.int64]:
    """Return the places where the direction changes and the two ends; in between nothing can turn."""
    if len(values) < 2:
        return np.arange(len(values))
    step = np.sign(np.diff(values))
    inner = np.flatnonzero(step[1:] != step[:-1]) + 1
    return np.concatenate([[0], inner, [len(values) - 1]])
