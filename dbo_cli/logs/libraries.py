"""Compiled libraries and the process they run in.

Some of them change what belongs to the whole process: polars puts a handler of its own
before Python's, and the libraries behind Parquet and workbooks write pages to standard
error at damaged bytes, or end the process. Whether anything is done about that is for
the process to decide: a ``Host`` does nothing, and ``dbo`` as a process sets one of its
own (``cli.app``).
"""

from __future__ import annotations

import contextlib
import functools
import importlib
from typing import Any

from dbo_cli.errors import InputError

GAVE_UP = "the library that reads it gave up"


class Host:
    """The process as any program has it: left alone."""

    def imported(self, module: str) -> None:
        """Take note that a library has been imported."""

    def contained(
        self, place: str, kind: str
    ) -> contextlib.AbstractContextManager[None]:
        """Surround a call that reads the file ``place``, which should be of a ``kind`` (``Parquet``)."""
        return contextlib.nullcontext()

    def signals_held(self) -> contextlib.AbstractContextManager[None]:
        """Surround renames that belong together; a signal may wait until they are done."""
        return contextlib.nullcontext()


_host = Host()


def set_host(chosen: Host) -> Host:
    """Choose what is done about libraries in this process; returns what was chosen before."""
    global _host
    before, _host = _host, chosen
    import_polars.cache_clear()
    return before


def host() -> Host:
    """Return what was chosen."""
    return _host


@functools.cache
def import_polars() -> Any:
    """Import polars, and tell the host of it once: polars puts a handler of its own before Python's."""
    library = importlib.import_module("polars")
    _host.imported("polars")
    return library


def import_extra(module: str, place: str) -> Any:
    """Import the library of an optional extra.

    Raises
    ------
    InputError
        It is not installed; the line says how to get it.
    """
    try:
        library = importlib.import_module(module)
    except ImportError:
        raise InputError(
            f"{place}: reading it needs the library {module}: pip install {module}"
        ) from None
    _host.imported(module)
    return library
