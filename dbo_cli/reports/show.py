"""What is in a model: one screen of text, the same as JSON, and its figures."""

from __future__ import annotations

import os
import textwrap
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dbo_cli.reports.words import json_text

if TYPE_CHECKING:
    from dbo_cli.model import Cascade, Quantity

LINE_WIDTH = 96  # characters of a line
SEPARATE_KEYS = ("logs", "validation", "warnings", "notes")
"""Keys of ``fit`` that stand beside it in the JSON form."""


@dataclass(frozen=True)
class ShownModel:
    """A model to be shown under a name."""

    model: Cascade
    name: str = "model"

    def values(self) -> dict[str, Any]:
        """Return what is in it as plain values, times in s (``dbo-show`` version 1)."""
        from dbo_cli.model import Points, model_values

        model, forward = self.model, self.model.forward()
        fit, relaxation = model.fit, forward.gears.relaxation
        points = [stage for stage in forward.stages if isinstance(stage, Points)]
        sections: list[dict[str, Any]] = []
        for stage in model_values(forward)["stages"]:
            sections += stage.get("sections", [])
        return {
            "format": "dbo-show",
            "version": 1,
            "direction": model.direction,
            "digest": model.digest,
            "input": asdict(model.input),
            "output": asdict(model.output),
            "sign": model.sign,
            "gears": forward.gears.n,
            "segments": [stage.dx.size for stage in points],
            "relaxation_seconds": [] if relaxation is None else list(relaxation.tau),
            "amplifier_seconds": forward.amplifier and forward.amplifier.seconds,
            "delay_seconds": model.delay_seconds,
            "dynamics": sections,
            "candidates": len(model.candidates),
            "fit": {key: fit[key] for key in fit if key not in SEPARATE_KEYS},
            **{key: list(fit.get(key, [])) for key in SEPARATE_KEYS},
            "provenance": dict(model.provenance),
        }

    def json(self) -> str:
        """Return the JSON form."""
        return json_text(self.values())

    def text(self) -> str:
        """Return one screen of text."""
        values = self.values()
        forward = self.model.forward()
        unit = forward.output.suffix
        operator = f"{values['gears']:,} gears"
        if values["segments"]:
            counts = " and ".join(map(str, values["segments"]))
            operator += f", curve of {counts} straight pieces"
        rows = [
            ("input", _range(self.model.input)),
            ("output", f"{_range(self.model.output)}, {values['sign']}"),
            ("operator", operator),
        ]
        if values["relaxation_seconds"]:
            rows.append(("creep", ", ".join(map(_time, values["relaxation_seconds"]))))
        if values["amplifier_seconds"]:
            rows.append(("amplifier", _time(values["amplifier_seconds"])))
        if values["delay_seconds"]:
            rows.append(("delay", _time(values["delay_seconds"])))
        rows += [("dynamics", _section(section)) for section in values["dynamics"]]
        rows += _errors(values["fit"], unit)
        rows += _seen(values["fit"], forward.input)
        for log in values["logs"]:
            rows.append(("log", _log(log, unit)))
        for log in values["validation"]:
            rows.append(("validation", _log(log, unit)))
        if "program" in values["provenance"]:
            rows.append(("made by", str(values["provenance"]["program"])))
        rows += [("warning", text) for text in values["warnings"]]
        rows += [("note", text) for text in values["notes"]]
        title = f"{self.name}: {values['direction']} model, {values['digest'][:12]}\n"
        return title + _aligned(rows)

    def figures(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Draw the model's figures into a folder, PNG and SVG; return the files."""
        from dbo_cli.reports.plots import model_plots, save

        return save(model_plots(self.model), folder)


def _range(quantity: Quantity) -> str:
    low, high = f"{quantity.min:.6g}", f"{quantity.max:.6g}"
    return f"{quantity.quantity} {low} to {high}{quantity.suffix}"


def _time(seconds: float) -> str:
    """Return a time as people write it."""
    return f"{1000.0 * seconds:.3g} ms" if seconds < 0.1 else f"{seconds:.3g} s"


def _section(section: Mapping[str, Any]) -> str:
    if "lag" in section:
        return f"lag of {_time(section['lag'])}"
    text = (
        f"resonance at {section['frequency']:.5g} Hz, damping {section['damping']:.3g}"
    )
    if "antiresonance" in section:
        text += f", antiresonance at {section['antiresonance']['frequency']:.5g} Hz"
    return text


def _errors(fit: Mapping[str, Any], unit: str) -> list[tuple[str, str]]:
    """Return what error to expect, and how well the model fits its own logs."""
    rows = []
    if fit.get("expected_rmse") is not None:
        rows.append(("expected", f"error {fit['expected_rmse']:.3g}{unit} RMS"))
    if fit.get("rmse") is not None:
        text = f"error {fit['rmse']:.3g}{unit} RMS on its own logs"
        if fit.get("line_rmse") is not None:
            text += f"; a straight line leaves {fit['line_rmse']:.3g}{unit}"
        rows.append(("fit", text))
    return rows


def _seen(fit: Mapping[str, Any], drive: Quantity) -> list[tuple[str, str]]:
    """Return how fast the logs were driven, and how long they rested."""
    parts = []
    if fit.get("fastest") is not None:
        parts.append(f"drives to {fit['fastest']:.3g}{drive.suffix}/s")
    if fit.get("longest_rest") is not None:
        parts.append(f"rests to {fit['longest_rest']:.3g} s")
    if fit.get("one_amplitude"):
        parts.append("one amplitude")
    return [("range", ", ".join(parts))] if parts else []


def _log(log: Mapping[str, Any], unit: str) -> str:
    text = str(log.get("name"))
    if log.get("rows") is not None:
        text += f", {log['rows']:,} rows"
    if log.get("rmse") is not None:
        text += f", error {log['rmse']:.3g}{unit} RMS"
    return text


def _aligned(rows: list[tuple[str, str]]) -> str:
    """Return two columns, the second wrapped."""
    width = max(len(name) for name, _ in rows) + 2
    lines = []
    for name, text in rows:
        wrapped = textwrap.fill(
            text,
            LINE_WIDTH,
            initial_indent=name.ljust(width),
            subsequent_indent=" " * width,
            break_long_words=False,
        )
        lines.append(wrapped + "\n")
    return "".join(lines)
