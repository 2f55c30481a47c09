"""Runs over channels: patterns of columns, logs read once for all, models and files by channel, and signals.

A pattern (``V{}``) names the columns, a model set the models; ``{channel}`` in a file's
name makes a file of each. Each channel is one run of the use case of one actuator: what
comes out is what it would give alone. ``simulate`` and ``compensate`` write one table
of all, matrices, or a file of each.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dbo_cli.errors import InputError, Listener, Remarks, UsageError
from dbo_cli.extras.channels.columns import (
    ChannelReader,
    channels_of,
    column_of,
    is_matrix,
)
from dbo_cli.extras.channels.model_set import Coupling
from dbo_cli.hysteresis.model_file import is_set, read_model, read_set
from dbo_cli.hysteresis.model_state import START_NAMES
from dbo_cli.logs import whole_output
from dbo_cli.logs.columns import PLACE, TIME_NAMES, header_of, is_pattern, parse_column
from dbo_cli.logs.request import (
    ALL_ROWS,
    Address,
    Given,
    ReadingOptions,
    parse_address,
    parse_output,
)
from dbo_cli.logs.sample_block import Column, FloatArray, joined
from dbo_cli.logs.signal_log import open_log
from dbo_cli.logs.signal_writer import signal_writer
from dbo_cli.logs.sources import TABLE, is_file, is_table
from dbo_cli.logs.whole_output import KeptOutputs, KeptSignal
from dbo_cli.runs.files import (
    Destination,
    SignalRun,
    bring_to,
    check_order,
    quantity_wish,
    write_json,
)
from dbo_cli.runs.jobs import Done, Outcome, Work, named, sum_up
from dbo_cli.runs.many import CHANNEL, address_of, in_name, make_folder_of

_ROWS = 1 << 12  # of a table of channels, written at a time; chosen, bounds the memory


def patterns_of(**selectors: str | None) -> dict[str, str]:
    """Return patterns of columns by parameter, or refuse a single column among them (UsageError).

    A parameter of None takes no part; one of an empty text has to be given.
    """
    patterns: dict[str, str] = {}
    not_many: dict[str, str] = {}
    for option, selector in selectors.items():
        if selector is None:
            continue
        if is_pattern(selector):
            patterns[option] = selector
        else:
            not_many[option] = selector
    pattern = "a pattern"
    for option, selector in patterns.items():
        pattern = f"`{option}` '{selector}'"
        break
    for option, selector in not_many.items():
        problem = f"is one column, '{selector}'," if selector else "is not given"
        raise UsageError(
            f"`{option}` {problem} where {pattern} is many: give a pattern for both"
        )
    return patterns


def columns_of(patterns: Mapping[str, str], channel: str) -> dict[str, str]:
    """Return one channel's columns by parameter."""
    return {option: column_of(pattern, channel) for option, pattern in patterns.items()}


class TableReader:
    """A table whose columns are read by channel, as ``ChannelReader`` reads those of a log."""

    def __init__(self, table: Any, patterns: Mapping[str, str]) -> None:
        self._table = table
        infos = [
            parse_column(str(name), number)
            for number, name in enumerate(table.columns, 1)
        ]
        taken = {
            column.number for column in infos if column.quantity.lower() in TIME_NAMES
        }
        self.channels = channels_of(TABLE, infos, patterns, taken)

    def log(self, channel: str) -> Any:
        """Return the table without the columns of other channels."""
        columns = self.channels[channel].values()
        of_others: set[int] = set()
        for by_option in self.channels.values():
            of_others.update(column.number for column in by_option.values())
        of_others -= {column.number for column in columns}
        places = []
        for number in range(1, self._table.shape[1] + 1):
            if number not in of_others:
                places.append(number - 1)
        return self._table.iloc[:, places]


def _name_of(log: Any) -> str:
    """Return how messages call a table or a file."""
    return TABLE if is_table(log) else parse_address(log).text


@contextlib.contextmanager
def opened_readers(
    logs: Sequence[Any],
    reading: ReadingOptions,
    patterns: Mapping[str, str],
    digest: bool = False,
) -> Iterator[list[Any]]:
    """Open logs or tables that all have the same channels (InputError where one lacks some)."""
    with contextlib.ExitStack() as stack:
        readers: list[ChannelReader | TableReader] = []
        for one in logs:
            if is_table(one):
                readers.append(TableReader(one, patterns))
            elif is_file(one) or isinstance(one, Address):
                reader = ChannelReader(parse_address(one), reading, patterns, digest)
                stack.callback(reader.close)
                readers.append(reader)
            else:
                raise InputError("a log with many channels is a table or a file's name")
            first, channels = readers[0].channels, readers[-1].channels
            missing = [name for name in first if name not in channels]
            missing += [name for name in channels if name not in first]
            if missing:
                raise InputError(
                    f"{_name_of(one)}: has other channels than {_name_of(logs[0])}: {named(missing)} in one "
                    "alone"
                )
        yield readers


def models_by_channel(
    model_file: str, channels: Sequence[str], matrix: bool = False
) -> Callable[[str], str]:
    """Return how each channel's model is named: a file of its own, one of a set, or one model for all.

    Raises
    ------
    InputError
        The set lacks a channel, or a matrix (``matrix``) has fewer columns than the set
        has models.
    """
    if CHANNEL in model_file:
        return lambda channel: in_name(model_file, channel)
    if not is_set(model_file):
        return lambda channel: model_file
    models = read_set(model_file)
    missing = [channel for channel in channels if channel not in models]
    if matrix and len(channels) < len(models):
        raise InputError(
            f"{model_file}: has {len(models):,} models, and the matrix {len(channels):,} columns; the longer"
            " axis of a matrix is taken for time where no time stamps stand beside it"
        )
    if missing:
        raise InputError(
            f"{model_file}: there is no model of channel {named(missing)} (it has {named(list(models))})"
        )
    return lambda channel: f"{model_file}::{channel}"


def common_rows(
    times: Sequence[FloatArray | None],
) -> tuple[FloatArray, list[tuple[int, int]]] | None:
    """Return the times of drives of which some begin or end before others, and the rows that each lacks.

    An actuator rests where its drive begins until the longest approach has brought the
    others there, too, and rests again at the end. None where the rows in between are
    not the same.
    """
    known = [time for time in times if time is not None]
    if len(known) < len(times):
        return None
    everything = np.unique(np.concatenate(known))
    places = []
    for time in known:
        before = int(np.searchsorted(everything, time[0]))
        if not np.array_equal(everything[before : before + len(time)], time):
            return None
        places.append((before, len(everything) - before - len(time)))
    return everything, places


def sum_up_remarks(
    remarks_of: Mapping[str, Remarks], pattern: str, remarks: Remarks
) -> None:
    """Sum up what is to be said of all channels."""
    if not remarks_of:
        return
    first = next(iter(remarks_of.values()))
    remarks.read += [
        f"{line}; {len(remarks_of):,} channels: '{pattern}'" for line in first.read
    ]
    sum_up(remarks, remarks_of, "channel")


def matrix_of(
    channels: Sequence[str], columns: Sequence[FloatArray], name: str
) -> FloatArray:
    """Return a column a channel (InputError where their rows are not the same)."""
    for channel, column in zip(channels, columns, strict=True):
        if len(column) != len(columns[0]):
            raise InputError(
                f"channel {channel}: {name} has {len(column):,} good rows of it and {len(columns[0]):,} of "
                f"channel {channels[0]}: coupled channels are needed in every row (take good `rows` A:B)"
            )
    return np.column_stack(columns)


# --- simulate and compensate over channels ---


def signals_of_channels(run: SignalRun, work: Work, listener: Listener) -> Outcome:
    """Run ``simulate`` or ``compensate`` for each channel; write a table or a file of each.

    What is said of each channel is summed up.
    """
    destination, reading = run.destination, run.reading
    patterns = patterns_of(**{run.option: run.column or ""})
    each_own = CHANNEL in destination.output.text
    _check_asked(run)
    outcome = Outcome()
    remarks: dict[str, Remarks] = {}
    summaries: list[dict[str, Any]] = []
    with opened_readers([run.log], reading, patterns) as (reader,):
        channels = list(reader.channels)
        (pattern,) = patterns.values()
        models = models_by_channel(run.model, channels, is_matrix(pattern))
        coupling, wanted = coupling_of(run.model, channels, work), run.drive is not None
        if run.drive is not None and run.drive.typed_limits:
            units = {
                channel: read_model(models(channel)).drive.unit for channel in channels
            }
            run.drive.require_one_unit(units)
        work = dataclasses.replace(work, all_needed=coupling is not None)
        log_of: Callable[[str], Address] = reader.log
        if coupling is not None and wanted:
            log_of = logs_apart(reader, models, pattern, reading, coupling).__getitem__
            reading = dataclasses.replace(reading, scale=())

        def jobs() -> Iterator[tuple[str, Callable[[], Remarks]]]:
            for channel in channels:
                run_of_channel = dataclasses.replace(
                    run, model=models(channel), log=log_of(channel), reading=reading,
                    destination=destination.placed(functools.partial(address_of, channel=channel)),
                    column=column_of(pattern, channel), state=in_name(run.state, channel),
                )  # fmt: skip
                yield channel, run_of_channel.run

        with whole_output.all_or_none():
            table = ChannelTable(destination, channels, pattern)
            if each_own:
                make_folder_of(destination.output)
            good = outcome.good(jobs(), work, "channel", len(channels), listener)
            pads = not each_own and _may_pad(run)
            for done in _together(good, coupling, pads, -2 if wanted else -1):
                remarks[done.name] = done.value
                if each_own:
                    write_kept(done.outputs, destination.protect)
                else:
                    table.add(done.name, done.outputs)
                    summaries += _other_documents(done, destination)
            table.finish()
            if summaries and destination.summary is not None:
                write_json(destination.summary, summaries)
    sum_up_remarks(remarks, pattern, outcome.remarks)
    return outcome


def _check_asked(run: SignalRun) -> None:
    """Refuse what cannot be had of channels, or written for all of them at once (UsageError)."""
    destination = run.destination
    if destination.live:
        raise UsageError(
            "`flush` follows a log row by row, and channels are read whole (leave one out)"
        )
    check_order(run.model, run.log.text)
    if CHANNEL in destination.output.text:
        return
    if (
        destination.save_state is not None
        and CHANNEL not in destination.save_state.text
    ):
        raise UsageError(
            f"`save_state` {destination.save_state.text}: each channel has its own (put {CHANNEL} into it)"
        )
    whole_output.check_outputs([destination.output], destination.protect)


def _together(
    good: Iterator[Done[Remarks]], coupling: Coupling | None, pads: bool, result: int
) -> Iterable[Done[Remarks]]:
    """Wait for all channels, where what is written of one depends on the others."""
    if coupling is None and not pads:
        return good
    all_done = list(good)
    if pads:
        _pad([done.outputs for done in all_done])
    if coupling is not None:
        put_together({done.name: done.outputs for done in all_done}, coupling, result)
    return all_done


def _may_pad(run: SignalRun) -> bool:
    """Tell whether drives may have rows before and after the move, between which the actuator is at rest."""
    around = run.drive is not None and run.drive.has_pieces
    return around and run.state in START_NAMES and not run.reading.skip_bad


def _pad(outputs: Sequence[KeptOutputs]) -> None:
    """Let drives that begin later than others rest at their first row until then, and at their last."""
    signals = [output.signals[0] for output in outputs]
    timed = all(header_of(signal.columns[0]) == "time_s" for signal in signals)
    common = common_rows([signal.arrays[0] if timed else None for signal in signals])
    if common is None:
        return  # the table says which channel has other rows
    for output, signal, (before, after) in zip(
        outputs, signals, common[1], strict=True
    ):
        _, desired, drive = signal.arrays
        wanted = np.concatenate(
            [np.full(before, desired[0]), desired, np.full(after, np.nan)]
        )
        arrays = (common[0], wanted, np.pad(drive, (before, after), "edge"))
        output.signals[0] = dataclasses.replace(signal, arrays=arrays)


def write_kept(outputs: KeptOutputs, protect: Sequence[Given]) -> None:
    """Write outputs that were kept, as they would have been written."""
    for signal in outputs.signals:
        _write_signal(signal, protect, len(signal.arrays[0]))
    for name, data in outputs.documents:
        whole_output.write_whole(name, data, protect=protect)


def _write_signal(signal: KeptSignal, protect: Sequence[Given], rows: int) -> None:
    """Write a signal, so many rows at a time."""
    with signal_writer(
        signal.address, signal.columns, format=signal.format, attributes=lambda: signal.attributes,
        protect=protect, commented=signal.commented,
    ) as writer:  # fmt: skip
        for row in range(0, len(signal.arrays[0]), max(rows, 1)):
            writer.write(*(array[row : row + rows] for array in signal.arrays))


def _other_documents(
    done: Done[Remarks], destination: Destination
) -> list[dict[str, Any]]:
    """Write a channel's state; return its summary, which goes into one list with the others'."""
    documents = []
    for name, data in done.outputs.documents:
        if destination.summary is not None and name == destination.summary.text:
            documents.append({"channel": done.name, **json.loads(data)})
        else:
            whole_output.write_whole(name, data, protect=destination.protect)
    return documents


@dataclass
class ChannelTable:
    """One output of all channels: columns that carry a channel's name, or (in HDF5, of matrices) matrices.

    Raises
    ------
    InputError
        The channels' rows are at different times, so that one table cannot hold them.
    """

    destination: Destination
    channels: Sequence[str]
    pattern: str
    _first: KeptSignal | None = None
    _time: Any = None
    _kept: dict[str, KeptSignal] = dataclasses.field(default_factory=dict)
    _stack: contextlib.ExitStack = dataclasses.field(
        default_factory=contextlib.ExitStack
    )
    _matrices: Any = None

    def add(self, channel: str, outputs: KeptOutputs) -> None:
        """Take the signal of a channel; matrices are written at once, columns wait for the others."""
        (signal,) = outputs.signals
        timed = header_of(signal.columns[0]) == "time_s"
        time: Any = signal.arrays[0] if timed else None
        arrays = signal.arrays[timed:]
        attributes = dict(signal.attributes)
        attributes.pop("model_sha256", None)  # the models of all are not one
        signal = dataclasses.replace(signal, attributes=attributes)
        if self._first is None:
            self._first, self._time = signal, time
        elif len(arrays[0]) != len(self._first.arrays[0]) or not (
            np.array_equal(time, self._time)
        ):
            raise InputError(
                f"channel {channel}: its {len(arrays[0]):,} rows are not at the times of the first channel's"
                f" {len(self._first.arrays[0]):,}: write a file a channel (-o 'out/{CHANNEL}.csv')"
            )
        if (
            is_matrix(self.pattern)
            and parse_output(self.destination.output, signal.format).kind == "hdf5"
        ):
            self._write_column(channel, signal, arrays)
        else:
            self._kept[channel] = dataclasses.replace(signal, arrays=arrays)

    def finish(self) -> None:
        """Write what waits."""
        self._stack.close()
        if not self._kept or self._first is None:
            return
        first = self._first
        timed = self._time is not None
        columns = list(first.columns[:1]) if timed else []
        arrays = [self._time] if timed else []
        for channel, signal in self._kept.items():
            columns += [
                self._column(column, channel) for column in signal.columns[timed:]
            ]
            arrays += signal.arrays
        whole = dataclasses.replace(first, columns=columns, arrays=tuple(arrays))
        _write_signal(whole, self.destination.protect, _ROWS)

    def _column(self, column: Column, channel: str) -> Column:
        """Return a channel's column: an input keeps its own name, which holds the channel's."""
        stem = column_of(self.pattern, channel).removeprefix("name=")
        if column.name.startswith(stem):
            return column
        quantity = column.quantity or column.name
        return dataclasses.replace(
            column, name=f"{column.name}_{channel}", quantity=quantity
        )

    def _write_column(
        self, channel: str, signal: KeptSignal, arrays: Sequence[Any]
    ) -> None:
        if self._matrices is None:
            from dbo_cli.logs.hdf5.store import matrix_writer

            stem = PLACE.split(self.pattern)[0].removesuffix("[")
            quantities = signal.columns[len(signal.columns) - len(arrays) :]
            columns = []
            for column in quantities:
                if column.name.startswith(stem):
                    column = dataclasses.replace(column, name=stem)
                columns.append(column)
            self._matrices = self._stack.enter_context(
                matrix_writer(
                    signal.address, columns, self.channels, self._time, len(arrays[0]),
                    attributes=signal.attributes,
                    protect=self.destination.protect,
                )
            )  # fmt: skip
        self._matrices(self.channels.index(channel), arrays)


# --- coupled channels: what is wanted is taken apart, what comes out put together ---


def coupling_of(
    model_file: str, channels: Sequence[str], work: Work
) -> Coupling | None:
    """Return the coupling that a set holds, in the order of channels, of which none may be missing."""
    coupling = read_set(model_file).coupling if is_set(model_file) else None
    if coupling is not None and work.keep_going:
        raise UsageError(
            f"`keep_going`: the models of {model_file} are coupled: each is needed for the others"
        )
    return None if coupling is None else coupling.of(channels)


def logs_apart(
    reader: ChannelReader,
    models: Callable[[str], str],
    pattern: str,
    reading: ReadingOptions,
    coupling: Coupling,
) -> dict[str, Address]:
    """Return logs of what each channel has to do alone, so that the sensors show what is wanted of all."""
    whole = dataclasses.replace(reading, rows=ALL_ROWS, resample=None, skip_bad=False)
    logs, columns = {}, []
    for channel in coupling.channels:
        model = read_model(models(channel))
        logs[channel] = reader.log(channel)
        want = {
            "wanted": quantity_wish(
                model.output,
                column_of(pattern, channel),
                option="displacement",
                trajectory=True,
            )
        }
        with open_log(logs[channel], want, whole) as opened:
            bring_to(opened, "wanted", model.output, models(channel))
            columns.append(joined(list(opened.blocks())).values["wanted"])
    apart = coupling.apart(matrix_of(coupling.channels, columns, reader.address.text))
    for place, (channel, log) in enumerate(logs.items()):
        assert log.table is not None  # a bad row was refused above
        table, number = log.table, reader.channels[channel]["displacement"].number
        unit = read_model(models(channel)).output.unit
        infos = []
        for column in table.columns:
            if column.number == number:
                column = dataclasses.replace(column, unit=unit)
            infos.append(column)
        block = dataclasses.replace(
            table.block,
            values={**table.block.values, str(number): apart[:, place].copy()},
        )
        logs[channel] = dataclasses.replace(
            log, table=dataclasses.replace(table, columns=infos, block=block)
        )
    return logs


def put_together(
    outputs: Mapping[str, KeptOutputs], coupling: Coupling, result: int
) -> None:
    """Let one column of all channels' kept signals (``result``: its place) be what the sensors show."""
    signals = [output.signals[0] for output in outputs.values()]
    name = signals[0].address.text
    shown = coupling.together(
        matrix_of(list(outputs), [signal.arrays[result] for signal in signals], name)
    )
    for place, (output, signal) in enumerate(
        zip(outputs.values(), signals, strict=True)
    ):
        arrays = list(signal.arrays)
        arrays[result] = np.ascontiguousarray(shown[:, place])
        output.signals[0] = dataclasses.replace(signal, arrays=tuple(arrays))
