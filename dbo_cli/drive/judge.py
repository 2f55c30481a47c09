"""What is judged of a drive: what limits cut off, what to expect, and what to warn of."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.drive.drive import Drive
from dbo_cli.drive.lead import Lead
from dbo_cli.drive.limits import in_full, rounded_down, rounded_up
from dbo_cli.drive.simulate import Due
from dbo_cli.errors import InputError, LimitError, warn
from dbo_cli.model import Run, State, Steps, expect

ALLOWED_PART = 0.01
"""Of the move: so much of it (RMS) may be cut off unasked; the order of a good model's error; chosen."""
# of the range: a trajectory this little outside is clipped like any other
BEYOND_REACH = 0.01
OFF_AT_FIRST = 1e-3  # of the range: so far off its first value may a drive begin unsaid
FAR = 0.1  # of the range: a way in that goes so far beyond it meets gears that no log shows
JUMP = 0.01  # of the range: a first step that is said
LONG_HOLD = 100.0  # times the longest time constant: what creeps has come to rest


class Judge:
    """Counts the rows of a drive as they come, refuses what limits cost, and concludes.

    Parameters
    ----------
    lead
        A forward model, what its drive may do, and what stands before the move.
    on_limit : str
        What happens where limits cut rows off.
    name : str
        Of the trajectory, in messages.

    Attributes
    ----------
    rounding : float
        What a low-pass took of the move (RMS), in the displacement's unit.
    unsettled : float or None
        Likewise, by how much a loop's first pass is off the settled one; None: no loop.
    warned : tuple of str
        What was warned of before.
    """

    def __init__(self, lead: Lead, on_limit: str, name: str) -> None:
        self.model, self.limits, self.lead = lead.model, lead.limits, lead
        self.on_limit, self.name = on_limit, name
        # how far the first row starts off its displacement, or is in motion
        self._off_at_first: float | None = None
        # rows, least and greatest voltage by part of the drive; and the displacement's
        self._rows: Counter[str] = Counter()
        self._ranges: dict[str, list[float]] = {}
        self._first = math.nan
        # of the move: what limits cut off, and what no voltage reaches
        self._clipped = self._first_clipped = self._unreachable = 0
        self._squares = self._largest = 0.0
        # least and greatest voltage, and slew, of limits that let the cut rows pass
        self._needed = (math.inf, -math.inf, 0.0)
        # the first rows, which judgements play again: voltages and steps, part by part
        self._voltages: list[Floats] = []
        self._steps: list[Floats] = []
        self.rounding = 0.0
        self.unsettled: float | None = None
        self.warned: tuple[str, ...] = ()

    # --- rows ---

    def see(self, due: Due, run: Run, state: State) -> None:
        """Look at rows that are driven: how the first ones begin, and what limits cut off the move.

        Parameters
        ----------
        due
            The rows, and what the static part was to reach for them.
        run, state
            The drive of them, and the state before it.

        Raises
        ------
        LimitError
            As of ``clip``.
        """
        model, target = self.model, due.target
        if self._off_at_first is None:
            reached = [due.asked[0]]
            is_held = run.clipped and run.first_clipped == 0
            if state.first is not None and not is_held:  # a start that was chosen
                reached.append(model.static.run(run.y[:1], state, 0.0).y[0])
            self._off_at_first = max(abs(float(target[0] - y)) for y in reached)
        if due.phase == "move":
            self.clip(due.desired, target, run, state, due.dt)

    def clip(
        self, desired: Floats, target: Floats, run: Run, state: State, dt: Steps
    ) -> None:
        """Count rows of the move and what the limits cut off them.

        Parameters
        ----------
        desired, target
            The rows, and what the static part was to reach for them.
        run, state
            The drive of them, and the state before it.

        Raises
        ------
        LimitError
            Something was cut off, and ``on_limit`` is error.
        """
        model, before = self.model, self._rows["move"]
        if run.clipped and not self._clipped:
            self._first_clipped = before + run.first_clipped + 1
        self._rows["move"] += desired.size
        self._clipped += run.clipped
        slack = BEYOND_REACH * model.output.span
        low, high = model.output.min - slack, model.output.max + slack
        self._unreachable += int(np.count_nonzero((desired < low) | (desired > high)))
        self._widen("desired", desired)
        if self._clipped:
            lost = target - model.static.run(run.y, state, dt).y
            # a settled start may step over the first value: no limit does that
            lost[: max(self._first_clipped - 1 - before, 0)] = 0.0
            self._squares += float(np.square(lost).sum())
            self._largest = max(self._largest, float(np.abs(lost).max()))
        is_first = run.clipped == self._clipped
        if run.clipped and self.on_limit != "clip":
            if is_first or before < expect.FIRST_ROWS:
                self._need(target, state, dt)
        if self._clipped and self.on_limit == "error":
            raise LimitError(f"{self.name}: {self._exceeding()}{self._remedy()}")

    def count(self, voltage: Floats, dt: Steps, phase: str) -> None:
        """Count rows of a part: ``lead``, ``move``, of which ``clip`` knows already, or ``return``."""
        if not voltage.size:
            return
        if math.isnan(self._first):
            self._first = float(voltage[0])
        self._widen(phase, voltage)
        steps = np.broadcast_to(np.nan if dt is None else dt, voltage.shape)
        first = slice(None)
        if phase == "move":
            before = self._rows[phase] - voltage.size
            first = slice(max(expect.FIRST_ROWS - before, 0))
        else:
            self._rows[phase] += voltage.size
        if voltage[first].size and phase != "return":
            self._voltages.append(voltage[first])
            self._steps.append(steps[first])

    def _widen(self, what: str, values: Floats) -> None:
        """Widen what is known of least and greatest values."""
        low, high = float(values.min()), float(values.max())
        lowest, greatest = self._ranges.get(what, (low, high))
        self._ranges[what] = [min(low, lowest), max(high, greatest)]

    def _played(self) -> tuple[Floats, Steps]:
        """Return the first voltages in one array, and their time steps; one number where all are alike."""
        voltage, dt = np.concatenate(self._voltages), np.concatenate(self._steps)
        if np.isnan(dt[0]):
            return voltage, None
        return voltage, float(dt[0]) if (dt == dt[0]).all() else dt

    # --- refusals ---

    @property
    def _lost_rms(self) -> float:
        """What the move misses."""
        return math.sqrt(self._squares / self._rows["move"]) if self._clipped else 0.0

    def _exceeding(self) -> str:
        """Return how much of the move the limits forbid, in words; rows before the move do not count."""
        return (
            f"{self._clipped:,} of {self._rows['move']:,} rows read (first: row {self._first_clipped:,}) "
            f"exceed {self.limits.describe()}"
        )

    def require_reached(self, step: float) -> None:
        """Refuse a move of which nothing can be reached, or of which the limits cut off too much.

        Parameters
        ----------
        step
            Seconds a row; 0 without a clock, infinity where the move is repeated for ever.

        Raises
        ------
        InputError
            No row of the trajectory is within what the model reaches.
        LimitError
            More than a hundredth of the move would be missed, or it is over before the
            model answers.
        """
        rows, delay = self._rows["move"], self.model.delay_seconds
        if self.on_limit == "auto" and delay > rows * step:
            raise LimitError(
                f"{self.name}: the move is shorter than the model's delay, {delay:.4g} s (`on_limit` clip "
                "writes it)"
            )
        reach, unit = self.model.output, self.model.output.suffix
        if self._unreachable == rows:
            raise InputError(
                f"{self.name}: every row is outside the model's reach, {reach.min:.6g} to {reach.max:.6g}"
                f"{unit}: check unit, column and zero of the trajectory"
            )
        low, high = self._ranges["desired"]
        size = high - low or reach.span
        lost = self._lost_rms
        if self.on_limit != "auto" or lost <= ALLOWED_PART * size:
            return
        raise LimitError(
            f"{self.name}: {self._exceeding()}, by {lost:.3g}{unit} RMS ({100.0 * lost / size:.2g} % of "
            f"{size:.3g}{unit}){self._remedy()}"
        )

    def _need(self, target: Floats, state: State, dt: Steps) -> None:
        """Look at what limits would let all rows pass, of those that limits cut off."""
        head = self.model.head
        voltage = self.model.drive(target, state, dt).y
        rate = 0.0
        if dt is not None:
            steps = np.broadcast_to(np.asarray(dt), voltage.shape)
            before = voltage[0] if state.drive is None else state.drive
            way = np.abs(np.diff(head(np.append(before, voltage)))) / head.least_slope
            rate = float((way[steps > 0.0] / steps[steps > 0.0]).max(initial=0.0))
        low, high, fastest = self._needed
        low, high = min(low, float(voltage.min())), max(high, float(voltage.max()))
        self._needed = low, high, max(fastest, rate)

    def _remedy(self) -> str:
        """Return which limits would let the move pass, and what to type."""
        low, high = rounded_down(self._needed[0], 4), rounded_up(self._needed[1], 4)
        unit = self.limits.suffix
        lowest, highest = self.limits.identified
        wider = "wider limits"
        if not self.limits.extrapolate and not lowest <= low <= high <= highest:
            wider += " and `extrapolate`"
        needed = f"; it needs {low:.4g} to {high:.4g}{unit}"
        if self.limits.slew is not None:
            needed += f", {rounded_up(self._needed[2], 3):.3g}{unit}/s"
        way = (
            ""
            if self.lead.approach or self.lead.condition
            else "a way to row 1 (`from_` VOLT, `approach` auto), "
        )
        return (
            f"{needed}: give {wider}, {way}a slower, smaller or smoother move (`bandwidth` HZ), or "
            "`on_limit` clip"
        )

    # --- the end ---

    def concluded(self, state: State, step: float) -> Drive:
        """Return the figures of a drive of which all rows were seen, and warn of what is unusual."""
        voltage, steps = self._played()
        lead_rows, move_rows = self._rows["lead"], self._rows["move"]
        voltages = [span for part, span in self._ranges.items() if part != "desired"]
        low = min(span[0] for span in voltages)
        high = max(span[1] for span in voltages)
        lowest, highest = self.limits.identified
        texts = self._start_warnings()
        error = error_from_rest = unrested = expected = None
        if self.limits.extrapolate and not lowest <= low <= high <= highest:
            texts.append(
                f"the drive goes from {low:.6g} to {high:.6g}{self.limits.suffix}, beyond the identified "
                f"range, {lowest:.6g} to {highest:.6g}{self.limits.suffix}"
            )
        else:
            expected = expect.expected_error(self.model, voltage, steps, lead_rows)
        past_known = self.lead.past_known
        if expected is not None:
            known, past, memory = expected
            missed = math.hypot(self._lost_rms, self.unsettled or 0.0, self.rounding)
            if self.lead.condition:
                missed = math.hypot(missed, past)
                unrested = math.hypot(math.hypot(known, memory), missed)
            error = math.hypot(known, missed)
            if not past_known:
                error_from_rest = error
                error = math.hypot(math.hypot(*expected), missed)
        move = slice(lead_rows, lead_rows + move_rows)
        texts += expect.move_warnings(self.model, voltage, steps, move)
        texts += self._end_warnings(error, state)
        warnings = [f"{self.name}: {text}" for text in texts]
        for text in warnings:
            warn(text)
        is_auto = self.lead.state in ("auto", "settled")
        asks_start = is_auto and self.lead.standing is None
        return Drive(
            self.model,
            self.limits,
            self.name,
            move=move,
            rows=self._rows.total(),
            voltage_range=[low, high],
            lead_range=self._ranges.get("lead"),
            move_range=self._ranges["desired"],
            lead_seconds=lead_rows * step,
            clipped=self._clipped,
            first_clipped=self._first_clipped,
            lost_rms=self._lost_rms,
            lost_most=self._largest,
            expected_error=error,
            expected_known=error_from_rest,
            expected_unrested=unrested,
            starts_at=self._first if asks_start else None,
            past_known=past_known,
            is_loop=self.unsettled is not None,
            state=replace(state, model=self.model.digest),
            notes=self._notes(),
            warnings=(*self.warned, *warnings),
        )

    def _notes(self) -> tuple[str, ...]:
        """Return what a user should know of a low-pass and of a loop."""
        notes, unit = [], self.model.output.suffix
        if self.unsettled is not None:
            notes.append(
                f"the first pass is {self.unsettled:.3g}{unit} off the settled one (RMS)"
            )
        if self.rounding:
            notes.append(
                f"`bandwidth` rounds the move by {self.rounding:.3g}{unit} RMS"
            )
        return tuple(f"{self.name}: {note}" for note in notes)

    # --- warnings, without the name of the trajectory ---

    def _start_warnings(self) -> list[str]:
        """Return what was clipped, and what is unusual about how the drive begins."""
        unit, span = self.model.output.suffix, self.model.output.span
        texts = []
        if self._clipped:
            texts.append(
                f"{self._exceeding()}: clipped; the move misses {self._lost_rms:.3g}{unit} RMS, at most "
                f"{self._largest:.3g}{unit}"
            )
        off = self._off_at_first or 0.0
        if off > OFF_AT_FIRST * span:
            texts.append(
                f"row 1 starts {off:.3g}{unit} off or in motion: try `lead` auto, `condition` or `state` "
                "empty"
            )
        (low, high), standing = self.limits.identified, self.lead.standing
        lead = self._ranges.get("lead", (low, high))
        if max(low - lead[0], lead[1] - high) > FAR * (high - low):
            texts.append(
                f"the way in goes from {in_full(lead[0])} to {in_full(lead[1])}{self.limits.suffix}, the "
                f"logs from {in_full(low)} to {in_full(high)}: what it leaves behind is not in the expected "
                "error; identify from a log of that range"
            )
        if standing is not None and abs(self._first - standing) > JUMP * (high - low):
            texts.append(
                f"jumps from {in_full(standing)} to {in_full(self._first)}{self.limits.suffix} at row 1, and "
                "the error there is not in the expected one: add `approach` auto"
            )
        return texts

    def _end_warnings(self, error: float | None, state: State) -> list[str]:
        """Return warnings where a straight line is as good, and where holding the end leaves the limits."""
        texts, unit = [], self.model.output.suffix
        line = self.model.fit.get("line_rmse")
        if isinstance(line, float) and error is not None:
            if error >= math.hypot(line, self._lost_rms, self.rounding):
                texts.append(
                    f"expected error {error:.3g}{unit}, a straight line's is {line:.3g}: identify with a log "
                    "of such moves"
                )
        voltage = self._held_voltage(state)
        (low, high), unit = self.limits.move, self.limits.suffix
        if voltage is not None and not low <= voltage <= high:
            texts.append(
                f"holding the last position takes the drive to {voltage:.6g}{unit} in the long run, outside "
                f"{low:.6g} to {high:.6g}{unit}"
            )
        return texts

    def _held_voltage(self, state: State) -> float | None:
        """Return where holding the last position leads, of an actuator whose drive creeps outward for it."""
        relaxation, static = self.model.gears.relaxation, self.model.static
        if relaxation is None or state.drive is None:
            return None
        if min(relaxation.gain) >= 0.0:
            return None
        still = replace(state, sections=None, delay=None, undoing=None)
        position = static.run(np.array([state.drive]), still, 0.0).y
        seconds = LONG_HOLD * max(relaxation.tau)
        return float(static.drive(position, still, seconds).y[0])
