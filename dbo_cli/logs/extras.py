"""Libraries that only some formats need: imported when such a file is opened, named when they are absent."""

from __future__ import annotations

import importlib
from typing import Any

from dbo_cli.errors import InputError


def import_extra(module: str, extra: str, place: str) -> Any:
    """Import the library of an optional extra.

    Raises
    ------
    InputError
        It is not installed; the line says how to get it.
    """
    try:
        return importlib.import_module(module)
    except ImportError:
        raise InputError(
            f'{place}: reading it needs the library {module}: pip install "dbo-cli[{extra}]"'
        ) from None
