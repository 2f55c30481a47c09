"""The stream of a drive: a trajectory goes in block by block, and its drive comes out, in constant memory.

Rows before the move and the move itself are one signal through one inverse in one
state. Every row passes the gate before it leaves.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator
from itertools import chain
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbo_cli.drive.drive import Drive
from dbo_cli.drive.gate import Gate
from dbo_cli.drive.lead import (
    Around,
    Lead,
    longest_lead,
    plan_lead,
    return_ramp,
    standing_at,
    too_long,
)
from dbo_cli.drive.limits import Limits
from dbo_cli.drive.loss import Loss, OnLimit, Steps
from dbo_cli.drive.outlook import Outlook
from dbo_cli.errors import InputError, LimitError
from dbo_cli.model import Model, State, Undoing, read_ahead

Floats = NDArray[np.float64]

PAUSE = (
    1e-6  # of a step: so much later than a step behind a state, its voltage was held
)


class Block(NamedTuple):
    """Consecutive rows of a trajectory.

    Attributes
    ----------
    time : array or None
        Seconds.
    dt : float, array or None
        Seconds since the row before: a number where they are even, None without a clock.
    desired, wanted : array
        What is desired, and what is asked of the model for it.
    part : str
        ``move``, or ``lead`` for rows before it.
    """

    time: Floats | None
    dt: Steps
    desired: Floats
    wanted: Floats
    part: str = "move"


class Rows(NamedTuple):
    """Rows of a drive: seconds (None without a clock), displacement, voltage."""

    time: Floats | None
    desired: Floats
    voltage: Floats


class Stream:
    """The drive of a trajectory that comes in blocks: iterate over it once, then ask for ``drive``.

    Parameters
    ----------
    model
        A forward model.
    blocks
        Of the trajectory.
    limits, around, on_limit
        What the drive may do, what stands around the move, and what happens at a limit.
    name
        Of the trajectory, for messages.

    Attributes
    ----------
    drive : Drive or None
        Figures of the drive (without rows), once the iteration is over.
    """

    def __init__(
        self,
        model: Model,
        blocks: Iterable[Block],
        limits: Limits,
        around: Around,
        on_limit: OnLimit = "auto",
        name: str = "trajectory",
    ) -> None:
        model.require("forward")
        self.model, self.limits, self.around = model, limits, around
        self.name = name
        self.drive: Drive | None = None
        self.loss = Loss(model, limits, on_limit, name)
        self.outlook = Outlook(self.loss)
        self._blocks = blocks
        self._gate = Gate(limits, standing_at(limits, around))
        self._state: State | None = None
        self._time: float | None = None

    def __iter__(self) -> Iterator[Rows]:
        """Yield the rows: before the move, of the move, after it.

        Raises
        ------
        InputError
            The trajectory is bad, or nothing of it can be reached.
        LimitError
            A limit was met, and that is refused; or the drive cannot begin.
        GateError
            A row breaks a limit: this program's fault.
        """
        blocks = self._checked(self._blocks)
        first = next(blocks, None)
        if first is None:
            raise InputError(f"{self.name}: has no rows")
        step = self._usual_step(first)
        if isinstance(first.dt, np.ndarray):
            later = first.dt[1:]
            first = first._replace(dt=np.concatenate([[step or 0.0], later]))
        lead = self._planned_lead(first, step or 0.0)
        moves = self._read_enough(chain([first], blocks), lead, step or 0.0)
        begin = 0.0 if first.time is None else float(first.time[0])
        times = begin - (step or 0.0) * np.arange(lead.rows, 0.0, -1.0)
        played = lead.voltage.size
        if played:
            self._admit(lead.voltage, step, "lead")
            yield Rows(times[:played], lead.expected, lead.voltage)
        if lead.desired.size:
            rest = Block(times[played:], step, lead.desired, lead.desired, "lead")
            moves = chain([rest], moves)
        yield from self._follow(moves, first.dt)
        seconds = self.loss.move.rows * (step or 0.0)
        self._require_reached(seconds)
        yield from self._return(step or 0.0)
        if self._state is not None:
            self._state = dataclasses.replace(self._state, time=self._time)
        known = self.around.past_known
        self.drive = self.outlook.drive(self._state, lead.rows * (step or 0.0), known)

    def _checked(self, blocks: Iterable[Block]) -> Iterator[Block]:
        """Yield the blocks that hold rows; refuse values that are not numbers (InputError)."""
        rows = 0
        for block in blocks:
            bad = ~np.isfinite(block.wanted)
            if bad.any():
                row = rows + int(np.argmax(bad)) + 1
                raise InputError(
                    f"{self.name}: row {row:,} holds no number (`skip_bad` drops such rows)"
                )
            rows += block.wanted.size
            if block.wanted.size:
                yield block

    # --- before the move ---

    def _usual_step(self, first: Block) -> float | None:
        """Return the seconds a row at the beginning; None without a clock.

        Raises
        ------
        InputError
            There is none, and something depends on the time.
        """
        step = first.dt
        if isinstance(step, np.ndarray):
            forward = step[1:][step[1:] > 0.0]
            step = float(np.median(forward)) if forward.size else None
        needed = self.model.needs_time or self.around.needs_time
        if step is None and (needed or self.limits.slew is not None):
            raise InputError(
                f"{self.name}: the model or the limits need a clock: a time column that advances, or "
                "`sample_rate` HZ"
            )
        return step

    def _planned_lead(self, first: Block, step: float) -> Lead:
        """Return what stands before the move, and note the state that it leaves."""
        around = self.around
        if isinstance(around.state, State):
            state = self._aged(around.state, first, step)
            around = dataclasses.replace(around, state=state)
        value = float(first.wanted[0])
        lead = plan_lead(self.model, value, step, self.limits, around)
        self._state = lead.state
        if not lead.voltage.size:
            self._gate.require_reachable(*self.limits.move, first.dt)
        return lead

    def _read_enough(
        self, blocks: Iterator[Block], lead: Lead, step: float
    ) -> Iterator[Block]:
        """Read so much of the move that what stands before it is known not to be long beside it."""
        read: list[Block] = []
        seconds = 0.0
        for block in blocks:
            read.append(block)
            seconds += block.wanted.size * step
            if lead.chosen <= longest_lead(seconds):
                return chain(read, blocks)
        raise too_long(lead, seconds)

    def _aged(self, state: State, first: Block, step: float) -> State:
        """Return a state after the pause between its last row and the first one: the voltage was held."""
        if state.time is None or state.drive is None or first.time is None:
            return state
        pause = float(first.time[0]) - state.time - step
        if pause <= PAUSE * step:
            return state
        return self.model.run(np.array([state.drive]), state, pause).state

    # --- rows ---

    def _admit(self, voltage: Floats, dt: Steps, part: str) -> None:
        """Let rows pass the gate, and note what they span."""
        self._gate.admit(voltage, dt, part)
        self.outlook.see(voltage, dt, part)

    def _follow(self, blocks: Iterator[Block], dt: Steps) -> Iterator[Rows]:
        """Yield the drive of displacements; dynamics and delay are undone before."""
        model = self.model
        undoing: Undoing | None = None
        if self._state is not None:
            undoing = model.inverter(dt).behind(self._state)
        late = 0
        if isinstance(dt, float):
            late = round(model.delay_seconds / dt)
        signal = ((block, block.wanted) for block in blocks)
        for block, wanted in read_ahead(signal, model.inverter(dt).ahead):
            undone, undoing = model.inverter(block.dt).run(wanted, undoing)
            if self._time is None:
                self.outlook.off = float(undone[0] - wanted[late])
            if block.time is not None:
                self._time = float(block.time[-1])
            yield self._driven(block, undone)

    def _driven(self, block: Block, wanted: Floats) -> Rows:
        """Return the drive of one block, ``wanted`` of the static part."""
        if self._state is None:
            self._state = self._started(float(wanted[0]))
        before = self._state
        done = self.model.drive(wanted, before, block.dt, self.limits.window)
        if block.part == "move":
            self.loss.see(block.desired, wanted, done, before, block.dt)
        self.outlook.missed = self.outlook.missed or done.missed
        self._admit(done.y, block.dt, block.part)
        self._state = done.state
        return Rows(block.time, block.desired, done.y)

    def _started(self, first: float) -> State:
        """Return the state in which a drive begins that nothing leads to."""
        assert isinstance(self.around.state, str)
        begun = self.model.start_drive(first, self.around.state, *self.limits.move)
        if self._gate.last is None and self.limits.slew is not None:
            self._gate.last = begun.drive
        return begun

    def _return(self, step: float) -> Iterator[Rows]:
        """Yield the way back, where one is asked for."""
        begin, end, state = self._gate.last, self.around.return_to, self._state
        if end is None or begin is None or state is None:
            return
        voltage = return_ramp(begin, end, step, self.limits)
        if not voltage.size:
            return
        run = self.model.run(voltage, state, step)
        self._admit(voltage, step, "return")
        time = (self._time or 0.0) + step * np.arange(1.0, voltage.size + 1.0)
        self._state, self._time = run.state, float(time[-1])
        yield Rows(time, run.y, voltage)

    def _require_reached(self, seconds: float) -> None:
        """Refuse a move that is over before the model answers, or whose limits cost too much of it."""
        delay = self.model.delay_seconds
        if self.loss.on_limit == "auto" and delay > seconds:
            raise LimitError(
                f"{self.name}: the move, {seconds:.4g} s, is shorter than the model's delay, {delay:.4g} "
                "s (`on_limit` clip writes it)"
            )
        self.loss.require_little()
