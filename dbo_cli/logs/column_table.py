"""A log as a list of columns that can be sliced: what every format but text comes down to.

A reader of a format finds the columns, their units, scales and the clock; everything a user meets afterwards
(blocks, bad values, unequal lengths, conflicting rates) is here, once.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dbo_cli.errors import DboError, InputError
from dbo_cli.logs.columns import column_info, column_label
from dbo_cli.logs.reading_options import SKIP_REMEDY, Rows
from dbo_cli.logs.sample_block import ColumnInfo, FloatArray, SampleBlock, are_measured, dropped_note
from dbo_cli.logs.stated_clock import Statement, agreed_rate

Fetch = Callable[[int, int], Any]
"""Gives the stored values of rows start..stop (from 0, stop not included)."""

GAVE_UP = "the library that reads it gave up"


@dataclass(frozen=True)
class ColumnSource:
    """One column of a file, and how its stored values become numbers.

    Attributes
    ----------
    label
        The column's name; a path (``run/voltage``) where groups are mixed.
    length
        The number of rows.
    fetch
        Reads stored values.
    unit
        As the file gives it, or None.
    scale, offset
        The value is stored · scale + offset (netCDF's ``scale_factor`` and ``add_offset``).
    missing
        Stored values that stand for "no value" (netCDF's ``_FillValue``).
    clock
        What the file states of this column's own sample rate.
    start
        The time (s) of the first row, as far as the file states it.
    remarks
        Notes for the user where this column is used.
    problem
        Why this column cannot be used, or an empty text.
    """

    label: str
    length: int
    fetch: Fetch
    unit: str | None = None
    scale: float = 1.0
    offset: float = 0.0
    missing: tuple[float, ...] = ()
    clock: tuple[Statement, ...] = ()
    start: float = 0.0
    remarks: tuple[str, ...] = ()
    problem: str = ""

    def read(self, start: int, stop: int) -> FloatArray:
        """Read rows start..stop (from 0, stop not included) as float64; what is missing as NaN."""
        stored = np.asarray(self.fetch(start, stop))
        values = np.ascontiguousarray(stored, dtype=np.float64)
        if self.missing:
            absent = np.logical_or.reduce([stored == one for one in self.missing])
            if absent.any():
                values = np.where(absent, np.nan, values)
        if self.scale != 1.0:
            values = values * self.scale
        return values + self.offset if self.offset != 0.0 else values


def array_source(label: str, values: Any, unit: str | None = None) -> ColumnSource:
    """Make a column of an array in memory (or mapped into it)."""
    return ColumnSource(label, len(values), lambda start, stop: values[start:stop], unit)


class ColumnTable:
    """A log made of columns; fulfils the protocol of ``signal_log.Table``.

    Parameters
    ----------
    place
        How messages call the log.
    kind
        What kind of file it is, as messages call it (``HDF5``).
    sources
        The columns.
    clock
        What the file states of its sample rate as a whole.
    start
        The time (s) of the first row.
    where
        Where in the file the columns are (`` in /run1``), for ``describe``.
    close
        Called once the log is no longer needed.
    damaged
        The errors that the format's library raises for a damaged file while it is read.
    """

    def __init__(
        self,
        place: str,
        kind: str,
        sources: Sequence[ColumnSource],
        *,
        clock: Sequence[Statement] = (),
        start: float = 0.0,
        where: str = "",
        close: Callable[[], object] | None = None,
        damaged: tuple[type[Exception], ...] = (OSError, RuntimeError, TypeError, ValueError),
    ) -> None:
        self.place = place
        self.notes: list[str] = []
        self._kind = kind
        self._where = where
        self._sources = list(sources)
        self._clock = tuple(clock)
        self._start = start
        self._close = close
        self._damaged = damaged
        self.columns = [describe_column(source, number) for number, source in enumerate(sources, start=1)]

    def describe(self) -> str:
        """Describe in one line how the log is written, for ``verbose``."""
        plural = "s" if len(self._sources) != 1 else ""
        stated = [one for one in self._clock if one.rate]
        rate = f", {stated[0].rate:g} samples a second" if stated else ""
        return f"{self.place}: {self._kind}, {len(self._sources)} column{plural}{self._where}{rate}"

    def even_clock(self, columns: Collection[ColumnInfo]) -> tuple[float | None, float]:
        """Return the sample rate (Hz) that the file states for these columns, and the first row's time (s).

        Raises
        ------
        InputError
            The rate cannot be read, or the columns are sampled at different rates.
        """
        picked = [self._sources[column.number - 1] for column in columns]
        own = [one for source in picked for one in source.clock]
        # What a column states of itself goes before what the file states as a whole.
        rate = agreed_rate(self.place, own or self._clock, self.notes)
        starts = {source.start for source in picked}
        if len(starts) > 1:
            listed = ", ".join(f"'{source.label}' at {source.start:g} s" for source in picked)
            raise InputError(
                f"{self.place}: the columns do not start at the same time: {listed} "
                "(`sample_rate` HZ takes them row by row)"
            )
        return rate, starts.pop() or self._start if starts else self._start

    def blocks(
        self, picks: Mapping[str, ColumnInfo], rows: Rows, skip_bad: bool, block_rows: int
    ) -> Iterator[SampleBlock]:
        """Read the wanted columns in blocks of ``block_rows`` rows.

        Raises
        ------
        InputError
            The columns are of unequal length, or a value is not finite (unless ``skip_bad``).
        """
        sources = [self._sources[pick.number - 1] for pick in picks.values()]
        for source in sources:
            if source.problem:
                raise InputError(f"{self.place}: {source.problem}")
            self.notes.extend(f"{self.place}: {remark}" for remark in source.remarks)
        length = self._common_length(sources)
        end = length if rows[1] is None else min(length, rows[1])
        dropped, first = 0, ""
        for start in range(rows[0] - 1, end, block_rows):
            block = self._block(list(picks), sources, start, min(end, start + block_rows))
            good = np.logical_and.reduce([are_measured(array) for array in block.values.values()])
            if not good.all():
                message = self._complaint(picks, block, int(np.flatnonzero(~good)[0]))
                if not skip_bad:
                    raise InputError(f"{message} {SKIP_REMEDY}")
                dropped, first = dropped + int((~good).sum()), first or message
                kept = {role: array[good] for role, array in block.values.items()}
                block = SampleBlock(np.asarray(block.rows)[good], None, None, kept)
            yield block
        if dropped:
            self.notes.append(dropped_note(first, dropped))

    def close(self) -> None:
        """Close the file."""
        if self._close is not None:
            self._close()

    @property
    def sha256(self) -> str | None:
        """None: such a file is always there to be hashed as a whole."""
        return None

    def _block(self, roles: list[str], sources: list[ColumnSource], start: int, stop: int) -> SampleBlock:
        try:
            arrays = {role: source.read(start, stop) for role, source in zip(roles, sources, strict=True)}
        except DboError:
            raise
        except self._damaged as problem:
            raise InputError(f"{self.place}: damaged {self._kind}: {brief(problem)}") from None
        return SampleBlock(range(start + 1, stop + 1), None, None, arrays)

    def _common_length(self, sources: Sequence[ColumnSource]) -> int:
        lengths = [source.length for source in sources]
        if len(set(lengths)) > 1:
            listed = ", ".join(f"'{s.label}' {n}" for s, n in zip(sources, lengths, strict=True))
            raise InputError(f"{self.place}: the columns are of unequal length: {listed}")
        return lengths[0]

    def _complaint(self, picks: Mapping[str, ColumnInfo], block: SampleBlock, index: int) -> str:
        for role, pick in picks.items():
            array = block.values[role]
            if not are_measured(array[index : index + 1])[0]:
                value = repr(str(float(array[index])))
                return f"{self.place}: row {block.rows[index]}: {column_label(pick)} is not finite: {value}"
        raise AssertionError("a row without a bad value was complained about")


def describe_column(source: ColumnSource, number: int) -> ColumnInfo:
    """Describe a column by the last part of its label and the unit that the file gives."""
    return replace(column_info(source.label.rsplit("/", 1)[-1], number, source.unit), name=source.label)


def brief(problem: BaseException) -> str:
    """Keep the reason in brackets of a library's message, or its first line."""
    if type(problem).__name__ == "PanicException":  # describes the library's own lines
        return GAVE_UP
    text = str(problem).strip("'\"").splitlines()[0] if str(problem) else type(problem).__name__
    return text[text.find("(") + 1 : text.rfind(")")] if "(" in text and text.endswith(")") else text
