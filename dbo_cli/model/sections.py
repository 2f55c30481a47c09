"""The sections of dynamics, of unit gain: resonances and first-order lags (beyond the paper).

A resonance is a mass on springs, 1/(1 + 2 zeta s/omega + s^2/omega^2), perhaps with an
antiresonance as numerator.

A resonance is discretised with a first-order hold: exact for an input that is straight
between samples, for any time between them. In p, the output of 1/(...), and q, its rate
over omega, one sample changes p by p_by_q q + S (u - p) + R (u' - u), where u and u' are
the input before and now, S the step response after one time step and R the response to a
ramp. A rest, u = p and q = 0, stays a rest to the last bit. A first-order hold of a lag
has its zero near -1, whose inverse rings for ever. With d = 1 - 1/z the lag is taken as
(1 - b d)/(1 + (tau/dt - b) d): late by tau at any rate, its zero at -b/(1 - b), -2/3
here, its error in amplitude, (1/2 - b) tau dt omega^2, a fifth of the backward
difference's (b = 0).

On an even clock a section is undone, reading ahead. With its output given, u - p and q
follow a recursion of two eigenvalues, the zeros of the discretised section. For a
resonance one lies near -0.268 and is run forward; the other near -3.73 and is run
backward, as a sum over the next samples. Both are driven by differences of the signal
alone, so that the inverse of a rest is the same rest. The zeros of an antiresonance are
both inside, and run forward.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.errors import InputError, ModelError
from dbo_cli.model.fields import Keyed, build, notes, number, require_above_0

LAG_ZERO = 0.4
"""b of a lag, see above: between ringing of the inverse and error of the amplitude."""
# radians of the resonance a step, below which responses are summed as series: no
# cancellation
_SERIES = 1.0
_TERMS = 24  # of the series; the last is below 1e-20 of the first at one radian
HIGHEST_PART = 0.3
"""Of the sample rate: a resonance above it is not undone; its inverse would ring."""
LEFT_OVER = 1e-17  # of the whole sum over the future: less than rounding does to it
# samples; beyond, the zero is so near the unit circle that the inverse rings
LONGEST_AHEAD = 2000


class SectionOutput(NamedTuple):
    """What a section's output has besides p: parts of the lead u - p and of q (``dbo_section_output``)."""

    by_lead: float = 0.0
    by_q: float = 0.0


@dataclass(frozen=True)
class Mode(Keyed):
    """The polynomial 1 + 2 zeta s/omega + s^2/omega^2.

    Attributes
    ----------
    frequency : float
        omega/2 pi in Hz, > 0.
    damping : float
        zeta, between 0 and 1.
    """

    frequency: float
    damping: float
    KEYS: ClassVar = {"frequency": number, "damping": number}

    def __post_init__(self) -> None:
        """Refuse numbers out of range, naming the key."""
        require_above_0("frequency", self.frequency)
        require_above_0("damping", self.damping, 1.0)


@dataclass(frozen=True)
class Resonance(Mode):
    """A second-order section, perhaps with an antiresonance (a ``Mode``) as numerator."""

    antiresonance: Mode | None = None
    KEYS: ClassVar = {**Mode.KEYS, "antiresonance": Mode.read}
    OPTIONAL: ClassVar = ("antiresonance",)

    @property
    def highest(self) -> float:
        """The higher of the resonance's and the antiresonance's frequency (Hz)."""
        if self.antiresonance is None:
            return self.frequency
        return max(self.frequency, self.antiresonance.frequency)

    @property
    def output(self) -> SectionOutput:
        """What the numerator adds to p."""
        if self.antiresonance is None:
            return SectionOutput()
        ratio = self.frequency / self.antiresonance.frequency
        damping = self.antiresonance.damping - ratio * self.damping
        return SectionOutput(ratio * ratio, 2.0 * ratio * damping)

    def step(self, dt: Floats) -> Floats:
        """Return how p and q change in each time step (s), shape (6, steps).

        p by q, by the lead u - p of the input, and by the change of the input; then q by
        the same (``dbo_section_step``).
        """
        angle = 2.0 * math.pi * self.frequency * dt
        zeta = self.damping
        root = math.sqrt(1.0 - zeta * zeta)
        fade = np.exp(-zeta * angle)
        sine = fade * np.sin(root * angle) / root
        cosine = fade * np.cos(root * angle)
        slow = angle < _SERIES
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            step = np.where(slow, _series(angle, zeta, 0), 1.0 - (cosine + zeta * sine))
            lag_steps = 1.0 - (2.0 * zeta * step + sine) / angle
            ramp = np.where(slow, _series(angle, zeta, 1), lag_steps)
            rate = np.where(angle > 0.0, step / angle, 0.0)
        return np.array([sine, step, ramp, cosine - zeta * sine, sine, rate])


def _series(angle: Any, zeta: float, order: int) -> Any:
    """Return p after an input that rises from 0 to 1 at once (``order`` 0) or evenly (1), as a power series.

    p'' + 2 zeta p' + p = input in units of 1/omega; the terms d_n = c_n angle^n follow
    from the two before.
    """
    squared = angle * angle
    before = now = total = 0.0 * squared  # d_0 and d_1
    for n in range(_TERMS):
        forcing = squared if n == order else 0.0
        drag = 2.0 * zeta * (n + 1) * angle * now
        following = (forcing - drag - squared * before) / ((n + 2) * (n + 1))
        total = total + following
        before, now = now, following
    return total


@dataclass(frozen=True)
class Lag(Keyed):
    """A first-order section (1 + lambda s)/(1 + tau s): a lag, or creep of which 1 - lambda/tau comes late.

    Attributes
    ----------
    seconds : float
        tau, > 0.
    lead : float
        lambda, from 0 to less than tau.
    """

    seconds: float
    lead: float = 0.0
    KEYS: ClassVar = {"lag": number, "lead": number}
    OPTIONAL: ClassVar = ("lead",)

    def __post_init__(self) -> None:
        """Refuse numbers out of range, naming the key."""
        require_above_0("lag", self.seconds)
        if not 0.0 <= self.lead < self.seconds:
            raise ModelError(
                f"lead: {self.lead!r} is not from 0 to less than the lag of {self.seconds!r} s"
            )

    @property
    def output(self) -> SectionOutput:
        """What the numerator adds to p."""
        return SectionOutput(by_lead=self.lead / self.seconds)

    @property
    def lag(self) -> float:
        """The time constant, as a model file calls it."""
        return self.seconds

    def step(self, dt: Floats) -> Floats:
        """Return how p changes in each time step (s), as of ``Resonance``; a lag has no q."""
        none = np.zeros_like(dt)
        with np.errstate(divide="ignore", invalid="ignore"):
            lag_steps = np.where(dt > 0.0, self.seconds / dt, np.inf)
            beta = np.minimum(LAG_ZERO, lag_steps)
            share = 1.0 / (1.0 + (lag_steps - beta))
        return np.array([none, share, share * (1.0 - beta), none, none, none])


Section = Resonance | Lag


def read_section(values: Any, path: str) -> Any:
    """Return the section that an object of a model file describes."""
    if "lag" not in notes(values, path):
        return Resonance.read(values, path)
    return build(_lag_of, values, path, Lag.OPTIONAL, **Lag.KEYS)


def _lag_of(lag: float, lead: float = 0.0) -> Lag:
    """Return a lag by the keys that a file has."""
    return Lag(lag, lead)


# --- undone on an even clock ---


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


def _recursion(section: Section, dt: float) -> tuple[Floats, Floats, Floats]:
    """Return how u - p and q follow the output y of a section: matrix, drive, out.

    They become ``matrix @ numbers + drive * (y' - y)``, and u = y + ``out @ numbers``.
    """
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
    drive = np.array([left / by_drive, q_by_change / by_drive])
    return np.array([lead_row, rate_row]), drive, np.array([1.0 - by_lead, -by_q])


def _with_one(decay: float, drive: float, out: float) -> Floats:
    """Return the kernel's numbers of a recursion of one number."""
    return np.array([decay, 0.0, 0.0, 0.0, drive, 0.0, out, 0.0])


def section_inverse(section: Section, dt: float) -> SectionInverse:
    """Return the inverse of a section on an even clock of ``dt`` (s).

    Raises
    ------
    InputError
        The clock does not resolve the section; the message names the rate that does.
    """
    matrix, drive, out = recursion = _recursion(section, dt)
    if isinstance(section, Lag):
        numbers = _with_one(matrix[0, 0], drive[0], out[0])
        return SectionInverse(numbers, np.zeros(0), np.array([[1.0, 0.0], [0.0, 0.0]]))
    if section.highest * dt > HIGHEST_PART:
        raise _unresolved(section, dt)
    numbers = np.concatenate([matrix.reshape(-1), drive, out])
    half = 0.5 * (matrix[0, 0] + matrix[1, 1])
    det = float(np.linalg.det(matrix))
    root = half * half - det
    inner = outer = math.sqrt(abs(det))  # the size of both, where they are complex
    if root > 0.0:
        outer = half + math.copysign(math.sqrt(root), half)
        inner, outer = sorted([det / outer, outer], key=abs)
    if abs(outer) < 1.0 and section.antiresonance is not None:
        return SectionInverse(numbers, np.zeros(0), np.eye(2))
    if not abs(inner) < 1.0 < abs(outer):
        raise _unresolved(section, dt)
    count = math.ceil(math.log(LEFT_OVER) / -math.log(abs(outer)))
    if count > LONGEST_AHEAD:
        raise _unresolved(section, dt)
    inside_row, inside_drive = _eigenpart(recursion, inner)
    _, outside_drive = _eigenpart(recursion, outer)
    weight = -outside_drive * outer ** -np.arange(1.0, count + 1.0)
    numbers = _with_one(inner, inside_drive, 1.0)
    return SectionInverse(numbers, weight, np.array([inside_row, [0.0, 0.0]]))


def _eigenpart(
    recursion: tuple[Floats, Floats, Floats], zero: float
) -> tuple[Floats, float]:
    """Return the part of the inverse that belongs to one eigenvalue: as seen in the result, and its drive."""
    matrix, drive, out = recursion
    left_vector = np.array([matrix[1, 0], zero - matrix[0, 0]])
    right = np.array([matrix[0, 1], zero - matrix[0, 0]])
    row = left_vector * (float(out @ right) / float(left_vector @ right))
    return row, float(row @ drive)


def _unresolved(section: Resonance, dt: float) -> InputError:
    """Return the refusal of a clock that does not resolve a section, with the rate that does."""
    name = f"resonance at {section.frequency:.6g} Hz"
    if section.antiresonance is not None:
        name += f" with its antiresonance at {section.antiresonance.frequency:.6g} Hz"
    return InputError(
        f"the model's {name} is too fast to be undone at {1.0 / dt:.6g} Hz"
        f" (`resample` {6.0 * section.highest:.6g} or more)"
    )
