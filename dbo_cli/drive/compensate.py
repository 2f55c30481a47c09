"""Compensation: the drive that makes an actuator follow a trajectory, within its limits.

One object drives, whoever feeds it: ``Driver`` takes the blocks of a file or a pipe, and
``plan`` hands it an array in blocks. What stands before the move and the move itself are
one signal through one inverse in one state, and every row passes the gate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from dbo_cli.arrays import Floats
from dbo_cli.drive import judge
from dbo_cli.drive.ahead import NO_ROWS, Ahead, Rows, joined
from dbo_cli.drive.drive import Drive
from dbo_cli.drive.lead import Lead, Seconds, plan_lead, ramp, standing_at
from dbo_cli.drive.limits import Gate, Limits
from dbo_cli.errors import InputError, LimitError, UsageError, warn
from dbo_cli.model import Cascade, Run, State, Steps, Undoing, steps_of

if TYPE_CHECKING:
    from dbo_cli.drive.learning import PassRecord, Tracked

Clock = float | ArrayLike | None
OnLimit = Literal["auto", "clip", "error"]

BLOCK_ROWS = 65_536  # that are driven at once: what they take stays in caches
LARGEST = 1e60  # of a displacement, as of the numbers of a model
PAUSE = 1e-6
"""Of a step: so much later than a step behind a state, its voltage was held."""


class Driver:
    """Drives one actuator along a trajectory that comes in blocks, in constant memory.

    Parameters
    ----------
    model : Cascade
        A forward model.
    limits : Limits
        What the drive may do.
    lead : Lead, optional
        What stands before the move.
    on_limit : {"auto", "clip", "error"}
        auto: what costs more than one percent of the move (RMS) is refused at the end.
    return_to : float, optional
        Voltage to go to after the move.
    name : str
        Of the trajectory, in messages.
    hold : int
        Rows by which what stands before the move is longer: another channel needs them.

    Attributes
    ----------
    lead_count : int
        Rows before the move, once the first block came.

    Raises
    ------
    LimitError
        The amplifier stands outside the rating.
    ModelError
        The model is an inverse one.
    UsageError
        ``on_limit`` is unknown, or ``lead`` contradicts itself.
    """

    def __init__(
        self,
        model: Cascade,
        limits: Limits,
        lead: Lead | None = None,
        on_limit: OnLimit = "auto",
        return_to: float | None = None,
        name: str = "trajectory",
        hold: int = 0,
    ) -> None:
        model.require("forward")
        if on_limit not in get_args(OnLimit):
            raise UsageError(f"`on_limit` {on_limit}: give auto, clip or error")
        self.model, self.limits, self.name = model, limits, name
        self.on_limit, self.return_to, self.hold = on_limit, return_to, hold
        self.lead = Lead() if lead is None else lead
        self.gate = Gate(limits, standing_at(limits, self.lead))
        self.lead_count = 0
        self._asks_start = self.gate.last is None and self.lead.state in (
            "auto",
            "settled",
        )
        self._state: State | None = None
        self._row_count = 0
        self._step = 0.0
        # undoing dynamics and delay: what waits, and how many rows of it stand before the move
        self._ahead: Ahead | None = None
        self._still = 0
        self._dt: Steps = None
        self._undoing: Undoing | None = None
        self._is_moving = False
        # what judgements look at
        self._clipping = judge.Clipping()
        self._excerpt = judge.Excerpt()
        self._figures = Drive(model, limits, name, past_known=self.lead.past_known)

    # --- rows ---

    def rows(
        self,
        desired: Floats,
        dt: Steps = None,
        time: Floats | None = None,
        target: Floats | None = None,
    ) -> Rows:
        """Return times, displacements and voltages of the rows that are ready.

        Parameters
        ----------
        desired : array
            The next rows of the trajectory.
        dt : float, array or None
            Seconds since the row before; one number where they are even.
        time : array, optional
            Seconds of each row.
        target : array, optional
            What is asked of the model for them, where that is not the trajectory.

        Raises
        ------
        InputError
            The trajectory is bad.
        LimitError
            A limit was met and that is refused, or the drive cannot begin.
        GateError
            A row breaks a limit: this program's fault.
        """
        target = desired if target is None else target
        require_numbers(self.name, target, self._row_count)
        self._row_count += target.size
        if not target.size:
            return NO_ROWS
        parts = []
        if self._ahead is None:
            dt, rows = self._begin(float(target[0]), dt, time)
            parts.append(rows)
        self._dt = dt
        assert self._ahead is not None
        for block in self._ahead.take(target, desired, time):
            parts.append(self._driven(*block))
        return joined(parts)

    def finish(self, return_rows: int = 0) -> tuple[Rows, Drive]:
        """Return the rows that were held back and the way back, and the figures of the whole drive.

        Parameters
        ----------
        return_rows
            The way back takes as many rows at least: another channel needs them.

        Raises
        ------
        InputError
            The trajectory has no rows, or nothing of it can be reached.
        LimitError
            The limits cost too much of the move, or the way back is outside the rating.
        """
        if self._ahead is None:
            raise InputError(f"{self.name}: has no rows")
        parts = [self._driven(*block) for block in self._ahead.remaining()]
        self._require_longer_than_delay()
        self._require_reached()
        voltage = self.way_back()
        last = voltage[-1] if voltage.size else self.gate.last
        rest = np.full(max(return_rows - voltage.size, 0), last)
        voltage = np.concatenate([voltage, rest])
        if voltage.size:
            assert self._state is not None
            begin = self._state.time
            count = np.arange(1.0, voltage.size + 1.0)
            stamps = (begin or 0.0) + self._step * count
            parts.append(self._played(stamps, voltage, "return", begin is not None))
        return joined(parts), self._concluded()

    def way_back(self) -> Floats:
        """Return the voltages from the last row to where the amplifier goes after the move."""
        if self.return_to is None:
            return np.empty(0)
        self.limits.require_start(self.return_to, "`return`")
        assert self.gate.last is not None
        begin, end = self.gate.last, self.return_to
        return ramp("return", begin, end, self._step, "auto", self.limits)

    def loop(
        self, desired: Floats, target: Floats, time: Floats, dt: float, passes: int
    ) -> Drive:
        """Return the settled drive of one period that is looped, behind what leads to it.

        Parameters
        ----------
        desired, target
            One period of the trajectory, and of what is asked of the model for it.
        time, dt
            Seconds of each row, and seconds a row.
        passes
            Of run-in.

        Raises
        ------
        InputError, LimitError, UsageError
            As of ``loops.plan_loop``; or the limits cost too much of the loop.
        """
        from dbo_cli.drive import loops

        if self.return_to is not None:
            raise UsageError(
                "`periodic` excludes `condition`, `lead` and `return`: use `passes` N"
            )
        model = self.model
        plan = loops.plan_loop(
            model, self.limits, target, dt, self.lead, passes, self.name, self.hold
        )
        run, state = plan.settled.run, plan.settled.before
        self._clip(desired, plan.target, run, state, dt)
        self._require_reached(dt * desired.size)
        warnings = plan.require_settled(self.on_limit)
        lead, voltage = plan.lead_voltage, plan.voltage
        first = float(lead[0] if lead.size else voltage[0])
        self.gate.require_reachable(first, first, dt)
        self._admit(lead, dt, "lead")
        self._admit(voltage, dt, "move")
        self.gate.admit(voltage[:1], dt)  # the seam
        count = lead.size
        whole = np.concatenate([lead, voltage])
        played = model.run(whole, plan.begin, dt)
        self._state = replace(played.state, time=float(time[-1]))
        self._figures = replace(
            self._figures, lead_seconds=count * dt, known_by="state"
        )
        drive = self._concluded()
        away = played.y[count:] - loops.settled_run(model, voltage, dt, state)
        away_rms = float(np.sqrt(np.mean(away**2)))
        note = f"the first pass is {away_rms:.3g}{model.output.suffix} off the settled one (RMS)"
        return replace(
            drive,
            time=np.concatenate([time[0] - dt * np.arange(count, 0.0, -1.0), time]),
            desired=np.concatenate([played.y[:count], desired]),
            voltage=whole,
            move=slice(count, whole.size),
            notes=(f"{self.name}: {note}",),
            warnings=(*warnings, *drive.warnings),
        )

    # --- a whole trajectory ---

    def whole(
        self,
        desired: ArrayLike,
        clock: Clock,
        *,
        bandwidth: float | None = None,
        periodic: bool = False,
        passes: int = 0,
        tracked: Sequence[Tracked] = (),
        history: Sequence[PassRecord] = (),
        absolute: bool = False,
        return_rows: int = 0,
    ) -> Drive:
        """Return the drive of a whole trajectory; the parameters are those of ``plan`` and ``finish``."""
        if passes and not periodic:
            raise UsageError("`passes` needs `periodic`")
        if history and not tracked:
            raise UsageError("`history` needs `tracked` LOG")
        name, model = self.name, self.model
        values = np.ascontiguousarray(desired, dtype=np.float64).reshape(-1)
        require_numbers(name, values)
        time, dt = _clock(clock, values.size, name)
        target, lesson = values, None
        if tracked or periodic or bandwidth is not None:
            seconds, step = _even(time, dt, name)
        if tracked:
            from dbo_cli.drive.learning import RepeatedMove

            state = self.lead.state
            swept = self.limits.move if self.lead.condition else None
            move = RepeatedMove(
                model, values, seconds, step, state, periodic, absolute, swept
            )
            lesson = move.lesson(tracked, history, bandwidth)
            target = lesson.request
        elif bandwidth is not None:
            from dbo_cli.drive.lowpass import low_pass

            target = low_pass(values, bandwidth, step, periodic)
        if periodic:
            drive = self.loop(values, target, seconds, step, passes)
        else:
            drive = self._driven_whole(values, target, time, dt, return_rows)
        if lesson is None:
            return drive
        return replace(
            drive,
            # the model's own error is what was learned
            expected_error=lesson.rmse,
            expected_known=None,
            history=lesson.history,
            notes=(*lesson.notes, *drive.notes),
            warnings=(*lesson.warnings, *drive.warnings),
        )

    def _driven_whole(
        self,
        desired: Floats,
        target: Floats,
        time: Floats | None,
        dt: Steps,
        return_rows: int,
    ) -> Drive:
        """Return the drive of a whole trajectory, driven in blocks."""
        parts = []
        for begin in range(0, desired.size, BLOCK_ROWS):
            rows = slice(begin, begin + BLOCK_ROWS)
            stamps = None if time is None else time[rows]
            steps = dt[rows] if isinstance(dt, np.ndarray) else dt
            parts.append(self.rows(desired[rows], steps, stamps, target[rows]))
        rest, drive = self.finish(return_rows)
        whole = joined([*parts, rest])
        move = slice(drive.lead_rows, drive.lead_rows + drive.move_rows)
        return replace(
            drive, time=whole.time, desired=whole.x, voltage=whole.y, move=move
        )

    # --- before the move ---

    def _begin(
        self, first: float, dt: Steps, time: Floats | None
    ) -> tuple[Steps, Rows]:
        """Return the time steps of the first block, and the rows before the move that are ready."""
        lead = self.lead
        step = self._step = self._usual_step(dt)
        if isinstance(dt, np.ndarray):
            dt = np.concatenate([[step], dt[1:]])
        if isinstance(lead.state, State):
            lead = replace(lead, state=_aged(self.model, lead.state, time, step))
        planned = plan_lead(self.model, first, step, self.limits, lead, self.hold)
        self._state, voltage, self._still = planned
        self.lead_count = voltage.size + self._still
        begin = 0.0 if time is None else float(time[0])
        stamps = begin - step * np.arange(self.lead_count, 0.0, -1.0)
        self._figures = replace(self._figures, lead_seconds=self.lead_count * step)
        played = NO_ROWS
        if voltage.size:
            before = stamps[: voltage.size]
            played = self._played(before, voltage, "lead", time is not None)
        else:
            self.gate.require_reachable(*self.limits.move, dt)
        inverter = self.model.inverter(dt)
        self._ahead = Ahead(inverter.ahead)
        if self._state is not None:
            self._undoing = inverter.behind(self._state)
        parts = [played]
        if self._still:
            still = np.full(self._still, first)
            at_rest = None if time is None else stamps[voltage.size :]
            self._dt = step
            for block in self._ahead.take(still, still, at_rest):
                parts.append(self._driven(*block))
        return dt, joined(parts)

    def _usual_step(self, dt: Steps) -> float:
        """Return the seconds a row at the beginning; 0 without a clock.

        Raises
        ------
        InputError
            There is none, and something depends on the time.
        """
        step, lead = dt, self.lead
        if isinstance(dt, np.ndarray):
            forward = dt[1:][dt[1:] > 0.0]
            step = float(np.median(forward)) if forward.size else None
        if step is not None:
            return float(step)
        timed = lead.condition or lead.approach or lead.rest or self.hold
        timed = timed or self.return_to is not None or self.limits.slew is not None
        if timed or self.model.needs_time:
            raise InputError(
                f"{self.name}: the model or the limits need a clock: a time column that advances, or "
                "`sample_rate` HZ"
            )
        return 0.0

    # --- the way of a row ---

    def _driven(self, columns: tuple[Floats | None, ...], known: Floats) -> Rows:
        """Return the drive of rows that are ready; ``known`` is what is asked for them and after them."""
        _, desired, time = columns
        assert desired is not None
        model = self.model
        target, self._undoing = model.inverter(self._dt).run(known, self._undoing)
        if self._state is None:
            self._state = self._started(float(target[0]))
        if not self._is_moving:
            self._is_moving, step = True, self._dt
            late = round(model.delay_seconds / step) if isinstance(step, float) else 0
            off = float(target[0] - known[late])
            self._figures = replace(self._figures, off=off)
        part = "lead" if self._still else "move"
        self._still = 0
        return Rows(time, desired, self._inverted(desired, target, time, part))

    def _started(self, first: float) -> State:
        """Return the state in which a drive begins that nothing leads to."""
        begin = self.model.start_drive(first, self.lead.state, *self.limits.move)
        if self.gate.last is None and self.limits.slew is not None:
            self.gate.last = begin.drive
        return begin

    def _inverted(
        self,
        desired: Floats,
        target: Floats,
        time: Floats | None,
        part: str,
    ) -> Floats:
        """Return the voltages with which the static part reaches a target, within the limits."""
        model, limits, state, dt = self.model, self.limits, self._state, self._dt
        assert state is not None
        run = model.drive(target, state, dt, limits.move, limits.slew)
        if part == "move":
            self._clip(desired, target, run, state, dt)
        clipped_at_once = run.clipped and run.first_clipped == 0
        beyond = model.inverse().outside(target[:1])[0]
        if state.first is not None and not clipped_at_once and not beyond:
            reached = model.static.run(run.y[:1], state, 0.0).y
            self._figures = replace(self._figures, missed=float(target[0] - reached[0]))
        self._admit(run.y, dt, part)
        self._state = run.state
        if time is not None:
            self._state = replace(run.state, time=float(time[-1]))
        return run.y

    def _played(self, time: Floats, voltage: Floats, part: str, clocked: bool) -> Rows:
        """Return rows that are played as they are, with the displacement that the model expects of them."""
        assert self._state is not None
        run = self.model.run(voltage, self._state, self._step)
        self._admit(voltage, self._step, part)
        self._state = replace(run.state, time=float(time[-1]))
        return Rows(time if clocked else None, run.y, voltage)

    # --- what is judged ---

    def _clip(
        self, desired: Floats, target: Floats, run: Run, state: State, dt: Steps
    ) -> None:
        """Count rows of the move and what the limits cut off them (LimitError: ``on_limit`` is error)."""
        excerpt = self._excerpt
        clipping = judge.clip(
            self._clipping, self.model, desired, target, run, state, dt
        )
        self._clipping = clipping
        excerpt.state = excerpt.state or state
        excerpt.target.append((target, dt))
        if self.limits.slew is None or clipping.rows > judge.FIRST_ROWS:
            excerpt.target.clear()
        if clipping.clipped and self.on_limit == "error":
            fits = judge.would_fit(self.model, self.limits, clipping, excerpt)
            raise LimitError(
                f"{self.name}: {clipping.said(self.limits)}{fits} (or `on_limit` clip)"
            )

    def _admit(self, voltage: Floats, dt: Steps, part: str) -> None:
        """Let rows of a part (``lead``, ``move``, ``return``) pass the gate, and count them."""
        self.gate.admit(voltage, dt, part)
        if not voltage.size:
            return
        figures = self._figures
        changes: dict[str, object] = {
            "rows": figures.rows + voltage.size,
            "voltage_range": judge.widened(figures.voltage_range, voltage),
        }
        if not figures.rows and self._asks_start:
            changes["starts_at"] = float(voltage[0])
        if part == "lead":
            changes["lead_rows"] = figures.lead_rows + voltage.size
            changes["lead_range"] = judge.widened(figures.lead_range, voltage)
        if part == "move":
            before = self._clipping.rows - voltage.size
            voltage = voltage[: max(judge.FIRST_ROWS - before, 0)]
        if part != "return" and voltage.size:
            steps = dt[: voltage.size] if isinstance(dt, np.ndarray) else dt
            self._excerpt.voltage.append(voltage)
            self._excerpt.steps.append(steps)
        self._figures = replace(figures, **changes)  # type: ignore[arg-type]

    def _require_longer_than_delay(self) -> None:
        """Refuse a move that is over before the model answers (LimitError)."""
        delay, seconds = self.model.delay_seconds, self._clipping.rows * self._step
        if self.on_limit == "auto" and delay > seconds:
            raise LimitError(
                f"{self.name}: the move, {seconds:.4g} s, is shorter than the model's delay, {delay:.4g} "
                "s (`on_limit` clip writes it)"
            )

    def _require_reached(self, period: float | None = None) -> None:
        """Refuse a move of which too little is reached; ``period`` is that of a loop in seconds."""
        judged = self._clipping, self._excerpt, self.on_limit == "auto", period
        judge.require_reached(self.name, self.model, self.limits, *judged)

    def _concluded(self) -> Drive:
        """Return the figures of a drive of which all rows were seen, and warn of what is unusual."""
        model, limits, clipping = self.model, self.limits, self._clipping
        figures, lost = self._figures, self._clipping.rms
        assert figures.voltage_range is not None
        beyond = judge.beyond_identified(limits, *figures.voltage_range)
        error = known = None
        if not beyond:
            played, rest = (model, self._excerpt), (figures.lead_rows, lost)
            saved = isinstance(self.lead.state, State)
            error = judge.expected(*played, figures.past_known, saved, *rest)
            if error is not None and not figures.past_known:
                known = judge.expected(*played, True, True, *rest)
        start = judge.start_warnings(
            model, limits, clipping, figures.missed, figures.off
        )
        texts = [*start, *beyond]
        texts += judge.move_warnings(model, self._excerpt, error, lost)
        texts += judge.creeping_hold(model, limits, self._state)
        warnings = tuple(f"{self.name}: {text}" for text in texts)
        for text in warnings:
            warn(text)
        return replace(
            figures,
            move_rows=clipping.rows,
            move_range=[clipping.low, clipping.high],
            clipped=clipping.clipped,
            first_clipped=clipping.first,
            lost_rms=lost,
            lost_most=clipping.largest,
            expected_error=error,
            expected_known=known,
            state=self._state,
            warnings=warnings,
        )


def plan(
    model: Cascade,
    desired: ArrayLike,
    clock: Clock,
    limits: Limits,
    *,
    state: str | State = "auto",
    start: float | None = None,
    approach: Seconds = None,
    condition: bool = False,
    lead: Seconds = None,
    return_to: float | None = None,
    bandwidth: float | None = None,
    periodic: bool = False,
    passes: int = 0,
    on_limit: OnLimit = "auto",
    tracked: Sequence[Tracked] = (),
    history: Sequence[PassRecord] = (),
    absolute: bool = False,
    name: str = "trajectory",
) -> Drive:
    """Return the drive of a whole trajectory.

    Parameters
    ----------
    model : Model
        A forward model.
    desired : array, shape (n,)
        Displacement, in the unit of the model's output.
    clock : float, array of shape (n,), or None
        Seconds a row, or the time of each row (s).
    limits : Limits
        What the drive may do.
    state : str or State
        ``auto``, ``empty``, ``full``, ``settled``, or the state to go on from.
    start : float, optional
        Voltage at which the amplifier stands.
    approach, lead : float or "auto", optional
        Seconds of the way to the first value, and of a rest there.
    condition : bool
        Sweep the move's range first, so that the past is known.
    return_to : float, optional
        Voltage to go to after the move.
    bandwidth : float, optional
        Cut-off (Hz) of a zero-phase low-pass on the trajectory; with ``tracked``, on
        what is learned.
    periodic : bool
        The trajectory is one period of a loop; the drive is that of the settled loop.
    passes : int
        Passes of run-in before that period.
    on_limit : {"auto", "clip", "error"}
        auto: clip while that costs at most one percent of the move (RMS).
    tracked, history : sequence
        Recordings of the last pass, and the passes so far: the move is learned.
    absolute : bool
        Learn the mean of the error, too.
    name : str
        Of the trajectory, in messages.

    Raises
    ------
    LimitError
        The move cannot be driven within the limits, or costs too much of it.
    InputError
        The trajectory, its clock or a recording is bad.
    UsageError
        Options exclude each other.
    """
    before = Lead(state, start, approach, condition, lead)
    driver = Driver(model, limits, before, on_limit, return_to, name)
    return driver.whole(
        desired,
        clock,
        bandwidth=bandwidth,
        periodic=periodic,
        passes=passes,
        tracked=tracked,
        history=history,
        absolute=absolute,
    )


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


def _aged(model: Cascade, state: State, time: Floats | None, step: float) -> State:
    """Return a state after the pause between its last row and the first one: the voltage was held."""
    if state.time is None or state.drive is None or time is None:
        return state
    pause = float(time[0]) - state.time - step
    if pause <= PAUSE * step:
        return state
    return model.run(np.array([state.drive]), state, pause).state


def _clock(clock: Clock, count: int, name: str) -> tuple[Floats | None, Steps]:
    """Return the time of each row, and the seconds between rows; None of both without a clock.

    Raises
    ------
    InputError
        There are more or fewer times than rows, or a step is not above 0.
    """
    if clock is None:
        return None, None
    if np.ndim(clock) == 0:
        step = float(np.asarray(clock))
        if not 0.0 < step < np.inf:
            raise InputError(f"{name}: {step:g} s between rows: give seconds above 0")
        return np.asarray(step * np.arange(count), dtype=np.float64), step
    time = np.ascontiguousarray(clock, dtype=np.float64).reshape(-1)
    if time.size != count:
        raise InputError(f"{name}: {time.size:,} times for {count:,} rows")
    if not np.isfinite(time).all():
        raise InputError(f"{name}: one time is not a number")
    try:
        return time, steps_of(time)
    except InputError as problem:
        raise InputError(f"{name}: {problem}") from None


def _even(time: Floats | None, dt: Steps, name: str) -> tuple[Floats, float]:
    """Return the time of each row and the step of an even clock (InputError: it is uneven)."""
    if time is None or not isinstance(dt, float):
        raise InputError(
            f"{name}: `tracked`, `periodic` and `bandwidth` need an even clock (`sample_rate` HZ, or "
            "`resample` HZ)"
        )
    return time, dt
