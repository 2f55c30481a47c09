"""What belongs to the process: signals, standard error, and the libraries that touch them.

``prepare_process`` is called once, before a command line is run as a process; everything below ``cli`` leaves
the process alone.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Iterator
from types import FrameType
from typing import IO, Any

from dbo_cli.logs.libraries import GAVE_UP, Host, set_host
from dbo_cli.logs.plain_text import cleaned

_ENDING_SIGNALS = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]


def prepare_process() -> None:
    """Let SIGTERM and SIGHUP unwind the stack (exit code 128 + number), and hold libraries in check."""
    for number in _ENDING_SIGNALS:
        if signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, _end)
    set_host(CommandProcess())


def _end(number: int, frame: FrameType | None) -> None:
    raise SystemExit(128 + number)


class CommandProcess(Host):
    """A process that runs one command: nobody else's handlers or output are at stake."""

    def imported(self, module: str) -> None:
        """Undo what a library has done to the process when it was imported.

        Polars puts a handler of its own before Python's for SIGINT and asks for interrupted reads to be
        restarted, so that a command waiting on standard input would hear Ctrl-C only when the next row
        arrives. npTDMS writes its doubts to the terminal.
        """
        if module == "polars" and hasattr(signal, "siginterrupt"):
            with contextlib.suppress(ValueError, OSError):
                signal.siginterrupt(signal.SIGINT, True)
        if module == "nptdms":
            import logging

            from nptdms.log import log_manager

            log_manager.set_level(logging.CRITICAL)

    @contextlib.contextmanager
    def contained(self, place: str, kind: str) -> Iterator[None]:
        """Hold back what is written to standard error inside; it is dropped where an error is raised.

        Where the library ends the process, one line says which file was read (exit code 1). Of 3,000 damaged
        Parquet files a few dozen led to a page of the library's own, one in some hundreds to such an end.
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
                if written := aside.read():  # by another thread
                    os.write(2, written)

    @contextlib.contextmanager
    def signals_held(self) -> Iterator[None]:
        """Let signals that come during the renames act after them: all outputs are there then, or none."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        came: list[int] = []
        handlers = {}
        for number in (signal.SIGINT, *_ENDING_SIGNALS):
            handler = signal.getsignal(number)
            if callable(handler):
                handlers[number] = handler
                signal.signal(number, lambda which, frame: came.append(which))
        try:
            yield
        finally:
            for number, handler in handlers.items():
                signal.signal(number, handler)
        for which in came:
            handlers[signal.Signals(which)](which, None)


def _aside() -> IO[bytes]:
    import tempfile

    try:
        return tempfile.TemporaryFile()
    except OSError:
        return open(os.devnull, "w+b")


@contextlib.contextmanager
def _at_abort(terminal: int, line: str) -> Iterator[None]:
    """Write a line and leave with exit code 1 where the library calls ``abort``.

    A handler of the ``signal`` module would run only after the library has returned, which it does not.
    """
    if os.name != "posix":
        yield
        return
    import ctypes

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
