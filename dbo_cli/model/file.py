"""Model files: UTF-8 JSON with stable key order, checked to the last key on reading.

The same model gives the same bytes, and floats are written so that reading them back
gives the same float64. ``docs/model-file.md`` is the contract.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from typing import cast

from dbo_cli.errors import InputError, ModelError
from dbo_cli.model.cascade import Direction, Stage
from dbo_cli.model.delay import Delay
from dbo_cli.model.dynamics import Dynamics, Lag, Mode, Resonance, Section
from dbo_cli.model.gears import Axis, Gears
from dbo_cli.model.model import MOST_CANDIDATES, Candidate, Model
from dbo_cli.model.node import Json, Node, dumps, load, runs_of
from dbo_cli.model.points import Points, Scale
from dbo_cli.model.relaxation import Relaxation
from dbo_cli.model.state import Quantity

MODEL_FORMAT = "dbo-model"
SET_FORMAT = "dbo-model-set"
VERSION = 1
# twice what identification makes
MOST_STAGES = 16
MOST_CHANNELS = 10_000

AMOUNTS_OF_FIT = (
    "rmse",
    "expected_rmse",
    "line_rmse",
    "left_out_rmse",
    "fastest",
    "longest_rest",
)
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
            raise InputError(
                f"{file}: no model is called {channel!r}; there are: {', '.join(models)}"
            )
        return models[channel]
    name, values = load(path, "model")
    return parse_model(values, name)


def read_models(path: str) -> dict[str, Model]:
    """Read a set of models: channels and their models (errors as of ``read_model``)."""
    name, values = load(path, "model")
    root = _top(values, name, SET_FORMAT, "a set of models")
    root.only(("format", "version", "models"))
    channels = root.node("models")
    if not 1 <= len(channels.values) <= MOST_CHANNELS:
        raise root.refuse("models", f"has not from 1 to {MOST_CHANNELS:,} entries")
    models = {}
    for channel, content in channels.values.items():
        node = channels.below(f'["{channel}"]', content)
        _check_format(node, MODEL_FORMAT, "a model")
        models[channel] = _model_of(node)
    return models


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
            f"{name}: is a set of models: name one of them ({name}::CHANNEL), or all columns with a pattern"
            " ('V{}')"
        )
    return _model_of(_top(values, name, MODEL_FORMAT, "a model"))


def _top(values: object, name: str, wanted: str, noun: str) -> Node:
    """Return the top of a file, its format and version checked."""
    if not isinstance(values, dict):
        raise ModelError(f"{name}: is not {noun}: the file holds no JSON object")
    root = Node(name, "", values)
    _check_format(root, wanted, noun)
    return root


def _check_format(node: Node, wanted: str, noun: str) -> None:
    if node.values.get("format") != wanted:
        raise node.refuse("format", f'must be "{wanted}" in {noun}')
    if "version" not in node.values:
        raise node.refuse("version", "is missing")
    version = node.values["version"]
    if isinstance(version, bool) or version != VERSION:
        raise node.refuse(
            "version",
            f"{version!r} is not version {VERSION}, which this program reads: identify the model again",
        )


def _model_of(root: Node) -> Model:
    """Return the model that an object describes."""
    keys = ("format", "version", "direction", "input", "output", "stages")
    root.only(keys, ("fit", "candidates", "provenance"))
    direction = root.text("direction")
    if direction not in ("forward", "inverse"):
        raise root.refuse(
            "direction", f"{direction!r} is neither 'forward' nor 'inverse'"
        )
    stages = _stages(root)
    fit = root.notes("fit")
    if fit:
        _check_fit(root.node("fit"))
    candidates: tuple[Candidate, ...] = ()
    if "candidates" in root.values:
        nodes = root.nodes("candidates")
        if len(nodes) > MOST_CANDIDATES:
            raise root.refuse("candidates", f"has more than {MOST_CANDIDATES} entries")
        candidates = tuple(_candidate(node) for node in nodes)
    source = _quantity(root.node("input"))
    result = _quantity(root.node("output"))
    provenance = root.notes("provenance")
    return root.build(
        lambda: Model(
            cast(Direction, direction),
            source,
            result,
            stages,
            fit,
            candidates,
            provenance,
        )
    )


def _check_fit(fit: Node) -> None:
    """Refuse what cannot be a figure where commands take it for one."""
    for key in AMOUNTS_OF_FIT:
        if fit.values.get(key) is None:
            continue
        number = fit.number(key)
        if number < 0.0:
            raise fit.refuse(key, f"{number!r} is not a number of at least 0")


def _quantity(node: Node) -> Quantity:
    node.only(("quantity", "unit", "min", "max"))
    name = node.text("quantity")
    unit = None
    if node.values["unit"] is not None:
        unit = node.text("unit")
    low, high = node.number("min"), node.number("max")
    return node.build(lambda: Quantity(name, unit, low, high))


def _stages(node: Node) -> tuple[Stage, ...]:
    nodes = node.nodes("stages")
    if len(nodes) > MOST_STAGES:
        raise node.refuse("stages", f"has more than {MOST_STAGES} entries")
    return tuple(_stage(item) for item in nodes)


def _stage(node: Node) -> Stage:
    """Return one stage of the cascade by its type."""
    if "type" not in node.values:
        raise node.refuse("type", "is missing")
    kind = node.text("type")
    if kind not in _READERS:
        raise node.refuse(
            "type", f"{kind!r} is not a known stage; there are: {', '.join(_READERS)}"
        )
    return _READERS[kind](node)


def _candidate(node: Node) -> Candidate:
    node.only(("weight", "stages"))
    weight = node.number("weight")
    stages = _stages(node)
    return node.build(lambda: Candidate(weight, stages))


def _curve(node: Node) -> tuple[list[float], list[float], float, float]:
    dx, dy = node.widths("dx"), node.widths("dy")
    return dx, dy, node.number("x0"), node.number("y0")


def _gears(node: Node) -> Gears:
    node.only(("type", "x0", "y0", "dx", "dy"), ("relaxation",))
    curve = _curve(node)
    terms: Relaxation | None = None
    axis: Axis = "input"
    if "relaxation" in node.values:
        terms, axis = _relaxation(node)
    return node.build(lambda: Gears(*curve, terms, axis))


def _relaxation(gears: Node) -> tuple[Relaxation, Axis]:
    """Return the relaxation of gears, and the axis that it follows."""
    node = gears.node("relaxation")
    node.only(("on", "reference", "tau", "gain"))
    axis = node.text("on")
    if axis not in ("input", "output"):
        raise node.refuse("on", f"{axis!r} is neither 'input' nor 'output'")
    reference = node.number("reference")
    tau, gain = node.numbers("tau"), node.numbers("gain")
    terms = gears.build(lambda: Relaxation(reference, tau, gain))
    return terms, cast(Axis, axis)


def _points(node: Node) -> Points:
    node.only(("type", "x0", "y0", "dx", "dy"))
    curve = _curve(node)
    return node.build(lambda: Points(*curve))


def _scale(node: Node) -> Scale:
    node.only(("type", "gain", "offset"))
    gain, offset = node.number("gain"), node.number("offset")
    return node.build(lambda: Scale(gain, offset))


def _delay(node: Node) -> Delay:
    node.only(("type", "seconds"))
    seconds = node.number("seconds")
    return node.build(lambda: Delay(seconds))


def _dynamics(node: Node) -> Dynamics:
    node.only(("type", "sections"))
    sections = tuple(_section(item) for item in node.nodes("sections"))
    return node.build(lambda: Dynamics(sections))


def _section(node: Node) -> Section:
    if "lag" in node.values:
        node.only(("lag",), ("lead",))
        seconds = node.number("lag")
        lead = 0.0
        if "lead" in node.values:
            lead = node.number("lead")
        return node.build(lambda: Lag(seconds, lead))
    node.only(("frequency", "damping"), ("antiresonance",))
    beside: Mode | None = None
    if "antiresonance" in node.values:
        below = node.node("antiresonance")
        below.only(("frequency", "damping"))
        beside = below.build(
            lambda: Mode(below.number("frequency"), below.number("damping"))
        )
    frequency, damping = node.number("frequency"), node.number("damping")
    return node.build(lambda: Resonance(frequency, damping, beside))


_READERS: dict[str, Callable[[Node], Stage]] = {
    "backlash": _gears,
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
        "stages": [stage_values(stage) for stage in model.stages],
    }
    if model.fit:
        values["fit"] = dict(model.fit)
    if model.candidates:
        values["candidates"] = [
            {
                "weight": float(part.weight),
                "stages": [stage_values(stage) for stage in part.stages],
            }
            for part in model.candidates
        ]
    if model.provenance:
        values["provenance"] = dict(model.provenance)
    return values


def stage_values(stage: Stage) -> Json:
    """Return a stage as plain values, its type first."""
    if isinstance(stage, Scale):
        return {
            "type": "scale",
            "gain": float(stage.gain),
            "offset": float(stage.offset),
        }
    if isinstance(stage, Delay):
        return {"type": "delay", "seconds": float(stage.seconds)}
    if isinstance(stage, Dynamics):
        sections = [_section_values(section) for section in stage.sections]
        return {"type": "dynamics", "sections": sections}
    kind = "point" if isinstance(stage, Points) else "backlash"
    values = {
        "type": kind,
        "x0": stage.x0,
        "y0": stage.y0,
        "dx": runs_of(stage.dx.tolist()),
        "dy": runs_of(stage.dy.tolist()),
    }
    if isinstance(stage, Gears) and stage.relaxation is not None:
        terms = stage.relaxation
        values["relaxation"] = {
            "on": stage.on,
            "reference": float(terms.reference),
            "tau": [float(tau) for tau in terms.tau],
            "gain": [float(gain) for gain in terms.gain],
        }
    return values


def _section_values(section: Section) -> Json:
    if isinstance(section, Lag):
        lag: Json = {"lag": float(section.seconds)}
        if section.lead:
            lag["lead"] = float(section.lead)
        return lag
    values = _mode_values(section)
    if section.antiresonance is not None:
        values["antiresonance"] = _mode_values(section.antiresonance)
    return values


def _mode_values(mode: Mode) -> Json:
    return {"frequency": float(mode.frequency), "damping": float(mode.damping)}


def _quantity_values(quantity: Quantity) -> Json:
    return {
        "quantity": quantity.quantity,
        "unit": quantity.unit,
        "min": float(quantity.min),
        "max": float(quantity.max),
    }
