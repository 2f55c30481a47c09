"""The two loops of an identification, in Python and compiled (``_fit.c``), bit for bit the same.

Every sum is taken in one fixed order: no library that deals its work out to threads takes part, so that the
same logs give the same model, to the last bit, wherever it is identified.
"""

from __future__ import annotations

import contextlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.hysteresis import kernel

Floats = NDArray[np.float64]
States = NDArray[np.uint8]

AT_ZERO, POSITIVE, FREE, ABSENT = range(4)  # of an unknown of ``minimise``

ROWS = 32  # of a table whose products are held at once: 3 MB with 100 columns
PATIENCE = 3  # steps without progress before unknowns are exchanged one by one (Júdice and Pires, 1994)


def add_products(table: Floats, columns: int, matrix: Floats) -> None:
    """Add the products of all pairs of columns to the upper triangle of ``matrix``, row after row."""
    rows = table.reshape(-1, columns)
    for first in range(0, len(rows), ROWS):
        part = rows[first : first + ROWS]
        products = part[:, :, None] * part[:, None, :]
        for one in products:
            matrix += one


def _solved(matrix: Floats, right: Floats) -> Floats | None:
    """Solve positive definite equations by Cholesky's factor; None where they are not."""
    upper, x = matrix.copy(), right.copy()
    count = len(right)
    for j in range(count):
        if not upper[j, j] > 0.0:
            return None
        upper[j, j] = root = np.sqrt(upper[j, j])
        row = upper[j, j + 1 :]
        row /= root
        upper[j + 1 :, j + 1 :] -= row[:, None] * row
        x[j] /= root
        x[j + 1 :] -= row * x[j]
    for j in range(count - 1, -1, -1):
        x[j] /= upper[j, j]
        x[:j] -= upper[:j, j] * x[j]
    return x


def minimise(matrix: Floats, right: Floats, state: States, x: Floats, tolerance: float, most: int) -> int:
    """Minimise x'Hx - 2 g'x, x >= 0 but for the free unknowns, by block principal pivoting.

    Unknowns are guessed to be zero or positive (``state``, changed in place); all that turn out on the wrong
    side change sides at once, and one by one where that does not get on (Júdice and Pires, 1994; Kim and
    Park, 2011). Returns the number of steps, 0 where ``most`` do not end it, -1 where H is not positive
    definite. A gradient counts as negative beyond ``tolerance``.
    """
    fewest, patience = len(right) + 1, PATIENCE
    for step in range(1, most + 1):
        at = np.flatnonzero((state == POSITIVE) | (state == FREE))
        part = _solved(matrix[np.ix_(at, at)], right[at])
        if part is None:
            return -1
        x[:] = 0.0
        x[at] = part
        dual = -right
        for row, value in zip(at.tolist(), part.tolist(), strict=True):
            dual += matrix[row] * value
        wrong = ((state == POSITIVE) & (x < 0.0)) | ((state == AT_ZERO) & (dual < -tolerance))
        count = int(wrong.sum())
        if not count:
            return step
        if count < fewest:
            fewest, patience = count, PATIENCE
        else:
            patience -= 1
        if patience < 0:
            wrong[: np.flatnonzero(wrong)[-1]] = False
        state[wrong] = POSITIVE - state[wrong]  # the one becomes the other
    return 0


class PythonFit:
    """The functions of this module under the names that the extension gives its own."""

    add_products = staticmethod(add_products)
    minimise = staticmethod(minimise)


def _choose() -> Any:
    """Return the extension where the compiled kernel is chosen and it was built, else the functions here."""
    if kernel.KIND == "compiled":
        with contextlib.suppress(ImportError):
            from dbo_cli.hysteresis import _fit  # type: ignore[attr-defined,unused-ignore]

            return _fit
    return PythonFit


CHOSEN = _choose()
