"""Dynamics behind the gears (beyond the paper): sections of unit gain in a row, and how they are undone.

A section is a resonance or a first-order lag.

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

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from typing import Any, ClassVar, NamedTuple

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.errors import InputError, ModelError
from dbo_cli.model import kernel
from dbo_cli.model.delay import BEFORE, Delay
from dbo_cli.model.fields import Keyed, above_0, listed, magnitude, notes, number
from dbo_cli.model.relaxation import checked_steps
from dbo_cli.model.state import Run, SectionStates, State, Undoing

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
    KEYS: ClassVar = {
        "frequency": above_0,
        "damping": partial(number, above=0.0, below=1.0),
    }


@dataclass(frozen=True)
class Resonance(Mode):
    """A second-order section, perhaps with an antiresonance (a ``Mode``) as numerator."""

    antiresonance: Mode | None = None
    KEYS: ClassVar = {**Mode.KEYS, "antiresonance": Mode.read}
    OPTIONAL: ClassVar = ("antiresonance",)

    @property
    def fade(self) -> float:
        """Seconds in which it dies away to 1/e."""
        return 1.0 / (2.0 * math.pi * self.frequency * self.damping)

    @property
    def output(self) -> tuple[float, float]:
        """What the numerator adds to p: parts of the lead u - p and of q (``dbo_section_output``)."""
        if self.antiresonance is None:
            return 0.0, 0.0
        ratio = self.frequency / self.antiresonance.frequency
        damping = self.antiresonance.damping - ratio * self.damping
        return ratio * ratio, 2.0 * ratio * damping

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
    lag : float
        tau in seconds, > 0.
    lead : float
        lambda in seconds, from 0 to less than tau.
    """

    lag: float
    lead: float = 0.0
    KEYS: ClassVar = {"lag": above_0, "lead": magnitude}
    OPTIONAL: ClassVar = ("lead",)

    def __post_init__(self) -> None:
        """Refuse a lead that is no lag, naming the key."""
        if self.lead >= self.lag:
            raise ModelError(
                f"lead: {self.lead!r} is not less than the lag of {self.lag!r} s"
            )

    @property
    def fade(self) -> float:
        """Seconds in which it dies away to 1/e."""
        return self.lag

    @property
    def output(self) -> tuple[float, float]:
        """What the numerator adds to p, as of ``Resonance``."""
        return self.lead / self.lag, 0.0

    def step(self, dt: Floats) -> Floats:
        """Return how p changes in each time step (s), as of ``Resonance``; a lag has no q."""
        none = np.zeros_like(dt)
        with np.errstate(divide="ignore", invalid="ignore"):
            lag_steps = np.where(dt > 0.0, self.lag / dt, np.inf)
            beta = np.minimum(LAG_ZERO, lag_steps)
            share = 1.0 / (1.0 + (lag_steps - beta))
        return np.array([none, share, share * (1.0 - beta), none, none, none])


Section = Resonance | Lag


def read_section(values: Any, path: str) -> Any:
    """Return the section that an object of a model file describes."""
    kind = Lag if "lag" in notes(values, path) else Resonance
    return kind.read(values, path)


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
    lag_part = 1.0 - p_by_change
    lead_row = [1.0 - p_by_lead + lag_part * from_lead, -p_by_q + lag_part * from_q]
    rate_row = [q_by_lead + q_by_change * from_lead, q_by_q + q_by_change * from_q]
    drive = np.array([lag_part / by_drive, q_by_change / by_drive])
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
    numbers = np.concatenate([matrix.reshape(-1), drive, out])
    half = 0.5 * (matrix[0, 0] + matrix[1, 1])
    det = float(np.linalg.det(matrix))
    root = half * half - det
    inner = outer = math.sqrt(abs(det))  # the size of both, where they are complex
    if root > 0.0:
        outer = half + math.copysign(math.sqrt(root), half)
        inner, outer = sorted([det / outer, outer], key=abs)
    highest = section.frequency
    if section.antiresonance is not None:
        highest = max(highest, section.antiresonance.frequency)
    refusal = InputError(
        f"the model's resonance at {section.frequency:.6g} Hz is too fast to be undone at {1.0 / dt:.6g} Hz "
        f"(`resample` {6.0 * highest:.6g} or more)"
    )
    if highest * dt > HIGHEST_PART:
        raise refusal
    if abs(outer) < 1.0 and section.antiresonance is not None:
        return SectionInverse(numbers, np.zeros(0), np.eye(2))
    count = math.inf
    if abs(inner) < 1.0 < abs(outer):
        count = math.ceil(math.log(LEFT_OVER) / -math.log(abs(outer)))
    if count > LONGEST_AHEAD:
        raise refusal
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


# --- the stage ---


@dataclass(frozen=True)
class Dynamics(Keyed):
    """Sections of unit gain one after the other.

    Parameters
    ----------
    sections : tuple of Resonance or Lag
        In the order in which a signal passes them.

    Raises
    ------
    ModelError
        There are no sections.
    """

    sections: tuple[Section, ...]
    KEYS: ClassVar = {"sections": partial(listed, read=read_section)}

    def __post_init__(self) -> None:
        """Refuse a stage without sections."""
        if not self.sections:
            raise ModelError("sections: is empty; leave the stage out instead")

    @cached_property
    def _output(self) -> Floats:
        return np.array([section.output for section in self.sections], dtype=np.float64)

    def run(self, x: Floats, state: State, dt: float | Floats) -> Run:
        """Return one block behind all sections, and the state with (p, q, u) of each section after it.

        Without them the stage is at rest at the first sample, whose time step (s) does
        not matter.
        """
        first = float(x[0])
        at_rest = ((first, 0.0, first),) * len(self.sections)
        memory = np.array(state.sections or at_rest, dtype=np.float64)
        y = np.empty(x.size)
        if isinstance(dt, np.ndarray):
            rows = _step_rows(self.sections, dt)
        else:
            rows = _even_row(self.sections, dt)
        signal = np.ascontiguousarray(x, dtype=np.float64)
        kernel.extension.dynamics_run(self._output, memory, signal, y, rows)
        return Run(y, replace(state, sections=as_states(memory)))

    def ahead(self, dt: float) -> int:
        """Return how many rows of an even clock ``undo`` reads ahead."""
        return sum(inverse.weight.size for inverse in inverses_of(self.sections, dt))

    def undo(
        self, y: Floats, memory: SectionStates, dt: float, ahead: int
    ) -> tuple[Floats, SectionStates]:
        """Return the input of all sections on an even clock, shorter by what this stage reads ahead.

        Parameters
        ----------
        y : array
            A block of the output and ``ahead`` rows of what follows it.
        memory : SectionStates
            As it comes back from the block before; without it the stage is at rest at
            the first row.
        """
        inverses = inverses_of(self.sections, dt)
        memories = list(memory or [(float(y[0]), 0.0, 0.0)] * len(inverses))
        count = y.size - ahead
        undo = kernel.extension.dynamics_undo
        signal = np.ascontiguousarray(y)
        for index, inverse in reversed(list(enumerate(inverses))):
            numbers, weight = inverse.numbers, inverse.weight
            values = np.array(memories[index])
            u = np.empty(signal.size - weight.size)
            undo(numbers, weight, values, signal[: count + weight.size], u[:count])
            memories[index] = tuple(values.tolist())
            # what the next section reads ahead, without going on from there
            if u.size > count:
                undo(numbers, weight, values, signal[count:], u[count:])
            signal = u
        return signal, tuple(memories)

    def undoing_behind(self, sections: SectionStates, dt: float) -> SectionStates:
        """Return what ``undo`` remembers where the forward sections are in a state."""
        memories = []
        each = zip(inverses_of(self.sections, dt), sections, self.sections, strict=True)
        for inverse, (p, q, u), section in each:
            by_lead, by_q = section.output
            a, b = (inverse.from_state @ np.array([u - p, q])).tolist()
            memories.append((p + (by_lead * (u - p) + by_q * q), a, b))
        return tuple(memories)

    def loop(self, x: Floats, dt: float) -> Floats:
        """Return one period behind all sections when it has been repeated for ever."""

        def run(x: Floats, states: SectionStates) -> tuple[Floats, SectionStates]:
            after = self.run(x, State(sections=states), dt)
            return after.y, after.state.sections or states

        return repeated(run, x, len(self.sections))

    def identity(self) -> list[object]:
        """Return what a state of the stage refers to."""
        sections = [dataclasses.asdict(section) for section in self.sections]
        for section in sections:
            if "lag" in section:
                section["seconds"] = section.pop("lag")  # its name in a digest
        return [sections]


def _step_rows(sections: tuple[Section, ...], dt: Any) -> Floats:
    """Return the kernel's numbers, six for each section, in a row for each time step (s)."""
    steps = checked_steps(dt)
    rows = np.vstack([section.step(steps) for section in sections])
    return np.ascontiguousarray(rows.T)


# of one time step; every block of a stream asks for it
_even_row = lru_cache(maxsize=32)(_step_rows)


@lru_cache(maxsize=32)
def inverses_of(sections: tuple[Section, ...], dt: float) -> tuple[SectionInverse, ...]:
    """Return the inverse of each section on an even clock of ``dt`` (s), once for all blocks.

    Raises
    ------
    InputError
        The clock does not resolve a section.
    """
    return tuple(section_inverse(section, dt) for section in sections)


def as_states(memories: Floats) -> SectionStates:
    """Return rows of three numbers as tuples."""
    return tuple((float(a), float(b), float(c)) for a, b, c in memories)


def repeated(
    run: Callable[[Floats, SectionStates], tuple[Floats, SectionStates]],
    period: Floats,
    sections: int,
) -> Floats:
    """Return what ``run`` makes of a period that is repeated for ever.

    The state of all sections after a period is linear in that before it: the state that
    stays solves as many equations as it has numbers.
    """

    def after(numbers: Floats) -> tuple[Floats, Floats]:
        y, states = run(period, as_states(numbers.reshape(sections, 3)))
        return y, np.array(states).reshape(-1)

    base = after(np.zeros(3 * sections))[1]
    unit = np.eye(3 * sections)
    columns = np.column_stack([after(row)[1] - base for row in unit])
    start = np.asarray(np.linalg.solve(unit - columns, base), dtype=np.float64)
    return after(start)[0]


class Inverter:
    """Undoes dynamics and a delay on an even clock of ``dt`` (s), reading ahead by ``ahead`` samples.

    Attributes
    ----------
    ahead : int
        Rows of what follows that both read.

    Raises
    ------
    InputError
        The clock does not resolve a section.
    """

    def __init__(
        self, dynamics: Dynamics | None, delay: Delay | None, dt: float
    ) -> None:
        self.dt = dt
        self.dynamics = dynamics
        self.delay = delay
        self._ahead_of_dynamics = 0 if dynamics is None else dynamics.ahead(dt)
        self.ahead = self._ahead_of_dynamics + (0 if delay is None else delay.ahead(dt))

    def run(
        self, desired: Floats, undoing: Undoing | None = None
    ) -> tuple[Floats, Undoing | None]:
        """Return what the static part must reach for a displacement, and what comes next goes on from.

        Parameters
        ----------
        desired : array
            A block and ``ahead`` samples of what follows it.
        undoing : Undoing, or None
            From the block before, or ``behind``; None: at rest at the first value.
        """
        if self.dynamics is None and self.delay is None:
            return desired, None
        memory: SectionStates = ()
        past: tuple[float, ...] = ()
        if undoing is not None and undoing[0] == self.dt:
            _, memory, past = undoing
        signal, dt = desired, self.dt
        if self.delay is not None:
            signal, past = self.delay.undo(signal, past, dt, self.ahead)
        if self.dynamics is not None:
            ahead = self._ahead_of_dynamics
            signal, memory = self.dynamics.undo(signal, memory, dt, ahead)
        return signal, (dt, memory, past)

    def behind(self, state: State) -> Undoing | None:
        """Return what ``run`` goes on from behind a state; None where nothing is known of it."""
        if state.undoing is not None and state.undoing[0] == self.dt:
            return state.undoing
        if self.dynamics is None or state.sections is None:
            return None
        return self.dt, self.dynamics.undoing_behind(state.sections, self.dt), ()

    def loop(self, desired: Floats) -> Floats:
        """Return what ``run`` does, for one period of a displacement that repeats for ever."""
        period = np.pad(desired, (0, self.ahead), mode="wrap")
        past = () if self.delay is None else tuple(desired[-BEFORE:].tolist())
        if self.dynamics is None:
            return self.run(period, (self.dt, (), past))[0]

        def undo(y: Floats, states: SectionStates) -> tuple[Floats, SectionStates]:
            target, undoing = self.run(y, (self.dt, states, past))
            return target, undoing[1] if undoing else states

        return repeated(undo, period, len(self.dynamics.sections))
