"""The recursions of the model in C: the extension ``_kernel``, which every installation has."""

from __future__ import annotations

from typing import Any

from dbo_cli.errors import DboError

INTERFACE = 7
"""Of the extension's functions, as ``_kernel.c`` has it: raised with every change of their arguments."""
REMEDY = "type `pip install -e .` in the checkout (it needs a C compiler)"


def _load() -> Any:
    """Return the extension.

    Raises
    ------
    DboError
        It is missing, or was built from another state of the sources.
    """
    try:
        from dbo_cli.model import _kernel  # type: ignore[attr-defined,unused-ignore]
    except ImportError:
        raise DboError(f"the compiled part of dbo is missing: {REMEDY}") from None
    if getattr(_kernel, "INTERFACE", None) != INTERFACE:
        raise DboError(f"the compiled part of dbo is of another version: {REMEDY}")
    return _kernel


extension: Any = _load()
"""The compiled module ``dbo_cli.model._kernel``."""
