"""The stage of plays and its state in model and state files (docs/model-file.md).

``hysteresis.model_file`` asks here when a file has a stage that it does not know.
"""

from __future__ import annotations

from dbo_cli.hysteresis.cascade import Stage
from dbo_cli.hysteresis.model_file import Node
from dbo_cli.hysteresis.operators import BacklashState
from dbo_cli.relatives.play_model import RelativeModel
from dbo_cli.relatives.plays import KINDS, Kind, PlayOperator, PlayState

__all__ = ["READERS", "RelativeModel", "read_places"]


def _plays(node: Node) -> Stage:
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


READERS = dict.fromkeys(KINDS, _plays)


def read_places(node: Node, model: RelativeModel) -> BacklashState:
    """Return what the plays of a model remember."""
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
