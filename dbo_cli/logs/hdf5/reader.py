"""HDF5 as a table of columns: how programs arrange a table in a group, and the group that is meant.

NeXus, Bluesky, LabOne, MATLAB, pandas, and plain groups of datasets. MATLAB's v7.3
files are HDF5 with every matrix stored transposed; since the longer axis is taken as
time, both read the same. What a dataset's attributes mean is in ``hdf5.columns``. No
link is followed and no dataset read that hangs or leads astray.
"""

from __future__ import annotations

import math
import os
import re
import stat
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import h5py
import numpy as np

from dbo_cli.errors import InputError, clean_text, cleaned
from dbo_cli.logs.clock import Statement, is_clock_name
from dbo_cli.logs.column_table import (
    MATLAB_OBJECTS,
    ColumnSource,
    ColumnTable,
    number_in,
    with_unit,
    without_scalars,
)
from dbo_cli.logs.columns import (
    DISPLACEMENT,
    TIME_NAMES,
    VOLTAGE,
    fits_pattern,
    split_header,
)
from dbo_cli.logs.hdf5.columns import (
    attribute,
    attribute_text,
    columns_of,
    is_dataset,
    is_group,
    matlab_class,
    program_columns,
    scalar_statements,
    statements_of,
    stored_text,
)
from dbo_cli.logs.request import BLOCK_ROWS, Address, FileWatch, Request, brief

# What h5py raises at damaged bytes.
_DAMAGED = (OSError, RuntimeError, KeyError, TypeError, ValueError, IndexError)
# members of a group that are all looked at: four columns of each of 4,096 actuators, 7
# s
_MOST = 1 << 14
# levels looked through for a table; LabOne's is the deepest known
# (/000/dev/demods/0/sample)
_DEEPEST = 8
# What NXlog, Bluesky's writers (EPOCH) and LabOne call values, stamps and what stands
# beside them.
_VALUES = ("value", "values", "data", "average_value")
_TIMES = ("time", "timestamp", "timestamps", "EPOCH")
_BESIDE = (
    "raw_value",
    "chunk",
    "status",
    "severity",
    "alarm_status",
    "alarm_severity",
    "connection_status",
)
# of the stamp: what is left of one clock written twice, in seconds since 1970
_SAME_STAMPS = 1e-9


def open_hdf5(request: Request) -> ColumnTable:
    """Open an HDF5 log: its columns at once, their rows in blocks.

    A path to a dataset outside the group, which the user named, becomes a column too.

    Raises
    ------
    InputError
        The file or the group is absent, damaged, or holds no columns of numbers.
    """
    address = request.address
    if address.is_stream:
        raise InputError(
            "standard input: HDF5 cannot be read from a pipe: give the file's name"
        )
    if not os.path.exists(address.path):
        raise InputError(f"{address.path}: no such file")
    if os.path.isdir(address.path):
        raise InputError(f"{address.path}: this is a folder, not a log")
    if not os.path.isfile(address.path):
        raise InputError(f"{address.path}: this is no regular file, and HDF5 needs one")
    try:
        file = _SafeFile(address.path, request.watch)
    except OSError as problem:
        raise InputError(
            f"{address.path}: cannot be read as HDF5: {brief(problem)}"
        ) from None
    try:
        with request.reading("HDF5", _DAMAGED):
            node, sources = _find_columns(file, address, request.named)
            clock = _nearest_clock(node)
            where = f" in {node.name}"
    except BaseException:
        file.close()
        raise
    return ColumnTable(
        request, "HDF5", sources, clock, 0.0, where, file.close, _DAMAGED
    )


def _find_columns(
    file: Any, address: Address, selectors: Sequence[str]
) -> tuple[Any, list[ColumnSource]]:
    place = address.text
    node = file.get(address.group or "/")
    if node is None:
        raise InputError(
            f"{place}: there is no group '{address.group}': {_list_groups(file)}"
        )
    if is_dataset(node):
        sources = columns_of(node, "")
        if not sources:
            raise InputError(
                f"{place}: this dataset holds no columns of numbers ({_shape_of(node)})"
            )
        return node, sources
    start = node
    sources = columns_in(node) if len(node) <= _MOST or not selectors else []
    tables: list[tuple[Any, list[ColumnSource]]] = []
    if not sources and len(node) <= _MOST:  # what is wanted often lies further down
        try:
            tables = tables_below(node)
        except InputError:
            if not selectors:
                raise
        if len(tables) == 1:
            node, sources = tables[0]
    sources = sources + list(_by_path(start, node, sources, selectors))
    if not sources:
        raise InputError(_no_columns(file, address, tables))
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
        if "*" in path and not any(fits_pattern(label, path) for label in known):
            for name in _dataset_paths(start):
                if not fits_pattern(name, path):
                    continue
                columns = columns_of(start.get(name), "")
                if len(columns) == 1 and name not in known:
                    known.add(name)
                    yield replace(columns[0], label=name)
            continue
        for base in (node, start):
            member = base.get(path)
            columns = columns_of(member, "") if is_dataset(member) else []
            if len(columns) == 1:
                yield replace(columns[0], label=path)
                break


def _dataset_paths(group: Any, above: str = "", depth: int = 0) -> Iterator[str]:
    """Give the paths of the datasets below a group."""
    for name, node in _members(group):
        if is_dataset(node):
            yield above + name
        elif is_group(node) and depth < _DEEPEST:
            yield from _dataset_paths(node, f"{above}{name}/", depth + 1)


def _nearest_clock(node: Any) -> list[Statement]:
    """Read the statements of the sample rate next to the columns, else further out."""
    level = node.parent if is_dataset(node) else node
    while True:
        statements = [*statements_of(level), *scalar_statements(level)]
        if statements or level.name == "/":
            return statements
        level = level.parent


def _no_columns(
    file: Any, address: Address, tables: Sequence[tuple[Any, list[ColumnSource]]]
) -> str:
    text = f"{address.text}: no columns of numbers in this group: {_list_groups(file)}"
    roles: dict[str, int] = {}
    for node, sources in tables:
        labels = {source.label.lower() for source in sources}
        if sum(source.label.lower() not in TIME_NAMES for source in sources) > 1:
            known = [
                bool(labels & set(role.guesses)) for role in (VOLTAGE, DISPLACEMENT)
            ]
            roles[clean_text(node.name)] = sum(known)
    if roles:  # not what a camera wrote beside a drive
        names = [name for name, count in roles.items() if count == max(roles.values())]
        of_many = f" for the first of {len(names)} tables" if len(names) > 1 else ""
        return f"{text} (write {address.path}::{names[0]}{of_many})"
    if tables:
        paths = list(_dataset_paths(file))
        node = tables[0][0].name.strip("/") + "/"
        end = _short_end(next(path for path in paths if path.startswith(node)), paths)
        return (
            f"{text} (the end of an address is enough: `voltage` '*{clean_text(end)}')"
        )
    objects = file.get("#subsystem#") is not None
    for name in file:
        member = file.get(name)
        objects = objects or (member is not None and _is_object(member))
    return f"{text}{MATLAB_OBJECTS}" if objects else text


def _short_end(path: str, paths: Sequence[str]) -> str:
    """Return the last parts of an address that no other one ends with."""
    parts = path.split("/")
    ends = ("/" + "/".join(parts[-count:]) for count in range(1, len(parts)))
    for end in ends:
        if sum(table.endswith(end) for table in paths) == 1:
            return end
    return path


def _is_object(node: Any) -> bool:
    return matlab_class(node) in (
        "table",
        "timetable",
        "timeseries",
        "string",
        "datetime",
        "duration",
    )


def _list_groups(file: Any) -> str:
    groups: list[str] = []

    def visit(name: str, node: Any) -> bool | None:
        if not name.startswith("#") and (is_dataset(node) or not len(node)):
            groups.append("/" + clean_text(name))
        return True if len(groups) >= 20 else None

    file.visititems(visit)
    return f"it has {', '.join(groups)}" if groups else "it is empty"


def _shape_of(dataset: Any) -> str:
    if dataset.shape is None:
        return f"no shape, {dataset.dtype}"
    shape = "x".join(map(str, dataset.shape)) or "one value"
    return f"{shape}, {dataset.dtype}"


def columns_in(group: Any) -> list[ColumnSource]:
    """List the columns of one group, whoever arranged it; scalars (a sample rate, a remark) are none.

    Raises
    ------
    InputError
        There are so many members that to look at each takes minutes.
    """
    if len(group) > _MOST:
        path = clean_text(group.name).strip("/")
        name = f"{path}/NAME" if path else "NAME"
        raise InputError(
            f"{clean_text(group.file.filename)}: /{path} has {len(group):,} members, more than {_MOST:,}: "
            f"name the datasets that are meant (`voltage` {name} `displacement` {name} `time` {name})"
        )
    return program_columns(group) or _plain_columns(group) or _logged_columns(group)


def tables_below(group: Any) -> list[tuple[Any, list[ColumnSource]]]:
    """Find the groups that hold columns, at the shallowest level below ``group`` that has any.

    Where NeXus names the group that is meant (``default``, or a single NXdata), that is
    the only one.
    """
    chosen = _default_data(group)
    if chosen is not None:
        return [(chosen, columns_in(chosen))]
    level = [group]
    visited = {group.id}
    for _ in range(_DEEPEST):
        children = []
        for node in level:
            for child in _inner_groups(node):
                if child.id not in visited:
                    visited.add(child.id)
                    children.append(child)
        level = children
        tables = []
        for child in level:
            columns = columns_in(child)
            if columns:
                tables.append((child, columns))
        if tables or not level:
            return tables
    return []


def _inner_groups(group: Any) -> list[Any]:
    """List the groups in a group; links that lead nowhere and programs' own book-keeping are left out."""
    return [node for _, node in _members(group) if is_group(node)]


def _members(group: Any) -> Iterator[tuple[str, Any]]:
    """Give what is in a group by name; not MATLAB's references and PyTables' indices."""
    return (
        (name, group.get(name)) for name in group if not name.startswith(("#", "_i_"))
    )


def _plain_columns(group: Any) -> list[ColumnSource]:
    sources: list[ColumnSource] = []
    nodes = [
        (clean_text(name), node) for name, node in _members(group) if is_dataset(node)
    ]
    stamps = frozenset(
        node.size for name, node in nodes if split_header(name)[0].lower() in TIME_NAMES
    )
    for name, node in nodes:
        if not (node.size == 1 and is_clock_name(name)):
            sources += columns_of(node, name, stamps)
    members = set(group)

    def text(name: str) -> str | None:
        return stored_text(group.get(name)) if name in members else None

    sources = [with_unit(source, text) for source in without_scalars(sources)]
    if attribute_text(group, "NX_class") in ("NXdata", "NXlog"):
        sources = _nexus_scaled(group, sources)
    return [_in_seconds(group, source) for source in sources]


# --- NeXus ---


def _default_data(group: Any) -> Any:
    """Follow NeXus to the group that is meant: ``default`` attributes, else the only entry's only NXdata."""
    node = group
    for _ in range(_DEEPEST):
        if attribute_text(node, "NX_class") == "NXdata":
            return node
        named = attribute_text(node, "default")
        target = node.get(named) if named else None
        if target is None:
            members = _of_class(node, "NXentry") or _of_class(node, "NXdata")
            target = members[0] if len(members) == 1 else None
        if not is_group(target):
            return None
        node = target
    return None


def _of_class(group: Any, kind: str) -> list[Any]:
    """Return the groups in a group that have this class of NeXus."""
    return [
        child
        for child in _inner_groups(group)
        if attribute_text(child, "NX_class") == kind
    ]


def _nexus_scaled(group: Any, sources: list[ColumnSource]) -> list[ColumnSource]:
    """Apply NeXus' ``NAME_scaling_factor`` and ``NAME_offset`` fields: (value + offset) · factor."""
    ends = ("_scaling_factor", "_offset", "_errors")
    helpers = {f"{source.label}{end}" for source in sources for end in ends}
    scaled = []
    for source in sources:
        if source.label in helpers:
            continue
        factor = _single(group.get(f"{source.label}_scaling_factor"))
        offset = _single(group.get(f"{source.label}_offset"))
        if factor is None and offset is not None:
            factor = 1.0
        if factor is not None:
            shift = (offset or 0.0) * factor
            source = replace(source, scale=factor, offset=shift)
        scaled.append(source)
    signal = attribute_text(group, "signal")
    for source in scaled:
        if source.label == signal:
            return [column for column in scaled if column.length == source.length]
    return scaled


def _single(node: Any) -> float | None:
    return number_in(node[()]) if is_dataset(node) and node.size == 1 else None


# --- one group per signal (Bluesky, NXlog, LabOne's plotter) ---


def _logged_columns(group: Any) -> list[ColumnSource]:
    """Read groups that hold one signal each, its values beside their own time stamps."""
    values: list[ColumnSource] = []
    clocks: list[ColumnSource] = []
    for child in _inner_groups(group):
        datasets = {
            name: node
            for name in child
            if is_dataset(node := child.get(name)) and node.shape
        }
        value = next((name for name in _VALUES if name in datasets), None)
        time = next((name for name in _TIMES if name in datasets), None)
        label = clean_text(child.name.rsplit("/", 1)[-1])
        if value is None or _beside(datasets, datasets[value].shape[0]):
            continue
        columns = columns_of(datasets[value], label)
        if len(columns) != 1:
            continue
        values += columns
        if time is not None:
            stamps = columns_of(datasets[time], f"{label}/{time}")
            unit = stamps[0].unit if stamps else None
            # Bluesky's writer documents its times in seconds
            if child.get("EPOCH") is not None:
                unit = unit or "s"
            clocks += [
                _in_seconds(child, replace(stamp, unit=unit)) for stamp in stamps
            ]
    if not values or max(source.length for source in values) < 2:
        return []
    if len(clocks) == len(values):
        clocks = _one_clock(clocks)
    return clocks + values


def _beside(datasets: dict[str, Any], length: int) -> bool:
    """Tell whether a group holds other columns beside one signal and its stamps: then it is a table."""
    known = (*_VALUES, *_TIMES, *_BESIDE)
    return any(
        name not in known and node.shape[0] == length for name, node in datasets.items()
    )


def _one_clock(clocks: list[ColumnSource]) -> list[ColumnSource]:
    """Put clocks that agree together into one; signals stamped each for itself keep their own."""
    first = clocks[0]
    kind = (first.length, first.unit, first.scale)
    for clock in clocks[1:]:
        if (clock.length, clock.unit, clock.scale) != kind:
            return clocks
        for start in range(0, first.length, BLOCK_ROWS):
            stop = min(first.length, start + BLOCK_ROWS)
            if not np.allclose(
                first.read(start, stop), clock.read(start, stop), _SAME_STAMPS, 0.0
            ):
                return clocks
    return [replace(first, label=first.label.rsplit("/", 1)[-1])]


def _in_seconds(group: Any, source: ColumnSource) -> ColumnSource:
    """Turn LabOne's time stamps, which count ticks of the instrument's clock, into seconds."""
    if source.label.rsplit("/", 1)[-1] != "timestamp" or source.unit:
        return source
    base = _clock_base(group)
    if base is not None:
        return replace(source, unit="s", scale=1.0 / base)
    for part in group.name.split("/"):
        if re.fullmatch(r"dev\d+", part.lower()):
            return replace(source, unit="ticks")
    return source


def _clock_base(group: Any) -> float | None:
    """Look for LabOne's ``clockbase`` (ticks a second) beside the samples or anywhere above them."""
    node = group
    for _ in range(_DEEPEST):
        base = _single(node.get("clockbase")) or number_in(attribute(node, "clockbase"))
        if base is not None and base > 0.0:
            return base
        node = node.parent
    return None


# --- files opened with care ---
#
# A file may claim a million times more rows than it holds, refer to itself, or point
# anywhere on the machine: an external link to a named pipe never opens, external
# storage hands out the bytes of any file, a virtual dataset whose source is missing
# reads as its fill value without a word.

# links to follow one after the other; HDF5's own limit for soft links is 16, too
_MOST_HOPS = 16
_MOST_CHUNK_BYTES = 1 << 30  # a chunk is unpacked as a whole
# an empty place kept for something else does not make a file unreadable
_HARMLESS_BYTES = 100_000_000
# of the claimed samples: less than that is no recording with a gap
_LEAST_STORED = 0.001


class _SafeGroup(h5py.Group):  # type: ignore[misc]
    """A group whose members are looked at before they are opened.

    ``root`` is the file that was asked for, ``hops`` the number of links on the way
    here.
    """

    root: _SafeFile
    hops = 0

    def get(
        self,
        name: Any,
        default: Any = None,
        getclass: bool = False,
        getlink: bool = False,
    ) -> Any:
        """Return a member, or ``default``."""
        if getclass or getlink:
            return super().get(name, default, getclass, getlink)
        node = _resolved(self, name, self.root, self.hops)
        return default if node is None else node

    def __getitem__(self, name: Any) -> Any:
        """Return a member (KeyError where there is none)."""
        if not isinstance(name, str | bytes):
            return super().__getitem__(name)
        node = _resolved(self, name, self.root, self.hops)
        if node is None:
            raise KeyError(
                f"there is no '{cleaned(_text(name))}', or it is a link that leads nowhere"
            )
        return node

    def __contains__(self, name: Any) -> bool:
        """Tell whether there is a member that can be opened."""
        return _resolved(self, name, self.root, self.hops) is not None


class _SafeFile(_SafeGroup, h5py.File):  # type: ignore[misc]
    """A file whose members are checked before they are handed out; files behind links are closed with it.

    Links that lead nowhere or in a circle are as if they were not there (``get`` gives
    None). ``watch`` gets the files behind links, too.
    """

    def __init__(self, path: str, watch: FileWatch) -> None:
        h5py.File.__init__(self, path, "r")
        self.watch = watch
        self.root = self
        self.behind_links: list[h5py.File] = []

    def close(self) -> None:
        """Close the file and those behind its links."""
        for file in (*self.behind_links, self):
            h5py.File.close(file)


def _text(name: str | bytes) -> str:
    return name.decode("utf-8", "surrogateescape") if isinstance(name, bytes) else name


def _resolved(group: Any, name: str | bytes, root: _SafeFile, hops: int) -> Any:
    """Follow a path link by link; None where it leads nowhere."""
    # a plain group: its own methods must not come back here
    node = h5py.Group(
        h5py.h5g.open(group.id, b"/" if _text(name).startswith("/") else b".")
    )
    parts = [part for part in _text(name).split("/") if part not in ("", ".")]
    for number, part in enumerate(parts):
        if not isinstance(node, h5py.Group):
            return None
        try:
            link = h5py.Group.get(node, part, getlink=True)
        except (KeyError, OSError, RuntimeError, UnicodeError):
            return None
        if isinstance(link, h5py.SoftLink | h5py.ExternalLink):
            if hops >= _MOST_HOPS:
                return None
            return _through(node, link, "/".join(parts[number + 1 :]), root, hops + 1)
        if link is None:
            return None
        try:
            node = h5py.Group.__getitem__(node, part)
        except (KeyError, OSError, RuntimeError):
            return None
    if isinstance(node, h5py.Dataset):
        check_dataset(node, root.watch)
        return node
    if not isinstance(node, h5py.Group):
        return node
    safe = _SafeGroup(node.id)
    safe.root, safe.hops = root, hops
    return safe


def _through(group: Any, link: Any, rest: str, root: _SafeFile, hops: int) -> Any:
    """Go on behind a link, in this file or another."""
    path = f"{link.path}/{rest}" if rest else link.path
    if isinstance(link, h5py.SoftLink):
        return _resolved(group, path, root, hops)
    target = _file_named(link.filename, group.file.filename)
    if target is None:
        return None
    if not stat.S_ISREG(os.stat(target).st_mode):
        raise InputError(
            f"{cleaned(group.file.filename)}: a link in '{group.name}' leads to '{cleaned(link.filename)}', "
            "which is no regular file: take the link out, or read another file"
        )
    root.watch.add(target)
    try:
        file = h5py.File(target, "r")
    except OSError:
        return None
    root.behind_links.append(file)
    return _resolved(file, "/" + path.lstrip("/"), root, hops)


def _file_named(name: str, beside: str) -> str | None:
    """Find a file that another names, as HDF5 does: as it stands, or beside the other."""
    folder = os.path.dirname(os.path.realpath(beside))
    candidates = (
        os.path.join(folder, name),
        name,
        os.path.join(folder, os.path.basename(name)),
    )
    return next(filter(os.path.exists, candidates), None)


def check_dataset(dataset: Any, watch: FileWatch) -> None:
    """Refuse a dataset that claims what it does not hold, or that takes its samples from elsewhere.

    Raises
    ------
    InputError
        Its samples are another file's (external storage), a source is missing or is the
        dataset itself (virtual), or hardly any of its samples are stored.
    """
    place = f"{cleaned(dataset.file.filename)}: dataset '{cleaned(dataset.name or '')}'"
    shape = dataset.shape
    if not shape or 0 in shape:
        return
    if dataset.external:
        raise InputError(
            f"{place} takes its bytes from another file ('{cleaned(str(dataset.external[0][0]))}'), which "
            "any file could be: put them into this one (h5repack)"
        )
    if dataset.is_virtual:
        _check_virtual(dataset, place, watch, ())
        return
    chunk = dataset.chunks
    if chunk is not None and _bytes(chunk, dataset) > _MOST_CHUNK_BYTES:
        raise InputError(
            f"{place} is stored in pieces of more than 1 GB: store it in smaller ones (h5repack)"
        )
    if _bytes(shape, dataset) < _HARMLESS_BYTES:
        return
    stored = _stored_share(dataset)
    if stored < _LEAST_STORED:
        count = " x ".join(f"{length:,}" for length in shape)
        what = "none of them" if stored == 0.0 else f"{100.0 * stored:.2g} % of them"
        raise InputError(
            f"{place} claims {count} samples and holds {what}: the recording was not finished"
        )


def _bytes(shape: tuple[int, ...], dataset: Any) -> int:
    return math.prod(map(int, shape)) * int(dataset.dtype.itemsize)


def _stored_share(dataset: Any) -> float:
    """Estimate the share of the claimed samples that is stored at all."""
    claimed = _bytes(dataset.shape, dataset)
    if dataset.chunks is None:
        return float(min(1.0, dataset.id.get_storage_size() / claimed))
    try:
        pieces = dataset.id.get_num_chunks()
    except (AttributeError, OSError, RuntimeError, ValueError):
        # a layout older than HDF5 1.10
        return 1.0 if dataset.id.get_storage_size() else 0.0
    return float(min(1.0, pieces * _bytes(dataset.chunks, dataset) / claimed))


def _check_virtual(
    dataset: Any, place: str, watch: FileWatch, above: tuple[tuple[str, str], ...]
) -> None:
    itself = (os.path.realpath(dataset.file.filename), dataset.name)
    if itself in above or len(above) > _MOST_HOPS:
        raise InputError(
            f"{place} is a virtual one made of itself: it holds no samples"
        )
    for file_name, name in _sources(dataset):
        if "%" in file_name + name:
            raise InputError(
                f"{place} is a virtual one of numbered files: join them into one file first"
            )
        source, called = _source_of(file_name, name, dataset.file.filename)
        missing = f"{place} is a virtual one, and its source {called} is missing"
        if source is None or not os.path.isfile(source):
            raise InputError(f"{missing}: put the file beside this one")
        if (os.path.realpath(source), "/" + name.strip("/")) in (*above, itself):
            raise InputError(
                f"{place} is a virtual one made of itself: it holds no samples"
            )
        watch.add(source)
        try:
            with h5py.File(source, "r") as file:
                node = _resolved_link(file, name)
                if node is None:
                    raise InputError(f"{missing} there")
                if node.is_virtual:
                    _check_virtual(node, place, watch, (*above, itself))
                elif node.external:
                    raise InputError(
                        f"{place} is a virtual one, and its source {called} is stored elsewhere"
                    )
        except OSError:
            raise InputError(f"{missing}: it cannot be opened") from None


def _source_of(file_name: str, name: str, beside: str) -> tuple[str | None, str]:
    """Return the file of a virtual dataset's source, None where it is missing, and what messages call it."""
    if file_name == ".":
        return os.path.realpath(beside), f"'{cleaned(name)}'"
    called = f"'{cleaned(name)}' in '{cleaned(file_name)}'"
    return _file_named(file_name, beside), called


def _resolved_link(file: Any, name: str) -> Any:
    """Return the dataset of a virtual source where it stands there by itself, no link on the way."""
    node = file
    for part in name.strip("/").split("/"):
        link = node.get(part, getlink=True) if isinstance(node, h5py.Group) else None
        if not isinstance(link, h5py.HardLink):
            return None
        node = node[part]
    return node if isinstance(node, h5py.Dataset) else None


def _sources(dataset: Any) -> Iterator[tuple[str, str]]:
    """Give each source of a virtual dataset once; every sample of it must come from one."""
    claimed = int(np.prod([float(length) for length in dataset.shape]))
    mapped = 0
    files = set()
    for source in dataset.virtual_sources():
        mapped += int(source.vspace.get_select_npoints())
        if (source.file_name, source.dset_name) not in files:
            files.add((source.file_name, source.dset_name))
            yield source.file_name, source.dset_name
    if mapped < claimed:
        raise InputError(
            f"{cleaned(dataset.file.filename)}: dataset '{cleaned(dataset.name)}' is a virtual one with "
            f"sources for {mapped:,} of its {claimed:,} samples"
        )
