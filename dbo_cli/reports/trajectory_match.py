"""A recording and the trajectory it was to follow, in two files: joined by time or by rows."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import numpy as np

from dbo_cli.errors import InputError
from dbo_cli.hysteresis.delay import interpolated
from dbo_cli.logs.sample_block import SampleBlock
from dbo_cli.reports.running_statistics import Floats
from dbo_cli.reports.sample_pairs import PairBlock

_AT_THE_END = 1e-6  # of a step: a stamp so little beyond the trajectory's last one is the same stamp


class TrajectoryMatch:
    """Give every sample of a recording the desired value that belongs to it.

    By time, the desired signal is interpolated linearly at the recording's times; what lies outside the
    trajectory's time, or goes back in time, takes no part. By rows, the first recorded row belongs to the
    first of the trajectory, and the time is the trajectory's, where it has one; what one of them has more
    takes no part. Both are read once and side by side, never held whole, and how they are cut into blocks
    changes no digit.

    Parameters
    ----------
    name, trajectory_name : str
        How messages call the two.
    recording : iterable of SampleBlock
        Roles ``measured`` and perhaps ``voltage``.
    trajectory : iterable of SampleBlock
        Role ``desired``.
    by_time : bool
        Both must carry time, then.

    Attributes
    ----------
    left_out : int
        Samples of the recording that found no partner; complete after the last pair.
    goes_on : bool
        By rows, whether the trajectory has more samples than the recording.
    """

    def __init__(
        self,
        name: str,
        trajectory_name: str,
        recording: Iterable[SampleBlock],
        trajectory: Iterable[SampleBlock],
        *,
        by_time: bool,
    ) -> None:
        self._name = name
        self._trajectory_name = trajectory_name
        self._recording = recording
        self._trajectory = (block for block in trajectory if len(block))
        self._by_time = by_time
        self.left_out = 0
        self.goes_on = False

    def pairs(self) -> Iterator[PairBlock]:
        """Yield the recording's samples with their desired values.

        Raises
        ------
        InputError
            The trajectory's time goes backwards, or no sample found a partner.
        """
        found = False
        for pair in self._pairs_by_time() if self._by_time else self._pairs_by_row():
            found = True
            yield pair
        if not found:
            raise InputError(
                f"{self._name}: no sample lies within the times of {self._trajectory_name}"
                " (where their clocks differ, `match` them by rows)"
                if self._by_time
                else f"{self._name}: no row to compare with {self._trajectory_name}"
            )

    def notes(self) -> list[str]:
        """Return what was left out, a line each."""
        notes = []
        if self.left_out:
            what = "outside the time of" if self._by_time else "more than in"
            notes.append(f"{self._name}: {self.left_out:,} rows {what} {self._trajectory_name} take no part")
        if self.goes_on:
            notes.append(f"{self._trajectory_name}: goes on behind the last row of {self._name}")
        return notes

    def _pairs_by_time(self) -> Iterator[PairBlock]:
        times, values = np.empty(0), np.empty(0)
        reached = -math.inf  # the recording's latest time; a sample before it has no place any more
        for block in self._recording:
            if not len(block):
                continue
            assert block.time is not None
            onward = np.maximum.accumulate(np.concatenate([[reached], block.time]))
            reached = float(onward[-1])
            while not len(times) or times[-1] < reached:
                following = next(self._trajectory, None)
                if following is None:
                    break
                times, values = self._appended(times, values, following)
            if not len(times):
                self.left_out += len(block)
                continue
            last_step = float(times[-1] - times[-2]) if len(times) > 1 else 0.0
            inside = (block.time >= times[0]) & (block.time <= times[-1] + _AT_THE_END * last_step)
            inside &= block.time >= onward[:-1]
            self.left_out += int(len(block) - np.count_nonzero(inside))
            if inside.any():
                desired, _ = interpolated(times, values, block.time)
                yield _only(PairBlock.of(block, desired), inside)
            # two stay: the one to interpolate from, and one more, whose step tells where the end is
            keep = max(int(np.searchsorted(times, reached, side="right")) - 2, 0)
            times, values = times[keep:], values[keep:]

    def _appended(self, times: Floats, values: Floats, block: SampleBlock) -> tuple[Floats, Floats]:
        assert block.time is not None
        together = np.concatenate([times, block.time])
        back = np.flatnonzero(np.diff(together[max(len(times) - 1, 0) :]) < 0.0)
        if len(back):
            place = block.place(self._trajectory_name, int(back[0]) + (len(times) == 0))
            raise InputError(f"{place}: time goes backwards (cut the trajectory there, or `match` by rows)")
        return together, np.concatenate([values, block.values["desired"]])

    def _pairs_by_row(self) -> Iterator[PairBlock]:
        wanted: SampleBlock | None = None
        for block in self._recording:
            done = 0
            while done < len(block):
                if wanted is None or not len(wanted):
                    wanted = next(self._trajectory, None)
                    if wanted is None:
                        self.left_out += len(block) - done
                        break
                count = min(len(block) - done, len(wanted))
                own, partner = block.part(done, done + count), wanted.part(0, count)
                time = own.time if partner.time is None else partner.time
                pair = PairBlock.of(own, partner.values["desired"])
                yield PairBlock(pair.rows, pair.desired, pair.measured, time, pair.drive)
                done, wanted = done + count, wanted.part(count, len(wanted))
        left = wanted is not None and len(wanted) > 0
        self.goes_on = left or next(self._trajectory, None) is not None


def _only(pair: PairBlock, kept: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> PairBlock:
    """Return the pairs that are kept."""
    if kept.all():
        return pair
    return PairBlock(
        np.asarray(pair.rows, dtype=np.int64)[kept],
        pair.desired[kept],
        pair.measured[kept],
        None if pair.time is None else pair.time[kept],
        None if pair.drive is None else pair.drive[kept],
    )
