"""TDMS files of LabVIEW: channels of numbers, read in blocks by nptdms."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from dbo_cli.logs.fence import fenced, import_extra, quiet
from dbo_cli.logs.table import Reading, Table, column_of, rows_of

_LEAD_IN = 28
"""Bytes: mark, contents, version, bytes to the next segment, bytes to the data."""


def read_tdms(path: str, inner: str, reading: Reading) -> Table:
    """Read a TDMS file, or one group of it (``FILE::GROUP``) (InputError)."""
    nptdms = import_extra("nptdms", "tdms", path)
    stream = open(path, "rb")
    table = Table(path, stream.close)
    try:
        with fenced(path, "TDMS"), quiet():
            file = nptdms.TdmsFile.open(stream)
            groups = [group for group in file.groups() if inner in ("", group.name)]
            _add_channels(table, groups)
            table.require_numbers(f"::{group.name}" for group in file.groups())
    except BaseException:
        stream.close()
        raise
    if _is_cut(path):
        table.doubt = "the file ends within a segment: was the record cut there?"
    if len(groups) > 1:
        table.hint = f" (or one group alone: {path}::{groups[0].name})"
    return table


def _is_cut(path: str) -> bool:
    """Return whether the last segment is shorter than its lead-in says, or was not completed."""
    size, position = os.path.getsize(path), 0
    with open(path, "rb") as file:
        while position < size:
            file.seek(position)
            lead_in = file.read(_LEAD_IN)
            position += _LEAD_IN + int.from_bytes(lead_in[12:20], "little")
    return position > size


def _add_channels(table: Table, groups: Sequence[Any]) -> None:
    """Add the channels of numbers, and what they state of their rate."""
    for group in groups:
        for channel in group.channels():
            if not len(channel) or channel.dtype.kind not in "fiuM":
                continue
            properties = channel.properties
            unit = properties.get("unit_string") or properties.get("NI_UnitDescription")
            name = channel.name if len(groups) == 1 else f"{group.name}/{channel.name}"
            column = column_of(name, channel.dtype, len(channel), rows_of(channel))
            table.add(replace(column, unit=unit))
            _state_clock(table, properties)


def _state_clock(table: Table, properties: Any) -> None:
    """Note what the properties of a channel state of its clock; a spectrum has none."""
    if str(properties.get("wf_xname") or "Time").lower() != "time":
        return
    for key in ("wf_increment", "wf_start_offset", "wf_start_time"):
        value = properties.get(key)
        if isinstance(value, np.datetime64):
            value = value.astype("datetime64[us]").astype(int) / 1e6
        if value is not None:
            table.state(key, value, "s")
