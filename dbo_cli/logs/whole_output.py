"""Outputs appear whole or not at all, several of them together or none.

Everything is written under a temporary name in the folder of the output, brought to the
disk, and renamed when complete; whatever ends the work before that (an error, Ctrl-C,
SIGTERM, a full disk) removes the temporary files and leaves the old ones as they were.
What a killed process left behind is cleaned up by the next one. No output overwrites an
input or another output, whatever they are called::

    with all_or_none():
        with signal_writer("drive.csv", columns) as writer: ...
        write_whole("state.json", state)
    # here both appear, or neither
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import stat
import sys
import unicodedata
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import IO, TYPE_CHECKING

from dbo_cli.errors import DboError, OutputError, UsageError
from dbo_cli.logs.request import Address, Given, host, parse_address

if TYPE_CHECKING:
    from dbo_cli.logs.sample_block import Column, FloatArray

# --- which file an output is ---

# Linux' names of open files, and the names that ``partial_path`` gives.
_DESCRIPTOR = re.compile(
    r"/(?:dev/fd|proc/(?:self|thread-self|\d+(?:/task/\d+)?)/fd)/(\d{1,9})"
)
_PARTIAL = re.compile(r"\..*\.(\d{1,10})-[0-9a-f]{8}\.partial", re.DOTALL)
# of the output's own name; most file systems allow 255 bytes for all of it
_NAME_BYTES = 100
WINDOWS = os.name == "nt"
# Names that Windows gives to devices, with any ending, and names that it cannot give to
# a file at all.
_NO_FILE = re.compile(
    r"(con|prn|aux|com[0-9]|lpt[0-9])(\..*)?|nul\..*|.*[<>:\"|?*].*|.*[. ]",
    re.IGNORECASE | re.DOTALL,
)
_MOST_LINKS = 40  # a longer chain of symbolic links is a circle; the kernel's own limit

FileIdentity = tuple[object, ...]


def descriptor_of(path: str) -> int | None:
    """Return the open file descriptor that a path stands for (``/dev/stdout``, ``/dev/fd/3``), or None.

    Such a path leads on to whatever the shell has opened there, perhaps a log that is
    being appended to: it is to be written to, never replaced or cut.
    """
    if os.name != "posix" or "\0" in path:
        return None
    target = path
    for _ in range(_MOST_LINKS):
        folder, name = os.path.split(target)
        target = os.path.join(os.path.realpath(folder or "."), name)
        match = _DESCRIPTOR.fullmatch(target)
        if match:
            return int(match[1])
        try:
            target = os.path.join(os.path.dirname(target), os.readlink(target))
        except OSError:
            return None
    return None


def is_replaceable(path: str) -> bool:
    """Tell whether an output is a file to be renamed to: no stream, device or open descriptor."""
    regular = path != "-" and (os.path.isfile(path) or not os.path.exists(path))
    return regular and descriptor_of(path) is None


def identity_of(address: Given, *, reading: bool = False) -> FileIdentity | None:
    """Return what two spellings of one file have in common, also of a file that is not there yet.

    None for what may be used twice without harm: devices such as ``/dev/null``, a
    terminal, a pipe that is read. Links, hard links, ``./``, ``..`` and, where the file
    system ignores it, case are seen through.

    Parameters
    ----------
    address
        A file, a group of an HDF5 file (the file counts), ``-`` or a path such as
        ``/dev/fd/3``.
    reading
        Whether ``-`` is standard input.
    """
    target = parse_address(address)
    descriptor = (
        (0 if reading else 1) if target.is_stream else descriptor_of(target.path)
    )
    try:
        status = os.stat(target.path) if descriptor is None else os.fstat(descriptor)
    except ValueError:
        return None
    except OSError:
        folder, name = os.path.split(os.path.realpath(target.path))
        if descriptor is not None or not os.path.isdir(folder):
            return None  # what is not open, or in no folder, is refused elsewhere
        status = os.stat(folder)
        if _ignores_case(folder):
            name = unicodedata.normalize("NFC", name).casefold()
        return ("new", status.st_dev, status.st_ino, name)
    if stat.S_ISREG(status.st_mode) or (stat.S_ISFIFO(status.st_mode) and not reading):
        return ("file", status.st_dev, status.st_ino)
    return None


def _ignores_case(folder: str) -> bool:
    """Tell whether the file system finds a folder by its name in the other case, too."""
    swapped = folder.swapcase()
    try:
        return swapped != folder and os.path.samefile(folder, swapped)
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
        Two outputs are one file, an output is an input, or two inputs are standard
        input.
    OutputError
        A folder is missing or not writable, an output is a folder, a name is too long.
    """
    streams = [address for address in inputs if _is_stream(address)]
    if len(streams) > 1:
        raise UsageError(
            "two inputs are standard input, which can be read once: give one of them as a file"
        )
    targets = [parse_address(output) for output in outputs]
    read = {identity_of(address, reading=True) for address in _readable(inputs)}
    written: dict[FileIdentity, Address] = {}
    for target in targets:
        # what may be used twice is like nothing else
        which = identity_of(target) or (object(),)
        if which in read:
            raise UsageError(
                f"{_called(target)}: this output is also an input: write to another file"
            )
        if which in written:
            first, again = _called(written[which]), _called(target)
            same = f"{first} and {again} are" if first != again else f"{first} is"
            raise UsageError(
                f"{same} one file, and two outputs go there: give each a file of its own"
            )
        written[which] = target
        if not target.is_stream:
            _check_place(target.path)


def _is_stream(address: Given) -> bool:
    if isinstance(address, Address):
        return address.is_stream
    return address == "-"


def _readable(inputs: Sequence[Given]) -> Iterator[Address]:
    """Leave out what is no file: the name of a state, an empty word, what does not exist."""
    for address in inputs:
        with contextlib.suppress(DboError):
            target = parse_address(address)
            if target.is_stream or os.path.exists(target.path):
                yield target


def check_output(address: Given, protect: Sequence[Given] = ()) -> None:
    """Refuse one output that cannot be written or is an input; see :func:`check_outputs`."""
    check_outputs([address], protect)


def _called(target: Address) -> str:
    return "standard output" if target.is_stream else target.path


def _check_place(path: str) -> None:
    if WINDOWS and _NO_FILE.fullmatch(os.path.basename(os.path.splitdrive(path)[1])):
        raise OutputError(f"{path}: Windows has no file of this name: give another one")
    descriptor = descriptor_of(path)
    if descriptor is not None:
        _check_descriptor(path, descriptor)
        return
    kind = 0
    try:
        kind = os.stat(path).st_mode
    except ValueError as problem:
        raise OutputError(f"{path!r}: this is no file name: {problem}") from None
    except OSError as problem:
        if problem.errno in (errno.ENAMETOOLONG, errno.ELOOP):
            raise OutputError(
                f"{path}: cannot be written: {problem.strerror}"
            ) from None
    folder = (
        os.path.dirname(os.path.realpath(path) if os.path.islink(path) else path) or "."
    )
    special = bool(kind) and not stat.S_ISREG(kind)
    if stat.S_ISDIR(kind):
        raise OutputError(f"{path}: this is a folder: give a file name")
    if not os.path.isdir(folder):
        raise OutputError(f"{path}: there is no folder '{folder}': create it first")
    if not os.access(path if special else folder, os.W_OK):
        raise OutputError(
            f"{path}: the {'device' if special else 'folder'} is not writable"
        )
    if kind and not os.access(path, os.W_OK):
        raise OutputError(f"{path}: the file is write-protected")


def _check_descriptor(path: str, descriptor: int) -> None:
    import fcntl

    try:
        mode = fcntl.fcntl(descriptor, fcntl.F_GETFL) & os.O_ACCMODE
    except OSError:
        raise OutputError(f"{path}: file descriptor {descriptor} is not open") from None
    if mode == os.O_RDONLY:
        raise OutputError(
            f"{path}: file descriptor {descriptor} is not open for writing"
        )
    if descriptor == 1 and sys.stdout is not None:
        sys.stdout.flush()


# --- temporary names ---


def partial_path(target: str) -> str:
    """Return a name beside ``target`` that nobody else uses: hidden, with the writer's process id in it."""
    folder, name = os.path.split(target)
    short = os.fsencode(name)[:_NAME_BYTES].decode("utf-8", "ignore")
    return os.path.join(folder, f".{short}.{os.getpid()}-{os.urandom(4).hex()}.partial")


def open_partial(path: str, buffering: int = -1) -> IO[bytes]:
    """Open a temporary file for writing and lock it for as long as it is open.

    The lock shows the clean-up of a process that cannot see this one (another
    container, another machine on the same network drive) that its writer lives. HDF5
    locks its files by itself.
    """
    file = open(path, "wb", buffering)
    try_lock(file.fileno())
    return file


def try_lock(handle: int) -> bool:
    """Lock an open file against other processes; False where one of them has locked it.

    True without a lock on systems and file systems that have none: HDF5 does without
    there, too.
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
    matches = (
        (name, _PARTIAL.fullmatch(name)) for name in names if name.startswith(start)
    )
    return {name: int(match[1]) for name, match in matches if match is not None}


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


# --- outputs under temporary names, and their renames ---

_ERRNO = re.compile(
    r"(?:errno = |os error )(\d+)"
)  # in the texts of HDF5 and of polars

Prepare = Callable[[str], AbstractContextManager[bool]]
"""Takes the temporary name right before the renames, and is left after them: it may hold a lock meanwhile.

Gives whether there was no file of the output's own name.
"""


@dataclass
class Output:
    """An output that is complete under its temporary name.

    Attributes
    ----------
    path, target
        Its name as it was given, and with symbolic links followed.
    temporary, backup
        The names of what was written, and of the file that it replaces.
    prepare
        Called before the renames.
    exclusive
        Whether no file of its name may be there.
    renamed
        Whether it has its own name by now.
    """

    path: str
    target: str
    temporary: str
    prepare: Prepare
    exclusive: bool = False
    backup: str | None = None
    renamed: bool = False


def _unprepared(temporary: str) -> AbstractContextManager[bool]:
    return contextlib.nullcontext(False)


class OutputSet:
    """The outputs of one command, collected under temporary names; see :func:`all_or_none`."""

    def __init__(self) -> None:
        self.pending: list[Output] = []
        self.folders: list[str] = []

    def commit(self) -> None:
        """Rename everything to its own name; where that fails, everything is as it was before.

        Raises
        ------
        OutputError
            A rename failed, or ``prepare`` refused.
        """
        done = False
        while not done:
            with contextlib.ExitStack() as prepared:
                for output in self.pending:
                    with _telling(output.path):
                        lock = output.prepare(output.temporary)
                        output.exclusive = prepared.enter_context(lock)
                        # Else a power failure leaves an empty file.
                        _bring_to_disk(output.temporary, os.O_RDWR)
                        _keep_permissions(output)
                done = self._renamed()
        for output in self.pending:
            _remove(output.backup)
        for folder in {os.path.dirname(output.target) for output in self.pending}:
            with contextlib.suppress(OSError):  # Windows, some network drives
                _bring_to_disk(folder, os.O_RDONLY)

    def give_up(self) -> None:
        """Remove everything that was written and not renamed, and the folders made for it."""
        for output in self.pending:
            _remove(output.temporary)
            _remove(output.backup)  # a signal came when everything was renamed
        for folder in reversed(self.folders):
            with contextlib.suppress(OSError):
                os.rmdir(folder)

    def _renamed(self) -> bool:
        """Rename everything; False where a file appeared meanwhile and it must be tried again."""
        with host().signals_held():
            try:
                for output in self.pending:
                    with _telling(output.path):
                        if not self._rename(output):
                            self._take_back()
                            return False
            except BaseException:
                self._take_back()
                raise
        return True

    def _rename(self, output: Output) -> bool:
        """Give an output its own name; False where a file appeared there that may not be replaced."""
        if output.exclusive:
            try:
                os.link(output.temporary, output.target)
                _remove(output.temporary)
            except FileExistsError:
                return False
            except OSError:  # a file system without hard links: the best that it can do
                os.replace(output.temporary, output.target)
        else:
            if len(self.pending) > 1 and os.path.exists(output.target):
                self._back_up(output)
            os.replace(output.temporary, output.target)
        output.renamed = True
        return True

    def _back_up(self, output: Output) -> None:
        """Keep the file that an output replaces, until all have their names."""
        backup = partial_path(output.target)
        if WINDOWS:  # a link to a file that is open could not be removed again
            os.replace(output.target, backup)
            output.backup = backup
            return
        with contextlib.suppress(OSError):
            os.link(output.target, backup)
            output.backup = backup

    def _take_back(self) -> None:
        """Undo the renames done so far: the new files go under their temporary names again."""
        for output in self.pending:
            with contextlib.suppress(OSError):
                if output.renamed:
                    os.replace(output.target, output.temporary)
                if output.backup is not None:
                    os.replace(output.backup, output.target)
            # still there where nothing had been renamed: both names were one file's
            _remove(output.backup)
            output.renamed = False
            output.backup = None


_CURRENT: ContextVar[OutputSet | None] = ContextVar("dbo_outputs", default=None)


@dataclass(frozen=True)
class KeptSignal:
    """A signal that was kept instead of written: what its writer was given."""

    address: Address
    columns: Sequence[Column]
    format: str | None
    attributes: Mapping[str, str | float]
    arrays: tuple[FloatArray, ...]
    commented: bool = False


@dataclass
class KeptOutputs:
    """Outputs that were kept instead of written, for another process or a larger file."""

    signals: list[KeptSignal] = field(default_factory=list)
    documents: list[tuple[str, bytes]] = field(default_factory=list)


KEPT: ContextVar[KeptOutputs | None] = ContextVar("dbo_kept", default=None)


@contextlib.contextmanager
def kept_outputs() -> Iterator[KeptOutputs]:
    """Let ``write_whole`` and ``signal_writer`` keep their data inside the block and write nothing."""
    outputs = KeptOutputs()
    token = KEPT.set(outputs)
    try:
        yield outputs
    finally:
        KEPT.reset(token)


@contextlib.contextmanager
def all_or_none() -> Iterator[None]:
    """Let all outputs written inside the block appear together at its end, or none of them.

    :func:`replacing`, :func:`write_whole` and ``signal_writer`` join by themselves,
    however deep below they are called (in the same thread); an inner block joins the
    outer one. Standard output, pipes and devices are written at once: what has gone
    there cannot be taken back.

    After a failure or whatever else unwinds the stack everything is as it was. Only a
    process that is killed (or a power failure) between the renames, some microseconds
    apart, can leave a part of them.

    Raises
    ------
    OutputError
        Something cannot be written.
    """
    with _current_or_new() as outputs:
        token = _CURRENT.set(outputs)
        try:
            yield
        finally:
            _CURRENT.reset(token)


@contextlib.contextmanager
def _current_or_new() -> Iterator[OutputSet]:
    outputs = _CURRENT.get()
    if outputs is not None:
        yield outputs
        return
    outputs = OutputSet()
    try:
        yield outputs
        outputs.commit()
    except BaseException:
        with host().signals_held():
            outputs.give_up()
        raise


@contextlib.contextmanager
def replacing(path: str, prepare: Prepare = _unprepared) -> Iterator[str]:
    """Give a temporary name beside ``path`` to write to; rename it to ``path`` at the end, or remove it.

    Inside :func:`all_or_none` the rename waits for the other outputs. A device or named
    pipe cannot be replaced and is given as it is; so is a path such as ``/dev/fd/3``.
    Where ``prepare`` found no file called ``path`` and there is one after all, it is
    called again.

    Raises
    ------
    OutputError
        Writing failed (disk full, folder gone, no permission), or another output has
        this name.
    """
    if not is_replaceable(path):
        with _telling(path):
            yield path
        return
    target = os.path.realpath(path)  # through a symbolic link, its target is replaced
    with _current_or_new() as outputs:
        which = identity_of(target)
        for earlier in outputs.pending:
            if which is not None and identity_of(earlier.target) == which:
                raise OutputError(
                    f"{path}: two outputs go there: give each a file of its own"
                )
        remove_orphans(os.path.dirname(target))
        output = Output(path, target, partial_path(target), prepare)
        with _telling(path):
            try:
                yield output.temporary
            except BaseException:
                _remove(output.temporary)
                raise
        outputs.pending.append(output)


def make_folder(path: str) -> None:
    """Make a folder and what is missing above; inside :func:`all_or_none` it goes where outputs are given up.

    Raises
    ------
    OutputError
        It cannot be made.
    """
    outputs = _CURRENT.get() or OutputSet()
    missing = []
    above = os.path.abspath(path)
    while not os.path.isdir(above) and os.path.dirname(above) != above:
        missing.append(above)
        above = os.path.dirname(above)
    for folder in reversed(missing):
        with _telling(path):
            try:
                os.mkdir(folder)
            except FileExistsError:
                if not os.path.isdir(folder):
                    raise
            else:
                outputs.folders.append(folder)


@contextlib.contextmanager
def opened(path: str, buffering: int = -1) -> Iterator[IO[bytes]]:
    """Open an output for bytes: a temporary file that is renamed at the end, a pipe, a device, ``-``.

    Raises
    ------
    OutputError
        It cannot be written (a full disk behind a redirection, too); a closed pipe
        stays a BrokenPipeError.
    """
    descriptor = 1 if path == "-" else descriptor_of(path)
    if descriptor == 1:
        with _telling("standard output"):
            sys.stdout.flush()
            yield sys.stdout.buffer
            sys.stdout.buffer.flush()
    elif descriptor is not None:
        with _telling(path), os.fdopen(os.dup(descriptor), "wb", buffering) as stream:
            # opened anew by its name, the file behind it would be cut to nothing
            yield stream
    else:
        with replacing(path) as temporary, open_partial(temporary, buffering) as stream:
            yield stream


@contextlib.contextmanager
def _telling(path: str) -> Iterator[None]:
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as problem:
        raise OutputError(f"{path}: {reason_of(problem)}") from None
    except (
        RuntimeError
    ) as problem:  # what HDF5 raises at a full disk when it closes a file
        if _ERRNO.search(str(problem)) is None:
            raise
        raise OutputError(f"{path}: {reason_of(OSError(str(problem)))}") from None


def reason_of(problem: OSError) -> str:
    """Return why writing failed; HDF5 and polars give the error's number only in its text."""
    number, inside = problem.errno, _ERRNO.search(str(problem))
    if number is None and inside:
        number = int(inside[1])
    if number in (errno.ENOSPC, errno.EDQUOT):
        return "the disk is full: nothing was written"
    return f"cannot be written: {os.strerror(number) if number else str(problem).splitlines()[0]}"


def _keep_permissions(output: Output) -> None:
    """Give what was written the permissions of the file that it replaces."""
    with contextlib.suppress(OSError):
        permissions = stat.S_IMODE(os.stat(output.target).st_mode)
        os.chmod(output.temporary, permissions)


def _remove(path: str | None) -> None:
    if path is not None:
        with contextlib.suppress(OSError):
            os.unlink(path)


def _bring_to_disk(path: str, flags: int) -> None:
    """Wait until a file or folder is stored; Windows wants a handle that may write."""
    handle = os.open(path, flags)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_whole(address: Given, data: bytes, *, protect: Sequence[Given] = ()) -> None:
    """Write a complete file at once (``-`` is standard output).

    Raises
    ------
    UsageError
        The output is one of the inputs in ``protect``.
    OutputError
        It cannot be written; what stood there is left as it was.
    """
    target = parse_address(address)
    outputs = KEPT.get()
    if outputs is not None:
        outputs.documents.append((target.text, data))
        return
    check_output(target, protect)
    if target.group is not None:
        raise UsageError(
            f"{target.text}: '::' names a group of an HDF5 file, and this output is no signal"
        )
    with opened(target.path) as file:
        file.write(data)
