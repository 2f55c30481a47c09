"""A last line without its line end: whether the record was cut in a cell of it."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from dbo_cli.logs.cells import is_number, to_number

# a sample that goes on from the one before does not jump by more than a few of the
# steps before it
_LARGEST_JUMP = 3.0


def cut_record(rows: Sequence[Sequence[str]], decimal: str) -> str:
    """Return why the last cell of the last row must be taken for a cut one; nothing where it need not.

    Parameters
    ----------
    rows
        The cells of the last rows, of the row in question last.
    decimal
        The decimal sign.
    """
    last = rows[-1]
    others = [row for row in rows[:-1] if len(row) == len(last)]
    if not others or not last:
        return ""
    cell = last[-1]
    cells = [row[-1] for row in others if is_number(row[-1], decimal)]
    if not cells or not is_number(cell, decimal):
        return ""  # a cell that is no number is refused as such
    fewer = f"its last cell '{cell}' is shorter than those above ('{cells[-1]}')"
    if re.search("[eE]", cells[-1]) and all(re.search("[eE]", text) for text in cells):
        shape = re.sub(r"\d+", "0", cells[-1])
        exponent = len(re.split("[eE]", cell)[-1].lstrip("+-"))
        usual = min(len(re.split("[eE]", text)[-1].lstrip("+-")) for text in cells)
        if not re.search("[eE]", cell) or exponent < usual or not shape:
            return fewer
    elif decimals(cell, decimal) < min(decimals(text, decimal) for text in cells):
        return fewer
    values = np.array([to_number(text, decimal) for text in [*cells, cell]])
    steps = np.abs(np.diff(values))
    if len(steps) > 2 and len(cell) < len(cells[-1]):
        if steps[-1] > _LARGEST_JUMP * steps[:-1].max():
            return fewer
    return ""


def decimals(cell: str, decimal: str) -> int:
    """Count the digits behind the decimal sign; -1 where there is none."""
    _, sign, behind = cell.partition(decimal)
    return len(behind) if sign else -1
