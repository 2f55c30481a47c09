"""Whether a last line without its line end is whole, or a record that was cut in the middle of a number.

A recorder that is stopped, or a disk that is full, cuts a log anywhere: ``10.5032`` becomes ``10.5``, ``10.``
or ``1``, all of them numbers. Whether that happened is told by the cells above the last one.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from typing import NamedTuple

from dbo_cli.logs.cell_grammar import decode_line, split_cells, to_number
from dbo_cli.logs.text_dialect import Dialect, is_comment

_NEIGHBOURS = 100
_USUAL_STEPS = 3.0  # a change this many times the largest one above is not the next sample
_NUMBER = re.compile(r"[+-]?(?P<whole>\d*)(?P<rest>[.,]\d*)?(?:[eEdD](?P<exponent>[+-]?\d*))?")


class _Written(NamedTuple):
    """How a number is written: digits before and after the decimal sign (-1: no sign) and in the exponent."""

    whole: int
    decimals: int
    exponent: int


def _written(cell: str) -> _Written | None:
    found = _NUMBER.fullmatch(cell)
    if found is None:
        return None
    decimals = len(found["rest"]) - 1 if found["rest"] is not None else -1
    return _Written(len(found["whole"]), decimals, len(found["exponent"] or ""))


def last_cells(text: bytes, dialect: Dialect) -> list[str]:
    """Return the last cells of the whole rows in the text above the last line, at most a hundred."""
    cells = []
    for raw in text.split(b"\n")[1:-1][-_NEIGHBOURS:]:
        line = decode_line(raw.removesuffix(b"\r"))
        if not is_comment(line, dialect.comments):
            row = split_cells(line, dialect.delimiter)
            if len(row) == dialect.width:
                cells.append(row[-1])
    return cells


def looks_cut(cell: str, above: Sequence[str], decimal: str) -> bool:
    """Tell whether a number has visibly fewer digits than all the numbers above it.

    Fewer decimals, or fewer digits in the exponent, than any number above: cut, unless it ends in ``.0`` as
    whole numbers do among numbers of varying length, and goes on from the one above. Fewer digits before the
    decimal sign alone mean nothing (99 follows 100), unless the value leaps as well.
    """
    own = _written(cell)
    others = [one for one in map(_written, above) if one is not None]
    if own is None or not others:
        return False
    least = _Written(
        *(min(getattr(one, name) for one in others) for name in ("whole", "decimals", "exponent"))
    )
    if own.exponent < least.exponent:
        return True
    if own.decimals < least.decimals:
        varying = len({one.decimals for one in others}) > 1
        return not (varying and cell[-2:] in (".0", ",0") and not _leaps(cell, above, decimal))
    shorter = len(cell) < min(map(len, above)) or own.whole < least.whole
    return shorter and _leaps(cell, above, decimal)


def _leaps(cell: str, above: Sequence[str], decimal: str) -> bool:
    """Tell whether the last number is further from the one above than numbers above are from each other."""
    value = to_number(cell, decimal)
    numbers = [number for number in (to_number(one, decimal) for one in above) if number is not None]
    if value is None or len(numbers) < 2:
        return False
    steps = [abs(later - earlier) for earlier, later in itertools.pairwise(numbers)]
    return abs(value - numbers[-1]) > _USUAL_STEPS * max(steps)
