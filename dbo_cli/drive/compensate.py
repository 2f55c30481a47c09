"""Compensation: the drive that makes an actuator follow a trajectory, within its limits.

One object drives, whoever feeds it: ``Driver.rows`` takes the blocks of a file or a pipe,
and ``Driver.whole`` an array, in blocks. What stands before the move and the move itself
are one signal through one inverse in one state, and every row passes the gate.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal, get_args

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.drive.drive import Drive, PassRecord
from dbo_cli.drive.judge import Judge
from dbo_cli.drive.lead import Lead, ramp
from dbo_cli.drive.limits import voltage_in
from dbo_cli.drive.simulate import NO_ROWS, Ahead, Due, Rows, stacked
from dbo_cli.errors import InputError, UsageError
from dbo_cli.model import State, Steps
from dbo_cli.units import Typed

OnLimit = Literal["auto", "clip", "error"]

DRIVEN_ROWS = 65_536  # that are driven at once: what they take stays in caches
LARGEST_DISPLACEMENT = 1e60  # of a displacement, as of the numbers of a model


class Driver:
    """Drives one actuator along a trajectory that comes in blocks, in constant memory.

    Parameters
    ----------
    lead : Lead
        A forward model, what its drive may do, and what stands before the move.
    on_limit : {"auto", "clip", "error"}
        auto: what costs more than one percent of the move (RMS) is refused at the end.
    return_to : float or str, optional
        Voltage to go to after the move; a text has a unit.
    name : str
        Of the trajectory, in messages.
    return_rows : int
        The way back takes as many rows at least: another channel needs them.

    Raises
    ------
    UsageError
        ``on_limit`` is unknown, or ``return_to`` cannot be read.
    """

    def __init__(
        self,
        lead: Lead,
        *,
        on_limit: OnLimit = "auto",
        return_to: Typed | None = None,
        name: str = "trajectory",
        return_rows: int = 0,
    ) -> None:
        if on_limit not in get_args(OnLimit):
            raise UsageError(f"`on_limit` {on_limit}: give auto, clip or error")
        self.model, self.limits, self.name = lead.model, lead.limits, name
        self.lead, self.on_limit, self.return_rows = lead, on_limit, return_rows
        self.return_to = voltage_in("return_", return_to, lead.model.input)
        self._judge = Judge(lead, on_limit, name)
        self._state: State | str = lead.state
        self._row_count = 0
        self._step = self._first = 0.0  # seconds a row, and the first value asked for
        self._began: float | None = None  # stamp of the first row of the move
        self._ahead: Ahead | None = None  # undoing dynamics and delay

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
        self._require_numbers(target)
        self._row_count += target.size
        if not target.size:
            return NO_ROWS
        before = NO_ROWS
        if self._ahead is None:
            dt, before = self._begin(float(target[0]), dt, time)
        assert self._ahead is not None
        due = self._ahead.take(Due(target, desired, time, dt))
        return stacked([before, *map(self._driven, due)])

    def finish(self) -> tuple[Rows, Drive]:
        """Return the rows that were held back and the way back, and the figures of the whole drive.

        Raises
        ------
        InputError
            The trajectory has no rows, or nothing of it can be reached.
        LimitError
            The limits cost too much of the move, or the way back is outside the rating.
        """
        if self._ahead is None:
            raise InputError(f"{self.name}: has no rows")
        rows = stacked([self._driven(due) for due in self._ahead.remaining()])
        self._judge.require_reached(self._step)
        voltage, begin = self._way_back(), self._last_state.time
        stamps = (begin or 0.0) + self._step * np.arange(1.0, voltage.size + 1.0)
        back = self._played(stamps, voltage, "return")
        drive = self._judge.concluded(self._last_state, self._step)
        if self._began is not None and begin is not None:
            drive = replace(drive, move_time=[self._began, begin])
        return stacked([rows, back]), drive

    @property
    def _last_state(self) -> State:
        """The state after the last row that was driven."""
        assert isinstance(self._state, State)
        return self._state

    def _way_back(self) -> Floats:
        """Return the voltages from the last row to where the amplifier goes."""
        last, end = self._judge.last, self.return_to
        assert last is not None
        if end is None:
            return np.full(self.return_rows, last)
        self.limits.require_start(end, "`return_`")
        voltage = ramp(last, end, self._step, None, self.limits)
        return np.append(voltage, np.full(max(self.return_rows - voltage.size, 0), end))

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
            As of ``loops.Loop``; or the limits cost too much of the loop.
        """
        from dbo_cli.drive import loops

        model, lead = self.model, self.lead
        if self.return_to is not None or lead.condition or lead.rest:
            raise UsageError(
                "`periodic` excludes `condition`, `lead` and `return_`: use `passes` N"
            )
        loop = loops.Loop(lead, target, dt, passes, self.name)
        self._judge.clip(desired, loop.target, loop.run, loop.state, dt, loop=True)
        self._judge.require_reached(math.inf)
        self._judge.warned = loop.require_settled(self.on_limit)
        leading, period = loop.lead_voltage, loop.voltage
        first = float(leading[0] if leading.size else period[0])
        self.limits.require_reachable((first, first), self._judge.last, dt)
        self._state, self._step = loop.begin, dt
        stamps = time[0] - dt * np.arange(leading.size, 0.0, -1.0)
        before = self._played(stamps, leading, "lead")
        first_pass = self._played(time, period, "move")
        self.limits.admit(period[:1], self._judge.last, dt, "move")  # the seam
        unsettled = first_pass.x - loops.settled_run(model, period, dt, loop.state)
        self._judge.unsettled = float(np.sqrt(np.mean(unsettled**2)))
        drive = self._judge.concluded(self._state, dt)
        drive = replace(drive, move_time=time[[0, -1]].tolist())
        return drive.with_rows(stacked([before, first_pass._replace(x=desired)]))

    # --- a whole trajectory ---

    def whole(
        self,
        desired: Floats,
        dt: Steps,
        time: Floats | None = None,
        *,
        bandwidth: float | None = None,
        periodic: bool = False,
        passes: int = 0,
        tracked: Sequence[tuple[str, Rows]] = (),
        history: Sequence[PassRecord] = (),
        absolute: bool = False,
    ) -> Drive:
        """Return the drive of a whole trajectory, with its rows.

        Parameters
        ----------
        desired, dt, time
            As of ``rows``; without time stamps an even clock begins at 0.
        bandwidth : float, optional
            Cut-off (Hz) of a zero-phase low-pass on the trajectory; with ``tracked``, on
            what is learned.
        periodic, passes
            The trajectory is one period of a loop, after so many passes of run-in.
        tracked, history, absolute
            Recordings of the last pass (names, and rows of drive and displacement), and
            the passes so far: the move is learned, with ``absolute`` its mean error, too.

        Raises
        ------
        InputError, LimitError, UsageError
            As of ``rows``, ``finish`` and ``loop``; or options exclude each other.
        """
        if passes and not periodic:
            raise UsageError("`passes` needs `periodic`")
        if (history or absolute) and not tracked:
            raise UsageError("`history`, `absolute`: each needs `tracked` LOG")
        self._require_numbers(desired)
        step = dt if isinstance(dt, float) else None
        if time is None and step is not None:
            time = step * np.arange(float(desired.size))
        if not (tracked or periodic or bandwidth is not None):
            return self._in_blocks(desired, desired, dt, time)
        if time is None or step is None:
            raise InputError(
                f"{self.name}: `tracked`, `periodic` and `bandwidth` need an even clock (`sample_rate` "
                "HZ, or `resample` HZ)"
            )
        target, figures = desired, dict[str, Any]()
        if tracked:
            from dbo_cli.drive.learning import learned

            target, figures = learned(
                self.lead,
                desired,
                float(time[0]),
                step,
                tracked,
                history,
                bandwidth=bandwidth,
                periodic=periodic,
                absolute=absolute,
            )
        elif bandwidth is not None:
            from dbo_cli.drive.smooth import low_pass

            target = low_pass(desired, bandwidth, step, periodic)
            self._judge.rounding = float(np.sqrt(np.mean((target - desired) ** 2)))
        if periodic:
            drive = self.loop(desired, target, time, step, passes)
        else:
            drive = self._in_blocks(desired, target, dt, time)
        return replace(drive, **figures)

    def _in_blocks(
        self, desired: Floats, target: Floats, dt: Steps, time: Floats | None
    ) -> Drive:
        """Return the drive of a whole trajectory that is driven in blocks, with its rows."""
        blocks = []
        for begin in range(0, desired.size, DRIVEN_ROWS):
            rows = slice(begin, begin + DRIVEN_ROWS)
            times = None if time is None else time[rows]
            steps = dt[rows] if isinstance(dt, np.ndarray) else dt
            blocks.append(self.rows(desired[rows], steps, times, target[rows]))
        last, drive = self.finish()
        return drive.with_rows(stacked([*blocks, last]))

    # --- before the move ---

    def _begin(
        self, first: float, dt: Steps, time: Floats | None
    ) -> tuple[Steps, Rows]:
        """Return the time steps of the first block, and the rows before the move that are ready."""
        self._first, step = first, self._first_step(dt)
        self._step = step
        if isinstance(dt, np.ndarray):
            dt = np.concatenate([[step], dt[1:]])
        begin = self._began = None if time is None else float(time[0])
        self._state, voltage, still_rows = self.lead.planned(first, step, begin)
        count = voltage.size + still_rows
        stamps = (begin or 0.0) - step * np.arange(count, 0.0, -1.0)
        if not voltage.size:
            self.limits.require_reachable(self.limits.move, self._judge.last, dt)
        way, at_rest = np.split(stamps, [voltage.size])
        rows = self._played(way, voltage, "lead")
        self._ahead = Ahead(self.model, dt, self._state)
        if still_rows:
            still = np.full(still_rows, first)
            due = self._ahead.take(Due(still, still, at_rest, step, "lead"))
            rows = stacked([rows, *map(self._driven, due)])
        return dt, rows

    def _first_step(self, dt: Steps) -> float:
        """Return the seconds a row at the beginning, the first step that advances; 0 without a clock.

        Raises
        ------
        InputError
            There is none, and something depends on the time.
        """
        step, lead = dt, self.lead
        if isinstance(dt, np.ndarray):
            step = next((float(each) for each in dt[1:] if each > 0.0), None)
        takes_time = lead.condition or lead.approach or lead.rest or lead.hold
        is_timed = takes_time or self.return_to is not None or self.model.needs_time
        if step is None and (is_timed or self.limits.slew is not None):
            raise InputError(
                f"{self.name}: the model or the limits need a clock: a time column that advances, or "
                "`sample_rate` HZ"
            )
        return float(step or 0.0)

    # --- the way of a row ---

    def _driven(self, due: Due) -> Rows:
        """Return the drive of rows that are due, with which the static part reaches their target."""
        model, limits, target = self.model, self.limits, due.target
        state = model.start_drive(float(target[0]), self._state, *limits.move)
        if self._judge.last is None:
            self._judge.last = state.drive  # of a start at an end of the range
        run = model.drive(target, state, due.dt, limits.move, limits.slew)
        if self._judge.off_at_first is None:
            self._judge.begin(self._first, float(target[0]), run, state)
        if due.phase == "move":
            self._judge.clip(due.desired, target, run, state, due.dt)
        self._judge.admit(run.y, due.dt, due.phase)
        self._state = run.state
        if due.time is not None:
            self._state = replace(run.state, time=float(due.time[-1]))
        return Rows(due.time, due.desired, run.y)

    def _played(self, time: Floats, voltage: Floats, phase: str) -> Rows:
        """Return rows that are played as they are, with the displacement that the model expects of them."""
        if not voltage.size:
            return NO_ROWS
        run = self.model.run(voltage, self._last_state, self._step)
        self._judge.admit(voltage, self._step, phase)
        self._state = replace(run.state, time=float(time[-1]))
        return Rows(time, run.y, voltage)

    def _require_numbers(self, values: Floats) -> None:
        """Refuse a row that is no displacement (InputError)."""
        bad = ~(np.abs(values) <= LARGEST_DISPLACEMENT)
        if not bad.any():
            return
        row = int(np.argmax(bad))
        raise InputError(
            f"{self.name}: row {self._row_count + row + 1:,}: {values[row]:g} is no displacement: check "
            "column and unit (`skip_bad` drops rows without a number)"
        )
