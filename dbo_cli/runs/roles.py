"""What a use case takes in: the columns of a log, its source in whatever form it is given, and the start."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from dbo_cli.errors import InputError, UsageError
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_file import read_state
from dbo_cli.hysteresis.model_state import START_NAMES, ModelState, Quantity, StartName
from dbo_cli.logs.columns import ColumnWish, wish
from dbo_cli.logs.plain_text import cleaned
from dbo_cli.logs.request import ALL_ROWS, Address, ReadingOptions, Rows
from dbo_cli.logs.sample_block import joined
from dbo_cli.logs.signal_log import open_log
from dbo_cli.logs.sources import ArraySource, Source, is_file, is_log, is_table, table_source
from dbo_cli.remarks import SILENT, Listener

if TYPE_CHECKING:
    from dbo_cli.drives.learning import Tracked


def quantity_wish(
    quantity: Quantity, selector: str | None = None, *, option: str, trajectory: bool = False
) -> ColumnWish:
    """Return the wish for a model's quantity; a ``trajectory`` of it may also be called desired."""
    role = "trajectory" if trajectory else quantity.quantity
    return wish(role, selector, option=option, quantity=quantity.quantity, unit=quantity.unit)


def recording_wishes(voltage: str | None, displacement: str | None) -> dict[str, ColumnWish]:
    """Return the columns that an identification reads, as named or to be guessed."""
    return {
        "voltage": wish("voltage", voltage, option="voltage"),
        "displacement": wish("displacement", displacement, option="displacement"),
    }


def short_names(logs: Sequence[Any]) -> dict[Address, str]:
    """Return the names of files without their folders, where these differ."""
    files = [one for one in logs if isinstance(one, Address) and not one.is_stream]
    short = {one: cleaned(os.path.basename(one.text)) for one in files}
    return short if len(set(short.values())) == len(short) else {}


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
        raise InputError("a log is a table or a file's name; give two arrays as voltage and displacement")
    found = open_log(log, want, reading, digest=digest)
    listener.opened(found.describe())
    return found


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
        Role to column; arrays come in this order, and messages call them as the options.
    signals
        A file's name, a table, or one array for each role.
    time, sample_rate, rows
        A column of a file or a table, or seconds; samples a second (Hz); the rows to take.
    name
        How messages call arrays.
    """
    if is_log(signals[0]):
        column = time if is_file(signals[0]) else None
        reading = ReadingOptions(time=column, sample_rate=sample_rate, rows=rows)
        return opened(signals[0], want, reading, time=time)
    called = [one.option for one in want.values()]
    given = dict(zip(called, signals, strict=True))
    arrays = ArraySource(given, time, sample_rate, name=name or f"`{called[0]}`", rows=rows)
    arrays.values = dict(zip(want, arrays.values.values(), strict=True))
    arrays.columns = dict(zip(want, arrays.columns.values(), strict=True))
    return arrays


def tracked_wishes(
    model: ActuatorModel, voltage: str | None = None, measured: str | None = None
) -> dict[str, ColumnWish]:
    """Return the columns of a recording of a pass."""
    return {
        "voltage": quantity_wish(model.input, voltage, option="voltage"),
        "measured": quantity_wish(model.output, measured, option="measured"),
    }


def tracked_of(source: Source, model: ActuatorModel) -> Tracked:
    """Read a recording whole, in the units of the model."""
    from dbo_cli.drives.learning import Tracked

    bring_to(source, "voltage", model.input, "the model")
    bring_to(source, "measured", model.output, "the model")
    block = joined(list(source.blocks()))
    return Tracked(source.name, block.values["voltage"], block.values["measured"], block.time)


def start_of(
    state: StartName | ModelState | str | os.PathLike[str], model: ActuatorModel
) -> StartName | ModelState:
    """Return a start: a name or a state as it is, anything else as a state file.

    Raises
    ------
    UsageError
        There is neither a start nor a file of that name, or the state is of another model.
    """
    if isinstance(state, ModelState):
        if state.model not in (None, model.digest):
            raise UsageError("`state`: is of another model (go on with the model that returned it)")
        return state
    path = os.fspath(state)
    if path in START_NAMES:
        return path
    if not os.path.exists(path):
        names = ", ".join(START_NAMES)
        raise UsageError(f"`state`: '{path}' is none of {names}, and there is no such file")
    return dataclasses.replace(read_state(path, model), model=model.digest)
