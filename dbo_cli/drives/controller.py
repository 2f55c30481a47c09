"""Live use: one sample at a time, forward in time only.

A control loop calls ``plan`` with what is wanted, hands the voltage (or the converter's code) to the
hardware, and calls ``commit`` once the hardware has acknowledged it. A plan never committed leaves no trace.
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
from dbo_cli.drives.lookahead import DriveLag, LookAhead
from dbo_cli.drives.options import DriveOptions, Figure
from dbo_cli.drives.pieces import ramp
from dbo_cli.errors import InputError, ModelError, UsageError
from dbo_cli.hysteresis.cascade import MemoryFree, ScaleStage, memory_free, through
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_state import DriveLimits, ModelState, StartName
from dbo_cli.hysteresis.stepper import ROUNDING, BacklashStepper
from dbo_cli.logs.request import checked_rate
from dbo_cli.logs.sources import samples
from dbo_cli.logs.units import in_unit


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
        state: StartName | ModelState = "auto",
        from_: Figure = None,
        dac: ArrayLike | None = None,
        ahead: bool = False,
        lookahead: float | Literal["auto"] | None = None,
    ) -> None:
        model.require("forward")
        _require_known(model, ahead, lookahead is not None)
        sample_rate = checked_rate(sample_rate)
        needs = model.needs_time or max_slew is not None or lookahead is not None
        if needs and sample_rate is None:
            raise UsageError("this model and these limits need the time between samples (`sample_rate` HZ)")
        self._model = model
        self._step_seconds = None if sample_rate is None else 1.0 / sample_rate
        self._limits = DriveOptions(v_min=v_min, v_max=v_max, max_slew=max_slew, from_=from_).limits(model)
        self._most = self._limits.largest_change(self._step_seconds)
        # A converter's code keeps the slew limit itself, since it may have to save up for it.
        self._planning = self._limits if dac is None else DriveLimits(self._limits.v_min, self._limits.v_max)
        self._inverse = model.inverse()
        self._start: StartName | ModelState = state
        self._last = None if from_ is None else in_unit("from_", from_, model.input.unit)
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
        self._prepare()
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
            displacement = self._ahead.plan(displacement, None if self._ahead.begun else self.state)
        if stepper is None:
            volts = self._plan_first(displacement)
        else:
            x = displacement
            for gain, offset in self._scales:
                x = gain * x + offset
            if self._bent_before:
                x = self._before(displacement)
            volts = stepper.plan(x)
            self._clipped_now = bool(stepper.clipped)
            if self._after:
                volts = self._bent(volts)
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
        undoing = None if self._ahead is None else self._ahead.memory
        return dataclasses.replace(self._update(), undoing=undoing, model=self._model.digest)

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

    def _prepare(self) -> None:
        """Sort the stages around the gears: scales before them alone are worked out without an array."""
        inverse, place = self._inverse, self._inverse.stages.index(self._inverse.backlash)
        head, self._after = memory_free(inverse.stages[:place]), memory_free(inverse.stages[place:])
        self._head = head
        self._scales = [(s.gain, s.offset) for s in head if isinstance(s, ScaleStage)]
        self._bent_before = len(self._scales) < len(head)
        self._drive_side = [stage.inverse() for stage in reversed(self._after)]

    def _before(self, displacement: float) -> float:
        return float(through(self._head, np.array([displacement]))[0])

    def _bent(self, volts: float) -> float:
        bent = float(through(self._after, np.array([volts]))[0])
        return min(max(bent, self._limits.v_min), self._limits.v_max)

    def _plan_first(self, displacement: float) -> float:
        """Find the start as ``compensate`` does; the fast way begins after the first sample."""
        self._gate.require_start(self._step_seconds)
        begin = self._model.start_compensation(displacement, self._start, self._planning)
        done = self._model.compensate(
            [displacement], begin, limits=self._planning, time_step=self._step_seconds
        )
        self._begun = done.state
        self._clipped_now = bool(done.clipped_count)
        return float(done.y[0])

    def _begin(self, state: ModelState) -> None:
        self._past, self._since = state if self._behind else None, []
        inverse, limits = self._inverse, self._planning
        if self._lag is not None:  # the slew is limited before the lag
            self._lag.begin(state)
            limits = DriveLimits(limits.v_min, limits.v_max)
        bound = inverse.output_limits(inverse.inner_limits(limits), self._step_seconds)
        last = math.nan if state.drive is None else state.drive
        self._stepper = BacklashStepper(inverse.backlash, state.backlash, last, self._step_seconds, bound)

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
