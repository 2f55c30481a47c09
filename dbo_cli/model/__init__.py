"""The model of an actuator: gears, points, relaxation, dynamics and delay; its files and states."""

from dbo_cli.model.cascade import Direction, Stage
from dbo_cli.model.delay import Delay, Held
from dbo_cli.model.dynamics import Dynamics, Lag, Mode, Resonance, Section
from dbo_cli.model.gears import Gears, GearsRun, Window
from dbo_cli.model.model import Candidate, Model, Outside, Sign, Steps
from dbo_cli.model.points import Points, Scale
from dbo_cli.model.relaxation import Relaxation
from dbo_cli.model.state import (
    NEGLIGIBLE,
    Driven,
    OutsideError,
    Quantity,
    Run,
    StartName,
    State,
    VoltageWindow,
    steps_of,
)
from dbo_cli.model.undoing import Inverter, Undoing, ZeroPhaseLowPass, read_ahead

__all__ = [
    "NEGLIGIBLE",
    "Candidate",
    "Delay",
    "Direction",
    "Driven",
    "Dynamics",
    "Gears",
    "GearsRun",
    "Held",
    "Inverter",
    "Lag",
    "Mode",
    "Model",
    "Outside",
    "OutsideError",
    "Points",
    "Quantity",
    "Relaxation",
    "Resonance",
    "Run",
    "Scale",
    "Section",
    "Sign",
    "Stage",
    "StartName",
    "State",
    "Steps",
    "Undoing",
    "VoltageWindow",
    "Window",
    "ZeroPhaseLowPass",
    "read_ahead",
    "steps_of",
]
