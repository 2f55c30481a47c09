"""What stands before a move, and the return after it.

Four pieces may stand before a move, in this order: a ramp from where the amplifier
stands into the move's range, a sweep that makes the past known, a rest in which
resonances die away (all three are voltages, played as they are), and the way to the
first value with a rest there (displacements that the inverse follows in the same state
as the move, so that the two meet without a join). Each piece is one function.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dbo_cli.drive.limits import Limits
from dbo_cli.errors import LimitError, UsageError
from dbo_cli.model import Lag, Model, State, VoltageWindow

Floats = NDArray[np.float64]
Seconds = float | Literal["auto"] | None

SWEEP_SECONDS = 1.0
"""s over the whole range, where no slew limit asks for more; as ``excite`` by default."""
SHORTEST_WAY = 0.1
"""s that a way or ramp takes at least where nobody typed its seconds: whatever it excites stays small."""
QUIET = 14.0  # time constants: what rings is down to a millionth
# s; a resonance that rings longer was hardly excited by swings of a second
LONGEST_REST = 10.0
SLEW_SPARE = 0.9
"""Of the slew limit: what dynamics add to a swing that was planned without them, and what the digits of time
stamps take away (since 1970, 0.2 us each).
"""
PLANS = 6  # tries to find how long a way takes; two are usual
LONGEST_CHOSEN = 60.0  # s that the program may put before any move
CHOSEN_MOVES = 10.0  # times the seconds of a move: so long before a longer one
MOST_ROWS = 100_000_000
WHOLE = 1e-9  # of a row: what rounding may add to a number of rows
NOTHING = np.zeros(0)


@dataclass(frozen=True)
class Around:
    """What is asked for around a move.

    Attributes
    ----------
    state : str or State
        ``auto``, ``empty``, ``full``, ``settled``, or the state to go on from.
    start : float, optional
        Voltage at which the amplifier stands.
    approach : float or "auto", optional
        Seconds of the way from there to the first value.
    condition : bool
        Sweep the move's range first.
    lead : float or "auto", optional
        Seconds at the first value; auto: as many as dynamics and delay need.
    return_to : float, optional
        Voltage to go to after the move.

    Raises
    ------
    UsageError
        A value is out of its range, or two exclude each other.
    """

    state: str | State = "auto"
    start: float | None = None
    approach: Seconds = None
    condition: bool = False
    lead: Seconds = None
    return_to: float | None = None

    def __post_init__(self) -> None:
        """Check every value."""
        for name in ("approach", "lead"):
            _check_seconds(name, getattr(self, name))
        if self.condition and self.state != "auto":
            raise UsageError(
                "`condition` and `state` exclude each other: the sweep makes its own state"
            )
        if self.start is not None and not math.isfinite(self.start):
            raise UsageError(
                f"`from` {self.start}: give the voltage at which the amplifier stands"
            )

    @property
    def needs_time(self) -> str:
        """The option that needs the time between samples; empty where none does."""
        for name in ("approach", "condition", "lead", "return_to"):
            if getattr(self, name) not in (None, False):
                return name.removesuffix("_to")
        return ""


@dataclass(frozen=True)
class Lead:
    """The rows before a move.

    Attributes
    ----------
    voltage, expected : array
        Voltages that are played as they are, and the displacement that the model
        expects of them.
    desired : array
        Displacements behind them, which the inverse follows up to the first value.
    state : State or None
        After the voltages; None where the inverse finds the start itself.
    chosen : float
        Seconds of the pieces of which nobody typed how long they take.
    slewed : float
        Seconds of these that a slew limit makes longer.
    dt : float
        Seconds a row.
    """

    voltage: Floats = field(default_factory=lambda: NOTHING)
    expected: Floats = field(default_factory=lambda: NOTHING)
    desired: Floats = field(default_factory=lambda: NOTHING)
    state: State | None = None
    chosen: float = 0.0
    slewed: float = 0.0
    dt: float = 0.0

    @property
    def rows(self) -> int:
        """How many rows stand before the move."""
        return self.voltage.size + self.desired.size


def plan_lead(
    model: Model, first: float, dt: float, limits: Limits, around: Around
) -> Lead:
    """Return the rows before a move.

    Parameters
    ----------
    model
        A forward model.
    first
        First value of the move (displacement).
    dt
        Seconds a row.

    Raises
    ------
    LimitError
        The start is outside the rating, or typed seconds are too few for the slew
        limit.
    UsageError
        The amplifier's voltage is not known, or a piece is too long for any memory.
    """
    last = standing_at(model, limits, around)
    state = around.state
    if isinstance(state, State) and state.drive is None:
        around = replace(around, state=replace(state, drive=last))
    moves = around.condition or around.approach is not None
    rest = _rest_at_first(model, first, dt, around)
    if last is None and around.approach is not None and not around.condition:
        raise UsageError(
            "`approach` needs `from` VOLT (where the amplifier stands) or a `state`"
        )
    if not moves:
        return _standing(model, last, rest, dt, around)
    return _moving(model, first, dt, limits, around, last, rest)


def standing_at(model: Model, limits: Limits, around: Around) -> float | None:
    """Return the voltage at which the amplifier stands before the first row, None where it is not known.

    Raises
    ------
    LimitError
        It is outside the rating.
    UsageError
        A state knows another voltage than the one that was typed.
    """
    if around.start is not None:
        limits.require_start(around.start)
    if not isinstance(around.state, State) or around.state.drive is None:
        return around.start
    left_at = around.state.drive
    limits.require_start(left_at, "`state`: the voltage at which it was left,")
    span = limits.rating[1] - limits.rating[0]
    if around.start is not None and abs(around.start - left_at) > 1e-9 * span:
        raise UsageError(
            f"`from` {around.start:g} contradicts `state`, which was left at {left_at:g}"
        )
    return left_at


def _standing(
    model: Model, last: float | None, rest: Floats, dt: float, around: Around
) -> Lead:
    """Return the lead of a drive that begins where the amplifier stands: a rest at the first value alone."""
    state = None
    if isinstance(around.state, State):
        state = around.state
    elif last is not None:
        state = _played(model, np.array([last]), dt, around)[1]
    chosen = rest.size * dt if around.lead == "auto" else 0.0
    return Lead(NOTHING, NOTHING, rest, state, chosen, 0.0, dt)


def _moving(
    model: Model,
    first: float,
    dt: float,
    limits: Limits,
    around: Around,
    last: float | None,
    rest: Floats,
) -> Lead:
    """Return the lead of a drive that goes to the first value: voltages, then the way and a rest."""
    voltage, slewed = _voltages(model, dt, limits, around, last)
    expected, state = _played(model, voltage, dt, around)
    typed = None if around.condition else around.approach
    path = way(model, state, first, dt, typed, limits)
    chosen = voltage.size
    if not _is_typed(typed):
        slewed += path.size
        chosen += path.size
    if not _is_typed(around.lead):
        chosen += rest.size
    desired = np.concatenate([path, rest])
    return Lead(voltage, expected, desired, state, chosen * dt, slewed * dt, dt)


def _voltages(
    model: Model, dt: float, limits: Limits, around: Around, last: float | None
) -> tuple[Floats, int]:
    """Return the ramp into the move's range, the sweep and a rest, and how many rows the slew limit rules."""
    known = isinstance(around.state, State)
    inside = _inside(last, limits)
    seconds: Seconds = "auto"
    if around.condition:
        inside = sweep_range(model, limits)[0]
        seconds = around.approach
    inwards = swept = quiet = NOTHING
    if last is not None:
        inwards = ramp("approach", last, inside, dt, seconds, limits)
        if not known:
            inwards = np.concatenate([[last], inwards])
    if around.condition:
        swept = sweep(model, limits, dt)
        if inwards.size:
            swept = swept[1:]
    if around.condition or inwards.size > 1 or known:
        quiet = np.full(rest_rows(model, dt), inside)
    slewed = inwards.size + swept.size
    return np.concatenate([inwards, swept, quiet]), slewed


def _inside(last: float | None, limits: Limits) -> float:
    """Return the voltage of the move's range that is nearest to where the amplifier stands."""
    low, high = limits.move
    return low if last is None else min(max(last, low), high)


def _played(
    model: Model, voltage: Floats, dt: float, around: Around
) -> tuple[Floats, State]:
    """Play voltages from the state, or from a named start at the first of them."""
    state = around.state
    if not isinstance(state, State):
        state = model.start(float(voltage[0]), state)
    if voltage.size == 0:
        return NOTHING, state
    run = model.run(voltage, state, dt if dt > 0.0 else None)
    return run.y, run.state


def _is_typed(seconds: Seconds) -> bool:
    """Tell whether seconds were typed, instead of left to the program."""
    return isinstance(seconds, float | int)


# --- the pieces ---


def ramp(
    name: str, begin: float, end: float, dt: float, seconds: Seconds, limits: Limits
) -> Floats:
    """Return the voltages after ``begin`` of a half-cosine ramp to ``end``; ``name`` is what asks for it.

    Raises
    ------
    LimitError
        The typed seconds are too few for the slew limit.
    """
    if begin == end:
        return NOTHING
    span = limits.rating[1] - limits.rating[0]
    duration = max(SHORTEST_WAY, SWEEP_SECONDS * abs(end - begin) / span)
    if limits.slew is not None:
        duration = SHORTEST_WAY
    if isinstance(seconds, float | int):
        duration = float(seconds)
    count = swing_rows(end - begin, dt, duration, limits.slew)
    _require_seconds(name, seconds, count, dt)
    return swings([begin, end], [count])[1:]


def sweep(model: Model, limits: Limits, dt: float) -> Floats:
    """Return the voltages of a sweep of the move's range: its lower end, its upper one, and back.

    At or below the first gear's origin every bit is clear, so that the past is wiped
    out.

    Raises
    ------
    UsageError
        The limits leave nothing to sweep.
    """
    low, high = sweep_range(model, limits)
    count = swing_rows(high - low, dt, SWEEP_SECONDS, limits.slew)
    return swings([low, high, low], [count, count])


def sweep_range(model: Model, limits: Limits) -> tuple[float, float]:
    """Return the ends of a sweep: the identified range within the move's (UsageError: empty)."""
    low = max(limits.move[0], model.input.min)
    high = min(limits.move[1], model.input.max)
    if not low < high:
        raise UsageError(
            f"`condition` sweeps the range on which the model was identified, {model.input.min:.6g} to "
            f"{model.input.max:.6g}{limits.suffix}, and the limits leave nothing of it"
        )
    return low, high


def rest_rows(model: Model, dt: float) -> int:
    """Return the rows (0 without dynamics) after which lags and resonances have died away."""
    if model.dynamics is None:
        return 0
    slowest = 0.0
    for section in model.dynamics.sections:
        if isinstance(section, Lag):
            fade = section.seconds
        else:
            fade = 1.0 / (2.0 * math.pi * section.frequency * section.damping)
        slowest = max(slowest, fade)
    return math.ceil(min(QUIET * slowest, LONGEST_REST) / dt)


def way(
    model: Model,
    state: State,
    end: float,
    dt: float,
    seconds: Seconds,
    limits: Limits,
) -> Floats:
    """Return the displacements from where a state stands on the way to ``end``.

    It is what a soft swing of the voltage makes of the actuator, so that its beginning
    goes on with what creeps; its end is bent to come to rest at ``end``. What delay and
    dynamics read ahead finds the state still standing there.

    Raises
    ------
    LimitError
        The typed seconds are too few for the slew limit.
    """
    static = model.static
    assert state.drive is not None
    window = VoltageWindow(*limits.move)
    target = static.drive(np.array([end]), state, SHORTEST_WAY, window).voltage[0]
    distance = float(target) - state.drive
    most = math.inf if limits.slew is None else SLEW_SPARE * limits.slew * dt
    count = _count(_way_seconds(model, distance, seconds, limits) / dt)
    for _ in range(PLANS):
        path = _way_of(static, state, distance, end, count, model.ahead(dt), dt)
        voltage = static.drive(path, state, dt, window).voltage
        largest = float(np.abs(np.diff(voltage, prepend=state.drive)).max())
        if largest <= most:
            break
        count = max(_count(count * largest / most), count + 1)
    _require_seconds("approach", seconds, count, dt)
    return path


def _way_seconds(
    model: Model, distance: float, seconds: Seconds, limits: Limits
) -> float:
    """Return how long a way takes at least (s)."""
    if isinstance(seconds, float | int):
        return float(seconds)
    if limits.slew is not None:
        return SHORTEST_WAY
    part = min(abs(distance) / model.input.span, 1.0)
    return max(SWEEP_SECONDS * part, SHORTEST_WAY)


def _way_of(
    static: Model,
    state: State,
    distance: float,
    end: float,
    count: int,
    ahead: int,
    dt: float,
) -> Floats:
    """Return the displacements of ``ahead`` rows where the state stands and a way of ``count`` rows."""
    assert state.drive is not None
    t = np.arange(1.0, count + 1.0) / count
    voltage = state.drive + distance * soft_rise(t)
    voltage = np.concatenate([np.full(ahead, state.drive), voltage])
    path = static.run(voltage, state, dt).y
    speed = float(path[-1] - path[-2]) if path.size > 1 else 0.0
    place = slice(ahead, None)
    path[place] += soft_rise(t) * (end - path[-1])
    path[place] += speed * count * (1.0 - t) * t**3 * (4.0 - 3.0 * t)
    path[-1] = end
    return path


def soft_rise(t: Floats) -> Floats:
    """Return a rise from 0 at t = 0 to 1 at t = 1; speed and acceleration are zero at either end."""
    return t**3 * (10.0 - 15.0 * t + 6.0 * t * t)


def _rest_at_first(model: Model, first: float, dt: float, around: Around) -> Floats:
    """Return the rows at the first value: typed seconds, or what delay and dynamics read ahead."""
    seconds = around.lead
    if isinstance(seconds, float | int):
        return np.full(_count(seconds / dt), first)
    moves = around.condition or around.approach is not None
    if seconds is None and not moves:
        return NOTHING
    return np.full(model.ahead(dt), first)


def return_ramp(begin: float, dt: float, limits: Limits, around: Around) -> Floats:
    """Return the voltages from the end of a move to ``return_to``, which may use the rating.

    Raises
    ------
    LimitError
        It is outside the rating.
    """
    if around.return_to is None:
        return NOTHING
    limits.require_start(around.return_to, "`return`")
    return ramp("return", begin, around.return_to, dt, "auto", limits)


def require_short(lead: Lead, move_seconds: float, limits: Limits) -> None:
    """Refuse rows before a move that nobody asked for and that are long beside the move.

    Raises
    ------
    LimitError
        They take more than a minute and more than ten moves; the message gives a slew
        limit that would fit.
    """
    allowed = longest_lead(move_seconds)
    if lead.chosen <= allowed:
        return
    remedy = "`approach` SECONDS"
    fixed = lead.chosen - lead.slewed
    if limits.slew is not None and fixed < allowed:
        fits = limits.slew * lead.slewed / (allowed - fixed)
        remedy = f"`max_slew` {_rounded_up(fits):g} would fit"
    raise LimitError(
        f"before the move, of {move_seconds:.4g} s, would stand {lead.chosen:.4g} s; at most a minute, or "
        f"ten times the move, {allowed:.4g} s, is put there ({remedy})"
    )


def longest_lead(move_seconds: float) -> float:
    """Return how long the program may drive before a move (s)."""
    return max(LONGEST_CHOSEN, CHOSEN_MOVES * move_seconds)


# --- swings of the voltage ---


def swings(turns: list[float], rows: list[int]) -> Floats:
    """Return half-cosine swings through ``turns``, in order; swing i takes ``rows[i]`` steps."""
    parts = [np.array(turns[:1])]
    for begin, end, count in zip(turns[:-1], turns[1:], rows, strict=True):
        phase = np.pi * np.arange(1, count + 1) / count
        part = begin + (end - begin) * (0.5 - 0.5 * np.cos(phase))
        part = np.clip(part, min(begin, end), max(begin, end))
        part[-1:] = end
        parts.append(part)
    return np.concatenate(parts)


def swing_rows(
    distance: float, dt: float, seconds: float, slew: float | None = None
) -> int:
    """Return the steps of a half-cosine swing: ``seconds``, or longer where the slew is limited.

    The steepest part of the swing rises by pi/2 times its mean slope.
    """
    if slew is not None:
        seconds = max(seconds, 0.5 * math.pi * abs(distance) / (SLEW_SPARE * slew))
    return _count(seconds / dt)


def _count(rows: float) -> int:
    """Return a whole number of rows, at least one (UsageError: more than any memory holds)."""
    if not rows < MOST_ROWS:
        raise UsageError(
            f"{rows:.4g} rows would stand before the move; at most {MOST_ROWS:,} are written "
            "(a larger `max_slew`, or a lower sample rate)"
        )
    return max(math.ceil(rows - WHOLE), 1)


def _check_seconds(name: str, value: Seconds) -> None:
    """Refuse what is neither a time above 0 nor ``auto`` (UsageError)."""
    if value is None or value == "auto":
        return
    if isinstance(value, float | int) and 0.0 < value < math.inf:
        return
    raise UsageError(f"`{name}` {value}: give seconds above 0, or auto")


def _require_seconds(name: str, seconds: Seconds, count: int, dt: float) -> None:
    if isinstance(seconds, float | int) and count * dt > seconds + dt:
        raise LimitError(
            f"`{name}` {seconds:g}: faster than the slew limit allows (at least {count * dt:.4g} s, or auto)"
        )


def _rounded_up(value: float) -> float:
    """Return a bound to three digits, no smaller than it is."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 2)
    return math.ceil(value / unit) * unit
