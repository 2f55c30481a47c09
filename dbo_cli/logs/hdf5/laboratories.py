"""HDF5 as programs for experiments arrange it: PyMoDAQ's tree of data and axes, Labber's channels and traces.

Written after the files that ``pymodaq_data`` writes, and after public readers of Labber's log files.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from dbo_cli.errors import InputError
from dbo_cli.logs.column_table import ColumnSource, array_source, without_scalars
from dbo_cli.logs.hdf5.columns import attribute_text, columns_of, is_dataset, is_group
from dbo_cli.logs.plain_text import clean_text
from dbo_cli.logs.stated_clock import Statement

_SIGNALS = ("axis", "data", "data_enlargeable")  # what PyMoDAQ calls arrays, beside logs and errors
_DEEPEST = 8  # levels of PyMoDAQ's tree, which has six: RawData/Scan000/Detector000/Data0D/CH00/EnlData00


def laboratory_columns(group: Any) -> list[ColumnSource]:
    """List the columns of a group of PyMoDAQ's, or of Labber's file; none of any other."""
    if all(name in group for name in ("Channels", "Log list", "Data")):
        traces = list(_labber_traces(group))
        return traces or list(_labber_steps(group))
    return without_scalars(list(_pymodaq(group))) if "pymodaq_version" in group.file.attrs else []


def _pymodaq(group: Any, depth: int = 0) -> Iterator[ColumnSource]:
    """Put all data and axes below a group side by side, under their labels.

    Raises
    ------
    InputError
        There are several scans.
    """
    scans = [str(name) for name in group if re.fullmatch(r"Scan\d+", str(name))]
    if len(scans) > 1:
        path = f"{clean_text(group.file.filename)}::{clean_text(group.name).rstrip('/')}/{scans[0]}"
        raise InputError(f"{path.partition('::')[0]}: {len(scans)} scans: which one? (write {path})")
    for name in group:
        node = group.get(name)
        if is_group(node) and depth < _DEEPEST:
            yield from _pymodaq(node, depth + 1)
        elif is_dataset(node) and _stated(node, "data_type") in _SIGNALS:
            for source in columns_of(node, _stated(node, "label") or clean_text(name)):
                yield replace(source, unit=_stated(node, "units") or None)


def _stated(node: Any, name: str) -> str:
    """Read a text attribute, also as a newer PyMoDAQ writes it: JSON with the text quoted as in Python."""
    text = attribute_text(node, name)
    try:
        return str(json.loads(text)["data"]).strip("'\"")
    except (ValueError, TypeError, KeyError):
        return text


def _labber_units(group: Any) -> dict[str, str]:
    rows = group["Channels"][()]
    return {clean_text(row["name"]): clean_text(row["unitPhys"]) for row in rows}


def _labber_steps(group: Any) -> Iterator[ColumnSource]:
    """Read values by step: points, channels, entries; the entries follow each other."""
    units, data = _labber_units(group), group["Data/Data"][()]
    for index, row in enumerate(group["Data/Channel names"][()]):
        name = clean_text(row["name"])
        if not clean_text(row["info"]):  # else a part of a complex number
            yield array_source(name, data[:, index, :].T.ravel(), units.get(name) or None)


def _labber_traces(group: Any) -> Iterator[ColumnSource]:
    """Read the traces of a log with one entry: values, and ``NAME_t0dt`` with the step along them."""
    units, traces = _labber_units(group), group.get("Traces", {})
    for name in (name for name in traces if f"{name}_t0dt" in traces):
        values = np.asarray(traces[name][()])
        if values.ndim == 3 and values.shape[1:] == (1, 1):
            start, step = (float(one) for one in np.ravel(traces[f"{name}_t0dt"][()])[:2])
            timed = attribute_text(traces[name], "x_unit") in ("s", "") and step > 0.0
            clock = (Statement(f"'{name}_t0dt' {step:g} s", 1.0 / step),) if timed else ()
            unit = units.get(clean_text(name)) or None
            yield ColumnSource(clean_text(name), len(values), _rows(values), unit, clock=clock, start=start)


def _rows(values: Any) -> Any:
    return lambda start, stop: values[start:stop, 0, 0]
