"""The entry of the program: an outcome becomes an exit code, an exception becomes one line on stderr."""

from __future__ import annotations

import contextlib
import errno
import itertools
import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from types import FrameType
from typing import IO, Any

from dbo_cli.errors import DboError, UsageError, cleaned
from dbo_cli.logs.request import GAVE_UP, Host, set_host

INTERRUPTED = 130  # exit code: 128 and the number of SIGINT, as shells report it


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

    The garbage collector seldom finds anything in this program and looks often while
    modules are imported, and taking the interpreter apart at the end changes nothing
    any more: together a tenth of a second.
    """
    try:
        if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
            # from here on there is work to undo
            signal.signal(signal.SIGINT, signal.default_int_handler)
        os._exit(_run_process())
    except KeyboardInterrupt:  # while starting up, or in the last flush
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # once is enough
        _print_line("interrupted")
        os._exit(INTERRUPTED)


def _run_process() -> int:
    """Prepare the process, run the command line and write out what is still held back."""
    import gc

    # Many small factorisations: threads only wait for each other there (measured: up to
    # 20 times slower), and one thread gives the same bytes on every machine of a kind
    # and leaves the others to `make -j`.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Reading, the model and writing have a thread each. More of them inside polars only
    # wait for each other (10,000,000 rows on two cores: 7 % more time of the
    # processors, and no less of the clock).
    os.environ.setdefault("POLARS_MAX_THREADS", "1")
    gc.set_threshold(100_000, 50, 50)
    _open_closed_streams()
    prepare_process()
    if "--debug" not in sys.argv:
        import warnings

        # what a library warns programmers of does not concern users
        warnings.simplefilter("ignore")
    code = main()
    try:
        sys.stdout.flush()
        sys.stderr.flush()
    except OSError:
        pass  # main() has printed what there was to print
    return code


def _open_closed_streams() -> None:
    """Take the places of streams that whoever started the program has closed.

    A file opened later must not become standard output by chance, and what is written
    to a closed one is not done: it fails with "Bad file descriptor" (reading finds the
    end).
    """
    for name, mode in (
        ("stdin", os.O_RDONLY),
        ("stdout", os.O_RDONLY),
        ("stderr", os.O_WRONLY),
    ):
        if getattr(sys, name) is None:
            # the lowest that is free: the closed one
            descriptor = os.open(os.devnull, mode)
            stream = open(descriptor, "r" if name == "stdin" else "w", closefd=False)
            setattr(sys, name, stream)


def _dispatch(words: list[str]) -> int:
    """Parse the command line and run the command it names."""
    # from ``main`` in Python; a shell cannot hand one on
    if any("\0" in word for word in words):
        raise UsageError(
            "a word of the command line holds a NUL character, which no name and no value can"
        )
    from dbo_cli.cli.typer_adapter import run as run_command

    return run_command(words)


def _report_error(problem: BaseException, words: list[str]) -> int:
    """Print in one line what went wrong and return the exit code that belongs to it."""
    text = f"internal error: {type(problem).__name__}: {problem} (--debug shows where; please report it)"
    code = 1
    if isinstance(problem, DboError):
        text, code = f"{problem}{_torn_name(words)}", problem.exit_code
    else:
        from dbo_cli.cli.typer_adapter import complaint

        refused = complaint(problem)
        if refused is not None:
            text, code = f"{refused[0]}{_where_to_look(words)}", refused[1]
        elif isinstance(problem, OSError):
            text = f"{_place_of(problem)}{problem.strerror or problem}"
        elif isinstance(problem, MemoryError):
            text = "out of memory (--rows A:B takes a part of a log)"
    _print_line(f"error: {text}")
    return code


def _place_of(problem: OSError) -> str:
    """Return where the system refused something: a file, or standard output where that is closed."""
    if problem.filename:
        return f"{problem.filename}: "
    if problem.errno == errno.EBADF:
        return "standard output: "
    return ""


def _where_to_look(words: list[str]) -> str:
    """Return the remedy for a wrong command line: where the options are listed."""
    from dbo_cli.cli import commands

    help_of = "dbo"
    if words and words[0] in commands.names():
        help_of = f"dbo {words[0]}"
    return f" ({help_of} --help lists what there is)"


def _torn_name(words: list[str]) -> str:
    """Return the remedy where a file's name with a blank came as two words of the command line."""
    for begin, end in itertools.pairwise(words):
        name = f"{begin} {end}"
        if not os.path.exists(begin) and os.path.isfile(name):
            return f" (is '{name}' meant? A name with a blank needs quotation marks)"
    return ""


def _print_line(text: str) -> None:
    """Print one line on stderr, whatever line breaks the text came with."""
    from dbo_cli.cli.commands import Reporter, shell_line

    try:
        # over what a long run has shown so far
        begin = Reporter.ERASE if sys.stderr.isatty() else ""
        print(begin + "dbo: " + shell_line(text), file=sys.stderr, flush=True)
    except OSError:
        pass  # stderr is gone: the exit code still says it


def _abandon_stdout() -> None:
    """Point stdout at nothing, so that the last flush does not complain about the closed pipe."""
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (OSError, ValueError):
        pass


# --- what belongs to the process: signals, standard error, and the libraries that touch
# them ---
#
# ``prepare_process`` is called once, before a command line is run as a process;
# everything below ``cli`` leaves the process alone.


_ENDING_SIGNALS = [
    getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)
]


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

        Polars puts a handler of its own before Python's for SIGINT and asks for
        interrupted reads to be restarted, so that a command waiting on standard input
        would hear Ctrl-C only when the next row arrives. npTDMS writes its doubts to
        the terminal.
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

        Where the library ends the process, one line says which file was read (exit code
        1). Of 3,000 damaged Parquet files a few dozen led to a page of the library's
        own, one in some hundreds to such an end.
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

    A handler of the ``signal`` module would run only after the library has returned,
    which it does not.
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
