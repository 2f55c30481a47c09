"""Model and state files of every model there is: those of gears, and those of plays (docs/model-file.md)."""

from __future__ import annotations

from typing import Any

from dbo_cli.hysteresis import model_file
from dbo_cli.hysteresis.cascade import OtherHysteresis, Stage
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_file import Node
from dbo_cli.hysteresis.model_state import ModelState
from dbo_cli.hysteresis.operators import BacklashState

KINDS = ("plays", "rate-plays", "singular-plays", "one-sided-plays")

# What a model of gears does not need is imported when there are plays: a command starts in no time.


def read_model(path: str) -> ActuatorModel:
    """Read a model file of either kind; see ``hysteresis.model_file.read_model``."""
    return model_file.read_model(path, dict.fromkeys(KINDS, _plays), _made)


def _made(direction: Any, source: Any, result: Any, stages: tuple[Stage, ...], **notes: Any) -> ActuatorModel:
    if not any(isinstance(stage, OtherHysteresis) for stage in stages):
        return ActuatorModel(direction, source, result, stages, **notes)
    from dbo_cli.relatives.model import RelativeModel

    return RelativeModel(direction, source, result, stages, **notes)


def _plays(node: Node) -> Stage:
    from dbo_cli.relatives.operators import Kind, PlayOperator

    kind: Kind = node.text("type")  # type: ignore[assignment]
    more: tuple[str, ...] = ()
    if kind == "rate-plays":
        more = ("by_rate", "fastest")
    elif kind == "one-sided-plays":
        more = ("cubic", "linear")
    node.only(("type", "radii", "weights", *more))
    lists = {key: node.numbers(key) for key in ("radii", "weights", "by_rate") if key in node.values}
    numbers = {key: node.number(key) for key in ("fastest", "cubic", "linear") if key in node.values}
    stage: Stage = node.build(lambda: PlayOperator(kind, **lists, **numbers))  # type: ignore[arg-type]
    return stage


def read_state(path: str, model: ActuatorModel) -> ModelState:
    """Read a state file for a model of either kind; see ``hysteresis.model_file.read_state``."""
    if not any(isinstance(stage, OtherHysteresis) for stage in model.stages):
        return model_file.read_state(path, model)
    return model_file.read_state(path, model, "plays", _places)


def _places(node: Node, model: ActuatorModel) -> BacklashState:
    from dbo_cli.relatives.model import RelativeModel
    from dbo_cli.relatives.operators import PlayState

    assert isinstance(model, RelativeModel)
    node.only(("places", "inverse_places", "wanted"))
    found = []
    for key in ("places", "inverse_places"):
        values = None if node.values[key] is None and key != "places" else node.numbers(key)
        if values is not None and len(values) != model.plays.n:
            raise node.refuse(key, f"has {len(values)} entries where the model has {model.plays.n} plays")
        found.append(values)
    wanted = None if node.values["wanted"] is None else node.number("wanted")
    places, inverse = found
    assert places is not None
    return PlayState(0, None, tuple(places), None if inverse is None else tuple(inverse), wanted)
