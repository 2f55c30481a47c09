"""Compensation: the drive that makes an actuator follow a trajectory, within the drive's limits.

The rows before a move (the sweep into a known state, the way from where the amplifier
stands, the rest that dynamics need) and the move itself are one signal through one
inverse in one state; every row of it passes the gate.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import chain
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np

from dbo_cli import extensions
from dbo_cli.drives.gate import DriveFigures, DriveGate
from dbo_cli.drives.model_run import ModelRun, Response, Tally, first_blocks
from dbo_cli.drives.options import (
    DriveOptions,
    beyond_range,
    limits_note,
    plain_in,
    voltage_in,
    volts_a_unit,
)
from dbo_cli.drives.pieces import (
    Before,
    BeforeMove,
    longest_chosen,
    ramp,
    require_short,
    sweep_range,
)
from dbo_cli.errors import InputError, LimitError, Remarks, UsageError, counted
from dbo_cli.hysteresis.dynamics import SectionStates
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_state import DriveLimits, ModelState, Simulated
from dbo_cli.hysteresis.move_error import (
    MOST_ROWS,
    UNLIKE,
    ZERO_STAYS,
    MoveError,
    move_error,
)
from dbo_cli.logs.sample_block import FloatArray, SampleBlock, even_step, median_step
from dbo_cli.logs.signal_log import Source

NOTHING_BROUGHT: Mapping[str, Any] = MappingProxyType({})
# of the range: a trajectory this little outside is clipped and counted like any other
REACH_SLACK = 0.01
SLACK = 1e-9  # of the range: what rounding may add to a drive that ends at its limit
# of the range: two drives that agree to this are one; chosen, far above rounding
SAME_DRIVE = 1e-9
ALLOWED_PART = 0.01
"""Of the move: so much of it (RMS) may be lost without being asked for. The order of the error that is
left where a model is good; chosen.
"""


STREAMED_ROWS = 100
"""Rows: what a stream has lost is a mean over at least so many, so that one row does not end it; chosen."""


class MoveLoss:
    """Adds up what a move loses.

    It knows only of the rows added: those from the block of the first clipped row on,
    whatever rows of that block come before it. All rows before lose nothing; they count
    in ``rms`` by their number.

    Parameters
    ----------
    model : ActuatorModel
        A forward model.

    Attributes
    ----------
    squares : float
        The sum of the squares of what each row loses, in the displacement's unit.
    most : float
        The most that a row loses, in the same unit.
    """

    def __init__(self, model: ActuatorModel) -> None:
        self._dynamics = model.dynamics
        self._sections: SectionStates | None = None
        self.squares = 0.0
        self.most = 0.0

    def add(self, lost: FloatArray, time_step: float | FloatArray | None) -> FloatArray:
        """Add consecutive rows; return what they lose.

        The first call brings the whole block of the first clipped row, the next ones
        every block after it.

        Parameters
        ----------
        lost
            What the gears and the points were to reach, less what they do; what lies
            behind them answers as it answers everything else.
        time_step
            Seconds since the row before.
        """
        if self._dynamics is not None and time_step is not None:
            if self._sections is None:
                self._sections = self._dynamics.run(np.zeros(1), 1.0, None)[1]
            lost, self._sections = self._dynamics.run(lost, time_step, self._sections)
        self.add_displacement(lost)
        return lost

    def add_displacement(self, lost: FloatArray) -> None:
        """Add rows of which it is known how much displacement they lose."""
        self.squares += float(np.square(lost).sum())
        self.most = max(self.most, float(np.abs(lost).max(initial=0.0)))

    def rms(self, rows: int) -> float:
        """Return the root of the mean square over all rows of a move, clipped or not."""
        return math.sqrt(self.squares / max(rows, 1))


def first_beyond(
    squares: float, rows: int, lost: FloatArray, allowed: float
) -> int | None:
    """Return the first of the rows ``lost`` at which the RMS of a stream so far is more than ``allowed``.

    Parameters
    ----------
    squares, rows
        The sum of squares, and the rows, before these.
    """
    sums = squares + np.cumsum(lost * lost)
    counts = np.maximum(rows + np.arange(1.0, lost.size + 1.0), STREAMED_ROWS)
    beyond = sums > allowed * allowed * counts
    if not beyond.any():
        return None
    return int(np.argmax(beyond))


class Watcher(Protocol):
    """Sees the rows of a move as they are played, and has something to say in the end."""

    def add(self, desired: FloatArray, drive: FloatArray) -> None:
        """See consecutive rows of the move."""

    def notes(self, name: str, figures: DriveFigures) -> str | list[str]:
        """Return what is to be said of the move called ``name``, whose drive has these figures."""

    def summary(self) -> dict[str, Any]:
        """Return what it adds to the summary of the run."""


@dataclass
class Compensation(ModelRun):
    """A run of a forward model's inverse over a trajectory; see ``DriveOptions``.

    Attributes
    ----------
    options : DriveOptions
        What is asked of the drive.
    remarks_before : Remarks
        What was said before the run.
    clipped : Tally
        The rows whose drive a limit clipped.
    first_value_missed : float
        How far the drive's first row is off the first value of the trajectory, because
        the settled curve steps over that; 0 where it does not. In the displacement's
        unit.
    unreachable : int
        The rows of the move outside the range of the model's displacement.
    streamed : bool
        Whether rows are written before all are read, so that too large a loss ends the
        run at once.
    loss : MoveLoss
        What the move loses by clipping.
    stream_ends : int, or None
        The first row of the block, from 0, at which a stream has lost too much.
    read_from, read_to : float
        The first (None before any) and the last time stamp read, in seconds.
    lead_in_figures : DriveFigures
        Figures of the drive before the first row.
    lead_in_seconds : float
        How long that takes.
    move_figures : DriveFigures
        The same figures of what is desired: displacements, in place of voltages.
    drive_figures : DriveFigures
        Figures of the whole drive, the rows before and after the move included.
    first_drives : list of tuples
        The first rows' drive and their time steps (None without time), block by block;
        the expected error of the move is computed from them.
    came_from : float, or None
        The voltage at which the amplifier stands before the first row, where that is
        known.
    limits : DriveLimits
        What the drive may do.
    gate : DriveGate
        What every row passes.
    watchers : list of Watcher
        What extras have to say of the rows of the move.
    expecting : bool
        Whether the error to expect of the move is worked out for the remarks.
    """

    options: DriveOptions = field(default_factory=DriveOptions)
    remarks_before: Remarks = field(default_factory=Remarks)
    clipped: Tally = field(default_factory=Tally)
    first_value_missed: float = 0.0
    unreachable: int = 0
    streamed: bool = False
    loss: MoveLoss = field(init=False)
    stream_ends: int | None = None
    read_from: float | None = None
    read_to: float = 0.0
    lead_in_figures: DriveFigures = field(default_factory=DriveFigures)
    lead_in_seconds: float = 0.0
    move_figures: DriveFigures = field(default_factory=DriveFigures)
    drive_figures: DriveFigures = field(default_factory=DriveFigures)
    first_drives: list[tuple[FloatArray, FloatArray | None]] = field(
        default_factory=list
    )
    came_from: float | None = field(init=False)
    limits: DriveLimits = field(init=False)
    gate: DriveGate = field(init=False)
    watchers: list[Watcher] = field(default_factory=list)
    expecting: bool = True
    _error_of: tuple[tuple[int, int], MoveError | None] | None = None

    compensates = True
    repeats = False  # whether the trajectory goes on from its last row to its first
    # whether the error that the model states is to be expected of this drive
    states_error = True
    first_what = "row"
    among_them = ""
    remedies = "`condition` sweeps it there, "
    or_after_a_sweep = " or after `condition`"
    before_its_first_sweep = (
        "; an actuator that never went over its range may err more"
        " (`condition` sweeps it)"
    )

    def __post_init__(self) -> None:
        """Take the options apart."""
        options = self.options
        self.limits = options.limits(self.model)
        self.start = options.state
        self.why_time = options.why_time
        self.bandwidth = options.rounding
        super().__post_init__()
        self._run = functools.partial(self.model.compensate, limits=self.limits)
        self.loss = MoveLoss(self.model)
        self.came_from = self._comes_from()
        self.gate = DriveGate(self.limits, self.came_from, self.model.input.suffix)

    def responses(self) -> Iterator[Response]:
        """Return the drive, with the pieces before and after it that were asked for.

        Raises
        ------
        InputError
            The source is bad, time goes backwards, or nothing of it can be reached.
        LimitError
            A limit of the drive was met, and that is refused; or no drive could begin
            within the limits.
        GateError
            A row breaks a limit: this program's fault.
        """
        blocks = self.source.blocks()
        step = 0.0
        if self.options.has_pieces:
            first, stamps = first_blocks(blocks)
            blocks = chain(first, blocks)
            if self.needs_time:
                step = self._usual_step(stamps)
            if first:
                value = float(first[0].values[self.input.quantity][0])
                before = self.before_move(value, step)
                times = _times_before(before, stamps, step)
                self.lead_in_seconds = step * (times.size - 1)
                blocks = self._read_enough(before, step, blocks)
                yield from self._played(before, times[: before.voltage.size + 1], step)
                blocks = chain(self._way_in(before, times), blocks)
        for block, x in self.inputs.blocks(self._watched(blocks), self.state):
            yield from self._answer(block, x)
        self._require_reached()
        state = self.state
        if self.options.return_ is not None and state is not None:
            if state.time is not None:
                yield self._return(state, state.time, step)

    def _answer(self, block: SampleBlock, x: FloatArray) -> Iterator[Response]:
        """Give the drive of a block; a stream that has lost too much ends here (LimitError)."""
        desired = block.values[self.input.quantity]
        drive = self.feed(block, x).y
        if not block.before_move:
            desired = self.desired_rows(desired)
            self._see(desired, drive)
        response = Response(block.time, desired, drive)
        if self.stream_ends is None:
            yield response
            return
        if self.stream_ends > 0:
            yield _first_rows(response, self.stream_ends)
        raise LimitError(self._stream_ended())

    def _way_in(self, before: Before, times: FloatArray) -> Iterator[SampleBlock]:
        """Give the displacements before the first row as a block of rows that end with row 0."""
        count = before.desired.size
        if count:
            values = {self.input.quantity: before.desired}
            yield SampleBlock(
                range(1 - count, 1), None, times[times.size - count :], values
            )

    def _read_enough(
        self, before: Before, step: float, blocks: Iterator[SampleBlock]
    ) -> Iterator[SampleBlock]:
        """Read so much of the move that it is known not to be short beside what was chosen before it.

        Raises
        ------
        LimitError
            It is.
        """
        chosen = step * sum(piece.rows for piece in before.chosen)
        if chosen <= longest_chosen(0.0):
            return blocks
        read: list[SampleBlock] = []
        seconds = 0.0
        for block in blocks:
            read.append(block)
            if read[0].time is not None and block.time is not None:
                seconds = float(block.time[-1] - read[0].time[0]) + step
            if chosen <= longest_chosen(seconds):
                return chain(read, blocks)
        require_short(self.source.name, before.chosen, step, seconds)
        return iter(read)

    def _watched(self, blocks: Iterable[SampleBlock]) -> Iterator[SampleBlock]:
        """Give the same blocks; note the first and the last time stamp that were read."""
        for block in blocks:
            if block.time is not None and len(block):
                if self.read_from is None:
                    self.read_from = float(block.time[0])
                self.read_to = float(block.time[-1])
            yield block

    def _require_reached(self) -> None:
        """Refuse what the drive cannot do at all, or not without losing much of the move.

        Raises
        ------
        InputError
            Nothing of the trajectory can be reached, which is no drive's fault.
        LimitError
            The limits, or the delay, cost too much of the move, and that was not asked
            for.
        """
        rows = self.rows - self.rows_before
        goes_on = isinstance(self.start, ModelState)
        if self.rows and self.unreachable >= rows > 0 and not goes_on:
            raise InputError(
                f"{self.source.name}: every row is outside what the model reaches ({self._range()}): check "
                "unit, column and zero of the trajectory"
            )
        if self.options.on_limit != "auto":
            return
        self._require_delay()
        if not self.streamed:
            self._require_little_loss()
        elif self._lost_rms() > ALLOWED_PART * self.model.output.span:
            raise LimitError(self._stream_ended())

    def _require_delay(self) -> None:
        """Refuse a delay that is longer than all that was read (LimitError)."""
        delay = self.model.delay_seconds
        if self.read_from is None or not self.rows or self.repeats:
            return
        if delay > self.read_to - self.read_from:
            raise LimitError(
                f"{self.source.name}: the model's delay, {delay:.4g} s, is longer than the move, "
                f"{self.read_to - self.read_from:.4g} s, so that the drive would hold its last value "
                "(`lead` auto lets it begin before; `on_limit` clip writes it all the same)"
            )

    def _require_little_loss(self) -> None:
        """Refuse limits that cost more than a hundredth of the move (LimitError)."""
        size, of_what = self.move_size()
        lost = self._lost_rms()
        if not self.clipped.count or lost <= ALLOWED_PART * size:
            return
        unit = self.model.output.suffix
        raise LimitError(
            f"{self._clipping_words()}: the move would miss {lost:.3g}{unit} RMS "
            f"({100.0 * lost / size:.2g} % of {of_what}), {self.loss.most:.3g}{unit} at worst; more than "
            f"{100.0 * ALLOWED_PART:g} % is not written (`on_limit` clip writes it)"
        )

    def move_size(self) -> tuple[float, str]:
        """Return what a loss is compared with, and its name: how far the move goes, or the model's range."""
        span = self.move_figures.high - self.move_figures.low
        if span > 0.0:
            return span, "the move"
        return self.model.output.span, "the model's range"

    def _stream_ended(self) -> str:
        """Say why a stream ends: its rows so far miss too much."""
        unit, size = self.model.output.suffix, self.model.output.span
        return (
            f"{self._clipping_words()}: the move misses more than {ALLOWED_PART * size:.3g}{unit} "
            f"RMS, {100.0 * ALLOWED_PART:g} % of the model's range; the stream ends (`on_limit` clip goes "
            "on)"
        )

    def _see(self, desired: FloatArray, drive: FloatArray) -> None:
        self.move_figures.see(desired, None)
        for watcher in self.watchers:
            watcher.add(desired, drive)

    def _played(
        self, before: Before, times: FloatArray, step: float
    ) -> Iterator[Response]:
        """Play the voltages before a move, and go on from the state that they leave."""
        if before.voltage.size:
            self.lead_in_figures.see(before.voltage, None)
            yield self._response(times[1:], before.expected, before.voltage, step)
        if before.state is not None:
            self.state = before.state
            if self.source.has_time:
                self.state = dataclasses.replace(before.state, time=float(times[-1]))
                self.last_time = float(times[-1])

    # --- the rows before and after the trajectory ---

    def _comes_from(self) -> float | None:
        """Return where the drive stands before the first row: a saved state, or what was said, knows it."""
        typed = None
        if self.options.from_ is not None:
            typed = voltage_in("from_", self.options.from_, self.model.input)
        if isinstance(self.start, ModelState):
            left_at = self.model.drive_of(self.start)
            if left_at is None:
                return typed
            if (
                typed is not None
                and abs(typed - left_at) > SAME_DRIVE * self.output.span
            ):
                raise UsageError(
                    f"`from_` {typed:g} contradicts `state`, which was left at {left_at:g}"
                )
            return left_at
        if typed is None and self.start in ("empty", "full"):
            low_end, high_end = self.model.covered_gears.x_range
            end = low_end if self.start == "empty" else high_end
            voltage = self.model.inverted.outer_drive(end)
            return min(max(voltage, self.limits.v_min), self.limits.v_max)
        return typed

    def _usual_step(self, stamps: FloatArray) -> float:
        """Return seconds a row for the pieces (InputError where the clock stands still)."""
        step = self.even_step or even_step(stamps)
        if step is not None:
            return step
        steps = np.diff(stamps)
        forward = steps[steps > 0.0]
        if not len(forward):
            option = (self.why_time or "`from_`").split()[0]
            raise InputError(
                f"{self.source.name}: the time does not advance, and {option} takes its rate from it"
            )
        return median_step(forward)

    def before_move(self, first: float, step: float) -> Before:
        """Return the pieces before the trajectory's first value."""
        options, last = self.options, self.gate.last
        plan = BeforeMove(self.model, options, self.limits, self.start, last, step)
        before = plan.plan(first)
        if options.condition:
            ramped = last is not None and options.approach is not None
            begin = None if ramped else sweep_range(self.model, self.limits)[0]
            self.gate.require_start(step, begin)
        return before

    def _rest_after(self) -> tuple[float, float]:
        """Return where the drive came from (0: not known), and what is nearest to it within limits."""
        rest = 0.0 if self.came_from is None else self.came_from
        return rest, min(max(rest, self.limits.v_min), self.limits.v_max)

    def _return(self, state: ModelState, last_time: float, step: float) -> Response:
        """Return the ramp after the move; nothing is desired there."""
        assert self.gate.last is not None
        _, target = self._rest_after()
        voltage = ramp(
            "return_", self.gate.last, target, step, self.options.return_, self.limits
        )
        time = last_time + step * np.arange(1.0, voltage.size + 1.0)
        if voltage.size:
            done = self.model.simulate(
                voltage, dataclasses.replace(state, undoing=None), time_step=step
            )
            self.state = dataclasses.replace(done.state, time=float(time[-1]))
        return self._response(time, np.full(voltage.size, math.nan), voltage, step)

    def _response(
        self, time: FloatArray, desired: FloatArray, drive: FloatArray, step: float
    ) -> Response:
        """Let voltages that are played as they are pass the gate."""
        self._admit(drive, step)
        return Response(time, desired, drive)

    # --- one block ---

    def _begun(self, first: float) -> ModelState:
        begun = self.model.start_compensation(first, self.start, self.limits)
        self._note_assumed(begun, first)
        return begun

    def feed(self, block: SampleBlock, x: FloatArray) -> Simulated:
        """Run one block; count its clipped rows, and let all rows pass the gate."""
        if self.state is None:
            self.state = self._begun(float(x[0]))
        before = self.state
        done = super().feed(block, x)
        steps = self.time_step
        if not self.drive_figures.rows:
            first_step = None if steps is None else float(np.ravel(steps)[0])
            self.gate.require_start(first_step)
        if block.before_move:
            self.lead_in_figures.see(done.y, None)
        else:  # what cannot be reached before a move is none of it
            self._count_unreachable(block, x)
            self._count_clipped(done, block)
            if self.clipped.count:
                self._count_lost(done, x, before, steps)
        self.first_value_missed = self.first_value_missed or done.first_missed
        self._admit(done.y, steps)
        self._keep_first_rows(done.y, steps)
        return done

    def _admit(self, drive: FloatArray, steps: float | FloatArray | None) -> None:
        """Let rows pass the gate (GateError), and measure them."""
        self.gate.admit(drive, steps)
        self.drive_figures.see(drive, steps)

    def _keep_first_rows(
        self, drive: FloatArray, steps: float | FloatArray | None
    ) -> None:
        """Keep the first rows, on which the error to expect is looked at in the end."""
        room = MOST_ROWS - sum(rows.size for rows, _ in self.first_drives)
        if room <= 0:
            return
        each_step = None
        if steps is not None:
            each_step = np.broadcast_to(steps, drive.shape)[:room]
        self.first_drives.append((drive[:room], each_step))

    def _count_unreachable(self, block: SampleBlock, x: FloatArray) -> None:
        """Count the rows outside the range of the model's displacement."""
        desired = x
        if self.model.dynamics is not None:
            desired = block.values[self.input.quantity]
        reach = self.model.output
        slack = REACH_SLACK * reach.span
        below = desired < reach.minimum - slack
        above = desired > reach.maximum + slack
        self.unreachable += int(np.count_nonzero(below | above))

    def _count_clipped(self, done: Simulated, block: SampleBlock | None) -> None:
        """Count the clipped rows, or refuse them (LimitError); rows before a loop are in no block."""
        if done.clipped_count:
            self.clipped.add(done.clipped_count, done.first_clipped, block)
        if self.options.on_limit == "error" and self.clipped.count:
            raise LimitError(f"{self._clipping_words()} (`on_limit` clip goes on)")

    def _count_lost(
        self,
        done: Simulated,
        x: FloatArray,
        before: ModelState,
        steps: float | FloatArray | None,
    ) -> None:
        """Add up what the rows of a block lose, from the first clipped block on; a stream may end in it."""
        model = self.model.without_dynamics_and_delay
        reached = model.follow(done.y, before, steps).y
        rows = self.rows - self.rows_before - x.size
        squares = self.loss.squares
        lost = self.loss.add(x - reached, steps)
        if self.streamed and self.options.on_limit == "auto":
            allowed = ALLOWED_PART * self.model.output.span
            self.stream_ends = first_beyond(squares, rows, lost, allowed)
        if self.stream_ends is not None:
            self._uncount_behind_end(done, self.stream_ends + 1, x, before, steps)

    def _uncount_behind_end(
        self,
        done: Simulated,
        count: int,
        x: FloatArray,
        before: ModelState,
        steps: float | FloatArray | None,
    ) -> None:
        """Take back what was counted of a block behind its first ``count`` rows, where a stream ends."""
        part = steps[:count] if isinstance(steps, np.ndarray) else steps
        begun = self._run(x[:count], before, time_step=part)
        self.clipped.count += begun.clipped_count - done.clipped_count
        self.rows += count - x.size

    def _lost_rms(self) -> float:
        return self.loss.rms(self.rows - self.rows_before)

    def desired_rows(self, rows: FloatArray) -> FloatArray:
        """Return what is desired in the last rows of the move that were run, of what the model was asked."""
        return rows

    def finish(self) -> None:
        """Write what belongs beside the drive, once that is written; a plain move needs nothing."""

    # --- what is said ---

    def _add_limits(self, remarks: Remarks) -> None:
        if self.clipped.count:
            unit = self.model.output.suffix
            remarks.warn(
                f"{self._clipping_words()}: clipped, by which the move misses {self._lost_rms():.3g}{unit} "
                f"RMS, {self.loss.most:.3g}{unit} at worst (`on_limit` error refuses this)"
            )
        elif self.beyond.count:
            super()._add_limits(remarks)
        if self.first_value_missed:
            missed = f"{abs(self.first_value_missed):.3g}{self.input.suffix}"
            remarks.warn(
                f"{self.source.name}: the displacement starts {missed} off its first value, at which an "
                "actuator that has settled does not stand (`state` empty or `condition`)"
            )
        beyond = beyond_range(
            self.model.input, self.drive_figures.low, self.drive_figures.high
        )
        # else the amplifier stood there, and only came inwards
        if beyond and self.options.extrapolate:
            remarks.warn(f"{self.source.name}: the drive goes {beyond}")
        self._add_ends_outside(remarks)

    def _add_ends_outside(self, remarks: Remarks) -> None:
        """Say where the amplifier stood outside the limits, and what the drive therefore does there."""
        name, unit, limits = self.source.name, self.model.input.suffix, self.limits
        within = f"its limits, {limits.v_min:.6g} to {limits.v_max:.6g}{unit}"
        if self.gate.outside:
            remarks.warn(
                f"{name}: the drive comes from {self.came_from:.6g}{unit}, outside {within}: the first "
                f"{counted(self.gate.outside, 'row')} on the way inwards outside them, too"
            )
        rest, target = self._rest_after()
        if self.options.return_ is not None and rest != target:
            came = "where drives rest"
            if self.came_from is not None:
                came = "where the drive came from"
            remarks.warn(
                f"{name}: the drive returns to {target:.6g}{unit} alone: {rest:.6g}{unit}, {came}, is "
                f"outside {within}"
            )

    def remarks(self) -> Remarks:
        """Return what is to be said of the run so far, and what was said before."""
        remarks = Remarks()
        remarks.add(self.remarks_before)
        remarks.add(super().remarks())
        name = self.source.name
        remarks.note(f"{name}: {text}" for text in self._notes())
        for watcher in self.watchers:
            remarks.note(watcher.notes(name, self.drive_figures))
        farad, drive = self.options.farad, self.drive_figures
        if farad is not None and drive.seconds:
            volts = float(volts_a_unit(self.model))
            coulombs = farad * volts * drive.travel
            joules = farad * volts**2 * drive.work
            remarks.notes.append(
                f"{name}: into {farad:g} F the drive takes {farad * volts * drive.fastest:.3g} A at most, "
                f"{coulombs / drive.seconds:.3g} A and {joules / drive.seconds:.3g} W (voltage times "
                "current) on average"
            )
        error = None
        if self.expecting and self.expected_rmse()[0] is not None:
            error = self._move_error()
        # Where clipping is the error, what is left of the move tells nothing of the
        # logs.
        if error is not None and not error.form < max(
            error.straight_line, self._lost_rms()
        ):
            unit = self.model.output.suffix
            remarks.warn(
                f"{name}: the expected error of the move, {error.form:.3g}{unit}, is no better than that of "
                f"a straight line, {error.straight_line:.3g}{unit}: the logs do not tell what it asks"
            )
        return remarks

    def _notes(self) -> Iterator[str]:
        """Say in which units limits are read, how the drive begins, where it may step, and what to expect."""
        options = self.options
        drive = self.model.input
        units_read = plain_in(
            drive.unit, options.v_min, options.v_max, options.max_slew, options.from_
        )
        if units_read:
            yield units_read
        if self.lead_in_figures.rows:
            yield self._lead_in_note()
        range_note = limits_note(drive, self.limits, options.v_min, options.v_max)
        if range_note:
            yield range_note
        if self.drive_figures.first is not None:
            yield from self._begin_notes(self.drive_figures.first)
        scale = self.voltage_scale
        if scale is not None:
            yield (
                f"the drive is in the voltages of the model's logs {scale} (`gain` of waveform takes it back "
                "to the converter's)"
            )
        if self.states_error and self.rows and self.expecting:
            yield from self._expected_error()

    def _begin_notes(self, first: float) -> Iterator[str]:
        """Say where the drive begins, if that may be a step from where the amplifier stands."""
        unit = self.output.suffix
        if self.came_from is None:
            yield (
                f"the drive begins at {first:.6g}{unit}; from where the amplifier comes is not known "
                "(`from_` VOLT says it, `approach` ramps there)"
            )
            return
        if self.limits.max_slew is not None:
            return
        if abs(first - self.came_from) > self.drive_figures.largest_step:
            yield (
                f"the first row steps from {self.came_from:.6g} to {first:.6g}{unit} (`approach` SECONDS "
                "ramps there)"
            )

    def _lead_in_note(self) -> str:
        """Say what stands before the first row."""
        figures, unit = self.lead_in_figures, self.output.suffix
        return (
            f"before the first {self.first_what} stand {figures.rows:,} rows, {self.lead_in_seconds:.4g} s, "
            f"from {figures.low:.6g} to {figures.high:.6g}{unit}{self.among_them}"
        )

    def summary_before(self) -> dict[str, Any]:
        """Return what stands before the first row as plain values."""
        figures = self.lead_in_figures
        reach = [figures.low, figures.high] if figures.rows else None
        return {"rows": figures.rows, "seconds": self.lead_in_seconds, "range": reach}

    def _expected_error(self) -> Iterator[str]:
        """Say what error to expect of the move, unless the model does not know."""
        stated = self.model.fit.get("expected_rmse", "")
        unknown = "what error to expect cannot be told: "
        rmse, percent = self.expected_rmse()
        if stated is None:
            yield f"{unknown}{self.model.fit.get('expected_from')}"
        elif rmse is not None:
            unit = self.model.output.suffix
            text = f"expected error of the move {rmse:.3g}{unit} RMS"
            if percent is not None:
                text += f" ({percent:.2g} % of the move)"
            error = self._move_error()
            if error is not None:
                text += self._parts_words(error, unit) + self._start_words(error)
            if self.clipped.count:
                text += ", clipped samples included"
            if self.bandwidth is not None:
                text += ", besides what `bandwidth` takes off"
            yield text
        elif isinstance(stated, float):
            yield (
                f"{unknown}the drive goes from {self.drive_figures.low:.6g} to {self.drive_figures.high:.6g}"
                f"{self.model.input.suffix}, beyond what the model was identified on"
            )

    def _parts_words(self, error: MoveError, unit: str) -> str:
        """Return shape and zero of the error, and what the zero depends on; nothing of an older model."""
        if error.shape is None or error.zero is None:
            return ""
        holds = self.model.fit.get("zero_from", ZERO_STAYS)
        if error.unlike > UNLIKE:
            holds = f"{holds}; the move's swings are unlike the logs', and it may be off by more"
        elif error.repeats_small:
            holds = f"{holds}; small swings that repeat may wander towards the middle of the loop"
        return f": shape {error.shape:.3g}{unit}, zero {error.zero:.3g}{unit} ({holds})"

    def _start_words(self, error: MoveError) -> str:
        """Say from which start the error is to be expected, where the past matters or cannot be known."""
        if self._past_is_known:
            return ""
        if not error.past_matters:
            # From the lower end a model knows one past alone: what an actuator at rest
            # does, it cannot say.
            return self.before_its_first_sweep if self.start == "auto" else ""
        unit = self.model.output.suffix
        whole = math.hypot(error.from_any_past, self._lost_rms())
        start = str(self.start)
        if start in ("auto", "settled"):
            start = "settled at the first row"
        return (
            f"; that is from the start assumed ({start}){self.or_after_a_sweep}, from an unknown past "
            f"{_rounded_up(whole):.3g}{unit}"
        )

    def _past_matters(self, error: MoveError) -> bool:
        """Whether what was before the first row is not known, and makes more than a fifth of the error."""
        return error.past_matters and not self._past_is_known

    @property
    def _past_is_known(self) -> bool:
        """Whether a sweep before the move, or a saved state, says where the actuator comes from."""
        return self.options.condition or isinstance(self.start, ModelState)

    def summary_of_error(self) -> dict[str, Any]:
        """Return the parts of the expected error and what belongs to them as plain values."""
        output = self.model.output
        values: dict[str, Any] = {
            "unit": output.unit,
            "model_range": [output.minimum, output.maximum],
        }
        move = self.move_figures
        if move.low <= move.high:
            values["move_range"] = [move.low, move.high]
        values["expected_shape_rmse"] = None
        values["expected_zero"] = None
        values["expected_from_any_past"] = None
        if self.expected_rmse()[0] is None:
            return values
        error = self._move_error()
        if error is None:
            return values
        past = error.from_any_past if self._past_matters(error) else error.rmse
        whole = math.hypot(past, self._lost_rms(), self._delay_left_rms())
        values["expected_shape_rmse"] = error.shape
        values["expected_zero"] = error.zero
        values["expected_from_any_past"] = whole
        return values

    def expected_rmse(self) -> tuple[float | None, float | None]:
        """Return the error to expect of the move, in its unit and in % of it; None where it is not known."""
        rmse = self.model.fit.get("expected_rmse")
        if not self.states_error or not isinstance(rmse, float):
            return None, None
        covered, drive = self.model.input, self.drive_figures
        slack = SLACK * covered.span
        if drive.low < covered.minimum - slack:
            return None, None
        if drive.high > covered.maximum + slack:
            return None, None
        error = self._move_error()
        if error is not None:
            rmse = error.rmse
        rmse = math.hypot(rmse, self._lost_rms(), self._delay_left_rms())
        span = self.move_figures.high - self.move_figures.low
        if span > 0.0:
            return rmse, 100.0 * rmse / span
        return rmse, None

    def _delay_left_rms(self) -> float:
        """Return what interpolating between samples leaves of the move, RMS, where the model has a delay."""
        left = self.inputs.delay_left
        return 0.0 if left is None else left.rms

    def _move_error(self) -> MoveError | None:
        """Return what error to expect of the first rows of the drive, worked out once for them."""
        if not self.first_drives:
            return None
        rows = self.rows, len(self.first_drives)
        if self._error_of is None or self._error_of[0] != rows:
            self._error_of = rows, self._worked_out()
        return self._error_of[1]

    def _worked_out(self) -> MoveError | None:
        drive = np.concatenate([drive for drive, _ in self.first_drives])
        parts = [steps for _, steps in self.first_drives if steps is not None]
        steps = np.concatenate(parts) if parts else None
        begin = min(self.rows_before, drive.size - 1)
        start = "auto" if isinstance(self.start, ModelState) else self.start
        return move_error(self.model, drive, steps, begin, start)

    def _clipping_words(self) -> str:
        """Say how much of a trajectory the drive's limits do not allow."""
        drive, limits = self.model.input, self.limits
        allowed = (
            f"{drive.quantity} {limits.v_min:.6g} to {limits.v_max:.6g}{drive.suffix}"
        )
        if limits.max_slew is not None:
            allowed += f", {limits.max_slew:.6g}{drive.suffix}/s"
        return f"{self._counted(self.clipped)} beyond what the limits of the drive allow ({allowed})"


def _rounded_up(value: float) -> float:
    """Return a bound to three digits, no smaller than it is."""
    if not 0.0 < value < math.inf:
        return value
    unit = 10.0 ** (math.floor(math.log10(value)) - 2)
    return math.ceil(value / unit * (1.0 - 1e-12)) * unit


def _times_before(before: Before, stamps: FloatArray, step: float) -> FloatArray:
    """Return the times (s) of the rows before a move, from one step before the first of them on."""
    count = before.voltage.size + before.desired.size
    begin = float(stamps[0]) if stamps.size else 0.0
    times: FloatArray = step * np.arange(-count - 1, 0.0) + begin
    return times


def _first_rows(response: Response, count: int) -> Response:
    """Return the first rows of a response."""
    time = None if response.time is None else response.time[:count]
    return Response(time, response.x[:count], response.y[:count])


def compensation(
    model: ActuatorModel,
    source: Source,
    options: DriveOptions,
    brought: Mapping[str, Any] = NOTHING_BROUGHT,
    last_row: int | None = None,
) -> Compensation:
    """Return the run of a forward model's inverse over a trajectory.

    Parameters
    ----------
    model
        A forward model.
    source
        The trajectory, under the name of the model's output.
    options
        What is asked of the drive.
    brought
        What the options that extras bring were given, by name. An extra either watches
        the run, or makes another one in its place.
    last_row
        The last row that is answered; rows after it are only read ahead.

    Raises
    ------
    UsageError
        The limits are not in order, options exclude each other, or nothing brings one
        of them.
    ModelError
        The model is an inverse one.
    """
    model.require("forward")
    watchers: list[Watcher] = []
    make: Callable[..., Compensation] | None = None
    of_make = {}
    for name, value in brought.items():
        watch = extensions.find("run", f"watch {name}")
        if watch is not None:
            watchers.append(watch(model, value))
            continue
        make = extensions.find("run", f"compensate {name}")
        if make is None:
            raise UsageError(f"`{name}` is no parameter of compensate")
        of_make[name] = value
    if make is None:
        return Compensation(
            model, source, last_row=last_row, options=options, watchers=watchers
        )
    run = make(model, source, options, of_make, last_row)
    run.watchers = watchers
    return run
