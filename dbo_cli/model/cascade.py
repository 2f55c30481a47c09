"""The order of the stages of a model, and a name for what they are."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Sequence
from typing import Literal

from dbo_cli.errors import ModelError
from dbo_cli.model.delay import Delay
from dbo_cli.model.dynamics import Dynamics
from dbo_cli.model.gears import Gears
from dbo_cli.model.points import Curve, Scale

Stage = Gears | Curve | Dynamics | Delay
Direction = Literal["forward", "inverse"]


def check_order(stages: Sequence[Stage], direction: Direction) -> None:
    """See that stages stand as a model has them.

    That is: points and scales around one stage of gears, then at most one dynamics and
    at most one delay; in an inverse model mirrored.

    Raises
    ------
    ModelError
        They do not; the message begins with the key.
    """
    gears = [place for place, stage in enumerate(stages) if isinstance(stage, Gears)]
    if not gears:
        raise ModelError("stages: one of type backlash is missing")
    if len(gears) > 1:
        raise ModelError(f"stages[{gears[1]}]: a second backlash stage")
    places, sign, on = list(range(len(stages))), 1.0, "input"
    if direction == "inverse":
        places.reverse()
        sign, on = -1.0, "output"
    beyond = 0
    for place in places:
        stage = stages[place]
        rank = 0
        if isinstance(stage, Gears) and stage.on != on:
            raise ModelError(
                f"stages[{place}].relaxation.on: must be {on!r} in this direction"
            )
        if isinstance(stage, Dynamics):
            rank = 1
        elif isinstance(stage, Delay):
            rank = 2
            if sign * stage.seconds < 0.0:
                raise ModelError(
                    f"stages[{place}].seconds: {stage.seconds!r} has the wrong sign in this direction"
                )
        if rank < beyond or rank == beyond > 0:
            raise ModelError(
                f"stages[{place}]: wrong order; points and scales around the gears, one dynamics, one "
                "delay (inverse: mirrored)"
            )
        beyond = rank


def digest_of(stages: Sequence[Stage]) -> str:
    """Return a name for a forward cascade; a gain inverted twice may differ in its last digits."""
    parts: list[object] = []
    for stage in stages:
        if isinstance(stage, Scale):
            parts.append([f"{stage.gain:.9e}", f"{stage.offset + 0.0:.9e}"])
        elif isinstance(stage, Delay):
            parts.append(stage.seconds)
        elif isinstance(stage, Dynamics):
            parts.append([dataclasses.asdict(section) for section in stage.sections])
        else:
            parts.append([stage.dx.tolist(), stage.dy.tolist(), stage.x0, stage.y0])
            if isinstance(stage, Gears) and stage.relaxation is not None:
                parts.append(dataclasses.asdict(stage.relaxation))
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()
