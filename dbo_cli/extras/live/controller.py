"""Live use: one sample at a time, forward in time only.

A control loop calls ``plan`` with what is wanted, hands the voltage (or the converter's code) to the
hardware, and calls ``commit`` once the hardware has acknowledged it. A plan never committed leaves no trace.
Beyond the gears, what is wanted later undoes delay and dynamics (``LookAhead``), and a lag before the gears
is undone sample by sample (``DriveLag``); all with the bits of ``compensate``.
"""

from __future__ import annotations

import bisect
import dataclasses
import itertools
import math
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from dbo_cli.drives.gate import DriveGate, GateError
from dbo_cli.drives.limits import voltage_in
from dbo_cli.drives.options import DriveOptions, Figure, check_seconds
from dbo_cli.drives.pieces import ramp
from dbo_cli.errors import InputError, ModelError, UsageError
from dbo_cli.hysteresis.cascade import WHOLE, MemoryFree, ScaleStage, through
from dbo_cli.hysteresis.drive_lag import coefficients, undoing_rows
from dbo_cli.hysteresis.dynamics import InverseMemory
from dbo_cli.hysteresis.kernel import Floats
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_state import DriveLimits, ModelState, StartName
from dbo_cli.hysteresis.stepper import ROUNDING, BacklashStepper
from dbo_cli.logs.request import checked_rate
from dbo_cli.logs.sources import samples

Window = tuple[list[float], Floats, InverseMemory | None]


class Converter:
    """A digital-to-analogue converter within the limits of a drive.

    One step between codes may be larger than the slew limit allows in a sample. Then the allowance of several
    samples is saved up for it: over any time the drive changes by no more than the slew limit allows in that
    time and one code, and in one sample by no more than the larger of the two.

    Parameters
    ----------
    volts : array_like
        The voltage of every code from 0 on, rising.
    limits : DriveLimits
        Of the drive; codes outside the range are never planned.
    most : float, optional
        Largest change in one sample, V.

    Raises
    ------
    UsageError
        The curve does not rise, or no code lies within the limits.
    """

    def __init__(self, volts: ArrayLike, limits: DriveLimits, most: float | None) -> None:
        curve = samples("dac", volts)
        if curve.size < 2 or not (np.diff(curve) > 0.0).all():
            raise UsageError("`dac`: give the voltage of every code from 0 on, rising from code to code")
        self.curve: list[float] = curve.tolist()
        self._low = bisect.bisect_left(self.curve, limits.v_min)
        self._high = bisect.bisect_right(self.curve, limits.v_max) - 1
        if self._low > self._high:
            raise UsageError(
                f"`dac`: no code lies within the limits of the drive, {limits.v_min:g} to {limits.v_max:g}"
            )
        self.step, self.saved = most, 0.0
        gaps: list[float] = [b - a for a, b in itertools.pairwise(self.curve)]
        self._widest = max(gaps)
        self._gaps: list[float] = [max(pair) for pair in itertools.pairwise([gaps[0], *gaps, gaps[-1]])]

    def volts(self, code: int | float) -> float:
        """Return the voltage of a code (InputError where there is none)."""
        if code != int(code) or not 0 <= code < len(self.curve):
            raise InputError(f"code {code} is not one of the converter's, 0 to {len(self.curve) - 1}")
        return self.curve[int(code)]

    def most(self, last: float | None) -> float | None:
        """Return the largest change that is allowed now, V; None where any is."""
        step = self.step
        if step is None or last is None:
            return None
        if step < self._widest:
            gap = self._gaps[min(bisect.bisect_left(self.curve, last), len(self._gaps) - 1)]
            return min(self.saved + step, max(step, gap))
        return step

    def code(self, volts: float, last: float | None, most: float | None) -> int:
        """Return the code nearest to a voltage, of those within range and slew; the last one, if none is."""
        curve, low, high = self.curve, self._low, self._high
        after = bisect.bisect_left(curve, volts)
        near = after - (0 < after < len(curve) and curve[after] - volts >= volts - curve[after - 1])
        near = low if near < low else high if near > high else near
        if most is None or last is None or -most <= curve[near] - last <= most:
            return near
        low = max(low, bisect.bisect_left(curve, last - most))
        high = min(high, bisect.bisect_right(curve, last + most) - 1)
        if low > high:  # from outside the range, or between two codes
            return min(max(bisect.bisect_left(curve, last), self._low), self._high)
        return low if near < low else high

    def commit(self, change: float, most: float | None) -> None:
        """Take what a change used off what was saved up."""
        if most is not None:
            self.saved = max(most - change, 0.0)


class LookAhead:
    """What the gears are to follow now, from what is wanted ``samples`` later.

    Before the first value the same value holds: the output is that of a trajectory with ``samples`` rows at
    its first value before it (``lead`` of ``compensate``).

    Parameters
    ----------
    model : ActuatorModel
        A forward model.
    rate : float
        Samples a second (Hz).
    seconds : float or "auto"
        How much later what is passed is wanted; auto: the shortest time that the model needs.

    Attributes
    ----------
    samples : int
        That time in samples, rounded up.
    held : tuple, or None
        What is wanted from the sample committed last on, the same with the delay undone, and what the inverse
        of the dynamics remembers; None before the first.

    Raises
    ------
    InputError
        The rate does not resolve the dynamics.
    UsageError
        The model needs more.
    """

    def __init__(self, model: ActuatorModel, rate: float, seconds: float | Literal["auto"]) -> None:
        check_seconds("lookahead", seconds)
        self._rate, self._step, self._delay = rate, 1.0 / rate, model.delay_seconds
        self._inverter = None if model.dynamics is None else model.dynamics.inverter(self._step)
        self._late = math.ceil(self._delay / self._step - WHOLE)
        self._ahead = 0 if self._inverter is None else self._inverter.ahead
        needed = self._late + self._ahead
        self.samples = needed if seconds == "auto" else math.ceil(seconds / self._step - WHOLE)
        if self.samples < needed:
            raise UsageError(
                f"`lookahead` {seconds:g} s is {self.samples} samples, and the inverse of this model reads "
                f"{needed} ahead (`lookahead` {needed / rate:.6g} or auto)"
            )
        self._count = 0  # values committed
        self.held: Window | None = None
        self._planned: Window | None = None

    def plan(self, wanted: float, state: ModelState | None) -> float:
        """Return what the gears are to follow now; ``state`` is that before the first value."""
        memory: InverseMemory | None = None
        if self.held is None:
            raw, shifted = (
                [float(wanted)] * (self.samples - self._ahead + 1),
                np.full(self._ahead + 1, wanted),
            )
            if self._inverter is not None:
                memory = (state and state.memory_for(self._inverter)) or self._inverter.rest(wanted)
        else:
            raw, shifted, memory = self.held
            raw = [*raw[1:], float(wanted)]
            shifted = np.append(shifted[1:], self._shifted(raw))
        u = float(shifted[0])
        if self._inverter is not None and memory is not None:
            undone, memory = self._inverter.run(shifted, memory)
            u = float(undone[0])
        self._planned = raw, shifted, memory
        return u

    def commit(self) -> None:
        """Go on to the next sample; without a plan what is wanted stays as it is."""
        if self._planned is None and self.held is not None:
            self.plan(self.held[0][-1], None)
        if self._planned is not None:
            self.held, self._planned, self._count = self._planned, None, self._count + 1

    def forget(self) -> None:
        """Begin anew with the next value."""
        self.held, self._planned, self._count = None, None, 0

    def _shifted(self, raw: list[float]) -> float:
        """Return what is wanted the delay after the oldest value; as ``cascade.interpolated`` does."""
        if not self._late:
            return raw[0]
        row = self._count + self._ahead
        newer, older = self._stamp(row + self._late), self._stamp(row + self._late - 1)
        later, earlier = raw[self._late], raw[self._late - 1]
        part = (newer - (self._stamp(row) + self._delay)) / (newer - older)
        if part < WHOLE:
            return later
        return earlier if part > 1.0 - WHOLE else later + part * (earlier - later)

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
        self._model, self._lag, self._limits, self._step = model, model.drive_lag, limits, step
        self._most = math.inf if limits.max_slew is None else limits.largest_change(step) or math.inf
        row = undoing_rows(coefficients(self._lag, step))[0]
        self._by_lead, self._by_change = float(row[1]), float(row[2])
        self.held = self._planned = (0.0, 0.0)  # what the lag passes on, and the drive before it
        self._instead: ModelState | None = None

    def plan(self, behind: float, wanted: float, stepper: BacklashStepper) -> tuple[float, bool]:
        """Return the drive that the lag makes ``behind`` of, or the nearest allowed, and if it is clipped.

        What the limits of the drive allow behind the lag changes from sample to sample; only a sample that
        they hold back is worked out by the whole model from what is ``wanted``.
        """
        late, last = self.held
        volts = last + (self._by_lead * (late - last) + self._by_change * (behind - late))
        self._planned, self._instead = (behind, volts), None
        if self._limits.v_min <= volts <= self._limits.v_max and abs(volts - last) <= self._most:
            return volts, bool(stepper.clipped)
        before = ModelState(stepper.state, stepper.last, drive_lag=((late, 0.0, last),))
        done = self._model.inverted.simulate([wanted], before, time_step=self._step, limits=self._limits)
        self._instead = done.state
        self._take(done.state)
        return float(done.y[0]), bool(done.clipped_count)

    def commit(self, stepper: BacklashStepper) -> None:
        """Go on to the state, the gears' too, that the last plan leads to."""
        self.held = self._planned
        if self._instead is None:
            stepper.commit()
        else:
            assert self._instead.drive is not None
            stepper.set(self._instead.backlash, self._instead.drive)

    def apply(self, volts: float) -> float:
        """Go on with this voltage, whatever was planned; return what the lag passes on of it."""
        late, last = self.held
        behind = float(self._lag.run(np.array([volts]), self._step, ((late, 0.0, last),))[0][0])
        self.held = behind, volts
        return behind

    def begin(self, state: ModelState) -> None:
        """Take a state over."""
        self._take(state)
        self.held = self._planned

    def _take(self, state: ModelState) -> None:
        assert state.drive_lag is not None
        late, _, last = state.drive_lag[0]
        self._planned = late, last


UPDATE = 128
"""Samples after which dynamics follow the drive: so many take hardly longer than one of them alone."""


class Controller:
    """The drive of a forward model, sample by sample; made by ``Model.controller``.

    The same bits as ``compensate`` over the same samples.

    Attributes
    ----------
    clipped : int
        Committed samples in which the limits of the drive were met.
    planned : float, int or None
        What was planned and is not committed yet.
    lookahead : int
        How many samples later is wanted what is passed; 0 without ``lookahead``.
    converter : Converter, or None
        What ``dac`` describes.
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
        _require_rate(sample_rate, model.needs_time or max_slew is not None or lookahead is not None)
        self._model = model
        self._step_seconds = None if sample_rate is None else 1.0 / sample_rate
        self._limits = DriveOptions(v_min, v_max, extrapolate, max_slew, from_=from_).limits(model)
        self._most = self._limits.largest_change(self._step_seconds)
        # A converter's code keeps the slew limit itself, since it may have to save up for it.
        self._planning = self._limits if dac is None else DriveLimits(self._limits.v_min, self._limits.v_max)
        self._inverse = model.inverse()
        self._gears = self._inverse.backlash  # a model that has none is refused here
        self._start: StartName | ModelState = state
        self._last = None if from_ is None else voltage_in("from_", from_, model.input)
        if isinstance(state, ModelState):
            self._last = model.drive_of(state)
        elif self._last is not None:
            begun = model.start(self._last, state)
            self._start = model.simulate([self._last], begun, time_step=self._step_seconds).state
        self._gate = DriveGate(self._limits, self._last, model.input.suffix)
        self.converter = None if dac is None else Converter(dac, self._limits, self._most)
        self._ahead: LookAhead | None = None
        if lookahead is not None and sample_rate is not None:
            self._ahead = LookAhead(model, sample_rate, lookahead)
        self._lag: DriveLag | None = None
        if model.drive_lag is not None and self._step_seconds is not None:
            self._lag = DriveLag(model, self._planning, self._step_seconds)
        self.lookahead = 0 if self._ahead is None else self._ahead.samples
        # What is behind the gears takes no part in the drive: it follows now and then, for the state alone.
        self._behind = model.dynamics is not None or (model.delay_seconds > 0.0 and not ahead)
        self._past: ModelState | None = None
        self._since: list[float] = []
        self._stepper: BacklashStepper | None = None
        self._begun: ModelState | None = None
        # Scales before the gears, where nothing else stands there, are worked out without an array.
        self._head, self._after, self._drive_side = (
            self._inverse.head, self._inverse.tail, self._inverse.tail_inverse
        )  # fmt: skip
        self._scales = [(s.gain, s.offset) for s in self._head if isinstance(s, ScaleStage)]
        self._bent_before = len(self._scales) < len(self._head)
        self._clipped_now = False
        self._planned_volts = math.nan
        self.clipped = 0
        self.planned: float | int | None = None

    def plan(self, displacement: float) -> float | int:
        """Return the voltage (the code, with a converter) for what is wanted next; nothing changes yet.

        Parameters
        ----------
        displacement : float
            What is wanted at this sample, in the unit of the model's output; with ``ahead`` what is wanted
            the model's delay later, with ``lookahead`` so much later.

        Raises
        ------
        InputError
            It is not a finite number.
        LimitError
            The drive cannot begin within its limits.
        """
        if not -math.inf < displacement < math.inf:
            raise InputError(f"what is wanted is not a finite number: {displacement!r}")
        stepper = self._stepper
        if self._ahead is not None:
            displacement = self._ahead.plan(displacement, None if self._ahead.held else self.state)
        if stepper is None:
            # The start is found as ``compensate`` does; the fast way begins after the first sample.
            self._gate.require_start(self._step_seconds)
            begin = self._model.start_compensation(displacement, self._start, self._planning)
            done = self._model.compensate(
                [displacement], begin, limits=self._planning, time_step=self._step_seconds
            )
            self._begun, volts = done.state, float(done.y[0])
            self._clipped_now = bool(done.clipped_count)
        else:
            x = displacement
            for gain, offset in self._scales:
                x = gain * x + offset
            if self._bent_before:
                x = float(through(self._head, np.array([displacement]))[0])
            volts = stepper.plan(x)
            self._clipped_now = bool(stepper.clipped)
            if self._after:
                bent = float(through(self._after, np.array([volts]))[0])
                volts = min(max(bent, self._limits.v_min), self._limits.v_max)
            if self._lag is not None:
                volts, self._clipped_now = self._lag.plan(volts, displacement, stepper)
        self.planned = volts
        if self.converter is not None:
            self.planned, volts = self._coded(volts, self.converter)
        self._pass(volts)
        self._planned_volts = volts
        return self.planned

    def commit(self, applied: float | int | None = None) -> None:
        """Go on from what was planned, or from what was applied instead.

        Parameters
        ----------
        applied : float or int, optional
            Volts, or with a converter a code, where that is not what was planned.

        Raises
        ------
        UsageError
            Nothing was planned, and nothing applied is given.
        """
        if applied is None and self.planned is None:
            raise UsageError("nothing was planned to be committed: call plan first")
        volts, first = self._planned_volts, self._stepper is None
        if applied is None and self.converter is None:
            if self._stepper is None:
                assert self._begun is not None
                self._begin(self._begun)
            elif self._lag is not None:
                self._lag.commit(self._stepper)
            else:
                self._stepper.commit()
        else:
            if applied is not None:
                volts = self.converter.volts(applied) if self.converter is not None else float(applied)
            self._apply(volts)
        if self._ahead is not None:
            self._ahead.commit()
        if self._behind and not first:
            self._since.append(volts)
            if len(self._since) >= UPDATE:
                self._update()
        if self.converter is not None and self._last is not None:
            self.converter.commit(abs(volts - self._last), self._most)
        self._last = volts
        self.clipped += self._clipped_now
        self._clipped_now = False
        self.planned = None

    def step(self, displacement: float) -> float | int:
        """Plan and commit at once, where the hardware takes what it is given.

        Parameters
        ----------
        displacement : float
            As in ``plan``.
        """
        volts = self.plan(displacement)
        self.commit()
        return volts

    def close(
        self, to: float | None = None, seconds: float | Literal["auto"] = "auto"
    ) -> list[float] | list[int]:
        """Return the ramp to rest, to be handed to the hardware as it is; the state goes with it.

        Parameters
        ----------
        to : float, optional
            Where to rest, V; 0 or the limit nearest to it, where not given.
        seconds : float or "auto"
            How long the ramp takes; auto: as fast as the slew allows, without one a second.

        Raises
        ------
        UsageError
            Nothing was committed yet, or no sample rate is known.
        """
        if self._last is None or self._step_seconds is None:
            raise UsageError("a ramp to rest needs a committed sample and a `sample_rate`")
        rest = min(max(0.0 if to is None else to, self._limits.v_min), self._limits.v_max)
        way: list[Any] = []
        for volts in ramp("seconds", self._last, rest, self._step_seconds, seconds, self._limits).tolist():
            code, played = (volts, volts) if self.converter is None else self._coded(volts, self.converter)
            self._pass(played)
            way.append(code)
            self.commit(code)
        if self._ahead is not None:
            self._ahead.forget()
        return way

    def _coded(self, volts: float, dac: Converter) -> tuple[int, float]:
        """Return the converter's code for a voltage, and the voltage that it means."""
        self._most = dac.most(self._last)
        code = dac.code(volts, self._last, self._most)
        return code, dac.curve[code]

    @property
    def state(self) -> ModelState | None:
        """The committed state, for ``simulate`` or ``compensate`` to go on from; None before the first."""
        if self._stepper is None:
            return self._start if isinstance(self._start, ModelState) else None
        held = None if self._ahead is None else self._ahead.held
        return dataclasses.replace(self._update(), undoing=held and held[2], model=self._model.digest)

    def _update(self) -> ModelState:
        """Return the committed state; let what is behind the gears follow the drive up to now."""
        assert self._stepper is not None
        held = ModelState(self._stepper.state, self._stepper.last)
        if self._lag is not None:
            late, last = self._lag.held
            held = dataclasses.replace(held, drive_lag=((late, 0.0, last),))
        past = self._past
        if past is not None:
            if self._since:
                past = self._model.simulate(self._since, past, time_step=self._step_seconds).state
            held = dataclasses.replace(held, dynamics=past.dynamics, history=past.history)
            self._past, self._since = held, []
        return held

    @property
    def begun(self) -> tuple[BacklashStepper, MemoryFree, MemoryFree] | None:
        """The gears' stepper and what stands beside it, for a bank; None before a commit, or with a lag."""
        alone = self._stepper is not None and self._ahead is None and self._lag is None
        return None if self._stepper is None or not alone else (self._stepper, self._head, self._after)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Range, largest change and the voltage that stands (NaN: none), for a bank."""
        most, last = (math.nan if one is None else one for one in (self._most, self._last))
        return self._limits.v_min, self._limits.v_max, most, last

    def _pass(self, volts: float) -> None:
        """Let one sample pass the gate; that of ``DriveGate`` for blocks, worked out here for speed."""
        low, high, last, most = self._limits.v_min, self._limits.v_max, self._last, self._most
        inside = low <= volts <= high
        if last is not None and not inside and not low <= last <= high:
            inside = last <= volts <= low if last < low else high <= volts <= last
        if most is not None and last is not None:
            inside = inside and abs(volts - last) <= most + ROUNDING * max(abs(last), abs(volts))
        if not inside:
            self._gate.last = last
            self._gate.admit(np.array([volts]), self._step_seconds)
            raise GateError(f"this program planned {volts!r} after {last!r}, which breaks its limits")

    def _begin(self, state: ModelState) -> None:
        self._past, self._since = state if self._behind else None, []
        inverse, limits = self._inverse, self._planning
        if self._lag is not None:  # the slew is limited before the lag
            self._lag.begin(state)
            limits = DriveLimits(limits.v_min, limits.v_max)
        bound = inverse.output_limits(inverse.inner_limits(limits), self._step_seconds)
        last = math.nan if state.drive is None else state.drive
        self._stepper = BacklashStepper(self._gears, state.backlash, last, self._step_seconds, bound)

    def _apply(self, volts: float) -> None:
        """Drive the forward model's gears by what was applied; the inverse goes on from their state."""
        if not -math.inf < volts < math.inf:
            raise InputError(f"what was applied is not a finite number: {volts!r}")
        if self._stepper is None:
            begun = self._model.start(volts, self._start)
            begun = dataclasses.replace(begun, history=None)
            self._begin(self._model.simulate([volts], begun, time_step=self._step_seconds).state)
            return
        inner = volts if self._lag is None else self._lag.apply(volts)
        for stage in self._drive_side:
            inner = float(stage.run(np.array([inner]))[0])
        self._stepper.apply(inner)


def _require_rate(sample_rate: float | None, needed: bool) -> None:
    """Refuse a rate that is missing where the time between samples matters (UsageError)."""
    if needed and sample_rate is None:
        raise UsageError("this model and these limits need the time between samples (`sample_rate` HZ)")


def _require_known(model: ActuatorModel, ahead: bool, looks_ahead: bool) -> None:
    """Refuse a model whose drive depends on what the caller does not pass (UsageError, ModelError)."""
    if ahead and looks_ahead:
        raise UsageError("`ahead` and `lookahead` exclude each other: the latter undoes the delay, too")
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
