"""Dynamics behind the gears (beyond the paper): sections of unit gain in a row, and how they are undone."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from typing import ClassVar

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.errors import ModelError
from dbo_cli.model import kernel
from dbo_cli.model.delay import Delay
from dbo_cli.model.fields import Keyed, listed
from dbo_cli.model.relaxation import checked_steps
from dbo_cli.model.sections import (
    Resonance,
    Section,
    SectionInverse,
    read_section,
    section_inverse,
)
from dbo_cli.model.state import Run, SectionStates, State, Undoing


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
    needs_time: ClassVar[bool] = True
    KEYS: ClassVar = {"sections": partial(listed, read=read_section)}

    def __post_init__(self) -> None:
        """Refuse a stage without sections."""
        if not self.sections:
            raise ModelError("sections: is empty; leave the stage out instead")

    @cached_property
    def _output(self) -> Floats:
        return np.array([section.output for section in self.sections], dtype=np.float64)

    @property
    def resonances(self) -> tuple[Resonance, ...]:
        """The second-order sections, lowest first."""
        sections = [each for each in self.sections if isinstance(each, Resonance)]
        return tuple(sorted(sections, key=lambda section: section.frequency))

    def run(self, x: Floats, state: State, dt: float | Floats) -> Run:
        """Return one block behind all sections, and the state with (p, q, u) of each section after it.

        Without them the stage is at rest at the first sample, whose time step (s) does
        not matter.
        """
        if x.size == 0:
            return Run(x, state)
        first = float(x[0])
        at_rest = ((first, 0.0, first),) * len(self.sections)
        memory = np.array(state.sections or at_rest, dtype=np.float64)
        y = np.empty(x.size)
        if isinstance(dt, np.ndarray):
            rows = _step_rows(self.sections, checked_steps(dt))
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
            output = section.output
            a, b = (inverse.from_state @ np.array([u - p, q])).tolist()
            memories.append((p + (output.by_lead * (u - p) + output.by_q * q), a, b))
        return tuple(memories)

    def loop(self, x: Floats, dt: float) -> Floats:
        """Return one period behind all sections when it has been repeated for ever."""

        def run(x: Floats, states: SectionStates) -> tuple[Floats, SectionStates]:
            after = self.run(x, State(sections=states), dt)
            return after.y, after.state.sections or states

        return repeated(run, x, len(self.sections))

    def undo_loop(self, y: Floats, dt: float) -> Floats:
        """Return what ``undo`` does, for one period of a signal that repeats for ever."""
        ahead = self.ahead(dt)

        def undo(y: Floats, states: SectionStates) -> tuple[Floats, SectionStates]:
            return self.undo(y, states, dt, ahead)

        return repeated(undo, np.pad(y, (0, ahead), mode="wrap"), len(self.sections))

    def identity(self) -> list[object]:
        """Return what a state of the stage refers to."""
        return [[dataclasses.asdict(section) for section in self.sections]]


def _step_rows(sections: tuple[Section, ...], steps: Floats) -> Floats:
    """Return the kernel's numbers, six for each section, in a row for each time step (s)."""
    rows = np.vstack([section.step(steps) for section in sections])
    return np.ascontiguousarray(rows.T)


@lru_cache(maxsize=32)
def _even_row(sections: tuple[Section, ...], dt: float) -> Floats:
    """Return ``_step_rows`` of one step; every block of a stream asks for it."""
    return _step_rows(sections, checked_steps(dt))


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
        for stage in (self.delay, self.dynamics):
            if stage is not None:
                desired = stage.undo_loop(desired, self.dt)
        return desired
