"""Header blocks that stand again among the data, one before each segment (LabVIEW's ``Multi_Headings``)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from dbo_cli.errors import InputError
from dbo_cli.logs.sample_block import FloatArray
from dbo_cli.logs.text.cells import split_cells

END_OF_HEADER = "***End_of_Header***"


class HeaderBlock(NamedTuple):
    """What begins and ends each header block, and the date and time that the first one states (each s)."""

    first_word: str
    names: str
    delimiter: str
    start: tuple[float, float] | None


def find_header_block(lines: Sequence[str], first: int, delimiter: str) -> HeaderBlock | None:
    """Find the block above the data (which begin at index ``first``) that each segment repeats.

    Such a file has two ends of a header: that of the file's and that of the first segment's.
    """
    ends = [number for number in range(first) if lines[number].strip().startswith(END_OF_HEADER)]
    if len(ends) < 2 or first - ends[-1] != 2:
        return None
    inner = [lines[number] for number in range(ends[-2] + 1, ends[-1]) if lines[number].strip()]
    if not inner:
        return None
    word = split_cells(inner[0], delimiter)[0]
    return HeaderBlock(word, lines[first - 1].strip(), delimiter, _start(inner, delimiter)) if word else None


def _start(lines: Sequence[str], delimiter: str) -> tuple[float, float] | None:
    """Return when a segment began: the date and the time that its header states, each in seconds."""
    from dbo_cli.logs.text.time_stamps import clock_seconds, date_seconds

    rows = [split_cells(line, delimiter) for line in lines]
    stated = {cells[0]: cells[1] for cells in rows if len(cells) > 1}
    date, clock = (
        date_seconds(stated.get("Date", "")),
        clock_seconds(stated.get("Time", "").replace(",", ".")),
    )
    return None if date is None or clock is None else (date, clock)


class RepeatedHeader:
    """Takes header blocks out of the data, and lets the time go on where a segment begins it again.

    A segment's time is shifted by what its header's date and time are later than the first one's; where that
    is not stated, it begins one step after the last row.
    """

    def __init__(self, place: str, block: HeaderBlock) -> None:
        self.place = place
        self.block = block
        self.count = 0
        self.guessed = 0
        self._lines: list[str] | None = None
        self._begins = False
        self._start: tuple[float, float] | None = None
        self._shift = 0.0
        self._last: float | None = None
        self._step = 0.0

    def takes(self, line: str, number: int) -> bool:
        """Return whether a line belongs to a header block and not to the data.

        Raises
        ------
        InputError
            The block names other columns than the first one.
        """
        if self._lines is None:
            if split_cells(line, self.block.delimiter)[0] != self.block.first_word:
                return False
            self._lines = []
        ended = bool(self._lines) and self._lines[-1].strip().startswith(END_OF_HEADER)
        if ended and line.strip():
            if line.strip() != self.block.names:
                raise InputError(
                    f"{self.place}:{number}: a header in the middle of the data names other columns than the "
                    "first one (cut the log with `rows` A:B)"
                )
            self._start = _start(self._lines, self.block.delimiter)
            self._lines, self._begins = None, True
            self.count += 1
        else:
            self._lines.append(line)
        return True

    def continued(self, time: FloatArray) -> FloatArray:
        """Return the time stamps (s) of rows that follow each other without a header between them."""
        if not len(time):
            return time
        if self._begins:
            self._begins = False
            self._shift = self._shift_for(float(time[0]))
        if self._shift:
            time = time + self._shift
        if len(time) > 1 or self._last is not None:
            before = float(time[-2]) if len(time) > 1 else self._last
            self._step = float(time[-1]) - before if before is not None else 0.0
        self._last = float(time[-1])
        return time

    def _shift_for(self, first: float) -> float:
        if self._last is None or first > self._last:
            return 0.0  # this writer lets the time go on by itself
        if self._start is not None and self.block.start is not None:
            dates, clocks = zip(self._start, self.block.start, strict=True)
            shift = dates[0] - dates[1] + clocks[0] - clocks[1]
            if first + shift > self._last:
                return shift
        self.guessed += 1
        return self._last + self._step - first

    def note(self, timed: bool) -> str:
        """Describe what was found; without a time column (``timed``) rows alone give the time."""
        plural = "s" if self.count > 1 else ""
        how = "their time goes on by the dates and times stated there"
        if not timed:
            how = "no column gives their time, so the rows go on as if there had been no pause"
        elif self.guessed:
            how = "the time goes on one step after the last row, for no date and time say more"
        return f"{self.place}: {self.count} more header{plural} among the data: {how}"
