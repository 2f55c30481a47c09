"""Identification of gears, memories, asymmetry and delay: what a user may fix, and all steps but dynamics."""

from __future__ import annotations

import dataclasses
import math
import numbers
from collections.abc import Sequence
from dataclasses import field, fields

import numpy as np

from dbo_cli.errors import FitError, UsageError
from dbo_cli.hysteresis.identification.cleaning import Sensor, cleaned
from dbo_cli.hysteresis.identification.evaluation import (
    TINY,
    WHOSE_LAG,
    Residual,
    fit_notes,
    fit_warnings,
    log_warnings,
    loop_width_percent,
    pooled,
    rated_warnings,
    residual_of,
    straight_line,
    swapped_warnings,
    validated,
    validation_of,
    white_noise,
)
from dbo_cli.hysteresis.identification.expectation import Expectation, expect
from dbo_cli.hysteresis.identification.preparation import Prepared, prepare
from dbo_cli.hysteresis.identification.recordings import (
    Recording,
    median_cycle_seconds,
    without_voltage_glitches,
)
from dbo_cli.hysteresis.identification.refinement import Fitted, fit, model_of
from dbo_cli.hysteresis.identification.search import (
    Choice,
    Orders,
    choose,
    sample_period,
    slowest_lag,
)
from dbo_cli.hysteresis.identification.statistics import PreparedLog
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.move_error import rms
from dbo_cli.records import dataclass

METHODS = ("least-squares", "paper")
SLOPES = ("growing", "falling", "free")
ZEROS = ("none", "mean", "first")
NOT_FOR_PAPER = (
    "relaxation",
    "delay",
    "slopes",
    "skip_seconds",
    "rated",
    "sensor_delay",
    "sensor_lag",
    "dynamics",
)

NOT_WITH_PRIOR = ("gears", "points", "relaxation", "delay", "slopes", "method", "zero", "dynamics")

MOST_GEARS = 10_000  # the normal equations of so many take 800 MB


@dataclass(frozen=True)
class IdentificationOptions:
    """What the user asked for; None stands for 'auto'.

    Parameters
    ----------
    gears, points : int, optional
        Number of gears; number of segments of the asymmetry, 0 for none.
    relaxation : sequence of float, optional
        Time constants in seconds, () for none.
    delay : float, optional
        Of the actuator, in seconds.
    slopes : {"growing", "falling", "free"}, optional
        How the slopes of the gears may change from one to the next.
    skip_seconds : float
        Left out at the beginning of every log.
    method : {"least-squares", "paper"}
        The paper's own takes one log of one cycle, and of the other options gears, points and zero alone.
    zero : {"none", "mean", "first"} or float
        Displacement that counts as zero: as logged, the log's mean, its first, or a value.
    rated : (float, float), optional
        The drive's full range, for a warning where the logs cover less; texts have a unit (``"1.2kV"``).
    force : bool
        Keep a model that would be refused.
    dynamics : int, optional
        Number of resonances: 0, 1 or 2.
    sensor_delay, sensor_lag : float
        What the sensor adds, in seconds: taken off the logs, kept in the model's ``fit``, not compensated.

    Raises
    ------
    UsageError
        A value is not of its kind, or options contradict each other.
    """

    gears: int | None = None
    points: int | None = None
    relaxation: Sequence[float] | None = None
    delay: float | None = None
    slopes: str | None = None
    skip_seconds: float = 0.0
    method: str = "least-squares"
    zero: str | float = "none"
    rated: tuple[float | str, float | str] | None = None
    force: bool = False
    sensor_delay: float = 0.0
    sensor_lag: float = 0.0
    dynamics: int | None = None

    def __post_init__(self) -> None:
        """Refuse what is not of its kind or contradicts the rest."""
        self._check_count("gears", self.gears, 1)
        if self.gears is not None and self.gears > MOST_GEARS:
            raise UsageError(f"`gears` {self.gears}: {MOST_GEARS:,} are more than any log can tell apart")
        self._check_count("points", self.points, 0)
        self._check_count("dynamics", self.dynamics, 0)
        if self.dynamics is not None and self.dynamics > 2:
            raise UsageError(f"`dynamics` {self.dynamics}: at most two resonances are looked for")
        _seconds("skip", self.skip_seconds)
        _seconds("sensor_delay", self.sensor_delay)
        _seconds("sensor_lag", self.sensor_lag)
        if self.delay is not None:
            _seconds("delay", self.delay)
        if self.relaxation is not None:
            self._check_relaxation(self.relaxation)
        if self.slopes is not None:
            _choice("slopes", self.slopes, SLOPES)
        _choice("method", self.method, METHODS)
        if not (_is_number(self.zero) and math.isfinite(float(self.zero))):
            _choice("zero", self.zero, ZEROS, " or a displacement")
        self._check_rated()
        _choice("force", self.force, (False, True))
        if self.method == "paper":
            self._check_paper()

    @property
    def sensor(self) -> Sensor:
        """The sensor's own delay and lag."""
        return Sensor(self.sensor_delay, self.sensor_lag)

    @staticmethod
    def _check_count(name: str, value: object, least: int) -> None:
        if value is None:
            return
        if isinstance(value, bool) or not isinstance(value, numbers.Integral) or value < least:
            raise UsageError(f"`{name}` {value!r}: is a whole number, at least {least}")

    def _check_relaxation(self, taus: object) -> None:
        if isinstance(taus, str) or not isinstance(taus, Sequence):
            raise UsageError(f"`relaxation` {taus!r}: give a list of time constants in seconds")
        for tau in taus:
            if not (_is_number(tau) and 0.0 < tau < math.inf):
                raise UsageError(f"`relaxation` {tau!r}: time constants are positive numbers of seconds")
        object.__setattr__(self, "relaxation", tuple(float(tau) for tau in taus))

    def _check_rated(self) -> None:
        if self.rated is None:
            return
        if isinstance(self.rated, str) or not (isinstance(self.rated, Sequence) and len(self.rated) == 2):
            raise UsageError(f"`rated` {self.rated!r}: give both ends of the drive's range")
        low, high = self.rated
        if isinstance(low, str) or isinstance(high, str):
            return  # checked when they are in the logs' unit
        if not (_is_number(low) and _is_number(high) and -math.inf < low < high < math.inf):
            raise UsageError(f"`rated` {self.rated!r}: the lower end must be a number below the upper one")

    def check_prior(self) -> None:
        """Refuse what a prior already has (UsageError)."""
        usual = {one.name: one.default for one in fields(self)}
        for name in NOT_WITH_PRIOR:
            if getattr(self, name) != usual[name]:
                raise UsageError(
                    f"`{name}` does not go with `prior`, whose shape is kept: leave one of them out"
                )

    def _check_paper(self) -> None:
        """Refuse what the paper's method would have to ignore."""
        usual = {one.name: one.default for one in fields(self)}
        for name in NOT_FOR_PAPER:
            value = getattr(self, name)
            nothing = name in ("relaxation", "delay", "dynamics") and not value
            if value != usual[name] and not nothing:
                shown = {"skip_seconds": "skip"}.get(name, name)
                raise UsageError(
                    f"`{shown}` does not go with `method` paper: the paper's model is fitted to one cycle "
                    "and has neither lag nor delay (`rows` A:B cuts the cycle out)"
                )


def _is_number(value: object) -> bool:
    return isinstance(value, numbers.Real) and not isinstance(value, bool) and not math.isnan(float(value))


def _seconds(name: str, value: object) -> None:
    if not (isinstance(value, numbers.Real) and _is_number(value) and 0.0 <= float(value) < math.inf):
        raise UsageError(f"`{name}` {value!r}: is a time in seconds, not negative")


def _choice(name: str, value: object, choices: Sequence[object], other: str = "") -> None:
    if not any(value is one or (isinstance(value, str) and value == one) for one in choices):
        raise UsageError(f"`{name}` {value!r}: is one of {', '.join(map(str, choices))}{other}")


NO_BETTER = 0.95  # of the straight line's RMSE: above this there is nothing but a line in the log

BROKEN = 2.0  # times the expected error: what could make a move err by more is warned of

LATE = 2.0
"""Sample periods: a shorter delay is no evidence of one, since a first-order lag looks alike. A sensor late
by 2 samples and 4 ms was found 2.5 to 3.25 late after six kinds of logs, lags without a delay 0.5 to 2.5."""

FASTEST = 98.0  # percentile of a log's rates: its few fastest steps are jumps and noise


@dataclass(frozen=True)
class Identification:
    """A model and what must be said of it: ``summary`` and ``warnings`` are lines of plain words."""

    model: ActuatorModel
    fit: dict[str, object]
    summary: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


NO_CLOCK = (
    "no clock, so neither lag nor delay could be looked for: name the time column (`time`) or give "
    "`sample_rate`"
)


def identify_static(
    recordings: Sequence[Recording],
    options: IdentificationOptions,
    validation: Sequence[Recording] = (),
    warned: Sequence[str] = (),
) -> Identification:
    """Identify a model without dynamics from recordings that were checked (see ``identify``).

    Parameters
    ----------
    warned : warnings that come before those found here

    Raises
    ------
    FitError
        Nothing trustworthy can be identified.
    """
    clocked = all(log.seconds() is not None for log in recordings)
    cycle = median_cycle_seconds(recordings) if clocked else None
    options.sensor.check(cycle)
    begins = [float(log.voltage[0]) for log in recordings]
    given = recordings
    recordings, said = without_voltage_glitches([options.sensor.taken_off(log) for log in recordings])
    logs = [cleaned(log) for log in recordings]
    recordings = [one.recording for one in logs]
    said += [note for one in logs for note in one.notes]
    prepared = prepare(recordings, options.skip_seconds, [one.bad for one in logs])
    choice = choose(prepared, _orders(options), cycle)
    fitted = fit(prepared.logs, choice.basis, choice.structure)
    model = model_of(fitted, prepared, recordings[0], options.zero, options.gears)
    residuals = [residual_of(model, log, ready) for log, ready in zip(recordings, prepared.logs, strict=True)]
    line = pooled(
        [straight_line(log, ready) for log, ready in zip(recordings, prepared.logs, strict=True)], residuals
    )
    rmse = pooled([one.rmse for one in residuals], residuals)
    if not any(tau > slowest_lag(cycle) for tau in fitted.basis.time_constants):
        prepared = dataclasses.replace(prepared, doubtful_drift=0.0)  # no creep was taken in its place
    warnings = [
        *warned,
        *log_warnings(recordings, prepared.shapes),
        *rated_warnings(prepared.low, prepared.high, options.rated),
        *fit_warnings(recordings, prepared, choice, residuals),
        *swapped_warnings(given, choice.clockwise),
        *([] if clocked else [NO_CLOCK]),
    ]
    if rmse > NO_BETTER * line:
        warnings.append(_no_loop(recordings, rmse, line, options.force))
    checks = [validation_of(model, options.sensor.taken_off(log), options.skip_seconds) for log in validation]
    expected = expect(
        prepared, choice, model, rmse, white_noise([one.values for one in residuals]) / max(rmse, TINY) ** 2
    )
    figures = _figures(
        prepared, choice, fitted, model, residuals, checks, rmse, line, cycle, expected, begins
    )
    warnings += _expected_warnings(expected, line) + _late_warnings(choice, prepared, expected, options)
    notes = fit_notes(model.output.unit, prepared, choice.clockwise, expected.gain_trend, expected.forgets)
    summary = said + prepared.notes + _summary(figures, model, prepared, checks, options.sensor) + notes
    figures |= {"notes": notes} | _figures_of(expected, options) | {"warnings": list(warnings)}
    figures["alternatives"] = [one.values() for one in expected.alternatives]
    return Identification(dataclasses.replace(model, fit=figures), figures, summary, warnings)


def _figures_of(expected: Expectation, options: IdentificationOptions) -> dict[str, object]:
    """Return what is known of the sensor, of the gain, and of the logs' swings, for the model file."""
    sensor = {"delay": options.sensor.delay, "lag": options.sensor.lag} if options.sensor else None
    found = {"sensor": sensor, "gain_trend": expected.gain_trend, "swings": expected.swing_values()}
    return {key: value for key, value in found.items() if value is not None}


def _orders(options: IdentificationOptions) -> Orders:
    """Return what the user fixed of the structure."""
    return Orders(
        options.gears,
        None if options.points is None else max(options.points, 1),
        None if options.relaxation is None else tuple(options.relaxation),
        options.delay,
        options.slopes,
    )


SCALES_APART = 2.0  # between the gains of logs; a piezo's own at small and at full swings differs by less


def _no_loop(recordings: Sequence[Recording], rmse: float, line: float, force: bool) -> str:
    """Refuse a model that is no better than a straight line (FitError), or say so where it is kept."""
    gains = [abs(float(np.polyfit(log.voltage, log.displacement, 1)[0])) for log in recordings]
    least, most = int(np.argmin(gains)), int(np.argmax(gains))
    cause = "the log shows no loop that this class of models can follow; check the columns and the sensor"
    if gains[most] > SCALES_APART * gains[least]:
        cause = (
            f"the gain of {recordings[least].name} is {gains[least] / gains[most]:.3g} of that of "
            f"{recordings[most].name}: bring the logs to one scale (`scale`)"
        )
    message = f"the model (RMSE {rmse:.4g}) is no better than a straight line (RMSE {line:.4g}): {cause}"
    if not force:
        raise FitError(f"{message} (`force` keeps the model)")
    return message


def _expected_warnings(expected: Expectation, line: float) -> list[str]:
    """Warn of what is expected on new moves."""
    warnings = []
    if expected.rmse is not None and expected.rmse >= line:
        warnings.append(
            f"what is expected on new moves ({expected.rmse:.4g}) is no better than a straight line's error "
            f"on the logs ({line:.4g}): record more amplitudes and cycles before using the model"
        )
    return warnings


def _figures(
    prepared: Prepared,
    choice: Choice,
    fitted: Fitted,
    model: ActuatorModel,
    residuals: Sequence[Residual],
    checks: Sequence[Residual],
    rmse: float,
    line: float,
    cycle: float | None,
    expected: Expectation,
    begins: Sequence[float],
) -> dict[str, object]:
    """Everything the model file says of its fit; errors in the displacement's unit, times in seconds.

    ``begins`` is the first voltage of each log.
    """
    span = abs(prepared.scale)
    cross = rmse * choice.score.rmse / expected.fitted
    new_moves = expected.rmse
    gears = fitted.basis
    figures: dict[str, object] = {
        "method": "least-squares",
        "rmse": rmse,
        "rmse_percent": 100.0 * rmse / span,
        "cross_validated_rmse": cross,
        "cross_validated_percent": 100.0 * cross / span,
        "expected_rmse": new_moves,
        "expected_percent": None if new_moves is None else 100.0 * new_moves / span,
        "expected_from": expected.words(),
        "left_out_rmse": expected.known,
        "straight_line_rmse": line,
        "fastest_drive": fastest_drive(prepared.logs),
    }
    figures |= validated(checks, span, "")[0]
    figures |= {
        "samples": sum(len(one.values) for one in residuals),
        "gears": model.backlash.n,
        "different_slopes": gears.gears,
        "points": len(fitted.knots) - 1 if len(fitted.knots) > 2 else 0,
        "drive_bend": gears.bend,
        "slopes": choice.structure.slopes,
        "smoothness": choice.structure.smoothness,
        "loop_width_percent": loop_width_percent(model),
        "relaxation_seconds": [
            float(t) for t, c in zip(gears.time_constants, fitted.gains, strict=True) if c > 0.0
        ],
        "delay_seconds": gears.delay,
        "delay_interval_seconds": list(choice.delay_interval) if choice.delay_interval else None,
        "lag_seconds": lag_seconds(fitted, cycle),
        "logs": _log_figures(prepared, residuals, begins),
    }
    return figures


def _log_figures(
    prepared: Prepared, residuals: Sequence[Residual], begins: Sequence[float]
) -> list[dict[str, object]]:
    """Return what the model file says of each log."""
    return [
        {
            "name": residual.name,
            "samples": len(residual.values),
            "rmse": residual.rmse,
            "drift": residual.drift_span,
            "begins_at": begins[k],
            "start": None if prepared.transient_rows[k] or log.stretches else log.start,
            "transient_rows": prepared.transient_rows[k],
            "outlier_rows": prepared.outlier_rows[k],
            "clipped_rows": prepared.clipped_rows[k],
        }
        for k, (residual, log) in enumerate(zip(residuals, prepared.logs, strict=True))
    ]


def _late_warnings(
    choice: Choice, prepared: Prepared, expected: Expectation, options: IdentificationOptions
) -> list[str]:
    """Warn of a pure delay that would break the expected error if it were the sensor's or the logger's.

    A stage and its amplifier lag; what comes late as a whole has mostly been delayed by a filter or a bus.
    Where a first-order lag explains the logs about as well, it need not be one.
    """
    if any(one.kind == "lag" and one.weight > np.exp(-1.0) for one in expected.alternatives):
        return []
    delay = choice.basis.delay
    if expected.rmse is None or options.sensor or options.delay is not None:
        return []
    cost = delay * abs(prepared.scale) / prepared.span * max(map(_usual_rate, prepared.logs))
    if delay < LATE * (sample_period(prepared.logs) or 0.0) or cost <= BROKEN * expected.rmse:
        return []
    return [
        f"the displacement is late by a pure delay of {1e3 * delay:.3g} ms, more often a sensor's or a "
        "logger's than an actuator's: if so, compensating it costs "
        f"{100.0 * cost / abs(prepared.scale):.2g} % of a move at the logs' speed (`sensor_delay` takes it "
        "off)"
    ]


def _usual_rate(log: PreparedLog) -> float:
    """Return the RMS rate of the voltage a second, 0 without a clock."""
    if log.seconds is None:
        return 0.0
    steps = np.diff(log.seconds)
    forward = steps > 0.0
    return rms(np.diff(log.voltage)[forward] / steps[forward])


def fastest_drive(logs: Sequence[PreparedLog]) -> float | None:
    """Rate of the voltage a second that one of the logs exceeds in 2 % of its steps; None without a clock."""
    found = []
    for log in logs:
        if log.seconds is None:
            return None
        steps = np.diff(log.seconds)
        forward = steps > 0.0
        rates = np.abs(np.diff(log.voltage)[forward]) / steps[forward]
        found.append(float(np.percentile(rates, FASTEST)) if rates.size else 0.0)
    return max(found)


def lag_seconds(fitted: Fitted, cycle: float | None) -> float:
    """Lag of the displacement in seconds at the logs' own frequency, the loop's own lag left out.

    To a slow sine of angular frequency w the gears answer with their mean slope s, a memory with
    c / (1 + i w tau): together a gain whose phase, over w, is a time; the delay adds to it.

    Parameters
    ----------
    fitted : the model in normalised terms
    cycle : duration of a cycle in seconds, None without a clock
    """
    if cycle is None or not len(fitted.gains):
        return fitted.basis.delay
    w = 2.0 * np.pi / cycle
    gain = (
        fitted.heights.sum() + (fitted.gains / (1.0 + 1j * w * np.asarray(fitted.basis.time_constants))).sum()
    )
    return fitted.basis.delay - float(np.angle(gain)) / w


def _summary(
    figures: dict[str, object],
    model: ActuatorModel,
    prepared: Prepared,
    checks: Sequence[Residual],
    sensor: Sensor,
) -> list[str]:
    """Lines for the person at the terminal."""
    unit = f" {model.output.unit}" if model.output.unit else ""
    volt = f" {model.input.unit}" if model.input.unit else ""
    fitted = (
        f"fit RMSE {figures['rmse']:.4g}{unit} ({figures['rmse_percent']:.2f} % of range), a straight line's "
        f"{figures['straight_line_rmse']:.4g}{unit}"
    )
    if figures["expected_rmse"] is None:
        lines = [f"what error to expect on new moves cannot be told: {figures['expected_from']}", fitted]
    else:
        lines = [
            f"expected on new moves inside the range: {figures['expected_rmse']:.4g}{unit} "
            f"({figures['expected_percent']:.2f} %); {fitted}"
        ]
    lines.extend(validated(checks, abs(prepared.scale), unit)[1])
    lines.append(
        f"loop {figures['loop_width_percent']:.1f} % of range, drive {prepared.low:g} to "
        f"{prepared.high:g}{volt}; {figures['gears']} gears, {figures['points']} segments of asymmetry"
    )
    lines.append(_lag_line(figures, sensor))
    lines.extend(
        f"{log.name}: sensor drift of {drift:.3g}{unit} fitted beside the model and left out of it"
        for log, drift in zip(prepared.logs, _drifts(figures), strict=True)
        if drift > 0.002 * abs(prepared.scale)
    )
    return lines


def _drifts(figures: dict[str, object]) -> list[float]:
    logs = figures["logs"]
    assert isinstance(logs, list)
    return [float(log["drift"]) for log in logs]


def _lag_line(figures: dict[str, object], sensor: Sensor) -> str:
    """Say what lag was found and what becomes of it; ``show`` says how well it is determined."""
    lag = figures["lag_seconds"]
    assert isinstance(lag, float)
    line = f"lag {1e3 * lag:.3g} ms"
    if sensor:
        return (
            f"{line}; the sensor's delay of {1e3 * sensor.delay:.3g} ms and lag of {1e3 * sensor.lag:.3g} ms "
            "were taken off before and are not compensated"
        )
    return line + (f", {WHOSE_LAG}" if lag > 0.0 else "")
