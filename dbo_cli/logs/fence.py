"""A fence around the libraries that read files: what they raise, what they print, whether they are there."""

import contextlib
import importlib
import os
from collections.abc import Callable, Iterator
from typing import Any

from dbo_cli.errors import DboError, InputError


def import_extra(module: str, extra: str, path: str) -> Any:
    """Import a library that is not always installed (InputError)."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise InputError(
            f"{path}: needs {module}: pip install 'dbo-cli[{extra}]'"
        ) from None


@contextlib.contextmanager
def fenced(path: str, kind: str) -> Iterator[None]:
    """Turn whatever a library raises at damaged bytes into one line (InputError)."""
    try:
        yield
    except (DboError, KeyboardInterrupt, SystemExit, GeneratorExit):
        raise
    except BaseException as problem:  # a panic of polars, too
        reason = str(problem).strip().splitlines() or [type(problem).__name__]
        raise InputError(f"{path}: cannot be read as {kind}: {reason[0]}") from None


@contextlib.contextmanager
def closed_on_error(close: Callable[[], object]) -> Iterator[None]:
    """Close a file where it cannot be made a table."""
    try:
        yield
    except BaseException:
        close()
        raise


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Keep off standard error what a library writes there: a log, or where it panicked."""
    try:
        stderr = os.dup(2)
    except OSError:  # it is closed
        yield
        return
    with open(os.devnull, "wb") as nowhere:
        os.dup2(nowhere.fileno(), 2)
    try:
        yield
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)


def refuse_part(path: str, inner: str) -> None:
    """Refuse a part of a file that has none (InputError)."""
    if inner:
        raise InputError(f"{path}::{inner}: this format has no parts: type {path}")
