"""The entry of the program: an outcome becomes an exit code, an exception becomes one line on stderr."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Sequence

from dbo_cli.errors import DboError, UsageError

INTERRUPTED = 130


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command line and return its exit code; nothing but ``SystemExit`` ever leaves this function.

    Parameters
    ----------
    argv
        The words after the program's name; those of the process where not given.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    try:
        code = _dispatch(words)
        sys.stdout.flush()
    except BrokenPipeError:
        _abandon_stdout()
        return 0
    except KeyboardInterrupt:
        _print_line("interrupted")
        return INTERRUPTED
    except SystemExit:
        raise
    except BaseException as problem:  # a library's panic is no Exception
        if "--debug" in words:
            import traceback

            traceback.print_exc()
        return _report_error(problem, words)
    return code


def run() -> None:
    """Serve the console script: ``main`` as a process.

    The garbage collector seldom finds anything in this program and looks often while modules are imported,
    and taking the interpreter apart at the end changes nothing any more: together a tenth of a second.
    """
    import signal

    try:
        if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
            signal.signal(signal.SIGINT, signal.default_int_handler)  # from here on there is work to undo
        os._exit(_run_process())
    except KeyboardInterrupt:  # while starting up, or in the last flush
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # once is enough
        _print_line("interrupted")
        os._exit(INTERRUPTED)


def _run_process() -> int:
    """Prepare the process, run the command line and write out what is still held back."""
    import gc

    from dbo_cli.cli.process import prepare_process

    # Many small factorisations: threads only wait for each other there (measured: up to 20 times slower), and
    # one thread gives the same bytes on every machine of a kind and leaves the others to `make -j`.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    gc.set_threshold(100_000, 50, 50)
    _open_closed_streams()
    prepare_process()
    if "--debug" not in sys.argv:
        import warnings

        warnings.simplefilter("ignore")  # what a library warns programmers of does not concern users
    code = main()
    try:
        sys.stdout.flush()
        sys.stderr.flush()
    except OSError:
        pass  # main() has printed what there was to print
    return code


def _open_closed_streams() -> None:
    """Take the places of streams that whoever started the program has closed.

    A file opened later must not become standard output by chance, and what is written to a closed one is
    not done: it fails with "Bad file descriptor" (reading finds the end).
    """
    for name, mode in (("stdin", os.O_RDONLY), ("stdout", os.O_RDONLY), ("stderr", os.O_WRONLY)):
        if getattr(sys, name) is None:
            descriptor = os.open(os.devnull, mode)  # the lowest that is free: the closed one
            stream = open(descriptor, "r" if name == "stdin" else "w", closefd=False)
            setattr(sys, name, stream)


def _dispatch(words: list[str]) -> int:
    """Parse the command line and run the command it names."""
    from dbo_cli.cli.typer_adapter import run as run_command

    if any("\0" in word for word in words):  # from ``main`` in Python; a shell cannot hand one on
        raise UsageError("a word of the command line holds a NUL character, which no name and no value can")
    return run_command(words)


def _report_error(problem: BaseException, words: list[str]) -> int:
    """Print in one line what went wrong and return the exit code that belongs to it."""
    if isinstance(problem, DboError):
        _print_line(f"error: {problem}")
        return problem.exit_code
    from dbo_cli.cli.typer_adapter import complaint

    refused = complaint(problem)
    if refused is not None:
        text, code = refused
        _print_line(f"error: {text}{_where_to_look(words)}")
        return code
    if isinstance(problem, OSError):
        closed = "standard output: " if problem.errno == errno.EBADF else ""
        place = f"{problem.filename}: " if problem.filename else closed
        _print_line(f"error: {place}{problem.strerror or problem}")
        return 1
    if isinstance(problem, MemoryError):
        _print_line("error: out of memory (--rows A:B takes a part of a log)")
        return 1
    _print_line(
        f"error: internal error: {type(problem).__name__}: {problem} (--debug shows where; please report it)"
    )
    return 1


def _where_to_look(words: list[str]) -> str:
    """Return the remedy for a wrong command line: where the options are listed."""
    from dbo_cli.cli.commands import COMMANDS

    command = "".join(f" {word}" for word in words[:1] if word in COMMANDS)
    return f" (dbo{command} --help lists what there is)"


def _print_line(text: str) -> None:
    """Print one line on stderr, whatever line breaks the text came with."""
    from dbo_cli.cli.messages import Progress, shell_line

    try:
        begin = Progress.ERASE if sys.stderr.isatty() else ""  # over what a long run has shown so far
        print(begin + "dbo: " + shell_line(text), file=sys.stderr, flush=True)
    except OSError:
        pass  # stderr is gone: the exit code still says it


def _abandon_stdout() -> None:
    """Point stdout at nothing, so that the last flush does not complain about the closed pipe."""
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (OSError, ValueError):
        pass
