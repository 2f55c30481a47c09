"""Identification of gears, memories, asymmetry and delay: all but dynamics, from recordings to a model."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dbo_cli.errors import FitError
from dbo_cli.hysteresis.identification.cleaning import (
    Sensor,
    cleaned,
    drive_range,
    within,
)
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
from dbo_cli.hysteresis.identification.finalists import best_of, fit, model_of
from dbo_cli.hysteresis.identification.output_error import Candidate
from dbo_cli.hysteresis.identification.preparation import Prepared, prepare
from dbo_cli.hysteresis.identification.recordings import (
    Floats,
    IdentificationOptions,
    Recording,
    median_cycle_seconds,
    without_voltage_glitches,
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
    sensor, given = Sensor.of(options), recordings
    sensor.check(cycle)
    recordings, said = without_voltage_glitches(
        [sensor.taken_off(log) for log in recordings]
    )
    ends = drive_range(recordings)
    logs = [cleaned(log) for log in recordings]
    recordings = within([one.recording for one in logs], ends)
    said += [note for one in logs for note in one.notes]
    # Where dynamics are looked for, or left out, what swings at the beginning is no
    # history.
    at_rest = options.dynamics is None
    prepared = prepare(
        recordings, options.skip_seconds, [one.bad for one in logs], ends, at_rest
    )
    choice = choose(prepared, options, cycle)
    finalist = best_of(prepared, choice, options)
    choice = dataclasses.replace(
        choice, basis=finalist.basis, structure=finalist.structure
    )
    if finalist.beaten and not options.force:
        raise FitError(
            f"{finalist.beaten}; {_lacking(prepared)} (`force` keeps the model)"
        )
    fitted = fit(prepared.logs, finalist)
    model = model_of(fitted, prepared, recordings[0], options.zero, options.gears)
    pairs = list(zip(recordings, prepared.logs, strict=True))
    residuals = [residual_of(model, log, ready) for log, ready in pairs]
    line = pooled([straight_line(log, ready) for log, ready in pairs], residuals)
    rmse = pooled([one.rmse for one in residuals], residuals)
    if not any(tau > slowest_lag(cycle) for tau in fitted.basis.time_constants):
        # no creep was taken in its place
        prepared = dataclasses.replace(prepared, doubtful_drift=0.0)
    warnings = [
        *warned,
        *log_warnings(recordings, prepared.shapes),
        *rated_warnings(prepared.low, prepared.high, options.rated),
        *fit_warnings(recordings, prepared, choice, residuals),
        *swapped_warnings(given, choice.clockwise),
        *([] if clocked else [NO_CLOCK]),
    ]
    if finalist.beaten:
        warnings.append(finalist.beaten)
    if rmse > NO_BETTER * line:
        warnings.append(_no_loop(recordings, prepared, rmse, line, options.force))
    checks = [
        validation_of(model, sensor.taken_off(log), options.skip_seconds)
        for log in validation
    ]
    noise = white_noise([one.weighted for one in residuals]) / max(rmse, TINY) ** 2
    expected = expect(
        prepared, choice, model, rmse, noise, *_zero_drift(residuals, recordings)
    )
    figures = _figures(
        prepared,
        choice,
        fitted,
        model,
        residuals,
        checks,
        rmse,
        line,
        cycle,
        expected,
        given,
    )
    warnings += _drift_warnings(residuals, abs(prepared.scale), model.output.unit)
    if expected.shape is not None and expected.shape >= line:
        remedy = _scales_apart(recordings) or RECORD_MORE
        warnings.append(NO_BETTER_THAN_LINE.format(expected.shape, line, remedy))
    if not sensor and options.delay is None:
        warnings += _late_warnings(choice, prepared, expected)
    notes = fit_notes(
        model.output.unit,
        prepared,
        choice.clockwise,
        expected.gain_trend,
        expected.forgets,
    )
    summary = (
        said
        + prepared.notes
        + _summary(figures, model, prepared, residuals, checks, sensor)
        + notes
    )
    figures |= (
        {"notes": notes} | _for_use(expected, sensor) | {"warnings": list(warnings)}
    )
    figures["alternatives"] = [one.values() for one in expected.alternatives]
    return Identification(
        dataclasses.replace(model, fit=figures), figures, summary, warnings
    )


def _zero_drift(
    residuals: Sequence[Residual], recordings: Sequence[Recording]
) -> tuple[float, float]:
    """Return how far the zero moved along the log on which it moved most, and how fast, a second."""
    most = max(range(len(residuals)), key=lambda place: residuals[place].drift_span)
    seconds = recordings[most].seconds()
    lasted = 0.0 if seconds is None else float(seconds[-1] - seconds[0])
    span = residuals[most].drift_span
    rate = span / lasted if lasted > 0.0 else 0.0
    return span, rate


def _for_use(expected: Expectation, sensor: Sensor) -> dict[str, object]:
    """Return what is known of the sensor, of the gain, and of the logs' swings, for the model file."""
    taken_off = {"delay": sensor.delay, "lag": sensor.lag} if sensor else None
    found = {
        "sensor": taken_off,
        "gain_trend": expected.gain_trend,
        "swings": expected.swing_values(),
    }
    return {key: value for key, value in found.items() if value is not None}


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


def _no_loop(
    recordings: Sequence[Recording],
    prepared: Prepared,
    rmse: float,
    line: float,
    force: bool,
) -> str:
    """Refuse a model that is no better than a straight line (FitError), or say so where it is kept."""
    cause = _scales_apart(recordings) or (
        "the log shows no loop that this class of models can follow, nor do gears alone; "
        + _lacking(prepared)
    )
    message = f"the model (RMSE {rmse:.4g}) is no better than a straight line (RMSE {line:.4g}): {cause}"
    if not force:
        raise FitError(f"{message} (`force` keeps the model)")
    return message


def _drift_warnings(
    residuals: Sequence[Residual], span: float, unit: str | None
) -> list[str]:
    """Warn of a drift so large that it is more likely the actuator's than the sensor's."""
    of_what = f" {unit}" if unit else ""
    warnings = []
    for one in residuals:
        share = one.drift_span / span
        if share > LARGE_DRIFT:
            warnings.append(
                f"{one.name}: {one.drift_span:.3g}{of_what} of the displacement ({100.0 * share:.0f} % of "
                "the range) was taken for a drift of the sensor and is not in the model: if the actuator "
                "itself moved so, its loops do not close and no model of this class follows it"
            )
    return warnings


def _figures(
    prepared: Prepared,
    choice: Choice,
    fitted: Candidate,
    model: ActuatorModel,
    residuals: Sequence[Residual],
    checks: Sequence[Residual],
    rmse: float,
    line: float,
    cycle: float | None,
    expected: Expectation,
    given: Sequence[Recording],
) -> dict[str, object]:
    """Everything the model file says of its fit; errors in the displacement's unit, times in seconds."""
    span = abs(prepared.scale)
    cross = rmse * choice.score.rmse / expected.fitted
    gears = fitted.basis
    taus = zip(gears.time_constants, fitted.gains, strict=True)
    return {
        "method": "least-squares",
        "rmse": rmse,
        "rmse_percent": 100.0 * rmse / span,
        "cross_validated_rmse": cross,
        "cross_validated_percent": 100.0 * cross / span,
        **_expected_figures(expected, span, model.output.suffix),
        "straight_line_rmse": line,
        "fastest_drive": fastest_drive(prepared.logs),
        **validated(checks, span, "")[0],
        "samples": sum(len(one.values) for one in residuals),
        "gears": model.backlash.n,
        "different_slopes": gears.gears,
        "points": len(fitted.knots) - 1 if len(fitted.knots) > 2 else 0,
        "drive_bend": gears.bend,
        "slopes": choice.structure.slopes,
        "smoothness": choice.structure.smoothness,
        "loop_width_percent": loop_width_percent(model),
        "relaxation_seconds": [float(tau) for tau, gain in taus if gain > 0.0],
        "delay_seconds": gears.delay,
        "delay_interval_seconds": list(choice.delay_interval)
        if choice.delay_interval
        else None,
        "lag_seconds": lag_seconds(fitted, cycle),
        "logs": [
            {
                "name": residual.name,
                "samples": len(residual.values),
                "rmse": residual.rmse,
                "drift": residual.drift_span,
                "begins_at": float(given[k].voltage[0]),
                "start": None
                if prepared.transient_rows[k] or log.stretches
                else log.start,
                "transient_rows": prepared.transient_rows[k],
                "outlier_rows": prepared.outlier_rows[k],
                "clipped_rows": prepared.clipped_rows[k],
            }
            for k, (residual, log) in enumerate(
                zip(residuals, prepared.logs, strict=True)
            )
        ],
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


def _late_warnings(
    choice: Choice, prepared: Prepared, expected: Expectation
) -> list[str]:
    """Warn of a pure delay that would break the expected error if it were the sensor's or the logger's.

    A stage and its amplifier lag; what comes late as a whole has mostly been delayed by
    a filter or a bus. Where a first-order lag explains the logs about as well, it need
    not be one.
    """
    delay = choice.basis.delay
    lags_as_well = any(
        one.kind == "lag" and one.weight > np.exp(-1.0) for one in expected.alternatives
    )
    if not delay or expected.rmse is None or lags_as_well:
        return []
    rate = max(rms(_rates(log)) for log in prepared.logs)
    cost = delay * abs(prepared.scale) / prepared.span * rate
    if (
        delay < LATE * (sample_period(prepared.logs) or 0.0)
        or cost <= BROKEN * expected.rmse
    ):
        return []
    return [
        f"the displacement is late by a pure delay of {1e3 * delay:.3g} ms, more often a sensor's or a "
        "logger's than an actuator's: if so, compensating it costs "
        f"{100.0 * cost / abs(prepared.scale):.2g} % of a move at the logs' speed (`sensor_delay` takes it "
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
    rates = [_rates(log) for log in logs]
    return max(float(np.percentile(one, FASTEST)) if one.size else 0.0 for one in rates)


def lag_seconds(fitted: Candidate, cycle: float | None) -> float:
    """Lag of the displacement in seconds at the logs' own frequency, the loop's own lag left out.

    To a slow sine of angular frequency w the gears answer with their mean slope s, a
    memory with c / (1 + i w tau): together a gain whose phase, over w, is a time; the
    delay adds to it.

    Parameters
    ----------
    fitted : the model in normalised terms
    cycle : duration of a cycle in seconds, None without a clock
    """
    if cycle is None or not len(fitted.gains):
        return fitted.basis.delay
    w = 2.0 * np.pi / cycle
    gain = (
        fitted.heights.sum()
        + (
            fitted.gains / (1.0 + 1j * w * np.asarray(fitted.basis.time_constants))
        ).sum()
    )
    return fitted.basis.delay - float(np.angle(gain)) / w


def _summary(
    figures: dict[str, object],
    model: ActuatorModel,
    prepared: Prepared,
    residuals: Sequence[Residual],
    checks: Sequence[Residual],
    sensor: Sensor,
) -> list[str]:
    """Lines for the person at the terminal; ``show`` says how well the lag is determined."""
    unit = f" {model.output.unit}" if model.output.unit else ""
    volt = f" {model.input.unit}" if model.input.unit else ""
    fitted = (
        f"fit RMSE {figures['rmse']:.4g}{unit} ({figures['rmse_percent']:.2f} %), a straight line's "
        f"{figures['straight_line_rmse']:.4g}{unit}"
    )
    if figures["expected_rmse"] is None:
        lines = [
            f"what error to expect on new moves cannot be told: {figures['expected_from']}",
            fitted,
        ]
    else:
        lines = [
            f"expected on new moves inside the range: {figures['expected_rmse']:.4g}{unit} "
            f"({figures['expected_percent']:.2f} % of the model's range); {fitted}",
            f"in parts: {parts_words(figures, unit)}",
        ]
    lines.extend(validated(checks, abs(prepared.scale), unit)[1])
    lines.append(
        f"loop {figures['loop_width_percent']:.1f} % of the model's range, drive {prepared.low:g} to "
        f"{prepared.high:g}{volt}; {figures['gears']} gears, {asymmetry_words(figures['points'])}"
    )
    lag = figures["lag_seconds"]
    assert isinstance(lag, float)
    whose = f", {WHOSE_LAG}" if lag > 0.0 else ""
    if sensor:
        whose = (
            f"; the sensor's delay of {1e3 * sensor.delay:.3g} ms and lag of {1e3 * sensor.lag:.3g} ms "
            "were taken off before and are not compensated"
        )
    lines.append(f"lag {1e3 * lag:.3g} ms{whose}")
    lines.extend(
        f"{one.name}: sensor drift of {one.drift_span:.3g}{unit} fitted beside the model and left out of it"
        for one in residuals
        if one.drift_span > 0.002 * abs(prepared.scale)
    )
    return lines
