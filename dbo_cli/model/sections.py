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
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbo_cli.arrays import Floats
from dbo_cli.errors import ModelError
from dbo_cli.model.fields import Keyed, build, notes, number, require_above_0

Complexes = NDArray[np.complexfloating]

LAG_ZERO = 0.4
"""b of a lag, see above: between ringing of the inverse and error of the amplitude."""
# radians of the resonance a step, below which responses are summed as series: no
# cancellation
_SERIES = 1.0
_TERMS = 24  # of the series; the last is below 1e-20 of the first at one radian


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

    def polynomial(self, frequency: Floats) -> Complexes:
        """Return its value at s = 2 pi i f, for frequencies in Hz."""
        s = 1j * frequency / self.frequency
        value: Complexes = 1.0 + 2.0 * self.damping * s + s * s
        return value


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

    def response(self, frequency: Floats) -> Complexes:
        """Return G(2 pi i f) for frequencies in Hz."""
        gain: Complexes = 1.0 / self.polynomial(frequency)
        if self.antiresonance is not None:
            gain = gain * self.antiresonance.polynomial(frequency)
        return gain


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
