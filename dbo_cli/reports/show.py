"""What is in a model: one screen of text, the same as JSON, and its figures."""

from __future__ import annotations

import os
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dbo_cli.reports.render import digits, json_text

if TYPE_CHECKING:
    from dbo_cli.model import Model, Quantity

WIDTH = 96  # characters of a line
APART = ("logs", "validation", "warnings", "notes")
"""Keys of ``fit`` that stand beside it in the JSON form."""


def show_model(model: Model, name: str = "model") -> Shown:
    """Return what is in a model, ready to be shown."""
    return Shown(model, name)


@dataclass(frozen=True)
class Shown:
    """A model to be shown under a name."""

    model: Model
    name: str

    def values(self) -> dict[str, Any]:
        """Return what is in it as plain values, times in s (``dbo-show`` version 1)."""
        model, forward = self.model, self.model.forward()
        gears, fit, provenance = forward.gears, model.fit, model.provenance
        relaxation = gears.relaxation
        return {
            "format": "dbo-show",
            "version": 1,
            "direction": model.direction,
            "digest": model.digest,
            "input": _quantity(model.input),
            "output": _quantity(model.output),
            "sign": model.sign,
            "gears": gears.n,
            "segments": _segments(forward),
            "relaxation_seconds": [] if relaxation is None else list(relaxation.tau),
            "delay_seconds": model.delay_seconds,
            "dynamics": _sections(forward),
            "candidates": len(model.candidates),
            "fit": {key: fit[key] for key in fit if key not in APART},
            "logs": list(fit.get("logs", [])),
            "validation": list(fit.get("validation", [])),
            "notes": list(fit.get("notes", [])),
            "warnings": list(fit.get("warnings", [])),
            "provenance": dict(provenance),
        }

    def json(self) -> str:
        """Return the JSON form."""
        return json_text(self.values())

    def text(self) -> str:
        """Return one screen of text."""
        values = self.values()
        fit, unit = values["fit"], _suffix(self.model.forward().output)
        span = self.model.forward().output.span
        rows = [
            (self.name, f"{values['direction']} model, {values['digest'][:12]}"),
            ("input", _range(self.model.input)),
            ("output", f"{_range(self.model.output)}, {values['sign']}"),
            ("operator", _operator(values)),
        ]
        if values["relaxation_seconds"]:
            rows.append(("lag, creep", _seconds(values["relaxation_seconds"])))
        if values["delay_seconds"]:
            rows.append(("delay", _seconds([values["delay_seconds"]])))
        for section in values["dynamics"]:
            rows.append(("dynamics", _dynamics(section)))
        rows += _errors(fit, unit, span)
        for log in values["validation"]:
            error = digits(log.get("rmse"), 3)
            rows.append(("validated", f"error {error}{unit} RMS on {log.get('name')}"))
        rows += _range_of_trust(fit, self.model.forward().input)
        for log in values["logs"]:
            rows.append(("from", _log(log, unit)))
        program = values["provenance"].get("program")
        if program:
            rows.append(("made by", str(program)))
        rows += [("warning", text) for text in values["warnings"]]
        rows += [("note", text) for text in values["notes"]]
        return _aligned(rows)

    def figures(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Draw the model's figures into a folder, PNG and SVG; return the files."""
        from dbo_cli.reports.plots import model_plots, save

        return save(model_plots(self.model), folder)


def _quantity(quantity: Quantity) -> dict[str, Any]:
    return {
        "quantity": quantity.quantity,
        "unit": quantity.unit,
        "min": quantity.min,
        "max": quantity.max,
    }


def _suffix(quantity: Quantity) -> str:
    return f" {quantity.unit}" if quantity.unit else ""


def _range(quantity: Quantity) -> str:
    low, high = f"{quantity.min:.6g}", f"{quantity.max:.6g}"
    return f"{quantity.quantity} {low} to {high}{_suffix(quantity)}"


def _segments(model: Model) -> list[int]:
    """Return the number of straight pieces of each point operator."""
    from dbo_cli.model import Points

    counts = []
    for stage in model.stages:
        if isinstance(stage, Points):
            counts.append(stage.dx.size)
    return counts


def _sections(model: Model) -> list[dict[str, Any]]:
    """Return the sections of the dynamics as the model file has them."""
    from dbo_cli.model import model_values

    for stage in model_values(model)["stages"]:
        if stage["type"] == "dynamics":
            return list(stage["sections"])
    return []


def _operator(values: Mapping[str, Any]) -> str:
    text = f"{values['gears']:,} gears"
    if values["segments"]:
        counts = " and ".join(str(count) for count in values["segments"])
        text += f", curve of {counts} straight pieces"
    return text


def _seconds(times: list[float]) -> str:
    """Return times as people write them."""
    parts = []
    for seconds in times:
        if seconds < 0.1:
            parts.append(f"{1000.0 * seconds:.3g} ms")
        else:
            parts.append(f"{seconds:.3g} s")
    return ", ".join(parts)


def _dynamics(section: Mapping[str, Any]) -> str:
    if "lag" in section:
        return f"lag of {_seconds([section['lag']])}"
    text = (
        f"resonance at {section['frequency']:.5g} Hz, damping {section['damping']:.3g}"
    )
    if "antiresonance" in section:
        text += f", antiresonance at {section['antiresonance']['frequency']:.5g} Hz"
    return text


def _errors(fit: Mapping[str, Any], unit: str, span: float) -> list[tuple[str, str]]:
    """Return what error to expect, and how well the model fits its own logs."""
    rows = []
    expected = fit.get("expected_rmse")
    if expected is not None:
        percent = digits(100.0 * expected / span, 2)
        rows.append(
            ("expected", f"error {expected:.3g}{unit} RMS ({percent} % of range)")
        )
    if fit.get("rmse") is not None:
        text = f"error {fit['rmse']:.3g}{unit} RMS on its own logs"
        if fit.get("line_rmse") is not None:
            text += f"; a straight line leaves {fit['line_rmse']:.3g}{unit}"
        rows.append(("fit", text))
    return rows


def _range_of_trust(fit: Mapping[str, Any], drive: Quantity) -> list[tuple[str, str]]:
    """Return how fast the logs were driven, and how long they rested."""
    parts = []
    if fit.get("fastest") is not None:
        parts.append(f"drives to {fit['fastest']:.3g}{_suffix(drive)}/s")
    if fit.get("longest_rest") is not None:
        parts.append(f"rests to {fit['longest_rest']:.3g} s")
    if fit.get("one_amplitude"):
        parts.append("one amplitude")
    if not parts:
        return []
    return [("seen", ", ".join(parts))]


def _log(log: Mapping[str, Any], unit: str) -> str:
    text = str(log.get("name"))
    if log.get("rows") is not None:
        text += f", {log['rows']:,} rows"
    if log.get("rmse") is not None:
        text += f", error {log['rmse']:.3g}{unit} RMS"
    return text


def _aligned(rows: list[tuple[str, str]]) -> str:
    """Return two columns, the second wrapped."""
    width = max(len(name) for name, _ in rows[1:]) + 2
    lines = [f"{rows[0][0]}: {rows[0][1]}"]
    for name, text in rows[1:]:
        wrapped = textwrap.wrap(text, WIDTH - width, break_long_words=False) or [""]
        lines.append(name.ljust(width) + wrapped[0])
        lines += [" " * width + line for line in wrapped[1:]]
    return "\n".join(lines) + "\n"
