"""Identification of gears, memories, asymmetry and delay: all but dynamics, from recordings to a model.

``identify_static`` is the whole story, a step a line: the logs are cleaned and
prepared, structures are searched and the last candidates compared, what is chosen is
refined, becomes a model, and is judged on its logs; then comes what to expect of it on
new moves. What stands below it puts that into figures, warnings and plain words.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from dbo_cli.errors import FitError
from dbo_cli.hysteresis.dynamics import latency_text
from dbo_cli.hysteresis.identification.cleaning import Sensor, clean
from dbo_cli.hysteresis.identification.evaluation import (
    WHOSE_LAG,
    Judged,
    Residual,
    fit_notes,
    fit_warnings,
    judge,
    log_warnings,
    loop_width_percent,
    rated_warnings,
    swapped_warnings,
    validated,
    validations_of,
)
from dbo_cli.hysteresis.identification.expectation import Expectation, expect
from dbo_cli.hysteresis.identification.finalists import best_of, fit, model_of
from dbo_cli.hysteresis.identification.output_error import Candidate
from dbo_cli.hysteresis.identification.preparation import Prepared, prepare
from dbo_cli.hysteresis.identification.recordings import (
    Floats,
    IdentificationOptions,
    Recording,
    median_cycle_seconds,
)
from dbo_cli.hysteresis.identification.search import (
    Choice,
    choose,
    sample_period,
    slowest_lag,
)
from dbo_cli.hysteresis.identification.statistics import PreparedLog
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.move_error import rms

# of the straight line's RMSE: above this there is nothing but a line in the log
NO_BETTER = 0.95

# times the expected error: what makes a move err by more is warned of, or refused of a
# prior
BROKEN = 2.0

LATE = 2.0
"""Sample periods: a shorter delay is no evidence of one, since a first-order lag looks alike. Measured:
docs/choices.md.
"""

# of the range: a sensor that drifts more is broken, or it is no sensor's drift
LARGE_DRIFT = 0.05

# of the range: a drift of the sensor below it is not worth a word
WORTH_A_WORD = 0.002

FASTEST = 98.0  # percentile of a log's rates: its few fastest steps are jumps and noise


@dataclass(frozen=True)
class Identification:
    """A model and what must be said of it: ``summary`` and ``warnings`` are lines of plain words."""

    model: ActuatorModel
    fit: dict[str, object]
    summary: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


NO_BETTER_THAN_LINE = (
    "what is expected on new moves ({:.4g}) is no better than a straight line's error on the logs "
    "({:.4g}): {}"
)
RECORD_MORE = "record more amplitudes and cycles before using the model"
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
    """Identify a model without dynamics from recordings that were checked (see ``methods``).

    Parameters
    ----------
    warned : warnings that come before those found here

    Raises
    ------
    FitError
        Nothing trustworthy can be identified.
    """
    notes: list[str] = []
    cycle = median_cycle_seconds(recordings)
    sensor = Sensor.of(options)
    sensor.check(cycle)
    # Where dynamics are looked for, or left out, what swings at the beginning is no
    # history.
    at_rest = options.dynamics is None

    logs, ends = clean(recordings, sensor, notes)
    prepared = prepare(logs, options.skip_seconds, ends, at_rest)
    choice = choose(prepared, options, cycle)
    finalist = best_of(prepared, choice, options)
    _refuse_beaten(finalist, prepared, options)
    candidate = fit(prepared.logs, finalist)
    model = model_of(candidate, prepared, logs[0], options.zero, options.gears)
    judged = judge(model, logs, prepared.logs)
    _refuse_straight_line(judged, logs, prepared, options)
    checks = validations_of(model, validation, sensor, options.skip_seconds)
    choice = replace(choice, basis=finalist.basis, structure=finalist.structure)
    expected = expect(prepared, choice, model, judged)

    return _stated(
        _Result(
            options=options,
            sensor=sensor,
            given=recordings,
            logs=logs,
            cycle=cycle,
            prepared=prepared,
            choice=choice,
            candidate=candidate,
            model=model,
            judged=judged,
            checks=checks,
            expected=expected,
        ),
        notes,
        warned,
    )


@dataclass(frozen=True)
class _Result:
    """What the steps of an identification led to: figures, warnings and lines are made of it.

    ``given`` are the logs as they came, ``logs`` the same after cleaning; ``cycle`` is
    the median duration of a cycle in seconds, None without a clock.
    """

    options: IdentificationOptions
    sensor: Sensor
    given: Sequence[Recording]
    logs: Sequence[Recording]
    cycle: float | None
    prepared: Prepared
    choice: Choice
    candidate: Candidate
    model: ActuatorModel
    judged: Judged
    checks: Sequence[Residual]
    expected: Expectation

    @property
    def span(self) -> float:
        """Range of the displacement, in its unit."""
        return abs(self.prepared.scale)

    @property
    def unit(self) -> str:
        """The displacement's unit as it follows a number."""
        return self.model.output.suffix


def _stated(
    result: _Result, notes: Sequence[str], warned: Sequence[str]
) -> Identification:
    """Return the model with all that must be said of it; ``notes`` are of the cleaning."""
    warnings = [*warned, *_warnings(result)]
    remarks = _notes(result)
    figures = _figures(result)
    summary = [*notes, *result.prepared.notes, *_summary(figures, result), *remarks]
    figures |= {"notes": remarks} | _for_use(result) | {"warnings": list(warnings)}
    others = result.expected.alternatives
    figures["alternatives"] = [other.values() for other in others]
    model = replace(result.model, fit=figures)
    return Identification(model, figures, summary, warnings)


def _refuse_beaten(
    finalist: Candidate, prepared: Prepared, options: IdentificationOptions
) -> None:
    """Refuse (FitError) what predicts parts left out worse than something simpler does."""
    if finalist.beaten and not options.force:
        raise FitError(
            f"{finalist.beaten}; {_lacking(prepared)} (`force` keeps the model)"
        )


def _refuse_straight_line(
    judged: Judged,
    logs: Sequence[Recording],
    prepared: Prepared,
    options: IdentificationOptions,
) -> None:
    """Refuse (FitError) a model that is no better than a straight line."""
    if judged.rmse > NO_BETTER * judged.line and not options.force:
        why = _no_loop(judged, logs, prepared)
        raise FitError(f"{why} (`force` keeps the model)")


def _for_use(result: _Result) -> dict[str, object]:
    """Return what is known of the sensor, of the gain, and of the logs' swings, for the model file."""
    figures: dict[str, object] = {}
    if result.sensor:
        figures["sensor"] = {"delay": result.sensor.delay, "lag": result.sensor.lag}
    if result.expected.gain_trend is not None:
        figures["gain_trend"] = result.expected.gain_trend
    figures["swings"] = result.expected.swing_values()
    return figures


# between the gains of logs; a piezo's own at small and at full swings differs by less
SCALES_APART = 2.0


def _scales_apart(recordings: Sequence[Recording]) -> str | None:
    """Return what to do where the gains of logs are so far apart that their scales must be."""
    gains = [
        abs(float(np.polyfit(log.voltage, log.displacement, 1)[0]))
        for log in recordings
    ]
    least, most = int(np.argmin(gains)), int(np.argmax(gains))
    if gains[most] <= SCALES_APART * gains[least]:
        return None
    return (
        f"the gain of {recordings[least].name} is {gains[least] / gains[most]:.3g} of that of "
        f"{recordings[most].name}: bring the logs to one scale (`scale`)"
    )


FEWEST_CYCLES = 3  # with fewer nothing can be left out that the rest holds, too


def _lacking(prepared: Prepared) -> str:
    """Return what the logs lack, and what to record."""
    cycles = sum(shape.cycle_count for shape in prepared.shapes)
    if cycles < FEWEST_CYCLES:
        return f"the logs hold fewer than {FEWEST_CYCLES} whole cycles: record more"
    if prepared.one_amplitude:
        return "the logs hold one amplitude: record swings of several"
    if any(log.seconds is None for log in prepared.logs):
        return "the logs have no clock, so no lag could be looked for: name the time column (`time`)"
    return "cycles, amplitudes and a clock are there: check the columns and the sensor"


def _no_loop(judged: Judged, logs: Sequence[Recording], prepared: Prepared) -> str:
    """Return in words that a model is no better than a straight line, and why."""
    cause = _scales_apart(logs)
    if cause is None:
        cause = (
            "the log shows no loop that this class of models can follow, nor do gears alone; "
            + _lacking(prepared)
        )
    return (
        f"the model (RMSE {judged.rmse:.4g}) is no better than a straight line "
        f"(RMSE {judged.line:.4g}): {cause}"
    )


def _warnings(result: _Result) -> list[str]:
    """Return what to be careful about: of the logs, of the fit, of what to expect."""
    prepared, choice, judged = result.prepared, result.choice, result.judged
    warnings = log_warnings(result.logs, prepared.shapes)
    warnings += rated_warnings(prepared.low, prepared.high, result.options.rated)
    warnings += fit_warnings(result.logs, prepared, choice, judged.residuals)
    warnings += swapped_warnings(result.given, choice.clockwise)
    if any(log.seconds() is None for log in result.given):
        warnings.append(NO_CLOCK)
    if result.candidate.beaten:
        warnings.append(result.candidate.beaten)
    if judged.rmse > NO_BETTER * judged.line:
        warnings.append(_no_loop(judged, result.logs, prepared))
    warnings += _drift_warnings(judged.residuals, result.span, result.unit)
    shape = result.expected.shape
    if shape is not None and shape >= judged.line:
        remedy = _scales_apart(result.logs) or RECORD_MORE
        warnings.append(NO_BETTER_THAN_LINE.format(shape, judged.line, remedy))
    if not result.sensor and result.options.delay is None:
        warnings += _late_warnings(result)
    return warnings


def _drift_warnings(residuals: Sequence[Residual], span: float, unit: str) -> list[str]:
    """Warn of a drift so large that it is more likely the actuator's than the sensor's."""
    warnings = []
    for residual in residuals:
        share = residual.drift_span / span
        if share > LARGE_DRIFT:
            warnings.append(
                f"{residual.name}: {residual.drift_span:.3g}{unit} of the displacement "
                f"({100.0 * share:.0f} % of the range) was taken for a drift of the sensor and is not in "
                "the model: if the actuator itself moved so, its loops do not close and no model of this "
                "class follows it"
            )
    return warnings


def _notes(result: _Result) -> list[str]:
    """Return what is good to know of the logs."""
    prepared, expected = result.prepared, result.expected
    slowest = slowest_lag(result.cycle)
    creep = any(tau > slowest for tau in result.candidate.basis.time_constants)
    if not creep:  # none was taken in the place of a drift
        prepared = replace(prepared, doubtful_drift=0.0)
    return fit_notes(
        result.model.output.unit,
        prepared,
        result.choice.clockwise,
        expected.gain_trend,
        expected.forgets,
    )


def _figures(result: _Result) -> dict[str, object]:
    """Everything the model file says of its fit; errors in the displacement's unit, times in seconds."""
    span, expected, choice = result.span, result.expected, result.choice
    rmse, candidate = result.judged.rmse, result.candidate
    cross = rmse * choice.score.rmse / expected.fitted
    basis, segments = candidate.basis, candidate.structure.segments
    taus = zip(basis.time_constants, candidate.gains, strict=True)
    interval = choice.delay_interval
    return {
        "method": "least-squares",
        "rmse": rmse,
        "rmse_percent": 100.0 * rmse / span,
        "cross_validated_rmse": cross,
        "cross_validated_percent": 100.0 * cross / span,
        **_expected_figures(expected, span, result.model.output.suffix),
        "straight_line_rmse": result.judged.line,
        "fastest_drive": fastest_drive(result.prepared.logs),
        **validated(result.checks, span, "")[0],
        "samples": sum(len(residual.values) for residual in result.judged.residuals),
        "gears": result.model.backlash.n,
        "different_slopes": basis.gears,
        "points": segments if segments > 1 else 0,
        "drive_bend": basis.bend,
        "slopes": choice.structure.slopes,
        "smoothness": choice.structure.smoothness,
        "loop_width_percent": loop_width_percent(result.model),
        "relaxation_seconds": [float(tau) for tau, gain in taus if gain > 0.0],
        "delay_seconds": basis.delay,
        "delay_interval_seconds": None if interval is None else list(interval),
        "lag_seconds": lag_seconds(candidate, result.cycle),
        "logs": [_log_figures(result, place) for place in range(len(result.given))],
    }


def _log_figures(result: _Result, place: int) -> dict[str, object]:
    """Return what the model file says of one log."""
    prepared, residual = result.prepared, result.judged.residuals[place]
    log = prepared.logs[place]
    start = None if log.transient_rows or log.stretches else log.start
    return {
        "name": residual.name,
        "samples": len(residual.values),
        "rmse": residual.rmse,
        "drift": residual.drift_span,
        "begins_at": float(result.given[place].voltage[0]),
        "start": start,
        "transient_rows": log.transient_rows,
        "outlier_rows": log.outlier_rows,
        "clipped_rows": log.clipped_rows,
    }


def _expected_figures(
    expected: Expectation, span: float, unit: str
) -> dict[str, object]:
    """Return what error to expect on new moves, in its parts, and what that rests on."""
    rmse = expected.rmse
    return {
        "expected_rmse": rmse,
        "expected_percent": None if rmse is None else 100.0 * rmse / span,
        "expected_shape_rmse": expected.shape,
        "expected_zero": expected.zero,
        "expected_from": expected.words(),
        "zero_from": expected.zero_words(unit),
        "left_out_rmse": expected.known,
        "line_left_out_rmse": expected.line,
        "zero_drift": expected.zero_drift,
        "zero_drift_rate": expected.zero_drift_rate,
    }


def asymmetry_words(segments: object) -> str:
    """Return in words how many straight pieces bend the loop's two branches alike."""
    if not segments:
        return "no curve that bends the loop"
    return f"a curve of {segments} straight pieces that bends the loop"


def parts_words(figures: Mapping[str, Any], unit: str) -> str:
    """Return the two parts of the error expected on new moves, and under which condition they hold."""
    return (
        f"{figures['expected_shape_rmse']:.3g}{unit} shape (RMS of the error less its mean), "
        f"{figures['expected_zero']:.3g}{unit} zero (that mean; {figures['zero_from']})"
    )


def _late_warnings(result: _Result) -> list[str]:
    """Warn of a pure delay that would break the expected error if it were the sensor's or the logger's.

    A stage and its amplifier lag; what comes late as a whole has mostly been delayed by
    a filter or a bus. Where a first-order lag explains the logs about as well, it need
    not be one.
    """
    delay, expected = result.choice.basis.delay, result.expected
    lags_as_well = any(
        other.kind == "lag" and other.weight > np.exp(-1.0)
        for other in expected.alternatives
    )
    if not delay or expected.rmse is None or lags_as_well:
        return []
    logs = result.prepared.logs
    rate = max(rms(_rates(log)) for log in logs)
    cost = delay * result.span / result.prepared.span * rate
    period = sample_period(logs) or 0.0
    if delay < LATE * period or cost <= BROKEN * expected.rmse:
        return []
    return [
        f"the displacement is late by a pure delay of {latency_text(delay)}, more often a sensor's or a "
        "logger's than an actuator's: if so, compensating it costs "
        f"{100.0 * cost / result.span:.2g} % of a move at the logs' speed (`sensor_delay` takes it "
        "off)"
    ]


def _rates(log: PreparedLog) -> Floats:
    """Return how fast the voltage changes, a second, in each step that the clock makes; none without one."""
    if log.seconds is None:
        return np.zeros(0)
    steps = np.diff(log.seconds)
    forward = steps > 0.0
    rates: Floats = np.abs(np.diff(log.voltage)[forward]) / steps[forward]
    return rates


def fastest_drive(logs: Sequence[PreparedLog]) -> float | None:
    """Rate of the voltage a second that one of the logs exceeds in 2 % of its steps; None without a clock."""
    if any(log.seconds is None for log in logs):
        return None
    fastest = 0.0
    for log in logs:
        rates = _rates(log)
        if rates.size:
            fastest = max(fastest, float(np.percentile(rates, FASTEST)))
    return fastest


def lag_seconds(candidate: Candidate, cycle: float | None) -> float:
    """Lag of the displacement in seconds at the logs' own frequency, the loop's own lag left out.

    To a slow sine of angular frequency w the gears answer with their mean slope s, a
    memory with c / (1 + i w tau): together a gain whose phase, over w, is a time; the
    delay adds to it.

    Parameters
    ----------
    candidate : the model in normalised terms
    cycle : duration of a cycle in seconds, None without a clock
    """
    delay = candidate.basis.delay
    if cycle is None or not len(candidate.gains):
        return delay
    w = 2.0 * np.pi / cycle
    taus = np.asarray(candidate.basis.time_constants)
    memories = (candidate.gains / (1.0 + 1j * w * taus)).sum()
    gain = candidate.heights.sum() + memories
    return delay - float(np.angle(gain)) / w


def _summary(figures: Mapping[str, Any], result: _Result) -> list[str]:
    """Lines for the person at the terminal; ``show`` says how well the lag is determined."""
    unit, prepared = result.unit, result.prepared
    volt = result.model.input.suffix
    lines = _expected_lines(figures, unit)
    lines += validated(result.checks, result.span, unit)[1]
    lines.append(
        f"loop {figures['loop_width_percent']:.1f} % of the model's range, drive {prepared.low:g} to "
        f"{prepared.high:g}{volt}; {figures['gears']} gears, {asymmetry_words(figures['points'])}"
    )
    lines.append(_lag_line(figures["lag_seconds"], result.sensor))
    for residual in result.judged.residuals:
        if residual.drift_span > WORTH_A_WORD * result.span:
            lines.append(
                f"{residual.name}: sensor drift of {residual.drift_span:.3g}{unit} fitted "
                "beside the model and left out of it"
            )
    return lines


def _expected_lines(figures: Mapping[str, Any], unit: str) -> list[str]:
    """Return what error to expect on new moves, and what the fit left, in words."""
    fitted = (
        f"fit RMSE {figures['rmse']:.4g}{unit} ({figures['rmse_percent']:.2f} %), a straight line's "
        f"{figures['straight_line_rmse']:.4g}{unit}"
    )
    if figures["expected_rmse"] is None:
        return [
            f"what error to expect on new moves cannot be told: {figures['expected_from']}",
            fitted,
        ]
    return [
        f"expected on new moves inside the range: {figures['expected_rmse']:.4g}{unit} "
        f"({figures['expected_percent']:.2f} % of the model's range); {fitted}",
        f"in parts: {parts_words(figures, unit)}",
    ]


def _lag_line(lag: float, sensor: Sensor) -> str:
    """Return the lag in words, and what becomes of it."""
    line = f"lag {latency_text(lag)}"
    if sensor:
        return (
            f"{line}; the sensor's delay of {latency_text(sensor.delay)}"
            f" and lag of {latency_text(sensor.lag)}"
            " were taken off before and are not compensated"
        )
    return f"{line}, {WHOSE_LAG}" if lag > 0.0 else line
