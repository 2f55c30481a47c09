"""Many channels of one log: ``{}`` in the names of columns stands for a channel's name.

``--voltage 'V{}' --displacement 'D{}'`` takes the columns V1 and D1, V2 and D2, and so
on. Each channel has a model of its own; a model set is one file of them. Channels are
worked on one after the other, in memory; their results stand side by side in one table,
and what belongs to a channel (state, summary, history) in one file of all. A log
without patterns is one channel whose name is empty: it has the plain files.
"""

from __future__ import annotations

import json
import os
import re
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from dbo_cli.arrays import Floats
from dbo_cli.errors import (
    DboError,
    DboWarning,
    InputError,
    LimitError,
    ModelError,
    UsageError,
    warn,
)
from dbo_cli.model import State, fields
from dbo_cli.model.file import parse_state, read_state
from dbo_cli.model.state import START_NAMES
from dbo_cli.units import split_header

if TYPE_CHECKING:
    from dbo_cli.drive import Drive
    from dbo_cli.drive.simulate import Rows
    from dbo_cli.logs import Block, Reading
    from dbo_cli.model import Cascade

Result = tuple[str, str | None, Floats]
"""A column of the result: its name, unit and values."""
PLACE = "{}"
ALONE = ("",)
"""The channels of a log whose columns are no patterns."""
MOST_TRIES = 20  # to make channels equally long; what creeps meanwhile may change a row
LIMIT_SLACK = 0.1
"""Of a channel's range: so far beyond it a limit is only that of the channel whose name it has."""


def is_pattern(columns: Mapping[str, str | None]) -> bool:
    """Return whether the name of a column stands for many."""
    return any(pattern is not None and PLACE in pattern for pattern in columns.values())


def columns_for(columns: Mapping[str, str | None], name: str) -> dict[str, str | None]:
    """Return the columns of one channel."""
    columns_of_channel = {}
    for role, pattern in columns.items():
        columns_of_channel[role] = (
            None if pattern is None else pattern.replace(PLACE, name)
        )
    return columns_of_channel


def names(
    paths: Sequence[str], reading: Reading, columns: Mapping[str, str | None]
) -> list[str]:
    """Return the channels that patterns find in a log, in the order of its columns; else ``ALONE``.

    Raises
    ------
    InputError
        A pattern finds no column, or two patterns find different channels.
    UsageError
        The log is a stream, which cannot be read once for every channel.
    """
    from dbo_cli.logs import columns_of
    from dbo_cli.logs.columns import fitting

    if not is_pattern(columns):
        return list(ALONE)
    path = paths[0]
    if path == "-":
        raise UsageError("-: channels need a file, not a pipe")
    table = columns_of(path, reading)
    headers = [column.name for column in table]
    channels: list[str] = []
    for role, pattern in columns.items():
        if pattern is None or PLACE not in pattern:
            continue
        names = headers
        if pattern == PLACE:
            names = [column.name for column in fitting(table, role)]
        matches = _matches(pattern, names)
        channels = channels or matches
        mismatched = sorted(set(channels) ^ set(matches))
        if mismatched or not matches:
            lacking = f"not for channel {mismatched[0]}" if mismatched else "no column"
            raise InputError(
                f"{path}: `{role}` {pattern}: {lacking}; columns: {', '.join(headers)}"
            )
    return channels


def _matches(pattern: str, headers: Sequence[str]) -> list[str]:
    """Return what stands in the place of ``{}``, for each header that fits, with or without its unit."""
    before, _, after = pattern.partition(PLACE)
    fit = re.compile(re.escape(before) + "(.+)" + re.escape(after), re.DOTALL)
    channels = []
    for header in headers:
        match = fit.fullmatch(split_header(header)[0]) or fit.fullmatch(header)
        if match is not None:
            channels.append(match[1])
    return channels


def models_of(path: str, channels: Sequence[str]) -> dict[str, Cascade]:
    """Return the model of each channel: of a set, or one that serves all."""
    from dbo_cli.model import is_set, read_model, read_models

    if tuple(channels) == ALONE or not is_set(path):
        return dict.fromkeys(channels, read_model(path))
    return read_models(path, list(channels))


# --- what is typed for a channel, or for all ---


def value_for(
    name: str, texts: Sequence[str] | None, channel: str, channels: Sequence[str]
) -> str | None:
    """Return what was typed for a channel: ``x=120V`` for one of them, ``120V`` for all.

    Parameters
    ----------
    name
        Of the option.
    texts
        Its values.
    channel, channels
        The channel, and all there are.

    Raises
    ------
    UsageError
        A value is of no channel, or two values are of one.
    """
    values: dict[str | None, str] = {}
    for text in texts or ():
        name_of_channel, mark, value = text.rpartition("=")
        owner = name_of_channel if mark else None
        if mark and (not owner or owner not in channels):
            names = ", ".join(channels) or "this is no set of channels"
            raise UsageError(f"`{name}` {text}: no channel {owner}: {names}")
        if owner in values:
            raise UsageError(f"`{name}` {text}: is given twice")
        values[owner] = value
    return values.get(channel, values.get(None))


def values_for(
    texts: Mapping[str, Sequence[str] | None], channel: str, channels: Sequence[str]
) -> dict[str, str | None]:
    """Return what was typed of several options for a channel, by option."""
    values = {}
    for name, values_of_option in texts.items():
        values[name] = value_for(name, values_of_option, channel, channels)
    return values


def require_own_limit(
    name: str,
    texts: Sequence[str] | None,
    channel: str,
    value: float | None,
    model: Cascade,
) -> None:
    """Refuse a limit for all channels that is far beyond the range of one of them (UsageError)."""
    is_own = any(text.startswith(f"{channel}=") for text in texts or ())
    if value is None or not channel or is_own:
        return
    drive = model.input
    slack = LIMIT_SLACK * drive.span
    if drive.min - slack <= value <= drive.max + slack:
        return
    raise UsageError(
        f"`{name}` {value:g}{drive.suffix} is beyond channel {channel}, {drive.min:.6g} to {drive.max:.6g}"
        f"{drive.suffix}: type `{name}` {channel}=VOLT"
    )


# --- tables and drives of all channels ---


def read_channels(
    log_path: str,
    reading: Reading,
    columns: Mapping[str, str | None],
    roles: Mapping[str, Mapping[str, Any]],
) -> dict[str, Block]:
    """Return the log of each channel.

    Parameters
    ----------
    roles
        By role: the quantity of each channel, in whose unit its values are wanted.
    """
    from dbo_cli.logs import open_log

    tables = {}
    for name in next(iter(roles.values())):
        units = {role: quantities[name].unit for role, quantities in roles.items()}
        with open_log(log_path, columns_for(columns, name), reading, units) as log:
            tables[name] = log.read()
    return tables


def together(
    drive_of: Callable[[str, int, int], Drive], channels: Iterable[str]
) -> dict[str, Drive]:
    """Return the drives of channels, of which the shorter ones hold before and behind the move.

    Parameters
    ----------
    drive_of
        Makes the drive of a channel, with rows held before what stands before the move,
        and with at least so many rows behind the move.
    """
    drives: dict[str, Drive] = {}
    holds = dict.fromkeys(channels, 0)
    after = 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DboWarning)
        for _ in range(MOST_TRIES):
            for name, hold in holds.items():
                if name not in drives:
                    with naming(name):
                        drives[name] = drive_of(name, hold, after)
            lead = max(drive.lead_rows for drive in drives.values())
            after = max(drive.rows - drive.move.stop for drive in drives.values())
            for name, drive in list(drives.items()):
                short = lead - drive.lead_rows
                if short or drive.rows - drive.move.stop < after:
                    holds[name] += short
                    del drives[name]
            if len(drives) == len(holds):
                break
        else:
            raise LimitError(
                "the channels' ways to their moves do not become equally long: give `approach` SECONDS"
            )
    for drive in drives.values():
        for text in drive.warnings:
            warn(text)
    return {name: drives[name] for name in holds}


@contextmanager
def naming(channel: str) -> Iterator[None]:
    """Name the channel in an error, if it has a name."""
    prefix = f"channel {channel}: " if channel else ""
    try:
        yield
    except DboError as problem:
        raise type(problem)(prefix + str(problem).removeprefix(prefix)) from problem


# --- files of all channels ---


def plural(kind: str) -> str:
    """Return the key under which a set holds files of a kind."""
    return kind[:-1] + "ies" if kind.endswith("y") else f"{kind}s"


def dumps_files(kind: str, texts: Mapping[str, str]) -> str:
    """Return the files of channels as one: a set of states, summaries or histories (of a ``kind``)."""
    if tuple(texts) == ALONE:
        return texts[""]
    members = {name: json.loads(text) for name, text in texts.items()}
    content: dict[str, Any] = {"format": f"dbo-{kind}-set", "version": fields.VERSION}
    content[plural(kind)] = members
    return json.dumps(content, indent=2) + "\n"


def summaries_of(path: str | None, channels: Sequence[str]) -> dict[str, Any]:
    """Return the summary of each channel, of a set of them; else the file itself, which serves all."""
    values = None
    if path is not None and tuple(channels) != ALONE:
        values = fields.load(path, "summary")[1]
    form = values.get("format") if isinstance(values, dict) else None
    if path is not None and isinstance(form, str) and form.endswith("-set"):
        return read_files(path, "summary", channels)
    return dict.fromkeys(channels, path)


def paths_of(output: str, channels: Collection[str]) -> dict[str, str]:
    """Return one name a channel: ``drive.arb`` becomes ``drive_x.arb`` (UsageError: it is ``-``)."""
    if tuple(channels) == ALONE:
        return {"": output}
    if output == "-":
        raise UsageError("`output` -: this format has a file a channel: give a name")
    stem, ending = os.path.splitext(output)
    return {name: f"{stem}_{name}{ending}" for name in channels}


def read_files(path: str, kind: str, channels: Iterable[str]) -> dict[str, Any]:
    """Return the values of each channel's file, of a set of them.

    Raises
    ------
    InputError
        The file cannot be read.
    ModelError
        It is no such set, or lacks a channel.
    """
    key = plural(kind)
    name, values = fields.load(path, kind)
    try:
        content = fields.contents(values, "", f"dbo-{kind}-set", f"a set of {key}")
        read = {key: fields.notes}
        members: dict[str, Any] = fields.build(dict, content, "", **read)[key]
        for channel in channels:
            if channel not in members:
                raise ModelError(f'{key}: has no channel "{channel}"')
    except ModelError as problem:
        raise ModelError(f"{name}: {problem}") from None
    return members


def states_of(state: str, models: Mapping[str, Cascade]) -> dict[str, State | str]:
    """Return what was before the first row of each channel: the name of a start, or a state of a set."""
    if state in START_NAMES:
        return dict.fromkeys(models, state)
    if tuple(models) == ALONE:
        return {"": read_state(state, models[""])}
    members = read_files(state, "state", models)
    states: dict[str, State | str] = {}
    for name, model in models.items():
        states[name] = parse_state(members[name], model, f"{state}: {name}")
    return states


def histories_of(path: str | None, channels: Sequence[str]) -> dict[str, Any]:
    """Return the passes so far of each channel; none where there is no file yet."""
    from dbo_cli.drive.learning import parse_history, read_history

    if path is None or not os.path.exists(path):
        return dict.fromkeys(channels, ())
    if tuple(channels) == ALONE:
        return {"": read_history(path)}
    members = read_files(path, "history", channels)
    return {name: parse_history(members[name], f"{path}: {name}") for name in channels}


def columns_of_run(name: str, model: Cascade, rows: Rows) -> list[Result]:
    """Return input and output of a channel's model as columns."""
    into, out = model.input, model.output
    return [
        (f"{into.quantity}_{name}", into.unit, rows.x),
        (f"{out.quantity}_{name}", out.unit, rows.y),
    ]


def columns_of_drives(drives: Mapping[str, Drive], time: Floats | None) -> list[Result]:
    """Return the table of drives: the time, then displacement and voltage of each channel."""
    results: list[Result] = [] if time is None else [("time", "s", time)]
    for name, drive in drives.items():
        output, into = drive.model.output, drive.model.input
        results.append((f"desired_{name}", output.unit, drive.desired))
        results.append((f"{into.quantity}_{name}", into.unit, drive.voltage))
    return results
