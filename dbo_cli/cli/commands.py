"""The commands: which options each has, one call into ``runs``, and the messages on stderr beside the data.

What a command needs is imported when it runs: a page of help loads nothing heavy.
"""

from __future__ import annotations

import inspect
import os
import re
import shlex
import sys
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, NamedTuple

from dbo_cli.cli import options
from dbo_cli.cli.options import Option
from dbo_cli.errors import Listener, Remarks, UsageError
from dbo_cli.logs.plain_text import cleaned, pattern
from dbo_cli.records import dataclass

if TYPE_CHECKING:
    from dbo_cli.export import ExportSummary
    from dbo_cli.logs.request import Address, ReadingOptions
    from dbo_cli.runs.jobs import Outcome, Work


EXIT_CODES = (
    ("0", "Done; also when the reader of a pipe leaves early."),
    ("1", "The input, the model or the fit failed; one line on standard error says what to do."),
    ("2", "The command line is wrong."),
    ("130", "Interrupted."),
)

_PARAMETER = pattern(r"`([a-z]\w*)`")


def shell_line(text: str) -> str:
    """Return a message of the library as the shell shows it: one line, parameters spelled as options.

    Names out of files hold no command that a terminal would obey.
    """
    return _PARAMETER.sub(lambda found: "--" + found[1].rstrip("_").replace("_", "-"), cleaned(text))


@dataclass(frozen=True)
class Reporter:
    """Prints messages on stderr: with ``quiet`` none but errors, with ``verbose`` details, too."""

    quiet: bool = False
    verbose: bool = False

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
        self.notes([*remarks.read, *remarks.notes, *(f"warning: {text}" for text in remarks.warnings)])

    def detail(self, text: str) -> None:
        """Print what was detected or assumed."""
        if self.verbose:
            self.note(text)


def refuse_terminal(output: Address) -> None:
    """Refuse to write a model onto a terminal, where nobody could read or keep it (UsageError)."""
    if output.is_stream and sys.stdout.isatty():
        raise UsageError("the model would be written onto the terminal: name a file (-o model.json)")


class Progress(Listener):
    """Prints how far a run has come: how a log was understood, then rows or seconds on a terminal.

    The number of rows of a stream is not known beforehand, so it counts instead of drawing a bar.
    """

    PATIENCE = 1.0  # s before the first message, and between two
    ERASE = "\r\x1b[K"

    def __init__(self, reporter: Reporter, verb: str) -> None:
        self.reporter = reporter
        self.active = not reporter.quiet and sys.stderr.isatty()
        self.verb = verb
        self.rows = 0
        self.last = time.monotonic()
        self.shown = False
        self._done = threading.Event()
        self._ticking: threading.Thread | None = None

    def opened(self, what: str) -> None:
        """Print how a log was understood."""
        self.reporter.detail(what)

    def reading(self, what: str) -> None:
        """Print what is being read."""
        self.reporter.note(what)

    def progressed(self, rows: int) -> None:
        """Count the rows of one more block."""
        self.rows += rows
        if self.active and time.monotonic() - self.last > self.PATIENCE:
            self.last = time.monotonic()
            self._show(f"{self.rows:,} rows {self.verb}")

    def working(self, what: str) -> None:
        """Count the seconds of something that gives no rows, until it is finished."""
        if self.active:
            self._done.clear()
            self._ticking = threading.Thread(target=self._tick, args=(what, time.monotonic()), daemon=True)
            self._ticking.start()

    def _tick(self, what: str, begin: float) -> None:
        while not self._done.wait(self.PATIENCE):
            self._show(f"{what}, {time.monotonic() - begin:.0f} s")

    def _show(self, text: str) -> None:
        self.shown = True
        print(f"{self.ERASE}dbo: {text}", end="", file=sys.stderr, flush=True)

    def finished(self) -> None:
        """Erase the line, so that the next message starts at the margin."""
        if self._ticking is not None:
            self._done.set()
            self._ticking.join()
            self._ticking = None
        if self.shown:
            print(self.ERASE, end="", file=sys.stderr, flush=True)
            self.shown = False


class Given(SimpleNamespace):
    """The values of a command's options, each under its ``key``; ``typed`` is the whole command line."""

    def of(self, options: Iterable[Option]) -> dict[str, Any]:
        """Return the values of some options by their keys, as keywords of a call."""
        return {option.key: getattr(self, option.key) for option in options}

    @property
    def reporter(self) -> Reporter:
        """What prints messages, as loudly as asked for (``app.main`` sees to ``--debug``)."""
        return Reporter(self.quiet, self.verbose)

    @property
    def reading(self) -> ReadingOptions:
        """How logs are to be read; what was not given stays at its default."""
        from dbo_cli.logs.request import ReadingOptions

        given = self.of(options.READING_OF_LOGS if hasattr(self, "log_format") else options.READING)
        known = {name.removeprefix("log_"): value for name, value in given.items() if value is not None}
        return ReadingOptions(**known)


class Command(NamedTuple):
    """A command: its function, whose docstring is its help, and its options in the order of the help."""

    function: Callable[[Given], None]
    options: tuple[Option, ...]

    def section(self, heading: str = "") -> str:
        """Return what the docstring has under a heading; what it begins with under none."""
        parts = re.split(r"(?m)^(\w.*)\n-+\n", inspect.cleandoc(self.function.__doc__ or ""))
        return dict(zip(["", *parts[1::2]], parts[::2], strict=True)).get(heading, "").strip()

    @property
    def summary(self) -> str:
        """The first line of the help."""
        return self.section().partition("\n")[0]

    @property
    def writes(self) -> str:
        """What the command writes."""
        return " ".join(self.section("Writes").split())

    @property
    def examples(self) -> list[tuple[str, str]]:
        """What each example is for, and its command line."""
        lines = list(map(str.strip, self.section("Examples").splitlines()))
        return list(zip(lines[::2], lines[1::2], strict=True))

    @property
    def exit_codes(self) -> list[tuple[str, str]]:
        """The exit codes and what they mean."""
        missed = " ".join(self.section("Exit code 3").split())
        return sorted([*EXIT_CODES, *([("3", missed)] if missed else [])], key=lambda code: int(code[0]))


def identify(given: Given) -> None:
    """Identify a model of an actuator from logs of its drive voltage and displacement.

    What is left at auto is chosen on cycles left out of the fit. Several logs of one actuator are fitted
    together, each with its own sensor offset and drift. What was found, and what to be careful about, is said
    on standard error and kept in the model.

    Writes
    ------
    The model as JSON; with several logs and -o 'models/{file}.json' one model each.

    Examples
    --------
    A log becomes a model:
        dbo identify recorded.csv -o model.json
    Two channels of an oscilloscope; the sensor gives 10 um a volt:
        dbo identify run.csv --voltage CH1 --displacement CH2 --scale displacement=10um/V -o m.json
    """
    reading = given.reading
    refuse_terminal(given.output)
    if (given.v_min is None) != (given.v_max is None):
        raise UsageError("`v_min` and `v_max` belong together: the rated range of the drive")
    from dbo_cli.hysteresis.identification import IdentificationOptions
    from dbo_cli.runs.identifying import IdentifyRun
    from dbo_cli.runs.many import identified

    fixed = IdentificationOptions(
        **given.of([*options.IDENTIFICATION, options.ZERO, options.METHOD, options.FORCE]),
        skip_seconds=given.skip,
        rated=None if given.v_min is None else (given.v_min, given.v_max),
    )
    asked = IdentifyRun(given.log, given.validate or [], reading, fixed, **given.of(options.FITTED))
    _finish(given, identified(asked, given.output, _work(given), Progress(given.reporter, "read")))
    if not given.output.is_stream and "{" not in given.output.text:
        model = shlex.quote(given.output.text)
        given.reporter.note(
            f"dbo show {model} says more; dbo compensate {model} TRAJECTORY -o drive.csv uses it"
        )


def show(given: Given) -> None:
    """Show what is in a model: range and units, how good it is, lag, where it comes from, its warnings.

    Writes
    ------
    A page of text, or JSON; with --figures the model's curves as PNG and SVG.

    Examples
    --------
    What is in a model, and what it is worth:
        dbo show model.json
    The expected error as a number:
        dbo show model.json --format json | jq .fit.expected_rmse
    """
    from dbo_cli.runs.showing import show_model

    given.reporter.notes(show_model(given.model, given.output, given.format, given.figures, given.settle))


def invert(given: Given) -> None:
    """Write the exact inverse of a model.

    Every gear and segment exchanges its widths, the cascade runs backwards, a delay becomes a look ahead.
    The inverse of a forward model turns a desired displacement into the drive (dbo simulate runs it;
    dbo compensate does the same from the forward model and keeps the drive within its limits).

    Writes
    ------
    The inverse model as JSON.

    Examples
    --------
    The model that turns displacement into voltage:
        dbo invert model.json -o inverse.json
    Run it over a trajectory:
        dbo invert model.json | dbo simulate - trajectory.csv -o drive.csv
    """
    refuse_terminal(given.output)
    from dbo_cli.runs.files import invert_model

    inverse = invert_model(given.model, given.output)
    given.reporter.detail(f"{given.model}: the inverse is {inverse.direction}")


def simulate(given: Given) -> None:
    """Run a model over its input signal and write the output signal.

    A forward model turns a drive into the displacement, an inverse model a displacement into the drive. The
    log is read block by block, so that it may be larger than memory or never end (tail -f ... | dbo simulate
    model.json - --flush).

    Writes
    ------
    Time (when known), the input column and the result, in the form that the name of the output says;
    several logs with -o 'out/{file}.csv'.

    Examples
    --------
    What a drive would do:
        dbo simulate model.json drive.csv -o predicted.csv
    Of a stream that never ends:
        tail -f drive.log | dbo simulate model.json - --flush
    """
    from dbo_cli.runs.files import SignalRun
    from dbo_cli.runs.many import signals

    destination = _destination(given, [given.model, *given.log, given.state])
    asked = SignalRun(
        given.model, given.log[0], destination, given.reading, given.input, given.state, given.outside
    )
    _finish(given, signals(asked, given.log, _work(given), Progress(given.reporter, "written")))


def compensate(given: Given) -> None:
    """Write the drive voltage that makes the actuator follow a desired displacement.

    The forward model is inverted exactly and started in the state in which dbo simulate of the drive starts;
    a delay is made up for by reading the trajectory ahead. What the drive cannot reach within its limits is
    clipped, counted and said; no row ever breaks a limit.

    Writes
    ------
    Time (when known), the desired displacement and the drive; rows that this program puts before or after
    the move have times of their own, before it negative ones.

    Examples
    --------
    A trajectory becomes a drive, with a ramp to its first row:
        dbo compensate model.json move.csv --max-slew 2000 --from 0 --approach auto -o drive.csv
    One period of a loop becomes the settled loop's drive:
        dbo compensate model.json period.csv --periodic -o loop.csv

    Exit code 3
    -----------
    A limit is met and --on-limit is error, or the drive cannot begin, close or return within its limits; no
    drive is written.
    """
    reading = given.reading
    from dbo_cli.drives.options import DriveOptions

    drive = DriveOptions(**given.of(options.DRIVING))  # the state is read with the model
    from dbo_cli.runs.files import SignalRun
    from dbo_cli.runs.many import signals

    tracked = given.tracked or ()
    destination = _destination(given, [given.model, *given.trajectory, given.state, *tracked])
    asked = SignalRun(
        given.model, given.trajectory[0], destination, reading, given.displacement, given.state, drive=drive,
        tracked=tracked, **given.of([options.TRACKED_VOLTAGE, options.TRACKED_MEASURED]),
    )  # fmt: skip
    _finish(given, signals(asked, given.trajectory, _work(given), Progress(given.reporter, "written")))


def check(given: Given) -> None:
    """Check a drive of any program against the limits of an amplifier, before it is played.

    Range, slew, the first row (--from), the seam of a loop (--loop), gaps, repeated times and rows without a
    number: what breaks a limit is named with its row, and the exit code is 3. With --against, the first file
    is a recording of what was played, and the question is whether it was that drive: rows, lag, gain, offset.

    Writes
    ------
    What was found, as text or JSON.

    Examples
    --------
    Another program's drive, before it is played:
        dbo check drive.csv --v-min 0 --v-max 100 --max-slew 2000 --from 0
    Was it what was played?
        dbo check played.csv --against drive.csv --v-min 0 --v-max 100

    Exit code 3
    -----------
    A limit is broken, or with --against the two differ by more than --tolerance.
    """
    from dbo_cli.runs.checking import CheckOptions, check_file

    asked = CheckOptions(**given.of(options.CHECKING), voltage=given.voltage)
    given.reporter.remarks(check_file(given.drive, given.output, given.format, given.reading, asked))


def report(given: Given) -> None:
    """Report how well the measured displacement follows the desired one.

    Several logs are put side by side, each with the ratio of its RMSE to the first log's: uncompensated
    first, compensated after it. With --model the model's prediction takes the place of the desired signal:
    it is run from the first row on, and --rows says which rows count. With --trajectory the desired signal
    comes from a file of its own.
    Patterns (--desired 'desired_{}' --measured 'D{}') give a line a channel, and figures of all together.
    Where a limit (--max-...) is missed the report is written all the same, and the exit code is 3.

    Writes
    ------
    The report as text, JSON, CSV or an HTML page, by the name of the output; with --figures pictures.

    Examples
    --------
    Without and with compensation, side by side:
        dbo report uncompensated.csv compensated.csv --figures figures -o report.html
    A check that a script can rely on:
        dbo report tracked.csv --trajectory drive.csv --max-nrmse-percent 1

    Exit code 3
    -----------
    A limit (--max-rmse, --max-abs, --max-nrmse-percent) is missed; the report is written all the same.
    """
    from dbo_cli.runs.many import reported
    from dbo_cli.runs.reporting import ReportRun, TrackingOptions

    tracking = TrackingOptions(**given.of([*options.TRACKING, *options.REPORT_COLUMNS]))
    limits = given.of(options.LIMITS)
    asked = ReportRun(given.log, given.output, given.reading, tracking, given.format, given.figures, limits)
    _finish(given, reported(asked, _work(given), Progress(given.reporter, "compared")))


def excite(given: Given) -> None:
    """Write the drive that identifies well; play it and record the displacement.

    A sweep over the whole range wipes out the past; then the drive turns at random levels, at speeds from a
    quarter to eight times the sweep's, with some holds, so that loop width, asymmetry, lag and creep come
    apart. It ends at rest where it began, so that drift shows, and it never leaves the limits. 15 s leave
    about half the error of 8 s, 30 s no less; at another --frequency, scale the duration with it. With
    --sweep-to, a small sweep in the middle of the range follows, in which a resonance shows itself (4 s
    more, and longer below 60 Hz). With --channels N there is a column for each of N channels.

    Writes
    ------
    Time and drive voltage.

    Examples
    --------
    15 s of drive from 0 to 100 V:
        dbo excite --v-max 100 --sample-rate 5000 -o excitation.csv
    For fast moves, with a sweep for the resonances:
        dbo excite --v-max 100 --sample-rate 20000 --sweep-to 1000 -o excitation.csv
    """
    from dbo_cli.hysteresis.excitation import excitation_of
    from dbo_cli.logs.units import in_unit
    from dbo_cli.runs.files import write_excitation

    if given.channels is not None and given.points is not None:
        raise UsageError(
            "`points` and `channels` exclude each other: channels that move one by one take more rows"
        )
    words = given.of(options.EXCITATION)
    volts = {
        key: None if words[key] is None else in_unit(key, words[key], "V", "s" if key == "max_slew" else None)
        for key in ("v_min", "v_max", "max_slew", "sweep_amplitude")
    }
    asked = excitation_of(**words | volts)
    rows = write_excitation(given.output, asked, given.format, given.channels)
    given.reporter.detail(
        f"{rows:,} rows, {rows / asked.sample_rate:g} s, {asked.v_min:g} to {asked.v_max:g} V"
    )
    if given.v_min:
        given.reporter.note(
            f"it begins and ends at {given.v_min:g} V: bring the amplifier there slowly first"
        )


def export(given: Given) -> None:
    """Write a model as C for a controller, with the tables, a self-test and a page to read.

    C99 without allocation, recursion or library calls. double gives the bits of dbo compensate; float and
    q31 (32-bit fixed point) come with a derived bound on their error. A set goes to one folder
    with one kernel, tables of each channel and calls that step all, or (-o 'c/{channel}') to a folder each.

    Writes
    ------
    A folder with NAME.h, NAME.c, NAME_test.c, the kernel, build files and README.md; it appears whole or
    not at all.

    Examples
    --------
    For a controller of 10 kHz:
        dbo export model.json -o firmware --sample-rate 10000
    In 32-bit floats, with a bound on the error:
        dbo export model.json -o firmware --arithmetic float --sample-rate 10000
    """
    from dbo_cli.errors import Remarks
    from dbo_cli.runs.channels import export_models
    from dbo_cli.runs.jobs import summed_up

    remarks = Remarks()
    made = export_models(given.model, given.output, remarks, **given.of(options.EXPORTING))
    remarks.note(summed_up({channel: _summary_lines(one) for channel, one in made.items()}, "channel"))
    warnings = {channel: list(one.warnings) for channel, one in made.items()}
    remarks.warnings += summed_up(warnings, "channel")
    given.reporter.remarks(remarks)


def compare(given: Given) -> None:
    """Compare the DBO with its relatives: each fitted to the same logs, in one table.

    The relatives are a straight line and the Prandtl-Ishlinskii operators that the paper names. All get the
    same rows, start, drift and search for a delay; one that cannot be fitted has a row that says why. The
    last, same-stages, is the DBO's own model with plays for gears: what the operator is worth. Times
    differ from run to run: with --no-timings the same logs give the same bytes.

    Writes
    ------
    A table as text, JSON, CSV or an HTML page, by the name of the output; with --figures pictures.

    Examples
    --------
    Fitted to one log, judged on another:
        dbo compare recorded.csv --validate other.csv --figures figures
    Two of them, the same bytes every time:
        dbo compare recorded.csv --models dbo,pi --no-timings -o table.csv
    """
    from dbo_cli.hysteresis.identification import IdentificationOptions
    from dbo_cli.runs.identifying import IdentifyRun, TableOptions, compare_logs

    logs = (given.log, given.validate or [], given.reading, IdentificationOptions())
    table = TableOptions(
        given.models, given.skip, not given.no_timings, given.format, given.figures, given.save_models
    )
    asked, listener = IdentifyRun(*logs, given.voltage, given.displacement), Progress(given.reporter, "read")
    given.reporter.remarks(compare_logs(asked, given.output, table, listener))


def trajectory(given: Given) -> None:
    """Write a move to be followed: raster, spiral, staircase, sine or triangle.

    It starts and stops softly, and its turns and steps are rounded to --bandwidth or to what --model can be
    trusted to; what the model does not reach is refused.

    Writes
    ------
    Time and displacement, or time, x and y: dbo compensate --displacement x_um takes one of them.

    Examples
    --------
    A raster that a model can follow:
        dbo trajectory raster --rate 10000 --range 2:9 --lines 64 --frequency 5 --model m.json -o s.csv
    Levels up and down:
        dbo trajectory staircase --rate 500 --range 1:9 --steps 9 --dwell 1 --model m.json -o s.csv
    """
    from dbo_cli.drives.options import DriveOptions
    from dbo_cli.drives.shapes import TrajectoryOptions
    from dbo_cli.runs.trajectories import write_trajectory

    asked = TrajectoryOptions(given.shape, **given.of(options.MOVE))
    models = given.model or []
    destination = _destination(given, models)
    drive = DriveOptions(**given.of(options.MOVE_LIMITS))
    given.reporter.notes(write_trajectory(destination, asked, models, given.unit, given.format, drive))


def waveform(given: Given) -> None:
    """Write a drive as the file that a generator, a wave table or a converter takes.

    What is written is read back and passes the gate that the drive passed. One line says what to set:
    points, rate, amplitude, offset, repetitions, and by how much rounding moves the drive.

    Writes
    ------
    The generator's file; one line on standard error says what to set there.

    Examples
    --------
    For a generator before an amplifier of gain 20:
        dbo waveform drive.csv --to keysight-arb --gain 20 --v-min 0 --v-max 100 -o drive.arb
    Codes of a 16-bit converter from 0 to 5 V:
        dbo waveform drive.csv --to uint16 --gain 20 --volts 0:5 -o drive.bin

    Exit code 3
    -----------
    The drive breaks a limit, or the generator's rate or range would change it by more than allowed.
    """
    from dbo_cli.runs.waveform_files import WaveformOptions, write_waveform

    asked = WaveformOptions(**given.of(options.WAVEFORM), voltage=tuple(given.voltage or ()))
    destination = _destination(given, given.drive)
    given.reporter.remarks(write_waveform(given.drive, destination, given.reading, asked))


def _work(given: Given) -> Work:
    """Return how many runs are to be worked through."""
    from dbo_cli.runs.jobs import Work

    return Work(given.jobs, given.keep_going)


def _finish(given: Given, outcome: Outcome) -> None:
    """Print what is to be said of many runs, and end with their error, if there is one."""
    given.reporter.remarks(outcome.remarks)
    given.reporter.notes(outcome.last)
    if outcome.failure is not None:
        raise outcome.failure


def _destination(given: Given, inputs: list[Any]) -> Any:
    """Return where a command writes, as far as it has options for it, and the inputs to be protected."""
    from dbo_cli.runs.files import Destination

    has, command = vars(given), shlex.join(["dbo", *given.typed])
    state, live, commented = has.get("save_state"), has.get("flush", False), has.get("header") == "comment"
    return Destination(given.output, state, inputs, live, command, given.summary, commented)


def _summary_lines(summary: ExportSummary) -> list[str]:
    """Return the messages about an export."""
    lines = [
        f"{summary.folder}: {summary.direction} model '{summary.name}' in {summary.arithmetic},"
        f" {summary.gears} gears in {summary.table_rows} rows; {summary.table_bytes} bytes of tables,"
        f" {summary.state_bytes} of state; {summary.vectors} samples of self-test"
    ]
    if summary.bounds:
        same, close = (summary.bounds[f"{key}_percent"] for key in ("same_gears", "after_close_turn"))
        lines.append(
            f"error at most {same:.2g} % of the range while both cross the same gears, {close:.2g} % after a "
            f"turn within {100.0 * summary.bounds['close_turn_fraction']:.2g} % of a gear's width from an end"
        )
    return lines + list(summary.notes)


COMMANDS = {
    function.__name__: Command(function, options.OPTIONS_OF[function.__name__])
    for function in (
        identify, show, invert, simulate, compensate, check, report, excite, export, compare, trajectory,
        waveform,
    )
}  # fmt: skip
"""All commands by name, in the order of a working day."""


def run_usual(words: Sequence[str]) -> bool:
    """Run the command that a usual line names, without the library that takes a fifth of the start.

    Returns whether it was one; all others (help, completion, anything wrong) are the library's.
    """
    if options.ASKED in os.environ or not words or words[0] not in COMMANDS:
        return False
    command = COMMANDS[words[0]]
    values = options.read_line(words[1:], command.options)
    if values is not None:
        command.function(Given(typed=tuple(words), **values))
    return values is not None
