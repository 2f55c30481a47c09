"""The dynamics stage of a model: sections one after the other, block by block, and what undoes them.

The sections and the mathematics are in ``linear_sections``. Beside them a zero-phase low-pass, which reads
ahead as the inverse does: it rounds the corners of a trajectory and bounds what is learned.
"""

from __future__ import annotations

import cmath
import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from dbo_cli.errors import InputError, ModelError, UsageError
from dbo_cli.hysteresis import kernel
from dbo_cli.hysteresis.linear_sections import (
    Antiresonance,
    Complexes,
    Floats,
    Lag,
    Resonance,
    Section,
    SectionInverse,
    section_inverse,
)

__all__ = [
    "Antiresonance",
    "DynamicsInverter",
    "DynamicsStage",
    "InverseMemory",
    "Lag",
    "Resonance",
    "Section",
]

Payload = TypeVar("Payload")
SectionStates = tuple[tuple[float, float, float], ...]

LEFT_OVER = 1e-10  # of a low-pass's weight in the middle, at which its weights are cut off
LONGEST_REACH = 20_000  # samples of a low-pass on either side; the work of a sample grows with them


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
        found = [section for section in self.sections if isinstance(section, Resonance)]
        return tuple(sorted(found, key=lambda section: section.frequency))

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
        steps = np.asarray(time_step, dtype=np.float64).reshape(-1)
        if not np.all(steps >= 0.0):
            k = int(np.flatnonzero(~(steps >= 0.0))[0])
            raise InputError(f"time step {k + 1}: {float(steps[k])!r} s; time must not go backwards")
        parts = [section.step(steps) for section in self.sections]
        return np.ascontiguousarray(np.concatenate(parts, axis=1))

    def rest(self, value: float) -> SectionStates:
        """Return the state after a long rest at ``value``."""
        return ((value, 0.0, value),) * len(self.sections)

    def run(
        self, x: Floats, time_step: float | Floats, state: SectionStates | None
    ) -> tuple[Floats, SectionStates | None]:
        """Return one block after the forward stage, and (p, q, u) of each section after it.

        Without a state the stage is at rest at the first sample, whose time step does not matter.
        """
        if x.size == 0:
            return x, state
        held = np.array(self.rest(float(x[0])) if state is None else state, dtype=np.float64)
        y = np.empty_like(x)
        kernel.CHOSEN.dynamics_run(self._output, held, np.ascontiguousarray(x), y, self.rows(time_step))
        return y, _as_states(held)

    def loop(self, x: Floats, time_step: float) -> tuple[Floats, SectionStates]:
        """Return one period after the forward stage when it has been repeated for ever, and the state then.

        What a state before the period adds to that after it is linear: the state that a period leaves
        unchanged solves two equations.
        """
        signal, states = np.ascontiguousarray(x), []
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


def _loop_of(stage: DynamicsStage, x: Floats, time_step: float) -> tuple[Floats, tuple[float, float, float]]:
    """Return what ``DynamicsStage.loop`` does, for a stage of one section."""

    def after(p: float, q: float) -> tuple[Floats, SectionStates]:
        y, state = stage.run(x, time_step, ((p, q, float(x[-1])),))
        assert state is not None
        return y, state

    def ends(p: float, q: float) -> tuple[float, float]:
        return after(p, q)[1][0][:2]

    y, state = after(*_fixed_point(ends))
    return y, state[0]


def _undone_loop_of(part: SectionInverse, y: Floats) -> Floats:
    """Return what ``DynamicsInverter.loop`` does, for one section."""
    wrapped = np.pad(y, (0, part.weight.size), mode="wrap")

    def after(a: float, b: float) -> tuple[Floats, Floats]:
        held, u = np.array([y[-1], a, b]), np.empty(y.size)
        kernel.CHOSEN.dynamics_undo(part.numbers, part.weight, held, wrapped, u)
        return u, held

    def ends(a: float, b: float) -> tuple[float, float]:
        held = after(a, b)[1]
        return float(held[1]), float(held[2])

    return after(*_fixed_point(ends))[0]


def _fixed_point(after: Callable[[float, float], tuple[float, float]]) -> tuple[float, float]:
    """Return the two numbers that an affine map leaves unchanged."""
    base = np.array(after(0.0, 0.0))
    columns = [np.array(after(1.0, 0.0)) - base, np.array(after(0.0, 1.0)) - base]
    first, second = np.linalg.solve(np.eye(2) - np.column_stack(columns), base).tolist()
    return first, second


def _as_states(held: Floats) -> SectionStates:
    return tuple((float(a), float(b), float(c)) for a, b, c in held)


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
        self.stage, self.time_step = stage, time_step
        self.parts = [section_inverse(section, time_step) for section in stage.sections]
        self.ahead = sum(part.weight.size for part in self.parts)

    def rest(self, value: float) -> InverseMemory:
        """Return the memory after a long rest at ``value``."""
        return InverseMemory(self.time_step, ((value, 0.0, 0.0),) * len(self.parts))

    def memory_of(self, states: SectionStates) -> InverseMemory:
        """Return the memory with which the inverse goes on from a state of the forward stage."""
        found = []
        for part, (p, q, u), section in zip(self.parts, states, self.stage.sections, strict=True):
            by_lead, by_q = section.output
            a, b = (part.from_state @ np.array([u - p, q])).tolist()
            found.append((p + (by_lead * (u - p) + by_q * q), a, b))
        return InverseMemory(self.time_step, tuple(found))

    def run(self, y: Floats, memory: InverseMemory) -> tuple[Floats, InverseMemory]:
        """Return the input for all but the last ``ahead`` samples of an output, and the memory after them."""
        count, signal = y.size - self.ahead, np.ascontiguousarray(y)
        states = list(memory.states)
        for k in range(len(self.parts) - 1, -1, -1):
            part = self.parts[k]
            held, out = np.array(states[k]), np.empty(signal.size - part.weight.size)
            kernel.CHOSEN.dynamics_undo(part.numbers, part.weight, held, signal[: count + part.weight.size],
                                        out[:count])  # fmt: skip
            states[k] = (float(held[0]), float(held[1]), float(held[2]))
            if out.size > count:  # what the next section reads ahead, without going on from there
                kernel.CHOSEN.dynamics_undo(part.numbers, part.weight, held, signal[count:], out[count:])
            signal = out
        return signal, InverseMemory(self.time_step, tuple(states))

    def loop(self, y: Floats) -> Floats:
        """Return the input of one period of an output that is repeated for ever."""
        signal = np.ascontiguousarray(y)
        for part in reversed(self.parts):
            signal = _undone_loop_of(part, signal)
        return signal


def with_future(blocks: Iterable[tuple[Payload, Floats]], ahead: int) -> Iterator[tuple[Payload, Floats]]:
    """Yield each block with ``ahead`` samples of those after it; at the end the last value holds."""
    waiting: deque[tuple[Payload, Floats]] = deque()
    known = 0
    for block in chain(blocks, [None]):
        if block is None:
            if waiting:
                held = np.full(ahead, waiting[-1][1][-1])
                values = np.concatenate([*(part for _, part in waiting), held])
                for payload, part in waiting:
                    yield payload, values[: part.size + ahead]
                    values = values[part.size :]
            return
        if block[1].size:
            waiting.append(block)
            known += block[1].size
        while waiting and known - waiting[0][1].size >= ahead:
            values = np.concatenate([part for _, part in waiting])
            payload, part = waiting.popleft()
            known -= part.size
            yield payload, values[: part.size + ahead]


def undone(
    blocks: Iterable[tuple[Payload, Floats]], inverter: DynamicsInverter, memory: InverseMemory | None = None
) -> Iterator[tuple[Payload, Floats, InverseMemory]]:
    """Undo a stage block by block: (payload, input of the stage, memory after the block).

    Before the first sample the first value holds, after the last one the last. The bits do not depend on how
    the signal is cut into blocks; empty blocks are dropped.
    """
    for payload, values in with_future(blocks, inverter.ahead):
        held = inverter.rest(float(values[0])) if memory is None else memory
        u, memory = inverter.run(values, held)
        yield payload, u, memory


class ZeroPhaseLowPass:
    """A symmetric low-pass of gain 1/(1 + (f/f_c)^2n): a Butterworth filter of order n, run both ways.

    Its weights are the two-sided impulse response, the sum over the stable poles s of Re(-s e^(s|t|)), taken
    at the samples and made to add up to 1. A constant comes through unchanged, to the last bit. Of order 2
    nothing overshoots a step by more than 3.4 % of it.

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
        The cut-off is above half the sampling rate, or so low that a sample would need 20,000 neighbours.
    """

    def __init__(self, cutoff: float, time_step: float, order: int = 2) -> None:
        rate = 1.0 / time_step
        if not 0.0 < cutoff <= 0.5 * rate:
            raise UsageError(
                f"`bandwidth` {cutoff:g}: above half the sampling rate of {rate:.6g} Hz (at most "
                f"{0.5 * rate:.6g})"
            )
        angles = [math.pi * (2 * k + 1 + order) / (2 * order) for k in range(order // 2)]
        poles = [2.0 * math.pi * cutoff * time_step * cmath.exp(1j * angle) for angle in angles]
        self.reach = math.ceil(math.log(LEFT_OVER) / max(pole.real for pole in poles))
        if self.reach > LONGEST_REACH:
            lowest = cutoff * self.reach / LONGEST_REACH
            raise UsageError(
                f"`bandwidth` {cutoff:g}: too low for a sampling rate of {rate:.6g} Hz (at least "
                f"{lowest:.3g}, or `resample` at a lower rate)"
            )
        at, middle = np.arange(1.0, self.reach + 1.0), -sum(pole.real for pole in poles)
        weight = sum(((-pole * np.exp(pole * at)).real for pole in poles), np.zeros(self.reach)) / middle
        self.cutoff, self.weight = cutoff, weight / (1.0 + 2.0 * math.fsum(weight.tolist()))

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

    def blocks(self, blocks: Iterable[tuple[Payload, Floats]]) -> Iterator[tuple[Payload, Floats]]:
        """Smooth a signal block by block; the bits do not depend on how it is cut. See ``whole``."""
        past: Floats | None = None
        for payload, values in with_future(blocks, self.reach):
            if past is None:
                past = np.full(self.reach, values[0])
            known = np.concatenate([past, values])
            count = values.size - self.reach
            yield payload, self.run(known)
            past = known[count : count + self.reach]
