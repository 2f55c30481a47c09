"""Identify, invert and compensate the hysteresis of piezo actuators with the Discrete Backlash Operator.

The public names are loaded when they are asked for, so that importing the package
costs nothing.
"""

from typing import TYPE_CHECKING

from dbo_cli.version import __version__

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
    from dbo_cli.library import (
        Model,
        ModelSet,
        identify,
        read_log,
        read_model,
        read_models,
        report,
    )

__all__ = [
    "DboError", "DboWarning", "FitError", "InputError", "LimitError", "Model", "ModelError",
    "ModelSet", "OutputError", "UsageError", "__version__", "identify", "read_log",
    "read_model", "read_models", "report",
]  # fmt: skip

if not TYPE_CHECKING:

    def __getattr__(name: str) -> object:
        """Load a public name when it is asked for."""
        from importlib import import_module

        if name not in __all__:
            raise AttributeError(f"module 'dbo_cli' has no attribute {name!r}")
        room = "errors" if name.endswith(("Error", "Warning")) else "library"
        return getattr(import_module(f"dbo_cli.{room}"), name)


def __dir__() -> list[str]:
    """List the public names."""
    return sorted([*globals(), *__all__])
