"""HDF5 logs: 1-D datasets, columns of 2-D ones, fields of compound ones, units as attributes.

A log is one file: what leads elsewhere (links, virtual datasets, external storage) is
passed over, and refused where it is typed. MATLAB's files of version 7.3 and netCDF-4 are HDF5, too.
"""

import posixpath
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import h5py
import numpy as np

from dbo_cli.errors import InputError
from dbo_cli.logs.fence import closed_on_error, fenced
from dbo_cli.logs.settings import plain_key
from dbo_cli.logs.table import Column, Fetch, Reading, Table, columns_in

# bytes a dataset: a compressed chunk is unpacked once, not once a block
_CHUNK_CACHE = 1 << 22
_LISTED = 9  # datasets that a message names at most
_NOT_APPLIED = {
    "scalefactor": 1.0, "addoffset": 0.0, "scale": 1.0, "offset": 0.0, "gain": 1.0, "factor": 1.0,
    "slope": 1.0, "intercept": 0.0, "sensitivity": 1.0, "calibration": 1.0, "conversion": 1.0,
    "scalingfactor": 1.0, "yinc": 1.0,
}  # fmt: skip
"""Attributes that may belong to a dataset's values, by their plain keys, and what changes nothing."""
_MATLAB_NUMBERS = ("double", "single", "int8", "int16", "int32", "int64", "uint8", "uint16",
                  "uint32", "uint64")  # fmt: skip

Nodes = dict[str, Any]
"""Groups and datasets by their paths; the file is that of no path."""


def read_hdf5(path: str, inner: str, reading: Reading) -> Table:
    """Read an HDF5 log; ``inner`` is a group or a dataset, by its path.

    Without it, the columns are those of the shallowest groups that have any.

    Raises
    ------
    InputError
        It is damaged, has no such part, or holds no columns of numbers.
    """
    with fenced(path, "HDF5"):
        file = h5py.File(path, "r", rdcc_nbytes=_CHUNK_CACHE)
    with closed_on_error(file.close), fenced(path, "HDF5"):
        return _table_of(path, inner.strip("/"), file)


def _table_of(path: str, inner: str, file: Any) -> Table:
    """Return the columns of a part of an open file; all other datasets are found by their paths."""
    table, nodes = Table(path, file.close), _nodes_of(file)
    if inner not in nodes:
        raise InputError(
            f"{path}::{inner}: no such part, or a link; the file has {_listing(nodes)}"
        )
    by_group: dict[str, list[Column]] = {}
    for name, node in nodes.items():
        if inner in ("", name) or name.startswith(f"{inner}/"):
            is_single = getattr(node, "size", 0) == 1 and name != inner
            columns = [] if is_single else _columns_of(name, node)
            by_group.setdefault(posixpath.dirname(name), []).extend(columns)
    groups = _shallowest(by_group)
    columns = [column for group in groups for column in by_group[group]]
    parents = [posixpath.dirname(column.name) for column in columns]
    top = posixpath.commonpath(parents) if parents else ""
    for column in columns:
        table.add(replace(column, name=column.name[len(top) :].lstrip("/")))
    table.require_numbers([_listing(nodes)])
    if len(groups) > 1:
        table.hint = f" (or one group alone: {path}::{groups[0]})"

    def find(name: str) -> Column | None:
        """Return the column that a path names, from the part that is open or from the top."""
        for start in (f"{inner}/{name}", name):
            columns = _columns_of(start.strip("/"), nodes.get(start.strip("/")))
            if len(columns) == 1:
                return table.add(replace(columns[0], name=name))
        return None

    table.find = find
    table.paths = [name for name in nodes if isinstance(nodes[name], h5py.Dataset)]
    return table


def _columns_of(path: str, dataset: Any) -> list[Column]:
    """Take a dataset apart into columns; none where it holds no numbers, or leads to other files."""
    if not isinstance(dataset, h5py.Dataset) or not dataset.size:
        return []
    if dataset.is_virtual or dataset.external:
        return []
    matlab = _texts(dataset, "MATLAB_class") or ["double"]
    if matlab[0] not in _MATLAB_NUMBERS or "MATLAB_empty" in dataset.attrs:
        return []
    group, _, name = path.rpartition("/")
    labels = _texts(dataset, "columns")
    columns = []
    stored = list(columns_in(name, dataset))
    units, doubt = _units_of(dataset, len(stored))
    for number, column in enumerate(stored):
        label = column.name
        if dataset.dtype.names is not None:
            label = f"{name}/{label}"
        elif len(labels) == len(stored) > 1:
            label = labels[number]
        fetch = _with_missing(dataset, column.fetch)
        label, unit = posixpath.join(group, label), units[number]
        columns.append(replace(column, name=label, unit=unit, fetch=fetch, doubt=doubt))
    return columns


def _units_of(dataset: Any, count: int) -> tuple[list[str], str]:
    """Return the units of so many columns of a dataset, and what is doubtful in these or in its values."""
    keys = [key for key in dataset.attrs if key.lower() in ("units", "unit")]
    unit_texts = [texts for texts in (_texts(dataset, key) for key in keys) if texts]
    units = unit_texts[0] if unit_texts else [""]
    if any(texts != units for texts in unit_texts) or len(units) not in (1, count):
        listing = ", ".join(text for texts in unit_texts for text in texts)
        doubt = f"has one of the units {listing}: type `scale` ROLE=1UNIT/UNIT"
        return [""] * count, doubt
    return units * (count // len(units)), _not_applied(dataset)


def _listing(nodes: Nodes) -> str:
    """Return the datasets of the file for a message."""
    names = []
    for name, node in nodes.items():
        if isinstance(node, h5py.Dataset):
            shape = "x".join(map(str, node.shape or ()))
            names.append(f"/{name} ({shape} {node.dtype})")
    return ", ".join(names[:_LISTED]) or "nothing"


def _nodes_of(file: Any) -> Nodes:
    """Return groups and datasets by their paths; links are not followed."""
    nodes = {"": file}

    def visit(name: str, node: Any) -> None:
        if not name.startswith("#"):  # MATLAB's own
            nodes[name] = node

    file.visititems(visit)
    return nodes


def _shallowest(by_group: Mapping[str, Sequence[Column]]) -> list[str]:
    """Return the shallowest groups with numbers; of several the only one with more than one such column."""
    by_depth: dict[int, dict[str, int]] = {}
    for group, columns in by_group.items():
        count = sum(column.kind == "number" for column in columns)
        if count:
            by_depth.setdefault(group.count("/") + bool(group), {})[group] = count
    numbers = by_depth[min(by_depth)] if by_depth else {}
    wide = [group for group in numbers if numbers[group] > 1]
    return wide if len(wide) == 1 else list(numbers)


def _with_missing(dataset: Any, fetch: Fetch) -> Fetch:
    """Return what fetches rows with NaN in the place of what stands for a missing number."""
    missing = _attribute(dataset, "_FillValue") + _attribute(dataset, "missing_value")
    missing = [value for value in missing if not isinstance(value, str)]
    missing += np.array(missing, np.float32).tolist()  # as a dataset may round it

    def fetch_numbers(start: int, stop: int) -> Any:
        rows = fetch(start, stop)
        return np.where(np.isin(rows, missing), np.nan, rows)

    return fetch_numbers if missing else fetch


def _not_applied(dataset: Any) -> str:
    """Say which factor or offset in or beside a dataset may belong to its values (Keysight, NeXus)."""
    factors = {key: _attribute(dataset, key) for key in dataset.attrs}
    factors["YInc"] = _attribute(dataset.parent, "YInc")
    reason = ""
    for key, values in factors.items():
        neutral = _NOT_APPLIED.get(plain_key(key))
        if neutral is not None and any(value != neutral for value in values):
            reason = f"{key} {' '.join(map(str, values))}"
    for sibling in (f"{dataset.name}_scaling_factor", f"{dataset.name}_offset"):
        if sibling in dataset.file:
            reason = sibling
    if not reason:
        return ""
    return f"has {reason} beside it, which is not applied: type `scale` ROLE=FACTOR"


# --- what a node says ---


def _attribute(node: Any, name: str) -> Any:
    """Return an attribute as a flat list of texts and numbers; empty where there is none."""
    value = node.attrs.get(name)
    if value is None or isinstance(value, h5py.Empty):
        return []
    items = np.ravel(value).tolist()
    return [str(x, "utf-8", "replace") if isinstance(x, bytes) else x for x in items]


def _texts(node: Any, name: str) -> list[str]:
    """Return an attribute as texts; a text with commas is a list."""
    texts = [str(item) for item in _attribute(node, name)]
    if len(texts) == 1:
        texts = texts[0].split(",")
    return [text.strip() for text in texts]
