"""What stands before a move, and the return after it.

Before a move the voltage swings from where the amplifier stands, perhaps through a
sweep that makes the past known, to the voltage from which the move goes on, and rests
there until resonances have died away. These rows are played as they are. Rows at the
first displacement may follow, in which the inverse reads ahead to the move.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dbo_cli.drive.limits import Limits
from dbo_cli.drive.swings import swing_rows, swings
from dbo_cli.errors import LimitError, UsageError
from dbo_cli.model import Lag, Model, Run, State, Window

Floats = NDArray[np.float64]
Seconds = float | Literal["auto"] | None

SWEEP_SECONDS = 1.0
"""s over the whole range, where no slew limit asks for more; as ``excite`` by default."""
SHORTEST_SWING = 0.1
"""s that a swing takes at least where nobody typed its seconds: whatever it excites stays small."""
QUIET = 14.0  # time constants: what rings is down to a millionth
# s; a resonance that rings longer was hardly excited by swings of a second
LONGEST_REST = 10.0
SLEW_SPARE = 0.9
"""Of the slew limit: what the digits of time stamps take away (since 1970, 0.2 us each)."""
HALVINGS = 40  # of the move's range, to find where a move goes on: to 1e-12 of it
LONGEST_CHOSEN = 60.0  # s that the program may put before any move
CHOSEN_MOVES = 10.0  # times the seconds of a move: so long before a longer one
MOST_ROWS = 100_000_000
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
        for name, value in (("approach", self.approach), ("lead", self.lead)):
            if isinstance(value, float | int) and 0.0 < value < math.inf:
                continue
            if value not in (None, "auto"):
                raise UsageError(f"`{name}` {value}: give seconds above 0, or auto")
        if self.condition and self.state != "auto":
            raise UsageError(
                "`condition` and `state` exclude each other: leave one out"
            )

    @property
    def moves(self) -> bool:
        """Whether the voltage moves before the move."""
        return self.condition or self.approach is not None

    @property
    def needs_time(self) -> bool:
        """Whether something is asked for that takes seconds."""
        return self.moves or self.lead is not None or self.return_to is not None

    @property
    def past_known(self) -> bool:
        """Whether a sweep or a state makes the past known."""
        return self.condition or isinstance(self.state, State)


@dataclass(frozen=True)
class Lead:
    """The rows before a move.

    Attributes
    ----------
    voltage, expected : array
        Voltages that are played as they are, and the displacement that the model
        expects of them.
    desired : array
        Displacements behind them, which the inverse follows: the first value of the
        move.
    state : State or None
        After the voltages; None where the inverse finds the start itself.
    chosen : float
        Seconds of the pieces of which nobody typed how long they take.
    """

    voltage: Floats = field(default_factory=lambda: NOTHING)
    expected: Floats = field(default_factory=lambda: NOTHING)
    desired: Floats = field(default_factory=lambda: NOTHING)
    state: State | None = None
    chosen: float = 0.0

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
    last = standing_at(limits, around)
    desired = np.full(_rest_rows_at_first(model, dt, around), first)
    chosen = 0.0
    if not isinstance(around.lead, float | int):
        chosen = desired.size * dt
    if not around.moves:
        state = None
        if isinstance(around.state, State):
            state = replace(around.state, drive=last)
        elif last is not None:
            state = _played(model, np.array([last]), dt, around.state).state
        return Lead(desired=desired, state=state, chosen=chosen)
    if last is None and not around.condition:
        raise UsageError("`approach` needs `from` VOLT or a `state` file")
    begun, seconds = around.state, around.approach
    before = NOTHING if last is None else np.array([last])
    if isinstance(begun, State):
        begun = replace(begun, drive=last)
        before = NOTHING  # where the amplifier stands was played already
    if around.condition:
        swept = sweep(model, limits, dt)
        if last is not None:
            inwards = ramp("approach", last, float(swept[0]), dt, seconds, limits)
            before = np.concatenate([before, inwards])
            swept = swept[1:]
        before = np.concatenate([before, swept])
        last, seconds = float(swept[-1]), "auto"
    run = _played(model, before, dt, begun)
    path = way(model, run.state, first, dt, seconds, limits)
    arrived = _played(model, path, dt, run.state)
    voltage = np.concatenate([before, path])
    chosen += voltage.size * dt
    if isinstance(around.approach, float | int):
        chosen -= around.approach
    expected = np.concatenate([run.y, arrived.y])
    return Lead(voltage, expected, desired, arrived.state, chosen)


def standing_at(limits: Limits, around: Around) -> float | None:
    """Return the voltage at which the amplifier stands before the first row, None where it is not known.

    Raises
    ------
    LimitError
        It is outside the rating.
    UsageError
        A state knows another voltage than the one that was typed.
    """
    left_at = around.state.drive if isinstance(around.state, State) else None
    return limits.standing(around.start, left_at)


def _rest_rows_at_first(model: Model, dt: float, around: Around) -> int:
    """Return the rows at the first value: typed seconds, or what delay and dynamics read ahead."""
    if isinstance(around.lead, float | int):
        return _checked_rows(swing_rows(0.0, dt, around.lead))
    if around.lead is None and not around.moves:
        return 0
    return model.inverter(dt).ahead


def _played(model: Model, voltage: Floats, dt: float, state: str | State) -> Run:
    """Play voltages from a state, or from a named start at the first of them."""
    if not isinstance(state, State):
        state = model.start(float(voltage[0]), state)
    return model.run(voltage, state, dt if dt > 0.0 else None)


# --- the pieces ---


def ramp(
    name: str, begin: float, end: float, dt: float, seconds: Seconds, limits: Limits
) -> Floats:
    """Return the voltages after ``begin`` of a swing to ``end``; ``name`` is the option that asks for it.

    Raises
    ------
    LimitError
        The typed seconds are too few for the slew limit.
    """
    if begin == end:
        return NOTHING
    least = SHORTEST_SWING
    if isinstance(seconds, float | int):
        least = float(seconds)
    elif limits.slew is None:
        span = limits.rating[1] - limits.rating[0]
        least = max(SHORTEST_SWING, SWEEP_SECONDS * abs(end - begin) / span)
    count = _rows(end - begin, dt, least, limits)
    if isinstance(seconds, float | int) and count * dt > seconds + dt:
        raise LimitError(
            f"`{name}` {seconds:g}: too fast for `max_slew`; give at least {count * dt:.4g} s, or auto"
        )
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
    low = max(limits.move[0], model.input.min)
    high = min(limits.move[1], model.input.max)
    if not low < high:
        raise UsageError(
            f"`condition` sweeps the identified range, {model.input.min:.6g} to "
            f"{model.input.max:.6g}{limits.suffix}; the limits leave none of it"
        )
    count = _rows(high - low, dt, SWEEP_SECONDS, limits)
    return swings([low, high, low], [count, count])


def way(
    model: Model,
    state: State,
    first: float,
    dt: float,
    seconds: Seconds,
    limits: Limits,
) -> Floats:
    """Return the voltages from where a state stands to where a move goes on, with a rest there.

    What creeps meanwhile is counted: behind these rows the inverse begins the move at
    the voltage at which they end.

    Raises
    ------
    LimitError
        The typed seconds are too few for the slew limit.
    """
    static, window = model.static, Window(*limits.move)
    assert state.drive is not None
    begin, rest = state.drive, rest_rows(model, dt)

    def way_to(end: float) -> Floats:
        swing = ramp("approach", begin, end, dt, seconds, limits)
        return np.concatenate([swing, np.full(rest, end)])

    def goes_on(state: State) -> float:
        return float(static.drive(np.array([first]), state, dt, window).y[0])

    if model.gears.relaxation is None:
        return way_to(goes_on(state))
    low, high = limits.move
    for _ in range(HALVINGS):
        end = 0.5 * (low + high)
        if goes_on(static.run(way_to(end), state, dt).state) > end:
            low = end
        else:
            high = end
    return way_to(end)


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


def return_ramp(begin: float, end: float, dt: float, limits: Limits) -> Floats:
    """Return the voltages from the end of a move to ``end``, which may use the rating.

    Raises
    ------
    LimitError
        It is outside the rating.
    """
    limits.require_start(end, "`return`")
    return ramp("return", begin, end, dt, "auto", limits)


def longest_lead(move_seconds: float) -> float:
    """Return how long the program may drive before a move (s)."""
    return max(LONGEST_CHOSEN, CHOSEN_MOVES * move_seconds)


def too_long(lead: Lead, move_seconds: float) -> LimitError:
    """Return the refusal of rows before a move that nobody asked for and that are long beside it."""
    return LimitError(
        f"{lead.chosen:.4g} s before a move of {move_seconds:.4g} s: more than ten moves and a "
        "minute; give `approach` SECONDS or more `max_slew`"
    )


def _rows(distance: float, dt: float, seconds: float, limits: Limits) -> int:
    """Return the steps of a swing within the slew limit."""
    slew = None if limits.slew is None else SLEW_SPARE * limits.slew
    return _checked_rows(swing_rows(distance, dt, seconds, slew))


def _checked_rows(rows: int) -> int:
    """Return a number of rows (UsageError: more than any memory holds)."""
    if rows > MOST_ROWS:
        raise UsageError(
            f"{rows:.4g} rows before the move, at most {MOST_ROWS:,}: raise `max_slew`, or lower the "
            "sample rate"
        )
    return rows
