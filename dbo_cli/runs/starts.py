"""The state a run starts in, by name, as a value or from a file."""

from __future__ import annotations

import dataclasses
import os

from dbo_cli.errors import UsageError
from dbo_cli.hysteresis.initial_states import START_NAMES, StartName
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_file import read_state
from dbo_cli.hysteresis.model_state import ModelState


def start_of(
    state: StartName | ModelState | str | os.PathLike[str], model: ActuatorModel
) -> StartName | ModelState:
    """Return a start: a name or a state as it is, anything else as a state file.

    Raises
    ------
    UsageError
        There is neither a start nor a file of that name, or the state is of another model.
    """
    if isinstance(state, ModelState):
        if state.model not in (None, model.digest):
            raise UsageError("`state`: is of another model (go on with the model that returned it)")
        return state
    path = os.fspath(state)
    if path in START_NAMES:
        return path
    if not os.path.exists(path):
        names = ", ".join(START_NAMES)
        raise UsageError(f"`state`: '{path}' is none of {names}, and there is no such file")
    return dataclasses.replace(read_state(path, model), model=model.digest)
