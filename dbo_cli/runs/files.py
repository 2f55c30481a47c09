"""The use cases from files to files, in constant memory: what a command does, without its messages.

``reading.format`` is for addresses whose ending does not show their format. With
``live`` every row is handed on as it arrives.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import chain
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from dbo_cli import extensions
from dbo_cli.drives.gate import DriveFigures, DriveGate, Floats
from dbo_cli.drives.model_run import ModelRun, Response, reads_ahead
from dbo_cli.errors import (
    SILENT,
    InputError,
    Listener,
    OutputError,
    Remarks,
    UsageError,
    cleaned,
    plain,
)
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_file import (
    model_to_bytes,
    read_model,
    read_state,
    state_to_bytes,
)
from dbo_cli.hysteresis.model_state import (
    START_NAMES,
    DriveLimits,
    ModelState,
    Quantity,
    StartName,
)
from dbo_cli.hysteresis.operators import Outside
from dbo_cli.logs import request
from dbo_cli.logs.columns import ColumnWish, column_wish, header_of, split_header
from dbo_cli.logs.request import ALL_ROWS, Address, Given, ReadingOptions, Rows
from dbo_cli.logs.sample_block import Column
from dbo_cli.logs.signal_log import SignalLog, Source, open_log
from dbo_cli.logs.signal_writer import SignalWriter, signal_writer
from dbo_cli.logs.sources import ArraySource, is_file, is_log, is_table, table_source
from dbo_cli.logs.units import quantity_name
from dbo_cli.logs.whole_output import all_or_none, check_outputs, write_whole

if TYPE_CHECKING:
    from dbo_cli.drives.options import DriveOptions
    from dbo_cli.hysteresis.excitation import Excitation


# of drives of many channels, written at a time; chosen, bounds the memory
_ROWS = 1 << 14


class Destination(NamedTuple):
    """Where a result goes: the file, the state after it, and the inputs that must not be overwritten.

    ``command`` is the command line that an HDF5 output names; ``summary`` a file for
    what was done, as JSON. With ``commented`` text begins with a comment that names
    command and model, too.
    """

    output: Address
    save_state: Address | None = None
    protect: Sequence[Given] = ()
    live: bool = False
    command: str = ""
    summary: Address | None = None
    commented: bool = False

    def beside(self, *selectors: str | None) -> Destination:
        """Protect the files that columns are taken from (``FILE::COLUMN``), too."""
        return self._replace(
            protect=[*self.protect, *request.selected_files(*selectors)]
        )

    def placed(self, put: Callable[[Address], Address]) -> Destination:
        """Put the name of a channel or a file into every output's."""
        state, summary = self.save_state, self.summary
        if state is not None:
            state = put(state)
        if summary is not None:
            summary = put(summary)
        return self._replace(output=put(self.output), save_state=state, summary=summary)

    def check(self) -> None:
        """Refuse outputs that cannot be written, or that are inputs or each other, before the long work."""
        if sum(map(_is_stream, self.protect)) > 1:
            raise UsageError(
                "standard input can be read once only: give the model or the signal as a file"
            )
        request.parse_output(self.output)
        outputs = (self.output, self.save_state, self.summary)
        check_outputs([path for path in outputs if path is not None], self.protect)
        if self.summary is not None:
            request.check_document(self.summary, "a summary", "json")
        if self.save_state is not None:
            request.check_document(self.save_state, "a state", "json")


def _is_stream(given: Given) -> bool:
    """Tell whether an input is standard input."""
    return given == "-" or (isinstance(given, Address) and given.is_stream)


@dataclass(frozen=True)
class SignalRun:
    """What is asked of ``simulate``, or with ``drive`` of ``compensate``.

    Attributes
    ----------
    model, log
        The model's file, and the log of its input or the trajectory.
    destination, reading
        Where the result goes, and how logs are read.
    column
        The signal's column; guessed where not given.
    state, outside
        Where it starts, and what happens outside the model's range.
    drive
        What is asked of the drive, but for the state.
    brought
        What the options that extras bring to ``compensate`` were given, by name.
    """

    model: str
    log: Address
    destination: Destination
    reading: ReadingOptions
    column: str | None = None
    state: str = "auto"
    outside: Outside = "extend"
    drive: DriveOptions | None = None
    brought: Mapping[str, Any] = field(default_factory=dict)

    @property
    def option(self) -> str:
        """The parameter that names the column."""
        return "input" if self.drive is None else "displacement"

    def run(self, listener: Listener = SILENT) -> Remarks:
        """Write time (when known), the input column and the result: the model's output, or the drive."""
        destination, model_file = self.protected(), self.model
        destination.check()
        check_order(model_file, self.log.text)
        request.check_format(self.reading.format, [self.log, destination.output])
        model = read_model(model_file)
        run = dataclasses.replace(self, destination=destination)
        if self.drive is None:
            return run._simulate(model, listener)
        model.require("forward", shown_name(model_file))
        return run._compensate(model, self.drive, listener)

    @property
    def may_read_ahead(self) -> bool:
        """Whether rows after the last one asked for may serve to undo delay and dynamics."""
        return True

    def refuse_many(self) -> None:
        """Refuse what is not for many channels or files (UsageError); a plain run is."""

    def protected(self) -> Destination:
        """Return where the result goes, with all that it must not overwrite."""
        return self.destination.beside(self.column, self.reading.time)

    def brought_to(self, model: ActuatorModel, listener: Listener) -> Mapping[str, Any]:
        """Return what was brought, as ``compensation`` takes it: files are read."""
        return self.brought

    def _simulate(self, model: ActuatorModel, listener: Listener) -> Remarks:
        ahead = model.direction == "inverse" and reads_ahead(model)
        with self._open_log(model.input, ahead, listener) as log:
            last = self.reading.rows[1] if ahead else None
            run = ModelRun(model, log, start_of(self.state, model), self.outside, last)
            return self._write_run(run, log, _column_of(log, model.input), listener)

    def _compensate(
        self, model: ActuatorModel, drive: DriveOptions, listener: Listener
    ) -> Remarks:
        from dbo_cli.drives.compensation import compensation

        wanted = model.output
        ahead = self.may_read_ahead and (
            reads_ahead(model) or drive.bandwidth is not None
        )
        brought = self.brought_to(model, listener)
        with self._open_log(wanted, ahead, listener) as log:
            options = dataclasses.replace(drive, state=start_of(self.state, model))
            last = self.reading.rows[1] if ahead else None
            run = compensation(model, log, options, brought, last)
            run.streamed = self.destination.output.is_stream
            # Not under the name of what will be measured: a drive must not be taken for
            # a recording.
            unit = log.columns[wanted.quantity].unit or wanted.unit
            desired = Column("desired", unit, "desired", may_be_blank=True)
            with all_or_none():
                remarks = self._write_run(run, log, desired, listener)
                run.finish()
            return remarks

    @contextlib.contextmanager
    def _open_log(
        self, taken: Quantity, ahead: bool, listener: Listener
    ) -> Iterator[SignalLog]:
        """Open the log; where it is to be read ahead, those after the last row asked for are there, too."""
        trajectory = self.drive is not None
        want = {
            taken.quantity: quantity_wish(
                taken, self.column, option=self.option, trajectory=trajectory
            )
        }
        reading, live = self.reading, self.destination.live
        if ahead and reading.resample is None:
            reading = dataclasses.replace(reading, rows=(reading.rows[0], None))
        with open_log(self.log, want, reading, live=live) as log:
            listener.opened(log.describe())
            if live:
                listener.reading(log.opening_line())
            bring_to(log, taken.quantity, taken, shown_name(self.model))
            yield log

    def _write_run(
        self, run: ModelRun, log: SignalLog, wanted: Column, listener: Listener
    ) -> Remarks:
        """Run to the end of the log and write what comes out, then the state and the summary."""
        destination = self.destination
        responses = run.responses()
        # Computed before anything is opened: a log that is bad from the start leaves
        # not even a header.
        first = next(responses)
        figures = DriveFigures()
        with all_or_none():
            try:
                with signal_writer(
                    destination.output.or_format(self.reading.format),
                    _output_columns(run, log, wanted),
                    attributes=partial(_attributes, run, log, destination.command),
                    flush=destination.live,
                    protect=destination.protect,
                    commented=destination.commented,
                ) as writer:
                    for response in chain([first], responses):
                        _write_block(writer, response)
                        if destination.summary is not None:
                            figures.see(response.y, None)
                        listener.progressed(len(response.y), "written")
                    listener.finished()
            except BrokenPipeError:
                if destination.save_state is None:
                    raise
                raise OutputError(
                    "standard output: its reader left before the end, so there is no last state to save"
                ) from None
            if destination.save_state is not None and run.state is not None:
                state = state_to_bytes(run.state, run.model)
                write_whole(destination.save_state, state)
            if destination.summary is not None:
                command = destination.command
                read = read_record(log.name, log.reading_record())
                summary = summary_of(command, read, figures, run.remarks(), run)
                write_summary(destination.summary, [summary])
        remarks = run.remarks()
        if destination.live:
            remarks.read.clear()  # printed when the stream began
        return remarks


def _output_columns(run: ModelRun, log: SignalLog, wanted: Column) -> list[Column]:
    """Return the columns to write: time, where it is known, what goes into the run and what comes out."""
    quantity, unit = run.output.quantity, run.output.unit
    out = Column(quantity, unit)
    if header_of(out) == header_of(wanted):
        out = Column(f"model_{quantity}", unit)
    if log.has_time:
        return [Column("time", "s"), wanted, out]
    return [wanted, out]


def _write_block(writer: SignalWriter, response: Response) -> None:
    """Write one block; without time it has two columns."""
    if response.time is None:
        writer.write(response.x, response.y)
    else:
        writer.write(response.time, response.x, response.y)


def run_of_signals(brought: Mapping[str, Any], **fields: Any) -> SignalRun:
    """Return the run of ``compensate``, as the extra makes it whose options were given.

    Parameters
    ----------
    brought
        What the options that extras bring were given, by name.
    **fields
        Those of ``SignalRun``.
    """
    make: type[SignalRun] = SignalRun
    for name in brought:
        make = extensions.find("run", f"files of compensate {name}") or make
    return make(**fields, brought=brought)


def invert_model(model_file: str, output: Address) -> ActuatorModel:
    """Write the exact inverse of a model."""
    request.check_document(output, "a model", "json")
    inverse = read_model(model_file).inverse()
    write_whole(output, model_to_bytes(inverse), protect=[model_file])
    return inverse


def excitation_drives(
    excitation: Excitation, points: int | None, brought: Mapping[str, Any]
) -> tuple[Floats, Mapping[str, Floats]]:
    """Return time (s) and the drive by the name of its column; an extra's option may make it many.

    Parameters
    ----------
    excitation
        What the drive is made of.
    points
        So many rows in all, where a generator's memory asks for that.
    brought
        What the options that extras bring were given.
    """
    for name in brought:
        made: tuple[Floats, Mapping[str, Floats]] = extensions.find(
            "run", f"excite --{name}"
        )(excitation, brought, points)
        return made
    time, voltage = excitation.drive()
    return time, {"voltage": voltage}


def write_excitation(
    output: Address,
    excitation: Excitation,
    form: str | None,
    timed_drives: tuple[Floats, Mapping[str, Floats]],
) -> float:
    """Write the drives that identify well, as ``excitation_drives`` returns them.

    A drive in another unit than volts is called by what the unit measures
    (``pressure_bar``).

    Returns
    -------
    float
        The greatest slew of them all, in the drive's unit per second.
    """
    time, drives = timed_drives
    limits = DriveLimits(excitation.v_min, excitation.v_max, excitation.max_slew)
    rate = excitation.sample_rate
    fastest = 0.0
    for drive in drives.values():
        DriveGate(limits).admit(drive, 1.0 / rate)
        fastest = max(fastest, float(np.abs(np.diff(drive)).max()) * rate)
    request.check_format(form, [output])
    quantity = quantity_name("voltage", excitation.unit)
    columns = [Column("time", "s")]
    columns += [
        Column(name.replace("voltage", quantity), excitation.unit) for name in drives
    ]
    with signal_writer(
        output.or_format(form), columns, attributes=lambda: {"sample_rate": rate}
    ) as writer:
        for row in range(0, len(time), _ROWS):
            writer.write(
                *(column[row : row + _ROWS] for column in (time, *drives.values()))
            )
    return fastest


def _attributes(run: ModelRun, log: SignalLog, command: str) -> dict[str, str | float]:
    """Return what an HDF5 output says of itself."""
    attributes: dict[str, str | float] = {
        "model_sha256": run.model.digest,
        "command": command,
    }
    if log.stated_rate is not None:
        attributes["sample_rate"] = log.stated_rate
    if run.voltage_scale is not None:
        attributes["voltage_scale"] = (
            f"{run.voltage_scale}, of the voltages in the model's logs"
        )
    return attributes


def summary_of(
    command: str,
    read: Mapping[str, Any] | None,
    figures: DriveFigures,
    remarks: Remarks,
    run: ModelRun | None = None,
) -> dict[str, Any]:
    """Return what was done as plain values (``dbo-summary``); voltages and lengths in the model's units."""
    from dbo_cli.drives.compensation import Compensation

    expected, percent, clipped = None, None, 0
    of_pieces: dict[str, Any] = {}
    if isinstance(run, Compensation):
        for watcher in run.watchers:
            of_pieces |= watcher.summary()
        of_pieces["before"] = run.summary_before()
        expected, percent = run.expected_rmse()
        of_pieces |= run.summary_of_error()
        clipped = run.clipped.count
    return {
        "format": "dbo-summary",
        "version": 1,
        "command": command,
        "read": [] if read is None else [read],
        "rows": figures.rows,
        "clipped": clipped,
        "range": [figures.low, figures.high],
        "largest_step": figures.largest_step,
        "expected_rmse": expected,
        "expected_percent": percent,
        "expected_percent_of_move": percent,
        **of_pieces,
        "notes": [plain(text) for text in remarks.notes],
        "warnings": [plain(text) for text in remarks.warnings],
    }


def read_record(name: str, read: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a summary says of a file that was read."""
    record: dict[str, Any] = {"file": name}
    for key in ("rows", "seconds", "columns"):
        if key in read:
            record[key] = read[key]
    return record


def summary_of_values(
    values: Floats, command: str, read: Mapping[str, Any] | None, remarks: Remarks
) -> dict[str, Any]:
    """Return what was done as plain values, of a signal at hand."""
    figures = DriveFigures()
    figures.see(values, None)
    return summary_of(command, read, figures, remarks)


def write_summary(output: Address, done: Sequence[Mapping[str, Any]]) -> None:
    """Write a summary, or a list of them where there are several signals."""
    write_json(output, done[0] if len(done) == 1 else done)


def write_json(output: Address, content: object) -> None:
    """Write plain values as JSON."""
    write_whole(
        output, (json.dumps(content, indent=2, ensure_ascii=False) + "\n").encode()
    )


def _column_of(log: SignalLog, taken: Quantity) -> Column:
    """Return the input column under its own name."""
    column = log.columns[taken.quantity]
    stated = split_header(column.name)[1]
    of_other_file = request.other_file(column.name)
    if stated is not None and stated != column.unit:
        name = column.quantity  # converted: the unit in its name is no longer its own
    elif not column.quantity:
        name = taken.quantity
    elif of_other_file:
        name = of_other_file[1]
    else:
        name = column.name
    return Column(name, column.unit or taken.unit, taken.quantity)


def check_order(model_file: str, log_file: str) -> None:
    """Recognise a model and a log that were given in each other's place (UsageError)."""
    if not _is_model(model_file) and _is_model(log_file):
        raise UsageError(
            f"{log_file} is a model: the model comes first, then the log ({log_file} {model_file})"
        )


def _is_model(path: str) -> bool:
    """Return whether a file begins as a model does; a pipe is not read: that could not be done again."""
    if not os.path.isfile(path):
        return False
    try:
        with open(path, "rb") as file:
            return file.read(1) == b"{" and b'"dbo-model"' in file.read(400)
    except OSError:
        return False


def shown_name(address: str) -> str:
    """Return an address as messages show it."""
    return "standard input" if address == "-" else address


# --- what a use case takes in: the columns of a log, its source in whatever form it is
# given, the start ---


def quantity_wish(
    quantity: Quantity,
    selector: str | None = None,
    *,
    option: str,
    trajectory: bool = False,
) -> ColumnWish:
    """Return the wish for a model's quantity; a ``trajectory`` of it may also be called desired."""
    role = "trajectory" if trajectory else quantity.quantity
    return column_wish(
        role, selector, option=option, quantity=quantity.quantity, unit=quantity.unit
    )


def recording_wishes(
    voltage: str | None, displacement: str | None, uncertainty: str | None = None
) -> dict[str, ColumnWish]:
    """Return the columns that an identification reads, as named or to be guessed."""
    wishes = {
        "voltage": column_wish("voltage", voltage, option="voltage"),
        "displacement": column_wish(
            "displacement", displacement, option="displacement"
        ),
    }
    if uncertainty is not None:
        wishes["uncertainty"] = ColumnWish(uncertainty, option="uncertainty")
    return wishes


def short_names(logs: Sequence[Any]) -> dict[Address, str]:
    """Return the names of files without their folders, where these differ."""
    files = [log for log in logs if isinstance(log, Address) and not log.is_stream]
    short = {log: cleaned(os.path.basename(log.text)) for log in files}
    if len(set(short.values())) < len(short):
        return {}
    return short


def bring_to(source: Source, role: str, wanted: Quantity, model: str) -> None:
    """Take a column in the model's unit: prefixes are converted, unlike units refused (InputError)."""
    source.convert(role, wanted.unit, f"{model} takes {wanted.quantity}")


def opened(
    log: Any,
    want: Mapping[str, ColumnWish],
    reading: ReadingOptions,
    listener: Listener = SILENT,
    *,
    time: Any = None,
    digest: bool = False,
) -> Source:
    """Return a log in whatever form it is given as a source of the columns wanted.

    Parameters
    ----------
    log
        An address or a file's name, a table, or arrays that are a source already.
    want
        Role to column.
    reading, time
        How it is read; of a table the column or the seconds of the time.
    listener, digest
        Is told how a file was understood, whose digest may be wanted.
    """
    if isinstance(log, ArraySource):
        log.rows = reading.rows
        return log
    if is_table(log):
        return table_source(log, want, time, reading.sample_rate, reading.rows)
    if not is_file(log) and not isinstance(log, Address):
        raise InputError(
            "a log is a table or a file's name; give two arrays as voltage and displacement"
        )
    log_file = open_log(log, want, reading, digest=digest)
    listener.opened(log_file.describe())
    return log_file


def source_of(
    want: Mapping[str, ColumnWish],
    *signals: Any,
    time: Any = None,
    sample_rate: float | None = None,
    rows: Rows = ALL_ROWS,
    name: str | None = None,
) -> Source:
    """Return what was given to a function in Python as a source of the columns wanted.

    Parameters
    ----------
    want
        Role to column; arrays come in this order, and messages call them as the
        options.
    signals
        A file's name, a table, or one array for each role.
    time, sample_rate, rows
        A column of a file or a table, or seconds; samples a second (Hz); the rows to
        take.
    name
        How messages call arrays.
    """
    if is_log(signals[0]):
        column = time if is_file(signals[0]) else None
        reading = ReadingOptions(time=column, sample_rate=sample_rate, rows=rows)
        return opened(signals[0], want, reading, time=time)
    called = [wish.option for wish in want.values()]
    columns = dict(zip(called, signals, strict=True))
    arrays = ArraySource(
        columns, time, sample_rate, name=name or f"`{called[0]}`", rows=rows
    )
    arrays.values = dict(zip(want, arrays.values.values(), strict=True))
    arrays.columns = dict(zip(want, arrays.columns.values(), strict=True))
    return arrays


def start_of(
    state: StartName | ModelState | str | os.PathLike[str], model: ActuatorModel
) -> StartName | ModelState:
    """Return a start: a name or a state as it is, anything else as a state file.

    Raises
    ------
    UsageError
        There is neither a start nor a file of that name, or the state is of another
        model.
    """
    if isinstance(state, ModelState):
        if state.model not in (None, model.digest):
            raise UsageError(
                "`state`: is of another model (go on with the model that returned it)"
            )
        return state
    path = os.fspath(state)
    if path in START_NAMES:
        return path
    if not os.path.exists(path):
        names = ", ".join(START_NAMES)
        raise UsageError(
            f"`state`: '{path}' is none of {names}, and there is no such file"
        )
    return dataclasses.replace(read_state(path, model), model=model.digest)
