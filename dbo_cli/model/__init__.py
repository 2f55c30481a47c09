"""The model of an actuator: its stages, their cascade, its files and states."""

from dbo_cli.model.amplifier import Amplifier
from dbo_cli.model.cascade import Candidate, Cascade, Outside, Stage
from dbo_cli.model.delay import Delay
from dbo_cli.model.dynamics import Dynamics
from dbo_cli.model.file import (
    dumps_model,
    dumps_set,
    dumps_state,
    is_set,
    model_values,
    read_model,
    read_models,
    read_state,
    state_of,
)
from dbo_cli.model.gears import Gears
from dbo_cli.model.points import Points, Scale
from dbo_cli.model.relaxation import Relaxation
from dbo_cli.model.sections import Lag, Mode, Resonance, Section
from dbo_cli.model.state import (
    Quantity,
    Run,
    State,
    Steps,
    Undoing,
    steps_behind,
    steps_of,
)

__all__ = [
    "Amplifier",
    "Candidate",
    "Cascade",
    "Delay",
    "Dynamics",
    "Gears",
    "Lag",
    "Mode",
    "Outside",
    "Points",
    "Quantity",
    "Relaxation",
    "Resonance",
    "Run",
    "Scale",
    "Section",
    "Stage",
    "State",
    "Steps",
    "Undoing",
    "dumps_model",
    "dumps_set",
    "dumps_state",
    "is_set",
    "model_values",
    "read_model",
    "read_models",
    "read_state",
    "state_of",
    "steps_behind",
    "steps_of",
]
