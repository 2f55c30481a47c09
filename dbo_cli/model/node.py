"""JSON objects that are read key by key, and JSON text that people and ``diff`` can read.

What is missing, unknown, twice there or out of range is refused with file and path of
the key: ``model.json: stages[0].dx[3]: -0.1 is not a finite width greater than 0``.
"""

from __future__ import annotations

import json
import math
import sys
import textwrap
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from dbo_cli.errors import InputError, ModelError

Json = dict[str, Any]
Made = TypeVar("Made")

LARGEST = 1e60  # of every number: products of five of them are still within float64
# a file of some bytes must not ask for more memory than a machine has
MOST_WIDTHS = 1_000_000
# equal widths in a row are written once from this many on: two are shorter as they are
SHORTEST_RUN = 3
LINE = 100  # characters, after which the next line of a list begins
# objects within one another in what is carried along: a bound for recursion
_NOTE_DEPTH = 20


class Node(NamedTuple):
    """One JSON object with the path that leads to it."""

    file: str
    path: str
    values: Json

    def at(self, key: str) -> str:
        """Return the path of a key."""
        if not self.path or not key:
            return self.path + key
        if key.startswith("["):
            return f"{self.path}{key}"
        return f"{self.path}.{key}"

    def refuse(self, key: str, what: str) -> ModelError:
        """Return the error for a key; an empty key is the object itself."""
        return ModelError(f"{self.file}: {self.at(key) or 'the file'}: {what}")

    def only(self, required: tuple[str, ...], optional: tuple[str, ...] = ()) -> None:
        """Refuse missing and unknown keys."""
        for key in required:
            if key not in self.values:
                raise self.refuse(key, "is missing")
        for key in self.values:
            if key not in required and key not in optional:
                raise self.refuse(key, "is not a known key")

    def build(self, make: Callable[[], Made]) -> Made:
        """Return what ``make`` builds; put file and path before the key it complains about."""
        try:
            return make()
        except ModelError as problem:
            raise ModelError(f"{self.file}: {self.at(str(problem))}") from None

    def number(self, key: str) -> float:
        """Return a finite number."""
        return self.finite(key, self.values[key])

    def finite(self, key: str, value: object) -> float:
        """Return a value as a finite number."""
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.refuse(key, f"{json.dumps(value)[:60]} is not a number")
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            raise self.refuse(key, f"{number!r} is not a finite number")
        if abs(number) > LARGEST:
            raise self.refuse(key, f"{number!r} is beyond {LARGEST:g}")
        return number

    def listed(self, key: str, what: str) -> list[Any]:
        """Return a list of ``what``."""
        values = self.values[key]
        if not isinstance(values, list):
            raise self.refuse(key, f"is not a list of {what}")
        return values

    def numbers(self, key: str) -> tuple[float, ...]:
        """Return a list of finite numbers."""
        items = self.listed(key, "numbers")
        return tuple(self.finite(f"{key}[{k}]", item) for k, item in enumerate(items))

    def widths(self, key: str) -> list[float]:
        """Return widths, of which a run of equal ones may stand once (``repeat`` and ``value``)."""
        numbers: list[float] = []
        for place, item in enumerate(self.listed(key, "numbers")):
            at = f"{key}[{place}]"
            count = 1
            if isinstance(item, dict):
                run = self.below(at, item)
                run.only(("repeat", "value"))
                count = run.count("repeat")
                value = run.number("value")
            else:
                value = self.finite(at, item)
            if len(numbers) + count > MOST_WIDTHS:
                raise self.refuse(key, f"has more than {MOST_WIDTHS:,} entries")
            numbers.extend([value] * count)
        return numbers

    def count(self, key: str) -> int:
        """Return a whole number of at least 1."""
        value = self.values[key]
        if isinstance(value, bool) or not isinstance(value, int) or value < 1:
            raise self.refuse(
                key, f"{json.dumps(value)[:60]} is not a whole number of at least 1"
            )
        return value

    def text(self, key: str) -> str:
        """Return a string."""
        value = self.values[key]
        if not isinstance(value, str):
            raise self.refuse(key, f"{json.dumps(value)[:60]} is not a text")
        if not value.isprintable():
            raise self.refuse(
                key, f"{json.dumps(value)} holds characters that cannot be shown"
            )
        return value

    def node(self, key: str) -> Node:
        """Return the object under a key."""
        return self.below(key, self.values[key])

    def below(self, key: str, value: object) -> Node:
        """Return an object that stands below this one under the name ``key``."""
        if not isinstance(value, dict):
            raise self.refuse(key, "is not an object")
        return Node(self.file, self.at(key), value)

    def nodes(self, key: str) -> list[Node]:
        """Return a list of objects."""
        items = self.listed(key, "objects")
        return [self.below(f"{key}[{k}]", item) for k, item in enumerate(items)]

    def notes(self, key: str) -> Json:
        """Return an object that is carried along; refuse what could not be written again."""
        if key not in self.values:
            return {}
        node = self.node(key)
        node.check_notes(_NOTE_DEPTH)
        return node.values

    def check_notes(self, depth: int) -> None:
        """Refuse numbers that are not finite, and objects within too many others."""
        for key, value in self.values.items():
            if isinstance(value, float) and not math.isfinite(value):
                raise self.refuse(key, f"{value!r} is not a finite number")
            if isinstance(value, list):
                value = {f"[{k}]": item for k, item in enumerate(value)}
            if isinstance(value, dict):
                if depth == 0:
                    raise self.refuse(key, "is nested too deeply")
                Node(self.file, self.at(key), value).check_notes(depth - 1)


def load(path: str, noun: str) -> tuple[str, Any]:
    """Return the name of a JSON file (``-`` is standard input) as messages say it, and its values.

    Raises
    ------
    InputError
        The file cannot be read.
    ModelError
        It is not JSON, or a key occurs twice in one object.
    """
    name = "standard input" if path == "-" else path
    try:
        content = sys.stdin.buffer.read() if path == "-" else Path(path).read_bytes()
    except OSError as problem:
        reason = problem.strerror or problem
        raise InputError(f"{name}: cannot be read: {reason}") from None
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as problem:
        raise ModelError(
            f"{name}: not a {noun} file: byte {problem.start + 1} is not UTF-8"
        ) from None
    return name, parse(name, text, noun)


def parse(name: str, text: str, noun: str) -> Any:
    """Return the values of JSON text; see ``load``."""
    if text.lstrip()[:1] not in ("{", "["):
        remedy = " (identify makes a model from a log)" if noun == "model" else ""
        raise ModelError(f"{name}: not a {noun} file: it is not JSON{remedy}")

    def distinct(pairs: list[tuple[str, Any]]) -> Json:
        values: Json = {}
        for key, value in pairs:
            if key in values:
                raise ModelError(f"{name}: {key}: occurs twice in one object")
            values[key] = value
        return values

    try:
        values = json.loads(text, object_pairs_hook=distinct)
        # raises at half a surrogate pair, which could not be written again
        if "\\u" in text:
            json.dumps(values, ensure_ascii=False).encode()
    except json.JSONDecodeError as problem:
        rest = text[problem.pos :].strip()
        if not rest or problem.msg.startswith("Unterminated string"):
            lines = len(text.splitlines())
            raise ModelError(
                f"{name}: incomplete file (ends at line {lines})"
            ) from None
        raise ModelError(
            f"{name}: line {problem.lineno}: not valid JSON: {problem.msg}"
        ) from None
    except (ValueError, RecursionError):
        raise ModelError(f"{name}: not readable as JSON") from None
    return values


def runs_of(widths: list[float]) -> list[float | Json]:
    """Return widths with every run of equal ones written once."""
    written: list[float | Json] = []
    begin = 0
    for end in range(1, len(widths) + 1):
        if end < len(widths) and widths[end] == widths[begin]:
            continue
        count = end - begin
        if count >= SHORTEST_RUN:
            written.append({"repeat": count, "value": widths[begin]})
        else:
            written.extend(widths[begin:end])
        begin = end
    return written


def dumps(values: Mapping[str, Any]) -> str:
    """Return JSON with one line for a short object and filled lines for a long list of numbers."""
    return _layout(values, "") + "\n"


def _layout(value: Any, indent: str) -> str:
    flat = json.dumps(value, ensure_ascii=False, allow_nan=False)
    if not value or not isinstance(value, Mapping | list):
        return flat
    if len(indent) + len(flat) <= LINE:
        return flat
    inner = indent + "  "
    if isinstance(value, Mapping):
        lines = []
        for key, item in value.items():
            name = json.dumps(key, ensure_ascii=False)
            lines.append(f"{inner}{name}: {_layout(item, inner)}")
        return "{\n" + ",\n".join(lines) + f"\n{indent}}}"
    if all(_is_number_or_run(item) for item in value):
        return f"[\n{_filled(value, inner)}\n{indent}]"
    lines = [inner + _layout(item, inner) for item in value]
    return "[\n" + ",\n".join(lines) + f"\n{indent}]"


def _is_number_or_run(item: Any) -> bool:
    if isinstance(item, Mapping):
        return item.keys() == {"repeat", "value"}
    return isinstance(item, int | float)


def _filled(items: list[Any], indent: str) -> str:
    """Return items with commas between them, in lines of at most ``LINE`` characters where they fit."""
    # a line does not end inside an item
    whole = [json.dumps(item, ensure_ascii=False).replace(" ", "\0") for item in items]
    lines = textwrap.fill(
        ", ".join(whole),
        LINE,
        initial_indent=indent,
        subsequent_indent=indent,
        break_long_words=False,
        break_on_hyphens=False,
    )
    return lines.replace("\0", " ")
