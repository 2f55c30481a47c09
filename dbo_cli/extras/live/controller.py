"""Live use: one sample at a time, forward in time only.

A control loop calls ``plan`` with what is wanted, hands the voltage (or the converter's
code) to the hardware, and calls ``commit`` once the hardware has acknowledged it. A
plan never committed leaves no trace. Beyond the gears, what is wanted later undoes
delay and dynamics (``LookAhead``), and a lag before the gears is undone sample by
sample (``DriveLag``); all with the bits of ``compensate``.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from dbo_cli.drives.gate import DriveGate, GateError
from dbo_cli.drives.options import DriveOptions, Figure, check_seconds, voltage_in
from dbo_cli.drives.pieces import ramp
from dbo_cli.errors import ModelError, UsageError
from dbo_cli.extras.live.converter import Converter
from dbo_cli.extras.live.rows import (
    PLAYED_SPANS,
    WANTED_SPANS,
    LiveDrive,
    Pending,
    number,
    reach_of,
    refused,
)
from dbo_cli.hysteresis.cascade import WHOLE, MemoryFree, ScaleStage, through
from dbo_cli.hysteresis.drive_lag import coefficients, undoing_rows
from dbo_cli.hysteresis.dynamics import DynamicsInverter, InverseMemory
from dbo_cli.hysteresis.kernel import Floats
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_state import DriveLimits, ModelState, StartName
from dbo_cli.hysteresis.stepper import BacklashStepper, inwards, may_follow
from dbo_cli.interpolation.smooth import AFTER, WINDOW, value_between
from dbo_cli.logs.request import checked_rate

Window = tuple[list[float], Floats, InverseMemory | None]
PAST = WINDOW - 2
"""Samples before the oldest one that is not past, of which a value between two samples may be made."""


class LookAhead:
    """What the gears are to follow now, from what is wanted ``samples`` later.

    Before the first value the same value holds: the output is that of a trajectory with
    ``samples`` rows at its first value before it (``lead`` of ``compensate``).

    Parameters
    ----------
    model : ActuatorModel
        A forward model.
    rate : float
        Samples a second (Hz).
    seconds : float or "auto"
        How much later what is passed is wanted; auto: the shortest time that the model
        needs.

    Attributes
    ----------
    samples : int
        That time in samples, rounded up.
    held : tuple, or None
        What is wanted from ``PAST`` samples before the one committed last on, the same
        with the delay undone, and what the inverse of the dynamics remembers; None
        before the first.

    Raises
    ------
    InputError
        The rate does not resolve the dynamics.
    UsageError
        The model needs more.
    """

    def __init__(
        self, model: ActuatorModel, rate: float, seconds: float | Literal["auto"]
    ) -> None:
        check_seconds("lookahead", seconds)
        self._rate = rate
        self._step = 1.0 / rate
        self._delay = model.delay_seconds
        self._inverter: DynamicsInverter | None = None
        self._ahead = 0
        if model.dynamics is not None:
            self._inverter = model.dynamics.inverter(self._step)
            self._ahead = self._inverter.ahead
        self._late = math.ceil(self._delay / self._step - WHOLE)
        needed = self._late + self._ahead
        self._between = "linear"
        self.samples = self._ahead
        if model.delay is not None:
            self._between = model.delay.between
            self.samples += model.delay.rows_ahead(self._step)
        if seconds != "auto":
            self.samples = math.ceil(seconds / self._step - WHOLE)
        if self.samples < needed:
            raise UsageError(
                f"`lookahead` {seconds:g} s is {self.samples} samples, and the inverse of this model reads "
                f"{needed} ahead (`lookahead` {needed / rate:.6g} or auto)"
            )
        self._count = 0  # values committed
        self.held: Window | None = None

    def plan(self, wanted: float, state: ModelState | None) -> tuple[float, Window]:
        """Return what the gears are to follow now, and what is held after it.

        ``state`` is that before the first value.
        """
        memory: InverseMemory | None = None
        if self.held is None:
            raw = [float(wanted)] * (PAST + self.samples - self._ahead + 1)
            shifted = np.full(self._ahead + 1, wanted)
            if self._inverter is not None:
                memory = (
                    state and state.memory_for(self._inverter)
                ) or self._inverter.rest(wanted)
        else:
            raw, shifted, memory = self.held
            raw = [*raw[1:], float(wanted)]
            shifted = np.append(shifted[1:], self._shifted(raw))
        u = float(shifted[0])
        if self._inverter is not None and memory is not None:
            undone, memory = self._inverter.run(shifted, memory)
            u = float(undone[0])
        return u, (raw, shifted, memory)

    def commit(self, window: Window | None) -> None:
        """Go on to the next sample."""
        if window is not None:
            self.held = window
            self._count += 1

    def hold(self) -> Window | None:
        """Return what is held after a sample for which nothing was planned: what is wanted stays."""
        return None if self.held is None else self.plan(self.held[0][-1], None)[1]

    def forget(self) -> None:
        """Begin anew with the next value."""
        self.held = None
        self._count = 0

    def _shifted(self, raw: list[float]) -> float:
        """Return what is wanted the delay after the oldest value that is not past, as reading ahead does.

        With less lookahead than ``auto`` takes, fewer of the six samples lie behind the
        time wanted.
        """
        if not self._late:
            return raw[PAST]
        row = self._count + self._ahead
        wanted = self._stamp(row) + self._delay
        newer, older = self._stamp(row + self._late), self._stamp(row + self._late - 1)
        later, earlier = raw[PAST + self._late], raw[PAST + self._late - 1]
        if self._between == "linear":
            part = (newer - wanted) / (newer - older)
            if part < WHOLE:
                return later
            return earlier if part > 1.0 - WHOLE else later + part * (earlier - later)
        part = (wanted - older) / (newer - older)
        if part < WHOLE:
            return earlier
        if part > 1.0 - WHOLE:
            return later
        newest = self.samples - self._ahead
        begin = min(self._late - AFTER, newest - (WINDOW - 1))
        times = [self._stamp(row + begin + k) for k in range(WINDOW)]
        values = raw[PAST + begin : PAST + begin + WINDOW]
        return value_between(times, values, self._late - 1 - begin, part)

    def _stamp(self, row: int) -> float:
        """Return the time (s) of a row, counted from the first at the first value; 0 at the trajectory's."""
        row -= self.samples
        return row * self._step if row < 0 else row / self._rate


class DriveLag:
    """A lag before the gears, undone one sample at a time (``hysteresis.drive_lag``).

    Parameters
    ----------
    model : ActuatorModel
        A forward model with such a lag.
    limits : DriveLimits
        Of the drive.
    step : float
        Seconds between samples.
    """

    def __init__(self, model: ActuatorModel, limits: DriveLimits, step: float) -> None:
        assert model.drive_lag is not None
        self._model = model
        self._lag = model.drive_lag
        self._limits = limits
        self._step = step
        self._most = math.inf
        if limits.max_slew is not None:
            self._most = limits.largest_change(step) or math.inf
        row = undoing_rows(coefficients(self._lag, step))[0]
        self._by_lead, self._by_change = float(row[1]), float(row[2])
        self.held = (0.0, 0.0)  # what the lag passes on, and the drive before it

    def plan(self, behind: float, wanted: float, stepper: BacklashStepper) -> LagStep:
        """Return the drive that the lag makes ``behind`` of, or the nearest allowed.

        What the limits of the drive allow behind the lag changes from sample to sample;
        only a sample that they hold back is worked out by the whole model from what is
        ``wanted``.
        """
        late, last = self.held
        volts = last + (
            self._by_lead * (late - last) + self._by_change * (behind - late)
        )
        if (
            self._limits.v_min <= volts <= self._limits.v_max
            and abs(volts - last) <= self._most
        ):
            return LagStep(volts, stepper.clipped, (behind, volts))
        before = ModelState(stepper.state, stepper.last, drive_lag=((late, 0.0, last),))
        done = self._model.inverted.simulate(
            [wanted], before, time_step=self._step, limits=self._limits
        )
        return LagStep(
            float(done.y[0]),
            min(done.clipped_count, 1),
            _lag_of(done.state),
            done.state,
        )

    def follow(self, volts: float) -> LagStep:
        """Return what the lag passes on of a voltage that was not planned here."""
        late, last = self.held
        behind = float(
            self._lag.run(np.array([volts]), self._step, ((late, 0.0, last),))[0][0]
        )
        return LagStep(volts, 0, (behind, volts))

    def begin(self, state: ModelState) -> None:
        """Take a state over."""
        self.held = _lag_of(state)


class LagStep(NamedTuple):
    """One sample through a lag before the gears.

    Attributes
    ----------
    volts : float
        The drive before the lag.
    clipped : int
        1 where the limits hold it back.
    held : tuple
        What the lag then passes on, and the drive.
    state : ModelState, or None
        That of the gears, where the stepper does not have it.
    """

    volts: float
    clipped: int
    held: tuple[float, float]
    state: ModelState | None = None


def _lag_of(state: ModelState) -> tuple[float, float]:
    """Return what the lag before the gears passes on in a state, and the drive before it."""
    assert state.drive_lag is not None
    late, _, last = state.drive_lag[0]
    return late, last


class Beside(NamedTuple):
    """What goes on with a row beside the gears.

    Attributes
    ----------
    begun : ModelState, or None
        After the first row.
    window : Window, or None
        What a look-ahead holds.
    lag : LagStep, or None
        Through the lag before the gears.
    """

    begun: ModelState | None = None
    window: Window | None = None
    lag: LagStep | None = None


UPDATE = 128
"""Samples after which dynamics follow the drive: so many take hardly longer than one of them alone."""


class Controller(LiveDrive[float, float | int]):
    """The drive of a forward model, sample by sample; made by ``Model.controller``.

    The same bits as ``compensate`` over the same samples. Where the drive stands
    outside its limits, because of ``from_``, a state or what was applied, the next
    plans bring it inwards as fast as the slew limit allows, whatever is wanted.

    Attributes
    ----------
    clipped : int
        Committed samples in which the limits of the drive were met.
    limits : DriveLimits
        What the drive may do: its range, and its change a second.
    lookahead : int
        How many samples later is wanted what is passed; 0 without ``lookahead``.
    converter : Converter, or None
        What ``dac`` describes.
    saved : float
        What the converter has saved up of the slew limit, V.
    wanted_reach, played_reach : Reach
        The displacements and the voltages that are taken at all.
    units : tuple of str
        Those of voltage and displacement, as messages write them.
    """

    def __init__(
        self,
        model: ActuatorModel,
        sample_rate: float | None,
        *,
        v_min: Figure = None,
        v_max: Figure = None,
        max_slew: Figure = None,
        extrapolate: bool = False,
        state: StartName | ModelState = "auto",
        from_: Figure = None,
        dac: ArrayLike | None = None,
        ahead: bool = False,
        lookahead: float | Literal["auto"] | None = None,
    ) -> None:
        model.require("forward")
        _require_known(model, ahead, lookahead is not None)
        sample_rate = checked_rate(sample_rate)
        _require_rate(
            sample_rate,
            model.needs_time or max_slew is not None or lookahead is not None,
        )
        self._model = model
        self._step_seconds = None if sample_rate is None else 1.0 / sample_rate
        v_min, v_max = _figure("v_min", v_min), _figure("v_max", v_max)
        max_slew, from_ = _figure("max_slew", max_slew), _figure("from_", from_)
        self.limits = DriveOptions(
            v_min, v_max, extrapolate, max_slew, from_=from_
        ).limits(model)
        self._low = self.limits.v_min
        self._high = self.limits.v_max
        most = self.limits.largest_change(self._step_seconds)
        self._most = math.inf if most is None else most
        # A converter's code keeps the slew limit itself, since it may have to save up
        # for it.
        self._planning = self.limits
        if dac is not None:
            self._planning = DriveLimits(self._low, self._high)
        self.wanted_reach = reach_of(
            model.output.minimum, model.output.maximum, WANTED_SPANS
        )
        self.played_reach = reach_of(
            model.input.minimum, model.input.maximum, PLAYED_SPANS
        )
        self.units = model.input.suffix, model.output.suffix
        self._inverse = model.inverse()
        self._gears = self._inverse.backlash  # a model that has none is refused here
        self._start: StartName | ModelState = state
        self._last = math.nan  # the voltage that stands; NaN: not known
        self._stand_at(from_)
        self._gate = DriveGate(self.limits, None, model.input.suffix)
        self.converter = None if dac is None else Converter(dac, self.limits, most)
        self.saved = 0.0
        if self.converter is not None and not math.isnan(self._last):
            stands_by = "state" if from_ is None else "from_"
            self.converter.require_within(stands_by, self._last)
        self._ahead: LookAhead | None = None
        if lookahead is not None and sample_rate is not None:
            self._ahead = LookAhead(model, sample_rate, lookahead)
        self._lag: DriveLag | None = None
        if model.drive_lag is not None and self._step_seconds is not None:
            self._lag = DriveLag(model, self._planning, self._step_seconds)
        self.lookahead = 0 if self._ahead is None else self._ahead.samples
        # What is behind the gears takes no part in the drive: it follows now and then,
        # for the state alone.
        self._behind = model.dynamics is not None or (
            model.delay_seconds > 0.0 and not ahead
        )
        self._past: ModelState | None = None
        self._since: list[float] = []
        self._stepper: BacklashStepper | None = None
        self._gears_alone = self._ahead is None and self._lag is None
        # the stepper's kernel, once it has begun and nothing else goes with it
        self._inner: Any = None
        self._set_stages()
        self.clipped = 0

    def close(
        self, to: float | None = None, seconds: float | Literal["auto"] = "auto"
    ) -> list[float] | list[int]:
        """Return the ramp to rest, to be handed to the hardware as it is; the state goes with it.

        Parameters
        ----------
        to : float, optional
            Where to rest, V; 0 or the limit nearest to it, where not given.
        seconds : float or "auto"
            How long the ramp takes; auto: as fast as the slew allows, without one a
            second.

        Raises
        ------
        UsageError
            Nothing was committed yet, or no sample rate is known.
        InputError
            ``to`` is not a finite number.
        """
        if math.isnan(self._last) or self._step_seconds is None:
            raise UsageError(
                "a ramp to rest needs a committed sample and a `sample_rate`"
            )
        check_seconds("seconds", seconds)
        rest = 0.0 if to is None else self._voltage("`to`", to)
        rest = min(max(rest, self._low), self._high)
        ramp_rows = ramp(
            "seconds", self._last, rest, self._step_seconds, seconds, self.limits
        ).tolist()
        if self.converter is not None:
            codes = self._codes_along(ramp_rows, self.converter)
            for code in codes:
                self.commit(code)
        else:
            self._check_row_by_row(ramp_rows)
            for volts in ramp_rows:
                self.commit(volts)
        self._pending = None
        if self._ahead is not None:
            self._ahead.forget()
        return ramp_rows if self.converter is None else codes

    @property
    def held_back(self) -> bool:
        """Whether the limits hold back what was planned and is not committed yet."""
        return self._pending is not None and bool(self._pending[2])

    @property
    def state(self) -> ModelState | None:
        """The committed state, for ``simulate`` or ``compensate`` to go on from; None before the first."""
        if self._stepper is None:
            return self._start if isinstance(self._start, ModelState) else None
        undoing = None if self._ahead is None else self._ahead.held
        return dataclasses.replace(
            self._update(), undoing=undoing and undoing[2], model=self._model.digest
        )

    @property
    def begun(self) -> tuple[BacklashStepper, MemoryFree, MemoryFree] | None:
        """The gears' stepper and what stands beside it, for a bank; None before a commit, or with a lag."""
        if self._stepper is None or self._ahead is not None or self._lag is not None:
            return None
        return self._stepper, self._head, self._after

    @property
    def bounds(self) -> tuple[float, ...]:
        """Range, largest change, the voltage that stands (NaN: none), and what may come in, for a bank."""
        limits = self._low, self._high, self._most, self._last
        return *limits, *self.wanted_reach, *self.played_reach

    def _stand_at(self, from_: Figure) -> None:
        """Find the voltage that stands, and the state there."""
        model = self._model
        if isinstance(self._start, ModelState):
            if self._start.model not in (None, model.digest):
                raise UsageError(
                    "`state`: is of another model (go on with the model that returned it)"
                )
            drive = model.drive_of(self._start)
            self._last = math.nan if drive is None else drive
        elif from_ is not None:
            self._last = self._voltage(
                "`from_`", voltage_in("from_", from_, model.input)
            )
            begun = model.start(self._last, self._start)
            self._start = model.simulate(
                [self._last], begun, time_step=self._step_seconds
            ).state

    def _set_stages(self) -> None:
        """Keep what stands before and behind the inverse's gears."""
        # Scales before the gears, where nothing else stands there, are worked out
        # without an array.
        self._head, self._after = self._inverse.head, self._inverse.tail
        self._drive_side = self._inverse.tail_inverse
        self._scales = []
        for stage in self._head:
            if isinstance(stage, ScaleStage):
                self._scales.append((stage.gain, stage.offset))
        self._bent_before = len(self._scales) < len(self._head)
        self._bent = self._bent_before or bool(self._after)

    def _worked_out(self, wanted: float) -> Pending:
        """Return what a plan comes to: voltage or code, its volts, whether it is clipped, and the rest."""
        if wanted.__class__ is not float:
            wanted = number("what is wanted", wanted)
        low, high = self.wanted_reach
        if not low < wanted < high:
            raise refused("what is wanted", wanted, self.wanted_reach, self.units[1])
        inner = self._inner
        if inner is None:
            return self._worked_out_with_more(wanted)
        last, limit_low, limit_high = self._last, self._low, self._high
        if self.converter is not None:
            return self._coded(self._stepped(wanted, inner), inner, self.converter)
        if not limit_low <= last <= limit_high:
            inside = inwards(last, limit_low, limit_high, self._most)
            if inside is not None:
                self._follow(inside, inner)
                return inside, inside, 1, 0.0, None
        if self._bent:
            volts = self._stepped(wanted, inner)
        else:
            for gain, offset in self._scales:
                wanted = gain * wanted + offset
            volts = inner.plan(wanted)
        if not (limit_low <= volts <= limit_high and abs(volts - last) <= self._most):
            self._require_may_follow(volts, last, self._most)
        return volts, volts, inner.clipped, 0.0, None

    def _coded(self, volts: float, inner: Any, dac: Converter) -> Pending:
        """Return what a plan comes to with a converter; the kernel has the state of the code's voltage."""
        clipped, last = inner.clipped, self._last
        code, volts, most, saved, held_back = dac.next(volts, last, self.saved)
        if not (self._low <= volts <= self._high and abs(volts - last) <= most):
            self._require_may_follow(volts, last, most)
        if self._drive_side:
            self._follow(volts, inner)
        else:
            inner.follow(volts)
        return code, volts, clipped or int(held_back), saved, None

    def _stepped(self, wanted: float, stepper: Any) -> float:
        """Return the voltage within the limits that the gears lead to; the stepper has their state."""
        if self._bent_before:
            wanted = float(through(self._head, np.array([wanted]))[0])
        else:
            for gain, offset in self._scales:
                wanted = gain * wanted + offset
        volts: float = stepper.plan(wanted)
        if self._after:
            bent = float(through(self._after, np.array([volts]))[0])
            volts = min(max(bent, self._low), self._high)
        return volts

    def _worked_out_with_more(self, wanted: float) -> Pending:
        """Return what a plan comes to, where it is the first one, or more than the gears go on with it."""
        begun, window, lag = None, None, None
        if self._ahead is not None:
            wanted, window = self._ahead.plan(
                wanted, None if self._ahead.held else self.state
            )
        stepper = self._stepper
        most, saved, last = self._most, self.saved, self._last
        inside = (
            inwards(last, self._low, self._high, most)
            if self.converter is None
            else None
        )
        if stepper is None:
            volts, clipped, begun = self._first(wanted, inside)
        elif inside is not None:
            volts, clipped = inside, 1
            lag = self._follow(inside, stepper)
        else:
            volts = self._stepped(wanted, stepper)
            clipped = stepper.clipped
            if self._lag is not None:
                lag = self._lag.plan(volts, wanted, stepper)
                volts, clipped = lag.volts, lag.clipped
        planned: float | int = volts
        if self.converter is not None:
            planned, volts, most, saved, held_back = self.converter.next(
                volts, self._before(), saved
            )
            clipped = clipped or int(held_back)
            if stepper is None:
                begun = self._state_after(volts)
            else:
                lag = self._follow(volts, stepper)
        self._require_may_follow(volts, last, most)
        return planned, volts, clipped, saved, Beside(begun, window, lag)

    def _first(
        self, wanted: float, inside: float | None
    ) -> tuple[float, int, ModelState]:
        """Return the first voltage, whether it is clipped, and the state after it.

        The start is found as ``compensate`` does; the stepper begins after it. ``way``
        is the voltage of a drive that has to come inwards first.
        """
        if inside is not None:
            return inside, 1, self._state_after(inside)
        begin = self._model.start_compensation(wanted, self._start, self._planning)
        done = self._model.compensate(
            [wanted], begin, limits=self._planning, time_step=self._step_seconds
        )
        return float(done.y[0]), min(done.clipped_count, 1), done.state

    def _before(self) -> float:
        """Return the voltage that stands, NaN where it is not known, for a converter.

        An actuator that starts ``empty`` or ``full`` stands at that end, as in
        ``start_compensation``.
        """
        if not math.isnan(self._last) or self._start not in ("empty", "full"):
            return self._last
        end = 0 if self._start == "empty" else 1
        inner = self._model.covered_gears.x_range[end]
        return min(max(self._inverse.outer_drive(inner), self._low), self._high)

    def _voltage(self, what: str, value: object) -> float:
        """Return volts that were handed in, checked (InputError)."""
        volts: float = value if value.__class__ is float else number(what, value)
        low, high = self.played_reach
        if not low < volts < high:
            raise refused(what, volts, self.played_reach, self.units[0])
        return volts

    def _followed(self, applied: float | int, pending: Pending | None) -> Pending:
        """Return what applied volts, or a code, come to."""
        what, saved, inner = "what was applied", self.saved, self._inner
        if self.converter is None:
            volts = self._voltage(what, applied)
        else:
            volts = self._voltage(
                what, self.converter.curve[self.converter.code_of(applied)]
            )
            if not math.isnan(self._last):
                most = self.converter.most(self._last, saved)
                saved = self.converter.left(abs(volts - self._last), most)
        clipped = 0 if pending is None else pending[2]
        if inner is not None:
            if self._drive_side:
                self._follow(volts, inner)
            else:
                inner.follow(volts)
            return applied, volts, clipped, saved, None
        window = self._window_after(pending)
        if self._stepper is None:
            beside = Beside(self._state_after(volts), window)
        else:
            beside = Beside(None, window, self._follow(volts, self._stepper))
        return applied, volts, clipped, saved, beside

    def _window_after(self, pending: Pending | None) -> Window | None:
        """Return what a look-ahead holds after a row: that of the plan, or what it held."""
        if self._ahead is None:
            return None
        if pending is None:
            return self._ahead.hold()
        window: Window | None = pending[4].window
        return window

    def _follow(self, volts: float, stepper: Any) -> LagStep | None:
        """Work out the state of the gears that a voltage leads to: the forward model's, driven by it."""
        lag = None if self._lag is None else self._lag.follow(volts)
        inner = volts if lag is None else lag.held[0]
        for stage in self._drive_side:
            inner = float(stage.run(np.array([inner]))[0])
        stepper.follow(inner)
        return lag

    def _state_after(self, volts: float) -> ModelState:
        """Return the state after a first voltage."""
        begun = self._model.start(volts, self._start)
        return self._model.simulate([volts], begun, time_step=self._step_seconds).state

    def _take(self, pending: Pending) -> None:
        """Go on from what was worked out last."""
        _, volts, clipped, saved, beside = pending
        if beside is None:
            self._inner.commit()
        else:
            self._take_more(volts, beside)
        self._last, self.saved = volts, saved
        self.clipped += clipped

    def _take_more(self, volts: float, beside: Beside) -> None:
        """Go on with what is beside the gears, and with these."""
        if beside.begun is not None:
            self._begin(beside.begun)
        elif self._stepper is not None:
            lag = beside.lag
            if lag is None or lag.state is None:
                self._stepper.commit()
            else:
                assert lag.state.drive is not None
                self._stepper.set(lag.state.backlash, lag.state.drive)
            if lag is not None and self._lag is not None:
                self._lag.held = lag.held
            if self._behind:
                self._since.append(volts)
                if len(self._since) >= UPDATE:
                    self._update()
        if self._ahead is not None:
            self._ahead.commit(beside.window)

    def _begin(self, state: ModelState) -> None:
        """Go on from the state after the first row."""
        self._past, self._since = state if self._behind else None, []
        inverse, limits = self._inverse, self._planning
        if self._lag is not None:  # the slew is limited before the lag
            self._lag.begin(state)
            limits = DriveLimits(limits.v_min, limits.v_max)
        bound = inverse.output_limits(inverse.inner_limits(limits), self._step_seconds)
        last = math.nan if state.drive is None else state.drive
        self._stepper = BacklashStepper(
            self._gears, state.backlash, last, self._step_seconds, bound
        )
        self._inner = self._stepper.inner if self._gears_alone else None

    def _update(self) -> ModelState:
        """Return the committed state; let what is behind the gears follow the drive up to now."""
        assert self._stepper is not None
        state = ModelState(self._stepper.state, self._stepper.last)
        if self._lag is not None:
            late, last = self._lag.held
            state = dataclasses.replace(state, drive_lag=((late, 0.0, last),))
        past = self._past
        if past is not None:
            if self._since:
                past = self._model.simulate(
                    self._since, past, time_step=self._step_seconds
                ).state
            state = dataclasses.replace(
                state, dynamics=past.dynamics, history=past.history
            )
            self._past, self._since = state, []
        return state

    def _codes_along(self, way: list[float], dac: Converter) -> list[int]:
        """Return the codes of a way, and those it takes until the last one is reached."""
        last, saved = self._last, self.saved
        codes: list[int] = []
        held_back, row = True, 0
        while way and (row < len(way) or held_back):
            aim = way[min(row, len(way) - 1)]
            code, volts, most, saved, held_back = dac.next(aim, last, saved)
            self._require_may_follow(volts, last, most)
            codes.append(code)
            last, row = volts, row + 1
        return codes

    def _check_row_by_row(self, way: list[float]) -> None:
        """Let a way pass the gate before any of it is taken."""
        last = self._last
        for volts in way:
            self._require_may_follow(volts, last, self._most)
            last = volts

    def _require_may_follow(self, volts: float, last: float, most: float) -> None:
        """Let a row pass the gate, or raise GateError: what breaks a limit is a fault of this program."""
        if not may_follow(volts, last, self._low, self._high, most):
            self._gate.last = None if math.isnan(last) else last
            self._gate.admit(np.array([volts]), self._step_seconds)
            raise GateError(
                f"this program planned {volts!r} after {last!r}, which breaks its limits"
            )

    def __getstate__(self) -> dict[str, Any]:
        """Pickle what is committed; the kernel's stepper is made again."""
        return super().__getstate__() | {"_inner": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Go on from what was committed."""
        self.__dict__.update(state)
        if self._stepper is not None and self._gears_alone:
            self._inner = self._stepper.inner


def _figure(name: str, value: Figure) -> Figure:
    """Return a limit as a text, a float or None (InputError where it is none of these)."""
    if value is None or isinstance(value, str):
        return value
    return number(f"`{name}`", value)


def _require_rate(sample_rate: float | None, needed: bool) -> None:
    """Refuse a rate that is missing where the time between samples matters (UsageError)."""
    if needed and sample_rate is None:
        raise UsageError(
            "this model and these limits need the time between samples (`sample_rate` HZ)"
        )


def _require_known(model: ActuatorModel, ahead: bool, looks_ahead: bool) -> None:
    """Refuse a model whose drive depends on what the caller does not pass (UsageError, ModelError)."""
    if ahead and looks_ahead:
        raise UsageError(
            "`ahead` and `lookahead` exclude each other: the latter undoes the delay, too"
        )
    if model.delay_seconds > 0.0 and not ahead and not looks_ahead:
        raise ModelError(
            f"the model has a delay of {model.delay_seconds:g} s, so the drive depends on what is wanted "
            "that much later, which a controller does not know (with `ahead` or `lookahead` the caller "
            "passes it)"
        )
    if model.dynamics is not None and not looks_ahead:
        raise ModelError(
            "the model has dynamics, so the drive depends on what is wanted after the present sample, "
            "which a controller does not know (with `lookahead` the caller passes it)"
        )
