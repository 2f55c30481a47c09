"""The rows of one file: bad ones refused or left out, times in seconds, values in the units asked for."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import InputError, UsageError
from dbo_cli.logs.clock import Clock, is_bad
from dbo_cli.logs.source import Block, Column, Source
from dbo_cli.units import multiplied, ratio, spell

_SCALE = re.compile(
    r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(?:([^\s/\d.][^\s/]*)\s*/\s*([^\s/]+))?\s*",
    re.ASCII,
)


@dataclass(frozen=True)
class Scale:
    """By what the figures of a column are multiplied, and the unit that they then have."""

    factor: Fraction = Fraction(1)
    unit: str | None = None


@dataclass
class Rows:
    """The rows of one file as blocks by role.

    ``doubtful`` holds the remarks about rows that were left out, cut or guessed.
    """

    source: Source
    clock: Clock
    picks: Mapping[str, Column]
    scales: Mapping[str, Scale]
    rows: tuple[int, int | None]
    skip_bad: bool
    dropped: int = 0
    first_dropped: str = ""
    doubtful: list[str] = field(default_factory=list)

    def blocks(self) -> Iterator[Block]:
        """Read the file once."""
        stamped = self.clock.kind in ("column", "stamps")
        chosen = list(self.picks.values())
        if stamped and self.clock.column is not None:
            chosen.append(self.clock.column)
        first, last = self.rows
        row, kept, told = 1, 0, len(self.source.remarks)
        before: float | None = None
        for arrays in self.source.blocks(chosen):
            count = len(arrays[0])
            part = slice(
                max(0, first - row), None if last is None else max(0, last - row + 1)
            )
            numbers = np.arange(row, row + count)[part]
            good = self._good(numbers, chosen, [array[part] for array in arrays])
            row += count
            if good is not None:
                block = self._block(numbers[good[0]], good[1], stamped, before)
                kept += len(block)
                if block.time is not None:
                    before = float(block.time[-1])
                yield block
            if last is not None and row > last:
                break
        self.doubtful += self.source.remarks[told:]
        self._finish(kept, row)

    def _good(
        self,
        numbers: NDArray[np.int64],
        chosen: Sequence[Column],
        arrays: list[NDArray[Any]],
    ) -> tuple[Any, list[NDArray[Any]]] | None:
        """Return which rows hold numbers, and their arrays; None where none does."""
        bad = np.zeros(len(numbers), dtype=bool)
        for column, array in zip(chosen, arrays, strict=True):
            bad |= is_bad(array, column)
        if not bad.any():
            return (slice(None), arrays) if len(numbers) else None
        at = int(np.argmax(bad))
        place = ""
        for column, array in zip(chosen, arrays, strict=True):
            if not place and is_bad(array[at : at + 1], column)[0]:
                place = self.source.where(int(numbers[at]), column)
        if not self.skip_bad:
            others = int(np.count_nonzero(bad)) - 1
            more = f", and {others:,} more such rows near it" if others else ""
            raise InputError(f"{place}{more} (`skip_bad` leaves such rows out)")
        self.first_dropped = self.first_dropped or place
        self.dropped += int(np.count_nonzero(bad))
        if bad.all():
            return None
        return ~bad, [array[~bad] for array in arrays]

    def _block(
        self,
        numbers: NDArray[np.int64],
        arrays: list[NDArray[Any]],
        stamped: bool,
        before: float | None,
    ) -> Block:
        """Turn arrays into a block: times in seconds, values in the units asked for."""
        time = self.clock.times(numbers, arrays[-1] if stamped else None)
        values = {}
        for role, array in zip(self.picks, arrays, strict=False):
            values[role] = multiplied(array, self.scales[role].factor)
        return Block(time, values, int(numbers[0]), self.clock.steps(time, before))

    def _finish(self, kept: int, row: int) -> None:
        """Tell what was skipped, and refuse a log without a row."""
        if self.dropped:
            s = "" if self.dropped == 1 else "s"
            text = f"{self.dropped:,} row{s} left out, the first: {self.first_dropped}"
            self.source.remarks.append(text)
            self.doubtful.append(text)
        if not kept and self.rows[0] >= row > 1:
            raise InputError(
                f"{self.source.name}: `rows` {self.rows[0]}: the log has {row - 1:,} data rows"
            )
        if not kept:
            raise InputError(f"{self.source.name}: no good data row")
        self.clock.close()
        self.source.remarks += self.clock.doubtful + self.clock.remarks
        self.doubtful += self.clock.doubtful


def parse_rows(rows: str | tuple[int, int | None] | None) -> tuple[int, int | None]:
    """Read ``rows``: the first and the last data row, counted from 1; either may be left out.

    Raises
    ------
    UsageError
        It is no range.
    """
    if rows is None:
        return 1, None
    if isinstance(rows, str):
        match = re.fullmatch(r"\s*(\d{0,15})\s*:\s*(\d{0,15})\s*", rows, re.ASCII)
        if match is None:
            raise UsageError(
                f"`rows` {rows}: give A:B, data rows counted from 1, both ends included"
            )
        first = int(match[1] or 1)
        last = int(match[2]) if match[2] else None
    else:
        first, last = rows
    if first < 1 or (last is not None and last < first):
        raise UsageError(
            f"`rows` {first}:{last}: rows are counted from 1, and the last is not before the first"
        )
    return first, last


def parse_scale(text: str) -> tuple[str, str]:
    """Read ``ROLE=FACTOR`` or ``ROLE=FACTORUNIT/UNIT``.

    Raises
    ------
    UsageError
        It is not of that form.
    """
    role, sign, factor = text.partition("=")
    if not sign or not role.strip() or _SCALE.fullmatch(factor) is None:
        raise UsageError(
            f"`scale` {text}: give ROLE=FACTOR or ROLE=FACTORUNIT/UNIT, such as voltage=20 or "
            "displacement=10um/V"
        )
    return role.strip().lower(), factor.strip()


def scales_of(
    name: str,
    picks: Mapping[str, Column],
    wishes: Mapping[str, str | float],
    units: Mapping[str, str],
    remarks: list[str],
) -> dict[str, Scale]:
    """Return the scale of every role: what the user gives, then the unit that is wanted.

    Raises
    ------
    InputError
        A unit cannot be converted.
    UsageError
        A scale is given for a role that is not there.
    """
    for role in wishes:
        if role not in picks:
            raise UsageError(f"`scale` {role}=...: give one of {', '.join(picks)}")
    scales = {}
    for role, column in picks.items():
        factor, unit = Fraction(1), column.unit
        if role in wishes:
            factor, unit = _wished(name, role, column, str(wishes[role]))
        wanted = units.get(role)
        if wanted is not None and unit is None:
            remarks.append(f"{column.label} has no unit: {wanted} is assumed")
        if wanted is not None:
            try:
                factor *= ratio(unit, wanted)
            except InputError:
                raise InputError(
                    f"{name}: {column.label} is in {unit}, and {wanted} is needed (`scale` "
                    f"{role}=FACTOR{wanted}/{unit})"
                ) from None
            unit = spell(wanted)
        scales[role] = Scale(factor, unit)
    return scales


def _wished(
    name: str, role: str, column: Column, text: str
) -> tuple[Fraction, str | None]:
    """Return the factor of a scale and the unit after it."""
    match = _SCALE.fullmatch(text)
    if match is None or float(match[1]) == 0.0 or not abs(float(match[1])) < 1e250:
        raise UsageError(
            f"`scale` {role}={text}: give a factor that is not 0, or one with units such as 10um/V"
        )
    factor = Fraction(match[1])
    if match[2] is None:
        return factor, column.unit
    try:
        factor *= ratio(column.unit, match[3])
    except InputError:
        raise InputError(
            f"{name}: {column.label} is in {column.unit}, but `scale` {role}={text} takes {match[3]}"
        ) from None
    return factor, spell(match[2])
