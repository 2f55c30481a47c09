"""Numbers as text: the shortest decimal that reads back as the same float64."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from itertools import repeat

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dbo_cli.logs.libraries import keep_interrupts

PLAIN_CELLS = (
    1 << 16
)  # fewer cells than this are written before polars is imported (benchmarks/text_speed.py)


# What instruments send in place of a value that is beyond their range (9.9E37) or none (9.91E37): SCPI-99,
# volume 1, 7.2.1. Their 32-bit numbers are a little off.
_OVERFLOW_FROM, _OVERFLOW_TO = 9.899e37, 9.911e37


def is_overflow(value: float) -> bool:
    """Tell whether a number is an instrument's way to say that it has none."""
    return _OVERFLOW_FROM < abs(value) < _OVERFLOW_TO


def are_measured(values: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell which numbers are finite and no instrument's overflow."""
    size = np.abs(values)
    usual: NDArray[np.bool_] = size < _OVERFLOW_FROM  # False for NaN and infinity as well
    if not usual.all():
        usual = usual | ((size >= _OVERFLOW_TO) & np.isfinite(values))
    return usual


def shortest(value: float) -> str:
    """Write one number with the fewest digits that read back exactly, spelled as polars spells it."""
    text = repr(value)
    if "e" not in text:
        return text if text != "nan" else "NaN"
    digits, exponent = text.split("e")
    if exponent == "-05":  # polars writes exponents only below 1e-5
        sign = "-" if digits[0] == "-" else ""
        return f"{sign}0.0000{digits.lstrip('-').replace('.', '')}"
    return f"{digits}e{'+' if exponent[0] == '+' else '-'}{exponent[1:].lstrip('0')}"


def rows_as_text(arrays: Sequence[ArrayLike], delimiter: str) -> bytes | memoryview:
    """Write columns as lines of delimited text; the bytes do not depend on which way is taken."""
    if "polars" in sys.modules or len(arrays) * np.size(arrays[0]) >= PLAIN_CELLS:
        return _fast_rows(arrays, delimiter)
    return _plain_rows(arrays, delimiter)


def _plain_rows(arrays: Sequence[ArrayLike], delimiter: str) -> bytes:
    numbers = [np.asarray(array, dtype=np.float64).tolist() for array in arrays]
    columns = [[shortest(value) for value in column] for column in numbers]
    lines = [delimiter.join(cells) for cells in zip(*columns, strict=True)]
    return ("\n".join(lines) + "\n").encode() if lines else b""


def _fast_rows(arrays: Sequence[ArrayLike], delimiter: str) -> memoryview:
    import io

    import polars

    keep_interrupts()

    buffer = io.BytesIO()
    names = map(str, range(len(arrays)))
    columns = map(np.ascontiguousarray, arrays, repeat(np.float64))
    table = polars.DataFrame(dict(zip(names, columns, strict=False)))
    table.write_csv(buffer, include_header=False, separator=delimiter)
    return buffer.getbuffer()
