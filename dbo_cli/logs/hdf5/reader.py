"""HDF5 as a table of columns: datasets of a group, fields of a compound dataset, rows or columns of a matrix.

MATLAB's v7.3 files are HDF5 with every matrix stored transposed; since the longer axis is taken as time, both
read the same.  How programs arrange a table is in ``hdf5.layouts``, what a dataset's attributes mean in
``hdf5.columns``.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

from dbo_cli.errors import InputError
from dbo_cli.logs.addresses import Address
from dbo_cli.logs.column_table import MATLAB_OBJECTS, ColumnSource, ColumnTable, Request, brief
from dbo_cli.logs.hdf5.columns import columns_of, is_dataset, matlab_class, scalar_statements, statements_of
from dbo_cli.logs.hdf5.layouts import columns_in, tables_below
from dbo_cli.logs.plain_text import clean_text
from dbo_cli.logs.stated_clock import Statement

_DAMAGED = (OSError, RuntimeError, KeyError, TypeError, ValueError, IndexError)


def open_hdf5(request: Request) -> ColumnTable:
    """Open an HDF5 log: its columns at once, their rows in blocks.

    A path to a dataset outside the group, which the user named, becomes a column too.

    Raises
    ------
    InputError
        The file or the group is absent, damaged, or holds no columns of numbers.
    """
    from dbo_cli.logs.hdf5.safety import open_safely

    address = request.address
    if address.is_stream:
        raise InputError("standard input: HDF5 cannot be read from a pipe: give the file's name")
    if not os.path.exists(address.path):
        raise InputError(f"{address.path}: no such file")
    if os.path.isdir(address.path):
        raise InputError(f"{address.path}: this is a folder, not a log")
    try:
        file = open_safely(address.path, request.watch)
    except OSError as problem:
        raise InputError(f"{address.path}: cannot be read as HDF5: {brief(problem)}") from None
    try:
        with request.reading("HDF5", _DAMAGED):
            node, sources = _find_columns(file, address, request.named)
            clock, where = _nearest_clock(node), f" in {node.name}"
    except BaseException:
        file.close()
        raise
    return ColumnTable(
        request, "HDF5", sources, clock=clock, where=where, at_close=file.close, damaged=_DAMAGED
    )


def _find_columns(file: Any, address: Address, selectors: Sequence[str]) -> tuple[Any, list[ColumnSource]]:
    place = address.text
    node = file.get(address.group or "/")
    if node is None:
        raise InputError(f"{place}: there is no group '{address.group}': {_list_groups(file)}")
    if is_dataset(node):
        sources = columns_of(node, "")
        if not sources:
            raise InputError(f"{place}: this dataset holds no columns of numbers ({_shape_of(node)})")
        return node, sources
    start, sources = node, columns_in(node)
    others: list[tuple[Any, list[ColumnSource]]] = []
    if not sources:  # what is wanted often lies further down
        others = tables_below(node)
        if len(others) == 1:
            node, sources = others[0]
    sources = sources + list(_by_path(start, node, sources, selectors))
    if not sources:
        raise InputError(_no_columns(file, address, others))
    return node, sources


def _by_path(
    start: Any, node: Any, sources: Sequence[ColumnSource], selectors: Sequence[str]
) -> Iterator[ColumnSource]:
    """Find the datasets that the user named by a path outside the group that was found."""
    known = {source.label for source in sources}
    for selector in selectors:
        path = selector.strip()
        if path in known or path.isdigit() or not path:
            continue
        for base in (node, start):
            other = base.get(path)
            found = columns_of(other, "") if is_dataset(other) else []
            if len(found) == 1:
                yield replace(found[0], label=path)
                break


def _nearest_clock(node: Any) -> list[Statement]:
    """Read what is said of the sample rate next to the columns, else further out."""
    level = node.parent if is_dataset(node) else node
    while True:
        found = [*statements_of(level), *scalar_statements(level)]
        if found or level.name == "/":
            return found
        level = level.parent


def _no_columns(file: Any, address: Address, tables: Sequence[tuple[Any, list[ColumnSource]]]) -> str:
    text = f"{address.text}: no columns of numbers in this group: {_list_groups(file)}"
    if tables:
        first = clean_text(tables[0][0].name)
        return f"{text} (write {address.path}::{first} for the first of {len(tables)} tables)"
    objects = file.get("#subsystem#") is not None
    members = (node for name in file if (node := file.get(name)) is not None)
    return f"{text}{MATLAB_OBJECTS}" if objects or any(map(_is_object, members)) else text


def _is_object(node: Any) -> bool:
    return matlab_class(node) in ("table", "timetable", "timeseries", "string", "datetime", "duration")


def _list_groups(file: Any) -> str:
    groups: list[str] = []

    def visit(name: str, node: Any) -> bool | None:
        if not name.startswith("#") and (is_dataset(node) or not len(node)):
            groups.append("/" + clean_text(name))
        return True if len(groups) >= 20 else None

    file.visititems(visit)
    return f"it has {', '.join(groups)}" if groups else "it is empty"


def _shape_of(dataset: Any) -> str:
    shape = "no shape" if dataset.shape is None else "x".join(map(str, dataset.shape)) or "one value"
    return f"{shape}, {dataset.dtype}"
