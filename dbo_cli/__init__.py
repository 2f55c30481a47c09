"""Identify, invert and compensate the hysteresis of piezo actuators with the Discrete Backlash Operator.

The public names are loaded when they are asked for, so that importing the package costs
nothing; see docs/python.md.
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
    from dbo_cli.extras.channels.api import ModelSet
    from dbo_cli.extras.moves.trajectory import trajectory
    from dbo_cli.runs.api import (
        Model,
        compensate,
        identify,
        read_log,
        read_model,
        report,
        simulate,
    )

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

_OF_ERRORS = ("Error", "Warning")


if not TYPE_CHECKING:  # else a type checker would believe in any name

    def __getattr__(name: str) -> object:
        """Load a public name of the core or of an extra when it is asked for."""
        from importlib import import_module
        from importlib.util import find_spec

        # Importing a module of this package asks for its name here first.
        if name.startswith("_") or find_spec(f"dbo_cli.{name}") is not None:
            raise AttributeError(f"module 'dbo_cli' has no attribute {name!r}")
        brought = import_module("dbo_cli.extensions").find("api", name)
        if brought is not None:
            return brought
        if name not in __all__:
            raise AttributeError(f"module 'dbo_cli' has no attribute {name!r}")
        room = "errors" if name.endswith(_OF_ERRORS) else "runs.api"
        return getattr(import_module(f"dbo_cli.{room}"), name)


def __dir__() -> list[str]:
    """List the public names."""
    return sorted([*globals(), *__all__])
