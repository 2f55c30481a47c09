"""The inverse of a section of dynamics on an even clock, reading ahead.

With the output of a section given, u - p and q follow a recursion of two eigenvalues,
the zeros of the discretised section. For a resonance one lies near -0.268 and is run
forward; the other near -3.73 and is run backward, as a sum over the next samples. Both
are driven by differences of the signal alone, so that the inverse of a rest is the same
rest. The zeros of an antiresonance are both inside, and run forward.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.errors import InputError
from dbo_cli.model.sections import Lag, Resonance, Section

HIGHEST_PART = 0.3
"""Of the sample rate: a resonance above it is not undone; its inverse would ring."""
LEFT_OVER = 1e-17  # of the whole sum over the future: less than rounding does to it
# samples; beyond, the zero is so near the unit circle that the inverse rings
LONGEST_AHEAD = 2000


class SectionInverse(NamedTuple):
    """The inverse of one section on an even clock.

    Attributes
    ----------
    numbers : array of 8
        Of its recursion, as ``dbo_section_inverse`` has them.
    weight : array
        Of the changes of the signal 1, 2, ... samples ahead.
    from_state : array of shape (2, 2)
        What the recursion remembers, from (u - p, q) of the forward section.
    """

    numbers: Floats
    weight: Floats
    from_state: Floats


class Recursion(NamedTuple):
    """How two numbers follow the output y of a section, and its input u from them.

    They become ``matrix @ numbers + drive * (y' - y)``, and u = y + ``out @ numbers``.
    """

    matrix: Floats
    drive: Floats
    out: Floats

    @property
    def numbers(self) -> Floats:
        """All in the kernel's order."""
        return np.concatenate([self.matrix.reshape(-1), self.drive, self.out])


def _recursion(section: Section, dt: float) -> Recursion:
    """Return how u - p and q follow a given output of a section."""
    by_step = section.step(np.array([dt]))[:, 0]
    p_by_q, p_by_lead, p_by_change, q_by_q, q_by_lead, q_by_change = by_step
    by_lead, by_q = section.output
    by_drive = (1.0 - by_lead) * p_by_change + by_lead + by_q * q_by_change
    # the change of the input that gives a change of the output, by u - p and q
    from_lead = -((1.0 - by_lead) * p_by_lead + by_q * q_by_lead) / by_drive
    from_q = -((1.0 - by_lead) * p_by_q + by_q * (q_by_q - 1.0)) / by_drive
    left = 1.0 - p_by_change
    lead_row = [1.0 - p_by_lead + left * from_lead, -p_by_q + left * from_q]
    rate_row = [q_by_lead + q_by_change * from_lead, q_by_q + q_by_change * from_q]
    return Recursion(
        matrix=np.array([lead_row, rate_row]),
        drive=np.array([left / by_drive, q_by_change / by_drive]),
        out=np.array([1.0 - by_lead, -by_q]),
    )


def _with_one(decay: float, drive: float, out: float) -> Floats:
    """Return the kernel's numbers of a recursion of one number."""
    matrix = np.diag([decay, 0.0])
    return Recursion(matrix, np.array([drive, 0.0]), np.array([out, 0.0])).numbers


def section_inverse(section: Section, dt: float) -> SectionInverse:
    """Return the inverse of a section on an even clock of ``dt`` (s).

    Raises
    ------
    InputError
        The clock does not resolve the section; the message names the rate that does.
    """
    recursion = _recursion(section, dt)
    matrix = recursion.matrix
    if isinstance(section, Lag):
        numbers = _with_one(matrix[0, 0], recursion.drive[0], recursion.out[0])
        return SectionInverse(numbers, np.zeros(0), np.array([[1.0, 0.0], [0.0, 0.0]]))
    if section.highest * dt > HIGHEST_PART:
        raise _unresolved(section, dt)
    half = 0.5 * (matrix[0, 0] + matrix[1, 1])
    det = float(np.linalg.det(matrix))
    root = half * half - det
    if root <= 0.0:
        return _forward_only(section, dt, recursion, math.sqrt(det))
    outer = half + math.copysign(math.sqrt(root), half)
    inner = det / outer
    inner, outer = sorted([inner, outer], key=abs)
    if abs(outer) < 1.0:
        return _forward_only(section, dt, recursion, abs(outer))
    count = math.ceil(math.log(LEFT_OVER) / -math.log(abs(outer)))
    if abs(inner) >= 1.0 or count > LONGEST_AHEAD:
        raise _unresolved(section, dt)
    inside_row, inside_drive = _eigenpart(recursion, inner)
    _, outside_drive = _eigenpart(recursion, outer)
    weight = -outside_drive * outer ** -np.arange(1.0, count + 1.0)
    numbers = _with_one(inner, inside_drive, 1.0)
    return SectionInverse(numbers, weight, np.array([inside_row, [0.0, 0.0]]))


def _eigenpart(recursion: Recursion, zero: float) -> tuple[Floats, float]:
    """Return the part of the inverse that belongs to one eigenvalue: as seen in the result, and its drive."""
    matrix, drive, out = recursion
    left_vector = np.array([matrix[1, 0], zero - matrix[0, 0]])
    right = np.array([matrix[0, 1], zero - matrix[0, 0]])
    row = left_vector * (float(out @ right) / float(left_vector @ right))
    return row, float(row @ drive)


def _forward_only(
    section: Resonance, dt: float, recursion: Recursion, largest: float
) -> SectionInverse:
    """Return an inverse without a look ahead: both zeros are inside the unit circle."""
    if not largest < 1.0 or section.antiresonance is None:
        raise _unresolved(section, dt)
    return SectionInverse(recursion.numbers, np.zeros(0), np.eye(2))


def _unresolved(section: Resonance, dt: float) -> InputError:
    """Return the refusal of a clock that does not resolve a section, with the rate that does."""
    name = f"resonance at {section.frequency:.6g} Hz"
    if section.antiresonance is not None:
        name += f" with its antiresonance at {section.antiresonance.frequency:.6g} Hz"
    return InputError(
        f"the model's {name} is too fast to be undone at {1.0 / dt:.6g} Hz"
        f" (`resample` {6.0 * section.highest:.6g} or more)"
    )
