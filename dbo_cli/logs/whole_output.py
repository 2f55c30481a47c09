"""Outputs appear whole or not at all, several of them together or none.

Everything is written under a temporary name in the folder of the output, brought to the disk, and renamed
when complete; whatever ends the work before that (an error, Ctrl-C, SIGTERM, a full disk) removes the
temporary files and leaves the old ones as they were::

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
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import IO, TYPE_CHECKING

from dbo_cli.errors import OutputError, UsageError
from dbo_cli.logs import output_files
from dbo_cli.logs.addresses import Address, Given, parse_address
from dbo_cli.logs.libraries import host
from dbo_cli.logs.output_files import (
    check_output,
    check_outputs,
    descriptor_of,
    identity_of,
    is_replaceable,
    open_partial,
    partial_path,
    remove_orphans,
)

if TYPE_CHECKING:
    from dbo_cli.logs.out_column import OutColumn
    from dbo_cli.logs.sample_block import FloatArray

__all__ = [
    "KEPT", "KeptOutputs", "KeptSignal", "OutputSet", "all_or_none", "check_output", "check_outputs",
    "kept_outputs", "make_folder", "opened", "reason_of",
    "replacing", "standard_output", "write_whole",
]  # fmt: skip

_HDF5_ERRNO = re.compile(r"errno = (\d+)")

Prepare = Callable[[str], AbstractContextManager[bool]]
"""Takes the temporary name right before the renames, and is left after them: it may hold a lock meanwhile.

Gives whether there was no file of the output's own name.
"""


@dataclass
class _Pending:
    """An output that is complete under its temporary name."""

    path: str
    target: str
    temporary: str
    prepare: Prepare
    backup: str | None = None
    renamed: bool = False


class _AppearedMeanwhile(Exception):
    """A file that was not there has been made by somebody else."""


def _unprepared(temporary: str) -> AbstractContextManager[bool]:
    return contextlib.nullcontext(False)


class OutputSet:
    """The outputs of one command, collected under temporary names; see :func:`all_or_none`."""

    def __init__(self) -> None:
        self._pending: list[_Pending] = []
        self._folders: list[str] = []

    def make_folder(self, path: str) -> None:
        """Make a folder and what is missing above it; removed again where the outputs are given up.

        Raises
        ------
        OutputError
            It cannot be made.
        """
        missing = []
        here = os.path.abspath(path)
        while not os.path.isdir(here) and os.path.dirname(here) != here:
            missing.append(here)
            here = os.path.dirname(here)
        for folder in reversed(missing):
            with _telling(path):
                try:
                    os.mkdir(folder)
                except FileExistsError:
                    if not os.path.isdir(folder):
                        raise
                else:
                    self._folders.append(folder)

    @contextlib.contextmanager
    def replacing(self, path: str, prepare: Prepare = _unprepared) -> Iterator[str]:
        """Give a temporary name to write ``path`` under; it is renamed with the others.

        Where ``prepare`` found no file called ``path`` and there is one after all, it is called again.

        Raises
        ------
        OutputError
            Writing failed, or another output of the set has this name.
        """
        target = os.path.realpath(path)  # through a symbolic link, its target is replaced
        which = identity_of(target)
        if which is not None and any(identity_of(one.target) == which for one in self._pending):
            raise OutputError(f"{path}: two outputs go there: give each a file of its own")
        remove_orphans(os.path.dirname(target))
        pending = _Pending(path, target, partial_path(target), prepare)
        with _telling(path):
            try:
                yield pending.temporary
            except BaseException:
                _remove(pending.temporary)
                raise
        self._pending.append(pending)

    def commit(self) -> None:
        """Rename everything to its own name; where that fails, everything is as it was before.

        Raises
        ------
        OutputError
            A rename failed, or ``prepare`` refused.
        """
        with contextlib.ExitStack() as prepared:
            while not self._renamed([self._made_ready(one, prepared) for one in self._pending]):
                prepared.close()
        for one in self._pending:
            _remove(one.backup)
        for folder in {os.path.dirname(one.target) for one in self._pending}:
            with contextlib.suppress(OSError):  # Windows, some network drives
                _bring_to_disk(folder, os.O_RDONLY)
        self._pending.clear()
        self._folders.clear()

    def give_up(self) -> None:
        """Remove everything that was written and not renamed, and the folders made for it."""
        for one in self._pending:
            _remove(one.temporary)
            _remove(one.backup)  # a signal came when everything was renamed
        for folder in reversed(self._folders):
            with contextlib.suppress(OSError):
                os.rmdir(folder)
        self._pending.clear()
        self._folders.clear()

    def _made_ready(self, one: _Pending, prepared: contextlib.ExitStack) -> bool:
        """Prepare an output and bring it to the disk: no rename shows an empty file after a power failure."""
        with _telling(one.path):
            alone = prepared.enter_context(one.prepare(one.temporary))
            _bring_to_disk(one.temporary, os.O_RDWR)
            with contextlib.suppress(OSError):  # the permissions of the file that it replaces
                os.chmod(one.temporary, stat.S_IMODE(os.stat(one.target).st_mode))
        return alone

    def _renamed(self, alone: Sequence[bool]) -> bool:
        """Rename everything; False where a file appeared meanwhile and it must be tried again."""
        with host().signals_held():
            try:
                for one, exclusive in zip(self._pending, alone, strict=True):
                    with _telling(one.path):
                        self._rename(one, exclusive)
            except BaseException as problem:
                self._take_back()
                if isinstance(problem, _AppearedMeanwhile):
                    return False
                raise
        return True

    def _rename(self, one: _Pending, exclusive: bool) -> None:
        if exclusive:
            try:
                os.link(one.temporary, one.target)
                _remove(one.temporary)
            except FileExistsError:
                raise _AppearedMeanwhile from None
            except OSError:  # a file system without hard links: the best that it can do
                os.replace(one.temporary, one.target)
        else:
            if len(self._pending) > 1 and os.path.exists(one.target):
                backup = partial_path(one.target)
                if output_files.WINDOWS:  # a link to a file that is open could not be removed again
                    os.replace(one.target, backup)
                    one.backup = backup
                else:
                    with contextlib.suppress(OSError):
                        os.link(one.target, backup)
                        one.backup = backup
            os.replace(one.temporary, one.target)
        one.renamed = True

    def _take_back(self) -> None:
        """Undo the renames done so far: the new files go under their temporary names again."""
        for one in self._pending:
            with contextlib.suppress(OSError):
                if one.renamed:
                    os.replace(one.target, one.temporary)
                if one.backup is not None:
                    os.replace(one.backup, one.target)
            _remove(one.backup)  # still there where nothing had been renamed: both names were one file's
            one.renamed, one.backup = False, None


_CURRENT: ContextVar[OutputSet | None] = ContextVar("dbo_outputs", default=None)


@dataclass(frozen=True)
class KeptSignal:
    """A signal that was kept instead of written: what its writer was given."""

    address: Address
    columns: Sequence[OutColumn]
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
    kept = KeptOutputs()
    token = KEPT.set(kept)
    try:
        yield kept
    finally:
        KEPT.reset(token)


@contextlib.contextmanager
def all_or_none() -> Iterator[OutputSet]:
    """Let all outputs written inside the block appear together at its end, or none of them.

    :func:`replacing`, :func:`write_whole` and ``signal_writer`` join by themselves, however deep below they
    are called (in the same thread); an inner block joins the outer one. Standard output, pipes and devices
    are written at once: what has gone there cannot be taken back.

    After a failure or whatever else unwinds the stack everything is as it was. Only a process that is killed
    (or a power failure) between the renames, some microseconds apart, can leave a part of them.

    Raises
    ------
    OutputError
        Something cannot be written.
    """
    current = _CURRENT.get()
    if current is not None:
        yield current
        return
    with _committed() as outputs:
        token = _CURRENT.set(outputs)
        try:
            yield outputs
        finally:
            _CURRENT.reset(token)


@contextlib.contextmanager
def _committed() -> Iterator[OutputSet]:
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

    Inside :func:`all_or_none` the rename waits for the other outputs. A device or named pipe cannot be
    replaced and is given as it is; so is a path such as ``/dev/fd/3``.

    Raises
    ------
    OutputError
        Writing failed (disk full, folder gone, no permission).
    """
    if not is_replaceable(path):
        with _telling(path):
            yield path
        return
    current = _CURRENT.get()
    with contextlib.nullcontext(current) if current is not None else _committed() as outputs:
        with outputs.replacing(path, prepare) as temporary:
            yield temporary


def make_folder(path: str) -> None:
    """Make a folder for outputs; inside :func:`all_or_none` it goes again where they are given up.

    Raises
    ------
    OutputError
        It cannot be made.
    """
    (_CURRENT.get() or OutputSet()).make_folder(path)


@contextlib.contextmanager
def opened(path: str, buffering: int = -1) -> Iterator[IO[bytes]]:
    """Open an output for bytes: a temporary file that is renamed at the end, a pipe, a device, ``-``.

    Raises
    ------
    OutputError
        It cannot be written.
    """
    descriptor = 1 if path == "-" else descriptor_of(path)
    if descriptor == 1:
        with standard_output() as stream:
            yield stream
    elif descriptor is not None:
        with _telling(path), os.fdopen(os.dup(descriptor), "wb", buffering) as stream:
            yield stream  # opened anew by its name, the file behind it would be cut to nothing
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
    except RuntimeError as problem:  # what HDF5 raises at a full disk when it closes a file
        if _HDF5_ERRNO.search(str(problem)) is None:
            raise
        raise OutputError(f"{path}: {reason_of(OSError(str(problem)))}") from None


def reason_of(problem: OSError) -> str:
    """Return why writing failed; HDF5 gives the number of the error only inside its text."""
    number, inside = problem.errno, _HDF5_ERRNO.search(str(problem))
    if number is None and inside:
        number = int(inside[1])
    if number in (errno.ENOSPC, errno.EDQUOT):
        return "the disk is full: nothing was written"
    return f"cannot be written: {os.strerror(number) if number else str(problem).splitlines()[0]}"


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
    kept = KEPT.get()
    if kept is not None:
        kept.documents.append((target.text, data))
        return
    check_output(target, protect)
    if target.group is not None:
        raise UsageError(f"{target.text}: '::' names a group of an HDF5 file, and this output is no signal")
    with opened(target.path) as file:
        file.write(data)


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
