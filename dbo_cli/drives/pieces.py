"""The pieces of a drive around a move: ramps, the sweep into a known state, the way to the first value.

Voltages are played as they are. The way to the first value is a stretch of displacement
that the inverse follows as it follows the move, in the same state: where the two meet
there is no join, whatever the model remembers. ``BeforeMove`` plans which pieces stand
before a move.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dbo_cli.drives.options import DriveOptions, Seconds
from dbo_cli.errors import LimitError, UsageError
from dbo_cli.hysteresis.dynamics import Lag
from dbo_cli.hysteresis.excitation import MOST_SAMPLES, Floats, swing_samples, swings
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_state import DriveLimits, ModelState, StartName

# over the whole range, where no slew limit asks for more; as ``excite`` by default
SWEEP_SECONDS = 1.0
QUIET = 14.0  # time constants: what rings is down to a millionth
# s; a resonance that rings longer was hardly excited by swings of a second
LONGEST_REST = 10.0
SLEW_SPARE = 0.9
"""Of the slew limit: what lag and resonance add to a swing planned without them, and what the digits of time
stamps take away (since 1970, 0.2 us each).
"""
# of the sweep's seconds: however short a way, what it excites stays small
SHORTEST_WAY = 0.1
MUCH_LONGER = 2.0
"""Times the rows of a swing of the drive: a way in displacement that takes more becomes that swing. Chosen;
up to there the way in displacement is the gentler one for dynamics.
"""
# tries to find how long a swing takes; the second is right where no memory matters
PLANS = 6

CHOSEN_SECONDS = 60.0  # s: so long the program may choose to take before any move
# times the move's own seconds: so long it may choose to take before a longer one
CHOSEN_MOVES = 10.0
WHOLE_ROW = 1e-9  # of a row: what rounding may add to a number of rows

NOTHING = np.zeros(0)


class Chosen(NamedTuple):
    """A piece of which the program chose how long it takes: its name, its rows, and what shortens it."""

    what: str
    rows: int
    remedy: str


class Before(NamedTuple):
    """The rows before a trajectory.

    Attributes
    ----------
    voltage, expected : array
        Played as they are, and the displacement that the model expects of them.
    desired : array
        Displacements that the inverse follows, up to the trajectory's first value.
    state : ModelState, or None
        After the voltages; None where the run finds its start itself.
    chosen : tuple of Chosen
        The pieces of which nobody typed how long they take.
    """

    voltage: Floats
    expected: Floats
    desired: Floats
    state: ModelState | None
    chosen: tuple[Chosen, ...] = ()


def ramp(
    name: str,
    begin: float,
    end: float,
    step: float,
    seconds: Seconds,
    limits: DriveLimits,
) -> Floats:
    """Return the voltages after ``begin`` of a half-cosine ramp to ``end``; ``name`` is what asks for it.

    Raises
    ------
    LimitError
        The seconds asked for are too few for the slew limit.
    """
    if begin == end and not isinstance(seconds, float | int):
        return np.zeros(0)
    duration = SWEEP_SECONDS if limits.max_slew is None else 0.0
    if isinstance(seconds, float | int):
        duration = float(seconds)
    count = _rows(f"`{name}`: the ramp", end - begin, step, duration, limits)
    _require_seconds(name, seconds, count, step)
    return swings([begin, end], [count])[1:]


def sweep(model: ActuatorModel, limits: DriveLimits, step: float) -> Floats:
    """Return the voltages of a sweep from the lower end of the range to the upper and back, and a rest there.

    A drive at or below X_0 clears every bit, so that the past is wiped out; the rest
    lets resonances and lags die away.
    """
    low, high = sweep_range(model, limits)
    count = _rows("`condition`: the sweep", high - low, step, SWEEP_SECONDS, limits)
    return swings([low, high, low, low], [count, count, rest_samples(model, step)])


def sweep_range(model: ActuatorModel, limits: DriveLimits) -> tuple[float, float]:
    """Return the ends of a sweep: those of the identified range, within the limits (UsageError: none)."""
    low = max(limits.v_min, model.input.minimum)
    high = min(limits.v_max, model.input.maximum)
    if low < model.drive_end < high:
        high = model.drive_end
    if not low < high:
        raise UsageError(
            "`condition` sweeps the range on which the model was identified, "
            f"{model.input.minimum:.6g} to {model.input.maximum:.6g}{model.input.suffix}, and the limits "
            "leave nothing of it"
        )
    return low, high


def rest_samples(model: ActuatorModel, step: float) -> int:
    """Return the rows (none without dynamics) after which lags and resonances have died away."""
    slowest = 0.0
    for stage in (model.dynamics, model.drive_lag):
        if stage is None:
            continue
        for section in stage.sections:
            if isinstance(section, Lag):
                fade = section.seconds
            else:
                fade = 1.0 / (2.0 * math.pi * section.frequency * section.damping)
            slowest = max(slowest, fade)
    return math.ceil(min(QUIET * slowest, LONGEST_REST) / step)


def way(
    model: ActuatorModel,
    state: ModelState,
    ends: tuple[float, float],
    creep: float,
    step: float,
    seconds: Seconds,
    limits: DriveLimits,
) -> Floats:
    """Return the displacements after ``ends[0]`` on the way to ``ends[1]``, slow enough for the slew limit.

    Parameters
    ----------
    model, state
        The forward model, and its state where the way begins.
    ends
        The displacement there, and the one to go to.
    creep
        The displacement's last change there, a row: the way begins with that speed,
        since a mass cannot stop at once.
    step, seconds, limits
        Seconds a row; seconds asked for, or ``auto``; limits of the drive.

    Raises
    ------
    LimitError
        The seconds asked for are too few for the slew limit.
    """
    begin, end = ends
    if begin == end and creep == 0.0 and not isinstance(seconds, float | int):
        return np.zeros(0)
    duration = SHORTEST_WAY * SWEEP_SECONDS
    if isinstance(seconds, float | int):
        duration = float(seconds)
    elif limits.max_slew is None:
        part = min(abs(end - begin) / model.output.span, 1.0)
        duration = max(SWEEP_SECONDS * part, duration)
    count = swing_samples(end - begin, step, duration)
    if limits.max_slew is None:
        path = _way(begin, end, creep, count, step)
    else:
        path = _Slowed(model, state, ends, creep, step, limits).path(count)
    _require_seconds("approach", seconds, path.size, step)
    return path


class _Slowed:
    """Finds a way to a displacement that the drive can go within its slew limit.

    A smooth way in displacement asks for a fast drive where the curve is flat. Slowed
    down everywhere, it may take far longer than the drive needs for its own way; then
    the way is that of a smooth swing of the drive.
    """

    def __init__(
        self,
        model: ActuatorModel,
        state: ModelState,
        ends: tuple[float, float],
        creep: float,
        step: float,
        limits: DriveLimits,
    ) -> None:
        self._model = model.without_lag
        self._state = dataclasses.replace(
            state, dynamics=None, undoing=None, history=None, drive_lag=None
        )
        self._ends, self._creep, self._step = ends, creep, step
        self._limits = DriveLimits(limits.v_min, limits.v_max)
        self._first = self._model.drive_of(self._state)
        largest = limits.largest_change(step)
        assert largest is not None and limits.max_slew is not None
        self._allowed = SLEW_SPARE * largest
        self._slew = SLEW_SPARE * limits.max_slew

    def path(self, count: int) -> Floats:
        """Return the displacements of a way of ``count`` rows, or of as many more as it needs."""
        path = self._plain(count)
        drive = self._drive_of(path)
        fewest = max(count, self._swing_rows(drive))
        for _ in range(PLANS):
            largest = self._largest_step(drive)
            if largest <= self._allowed:
                return path
            count = max(math.ceil(count * min(largest / self._allowed, 1e6)), count + 1)
            if count > MUCH_LONGER * fewest:
                return self._path_of_swing(fewest, drive)
            path = self._plain(count)
            drive = self._drive_of(path)
        return path

    def _plain(self, count: int) -> Floats:
        return _way(*self._ends, self._creep, count, self._step)

    def _drive_of(self, path: Floats) -> Floats:
        done = self._model.compensate(
            path, self._state, limits=self._limits, time_step=self._step
        )
        return done.y

    def _begin_of(self, drive: Floats) -> float:
        """Return the voltage before a drive: that of the state, where it is known."""
        return float(drive[0]) if self._first is None else self._first

    def _largest_step(self, drive: Floats) -> float:
        before = self._begin_of(drive)
        return float(np.abs(np.diff(drive, prepend=before)).max())

    def _swing_rows(self, drive: Floats) -> int:
        """Return how many rows a swing of the drive takes to where it has to be in the end."""
        begin = self._begin_of(drive)
        return swing_samples(float(drive[-1] - begin), self._step, 0.0, self._slew)

    def _path_of_swing(self, count: int, drive: Floats) -> Floats:
        """Return the displacements that a swing of the drive to its end leads through."""
        end = self._ends[1]
        path = self._plain(count)
        for _ in range(PLANS):
            ends = [self._begin_of(drive), float(drive[-1])]
            voltage = swings(ends, [count])[1:]
            path = self._model.simulate(voltage, self._state, time_step=self._step).y
            # What creeps meanwhile makes it end a little off.
            part = (np.arange(1.0, path.size + 1.0)) / path.size
            path = path + soft_rise(part) * (end - path[-1])
            path[-1] = end
            drive = self._drive_of(path)
            largest = self._largest_step(drive)
            if largest <= self._allowed:
                break
            count = max(math.ceil(count * largest / self._allowed), count + 1)
        return path


def _way(begin: float, end: float, creep: float, count: int, step: float) -> Floats:
    """Return a smooth way of so many rows: no jump of speed or acceleration at either end."""
    rows = require_rows("the way to the first row", count, step)
    t = np.arange(1.0, rows + 1.0) / count
    values: Floats = (
        begin
        + soft_rise(t) * (end - begin)
        + creep * count * t * (1.0 - t) ** 3 * (1.0 + 3.0 * t)
    )
    values[-1] = end
    return values


def soft_rise(t: Floats) -> Floats:
    """Return a rise from 0 at t = 0 to 1 at t = 1; speed and acceleration are zero at either end."""
    return t**3 * (10.0 - 15.0 * t + 6.0 * t * t)


def require_rows(what: str, count: int, step: float) -> int:
    """Refuse a piece that no memory could hold (UsageError)."""
    if count > MOST_SAMPLES:
        raise UsageError(
            f"{what} takes {count * step:.4g} s, {count:.4g} rows, more than the {MOST_SAMPLES:,} that are "
            "written at most (another rate)"
        )
    return count


def _rows(
    what: str, distance: float, step: float, seconds: float, limits: DriveLimits
) -> int:
    """Return how many rows a swing takes within the slew limit, or refuse one that no memory could hold."""
    slew, slowest = None, 0.0
    if limits.max_slew is not None:
        slew = SLEW_SPARE * limits.max_slew
        slowest = 0.5 * math.pi * abs(distance) / slew
    rows = max(slowest, seconds) / step
    if rows > MOST_SAMPLES:
        at, remedy = "", "rate"
        if slowest > seconds:
            at, remedy = f" at `max_slew` {limits.max_slew:g}", "`max_slew`"
        raise UsageError(
            f"{what}{at} takes {rows * step:.4g} s, {rows:.4g} rows, more than the {MOST_SAMPLES:,} that are "
            f"written at most (another {remedy})"
        )
    return swing_samples(distance, step, seconds, slew)


def _require_seconds(name: str, seconds: Seconds, count: int, step: float) -> None:
    if isinstance(seconds, float | int) and count * step > seconds + step:
        raise LimitError(
            f"`{name}` {seconds:g}: faster than the slew limit allows (at least {count * step:.4g} s, or "
            "auto)"
        )


class _Played(NamedTuple):
    """What is known where the voltages before a move end."""

    state: ModelState | None
    expected: Floats
    displacement: float
    creep: float


@dataclass(frozen=True)
class BeforeMove:
    """Plans the rows before a move.

    Attributes
    ----------
    model : ActuatorModel
        A forward model.
    options : DriveOptions
        What is asked of the drive.
    limits : DriveLimits
        What the drive may do.
    start : str or ModelState
        Where the actuator starts.
    last : float, optional
        Where the amplifier stands, where that is known.
    step : float
        Seconds a row.
    """

    model: ActuatorModel
    options: DriveOptions
    limits: DriveLimits
    start: StartName | ModelState
    last: float | None
    step: float

    def plan(self, first: float) -> Before:
        """Return the pieces before a move whose first value is ``first``.

        Raises
        ------
        UsageError
            From where the amplifier comes is not known, or a piece is too long for any
            memory.
        LimitError
            Seconds that were typed are too few for the slew limit.
        """
        options = self.options
        lead = self._lead(first)
        chosen = []
        if not _typed(options.lead):
            chosen.append(Chosen("the lead", lead.size, "`lead` SECONDS"))
        known = self._state is not None or options.from_ is not None
        if not known and not options.condition and options.approach is None:
            return Before(NOTHING, NOTHING, lead, None, tuple(chosen))
        if self.last is None and not options.condition:
            raise UsageError(
                "`approach` needs `from_` VOLT (what the amplifier stands at) or a `state`"
            )
        inwards = self._inwards()
        swept = self._swept()
        rest = self._rest(inwards)
        voltage = np.concatenate([inwards, swept, rest])
        played = self._played(voltage)
        path = self._way(played, first)
        if not (options.condition and _typed(options.approach)):
            chosen.append(
                Chosen("the ramp into the range", inwards.size, "a larger `max_slew`")
            )
        remedy = "a larger `max_slew`, or `state` instead of `condition`"
        chosen.append(Chosen("the sweep", swept.size, remedy))
        chosen.append(Chosen("the rest", rest.size, "a larger `max_slew`"))
        if options.condition or not _typed(options.approach):
            chosen.append(
                Chosen("the way to the first row", path.size, "`approach` SECONDS")
            )
        desired = np.concatenate([path, lead])
        return Before(voltage, played.expected, desired, played.state, tuple(chosen))

    @property
    def _state(self) -> ModelState | None:
        return self.start if isinstance(self.start, ModelState) else None

    def _lead(self, first: float) -> Floats:
        """Return the rows at the first value: those typed, else what dynamics and delay need."""
        typed, options = self.options.lead, self.options
        if typed is None and not options.condition and options.approach is None:
            return NOTHING
        if _typed(typed):
            rows = math.ceil(float(typed or 0.0) / self.step - WHOLE_ROW)
            return np.full(require_rows("`lead`", rows, self.step), first)
        ahead = late = 0
        if self.model.dynamics is not None:
            ahead = self.model.dynamics.inverter(self.step).ahead
        if self.model.delay is not None:
            late = self.model.delay.rows_ahead(self.step)
        return np.full(ahead + late, first)

    def _inside(self) -> float:
        """Return the voltage inside the limits at which the way to the first value, or the sweep, begins."""
        if self.options.condition:
            return sweep_range(self.model, self.limits)[0]
        assert self.last is not None
        return min(max(self.last, self.limits.v_min), self.limits.v_max)

    def _inwards(self) -> Floats:
        """Return where the amplifier stands, and the ramp from there into the limits."""
        if self.last is None or self.options.approach is None:
            return NOTHING
        seconds = self.options.approach if self.options.condition else "auto"
        voltage = ramp(
            "approach", self.last, self._inside(), self.step, seconds, self.limits
        )
        if self._state is not None:
            return voltage  # the state's own row was played before
        return np.concatenate([[self.last], voltage])

    def _swept(self) -> Floats:
        """Return the sweep; where a ramp leads to it, its first row was the last one of that."""
        if not self.options.condition:
            return NOTHING
        voltage = sweep(self.model, self.limits, self.step)
        ramped = self.last is not None and self.options.approach is not None
        return voltage[1:] if ramped else voltage

    def _rest(self, inwards: Floats) -> Floats:
        """Return the rest behind a ramp, in which what it made ring dies away; a sweep has its own."""
        if self.options.condition or self.last is None or self.options.approach is None:
            return NOTHING
        if self._state is None and inwards.size == 1:
            return NOTHING  # it was at rest, and is where it was
        return np.full(rest_samples(self.model, self.step), self._inside())

    def _played(self, voltage: Floats) -> _Played:
        """Play the voltages, from the state or from a start at the first of them."""
        model, state = self.model, self._state
        if voltage.size == 0 and state is not None:
            reached = 0.0
            if self.options.approach is not None:
                reached = model.displacement_of(state)
            return _Played(state, NOTHING, reached, 0.0)
        rows = voltage
        if voltage.size == 0 and self.last is not None:
            rows = np.array([self.last])
        begun = state or model.start(float(rows[0]), self.start)
        time_step = self.step if self.step > 0.0 else None
        done = model.simulate(rows, begun, time_step=time_step)
        creep = float(done.y[-1] - done.y[-2]) if done.y.size > 1 else 0.0
        return _Played(done.state, done.y[: voltage.size], float(done.y[-1]), creep)

    def _way(self, played: _Played, first: float) -> Floats:
        """Return the displacements from where the voltages end to the first value."""
        if self.options.approach is None and not self.options.condition:
            return NOTHING
        assert played.state is not None
        seconds: Seconds = "auto"
        if not self.options.condition and self.options.approach is not None:
            seconds = self.options.approach
        ends = played.displacement, first
        return way(
            self.model,
            played.state,
            ends,
            played.creep,
            self.step,
            seconds,
            self.limits,
        )


def _typed(seconds: Seconds) -> bool:
    """Tell whether seconds were typed, instead of left to the program."""
    return isinstance(seconds, float | int)


def longest_chosen(move_seconds: float) -> float:
    """Return how long the program may choose to take before a move (s)."""
    return max(CHOSEN_SECONDS, CHOSEN_MOVES * move_seconds)


def require_short(
    name: str, chosen: tuple[Chosen, ...], step: float, move_seconds: float
) -> None:
    """Refuse what the program chose itself where it is long beside the move (LimitError).

    Parameters
    ----------
    name : str
        The trajectory's, for the message.
    chosen : tuple of Chosen
        The pieces of which nobody typed how long they take.
    step, move_seconds : float
        Seconds a row, and of the move.
    """
    seconds = step * sum(piece.rows for piece in chosen)
    if seconds <= longest_chosen(move_seconds):
        return
    longest = max(chosen, key=lambda piece: piece.rows)
    raise LimitError(
        f"{name}: before the move, of {move_seconds:.4g} s, would stand {seconds:.4g} s that nobody asked "
        f"for, {longest.what} the longest, {step * longest.rows:.4g} s; at most a minute, or ten times the "
        f"move, is chosen ({longest.remedy})"
    )
