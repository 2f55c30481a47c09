"""The clock of a log: the time of every row in seconds, from a column, a stated rate, or none.

``find_clock`` decides which; ``Clock.read`` makes seconds of it, block by block. Gaps and
repeated stamps are warned of. Time that goes back is refused, and so are figures without
a unit that can hardly be seconds.
"""

import contextlib
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.arrays import Floats
from dbo_cli.errors import InputError, UsageError, warn
from dbo_cli.logs.columns import TIME_NAMES, listing_of, named, words
from dbo_cli.logs.settings import stated_rate
from dbo_cli.logs.table import Column, Reading, Table
from dbo_cli.signals import even
from dbo_cli.units import kind_of, multiplied, ratio, time_unit

_KINDS = (None, "time", "count", "number of samples")  # what its unit may measure
# s; without a unit, figures this far apart or more are hardly seconds
_LONG_STEP = 1.0
# s; without a unit, figures closer together than this are hardly seconds: days are
_SHORT_STEP = 1e-5
_SAME = 0.01  # of a step
_LATEST = 1e8  # s, three years; a clock that counts a run never gets there
_EPOCH = (1e9, 4.1e9)  # s since 1970: the years 2001 to 2100
_GAP = 1.5  # usual steps


@dataclass
class Clock:
    """Where the times of a log's rows come from.

    Attributes
    ----------
    name
        The file, for messages.
    kind
        ``column``, ``stamps``, ``rate`` or ``none``.
    column
        The time column.
    factor
        By what its figures become seconds.
    assumption
        What is assumed of a unit that nothing states; empty where all is stated.
    rate, start
        Samples a second (Hz) and the time (s) of the first row, without a column.
    rate_beside
        The rate (Hz) that the file states beside a time column.
    step
        Seconds between rows where they are even so far.
    first_stamp
        What time 0 is (ns since 1970, or since midnight), where stamps say it.
    holds_delay
        Whether a delay of the actuator is part of the seconds that are added to the clock
        of a second file.
    note
        How messages tell of these seconds.
    usual_step, repeats, irregular, first_irregular
        The median step (s); how many steps are zero; how many are zero or much longer, and
        the row of the first.
    """

    name: str
    kind: str = "none"
    column: Column | None = None
    factor: Fraction = Fraction(1)
    assumption: str = ""
    rate: float | None = None
    start: float = 0.0
    rate_beside: float | None = None
    step: float | None = None
    first_stamp: int | None = None
    holds_delay: bool = False
    note: str = ""
    remarks: list[str] = field(default_factory=list)
    rows: int = 0
    first: float = 0.0
    last: float = 0.0
    usual_step: float = 0.0
    repeats: int = 0
    irregular: int = 0
    first_irregular: int = 0

    @property
    def is_read(self) -> bool:
        """Whether the times stand in a column."""
        return self.kind in ("column", "stamps")

    def read(
        self, numbers: NDArray[np.int64], stored: NDArray[Any]
    ) -> tuple[Floats | None, float | Floats | None]:
        """Return the times of rows (s), and the time since the row before each.

        Parameters
        ----------
        numbers
            The numbers of the rows, from 1; at least one.
        stored
            What the time column holds.

        Returns
        -------
        time, dt
            ``dt`` is a number where the steps are even. Both are None without a clock.

        Raises
        ------
        InputError
            Time goes back, or the figures can hardly be what they are taken for.
        """
        if self.kind == "none":
            return None, None
        time = self._seconds(numbers, stored)
        steps = np.diff(time, prepend=self.last if self.rows else time[0])
        differences = steps if self.rows else steps[1:]
        if not self.rows:
            self.first = float(time[0])
            steps[:1] = steps[1:2] if len(differences) else 0.0
        if len(differences):
            self._watch(differences, time, numbers)
        self.rows += len(time)
        self.last = float(time[-1])
        return time, steps if self.step is None else self.step

    def _seconds(self, numbers: NDArray[np.int64], stored: NDArray[Any]) -> Floats:
        if self.rate is not None:
            return np.asarray(self.start + (numbers - 1.0) / self.rate, np.float64)
        if self.kind == "column":
            return np.asarray(multiplied(stored, self.factor))
        if self.first_stamp is None:
            self.first_stamp = int(stored[0])
        return np.asarray((stored - self.first_stamp) / 1e9)

    def _watch(self, steps: Floats, time: Floats, numbers: NDArray[np.int64]) -> None:
        """Refuse a time that goes back; find out whether it is even, else count what is not."""
        numbers = numbers[len(numbers) - len(steps) :]
        if steps.min() < 0.0:
            at = int(np.argmax(steps < 0.0))
            after = float(time[at - len(steps)])
            label = "" if self.column is None else f", {self.column.label},"
            raise InputError(
                f"{self.name}: the time{label} goes back in row {numbers[at]}, from {after - steps[at]:.9g} "
                f"to {after:.9g} s: cut with `rows` :{numbers[at] - 1}, or type `sample_rate` HZ where no "
                "row is missing"
            )
        if self.step is not None or self.rows < 2:
            stamps = np.concatenate([[self.last], time]) if self.rows else time
            self.step = even(stamps, self.step)
        if not self.usual_step:
            self.usual_step = self.step or float(np.median(steps))
            self._require_seconds(float(time[-1]))
        if self.step is None and self.rate is None:
            self.repeats += int(np.count_nonzero(steps == 0.0))
            irregular = (steps == 0.0) | (steps > _GAP * self.usual_step)
            if irregular.any():
                first = int(numbers[np.argmax(irregular)])
                self.first_irregular = self.first_irregular or first
                self.irregular += int(np.count_nonzero(irregular))

    def _require_seconds(self, reach: float) -> None:
        """Refuse figures without a unit that can hardly be seconds, or contradict a stated rate."""
        if self.kind != "column" or not self.assumption:
            return
        step, is_epoch = self.usual_step, _EPOCH[0] < self.first < _EPOCH[1]
        samples = step * (self.rate_beside or 0.0)
        doubts = (
            step >= _LONG_STEP or 0.0 < step < _SHORT_STEP,
            abs(86400.0 * step - 1.0) < _SAME,  # days, at rows a second apart
            samples and abs(samples - 1.0) > _SAME,
            reach > _LATEST and not is_epoch,
        )
        if any(doubts):
            problem = f"has no unit, and in seconds its steps would be {step:.4g}, its end {reach:.6g}"
            raise _unclear(self.name, self.column, problem)

    def close(self) -> None:
        """Warn of what is doubtful once all rows are read; refuse a time that mostly stands still."""
        if 2 * self.repeats >= max(self.rows, 1):
            problem = f"stands still at {self.repeats:,} of {self.rows:,} rows"
            raise _unclear(self.name, self.column, problem)
        if self.irregular:
            warn(
                f"{self.name}: {self.irregular:,} gaps or repeats among {self.rows:,} time stamps, the "
                f"first in row {self.first_irregular:,}: `sample_rate` HZ replaces the stamps"
            )

    def describe(self) -> str:
        """Return how long a log lasts and at which rate: ``12 s at 2 kHz``."""
        if self.kind == "none" or self.rows < 1:
            return "no clock"
        step = self.step or (self.last - self.first) / max(self.rows - 1, 1)
        if self.irregular and self.usual_step:
            step = self.usual_step
        if step <= 0.0:
            return "no span of time"
        about = "" if self.step else "about "
        text = f"{self.last - self.first + step:.4g} s at {about}{hertz(1.0 / step)}"
        text += " (no unit stated)" if self.assumption else ""
        return text + self.note


def hertz(rate: float) -> str:
    """Return a rate with its unit: ``2 kHz``."""
    rate = float(f"{rate:.5g}")  # 999.9999999 Hz is 1 kHz
    for size, unit in ((1e6, "MHz"), (1e3, "kHz")):
        if rate >= size:
            return f"{rate / size:.5g} {unit}"
    return f"{rate:.5g} Hz"


# --- which clock ---


def find_clock(
    source: Table, reading: Reading, selector: str | None, used: Sequence[Column]
) -> Clock:
    """Find the time column, or the rate that the user or the file states.

    Parameters
    ----------
    source
        The file.
    reading
        ``sample_rate`` and ``time_unit`` as the user gave them.
    selector
        What the user typed for the time, or None.
    used
        Columns that the user named for other roles.

    Raises
    ------
    InputError
        Several columns may be meant, or the unit is none of time.
    UsageError
        ``sample_rate`` is given beside ``time`` or ``time_unit``.
    """
    rate = reading.sample_rate
    if rate is not None and (selector or reading.time_unit) is not None:
        option = "time_unit" if selector is None else "time"
        raise UsageError(
            f"`{option}` and `sample_rate` exclude each other: leave one out"
        )
    if selector is not None:
        matches = [named(source, selector, "time")]
    else:
        matches = _time_columns(source, used, needed=rate is None)
    if rate is not None:
        column = matches[0] if len(matches) == 1 else None  # has no other role
        return Clock(source.name, "rate", column, rate=rate, step=1.0 / rate)
    if len(matches) > 1:
        which = " or ".join(f"{column.number} ('{column.name}')" for column in matches)
        raise InputError(
            f"{source.name}: which column is the time? Type `time` {which}{source.hint}; columns of two "
            "clocks belong into two files (`clock_offset`)"
        )
    if matches:
        return _clock_of(source, matches[0], reading.time_unit)
    if reading.time_unit is not None:
        listing = listing_of(source.columns)
        raise _unclear(source.name, None, f"of `time_unit` is in no column, {listing}")
    rate, start, remark = stated_rate(source.name, source.settings, source.decimal)
    if rate is None:
        return Clock(source.name)
    clock = Clock(source.name, "rate", rate=rate, start=start, step=1.0 / rate)
    if remark:
        clock.assumption, clock.remarks = remark, [remark]
    return clock


def _unclear(name: str, column: Column | None, problem: str) -> InputError:
    """Return the refusal of a time column, of which ``problem`` is said."""
    label = "the time" if column is None else f"the time, {column.label},"
    return InputError(
        f"{name}: {label} {problem}: type `time_unit` s, ms, us, ns or d, `time` COLUMN, or `sample_rate` HZ"
    )


def _time_columns(source: Table, used: Sequence[Column], needed: bool) -> list[Column]:
    """Return the columns that may hold the time, by the surest reason that there is.

    A name; a word of the name; dates; the unit of the first column. One that cannot be
    read is refused where it is needed (InputError).
    """
    free = [column for column in source.columns if column not in used]
    # m may be minutes where a name says time: it is refused, not passed over
    timed = [
        c
        for c in free
        if kind_of(c.unit) in _KINDS or time_unit(c.unit) or c.unit == "m"
    ]
    called = [c for c in timed if c.quantity.lower() in TIME_NAMES]
    called = called or [c for c in timed if words(c.quantity) & TIME_NAMES]
    matches = [column for column in called if column.kind == "number"]
    matches = matches or [column for column in called if column.kind == "stamp"]
    matches = matches or [column for column in free if column.kind == "stamp"]
    if matches:
        return matches
    for column in called:
        if column.kind == "text" and needed:
            problem = f"holds '{column.sample}', no time stamp"
            raise _unclear(source.name, column, problem)
    first = [column for column in source.columns[:1] if column in free]
    return [c for c in first if c.kind == "number" and time_unit(c.unit)]


def _clock_of(source: Table, column: Column, spelled: str | None) -> Clock:
    """Return the clock of a time column.

    Raises
    ------
    InputError
        Its figures count something that is no known unit of time.
    """
    name = source.name
    if column.kind == "stamp" and spelled is not None:
        raise InputError(f"{name}: {column.label} holds stamps: leave out `time_unit`")
    if column.kind == "stamp":
        return Clock(name, "stamps", column)
    if spelled is not None:
        return Clock(name, "column", column, parse_time_unit(spelled))
    if column.doubt:
        raise _unclear(name, column, column.doubt.partition(":")[0])
    unit = _stated_unit(name, column)
    clock = Clock(name, "column", column, ratio(unit, "s"))
    if unit is None:
        clock.assumption = f"the time {column.label} has no unit: s is assumed"
    with contextlib.suppress(InputError):
        clock.rate_beside = stated_rate(name, source.settings, source.decimal)[0]
    return clock


def _stated_unit(name: str, column: Column) -> str | None:
    """Return the unit that a time column states; None where it states none.

    Raises
    ------
    InputError
        What it states is no unit of time, or several: ``time_100us``.
    """
    amount = r"(?<![^\W_])(\d[\d.,]*)\s*([^\W\d_]+)"
    for number, word in re.findall(amount, column.name):
        if time_unit(word):
            raise _unclear(name, column, f"may count {number} {word}")
    if column.unit is not None:
        before, _, _ = column.unit.partition(" since ")  # netCDF: s since 2026-01-02
        if time_unit(before) is None:
            raise _unclear(name, column, f"states '{column.unit}', no unit of time")
        return time_unit(before)
    parts = words(column.quantity)
    units = {time_unit(word) for word in parts if len(word) > 1} - {None, "min"}
    if len(units) > 1:
        raise _unclear(name, column, "states several units")
    return units.pop() if units else None


def parse_time_unit(text: str) -> Fraction:
    """Read ``time_unit``: a unit of time, or a number of them (``10us``), in seconds.

    Raises
    ------
    UsageError
        It is none.
    """
    match = re.fullmatch(r"\s*(\d+(?:\.\d+)?)?\s*([^\d\s].*?)\s*", text)
    unit = time_unit(match[2]) if match else None
    count = Fraction((match[1] if match else None) or 1)
    if unit is None or not count:
        raise UsageError(
            f"`time_unit` {text}: give s, ms, us, ns, min, h, or a multiple such as 10us"
        )
    return count * ratio(unit, "s")
