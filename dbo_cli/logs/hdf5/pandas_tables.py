"""What ``DataFrame.to_hdf`` writes (through PyTables): tables, with data columns or not, and blocks."""

from __future__ import annotations

import io
import pickle
import re
from dataclasses import replace
from typing import Any

import numpy as np

from dbo_cli.logs.column_table import ColumnSource
from dbo_cli.logs.foreign_text import clean_text
from dbo_cli.logs.hdf5.columns import attribute, attribute_text, columns_of, field_slicer, is_dataset


def pandas_columns(group: Any) -> list[ColumnSource]:
    """Read what ``DataFrame.to_hdf`` writes, in either of its formats."""
    kind = attribute_text(group, "pandas_type")
    if kind in ("frame_table", "appendable_frame", "series_table") and is_dataset(group.get("table")):
        return _pandas_table(group, group["table"])
    if kind == "frame" and is_dataset(group.get("axis1")):
        return _pandas_blocks(group)
    if kind == "series" and is_dataset(group.get("values")):
        return [
            *_index(group.get("index")),
            *columns_of(group["values"], attribute_text(group, "name") or "values"),
        ]
    return []


def _pandas_table(group: Any, table: Any) -> list[ColumnSource]:
    sources: list[ColumnSource] = []
    length = table.shape[0]
    info = _harmless(attribute(group, "info"))
    for field in table.dtype.names:
        kind = table.dtype[field]
        named = [clean_text(name) for name in _harmless(attribute(table, f"{field}_kind")) or ()]
        if field == "index":
            name = info.get("index", {}).get("index_name") if isinstance(info, dict) else None
            source = ColumnSource(clean_text(name or ""), length, field_slicer(table, field))
            sources += _as_index(source, attribute_text(table, "index_kind"))
        elif kind.subdtype is not None and len(kind.shape) == 1 and kind.base.kind in "fiub":
            names = (
                named if len(named) == kind.shape[0] else [f"{field}[{n + 1}]" for n in range(kind.shape[0])]
            )
            stamped = attribute_text(table, f"{field}_dtype")
            for index, name in enumerate(names):
                source = ColumnSource(name, length, field_slicer(table, field, index))
                sources.append(_from_stamps(source, stamped) or source)
        elif kind.kind in "fiub":
            source = ColumnSource(clean_text(field), length, field_slicer(table, field))
            sources.append(_from_stamps(source, attribute_text(table, f"{field}_dtype")) or source)
    return sources


def _pandas_blocks(group: Any) -> list[ColumnSource]:
    sources = _index(group["axis1"])
    order = (
        [clean_text(name) for name in group["axis0"][()].ravel()] if is_dataset(group.get("axis0")) else []
    )
    found: dict[str, ColumnSource] = {}
    for number in range(int(np.ravel(attribute(group, "nblocks"))[0])):
        values, items = group.get(f"block{number}_values"), group.get(f"block{number}_items")
        if not (
            is_dataset(values)
            and is_dataset(items)
            and len(values.shape) == 2
            and values.dtype.kind in "fiub"
        ):
            continue
        for index, name in enumerate(map(clean_text, items[()].ravel())):
            source = ColumnSource(name, values.shape[0], _column_slicer(values, index))
            found[name] = _from_stamps(source, attribute_text(values, "value_type")) or source
    return sources + [found[name] for name in order if name in found]


def _column_slicer(values: Any, index: int) -> Any:
    return lambda start, stop: values[start:stop, index]


def _index(axis: Any) -> list[ColumnSource]:
    if not is_dataset(axis) or axis.dtype.kind not in "fiu" or len(axis.shape) != 1:
        return []
    name = attribute_text(axis, "name")
    source = ColumnSource("" if name in ("N.", "") else _unpickled_text(name), axis.shape[0],
                          lambda start, stop: axis[start:stop])  # fmt: skip
    return _as_index(source, attribute_text(axis, "kind"))


def _as_index(source: ColumnSource, kind: str) -> list[ColumnSource]:
    """Keep an index that says something: a name, stamps of time, fractions; not pandas' own row numbers."""
    stamped = _from_stamps(source, kind)
    if stamped is not None:
        return [replace(stamped, label=source.label or "time")]
    if source.label or kind == "float":
        return [replace(source, label=source.label or "index")]
    return []


def _from_stamps(source: ColumnSource, kind: str) -> ColumnSource | None:
    """Turn dates (and durations) stored as counts into seconds from the first row on."""
    found = re.fullmatch(r"(?:datetime|timedelta)64(?:\[(s|ms|us|ns)(?:,.*)?\])?", kind)
    if found is None or not source.length:
        return None
    per_second = {"s": 1, "ms": 1000, "us": 10**6, "ns": 10**9}[found[1] or "ns"]
    first = np.asarray(source.fetch(0, 1), dtype=np.int64)[0]

    def fetch(start: int, stop: int) -> Any:
        return (np.asarray(source.fetch(start, stop), dtype=np.int64) - first) / per_second

    return replace(source, fetch=fetch, unit="s")


class _NoCode(pickle.Unpickler):
    """Reads pickled lists, tuples, dicts, texts and numbers; anything that would run code is refused."""

    def find_class(self, module: str, name: str) -> Any:
        raise pickle.UnpicklingError(f"{module}.{name}")


def _harmless(value: Any) -> Any:
    """Read the column names that PyTables pickles into attributes, without ever running what is in them."""
    if value is None or not isinstance(value, bytes | np.bytes_):
        return None
    try:
        return _NoCode(io.BytesIO(bytes(value))).load()
    except Exception:
        return None  # whatever is no plain list of names: the columns then go by numbers


def _unpickled_text(name: str) -> str:
    plain = _harmless(name.encode())
    return (
        clean_text(plain) if isinstance(plain, str) else "" if plain is None and name.endswith(".") else name
    )
