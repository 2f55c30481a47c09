"""JSON objects that are read key by key, and JSON text that people and ``diff`` can read.

What is missing, unknown, twice in one object or out of range is refused with file and
path of the key: ``model.json: stages[0].dx[3]: -0.1 is not a finite width greater than 0``.

A reader is a function of a JSON value and the path of its key. It returns what the value
stands for, or raises ModelError with the path.
"""

import json
import math
import sys
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from dbo_cli.arrays import Range
from dbo_cli.errors import InputError, ModelError
from dbo_cli.files import note_input

Json = dict[str, Any]
Reader = Callable[[Any, str], Any]

VERSION = 1
STANDARD_INPUT = "standard input"  # what messages call ``-``
# every number is below: 1e60 at most, products of five of them are still within float64
LARGEST = math.nextafter(1e60, math.inf)
# a file of some bytes must not ask for more memory than a machine has
MOST_WIDTHS = 1_000_000
SHOWN = 40  # characters of a value in a message
LINE = 100  # characters, after which the next line of a list begins


# ---- reading ----


def load(path: str, noun: str) -> tuple[str, Any]:
    """Return the name of a JSON file (``-`` is standard input) as messages say it, and its values.

    Raises
    ------
    InputError
        The file cannot be read.
    ModelError
        It is not JSON, or not whole, or a key occurs twice in one object.
    """
    name = STANDARD_INPUT if path == "-" else path

    def distinct(pairs: list[tuple[str, Any]]) -> Json:
        values = dict(pairs)
        if len(values) < len(pairs):
            keys = [key for key, _ in pairs]
            twice = next(key for key in keys if keys.count(key) > 1)
            raise ModelError(f"{name}: {twice}: occurs twice in one object")
        return values

    def constant(text: str) -> float:
        raise ModelError(f"{name}: {text} is not a number")

    note_input(path, noun)
    try:
        content = sys.stdin.buffer.read() if path == "-" else Path(path).read_bytes()
        return name, json.loads(
            content, object_pairs_hook=distinct, parse_constant=constant
        )
    except OSError as problem:
        reason = problem.strerror or problem
        raise InputError(f"{name}: cannot be read: {reason}") from None
    except (ValueError, RecursionError) as problem:
        line = getattr(problem, "lineno", 1)
        raise ModelError(
            f"{name}: line {line}: not the JSON of a {noun}, or the file ends too early"
        ) from None


def contents(values: Any, path: str, form: str, noun: str) -> Json:
    """Return what stands behind format and version, which must be of ``form``."""
    fields = dict(notes(values, path or "the file"))
    if fields.pop("format", None) != form:
        raise ModelError(f'{_join(path, "format")}: must be "{form}" in {noun}')
    version = fields.pop("version", None)
    if type(version) is not int or version != VERSION:
        raise ModelError(
            f"{_join(path, 'version')}: {shown(version)} is not version {VERSION}: make {noun} again"
        )
    return fields


def members(values: Any, form: str, key: str, noun: str) -> Json:
    """Return what a set of ``form`` holds for each channel, under ``key``."""
    content = contents(values, "", form, noun)
    channels: Json = build(dict, content, "", **{key: notes})[key]
    if not channels:
        raise ModelError(f"{key}: is empty")
    return channels


def build(
    make: Callable[..., Any],
    values: Any,
    path: str,
    optional: tuple[str, ...] = (),
    /,
    **readers: Reader,
) -> Any:
    """Return what ``make`` builds of the keys of an object.

    Parameters
    ----------
    make : callable
        Takes what was read under the names of the keys. The path is put before what it
        complains about.
    values : object
        Of the JSON file.
    path : str
        Leads to them.
    optional : tuple of str
        Keys that may be missing.
    **readers
        How each key is read.
    """
    parts = {}
    values = notes(values, path)
    for key, read in readers.items():
        if key in values:
            parts[key] = read(values[key], _join(path, key))
        elif key not in optional:
            raise ModelError(f"{_join(path, key)}: is missing")
    for key in values:
        if key not in readers:
            raise ModelError(f"{_join(path, key)}: is not a known key")
    try:
        return make(**parts)
    except ModelError as problem:
        raise ModelError(_join(path, str(problem))) from None


def _join(path: str, key: str) -> str:
    """Return the path of a key below another path."""
    return f"{path}.{key}" if path else key


def shown(value: object) -> str:
    """Return a JSON value as a message shows it."""
    text = json.dumps(value)
    return text if len(text) <= SHOWN else f"{text[:SHOWN]}..."


def number(
    value: Any, path: str, above: float = -LARGEST, below: float = LARGEST
) -> float:
    """Return a number between two others."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or not above < value < below:
        raise ModelError(
            f"{path}: {shown(value)} is not a number between {above:g} and {below:g}"
        )
    return float(value)


above_0 = partial(number, above=0.0)


def magnitude(value: Any, path: str) -> float:
    """Return a number of at least 0: an error, a duration."""
    return above_0(value, path) if value else abs(number(value, path))


def interval(value: Any, path: str) -> Range:
    """Return the two ends of a range, the lower one first."""
    ends = number_list(value, path)
    if len(ends) != 2 or ends[0] > ends[1]:
        raise ModelError(f"{path}: is not a list of two numbers, the lower one first")
    return ends[0], ends[1]


def text(value: Any, path: str) -> str:
    """Return a text."""
    if not isinstance(value, str) or not value.isprintable():
        raise ModelError(f"{path}: {shown(value)} is not a text")
    return value


def notes(value: Any, path: str) -> Json:
    """Return an object that is carried along as it is."""
    if not isinstance(value, dict):
        raise ModelError(f"{path}: is not an object")
    return value


def choice(value: Any, path: str, choices: tuple[str, ...]) -> str:
    """Return one of some texts."""
    if value not in choices:
        raise ModelError(f"{path}: {value!r} is not one of {', '.join(choices)}")
    return str(value)


def unless_null(read: Reader) -> Reader:
    """Return a reader that returns None for null."""
    return lambda value, path: None if value is None else read(value, path)


def listed(items: Any, path: str, read: Reader) -> tuple[Any, ...]:
    """Return the items of a list, each as ``read`` returns it."""
    if not isinstance(items, list | tuple):
        raise ModelError(f"{path}: is not a list")
    return tuple(read(item, f"{path}[{k}]") for k, item in enumerate(items))


def number_list(items: Any, path: str) -> tuple[float, ...]:
    """Return a list of finite numbers."""
    return listed(items, path, number)


def widths(items: Any, path: str) -> list[float]:
    """Return widths, of which a run of equal ones may stand once (``repeat`` and ``value``)."""
    values: list[float] = []

    def read(item: Any, path: str) -> None:
        run = {"repeat": 1, "value": item}
        if isinstance(item, dict):
            run = build(dict, item, path, repeat=lambda count, _: count, value=above_0)
        count = run["repeat"]
        if type(count) is not int or not 1 <= count <= MOST_WIDTHS - len(values):
            raise ModelError(
                f"{path}.repeat: is not a whole number from 1 on, or more than {MOST_WIDTHS:,} widths in all"
            )
        values.extend([above_0(run["value"], path)] * count)

    listed(items, path, read)
    return values


# ---- what is read and written alike ----


class Keyed:
    """What stands in a file as an object, whose keys are its attributes.

    Attributes
    ----------
    KEYS : mapping
        How each key is read, in the order in which they are written.
    OPTIONAL : tuple of str
        Keys that may be missing: they are, where nothing stands for them.
    """

    KEYS: ClassVar[Mapping[str, Reader]] = {}
    OPTIONAL: ClassVar[tuple[str, ...]] = ()

    @classmethod
    def read(cls, values: Any, path: str) -> Any:
        """Return what an object describes."""
        return build(cls, values, path, cls.OPTIONAL, **cls.KEYS)

    def keys(self) -> Json:
        """Return the keys and plain values."""
        values = {}
        for key in self.KEYS:
            value = getattr(self, key)
            if key not in self.OPTIONAL or value:
                values[key] = _plain(value)
        return values


def _plain(value: Any) -> Any:
    """Return a value as JSON has it."""
    if isinstance(value, Keyed):
        return value.keys()
    if isinstance(value, tuple | np.ndarray):
        return [_plain(item) for item in value]
    return value if value is None or isinstance(value, str) else float(value)


# ---- writing ----


def dumps(values: Json) -> str:
    """Return JSON text with short objects in one line, and filled lines of a long list."""
    return _layout(values, "") + "\n"


def _layout(value: Any, indent: str) -> str:
    flat = json.dumps(value, ensure_ascii=False, allow_nan=False)
    if len(indent) + len(flat) <= LINE or not isinstance(value, dict | list | tuple):
        return flat
    inner = indent + "  "
    if not isinstance(value, dict):
        lines = _filled([_layout(item, inner) for item in value])
        return f"[\n{inner}" + f",\n{inner}".join(lines) + f"\n{indent}]"
    lines = []
    for key, item in value.items():
        name = json.dumps(key, ensure_ascii=False)
        lines.append(f"{name}: {_layout(item, inner)}")
    return f"{{\n{inner}" + f",\n{inner}".join(lines) + f"\n{indent}}}"


def _filled(items: list[str]) -> list[str]:
    """Return items joined to lines of at most ``LINE`` characters."""
    lines = [items[0]]
    for item in items[1:]:
        if len(lines[-1]) + len(item) > LINE:
            lines.append(item)
        else:
            lines[-1] += f", {item}"
    return lines
