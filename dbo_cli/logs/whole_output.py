"""Outputs appear whole or not at all.

Everything is written under a temporary name in the folder of the output and renamed when complete; whatever
ends the work before that (an error, Ctrl-C, SIGTERM, a full disk) removes the temporary file and leaves the
old one as it was.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import secrets
import signal
import stat
import sys
import threading
from collections.abc import Iterator, Sequence
from types import FrameType
from typing import IO

from dbo_cli.errors import OutputError, UsageError
from dbo_cli.logs.addresses import Address, parse_address

_HDF5_ERRNO = re.compile(r"errno = (\d+)")
_ENDING_SIGNALS = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]


def check_output(address: str | Address, protect: Sequence[str] = ()) -> None:
    """Refuse an output that cannot be written, before any long work starts.

    Parameters
    ----------
    address
        The output; ``-`` is standard output and always fine.
    protect
        Inputs of the same command, which must not be overwritten.

    Raises
    ------
    UsageError
        The output is one of the inputs.
    OutputError
        Its folder is missing or not writable, or it is a folder itself.
    """
    target = parse_address(address) if isinstance(address, str) else address
    if target.is_stream:
        return
    for given in protect:
        if _is_same_file(target.path, given):
            raise UsageError(f"{target.path}: this output is also an input: write to another file")
    if os.path.isdir(target.path):
        raise OutputError(f"{target.path}: this is a folder: give a file name")
    folder = os.path.dirname(target.path) or "."
    if not os.path.isdir(folder):
        raise OutputError(f"{target.path}: there is no folder '{folder}': create it first")
    exists = os.path.exists(target.path)
    special = exists and not os.path.isfile(target.path)
    if not os.access(target.path if special else folder, os.W_OK):
        raise OutputError(f"{target.path}: the {'device' if special else 'folder'} is not writable")
    if exists and not os.access(target.path, os.W_OK):
        raise OutputError(f"{target.path}: the file is write-protected")


def _is_same_file(path: str, given: str) -> bool:
    try:
        there = os.stat(path)
        other = os.fstat(sys.stdin.fileno()) if given == "-" else os.stat(parse_address(given).path)
    except (OSError, ValueError, UsageError):
        return False  # one of them does not exist, or standard input is no file
    return stat.S_ISREG(there.st_mode) and os.path.samestat(there, other)


@contextlib.contextmanager
def replacing(path: str, *, devices: bool = True) -> Iterator[str]:
    """Give a temporary name beside ``path`` to write to; rename it to ``path`` at the end, or remove it.

    A device or named pipe cannot be replaced and is given as it is, unless ``devices`` is False.

    Raises
    ------
    OutputError
        Writing failed (disk full, folder gone, no permission).
    """
    if os.path.exists(path) and not os.path.isfile(path):
        if not devices:
            raise OutputError(f"{path}: this is no regular file: name a file")
        with _telling(path):
            yield path
        return
    target = os.path.realpath(path)  # through a symbolic link, its target is replaced
    folder, name = os.path.split(target)
    temporary = os.path.join(folder, f".{name[:100]}.{os.getpid()}-{secrets.token_hex(4)}.partial")
    with _telling(path), _ending_signals_raise():
        try:
            yield temporary
            _adopt_mode(target, temporary)
            os.replace(temporary, target)
        except BaseException:
            with contextlib.suppress(OSError):
                os.unlink(temporary)
            raise


@contextlib.contextmanager
def _telling(path: str) -> Iterator[None]:
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as problem:
        raise OutputError(f"{path}: {reason_of(problem)}") from None


def reason_of(problem: OSError) -> str:
    """Say why writing failed; the HDF5 library tells the number of the error only inside its text."""
    number, told = problem.errno, _HDF5_ERRNO.search(str(problem))
    if number is None and told:
        number = int(told[1])
    if number in (errno.ENOSPC, errno.EDQUOT):
        return "the disk is full: nothing was written"
    return f"cannot be written: {os.strerror(number) if number else str(problem).splitlines()[0]}"


def _adopt_mode(target: str, temporary: str) -> None:
    """Give the new file the permissions of the one it replaces."""
    with contextlib.suppress(OSError):
        os.chmod(temporary, stat.S_IMODE(os.stat(target).st_mode))


@contextlib.contextmanager
def _ending_signals_raise() -> Iterator[None]:
    """Let SIGTERM and SIGHUP unwind the stack (exit code 128 + number), so that no litter stays."""

    def end(number: int, frame: FrameType | None) -> None:
        raise SystemExit(128 + number)

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    replaced = [number for number in _ENDING_SIGNALS if signal.getsignal(number) is signal.SIG_DFL]
    for number in replaced:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in replaced:
            signal.signal(number, signal.SIG_DFL)


def write_whole(address: str, data: bytes, *, protect: Sequence[str] = ()) -> None:
    """Write a complete file at once (``-`` is standard output).

    Raises
    ------
    UsageError
        The output is one of the inputs in ``protect``.
    OutputError
        It cannot be written; what stood there is left as it was.
    """
    check_output(address, protect)
    if parse_address(address).is_stream:
        with standard_output() as stream:
            stream.write(data)
        return
    with replacing(address) as path, open(path, "wb") as file:
        file.write(data)
        file.flush()
        if os.path.isfile(path):
            os.fsync(file.fileno())


@contextlib.contextmanager
def standard_output() -> Iterator[IO[bytes]]:
    """Give standard output for bytes, flushed at the end.

    Raises
    ------
    OutputError
        It cannot be written to (a full disk behind a redirection); a closed pipe stays a BrokenPipeError.
    """
    with _telling("standard output"):
        sys.stdout.flush()
        yield sys.stdout.buffer
        sys.stdout.buffer.flush()
