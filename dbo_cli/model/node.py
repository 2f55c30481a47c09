"""JSON objects that are read key by key, and JSON text that people and ``diff`` can read.

What is missing, unknown, twice there or out of range is refused with file and path of
the key: ``model.json: stages[0].dx[3]: -0.1 is not a finite width greater than 0``.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from dbo_cli.errors import InputError, ModelError

Json = dict[str, Any]
Made = TypeVar("Made")
Parts = ParamSpec("Parts")

VERSION = 1
LARGEST = 1e60  # of every number: products of five of them are still within float64
# a file of some bytes must not ask for more memory than a machine has
MOST_WIDTHS = 1_000_000
LINE = 100  # characters, after which the next line of a list begins


class Node:
    """One JSON object with the path that leads to it.

    Every key is asked for by name; ``build`` refuses those that nobody asked for.

    Raises
    ------
    ModelError
        From every method, where the key is not as it must be.
    """

    def __init__(self, file: str, path: str, values: object) -> None:
        self.file = file
        self.path = path
        if not isinstance(values, dict):
            raise self.refuse("", "is not an object")
        self.values: Json = values
        self.asked: set[str] = set()

    def at(self, key: str) -> str:
        """Return the path of a key; an empty key is the object itself."""
        if self.path and key and not key.startswith("["):
            return f"{self.path}.{key}"
        return self.path + key

    def refuse(self, key: str, what: str) -> ModelError:
        """Return the error for a key."""
        return ModelError(f"{self.file}: {self.at(key) or 'the file'}: {what}")

    def build(
        self,
        make: Callable[Parts, Made],
        *parts: Parts.args,
        **named: Parts.kwargs,
    ) -> Made:
        """Return what ``make`` builds of the parts read; put file and path before what it complains about."""
        for key in self.values:
            if key not in self.asked:
                raise self.refuse(key, "is not a known key")
        try:
            return make(*parts, **named)
        except ModelError as problem:
            raise ModelError(f"{self.file}: {self.at(str(problem))}") from None

    def require_format(self, wanted: str, noun: str) -> None:
        """Refuse another format or version."""
        self.asked.add("format")
        if self.values.get("format") != wanted:
            raise self.refuse("format", f'must be "{wanted}" in {noun}')
        version = self.value("version")
        if isinstance(version, bool) or version != VERSION:
            raise self.refuse(
                "version",
                f"{version} is not version {VERSION}: make {noun} again",
            )

    def has(self, key: str) -> bool:
        """Tell whether a key is there that may be left out."""
        self.asked.add(key)
        return key in self.values

    def value(self, key: str) -> Any:
        """Return whatever a key holds."""
        if not self.has(key):
            raise self.refuse(key, "is missing")
        return self.values[key]

    def unless_null(self, key: str, read: Callable[[str], Made]) -> Made | None:
        """Return what ``read`` finds under a key, or None where it holds null."""
        if self.value(key) is None:
            return None
        return read(key)

    def number(self, key: str) -> float:
        """Return a finite number."""
        return self.finite(key, self.value(key))

    def finite(self, key: str, value: object) -> float:
        """Return a value as a finite number."""
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.refuse(key, f"{json.dumps(value)[:60]} is not a number")
        if not -LARGEST <= value <= LARGEST:
            raise self.refuse(
                key, f"{str(value)[:60]} is not a finite number up to {LARGEST:g}"
            )
        return float(value)

    def text(self, key: str) -> str:
        """Return a text."""
        value = self.value(key)
        if not isinstance(value, str) or not value.isprintable():
            raise self.refuse(key, f"{json.dumps(value)[:60]} is not a text")
        return value

    def choice(self, key: str, *words: str) -> str:
        """Return one of some words."""
        value = self.value(key)
        if value not in words:
            raise self.refuse(key, f"{value!r} is not one of {', '.join(words)}")
        return str(value)

    def listed(self, key: str) -> list[Any]:
        """Return a list."""
        items = self.value(key)
        if not isinstance(items, list):
            raise self.refuse(key, "is not a list")
        return items

    def numbers(self, key: str) -> tuple[float, ...]:
        """Return a list of finite numbers."""
        items = enumerate(self.listed(key))
        return tuple(self.finite(f"{key}[{k}]", item) for k, item in items)

    def widths(self, key: str) -> list[float]:
        """Return widths, of which a run of equal ones may stand once (``repeat`` and ``value``)."""
        widths: list[float] = []
        for place, item in enumerate(self.listed(key)):
            at = f"{key}[{place}]"
            if not isinstance(item, dict):
                widths.append(self.finite(at, item))
                continue
            run = Node(self.file, self.at(at), item)
            count, value = run.value("repeat"), run.number("value")
            if type(count) is not int or not 1 <= count <= MOST_WIDTHS:
                raise run.refuse(
                    "repeat", f"is not a whole number from 1 to {MOST_WIDTHS:,}"
                )
            run.build(widths.extend, [value] * count)
            if len(widths) > MOST_WIDTHS:
                raise self.refuse(key, f"has more than {MOST_WIDTHS:,} entries")
        return widths

    def node(self, key: str) -> Node:
        """Return the object under a key."""
        return Node(self.file, self.at(key), self.value(key))

    def nodes(self, key: str) -> list[Node]:
        """Return a list of objects."""
        nodes = []
        for place, item in enumerate(self.listed(key)):
            nodes.append(Node(self.file, self.at(f"{key}[{place}]"), item))
        return nodes

    def notes(self, key: str) -> Json:
        """Return an object that is carried along as it is; empty where there is none."""
        if not self.has(key):
            return {}
        return self.node(key).values


def load(path: str, noun: str) -> tuple[str, Any]:
    """Return the name of a JSON file (``-`` is standard input) as messages say it, and its values.

    Raises
    ------
    InputError
        The file cannot be read.
    ModelError
        It is not JSON, or not whole, or a key occurs twice in one object.
    """
    name = "standard input" if path == "-" else path

    def distinct(pairs: list[tuple[str, Any]]) -> Json:
        values = dict(pairs)
        if len(values) < len(pairs):
            keys = [key for key, _ in pairs]
            twice = next(key for key in keys if keys.count(key) > 1)
            raise ModelError(f"{name}: {twice}: occurs twice in one object")
        return values

    def constant(text: str) -> float:
        raise ModelError(f"{name}: {text} is not a number")

    try:
        content = sys.stdin.buffer.read() if path == "-" else Path(path).read_bytes()
        return name, json.loads(
            content, object_pairs_hook=distinct, parse_constant=constant
        )
    except OSError as problem:
        reason = problem.strerror or problem
        raise InputError(f"{name}: cannot be read: {reason}") from None
    except json.JSONDecodeError as problem:
        if problem.pos == 0:
            remedy = " (identify makes a model from a log)" if noun == "model" else ""
            raise ModelError(
                f"{name}: not a {noun} file: it is not JSON{remedy}"
            ) from None
        raise ModelError(
            f"{name}: line {problem.lineno}: not valid JSON, or the file ends too early"
        ) from None
    except (ValueError, RecursionError):
        raise ModelError(f"{name}: not readable as JSON") from None


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
