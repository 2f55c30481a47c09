"""The stream of a drive: a trajectory goes in block by block, and its drive comes out, in constant memory.

Rows before the move and the move itself are one signal through one inverse in one
state. Every row passes the gate before it leaves.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator
from itertools import chain
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbo_cli.drive.drive import Drive
from dbo_cli.drive.gate import Gate
from dbo_cli.drive.lead import (
    Around,
    Lead,
    longest_lead,
    plan_lead,
    require_short,
    return_ramp,
    standing_at,
)
from dbo_cli.drive.limits import Limits
from dbo_cli.drive.loss import Loss, Steps
from dbo_cli.drive.outlook import Outlook
from dbo_cli.errors import InputError, LimitError, UsageError
from dbo_cli.model import Model, State, Undoing, read_ahead

Floats = NDArray[np.float64]
OnLimit = Literal["auto", "clip", "error"]

BLOCK_ROWS = 65_536  # that are driven at once: what they take stays in caches
EVEN = 1e-6  # of a step: what rounding of stamps may make of an even step


class Block(NamedTuple):
    """Consecutive rows of a trajectory.

    Attributes
    ----------
    time : array or None
        Seconds.
    desired, wanted : array
        What is desired, and what is asked of the model for it.
    part : str
        ``move``; ``lead`` for rows before it; ``tail`` for rows that are read ahead alone.
    dt : float, array or None
        Seconds since the row before.
    """

    time: Floats | None
    desired: Floats
    wanted: Floats
    part: str = "move"
    dt: Steps = None


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
    step
        Seconds a row of an even clock; None: uneven, or no clock.
    limits, around, on_limit
        What the drive may do, what stands around the move, and what happens at a limit.
    name
        Of the trajectory, for messages.
    block_rows
        Most rows of a block that comes out.

    Attributes
    ----------
    drive : Drive or None
        Figures of the drive (without rows), once the iteration is over.
    """

    def __init__(
        self,
        model: Model,
        blocks: Iterable[Block],
        step: float | None,
        limits: Limits,
        around: Around,
        on_limit: OnLimit = "auto",
        name: str = "trajectory",
        block_rows: int = BLOCK_ROWS,
    ) -> None:
        model.require("forward")
        check_on_limit(on_limit)
        self.model, self.limits, self.around = model, limits, around
        self.on_limit, self.name, self.step = on_limit, name, step
        self.drive: Drive | None = None
        self.loss = Loss(model, limits, name)
        self.outlook = Outlook(model, self.loss)
        self._blocks = _cut(blocks, block_rows)
        self._gate = Gate(limits, standing_at(model, limits, around))
        self._state: State | None = None
        self._lead = Lead()
        self._time = math.nan

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
        blocks = self._clocked(self._blocks)
        first = next(blocks, None)
        if first is None:
            raise InputError(f"{self.name}: holds no rows")
        lead = self._lead = self._planned_lead(first)
        blocks = self._read_enough(chain([first], blocks))
        times = _times_before(first, lead)
        played = lead.voltage.size
        if played:
            self._admit(lead.voltage, lead.dt, "lead")
            yield Rows(times[:played], lead.expected, lead.voltage)
        if lead.desired.size:
            way = Block(times[played:], lead.desired, lead.desired, "lead", lead.dt)
            blocks = chain([way], blocks)
        yield from self._follow(blocks)
        self._require_reached()
        yield from self._return()
        self.drive = self._figures()

    # --- the clock ---

    def _clocked(self, blocks: Iterable[Block]) -> Iterator[Block]:
        """Give each block the seconds since the row before; refuse bad rows, and time that goes back."""
        rows = 0
        last: float | None = None
        for block in blocks:
            count = block.desired.size
            if not count:
                continue
            bad = ~np.isfinite(block.wanted)
            if bad.any():
                row = rows + int(np.argmax(bad)) + 1
                raise InputError(
                    f"{self.name}: row {row:,} holds no number (`skip_bad` leaves such rows out)"
                )
            time = block.time
            dt: Steps = self.step
            if time is not None:
                if last is None:
                    last = float(time[0]) - (self._usual_step(time) or 0.0)
                dt = self._even(np.diff(time, prepend=last), rows)
                last = float(time[-1])
            elif self.step is not None:
                time = np.asarray(self.step * np.arange(rows, rows + count))
            rows += count
            yield block._replace(time=time, dt=dt)

    def _usual_step(self, time: Floats | None) -> float | None:
        """Return the step of a clock: the even one, or the median of those that go forward."""
        if self.step is not None or time is None:
            return self.step
        forward = np.diff(time)
        forward = forward[forward > 0.0]
        return float(np.median(forward)) if forward.size else None

    def _even(self, steps: Floats, rows: int) -> Steps:
        """Return time steps, as one number where they are even."""
        if (steps < 0.0).any():
            row = rows + int(np.argmax(steps < 0.0)) + 1
            raise InputError(
                f"{self.name}: time goes backwards in row {row:,} (`rows` A:B cuts the log)"
            )
        if (
            self.step is not None
            and (np.abs(steps - self.step) <= EVEN * self.step).all()
        ):
            return self.step
        return steps

    # --- before the move ---

    def _planned_lead(self, first: Block) -> Lead:
        """Return what stands before the move, and note the state that it leaves."""
        around, step = self.around, self._usual_step(first.time)
        if step is None:
            self._require_no_clock()
        if isinstance(around.state, State):
            around = dataclasses.replace(
                around, state=self._aged(around.state, first, step)
            )
        lead = plan_lead(
            self.model, float(first.wanted[0]), step or 0.0, self.limits, around
        )
        self._state = lead.state
        if not lead.voltage.size:
            self._gate.require_reachable(*self.limits.move, first.dt)
        return lead

    def _require_no_clock(self) -> None:
        """Refuse a trajectory without a clock where something depends on the time (InputError)."""
        what = ""
        if self.model.needs_time:
            what = "the model"
        if self.limits.slew is not None:
            what = "`max_slew`"
        if self.around.needs_time:
            what = f"`{self.around.needs_time}`"
        if what:
            raise InputError(
                f"{self.name}: {what} needs the time between samples (a time column that advances, or "
                "`sample_rate`)"
            )

    def _aged(self, state: State, first: Block, step: float | None) -> State:
        """Return a state after the pause between its last row and the first one: the voltage was held."""
        if (
            state.time is None
            or state.drive is None
            or first.time is None
            or step is None
        ):
            return state
        pause = float(first.time[0]) - state.time - step
        if pause <= EVEN * step:
            return state
        return self.model.run(np.array([state.drive]), state, pause).state

    def _read_enough(self, blocks: Iterator[Block]) -> Iterator[Block]:
        """Read so much of the move that what stands before it is known not to be long beside it."""
        read: list[Block] = []
        seconds = 0.0
        while self._lead.chosen > longest_lead(seconds):
            block = next(blocks, None)
            if block is None:
                require_short(self._lead, seconds, self.limits)
                break
            read.append(block)
            if block.part == "move":
                seconds += block.desired.size * self._lead.dt
        return chain(read, blocks)

    # --- rows ---

    def _admit(self, voltage: Floats, dt: Steps, part: str) -> None:
        """Let rows pass the gate, and note what they span."""
        self._gate.admit(voltage, dt, part)
        self.outlook.see(voltage, dt, part)

    def _follow(self, blocks: Iterator[Block]) -> Iterator[Rows]:
        """Yield the drive of displacements; dynamics and delay are undone before."""
        model = self.model
        if model.dynamics is None and model.delay is None:
            for block in blocks:
                if block.part != "tail":
                    yield self._driven(block, block.wanted, None)
            return
        step = self.step
        if step is None:
            raise InputError(
                f"{self.name}: the samples are not evenly spaced in time, and the model's delay and dynamics "
                "need that (`resample` HZ)"
            )
        undoing: Undoing | None = None
        if self._state is not None:
            undoing = model.undoing_of(self._state, step)
        late = round(model.delay_seconds / step)
        signal = ((block, block.wanted) for block in blocks)
        for block, wanted in read_ahead(signal, model.ahead(step)):
            if block.part == "tail":
                return
            undone, undoing = model.undo(wanted, undoing, step)
            self.outlook.see_undone(float(undone[0] - wanted[late]))
            yield self._driven(block, undone, undoing)

    def _driven(self, block: Block, wanted: Floats, undoing: Undoing | None) -> Rows:
        """Return the drive of one block, ``wanted`` of the static part; count what is clipped of the move."""
        if self._state is None:
            self._state = self._started(float(wanted[0]))
        before = self._state
        done = self.model.drive(wanted, before, block.dt, self.limits.window)
        self.loss.keep(wanted, block.dt, before)
        if block.part == "move":
            self.loss.see(block.desired, done.clipped, done.first_clipped)
            if self.on_limit == "error":
                self.loss.require_none()
            if self.loss.clipped:
                self.loss.add(wanted, done.voltage, before, block.dt)
        self.outlook.missed = self.outlook.missed or done.missed
        self._admit(done.voltage, block.dt, block.part)
        if block.time is not None:
            self._time = float(block.time[-1])
        self._state = dataclasses.replace(done.state, undoing=undoing)
        return Rows(block.time, block.desired, done.voltage)

    def _started(self, first: float) -> State:
        """Return the state in which a drive begins that nothing leads to."""
        assert isinstance(self.around.state, str)
        begun = self.model.start_drive(first, self.around.state, *self.limits.move)
        if self._gate.last is None and self.limits.slew is not None:
            self._gate.last = begun.drive
        return begun

    def _return(self) -> Iterator[Rows]:
        """Yield the way back, where one is asked for."""
        begin, state, step = self._gate.last, self._state, self._lead.dt
        if self.around.return_to is None or begin is None or state is None:
            return
        voltage = return_ramp(begin, step, self.limits, self.around)
        if not voltage.size:
            return
        run = self.model.run(voltage, dataclasses.replace(state, undoing=None), step)
        self._admit(voltage, step, "return")
        time = self._time + step * np.arange(1.0, voltage.size + 1.0)
        self._state, self._time = run.state, float(time[-1])
        yield Rows(time, run.y, voltage)

    # --- what came of it ---

    def _require_reached(self) -> None:
        """Refuse a move that cannot be reached, or whose limits cost too much of it."""
        if not isinstance(self.around.state, State):
            self.loss.require_reachable()
        if self.on_limit != "auto":
            return
        delay = self.model.delay_seconds
        seconds = (self.loss.move.rows - 1) * (self.step or 0.0)
        if delay > 0.0 and delay > seconds:
            raise LimitError(
                f"{self.name}: the model's delay, {delay:.4g} s, is longer than the move, {seconds:.4g} s "
                "(`on_limit` clip writes it all the same)"
            )
        self.loss.require_little()

    def _figures(self) -> Drive:
        """Return the figures of the whole drive, and warn of what is unusual."""
        state = self._state
        if state is not None and not math.isnan(self._time):
            state = dataclasses.replace(state, time=self._time)
        past_known = self.around.condition or isinstance(self.around.state, State)
        seconds = self._lead.rows * self._lead.dt
        return self.outlook.drive(state, seconds, past_known)


def check_on_limit(on_limit: str) -> None:
    """Refuse what is no way to meet a limit (UsageError)."""
    if on_limit not in ("auto", "clip", "error"):
        raise UsageError(f"`on_limit` {on_limit}: give auto, clip or error")


def _cut(blocks: Iterable[Block], rows: int) -> Iterator[Block]:
    """Yield the same rows in blocks of so many at most; a tail is read ahead alone, and stays whole."""
    for block in blocks:
        if block.part == "tail":
            yield block
            continue
        for begin in range(0, block.desired.size, rows):
            part = slice(begin, begin + rows)
            time = None if block.time is None else block.time[part]
            yield block._replace(
                time=time, desired=block.desired[part], wanted=block.wanted[part]
            )


def _times_before(first: Block, lead: Lead) -> Floats:
    """Return the times of the rows before the move."""
    begin = 0.0 if first.time is None else float(first.time[0])
    times: Floats = begin - lead.dt * np.arange(lead.rows, 0.0, -1.0)
    return times
