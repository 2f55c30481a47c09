"""How well a model follows a recording, judged with the very operators that will be used."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from dbo_cli.errors import FitError
from dbo_cli.hysteresis.identification.recordings import Floats, Integers, Recording, first_wiped_row
from dbo_cli.hysteresis.identification.statistics import PreparedLog
from dbo_cli.hysteresis.initial_states import StartName
from dbo_cli.hysteresis.model import ActuatorModel, DelayStage

BLOCK_ROWS = 65536


@dataclass(frozen=True)
class Residual:
    """What a model leaves over on one log.

    ``values`` measured minus predicted displacement, offset and drift taken off, for the rows used only;
    ``rows`` their indices; ``drift_span`` the drift's peak to peak; all in the displacement's unit.
    """

    name: str
    values: Floats
    rows: Integers
    drift_span: float

    @property
    def rmse(self) -> float:
        """Root mean square of the values."""
        return float(np.sqrt(np.mean(self.values**2)))


def predict(model: ActuatorModel, recording: Recording, start: StartName = "auto") -> Floats:
    """Displacement that the model predicts for a recording's voltage, from a named start state."""
    seconds = recording.seconds()
    voltage = recording.voltage
    state = model.start(float(voltage[0]), start)
    steps = None if seconds is None else np.maximum(np.diff(seconds, prepend=seconds[0]), 0.0)
    predicted = np.empty(len(voltage))
    for first in range(0, len(voltage), BLOCK_ROWS):
        part = slice(first, min(first + BLOCK_ROWS, len(voltage)))
        step = None if steps is None else steps[part]
        done = model.simulate(voltage[part], state, time_step=step)
        predicted[part], state = done.y, done.state
    return predicted


def residual_of(model: ActuatorModel, recording: Recording, log: PreparedLog) -> Residual:
    """Residual on a log that took part in the fit: its start state, its rows, its drift terms."""
    rows = np.flatnonzero(log.used)
    left = (recording.displacement - predict(model, recording, log.start))[rows]
    columns = log.drift[rows]
    terms = np.linalg.lstsq(columns, left, rcond=None)[0]
    drifting = slice(1, columns.shape[1] - log.stretches)
    drift = columns[:, drifting] @ terms[drifting]
    span = float(np.ptp(drift)) if drift.size else 0.0
    return Residual(log.name, left - columns @ terms, rows, span)


def validation_of(model: ActuatorModel, recording: Recording, skip_seconds: float) -> Residual:
    """Residual on a recording that took no part in the fit: only the sensor's offset is taken off.

    Rows before ``skip_seconds``, and those before the drive has been at both ends of its range where that
    leaves most of the log, are left out: the history before the first sample is not known.

    Raises
    ------
    FitError
        Nothing is left of the log.
    """
    seconds = recording.seconds()
    keep = np.ones(len(recording.voltage), bool)
    if seconds is not None:
        keep &= seconds >= skip_seconds
    wiped = first_wiped_row(recording.voltage)
    if wiped <= 0.4 * len(keep):
        keep[:wiped] = False
    if not keep.any():
        raise FitError(
            f"{recording.name}: nothing is left of this log to validate on: it is shorter than `skip` "
            f"({skip_seconds:g} s)"
        )
    left = (recording.displacement - predict(model, recording))[keep]
    return Residual(recording.name, left - left.mean(), np.flatnonzero(keep), 0.0)


def straight_line(recording: Recording, log: PreparedLog) -> float:
    """RMSE of the best straight line from voltage to displacement, offset and drift fitted beside it."""
    rows = log.used
    # About their means: an offset of a million ranges would leave the voltage no digits beside the constant.
    voltage, target = (
        signal[rows] - signal[rows].mean() for signal in (recording.voltage, recording.displacement)
    )
    columns = np.column_stack((voltage, log.drift[rows]))
    left = target - columns @ np.linalg.lstsq(columns, target, rcond=None)[0]
    return float(np.sqrt(np.mean(left**2)))


def loop_width_percent(model: ActuatorModel) -> float:
    """Greatest distance between the slow rising and falling branch, in % of the output's range.

    Walked over the full input range so slowly that relaxation is at rest at every step.
    """
    up = np.linspace(model.input.minimum, model.input.maximum, 1001)
    walk = np.concatenate((up, up[::-1]))
    still = dataclasses.replace(model, stages=tuple(s for s in model.stages if not isinstance(s, DelayStage)))
    slow = still.simulate(
        walk, still.start(float(up[0]), "empty"), time_step=1e9 if still.needs_time else None
    )
    rising, falling = slow.y[: len(up)], slow.y[: len(up) - 1 : -1]
    return 100.0 * float(np.abs(falling - rising).max()) / float(np.ptp(slow.y))
