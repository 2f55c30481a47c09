"""Live control beyond the gears: what is wanted later undoes delay and dynamics, and a lag before the gears.

One sample at a time, with the bits of ``compensate``. A plan changes nothing until it is committed.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from dbo_cli.drives.options import check_seconds
from dbo_cli.errors import UsageError
from dbo_cli.hysteresis.cascade import WHOLE
from dbo_cli.hysteresis.drive_lag import coefficients, undoing_rows
from dbo_cli.hysteresis.dynamics import InverseMemory
from dbo_cli.hysteresis.excitation import Floats
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_state import DriveLimits, ModelState
from dbo_cli.hysteresis.stepper import BacklashStepper

Window = tuple[list[float], Floats, InverseMemory | None]


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
        self._held: Window | None = None
        self._planned: Window | None = None

    def plan(self, wanted: float, state: ModelState | None) -> float:
        """Return what the gears are to follow now; ``state`` is that before the first value."""
        if self._held is None:
            raw, shifted = (
                [float(wanted)] * (self.samples - self._ahead + 1),
                np.full(self._ahead + 1, wanted),
            )
            memory = self._memory_of(wanted, state)
        else:
            raw, shifted, memory = self._held
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
        if self._planned is None and self._held is not None:
            self.plan(self._held[0][-1], None)
        if self._planned is not None:
            self._held, self._planned, self._count = self._planned, None, self._count + 1

    def forget(self) -> None:
        """Begin anew with the next value."""
        self._held, self._planned, self._count = None, None, 0

    @property
    def begun(self) -> bool:
        """Whether a value was committed."""
        return self._held is not None

    @property
    def memory(self) -> InverseMemory | None:
        """What the inverse of the dynamics remembers after the sample committed last."""
        return None if self._held is None else self._held[2]

    def _memory_of(self, wanted: float, state: ModelState | None) -> InverseMemory | None:
        if self._inverter is None:
            return None
        if state is not None and state.undoing is not None and state.undoing.time_step == self._step:
            return state.undoing
        if state is not None and state.dynamics is not None:
            return self._inverter.memory_of(state.dynamics)
        return self._inverter.rest(wanted)

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
