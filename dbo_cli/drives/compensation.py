"""Compensation: the drive that makes an actuator follow a trajectory, within the drive's limits.

The rows before a move (the sweep into a known state, the way from where the amplifier stands, the rest that
dynamics need) and the move itself are one signal through one inverse in one state; every row of it passes the
gate.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Iterator
from dataclasses import field
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np

from dbo_cli import extensions
from dbo_cli.drives.gate import DriveFigures, DriveGate
from dbo_cli.drives.limits import beyond_range, limits_note, voltage_in
from dbo_cli.drives.model_run import ModelRun, Response, Tally, first_blocks
from dbo_cli.drives.options import DriveOptions, plain_in, volts_a_unit
from dbo_cli.drives.pieces import NOTHING, Before, ramp, require_rows, rest_samples, sweep, sweep_range, way
from dbo_cli.errors import InputError, LimitError, Remarks, UsageError
from dbo_cli.extras.repeat.learning import write_history
from dbo_cli.extras.repeat.settled_loops import slow_model
from dbo_cli.hysteresis.model_state import DriveLimits, ModelState, Simulated
from dbo_cli.hysteresis.move_error import MOST_ROWS, MoveError, move_error
from dbo_cli.logs.sample_block import FloatArray, SampleBlock, even_step, median_step
from dbo_cli.records import dataclass

if TYPE_CHECKING:
    from dbo_cli.extras.repeat.learning import Lesson

REACH_SLACK = 0.01  # of the range: a trajectory this little outside is clipped and counted like any other
SLACK = 1e-9  # of the range: what rounding may add to a drive that ends at its limit
SAME_DRIVE = 1e-9  # of the range: two drives that agree to this are one; chosen, far above rounding


@dataclass
class Compensation(ModelRun):
    """A run of a forward model's inverse over a trajectory; see ``DriveOptions``.

    Attributes
    ----------
    options : DriveOptions
        What is asked of the drive.
    lesson : Lesson, optional
        What recordings of the last pass have taught; the source then holds what is asked of the model instead
        of the trajectory.
    remarks_before : Remarks
        What was said before the run.
    gate : DriveGate
        What every row passes.
    """

    options: DriveOptions = field(default_factory=DriveOptions)
    lesson: Lesson | None = None
    remarks_before: Remarks = field(default_factory=Remarks)
    clipped: Tally = field(default_factory=Tally)
    missed: float = 0.0
    unreachable: int = 0
    lost: float = 0.0  # of clipped samples: the sum of squares of what the move misses, and the most
    most_lost: float = 0.0
    move: DriveFigures = field(default_factory=DriveFigures)
    drive: DriveFigures = field(default_factory=DriveFigures)
    kept: list[tuple[FloatArray, FloatArray | None]] = field(default_factory=list)
    came_from: float | None = field(init=False)
    limits: DriveLimits = field(init=False)
    gate: DriveGate = field(init=False)
    settling: Any = None
    expecting: bool = True
    _error_of: tuple[tuple[int, int], MoveError | None] | None = None

    compensates = True
    remedies = "`condition` sweeps it there, "

    def __post_init__(self) -> None:
        """Take the options apart."""
        options = self.options
        if options.settle is not None:
            self.settling = extensions.find("run", "compensate --settle")(self.model, options.settle)
        self.limits, self.start = options.limits(self.model), options.state
        self.why_time, self.bandwidth = options.why_time, options.bandwidth
        if self.lesson is not None:
            self.why_time, self.bandwidth = "`tracked` depends on it", None
            self.remarks_before.add(self.lesson.remarks)
        super().__post_init__()
        self._run = functools.partial(self.model.compensate, limits=self.limits)
        self.came_from = self._comes_from()
        self.gate = DriveGate(self.limits, self.came_from, self.model.input.suffix)

    def responses(self) -> Iterator[Response]:
        """Return the drive, with the pieces before and after it that were asked for.

        Raises
        ------
        InputError
            The source is bad, time goes backwards, or nothing of it can be reached.
        LimitError
            A limit of the drive was met, and that is refused; or no drive could begin within the limits.
        GateError
            A row breaks a limit: this program's fault.
        """
        blocks, role, step = self.source.blocks(), self.input.quantity, 0.0
        if self.options.has_pieces:
            held, stamps = first_blocks(blocks)
            blocks = chain(held, blocks)
            if self.steps.needed:
                step = self._usual_step(stamps)
            if held:
                before = self._before(float(held[0].values[role][0]), step)
                played, count = before.voltage.size, before.voltage.size + before.desired.size
                # From one step before the first row on.
                times = step * np.arange(-count - 1, 0.0) + (stamps[0] if stamps.size else 0.0)
                yield from self._played(before, times[: played + 1], step)
                if count > played:
                    rows, values = range(1 + played - count, 1), {role: before.desired}
                    blocks = chain([SampleBlock(rows, None, times[played + 1 :], values)], blocks)
        for block, x in self.inputs.blocks(blocks, self.state):
            desired, drive = block.values[role], self.feed(block, x).y
            if block.rows[0] >= 1:
                if self.lesson is not None:
                    end = self.rows - self.rows_before
                    desired = self.lesson.desired[end - drive.size : end]
                self._see(desired, drive)
            yield Response(block.time, desired, drive)
        if self.rows and self.unreachable >= self.rows - self.rows_before > 0:
            raise InputError(
                f"{self.source.name}: every row is outside what the model reaches ({self._range()}): check "
                "unit, column and zero of the trajectory"
            )
        if self.options.return_ is not None and self.state is not None and self.state.time is not None:
            yield self._return(self.state, self.state.time, step)

    def _see(self, desired: FloatArray, drive: FloatArray) -> None:
        self.move.see(desired, None)
        if self.settling is not None:
            self.settling.add(desired, drive)

    def _played(self, before: Before, times: FloatArray, step: float) -> Iterator[Response]:
        """Play the voltages before a move, and go on from the state that they leave."""
        if before.voltage.size:
            yield self._response(times[1:], before.expected, before.voltage, step)
        if before.state is not None:
            self.state = before.state
            if self.source.has_time:
                self.state = dataclasses.replace(before.state, time=float(times[-1]))
                self.steps.last = float(times[-1])

    # --- the rows before and after the trajectory ---

    def _comes_from(self) -> float | None:
        """Return where the drive stands before the first row: a saved state, or what was said, knows it."""
        given, state = self.options.from_, self.start
        asked = None if given is None else voltage_in("from_", given, self.model.input)
        known = self.model.drive_of(state) if isinstance(state, ModelState) else None
        if asked is not None and known is not None and abs(asked - known) > SAME_DRIVE * self.output.span:
            raise UsageError(f"`from_` {asked:g} contradicts `state`, which was left at {known:g}")
        if asked is None and known is None and self.start in ("empty", "full"):
            end = self.model.covered_gears.operator.x_range[0 if self.start == "empty" else 1]
            known = min(max(self.model.inverted.outer_drive(end), self.limits.v_min), self.limits.v_max)
        return asked if known is None else known

    def _usual_step(self, stamps: FloatArray) -> float:
        """Return seconds a row for the pieces (InputError where the clock stands still)."""
        step = self.steps.step or even_step(stamps)
        if step is not None:
            return step
        steps = np.diff(stamps)
        forward = steps[steps > 0.0]
        if not len(forward):
            asked = (self.why_time or "`from_`").split()[0]
            raise InputError(
                f"{self.source.name}: the time does not advance, and {asked} takes its rate from it"
            )
        return median_step(forward)

    def _before(self, first: float, step: float) -> Before:
        """Return the pieces before the trajectory's first value."""
        options, last, limits = self.options, self.gate.last, self.limits
        lead = np.full(self._lead_rows(step), first)
        state = self.start if isinstance(self.start, ModelState) else None
        known = state is not None or options.from_ is not None
        if not known and not options.condition and options.approach is None:
            return Before(NOTHING, NOTHING, lead, None)
        if last is None and not options.condition:
            raise UsageError("`approach` needs `from_` VOLT (what the amplifier stands at) or a `state`")
        rows: list[FloatArray] = []
        if last is not None and options.approach is not None:
            inside = min(max(last, limits.v_min), limits.v_max)
            if options.condition:
                inside = sweep_range(self.model, limits)[0]
            seconds = options.approach if options.condition else "auto"
            here = np.array([last] if state is None else [])  # a state's own row was played before
            rows = [here, ramp("approach", last, inside, step, seconds, limits)]
        if options.condition:
            self.gate.require_start(step, None if rows else sweep_range(self.model, limits)[0])
            rows.append(sweep(self.model, limits, step)[int(bool(rows)) :])
        elif last is not None and options.approach is not None:
            at_rest = state is None and rows[1].size == 0
            rows.append(np.full(0 if at_rest else rest_samples(self.model, step), inside))
        voltage = np.concatenate(rows) if rows else NOTHING
        expected, there, creep = NOTHING, 0.0, 0.0
        if voltage.size or state is None:
            played = voltage if voltage.size or last is None else np.array([last])
            begun = state or self.model.start(float(played[0]), self.start)
            done = self.model.simulate(played, begun, time_step=step if self.steps.needed else None)
            state, expected, there = done.state, done.y[: voltage.size], float(done.y[-1])
            creep = float(done.y[-1] - done.y[-2]) if done.y.size > 1 else 0.0
        elif options.approach is not None:
            there = self.model.displacement_of(state)
        desired = NOTHING
        if options.approach is not None or options.condition:
            seconds = "auto" if options.condition or options.approach is None else options.approach
            desired = way(self.model, state, (there, first), creep, step, seconds, limits)
        return Before(voltage, expected, np.concatenate([desired, lead]), state)

    def _lead_rows(self, step: float) -> int:
        """Return how many rows at the first value stand before a move."""
        asked, options = self.options.lead, self.options
        if asked is None and not options.condition and options.approach is None:
            return 0
        if asked is not None and asked != "auto":
            return require_rows("`lead`", math.ceil(float(asked) / step - SLACK), step)
        ahead = 0 if self.model.dynamics is None else self.model.dynamics.inverter(step).ahead
        return ahead + math.ceil(self.model.delay_seconds / step - SLACK)

    def _return(self, state: ModelState, last_time: float, step: float) -> Response:
        """Return the ramp after the move; nothing is desired there."""
        assert self.gate.last is not None
        rest = 0.0 if self.came_from is None else self.came_from
        target = min(max(rest, self.limits.v_min), self.limits.v_max)
        voltage = ramp("return_", self.gate.last, target, step, self.options.return_, self.limits)
        time = last_time + step * np.arange(1.0, voltage.size + 1.0)
        if voltage.size:
            done = self.model.simulate(voltage, dataclasses.replace(state, undoing=None), time_step=step)
            self.state = dataclasses.replace(done.state, time=float(time[-1]))
        return self._response(time, np.full(voltage.size, math.nan), voltage, step)

    def _response(self, time: FloatArray, desired: FloatArray, drive: FloatArray, step: float) -> Response:
        """Let voltages that are played as they are pass the gate."""
        self.gate.admit(drive, step)
        self.drive.see(drive, step)
        return Response(time, desired, drive)

    # --- one block ---

    def _begun(self, first: float) -> ModelState:
        begun = self.model.start_compensation(first, self.start, self.limits)
        self._note_assumed(begun, first)
        return begun

    def feed(self, block: SampleBlock, x: FloatArray) -> Simulated:
        """Run one block; count what the limits held back, and let the rows pass the gate."""
        if self.state is None:
            self.state = self._begun(float(x[0]))
        before = self.state
        done, steps = super().feed(block, x), self.time_step
        if not self.drive.rows:
            self.gate.require_start(None if steps is None else float(np.ravel(steps)[0]))
        if block.rows[0] >= 1:  # what cannot be reached before a move is none of it
            reach, slack = self.model.output, REACH_SLACK * self.model.output.span
            desired = x if self.model.dynamics is None else block.values[self.input.quantity]
            outside = (desired < reach.minimum - slack) | (desired > reach.maximum + slack)
            self.unreachable += int(np.count_nonzero(outside))
            self._clip(done, block)
            if done.clipped_count:
                self._miss(x - slow_model(self.model).follow(done.y, before, steps).y)
        self.missed = self.missed or done.first_missed
        self.gate.admit(done.y, steps)
        self.drive.see(done.y, steps)
        room = MOST_ROWS - sum(drive.size for drive, _ in self.kept)
        if room > 0:  # on its first rows the error to expect is looked at in the end
            every = None if steps is None else np.broadcast_to(steps, done.y.shape)[:room]
            self.kept.append((done.y[:room], every))
        return done

    def _clip(self, done: Simulated, block: SampleBlock | None) -> None:
        """Count what the limits held back, or refuse it (LimitError); rows before a loop are in no block."""
        if done.clipped_count:
            self.clipped.add(done.clipped_count, done.first_clipped, block)
        if self.options.on_limit == "error" and self.clipped.count:
            raise LimitError(f"{self._clipping()} (`on_limit` clip goes on)")

    def _miss(self, missed: FloatArray) -> None:
        """Add up by how much rows of the move miss what is wanted, where samples of them were clipped."""
        self.lost += float(missed @ missed)
        self.most_lost = max(self.most_lost, float(np.abs(missed).max()))

    def _lost_rms(self) -> float:
        return math.sqrt(self.lost / max(self.rows - self.rows_before, 1))

    def keep_history(self) -> None:
        """Write the history, where one is asked for."""
        if self.options.history is not None and self.lesson is not None:
            write_history(self.options.history, self.lesson.passes)

    # --- what is said ---

    def _add_limits(self, remarks: Remarks) -> None:
        if self.clipped.count:
            unit = self.model.output.suffix
            remarks.warn(
                f"{self._clipping()}: clipped, by which the move misses {self._lost_rms():.3g}{unit} RMS, "
                f"{self.most_lost:.3g}{unit} at worst (`on_limit` error refuses this)"
            )
        elif self.beyond.count:
            super()._add_limits(remarks)
        if self.missed:
            remarks.warn(
                f"{self.source.name}: the drive starts {abs(self.missed):.3g}{self.input.suffix} off the "
                "first value, which the actuator does not pass when it settles (`state` empty or `condition`)"
            )
        if beyond := beyond_range(self.model.input, self.drive.low, self.drive.high):
            remarks.warn(f"{self.source.name}: the drive goes {beyond}")

    def remarks(self) -> Remarks:
        """Return what is to be said of the run so far, and what was said before."""
        remarks = Remarks()
        remarks.add(self.remarks_before)
        remarks.add(super().remarks())
        name = self.source.name
        remarks.note(f"{name}: {text}" for text in self._notes())
        if self.settling is not None:
            remarks.note(self.settling.notes(name, self.drive))
        farad, drive = self.options.farad, self.drive
        if farad is not None and drive.seconds:
            volts = float(volts_a_unit(self.model))
            coulombs, joules = farad * volts * drive.travel, farad * volts**2 * drive.work
            remarks.notes.append(
                f"{name}: into {farad:g} F the drive takes {farad * volts * drive.fastest:.3g} A at most, "
                f"{coulombs / drive.seconds:.3g} A and {joules / drive.seconds:.3g} W (voltage times "
                "current) on average"
            )
        found = self._move_error() if self.expecting and self.expected_rmse()[0] is not None else None
        # Where clipping is the error, what is left of the move tells nothing of the logs.
        if found is not None and not found.rmse < max(found.straight_line, self._lost_rms()):
            unit = self.model.output.suffix
            remarks.warn(
                f"{name}: the expected error of the move, {found.rmse:.3g}{unit}, is no better than that of "
                f"a straight line, {found.straight_line:.3g}{unit}: the logs do not tell what it asks"
            )
        return remarks

    def _notes(self) -> Iterator[str]:
        """Say in which units limits are read, how the drive begins, where it may step, and what to expect."""
        unit, first, scale = self.output.suffix, self.drive.first, self.voltage_scale
        asked = self.options
        if read := plain_in(self.model.input.unit, asked.v_min, asked.v_max, asked.max_slew, asked.from_):
            yield read
        if held := limits_note(self.model.input, self.limits, asked.v_min, asked.v_max):
            yield held
        if first is not None and self.came_from is None:
            yield (
                f"the drive begins at {first:.6g}{unit}; from where the amplifier comes is not known "
                "(`from_` VOLT says it, `approach` ramps there)"
            )
        elif first is not None and self.came_from is not None and self.limits.max_slew is None:
            if abs(first - self.came_from) > self.drive.largest_step:
                yield (
                    f"the first row steps from {self.came_from:.6g} to {first:.6g}{unit} (`approach` SECONDS "
                    "ramps there)"
                )
        if scale is not None:
            yield (
                f"the drive is in the voltages of the model's logs {scale} (`gain` of waveform takes it back "
                "to the converter's)"
            )
        if self.lesson is None and self.rows and self.expecting:
            yield from self._expected_error()

    def _expected_error(self) -> Iterator[str]:
        """Say what error to expect of the move, unless the model does not know."""
        stated, unknown = self.model.fit.get("expected_rmse", ""), "what error to expect cannot be told: "
        rmse, percent = self.expected_rmse()
        if stated is None:
            yield f"{unknown}{self.model.fit.get('expected_from')}"
        elif rmse is not None:
            part = "" if percent is None else f" ({percent:.2g} % of the move)"
            held = ", clipped samples included" if self.clipped.count else ""
            held += ", besides what `bandwidth` takes off" if self.bandwidth is not None else ""
            yield f"expected error of the move {rmse:.3g}{self.model.output.suffix} RMS{part}{held}"
        elif isinstance(stated, float):
            yield (
                f"{unknown}the drive goes from {self.drive.low:.6g} to {self.drive.high:.6g}"
                f"{self.model.input.suffix}, beyond what the model was identified on"
            )

    def expected_rmse(self) -> tuple[float | None, float | None]:
        """Return the error to expect of the move, in its unit and in % of it; None where it is not known."""
        rmse, covered = self.model.fit.get("expected_rmse"), self.model.input
        slack = SLACK * covered.span
        beyond = self.drive.low < covered.minimum - slack or self.drive.high > covered.maximum + slack
        if self.lesson is not None or not isinstance(rmse, float) or beyond:
            return None, None
        found = self._move_error()
        rmse = math.hypot(rmse if found is None else found.rmse, self._lost_rms())
        span = self.move.high - self.move.low
        return rmse, 100.0 * rmse / span if span > 0.0 else None

    def _move_error(self) -> MoveError | None:
        """Return what to expect of the rows that were kept, worked out once for them."""
        if not self.kept:
            return None
        rows = self.rows, len(self.kept)
        if self._error_of is None or self._error_of[0] != rows:
            self._error_of = rows, self._worked_out()
        return self._error_of[1]

    def _worked_out(self) -> MoveError | None:
        drive = np.concatenate([drive for drive, _ in self.kept])
        steps = [one for _, one in self.kept if one is not None]
        begin = min(self.rows_before, drive.size - 1)
        return move_error(self.model, drive, np.concatenate(steps) if steps else None, begin)

    def _clipping(self) -> str:
        """Say how much of a trajectory the drive's limits do not allow."""
        drive, limits = self.model.input, self.limits
        said = f"{drive.quantity} {limits.v_min:.6g} to {limits.v_max:.6g}{drive.suffix}"
        if limits.max_slew is not None:
            said += f", {limits.max_slew:.6g}{drive.suffix}/s"
        return f"{self._counted(self.clipped)} beyond what the limits of the drive allow ({said})"
