"""How well a model follows a recording, judged with the very operators of use, and what to warn of."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import FitError
from dbo_cli.hysteresis.identification.cleaning import Sensor
from dbo_cli.hysteresis.identification.normal_equations import dot, sum_of_squares
from dbo_cli.hysteresis.identification.preparation import Prepared
from dbo_cli.hysteresis.identification.recordings import (
    BLOCK_ROWS,
    FEWEST_ROWS,
    KNOWN_PAST,
    MOST,
    DriveShape,
    Floats,
    Integers,
    Recording,
    first_wiped_row,
    known_behind_gaps,
)
from dbo_cli.hysteresis.identification.search import ROWS_PER_SLOPE, Choice
from dbo_cli.hysteresis.identification.statistics import PreparedLog, weighted
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_state import StartName

TINY = float(np.finfo(float).tiny)  # in place of a divisor of 0
WHOSE_LAG = (
    "compensated too (`sensor_delay`, `sensor_lag`: take off what is the sensor's)"
)
"""What becomes of a lag: a log cannot tell whether the actuator or its sensor is late."""


@dataclass(frozen=True)
class Residual:
    """What a model leaves over on one log.

    ``values`` measured minus predicted displacement, offset and drift taken off, for
    the rows used only; ``rows`` their indices; ``drift_span`` the drift's peak to peak;
    ``mean_predicted`` of them. All are in the unit of the displacement. ``weights`` are
    the roots of the rows' weights, None where all count alike.
    """

    name: str
    values: Floats
    rows: Integers
    drift_span: float
    mean_predicted: float = 0.0
    weights: Floats | None = None

    @property
    def weighted(self) -> Floats:
        """The values times the roots of their weights."""
        return weighted(self.values, self.weights)

    @property
    def rmse(self) -> float:
        """Root mean square of the values, by their weights."""
        return float(np.sqrt(np.mean(self.weighted**2)))


def predict(
    model: ActuatorModel, recording: Recording, start: StartName = "auto"
) -> Floats:
    """Displacement that the model predicts for a recording's voltage, from a named start state."""
    seconds = recording.seconds()
    voltage = recording.voltage
    state = model.start(float(voltage[0]), start)
    steps = None
    if seconds is not None:
        steps = np.maximum(np.diff(seconds, prepend=seconds[0]), 0.0)
    predicted = np.empty(len(voltage))
    for first in range(0, len(voltage), BLOCK_ROWS):
        part = slice(first, min(first + BLOCK_ROWS, len(voltage)))
        step = None if steps is None else steps[part]
        done = model.simulate(voltage[part], state, time_step=step)
        predicted[part], state = done.y, done.state
    return predicted


def residual_of(
    model: ActuatorModel, recording: Recording, log: PreparedLog
) -> Residual:
    """Residual on a log that took part in the fit: its start state, its rows, its drift terms."""
    rows = np.flatnonzero(log.used)
    predicted = predict(model, recording, log.start)[rows]
    left = recording.displacement[rows] - predicted
    columns, weights = log.drift[rows], log.weights_at(rows)
    terms = np.linalg.lstsq(
        weighted(columns, weights), weighted(left, weights), rcond=None
    )[0]
    drifting = slice(1, columns.shape[1] - log.stretches)
    drift = columns[:, drifting] @ terms[drifting]
    span = float(np.ptp(drift)) if drift.size else 0.0
    mean = float(predicted.mean())
    return Residual(log.name, left - columns @ terms, rows, span, mean, weights)


def known_rows(recording: Recording, skip_seconds: float) -> NDArray[np.bool_]:
    """Return the rows of a log that can be judged; shape (samples,).

    Rows before ``skip_seconds``, and those before the drive has been at both ends of
    its range where that leaves most of the log, are left out: the history before the
    first sample is not known. So is that behind gaps (``known_behind_gaps``).
    """
    seconds = recording.seconds()
    keep = np.ones(len(recording.voltage), bool)
    if seconds is not None:
        keep = seconds >= skip_seconds
    wiped = first_wiped_row(recording.voltage)
    if wiped <= KNOWN_PAST * len(keep):
        keep[:wiped] = False
    return known_behind_gaps(recording, keep)


def validation_of(
    model: ActuatorModel, recording: Recording, skip_seconds: float
) -> Residual:
    """Residual on a recording that took no part in the fit: only the sensor's offset is taken off.

    Raises
    ------
    FitError
        Nothing is left of the log.
    """
    keep = known_rows(recording, skip_seconds)
    if not keep.any():
        raise FitError(
            f"{recording.name}: nothing is left of this log to validate on: it is shorter than `skip` "
            f"({skip_seconds:g} s)"
        )
    left = (recording.displacement - predict(model, recording))[keep]
    return Residual(recording.name, left - left.mean(), np.flatnonzero(keep), 0.0)


def validations_of(
    model: ActuatorModel,
    recordings: Sequence[Recording],
    sensor: Sensor,
    skip_seconds: float,
) -> list[Residual]:
    """Residuals on recordings that took no part in the fit, their sensor taken off."""
    return [
        validation_of(model, sensor.taken_off(recording), skip_seconds)
        for recording in recordings
    ]


def pooled(values: Sequence[float], residuals: Sequence[Residual]) -> float:
    """Root of the mean square over all logs, weighted by their rows."""
    weights = np.array([len(residual.values) for residual in residuals], dtype=float)
    return float(np.sqrt(weights @ np.square(values) / weights.sum()))


@dataclass(frozen=True)
class Judged:
    """What a model, and a straight line, leave over on the logs that they were fitted to.

    ``rmse`` and ``line`` are the RMS errors over all logs, in the displacement's unit;
    ``noise`` is the share of the model's mean square that is white;
    ``zero_drift`` and ``zero_drift_rate`` are by how much the zero moved along the log
    on which it moved most, and how fast, a second.
    """

    residuals: Sequence[Residual]
    rmse: float
    line: float
    noise: float
    zero_drift: float
    zero_drift_rate: float


def judge(
    model: ActuatorModel, recordings: Sequence[Recording], logs: Sequence[PreparedLog]
) -> Judged:
    """Run a model over the logs that it was fitted to, beside a straight line."""
    pairs = list(zip(recordings, logs, strict=True))
    residuals = [residual_of(model, recording, log) for recording, log in pairs]
    lines = [straight_line(recording, log) for recording, log in pairs]
    rmse = pooled([residual.rmse for residual in residuals], residuals)
    white = white_noise([residual.weighted for residual in residuals])
    noise = white / max(rmse, TINY) ** 2
    drift, drift_rate = _zero_drift(residuals, recordings)
    line = pooled(lines, residuals)
    return Judged(residuals, rmse, line, noise, drift, drift_rate)


def _zero_drift(
    residuals: Sequence[Residual], recordings: Sequence[Recording]
) -> tuple[float, float]:
    """Return how far the zero moved along the log on which it moved most, and how fast, a second."""
    spans = [residual.drift_span for residual in residuals]
    most = spans.index(max(spans))
    seconds = recordings[most].seconds()
    if seconds is None or seconds[-1] <= seconds[0]:
        return spans[most], 0.0
    return spans[most], spans[most] / float(seconds[-1] - seconds[0])


def validated(
    checks: Sequence[Residual], span: float, unit: str
) -> tuple[dict[str, object], list[str]]:
    """Return what the model file says of logs that took no part in the fit, and lines for the terminal."""
    if not checks:
        return {}, []
    rmse = pooled([check.rmse for check in checks], checks)
    figures: dict[str, object] = {
        "validation_rmse": rmse,
        "validation_percent": 100.0 * rmse / span,
        "validation": [
            {"name": check.name, "samples": len(check.values), "rmse": check.rmse}
            for check in checks
        ],
    }
    return figures, [
        f"{check.name}: predicts it to {check.rmse:.4g}{unit} RMSE ({100.0 * check.rmse / span:.2f} % of the "
        "model's range), offset removed"
        for check in checks
    ]


# of fast rows, or of a short log beside a prior; chosen, the next line follows from it
FOLDS = 5
STUDENT = 2.776
"""Standard errors on either side of a frequency or damping: Student's t of as many folds, 95 %. Measured:
docs/choices.md.
"""
WHITE = 4.0
"""Standard deviations up to which what is left over is noise alone.

That of n samples of white noise, of the ratio of their mean square to the one by their
second differences, is (2/n)^1/2.
"""


def with_its_error(value: float, error: float, sign: bool = False) -> tuple[str, str]:
    """Return a value and the half width of its interval as texts, to the same place.

    The error has two digits and is rounded up, so that what is printed holds what the
    interval holds, the rounding of the value included.
    """
    form = "+" if sign else ""
    if not 0.0 < error < math.inf:
        return f"{value:{form}.4g}", f"{error:.2g}"
    places = 1 - math.floor(math.log10(error))
    unit = 10.0**-places
    rounded = round(value, places)
    least = abs(rounded - value) + error
    shown = math.ceil(least / unit - 1e-9) * unit
    places = max(places, 0)
    return f"{rounded:{form}.{places}f}", f"{shown:.{places}f}"


def outward(interval: Sequence[float], digits: int) -> str:
    """Return an interval as "low to high", its ends rounded outwards to so many digits."""
    low, high = interval
    above = 0.0 - _rounded_down(-high, digits)
    return f"{_rounded_down(low, digits):.{digits}g} to {above:.{digits}g}"


def _rounded_down(value: float, digits: int) -> float:
    """Return the next value of so many digits below, or the value where it has no more."""
    if value == 0.0 or not math.isfinite(value):
        return value
    places = digits - 1 - math.floor(math.log10(abs(value)))
    unit = 10.0**-places
    return round(math.floor(value / unit + 1e-9) * unit, places)


def white_noise(left: Sequence[Floats]) -> float:
    """Return the mean square of what is white in what is left over, by its second differences."""
    noise = [np.diff(part, 2) for part in left]
    squares = sum(sum_of_squares(part) for part in noise)
    return squares / sum(part.size for part in noise) / 6.0


def most_noise(noise: float, rows: int) -> float:
    """Return the largest mean square that so many rows of white noise of this mean square may have."""
    return (1.0 + WHITE * float(np.sqrt(2.0 / rows))) * noise


def beyond_noise(left: Sequence[Floats]) -> float:
    """Return the mean square of what is left over beyond white noise, 0 where that may be all."""
    rows = sum(part.size for part in left)
    total = sum(sum_of_squares(part) for part in left) / rows
    return max(total - most_noise(white_noise(left), rows), 0.0)


def straight_line(recording: Recording, log: PreparedLog) -> float:
    """RMSE of the best straight line from voltage to displacement, offset and drift fitted beside it."""
    rows = log.used
    # About their means: an offset of a million ranges would leave the voltage no digits
    # beside the constant.
    voltage = recording.voltage[rows] - recording.voltage[rows].mean()
    target = recording.displacement[rows] - recording.displacement[rows].mean()
    weights = log.weights_at(rows)
    columns = weighted(np.column_stack((voltage, log.drift[rows])), weights)
    target = weighted(target, weights)
    left = target - columns @ np.linalg.lstsq(columns, target, rcond=None)[0]
    return float(np.sqrt(np.mean(left**2)))


def loop_width_percent(model: ActuatorModel) -> float:
    """Greatest distance between the slow rising and falling branch, in % of the output's range.

    Walked over the full input range so slowly that relaxation is at rest at every step.
    """
    up = np.linspace(model.input.minimum, model.input.maximum, 1001)
    walk = np.concatenate((up, up[::-1]))
    still = model.without(model.delay)
    time_step = 1e9 if still.needs_time else None
    slow = still.simulate(walk, still.start(float(up[0]), "empty"), time_step=time_step)
    rising, falling = slow.y[: len(up)], slow.y[: len(up) - 1 : -1]
    return 100.0 * float(np.abs(falling - rising).max()) / float(np.ptp(slow.y))


POOR_PERCENT = 5.0  # of the range: a fit worse than this does not describe the actuator
SPEED_CORRELATION = 0.35
"""Of residual and speed, from which the error is said to depend on the speed. Measured: docs/choices.md."""

SATURATION = 0.15  # slope at an end, relative to the median slope
# greatest over least gain of logs: a piezo's own scatter between runs is below a
# percent
GAINS_APART = 1.01
SLEWED = 4.0
"""Times as many rows near the greatest speed as the model has: something holds the speed at a limit.
Measured: docs/choices.md.
"""
# twice up and down: of fewer the error that came was up to ten times the one expected
FEWEST_SWINGS = 4
FEWEST_LEVELS = 20
"""Hundredths of the range that a drive visits; one that moves visits them all. Measured: docs/choices.md."""
CLOCKWISE = 1.3  # growing slopes fit so much worse than falling ones


def log_warnings(
    recordings: Sequence[Recording], shapes: Sequence[DriveShape]
) -> list[str]:
    """Warnings about the recordings themselves."""
    warnings = []
    for log in recordings:
        moving = np.abs(np.diff(log.voltage)) > 0.0
        repeats = (np.diff(log.displacement) == 0.0) & moving
        if (
            moving.any()
            and repeats.sum() > MOST * moving.sum()
            and not _stepped(log.displacement)
        ):
            warnings.append(
                f"{log.name}: {100.0 * repeats.sum() / moving.sum():.0f} % of the displacements repeat the "
                "one before while the drive moves: the sensor is slower than the log (sample-and-hold); log "
                "at the sensor's rate, or the fit sees a lag that is not the actuator's"
            )
        seconds = log.seconds()
        if seconds is not None and log.time is not None:
            steps = np.diff(seconds)
            if (steps < 0.0).any():
                warnings.append(
                    f"{log.name}: time runs backwards {int((steps < 0).sum())} times (first at row "
                    f"{int(np.argmax(steps < 0)) + 2}): lag and delay found from it are not to be trusted; "
                    "repair the clock or cut the log with `rows`"
                )
            elif (steps == 0.0).any():
                warnings.append(
                    f"{log.name}: {int((steps == 0).sum())} repeated time stamps (first at row "
                    f"{int(np.argmax(steps == 0)) + 2}): lag and delay are less certain; log time with more "
                    "digits"
                )
    if sum(len(shape.turns) + 1 for shape in shapes) < FEWEST_SWINGS:
        warnings.append(
            "less than two whole cycles: nothing could be left out to test the model on; record at least "
            "three"
        )
    low = min(log.voltage.min() for log in recordings)
    span = max(np.ptp(log.voltage) for log in recordings)
    places = [
        np.bincount((100.0 * (log.voltage - low) / span + 0.5).astype(np.int64))
        for log in recordings
    ]
    levels = max(int(np.count_nonzero(counts)) for counts in places)
    if levels < FEWEST_LEVELS:
        warnings.append(
            f"the log's samples stand at {levels} levels of the drive alone: what is expected on new moves "
            "holds there; record a drive that moves over the range"
        )
    return warnings


def _stepped(displacement: Floats) -> bool:
    """Whether a sensor repeats itself because its steps are coarse, not because it is slow."""
    steps = np.abs(np.diff(displacement))
    steps = steps[steps > 0.0]
    return len(steps) == 0 or float(np.median(steps)) < 1.5 * float(steps.min())


def rated_warnings(
    lowest: float, highest: float, rated: tuple[float | str, float | str] | None
) -> list[str]:
    """Warn where the logs cover less or more than the drive's rated range (both in the voltage's unit)."""
    if rated is None:
        return []
    low, high = map(float, rated)
    slack = 0.01 * (high - low)  # chosen
    warnings = []
    if lowest < low - slack or highest > high + slack:
        warnings.append(
            f"the logs go from {lowest:g} to {highest:g}, beyond the rated range {low:g} to "
            f"{high:g}: check the voltage column, or give compensate `v_min` and `v_max`"
        )
    covered = 100.0 * (min(highest, high) - max(lowest, low)) / (high - low)
    if covered < 95.0:  # chosen
        warnings.append(
            f"the logs cover {lowest:g} to {highest:g}, {covered:.0f} % of the rated range "
            f"{low:g} to {high:g}: outside, the model goes straight on; record the whole range before using "
            "it there"
        )
    return warnings


def swapped_warnings(recordings: Sequence[Recording], clockwise: float) -> list[str]:
    """Warn of a loop that runs clockwise in logs, as they were given, whose voltage is the noisier signal."""
    if clockwise <= CLOCKWISE or any(
        _roughness(log.voltage) <= _roughness(log.displacement) for log in recordings
    ):
        return []
    return [
        "the loop runs clockwise, and the voltage is noisier than the displacement: voltage and displacement "
        "are swapped, or the voltage was read back: check `voltage` and `displacement`"
    ]


def _roughness(signal: Floats) -> float:
    """Return the median of the sixth differences, to which a smooth signal adds little, over the range."""
    return float(np.median(np.abs(np.diff(signal, 6)))) / max(
        float(np.ptp(signal)), TINY
    )


def fit_notes(
    unit: str | None,
    prepared: Prepared,
    clockwise: float,
    trend: float | None,
    forgets: bool = False,
) -> list[str]:
    """Return what is good to know of the logs and is in the figure: none of it tells moves that err by more.

    Of 528 moves of 11 kinds of plants (benchmarks/foreign_plants.py), 63 % within 1.5
    times what was stated, these were said of 132 within and 55 beyond twice, most of
    them after one amplitude, which now widens it.
    """
    notes = []
    if prepared.one_amplitude:
        notes.append(
            "all cycles go over one and the same range: smaller loops are extrapolated, and lag, loop width "
            "and delay can hardly be told apart; record several amplitudes ('dbo excite' writes such a "
            "drive)"
        )
    for log in prepared.logs:
        apart = np.diff(np.flatnonzero(np.diff(log.voltage)))
        every = int(np.median(apart)) if len(apart) else 1
        if every > 1 and np.mean(apart == every) > MOST:
            notes.append(
                f"{log.name}: the voltage changes only once in {every} rows: right where the drive itself "
                "goes in such steps; where it is read more slowly than the displacement, log both at one rate"
            )
    if prepared.doubtful_drift:
        size = (
            f"{prepared.doubtful_drift * abs(prepared.scale):.2g} {unit or ''}".rstrip()
        )
        notes.append(
            f"the logs' slow part may be sensor drift or creep: a drift of {size} explains them as well, and "
            "creep was taken; where the sensor had just been switched on, record again with it warm"
        )
    if clockwise > CLOCKWISE:
        notes.append(
            "the loop runs clockwise: the displacement leads the voltage, since the actuator softens after a "
            "turn (friction, magnetics)"
        )
    if trend is not None:
        notes.append(
            f"the gain changes by {100.0 * trend:+.1f} % along the log, and this makes most of the error: "
            "let the actuator warm up, or settle, before recording"
        )
    if forgets:
        notes.append(
            "loops may not close: in the logs the displacement forgets its past as the drive moves, which "
            "this model does not, so that small moves repeated at one place may creep away from it; the "
            "error expected of a move includes that"
        )
    return notes


def fit_warnings(
    recordings: Sequence[Recording],
    prepared: Prepared,
    choice: Choice,
    residuals: Sequence[Residual],
) -> list[str]:
    """Warnings about the fitted model and what it leaves over."""
    warnings = []
    span = abs(prepared.scale)
    rows = sum(len(residual.values) for residual in residuals)
    squares = 0.0
    for residual in residuals:
        squares += sum_of_squares(residual.weighted)
    rmse = float(np.sqrt(squares / rows))
    if rows < ROWS_PER_SLOPE * choice.basis.gears:
        warnings.append(
            f"{rows} rows for {choice.basis.gears} unknown slopes are fewer than the {ROWS_PER_SLOPE} for "
            "each that are safe: record longer, or give fewer gears (`gears`)"
        )
    if 100.0 * rmse / span > POOR_PERCENT:
        warnings.append(
            f"the model leaves {100.0 * rmse / span:.1f} % of its range unexplained: the log shows something "
            "this class of models cannot follow (a loop that crosses itself, resonance, slip, a wrong "
            "column); look at 'dbo report `model`' before using it"
        )
    warnings.extend(_gain_warnings(recordings, residuals))
    warnings.extend(_slew_warnings(recordings, residuals))
    warnings.extend(_shape_warnings(recordings, prepared))
    speed = _speed_correlation(recordings, residuals)
    if abs(speed) > SPEED_CORRELATION and 100.0 * rmse / span > 0.5:
        warnings.append(
            f"what is left over follows the drive's speed (correlation {speed:.2f}): the actuator's loop "
            "depends on the rate, which this model does not follow; identify at the speed of use"
        )
    return warnings


def _gain_warnings(
    recordings: Sequence[Recording], residuals: Sequence[Residual]
) -> list[str]:
    """Warn of a gain that differs between logs where that makes most of the error.

    On 11 kinds of plants (benchmarks/foreign_plants.py) a gain that warms up by 3 %
    left 0.10 to 0.44 of the squared error after five kinds of logs and 0.2 beyond noise
    after the sixth, creep over five decades 0.4 twice (0.3 % of gain), everything else
    0.8 and more.
    """
    gains, before, after = [], 0.0, 0.0
    for log, residual in zip(recordings, residuals, strict=True):
        left = residual.values - residual.values.mean()
        predicted = log.displacement[residual.rows] - residual.values
        predicted = predicted - predicted.mean()
        more = float(np.sum(left * predicted)) / max(float(np.sum(predicted**2)), TINY)
        gains.append(1.0 + more)
        before += float(np.sum(left**2))
        after += float(np.sum((left - more * predicted) ** 2))
    if max(gains) < GAINS_APART * min(gains) or after > MOST * before:
        return []
    each = ", ".join(
        f"{log.name} {gain:.3f}" for log, gain in zip(recordings, gains, strict=True)
    )
    return [
        f"the logs' gains differ (over the model's: {each}), and this makes most of the error: different "
        "actuators, loads or temperatures? identify each by itself (`output` 'models/{file}.json' does)"
    ]


def _slew_warnings(
    recordings: Sequence[Recording], residuals: Sequence[Residual]
) -> list[str]:
    """Warn where the displacement keeps to a greatest speed that the model does not know."""
    warnings = []
    for log, residual in zip(recordings, residuals, strict=True):
        measured = log.displacement[residual.rows]
        predicted = measured - residual.values
        apart = 5  # rows: over one step noise is as large as the motion
        steps = [signal[apart:] - signal[:-apart] for signal in (measured, predicted)]
        for direction, word in ((1.0, "rises"), (-1.0, "falls")):
            along = direction * steps[1] > 0.0
            near = _near_greatest(direction * steps[0][along])
            usual = _near_greatest(direction * steps[1][along])
            if near > SLEWED * usual > 0.0:
                warnings.append(
                    f"{log.name}: the displacement {word} at one greatest speed ({100.0 * near:.0f} % of the "
                    f"rows are near it, {100.0 * usual:.0f} % of the model's): a slew or current limit of "
                    "the amplifier, which no model of this class follows; record and move more slowly"
                )
                break
    return warnings


SCATTER = 0.25
"""Of the displacement's variance, what a curve that turns may leave at one place and direction of the drive;
chosen (butterflies leave 0.02, amplifiers that slew 0.3, a log of another drive 0.7).
"""


def _near_greatest(steps: Floats) -> float:
    """Return the share of steps within a tenth of the greatest, the largest 0.5 % aside."""
    if len(steps) < FEWEST_ROWS:
        return 0.0
    return float(np.mean(steps > 0.9 * np.percentile(steps, 99.5)))


def _shape_warnings(recordings: Sequence[Recording], prepared: Prepared) -> list[str]:
    """Butterfly and saturation, from the mean curve of displacement over voltage."""
    warnings = []
    for log, ready in zip(recordings, prepared.logs, strict=True):
        voltage = (log.voltage - prepared.low) / prepared.span
        moved = np.diff(voltage, prepend=voltage[0])
        last_move = np.maximum.accumulate(
            np.where(moved != 0.0, np.arange(len(moved)), 0)
        )
        down = moved[last_move] < 0.0
        place = np.clip((voltage * 20).astype(np.int64), 0, 19) + 20 * down
        place, displacement = place[ready.used], log.displacement[ready.used]
        counts = np.bincount(place, minlength=40).reshape(2, 20)
        sums = np.bincount(place, displacement, minlength=40).reshape(2, 20)
        # a level driven to one way alone would be half a loop
        full = (counts > 0).all(axis=0)
        mean = (sums[:, full] / counts[:, full]).mean(axis=0)
        climbs = np.diff(mean) * np.sign(prepared.scale)
        if len(climbs) < 8:
            continue
        falls = -float(climbs[climbs < 0.0].sum())
        turns = falls > 0.25 * float(climbs[climbs > 0.0].sum())
        at_ends = min(float(climbs[1:3].mean()), float(climbs[-3:-1].mean()))
        if turns and _follows(displacement, place):
            warnings.append(
                f"{log.name}: the displacement rises and falls again as the voltage rises (a butterfly, or a "
                "turning direction of motion): no invertible model follows that; stay on one side of the "
                "turn"
            )
        elif not turns and at_ends < SATURATION * float(np.median(climbs)):
            warnings.append(
                f"{log.name}: the displacement hardly moves at an end of the drive's range (saturation, or "
                "an end stop): the inverse asks for large voltages there; keep trajectories away from it"
            )
    return warnings


def _follows(displacement: Floats, place: NDArray[np.int64]) -> bool:
    """Whether a displacement is a matter of the drive's place and direction, but for ``SCATTER``."""
    counts = np.maximum(np.bincount(place), 1)
    mean = np.bincount(place, displacement) / counts
    return bool(np.var(displacement - mean[place]) < SCATTER * np.var(displacement))


def _speed_correlation(
    recordings: Sequence[Recording], residuals: Sequence[Residual]
) -> float:
    """Correlation of the residual with the drive's speed, over all logs."""
    left, speed = [], []
    for log, residual in zip(recordings, residuals, strict=True):
        seconds = log.seconds()
        if seconds is None:
            steps = np.gradient(log.voltage)
        else:
            steps = _speed(log.voltage, seconds)
        left.append(residual.values - residual.values.mean())
        speed.append(steps[residual.rows] - steps[residual.rows].mean())
    a, b = np.concatenate(left), np.concatenate(speed)
    size = math.sqrt(sum_of_squares(a) * sum_of_squares(b))
    return dot(a, b) / size if size > 0.0 else 0.0


def _speed(voltage: Floats, seconds: Floats) -> Floats:
    """Drive's rate of change; zero where the clock stands still."""
    rise, run = np.gradient(voltage), np.gradient(seconds)
    out: Floats = np.divide(rise, run, out=np.zeros(len(voltage)), where=run > 0.0)
    return out
