"""Dwells: the pairs at which what is desired is held, as at a pixel or on a stair."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import numpy as np

from dbo_cli.errors import InputError
from dbo_cli.reports.sample_pairs import PairBlock

SAME = 1e-9  # of the seconds: what rounded time stamps may lack


class Dwells:
    """Takes out the pairs whose desired value has not changed for some seconds.

    Parameters
    ----------
    name : str
        How messages call the log.
    seconds : float
        How long it is held before a pair counts; 0: from the second row on.
    sample_rate : float, optional
        Rows a second (Hz), of a log without times.
    """

    def __init__(self, name: str, seconds: float, sample_rate: float | None) -> None:
        self._name, self._seconds, self._rate = name, seconds, sample_rate
        self.kept = self.read = 0

    def of(self, blocks: Iterable[PairBlock]) -> Iterator[PairBlock]:
        """Yield the pairs that count; how they are cut into blocks changes none.

        Raises
        ------
        InputError
            There is no time, or nothing is held so long.
        """
        level, since = math.nan, math.nan
        for block in blocks:
            if not len(block):
                continue
            time = block.time
            if time is None and self._rate is None:
                raise InputError(
                    f"{self._name}: no time is given, and `dwell` depends on it (`time` or `sample_rate` HZ)"
                )
            if time is None and self._rate is not None:
                time = block.row_numbers() / self._rate
            assert time is not None
            new = block.desired != np.concatenate([[level], block.desired[:-1]])  # a blank is never held
            begun = np.maximum.accumulate(np.where(new, np.arange(len(block)), -1))
            start = np.where(begun >= 0, time[begun], since)
            held = block.only(~new & (time - start >= self._seconds * (1.0 - SAME)))
            level, since = float(block.desired[-1]), float(start[-1])
            self.read += len(block)
            self.kept += len(held)
            yield held
        if self.read and not self.kept:
            raise InputError(
                f"{self._name}: what is desired is nowhere held for {self._seconds:g} s (`dwell`)"
            )

    def note(self) -> str:
        """Return how many pairs counted."""
        return (
            f"{self._name}: {self.kept:,} of {self.read:,} rows count, at which what is desired has been "
            f"held for {self._seconds:g} s"
        )
