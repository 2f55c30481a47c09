"""What is in a model: one screen of text, the same as JSON, and its figures."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dbo_cli.model import Cascade, Quantity

LINE_WIDTH = 96  # characters of a line
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
    if fit.get("expected_rmse") is not None:
        rows.append(("expected", f"error {fit['expected_rmse']:.3g}{unit} RMS"))
    if fit.get("rmse") is not None:
        text = f"error {fit['rmse']:.3g}{unit} RMS on its own logs"
        if fit.get("line_rmse") is not None:
            text += f"; a straight line leaves {fit['line_rmse']:.3g}{unit}"
        rows.append(("fit", text))
    seen = _seen(fit, forward.input)
    if seen:
        rows.append(("range", ", ".join(seen)))
    rows += [("log", _log(log, unit)) for log in values["logs"]]
    rows += [("validation", _log(log, unit)) for log in values["validation"]]
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


def _seen(fit: Mapping[str, Any], drive: Quantity) -> list[str]:
    """Return how fast the logs were driven, and how long they rested."""
    texts = []
    if fit.get("fastest") is not None:
        texts.append(f"drives to {fit['fastest']:.3g}{drive.suffix}/s")
    if fit.get("longest_rest") is not None:
        texts.append(f"rests to {fit['longest_rest']:.3g} s")
    if fit.get("one_amplitude"):
        texts.append("one amplitude")
    return texts


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
    next_line = "\n" + " " * width
    page = ""
    for name, text in rows:
        wrapped = textwrap.wrap(text, LINE_WIDTH - width, break_long_words=False)
        page += name.ljust(width) + next_line.join(wrapped) + "\n"
    return page
