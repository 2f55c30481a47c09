"""What stands before a move: the ramp inwards, the sweep, the rest, the way to the first value, the lead."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dbo_cli.drives.options import DriveOptions, Seconds
from dbo_cli.drives.pieces import (
    NOTHING,
    Before,
    Chosen,
    ramp,
    require_rows,
    rest_samples,
    sweep,
    sweep_range,
    way,
)
from dbo_cli.errors import LimitError, UsageError
from dbo_cli.hysteresis.excitation import Floats
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_state import DriveLimits, ModelState, StartName

CHOSEN_SECONDS = 60.0  # s: so long the program may choose to take before any move
# times the move's own seconds: so long it may choose to take before a longer one
CHOSEN_MOVES = 10.0
WHOLE_ROW = 1e-9  # of a row: what rounding may add to a number of rows


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
        chosen = (
            []
            if _typed(options.lead)
            else [Chosen("the lead", lead.size, "`lead` SECONDS")]
        )
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
        dynamics = self.model.dynamics
        ahead = 0 if dynamics is None else dynamics.inverter(self.step).ahead
        delay = self.model.delay
        late = 0 if delay is None else delay.rows_ahead(self.step)
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
            reached = (
                0.0 if self.options.approach is None else model.displacement_of(state)
            )
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
