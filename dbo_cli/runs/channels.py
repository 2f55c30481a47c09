"""What runs over channels share: patterns of columns, logs read once for all, models and files by channel.

A pattern (``V{}``) names the columns, a model set the models; ``{channel}`` in a file's name makes a file of
each. Each channel is one run of the use case of one actuator: what comes out is what it would give alone.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from dbo_cli.errors import InputError, UsageError
from dbo_cli.hysteresis.model_set import is_set, read_model, read_set
from dbo_cli.logs.channels import ChannelReader, channels_of, column_of, is_pattern
from dbo_cli.logs.columns import TIME_NAMES, column_info
from dbo_cli.logs.request import Address, ReadingOptions, parse_address
from dbo_cli.logs.sample_block import FloatArray
from dbo_cli.logs.sources import TABLE, is_file, is_table
from dbo_cli.logs.whole_output import all_or_none, make_folder
from dbo_cli.remarks import Remarks
from dbo_cli.runs.jobs import named, sum_up

if TYPE_CHECKING:
    from dbo_cli.export import ExportSummary

CHANNEL = "{channel}"


def patterns_of(**selectors: str | None) -> dict[str, str]:
    """Return patterns of columns by parameter, or refuse a single column among them (UsageError).

    A parameter of None takes no part; one of an empty text has to be given.
    """
    given = {option: one for option, one in selectors.items() if one is not None}
    pattern = next((f"`{option}` '{one}'" for option, one in given.items() if is_pattern(one)), "a pattern")
    for option, one in given.items():
        if not is_pattern(one):
            found = f"is one column, '{one}'," if one else "is not given"
            raise UsageError(f"`{option}` {found} where {pattern} is many: give a pattern for both")
    return given


def columns_of(patterns: Mapping[str, str], channel: str) -> dict[str, str]:
    """Return one channel's columns by parameter."""
    return {option: column_of(one, channel) for option, one in patterns.items()}


def wants_channels(output: Address, *selectors: str | None) -> bool:
    """Tell whether columns are named by a pattern.

    Raises
    ------
    UsageError
        An output is to be written for each channel, and there is no pattern.
    """
    if any(map(is_pattern, selectors)):
        return True
    if CHANNEL in output.text:
        raise UsageError(
            f"{output.text}: {CHANNEL} stands for a channel's name: name the columns by a pattern, 'V{{}}'"
        )
    return False


def in_name(name: str, channel: str) -> str:
    """Put a channel into the name of a file; a name that would lead to another folder is refused."""
    if CHANNEL in name and (channel in (".", "..") or any(sign in channel for sign in "/\\\0")):
        raise InputError(f"channel '{channel}' cannot be part of a file's name ('{name}')")
    return name.replace(CHANNEL, channel)


def address_of(address: Address, channel: str) -> Address:
    """Put a channel into the address of a file; see ``in_name``."""
    return parse_address(in_name(address.text, channel), address.format)


class TableReader:
    """A table whose columns are read by channel, as ``ChannelReader`` reads those of a log."""

    def __init__(self, table: Any, patterns: Mapping[str, str]) -> None:
        self._table = table
        infos = [column_info(str(name), number) for number, name in enumerate(table.columns, 1)]
        taken = {one.number for one in infos if one.quantity.lower() in TIME_NAMES}
        self.channels = channels_of(TABLE, infos, patterns, taken)

    def log(self, channel: str) -> Any:
        """Return the table without the columns of other channels."""
        own = self.channels[channel].values()
        others = {one.number for found in self.channels.values() for one in found.values()}
        others -= {one.number for one in own}
        return self._table.iloc[:, [k - 1 for k in range(1, self._table.shape[1] + 1) if k not in others]]


@contextlib.contextmanager
def opened_readers(
    logs: Sequence[Any], reading: ReadingOptions, patterns: Mapping[str, str], digest: bool = False
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
                here, there = (TABLE if is_table(log) else parse_address(log).text for log in (one, logs[0]))
                raise InputError(f"{here}: has other channels than {there}: {named(missing)} in one alone")
        yield readers


def models_by_channel(model_file: str, channels: Sequence[str], matrix: bool = False) -> Callable[[str], str]:
    """Return how each channel's model is named: a file of its own, one of a set, or one model for all.

    Raises
    ------
    InputError
        The set lacks a channel, or a matrix (``matrix``) has fewer columns than the set has models.
    """
    if CHANNEL in model_file:
        return lambda channel: in_name(model_file, channel)
    if not is_set(model_file):
        return lambda channel: model_file
    there = read_set(model_file)
    missing = [channel for channel in channels if channel not in there]
    if matrix and len(channels) < len(there):
        raise InputError(
            f"{model_file}: has {len(there):,} models, and the matrix {len(channels):,} columns; the longer"
            " axis of a matrix is taken for time where no time stamps stand beside it"
        )
    if missing:
        raise InputError(
            f"{model_file}: there is no model of channel {named(missing)} (it has {named(list(there))})"
        )
    return lambda channel: f"{model_file}::{channel}"


def make_folder_of(output: Address) -> None:
    """Make the folder that files of channels go to; it goes again where they are given up."""
    folder = output.path.rpartition("/")[0]
    if folder and CHANNEL not in folder:
        make_folder(folder)


def common_rows(times: Sequence[FloatArray | None]) -> tuple[FloatArray, list[tuple[int, int]]] | None:
    """Return the times of drives of which some begin or end before others, and the rows that each lacks.

    An actuator rests where its drive begins until the longest approach has brought the others there, too, and
    rests again at the end. None where the rows in between are not the same.
    """
    known = [one for one in times if one is not None]
    if len(known) < len(times):
        return None
    everything = np.unique(np.concatenate(known))
    places = []
    for one in known:
        before = int(np.searchsorted(everything, one[0]))
        if not np.array_equal(everything[before : before + len(one)], one):
            return None
        places.append((before, len(everything) - before - len(one)))
    return everything, places


def sum_up_remarks(found: Mapping[str, Remarks], pattern: str, remarks: Remarks) -> None:
    """Sum up what is to be said of all channels."""
    if not found:
        return
    first = next(iter(found.values()))
    remarks.read += [f"{line}; {len(found):,} channels: '{pattern}'" for line in first.read]
    sum_up(remarks, found, "channel")


def matrix_of(channels: Sequence[str], columns: Sequence[FloatArray], name: str) -> FloatArray:
    """Return a column a channel (InputError where their rows are not the same)."""
    for channel, column in zip(channels, columns, strict=True):
        if len(column) != len(columns[0]):
            raise InputError(
                f"channel {channel}: {name} has {len(column):,} good rows of it and {len(columns[0]):,} of "
                f"channel {channels[0]}: coupled channels are needed in every row (take good `rows` A:B)"
            )
    return np.column_stack(columns)


def export_models(
    model_file: str, folder: str, remarks: Remarks, *, name: str, **options: Any
) -> dict[str, ExportSummary]:
    """Export a model, or a set: to one folder with one kernel, or (``{channel}``) to a folder of each model.

    Raises
    ------
    UsageError
        A channel's name makes no names of its own in C, or an option is not for sets.
    """
    from dbo_cli.export import export_model, export_set

    if not is_set(model_file):
        return {"": export_model(read_model(model_file), folder, name=name, **options)}
    models = read_set(model_file)
    if models.coupling is not None:
        remarks.warn(
            f"the models of {model_file} are coupled, and the sources are of single channels: what is wanted "
            "of all has to be multiplied by the inverse of the gains first (docs/model-file.md)"
        )
    if CHANNEL not in folder:
        return export_set(models, folder, name=name, **options)
    with all_or_none():
        make_folder_of(parse_address(folder))
        return {
            channel: export_model(model, in_name(folder, channel), name=f"{name}_{channel}", **options)
            for channel, model in models.items()
        }
