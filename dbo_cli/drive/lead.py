"""What stands before a move.

Before a move the voltage swings from where the amplifier stands, perhaps through a
sweep that makes the past known, to the voltage from which the move goes on, and rests
there until resonances have died away. These rows are played as they are. Rows at the
first displacement may follow, in which the inverse reads ahead to the move.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.drive.limits import Figure, Limits, rounded_up, voltage_in
from dbo_cli.drive.smooth import swing_rows, swings
from dbo_cli.errors import LimitError, UsageError
from dbo_cli.model import Cascade, Lag, Quantity, State
from dbo_cli.units import parse_quantity

Seconds = float | str | None
"""A number of s, ``auto``, or None; of ``Lead`` a text with a unit, too."""

SWEEP_SECONDS = 1.0
"""s over the whole range, where no slew limit asks for more; as ``excite`` by default."""
SAME_VOLTAGE = 1e-9
"""Of the rating: a typed voltage and that of a state are one up to rounding."""
SHORTEST_SWING = 0.1
"""s that a swing takes at least where nobody typed its seconds: whatever it excites stays small."""
QUIET = 14.0  # time constants: what rings is down to a millionth
# s; a resonance that rings longer was hardly excited by swings of a second
LONGEST_REST = 10.0
SLEW_SPARE = 0.9
"""Of the slew limit: what the digits of time stamps take away (since 1970, 0.2 us each)."""
WAY_HALVINGS = 40  # of the move's range, to find where a move goes on: to 1e-12 of it
SECANTS = 4
"""Steps of a secant that begins there; what creeps on the way is a small part."""
SECANT_SLACK = 1e-8  # of the move's range, around what a secant finds
LONGEST_CHOSEN = 60.0  # s that the program may put before a move; a user may type more
MOST_LEAD_ROWS = 100_000_000
NO_VOLTAGES = np.zeros(0)


@dataclass(kw_only=True)
class Lead:
    """What is asked for before a move.

    Attributes
    ----------
    state : str or State
        ``auto``, ``empty``, ``full``, ``settled``, or the state to go on from.
    start : float or str, optional
        Voltage at which the amplifier stands; a text has a unit.
    approach : float, str or "auto", optional
        Seconds (a text has a unit) of the way from there to the first value; with ``condition`` of the
        sweep, too.
    condition : bool
        Sweep the move's range first.
    rest : float, str or "auto", optional
        Seconds at the first value; auto: as many as dynamics and delay need.

    Raises
    ------
    UsageError
        A value is out of its range, or two exclude each other.
    """

    state: str | State = "auto"
    start: Figure = None
    approach: Seconds = None
    condition: bool = False
    rest: Seconds = None

    def __post_init__(self) -> None:
        """Check every value."""
        self.approach = _seconds("approach", self.approach)
        self.rest = _seconds("lead", self.rest)
        if self.condition and self.state != "auto":
            raise UsageError(
                "`condition` and `state` exclude each other: leave one out"
            )

    @property
    def past_known(self) -> bool:
        """Whether a sweep from rest or a typed state makes the past known."""
        return self.condition or isinstance(self.state, State) or self.state != "auto"

    def standing(self, limits: Limits, voltage: Quantity) -> float | None:
        """Return where the amplifier stands: as typed, or as a state left it; None where neither is known.

        Raises
        ------
        LimitError
            It is outside the rating.
        UsageError
            The two contradict each other.
        """
        start = voltage_in("from_", self.start, voltage)
        if start is not None:
            limits.require_start(start, "`from_`")
        left_at = self.state.drive if isinstance(self.state, State) else None
        if left_at is None:
            return start
        limits.require_start(left_at, "`state`: the voltage at which it was left,")
        low, high = limits.rating
        if start is not None and abs(start - left_at) > SAME_VOLTAGE * (high - low):
            raise UsageError(
                f"`from_` {start:g} contradicts `state`, which ends at {left_at:g}{limits.suffix}"
            )
        return left_at


def _seconds(name: str, value: Seconds) -> Seconds:
    """Return typed seconds as a number; UsageError where they are not above 0, None or auto."""
    if value is None or value == "auto":
        return value
    seconds = parse_quantity(value, "s", name)
    if 0.0 < seconds < math.inf:
        return seconds
    raise UsageError(f"`{name}` {value}: give seconds above 0, or auto")


@dataclass(frozen=True)
class LeadIn:
    """What stands before a move.

    Attributes
    ----------
    model
        A forward model.
    first
        First value of the move (displacement).
    dt
        Seconds a row.
    limits, lead
        What the drive may do, and what is asked for.
    last
        Where the amplifier stands, if that is known.
    """

    model: Cascade
    first: float
    dt: float
    limits: Limits
    lead: Lead
    last: float | None

    def planned(self, hold: int = 0) -> tuple[State | None, Floats, int]:
        """Return what stands before the move.

        Parameters
        ----------
        hold
            Rows at the beginning that are added to it.

        Returns
        -------
        state : State or None
            Before the first row; None where the inverse finds the start itself.
        voltage : array
            Voltages that are played as they are.
        rest : int
            Rows at the first displacement behind them, which the inverse follows.

        Raises
        ------
        LimitError
            The start is outside the rating, typed seconds are too few for the slew
            limit, or more than a minute would be needed that nobody typed.
        UsageError
            A piece is too long for any memory.
        """
        lead, last = self.lead, self.last
        moves = lead.condition or lead.approach is not None
        still, untyped = self._still_rows(moves)
        state, before = lead.state, NO_VOLTAGES
        if isinstance(state, State):
            state = replace(state, drive=last)
        elif last is not None:
            state = self.model.start(last, state)
            before = np.array([last])
        if moves:
            begin, voltage = self._way_in(state, before, hold, untyped)
            return begin, voltage, still
        _require_short(untyped, "lead", untyped)
        if not isinstance(state, State):
            return None, NO_VOLTAGES, still + hold
        return self._state_after(before, state), NO_VOLTAGES, still + hold

    def _way_in(
        self, state: State | str, before: Floats, hold: int, untyped: float
    ) -> tuple[State, Floats]:
        """Return the state before the first row, and the voltages that lead to the move.

        ``before`` is where the amplifier stands, if a row of it is to be written;
        ``untyped`` are seconds that nobody typed so far.
        """
        lead, dt = self.lead, self.dt
        last, swept = self.last, NO_VOLTAGES
        if lead.condition:
            swept = self._conditioning(last)
        before = np.concatenate([before, swept])
        stands = before[:1] if before.size else np.array([last])
        before = np.concatenate([np.repeat(stands, hold), before])
        if not isinstance(state, State):
            state = self.model.start(float(before[0]), state)
        seconds = lead.approach
        if lead.condition:
            seconds = "auto"
            if isinstance(lead.approach, float):
                seconds = max(lead.approach - swept.size * dt, dt)
        path = self._way(self._state_after(before, state), seconds)
        voltage = np.concatenate([before, path])
        still = rest_rows(self.model, dt)
        swing = (voltage.size - hold - still) * dt
        untyped += still * dt
        if not isinstance(lead.approach, float):
            untyped += swing
        _require_short(untyped, "approach", swing)
        return state, voltage

    def _still_rows(self, moves: bool) -> tuple[int, float]:
        """Return the rows at the first displacement, and the seconds of them that nobody typed."""
        rest = self.lead.rest
        if isinstance(rest, float):
            return _checked_rows(swing_rows(0.0, self.dt, rest)), 0.0
        still = 0
        if moves or rest == "auto":
            still = self.model.inverter(self.dt).ahead
        return still, still * self.dt

    def _conditioning(self, last: float | None) -> Floats:
        """Return the voltages of a sweep, behind the way there from where the amplifier stands.

        Typed seconds are those of the whole way, to the first value of the move: each
        swing has as many of them as of the distance.

        Raises
        ------
        LimitError
            The typed seconds are too few for the slew limit.
        UsageError
            The limits leave nothing to sweep.
        """
        limits, drive = self.limits, self.model.input
        dt, seconds = self.dt, self.lead.approach
        # at or below the first gear's origin every bit is clear, so that the past is wiped out
        low, high = limits.sweep
        if not low < high:
            raise UsageError(
                f"`condition` sweeps the identified range, {drive.min:.6g} to {drive.max:.6g}"
                f"{limits.suffix}; the limits leave none of it"
            )
        begin = low if last is None else last
        inwards: Seconds = "auto"
        sweeping = SWEEP_SECONDS
        if isinstance(seconds, float):
            end = self._goes_on(self.model.start(low, "empty"))
            distance = abs(begin - low) + 2.0 * (high - low) + abs(end - low)
            shortest = _rows(distance, dt, dt, limits) * dt
            _require_time("approach", seconds, shortest, dt)
            inwards = seconds * abs(begin - low) / distance
            sweeping = seconds * (high - low) / distance
        count = _rows(high - low, dt, sweeping, limits)
        swept = swings([low, high, low], [count, count])
        if last is None:
            return swept
        return np.concatenate([_swing(last, low, dt, inwards, limits), swept[1:]])

    def _way(self, state: State, seconds: Seconds) -> Floats:
        """Return the voltages from where a state stands to where the move goes on, with a rest there.

        What creeps meanwhile is counted: behind these rows the inverse begins the move at
        the voltage at which they end. The last swing behind a sweep takes what the slew
        limit needs.

        Raises
        ------
        LimitError
            The typed seconds are too few for the slew limit.
        """
        static, dt, limits = self.model.static, self.dt, self.limits
        begin, still = state.drive, rest_rows(self.model, dt)
        assert begin is not None

        def way_to(end: float) -> Floats:
            swing = _swing(begin, end, dt, seconds, limits)
            return np.concatenate([swing, np.full(still, end)])

        def missing(end: float) -> float:
            return self._goes_on(static.run(way_to(end), state, dt).state) - end

        end = self._goes_on(state)
        if self.model.gears.relaxation is not None:
            end = _zero_of(missing, *limits.move, end)
        if not self.lead.condition:
            ramp("approach", begin, end, dt, seconds, limits)
        return way_to(end)

    def _goes_on(self, state: State) -> float:
        """Return the voltage at which the move goes on behind a state."""
        first, move = np.array([self.first]), self.limits.move
        return float(self.model.static.drive(first, state, self.dt, move).y[0])

    def _state_after(self, voltage: Floats, state: State) -> State:
        """Return the state after voltages; without a clock the model does not need one."""
        dt = self.dt if self.dt > 0.0 else None
        return self.model.run(voltage, state, dt).state


def _require_short(untyped: float, option: str, seconds: float) -> None:
    """Refuse to choose more than a minute before a move; name the seconds to type (LimitError)."""
    if untyped <= LONGEST_CHOSEN:
        return
    more = " or more `max_slew`" if option == "approach" else ""
    raise LimitError(
        f"{untyped:.4g} s before the move, and at most {LONGEST_CHOSEN:g} s are chosen: give `{option}` "
        f"{rounded_up(seconds, 3):.9g}{more}"
    )


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
    voltage = _swing(begin, end, dt, seconds, limits)
    if isinstance(seconds, float):
        _require_time(name, seconds, voltage.size * dt, dt)
    return voltage


def _require_time(name: str, seconds: float, shortest: float, dt: float) -> None:
    """Refuse typed seconds that are too few for the slew limit, and say how many are not (LimitError)."""
    if shortest > seconds + dt:
        raise LimitError(
            f"`{name}` {seconds:g}: too fast for `max_slew`; give at least {rounded_up(shortest, 4):.9g} s "
            "for the whole way, or auto"
        )


def _swing(
    begin: float, end: float, dt: float, seconds: Seconds, limits: Limits
) -> Floats:
    """Return the voltages after ``begin`` of a swing to ``end``, as slow as the slew limit needs."""
    if begin == end:
        return NO_VOLTAGES
    shortest = SHORTEST_SWING
    if isinstance(seconds, float):
        shortest = float(seconds)
    elif limits.slew is None:
        span = limits.rating[1] - limits.rating[0]
        shortest = max(SHORTEST_SWING, SWEEP_SECONDS * abs(end - begin) / span)
    return swings([begin, end], [_rows(end - begin, dt, shortest, limits)])[1:]


def _zero_of(
    falling: Callable[[float], float], low: float, high: float, guess: float
) -> float:
    """Return where a falling function is zero between two voltages, by halving.

    A secant that begins at a guess finds it first, so that only halvings near it need the
    function, which may have small steps where a swing takes a row more.
    """
    slack, previous, middle = SECANT_SLACK * (high - low), guess, guess
    value = falling(guess)
    zero = guess + value
    for _ in range(SECANTS):
        last, value = value, falling(zero)
        if value == last:
            break
        zero, previous = zero - value * (zero - previous) / (value - last), zero
    is_found = abs(zero - previous) < 0.1 * slack
    for _ in range(WAY_HALVINGS):
        middle = 0.5 * (low + high)
        is_below = middle < zero
        if not is_found or abs(middle - zero) <= slack:
            is_below = falling(middle) > 0.0
        if is_below:
            low = middle
        else:
            high = middle
    return middle


def rest_rows(model: Cascade, dt: float) -> int:
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


def _rows(distance: float, dt: float, seconds: float, limits: Limits) -> int:
    """Return the steps of a swing within the slew limit."""
    slew = None if limits.slew is None else SLEW_SPARE * limits.slew
    return _checked_rows(swing_rows(distance, dt, seconds, slew))


def _checked_rows(rows: int) -> int:
    """Return a number of rows (UsageError: more than any memory holds)."""
    if rows > MOST_LEAD_ROWS:
        raise UsageError(
            f"{rows:.4g} rows before the move, at most {MOST_LEAD_ROWS:,}: raise `max_slew`, or lower the "
            "sample rate"
        )
    return rows
