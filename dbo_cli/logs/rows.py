"""The rows of one file: bad ones refused or left out, times in seconds, values in the units asked for."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import InputError, UsageError
from dbo_cli.logs.clock import Clock
from dbo_cli.logs.source import NOT_A_TIME, Block, Column, Source
from dbo_cli.units import multiplied, parse_unit, ratio, spell, units_in

_SCALE = re.compile(
    r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(?:([^\s/\d.][^\s/]*)\s*/\s*([^\s/]+))?\s*",
    re.ASCII,
)

_OVERLOAD = 9.9e30  # instruments write 9.9E37 and 1E+31 for what they could not measure


@dataclass(frozen=True)
class Scale:
    """By what the figures of a column are multiplied, and the unit that they then have."""

    factor: Fraction = Fraction(1)
    unit: str | None = None


class Rows:
    """The rows of one file as blocks by role.

    ``doubtful`` holds the remarks about rows that were left out or cut.
    """

    def __init__(
        self,
        source: Source,
        clock: Clock,
        picks: Mapping[str, Column],
        scales: Mapping[str, Scale],
        rows: tuple[int, int | None],
        skip_bad: bool,
    ) -> None:
        self.source = source
        self.clock = clock
        self.picks = picks
        self.scales = scales
        self.first, self.last = rows
        self.skip_bad = skip_bad
        self.doubtful: list[str] = []
        self._dropped = 0
        self._first_dropped = ""

    def blocks(self) -> Iterator[Block]:
        """Read the file once.

        Raises
        ------
        InputError
            A row holds no number, time goes back, or there is no row.
        """
        chosen = list(self.picks.values())
        if self.clock.kind in ("column", "stamps") and self.clock.column is not None:
            chosen.append(self.clock.column)
        noted = len(self.source.remarks)
        row, count = 1, 0
        for arrays in self.source.blocks(chosen):
            start = max(0, self.first - row)
            stop = None if self.last is None else self.last - row + 1
            numbers = np.arange(row, row + len(arrays[0]))[start:stop]
            row += len(arrays[0])
            arrays = [array[start:stop] for array in arrays]
            good = self._good(numbers, chosen, arrays)
            if good is not None:
                numbers = numbers[good]
                arrays = [array[good] for array in arrays]
            if len(numbers):
                count += len(numbers)
                yield self._block(numbers, arrays)
            if self.last is not None and row > self.last:
                break
        self.doubtful += self.source.remarks[noted:]
        if self._dropped:
            s = "" if self._dropped == 1 else "s"
            text = (
                f"{self._dropped:,} row{s} left out, the first: {self._first_dropped}"
            )
            self.source.remarks.append(text)
            self.doubtful.append(text)
        if not count:
            self._refuse_nothing(row - 1)
        self.clock.close()
        self.source.remarks += self.clock.remarks

    def _good(
        self,
        numbers: NDArray[np.int64],
        chosen: Sequence[Column],
        arrays: Sequence[NDArray[Any]],
    ) -> NDArray[np.bool_] | None:
        """Return which rows hold numbers; None where all do."""
        bad = [
            _is_bad(array, column) for array, column in zip(arrays, chosen, strict=True)
        ]
        any_bad = np.logical_or.reduce(bad)
        if not any_bad.any():
            return None
        at = int(np.argmax(any_bad))
        column = chosen[int(np.argmax([marks[at] for marks in bad]))]
        place = self.source.where(int(numbers[at]), column)
        if not self.skip_bad:
            rest = int(np.count_nonzero(any_bad)) - 1
            more = f", and {rest:,} more such rows near it" if rest else ""
            raise InputError(f"{place}{more} (`skip_bad` drops such rows)")
        self._first_dropped = self._first_dropped or place
        self._dropped += int(np.count_nonzero(any_bad))
        return np.asarray(~any_bad)

    def _block(
        self, numbers: NDArray[np.int64], arrays: Sequence[NDArray[Any]]
    ) -> Block:
        """Turn arrays into a block: times in seconds, values in the units asked for."""
        time, dt = self.clock.read(numbers, arrays[-1])
        values = {}
        for role, array in zip(self.picks, arrays, strict=False):
            values[role] = multiplied(array, self.scales[role].factor)
        return Block(time, values, int(numbers[0]), dt)

    def _refuse_nothing(self, rows: int) -> None:
        if self.first > rows > 0:
            raise InputError(
                f"{self.source.name}: `rows` {self.first}: the log has {rows:,} data rows"
            )
        raise InputError(f"{self.source.name}: no row holds only numbers")


def _is_bad(array: NDArray[Any], column: Column) -> NDArray[np.bool_]:
    """Return which rows of a column hold no number or no stamp."""
    if column.kind == "stamp":
        return np.asarray(array == NOT_A_TIME)
    return np.asarray(~(np.abs(array) < _OVERLOAD))


def parse_rows(rows: str | None) -> tuple[int, int | None]:
    """Read ``rows``: the first and the last data row, counted from 1; either may be left out.

    Raises
    ------
    UsageError
        It is no range.
    """
    match = re.fullmatch(r"\s*(\d{0,15})\s*:\s*(\d{0,15})\s*", rows or ":", re.ASCII)
    if match is None:
        raise UsageError(
            f"`rows` {rows}: give A:B, data rows counted from 1, both ends included"
        )
    first = int(match[1] or 1)
    last = int(match[2]) if match[2] else None
    if first < 1 or (last is not None and last < first):
        raise UsageError(f"`rows` {rows}: give A:B with 1 <= A <= B")
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
            f"`scale` {text}: give ROLE=FACTOR, such as voltage=20 or displacement=10um/V"
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
        if role not in wishes:
            _refuse_unclear_unit(name, role, column)
        else:
            factor, unit = _wished(name, role, column, str(wishes[role]))
        wanted = units.get(role)
        if wanted is not None and unit is None:
            remarks.append(f"{column.label} has no unit: {wanted} assumed")
        if wanted is not None:
            try:
                factor *= ratio(unit, wanted)
            except InputError:
                raise InputError(
                    f"{name}: {column.label} is in {unit}, not {wanted}: add `scale` "
                    f"{role}=FACTOR{wanted}/{unit}"
                ) from None
            unit = spell(wanted)
        scales[role] = Scale(factor, unit)
    return scales


def _refuse_unclear_unit(name: str, role: str, column: Column) -> None:
    """Refuse a unit whose capitals are those of the name (``VOLTAGE (MV)``), and several units."""
    unit = column.unit or ""
    stated = sorted(units_in(column.name)) if parse_unit(unit) is None else []
    if unit.startswith("M") and unit.lower() in ("mv", "mm"):
        stated = [f"m{unit[1:]}", unit]
    camel = re.search(r"[a-z]([KMN][mv]|Uv)$", column.name)
    if camel and not unit:  # VoltageMv
        stated = [camel[1].lower().replace("v", "V"), camel[1]]
    if len(stated) > 1:
        raise InputError(
            f"{name}: {column.label} may be in {' or '.join(stated)}: add `scale` "
            f"{role}=1{stated[0]}/{unit or stated[0]}"
        )


def _wished(
    name: str, role: str, column: Column, text: str
) -> tuple[Fraction, str | None]:
    """Return the factor of a scale and the unit after it."""
    match = _SCALE.fullmatch(text)
    if match is None or float(match[1]) == 0.0 or not abs(float(match[1])) < 1e250:
        raise UsageError(
            f"`scale` {role}={text}: give a factor other than 0, such as 20 or 10um/V"
        )
    factor = Fraction(match[1])
    if match[2] is None:
        return factor, column.unit
    try:
        factor *= ratio(column.unit, match[3])
    except InputError:
        raise InputError(
            f"{name}: {column.label} is in {column.unit}, `scale` {role}={text} expects {match[3]}"
        ) from None
    return factor, spell(match[2])
