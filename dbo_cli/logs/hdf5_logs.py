"""HDF5 as a table of columns: datasets of a group, fields of a compound dataset, rows or columns of a matrix.

MATLAB's v7.3 files are HDF5 with every matrix stored transposed; since the longer axis is taken as time, both
read the same.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dbo_cli.errors import InputError
from dbo_cli.logs.addresses import Address
from dbo_cli.logs.cell_grammar import SKIP_REMEDY
from dbo_cli.logs.columns import column_info, column_label
from dbo_cli.logs.reading_options import Rows
from dbo_cli.logs.sample_block import ColumnInfo, FloatArray, SampleBlock

_UNIT_ATTRIBUTES = ("units", "unit", "Units", "Unit", "unit_string")
_RATE_ATTRIBUTES = ("sample_rate", "sample_rate_hz", "sampling_rate", "sampling_frequency", "fs", "rate")
_STEP_ATTRIBUTES = ("wf_increment", "sample_period", "sample_interval", "dt")
_NAME_ATTRIBUTES = ("columns", "column_names", "names", "channels", "channel_names", "labels", "fields")


@dataclass(frozen=True)
class _Source:
    """Where one column's numbers are: a dataset and, in it, a field or an index across the time axis."""

    dataset: Any
    label: str
    field: str | None = None
    index: int | None = None
    axis: int = 0

    def __len__(self) -> int:
        return int(self.dataset.shape[self.axis])

    def read(self, start: int, stop: int) -> FloatArray:
        """Read samples start..stop (from 0, stop not included) as float64."""
        if self.field is not None:
            values = self.dataset[start:stop][self.field]
            values = values if self.index is None else values[:, self.index]
        elif self.index is None:
            values = self.dataset[start:stop]
        elif self.axis == 0:
            values = self.dataset[start:stop, self.index]
        else:
            values = self.dataset[self.index, start:stop]
        return np.ascontiguousarray(values, dtype=np.float64)


class Hdf5Table:
    """An HDF5 log: its columns at once, their rows in blocks.

    Parameters
    ----------
    address
        The file and, after ``::``, a group or dataset in it.
    selectors
        What the user named; a path to a dataset outside the group becomes a column too.

    Raises
    ------
    InputError
        The file or the group is absent, damaged, or holds no columns of numbers.
    """

    def __init__(self, address: Address, selectors: Sequence[str] = ()) -> None:
        import h5py

        self.place = address.text
        self.notes: list[str] = []
        if address.is_stream:
            raise InputError("standard input: HDF5 cannot be read from a pipe: give the file's name")
        if not os.path.exists(address.path):
            raise InputError(f"{address.path}: no such file")
        if os.path.isdir(address.path):
            raise InputError(f"{address.path}: this is a folder, not a log")
        try:
            self._file = h5py.File(address.path, "r")
        except OSError as problem:
            raise InputError(f"{address.path}: cannot be read as HDF5: {_brief(problem)}") from None
        try:
            self._node = self._find(address.group or "/")
            self._sources = self._list_sources(selectors)
            self.columns = [_describe(source, number) for number, source in enumerate(self._sources, start=1)]
            self.sample_rate = self._find_rate()
        except (OSError, RuntimeError, KeyError, TypeError, ValueError) as problem:
            self.close()
            raise InputError(f"{self.place}: damaged HDF5: {_brief(problem)}") from None
        except BaseException:
            self.close()
            raise

    def describe(self) -> str:
        """Tell in one line how the log is written, for ``verbose``."""
        plural = "s" if len(self._sources) != 1 else ""
        rate = f", {self.sample_rate:g} samples a second" if self.sample_rate else ""
        return f"{self.place}: HDF5, {len(self._sources)} column{plural} in {self._node.name}{rate}"

    def blocks(
        self, picks: Mapping[str, ColumnInfo], rows: Rows, skip_bad: bool, block_rows: int
    ) -> Iterator[SampleBlock]:
        """Read the wanted columns in blocks of ``block_rows`` rows.

        Raises
        ------
        InputError
            The columns are of unequal length, or a value is not finite (unless ``skip_bad``).
        """
        sources = [self._sources[pick.number - 1] for pick in picks.values()]
        length = self._common_length(sources)
        end = length if rows[1] is None else min(length, rows[1])
        dropped, first = 0, ""
        for start in range(rows[0] - 1, end, block_rows):
            stop = min(end, start + block_rows)
            try:
                arrays = {
                    role: source.read(start, stop) for role, source in zip(picks, sources, strict=True)
                }
            except (OSError, RuntimeError, TypeError, ValueError) as problem:
                raise InputError(f"{self.place}: damaged HDF5: {_brief(problem)}") from None
            good = np.logical_and.reduce([np.isfinite(array) for array in arrays.values()])
            block = SampleBlock(range(start + 1, stop + 1), None, None, arrays)
            if not good.all():
                message = self._complaint(picks, block, int(np.flatnonzero(~good)[0]))
                if not skip_bad:
                    raise InputError(f"{message} {SKIP_REMEDY}")
                dropped, first = dropped + int((~good).sum()), first or message
                kept = {role: array[good] for role, array in arrays.items()}
                block = SampleBlock(np.asarray(block.rows)[good], None, None, kept)
            yield block
        if dropped:
            more = f" and {dropped - 1} more: {dropped} rows dropped" if dropped > 1 else ": 1 row dropped"
            self.notes.append(first + more)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    @property
    def sha256(self) -> str | None:
        """None: an HDF5 file is always there to be hashed as a whole."""
        return None

    def _find(self, group: str) -> Any:
        node = self._file.get(group)
        if node is None:
            raise InputError(f"{self.place}: there is no group '{group}': {_list_groups(self._file)}")
        return node

    def _list_sources(self, selectors: Sequence[str]) -> list[_Source]:
        node = self._node
        if _is_dataset(node):
            sources = _columns_of(node, "")
            if not sources:
                raise InputError(
                    f"{self.place}: this dataset holds no columns of numbers ({_shape_of(node)})"
                )
            return sources
        sources = _columns_in(node)
        if not sources:  # what is wanted often lies one group down
            inner = [(child, _columns_in(child)) for child in _inner_groups(node)]
            inner = [(child, found) for child, found in inner if found]
            if len(inner) == 1:
                self._node, sources = inner[0]
        known = {source.label for source in sources}
        for selector in selectors:
            path = selector.strip()
            other = None if path in known or path.isdigit() else node.get(path)
            if other is not None and _is_dataset(other):
                found = _columns_of(other, "")
                if len(found) == 1:
                    sources.append(_Source(other, path, found[0].field, found[0].index, found[0].axis))
        if not sources:
            raise InputError(f"{self.place}: no columns of numbers in this group: {_list_groups(self._file)}")
        return sources

    def _find_rate(self) -> float | None:
        """Look for a sample rate in the attributes, from the column outwards, and in a scalar ``fs``."""
        nodes = [source.dataset for source in self._sources[:1]] + [self._node, self._file]
        for node in nodes:
            attributes = {str(name).lower(): name for name in node.attrs}
            for names, inverse in ((_RATE_ATTRIBUTES, False), (_STEP_ATTRIBUTES, True)):
                for name in names:
                    if name in attributes:
                        value = _scalar(node.attrs[attributes[name]])
                        if value:
                            return 1.0 / value if inverse else value
        group = self._node.parent if _is_dataset(self._node) else self._node
        for name in group:
            if name.lower() in _RATE_ATTRIBUTES and _is_dataset(group[name]) and group[name].size == 1:
                return _scalar(group[name][()])
        return None

    def _common_length(self, sources: Sequence[_Source]) -> int:
        lengths = [len(source) for source in sources]
        if len(set(lengths)) > 1:
            told = ", ".join(f"'{s.label}' {n}" for s, n in zip(sources, lengths, strict=True))
            raise InputError(f"{self.place}: the columns are of unequal length: {told}")
        return lengths[0]

    def _complaint(self, picks: Mapping[str, ColumnInfo], block: SampleBlock, index: int) -> str:
        for role, pick in picks.items():
            array = block.values[role]
            if not np.isfinite(array[index]):
                value = repr(str(float(array[index])))
                return f"{self.place}: row {block.rows[index]}: {column_label(pick)} is not finite: {value}"
        raise AssertionError("a row without a bad value was complained about")


def _is_dataset(node: Any) -> bool:
    return hasattr(node, "shape")


def _inner_groups(group: Any) -> list[Any]:
    """List the groups in a group, links that lead nowhere left out."""
    nodes = [group.get(name) for name in group]
    return [node for node in nodes if hasattr(node, "keys")]


def _columns_in(group: Any) -> list[_Source]:
    """List the columns directly in a group; scalars (a sample rate, a remark) are none."""
    sources = []
    for name in group:
        node = group.get(name)
        if node is not None and _is_dataset(node) and hasattr(node, "attrs"):
            sources += _columns_of(node, name)
    longest = max((len(source) for source in sources), default=0)
    return [source for source in sources if len(source) > 1 or longest <= 1]


def _columns_of(dataset: Any, name: str) -> list[_Source]:
    """Take a dataset apart into columns; the longer axis of a matrix is time."""
    shape, kind = dataset.shape, dataset.dtype
    if shape is None or dataset.size is None:
        return []
    if kind.names is not None and len(shape) == 1:
        return _fields_of(dataset, name)
    if kind.kind not in "fiub":
        return []
    own = name or dataset.name.rsplit("/", 1)[-1]
    if len(shape) == 1:
        return [_Source(dataset, own)]
    if len(shape) != 2 or 0 in shape:
        return []
    matlab = "MATLAB_class" in dataset.attrs
    axis = 0 if shape[0] > shape[1] or (shape[0] == shape[1] and not matlab) else 1
    width = shape[1 - axis]
    if width == 1:
        return [_Source(dataset, own, None, 0, axis)]
    names = _column_names(dataset, width)
    labels = names or [f"{own}[{number}]" for number in range(1, width + 1)]
    return [_Source(dataset, label, None, index, axis) for index, label in enumerate(labels)]


def _fields_of(dataset: Any, name: str) -> list[_Source]:
    sources = []
    for field in dataset.dtype.names:
        kind = dataset.dtype[field]
        label = f"{name}/{field}" if name else field
        if kind.subdtype is not None and len(kind.shape) == 1 and kind.base.kind in "fiub":
            sources += [
                _Source(dataset, f"{label}[{index + 1}]", field, index) for index in range(kind.shape[0])
            ]
        elif kind.kind in "fiub":
            sources.append(_Source(dataset, label, field))
    return sources


def _column_names(dataset: Any, width: int) -> list[str] | None:
    for attribute in _NAME_ATTRIBUTES:
        if attribute in dataset.attrs:
            names = [_text(name) for name in np.atleast_1d(dataset.attrs[attribute]).ravel()]
            if len(names) == 1 and width > 1:
                names = [name.strip() for name in names[0].split(",")]
            if len(names) == width:
                return names
    return None


def _describe(source: _Source, number: int) -> ColumnInfo:
    """Describe a column by its label and units attribute; a list of units belongs to the columns in order."""
    unit = ""
    for attribute in _UNIT_ATTRIBUTES:
        if attribute in source.dataset.attrs:
            units = [_text(one) for one in np.atleast_1d(source.dataset.attrs[attribute]).ravel()]
            if len(units) == 1 and "," in units[0]:
                units = units[0].split(",")
            index = source.index or 0
            if source.field is not None:
                index = source.dataset.dtype.names.index(source.field)
            unit = units[0] if len(units) == 1 else (units[index] if index < len(units) else "")
            break
    return replace(column_info(source.label.rsplit("/", 1)[-1], number, unit), name=source.label)


def _text(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def _scalar(value: Any) -> float | None:
    try:
        number = float(np.asarray(value).ravel()[0])
    except (ValueError, TypeError, IndexError):
        return None
    return number if np.isfinite(number) and number > 0.0 else None


def _list_groups(file: Any) -> str:
    groups: list[str] = []

    def visit(name: str, node: Any) -> None:
        if len(groups) < 20 and (_is_dataset(node) or not len(node)):
            groups.append("/" + name)

    file.visititems(visit)
    return f"it has {', '.join(groups)}" if groups else "it is empty"


def _shape_of(dataset: Any) -> str:
    shape = "no shape" if dataset.shape is None else "x".join(map(str, dataset.shape)) or "one value"
    return f"{shape}, {dataset.dtype}"


def _brief(problem: Exception) -> str:
    """Keep the reason in brackets of the library's message, or its first line."""
    text = str(problem).strip("'\"").splitlines()[0] if str(problem) else type(problem).__name__
    return text[text.find("(") + 1 : text.rfind(")")] if "(" in text and text.endswith(")") else text
