"""What is in a model, from its data: a screen of text, or the same as JSON."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any

from dbo_cli import extensions
from dbo_cli.errors import UsageError, suffix_of
from dbo_cli.hysteresis.cascade import OtherHysteresis, Stage
from dbo_cli.hysteresis.dynamics import Lag, latency_text
from dbo_cli.hysteresis.model import (
    SIGN_VERBS,
    ActuatorModel,
    BacklashStage,
    PointStage,
)
from dbo_cli.hysteresis.model_file import is_set, read_model, read_set, section_values
from dbo_cli.hysteresis.model_state import Quantity
from dbo_cli.logs.request import Address, check_document
from dbo_cli.logs.whole_output import write_whole

WIDTH = 96  # characters of a line on the screen
# of `fit`: elsewhere, or long
APART = ("notes", "warnings", "logs", "validation", "alternatives", "swings")


def show_model(
    model_file: str,
    output: Address,
    form: str | None,
    figures: str | None,
    brought: Mapping[str, Any] = MappingProxyType({}),
) -> list[str]:
    """Write what is in a model or a set of them; returns notes (where figures went).

    ``brought``: what the options that extras bring were given; each adds a part to what
    is shown of a model.
    """
    chosen = form or ("json" if output.text.lower().endswith(".json") else "text")
    if is_set(model_file):
        for name in brought:
            raise UsageError(
                f"`{name}` is of one model, and {model_file} is a set ({model_file}::CHANNEL)"
            )
        if figures is not None:
            raise UsageError(
                f"`figures` draws one model, and {model_file} is a set: name one ({model_file}::CHANNEL)"
            )
        check_document(output, "what is shown", chosen)
        text = extensions.find("run", "show a set")(read_set(model_file), chosen)
    else:
        model = read_model(model_file)
        check_document(output, "what is shown", chosen)
        if figures is not None:
            from dbo_cli.reports.drawing import check_folder, save

            folder = check_folder(figures)
        content = contents(model)
        forward = model if model.direction == "forward" else model.inverse()
        for name, value in brought.items():
            content |= extensions.find("run", f"show --{name}")(forward, value)
        if chosen == "json":
            text = json.dumps(content, indent=2, ensure_ascii=False)
        else:
            text = as_text(content)
    write_whole(output, (text + "\n").encode(), protect=[model_file])
    if figures is None:
        return []
    from dbo_cli.reports.models import plots_of_model

    save(plots_of_model(model), folder, "model")
    return [f"figures are in {figures}"]


def contents(model: ActuatorModel) -> dict[str, Any]:
    """Return what is in a model as plain values; lengths and voltages in the model's units, times in s."""
    fit, provenance = model.fit, model.provenance
    gears, relaxation_seconds = _gears_and_relaxation(model)
    # between the drive and the gears
    before = model.head if model.direction == "forward" else model.tail
    dynamics = model.dynamics.sections if model.dynamics else ()
    return {
        "format": "dbo-show",
        "version": 1,
        "direction": model.direction,
        "input": _quantity(model.input),
        "output": _quantity(model.output),
        "sign": model.sign,
        "gears": gears,
        "operator": model.size,
        "segments": _segments(model.stages),
        "segments_at_the_drive": 0 if gears is None else sum(_segments(before)),
        "relaxation_seconds": relaxation_seconds,
        "delay_seconds": model.delay_seconds,
        "dynamics": [section_values(section) for section in dynamics],
        "drive_lag_seconds": _drive_lag_seconds(model),
        "fit": {key: value for key, value in fit.items() if key not in APART},
        "logs": fit.get("logs", []),
        "validation": fit.get("validation", []),
        "notes": fit.get("notes", []),
        "warnings": fit.get("warnings", []),
        "program": provenance.get("program"),
        "arguments": provenance.get("arguments", []),
        "inputs": provenance.get("inputs", []),
    }


def _gears_and_relaxation(model: ActuatorModel) -> tuple[int | None, list[float]]:
    """Return the number of gears, None of another operator, and the time constants (s) of the relaxation."""
    gears = None
    seconds: list[float] = []
    for stage in model.stages:
        if isinstance(stage, BacklashStage):
            gears = stage.n
        if isinstance(stage, BacklashStage | OtherHysteresis) and stage.relaxation:
            seconds = list(stage.relaxation.tau)
    return gears, seconds


def _segments(stages: Iterable[Stage]) -> list[int]:
    """Return the segments of each asymmetry among some stages."""
    return [stage.m for stage in stages if isinstance(stage, PointStage)]


def _drive_lag_seconds(model: ActuatorModel) -> float | None:
    """Return the time constant (s) of a lag before the gears, where there is one."""
    if model.drive_lag is not None:
        for section in model.drive_lag.sections:
            if isinstance(section, Lag):
                return section.seconds
    return None


def as_text(content: Mapping[str, Any]) -> str:
    """Return the contents as lines for a terminal."""
    source, made = content["input"], content["output"]
    lines = [
        f"{content['direction']} model: {_range(source)} to {_range(made)}",
        f"{made['quantity']} {SIGN_VERBS[content['sign']]} as {source['quantity']} rises",
        content["operator"] + _asymmetry(content) + _lag(content),
    ]
    lines += _moving(content)
    if "settling" in content:
        lines.append(_settling_line(content["settling"]))
    lines += _goodness(content, made["unit"])
    if content["inputs"]:
        names = ", ".join(_log_with_rows(log) for log in content["inputs"])
        lines.append(f"from {names}, by {content['program']}")
    if content["arguments"]:
        lines.append("dbo " + " ".join(map(str, content["arguments"])))
    lines += [f"note: {text}" for text in content["notes"]]
    lines += [f"warning: {text}" for text in content["warnings"]]
    wrapper = textwrap.TextWrapper(
        width=WIDTH, subsequent_indent="  ", break_long_words=False
    )
    return "\n".join(map(wrapper.fill, lines))


def _settling_line(settling: Mapping[str, Any]) -> str:
    line = (
        f"settling: {settling['seconds']:.3g} s after a step over the whole drive, until creep and "
        f"ringing stay within {settling['distance']:.6g} {settling['unit'] or ''}"
    ).rstrip()
    if "hint" in settling:
        line += f" ({settling['hint']})"
    return line


def _log_with_rows(log: Mapping[str, Any]) -> str:
    """Return the name of a log, with those joined to it, and its rows."""
    names = [part["name"] for part in [log, *log.get("joined", ())]]
    return f"{' and '.join(names)} ({log['rows']:,} rows)"


def _moving(content: Mapping[str, Any]) -> list[str]:
    """Return the dynamics, and how fast the model can be trusted."""
    before = content["drive_lag_seconds"]
    parts = []
    if before:
        gears = content["operator"].split()[-1]
        parts.append(f"a lag of {latency_text(before)} before the {gears}")
    for section in content["dynamics"]:
        if section.get("lead"):
            late = 100.0 * (1.0 - section["lead"] / section["lag"])
            parts.append(f"creep of {late:.2g} % with {section['lag']:.3g} s")
            continue
        if "lag" in section:
            parts.append(f"a lag of {latency_text(section['lag'])}")
            continue
        parts.append(
            f"a resonance at {section['frequency']:.5g} Hz, damping {section['damping']:.3g}"
        )
        if "antiresonance" in section:
            parts[-1] += (
                f", with an antiresonance at {section['antiresonance']['frequency']:.5g} Hz"
            )
    lines = []
    if parts:
        lines.append(f"dynamics: {'; '.join(parts)}")
    trusted = content["fit"].get("trusted_hz")
    if trusted is not None:
        lines.append(f"trust it to {trusted:.3g} Hz")
    return lines


def _goodness(content: Mapping[str, Any], unit: str | None) -> list[str]:
    """Return how well the model fits and what that is worth."""
    fit: Mapping[str, Any] = content["fit"]
    suffix = suffix_of(unit)
    lines = []
    if fit.get("rmse") is not None:
        lines.append(_fit_line(fit, suffix))
    lines += _uncertainty(content)
    lines += _expectation(fit, suffix)
    for log in content["validation"]:
        lines.append(
            f"validated: RMSE {log['rmse']:.4g}{suffix} on {log['name']}, which took no part in the fit"
        )
    if fit.get("loop_width_percent") is not None:
        lines.append(_loop_line(fit))
    return lines + _lateness(fit)


def _fit_line(fit: Mapping[str, Any], suffix: str) -> str:
    """Return how well the model fits the rows that it was identified from."""
    line = f"fit: RMSE {fit['rmse']:.4g}{suffix}"
    if fit.get("rmse_percent") is not None:
        line += f" ({fit['rmse_percent']:.2f} % of the model's range)"
    line += " on the rows it was identified from"
    if fit.get("cross_validated_rmse") is not None:
        line += f", {fit['cross_validated_rmse']:.4g}{suffix} on cycles left out"
    if fit.get("straight_line_rmse") is not None:
        line += f"; a straight line leaves {fit['straight_line_rmse']:.4g}{suffix}"
    return line


def _expectation(fit: Mapping[str, Any], suffix: str) -> list[str]:
    """Return what error to expect of new moves, and its parts."""
    why = fit.get("expected_from")
    if fit.get("expected_rmse") is None:
        return [f"expect: cannot be told: {why}"] if why else []
    line = (
        f"expect: RMSE {fit['expected_rmse']:.4g}{suffix} on new moves inside the range"
    )
    if why:
        line += f", from {why}"
    shape, zero = fit.get("expected_shape_rmse"), fit.get("expected_zero")
    if shape is None or zero is None:
        return [line]
    parts = (
        f"in parts: {shape:.3g}{suffix} shape (RMS of the error less its mean), "
        f"{zero:.3g}{suffix} zero (that mean; {fit['zero_from']})"
    )
    return [line, parts]


def _loop_line(fit: Mapping[str, Any]) -> str:
    """Return how wide the loop is, and how its slopes run."""
    width = f"{fit['loop_width_percent']:.1f} % of the model's range"
    line = f"loop: {width} wide, which the model undoes"
    if fit.get("slopes"):
        line += f"; {fit['slopes']} slopes"
    if fit.get("drive_bend"):
        line += f", drive bent by {100.0 * fit['drive_bend']:.0f} %"
    return line


def _uncertainty(content: Mapping[str, Any]) -> list[str]:
    """Return what was known of the displacement's uncertainty: that of its rows, and that of its scale."""
    lines = []
    columns = []
    for log in content["inputs"]:
        column = log.get("read", {}).get("columns", {}).get("uncertainty")
        if column is not None and column["column"] not in columns:
            columns.append(column["column"])
    if columns:
        names = " and ".join(f"'{name}'" for name in columns)
        lines.append(
            f"rows count by their uncertainty, column {names}, and do so in the RMSE"
        )
    fit = content["fit"]
    percent, gain = fit.get("scale_uncertainty_percent"), fit.get("gain")
    known = fit.get("gain_uncertainty")
    if percent is None or gain is None or known is None:
        return lines
    drive, made = content["input"]["unit"], content["output"]["unit"]
    if content["direction"] == "inverse":
        drive, made = made, drive
    unit = f" {made}/{drive}" if made and drive else ""
    lines.append(
        f"gain: {gain:.6g}{unit} from end to end, standard uncertainty {known:.2g}{unit}, of which the "
        f"displacement's scale is {percent:.3g} %"
    )
    return lines


def _lateness(fit: Mapping[str, Any]) -> list[str]:
    """Return how late the displacement is, how well that is known, and whose lag it is."""
    if not fit.get("lag_seconds"):
        return []
    line = f"lag: {latency_text(fit['lag_seconds'])} at the logs' own frequency"
    low, high = fit.get("delay_interval_seconds") or (0.0, 0.0)
    if high > low:
        line += f"; a delay from {latency_text(low)} to {latency_text(high)} explains the logs as well"
    if "sensor" not in fit and fit["lag_seconds"] > 0.0:
        line += (
            "; whether the actuator or its sensor is late a log cannot tell: all of it is compensated "
            "(identify --sensor-delay, --sensor-lag takes the sensor's part off)"
        )
    return [line]


def _asymmetry(content: Mapping[str, Any]) -> str:
    """Return how many segments the points have, and on which side of the gears where they stand on both."""
    before, every = content["segments_at_the_drive"], sum(content["segments"])
    if 0 < before < every:
        behind = every - before
        return f", bent by {before} straight pieces on the drive's side and {behind} on the displacement's"
    if not every:
        return ""
    return f", bent by a curve of {every} straight pieces"


def _lag(content: Mapping[str, Any]) -> str:
    seconds = ", ".join(f"{tau:.3g}" for tau in content["relaxation_seconds"])
    text = "; no lag, no creep"
    if seconds:
        text = f"; lag and creep with time constants of {seconds} s"
    delay = content["delay_seconds"]
    if delay:
        text += f"; a delay of {latency_text(delay)}"
    return text


def _quantity(quantity: Quantity) -> dict[str, Any]:
    return {
        "quantity": quantity.quantity,
        "unit": quantity.unit,
        "min": quantity.minimum,
        "max": quantity.maximum,
    }


def _range(quantity: Mapping[str, Any]) -> str:
    low, high = f"{quantity['min']:.6g}", f"{quantity['max']:.6g}"
    return f"{quantity['quantity']} {low} to {high}{suffix_of(quantity['unit'])}"
