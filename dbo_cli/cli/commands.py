"""What a command is; the commands of the core; and how any command is found by its name.

A command is a function that makes one call into ``runs`` of its options and prints the
messages. What it needs is imported when it runs: a page of help loads nothing heavy.
"""

from __future__ import annotations

import functools
import inspect
import re
import shlex
import sys
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, NamedTuple

from dbo_cli import extensions
from dbo_cli.cli import options
from dbo_cli.cli.options import Option
from dbo_cli.errors import Listener, Remarks, UsageError, as_options, cleaned

if TYPE_CHECKING:
    from dbo_cli.logs.request import Address, ReadingOptions
    from dbo_cli.runs.files import Destination
    from dbo_cli.runs.jobs import Outcome, Work

EXIT_CODES = (
    ("0", "Done; also when the reader of a pipe leaves early."),
    (
        "1",
        "The input, the model or the fit failed; one line on standard error says what to do.",
    ),
    ("2", "The command line is wrong."),
    ("130", "Interrupted."),
)


def shell_line(text: str) -> str:
    """Return a message of the library as the shell shows it: one line, parameters spelled as options.

    Names out of files hold no command that a terminal would obey.
    """
    return as_options(cleaned(text))


def refuse_terminal(output: Address) -> None:
    """Refuse to write a model onto a terminal, where nobody could read or keep it (UsageError)."""
    if output.is_stream and sys.stdout.isatty():
        raise UsageError(
            "the model would be written onto the terminal: name a file (-o model.json)"
        )


class Reporter(Listener):
    """Prints messages, and how far a run has come, on stderr.

    On a terminal it counts rows or seconds: the number of rows of a stream is not known
    beforehand, so that there is no bar to draw.

    Parameters
    ----------
    quiet : bool
        Print nothing but errors.
    verbose : bool
        Print details, too.
    """

    PATIENCE = 1.0  # s before the first count, and between two
    ERASE = "\r\x1b[K"

    def __init__(self, quiet: bool = False, verbose: bool = False) -> None:
        self.quiet = quiet
        self.verbose = verbose
        self._counts = not quiet and sys.stderr.isatty()
        self._rows = 0
        self._last_count = time.monotonic()
        self._count_is_shown = False
        self._done = threading.Event()
        self._ticking: threading.Thread | None = None

    def note(self, text: str) -> None:
        """Print what is good to know."""
        if not self.quiet:
            print("dbo: " + shell_line(text), file=sys.stderr, flush=True)

    def notes(self, texts: Iterable[str]) -> None:
        """Print notes, one line each."""
        for text in texts:
            self.note(text)

    def remarks(self, remarks: Remarks) -> None:
        """Print the remarks of a run, first what was read."""
        self.notes(remarks.read)
        self.notes(remarks.notes)
        for text in remarks.warnings:
            self.note(f"warning: {text}")

    def detail(self, text: str) -> None:
        """Print what was detected or assumed."""
        if self.verbose:
            self.note(text)

    # --- while a run goes on ---

    def opened(self, what: str) -> None:
        """Print how a log was understood."""
        self.detail(what)

    def reading(self, what: str) -> None:
        """Print what is being read."""
        self.note(what)

    def progressed(self, rows: int, verb: str) -> None:
        """Count the rows of one more block."""
        self._rows += rows
        if self._counts and time.monotonic() - self._last_count > self.PATIENCE:
            self._last_count = time.monotonic()
            self._show(f"{self._rows:,} rows {verb}")

    def working(self, what: str) -> None:
        """Count the seconds of something that gives no rows, until it is finished."""
        if self._counts:
            self._done.clear()
            self._ticking = threading.Thread(
                target=self._tick, args=(what, time.monotonic()), daemon=True
            )
            self._ticking.start()

    def _tick(self, what: str, begin: float) -> None:
        while not self._done.wait(self.PATIENCE):
            self._show(f"{what}, {time.monotonic() - begin:.0f} s")

    def _show(self, text: str) -> None:
        self._count_is_shown = True
        print(f"{self.ERASE}dbo: {text}", end="", file=sys.stderr, flush=True)

    def finished(self) -> None:
        """Erase the count, so that the next message starts at the margin."""
        if self._ticking is not None:
            self._done.set()
            self._ticking.join()
            self._ticking = None
        if self._count_is_shown:
            print(self.ERASE, end="", file=sys.stderr, flush=True)
            self._count_is_shown = False


class Arguments(SimpleNamespace):
    """The values of a command's options, each under its ``key``.

    ``typed`` is the whole command line. ``brought`` has the values of options that
    extras bring to a command of the core, by key; those that were not typed are not in
    it.
    """

    def of(self, options: Iterable[Option]) -> dict[str, Any]:
        """Return the values of some options by their keys, as keywords of a call."""
        return {option.key: getattr(self, option.key) for option in options}

    @functools.cached_property
    def reporter(self) -> Reporter:
        """What prints messages, as loudly as asked for (``app.main`` sees to ``--debug``)."""
        return Reporter(self.quiet, self.verbose)

    @property
    def reading(self) -> ReadingOptions:
        """How logs are to be read; what was not given stays at its default."""
        from dbo_cli.logs.request import ReadingOptions

        declared: tuple[Option, ...] = options.READING
        if hasattr(self, "log_format"):  # --format is that of the report
            declared = options.READING_OF_LOGS
        chosen = {}
        for name, value in self.of(declared).items():
            if value is not None:
                chosen[name.removeprefix("log_")] = value
        return ReadingOptions(**chosen)

    @property
    def work(self) -> Work:
        """How many runs are worked through at once, and what is done where one fails."""
        from dbo_cli.runs.jobs import Work

        return Work(self.jobs, self.keep_going)

    @property
    def command_line(self) -> str:
        """What was typed, as files keep it."""
        return shlex.join(["dbo", *self.typed])

    def destination(self, inputs: Sequence[Any]) -> Destination:
        """Return where the command writes, as far as it has options for it; ``inputs`` are protected."""
        from dbo_cli.runs.files import Destination

        values = vars(self)
        return Destination(
            output=self.output,
            save_state=values.get("save_state"),
            protect=inputs,
            live=values.get("flush", False),
            command=self.command_line,
            summary=self.summary,
            commented=values.get("header") == "comment",
        )

    def finish(self, outcome: Outcome) -> None:
        """Print what is to be said of a run or of many, and end with their error, if there is one."""
        self.reporter.remarks(outcome.remarks)
        self.reporter.notes(outcome.last)
        if outcome.failure is not None:
            raise outcome.failure


class Command(NamedTuple):
    """A command: its function, whose docstring is its help, and its options in the order of the help.

    ``brought``: the options that extras bring to a command of the core; they come last.
    """

    function: Callable[[Arguments], None]
    options: tuple[Option, ...]
    brought: tuple[Option, ...] = ()

    def section(self, heading: str = "") -> str:
        """Return what the docstring has under a heading; what it begins with under none."""
        parts = re.split(
            r"(?m)^(\w.*)\n-+\n", inspect.cleandoc(self.function.__doc__ or "")
        )
        return (
            dict(zip(["", *parts[1::2]], parts[::2], strict=True))
            .get(heading, "")
            .strip()
        )

    @property
    def summary(self) -> str:
        """The first line of the help."""
        return self.section().partition("\n")[0]

    @property
    def writes(self) -> str:
        """What the command writes."""
        return " ".join(self.section("Writes").split())

    @property
    def usual(self) -> list[str]:
        """The options that most need; where the docstring names none, those of the command alone."""
        usual = self.section("Usual options").split()
        if usual:
            return usual
        for option in self.options:
            if option.names and option.heading == options.OPTIONS:
                usual.append(option.names[-1])
        return usual

    @property
    def examples(self) -> list[tuple[str, str]]:
        """What each example is for, and its command line."""
        examples: list[tuple[str, str]] = []
        for line in self.section("Examples").splitlines():
            if line.startswith(" "):
                purpose, command_line = examples.pop()
                examples.append((purpose, f"{command_line} {line.strip()}".lstrip()))
            else:
                examples.append((line, ""))
        return examples

    @property
    def exit_codes(self) -> list[tuple[str, str]]:
        """The exit codes and what they mean."""
        codes = list(EXIT_CODES)
        missed = " ".join(self.section("Exit code 3").split())
        if missed:
            codes.append(("3", missed))
        return sorted(codes, key=lambda code: int(code[0]))


# --- the commands of the core ---


def identify(arguments: Arguments) -> None:
    """Identify a model of an actuator from logs of its drive voltage and displacement.

    What is left at auto is chosen on cycles left out of the fit. Several logs of one
    actuator are fitted together, each with its own sensor offset and drift. What was
    found, and what to be careful about, is said on standard error and kept in the
    model.

    Writes
    ------
    The model as JSON; with several logs and -o 'models/{file}.json' one model each.

    Usual options
    -------------
    --voltage --displacement --sample-rate --scale --validate --prior --sign --force
    -o

    Examples
    --------
    A log becomes a model:
        dbo identify recorded.csv -o model.json
    Two channels of an oscilloscope; the sensor gives 10 um a volt:
        dbo identify run.csv --voltage CH1 --displacement CH2 --scale
        displacement=10um/V -o m.json

    Exit code 3
    -----------
    The displacement goes the other way with the voltage than --sign says; no model is
    written.
    """
    reading = arguments.reading
    refuse_terminal(arguments.output)
    if (arguments.v_min is None) != (arguments.v_max is None):
        raise UsageError(
            "`v_min` and `v_max` belong together: the rated range of the drive"
        )
    from dbo_cli.hysteresis.identification import IdentificationOptions
    from dbo_cli.runs.identifying import IdentifyRun
    from dbo_cli.runs.many import identify_one_or_many

    rated = None
    if arguments.v_min is not None:
        rated = arguments.v_min, arguments.v_max
    fixed = IdentificationOptions(
        **arguments.of(options.IDENTIFICATION),
        **arguments.of(options.FIXED),
        skip_seconds=arguments.skip,
        rated=rated,
    )
    run = IdentifyRun(
        arguments.log,
        arguments.validate or [],
        reading,
        fixed,
        **arguments.of(options.FITTED),
        command=arguments.command_line,
        brought=arguments.brought,
    )
    outcome = identify_one_or_many(
        run, arguments.output, arguments.work, arguments.reporter
    )
    arguments.finish(outcome)
    if not arguments.output.is_stream and "{" not in arguments.output.text:
        model = shlex.quote(arguments.output.text)
        arguments.reporter.note(
            f"dbo show {model} says more; dbo compensate {model} TRAJECTORY -o drive.csv uses it"
        )


def show(arguments: Arguments) -> None:
    """Show what is in a model: range and units, how good it is, lag, where it comes from, its warnings.

    Writes
    ------
    A page of text, or JSON; with --figures the model's curves as PNG and SVG.

    Usual options
    -------------
    --figures --format -o

    Examples
    --------
    What is in a model, and what it is worth:
        dbo show model.json
    The expected error as a number:
        dbo show model.json --format json | jq .fit.expected_rmse
    """
    from dbo_cli.runs.showing import show_model

    arguments.reporter.notes(
        show_model(
            arguments.model,
            arguments.output,
            arguments.format,
            arguments.figures,
            arguments.brought,
        )
    )


def invert(arguments: Arguments) -> None:
    """Write the exact inverse of a model.

    Every gear and segment exchanges its widths, the cascade runs backwards, a delay
    becomes a look ahead. The inverse of a forward model turns a desired displacement
    into the drive (dbo simulate runs it; dbo compensate does the same from the forward
    model and keeps the drive within its limits).

    Writes
    ------
    The inverse model as JSON.

    Usual options
    -------------
    -o

    Examples
    --------
    The model that turns displacement into voltage:
        dbo invert model.json -o inverse.json
    Run it over a trajectory:
        dbo invert model.json | dbo simulate - trajectory.csv -o drive.csv
    """
    refuse_terminal(arguments.output)
    from dbo_cli.runs.files import invert_model

    inverse = invert_model(arguments.model, arguments.output)
    arguments.reporter.detail(f"{arguments.model}: the inverse is {inverse.direction}")


def simulate(arguments: Arguments) -> None:
    """Run a model over its input signal and write the output signal.

    A forward model turns a drive into the displacement, an inverse model a displacement
    into the drive. The log is read block by block, so that it may be larger than memory
    or never end (tail -f ... | dbo simulate model.json - --flush).

    Writes
    ------
    Time (when known), the input column and the result, in the form that the name of the
    output says; several logs with -o 'out/{file}.csv'.

    Usual options
    -------------
    --state --save-state --outside --flush -o

    Examples
    --------
    What a drive would do:
        dbo simulate model.json drive.csv -o predicted.csv
    Of a stream that never ends:
        tail -f drive.log | dbo simulate model.json - --flush
    """
    from dbo_cli.runs.files import SignalRun
    from dbo_cli.runs.many import run_signals

    run = SignalRun(
        arguments.model,
        arguments.log[0],
        arguments.destination([arguments.model, *arguments.log, arguments.state]),
        arguments.reading,
        arguments.input,
        arguments.state,
        arguments.outside,
    )
    outcome = run_signals(run, arguments.log, arguments.work, arguments.reporter)
    arguments.finish(outcome)


def compensate(arguments: Arguments) -> None:
    """Write the drive voltage that makes the actuator follow a desired displacement.

    The forward model is inverted exactly and started in the state in which dbo simulate
    of the drive starts; a delay is made up for by reading the trajectory ahead. No row
    ever leaves the range on which the model was identified, cut by --v-min and --v-max
    (beyond it only with --extrapolate); from an amplifier that stands outside (--from)
    the drive comes straight inwards, and says so. What cannot be reached within the
    limits is cut off, counted and said, as long as it costs at most 1 % of the move:
    the RMS of what the move misses, over the difference between its largest and its
    least value. On standard output, where rows leave before that is known, a stream
    ends once it has lost more than 1 % of the model's range.

    Writes
    ------
    Time (when known), the desired displacement and the drive; rows that this program
    puts before or after the move have times of their own, before it negative ones.

    Usual options
    -------------
    --v-min --v-max --max-slew --from --approach --condition --return --on-limit
    --summary -o

    Examples
    --------
    A trajectory becomes a drive, with a ramp to its first row:
        dbo compensate model.json move.csv --max-slew 2000 --from 0 --approach auto -o
        drive.csv
    One period of a loop becomes the settled loop's drive:
        dbo compensate model.json period.csv --periodic -o loop.csv

    Exit code 3
    -----------
    Limits cost more than 1 % of the move, or the delay is longer than it (--on-limit
    clip writes it all the same); a limit is met and --on-limit is error; the drive
    cannot begin, close or return within its limits; or what the program chose to put
    before the move takes more than a minute and ten times the move. No drive is
    written.
    """
    from dbo_cli.drives.options import DriveOptions
    from dbo_cli.runs.files import run_of_signals
    from dbo_cli.runs.many import run_signals

    inputs = [arguments.model, *arguments.trajectory, arguments.state]
    run = run_of_signals(
        arguments.brought,
        reading=arguments.reading,
        # the state is read with the model
        drive=DriveOptions(**arguments.of(options.DRIVING)),
        model=arguments.model,
        log=arguments.trajectory[0],
        destination=arguments.destination(inputs),
        column=arguments.displacement,
        state=arguments.state,
    )
    outcome = run_signals(run, arguments.trajectory, arguments.work, arguments.reporter)
    arguments.finish(outcome)


def check(arguments: Arguments) -> None:
    """Check a drive of any program against the limits of an amplifier, before it is played.

    Range, slew, the first row (--from), the seam of a loop (--loop), gaps, repeated
    times, and every row that a reader would have to drop, to guess or to cut: what is
    wrong is named with its row, and the exit code is
    3. A column in kV or mV takes limits with their unit only (--v-max 0.1kV). With
       --against, the first file
    is a recording of what was played, and the question is whether it was that drive:
    rows, lag, gain, offset.

    Writes
    ------
    What was found, as text or JSON.

    Usual options
    -------------
    --v-min --v-max --max-slew --from --loop --against -o

    Examples
    --------
    Another program's drive, before it is played:
        dbo check drive.csv --v-min 0 --v-max 100 --max-slew 2000 --from 0
    Was it what was played?
        dbo check played.csv --against drive.csv --v-min 0 --v-max 100

    Exit code 3
    -----------
    A limit is broken, a row holds no number, or with --against the two differ by more
    than --tolerance.
    """
    from dbo_cli.runs.checking import CheckOptions, check_file

    limits = CheckOptions(**arguments.of(options.CHECKING), voltage=arguments.voltage)
    arguments.reporter.remarks(
        check_file(
            arguments.drive,
            arguments.output,
            arguments.format,
            arguments.reading,
            limits,
        )
    )


def report(arguments: Arguments) -> None:
    """Report how well the measured displacement follows the desired one.

    Several logs are put side by side, each with the ratio of its RMSE to the first
    log's: uncompensated first, compensated after it. With --model the model's
    prediction takes the place of the desired signal: it is run from the first row on,
    and --rows says which rows count. With --trajectory the desired signal comes from a
    file of its own. Patterns (--desired 'desired_{}' --measured 'D{}') give a line a
    channel, and figures of all together. Where a limit (--max-...) is missed the report
    is written all the same, and the exit code is 3.

    Writes
    ------
    The report as text, JSON, CSV or an HTML page, by the name of the output; with
    --figures pictures.

    Usual options
    -------------
    --trajectory --model --segment --max-rmse --max-nrmse-percent --figures --desired
    --measured -o

    Examples
    --------
    Without and with compensation, side by side:
        dbo report uncompensated.csv compensated.csv --figures figures -o report.html
    A check that a script can rely on:
        dbo report tracked.csv --trajectory drive.csv --max-nrmse-percent 1

    Exit code 3
    -----------
    A limit (--max-...) is missed; the report is written all the same, and begins with
    that.
    """
    from dbo_cli.runs.many import run_report
    from dbo_cli.runs.reporting import ReportRun, TrackingOptions

    tracking = TrackingOptions(
        **arguments.of([*options.TRACKING, *options.REPORT_COLUMNS])
    )
    limits = arguments.of(options.LIMITS)
    run = ReportRun(
        arguments.log,
        arguments.output,
        arguments.reading,
        tracking,
        arguments.format,
        arguments.figures,
        limits,
        arguments.show,
        shell_line,
    )
    outcome = run_report(run, arguments.work, arguments.reporter)
    arguments.finish(outcome)


def excite(arguments: Arguments) -> None:
    """Write the drive that identifies well; play it and record the displacement.

    A sweep over the whole range wipes out the past; then the drive turns at random
    levels, at speeds from a quarter to eight times the sweep's, with some holds, so
    that loop width, asymmetry, lag and creep come apart. It ends at rest where it
    began, so that drift shows, and it never leaves the limits. 15 s leave about half
    the error of 8 s, 30 s no less; at another --frequency, scale the duration with it.
    With --sweep-to, a small sweep in the middle of the range follows, in which a
    resonance shows itself (4 s more, and longer below 60 Hz). With --channels N there
    is a column for each of N channels.

    Writes
    ------
    Time and drive voltage, or what else drives the actuator: the unit of --v-max says
    which (4bar, 500mA).

    Usual options
    -------------
    --v-max --v-min --sample-rate --duration --frequency --max-slew --sweep-to -o

    Examples
    --------
    15 s of drive from 0 to 100 V:
        dbo excite --v-max 100 --sample-rate 5000 -o excitation.csv
    For fast moves, with a sweep for the resonances:
        dbo excite --v-max 100 --sample-rate 20000 --sweep-to 1000 -o excitation.csv
    """
    from dbo_cli.hysteresis.excitation import excitation_of
    from dbo_cli.logs.units import drive_unit, in_unit
    from dbo_cli.runs.files import excitation_drives, write_excitation

    words = arguments.of(options.EXCITATION)
    unit = drive_unit(words["v_max"])
    for key in ("v_min", "v_max", "max_slew", "sweep_amplitude"):
        per = "s" if key == "max_slew" else None
        if words[key] is not None:
            words[key] = in_unit(key, words[key], unit, per)
    drive = excitation_of(unit=unit, **words)
    drives = excitation_drives(drive, arguments.points, arguments.brought)
    fastest = write_excitation(arguments.output, drive, arguments.format, drives)
    rows = len(drives[0])
    arguments.reporter.note(
        f"{rows:,} rows, {rows / drive.sample_rate:g} s at {drive.sample_rate:g} rows a second, from"
        f" {drive.v_min:g} to {drive.v_max:g} {unit}, at most {fastest:.3g} {unit}/s"
    )
    if drive.v_min:
        arguments.reporter.note(
            f"it begins and ends at {drive.v_min:g} {unit}: bring the amplifier there slowly first"
        )
    if not arguments.brought:
        arguments.reporter.note(
            "play it, record drive and displacement side by side, then: dbo identify RECORDED -o model.json"
        )


MEANT = {
    "fit": "identify",
    "calibrate": "identify",
    "learn": "identify",
    "run": "simulate",
    "predict": "simulate",
    "inverse": "invert",
    "drive": "compensate",
    "plot": "report --figures",
    "evaluate": "report",
    "info": "show",
    "print": "show",
    "version": "--version",
}
"""Words that people try in the place of a command, and what they mean."""

CORE = {
    function.__name__: Command(function, options.OPTIONS_OF[function.__name__])
    for function in (
        identify,
        show,
        invert,
        simulate,
        compensate,
        check,
        report,
        excite,
    )
}
"""The commands of the core by name, in the order of a working day."""


def names() -> list[str]:
    """Return the names of all commands: those of the core, then those of the extras that are installed."""
    return [*CORE, *extensions.keys("command")]


def find(name: str, words: Sequence[str] | None = None) -> Command | None:
    """Return the command of a name, with the options that extras bring; None where there is none.

    Parameters
    ----------
    name
        The command.
    words
        The command line. Other packages are looked at only where it has an option that
        is not known by then; without a command line always.

    Raises
    ------
    UsageError
        It, or an option of the command line, belongs to an extra that is not installed.
    """
    command = CORE.get(name)
    if command is None:
        from_extra: Command | None = extensions.find("command", name)
        return from_extra
    command = command._replace(brought=_brought(name, extensions.own()))
    if words is not None:
        typed = {word.partition("=")[0] for word in words if word.startswith("--")}
        known: set[str] = set()
        for option in (*command.options, *command.brought):
            known.update(option.names)
        if typed <= known:
            return command
        for spelling in sorted(typed - known):
            # refuses one of an extra that is missing
            extensions.find("option", f"{name} {spelling}")
    return command._replace(brought=_brought(name, extensions.installed()))


def _brought(name: str, extras: Iterable[extensions.Extra]) -> tuple[Option, ...]:
    """Return the options that extras bring to a command of the core."""
    options_of_extras = []
    for extra in extras:
        for key, option in extra.things("option"):
            if key.startswith(f"{name} "):
                options_of_extras.append(option)
    return tuple(options_of_extras)


def every() -> dict[str, Command]:
    """Return all commands by name, in the order of the help."""
    commands = {}
    for name in names():
        command = find(name)
        if command is not None:
            commands[name] = command
    return commands
