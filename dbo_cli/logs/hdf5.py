"""HDF5 logs: 1-D datasets, columns of 2-D ones, fields of compound ones, units as attributes.

Soft links inside the file are followed. What leads out of it (external links, virtual
datasets, external storage) is refused: a log is one file, and no other is opened
because a file says so. MATLAB's files of version 7.3 and netCDF-4 are HDF5, too.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import h5py
import numpy as np

from dbo_cli.errors import InputError
from dbo_cli.logs.cells import stamp_format, to_stamp
from dbo_cli.logs.formats import (
    Found,
    Group,
    LibrarySource,
    Statement,
    choose,
    chosen_columns,
    fenced,
    without_single_values,
)
from dbo_cli.logs.headers import is_clock_key
from dbo_cli.logs.source import Column, Fetch, Reading, Source

MOST_HOPS = 16  # soft links behind each other; more are a circle
MOST_MEMBERS = 20_000  # that are looked at: some seconds
LONGEST_STAMP = 80  # bytes of a text that may be a date and a time
CHUNK_CACHE = (
    1 << 25
)  # bytes a dataset: a compressed chunk is unpacked once, not once a block
_UNITS = ("units", "unit", "Units", "Unit")
_NAMES = ("columns", "column_names", "names", "channels", "labels")
_UNUSED = (
    "offset",
    "gain",
    "factor",
    "sensitivity",
    "calibration",
    "conversion_factor",
)
_MATLAB_NUMBERS = ("double", "single", "int8", "int16", "int32", "int64", "uint8", "uint16",
                   "uint32", "uint64", "logical", "")  # fmt: skip
_OBJECTS = "; MATLAB's own objects are not read: save vectors, save('run.mat', 't', 'voltage', '-v7.3')"


def open_hdf5(path: str, part: str, reading: Reading) -> Source:
    """Open an HDF5 log; ``part`` is a group or a dataset, by its path.

    Without it, the columns are those of the shallowest group that has any.

    Raises
    ------
    InputError
        It is damaged, has no such part, or holds no columns of numbers.
    """
    with fenced(path, "HDF5"):
        file = h5py.File(path, "r", rdcc_nbytes=CHUNK_CACHE)
    try:
        with fenced(path, "HDF5"):
            return Hdf5Source(path, part, file)
    except BaseException:
        file.close()
        raise


class Hdf5Source(LibrarySource):
    """The columns of an HDF5 file."""

    def __init__(self, path: str, part: str, file: Any) -> None:
        self._file = _Tree(path, file)
        node = self._file.node(file, part or "/")
        if node is None:
            raise InputError(
                f"{path}::{part}: there is no '{part}': it has {self._file.listed()}"
            )
        self._node = node
        groups = self._groups(node)
        found, hint = chosen_columns(path, groups, "/")
        if not found:
            place = f"{path}::{part}" if part else path
            raise InputError(
                f"{place}: no columns of numbers: it has {self._file.listed()}"
            )
        level = choose(groups)[0][0]
        statements = level.statements or self._stated_above(part, level)
        super().__init__(path, found, statements, file.close, self._file.remarks)
        self.hint = hint

    def find(self, name: str) -> Column | None:
        """Return the column that a dataset's path names, from the part that is read or from the top."""
        for base in (self._node, self._node.file["/"]):
            if isinstance(base, h5py.Group):
                node = self._file.node(base, name)
                found = self._file.columns(node, name) if _is_dataset(node) else []
                if len(found) == 1:
                    return self.add(found[0])
        return None

    def _groups(self, node: Any) -> list[Group]:
        if _is_dataset(node):
            group = Group("", 0, statements=_statements(node))
            group.columns = self._file.columns(node, node.name.rsplit("/", 1)[-1])
            return [group]
        return list(self._file.groups(node, "", 0, set()))

    def _stated_above(self, part: str, level: Group) -> list[Statement]:
        """Return what the nearest level above the columns states."""
        top = self._node.parent if _is_dataset(self._node) else self._node
        node = self._file.node(top, level.path) if level.path else top
        while node is not None:
            stated = self._file.statements(node)
            if stated or node.name == "/":
                return stated
            node = node.parent
        return []


class _Tree:
    """The groups and datasets of a file, with links checked before they are followed."""

    def __init__(self, path: str, file: Any) -> None:
        self.path = path
        self.file = file
        self.remarks: list[str] = []
        self._seen = 0

    def node(self, base: Any, path: str, hops: int = 0) -> Any:
        """Return the group or dataset at a path, or None.

        Raises
        ------
        InputError
            The path leads to another file.
        """
        node = self.file["/"] if path.startswith("/") else base
        steps = [step for step in path.split("/") if step not in ("", ".")]
        for number, step in enumerate(steps):
            if not isinstance(node, h5py.Group) or step not in node.keys():
                return None
            link = node.get(step, getlink=True)
            if isinstance(link, h5py.ExternalLink):
                raise InputError(
                    f"{self.path}: '{path}' leads to another file, {link.filename}: read that file itself"
                )
            if isinstance(link, h5py.SoftLink):
                rest = "/".join([link.path, *steps[number + 1 :]])
                return None if hops >= MOST_HOPS else self.node(node, rest, hops + 1)
            node = node[step]
        return node

    def groups(
        self, group: Any, path: str, depth: int, seen: set[Any]
    ) -> Iterator[Group]:
        """Return a group and all groups below it, each with its columns."""
        address = h5py.h5o.get_info(group.id).addr
        if address in seen:
            return  # a circle of hard links
        seen.add(address)
        if "pandas_type" in group.attrs:
            raise InputError(
                f"{self.path}: pandas' to_hdf wrote it: df.to_parquet(OUT), or dbo.identify(df)"
            )
        found = Group(path, depth, statements=self.statements(group))
        below = []
        for name, node in self._members(group):
            if _is_dataset(node):
                beside = _stored_text(_own_member(group, f"{name}_unit"))
                for column in self.columns(node, name):
                    found.columns.append(replace(column, unit=column.unit or beside))
                if node.size and node.size > 1:
                    found.statements += _statements(node)
            elif isinstance(node, h5py.Group):
                below.append((name, node))
        found.columns = without_single_values(found.columns)
        yield found
        for name, node in below:
            yield from self.groups(node, f"{path}/{name}".lstrip("/"), depth + 1, seen)

    def _members(self, group: Any) -> Iterator[tuple[str, Any]]:
        for name in group:
            self._seen += 1
            if self._seen > MOST_MEMBERS:
                raise InputError(
                    f"{self.path}: more than {MOST_MEMBERS:,} members: say which group is meant "
                    f"({self.path}::/GROUP)"
                )
            if name.startswith("#"):
                continue  # MATLAB's book-keeping
            if isinstance(group.get(name, getlink=True), h5py.ExternalLink):
                self.remarks.append(
                    f"the link '{name}' leads to another file and is not followed"
                )
                continue
            node = self.node(group, name)
            if node is not None:
                yield name, node

    def statements(self, group: Any) -> list[Statement]:
        """Return what a group's attributes and single values state of the sample rate."""
        stated = _statements(group)
        for name in group:
            node: Any = _own_member(group, name) if is_clock_key(name) else None
            if _is_dataset(node) and node.size == 1 and not _leads_out(node):
                value = np.ravel(node[()])[0]
                stated.append((name, _plain(value), _attribute_text(node, _UNITS)))
        return stated

    def columns(self, dataset: Any, name: str) -> list[Found]:
        """Take a dataset apart into columns; none where it holds no numbers or stamps."""
        kind, shape = dataset.dtype, dataset.shape
        if not dataset.size or not _holds_numbers(dataset):
            return []
        if _leads_out(dataset):
            length = shape[0] if shape else 1
            return [Found(name, length, self._refusing(name))]
        if kind.names is not None:
            return self._fields(dataset, name) if len(shape) == 1 else []
        if h5py.check_string_dtype(kind) is not None and len(shape) == 1:
            return self._stamps(dataset, name)
        if kind.kind not in "fiub" or len(shape) not in (0, 1, 2):
            return []
        if not shape:
            return [Found(name, 1, lambda start, stop: np.ravel(dataset[()]))]
        axis = _time_axis(dataset)
        width = dataset.size // shape[axis]
        found = []
        for number, label in enumerate(_labels(dataset, name, width)):
            fetch = self._scaled(dataset, label, number, _rows(dataset, axis, number))
            found.append(Found(label, shape[axis], fetch, _unit(dataset, number)))
        return found

    def listed(self) -> str:
        """Return the datasets of the file for a message, and why MATLAB's objects are none."""
        names: list[str] = []
        has_objects = "#subsystem#" in self.file

        def visit(name: str, node: Any) -> bool | None:
            if _is_dataset(node) and not name.startswith("#"):
                names.append(
                    f"/{name} ({'x'.join(map(str, node.shape or ()))} {node.dtype})"
                )
            return True if len(names) > 8 else None

        self.file.visititems(visit)
        return (", ".join(names) or "nothing") + (_OBJECTS if has_objects else "")

    def _refusing(self, name: str) -> Fetch:
        def fetch(start: int, stop: int) -> Any:
            raise InputError(
                f"{self.path}: the data of '{name}' lie in other files (virtual or external storage): "
                "read those, or copy them into one file (h5repack)"
            )

        return fetch

    def _fields(self, dataset: Any, name: str) -> list[Found]:
        found = []
        for number, field in enumerate(dataset.dtype.names):
            kind, length = dataset.dtype[field], len(dataset)
            rows = _field_rows(dataset, field)
            if kind.kind in "fiub" and not kind.shape:
                found.append(Found(field, length, rows, _unit(dataset, number)))
            elif h5py.check_string_dtype(kind) is not None:
                found += self._stamps(dataset.fields(field), field, length)
        return found

    def _stamps(
        self, dataset: Any, name: str, length: int | None = None
    ) -> list[Found]:
        """Take texts as time stamps, if they all are."""
        shape = len(dataset) if length is None else length
        first = [_plain(cell).strip() for cell in dataset[:20]]
        if any(len(cell) > LONGEST_STAMP for cell in first):
            return []
        form = stamp_format([(cell, 1.0) for cell in first])
        if form is None:
            return []

        def fetch(start: int, stop: int) -> Any:
            cells = [_plain(cell).strip() for cell in dataset[start:stop]]
            return np.array([to_stamp(cell, form) for cell in cells], dtype=np.int64)

        return [Found(name, shape, fetch, None, "stamp")]

    def _scaled(self, dataset: Any, name: str, number: int, rows: Fetch) -> Fetch:
        """Apply ``scale_factor``, ``add_offset`` (or a lone ``scale``) and fill values."""
        factor = _attribute_number(dataset, "scale_factor", number)
        shift = _attribute_number(dataset, "add_offset", number)
        scale = _attribute_number(dataset, "scale", number)
        if factor is None and scale not in (None, 0.0, 1.0):
            if _attribute_number(dataset, "offset", number):
                return self._unclear(name)
            factor = scale
            self.remarks.append(
                f"column '{name}' is multiplied by its attribute scale, {scale:g}"
            )
        for key in _UNUSED:
            value = _attribute_number(dataset, key, number)
            if value not in (None, 0.0 if key == "offset" else 1.0):
                self.remarks.append(
                    f"column '{name}' has an attribute {key}, {value:g}, which is not applied"
                )
        fills = [
            _attribute_number(dataset, key, number)
            for key in ("_FillValue", "missing_value")
        ]
        missing = [value for value in fills if value is not None]
        if factor is None and shift is None and not missing:
            return rows

        def fetch(start: int, stop: int) -> Any:
            stored = np.asarray(rows(start, stop), dtype=np.float64)
            values = stored * (1.0 if factor is None else factor) + (shift or 0.0)
            values[np.isin(stored, missing)] = np.nan
            return values

        return fetch

    def _unclear(self, name: str) -> Fetch:
        def fetch(start: int, stop: int) -> Any:
            raise InputError(
                f"{self.path}: column '{name}' has the attributes scale and offset, and nothing says which "
                "applies first: write scale_factor and add_offset (value * scale_factor + add_offset)"
            )

        return fetch


# --- what a dataset says ---


def _is_dataset(node: Any) -> bool:
    return isinstance(node, h5py.Dataset)


def _own_member(group: Any, name: str) -> Any:
    """Return what a group holds itself, not behind a link, or None."""
    is_own = group.get(name, getclass=True, getlink=True) is h5py.HardLink
    return group[name] if is_own else None


def _stored_text(node: Any) -> str | None:
    """Return a text of MATLAB's, which is a short array of character codes."""
    if not _is_dataset(node) or _attribute_text(node, ("MATLAB_class",)) != "char":
        return None
    if _leads_out(node) or not 0 < node.size <= LONGEST_STAMP:
        return None
    return "".join(chr(int(code)) for code in np.ravel(node[()]))


def _leads_out(dataset: Any) -> bool:
    """Tell whether the data lie in other files."""
    return bool(dataset.is_virtual or dataset.external)


def _plain(value: Any) -> Any:
    """Return a text as str, and a number as Python's."""
    if isinstance(value, bytes):
        try:
            return value.decode()
        except UnicodeDecodeError:
            return value.decode("latin-1")
    return value.item() if isinstance(value, np.generic) else value


def _attribute(node: Any, *names: str) -> Any:
    for name in names:
        if name in node.attrs:
            try:
                return node.attrs[name]
            except UnicodeDecodeError:  # Latin-1 in a type that claims UTF-8
                return node.attrs.get_id(name).asstr("latin-1")
    return None


def _texts(value: Any) -> list[str]:
    """Return an attribute as texts; a text with commas is a list."""
    if value is None or isinstance(value, h5py.Empty):
        return []
    texts = [str(_plain(one)).strip() for one in np.ravel(value)]
    if len(texts) == 1 and "," in texts[0]:
        return [text.strip() for text in texts[0].split(",")]
    return texts


def _attribute_text(node: Any, names: tuple[str, ...]) -> str:
    texts = _texts(_attribute(node, *names))
    return texts[0] if len(texts) == 1 else ""


def _attribute_number(node: Any, name: str, number: int) -> float | None:
    """Return a number of an attribute; of a list the one of a column."""
    value = _attribute(node, name)
    if value is None or isinstance(value, h5py.Empty):
        return None
    values = np.ravel(value)
    if values.dtype.kind not in "fiu" or number >= len(values) > 1 or not len(values):
        return None
    return float(values[number if len(values) > 1 else 0])


def _unit(dataset: Any, number: int) -> str | None:
    """Return the unit of a column; a list of units belongs to the columns in order."""
    units = _texts(_attribute(dataset, *_UNITS))
    if len(units) == 1:
        return units[0]
    return units[number] if number < len(units) else None


def _statements(node: Any) -> list[Statement]:
    """Return what attributes state of the sample rate."""
    stated: list[Statement] = []
    for key in node.attrs:
        if is_clock_key(key):
            values = np.ravel(_attribute(node, key))
            unit = _attribute_text(node, (f"{key}_units", f"{key}_unit"))
            if len(values) == 1:
                stated.append((key, _plain(values[0]), unit))
    return stated


def _holds_numbers(dataset: Any) -> bool:
    """Leave out what only looks like numbers: MATLAB's text and objects, netCDF's bare dimensions."""
    if _attribute_text(dataset, ("NAME",)).startswith(
        "This is a netCDF dimension but not"
    ):
        return False
    if _attribute_text(dataset, ("MATLAB_class",)) not in _MATLAB_NUMBERS:
        return False
    return "MATLAB_empty" not in dataset.attrs


def _time_axis(dataset: Any) -> int:
    """Return the longer axis; MATLAB stores matrices transposed, so a square one runs the other way."""
    shape = dataset.shape
    if len(shape) == 1 or shape[0] > shape[1]:
        return 0
    if shape[0] == shape[1]:
        return 1 if "MATLAB_class" in dataset.attrs else 0
    return 1


def _labels(dataset: Any, name: str, width: int) -> list[str]:
    if width == 1:
        return [name]
    names = _texts(_attribute(dataset, *_NAMES))
    if len(names) == width:
        return names
    return [f"{name}[{number}]" for number in range(1, width + 1)]


def _rows(dataset: Any, axis: int, number: int) -> Fetch:
    if len(dataset.shape) == 1:
        return lambda start, stop: dataset[start:stop]
    if axis == 0:
        return lambda start, stop: dataset[start:stop, number]
    return lambda start, stop: dataset[number, start:stop]


def _field_rows(dataset: Any, field: str) -> Fetch:
    return lambda start, stop: dataset.fields(field)[start:stop]
