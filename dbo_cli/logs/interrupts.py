"""What Ctrl-C and the signals that end a process do: reads hear them, temporary files are removed."""

from __future__ import annotations

import contextlib
import functools
import signal
import threading
from collections.abc import Iterator
from types import FrameType

_ENDING_SIGNALS = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]


@functools.cache
def keep_interrupts() -> None:
    """Let SIGINT interrupt system calls again; to be called after polars is imported.

    Polars puts a handler of its own before Python's and asks for interrupted reads to be restarted, so that
    a command waiting on standard input would hear Ctrl-C only when the next row arrives. It does so
    once, when it is imported, so the first call is the one that counts.
    """
    if hasattr(signal, "siginterrupt"):
        with contextlib.suppress(ValueError, OSError):
            signal.siginterrupt(signal.SIGINT, True)


@contextlib.contextmanager
def ending_signals_raise() -> Iterator[None]:
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


@contextlib.contextmanager
def signals_wait() -> Iterator[None]:
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
