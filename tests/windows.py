"""What Windows refuses, refused here: so that what is particular to it is tried on other systems, too.

Nobody may replace or remove a file while it is open, ``fsync`` needs a handle that may
write, folders cannot be opened, some names are given to no file, and ``fcntl`` does not
exist.
"""

from __future__ import annotations

import builtins
import errno
import fcntl
import os
import re
import sys
from collections.abc import Callable
from typing import Any

import pytest

_DEVICES = re.compile(r"(con|prn|aux|nul|com[0-9]|lpt[0-9])(\..*)?", re.IGNORECASE)
_FORBIDDEN = re.compile(r'[<>:"|?*]')


def open_here(path: str) -> list[int]:
    """List the descriptors of this process that have a file open."""
    found = []
    for name in os.listdir("/proc/self/fd"):
        try:
            if os.path.samestat(os.stat(f"/proc/self/fd/{name}"), os.stat(path)):
                found.append(int(name))
        except OSError:
            pass
    return found


def refuse_names(path: Any) -> None:
    """Refuse a name that Windows gives to no file."""
    if isinstance(path, int):
        return
    name = os.path.basename(os.fspath(path))
    if _DEVICES.fullmatch(name) or _FORBIDDEN.search(name) or name != name.rstrip(". "):
        raise OSError(errno.EINVAL, "Invalid argument", path)


def refuse_open(*paths: str) -> None:
    """Refuse to replace or remove what this very process has open (a sharing violation)."""
    for path in paths:
        if os.path.isfile(path) and open_here(path):
            raise PermissionError(
                errno.EACCES, "The process cannot access the file: it is in use", path
            )


def pretend(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let this process meet what a process meets on Windows."""
    real_open, real_sync, real_builtin = os.open, os.fsync, builtins.open

    def opened(path: Any, flags: int, *more: Any, **named: Any) -> int:
        refuse_names(path)
        if os.path.isdir(path):
            raise PermissionError(errno.EACCES, "Permission denied", path)
        return real_open(path, flags, *more, **named)

    def opened_by_python(path: Any, *more: Any, **named: Any) -> Any:
        refuse_names(path)
        return real_builtin(path, *more, **named)

    def synced(handle: Any) -> None:
        number = handle if isinstance(handle, int) else handle.fileno()
        if fcntl.fcntl(number, fcntl.F_GETFL) & os.O_ACCMODE == os.O_RDONLY:
            raise OSError(errno.EBADF, "Bad file descriptor")
        real_sync(number)

    def careful(real: Callable[..., None], count: int) -> Callable[..., None]:
        def call(*paths: Any, **named: Any) -> None:
            for path in paths[1:count]:
                refuse_names(path)
            refuse_open(*paths[:count])
            real(*paths, **named)

        return call

    monkeypatch.setattr(os, "open", opened)
    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(builtins, "open", opened_by_python)
    for name, count in (("replace", 2), ("rename", 2), ("unlink", 1), ("remove", 1)):
        monkeypatch.setattr(os, name, careful(getattr(os, name), count))
    monkeypatch.setitem(sys.modules, "fcntl", None)
    monkeypatch.setattr("dbo_cli.logs.whole_output.WINDOWS", True)
