"""HDF5 files opened with care: no link is followed and no dataset read that hangs, lies or leads astray.

A file may claim a million times more rows than it holds, refer to itself, or point anywhere on the machine:
an external link to a named pipe never opens, external storage hands out the bytes of any file, a virtual
dataset whose source is missing reads as its fill value without a word.
"""

from __future__ import annotations

import math
import os
import stat
from collections.abc import Iterator
from typing import Any

import h5py
import numpy as np

from dbo_cli.errors import InputError
from dbo_cli.logs.plain_text import cleaned
from dbo_cli.logs.request import FileWatch

_MOST_HOPS = 16  # links to follow one after the other; HDF5's own limit for soft links is 16, too
_MOST_CHUNK_BYTES = 1 << 30  # a chunk is unpacked as a whole
_HARMLESS_BYTES = 100_000_000  # an empty place kept for something else does not make a file unreadable
_LEAST_STORED = 0.001  # of the claimed samples: less than that is no recording with a gap


def open_safely(path: str, watch: FileWatch) -> Any:
    """Open an HDF5 file for reading; what is got from it by name is checked before it is handed out.

    Links that lead nowhere or in a circle are as if they were not there (``get`` gives None). Files behind
    links are closed with it, and watched like it.

    Raises
    ------
    InputError
        The path is no regular file; later: what is asked for is not safe to read.
    OSError
        HDF5 cannot open it.
    """
    if not stat.S_ISREG(os.stat(path).st_mode):
        raise InputError(f"{path}: this is no regular file, and HDF5 needs one")
    return _SafeFile(path, watch)


class _SafeGroup(h5py.Group):  # type: ignore[misc]
    """A group whose members are looked at before they are opened.

    ``root`` is the file that was asked for, ``hops`` the number of links on the way here.
    """

    root: _SafeFile
    hops = 0

    def get(self, name: Any, default: Any = None, getclass: bool = False, getlink: bool = False) -> Any:
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
            raise KeyError(f"there is no '{cleaned(_text(name))}', or it is a link that leads nowhere")
        return node

    def __contains__(self, name: Any) -> bool:
        """Tell whether there is a member that can be opened."""
        return _resolved(self, name, self.root, self.hops) is not None


class _SafeFile(_SafeGroup, h5py.File):  # type: ignore[misc]
    """A file opened with care."""

    def __init__(self, path: str, watch: FileWatch) -> None:
        watch.add(path)
        h5py.File.__init__(self, path, "r")
        self.watch = watch
        self.root = self
        self.behind_links: list[h5py.File] = []

    def close(self) -> None:
        """Close the file and those behind its links."""
        for other in (*self.behind_links, self):
            h5py.File.close(other)


def _text(name: str | bytes) -> str:
    return name.decode("utf-8", "surrogateescape") if isinstance(name, bytes) else name


def _resolved(group: Any, name: str | bytes, root: _SafeFile, hops: int) -> Any:
    """Follow a path link by link; None where it leads nowhere."""
    # a plain group: its own methods must not come back here
    here = h5py.Group(h5py.h5g.open(group.id, b"/" if _text(name).startswith("/") else b"."))
    parts = [part for part in _text(name).split("/") if part not in ("", ".")]
    for number, part in enumerate(parts):
        if not isinstance(here, h5py.Group):
            return None
        try:
            link = h5py.Group.get(here, part, getlink=True)
        except (KeyError, OSError, RuntimeError, UnicodeError):
            return None
        if isinstance(link, h5py.SoftLink | h5py.ExternalLink):
            if hops >= _MOST_HOPS:
                return None
            return _through(here, link, "/".join(parts[number + 1 :]), root, hops + 1)
        if link is None:
            return None
        try:
            here = h5py.Group.__getitem__(here, part)
        except (KeyError, OSError, RuntimeError):
            return None
    if isinstance(here, h5py.Dataset):
        check_dataset(here, root.watch)
        return here
    if not isinstance(here, h5py.Group):
        return here
    safe = _SafeGroup(here.id)
    safe.root, safe.hops = root, hops
    return safe


def _through(here: Any, link: Any, rest: str, root: _SafeFile, hops: int) -> Any:
    """Go on behind a link, in this file or another."""
    path = f"{link.path}/{rest}" if rest else link.path
    if isinstance(link, h5py.SoftLink):
        return _resolved(here, path, root, hops)
    target = _file_named(link.filename, here.file.filename)
    if target is None:
        return None
    if not stat.S_ISREG(os.stat(target).st_mode):
        raise InputError(
            f"{_name_of(here.file)}: a link in '{here.name}' leads to '{cleaned(link.filename)}', which is "
            "no regular file: take the link out, or read another file"
        )
    root.watch.add(target)
    try:
        other = h5py.File(target, "r")
    except OSError:
        return None
    root.behind_links.append(other)
    return _resolved(other, "/" + path.lstrip("/"), root, hops)


def _name_of(file: Any) -> str:
    return cleaned(_text(file.filename))


def _file_named(name: str, beside: str) -> str | None:
    """Find a file that another names, as HDF5 does: as it stands, or beside the other."""
    folder = os.path.dirname(os.path.realpath(beside))
    candidates = (os.path.join(folder, name), name, os.path.join(folder, os.path.basename(name)))
    return next(filter(os.path.exists, candidates), None)


def check_dataset(dataset: Any, watch: FileWatch) -> None:
    """Refuse a dataset that claims what it does not hold, or that takes its samples from elsewhere.

    Raises
    ------
    InputError
        Its samples are another file's (external storage), a source is missing or is the dataset itself
        (virtual), or hardly any of its samples are stored.
    """
    place = f"{_name_of(dataset.file)}: dataset '{cleaned(dataset.name or '')}'"
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
    if dataset.chunks is not None and _bytes(dataset.chunks, dataset) > _MOST_CHUNK_BYTES:
        raise InputError(
            f"{place} is stored in pieces of more than 1 GB: store it in smaller ones (h5repack)"
        )
    if _bytes(shape, dataset) < _HARMLESS_BYTES:
        return
    stored = _stored_share(dataset)
    if stored < _LEAST_STORED:
        count = " x ".join(f"{length:,}" for length in shape)
        what = "none of them" if stored == 0.0 else f"{100.0 * stored:.2g} % of them"
        raise InputError(f"{place} claims {count} samples and holds {what}: the recording was not finished")


def _bytes(shape: tuple[int, ...], dataset: Any) -> int:
    return math.prod(map(int, shape)) * int(dataset.dtype.itemsize)


def _stored_share(dataset: Any) -> float:
    """Estimate the share of the claimed samples that is stored at all."""
    claimed = _bytes(dataset.shape, dataset)
    if dataset.chunks is None:
        return float(min(1.0, dataset.id.get_storage_size() / claimed))
    try:
        pieces = dataset.id.get_num_chunks()
    except (AttributeError, OSError, RuntimeError, ValueError):  # a layout older than HDF5 1.10
        return 1.0 if dataset.id.get_storage_size() else 0.0
    return float(min(1.0, pieces * _bytes(dataset.chunks, dataset) / claimed))


def _check_virtual(dataset: Any, place: str, watch: FileWatch, above: tuple[tuple[str, str], ...]) -> None:
    own = (os.path.realpath(_text(dataset.file.filename)), dataset.name)
    if own in above or len(above) > _MOST_HOPS:
        raise InputError(f"{place} is a virtual one made of itself: it holds no samples")
    for file_name, name in _sources(dataset):
        source = _file_named(file_name, _text(dataset.file.filename)) if file_name != "." else own[0]
        if "%" in file_name + name:
            raise InputError(f"{place} is a virtual one of numbered files: join them into one file first")
        called = f"'{cleaned(name)}'" + (f" in '{cleaned(file_name)}'" if file_name != "." else "")
        missing = f"{place} is a virtual one, and its source {called} is missing"
        if source is None or not os.path.isfile(source):
            raise InputError(f"{missing}: put the file beside this one")
        if (os.path.realpath(source), "/" + name.strip("/")) in (*above, own):
            raise InputError(f"{place} is a virtual one made of itself: it holds no samples")
        watch.add(source)
        try:
            with h5py.File(source, "r") as file:
                node = _resolved_link(file, name)
                if node is None:
                    raise InputError(f"{missing} there")
                if node.is_virtual:
                    _check_virtual(node, place, watch, (*above, own))
                elif node.external:
                    raise InputError(f"{place} is a virtual one, and its source {called} is stored elsewhere")
        except OSError:
            raise InputError(f"{missing}: it cannot be opened") from None


def _resolved_link(file: Any, name: str) -> Any:
    """Return the dataset of a virtual source where it stands there by itself, no link on the way."""
    here = file
    for part in name.strip("/").split("/"):
        link = here.get(part, getlink=True) if isinstance(here, h5py.Group) else None
        if not isinstance(link, h5py.HardLink):
            return None
        here = here[part]
    return here if isinstance(here, h5py.Dataset) else None


def _sources(dataset: Any) -> Iterator[tuple[str, str]]:
    """Give each source of a virtual dataset once; every sample of it must come from one."""
    claimed = int(np.prod([float(length) for length in dataset.shape]))
    mapped, seen = 0, set()
    for source in dataset.virtual_sources():
        mapped += int(source.vspace.get_select_npoints())
        if (source.file_name, source.dset_name) not in seen:
            seen.add((source.file_name, source.dset_name))
            yield source.file_name, source.dset_name
    if mapped < claimed:
        raise InputError(
            f"{_name_of(dataset.file)}: dataset '{cleaned(dataset.name)}' is a virtual one with sources for "
            f"{mapped:,} of its {claimed:,} samples"
        )
