"""How well a model follows a recording, judged with the very operators that will be used."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dbo_cli.hysteresis.identification.preparation import PreparedLog
from dbo_cli.hysteresis.identification.recordings import Floats, Recording, first_wiped_row
from dbo_cli.hysteresis.model import ActuatorModel, DelayStage
from dbo_cli.hysteresis.operators import DiscreteBacklashOperator

BLOCK_ROWS = 65536


@dataclass(frozen=True)
class Residual:
    """What a model leaves over on one log.

    ``values`` measured minus predicted displacement, offset and drift taken off, for the rows used only;
    ``rows`` their indices; ``drift_span`` the drift's peak to peak; all in the displacement's unit.
    """

    name: str
    values: Floats
    rows: Floats
    drift_span: float

    @property
    def rmse(self) -> float:
        """Root mean square of the values."""
        return float(np.sqrt(np.mean(self.values**2)))


def predict(model: ActuatorModel, recording: Recording, start: str = "auto") -> Floats:
    """Displacement that the model predicts for a recording's voltage, from a named start state."""
    seconds = recording.seconds()
    voltage = recording.voltage
    state = model.start(float(voltage[0]), start)  # type: ignore[arg-type]
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
    rows = np.flatnonzero(log.fold >= 0)
    left = (recording.displacement - predict(model, recording, log.start))[rows]
    columns = log.drift[rows]
    terms = np.linalg.lstsq(columns, left, rcond=None)[0]
    drift = columns[:, 1:] @ terms[1:]
    span = float(np.ptp(drift)) if drift.size else 0.0
    return Residual(log.name, left - columns @ terms, rows, span)


def validation_of(model: ActuatorModel, recording: Recording, skip_seconds: float) -> Residual:
    """Residual on a recording that took no part in the fit: only the sensor's offset is taken off.

    Rows before ``skip_seconds``, and those before the drive has been at both ends of its range where that
    leaves most of the log, are left out: the history before the first sample is not known.
    """
    seconds = recording.seconds()
    keep = np.ones(len(recording.voltage), bool)
    if seconds is not None:
        keep &= seconds >= skip_seconds
    wiped = first_wiped_row(recording.voltage)
    if wiped <= 0.4 * len(keep):
        keep[:wiped] = False
    left = (recording.displacement - predict(model, recording))[keep]
    return Residual(recording.name, left - left.mean(), np.flatnonzero(keep), 0.0)


def straight_line(recording: Recording, log: PreparedLog) -> float:
    """RMSE of the best straight line from voltage to displacement, offset and drift fitted beside it."""
    rows = log.fold >= 0
    columns = np.column_stack((recording.voltage[rows], log.drift[rows]))
    target = recording.displacement[rows]
    left = target - columns @ np.linalg.lstsq(columns, target, rcond=None)[0]
    return float(np.sqrt(np.mean(left**2)))


def loop_width_percent(model: ActuatorModel) -> float:
    """Greatest distance between the slow rising and falling branch, in % of the output's range.

    Walked over the full input range with the relaxation left out (it opens no loop when slow enough).
    """
    operator = model.backlash
    gears = DiscreteBacklashOperator(operator.dx, operator.dy, operator.x0, operator.y0)
    kappa = sum(operator.relaxation.gain) if operator.relaxation else 0.0
    low, high = operator.x_range
    up = np.linspace(low, high, 1001)
    rising, state, _ = gears.run(up, gears.empty())
    falling, _, _ = gears.run(up[::-1], state)
    branches = []
    for branch, voltage in ((rising, up), (falling[::-1], up)):
        out = branch + kappa * (voltage - low)
        for stage in model.stages[1:]:
            if not isinstance(stage, DelayStage):
                out = stage.run(out)  # type: ignore[union-attr]
        branches.append(out)
    width = float(np.abs(branches[1] - branches[0]).max())
    reach = float(max(np.ptp(branches[0]), np.ptp(branches[1])))
    return 100.0 * width / reach
