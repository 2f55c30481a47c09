"""Identify, invert and compensate the hysteresis of piezo actuators with the Discrete Backlash Operator.

The public names are loaded when they are asked for, so that importing the package costs nothing; see
docs/python.md.
"""

from __future__ import annotations

from dbo_cli.version import __version__

TYPE_CHECKING = False  # as in typing, which is not imported for it
if TYPE_CHECKING:
    from dbo_cli.errors import (
        DboError,
        DboWarning,
        FitError,
        InputError,
        LimitError,
        ModelError,
        OutputError,
        UsageError,
    )
    from dbo_cli.runs.api import Model, ModelSet, compensate, identify, read_log, read_model, report, simulate
    from dbo_cli.runs.trajectories import trajectory

__all__ = [
    "DboError",
    "DboWarning",
    "FitError",
    "InputError",
    "LimitError",
    "Model",
    "ModelError",
    "ModelSet",
    "OutputError",
    "UsageError",
    "__version__",
    "compensate",
    "identify",
    "read_log",
    "read_model",
    "report",
    "simulate",
    "trajectory",
]

_ROOMS = {"DboWarning": "errors", "trajectory": "runs.trajectories"}


if not TYPE_CHECKING:  # else a type checker would believe in any name

    def __getattr__(name: str) -> object:
        """Load a public name when it is asked for."""
        if name not in __all__:
            raise AttributeError(f"module 'dbo_cli' has no attribute {name!r}")
        from importlib import import_module

        room = _ROOMS.get(name) or ("errors" if name.endswith("Error") else "runs.api")
        return getattr(import_module(f"dbo_cli.{room}"), name)


def __dir__() -> list[str]:
    """List the public names."""
    return sorted([*globals(), *__all__])
