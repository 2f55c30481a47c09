"""Model files: UTF-8 JSON with stable key order, checked to the last key on reading.

The same model gives the same bytes, and floats are written so that reading them back
gives the same float64. ``docs/model-file.md`` is the contract.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from itertools import groupby
from typing import cast

from dbo_cli.errors import InputError, ModelError
from dbo_cli.model.cascade import Direction, Stage
from dbo_cli.model.delay import Delay
from dbo_cli.model.dynamics import Dynamics, Lag, Mode, Resonance, Section
from dbo_cli.model.gears import Axis, Gears
from dbo_cli.model.model import Candidate, Model
from dbo_cli.model.node import VERSION, Json, Node, dumps, load
from dbo_cli.model.points import Points, Scale
from dbo_cli.model.relaxation import Relaxation
from dbo_cli.model.state import Quantity

MODEL_FORMAT = "dbo-model"
SET_FORMAT = "dbo-model-set"
# equal widths in a row are written once from this many on: two are shorter as they are
SHORTEST_RUN = 3

AMOUNTS_OF_FIT = ("rmse", "expected_rmse", "line_rmse", "left_out_rmse")
TIMES_OF_FIT = ("fastest", "longest_rest")
"""Keys of ``fit`` that commands compute with: null or numbers of at least 0."""


# ---- reading ----


def read_model(path: str) -> Model:
    """Read a model file, or one model of a set (``FILE::CHANNEL``); ``-`` is standard input.

    Raises
    ------
    InputError
        The file cannot be read, or the set has no such channel.
    ModelError
        It is not a model, of another version, or contradicts itself; the message names
        file and key.
    """
    file, separator, channel = path.rpartition("::")
    if separator and not os.path.exists(path):
        models = read_models(file)
        if channel not in models:
            raise InputError(f"{file}: no model {channel}; models: {', '.join(models)}")
        return models[channel]
    name, values = load(path, "model")
    return parse_model(values, name)


def read_models(path: str) -> dict[str, Model]:
    """Read a set of models: channels and their models (errors as of ``read_model``)."""
    name, values = load(path, "model")
    root = Node(name, "", values)
    root.require_format(SET_FORMAT, "a set of models")
    channels = root.node("models")
    if not channels.values:
        raise root.refuse("models", "is empty")
    models = {}
    for channel, content in channels.values.items():
        models[channel] = _model(Node(name, f'models["{channel}"]', content))
    return root.build(dict, models)


def is_set(path: str) -> bool:
    """Tell whether a file is a set of models; a pipe is not read."""
    if not os.path.isfile(path):
        return False
    try:
        values = load(path, "model")[1]
    except (InputError, ModelError):
        return False
    return isinstance(values, dict) and values.get("format") == SET_FORMAT


def parse_model(values: object, name: str = "the model") -> Model:
    """Return the model that JSON values describe, checked to the last key.

    Raises
    ------
    ModelError
        They do not; the message begins with ``name`` and the key.
    """
    if isinstance(values, dict) and values.get("format") == SET_FORMAT:
        raise ModelError(
            f"{name}: is a set of models: type {name}::CHANNEL, or a pattern of columns"
        )
    return _model(Node(name, "", values))


def _model(node: Node) -> Model:
    """Return the model that an object describes."""
    node.require_format(MODEL_FORMAT, "a model")
    direction = node.choice("direction", "forward", "inverse")
    candidates: list[Candidate] = []
    if node.has("candidates"):
        candidates = [_candidate(part) for part in node.nodes("candidates")]
    return node.build(
        Model,
        cast(Direction, direction),
        _quantity(node.node("input")),
        _quantity(node.node("output")),
        _stages(node, direction),
        _fit(node),
        tuple(candidates),
        node.notes("provenance"),
    )


def _fit(model: Node) -> Json:
    """Return the figures of a fit; refuse what cannot be one where commands take it for one."""
    values = model.notes("fit")
    if values:
        fit = model.node("fit")
        for key in (*AMOUNTS_OF_FIT, *TIMES_OF_FIT):
            if values.get(key) is not None and fit.number(key) < 0.0:
                raise fit.refuse(key, f"{values[key]!r} is not a number of at least 0")
    return values


def _quantity(node: Node) -> Quantity:
    unit = node.unless_null("unit", node.text)
    low, high = node.number("min"), node.number("max")
    return node.build(Quantity, node.text("quantity"), unit, low, high)


def _candidate(node: Node) -> Candidate:
    return node.build(Candidate, node.number("weight"), _stages(node, "forward"))


def _stages(node: Node, direction: str) -> tuple[Stage, ...]:
    stages: list[Stage] = []
    for part in node.nodes("stages"):
        kind = part.choice("type", "backlash", *_READERS)
        if kind == "backlash":
            stages.append(_gears(part, "input" if direction == "forward" else "output"))
        else:
            stages.append(_READERS[kind](part))
    return tuple(stages)


def _gears(node: Node, axis: str) -> Gears:
    terms: Relaxation | None = None
    if node.has("relaxation"):
        part = node.node("relaxation")
        axis = part.choice("on", "input", "output")
        reference = part.number("reference")
        tau, gain = part.numbers("tau"), part.numbers("gain")
        terms = part.build(Relaxation, reference, tau, gain)
    dx, dy = node.widths("dx"), node.widths("dy")
    x0, y0 = node.number("x0"), node.number("y0")
    return node.build(Gears, dx, dy, x0, y0, terms, cast(Axis, axis))


def _points(node: Node) -> Points:
    dx, dy = node.widths("dx"), node.widths("dy")
    return node.build(Points, dx, dy, node.number("x0"), node.number("y0"))


def _scale(node: Node) -> Scale:
    return node.build(Scale, node.number("gain"), node.number("offset"))


def _delay(node: Node) -> Delay:
    return node.build(Delay, node.number("seconds"))


def _dynamics(node: Node) -> Dynamics:
    sections = [_section(part) for part in node.nodes("sections")]
    return node.build(Dynamics, tuple(sections))


def _section(node: Node) -> Section:
    if node.has("lag"):
        lead = node.number("lead") if node.has("lead") else 0.0
        return node.build(Lag, node.number("lag"), lead)
    beside: Mode | None = None
    if node.has("antiresonance"):
        part = node.node("antiresonance")
        beside = part.build(Mode, part.number("frequency"), part.number("damping"))
    frequency, damping = node.number("frequency"), node.number("damping")
    return node.build(Resonance, frequency, damping, beside)


_READERS: dict[str, Callable[[Node], Stage]] = {
    "point": _points,
    "scale": _scale,
    "dynamics": _dynamics,
    "delay": _delay,
}


# ---- writing ----


def dumps_model(model: Model) -> str:
    """Return the text of a model file: the same model gives the same text."""
    return dumps(model_values(model))


def dumps_set(models: Mapping[str, Model]) -> str:
    """Return the text of a file that holds the models of several channels."""
    content = {channel: model_values(model) for channel, model in models.items()}
    return dumps({"format": SET_FORMAT, "version": VERSION, "models": content})


def model_values(model: Model) -> Json:
    """Return the keys and values of a model file."""
    values: Json = {
        "format": MODEL_FORMAT,
        "version": VERSION,
        "direction": model.direction,
        "input": _quantity_values(model.input),
        "output": _quantity_values(model.output),
        "stages": [_stage_values(stage) for stage in model.stages],
    }
    if model.fit:
        values["fit"] = dict(model.fit)
    if model.candidates:
        values["candidates"] = []
    for part in model.candidates:
        stages = [_stage_values(stage) for stage in part.stages]
        values["candidates"].append({**_numbers(part, "weight"), "stages": stages})
    if model.provenance:
        values["provenance"] = dict(model.provenance)
    return values


def _numbers(part: object, *names: str) -> Json:
    """Return attributes as floats under their names."""
    return {name: float(getattr(part, name)) for name in names}


def _quantity_values(part: Quantity) -> Json:
    names = {"quantity": part.quantity, "unit": part.unit}
    return {**names, **_numbers(part, "min", "max")}


def _stage_values(stage: Stage) -> Json:
    """Return a stage as plain values, its type first."""
    if isinstance(stage, Scale):
        return {"type": "scale", **_numbers(stage, "gain", "offset")}
    if isinstance(stage, Delay):
        return {"type": "delay", **_numbers(stage, "seconds")}
    if isinstance(stage, Dynamics):
        sections = [_section_values(section) for section in stage.sections]
        return {"type": "dynamics", "sections": sections}
    values: Json = {
        "type": "point" if isinstance(stage, Points) else "backlash",
        **_numbers(stage, "x0", "y0"),
        "dx": _runs(stage.dx.tolist()),
        "dy": _runs(stage.dy.tolist()),
    }
    if isinstance(stage, Gears) and stage.relaxation is not None:
        values["relaxation"] = {
            "on": stage.on,
            **_numbers(stage.relaxation, "reference"),
            "tau": [float(tau) for tau in stage.relaxation.tau],
            "gain": [float(gain) for gain in stage.relaxation.gain],
        }
    return values


def _section_values(section: Section) -> Json:
    if isinstance(section, Lag):
        values: Json = {"lag": float(section.seconds)}
        if section.lead:
            values["lead"] = float(section.lead)
        return values
    values = _numbers(section, "frequency", "damping")
    if section.antiresonance is not None:
        beside = section.antiresonance
        values["antiresonance"] = _numbers(beside, "frequency", "damping")
    return values


def _runs(widths: list[float]) -> list[float | Json]:
    """Return widths with every run of equal ones written once."""
    written: list[float | Json] = []
    for width, same in groupby(widths):
        count = len(list(same))
        if count >= SHORTEST_RUN:
            written.append({"repeat": count, "value": width})
        else:
            written.extend([width] * count)
    return written
