"""Temporary names for outputs that are being written, and what is left of writers that were killed."""

from __future__ import annotations

import contextlib
import os
import re
import secrets
from typing import IO

_PARTIAL = re.compile(r"\..*\.(\d{1,10})-[0-9a-f]{8}\.partial")
_NAME_BYTES = 100  # of the output's own name; most file systems allow 255 bytes for all of it


def partial_path(target: str) -> str:
    """Return a name beside ``target`` that nobody else uses: hidden, with the writer's process id in it."""
    folder, name = os.path.split(target)
    short = os.fsencode(name)[:_NAME_BYTES].decode("utf-8", "ignore")
    return os.path.join(folder, f".{short}.{os.getpid()}-{secrets.token_hex(4)}.partial")


def open_partial(path: str, buffering: int = -1) -> IO[bytes]:
    """Open a temporary file for writing and lock it for as long as it is open.

    The lock tells the clean-up of a process that cannot see this one (another container, another machine
    on the same network drive) that its writer lives. HDF5 locks its files by itself.
    """
    file = open(path, "wb", buffering)
    with contextlib.suppress(ImportError, OSError):
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    return file


def writer_of(name: str) -> int | None:
    """Return the process id in the name of a temporary file, None for any other name."""
    found = _PARTIAL.fullmatch(name)
    return int(found[1]) if found else None


def is_running(process: int) -> bool:
    """Tell whether a process is there; where that cannot be asked without harm, it is taken to be."""
    if os.name != "posix":
        return True  # os.kill(..., 0) would end it
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True


def remove_orphans(folder: str) -> None:
    """Remove the temporary files in a folder whose writers are gone (killed, or the power failed)."""
    try:
        names = os.listdir(folder or ".")
    except OSError:
        return  # a folder that may be written but not listed
    for name in names:
        process = writer_of(name)
        if process is not None and not is_running(process):
            path = os.path.join(folder, name)
            if not _is_locked(path):
                with contextlib.suppress(OSError):
                    os.unlink(path)


def _is_locked(path: str) -> bool:
    try:
        import fcntl
    except ImportError:
        return False
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    except OSError:
        return True  # gone already, or not ours to judge
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False  # a file system without locks
    finally:
        os.close(handle)
    return False
