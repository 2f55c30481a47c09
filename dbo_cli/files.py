"""Files of a command: what it reads, and outputs that appear whole or not at all.

An output is written under a temporary name in its folder, brought to the disk, and
renamed when it is complete. Whatever ends the work before that (an error, a signal, a
full disk) removes the temporary file and leaves the old one as it was::

    with Outputs() as outputs:  # both appear, or neither
        outputs.write_text("model.json", text)
        outputs.write_text("summary.json", figures)

A command never writes in place of a file that it reads. Whoever opens an input says so
(:func:`note_input`), and files are compared themselves, not their names: links and
relative paths lead to the same file. Only a state may replace the state that was read,
and a history the history. In the library nothing is noted: there a file may be read
and saved again.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import signal
import stat
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import FrameType, TracebackType
from typing import IO

from dbo_cli.errors import OutputError

FileId = tuple[int, int]  # device and inode
STDOUT = ("-", "/dev/stdout")
UNPRINTABLE = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]"
)
"""Control characters but tabs and new lines, marks of direction, and bytes of a name that are no text."""


_is_command = False  # whether a command line runs: a library's files are not noted
_inputs: list[tuple[FileId, str, str]] = []  # of the command line: kind and name
_outputs: dict[str, Output] = {}  # of the command line, by what was typed
_unfinished: set[str] = set()  # temporary files
_is_naming = False
_late_signals: list[int] = []


# --- one command ---


@contextlib.contextmanager
def command() -> Iterator[None]:
    """Note inputs and outputs while a command line runs."""
    global _is_command
    _is_command = True
    try:
        yield
    finally:
        _is_command = False
        _inputs.clear()
        _outputs.clear()


def note_input(path: str, kind: str) -> None:
    """Note a file that is about to be read.

    Parameters
    ----------
    path
        ``-`` is standard input.
    kind
        What it is read as: ``log``, ``model``, ``state``, ``history``.

    Raises
    ------
    OutputError
        It is an output, too.
    """
    if not _is_command:
        return
    identity = _identity(path, sys.stdin)
    if identity is not None:
        name = "standard input" if path == "-" else path
        _inputs.append((identity, kind, name))
        _require_apart()


def _require_apart() -> None:
    """Refuse an output that is an input (OutputError)."""
    for output in _outputs.values():
        for identity, kind, name in _inputs:
            if identity == output.identity and kind != output.replaces:
                shown = "standard output" if output.is_stdout else output.path
                raise OutputError(
                    f"{shown}: this is the {kind} {name}, which is read: write to another file"
                )


def missing_outputs() -> list[str]:
    """Return the files that the command was to write and that have not appeared."""
    return [path for path, output in _outputs.items() if not output.has_appeared]


def check_outputs(*paths: str | None, **replacing: str | None) -> None:
    """Refuse outputs before any long work; None stands for an output that is not wanted.

    Parameters
    ----------
    *paths
        Outputs that replace nothing that is read.
    **replacing
        Outputs that may replace an input of this kind: ``state=``, ``history=``.

    Raises
    ------
    OutputError
        A folder is missing or not writable, a path is a folder, two paths are one file,
        or a path is an input.
    """
    outputs = Outputs()
    kinds = [(path, "") for path in paths]
    kinds += [(path, kind) for kind, path in replacing.items()]
    for path, kind in kinds:
        if path is not None:
            outputs.add(path, kind)


def end_by_signal(number: int, frame: FrameType | None = None) -> None:
    """End the process at once; nothing half written is left.

    An exception would be lost in a callback of a library, or become another one. While
    outputs get their names, the signal waits: all appear, or none.
    """
    if _is_naming:
        _late_signals.append(number)
        return
    for path in list(_unfinished):
        with contextlib.suppress(OSError):
            os.unlink(path)
    if number == signal.SIGINT:
        with contextlib.suppress(OSError):
            os.write(2, b"dbo: interrupted\n")
    os._exit(128 + number)


def _identity(path: str, standard: object) -> FileId | None:
    """Return which file a path leads to; None where it is no regular file."""
    try:
        if path == "-":
            status = os.fstat(standard.fileno())  # type: ignore[attr-defined]
        else:
            status = os.stat(path)
    except (OSError, ValueError, AttributeError):
        return None
    if not stat.S_ISREG(status.st_mode):
        return None
    return status.st_dev, status.st_ino


# --- outputs ---


class Outputs(contextlib.AbstractContextManager["Outputs"]):
    """Files that appear together when the block is left, or none of them."""

    def __init__(self) -> None:
        self._files: list[Output] = []
        self._folders: list[Path] = []

    def add(self, path: str | os.PathLike[str], replaces: str = "") -> Output:
        """Note an output.

        Parameters
        ----------
        path
            ``-`` is standard output.
        replaces
            The kind of input that it may replace.

        Raises
        ------
        OutputError
            It cannot be written, is noted already, or is an input.
        """
        file = Output(os.fspath(path), replaces)
        for noted in self._files:
            is_same = file.temporary is not None and file.target == noted.target
            if is_same or (file.is_stdout and noted.is_stdout):
                raise OutputError(f"{path}: two outputs go there: type two names")
        self._files.append(file)
        if _is_command:
            _outputs[file.path] = file
            _require_apart()
        return file

    def write_text(
        self, path: str | os.PathLike[str], text: str, replaces: str = ""
    ) -> None:
        """Write a small file of text, without signs that change a terminal; see :meth:`add`."""
        self.write_bytes(path, UNPRINTABLE.sub(" ", text).encode(), replaces)

    def write_bytes(
        self, path: str | os.PathLike[str], data: bytes, replaces: str = ""
    ) -> None:
        """Write a small file of bytes; see :meth:`add`."""
        file = self.add(path, replaces)
        stream = file.open()
        with telling(file.path):
            stream.write(data)
            stream.flush()

    def write_all(
        self, folder: str | os.PathLike[str], files: Mapping[str, bytes]
    ) -> list[Path]:
        """Write files into a folder, which is made where there is none; see :meth:`add`."""
        target = Path(folder)
        with telling(str(folder)):
            target.mkdir(parents=True, exist_ok=True)
        self._folders.append(target)
        for name, data in files.items():
            self.write_bytes(target / name, data)
        return [target / name for name in files]

    def __exit__(
        self,
        kind: type[BaseException] | None,
        problem: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Give all files their names, or remove all that was written."""
        global _is_naming
        try:
            if kind is None:
                for file in self._files:
                    file.finish()
                _is_naming = True
                for file in self._files:
                    file.rename()
        finally:
            _is_naming = False
            for file in self._files:
                file.remove()
            for folder in self._folders:
                with contextlib.suppress(OSError):
                    folder.rmdir()  # empty: nothing was written
            if _late_signals:
                end_by_signal(_late_signals[0])


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a small file, whole or not at all; ``-`` is standard output (OutputError)."""
    with Outputs() as outputs:
        outputs.write_text(path, text)


def write_all(folder: str | os.PathLike[str], files: Mapping[str, bytes]) -> list[Path]:
    """Write files into a folder, which is made where there is none: all of them or nothing (OutputError)."""
    with Outputs() as outputs:
        return outputs.write_all(folder, files)


class Output:
    """One output: the name that it shall have, and what is written meanwhile.

    ``temporary`` is a name beside it; standard output, pipes and devices have none.
    """

    def __init__(self, path: str, replaces: str = "") -> None:
        """Check whether it can be written (OutputError)."""
        self.path = path  # as typed
        self.replaces = replaces
        self.is_stdout = path in STDOUT
        self.closing = contextlib.ExitStack()  # ends the format, then closes the stream
        self.temporary: str | None = None
        if not path or "\0" in path or os.path.isdir(path):
            raise OutputError(
                f"{path!r}: this is a folder, or no name: give a file name"
            )
        self.target = os.path.realpath(path)
        self.identity = _identity("-" if self.is_stdout else path, sys.stdout)
        is_special = os.path.exists(path) and not os.path.isfile(path)
        self.has_appeared = self.is_stdout or is_special
        if self.has_appeared:
            return
        folder, name = os.path.split(self.target)
        if not os.access(folder, os.W_OK):
            raise OutputError(
                f"{path}: there is no folder '{folder}' that can be written: create it, or write elsewhere"
            )
        mark = f"{os.getpid()}-{os.urandom(4).hex()}"
        self.temporary = os.path.join(folder, f".{name[:50]}.{mark}.partial")

    def begin(self) -> str:
        """Return the temporary name, for a file that is removed when the process is told to end."""
        assert self.temporary is not None
        _unfinished.add(self.temporary)
        return self.temporary

    def open(self) -> IO[bytes]:
        """Open the temporary file, or the pipe or device itself."""
        with telling(self.path):
            if self.is_stdout:
                sys.stdout.flush()
                return sys.stdout.buffer
            if self.temporary is None:
                return self.closing.enter_context(open(self.path, "wb"))
            return self.closing.enter_context(open(self.begin(), "xb"))

    def finish(self) -> None:
        """Bring everything to the disk, with the permissions of the file that it replaces."""
        with telling(self.path):
            self.close()
            if self.temporary is None:
                return
            if os.path.exists(self.target):
                os.chmod(self.temporary, os.stat(self.target).st_mode & 0o7777)
            with open(self.temporary, "rb") as written:
                os.fsync(written.fileno())

    def close(self) -> None:
        """End the format and close the stream; standard output stays open."""
        self.closing.close()
        if self.is_stdout:
            sys.stdout.buffer.flush()

    def rename(self) -> None:
        """Give the output its name."""
        if self.temporary is not None:
            with telling(self.path):
                os.replace(self.temporary, self.target)
            self.has_appeared = True

    def remove(self) -> None:
        """Close the stream, and remove what has not got its name."""
        with contextlib.suppress(Exception):
            self.close()
        if self.temporary is not None:
            with contextlib.suppress(OSError):
                os.unlink(self.temporary)
            _unfinished.discard(self.temporary)


@contextlib.contextmanager
def telling(path: str) -> Iterator[None]:
    """Turn what the system says into one line; a closed pipe stays BrokenPipeError."""
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as problem:
        shown = "standard output" if path == "-" else path
        reason = f"cannot be written: {problem.strerror or problem}"
        if problem.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            reason = "the disk is full, so nothing was written: free some space, or write elsewhere"
        raise OutputError(f"{shown}: {reason}") from None
