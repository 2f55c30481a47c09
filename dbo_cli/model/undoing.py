"""Dynamics and delay undone on an even clock, reading ahead.

With the output of a section given, u - p and q follow a recursion of two eigenvalues,
the zeros of the discretised section. For a resonance one lies near -0.268 and is run
forward; the other near -3.73 and is run backward, as a sum over the next samples. Both
are driven by differences of the signal alone, so that the inverse of a rest is the same
rest. The zeros of an antiresonance are both inside, and run forward.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Iterator
from itertools import chain
from typing import NamedTuple, TypeVar

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.errors import InputError
from dbo_cli.model import kernel
from dbo_cli.model.delay import BEFORE, Delay
from dbo_cli.model.dynamics import (
    Dynamics,
    Lag,
    Resonance,
    Section,
    repeated,
)
from dbo_cli.model.state import SectionStates, State, Undoing

Payload = TypeVar("Payload")

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
        See ``dbo_section_inverse``.
    weight : array
        Of the changes of the signal 1, 2, ... samples ahead.
    from_state : array of shape (2, 2)
        What the recursion remembers, from (u - p, q) of the forward section.
    """

    numbers: Floats
    weight: Floats
    from_state: Floats


# how (u - p, q) follows the output y: it becomes matrix @ it + drive (y' - y), and
# u = y + out @ it
_Recursion = tuple[Floats, Floats, Floats]


def _recursion(section: Section, dt: float) -> _Recursion:
    """Return how u - p and q follow a given output of a section."""
    row = section.step(np.array([dt]))[0].tolist()
    p_q, p_lead, p_change, q_q, q_lead, q_change = row
    by_lead, by_q = section.output
    by_drive = (1.0 - by_lead) * p_change + by_lead + by_q * q_change
    # the change of the input that gives a wanted change of the output, by u - p and q
    from_lead = -((1.0 - by_lead) * p_lead + by_q * q_lead) / by_drive
    from_q = -((1.0 - by_lead) * p_q + by_q * (q_q - 1.0)) / by_drive
    lead_row = [1.0 - p_lead + (1.0 - p_change) * from_lead]
    lead_row.append(-p_q + (1.0 - p_change) * from_q)
    rate_row = [q_lead + q_change * from_lead, q_q + q_change * from_q]
    drive = np.array([(1.0 - p_change) / by_drive, q_change / by_drive])
    out = np.array([1.0 - by_lead, -by_q])
    return np.array([lead_row, rate_row]), drive, out


def section_inverse(section: Section, dt: float) -> SectionInverse:
    """Return the inverse of a section on an even clock of ``dt`` (s).

    Raises
    ------
    InputError
        The clock does not resolve the section; the message names the rate that does.
    """
    recursion = _recursion(section, dt)
    matrix, drive, out = recursion
    if isinstance(section, Lag):
        numbers = np.array([matrix[0, 0], 0.0, 0.0, 0.0, drive[0], 0.0, out[0], 0.0])
        return SectionInverse(numbers, np.zeros(0), np.array([[1.0, 0.0], [0.0, 0.0]]))
    if section.highest * dt > HIGHEST_PART:
        raise _unresolved(section, dt)
    half = 0.5 * (matrix[0, 0] + matrix[1, 1])
    det = float(np.linalg.det(matrix))
    root = half * half - det
    if root <= 0.0:
        return _forward_only(section, dt, recursion, math.sqrt(det))
    far = half + math.copysign(math.sqrt(root), half)
    near = det / far
    near, far = sorted([near, far], key=abs)
    if abs(far) < 1.0:
        return _forward_only(section, dt, recursion, abs(far))
    count = math.ceil(math.log(LEFT_OVER) / -math.log(abs(far)))
    if abs(near) >= 1.0 or count > LONGEST_AHEAD:
        raise _unresolved(section, dt)
    inside_row, inside_drive = _eigenpart(recursion, near)
    _, outside_drive = _eigenpart(recursion, far)
    weight = -outside_drive * far ** -np.arange(1.0, count + 1.0)
    numbers = np.array([near, 0.0, 0.0, 0.0, inside_drive, 0.0, 1.0, 0.0])
    return SectionInverse(numbers, weight, np.array([inside_row, [0.0, 0.0]]))


def _eigenpart(recursion: _Recursion, zero: float) -> tuple[Floats, float]:
    """Return the part of the inverse that belongs to one eigenvalue: as seen in the result, and its drive."""
    matrix, drive, out = recursion
    left = np.array([matrix[1, 0], zero - matrix[0, 0]])
    right = np.array([matrix[0, 1], zero - matrix[0, 0]])
    row = left * (float(out @ right) / float(left @ right))
    return row, float(row @ drive)


def _forward_only(
    section: Resonance, dt: float, recursion: _Recursion, largest: float
) -> SectionInverse:
    """Return an inverse without a look ahead: both zeros are inside the unit circle."""
    if not largest < 1.0 or section.antiresonance is None:
        raise _unresolved(section, dt)
    numbers = np.concatenate([part.reshape(-1) for part in recursion])
    return SectionInverse(numbers, np.zeros(0), np.eye(2))


def _unresolved(section: Resonance, dt: float) -> InputError:
    """Return the refusal of a clock that does not resolve a section, with the rate that does."""
    name = f"resonance at {section.frequency:.6g} Hz"
    if section.antiresonance is not None:
        name += f" with its antiresonance at {section.antiresonance.frequency:.6g} Hz"
    return InputError(
        f"the model's {name} is too fast to be undone at {1.0 / dt:.6g} Hz"
        f" (`resample` {6.0 * section.highest:.6g} or more)"
    )


class Inverter:
    """Undoes dynamics and a delay on an even clock of ``dt`` (s), reading ahead by ``ahead`` samples.

    Raises
    ------
    InputError
        The clock does not resolve a section.
    """

    def __init__(
        self, dynamics: Dynamics | None, delay: Delay | None, dt: float
    ) -> None:
        self.sections = () if dynamics is None else dynamics.sections
        self.delay, self.dt = delay, dt
        self.parts = [section_inverse(part, dt) for part in self.sections]
        self.ahead = sum(part.weight.size for part in self.parts)
        if delay is not None:
            self.ahead += delay.rows_ahead(dt)

    def run(
        self, wanted: Floats, undoing: Undoing | None = None
    ) -> tuple[Floats, Undoing | None]:
        """Return what the static part must reach for a wanted displacement, and what comes next goes on from.

        Parameters
        ----------
        wanted : array
            A block and ``ahead`` samples of what follows it.
        undoing : Undoing, or None
            From the block before, or ``behind``; None: at rest at the first value.
        """
        if not self.parts and self.delay is None:
            return wanted, None
        memory: SectionStates = ()
        past: tuple[float, ...] = ()
        if undoing is not None and undoing[0] == self.dt:
            _, memory, past = undoing
        signal = wanted
        if self.delay is not None:
            signal = self.delay.read_ahead(wanted, self.dt, past)
            count = wanted.size - self.ahead
            before = wanted[max(count - BEFORE, 0) : count].tolist()
            past = (*past, *before)[-BEFORE:]
        if self.parts:
            rest = ((float(signal[0]), 0.0, 0.0),) * len(self.parts)
            signal, memory = self._undone(signal, memory or rest)
        return signal, (self.dt, memory, past)

    def behind(self, state: State) -> Undoing | None:
        """Return what ``run`` goes on from behind a state; None where nothing is known of it."""
        if state.undoing is not None and state.undoing[0] == self.dt:
            return state.undoing
        if not self.parts or state.sections is None:
            return None
        memories = []
        for part, (p, q, u), section in zip(
            self.parts, state.sections, self.sections, strict=True
        ):
            by_lead, by_q = section.output
            a, b = (part.from_state @ np.array([u - p, q])).tolist()
            memories.append((p + (by_lead * (u - p) + by_q * q), a, b))
        return self.dt, tuple(memories), ()

    def _undone(self, y: Floats, memory: SectionStates) -> tuple[Floats, SectionStates]:
        """Return the input of all sections but for what they read ahead, and the memory after it."""
        count = y.size - sum(part.weight.size for part in self.parts)
        undo = kernel.extension.dynamics_undo
        signal = np.ascontiguousarray(y)
        states = list(memory)
        for place, part in reversed(list(enumerate(self.parts))):
            ahead = part.weight.size
            state = np.array(states[place])
            out = np.empty(signal.size - ahead)
            undo(part.numbers, part.weight, state, signal[: count + ahead], out[:count])
            states[place] = tuple(state.tolist())
            # what the next section reads ahead, without going on from there
            if out.size > count:
                undo(part.numbers, part.weight, state, signal[count:], out[count:])
            signal = out
        return signal, tuple(states)

    def loop(self, wanted: Floats) -> Floats:
        """Return what ``run`` does, for one period of a displacement that repeats for ever."""
        signal, ahead = wanted, self.ahead
        if self.delay is not None:
            signal = self.delay.early_loop(signal, self.dt)
            ahead -= self.delay.rows_ahead(self.dt)
        if not self.parts:
            return signal
        wrapped = np.pad(signal, (0, ahead), mode="wrap")
        return repeated(self._undone, wrapped, len(self.parts))


def read_ahead(
    blocks: Iterable[tuple[Payload, Floats]], rows: int
) -> Iterator[tuple[Payload, Floats]]:
    """Yield each block with ``rows`` samples of those after it; at the end the last value holds.

    Empty blocks are dropped.
    """
    waiting: deque[tuple[Payload, int]] = deque()
    values = np.empty(0)  # of the blocks that wait, and what is known of those after
    for block in chain(blocks, [None]):
        if block is not None:
            payload, part = block
            if part.size:
                waiting.append((payload, part.size))
            values = np.concatenate([values, part])
        elif values.size:  # at the end
            values = np.concatenate([values, np.full(rows, values[-1])])
        while waiting and values.size - waiting[0][1] >= rows:
            payload, count = waiting.popleft()
            yield payload, values[: count + rows]
            values = values[count:]
