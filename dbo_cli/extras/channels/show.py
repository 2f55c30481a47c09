"""What is in a set of models, on one screen."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from dbo_cli.extras.channels.model_set import ModelSet
from dbo_cli.runs.showing import contents


def set_text(models_of_set: ModelSet, form: str) -> str:
    """Return what is in a set of models: a line a channel, or the same as JSON."""
    models, coupling = (
        {channel: contents(model) for channel, model in models_of_set.items()},
        models_of_set.coupling,
    )
    if form == "json":
        whole = {"format": "dbo-show-set", "version": 1, "models": models}
        if coupling is not None:
            whole["coupling"] = {"condition": coupling.condition, **coupling.values()}
        return json.dumps(whole, indent=2, ensure_ascii=False)
    lines = _set_lines(models)
    return "\n".join(lines if coupling is None else [*lines, "", coupling.summary()])


def _set_lines(models: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return a table of a set: what each channel spans, how good it is, and how many warnings it has."""
    rows: list[tuple[str, ...]] = [
        (
            "channel",
            "drive",
            "output",
            "sign",
            "gears",
            "fit RMSE",
            "% of range",
            "expected",
            "warnings",
        )
    ]
    for channel, content in models.items():
        fit, unit = content["fit"], content["output"]["unit"] or ""
        ends = [
            f"{q['min']:.4g} to {q['max']:.4g} {q['unit'] or ''}".strip()
            for q in (content["input"], content["output"])
        ]
        errors = [
            ""
            if fit.get(key) is None
            else f"{fit[key]:.3g}{'' if key.endswith('percent') else f' {unit}'}".strip()
            for key in ("rmse", "rmse_percent", "expected_rmse")
        ]
        gears, warned = str(content["gears"] or ""), str(len(content["warnings"]))
        rows.append((channel, *ends, content["sign"], gears, *errors, warned))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [
        "  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True))
        for row in rows
    ]
    return [f"{len(models):,} models (FILE::CHANNEL names one)", "", *lines]
