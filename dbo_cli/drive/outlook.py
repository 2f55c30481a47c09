"""What to expect of a drive, and what to warn of."""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbo_cli.drive.drive import Extent
from dbo_cli.drive.limits import Limits
from dbo_cli.drive.loss import Loss, Steps
from dbo_cli.errors import warn
from dbo_cli.model import Model, State

Floats = NDArray[np.float64]

EXPECTED_ROWS = 131_072  # first rows of a move, on which the error to expect is played
LONG_HOLD = 100.0  # times the longest time constant: what creeps has come to rest


class Expected(NamedTuple):
    """The error to expect (RMS, in the displacement's unit): as the past is known, and with a known past."""

    error: float | None = None
    known: float | None = None


class Outlook:
    """Sees the rows of a drive go by, and says in the end what to expect of them.

    Attributes
    ----------
    missed : float
        How far the first row starts off its displacement, because no settled actuator
        stands there.
    """

    def __init__(self, model: Model, limits: Limits, name: str) -> None:
        self.model, self.limits, self.name = model, limits, name
        self.missed = 0.0
        self._voltage: list[Floats] = []
        self._steps: list[Floats] = []
        self._rows = 0
        self._before = 0

    def see(self, voltage: Floats, dt: Steps, part: str) -> None:
        """See consecutive rows; those before the move are kept, and the first ones of the move."""
        if part == "move":
            voltage = voltage[: EXPECTED_ROWS - self._rows]
            self._rows += voltage.size
        if part == "return" or not voltage.size:
            return
        self._voltage.append(voltage)
        if dt is not None:
            steps = dt[: voltage.size] if isinstance(dt, np.ndarray) else dt
            self._steps.append(np.broadcast_to(steps, voltage.shape))
        if part == "lead":
            self._before += voltage.size

    def _first_rows(self) -> tuple[Floats, Steps]:
        """Return the first rows and their time steps."""
        voltage = np.concatenate(self._voltage)
        if not self._steps:
            return voltage, None
        steps = np.concatenate(self._steps)
        if (steps == steps[0]).all():
            return voltage, float(steps[0])
        return voltage, steps

    def expected(self, past_known: bool, lost: float) -> Expected:
        """Return the error to expect of the move, ``lost`` (RMS) by clipping included."""
        from dbo_cli.model.expect import expected_error

        if not self._voltage:
            return Expected()
        voltage, dt = self._first_rows()
        begin = min(self._before, voltage.size - 1)
        errors: list[float | None] = []
        for known in (past_known, True):
            error = expected_error(self.model, voltage, dt, past_known=known, begin=begin)
            errors.append(None if error is None else math.hypot(error, lost))
        if past_known:
            return Expected(errors[0], None)
        return Expected(*errors)

    def warn(
        self, loss: Loss, state: State | None, whole: Extent, expected: Expected
    ) -> list[str]:
        """Warn of what is unusual; return the warnings."""
        from dbo_cli.model.expect import move_warnings

        texts: list[str] = []
        unit = self.model.output.suffix
        if loss.clipped:
            texts.append(
                f"{loss.clipping()}: clipped, by which the move misses {loss.rms:.3g}{unit} RMS, "
                f"{loss.most:.3g}{unit} at most"
            )
        if self.missed:
            texts.append(
                f"{self.name}: the displacement starts {abs(self.missed):.3g}{unit} off its first value, where "
                "an actuator that has settled does not stand (`condition`, or `state` empty)"
            )
        texts += self._beyond(whole)
        if self._voltage:
            for text in move_warnings(self.model, *self._first_rows()):
                texts.append(f"{self.name}: {text}")
        line = self.model.fit.get("line_rmse")
        if expected.error is not None and isinstance(line, float):
            if expected.error >= max(line, loss.rms):
                texts.append(
                    f"{self.name}: the expected error, {expected.error:.3g}{unit}, is no better than that of a "
                    f"straight line, {line:.3g}{unit}: the logs do not show what this move does"
                )
        texts += self._creeping_hold(state)
        for text in texts:
            warn(text)
        return texts

    def _beyond(self, whole: Extent) -> list[str]:
        """Say that the drive leaves the identified range, where that was asked for."""
        low, high = self.limits.identified
        if not self.limits.extrapolate or (low <= whole.least and whole.greatest <= high):
            return []
        volt = self.limits.suffix
        return [
            f"{self.name}: the drive goes from {whole.least:.6g} to {whole.greatest:.6g}{volt}, beyond the "
            f"{low:.6g} to {high:.6g}{volt} on which the model was identified"
        ]

    def _creeping_hold(self, state: State | None) -> list[str]:
        """Say where holding the last position drives the voltage out of the limits, in the long run."""
        relaxation = self.model.gears.relaxation
        if relaxation is None or state is None or state.drive is None:
            return []
        if not any(gain < 0.0 for gain in relaxation.gain):
            return []
        still = dataclasses.replace(state, sections=None, delay=None, undoing=None, first=None)
        at = self.model.static.run(np.array([state.drive]), still, 0.0).y
        seconds = LONG_HOLD * max(relaxation.tau)
        held = float(self.model.static.drive(at, still, seconds).voltage[0])
        low, high = self.limits.move
        if low <= held <= high:
            return []
        volt = self.limits.suffix
        return [
            f"{self.name}: holding the last position takes the drive to {held:.6g}{volt} in the long run, "
            f"outside {low:.6g} to {high:.6g}{volt}"
        ]
