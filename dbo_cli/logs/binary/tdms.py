"""LabVIEW's TDMS files as a table of columns, read in blocks with npTDMS."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from typing import Any

from dbo_cli.errors import InputError
from dbo_cli.logs.byte_source import Request
from dbo_cli.logs.column_table import ColumnSource, ColumnTable, array_source
from dbo_cli.logs.libraries import import_extra
from dbo_cli.logs.plain_text import clean_text
from dbo_cli.logs.stated_clock import Statement, read_statements


def open_tdms(request: Request) -> ColumnTable:
    """Open a TDMS file; the channels of several groups are called ``group/channel``.

    Raises
    ------
    InputError
        npTDMS is not installed, the file is damaged, or holds no channels of numbers.
    """
    nptdms = import_extra("nptdms", request.place)
    with contextlib.ExitStack() as opened:
        # A stream of its own: npTDMS leaves a damaged file open.
        stream = opened.enter_context(open(request.address.path, "rb"))
        with request.reading("TDMS"):  # npTDMS raises whatever the damaged bytes lead to
            file = nptdms.TdmsFile.open(stream)
        groups = _groups(request, file)
        channels = [(group, one) for group in groups for one in group.channels()]
        numeric = [(group, one) for group, one in channels if len(one) > 0 and one.dtype.kind in "fiubM"]
        several = len({group.name for group, _ in numeric}) > 1
        sources = [_column(group, channel, several) for group, channel in numeric]
        if not sources:
            listed = ", ".join(f"{group.name}/{one.name}" for group, one in channels) or "nothing"
            raise InputError(f"{request.place}: no channels of numbers: it holds {listed}")
        levels = [*(groups if len(groups) == 1 else ()), file]
        clock = next((found for level in levels if (found := _statements(level))), [])
        close = opened.pop_all().close
    return ColumnTable(request, "TDMS", sources, clock=clock, at_close=close, damaged=(Exception,))


def _groups(request: Request, file: Any) -> list[Any]:
    groups = list(file.groups())
    wanted = (request.address.group or "").strip("/")
    if not wanted:
        return groups
    found = [group for group in groups if group.name == wanted]
    if not found:
        names = ", ".join(f"'{group.name}'" for group in groups) or "none"
        raise InputError(f"{request.place}: there is no group '{wanted}': the groups are: {names}")
    return found


def _column(group: Any, channel: Any, several: bool) -> ColumnSource:
    name = clean_text(channel.name)
    label = f"{clean_text(group.name)}/{name}" if several else name
    properties = channel.properties
    unit = clean_text(properties.get("unit_string") or properties.get("NI_UnitDescription") or "") or None
    if channel.dtype.kind == "M":
        stamps = channel[:]
        return array_source(label, (stamps - stamps[0]).astype("timedelta64[us]").astype("int64") / 1e6, "s")
    source = ColumnSource(label, len(channel), lambda start, stop: channel[start:stop], unit)
    offset = properties.get("wf_start_offset", 0.0)  # LabVIEW defines it in seconds
    offset = float(offset) if isinstance(offset, int | float) else 0.0
    return replace(source, clock=tuple(_statements(channel)), start=offset)


def _statements(node: Any) -> list[Statement]:
    properties = node.properties
    if clean_text(properties.get("wf_xname") or "Time").strip().lower() not in ("time", "zeit", "temps", ""):
        return []  # a spectrum: its increment is no time
    found = []
    for name, value in properties.items():
        own = name == "wf_increment"  # LabVIEW defines it in seconds
        unit = properties.get("wf_xunit_string" if own else f"{name}_unit")
        found += read_statements(name, value, unit or None, sure=own)
    return found
