"""What was read of a log, as one line for people and as data for a model's provenance."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from dbo_cli.logs.sample_block import ColumnInfo


class ReadColumn(NamedTuple):
    """A column as it was used: its role, where it stands, its unit, and the factor that was asked for."""

    role: str
    column: ColumnInfo
    unit: str | None
    scale: str | None = None

    def __str__(self) -> str:
        """Name it: ``voltage 'CH1' (V)``."""
        called = f"'{self.column.name}'" if self.column.quantity else f"column {self.column.number}"
        scale = f", {self.scale}" if self.scale else ""
        return f"{self.role} {called} ({self.unit or 'no unit'}{scale})"

    def record(self) -> dict[str, str]:
        """Give it as plain values."""
        found = {"column": self.column.name, "unit": self.unit, "scale": self.scale}
        return {key: value for key, value in found.items() if value is not None}


class ReadingSummary(NamedTuple):
    """What was read of a log.

    ``rows`` is None where it is not known yet; ``seconds`` is the time from the first sample to the last,
    ``rate`` the samples a second (Hz; ``even`` where no step is far from the usual one), ``rate_source`` says
    where a rate was taken from that is not a time column's: ``given`` or ``from the file``.
    """

    name: str
    columns: Sequence[ReadColumn]
    time: ReadColumn | None = None
    rows: int | None = None
    seconds: float | None = None
    rate: float | None = None
    even: bool = True
    rate_source: str | None = None

    def line(self) -> str:
        """Say it in one line."""
        told = []
        if self.rows is not None:
            told.append(f"{self.rows:,} row{'s' if self.rows != 1 else ''}")
        if self.rate is not None:
            source = f" ({self.rate_source})" if self.rate_source else ""
            plural = "" if _plain(self.rate) == "1" else "s"
            rate = f"{'' if self.even else 'about '}{_plain(self.rate)} sample{plural}/s{source}"
            told.append(rate if self.seconds is None else f"{_plain(self.seconds, 3)} s at {rate}")
        elif self.time is None:
            told.append("no time")
        columns = [*([] if self.time is None else [self.time]), *self.columns]
        listed = ", ".join(str(column) for column in columns)
        return f"{self.name}: {'; '.join([', '.join(told), listed] if told else [listed])}"

    def record(self) -> dict[str, Any]:
        """Give it as plain values; a key whose value is not known is left out."""
        found: dict[str, Any] = {
            "rows": self.rows,
            "seconds": self.seconds,
            "sample_rate": self.rate,
            "time": None if self.time is None else self.time.record(),
            "columns": {column.role: column.record() for column in self.columns},
        }
        return {key: value for key, value in found.items() if value is not None}


def _plain(value: float, digits: int = 4) -> str:
    """Write a number without an exponent where people would: 48,000 and not 4.8e+04."""
    return f"{value:,.0f}" if 999.5 <= abs(value) < 1e9 else f"{value:.{digits}g}"
