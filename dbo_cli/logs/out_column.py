"""A column as it is written: its name, its unit, and how the two make a header."""

from __future__ import annotations

from dataclasses import dataclass

from dbo_cli.logs.columns import is_known_unit, split_header


@dataclass(frozen=True)
class OutColumn:
    """A column to be written: name, unit, and what it measures (told by HDF5 alone; the name by default)."""

    name: str
    unit: str | None = None
    quantity: str | None = None

    @property
    def header(self) -> str:
        """The header cell, ``voltage_V``; a unit that no reader would know stands in brackets."""
        if not self.unit or split_header(self.name)[1] == self.unit:
            return self.name
        return f"{self.name}_{self.unit}" if is_known_unit(self.unit) else f"{self.name} ({self.unit})"
