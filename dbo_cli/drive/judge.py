"""What is judged of a drive: what limits cut off, what to expect, and what to warn of."""

import math
from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.drive.drive import Drive
from dbo_cli.drive.lead import Lead
from dbo_cli.drive.limits import Limits, in_full, rounded_down, rounded_up
from dbo_cli.errors import InputError, LimitError, warn
from dbo_cli.model import Cascade, Run, State, Steps, expect
from dbo_cli.model.state import SectionStates

ALLOWED_PART = 0.01
"""Of the move: so much of it (RMS) may be cut off unasked; the order of a good model's error; chosen."""
# of the range: a trajectory this little outside is clipped like any other
BEYOND_REACH = 0.01
OFF_AT_FIRST = 1e-3  # of the range: so far off its first value may a drive begin unsaid
FAR = 0.1  # of the range: a way in that goes so far beyond it meets gears that no log shows
JUMP = 0.01  # of the range: a first step that is said
LONG_HOLD = 100.0  # times the longest time constant: what creeps has come to rest


class Judge:
    """Lets the rows of a drive pass the gate and counts them, refuses what limits cost, and concludes.

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
    last : float or None
        The last row, or where the amplifier stands before the first; None: not known.
    off_at_first : float or None
        How far the first row starts off its displacement, or is in motion; None: not looked at.
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
        self.last = lead.standing
        self.off_at_first: float | None = None
        self.rounding = 0.0
        self.unsettled: float | None = None
        self.warned: tuple[str, ...] = ()
        # rows by part of the drive; least and greatest voltage, that before the move, and displacement
        self._rows: Counter[str] = Counter()
        self._ranges: dict[str, list[float]] = {}
        # of the move: what limits cut off, and what no voltage reaches
        self._clipped = self._first_clipped = self._unreachable = 0
        self._squares = self._largest = 0.0
        # the dynamics' sections, behind what was cut off
        self._lost_sections: SectionStates | None = None
        # least and greatest voltage, and slew, of limits that let the cut rows pass
        self._needed = (math.inf, -math.inf, 0.0)
        # the first rows, which judgements play again: voltages and steps, part by part
        self._voltages: list[Floats] = []
        self._steps: list[Floats] = []

    # --- rows ---

    def begin(self, first: float, target: float, run: Run, state: State) -> None:
        """Look at how the first row begins.

        Parameters
        ----------
        first, target
            What is asked for in this row, and what the static part is to reach for it.
        run, state
            Its drive, and the state before it.
        """
        reached = [first]
        is_held = run.clipped and run.first_clipped == 0
        if state.first is not None and not is_held:  # a start that was chosen
            reached.append(self.model.static.run(run.y[:1], state, 0.0).y[0])
        self.off_at_first = max(abs(float(target - y)) for y in reached)

    def clip(
        self,
        desired: Floats,
        target: Floats,
        run: Run,
        state: State,
        dt: Steps,
        loop: bool = False,
    ) -> None:
        """Count rows of the move and what the limits cut off them, as the displacement misses it.

        Parameters
        ----------
        desired, target
            The rows, and what the static part was to reach for them.
        run, state
            The drive of them, and the state before it.
        loop
            Whether the rows are all of a move that is repeated for ever.

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
        if not self._clipped:
            return
        lost = target - model.static.run(run.y, state, dt).y
        # a settled start may step over the first value: no limit does that
        lost[: max(self._first_clipped - 1 - before, 0)] = 0.0
        lost = self._behind_dynamics(lost, dt, loop)
        self._squares += float(np.square(lost).sum())
        self._largest = max(self._largest, float(np.abs(lost).max()))
        is_early = run.clipped == self._clipped or before < expect.FIRST_ROWS
        if run.clipped and is_early and self.on_limit != "clip":
            self._need(target, state, dt)
        if self.on_limit == "error":
            raise self._refusal()

    def _behind_dynamics(self, lost: Floats, dt: Steps, loop: bool) -> Floats:
        """Return what a lost part of the static target is of the displacement: sections are linear."""
        dynamics = self.model.dynamics
        if dynamics is None or dt is None:
            return lost
        if loop and not isinstance(dt, np.ndarray):
            return dynamics.loop(lost, dt)
        sections = self._lost_sections
        if sections is None and self._rows["move"] > lost.size:  # nothing was, so far
            sections = ((0.0, 0.0, 0.0),) * len(dynamics.sections)
        run = dynamics.run(lost, State(sections=sections), dt)
        self._lost_sections = run.state.sections
        return run.y

    def admit(self, voltage: Floats, dt: Steps, phase: str) -> None:
        """Let rows of a part pass the gate: ``lead``, ``move``, which ``clip`` has counted, or ``return``.

        Raises
        ------
        GateError
            A row breaks a limit: this program's fault.
        """
        self.limits.admit(voltage, self.last, dt, phase)
        self.last = float(voltage[-1])
        self._widen("voltage", voltage)
        if phase == "lead":
            self._widen("lead", voltage)
        first = voltage.size
        if phase == "move":
            first = max(first + expect.FIRST_ROWS - self._rows[phase], 0)
        else:
            self._rows[phase] += voltage.size
        if first and phase != "return":
            steps = np.broadcast_to(np.nan if dt is None else dt, voltage.shape)
            self._voltages.append(voltage[:first])
            self._steps.append(steps[:first])

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
        unit = self.model.output.suffix
        return (
            f"{self._clipped:,} of {self._rows['move']:,} rows read (first: row {self._first_clipped:,}) "
            f"exceed {self.limits.describe()}; clipped, the move misses {self._lost_rms:.3g}{unit} RMS, "
            f"at most {self._largest:.3g}{unit}"
        )

    def _need(self, target: Floats, state: State, dt: Steps) -> None:
        """Look at what limits would let rows pass that limits cut off."""
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

    def _refusal(self) -> LimitError:
        """Return the refusal of a move that limits cut off: which limits it needs, and what to type."""
        low, high, rate = self._needed
        unit = self.limits.suffix
        needed = f"{rounded_down(low, 4):.4g} to {rounded_up(high, 4):.4g}{unit}"
        if self.limits.slew is not None:
            needed += f", {rounded_up(rate, 3):.3g}{unit}/s"
        return LimitError(
            f"{self.name}: {self._exceeding()}; it needs {needed}: give wider limits (beyond the identified "
            "range `extrapolate`), a way to row 1 (`from_` VOLT, `approach` auto), a slower, smaller or "
            "smoother move (`bandwidth` HZ), or `on_limit` clip"
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
        reach = self.model.output
        if self._unreachable == rows:
            raise InputError(
                f"{self.name}: every row is outside the model's reach, {reach.min:.6g} to {reach.max:.6g}"
                f"{reach.suffix}: check unit, column and zero of the trajectory"
            )
        low, high = self._ranges["desired"]
        allowed = ALLOWED_PART * (high - low or reach.span)
        if self.on_limit == "auto" and self._lost_rms > allowed:
            raise self._refusal()

    # --- the end ---

    def concluded(self, state: State, step: float) -> Drive:
        """Return the figures of a drive of which all rows were seen, and warn of what is unusual."""
        lead, ranges = self.lead, self._ranges
        voltage, steps = self._played()
        move = slice(self._rows["lead"], self._rows["lead"] + self._rows["move"])
        low, high = ranges["voltage"]
        missed = math.hypot(self._lost_rms, self.unsettled or 0.0, self.rounding)
        lowest, highest = self.limits.identified
        errors: dict[str, Any] = {}
        if not self.limits.extrapolate or lowest <= low <= high <= highest:
            errors = stated_errors(lead, voltage, steps, move.start, missed)
        texts = [self._exceeding()] if self._clipped else []
        texts += start_warnings(lead, float(voltage[0]), self.off_at_first or 0.0)
        texts += range_warnings(self.limits, low, high)
        texts += expect.move_warnings(self.model, voltage, steps, move)
        texts += end_warnings(self.model, self.limits, state)
        warnings = [f"{self.name}: {text}" for text in texts]
        for text in warnings:
            warn(text)
        asks_start = lead.state in ("auto", "settled") and lead.standing is None
        return Drive(
            self.model,
            self.limits,
            self.name,
            move=move,
            rows=self._rows.total(),
            voltage_range=[low, high],
            lead_range=ranges.get("lead"),
            move_range=ranges["desired"],
            lead_seconds=move.start * step,
            clipped=self._clipped,
            first_clipped=self._first_clipped,
            lost_rms=self._lost_rms,
            lost_most=self._largest,
            **errors,
            starts_at=float(voltage[0]) if asks_start else None,
            past_known=lead.past_known,
            is_loop=self.unsettled is not None,
            state=replace(state, model=self.model.digest),
            warnings=(*self.warned, *warnings),
        )


# --- verdicts on a whole drive; warnings without the name of the trajectory ---


def stated_errors(
    lead: Lead, voltage: Floats, dt: Steps, begin: int, missed: float
) -> dict[str, float]:
    """Return the errors to expect of a drive, by the names of ``Drive``; none where the model does not know.

    Parameters
    ----------
    voltage, dt, begin
        As of ``expect.expected_error``.
    missed
        What the move misses beside that (RMS).
    """
    expected = expect.expected_error(lead.model, voltage, dt, begin)
    if expected is None:
        return {}
    known, past, memory = expected
    if lead.condition:
        missed = math.hypot(missed, past)
        unrested = math.hypot(math.hypot(known, memory), missed)
        return {
            "expected_error": math.hypot(known, missed),
            "expected_unrested": unrested,
        }
    from_known = math.hypot(known, missed)
    if lead.past_known:
        return {"expected_error": from_known}
    error = math.hypot(math.hypot(*expected), missed)
    return {"expected_error": error, "expected_known": from_known}


def start_warnings(lead: Lead, first: float, off: float) -> list[str]:
    """Return warnings of a first row that begins off its displacement or in motion, and of a jump to it."""
    voltage, displacement, texts = lead.model.input, lead.model.output, []
    if off > OFF_AT_FIRST * displacement.span:
        texts.append(
            f"row 1 starts {off:.3g}{displacement.suffix} off or in motion: try `lead` auto, `condition` or "
            "`state` empty"
        )
    standing = lead.standing
    if standing is not None and abs(first - standing) > JUMP * voltage.span:
        texts.append(
            f"jumps from {in_full(standing)} to {in_full(first)}{voltage.suffix} at row 1, and the error "
            "there is not in the expected one: add `approach` auto"
        )
    return texts


def range_warnings(limits: Limits, low: float, high: float) -> list[str]:
    """Return a warning of voltages far beyond those of the logs; of any beyond, where a move may go there."""
    lowest, highest = limits.identified
    allowed = 0.0 if limits.extrapolate else FAR * (highest - lowest)
    if max(lowest - low, high - highest) <= allowed:
        return []
    return [
        f"goes from {in_full(low)} to {in_full(high)}{limits.suffix}, the logs from {in_full(lowest)} to "
        f"{in_full(highest)}: what that leaves behind is not in the expected error; identify from a log of "
        "that range"
    ]


def end_warnings(model: Cascade, limits: Limits, state: State) -> list[str]:
    """Return a warning where holding the last position leads a drive that creeps out of its limits."""
    relaxation, static = model.gears.relaxation, model.static
    if relaxation is None or state.drive is None or min(relaxation.gain) >= 0.0:
        return []
    still = replace(state, sections=None, delay=None, undoing=None)
    position = static.run(np.array([state.drive]), still, 0.0).y
    seconds = LONG_HOLD * max(relaxation.tau)
    voltage = float(static.drive(position, still, seconds).y[0])
    low, high = limits.move
    if low <= voltage <= high:
        return []
    unit = limits.suffix
    return [
        f"holding the last position takes the drive to {voltage:.6g}{unit} in the long run, outside "
        f"{low:.6g} to {high:.6g}{unit}"
    ]
