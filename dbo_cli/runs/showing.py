"""What is in a model, from its data: a screen of text, or the same as JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from dbo_cli.hysteresis.dynamics import Lag
from dbo_cli.hysteresis.model import ActuatorModel, BacklashStage, DelayStage, PointStage
from dbo_cli.hysteresis.model_file import read_model, section_values
from dbo_cli.hysteresis.model_state import Quantity
from dbo_cli.logs.addresses import Address, check_document
from dbo_cli.logs.whole_output import write_whole

WIDTH = 96  # characters of a line on the screen


def show_model(model_file: str, output: Address, form: str | None, figures: str | None) -> list[str]:
    """Write what is in a model; returns notes (where figures went)."""
    model = read_model(model_file)
    chosen = form or ("json" if output.text.lower().endswith(".json") else "text")
    check_document(output, "what is shown", chosen)
    if figures is not None:
        from dbo_cli.reports.drawing import check_folder

        folder = check_folder(figures)
    content = contents(model)
    text = json.dumps(content, indent=2, ensure_ascii=False) if chosen == "json" else as_text(content)
    write_whole(output, (text + "\n").encode(), protect=[model_file])
    if figures is None:
        return []
    from dbo_cli.reports.drawing import save
    from dbo_cli.reports.models import plots_of_model

    save(plots_of_model(model), folder, "model")
    return [f"figures are in {figures}"]


def contents(model: ActuatorModel) -> dict[str, Any]:
    """Return what is in a model as plain values; lengths and voltages in the model's units, times in s."""
    fit, provenance = model.fit, model.provenance
    backlash = next((stage for stage in model.stages if isinstance(stage, BacklashStage)), None)
    delay = next((abs(s.seconds) for s in model.stages if isinstance(s, DelayStage)), 0.0)
    relaxation = list(backlash.relaxation.tau) if backlash and backlash.relaxation else []
    return {
        "format": "dbo-show",
        "version": 1,
        "direction": model.direction,
        "input": _quantity(model.input),
        "output": _quantity(model.output),
        "gears": backlash.n if backlash else None,
        "operator": model.size,
        "segments": [stage.m for stage in model.stages if isinstance(stage, PointStage)],
        "segments_at_the_drive": _at_the_drive(model),
        "relaxation_seconds": relaxation,
        "delay_seconds": delay,
        "dynamics": [section_values(one) for one in (model.dynamics.sections if model.dynamics else ())],
        "drive_lag_seconds": _drive_lag(model),
        "fit": {
            key: fit[key] for key in fit if key not in ("warnings", "logs", "validation", "alternatives")
        },
        "logs": fit.get("logs", []),
        "validation": fit.get("validation", []),
        "warnings": fit.get("warnings", []),
        "program": provenance.get("program"),
        "arguments": provenance.get("arguments", []),
        "inputs": provenance.get("inputs", []),
    }


def as_text(content: Mapping[str, Any]) -> str:
    """Return the contents as lines for a terminal."""
    given, made = content["input"], content["output"]
    lines = [
        f"{content['direction']} model: {_range(given)} to {_range(made)}",
        content["operator"] + _asymmetry(content) + _lag(content),
    ]
    lines += _moving(content)
    lines += _goodness(content, made["unit"])
    if content["inputs"]:
        names = ", ".join(
            f"{' and '.join(part['name'] for part in [one, *one.get('joined', ())])} ({one['rows']:,} rows)"
            for one in content["inputs"]
        )
        lines.append(f"from {names}, by {content['program']}")
    if content["arguments"]:
        lines.append("dbo " + " ".join(map(str, content["arguments"])))
    lines += [f"warning: {text}" for text in content["warnings"]]
    return "\n".join(_wrapped(line) for line in lines)


def _drive_lag(model: ActuatorModel) -> float | None:
    sections = model.drive_lag.sections if model.drive_lag else ()
    return next((one.seconds for one in sections if isinstance(one, Lag)), None)


def _moving(content: Mapping[str, Any]) -> list[str]:
    """Return the dynamics, and how fast the model can be trusted."""
    before = content["drive_lag_seconds"]
    parts = [f"a lag of {1e3 * before:.3g} ms before the gears"] if before else []
    for one in content["dynamics"]:
        if one.get("lead"):
            late = 100.0 * (1.0 - one["lead"] / one["lag"])
            parts.append(f"creep of {late:.2g} % with {one['lag']:.3g} s")
            continue
        if "lag" in one:
            parts.append(f"a lag of {1e3 * one['lag']:.3g} ms")
            continue
        parts.append(f"a resonance at {one['frequency']:.5g} Hz, damping {one['damping']:.3g}")
        if "antiresonance" in one:
            parts[-1] += f", with an antiresonance at {one['antiresonance']['frequency']:.5g} Hz"
    lines = [f"dynamics: {'; '.join(parts)}"] if parts else []
    trusted = content["fit"].get("trusted_hz")
    return lines + ([f"trust it to {trusted:.3g} Hz"] if trusted is not None else [])


def _goodness(content: Mapping[str, Any], unit: str | None) -> list[str]:
    """Return how well the model fits and what that is worth."""
    fit: Mapping[str, Any] = content["fit"]
    suffix = f" {unit}" if unit else ""
    lines = []
    if "rmse" in fit:
        percent = f" ({fit['rmse_percent']:.2f} % of range)" if "rmse_percent" in fit else ""
        lines.append(f"fit: RMSE {fit['rmse']:.4g}{suffix}{percent} on the rows it was identified from")
    if "expected_rmse" in fit and fit["expected_rmse"] is not None:
        lines.append(f"expect: RMSE {fit['expected_rmse']:.4g}{suffix} on new moves inside the range")
    lines += [
        f"validated: RMSE {one['rmse']:.4g}{suffix} on {one['name']}, which took no part in the fit"
        for one in content["validation"]
    ]
    if "loop_width_percent" in fit:
        lines.append(f"loop: {fit['loop_width_percent']:.1f} % of range wide, which the model undoes")
    return lines


def _asymmetry(content: Mapping[str, Any]) -> str:
    """Return how many segments the points have, and on which side of the gears where they stand on both."""
    before, every = content["segments_at_the_drive"], sum(content["segments"])
    if 0 < before < every:
        behind = every - before
        return f", {before} segments of asymmetry on the drive's side and {behind} on the displacement's"
    return f", {every} segments of asymmetry" if every else ""


def _at_the_drive(model: ActuatorModel) -> int:
    """Return how many segments stand between the drive and the gears."""
    gears = next((k for k, s in enumerate(model.stages) if isinstance(s, BacklashStage)), None)
    if gears is None:
        return 0
    side = model.stages[:gears] if model.direction == "forward" else model.stages[gears:]
    return sum(stage.m for stage in side if isinstance(stage, PointStage))


def _lag(content: Mapping[str, Any]) -> str:
    taus = ", ".join(f"{tau:.3g}" for tau in content["relaxation_seconds"])
    text = f"; lag and creep with time constants of {taus} s" if taus else "; no lag, no creep"
    delay = content["delay_seconds"]
    return text + (f"; a delay of {1e3 * delay:.3g} ms" if delay else "")


def _quantity(quantity: Quantity) -> dict[str, Any]:
    return {
        "quantity": quantity.quantity,
        "unit": quantity.unit,
        "min": quantity.minimum,
        "max": quantity.maximum,
    }


def _range(quantity: Mapping[str, Any]) -> str:
    unit = f" {quantity['unit']}" if quantity["unit"] else ""
    return f"{quantity['quantity']} {quantity['min']:.6g} to {quantity['max']:.6g}{unit}"


def _wrapped(line: str) -> str:
    import textwrap

    return textwrap.fill(line, WIDTH, subsequent_indent="  ", break_long_words=False)
