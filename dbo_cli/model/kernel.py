"""The recursions of the model: the extension where it was built, else the paper's procedure in Python."""

from __future__ import annotations

import functools
from typing import Any

from dbo_cli.errors import DboError, warn

INTERFACE = 2
"""Of the extension's functions, as ``_kernel.c`` has it: raised with every change of their arguments."""


def _load() -> Any:
    """Return the extension, or None where it was not built.

    Raises
    ------
    DboError
        It was built from another state of the sources.
    """
    try:
        from dbo_cli.model import _kernel  # type: ignore[attr-defined,unused-ignore]
    except ImportError:
        return None
    if getattr(_kernel, "INTERFACE", None) != INTERFACE:
        raise DboError(
            "the compiled part is of another version: build it again with `pip install -e .` in the checkout"
        )
    return _kernel


extension: Any = _load()
"""The compiled module ``dbo_cli.model._kernel``, or None."""


def require(what: str) -> Any:
    """Return the extension, which ``what`` needs (DboError where it was not built)."""
    if extension is None:
        raise DboError(
            f"{what} needs the compiled part of dbo: reinstall dbo-cli with a C compiler"
        )
    return extension


def recursions() -> Any:
    """Return what runs a model: the extension, or the slow fallback, of which the user is warned once."""
    if extension is not None:
        return extension
    return _fallback()


@functools.cache
def _fallback() -> Any:
    from dbo_cli.model import fallback

    warn(
        "the compiled part of dbo is missing: some 100 times slower; reinstall dbo-cli with a C "
        "compiler"
    )
    return fallback
