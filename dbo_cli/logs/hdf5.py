"""HDF5 logs: 1-D datasets, columns of 2-D ones, fields of compound ones, units as attributes.

Soft links inside the file are followed. What leads out of it (external links, virtual
datasets, external storage) is refused: a log is one file, and no other is opened
because a file says so. MATLAB's files of version 7.3 and netCDF-4 are HDF5, too.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import InputError, warn
from dbo_cli.logs.formats.stored import (
    Fetch,
    StoredColumn,
    StoredTable,
    fenced,
    no_columns,
    rows_of,
)
from dbo_cli.logs.settings import Statement, is_clock_setting, plain_key
from dbo_cli.logs.table import Column, Reading, Table

_MOST_HOPS = 16  # soft links behind each other; more are a circle
# bytes a dataset: a compressed chunk is unpacked once, not once a block
_CHUNK_CACHE = 1 << 22
_NOT_APPLIED = {
    "scalefactor": 1.0, "addoffset": 0.0, "scale": 1.0, "offset": 0.0, "gain": 1.0, "factor": 1.0,
    "sensitivity": 1.0, "calibration": 1.0, "conversion": 1.0, "scalingfactor": 1.0,
}  # fmt: skip
"""Attributes that may belong to a dataset's values, by their plain keys, and what changes nothing."""
_MATLAB_NUMBERS = ("double", "single", "int8", "int16", "int32", "int64", "uint8", "uint16",
                  "uint32", "uint64", "logical")  # fmt: skip
_EMPTY_DIMENSION = "This is a netCDF dimension but not a netCDF variable"


def open_hdf5(path: str, inner: str, reading: Reading) -> Table:
    """Read an HDF5 log; ``inner`` is a group or a dataset, by its path.

    Without it, the columns are those of the shallowest group that has any.

    Raises
    ------
    InputError
        It is damaged, has no such part, or holds no columns of numbers.
    """
    with fenced(path, "HDF5"):
        file = h5py.File(path, "r", rdcc_nbytes=_CHUNK_CACHE)
    try:
        with fenced(path, "HDF5"):
            return Hdf5Table(path, inner, file, bool(reading.scale))
    except BaseException:
        file.close()
        raise


@dataclass
class _Group:
    """A group by its path from the part that is open_hdf5, and what stands in it."""

    path: str
    columns: list[StoredColumn] = field(default_factory=list)
    datasets: list[str] = field(default_factory=list)
    statements: list[Statement] = field(default_factory=list)

    def named(self, by_path: bool) -> Iterator[StoredColumn]:
        """Return the columns: by short names, or by paths, as columns of the same name are."""
        names = [column.name for column in self.columns]
        for column, dataset in zip(self.columns, self.datasets, strict=True):
            name = column.name
            if names.count(name) > 1 and name != dataset:
                name = f"{dataset}/{name}"
            if by_path and self.path:
                name = f"{self.path}/{name}"
            yield replace(column, name=name)

    def take(self, dataset: Any, name: str) -> None:
        """Take the columns of a dataset, and what it states of the rate."""
        columns = _columns_of(dataset, name)
        self.columns += columns
        self.datasets += [name] * len(columns)
        self.statements += _attributes(dataset)

    @property
    def depth(self) -> int:
        """How far below the part that is open_hdf5 it stands."""
        return self.path.count("/") + bool(self.path)

    @property
    def width(self) -> int:
        """The number of columns of numbers."""
        return sum(column.kind == "number" for column in self.columns)


class Hdf5Table(StoredTable):
    """The columns of an HDF5 file.

    A column whose attributes may belong to its values (``scale_factor``) is refused where
    it is open_hdf5, or warned of where the user types a scale (``is_scaled``).
    """

    def __init__(self, path: str, inner: str, file: Any, is_scaled: bool) -> None:
        node = _node(path, file, inner)
        if node is None:
            raise InputError(
                f"{path}::{inner}: no such part; the file has {_listed(file)}"
            )
        self._node = node
        self._is_scaled = is_scaled
        if isinstance(node, h5py.Dataset):
            name = node.name.rsplit("/", 1)[-1]
            groups = [_Group("")]
            groups[0].take(node, name)
        else:
            groups = list(_groups(path, node, "", set()))
        holders = _holding(groups)
        if not holders:
            raise no_columns(path, [_listed(file)])
        columns: list[StoredColumn] = []
        for group in holders:
            columns += group.named(len(holders) > 1)
        above = groups[0].statements or _attributes(file)
        statements = [text for group in holders for text in group.statements] or above
        super().__init__(path, columns, statements, file.close)
        if len(holders) > 1:
            self.hint = f" (or one group alone: {path}::{holders[0].path})"

    def find(self, name: str) -> Column | None:
        """Return the column that a dataset's path names, from the part that is open_hdf5 or from the top."""
        for base in (self._node, self._node.file):
            node = (
                _node(self.name, base, name) if isinstance(base, h5py.Group) else None
            )
            if isinstance(node, h5py.Dataset):
                members = _columns_of(node, name)
                if len(members) == 1:
                    return self.add(members[0])
        return None

    def blocks(self, columns: Sequence[Column]) -> Iterator[list[NDArray[Any]]]:
        """Return all rows of the chosen columns; see ``Table``."""
        for column in columns:
            problem = self._stored[column.number - 1].problem
            if problem and not self._is_scaled:
                raise InputError(f"{self.name}: {column.label} {problem}")
            if problem:  # the scale may be another column's
                warn(f"{self.name}: {column.label} {problem}")
        yield from super().blocks(columns)


def _node(path: str, base: Any, inner: str, hops: int = 0) -> Any:
    """Return the group or dataset at an inner path, or None.

    Raises
    ------
    InputError
        The inner path leads to another file.
    """
    node = base.file if inner.startswith("/") else base
    steps = [step for step in inner.split("/") if step not in ("", ".")]
    for number, step in enumerate(steps):
        link = node.get(step, getlink=True) if isinstance(node, h5py.Group) else None
        if isinstance(link, h5py.ExternalLink):
            raise InputError(
                f"{path}: '{inner}' links to another file: type {link.filename}"
            )
        if isinstance(link, h5py.SoftLink):
            target = "/".join([link.path, *steps[number + 1 :]])
            return None if hops >= _MOST_HOPS else _node(path, node, target, hops + 1)
        if link is None:
            return None
        node = node[step]
    return node


def _groups(path: str, group: Any, inner: str, visited: set[int]) -> Iterator[_Group]:
    """Return a group and all groups below it, each with its columns."""
    address = h5py.h5o.get_info(group.id).addr
    if address in visited:
        return  # a circle of hard links
    visited.add(address)
    current = _Group(inner, statements=_attributes(group))
    below = []
    for name in group:
        is_external = isinstance(group.get(name, getlink=True), h5py.ExternalLink)
        if name.startswith("#") or is_external:
            continue  # MATLAB's book-keeping, or another file
        node = _node(path, group, name)
        if isinstance(node, h5py.Group):
            below.append((name, node))
        elif isinstance(node, h5py.Dataset) and node.size == 1:
            current.statements += _single_value(node, name)
        elif isinstance(node, h5py.Dataset):
            current.take(node, name)
    yield current
    for name, node in below:
        yield from _groups(path, node, f"{inner}/{name}".lstrip("/"), visited)


def _holding(groups: Sequence[_Group]) -> list[_Group]:
    """Return the shallowest groups with columns; of several the only one that has more than one column."""
    holding = [group for group in groups if group.width]
    depth = min([group.depth for group in holding], default=0)
    holding = [group for group in holding if group.depth == depth]
    wide = [group for group in holding if group.width > 1]
    return wide if len(wide) == 1 else holding


def _columns_of(dataset: Any, name: str) -> list[StoredColumn]:
    """Take a dataset apart into columns; none where it holds no numbers."""
    if not dataset.size or not _holds_numbers(dataset):
        return []
    if dataset.is_virtual or dataset.external:
        return [StoredColumn(name, len(dataset), None)]
    kind, shape = dataset.dtype, dataset.shape
    if kind.names is not None and len(shape) == 1:
        return _fields(dataset)
    if h5py.check_string_dtype(kind) is not None and len(shape) == 1:
        return [StoredColumn(name, len(dataset), rows_of(dataset), kind="text")]
    if kind.kind not in "fiub" or len(shape) not in (1, 2):
        return []
    if len(shape) == 1:
        return [_column(dataset, name, 0, len(dataset), rows_of(dataset))]
    is_matlab = "MATLAB_class" in dataset.attrs  # it stores matrices transposed
    along = 0 if shape[0] > shape[1] or (shape[0] == shape[1] and not is_matlab) else 1
    width = shape[1 - along]
    labels = _texts(dataset, "columns", "column_names", "names")
    if len(labels) != width:
        labels = [f"{name}[{number + 1}]" for number in range(width)]
    if width == 1:
        labels = [name]
    members = []
    for number, label in enumerate(labels):
        rows = _matrix_rows(dataset, along, number)
        members.append(_column(dataset, label, number, shape[along], rows))
    return members


def _column(
    dataset: Any, name: str, number: int, length: int, rows: Fetch
) -> StoredColumn:
    """Return a column with its unit."""
    units = _texts(dataset, "units", "unit", "Units", "Unit")
    if len(units) == 1:
        units = units * (number + 1)
    unit = units[number] if number < len(units) else None
    missing = _attribute(dataset, "_FillValue") + _attribute(dataset, "missing_value")
    fetch = _without(rows, missing) if missing else rows
    return StoredColumn(name, length, fetch, unit, problem=_not_applied(dataset))


def _not_applied(dataset: Any) -> str:
    """Say which factor or offset stands beside a dataset and may belong to its values."""
    factors = [(key, _attribute(dataset, key)) for key in dataset.attrs]
    factors.append(("YInc", _attribute(dataset.parent, "YInc")))  # Keysight's counts
    for key, values in factors:
        neutral = 1.0 if key == "YInc" else _NOT_APPLIED.get(plain_key(key))
        if neutral is not None and len(values) == 1 and values[0] != neutral:
            return f"has an attribute {key}, {values[0]}, which is not applied: type `scale` ROLE=FACTOR"
    for sibling in (f"{dataset.name}_scaling_factor", f"{dataset.name}_offset"):
        if sibling in dataset.file:  # NeXus
            return f"has {sibling} beside it, which is not applied: type `scale` ROLE=FACTOR"
    return ""


def _without(rows: Fetch, missing: Sequence[float]) -> Fetch:
    """Make NaN of what stands where a number is missing."""

    def fetch(start: int, stop: int) -> Any:
        stored = np.asarray(rows(start, stop), dtype=np.float64)
        return np.where(np.isin(stored, missing), np.nan, stored)

    return fetch


def _fields(dataset: Any) -> list[StoredColumn]:
    members = []
    for number, name in enumerate(dataset.dtype.names):
        kind, length = dataset.dtype[name], len(dataset)
        if kind.kind in "fiub" and not kind.shape:
            rows = rows_of(dataset.fields(name))
            members.append(_column(dataset, name, number, length, rows))
    return members


def _matrix_rows(dataset: Any, along: int, number: int) -> Fetch:
    if along == 0:
        return lambda start, stop: dataset[start:stop, number]
    return lambda start, stop: dataset[number, start:stop]


# --- what a node says ---


def _listed(file: Any) -> str:
    """Return the datasets of the file for a message."""
    names: list[str] = []

    def visit(name: str, node: Any) -> bool | None:
        if isinstance(node, h5py.Dataset) and not name.startswith("#"):
            shape = "x".join(map(str, node.shape or ()))
            names.append(f"/{name} ({shape} {node.dtype})")
        return True if len(names) > 8 else None

    file.visititems(visit)
    return ", ".join(names) or "nothing"


def _holds_numbers(dataset: Any) -> bool:
    """Leave out what only looks like numbers: MATLAB's text and objects, netCDF's bare dimensions."""
    name = _texts(dataset, "NAME")
    if name and name[0].startswith(_EMPTY_DIMENSION):
        return False
    matlab = _texts(dataset, "MATLAB_class")
    is_number = not matlab or matlab[0] in _MATLAB_NUMBERS
    return is_number and "MATLAB_empty" not in dataset.attrs


def _plain(value: Any) -> Any:
    """Return a text as str, and a number as Python's."""
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    return value.item() if isinstance(value, np.generic) else value


def _attribute(node: Any, name: str) -> Any:
    """Return an attribute as a flat list of texts and numbers; empty where there is none."""
    try:
        value = node.attrs.get(name)
    except UnicodeDecodeError:  # Latin-1 in a type that claims UTF-8
        value = node.attrs.get_id(name).asstr("latin-1")
    if value is None or isinstance(value, h5py.Empty):
        return []
    return [_plain(item) for item in np.ravel(value)]


def _texts(node: Any, *names: str) -> list[str]:
    """Return the first of several attributes as texts; a text with commas is a list."""
    for name in names:
        texts = [str(item).strip() for item in _attribute(node, name)]
        if len(texts) == 1:
            return [text.strip() for text in texts[0].split(",")]
        if texts:
            return texts
    return []


def _attributes(node: Any) -> list[Statement]:
    """Return what attributes state of the sample rate."""
    statements: list[Statement] = []
    for key in node.attrs:
        values = _attribute(node, key) if is_clock_setting(key) else []
        if len(values) == 1:
            unit = _texts(node, f"{key}_units", f"{key}_unit")
            statements.append((key, values[0], "".join(unit)))
    return statements


def _single_value(node: Any, name: str) -> list[Statement]:
    if not is_clock_setting(name) or node.is_virtual or node.external:
        return []
    unit = _texts(node, "units", "unit")
    return [(name, _plain(np.ravel(node[()])[0]), "".join(unit))]
