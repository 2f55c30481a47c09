"""Model and state files: UTF-8 JSON with stable key order, checked to the last key on reading.

The same model gives the same bytes, and floats are written so that reading them back
gives the same float64. ``docs/model-file.md`` is the contract. A state file says where
an actuator was left, so that the next run goes on from there.
"""

import os
import re
from collections.abc import Mapping
from functools import partial
from itertools import chain, groupby
from pathlib import Path
from typing import Any

from dbo_cli.errors import ModelError, prefixed
from dbo_cli.model import fields
from dbo_cli.model.amplifier import Amplifier
from dbo_cli.model.cascade import (
    MOST_CANDIDATES,
    Candidate,
    Cascade,
    Direction,
    Stage,
)
from dbo_cli.model.delay import Delay
from dbo_cli.model.dynamics import Dynamics
from dbo_cli.model.fields import VERSION, Json, Reader, build, number, number_list
from dbo_cli.model.gears import Gears
from dbo_cli.model.points import TABLE, Points, Scale
from dbo_cli.model.state import KEPT_STARTS, START_NAMES, Held, Quantity, State

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
STAGE_ORDER = re.compile(
    "(amplifier )?((point|scale) )*backlash ((point|scale) )*(dynamics )?(delay )?"
)
"""Of the stages from voltage to displacement."""
_EXCHANGED = {"x0": "y0", "y0": "x0", "dx": "dy", "dy": "dx"}
_SIDES: dict[Direction, str] = {"forward": "input", "inverse": "output"}
"""On which side of the gears the voltage is, by the direction of a file."""
# equal widths in a row are written once from this many on: two are shorter as they are
SHORTEST_RUN = 3

OPTIONAL = ("past", "fit", "candidates", "provenance")
"""Keys of a model that are missing where nothing stands for them."""
FIGURES = (
    "rmse expected_rmse line_rmse left_out_rmse left_out_line_rmse scale_rmse "
    "fastest longest_rest longest_swing swings sensor_delay"
).split()
"""Keys of ``fit`` that commands compute with: null or numbers of at least 0."""


# ---- models ----


def read_cascade(path: str) -> Cascade:
    """Read a model file, or one model of a set (``FILE::CHANNEL``); ``-`` is standard input.

    Raises
    ------
    InputError
        The file cannot be read.
    ModelError
        It is not a model, of another version, or contradicts itself; the message names
        file and key. Or it is a set of models, or one without that channel.
    """
    model: Cascade = member(read_cascades(path), path)
    return model


def read_cascades(path: str) -> dict[str, Cascade]:
    """Read the models of a set by channel; a single model, and ``FILE::CHANNEL``, have the name ``""``.

    Errors are as of ``read_cascade``.
    """
    file, separator, channel = path.rpartition("::")
    if not separator or os.path.exists(path):
        file, channel = path, ""
    name, values = fields.load(file, "model")
    with prefixed(name):
        is_set = isinstance(values, dict) and values.get("format") == SET_FORMAT
        if not channel and not is_set:
            return {"": _model(values, "")}
        contents = fields.members(values, SET_FORMAT, "models", "a set of models")
        if channel:
            content = member(contents, file, channel)
            return {"": _model(content, f'models["{channel}"]')}
        return {key: _model(each, f'models["{key}"]') for key, each in contents.items()}


def member(
    models: Mapping[str, Any], path: str, channel: str = "", hint: str = ""
) -> Any:
    """Return what a file has for a channel; the model of a file that is no set serves every one.

    Raises
    ------
    ModelError
        The set has none; the message says what to type, and ends with ``hint``.
    """
    for name in ("", channel):
        if name in models:
            return models[name]
    lacking = f"no model {channel}" if channel else "is a set"
    raise ModelError(
        f"{path}: {lacking}; models: {', '.join(models)}: type {path}::{next(iter(models))}{hint}"
    )


def _model(values: Any, path: str) -> Cascade:
    """Return the model that an object describes."""
    values = fields.contents(values, path, MODEL_FORMAT, "a model")
    direction: Direction = "forward"
    if values.get("direction") == "inverse":
        direction = "inverse"

    def candidate(values: Any, path: str) -> Any:
        return build(Candidate, values, path, weight=fields.above_0, stages=_stages)

    def cascade(past: str = "settled", **keys: Any) -> Cascade:
        if len(keys.get("candidates", ())) > MOST_CANDIDATES:
            raise ModelError(f"candidates: are more than {MOST_CANDIDATES}")
        return Cascade(**keys, auto_start=past)

    model: Cascade = build(
        cascade,
        values,
        path,
        OPTIONAL,
        direction=partial(fields.choice, choices=("forward", "inverse")),
        input=Quantity.read,
        output=Quantity.read,
        stages=partial(_stages, direction=direction),
        fit=_fit,
        candidates=partial(fields.listed, read=candidate),
        provenance=fields.notes,
        past=partial(fields.choice, choices=KEPT_STARTS),
    )
    return model


def _fit(values: Any, path: str) -> Json:
    """Return the figures of a fit; refuse what cannot be one where commands take it for one."""
    figures = fields.notes(values, path)
    for key in FIGURES:
        fields.unless_null(fields.magnitude)(figures.get(key), f"{path}.{key}")
    return figures


def _stages(
    values: Any, path: str, direction: Direction = "forward"
) -> tuple[Stage, ...]:
    """Return stages from voltage to displacement; those of an inverse model stand mirrored in its file."""
    stages = fields.listed(values, path, partial(_stage, direction=direction))
    if direction == "inverse":
        stages = stages[::-1]
    if STAGE_ORDER.fullmatch("".join(f"{TYPES[type(stage)]} " for stage in stages)):
        return stages
    raise ModelError(
        f"{path}: wrong order; one amplifier, points and scales around one backlash, one "
        "dynamics, one delay (inverse: mirrored)"
    )


def _stage(values: Any, path: str, direction: Direction) -> Any:
    """Return the stage that an object describes; in an inverse model it describes what undoes the stage."""
    content = dict(fields.notes(values, path))
    kind = fields.choice(content.pop("type", None), f"{path}.type", tuple(KINDS))
    stage, is_inverse = KINDS[kind], direction == "inverse"
    if "relaxation" in content:
        terms = dict(fields.notes(content["relaxation"], f"{path}.relaxation"))
        if terms.pop("on", None) != _SIDES[direction]:
            raise ModelError(f"{path}.relaxation.on: is not the side of the voltage")
        content["relaxation"] = terms

    def undone(**keys: Any) -> Stage:
        if "dx" in keys:  # refuses what is wrong by the keys of the file
            stage(**{key: keys[key] for key in TABLE})
        return stage(**_mirrored(stage, keys))

    make = undone if is_inverse else stage
    return build(make, content, path, stage.OPTIONAL, **stage.KEYS)


def _mirrored(stage: type[Stage], keys: Json) -> Json:
    """Return the keys of what undoes a stage: exchanged axes (17)-(18), or the opposite number.

    Mirrored twice, they are those of the stage.
    """
    if stage is Scale:
        return Scale(**keys).inverse.keys()
    if stage is Delay:
        return {"seconds": -keys["seconds"]}
    return {key: keys[_EXCHANGED.get(key, key)] for key in keys}


def dumps_model(model: Cascade) -> str:
    """Return the text of a model file: the same model gives the same text."""
    return fields.dumps(model_values(model))


def dumps_set(models: Mapping[str, Cascade]) -> str:
    """Return the text of a file that holds the models of several channels."""
    content = {channel: model_values(model) for channel, model in models.items()}
    return fields.dumps({"format": SET_FORMAT, "version": VERSION, "models": content})


def model_values(model: Cascade) -> Json:
    """Return the keys and values of a model file."""
    candidates = []
    for candidate in model.candidates:
        stages = _stage_values(candidate.stages)
        candidates.append({"weight": float(candidate.weight), "stages": stages})
    values: Json = {
        "format": MODEL_FORMAT,
        "version": VERSION,
        "direction": model.direction,
        "input": model.input.keys(),
        "output": model.output.keys(),
        "stages": _stage_values(model.stages, model.direction),
        "past": "" if model.auto_start == "settled" else model.auto_start,
        "fit": dict(model.fit),
        "candidates": candidates,
        "provenance": dict(model.provenance),
    }
    return {key: value for key, value in values.items() if value or key not in OPTIONAL}


def _stage_values(
    stages: tuple[Stage, ...], direction: Direction = "forward"
) -> list[Json]:
    """Return stages as plain values, their types first; those of an inverse model mirrored."""
    values = []
    for stage in stages if direction == "forward" else stages[::-1]:
        kind = type(stage)
        keys: Json = stage.keys()
        if direction == "inverse":
            keys = _mirrored(kind, keys)
        if "relaxation" in keys:
            keys["relaxation"] = {"on": _SIDES[direction], **keys["relaxation"]}
        for axis in {"dx", "dy"} & set(keys):
            keys[axis] = _runs(keys[axis])
        values.append({"type": TYPES[kind], **keys})
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


_OTHER = "the state belongs to another model: save it again with this one"


def parse_state(values: object, model: Cascade, name: str = "the state") -> State:
    """Return the state that JSON values describe (ModelError: they do not, or it is another model's)."""
    number_or_null = fields.unless_null(number)
    numbers_or_null = fields.unless_null(number_list)
    readers: dict[str, Reader] = {
        "model": fields.text,
        "gears": number,
        "bits": _bits,
        "memory": numbers_or_null,
        "time": number_or_null,
        "drive": number_or_null,
        "sections": numbers_or_null,
        "delay": fields.unless_null(_held),
    }
    if model.amplifier is not None:
        readers["amplifier"] = number_or_null
    with prefixed(name):
        content = fields.contents(values, "", STATE_FORMAT, "a state")
        if content.get("model", model.digest) != model.digest:
            raise ModelError(f"model: {_OTHER}")
        keys = build(dict, content, "", **readers)
        _require_own(keys, model)
    flat = keys["sections"]
    if flat is not None:
        keys["sections"] = tuple(zip(flat[::3], flat[1::3], flat[2::3], strict=True))
    del keys["gears"]
    return State(**keys)


def _require_own(keys: Json, model: Cascade) -> None:
    """Refuse the keys of a state that the model cannot have (ModelError)."""
    gears = model.gears
    sections = () if model.dynamics is None else model.dynamics.sections
    sizes = {"memory": gears.gain.size, "sections": 3 * len(sections)}
    fitting = {
        "gears": keys["gears"] == gears.n,
        "bits": 0 <= keys["bits"] < 1 << gears.n,
    }
    for key, size in sizes.items():
        fitting[key] = keys[key] is None or len(keys[key]) == size
    if keys["delay"] is not None:
        times, held = keys["delay"]
        is_even = 0 < len(times) == len(held)
        in_order = sorted(times) == list(times)
        fitting["delay"] = model.delay is not None and is_even and in_order
    for key, fits in fitting.items():
        if not fits:
            raise ModelError(f"{key}: {_OTHER}")


def _bits(value: Any, path: str) -> int:
    """Return the bits of gears; below 0 where they are not hexadecimal."""
    digits = fields.text(value, path)
    return int(digits, 16) if re.fullmatch("[0-9a-f]+", digits) else -1


def _held(value: Any, path: str) -> Held:
    """Return what a delay held back."""
    held = build(dict, value, path, times=number_list, values=number_list)
    return held["times"], held["values"]


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
    if not isinstance(state, (str, Path)):
        starts = ", ".join(START_NAMES)
        raise ModelError(f"`state` {state!r}: give {starts}, a state or its file")
    name = str(state)
    return name if name in START_NAMES else read_state(name, model)
