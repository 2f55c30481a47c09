"""Where the process begins, as ``dbo`` or ``python -m dbo_cli``: Ctrl-C is heard before anything is imported.

What cannot be heard is Ctrl-C while the interpreter itself starts, before the first
line of this package: it says so in its own way (a traceback, or nothing).
"""

import os

try:
    import signal
    from types import FrameType
except KeyboardInterrupt:
    os._exit(130)


def _leave(number: int, frame: FrameType | None) -> None:
    """End at once: nothing has been begun, so there is nothing to clean up."""
    os._exit(130)


def main() -> None:
    """Serve the console script."""
    # Where a shell lets its background jobs ignore interrupts, they stay ignored.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _leave)
    from dbo_cli.cli.app import run

    run()


if __name__ == "__main__":
    main()
