"""The dynamics stage of a model: sections one after the other, and their exact inverses (beyond the paper).

What moves is a mass on springs behind an amplifier. Sections of unit gain follow one
another: resonances, 1/(1 + 2ζs/ω + s²/ω²), each perhaps with an antiresonance as
numerator, and first-order lags.

A resonance is discretised with a first-order hold: exact for an input that is straight
between samples, for any time between them. In p, the output of 1/(1 + 2ζs/ω + s²/ω²),
and q, its rate over ω, one sample changes p by p_by_q q + S (u - p) + R (u' - u), where
u and u' are the input before and now, S the step response after one time step and R the
response to a ramp. A rest, u = p and q = 0, stays a rest to the last bit. A first-order
hold of a lag has its zero near -1, whose inverse rings for ever. With δ = 1 - 1/z the
lag is taken as (1 - βδ)/(1 + (τ/Δt - β)δ): late by τ at any rate, its zero at -β/(1 -
β), -2/3 here, its error in amplitude, (1/2 - β) τΔtω², a fifth of the backward
difference's (β = 0).

The inverse. With the output given, u - p and q follow a recursion of two eigenvalues,
the zeros of the discretised section. For a resonance one lies near -0.268 and is run
forward; the other near -3.73 and is run backward, as a sum over the next samples. Both
are driven by differences of the signal alone, so that the inverse of a rest is the same
rest. The zeros of an antiresonance are both inside, and run forward.

Beside them a zero-phase low-pass, which reads ahead as the inverse does: it rounds the
corners of a trajectory and bounds what is learned.
"""

from __future__ import annotations

import cmath
import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import chain
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dbo_cli.errors import InputError, ModelError, UsageError
from dbo_cli.hysteresis import kernel
from dbo_cli.hysteresis.operators import checked_steps

Floats = NDArray[np.float64]
Complexes = NDArray[np.complexfloating]
Payload = TypeVar("Payload")
SectionStates = tuple[tuple[float, float, float], ...]

FEWEST_SAMPLES = 3.0
"""Samples a period of the resonance from which on the inverse is taken. Measured: docs/choices.md."""
LEFT_OVER = 1e-17  # of the whole sum over the future: less than rounding does to it
# samples; beyond, the zero is so near the unit circle that the inverse rings
LONGEST_AHEAD = 2000
LAG_ZERO = 0.4
"""β of a lag, see above. Measured: docs/choices.md."""
# radians of the resonance a step, below which responses are summed as series: no
# cancellation
_SERIES = 1.0
_TERMS = 24  # of the series; the last is below 1e-20 of the first at one radian
# of a low-pass's weight in the middle, at which its weights are cut off
LOW_PASS_LEFT_OVER = 1e-10
# samples of a low-pass on either side; the work of a sample grows with them
LONGEST_REACH = 20_000


def _positive(key: str, value: float, most: float = math.inf) -> None:
    """Refuse a number that is not between 0 and ``most``, naming the key."""
    if not (math.isfinite(value) and 0.0 < value < most):
        bound = "greater than 0"
        if most < math.inf:
            bound = f"between 0 and {most:g}"
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
        if self.antiresonance is None:
            return self.frequency
        return max(self.frequency, self.antiresonance.frequency)

    @property
    def output(self) -> tuple[float, float]:
        """The parts of u - p and of q that the numerator adds to p."""
        if self.antiresonance is None:
            return 0.0, 0.0
        ratio = self.frequency / self.antiresonance.frequency
        damping = self.antiresonance.damping - ratio * self.damping
        return ratio * ratio, 2.0 * ratio * damping

    def step(self, time_step: Floats) -> Floats:
        """Return the kernel's six numbers for each time step (s): what p and q change by."""
        angle = 2.0 * math.pi * self.frequency * time_step
        zeta = self.damping
        if angle.size == 1 and 0.0 < angle[0] < _SERIES:
            return _even_step(angle.item(), zeta)
        sine, cosine = _turned(angle, zeta)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            step = np.where(
                angle < _SERIES, _series(angle, zeta, 0), 1.0 - (cosine + zeta * sine)
            )
            ramp = np.where(
                angle < _SERIES,
                _series(angle, zeta, 1),
                1.0 - (2.0 * zeta * step + sine) / angle,
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


def _turned(angle: Floats, zeta: float) -> tuple[Floats, Floats]:
    """Return sine and cosine of a decaying turn, the sine over the root of 1 - zeta squared."""
    root = math.sqrt(1.0 - zeta * zeta)
    fade = np.exp(-zeta * angle)
    return fade * np.sin(root * angle) / root, fade * np.cos(root * angle)


@lru_cache(maxsize=16)  # a fit changes one resonance at a time, and has but a few
def _even_step(angle: float, zeta: float) -> Floats:
    """Return ``Resonance.step`` of a single time step, in plain numbers: the same bits."""
    sines, cosines = _turned(np.array([angle]), zeta)
    sine, cosine = sines.item(), cosines.item()
    step = _series(angle, zeta, 0)
    ramp = _series(angle, zeta, 1)
    return np.array([[sine, step, ramp, cosine - zeta * sine, sine, step / angle]])


def _series(angle: Any, zeta: float, order: int) -> Any:
    """Return p after an input that rises from 0 to 1 at once (``order`` 0) or evenly (1), as a power series.

    p'' + 2ζp' + p = input in units of 1/ω; the terms d_n = c_n angleⁿ follow from the
    two before.
    """
    squared = angle * angle
    before = now = total = 0.0 * squared  # d_0 and d_1
    plain = isinstance(angle, float)
    for n in range(_TERMS):
        forcing = squared if n == order else 0.0
        following = (
            forcing - 2.0 * zeta * (n + 1) * angle * now - squared * before
        ) / ((n + 2) * (n + 1))
        # Where two terms change nothing, no later one does: each is less than the
        # larger of the two before.
        if plain and n > order and total + now == total == total + following:
            break
        total = total + following
        before, now = now, following
    return total


def latency_text(seconds: float) -> str:
    """Return a delay or a lag as it is said: in ms below a second, in s from there on."""
    if abs(seconds) < 1.0:
        return f"{1e3 * seconds:.3g} ms"
    return f"{seconds:.3g} s"


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
            raise ModelError(
                f"lead: {self.lead!r} is not from 0 to less than the lag of {self.seconds!r} s"
            )

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
        return (1.0 + turn * self.lead) / (1.0 + turn * self.seconds)


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
    p_q, p_lead, p_change, q_q, q_lead, q_change = section.step(np.array([time_step]))[
        0
    ].tolist()
    by_lead, by_q = section.output
    by_drive = (1.0 - by_lead) * p_change + by_lead + by_q * q_change
    # The change of the input that gives a wanted change of the output, by u - p, q and
    # that change:
    from_lead = -((1.0 - by_lead) * p_lead + by_q * q_lead) / by_drive
    from_q = -((1.0 - by_lead) * p_q + by_q * (q_q - 1.0)) / by_drive
    matrix = np.array(
        [
            [
                1.0 - p_lead + (1.0 - p_change) * from_lead,
                -p_q + (1.0 - p_change) * from_q,
            ],
            [q_lead + q_change * from_lead, q_q + q_change * from_q],
        ]
    )
    drive = np.array([(1.0 - p_change) / by_drive, q_change / by_drive])
    out = np.array([1.0 - by_lead, -by_q])
    if isinstance(section, Lag):
        numbers = np.array([matrix[0, 0], 0.0, 0.0, 0.0, drive[0], 0.0, out[0], 0.0])
        return SectionInverse(numbers, np.zeros(0), np.array([[1.0, 0.0], [0.0, 0.0]]))
    half = 0.5 * (matrix[0, 0] + matrix[1, 1])
    det = float(np.linalg.det(matrix))
    root = half * half - det
    if root <= 0.0:
        return _forward_only(section, time_step, matrix, drive, out, math.sqrt(det))
    far = half + math.copysign(math.sqrt(root), half)
    zeros = sorted([det / far, far], key=abs)
    if abs(zeros[1]) < 1.0:
        return _forward_only(section, time_step, matrix, drive, out, abs(zeros[1]))
    if section.frequency * time_step * FEWEST_SAMPLES > 1.0 or abs(zeros[0]) >= 1.0:
        raise _unresolved(section, time_step)
    inside = _mode(matrix, drive, out, zeros[0])
    outside = _mode(matrix, drive, out, zeros[1])
    count = math.ceil(math.log(LEFT_OVER) / -math.log(abs(zeros[1])))
    if count > LONGEST_AHEAD:
        raise _unresolved(section, time_step)
    weight = -outside[1] * zeros[1] ** -np.arange(1.0, count + 1.0)
    numbers = np.array([zeros[0], 0.0, 0.0, 0.0, inside[1], 0.0, 1.0, 0.0])
    return SectionInverse(numbers, weight, np.array([inside[0], [0.0, 0.0]]))


def _mode(
    matrix: Floats, drive: Floats, out: Floats, zero: float
) -> tuple[Floats, float]:
    """Return the part of the inverse that belongs to one eigenvalue: as seen in the result, and its drive."""
    left = np.array([matrix[1, 0], zero - matrix[0, 0]])
    right = np.array([matrix[0, 1], zero - matrix[0, 0]])
    output_row = left * (float(out @ right) / float(left @ right))
    return output_row, float(output_row @ drive)


def _forward_only(
    section: Resonance,
    time_step: float,
    matrix: Floats,
    drive: Floats,
    out: Floats,
    largest: float,
) -> SectionInverse:
    """Return an inverse without a look ahead: both zeros are inside the unit circle."""
    if not largest < 1.0 or section.antiresonance is None:
        raise _unresolved(section, time_step)
    numbers = np.concatenate([matrix.reshape(-1), drive, out])
    return SectionInverse(numbers, np.zeros(0), np.eye(2))


def _unresolved(section: Resonance, time_step: float) -> InputError:
    """Return the refusal of a clock that does not resolve a section, with the rate that does."""
    name = f"resonance at {section.frequency:.6g} Hz"
    if section.antiresonance is not None:
        frequency = section.antiresonance.frequency
        name += f" with its antiresonance at {frequency:.6g} Hz"
    beyond = "above half" if section.highest * time_step >= 0.5 else "too high for"
    return InputError(
        f"the model's {name} is {beyond} the sampling rate of {1.0 / time_step:.6g} Hz, "
        f"so its inverse is not to be had there (`resample` {6.0 * section.highest:.6g} or more)"
    )


@dataclass(frozen=True)
class InverseMemory:
    """What the inverse of the dynamics remembers, on a clock of ``time_step`` (s)."""

    time_step: float
    states: SectionStates


@dataclass(frozen=True)
class DynamicsStage:
    """Sections of unit gain one after the other; in an inverse model, what undoes them.

    Parameters
    ----------
    sections : tuple of Resonance or Lag
        In the order in which a forward signal passes them.
    inverted : bool
        Whether the stage undoes them; the direction of a model tells.

    Raises
    ------
    ModelError
        There are no sections.
    """

    sections: tuple[Section, ...]
    inverted: bool = False

    def __post_init__(self) -> None:
        """Refuse a stage without sections."""
        if not self.sections:
            raise ModelError("sections: is empty; leave the stage out instead")

    def inverse(self) -> DynamicsStage:
        """Return the stage that undoes this one."""
        return replace(self, inverted=not self.inverted)

    @cached_property
    def _output(self) -> Floats:
        return np.array([section.output for section in self.sections], dtype=np.float64)

    @property
    def resonances(self) -> tuple[Resonance, ...]:
        """The second-order sections, lowest first."""
        resonances = [
            section for section in self.sections if isinstance(section, Resonance)
        ]
        return tuple(sorted(resonances, key=lambda section: section.frequency))

    def response(self, frequency: ArrayLike) -> Complexes:
        """Return G(2πif), the gain and phase of the forward stage, for frequencies in Hz."""
        at = np.asarray(frequency, dtype=np.float64)
        total: Complexes = np.ones(at.shape, dtype=np.complex128)
        for section in self.sections:
            total = total * section.response(at)
        return total

    def rows(self, time_step: float | Floats) -> Floats:
        """Return the kernel's numbers, a row for each time step (s) or a single one.

        Raises
        ------
        InputError
            A time step is negative or not a number.
        """
        steps = checked_steps(time_step)
        parts = [section.step(steps) for section in self.sections]
        return np.ascontiguousarray(np.concatenate(parts, axis=1))

    def rest(self, value: float) -> SectionStates:
        """Return the state after a long rest at ``value``."""
        return ((value, 0.0, value),) * len(self.sections)

    def run(
        self, x: Floats, time_step: float | Floats, state: SectionStates | None
    ) -> tuple[Floats, SectionStates | None]:
        """Return one block after the forward stage, and (p, q, u) of each section after it.

        Without a state the stage is at rest at the first sample, whose time step does
        not matter.
        """
        if x.size == 0:
            return x, state
        if state is None:
            state = self.rest(float(x[0]))
        memory = np.array(state, dtype=np.float64)
        y = np.empty_like(x)
        kernel.CHOSEN.dynamics_run(
            self._output, memory, np.ascontiguousarray(x), y, self.rows(time_step)
        )
        return y, _as_states(memory)

    def loop(self, x: Floats, time_step: float) -> tuple[Floats, SectionStates]:
        """Return one period after the forward stage when it has been repeated for ever, and the state then.

        What a state before the period adds to that after it is linear: the state that a
        period leaves unchanged solves two equations.
        """
        signal = np.ascontiguousarray(x)
        states = []
        for section in self.sections:
            signal, end = _loop_of(DynamicsStage((section,)), signal, time_step)
            states.append(end)
        return signal, tuple(states)

    def inverter(self, time_step: float) -> DynamicsInverter:
        """Return what undoes the stage on an even clock of ``time_step`` (s).

        Raises
        ------
        InputError
            The clock does not resolve a section.
        """
        return DynamicsInverter(self, time_step)


def _loop_of(
    stage: DynamicsStage, x: Floats, time_step: float
) -> tuple[Floats, tuple[float, float, float]]:
    """Return what ``DynamicsStage.loop`` does, for a stage of one section."""

    def after(p: float, q: float) -> tuple[Floats, Floats]:
        y, state = stage.run(x, time_step, ((p, q, float(x[-1])),))
        return y, np.array(state).reshape(-1)

    y, memory = _repeated(after, slice(0, 2))
    return y, _as_states(memory[np.newaxis])[0]


def _undone_loop_of(part: SectionInverse, y: Floats) -> Floats:
    """Return what ``DynamicsInverter.loop`` does, for one section."""
    wrapped = np.pad(y, (0, part.weight.size), mode="wrap")

    def after(a: float, b: float) -> tuple[Floats, Floats]:
        memory = np.array([y[-1], a, b])
        u = np.empty(y.size)
        kernel.CHOSEN.dynamics_undo(part.numbers, part.weight, memory, wrapped, u)
        return u, memory

    return _repeated(after, slice(1, 3))[0]


def _repeated(
    after: Callable[[float, float], tuple[Floats, Floats]], periodic: slice
) -> tuple[Floats, Floats]:
    """Return a period, and the state after it, from the two numbers of the state that it leaves unchanged."""
    base = after(0.0, 0.0)[1][periodic]
    by_first = after(1.0, 0.0)[1][periodic] - base
    by_second = after(0.0, 1.0)[1][periodic] - base
    columns = np.column_stack([by_first, by_second])
    first, second = np.linalg.solve(np.eye(2) - columns, base).tolist()
    return after(first, second)


def _as_states(memories: Floats) -> SectionStates:
    return tuple((float(a), float(b), float(c)) for a, b, c in memories)


class DynamicsInverter:
    """Undoes a dynamics stage on an even clock: its input from its output, read ahead by ``ahead`` samples.

    Parameters
    ----------
    stage : DynamicsStage
        What is undone.
    time_step : float
        Seconds between samples.

    Raises
    ------
    InputError
        The clock does not resolve a section.
    """

    def __init__(self, stage: DynamicsStage, time_step: float) -> None:
        if not time_step > 0.0:
            raise InputError(f"time step: {time_step!r} s is not greater than 0")
        self.stage = stage
        self.time_step = time_step
        self.parts = [section_inverse(section, time_step) for section in stage.sections]
        self.ahead = sum(part.weight.size for part in self.parts)

    def rest(self, value: float) -> InverseMemory:
        """Return the memory after a long rest at ``value``."""
        return InverseMemory(self.time_step, ((value, 0.0, 0.0),) * len(self.parts))

    def memory_of(self, states: SectionStates) -> InverseMemory:
        """Return the memory with which the inverse goes on from a state of the forward stage."""
        memories = []
        for part, (p, q, u), section in zip(
            self.parts, states, self.stage.sections, strict=True
        ):
            by_lead, by_q = section.output
            a, b = (part.from_state @ np.array([u - p, q])).tolist()
            memories.append((p + (by_lead * (u - p) + by_q * q), a, b))
        return InverseMemory(self.time_step, tuple(memories))

    def run(self, y: Floats, memory: InverseMemory) -> tuple[Floats, InverseMemory]:
        """Return the input for all but the last ``ahead`` samples of an output, and the memory after them."""
        count = y.size - self.ahead
        signal = np.ascontiguousarray(y)
        states = list(memory.states)
        for k, part in reversed(list(enumerate(self.parts))):
            numbers, weight = part.numbers, part.weight
            section = np.array(states[k])
            out = np.empty(signal.size - weight.size)
            kernel.CHOSEN.dynamics_undo(
                numbers, weight, section, signal[: count + weight.size], out[:count]
            )
            states[k] = (float(section[0]), float(section[1]), float(section[2]))
            # what the next section reads ahead, without going on from there
            if out.size > count:
                kernel.CHOSEN.dynamics_undo(
                    numbers, weight, section, signal[count:], out[count:]
                )
            signal = out
        return signal, InverseMemory(self.time_step, tuple(states))

    def loop(self, y: Floats) -> Floats:
        """Return the input of one period of an output that is repeated for ever."""
        signal = np.ascontiguousarray(y)
        for part in reversed(self.parts):
            signal = _undone_loop_of(part, signal)
        return signal


def with_future(
    blocks: Iterable[tuple[Payload, Floats]], ahead: int
) -> Iterator[tuple[Payload, Floats]]:
    """Yield each block with ``ahead`` samples of those after it; at the end the last value holds."""
    waiting: deque[tuple[Payload, int]] = deque()
    # of the blocks that wait, and what is known of those after them
    values = np.empty(0)
    for block in chain(blocks, [None]):
        if block is not None:
            payload, part = block
            if part.size:
                waiting.append((payload, part.size))
            values = np.concatenate([values, part])
        elif values.size:  # at the end
            values = np.concatenate([values, np.full(ahead, values[-1])])
        while waiting and values.size - waiting[0][1] >= ahead:
            payload, count = waiting.popleft()
            yield payload, values[: count + ahead]
            values = values[count:]


def undone(
    blocks: Iterable[tuple[Payload, Floats]],
    inverter: DynamicsInverter,
    memory: InverseMemory | None = None,
) -> Iterator[tuple[Payload, Floats, InverseMemory]]:
    """Undo a stage block by block: (payload, input of the stage, memory after the block).

    Before the first sample the first value holds, after the last one the last. The bits
    do not depend on how the signal is cut into blocks; empty blocks are dropped.
    """
    for payload, values in with_future(blocks, inverter.ahead):
        if memory is None:
            memory = inverter.rest(float(values[0]))
        u, memory = inverter.run(values, memory)
        yield payload, u, memory


class ZeroPhaseLowPass:
    """A symmetric low-pass of gain 1/(1 + (f/f_c)^2n): a Butterworth filter of order n, run both ways.

    Its weights are the two-sided impulse response, the sum over the stable poles s of
    Re(-s e^(s|t|)), taken at the samples and made to add up to 1. A constant comes
    through unchanged, to the last bit. Of order 2 nothing overshoots a step by more
    than 3.4 % of it.

    Parameters
    ----------
    cutoff : float
        f_c in Hz, where half of the amplitude is left.
    time_step : float
        Seconds between samples.
    order : int
        n, an even number.

    Raises
    ------
    UsageError
        The cut-off is above half the sampling rate, or so low that a sample would need
        20,000 neighbours.
    """

    def __init__(self, cutoff: float, time_step: float, order: int = 2) -> None:
        rate = 1.0 / time_step
        if not 0.0 < cutoff <= 0.5 * rate:
            raise UsageError(
                f"`bandwidth` {cutoff:g}: above half the sampling rate of {rate:.6g} Hz (at most "
                f"{0.5 * rate:.6g})"
            )
        turn = 2.0 * math.pi * cutoff * time_step
        poles = []
        for k in range(order // 2):
            angle = math.pi * (2 * k + 1 + order) / (2 * order)
            poles.append(turn * cmath.exp(1j * angle))
        self.reach = math.ceil(
            math.log(LOW_PASS_LEFT_OVER) / max(pole.real for pole in poles)
        )
        if self.reach > LONGEST_REACH:
            lowest = cutoff * self.reach / LONGEST_REACH
            raise UsageError(
                f"`bandwidth` {cutoff:g}: too low for a sampling rate of {rate:.6g} Hz (at least "
                f"{lowest:.3g}, or `resample` at a lower rate)"
            )
        samples = np.arange(1.0, self.reach + 1.0)
        middle = -sum(pole.real for pole in poles)
        response = np.zeros(self.reach)
        for pole in poles:
            response = response + (-pole * np.exp(pole * samples)).real
        weight = response / middle
        self.cutoff = cutoff
        self.weight = weight / (1.0 + 2.0 * math.fsum(weight.tolist()))

    def run(self, x: Floats) -> Floats:
        """Return all but the first and the last ``reach`` samples, smoothed."""
        y = np.empty(x.size - 2 * self.reach)
        kernel.CHOSEN.smooth(self.weight, np.ascontiguousarray(x), y)
        return y

    def whole(self, x: Floats) -> Floats:
        """Return a whole signal smoothed; the first and the last value hold beyond its ends."""
        return self.run(np.pad(x, self.reach, mode="edge"))

    def loop(self, x: Floats) -> Floats:
        """Return one period of a signal that repeats, smoothed."""
        return self.run(np.pad(x, self.reach, mode="wrap"))

    def blocks(
        self, blocks: Iterable[tuple[Payload, Floats]]
    ) -> Iterator[tuple[Payload, Floats]]:
        """Smooth a signal block by block; the bits do not depend on how it is cut. See ``whole``."""
        past: Floats | None = None
        for payload, values in with_future(blocks, self.reach):
            if past is None:
                past = np.full(self.reach, values[0])
            known = np.concatenate([past, values])
            count = values.size - self.reach
            yield payload, self.run(known)
            past = known[count : count + self.reach]
