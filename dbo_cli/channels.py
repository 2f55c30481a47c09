"""Many channels of one log: ``{}`` in the names of columns stands for a channel's name.

``--voltage 'V{}' --displacement 'D{}'`` takes the columns V1 and D1, V2 and D2, and so
on. Each channel has a model of its own; a model set is one file of them. Channels are
worked on one after the other, in memory; their results stand side by side in one
table.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.errors import DboError, InputError, ModelError, UsageError
from dbo_cli.model.state import START_NAMES
from dbo_cli.units import split_header

if TYPE_CHECKING:
    from dbo_cli.logs import Block, Reading
    from dbo_cli.model import Cascade

Result = tuple[str, str | None, Floats]
"""A column of the result: its name, unit and values."""
Columns = Mapping[str, str | None]
"""What was typed for each role."""
PLACE = "{}"


def is_pattern(columns: Columns) -> bool:
    """Return whether the name of a column stands for many."""
    return any(typed is not None and PLACE in typed for typed in columns.values())


def filled(columns: Columns, name: str) -> dict[str, str | None]:
    """Return the columns of one channel."""
    chosen = {}
    for role, typed in columns.items():
        chosen[role] = None if typed is None else typed.replace(PLACE, name)
    return chosen


def names(paths: Sequence[str], reading: Reading, columns: Columns) -> list[str]:
    """Return the channels that patterns find in a log, in the order of its columns.

    Raises
    ------
    InputError
        A pattern finds no column, or two patterns find different channels.
    UsageError
        The log is a stream, which cannot be read once for every channel.
    """
    from dbo_cli.logs import columns_of

    path = paths[0]
    if path == "-":
        raise UsageError("-: channels need a file, not a pipe")
    headers = [column.name for column in columns_of(path, reading)]
    channels: list[str] = []
    for role, typed in columns.items():
        if typed is None or PLACE not in typed:
            continue
        matches = _matches(typed, headers)
        channels = channels or matches
        odd = sorted(set(channels) ^ set(matches))
        if odd or not matches:
            lacking = f"not for channel {odd[0]}" if odd else "no column"
            raise InputError(
                f"{path}: `{role}` {typed}: {lacking}; columns: {', '.join(headers)}"
            )
    return channels


def _matches(pattern: str, headers: Sequence[str]) -> list[str]:
    """Return what stands in the place of ``{}``, for each header that fits, with or without its unit."""
    before, _, behind = pattern.partition(PLACE)
    fit = re.compile(re.escape(before) + "(.+)" + re.escape(behind), re.DOTALL)
    channels = []
    for header in headers:
        match = fit.fullmatch(split_header(header)[0]) or fit.fullmatch(header)
        if match is not None:
            channels.append(match[1])
    return channels


def models_of(path: str, channels: Iterable[str]) -> dict[str, Cascade]:
    """Return the model of each channel: of a set, or one that serves all."""
    from dbo_cli.model import is_set, read_model, read_models

    if not is_set(path):
        model = read_model(path)
        return dict.fromkeys(channels, model)
    models = read_models(path)
    for name in channels:
        if name not in models:
            raise ModelError(
                f"{path}: no model for channel {name}; models: {', '.join(models)}"
            )
    return {name: models[name] for name in channels}


def simulate(
    model_path: str,
    log_path: str,
    output: str,
    reading: Reading,
    columns: Columns,
    state: str,
    outside: Any,
) -> str:
    """Run the model of each channel over its input, write all side by side; return what to say of it."""
    from dbo_cli.drive.simulate import Simulator

    refuse({"state": state not in START_NAMES})
    results: list[Result] = []
    for name, model, table in _each(model_path, log_path, reading, columns, "input"):
        into, out, x = model.input, model.output, table["input"]
        with _naming(name):
            simulator = Simulator(model, state, outside, f"channel {name}")
            parts = simulator.rows(x, table.dt), simulator.finish()
        y = np.concatenate([part.y for part in parts])
        results.append((f"{into.quantity}_{name}", into.unit, x))
        results.append((f"{out.quantity}_{name}", out.unit, y))
    return _write(output, table.time, results)


def compensate(
    model_path: str,
    log_path: str,
    output: str,
    reading: Reading,
    columns: Columns,
    limits: Mapping[str, Any],
    on_limit: Any,
    state: str,
) -> str:
    """Drive each channel along its own displacement, write all drives side by side; return what to say."""
    from dbo_cli.drive import Limits, plan

    refuse({"state": state not in START_NAMES})
    role = "displacement"
    results: list[Result] = []
    for name, model, table in _each(model_path, log_path, reading, columns, role):
        model.require("forward", f"{model_path}::{name}")
        drive, moved = model.input, model.output
        clock = table.dt if isinstance(table.dt, float) else table.time
        options = {"on_limit": on_limit, "state": state, "name": f"channel {name}"}
        with _naming(name):
            allowed = Limits.within(drive, **limits)
            done = plan(model, table[role], clock, allowed, **options)
        results.append((f"desired_{name}", moved.unit, done.desired))
        results.append((f"{drive.quantity}_{name}", drive.unit, done.voltage))
    return _write(output, table.time, results)


def refuse(options: Mapping[str, object]) -> None:
    """Refuse what gives channels drives of different lengths, or is of one model."""
    for option, value in options.items():
        if value:
            raise UsageError(
                f"`{option}` needs a single channel: give SET::NAME and its columns"
            )


def _each(
    model_path: str, log_path: str, reading: Reading, columns: Columns, role: str
) -> Iterator[tuple[str, Cascade, Block]]:
    """Yield name, model and log of each channel, the signal of a role in the unit of the model."""
    from dbo_cli.logs import open_log

    channels = names([log_path], reading, columns)
    for name, model in models_of(model_path, channels).items():
        unit = (model.input if role == "input" else model.output).unit
        units = {role: unit} if unit else {}
        with open_log(log_path, filled(columns, name), reading, units) as log:
            yield name, model, log.read()


@contextmanager
def _naming(channel: str) -> Iterator[None]:
    """Name the channel in an error."""
    place = f"channel {channel}: "
    try:
        yield
    except DboError as problem:
        raise type(problem)(place + str(problem).removeprefix(place)) from problem


def _write(output: str, time: Floats | None, results: list[Result]) -> str:
    """Write the two columns of each channel side by side, behind the time if there is one."""
    from dbo_cli.logs import create

    text = f"{len(results) // 2} channels, {len(results[0][2]):,} rows"
    if time is not None:
        results = [("time", "s", time), *results]
    with create(output, [(name, unit) for name, unit, _ in results]) as table:
        table.write(*(values for _, _, values in results))
    return text
