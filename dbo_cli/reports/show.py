"""What is in a model: one screen of text, the same as JSON, and its figures."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dbo_cli.model import Cascade, Quantity

LINE_WIDTH = 96  # characters of a line
EXPECTED_FORMS = {"expected_rmse": "error {:.3g}{unit} RMS"}
FIT_FORMS = {
    "rmse": "error {:.3g}{unit} RMS on its own logs",
    "line_rmse": "a straight line leaves {:.3g}{unit}",
}
RANGE_FORMS = {
    "fastest": "drives to {:.5g}{drive}/s",
    "longest_rest": "rests to {:.3g} s",
    "one_amplitude": "one amplitude",
}
LOG_FORMS = {"name": "{}", "rows": "{:,} rows", "rmse": "error {:.3g}{unit} RMS"}
"""How the figures of a fit and of a log are written, by their keys."""
SEPARATE_KEYS = ("logs", "validation", "warnings", "notes")
"""Keys of ``fit`` that stand beside it in the JSON form."""


def shown_values(model: Cascade) -> dict[str, Any]:
    """Return what is in a model as plain values, times in s (``dbo-show`` version 1)."""
    from dbo_cli.model import Points, model_values

    forward = model.forward()
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


def shown_text(model: Cascade, name: str) -> str:
    """Return one screen of text about a model of some name."""
    values, forward = shown_values(model), model.forward()
    fit, unit = values["fit"], forward.output.suffix
    rows = [
        ("input", _range(model.input)),
        ("output", f"{_range(model.output)}, {values['sign']}"),
        ("operator", _operator(values, model.auto_start)),
    ]
    if values["relaxation_seconds"]:
        rows.append(("creep", ", ".join(map(_time, values["relaxation_seconds"]))))
    for part in ("amplifier", "delay"):
        if values[f"{part}_seconds"]:
            rows.append((part, _time(values[f"{part}_seconds"])))
    rows += [("dynamics", _section(section)) for section in values["dynamics"]]
    shown = [
        ("expected", fit, EXPECTED_FORMS),
        ("fit", fit, FIT_FORMS),
        ("range", fit, RANGE_FORMS),
    ]
    shown += [("log", log, LOG_FORMS) for log in values["logs"]]
    shown += [("validation", log, LOG_FORMS) for log in values["validation"]]
    for heading, figures, forms in shown:
        texts = []
        for key, form in forms.items():
            if figures.get(key) not in (None, False):
                text = form.format(figures[key], unit=unit, drive=forward.input.suffix)
                texts.append(text)
        if texts:
            rows.append((heading, ", ".join(texts)))
    if "program" in values["provenance"]:
        rows.append(("made by", str(values["provenance"]["program"])))
    rows += [("warning", text) for text in values["warnings"]]
    rows += [("note", text) for text in values["notes"]]
    title = f"{name}: {values['direction']} model, {values['digest'][:12]}\n"
    return title + _aligned(rows)


def _operator(values: Mapping[str, Any], start: str) -> str:
    text = f"{values['gears']:,} gears"
    if values["segments"]:
        counts = " and ".join(map(str, values["segments"]))
        text += f", curve of {counts} straight pieces"
    if start in ("below", "above"):
        text += f"; auto comes from {start} the range, as the logs began"
    elif start != "settled":
        text += f"; auto starts {start}, as the logs began"
    return text


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


def _aligned(rows: list[tuple[str, str]]) -> str:
    """Return two columns, the second wrapped."""
    width = max(len(name) for name, _ in rows) + 2
    next_line = "\n" + " " * width
    page = ""
    for name, text in rows:
        wrapped = textwrap.wrap(text, LINE_WIDTH - width, break_long_words=False)
        page += name.ljust(width) + next_line.join(wrapped) + "\n"
    return page
