"""Ctrl-C ends a read that waits for input, whatever a library does to the signal's handler."""

from __future__ import annotations

import contextlib
import signal


def keep_interrupts() -> None:
    """Let SIGINT interrupt system calls again; to be called after polars is imported.

    Polars puts a handler of its own before Python's and asks for interrupted reads to be restarted, so that
    a command waiting on standard input would hear Ctrl-C only when the next row arrives.
    """
    if hasattr(signal, "siginterrupt"):
        with contextlib.suppress(ValueError, OSError):
            signal.siginterrupt(signal.SIGINT, True)
