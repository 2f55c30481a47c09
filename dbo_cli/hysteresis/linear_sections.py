"""The sections of a model's dynamics and their exact inverses (beyond the paper).

What moves is a mass on springs behind an amplifier. Sections of unit gain follow one another: resonances,
1/(1 + 2ζs/ω + s²/ω²), each perhaps with an antiresonance as numerator, and first-order lags.

A resonance is discretised with a first-order hold: exact for an input that is straight between samples, for
any time between them. In p, the output of 1/(1 + 2ζs/ω + s²/ω²), and q, its rate over ω, one sample changes
p by p_by_q q + S (u - p) + R (u' - u), where u and u' are the input before and now, S the step response after
one time step and R the response to a ramp. A rest, u = p and q = 0, stays a rest to the last bit. A
first-order hold of a lag has its zero near -1, whose inverse rings for ever. With δ = 1 - 1/z the lag is
taken as (1 - βδ)/(1 + (τ/Δt - β)δ): late by τ at any rate, its zero at -β/(1 - β), -2/3 here, its error in
amplitude, (1/2 - β) τΔtω², a fifth of the backward difference's (β = 0).

The inverse. With the output given, u - p and q follow a recursion of two eigenvalues, the zeros of the
discretised section. For a resonance one lies near -0.268 and is run forward; the other near -3.73 and is
run backward, as a sum over the next samples. Both are driven by differences of the signal alone, so that the
inverse of a rest is the same rest. The zeros of an antiresonance are both inside, and run forward.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import InputError, ModelError

Floats = NDArray[np.float64]
Complexes = NDArray[np.complexfloating]

FEWEST_SAMPLES = 3.0
"""Samples a period of the resonance from which on the inverse is taken.

The zero that is run backward lies at -3.73 for many samples, at -2.4 to -2.9 for 6, at -1.4 for 3; towards 2,
half the sampling rate, at -1, where no sum over the future converges.
"""
LEFT_OVER = 1e-17  # of the whole sum over the future: less than rounding does to it
LONGEST_AHEAD = 2000  # samples; beyond, the zero is so near the unit circle that the inverse rings
LAG_ZERO = 0.4
"""β of a lag. Measured on a lag of 0.2 ms and a resonance of 800 Hz at 20 kHz, sine at 160 Hz, error in % of
the move: 0.17 for β = 0, 0.028 for 0.4; at 0.5 its inverse rings for ever."""
_SERIES = 1.0  # radians of the resonance a step, below which responses are summed as series: no cancellation
_TERMS = 24  # of the series; the last is below 1e-20 of the first at one radian


def _positive(key: str, value: float, most: float = math.inf) -> None:
    if not (math.isfinite(value) and 0.0 < value < most):
        bound = "greater than 0" if most == math.inf else f"between 0 and {most:g}"
        raise ModelError(f"{key}: {value!r} is not a finite number {bound}")


@dataclass(frozen=True)
class Mode:
    """The polynomial 1 + 2ζs/ω + s²/ω².

    Attributes
    ----------
    frequency : float
        ω/2π in Hz, > 0.
    damping : float
        ζ, in (0, 1).
    """

    frequency: float
    damping: float

    def __post_init__(self) -> None:
        """Refuse what is none, naming the key."""
        _positive("frequency", self.frequency)
        _positive("damping", self.damping, 1.0)


class Antiresonance(Mode):
    """The numerator 1 + 2ζs/ω + s²/ω² of a section: where the actuator hardly moves."""


@dataclass(frozen=True)
class Resonance(Mode):
    """A second-order section 1/(1 + 2ζs/ω + s²/ω²), perhaps with an antiresonance as numerator."""

    antiresonance: Antiresonance | None = None

    @property
    def highest(self) -> float:
        """The higher of the resonance's and the antiresonance's frequency (Hz)."""
        other = self.antiresonance
        return self.frequency if other is None else max(self.frequency, other.frequency)

    @property
    def output(self) -> tuple[float, float]:
        """The parts of u - p and of q that the numerator adds to p."""
        if self.antiresonance is None:
            return 0.0, 0.0
        ratio = self.frequency / self.antiresonance.frequency
        return ratio * ratio, 2.0 * ratio * (self.antiresonance.damping - ratio * self.damping)

    def step(self, time_step: Floats) -> Floats:
        """Return the kernel's six numbers for each time step (s): what p and q change by."""
        angle = 2.0 * math.pi * self.frequency * time_step
        zeta, root = self.damping, math.sqrt(1.0 - self.damping * self.damping)
        fade = np.exp(-zeta * angle)
        sine, cosine = fade * np.sin(root * angle) / root, fade * np.cos(root * angle)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            # One step, as in every fit, is summed in plain numbers: the same bits in a fifth of the time.
            small: Any = angle.item() if angle.size == 1 else angle
            step = np.where(angle < _SERIES, _series(small, zeta, 0), 1.0 - (cosine + zeta * sine))
            ramp = np.where(
                angle < _SERIES, _series(small, zeta, 1), 1.0 - (2.0 * zeta * step + sine) / angle
            )
            rate = np.where(angle > 0.0, step / angle, 0.0)
        return np.column_stack([sine, step, ramp, cosine - zeta * sine, sine, rate])

    def response(self, frequency: Floats) -> Complexes:
        """Return G(2πif) for frequencies in Hz."""
        s = 1j * frequency / self.frequency
        gain: Complexes = 1.0 / (1.0 + 2.0 * self.damping * s + s * s)
        if self.antiresonance is not None:
            s = 1j * frequency / self.antiresonance.frequency
            gain = gain * (1.0 + 2.0 * self.antiresonance.damping * s + s * s)
        return gain


def _series(angle: Any, zeta: float, order: int) -> Any:
    """Return p after an input that rises from 0 to 1 at once (``order`` 0) or evenly (1), as a power series.

    p'' + 2ζp' + p = input in units of 1/ω; the terms d_n = c_n angleⁿ follow from the two before.
    """
    squared = angle * angle
    before = now = total = 0.0 * squared  # d_0 and d_1
    for n in range(_TERMS):
        asked = squared if n == order else 0.0
        following = (asked - 2.0 * zeta * (n + 1) * angle * now - squared * before) / ((n + 2) * (n + 1))
        total = total + following
        before, now = now, following
    return total


@dataclass(frozen=True)
class Lag:
    """A first-order section (1 + λs)/(1 + τs): a lag, or with a lead creep, of which 1 - λ/τ comes late.

    Attributes
    ----------
    seconds : float
        τ, > 0.
    lead : float
        λ, from 0 to τ.
    """

    seconds: float
    lead: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what is none, naming the key."""
        _positive("lag", self.seconds)
        if not 0.0 <= self.lead < self.seconds:
            raise ModelError(f"lead: {self.lead!r} is not from 0 to less than the lag of {self.seconds!r} s")

    @property
    def output(self) -> tuple[float, float]:
        """The part of u - p that the lead adds to p; nothing of q."""
        return self.lead / self.seconds, 0.0

    def step(self, time_step: Floats) -> Floats:
        """Return the kernel's six numbers for each time step (s)."""
        none = np.zeros_like(time_step)
        with np.errstate(divide="ignore", invalid="ignore"):
            late = np.where(time_step > 0.0, self.seconds / time_step, np.inf)
            beta = np.minimum(LAG_ZERO, late)
            part = 1.0 / (1.0 + (late - beta))
        return np.column_stack([none, part, part * (1.0 - beta), none, none, none])

    def response(self, frequency: Floats) -> Complexes:
        """Return G(2πif) for frequencies in Hz."""
        turn = 2j * math.pi * frequency
        response: Complexes = (1.0 + turn * self.lead) / (1.0 + turn * self.seconds)
        return response


Section = Resonance | Lag


class SectionInverse(NamedTuple):
    """The inverse of one section on an even clock.

    Attributes
    ----------
    numbers : array of 8
        See ``dbo_section_inverse``.
    weight : array
        Of the changes of the signal 1, 2, … samples ahead.
    from_state : array of shape (2, 2)
        What the recursion remembers, from (u - p, q) of the forward section.
    """

    numbers: Floats
    weight: Floats
    from_state: Floats


def section_inverse(section: Section, time_step: float) -> SectionInverse:
    """Return the inverse of a section on an even clock.

    Raises
    ------
    InputError
        The clock does not resolve the section; the message names the rate that does.
    """
    if isinstance(section, Resonance) and section.highest * time_step >= 0.5:
        raise _unresolved(section, time_step)
    p_q, p_lead, p_change, q_q, q_lead, q_change = section.step(np.array([time_step]))[0].tolist()
    by_lead, by_q = section.output
    own = (1.0 - by_lead) * p_change + by_lead + by_q * q_change
    # The change of the input that gives a wanted change of the output, by u - p, q and that change:
    from_lead = -((1.0 - by_lead) * p_lead + by_q * q_lead) / own
    from_q = -((1.0 - by_lead) * p_q + by_q * (q_q - 1.0)) / own
    matrix = np.array(
        [
            [1.0 - p_lead + (1.0 - p_change) * from_lead, -p_q + (1.0 - p_change) * from_q],
            [q_lead + q_change * from_lead, q_q + q_change * from_q],
        ]
    )
    drive = np.array([(1.0 - p_change) / own, q_change / own])
    out = np.array([1.0 - by_lead, -by_q])
    if isinstance(section, Lag):
        numbers = np.array([matrix[0, 0], 0.0, 0.0, 0.0, drive[0], 0.0, out[0], 0.0])
        return SectionInverse(numbers, np.zeros(0), np.array([[1.0, 0.0], [0.0, 0.0]]))
    half, det = 0.5 * (matrix[0, 0] + matrix[1, 1]), float(np.linalg.det(matrix))
    root = half * half - det
    if root <= 0.0:
        return _forward_only(section, time_step, matrix, drive, out, math.sqrt(det))
    far = half + math.copysign(math.sqrt(root), half)
    zeros = sorted([det / far, far], key=abs)
    if abs(zeros[1]) < 1.0:
        return _forward_only(section, time_step, matrix, drive, out, abs(zeros[1]))
    if section.frequency * time_step * FEWEST_SAMPLES > 1.0 or abs(zeros[0]) >= 1.0:
        raise _unresolved(section, time_step)
    inside, outside = (_mode(matrix, drive, out, zero) for zero in zeros)
    count = math.ceil(math.log(LEFT_OVER) / -math.log(abs(zeros[1])))
    if count > LONGEST_AHEAD:
        raise _unresolved(section, time_step)
    weight = -outside[1] * zeros[1] ** -np.arange(1.0, count + 1.0)
    numbers = np.array([zeros[0], 0.0, 0.0, 0.0, inside[1], 0.0, 1.0, 0.0])
    return SectionInverse(numbers, weight, np.array([inside[0], [0.0, 0.0]]))


def _mode(matrix: Floats, drive: Floats, out: Floats, zero: float) -> tuple[Floats, float]:
    """Return the part of the inverse that belongs to one eigenvalue: as seen in the result, and its drive."""
    left = np.array([matrix[1, 0], zero - matrix[0, 0]])
    right = np.array([matrix[0, 1], zero - matrix[0, 0]])
    seen = left * (float(out @ right) / float(left @ right))
    return seen, float(seen @ drive)


def _forward_only(
    section: Resonance, time_step: float, matrix: Floats, drive: Floats, out: Floats, largest: float
) -> SectionInverse:
    """Return an inverse without a look ahead: both zeros are inside the unit circle."""
    if not largest < 1.0 or section.antiresonance is None:
        raise _unresolved(section, time_step)
    numbers = np.concatenate([matrix.reshape(-1), drive, out])
    return SectionInverse(numbers, np.zeros(0), np.eye(2))


def _unresolved(section: Resonance, time_step: float) -> InputError:
    """Return the refusal of a clock that does not resolve a section, with the rate that does."""
    named = [f"resonance at {section.frequency:.6g} Hz"]
    if section.antiresonance is not None:
        named.append(f"antiresonance at {section.antiresonance.frequency:.6g} Hz")
    beyond = "above half" if section.highest * time_step >= 0.5 else "too high for"
    return InputError(
        f"the model's {' with its '.join(named)} is {beyond} the sampling rate of {1.0 / time_step:.6g} Hz, "
        f"so its inverse is not to be had there (`resample` {6.0 * section.highest:.6g} or more)"
    )
