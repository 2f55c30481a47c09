"""The clock of a log: the time of every row in seconds, from a column, a stated rate, or none.

Gaps and repeated stamps are said. Time that goes back is refused, and so are figures
without a unit that can hardly be seconds.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import InputError, warn
from dbo_cli.logs.source import NOT_A_TIME, Column, FloatArray
from dbo_cli.units import multiplied

_DAY = 86400 * 10**9  # ns
# s; whoever logs a hysteresis loop at one sample a second or slower states the unit
_LONG_STEP = 1.0
_LONGEST_STEP = 3600.0  # s; no loop is recorded at less than a sample an hour
_LATEST = (
    1e8  # s, three years; a clock that counts the seconds of a run never gets there
)
_EPOCH = (1e9, 4.1e9)  # s since 1970: the years 2001 to 2100
_SHORTEST = 1e-3  # s; no piezo under load passes its range in less
_LONG_LOG = 3600.0  # s
# steps are even where they differ by no more than this part of a step, or by the
# rounding of the file's decimals
_EVEN = 1e-6
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
    unit
        The unit that is stated; None where nothing states it.
    rate, start
        Samples a second (Hz) and the time (s) of the first row, without a column.
    step, uneven
        Seconds between rows where they are even so far; whether they are not.
    origin
        What time 0 is in seconds since 1970, where dates say it.
    """

    name: str
    kind: str = "none"
    column: Column | None = None
    factor: Fraction = Fraction(1)
    unit: str | None = None
    given: bool = False
    rate: float | None = None
    start: float = 0.0
    step: float | None = None
    uneven: bool = False
    origin: float | None = None
    remarks: list[str] = field(default_factory=list)
    doubtful: list[str] = field(default_factory=list)
    rows: int = 0
    first: float = 0.0
    last: float = 0.0
    usual_step: float = 0.0
    repeats: int = 0
    gaps: int = 0
    first_gap: int = 0
    largest_gap: float = 0.0
    first_stamp: int | None = None
    last_stamp: int = 0
    days: int = 0
    digits: float = 0.0

    def times(
        self, numbers: NDArray[np.int64], stored: NDArray[Any] | None
    ) -> FloatArray | None:
        """Return the times (s) of rows, by their numbers (from 1) or by what the column holds.

        Raises
        ------
        InputError
            Time goes back, or the figures can hardly be what they are taken for.
        """
        if self.kind == "none":
            return None
        if self.kind == "rate":
            assert self.rate is not None
            time = np.asarray(
                self.start + (numbers - 1.0) / self.rate, dtype=np.float64
            )
            self._count(time)
            return time
        assert stored is not None
        if self.kind == "stamps":
            time = self._since_first(stored)
        else:
            time = multiplied(stored, self.factor)
        if len(time):
            self._watch(time, numbers)
        return time

    def _since_first(self, stamps: NDArray[np.int64]) -> FloatArray:
        """Turn stamps (ns) into seconds since the first; a clock without dates goes on past midnight."""
        if not len(stamps):
            return stamps.astype(np.float64)
        if self.first_stamp is None:
            self.first_stamp = int(stamps[0])
            self.last_stamp = int(stamps[0])
            if self.first_stamp >= _DAY:
                self.origin = self.first_stamp / 1e9
        if self.origin is None:
            steps = np.diff(stamps, prepend=self.last_stamp)
            self.last_stamp = int(stamps[-1])
            passed = self.days + np.cumsum(steps < -_DAY // 2)
            if passed[-1] and not self.days:
                self.doubtful.append("the clock passes midnight and goes on")
            self.days = int(passed[-1])
            stamps = stamps + passed * _DAY
        return (stamps - self.first_stamp) / 1e9

    def _count(self, time: FloatArray) -> None:
        if len(time):
            self.first = float(time[0]) if not self.rows else self.first
            self.last = float(time[-1])
            self.rows += len(time)

    def _watch(self, time: FloatArray, numbers: NDArray[np.int64]) -> None:
        """Refuse a time that goes back; count repeats and gaps, and find the usual step."""
        steps = np.diff(time, prepend=time[0] if not self.rows else self.last)
        if (steps < 0.0).any():
            at = int(np.argmax(steps < 0.0))
            before = time[at] - steps[at]
            raise InputError(
                f"{self.called}: row {numbers[at]}: time goes back from {before:.9g} to {time[at]:.9g} s "
                "(`rows` A:B cuts the log there, or `sample_rate` HZ gives the time instead)"
            )
        known = steps[1:] if not self.rows else steps
        fresh = self.rows < 3
        self._count(time)
        if fresh and len(known):
            self.usual_step = float(np.median(known))
            self._require_seconds()
        self.repeats += int(np.count_nonzero(known == 0.0))
        if self.usual_step > 0.0:
            gaps = known > _GAP * self.usual_step
            if gaps.any() and not self.gaps:
                self.first_gap = int(
                    numbers[len(numbers) - len(known) + int(np.argmax(gaps))]
                )
            self.gaps += int(np.count_nonzero(gaps))
            self.largest_gap = max(self.largest_gap, float(known.max(initial=0.0)))

    @property
    def called(self) -> str:
        """How messages call the time column."""
        assert self.column is not None
        return f"{self.name}: the time {self.column.label}"

    def steps(
        self, time: FloatArray | None, before: float | None
    ) -> float | FloatArray | None:
        """Return the seconds since the sample before for each row of a block: a number where they are even.

        Parameters
        ----------
        time
            The times of the block.
        before
            The time of the row before it; None at the start of the log.
        """
        if time is None or not len(time):
            return None
        if self.kind == "rate" and self.rate is not None:
            contiguous = (
                len(time) < 2 or time[-1] - time[0] < (len(time) - 0.5) / self.rate
            )
            late = before is not None and time[0] - before > 1.5 / self.rate
            if contiguous and not late:
                self.step = 1.0 / self.rate
                return self.step
        steps = np.diff(time, prepend=time[0] if before is None else before)
        if before is None and len(steps) > 1:
            steps[0] = steps[1]
        fresh = steps if before is not None else steps[1:]
        if not len(fresh):
            return steps if self.step is None else self.step
        if not self.uneven:
            self.step = self._even_step(fresh, time)
            self.uneven = self.step is None
        return steps if self.step is None else self.step

    def _even_step(self, steps: FloatArray, time: FloatArray) -> float | None:
        """Return the one step of rows that are even to rounding; None where they are not."""
        mean = float(steps.mean())
        rounding = 4.0 * np.spacing(abs(time).max()) + self._resolution(time)
        if mean <= 0.0 or np.abs(steps - mean).max() > _EVEN * mean + rounding:
            return None
        step = mean if self.step is None else self.step
        return step if abs(mean - step) <= _EVEN * step + rounding else None

    def _resolution(self, time: FloatArray) -> float:
        """Return the last decimal place of the times, where it is a small part of a step."""
        if not self.digits and len(time) > 2:
            span = time[: min(len(time), 50)]
            for power in range(1, 13):
                rounded = np.round(span, power)
                if np.abs(span - rounded).max() < 10.0 ** (
                    -power - 3
                ) + 4.0 * np.spacing(span.max()):
                    self.digits = 10.0**-power
                    break
        usual = self.usual_step or (1.0 / self.rate if self.rate else 0.0)
        return 1.01 * self.digits if self.digits < 0.05 * usual else 0.0

    def _require_seconds(self) -> None:
        """Refuse figures without a unit that can hardly be seconds."""
        if self.kind != "column" or self.unit is not None:
            return
        step, reach = self.usual_step, max(abs(self.first), abs(self.last))
        is_epoch = _EPOCH[0] < self.first < _EPOCH[1]
        if step >= _LONG_STEP:
            odd = f"its usual step would be {step:.6g} s"
        elif reach > _LATEST and not is_epoch:
            odd = f"its stamps would reach {self.last:.6g} s"
        else:
            return
        self._refuse_bare(odd)

    def _refuse_bare(self, odd: str) -> None:
        raise InputError(
            f"{self.called} has no unit: read as seconds, {odd} (`time_unit` s, ms, us or ns says what it "
            "counts; `sample_rate` HZ gives the time instead)"
        )

    def close(self) -> None:
        """Say what is doubtful once all rows went by.

        Raises
        ------
        InputError
            Figures without a unit end before any piezo has moved.
        """
        if self.kind not in ("column", "stamps") or self.rows < 2:
            return
        if 2 * self.repeats > self.rows:
            warn(
                f"{self.called} repeats its stamps in {self.repeats:,} of {self.rows:,} rows: they have too "
                "few digits (`sample_rate` HZ gives the time instead)"
            )
        elif self.repeats:
            s = " is" if self.repeats == 1 else "s are"
            warn(f"{self.name}: {self.repeats:,} time stamp{s} repeated")
        if self.gaps and 2 * self.repeats <= self.rows:
            s = "" if self.gaps == 1 else "s"
            warn(
                f"{self.name}: {self.gaps:,} gap{s} in time, the first before row {self.first_gap:,}, the "
                f"largest {self.largest_gap:.4g} s"
            )
        if self.kind == "column" and not self.given:
            self._doubt_unit()

    def _doubt_unit(self) -> None:
        """Warn of a stated unit that can hardly be right; refuse seconds that nobody stated."""
        span, step = self.last - self.first, self.usual_step
        if 0.0 < span < _SHORTEST:
            odd = f"the whole log would last {span:.3g} s"
            if self.unit is None:
                self._refuse_bare(odd)
        elif step > _LONGEST_STEP:
            odd = f"its usual step would be {step:.3g} s"
        elif self.unit == "s" and step >= _LONG_STEP and span >= _LONG_LOG:
            odd = f"its usual step would be {step:.6g} s, and the log {span / 3600.0:.3g} h long"
        else:
            return
        warn(
            f"{self.called} is stated in {self.unit}, but {odd} (`time_unit` {self.unit} if that is "
            "right, or what it counts: ms, us, ns)"
        )

    def describe(self) -> str:
        """Return how long a log lasts and at which rate: ``12 s at 2 kHz``."""
        if self.kind == "none" or self.rows < 1:
            return "no clock"
        if self.rows < 2:
            return "one time"
        step = self.step or (self.last - self.first) / (self.rows - 1)
        if step <= 0.0:
            return "no span of time"
        about = "" if self.step else "about "
        return f"{self.last - self.first + step:.4g} s at {about}{hertz(1.0 / step)}"


def hertz(rate: float) -> str:
    """Return a rate with its unit: ``2 kHz``."""
    for size, unit in ((1e6, "MHz"), (1e3, "kHz")):
        if rate >= size:
            return f"{rate / size:.5g} {unit}"
    return f"{rate:.5g} Hz"


def is_bad(array: NDArray[Any], column: Column) -> NDArray[np.bool_]:
    """Return which rows of a column hold no number or no stamp."""
    if column.kind == "stamp":
        return np.asarray(array == NOT_A_TIME)
    return np.asarray(~np.isfinite(array))
