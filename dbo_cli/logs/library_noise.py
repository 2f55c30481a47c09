"""What a compiled library says and does by itself on a damaged file: only this program's line is to be seen.

The libraries behind Parquet, Feather and workbooks print a page of their own before they raise an error, and
end the process where damaged bytes make them ask for more memory than there is. (Of 3,000 damaged Parquet
files a few dozen led to such a page, one in some hundreds to such an end.)
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import tempfile
from collections.abc import Iterator
from typing import IO, Any

from dbo_cli.logs.column_table import GAVE_UP
from dbo_cli.logs.plain_text import cleaned


@contextlib.contextmanager
def contained(place: str, kind: str) -> Iterator[None]:
    """Hold back what is written to standard error inside; it is dropped where an error is raised.

    Parameters
    ----------
    place
        The file that is read.
    kind
        What it should be, for the line that is said where the library ends the process (exit code 1).
    """
    try:
        terminal = os.dup(2)
    except OSError:  # standard error is closed: nothing can be seen there
        yield
        return
    line = f"dbo: error: {cleaned(place)}: damaged {kind}: {GAVE_UP}\n"
    with _aside() as aside, _at_abort(terminal, line):
        os.dup2(aside.fileno(), 2)
        try:
            yield
        except BaseException:
            aside.truncate(0)
            raise
        finally:
            os.dup2(terminal, 2)
            os.close(terminal)
            aside.seek(0)
            if said := aside.read():  # by another thread
                os.write(2, said)


def _aside() -> IO[bytes]:
    try:
        return tempfile.TemporaryFile()
    except OSError:
        return open(os.devnull, "w+b")


@contextlib.contextmanager
def _at_abort(terminal: int, line: str) -> Iterator[None]:
    """Say a line and leave with exit code 1 where the library calls ``abort``.

    A handler of the ``signal`` module would run only after the library has returned, which it does not.
    """
    if os.name != "posix":
        yield
        return

    def leave(number: int) -> None:
        os.write(terminal, line.encode(errors="replace"))
        os._exit(1)

    library: Any = ctypes.CDLL(None)
    library.signal.restype = ctypes.c_void_p
    library.signal.argtypes = (ctypes.c_int, ctypes.c_void_p)
    handler = ctypes.CFUNCTYPE(None, ctypes.c_int)(leave)
    before = library.signal(signal.SIGABRT, ctypes.cast(handler, ctypes.c_void_p))
    try:
        yield
    finally:
        library.signal(signal.SIGABRT, before)
