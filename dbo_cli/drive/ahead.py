"""Rows that wait until those after them are known: undoing dynamics and delay reads ahead."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.model import Steps


class Rows(NamedTuple):
    """Rows that are ready: seconds (None without a clock), what was asked for, and what came of it."""

    time: Floats | None
    x: Floats
    y: Floats


class Ahead:
    """Holds back the last ``count`` rows of a signal that comes in blocks."""

    def __init__(self, count: int) -> None:
        self.count = count
        self._x = np.empty(0)
        self._time: Floats | None = None
        self._dt: Steps = None

    def take(
        self, x: Floats, dt: Steps, time: Floats | None
    ) -> tuple[Floats, Floats, Steps, Floats | None]:
        """Take a block; return rows that are ready, them and ``count`` after, their steps and times."""
        if self._x.size:
            x = np.concatenate([self._x, x])
            if time is not None and self._time is not None:
                time = np.concatenate([self._time, time])
        ready = max(x.size - self.count, 0)
        self._x, self._dt = x[ready:], dt
        self._time = None if time is None else time[ready:]
        return x[:ready], x, dt, None if time is None else time[:ready]

    def rest(self) -> tuple[Floats, Floats, Steps, Floats | None]:
        """Return the rows that are left: the last value goes on for ever."""
        x, self._x = self._x, np.empty(0)
        known = np.concatenate([x, np.full(self.count, x[-1:].sum())])
        return x, known, self._dt, self._time
