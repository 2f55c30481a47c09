"""Model and state files: UTF-8 JSON with stable key order, checked to the last key on reading.

The same model gives the same bytes, and floats are written so that reading them back
gives the same float64. ``docs/model-file.md`` is the contract. A state file says where
an actuator was left, so that the next run goes on from there.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from functools import partial
from itertools import chain, groupby, pairwise
from pathlib import Path
from typing import Any

from dbo_cli.errors import InputError, ModelError
from dbo_cli.model import fields
from dbo_cli.model.amplifier import Amplifier
from dbo_cli.model.cascade import Candidate, Cascade, Direction, Stage
from dbo_cli.model.delay import Delay
from dbo_cli.model.dynamics import Dynamics
from dbo_cli.model.fields import VERSION, Json, build, number, number_list
from dbo_cli.model.gears import Gears
from dbo_cli.model.points import Points, Scale
from dbo_cli.model.relaxation import Relaxation
from dbo_cli.model.state import START_NAMES, Held, Quantity, State

MODEL_FORMAT = "dbo-model"
SET_FORMAT = "dbo-model-set"
STATE_FORMAT = "dbo-state"
KINDS: dict[str, type[Stage]] = {
    "amplifier": Amplifier,
    "backlash": Gears,
    "point": Points,
    "scale": Scale,
    "dynamics": Dynamics,
    "delay": Delay,
}
TYPES = {stage: name for name, stage in KINDS.items()}
# equal widths in a row are written once from this many on: two are shorter as they are
SHORTEST_RUN = 3

FIGURES = (
    "rmse expected_rmse line_rmse left_out_rmse left_out_line_rmse unknown_past_rmse "
    "fastest longest_rest longest_swing swings sensor_delay"
).split()
"""Keys of ``fit`` that commands compute with: null or numbers of at least 0."""


# ---- models ----


def read_model(path: str) -> Cascade:
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
        return read_models(file, [channel])[channel]
    name, values = fields.load(path, "model")
    return parse_model(values, name)


def read_models(path: str, only: list[str] | None = None) -> dict[str, Cascade]:
    """Read a set of models, or those of some channels: by channel (errors as of ``read_model``)."""
    name, values = fields.load(path, "model")
    models = {}
    try:
        channels = _channels(values)
        for channel in channels if only is None else only:
            if channel not in channels:
                names = ", ".join(channels)
                alike = [key for key in channels if key.lower() == channel.lower()]
                near = [*alike, *channels][0]
                raise InputError(
                    f"{name}: no model {channel}; models: {names}: type {name}::{near}"
                )
            models[channel] = _model(channels[channel], f'models["{channel}"]')
    except ModelError as problem:
        raise ModelError(f"{name}: {problem}") from None
    return models


def _channels(values: Any) -> Json:
    """Return what stands in a set for the model of each channel."""
    channels = fields.members(values, SET_FORMAT, "models", "a set of models")
    if not channels:
        raise ModelError("models: is empty")
    return channels


def is_set(path: str) -> bool:
    """Tell whether a file is a set of models; a pipe is not read."""
    if not os.path.isfile(path):
        return False
    try:
        values = fields.load(path, "model")[1]
    except (InputError, ModelError):
        return False
    return _is_set(values)


def _is_set(values: object) -> bool:
    """Tell whether values of a file are those of a set of models."""
    return isinstance(values, dict) and values.get("format") == SET_FORMAT


def parse_model(values: object, name: str = "the model") -> Cascade:
    """Return the model that JSON values describe, checked to the last key.

    Raises
    ------
    ModelError
        They do not; the message begins with ``name`` and the key.
    """
    try:
        if _is_set(values):
            names = list(_channels(values))
            file = "-" if name == fields.STANDARD_INPUT else name
            raise ModelError(
                f"is a set of models, {', '.join(names)}: type {file}::{names[0]}"
            )
        return _model(values, "")
    except ModelError as problem:
        raise ModelError(f"{name}: {problem}") from None


def _model(values: Any, path: str) -> Cascade:
    """Return the model that an object describes."""
    values = fields.contents(values, path, MODEL_FORMAT, "a model")
    direction: Direction = "forward"
    if values.get("direction") == "inverse":
        direction = "inverse"
    model: Cascade = build(
        Cascade,
        values,
        path,
        ("fit", "candidates", "provenance"),
        direction=partial(fields.choice, choices=("forward", "inverse")),
        input=Quantity.read,
        output=Quantity.read,
        stages=partial(_stages, direction=direction),
        fit=_fit,
        candidates=partial(fields.listed, read=_candidate),
        provenance=fields.notes,
    )
    return model


def _fit(values: Any, path: str) -> Json:
    """Return the figures of a fit; refuse what cannot be one where commands take it for one."""
    for key in FIGURES:
        value = fields.notes(values, path).get(key)
        if value is not None:
            fields.magnitude(value, f"{path}.{key}")
    return fields.notes(values, path)


def _candidate(values: Any, path: str) -> Any:
    return build(Candidate, values, path, weight=number, stages=_stages)


def _stages(
    values: Any, path: str, direction: Direction = "forward"
) -> tuple[Stage, ...]:
    """Return stages from voltage to displacement; those of an inverse model stand mirrored in its file."""
    stages = fields.listed(values, path, partial(_stage, direction=direction))
    return stages if direction == "forward" else stages[::-1]


def _stage(values: Any, path: str, direction: Direction) -> Any:
    """Return the stage that an object describes; in an inverse model it describes what undoes the stage."""
    content = dict(fields.notes(values, path))
    kind = fields.choice(content.pop("type", None), f"{path}.type", tuple(KINDS))
    stage, is_inverse = KINDS[kind], direction == "inverse"
    if "relaxation" in content:
        terms = dict(fields.notes(content["relaxation"], f"{path}.relaxation"))
        if terms.pop("on", None) != ("output" if is_inverse else "input"):
            raise ModelError(f"{path}.relaxation.on: is not the side of the voltage")
        content["relaxation"] = terms
    if is_inverse and stage in _UNDOING:
        make = _UNDOING[stage]
        return build(make, content, path, stage.OPTIONAL, **stage.KEYS)
    return stage.read(content, path)


def _inverse_gears(
    dx: Any, dy: Any, x0: float, y0: float, relaxation: Relaxation | None = None
) -> Gears:
    """Return the gears that exchanged axes describe (17)-(18)."""
    Gears(dx, dy, x0, y0)  # refuses what is wrong by the keys of the file
    return Gears(dy, dx, y0, x0, relaxation)


def _negative_delay(seconds: float) -> Delay:
    """Return the delay that an inverse model reads ahead by."""
    if seconds > 0.0:
        raise ModelError(f"seconds: {seconds!r} has the wrong sign in this direction")
    return Delay(-seconds)


_UNDOING: dict[type[Stage], Callable[..., Stage]] = {
    Gears: _inverse_gears,
    Points: lambda **table: Points(**table).inverse(),
    Scale: lambda gain, offset: Scale(gain, offset).inverse(),
    Delay: _negative_delay,
}
"""What makes a stage of the keys of what undoes it, where these are other ones."""


def dumps_model(model: Cascade) -> str:
    """Return the text of a model file: the same model gives the same text."""
    return fields.dumps(model_values(model))


def dumps_set(models: Mapping[str, Cascade]) -> str:
    """Return the text of a file that holds the models of several channels."""
    content = {channel: model_values(model) for channel, model in models.items()}
    return fields.dumps({"format": SET_FORMAT, "version": VERSION, "models": content})


def model_values(model: Cascade) -> Json:
    """Return the keys and values of a model file."""
    values: Json = {
        "format": MODEL_FORMAT,
        "version": VERSION,
        "direction": model.direction,
        "input": model.input.keys(),
        "output": model.output.keys(),
        "stages": _stage_values(model.stages, model.direction),
    }
    if model.fit:
        values["fit"] = dict(model.fit)
    if model.candidates:
        values["candidates"] = []
    for candidate in model.candidates:
        stages = _stage_values(candidate.stages)
        content = {"weight": float(candidate.weight), "stages": stages}
        values["candidates"].append(content)
    if model.provenance:
        values["provenance"] = dict(model.provenance)
    return values


def _stage_values(
    stages: tuple[Stage, ...], direction: Direction = "forward"
) -> list[Json]:
    """Return stages as plain values, their types first; those of an inverse model mirrored."""
    values = []
    for stage in stages:
        keys = {"type": TYPES[type(stage)], **stage.keys()}
        if "relaxation" in keys:
            keys["relaxation"] = {"on": "input", **keys["relaxation"]}
        values.append(keys)
    if direction == "inverse":
        values = [_mirrored(keys) for keys in reversed(values)]
    for keys in values:
        keys |= {axis: _runs(keys[axis]) for axis in ("dx", "dy") if axis in keys}
    return values


def _mirrored(keys: Json) -> Json:
    """Return the keys of what undoes a stage: exchanged axes (17)-(18), or the opposite number."""
    if keys["type"] == "scale":
        return {**keys, **Scale(keys["gain"], keys["offset"]).inverse().keys()}
    if keys["type"] == "delay":
        return {**keys, "seconds": -keys["seconds"]}
    exchange = {"x0": "y0", "y0": "x0", "dx": "dy", "dy": "dx"}
    mirrored = {key: keys[exchange.get(key, key)] for key in keys}
    if "relaxation" in mirrored:
        mirrored["relaxation"] = {**mirrored["relaxation"], "on": "output"}
    return mirrored


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


# ---- states ----


def dumps_state(state: State, model: Cascade) -> str:
    """Return the text of a state file; it names the model that it belongs to by a hash."""
    sections = held = None
    if state.sections is not None:
        sections = list(chain.from_iterable(state.sections))
    if state.delay is not None:
        held = {"times": state.delay[0], "values": state.delay[1]}
    values: Json = {
        "format": STATE_FORMAT,
        "version": VERSION,
        "model": model.digest,
        "gears": model.gears.n,
        "bits": f"{state.bits:x}",
        "memory": state.memory,
        "time": state.time,
        "drive": state.drive,
        "sections": sections,
        "delay": held,
    }
    if model.amplifier is not None:
        values["amplifier"] = state.amplifier
    return fields.dumps(values)


def read_state(path: str, model: Cascade) -> State:
    """Read a state file for a model or its inverse; ``-`` is standard input.

    Raises
    ------
    InputError
        The file cannot be read.
    ModelError
        It is not a state, contradicts itself, or belongs to another model.
    """
    name, values = fields.load(path, "state")
    return parse_state(values, model, name)


def parse_state(values: object, model: Cascade, name: str = "the state") -> State:
    """Return the state that JSON values describe (ModelError: they do not, or it is another model's)."""
    try:
        return _state(fields.contents(values, "", STATE_FORMAT, "a state"), model)
    except ModelError as problem:
        raise ModelError(f"{name}: {problem}") from None


def state_of(state: State | str | Path, model: Cascade) -> State | str:
    """Return what was before a run: the name of a start, a state, or that of a file.

    Raises
    ------
    InputError
        The file cannot be read.
    ModelError
        It is no state, or one of another model.
    """
    if isinstance(state, State):
        if state.model in ("", model.digest):
            return state
        raise ModelError(
            "`state`: it belongs to another model: take one that this model returned"
        )
    name = str(state)
    return name if name in START_NAMES else read_state(name, model)


def _state(values: Json, model: Cascade) -> State:
    """Return the state that an object describes, which must be one of ``model``."""
    amplifier = {}
    if model.amplifier is not None:
        amplifier["amplifier"] = fields.unless_null(number)
    parts = build(
        dict,
        values,
        "",
        model=fields.text,
        gears=number,
        bits=fields.text,
        memory=fields.unless_null(number_list),
        time=fields.unless_null(number),
        drive=fields.unless_null(number),
        sections=fields.unless_null(number_list),
        delay=fields.unless_null(_held),
        **amplifier,
    )
    if parts["model"] != model.digest:
        raise ModelError(
            "model: the state belongs to another model: save it again with this one"
        )
    gears, digits = model.gears.n, parts["bits"]
    if parts["gears"] != gears:
        raise ModelError(f"gears: is not {gears}, the number of gears of the model")
    hexadecimal = digits and not set(digits) - set("0123456789abcdef")
    if not hexadecimal or int(digits, 16) >> gears:
        raise ModelError(f"bits: is not a hexadecimal number of {gears} bits")
    counts = {"memory": model.gears.gain.size, "sections": 0}
    if model.dynamics is not None:
        counts["sections"] = 3 * len(model.dynamics.sections)
    for key, count in counts.items():
        if parts[key] is not None and len(parts[key]) != count:
            raise ModelError(f"{key}: has {len(parts[key])} entries, not {count}")
    if parts["delay"] is not None and model.delay is None:
        raise ModelError("delay: the model has no delay")
    flat = parts["sections"]
    sections = None
    if flat is not None:
        sections = tuple(zip(flat[::3], flat[1::3], flat[2::3], strict=True))
    return State(
        int(digits, 16),
        parts["memory"],
        parts["drive"],
        parts["time"],
        sections,
        parts["delay"],
        parts.get("amplifier"),
        model=parts["model"],
    )


def _held(values: Any, path: str) -> Held:
    """Return what a delay held back."""
    held = build(dict, values, path, times=number_list, values=number_list)
    times, past = held["times"], held["values"]
    if len(times) != len(past) or not times:
        raise ModelError(f"{path}.values: has {len(past)} entries, not {len(times)}")
    if any(later < earlier for earlier, later in pairwise(times)):
        raise ModelError(f"{path}.times: goes backwards")
    return times, past
