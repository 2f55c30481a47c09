"""The figures of a drive, the error to expect of it, and what to warn of."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dbo_cli.drive.drive import Drive, Extent
from dbo_cli.drive.loss import Loss, Steps
from dbo_cli.errors import warn
from dbo_cli.model import State

Floats = NDArray[np.float64]

EXPECTED_ROWS = 131_072  # first rows of a move, on which the error to expect is played
OFF_AT_FIRST = 1e-3  # of the range: so far off its first value may a drive begin unsaid
LONG_HOLD = 100.0  # times the longest time constant: what creeps has come to rest


class Outlook:
    """Sees the rows of a drive go by, and says in the end what to expect of them.

    Attributes
    ----------
    loss : Loss
        What the limits cut off the move.
    missed : float
        How far the first row starts off its displacement, because no settled actuator
        stands there.
    off : float
        By how much the first row of the static part is off what is desired there.
    """

    def __init__(self, loss: Loss) -> None:
        self.model, self.limits, self.name = loss.model, loss.limits, loss.name
        self.loss = loss
        self.missed = self.off = 0.0
        self._whole, self._lead = Extent(), Extent()
        self._voltage: list[Floats] = []
        self._steps: list[Floats] = []
        self._rows = 0

    def see(self, voltage: Floats, dt: Steps, part: str) -> None:
        """See consecutive rows of a part of the drive (``lead``, ``move``, ``return``)."""
        self._whole.see(voltage)
        if part == "lead":
            self._lead.see(voltage)
        elif part == "move":
            voltage = voltage[: EXPECTED_ROWS - self._rows]
            self._rows += voltage.size
        if part == "return" or not voltage.size:
            return
        self._voltage.append(voltage)
        if dt is not None:
            steps = dt[: voltage.size] if isinstance(dt, np.ndarray) else dt
            self._steps.append(np.broadcast_to(steps, voltage.shape))

    def drive(
        self, state: State | None, lead_seconds: float, past_known: bool
    ) -> Drive:
        """Return the figures of what was seen, and warn of what is unusual."""
        loss = self.loss
        voltage, dt = self._first_rows()
        beyond = self._beyond()
        error = known = None
        if not beyond:
            error = self._expected(voltage, dt, past_known)
            if not past_known:
                known = self._expected(voltage, dt, True)
        warnings = [*self._start_warnings(), *beyond]
        warnings += self._move_warnings(voltage, dt, error)
        warnings += self._creeping_hold(state)
        for text in warnings:
            warn(text)
        return Drive(
            self.limits,
            self.model.digest,
            self.model.output.unit,
            rows=self._whole.rows,
            least=self._whole.least,
            greatest=self._whole.greatest,
            clipped=loss.clipped,
            first_clipped=loss.first_clipped,
            lost_rms=loss.rms,
            lost_most=loss.most,
            expected_error=error,
            expected_known=known,
            past_known=past_known,
            state=state,
            lead=self._lead,
            lead_seconds=lead_seconds,
            move_range=loss.move.range,
            warnings=tuple(warnings),
        )

    def _first_rows(self) -> tuple[Floats, Steps]:
        """Return the rows before the move and the first ones of it, and their time steps."""
        voltage = np.concatenate(self._voltage)
        if not self._steps:
            return voltage, None
        steps = np.concatenate(self._steps)
        if (steps == steps[0]).all():
            return voltage, float(steps[0])
        return voltage, steps

    def _expected(self, voltage: Floats, dt: Steps, past_known: bool) -> float | None:
        """Return the error to expect of the move (RMS), with what is clipped; None where it is not known."""
        from dbo_cli.model.expect import expected_error

        begin = self._lead.rows
        error = expected_error(self.model, voltage, dt, past_known, begin)
        return None if error is None else math.hypot(error, self.loss.rms)

    def _start_warnings(self) -> list[str]:
        """Return what was clipped, and how the drive begins."""
        loss, unit = self.loss, self.model.output.suffix
        texts = []
        if loss.clipped:
            texts.append(
                f"{loss.clipping()}: clipped; the move misses {loss.rms:.3g}{unit} RMS, at most "
                f"{loss.most:.3g}{unit}"
            )
        if abs(self.missed) > OFF_AT_FIRST * self.model.output.span:
            texts.append(
                f"{self.name}: row 1 starts {abs(self.missed):.3g}{unit} off, where no settled actuator "
                "is: try `condition` or `state` empty"
            )
        if abs(self.off) > OFF_AT_FIRST * self.model.output.span:
            texts.append(
                f"{self.name}: the move starts in motion and rings at first: add `lead` auto"
            )
        return texts

    def _beyond(self) -> list[str]:
        """Return a warning where the drive leaves the identified range."""
        low, high = self.limits.identified
        inside = low <= self._whole.least and self._whole.greatest <= high
        if not self.limits.extrapolate or inside:
            return []
        unit = self.limits.suffix
        return [
            f"{self.name}: the drive goes from {self._whole.least:.6g} to {self._whole.greatest:.6g}{unit}, "
            f"beyond the identified range, {low:.6g} to {high:.6g}{unit}"
        ]

    def _move_warnings(
        self, voltage: Floats, dt: Steps, expected: float | None
    ) -> list[str]:
        """Return what of the move the logs do not show."""
        from dbo_cli.model.expect import move_warnings

        texts = [
            f"{self.name}: {text}" for text in move_warnings(self.model, voltage, dt)
        ]
        line, unit = self.model.fit.get("line_rmse"), self.model.output.suffix
        if expected is None or not isinstance(line, float):
            return texts
        if expected >= max(line, self.loss.rms):
            texts.append(
                f"{self.name}: expected error {expected:.3g}{unit}, a straight line's is {line:.3g}: "
                "identify with a log of such moves"
            )
        return texts

    def _creeping_hold(self, state: State | None) -> list[str]:
        """Return a warning where holding the last position drives the voltage out of the limits."""
        relaxation = self.model.gears.relaxation
        if relaxation is None or state is None or state.drive is None:
            return []
        if min(relaxation.gain) >= 0.0:
            return []
        static = self.model.static
        still = replace(state, sections=None, delay=None, undoing=None)
        position = static.run(np.array([state.drive]), still, 0.0).y
        seconds = LONG_HOLD * max(relaxation.tau)
        voltage = float(static.drive(position, still, seconds).y[0])
        low, high = self.limits.move
        if low <= voltage <= high:
            return []
        unit = self.limits.suffix
        return [
            f"{self.name}: holding the last position takes the drive to {voltage:.6g}{unit} in the long run, "
            f"outside {low:.6g} to {high:.6g}{unit}"
        ]
