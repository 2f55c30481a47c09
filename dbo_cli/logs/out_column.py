"""A column as it is written: its header, and its numbers as the shortest text that reads back exactly."""

from __future__ import annotations

import io
import sys
from collections.abc import Sequence
from itertools import repeat
from typing import IO

import numpy as np
from numpy.typing import ArrayLike

from dbo_cli.errors import OutputError
from dbo_cli.logs.columns import split_header
from dbo_cli.logs.libraries import import_polars
from dbo_cli.logs.plain_text import cleaned
from dbo_cli.logs.units import is_known_unit
from dbo_cli.records import dataclass

PLAIN_CELLS = 1 << 16  # with fewer cells importing polars costs more than it saves (benchmarks/text_speed.py)
_FORMULA_SIGNS = ("=", "+", "-", "@")  # what begins a formula in Excel and LibreOffice


@dataclass(frozen=True)
class OutColumn:
    """A column to be written: name, unit, and what it measures (for HDF5 alone; the name by default).

    NaN in a column that ``may_be_blank`` is written as an empty cell (HDF5: as NaN).
    """

    name: str
    unit: str | None = None
    quantity: str | None = None
    may_be_blank: bool = False

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


def require_finite(columns: Sequence[OutColumn], headers: Sequence[str], arrays: Sequence[ArrayLike]) -> None:
    """Refuse to write NaN or infinity: the model or the signal is beyond the range of the arithmetic.

    Raises
    ------
    OutputError
        An array holds one, and it is no NaN of a column that may be blank; its header is named.
    """
    for column, header, array in zip(columns, headers, arrays, strict=True):
        good = np.isfinite(array)
        if not (good.all() or (column.may_be_blank and (good | np.isnan(array)).all())):
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


def shortest(value: float) -> str:
    """Write one number with the fewest digits that read back exactly, as polars spells it; NaN is empty."""
    text = repr(value)
    if "e" not in text:
        return text if text != "nan" else ""
    digits, exponent = text.split("e")
    if exponent == "-05":  # polars writes exponents only below 1e-5
        sign = "-" if digits[0] == "-" else ""
        return f"{sign}0.0000{digits.lstrip('-').replace('.', '')}"
    return f"{digits}e{'+' if exponent[0] == '+' else '-'}{exponent[1:].lstrip('0')}"


def write_rows(
    stream: IO[bytes],
    arrays: Sequence[ArrayLike],
    delimiter: str,
    *,
    blanks: bool = True,
    own_file: bool = False,
) -> None:
    """Write columns as lines of delimited text; the bytes do not depend on which way is taken.

    Parameters
    ----------
    stream, arrays, delimiter
        What is written where.
    blanks
        Whether a NaN may be among the numbers, which is an empty cell.
    own_file
        The stream is a file that nobody else knows: polars writes into it by itself, and no byte is copied.
        It would do so to standard output, too, but there a closed pipe and Ctrl-C are Python's to hear of.
    """
    if "polars" not in sys.modules and len(arrays) * np.size(arrays[0]) < PLAIN_CELLS:
        stream.write(_plain_rows(arrays, delimiter))
        return
    names = map(str, range(len(arrays)))
    columns = map(np.ascontiguousarray, arrays, repeat(np.float64))
    table = import_polars().DataFrame(dict(zip(names, columns, strict=False)), nan_to_null=blanks)
    if own_file:
        stream.flush()
        table.write_csv(stream, include_header=False, separator=delimiter)
    else:
        buffer = io.BytesIO()
        table.write_csv(buffer, include_header=False, separator=delimiter)
        stream.write(buffer.getbuffer())


def _plain_rows(arrays: Sequence[ArrayLike], delimiter: str) -> bytes:
    numbers = [np.asarray(array, dtype=np.float64).tolist() for array in arrays]
    columns = [[shortest(value) for value in column] for column in numbers]
    lines = [delimiter.join(cells) for cells in zip(*columns, strict=True)]
    return ("\n".join(lines) + "\n").encode() if lines else b""
