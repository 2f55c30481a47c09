"""What stands before a move.

Before a move the voltage swings from where the amplifier stands, perhaps through a
sweep that makes the past known, to the voltage from which the move goes on, and rests
there until resonances have died away. These rows are played as they are. Rows at the
first displacement may follow, in which the inverse reads ahead to the move.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.drive.limits import Limits, rounded_up, voltage_in
from dbo_cli.drive.smooth import swing_rows, swings
from dbo_cli.errors import LimitError, UsageError
from dbo_cli.model import Cascade, State
from dbo_cli.units import Typed, quantity

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
LONGEST_CHOSEN = 60.0  # s that the program may put before a move; a user may type more
NO_VOLTAGES = np.zeros(0)
HELD_STEPS = 1e-6
"""Of a step: so much later than a step behind a state, its voltage was held."""


@dataclass
class Lead:
    """What a drive may do, and what stands before a move.

    Attributes
    ----------
    model
        A forward model.
    limits
        What its drive may do.
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
    hold : int
        Rows by which what stands before the move is longer: another channel needs them.
    standing : float or None
        Where the amplifier stands, as typed or as a state left it; None where neither is known.

    Raises
    ------
    LimitError
        The amplifier stands outside the rating.
    ModelError
        The model is an inverse one.
    UsageError
        A value is out of its range, or two contradict each other.
    """

    model: Cascade
    limits: Limits
    state: str | State = "auto"
    start: Typed | None = None
    approach: Typed | None = None
    condition: bool = False
    rest: Typed | None = None
    hold: int = 0
    standing: float | None = field(init=False)

    def __post_init__(self) -> None:
        """Check every value."""
        self.model.require("forward")
        self.standing = self._standing()
        self.approach = _seconds("approach", self.approach)
        self.rest = _seconds("lead", self.rest)
        if self.condition and self.state != "auto":
            raise UsageError(
                "`condition` and `state` exclude each other: leave one out"
            )
        if self.approach is not None and not self.condition and self.standing is None:
            raise UsageError("`approach` needs `from_` VOLT or a `state` file")

    def _standing(self) -> float | None:
        """Return where the amplifier stands; see ``standing``."""
        limits = self.limits
        start = voltage_in("from_", self.start, self.model.input)
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

    @property
    def past_known(self) -> bool:
        """Whether a sweep from rest or a typed state makes the past known."""
        return self.condition or isinstance(self.state, State) or self.state != "auto"

    # --- the rows before a move; ``first`` is its first displacement, ``dt`` the seconds a row ---

    def planned(
        self, first: float, dt: float, time: float | None
    ) -> tuple[State | str, Floats, int]:
        """Return what stands before the move: from where the amplifier stands, a sweep, the way, a rest.

        Parameters
        ----------
        first, dt
            The first displacement of the move, and the seconds a row.
        time
            Stamp (s) of that row: the voltage of a state was held until what stands before it.

        Returns
        -------
        state : State or str
            Before the first row; the name of a start that the inverse finds itself.
        voltage : array
            Voltages that are played as they are.
        rest : int
            Rows at the first displacement behind them, which the inverse follows.

        Raises
        ------
        LimitError
            Typed seconds are too few for the slew limit, or more than a minute would be
            needed that nobody typed.
        UsageError
            A piece is too long for any memory.
        """
        state, voltage = self.state, NO_VOLTAGES  # a state, or a row of where it stands
        if isinstance(state, State):
            state = replace(self._held(state, time, dt), drive=self.standing)
        elif self.standing is not None:
            voltage = np.array([self.standing])
            state = self.model.start(self.standing, state)
        moves = self.condition or self.approach is not None
        rest, added = 0, 0.0
        if isinstance(self.rest, float):
            rest = swing_rows(0.0, dt, self.rest)
        elif moves or self.rest == "auto":
            rest = self.model.inverter(dt).ahead
            added = rest * dt
        if not moves:
            _require_short(added, "lead", added)
            if isinstance(state, State):
                state = self._state_after(voltage, state, dt)
            return state, NO_VOLTAGES, rest + self.hold
        return *self._way_in(first, dt, state, voltage, added), rest

    def _held(self, state: State, time: float | None, dt: float) -> State:
        """Return a state after the pause behind its last row, in which the voltage was held."""
        if state.time is None or state.drive is None or time is None:
            return state
        pause = time - state.time - dt
        if pause <= HELD_STEPS * dt:
            return state
        return self.model.run(np.array([state.drive]), state, pause).state

    def _way_in(
        self,
        first: float,
        dt: float,
        state: State | str,
        voltage: Floats,
        added: float,
    ) -> tuple[State, Floats]:
        """Return the state before the first row, and the voltages that lead to the move.

        ``voltage`` is a row of where the amplifier stands, or none; ``added`` are seconds
        of the rest before the move that nobody typed.
        """
        seconds = total = self.approach if isinstance(self.approach, float) else None
        if self.condition:
            swept = self._conditioning(first, dt, total)
            voltage = np.concatenate([voltage, swept])
            if total is not None:
                seconds = max(total - swept.size * dt, dt)
        stands = voltage[0] if voltage.size else self.standing
        voltage = np.concatenate([np.full(self.hold, stands), voltage])
        if not isinstance(state, State):
            state = self.model.start(float(voltage[0]), state)
        path = self._way(first, dt, self._state_after(voltage, state, dt), seconds)
        voltage, quiet = np.concatenate([voltage, path]), rest_rows(self.model, dt)
        if not self.condition:
            require_time(seconds, (path.size - quiet) * dt, dt)
        swing = (voltage.size - self.hold - quiet) * dt
        added += quiet * dt
        if total is None:
            added += swing
        _require_short(added, "approach", swing)
        return state, voltage

    def _conditioning(self, first: float, dt: float, seconds: float | None) -> Floats:
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
        limits, standing = self.limits, self.standing
        # at or below the first gear's origin every bit is clear, so that the past is wiped out
        low, high = limits.sweep
        if not low < high:
            lowest, highest = limits.identified
            raise UsageError(
                f"`condition` sweeps the identified range, {lowest:.6g} to {highest:.6g}{limits.suffix}; "
                "the limits leave none of it"
            )
        begin = low if standing is None else standing
        inwards, sweeping = None, SWEEP_SECONDS
        if seconds is not None:
            end = self._goes_on(first, dt, self.model.start(low, "empty"))
            distance = abs(begin - low) + 2.0 * (high - low) + abs(end - low)
            shortest = _rows(distance, dt, dt, limits) * dt
            require_time(seconds, shortest, dt)
            inwards = seconds * abs(begin - low) / distance
            sweeping = seconds * (high - low) / distance
        count = _rows(high - low, dt, sweeping, limits)
        swept = swings([low, high, low], [count, count])
        if standing is None:
            return swept
        inward = ramp(standing, low, dt, inwards, limits)
        return np.concatenate([inward, swept[1:]])

    def _way(
        self, first: float, dt: float, state: State, seconds: float | None
    ) -> Floats:
        """Return the voltages from where a state stands to where the move goes on, with a rest there.

        What creeps meanwhile is counted: behind these rows the inverse begins the move at
        the voltage at which they end.
        """
        static, limits = self.model.static, self.limits
        begin, quiet = state.drive, rest_rows(self.model, dt)
        assert begin is not None

        def way_to(end: float) -> Floats:
            swing = ramp(begin, end, dt, seconds, limits)
            return np.concatenate([swing, np.full(quiet, end)])

        if self.model.gears.relaxation is None:
            return way_to(self._goes_on(first, dt, state))
        low, high = limits.move  # where it goes on falls as the way ends higher
        for _ in range(WAY_HALVINGS):
            end = 0.5 * (low + high)
            after = static.run(way_to(end), state, dt).state
            if self._goes_on(first, dt, after) > end:
                low = end
            else:
                high = end
        return way_to(end)

    def _goes_on(self, first: float, dt: float, state: State) -> float:
        """Return the voltage at which the move goes on behind a state, an amplifier at rest there."""
        static, target, move = self.model.static, np.array([first]), self.limits.move
        if static.amplifier is not None:
            static = static.with_stages(static.stages[1:])
        return float(static.drive(target, state, dt, move).y[0])

    def _state_after(self, voltage: Floats, state: State, dt: float) -> State:
        """Return the state after voltages; without a clock the model does not need one."""
        return self.model.run(voltage, state, dt if dt > 0.0 else None).state


def _seconds(name: str, value: Typed | None) -> Typed | None:
    """Return typed seconds as a number; UsageError where they are not above 0, None or auto."""
    seconds: Typed | None = quantity(name, value, "s", "auto")
    if isinstance(seconds, float) and not seconds > 0.0:
        raise UsageError(f"`{name}` {value}: give seconds above 0, or auto")
    return seconds


def _require_short(added: float, option: str, seconds: float) -> None:
    """Refuse to choose more than a minute before a move; name the seconds to type (LimitError)."""
    if added <= LONGEST_CHOSEN:
        return
    more = " or more `max_slew`" if option == "approach" else ""
    raise LimitError(
        f"{added:.4g} s before the move, and at most {LONGEST_CHOSEN:g} s are chosen: give `{option}` "
        f"{rounded_up(seconds, 3):.9g}{more}"
    )


# --- the pieces ---


def ramp(
    begin: float, end: float, dt: float, seconds: float | None, limits: Limits
) -> Floats:
    """Return the voltages after ``begin`` of a swing to ``end``, as slow as the slew limit needs."""
    if begin == end:
        return NO_VOLTAGES
    if seconds is None:
        seconds = SHORTEST_SWING
        if limits.slew is None:
            span = limits.rating[1] - limits.rating[0]
            seconds = max(seconds, SWEEP_SECONDS * abs(end - begin) / span)
    return swings([begin, end], [_rows(end - begin, dt, seconds, limits)])[1:]


def require_time(seconds: float | None, shortest: float, dt: float) -> None:
    """Refuse typed seconds that are too few for the slew limit, and say how many are not (LimitError)."""
    if seconds is not None and shortest > seconds + dt:
        raise LimitError(
            f"`approach` {seconds:g}: too fast for `max_slew`; give at least {rounded_up(shortest, 4):.9g} s "
            "for the whole way, or auto"
        )


def rest_rows(model: Cascade, dt: float) -> int:
    """Return the rows (0 without dynamics) after which lags and resonances have died away."""
    if model.dynamics is None:
        return 0
    slowest = max(section.fade for section in model.dynamics.sections)
    return math.ceil(min(QUIET * slowest, LONGEST_REST) / dt)


def _rows(distance: float, dt: float, seconds: float, limits: Limits) -> int:
    """Return the steps of a swing within the slew limit."""
    slew = None if limits.slew is None else SLEW_SPARE * limits.slew
    return swing_rows(distance, dt, seconds, slew)
