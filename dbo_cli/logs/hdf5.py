"""HDF5 logs: 1-D datasets, columns of 2-D ones, fields of compound ones, units as attributes.

A log is one file: what leads elsewhere (links, virtual datasets, external storage) is
passed over, and refused where it is typed. MATLAB's files of version 7.3 and netCDF-4
are HDF5, too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import h5py
import numpy as np

from dbo_cli.errors import InputError, warn
from dbo_cli.logs.formats.stored import Fetch, StoredTable, fenced, parts_of
from dbo_cli.logs.settings import Statement, is_clock_setting, plain_key, stated_clock
from dbo_cli.logs.table import Column, Reading, Table

# bytes a dataset: a compressed chunk is unpacked once, not once a block
_CHUNK_CACHE = 1 << 22
_LISTED = 9  # datasets that a message names at most
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

    Without it, the columns are those of the shallowest groups that have any.

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


@dataclass(frozen=True)
class _Stored:
    """A column: its path from the part that is open, the group it stands in, and what is known of it."""

    path: str
    group: str
    length: int
    fetch: Fetch
    unit: str | None
    kind: str


class Hdf5Table(StoredTable):
    """The columns of an HDF5 file.

    A column whose attributes may belong to its values (``scale_factor``) is refused where
    it is read, or warned of where the user types a scale (``is_scaled``).
    """

    def __init__(self, path: str, inner: str, file: Any, is_scaled: bool) -> None:
        super().__init__(path, file.close)
        self._is_scaled = is_scaled
        self._node = self._node_at(file, inner)
        if self._node is None:
            raise InputError(
                f"{path}::{inner}: no such part; the file has {_listed(file)}"
            )
        datasets = _datasets_of(self._node)
        stored = []
        for name, dataset in datasets.items():
            if dataset.size != 1 or len(datasets) == 1:
                stored += self._columns_of(name, dataset)
        stored = _shallowest(stored)
        paths = [column.path for column in stored]
        for column in stored:
            name = _shortest_end(column.path, paths)
            self.add(name, column.length, column.fetch, column.unit, column.kind)
        self.require_numbers([_listed(file)])
        groups = list(dict.fromkeys(column.group for column in stored))
        statements = self._statements(groups, datasets)
        above = self._statements([""], datasets) or _attributes(file)
        self.stated = stated_clock(statements or above)
        if len(groups) > 1:
            self.hint = f" (or one group alone: {path}::{groups[0]})"

    def _statements(
        self, groups: Sequence[str], datasets: Mapping[str, Any]
    ) -> list[Statement]:
        """Return what groups and the datasets in them state of the sample rate."""
        statements: list[Statement] = []
        for group in groups:
            statements += _attributes(self._node[group] if group else self._node)
        for name, dataset in datasets.items():
            if name.rpartition("/")[0] in groups:
                statements += _attributes(dataset) + _single_value(dataset, name)
        return statements

    def find(self, name: str) -> Column | None:
        """Return the column that a dataset's path names, from the part that is open or from the top."""
        for base in (self._node, self._node.file):
            dataset = self._node_at(base, name)
            if isinstance(dataset, h5py.Dataset):
                stored = self._columns_of(name, dataset)
                if len(stored) == 1:
                    column = stored[0]
                    return self.add(
                        name, column.length, column.fetch, column.unit, column.kind
                    )
        return None

    def _node_at(self, base: Any, inner: str) -> Any:
        """Return the group or dataset at an inner path, or None.

        Raises
        ------
        InputError
            The path leads through a link.
        """
        node = base.file if inner.startswith("/") else base
        for step in inner.split("/"):
            if step in ("", "."):
                continue
            is_group = isinstance(node, h5py.Group)
            link = node.get(step, getlink=True) if is_group else None
            if isinstance(link, h5py.ExternalLink):
                raise InputError(
                    f"{self.name}: '{inner}' links to another file: type {link.filename}"
                )
            if isinstance(link, h5py.SoftLink):
                raise InputError(
                    f"{self.name}: '{inner}' is a link: type what it leads to, {link.path}"
                )
            if link is None:
                return None
            node = node[step]
        return node

    def _columns_of(self, path: str, dataset: Any) -> list[_Stored]:
        """Take a dataset apart into columns; none where it holds no numbers."""
        if not dataset.size or not _holds_numbers(dataset):
            return []
        group, _, name = path.rpartition("/")
        labels = _texts(dataset, "columns", "column_names", "names")
        units = _texts(dataset, "units", "unit", "Units", "Unit")
        columns = []
        parts = list(parts_of(name, dataset))
        for number, (label, length, fetch, kind) in enumerate(parts):
            name_path = f"{group}/{label}"
            if dataset.dtype.names is not None:
                name_path = f"{path}/{label}"
            elif len(labels) == len(parts) > 1:
                name_path = f"{path}/{labels[number]}"
            unit = units[0] if len(units) == 1 else "".join(units[number : number + 1])
            fetch = self._checked(dataset, label, fetch)
            name_path = name_path.lstrip("/")
            columns.append(_Stored(name_path, group, length, fetch, unit, kind))
        return columns

    def _checked(self, dataset: Any, label: str, fetch: Fetch) -> Fetch:
        """Make NaN of what stands for a missing number; refuse what may not be what it is taken for."""
        missing = _attribute(dataset, "_FillValue")
        missing += _attribute(dataset, "missing_value")
        factor = _not_applied(dataset)

        def checked(start: int, stop: int) -> Any:
            if dataset.is_virtual or dataset.external:
                raise InputError(
                    f"{self.name}: column '{label}' is stored in other files: copy them into one "
                    "with h5repack"
                )
            if factor and not self._is_scaled:
                raise InputError(f"{self.name}: column '{label}' {factor}")
            if factor and start == 0:  # the scale may be another column's
                warn(f"{self.name}: column '{label}' {factor}")
            rows = fetch(start, stop)
            return np.where(np.isin(rows, missing), np.nan, rows) if missing else rows

        return checked


def _datasets_of(node: Any) -> dict[str, Any]:
    """Return the datasets of a part by their paths, whatever hard links lead to them."""
    if isinstance(node, h5py.Dataset):
        return {node.name.rpartition("/")[2]: node}
    datasets: dict[str, Any] = {}

    def visit(name: str, member: Any) -> None:
        if isinstance(member, h5py.Dataset) and not name.startswith("#"):  # MATLAB's
            datasets[name] = member

    node.visititems(visit)
    return datasets


def _shallowest(columns: Sequence[_Stored]) -> list[_Stored]:
    """Return the columns of the shallowest groups; of several those of the only one with more than one."""
    numbers = [column.group for column in columns if column.kind == "number"]
    depth = min(map(_depth, numbers), default=0)
    groups = [group for group in numbers if _depth(group) == depth]
    wide = {group for group in groups if groups.count(group) > 1}
    kept = wide if len(wide) == 1 else groups
    return [column for column in columns if column.group in kept]


def _depth(group: str) -> int:
    return group.count("/") + bool(group)


def _shortest_end(path: str, paths: Sequence[str]) -> str:
    """Return the shortest end of a path that no other path has."""
    steps = path.split("/")
    for start in range(len(steps) - 1, 0, -1):
        end = "/".join(steps[start:])
        if sum(f"/{other}".endswith(f"/{end}") for other in paths) == 1:
            return end
    return path


def _not_applied(dataset: Any) -> str:
    """Say which factor or offset in or beside a dataset may belong to its values (Keysight, NeXus)."""
    for key in dataset.attrs:
        values, neutral = _attribute(dataset, key), _NOT_APPLIED.get(plain_key(key))
        if neutral is not None and len(values) == 1 and values[0] != neutral:
            return f"has an attribute {key}, {values[0]}, which is not applied: type `scale` ROLE=FACTOR"
    if _attribute(dataset.parent, "YInc") not in ([], [1.0]):
        return "has YInc beside it, which is not applied: type `scale` ROLE=FACTOR"
    for sibling in (f"{dataset.name}_scaling_factor", f"{dataset.name}_offset"):
        if sibling in dataset.file:
            return f"has {sibling} beside it, which is not applied: type `scale` ROLE=FACTOR"
    return ""


# --- what a node says ---


def _listed(file: Any) -> str:
    """Return the datasets of the file for a message."""
    names = []
    for name, dataset in list(_datasets_of(file).items())[:_LISTED]:
        shape = "x".join(map(str, dataset.shape or ()))
        names.append(f"/{name} ({shape} {dataset.dtype})")
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


def _single_value(dataset: Any, path: str) -> list[Statement]:
    """Return what a dataset of one value states of the sample rate."""
    name = path.rpartition("/")[2]
    is_elsewhere = dataset.is_virtual or dataset.external
    if dataset.size != 1 or is_elsewhere or not is_clock_setting(name):
        return []
    unit = _texts(dataset, "units", "unit")
    return [(name, _plain(np.ravel(dataset[()])[0]), "".join(unit))]
