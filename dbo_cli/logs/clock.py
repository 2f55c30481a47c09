"""The clock of a log: the time of every row in seconds, from a column, a stated rate, or none.

Gaps and repeated stamps are warned of. Time that goes back is refused, and so are figures
without a unit that can hardly be seconds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import InputError, warn
from dbo_cli.logs.source import Column, FloatArray
from dbo_cli.units import multiplied

_DAY = 86400 * 10**9  # ns
# s; without a unit, figures this far apart or more are hardly seconds
_LONG_STEP = 1.0
# s; without a unit, figures closer together than this are hardly seconds: days are
_SHORT_STEP = 1e-5
_SAME = 0.01  # of a step
_LONG_LOG = 3600.0  # s
_LATEST = 1e8  # s, three years; a clock that counts a run never gets there
_EPOCH = (1e9, 4.1e9)  # s since 1970: the years 2001 to 2100
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
    given
        Whether the user states it.
    rate, start
        Samples a second (Hz) and the time (s) of the first row, without a column.
    step, uneven
        Seconds between rows where they are even so far; whether they are not.
    rate_beside
        The rate (Hz) that the file states beside a time column.
    origin, first_stamp
        What time 0 is in seconds since 1970, where dates say it; the first stamp (ns).
    """

    name: str
    kind: str = "none"
    column: Column | None = None
    factor: Fraction = Fraction(1)
    unit: str | None = None
    given: bool = False
    rate: float | None = None
    start: float = 0.0
    rate_beside: float | None = None
    step: float | None = None
    uneven: bool = False
    origin: float | None = None
    first_stamp: int | None = None
    remarks: list[str] = field(default_factory=list)
    rows: int = 0
    first: float = 0.0
    last: float = 0.0
    usual_step: float = 0.0
    repeats: int = 0
    gaps: int = 0
    first_gap: int = 0
    largest_gap: float = 0.0

    def read(
        self, numbers: NDArray[np.int64], stored: NDArray[Any]
    ) -> tuple[FloatArray | None, float | FloatArray | None]:
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
        known = steps if self.rows else steps[1:]
        if not self.rows:
            self.first = float(time[0])
        if not self.rows and len(known):
            steps[0] = steps[1]
        if self.kind != "rate" and len(known):
            self._watch(known, time, numbers)
        self.rows += len(time)
        self.last = float(time[-1])
        if len(known) and not self.uneven:
            self.step = self._even_step(known, time)
            self.uneven = self.step is None
        return time, steps if self.step is None else self.step

    def _seconds(self, numbers: NDArray[np.int64], stored: NDArray[Any]) -> FloatArray:
        if self.kind == "rate":
            assert self.rate is not None
            return np.asarray(
                self.start + (numbers - 1.0) / self.rate, dtype=np.float64
            )
        if self.kind == "column":
            return np.asarray(multiplied(stored, self.factor))
        if self.first_stamp is None:
            self.first_stamp = int(stored[0])
            if self.first_stamp >= _DAY:
                self.origin = self.first_stamp / 1e9
        return np.asarray((stored - self.first_stamp) / 1e9)

    def _watch(
        self, steps: FloatArray, time: FloatArray, numbers: NDArray[np.int64]
    ) -> None:
        """Refuse a time that goes back; count repeats and gaps, and find the usual step."""
        numbers = numbers[len(numbers) - len(steps) :]
        if steps.min() < 0.0:
            at = int(np.argmax(steps < 0.0))
            after = float(time[at - len(steps)])
            raise InputError(
                f"{self.called}: row {numbers[at]}: time goes back from {after - steps[at]:.9g} to "
                f"{after:.9g} s: cut with `rows` A:B, or add `sample_rate` HZ"
            )
        if self.rows < 2:
            self.usual_step = float(np.sort(steps)[len(steps) // 2])
            self._require_seconds(float(time[-1]))
        self.repeats += int(np.count_nonzero(steps == 0.0))
        if self.usual_step > 0.0:
            gaps = steps > _GAP * self.usual_step
            if not self.gaps and gaps.any():
                self.first_gap = int(numbers[np.argmax(gaps)])
            self.gaps += int(np.count_nonzero(gaps))
            self.largest_gap = max(self.largest_gap, float(steps.max()))

    @property
    def called(self) -> str:
        """How messages call the time column."""
        assert self.column is not None
        return f"{self.name}: the time {self.column.label}"

    def _even_step(self, steps: FloatArray, time: FloatArray) -> float | None:
        """Return the one step of rows that are even to rounding; None where they are not."""
        if self.rate is not None:
            is_whole = steps.max() < _GAP / self.rate
            return 1.0 / self.rate if is_whole else None
        mean = float(steps.mean())
        rounding = 4.0 * np.spacing(np.abs(time).max()) + self._resolution(time)
        if mean <= 0.0 or np.abs(steps - mean).max() > _EVEN * mean + rounding:
            return None
        step = mean if self.step is None else self.step
        return step if abs(mean - step) <= _EVEN * step + rounding else None

    def _resolution(self, time: FloatArray) -> float:
        """Return the last decimal place of the times, where it is a small part of a step."""
        times = time[:50]
        for places in range(1, 13):
            place = 10.0**-places
            off = np.abs(times - np.round(times, places)).max()
            if off < 1e-3 * place + 4.0 * np.spacing(np.abs(times).max()):
                return 1.01 * place if place < 0.05 * self.usual_step else 0.0
        return 0.0

    def _require_seconds(self, reach: float) -> None:
        """Refuse figures without a unit that can hardly be seconds."""
        if self.kind != "column" or self.unit is not None:
            return
        is_epoch = _EPOCH[0] < self.first < _EPOCH[1]
        beside = self.usual_step * (self.rate_beside or 0.0)
        thousands = round(math.log10(beside) / 3.0) if beside else 0
        if thousands and abs(beside / 1e3**thousands - 1.0) < _SAME:
            odd = f"its steps contradict the stated rate by a factor of 1e{3 * abs(thousands)}"
        elif self.usual_step >= _LONG_STEP or 0.0 < self.usual_step < _SHORT_STEP:
            odd = f"its usual step would be {self.usual_step:.4g} s"
        elif reach > _LATEST and not is_epoch:
            odd = f"its stamps would reach {reach:.6g} s"
        else:
            return
        raise InputError(
            f"{self.called} has no unit: in seconds, {odd}: add `time_unit` s, ms, us, ns or d, or "
            "`sample_rate` HZ"
        )

    def close(self) -> None:
        """Warn of what is doubtful once all rows are read."""
        if self.repeats:
            warn(
                f"{self.name}: {self.repeats:,} of {self.rows:,} time stamps repeat: `sample_rate` HZ "
                "replaces them"
            )
        if self.gaps:
            s = "" if self.gaps == 1 else "s"
            warn(
                f"{self.name}: {self.gaps:,} gap{s} in time, first before row {self.first_gap:,}, largest "
                f"{self.largest_gap:.4g} s"
            )
        hours = (self.last - self.first) / 3600.0
        is_slow = self.usual_step >= _LONG_STEP and 3600.0 * hours >= _LONG_LOG
        if self.kind == "column" and self.unit == "s" and not self.given and is_slow:
            warn(
                f"{self.called} in s makes steps of {self.usual_step:.6g} s and a log of {hours:.3g} h: "
                "confirm with `time_unit` s, or type ms or us"
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
        text = f"{self.last - self.first + step:.4g} s at {about}{hertz(1.0 / step)}"
        is_assumed = self.kind == "column" and self.unit is None
        if is_assumed or any("assumed" in remark for remark in self.remarks):
            text += " (no unit stated)"
        return text


def hertz(rate: float) -> str:
    """Return a rate with its unit: ``2 kHz``."""
    for size, unit in ((1e6, "MHz"), (1e3, "kHz")):
        if rate >= size:
            return f"{rate / size:.5g} {unit}"
    return f"{rate:.5g} Hz"
