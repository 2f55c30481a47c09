"""The stream of a drive: a trajectory goes in block by block, and its drive comes out, in constant memory.

Rows before the move and the move itself are one signal through one inverse in one
state. Every row passes the gate before it leaves.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import chain

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.drive.drive import Drive
from dbo_cli.drive.lead import (
    CHOSEN_MOVES,
    LONGEST_CHOSEN,
    Lead,
    plan_lead,
    ramp,
)
from dbo_cli.drive.outlook import conclude
from dbo_cli.errors import InputError, LimitError
from dbo_cli.model import Cascade, State, Steps, Undoing, read_ahead

# consecutive rows of a trajectory: seconds (None without a clock), seconds since the row
# before (a number where they are even), what is desired, and what is asked for it
Block = tuple[Floats | None, Steps, Floats, Floats]
# of a drive: seconds (None without a clock), displacement, voltage
Rows = tuple[Floats | None, Floats, Floats]

LARGEST = 1e60  # of a displacement, as of the numbers of a model
PAUSE = 1e-6
"""Of a step: so much later than a step behind a state, its voltage was held."""


def drive_blocks(
    drive: Drive, blocks: Iterable[Block], lead: Lead, return_to: float | None
) -> Iterator[Rows]:
    """Yield the rows of a drive: before the move, of the move, after it.

    Parameters
    ----------
    drive
        Takes the figures and the state, which are complete at the end.
    blocks
        Of the trajectory.
    lead, return_to
        What stands before the move, and the voltage to go to after it.

    Raises
    ------
    InputError
        The trajectory is bad, or nothing of it can be reached.
    LimitError
        A limit was met, and that is refused; or the drive cannot begin.
    GateError
        A row breaks a limit: this program's fault.
    """
    moves = _checked(blocks, drive.name)
    first = next(moves, None)
    if first is None:
        raise InputError(f"{drive.name}: has no rows")
    time, dt, desired, wanted = first
    timed = lead.condition or lead.approach or lead.rest or return_to is not None
    step = _usual_step(drive, dt, bool(timed))
    if isinstance(dt, np.ndarray):
        dt = np.concatenate([[step], dt[1:]])
    if isinstance(lead.state, State):
        lead = replace(lead, state=_aged(drive.model, lead.state, time, step))
    # what stands before the move
    value = float(wanted[0])
    planned = plan_lead(drive.model, value, step, drive.limits, lead)
    drive.state, voltage, rest, chosen = planned
    moves = _read_enough(chain([(time, dt, desired, wanted)], moves), chosen, step)
    earlier = voltage.size + rest
    drive.lead_seconds, drive.past_known = earlier * step, lead.past_known
    begin = 0.0 if time is None else float(time[0])
    times = begin - step * np.arange(earlier, 0.0, -1.0)
    if voltage.size:
        yield _played(drive, times[: voltage.size], voltage, step, "lead")
    else:
        drive.gate.require_reachable(*drive.limits.move, dt)
    # the move, behind rows at its first value
    at_first = np.full(rest, value)
    still: Block = (times[voltage.size :], step, at_first, at_first)
    signal = chain([(still, "lead")], ((block, "move") for block in moves))
    for block, part in _undone(drive, signal, dt):
        if drive.state is None:
            drive.state = _started(drive, lead.state, float(block[3][0]))
        yield _driven(drive, block, part)
    _require_longer_than_delay(drive, step)
    drive.require_reached()
    if return_to is not None:
        yield from _return(drive, return_to, step)
    conclude(drive)


def _checked(blocks: Iterable[Block], name: str) -> Iterator[Block]:
    """Yield the blocks that hold rows; refuse values that are no displacement (InputError)."""
    rows = 0
    for block in blocks:
        require_numbers(name, block[3], rows)
        rows += block[3].size
        if block[3].size:
            yield block


def require_numbers(name: str, values: Floats, before: int = 0) -> None:
    """Refuse a row that is no displacement, with ``before`` rows before it (InputError)."""
    bad = ~(np.abs(values) <= LARGEST)
    if not bad.any():
        return
    row = int(np.argmax(bad))
    where = f"{name}: row {before + row + 1:,}"
    if np.isfinite(values[row]):
        raise InputError(
            f"{where}: {values[row]:g} is no displacement: check column and unit"
        )
    raise InputError(f"{where} holds no number (`skip_bad` drops such rows)")


def _usual_step(drive: Drive, dt: Steps, timed: bool) -> float:
    """Return the seconds a row at the beginning; 0 without a clock.

    Raises
    ------
    InputError
        There is none, and something depends on the time.
    """
    step = dt
    if isinstance(dt, np.ndarray):
        forward = dt[1:][dt[1:] > 0.0]
        step = float(np.median(forward)) if forward.size else None
    if step is not None:
        return float(step)
    if timed or drive.model.needs_time or drive.limits.slew is not None:
        raise InputError(
            f"{drive.name}: the model or the limits need a clock: a time column that advances, or "
            "`sample_rate` HZ"
        )
    return 0.0


def _aged(model: Cascade, state: State, time: Floats | None, step: float) -> State:
    """Return a state after the pause between its last row and the first one: the voltage was held."""
    if state.time is None or state.drive is None or time is None:
        return state
    pause = float(time[0]) - state.time - step
    if pause <= PAUSE * step:
        return state
    return model.run(np.array([state.drive]), state, pause).state


def _read_enough(
    blocks: Iterator[Block], chosen: float, step: float
) -> Iterator[Block]:
    """Read so much of the move that what stands before it is known not to be long beside it."""
    read: list[Block] = []
    seconds = 0.0
    while chosen > max(LONGEST_CHOSEN, CHOSEN_MOVES * seconds):
        block = next(blocks, None)
        if block is None:
            raise LimitError(
                f"{chosen:.4g} s before a move of {seconds:.4g} s: more than ten moves and a minute; "
                "give `approach` SECONDS or more `max_slew`"
            )
        read.append(block)
        seconds += block[3].size * step
    return chain(read, blocks)


def _played(
    drive: Drive, times: Floats, voltage: Floats, step: float, part: str
) -> Rows:
    """Return rows that are played as they are, with the displacement that the model expects of them."""
    assert drive.state is not None
    run = drive.model.run(voltage, drive.state, step)
    drive.admit(voltage, step, part)
    drive.state = replace(run.state, time=float(times[-1]))
    return times, run.y, voltage


def _undone(
    drive: Drive, signal: Iterable[tuple[Block, str]], dt: Steps
) -> Iterator[tuple[Block, str]]:
    """Yield blocks with what the static part is to reach for them: dynamics and delay undone."""
    model = drive.model
    undoing: Undoing | None = None
    if drive.state is not None:
        undoing = model.inverter(dt).behind(drive.state)
    late = round(model.delay_seconds / dt) if isinstance(dt, float) else 0
    known = (((block, part), block[3]) for block, part in signal)
    begun = False
    for (block, part), ahead in read_ahead(known, model.inverter(dt).ahead):
        time, dt, desired, _ = block
        wanted, undoing = model.inverter(dt).run(ahead, undoing)
        if not begun:
            drive.off = float(wanted[0] - ahead[late])
            begun = True
        yield (time, dt, desired, wanted), part


def _started(drive: Drive, start: str | State, first: float) -> State:
    """Return the state in which a drive begins that nothing leads to."""
    begun = drive.model.start_drive(first, start, *drive.limits.move)
    if drive.gate.last is None and drive.limits.slew is not None:
        drive.gate.last = begun.drive
    return begun


def _driven(drive: Drive, block: Block, part: str) -> Rows:
    """Return the rows of one block, of which the static part is to reach what is asked."""
    time, dt, desired, wanted = block
    model, limits, before = drive.model, drive.limits, drive.state
    assert before is not None
    done = model.drive(wanted, before, dt, limits.move, limits.slew)
    if part == "move":
        drive.clip(desired, wanted, done, before, dt)
    clipped_at_once = done.clipped and done.first_clipped == 0
    beyond = model.inverse().outside(wanted[:1])[0]
    if before.first is not None and not clipped_at_once and not beyond:
        reached = model.static.run(done.y[:1], before, 0.0).y
        drive.missed = float(wanted[0] - reached[0])
    drive.admit(done.y, dt, part)
    drive.state = done.state
    if time is not None:
        drive.state = replace(done.state, time=float(time[-1]))
    return time, desired, done.y


def _return(drive: Drive, end: float, step: float) -> Iterator[Rows]:
    """Yield the voltages from the end of a move to ``end`` (LimitError: it is outside the rating)."""
    assert drive.gate.last is not None and drive.state is not None
    drive.limits.require_start(end, "`return`")
    voltage = ramp("return", drive.gate.last, end, step, "auto", drive.limits)
    times = (drive.state.time or 0.0) + step * np.arange(1.0, voltage.size + 1.0)
    if voltage.size:
        yield _played(drive, times, voltage, step, "return")


def _require_longer_than_delay(drive: Drive, step: float) -> None:
    """Refuse a move that is over before the model answers (LimitError)."""
    delay, seconds = drive.model.delay_seconds, drive.move_rows * step
    if drive.on_limit == "auto" and delay > seconds:
        raise LimitError(
            f"{drive.name}: the move, {seconds:.4g} s, is shorter than the model's delay, {delay:.4g} "
            "s (`on_limit` clip writes it)"
        )
