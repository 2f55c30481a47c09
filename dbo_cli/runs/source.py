"""Where a run takes its samples from: a log, or arrays that look like one."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from dbo_cli.errors import InputError, UsageError
from dbo_cli.logs.clock import TimeCheck, require_even
from dbo_cli.logs.columns import column_info
from dbo_cli.logs.sample_block import ColumnInfo, FloatArray, SampleBlock, joined
from dbo_cli.logs.units import match_units
from dbo_cli.runs.remarks import Remarks


class Source(Protocol):
    """What a run needs of a log; ``logs.signal_log.SignalLog`` is one."""

    name: str
    columns: dict[str, ColumnInfo]
    notes: list[str]
    warnings: list[str]

    @property
    def has_time(self) -> bool:
        """Whether samples carry a time."""

    @property
    def even_rate(self) -> float | None:
        """Samples a second (Hz) where they are evenly spaced by definition, else None."""

    @property
    def stated_rate(self) -> float | None:
        """Samples a second (Hz) as it was given, rows that were dropped aside, or None."""

    def require_time(self, why: str) -> None:
        """Refuse a source without time (InputError)."""

    def convert(self, role: str, wanted: str | None, taker: str) -> None:
        """Hand a role's samples out in another unit from now on, and say so (or InputError)."""

    def reading_line(self) -> str | None:
        """Say what was read, once it was; None where nothing was."""

    def blocks(self) -> Iterator[SampleBlock]:
        """Return the samples in blocks, by role."""


def remarks_of(source: Source) -> Remarks:
    """Return what is to be said of a source that was read."""
    line = source.reading_line()
    return Remarks(list(source.notes), list(source.warnings), [] if line is None else [line])


def samples(name: str, values: ArrayLike) -> FloatArray:
    """Return a signal as float64 of shape (samples,).

    Raises
    ------
    InputError
        It has another shape, no samples, or one that is not a finite number.
    """
    try:
        given = np.asarray(values)
        if np.iscomplexobj(given):
            raise TypeError
        signal = np.ascontiguousarray(given, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"`{name}`: is no array of numbers") from None
    if signal.ndim == 0 or signal.size == 0:
        raise InputError(f"`{name}`: holds no samples")
    if signal.ndim > 1:
        raise InputError(f"`{name}`: has the shape {signal.shape}; give one dimension")
    good = np.isfinite(signal)
    if not good.all():
        row = int(np.argmin(good))
        raise InputError(f"`{name}`: sample {row + 1} is not finite: {float(signal[row])!r} (leave it out)")
    return signal


class ArraySource:
    """Arrays as a source: one block.

    Parameters
    ----------
    values : mapping of str to array_like
        Role to signal; all of one length.
    time : array_like, optional
        Seconds, of the same length.
    sample_rate : float, optional
        Samples a second (Hz) where ``time`` is not given.
    columns : mapping, optional
        What is known of each role's column.
    name : str
        How messages call the arrays.

    Raises
    ------
    InputError
        A signal is no array of finite numbers, or the lengths differ.
    UsageError
        Both a time and a rate are given, or the rate is none.
    """

    def __init__(
        self,
        values: Mapping[str, ArrayLike],
        time: ArrayLike | None = None,
        sample_rate: float | None = None,
        columns: Mapping[str, ColumnInfo] | None = None,
        name: str = "the arrays",
    ) -> None:
        if time is not None and sample_rate is not None:
            raise UsageError("`time` and `sample_rate` exclude each other: give the one or the other")
        if sample_rate is not None and not 0.0 < sample_rate < float("inf"):
            raise UsageError(f"`sample_rate` {sample_rate:g}: give a positive number of samples a second")
        self.name = name
        self.notes: list[str] = []
        self.warnings: list[str] = []
        self.clock_was_judged = False
        self.values = {role: samples(role, signal) for role, signal in values.items()}
        self.time = None if time is None else samples("time", time)
        first, count = next((role, signal.size) for role, signal in self.values.items())
        for role, signal in [*self.values.items(), *([] if self.time is None else [("time", self.time)])]:
            if signal.size != count:
                raise InputError(f"`{role}` has {signal.size} samples where `{first}` has {count}")
        self.columns = dict(columns or {role: column_info(role, n + 1) for n, role in enumerate(values)})
        self.sample_rate = sample_rate

    @property
    def has_time(self) -> bool:
        """Whether samples carry a time."""
        return self.time is not None or self.sample_rate is not None

    @property
    def even_rate(self) -> float | None:
        """Samples a second (Hz), or None where stamps tell the time."""
        return self.sample_rate

    @property
    def stated_rate(self) -> float | None:
        """Samples a second (Hz), or None where stamps tell the time."""
        return self.sample_rate

    def require_time(self, why: str) -> None:
        """Refuse arrays without time (InputError)."""
        if not self.has_time:
            raise InputError(f"{self.name}: no time is given, and {why} (`time` or `sample_rate` HZ)")

    def convert(self, role: str, wanted: str | None, taker: str) -> None:
        """Hand a role's samples out in another unit; arrays of an unknown unit are taken as they are."""
        column = self.columns[role]
        if column.unit is None or wanted is None:
            return
        match = match_units(self.name, column, wanted, taker)
        self.notes.extend([match.note] if match.note else [])
        self.values[role] = match.factor.apply(self.values[role])
        self.columns[role] = dataclasses.replace(column, unit=wanted)

    def reading_line(self) -> None:
        """Return nothing: arrays were not read from anywhere."""

    def blocks(self) -> Iterator[SampleBlock]:
        """Return all samples as one block."""
        count = next(iter(self.values.values())).size
        time = self.time
        if time is None and self.sample_rate is not None:
            time = np.arange(count) / self.sample_rate
        rows = range(1, count + 1)
        if self.time is not None:
            check = TimeCheck(self.name, has_lines=False)
            check.feed(self.time, rows, None)
            self.notes.extend(check.notes())
            if check.repeat.count and not self.clock_was_judged:
                self.warnings.append(
                    f"{self.name}: `time` repeats its stamps in {check.repeat.count:,} of {count:,} samples:"
                    " too few digits for the rate (`sample_rate` HZ gives the time instead)"
                )
        yield SampleBlock(rows, None, time, self.values)


class WholeSource:
    """Another source read whole: one block, which may be exchanged for what was made of it."""

    def __init__(self, source: Source) -> None:
        self.name, self.columns = source.name, source.columns
        self._source = source
        self.block = joined(list(source.blocks()))
        self.notes, self.warnings = source.notes, source.warnings

    @property
    def has_time(self) -> bool:
        """Whether samples carry a time."""
        return self._source.has_time

    @property
    def even_rate(self) -> float | None:
        """Samples a second (Hz), or None where stamps tell the time."""
        return self._source.even_rate

    @property
    def stated_rate(self) -> float | None:
        """Samples a second (Hz) as it was given, or None."""
        return self._source.stated_rate

    def require_time(self, why: str) -> None:
        """Refuse a source without time (InputError)."""
        self._source.require_time(why)

    def convert(self, role: str, wanted: str | None, taker: str) -> None:
        """Hand a role's samples out in another unit from now on, and say so (or InputError)."""
        column = self.columns[role]
        if column.unit is None or wanted is None:
            return
        match = match_units(self.name, column, wanted, taker)
        self.notes.extend([match.note] if match.note else [])
        changed = {role: match.factor.apply(self.block.values[role])}
        self.block = dataclasses.replace(self.block, values=dict(self.block.values) | changed)
        self.columns[role] = dataclasses.replace(column, unit=wanted)

    def reading_line(self) -> str | None:
        """Say what was read."""
        return self._source.reading_line()

    def even_step(self, why: str) -> float:
        """Return the even time step (s), or refuse with the remedy (InputError)."""
        if self.even_rate is not None:
            return 1.0 / self.even_rate
        self.require_time(why)
        assert self.block.time is not None
        return require_even(self.name, self.block.time, why)

    def blocks(self) -> Iterator[SampleBlock]:
        """Return the one block."""
        yield self.block
