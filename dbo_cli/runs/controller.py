"""Live use: one sample at a time, forward in time only.

A control loop calls ``plan`` with what is wanted, hands the voltage (or the converter's code) to the
hardware, and calls ``commit`` once the hardware has acknowledged it. A plan never committed leaves no trace.
"""

from __future__ import annotations

import bisect
import dataclasses
import math

import numpy as np
from numpy.typing import ArrayLike

from dbo_cli.errors import InputError, ModelError, UsageError
from dbo_cli.hysteresis.cascade import ScaleStage, memory_free, through
from dbo_cli.hysteresis.initial_states import StartName
from dbo_cli.hysteresis.model import NEGLIGIBLE, ActuatorModel
from dbo_cli.hysteresis.model_state import DriveLimits, ModelState
from dbo_cli.hysteresis.operators import OutputLimits
from dbo_cli.hysteresis.stepper import BacklashStepper
from dbo_cli.runs.source import samples


class Controller:
    """The drive of a forward model, sample by sample; made by ``Model.controller``.

    The same bits as ``compensate`` over the same samples.

    Attributes
    ----------
    clipped : int
        Committed samples in which the limits of the drive were met.
    planned : float, int or None
        What was planned and is not committed yet.
    """

    def __init__(
        self,
        model: ActuatorModel,
        sample_rate: float | None,
        *,
        v_min: float | None = None,
        v_max: float | None = None,
        max_slew: float | None = None,
        state: StartName | ModelState = "auto",
        dac: ArrayLike | None = None,
        ahead: bool = False,
    ) -> None:
        model.require("forward")
        if model.delay_seconds > 0.0 and not ahead:
            raise ModelError(
                f"the model has a delay of {model.delay_seconds:g} s, so the drive depends on what is wanted "
                "that much later, which a controller does not know (with `ahead` the caller passes it)"
            )
        if model.dynamics is not None or model.drive_lag is not None:
            raise ModelError(
                "the model has dynamics, so the drive depends on what is wanted after the present sample, "
                "which a controller does not know (compensate the whole trajectory)"
            )
        if sample_rate is not None and not 0.0 < sample_rate < math.inf:
            raise UsageError(f"`sample_rate` {sample_rate:g}: give a positive number of samples a second")
        needs = model.needs_time or max_slew is not None
        if needs and sample_rate is None:
            raise UsageError("this model and these limits need the time between samples (`sample_rate` HZ)")
        drive = model.input
        low = drive.minimum if v_min is None else v_min
        high = drive.maximum if v_max is None else v_max
        self._model = model
        self._step_seconds = None if sample_rate is None else 1.0 / sample_rate
        self._limits = DriveLimits(low, high, max_slew)
        self._inverse = model.inverse()
        self._start = state
        self._dac = None if dac is None else _Converter(dac)
        self._stepper: BacklashStepper | None = None
        self._begun: ModelState | None = None
        self._prepare()
        self._clipped_now = False
        self.clipped = 0
        self.planned: float | int | None = None

    def plan(self, displacement: float) -> float | int:
        """Return the voltage (the code, with a converter) for what is wanted next; nothing changes yet.

        Parameters
        ----------
        displacement : float
            What is wanted at this sample, in the unit of the model's output; with ``ahead`` what is wanted
            the model's delay later.

        Raises
        ------
        InputError
            It is not a finite number.
        """
        if not -math.inf < displacement < math.inf:
            raise InputError(f"what is wanted is not a finite number: {displacement!r}")
        stepper = self._stepper
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
        self.planned = volts if self._dac is None else self._dac.code(volts, self._limits)
        return self.planned

    def commit(self, applied: float | int | None = None) -> None:
        """Go on from what was planned, or from what was ``applied`` instead (volts, or a code).

        Raises
        ------
        UsageError
            Nothing was planned, and nothing applied is given.
        """
        if applied is None and self.planned is None:
            raise UsageError("nothing was planned to be committed: call plan first")
        if applied is None and self._dac is None:
            if self._stepper is None:
                assert self._begun is not None
                self._begin(self._begun)
            else:
                self._stepper.commit()
        else:
            value = self.planned if applied is None else applied
            assert value is not None
            self._apply(self._dac.volts(int(value)) if self._dac is not None else float(value))
        self.clipped += self._clipped_now
        self._clipped_now = False
        self.planned = None

    def step(self, displacement: float) -> float | int:
        """Plan and commit at once, where the hardware takes what it is given."""
        volts = self.plan(displacement)
        self.commit()
        return volts

    @property
    def state(self) -> ModelState | None:
        """The committed state, for ``simulate`` or ``compensate`` to go on from; None before the first."""
        if self._stepper is None:
            return self._start if isinstance(self._start, ModelState) else None
        return ModelState(self._stepper.state, self._stepper.last)

    def _prepare(self) -> None:
        """Sort the stages around the gears: scales before them alone are worked out without an array."""
        inverse, place = self._inverse, self._inverse.stages.index(self._inverse.backlash)
        head, self._after = memory_free(inverse.stages[:place]), memory_free(inverse.stages[place:])
        self._head = head
        self._scales = [(s.gain, s.offset) for s in head if isinstance(s, ScaleStage)]
        self._bent_before = len(self._scales) < len(head)

    def _before(self, displacement: float) -> float:
        return float(through(self._head, np.array([displacement]))[0])

    def _bent(self, volts: float) -> float:
        bent = float(through(self._after, np.array([volts]))[0])
        return min(max(bent, self._limits.v_min), self._limits.v_max)

    def _plan_first(self, displacement: float) -> float:
        """Find the start as ``compensate`` does; the fast way begins after the first sample."""
        begin = self._model.start_compensation(displacement, self._start, self._limits)
        done = self._model.compensate(
            [displacement], begin, limits=self._limits, time_step=self._step_seconds
        )
        self._begun = done.state
        self._clipped_now = bool(done.clipped_count)
        return float(done.y[0])

    def _begin(self, state: ModelState) -> None:
        inner = self._inverse._inner_limits(self._limits)
        assert inner is not None
        step = None
        if inner.max_slew is not None and self._step_seconds is not None:
            step = inner.max_slew * self._step_seconds
        bound = OutputLimits(inner.v_min, inner.v_max, step, NEGLIGIBLE * (inner.v_max - inner.v_min))
        last = math.nan if state.drive is None else state.drive
        self._stepper = BacklashStepper(
            self._inverse.backlash, state.backlash, last, self._step_seconds, bound
        )
        self._state_behind = dataclasses.replace(state, history=None, first=None)

    def _apply(self, volts: float) -> None:
        """Drive the forward model's gears by what was applied; the inverse goes on from their state."""
        if not -math.inf < volts < math.inf:
            raise InputError(f"what was applied is not a finite number: {volts!r}")
        before = self.state or self._model.start(volts, "auto")
        if self._stepper is None and self._begun is not None:
            before = self._model.start(volts, self._start)
        done = self._model.simulate(
            [volts], dataclasses.replace(before, history=None), time_step=self._step_seconds
        )
        if self._stepper is None:
            self._begin(done.state)
        else:
            assert done.state.drive is not None
            self._stepper.set(done.state.backlash, done.state.drive)


class _Converter:
    """A digital-to-analogue converter: the voltage of every code."""

    def __init__(self, volts: ArrayLike) -> None:
        curve = samples("dac", volts)
        if curve.size < 2 or not (np.diff(curve) > 0.0).all():
            raise UsageError("`dac`: give the voltage of every code from 0 on, rising from code to code")
        self._volts: list[float] = curve.tolist()

    def volts(self, code: int) -> float:
        if not 0 <= code < len(self._volts):
            raise InputError(f"code {code} is not one of the converter's, 0 to {len(self._volts) - 1}")
        return self._volts[code]

    def code(self, volts: float, limits: DriveLimits) -> int:
        """Return the code whose voltage is nearest, among those within the limits where there are any."""
        after = bisect.bisect_left(self._volts, volts)
        near = [k for k in (after - 1, after) if 0 <= k < len(self._volts)]
        allowed = [k for k in near if limits.v_min <= self._volts[k] <= limits.v_max]
        return min(allowed or near, key=lambda k: abs(self._volts[k] - volts))
