"""A column as it is written: its name, its unit, and how the two make a header."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dbo_cli.errors import OutputError
from dbo_cli.logs.columns import split_header
from dbo_cli.logs.plain_text import cleaned
from dbo_cli.logs.units import is_known_unit

_FORMULA_SIGNS = ("=", "+", "-", "@")


@dataclass(frozen=True)
class OutColumn:
    """A column to be written: name, unit, and what it measures (told by HDF5 alone; the name by default)."""

    name: str
    unit: str | None = None
    quantity: str | None = None

    @property
    def header(self) -> str:
        """The header cell, ``voltage_V``; a unit that no reader would know stands in brackets."""
        name, unit = cleaned(self.name), cleaned(self.unit or "")
        if not unit or split_header(name)[1] == unit:
            return name
        return f"{name}_{unit}" if is_known_unit(unit) else f"{name} ({unit})"


def unique_headers(columns: Sequence[OutColumn]) -> list[str]:
    """Return the headers of a table; the second column of a name is called ``name_2``."""
    headers: list[str] = []
    for column in columns:
        header, number = column.header, 2
        while header in headers:
            header, number = f"{column.header}_{number}", number + 1
        headers.append(header)
    return headers


def require_finite(headers: Sequence[str], arrays: Sequence[ArrayLike]) -> None:
    """Refuse to write NaN or infinity: the model or the signal is beyond the range of the arithmetic.

    Raises
    ------
    OutputError
        An array holds one; its header is named.
    """
    for header, array in zip(headers, arrays, strict=True):
        if not np.isfinite(array).all():
            raise OutputError(
                f"column '{header}' would hold a number that is not finite: the model or the signal is "
                "beyond the range of the arithmetic"
            )


def header_cell(text: str, delimiter: str) -> str:
    """Write a header as a cell of delimited text.

    A header that a spreadsheet would take for a formula (``=cmd|...``, ``-V``) gets an apostrophe before it,
    the spreadsheet's own sign for text.
    """
    if text.startswith(_FORMULA_SIGNS):
        text = "'" + text
    if delimiter in text or '"' in text or text[:1] in ("#", "%"):
        return '"' + text.replace('"', '""') + '"'
    return text
