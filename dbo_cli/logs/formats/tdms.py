"""TDMS files of LabVIEW: channels of numbers, read in blocks by nptdms."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from dbo_cli.logs.fence import closed_on_error, fenced, import_extra, quiet
from dbo_cli.logs.table import Reading, Table, column_of, rows_of


def read_tdms(path: str, inner: str, reading: Reading) -> Table:
    """Read a TDMS file, or one group of it (``FILE::GROUP``) (InputError)."""
    nptdms = import_extra("nptdms", "tdms", path)
    stream = open(path, "rb")
    table = Table(path, stream.close)
    with closed_on_error(stream.close), fenced(path, "TDMS"), quiet():
        file = nptdms.TdmsFile.open(stream)
        groups = [group for group in file.groups() if inner in ("", group.name)]
        _add_channels(table, groups)
        table.require_numbers(f"::{group.name}" for group in file.groups())
    if file.file_status.incomplete_final_segment:
        table.doubt = "the file ends within a segment: was the record cut there?"
    if len(groups) > 1:
        table.hint = f" (or one group alone: {path}::{groups[0].name})"
    return table


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
