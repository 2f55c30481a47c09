"""The readable twin of ``dbo_dynamics.c``: the same arguments, the same bits.

Every floating-point operation is written in the same order in both. Sums over many neighbours are vectors
over the samples here, one neighbour after the other, as in C.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def dynamics_run(output: Floats, state: Floats, x: Floats, y: Floats, step: Floats) -> None:
    """Fill ``y`` with ``x`` after all sections; ``state`` (sections × 3: p, q, u) becomes that after it.

    ``output`` has two numbers a section, ``step`` six a section in one row or in one row for each sample; see
    ``dbo_dynamics.h`` for their meaning.
    """
    sections = state.size // 3
    held = [list(row) for row in state.reshape(sections, 3).tolist()]
    outputs = output.reshape(sections, 2).tolist()
    rows = step.reshape(-1, sections, 6).tolist()
    result = []
    for k, value in enumerate(x.tolist()):
        row = rows[k] if len(rows) > 1 else rows[0]
        for s, (p_q, p_lead, p_change, q_q, q_lead, q_change), (by_lead, by_q) in zip(
            held, row, outputs, strict=True
        ):
            p, q, u = s
            lead, change = u - p, value - u
            p = p + ((p_q * q + p_lead * lead) + p_change * change)
            q = (q_q * q + q_lead * lead) + q_change * change
            s[:] = p, q, value
            value = p + (by_lead * (value - p) + by_q * q)
        result.append(value)
    y[:] = result
    state[:] = np.array(held).reshape(state.shape)


def dynamics_undo(numbers: Floats, weight: Floats, state: Floats, y: Floats, u: Floats) -> None:
    """Fill ``u`` with the input of one section whose output is ``y``, which goes on for ``len(weight)`` more.

    ``numbers`` are aa, ab, ba, bb, a_in, b_in, a_out, b_out of ``dbo_section_inverse``; ``state`` (y, a, b)
    becomes that after the samples of ``u``.
    """
    count = u.size
    future = np.zeros(count)
    for j in range(weight.size, 0, -1):
        future += weight[j - 1] * (y[j : j + count] - y[j - 1 : j - 1 + count])
    aa, ab, ba, bb, a_in, b_in, a_out, b_out = numbers.tolist()
    last, a, b = state.tolist()
    result = []
    for value, ahead in zip(y[:count].tolist(), future.tolist(), strict=True):
        change = value - last
        a, b = (aa * a + ab * b) + a_in * change, (ba * a + bb * b) + b_in * change
        last = value
        result.append(value + ((a_out * a + b_out * b) + ahead))
    u[:] = result
    state[:] = last, a, b


def smooth(weight: Floats, x: Floats, y: Floats) -> None:
    """Fill ``y`` with a symmetric weighted mean of ``x``, which has ``len(weight)`` more at either end."""
    reach, count = weight.size, y.size
    middle = x[reach : reach + count]
    total = np.zeros(count)
    for j in range(reach, 0, -1):
        total += weight[j - 1] * (
            (x[reach - j : reach - j + count] - middle) + (x[reach + j : reach + j + count] - middle)
        )
    y[:] = middle + total
