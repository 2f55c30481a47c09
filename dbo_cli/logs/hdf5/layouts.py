"""How programs arrange a table in HDF5: NeXus, Bluesky, LabOne, MATLAB, and plain groups of datasets."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np

from dbo_cli.logs.column_table import ColumnSource
from dbo_cli.logs.foreign_text import clean_text
from dbo_cli.logs.hdf5.columns import (
    attribute,
    attribute_text,
    columns_of,
    is_dataset,
    is_group,
    with_unit_fields,
)
from dbo_cli.logs.hdf5.pandas_tables import pandas_columns
from dbo_cli.logs.stated_clock import is_clock_name

_DEEPEST = 8  # levels looked through for a table; LabOne's is the deepest known (/000/dev/demods/0/sample)
_VALUES = ("value", "values", "data", "average_value")
_TIMES = ("time", "timestamp", "timestamps", "EPOCH")
_BESIDE = ("raw_value", "chunk", "status", "severity", "alarm_status", "alarm_severity", "connection_status")
_SAME_STAMPS = 1e-9  # of the stamp: what is left of one clock written twice, in seconds since 1970


def columns_in(group: Any) -> list[ColumnSource]:
    """List the columns of one group, whoever arranged it; scalars (a sample rate, a remark) are none."""
    return pandas_columns(group) or _plain_columns(group) or _logged_columns(group)


def tables_below(group: Any) -> list[tuple[Any, list[ColumnSource]]]:
    """Find the groups that hold columns, at the shallowest level below ``group`` that has any.

    Where NeXus says which group is meant (``default``, or a single NXdata), that is the only one.
    """
    chosen = _default_data(group)
    if chosen is not None:
        return [(chosen, columns_in(chosen))]
    level, seen = [group], {group.id}
    for _ in range(_DEEPEST):
        level = [child for node in level for child in _inner_groups(node) if child.id not in seen]
        level = list({child.id: child for child in level}.values())
        seen |= {child.id for child in level}
        found = [(child, columns) for child in level if (columns := columns_in(child))]
        if found or not level:
            return found
    return []


def _inner_groups(group: Any) -> list[Any]:
    """List the groups in a group; links that lead nowhere and programs' own book-keeping are left out."""
    names = [
        name for name in group if not name.startswith(("#", "_i_"))
    ]  # MATLAB's references, PyTables' indices
    return [node for node in (group.get(name) for name in names) if is_group(node)]


def _plain_columns(group: Any) -> list[ColumnSource]:
    sources: list[ColumnSource] = []
    for name in group:
        if name.startswith(("#", "_i_")):
            continue
        node = group.get(name)
        if is_dataset(node) and not (node.size == 1 and is_clock_name(clean_text(name))):
            sources += columns_of(node, clean_text(name))
    longest = max((source.length for source in sources), default=0)
    sources = [source for source in sources if source.length > 1 or longest <= 1]
    sources = with_unit_fields(group, sources)
    if attribute_text(group, "NX_class") in ("NXdata", "NXlog"):
        sources = _nexus_scaled(group, sources)
    return [_in_seconds(group, source) for source in sources]


# --- NeXus ----------------------------------------------------------------------------------------


def _default_data(group: Any) -> Any:
    """Follow NeXus to the group that is meant: ``default`` attributes, else the only entry's only NXdata."""
    node = group
    for _ in range(_DEEPEST):
        if attribute_text(node, "NX_class") == "NXdata":
            return node
        named = attribute_text(node, "default")
        target = node.get(named) if named else None
        if target is None:
            kinds = [child for child in _inner_groups(node) if attribute_text(child, "NX_class") == "NXentry"]
            kinds = kinds or [c for c in _inner_groups(node) if attribute_text(c, "NX_class") == "NXdata"]
            target = kinds[0] if len(kinds) == 1 else None
        if not is_group(target):
            return None
        node = target
    return None


def _nexus_scaled(group: Any, sources: list[ColumnSource]) -> list[ColumnSource]:
    """Apply NeXus' ``NAME_scaling_factor`` and ``NAME_offset`` fields: (value + offset) · factor."""
    helpers = {
        f"{source.label}{end}" for source in sources for end in ("_scaling_factor", "_offset", "_errors")
    }
    found = []
    for source in sources:
        if source.label in helpers:
            continue
        factor, offset = (
            _single(group.get(f"{source.label}{end}")) for end in ("_scaling_factor", "_offset")
        )
        if factor is not None or offset is not None:
            factor, offset = 1.0 if factor is None else factor, offset or 0.0
            source = replace(source, scale=factor, offset=offset * factor)
        found.append(source)
    signal = attribute_text(group, "signal")
    length = next((source.length for source in found if source.label == signal), None)
    return found if length is None else [source for source in found if source.length == length]


def _single(node: Any) -> float | None:
    if not is_dataset(node) or node.size != 1 or node.dtype.kind not in "fiu":
        return None
    return float(np.ravel(node[()])[0])


# --- one group per signal (Bluesky, NXlog, LabOne's plotter) --------------------------------------


def _logged_columns(group: Any) -> list[ColumnSource]:
    """Read groups that hold one signal each, its values beside their own time stamps."""
    values: list[ColumnSource] = []
    clocks: list[ColumnSource] = []
    for child in _inner_groups(group):
        held = {name: node for name in child if is_dataset(node := child.get(name)) and node.shape}
        value = next((name for name in _VALUES if name in held), None)
        time = next((name for name in _TIMES if name in held), None)
        own = clean_text(child.name.rsplit("/", 1)[-1])
        if value is None or _beside(held, held[value].shape[0]):
            continue
        found = columns_of(held[value], own)
        if len(found) != 1:
            continue
        values += found
        if time is not None:
            stamps = columns_of(held[time], f"{own}/{time}")
            unit = stamps[0].unit if stamps else None
            clocks += [_in_seconds(child, replace(one, unit=unit or _nexus_seconds(child))) for one in stamps]
    if not values or max(source.length for source in values) < 2:
        return []
    return (_one_clock(clocks) if len(clocks) == len(values) else clocks) + values


def _beside(held: dict[str, Any], length: int) -> bool:
    """Tell whether a group holds other columns beside one signal and its stamps: then it is a table."""
    known = (*_VALUES, *_TIMES, *_BESIDE)
    return any(name not in known and node.shape[0] == length for name, node in held.items())


def _nexus_seconds(child: Any) -> str | None:
    """Bluesky's NeXus writer documents its times in seconds, and its file says who wrote it."""
    return "s" if child.get("EPOCH") is not None else None


def _one_clock(clocks: list[ColumnSource]) -> list[ColumnSource]:
    """Put clocks that agree together into one; signals stamped each for itself keep their own."""
    first = clocks[0]
    for other in clocks[1:]:
        if (other.length, other.unit, other.scale) != (first.length, first.unit, first.scale):
            return clocks
        step = 1 << 16
        for start in range(0, first.length, step):
            stop = min(first.length, start + step)
            here, there = first.read(start, stop), other.read(start, stop)
            if not np.allclose(here, there, rtol=_SAME_STAMPS, atol=0.0):
                return clocks
    return [replace(first, label=first.label.rsplit("/", 1)[-1])]


def _in_seconds(group: Any, source: ColumnSource) -> ColumnSource:
    """Turn LabOne's time stamps, which count ticks of the instrument's clock, into seconds."""
    if source.label.rsplit("/", 1)[-1] != "timestamp" or source.unit:
        return source
    base = _clock_base(group)
    if base is not None:
        return replace(source, unit="s", scale=1.0 / base)
    device = any(re.fullmatch(r"dev\d+", part.lower()) for part in group.name.split("/"))
    return replace(source, unit="ticks") if device else source


def _clock_base(group: Any) -> float | None:
    """Look for LabOne's ``clockbase`` (ticks a second) beside the samples or anywhere above them."""
    node = group
    for _ in range(_DEEPEST):
        found = _single(node.get("clockbase"))
        if found is None:
            value = attribute(node, "clockbase")
            found = float(np.ravel(value)[0]) if isinstance(value, np.ndarray | np.number) else None
        if found is not None and found > 0.0:
            return found
        if node.name == "/":
            return None
        node = node.parent
    return None
