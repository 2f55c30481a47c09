"""Many channels of one log: ``{}`` in the names of columns stands for a channel's name.

``--voltage 'V{}' --displacement 'D{}'`` takes the columns V1 and D1, V2 and D2, and so
on. Each channel has a model of its own; a model set is one file of them. Channels are
worked on one after the other, in memory; their results stand side by side in one table,
and what belongs to a channel (state, summary, history) in one file of all. A log
without patterns is one channel whose name is empty: it has the plain files.
"""

import json
import os
import re
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from dbo_cli import errors
from dbo_cli.drive import Drive, Driver, voltage_in
from dbo_cli.drive.drive import PassRecord
from dbo_cli.errors import InputError, LimitError, ModelError, UsageError, warn
from dbo_cli.files import Outputs
from dbo_cli.logs import Log, Reading, add_table, open_table
from dbo_cli.logs.columns import fitting, listing_of
from dbo_cli.logs.write import Attributes, Named, Writer
from dbo_cli.model import Cascade, State, dumps_state, fields, member, read_cascades
from dbo_cli.model.file import parse_state
from dbo_cli.model.state import START_NAMES
from dbo_cli.units import split_header

PLACE = "{}"
ALONE = ("",)
"""The channels of a log whose columns are no patterns."""
MOST_TRIES = 20  # to make channels equally long; what creeps meanwhile may change a row
LIMIT_SLACK = 0.1
"""Of a channel's range: so far beyond it a limit is only that of the channel whose name it has."""


def columns_for(columns: Mapping[str, str | None], name: str) -> dict[str, str | None]:
    """Return the columns of one channel."""
    return {
        role: pattern and pattern.replace(PLACE, name)
        for role, pattern in columns.items()
    }


def columns_of(
    paths: Sequence[str], reading: Reading, columns: Mapping[str, str | None]
) -> dict[str, dict[str, str | None]]:
    """Return the columns of each channel that patterns find in a log, in its order; else of ``ALONE``.

    Raises
    ------
    InputError
        A pattern finds no column, or two patterns find different channels.
    UsageError
        The log is a stream, which cannot be read once for every channel.
    """
    if not any(
        pattern is not None and PLACE in pattern for pattern in columns.values()
    ):
        return {"": dict(columns)}
    path = paths[0]
    if path == "-":
        raise UsageError("-: channels need a file, not a pipe")
    with open_table(path, reading) as source:
        table, paths = source.columns, source.paths
    found: dict[str, list[str]] = {}
    for role, pattern in columns.items():
        if pattern is not None and PLACE in pattern:
            of_role = fitting(table, role) if pattern == PLACE else table
            names = [column.name for column in of_role]
            found[role] = _matches(pattern, names) or _matches(pattern, paths)
    channels = next(iter(found.values()))
    if not channels or any(set(names) != set(channels) for names in found.values()):
        lists = []
        for role, names in found.items():
            lists.append(f"`{role}` {columns[role]} finds {', '.join(names) or 'none'}")
        options = " ".join(f"`{role}` COLUMN" for role in found)
        raise InputError(
            f"{path}: {'; '.join(lists)}: the names must be the same, capitals too: rename headers, or type "
            f"{options} of one channel; {listing_of(table)}"
        )
    return {name: columns_for(columns, name) for name in channels}


def _matches(pattern: str, names: Sequence[str]) -> list[str]:
    """Return what stands in the place of ``{}`` in names that fit, with or without their unit."""
    before, _, after = pattern.lstrip("/").partition(PLACE)
    fit = re.compile(re.escape(before) + "([^/]+)" + re.escape(after))
    channels = []
    for name in names:
        match = fit.fullmatch(split_header(name)[0]) or fit.fullmatch(name)
        if match is not None:
            channels.append(match[1])
    return channels


def models_of(
    path: str, channels: Collection[str], columns: Mapping[str, str | None]
) -> dict[str, Cascade]:
    """Return the model of each channel: of a set, or one that serves all.

    Raises
    ------
    ModelError
        A file is no model, or a set that lacks one; the message names the columns that
        are patterns, or could be.
    """
    models = read_cascades(path)
    roles = [f"`{role}` COLUMN" for role, name in columns.items() if name]
    hint = f" with {' '.join(roles)}"
    if tuple(channels) == ALONE:
        role = next(role for role in columns if role != "time")
        hint = f", or `{role}` '{{}}' for all of it"
    return {channel: member(models, path, channel, hint) for channel in channels}


# --- what is typed for a channel, or for all ---


def values_for(
    texts: Mapping[str, Sequence[str] | None], channels: Iterable[str]
) -> dict[str, dict[str, str | None]]:
    """Return what was typed for each channel, by option: ``x=120V`` for one of them, ``120V`` for all.

    Raises
    ------
    UsageError
        A value is of no channel, or two values are of one.
    """
    values: dict[str, dict[str, str | None]] = {channel: {} for channel in channels}
    for option, texts_of_option in texts.items():
        by_owner: dict[str, str] = {}
        for text in texts_of_option or ():
            owner, mark, value = text.rpartition("=")
            is_unknown = mark and (not owner or owner not in values)
            if is_unknown or owner in by_owner:
                names = ", ".join(values) or "this is no set of channels"
                raise UsageError(
                    f"`{option}` {text}: type VALUE once, or CHANNEL=VALUE once a channel: {names}"
                )
            by_owner[owner] = value
        for channel, own in values.items():
            own[option] = by_owner.get(channel, by_owner.get(""))
    return values


def require_own_limit(
    name: str, texts: Sequence[str] | None, channel: str, model: Cascade
) -> None:
    """Refuse a limit for all channels that is far beyond the range of one of them (UsageError)."""
    common = [text for text in texts or () if "=" not in text]
    if not channel or not common or any(f"{channel}=" in text for text in texts or ()):
        return
    drive = model.input
    value = voltage_in(name, common[0], drive)
    slack = LIMIT_SLACK * drive.span
    if value is None or drive.min - slack <= value <= drive.max + slack:
        return
    raise UsageError(
        f"`{name}` {value:g}{drive.suffix} is beyond channel {channel}, {drive.min:.6g} to {drive.max:.6g}"
        f"{drive.suffix}: type `{name}` {channel}=VOLT"
    )


# --- tables and drives of all channels ---


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
        warnings.simplefilter("ignore", errors.DboWarning)
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
    """Name the channel, if it has a name, in an error and in warnings."""
    if not channel:
        yield
        return
    name, caught = f"channel {channel}", []
    try:
        with warnings.catch_warnings(record=True) as caught, errors.prefixed(name):
            warnings.simplefilter("always", errors.DboWarning)
            yield
    finally:
        for entry in caught:
            if entry.category is errors.DboWarning:
                warn(f"{name}: {entry.message}")


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


def paths_of(output: str, channels: Collection[str]) -> dict[str, str]:
    """Return one name a channel: ``drive.arb`` becomes ``drive_x.arb`` (UsageError: it is ``-``)."""
    if tuple(channels) == ALONE:
        return {"": output}
    if output == "-":
        raise UsageError("`output` -: this format has a file a channel: give a name")
    stem, ending = os.path.splitext(output)
    return {name: f"{stem}_{name}{ending}" for name in channels}


def members_of(
    path: str, kind: str, channels: Collection[str]
) -> dict[str, tuple[str, Any]]:
    """Return what messages call the file of each channel, and its values; of channels, the file is a set.

    Raises
    ------
    InputError
        The file cannot be read.
    ModelError
        It is no such set, or lacks a channel.
    """
    name, values = fields.load(path, kind)
    if tuple(channels) == ALONE:
        return {"": (name, values)}
    key = plural(kind)
    with errors.prefixed(name):
        members = fields.members(values, f"dbo-{kind}-set", key, f"a set of {key}")
        for channel in channels:
            if channel not in members:
                raise ModelError(f'{key}: has no channel "{channel}"')
    return {channel: (f"{name}: {channel}", members[channel]) for channel in channels}


def states_of(state: str, models: Mapping[str, Cascade]) -> dict[str, State | str]:
    """Return what was before the first row of each channel: the name of a start, or a state of a set."""
    if state in START_NAMES:
        return dict.fromkeys(models, state)
    states: dict[str, State | str] = {}
    for name, (label, values) in members_of(state, "state", models).items():
        states[name] = parse_state(values, models[name], label)
    return states


def histories_of(
    path: str | None, channels: Collection[str] = ALONE
) -> dict[str, Sequence[PassRecord]]:
    """Return the passes so far of each channel; none where there is no file yet."""
    if path is None or not os.path.exists(path):
        return dict.fromkeys(channels, ())
    from dbo_cli.drive.learning import parse_history

    histories: dict[str, Sequence[PassRecord]] = {}
    for name, (label, values) in members_of(path, "history", channels).items():
        histories[name] = parse_history(values, label)
    return histories


# --- tables of all channels ---


def require_same_rows(logs: Mapping[str, Log]) -> None:
    """Refuse channels of which other rows are left out: side by side, rows would not be of one time.

    Raises
    ------
    InputError
        A row holds numbers for one channel alone.
    """
    (first, log), *others = logs.items()
    for name, other in others:
        apart = set(log.left_out) ^ set(other.left_out)
        if apart:
            row = min(apart)
            raise InputError(
                f"{log.name}: row {row} is left out in one of the channels {first} and {name}, not in both: "
                f"mend it, or cut with `rows` :{row - 1}"
            )


def named_columns(
    pairs: Mapping[str, Sequence[Named]], is_clocked: bool
) -> list[Named]:
    """Return names and units of the columns of channels: the time, then those of each channel."""
    columns: list[Named] = [("time", "s")] if is_clocked else []
    for channel, pair in pairs.items():
        ending = f"_{channel}" if channel else ""
        columns += [(name + ending, unit) for name, unit in pair]
    return columns


def drive_table(
    outputs: Outputs,
    output: str,
    drives: Mapping[str, Drive] | Mapping[str, Driver],
    is_clocked: bool,
) -> Writer:
    """Return what writes drives side by side; an HDF5 file states the models and limits."""
    pairs, digests, limits = {}, {}, {}
    for name, drive in drives.items():
        into, out = drive.model.input, drive.model.output
        pairs[name] = [("desired", out.unit), (into.quantity, into.unit)]
        digests[name], limits[name] = drive.model.digest, drive.limits.as_dict()
    origin: Attributes = {"model": json.dumps(digests), "limits": json.dumps(limits)}
    if tuple(drives) == ALONE:
        origin = {"model": digests[""], "limits": json.dumps(limits[""])}
    return add_table(outputs, output, named_columns(pairs, is_clocked), origin)


def write_drives(outputs: Outputs, output: str, drives: Mapping[str, Drive]) -> None:
    """Write drives side by side: the time, then displacement and voltage of each channel."""
    time = next(iter(drives.values())).time
    values = [] if time is None else [time]
    for drive in drives.values():
        values += [drive.desired, drive.voltage]
    drive_table(outputs, output, drives, time is not None).write(*values)


def write_summaries(
    outputs: Outputs,
    drives: Mapping[str, Drive],
    logs: Mapping[str, Log],
    paths: Mapping[str, str | None],
) -> None:
    """Write the summary, state and history of drives, as far as there are ``paths`` for them."""
    if not any(paths.values()):
        return
    from dbo_cli.drive.learning import dumps_history

    texts: dict[str, dict[str, str]] = {kind: {} for kind in paths}
    for name, drive in drives.items():
        figures = {**drive.summary(), "trajectory": logs[name].name}
        assert drive.state is not None
        texts["summary"][name] = json.dumps(figures, indent=2) + "\n"
        texts["state"][name] = dumps_state(drive.state, drive.model)
        texts["history"][name] = dumps_history(drive.history)
    for kind, path in paths.items():
        if path is not None:
            outputs.write_text(path, dumps_files(kind, texts[kind]), kind)
