"""Which file an output is, and the temporary name that it is written under.

No output overwrites an input or another output, whatever they are called; what a killed process left behind
is cleaned up by the next one.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import secrets
import stat
import sys
import unicodedata
from collections.abc import Iterator, Sequence
from typing import IO

from dbo_cli.errors import DboError, OutputError, UsageError
from dbo_cli.logs.addresses import Address, Given, parse_address

# Linux' names of open files, and the names that ``partial_path`` gives.
_DESCRIPTOR = re.compile(r"/(?:dev/fd|proc/(?:self|thread-self|\d+)/fd)/(\d{1,9})")
_PARTIAL = re.compile(r"\..*\.(\d{1,10})-[0-9a-f]{8}\.partial", re.DOTALL)
_NAME_BYTES = 100  # of the output's own name; most file systems allow 255 bytes for all of it
WINDOWS = os.name == "nt"
# Names that Windows gives to devices, with any ending, and names that it cannot give to a file at all.
_NO_FILE = re.compile(
    r"(con|prn|aux|com[0-9]|lpt[0-9])(\..*)?|nul\..*|.*[<>:\"|?*].*|.*[. ]", re.IGNORECASE | re.DOTALL
)
_MOST_LINKS = 40  # a longer chain of symbolic links is a circle; the kernel's own limit

FileIdentity = tuple[object, ...]


def descriptor_of(path: str) -> int | None:
    """Return the open file descriptor that a path stands for (``/dev/stdout``, ``/dev/fd/3``), or None.

    Such a path leads on to whatever the shell has opened there, perhaps a log that is being appended to:
    it is to be written to, never replaced or cut.
    """
    if os.name != "posix" or "\0" in path:
        return None
    here = path
    for _ in range(_MOST_LINKS):
        folder, name = os.path.split(here)
        here = os.path.join(_plain_folder(folder), name)
        found = _DESCRIPTOR.fullmatch(here)
        if found:
            return int(found[1])
        try:
            here = os.path.join(os.path.dirname(here), os.readlink(here))
        except OSError:
            return None
    return None


def is_replaceable(path: str) -> bool:
    """Tell whether an output is a file to be renamed to: no stream, device or open descriptor."""
    regular = path != "-" and (os.path.isfile(path) or not os.path.exists(path))
    return regular and descriptor_of(path) is None


def _plain_folder(folder: str) -> str:
    """Resolve links in a folder, but keep /dev/fd and /proc/self/fd in their short spelling."""
    absolute = os.path.abspath(folder or ".")
    own = f"/proc/{os.getpid()}/"
    resolved = os.path.realpath(absolute)
    if resolved.startswith(own) and resolved.endswith("/fd"):
        return "/proc/self/fd"
    return resolved


def identity_of(address: Given, *, reading: bool = False) -> FileIdentity | None:
    """Return what two spellings of one file have in common, also of a file that is not there yet.

    None for what may be used twice without harm: devices such as ``/dev/null``, a terminal, a pipe that
    is read. Links, hard links, ``./``, ``..`` and, where the file system ignores it, case are seen through.

    Parameters
    ----------
    address
        A file, a group of an HDF5 file (the file counts), ``-`` or a path such as ``/dev/fd/3``.
    reading
        Whether ``-`` is standard input.
    """
    target = parse_address(address)
    descriptor = (0 if reading else 1) if target.is_stream else descriptor_of(target.path)
    try:
        found = os.stat(target.path) if descriptor is None else os.fstat(descriptor)
    except OSError:
        return None if descriptor is not None else _identity_of_new(target.path)
    except ValueError:
        return None
    if stat.S_ISREG(found.st_mode) or (stat.S_ISFIFO(found.st_mode) and not reading):
        return ("file", found.st_dev, found.st_ino)
    return None


def _identity_of_new(path: str) -> FileIdentity | None:
    folder, name = os.path.split(os.path.realpath(path))
    try:
        found = os.stat(folder)
    except OSError:
        return None  # refused elsewhere: there is no such folder
    if _ignores_case(folder):
        name = unicodedata.normalize("NFC", name).casefold()
    return ("new", found.st_dev, found.st_ino, name)


def _ignores_case(folder: str) -> bool:
    """Tell whether the file system finds a folder by its name in the other case, too."""
    other = folder.swapcase()
    try:
        return other != folder and os.path.samefile(folder, other)
    except OSError:
        return False


def check_outputs(outputs: Sequence[Given], inputs: Sequence[Given] = ()) -> None:
    """Refuse outputs that cannot be written, are an input or each other, before any long work starts.

    Parameters
    ----------
    outputs
        All outputs of a command; ``-`` is standard output.
    inputs
        All inputs of the command; ``-`` is standard input.

    Raises
    ------
    UsageError
        Two outputs are one file, an output is an input, or two inputs are standard input.
    OutputError
        A folder is missing or not writable, an output is a folder, a name is too long.
    """
    if sum(given == "-" or (isinstance(given, Address) and given.is_stream) for given in inputs) > 1:
        raise UsageError("two inputs are standard input, which can be read once: give one of them as a file")
    targets = [parse_address(one) for one in outputs]
    read = {identity_of(given, reading=True) for given in _readable(inputs)}
    written: dict[FileIdentity, Address] = {}
    for target in targets:
        which = identity_of(target)
        if which is not None and which in read:
            raise UsageError(f"{_called(target)}: this output is also an input: write to another file")
        if which is not None and which in written:
            first, again = _called(written[which]), _called(target)
            same = f"{first} and {again} are" if first != again else f"{first} is"
            raise UsageError(f"{same} one file, and two outputs go there: give each a file of its own")
        if which is not None:
            written[which] = target
        _check_place(target)


def _readable(inputs: Sequence[Given]) -> Iterator[Address]:
    """Leave out what is no file: the name of a state, an empty word, what does not exist."""
    for given in inputs:
        with contextlib.suppress(DboError):
            target = parse_address(given)
            if target.is_stream or os.path.exists(target.path):
                yield target


def check_output(address: Given, protect: Sequence[Given] = ()) -> None:
    """Refuse one output that cannot be written or is an input; see :func:`check_outputs`."""
    check_outputs([address], protect)


def _called(target: Address) -> str:
    return "standard output" if target.is_stream else target.path


def _check_place(target: Address) -> None:
    if target.is_stream:
        return
    path = target.path
    if WINDOWS and _NO_FILE.fullmatch(os.path.basename(os.path.splitdrive(path)[1])):
        raise OutputError(f"{path}: Windows has no file of this name: give another one")
    descriptor = descriptor_of(path)
    if descriptor is not None:
        _check_descriptor(path, descriptor)
        return
    try:
        kind = os.stat(path).st_mode
    except ValueError as problem:
        raise OutputError(f"{path!r}: this is no file name: {problem}") from None
    except OSError as problem:
        if problem.errno in (errno.ENAMETOOLONG, errno.ELOOP):
            raise OutputError(f"{path}: cannot be written: {problem.strerror}") from None
        kind = 0
    if stat.S_ISDIR(kind):
        raise OutputError(f"{path}: this is a folder: give a file name")
    _check_access(path, kind)


def _check_access(path: str, kind: int) -> None:
    folder = os.path.dirname(os.path.realpath(path) if os.path.islink(path) else path) or "."
    if not os.path.isdir(folder):
        raise OutputError(f"{path}: there is no folder '{folder}': create it first")
    special = bool(kind) and not stat.S_ISREG(kind)
    if not os.access(path if special else folder, os.W_OK):
        raise OutputError(f"{path}: the {'device' if special else 'folder'} is not writable")
    if kind and not os.access(path, os.W_OK):
        raise OutputError(f"{path}: the file is write-protected")


def _check_descriptor(path: str, descriptor: int) -> None:
    import fcntl

    try:
        mode = fcntl.fcntl(descriptor, fcntl.F_GETFL) & os.O_ACCMODE
    except OSError:
        raise OutputError(f"{path}: file descriptor {descriptor} is not open") from None
    if mode == os.O_RDONLY:
        raise OutputError(f"{path}: file descriptor {descriptor} is not open for writing")
    if descriptor == 1 and sys.stdout is not None:
        sys.stdout.flush()


# --- temporary names ------------------------------------------------------------------------------


def partial_path(target: str) -> str:
    """Return a name beside ``target`` that nobody else uses: hidden, with the writer's process id in it."""
    folder, name = os.path.split(target)
    short = os.fsencode(name)[:_NAME_BYTES].decode("utf-8", "ignore")
    return os.path.join(folder, f".{short}.{os.getpid()}-{secrets.token_hex(4)}.partial")


def open_partial(path: str, buffering: int = -1) -> IO[bytes]:
    """Open a temporary file for writing and lock it for as long as it is open.

    The lock shows the clean-up of a process that cannot see this one (another container, another machine
    on the same network drive) that its writer lives. HDF5 locks its files by itself.
    """
    file = open(path, "wb", buffering)
    try_lock(file.fileno())
    return file


def try_lock(handle: int) -> bool:
    """Lock an open file against other processes; False where one of them has locked it.

    True without a lock on systems and file systems that have none: HDF5 does without there, too.
    """
    try:
        import fcntl
    except ImportError:
        return True
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as problem:
        return problem.errno not in (errno.EAGAIN, errno.EACCES, errno.EWOULDBLOCK)
    return True


def writers_in(folder: str, start: str = ".") -> dict[str, int]:
    """Give the temporary files in a folder whose names begin with ``start``, and their writers' ids."""
    try:
        names = os.listdir(folder or ".")
    except OSError:
        return {}  # a folder that may be written but not listed
    found = ((name, _PARTIAL.fullmatch(name)) for name in names if name.startswith(start))
    return {name: int(match[1]) for name, match in found if match is not None}


def is_running(process: int) -> bool:
    """Tell whether a process is there; where that cannot be asked without harm, it is taken to be."""
    if os.name != "posix":
        return True  # os.kill(..., 0) would end it
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        pass
    return True


def remove_orphans(folder: str) -> None:
    """Remove the temporary files in a folder whose writers are gone (killed, or the power failed)."""
    for name, process in writers_in(folder).items():
        path = os.path.join(folder, name)
        with contextlib.suppress(OSError):
            if not is_running(process) and not _is_locked(path):
                os.unlink(path)


def _is_locked(path: str) -> bool:
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    try:
        return not try_lock(handle)
    finally:
        os.close(handle)
