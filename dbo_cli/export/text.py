"""Text of exported files: templates, and numbers, arrays and names as C."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from string import Template
from typing import Any

from dbo_cli.errors import UsageError

_IDENTIFIER = re.compile(r"(?!dboq?_)[A-Za-z][A-Za-z0-9_]{0,39}")  # dbo_: the kernel's
_KEYWORDS = frozenset(
    """
    auto break case char const continue default do double else enum extern float for goto if inline
    int long register restrict return short signed sizeof static struct switch typedef union unsigned
    void volatile while
    """.split()
)  # of C99
_LINE = 108  # characters of a line of numbers


@dataclass(frozen=True)
class SelfTestRun:
    """One run of the self-test as C constants: the drive given to reset (None: init), inputs, outputs."""

    reset: str | None
    inputs: Sequence[str]
    outputs: Sequence[str]


@dataclass
class Sources:
    """What a model puts into its sources, in one arithmetic.

    Attributes
    ----------
    kernel : list of str
        The kernel's files that are used.
    members, tables, init, reset, step : list of str
        Members of the state, tables, and the statements of three functions.
    values : dict
        What the templates are filled with.
    runs : list of SelfTestRun
        The self-test.
    """

    kernel: list[str]
    members: list[str] = field(default_factory=list)
    tables: list[str] = field(default_factory=list)
    init: list[str] = field(default_factory=list)
    reset: list[str] = field(default_factory=list)
    step: list[str] = field(default_factory=list)
    values: dict[str, str] = field(default_factory=dict)
    runs: list[SelfTestRun] = field(default_factory=list)


def kernel_file(name: str) -> str:
    """Return the text of a file of the kernel: a template of this room, or the package's own."""
    folder = resources.files("dbo_cli.model")
    if name.startswith(("dbo_q31", "dbo_lookup")):
        folder = resources.files("dbo_cli.export") / "templates"
    return (folder / name).read_text(encoding="utf-8")


def fill(template: str, values: Mapping[str, str]) -> str:
    """Return a file of ``templates`` filled in; lines on which nothing is left go."""
    folder = resources.files("dbo_cli.export") / "templates"
    text = (folder / template).read_text(encoding="utf-8")
    for name, value in values.items():
        if not value:
            text = text.replace(f"\n${name}\n", "\n")
    return Template(text).substitute(values)


def plain(text: str) -> str:
    """Return text on one line that cannot end the comment it stands in, nor begin another."""
    line = "".join(letter if letter.isprintable() else " " for letter in text)
    return line.replace("*/", "* /").replace("/*", "/ *").replace("$", " ")


def check_name(name: str) -> None:
    """Refuse a name that cannot begin the names of files, types and functions.

    Raises
    ------
    UsageError
        It is no identifier of C, or begins as the kernel's names do.
    """
    if not _IDENTIFIER.fullmatch(name) or name in _KEYWORDS:
        raise UsageError(
            f"`name` {name}: give a C identifier of at most 40 letters, digits and underscores, no "
            "keyword"
        )


def real(value: float) -> str:
    """Return a C99 constant that is this float64 to the bit."""
    return float(value).hex()


def whole(value: int) -> str:
    """Return a C constant; the least 32-bit and 64-bit numbers have no literal of their own."""
    value = int(value)
    if value == -(2**31):
        return "(-2147483647 - 1)"
    if value == -(2**63):
        return "(-INT64_C(9223372036854775807) - 1)"
    if abs(value) < 2**31:
        return str(value)
    return f"INT64_C({value})"


def array(kind: str, name: str, items: Sequence[str]) -> str:
    """Return the definition of a constant array, private to its file."""
    lines = textwrap.wrap(
        ", ".join(items), _LINE, break_long_words=False, break_on_hyphens=False
    )
    body = textwrap.indent("\n".join(lines), "    ")
    return f"static const {kind} {name}[{len(items)}] = {{\n{body}}};\n"


def reals(name: str, values: Iterable[float]) -> str:
    """Return the definition of an array of float64."""
    return array("double", name, [real(value) for value in values])


def structs(
    rows: Iterable[Iterable[Any]], constant: Callable[[Any], str] = str
) -> list[str]:
    """Return initialisers of structures, each value written as a ``constant``."""
    return ["{" + ", ".join(map(constant, row)) + "}" for row in rows]


def words_of(bits: int, gears: int, width: int) -> list[str]:
    """Return bits as C constants of ``width`` bits; empty where none is set."""
    if not bits:
        return []
    mask = (1 << width) - 1
    form = "UINT64_C(0x{:x})" if width == 64 else "0x{:x}U"
    count = -(-gears // width)
    return [form.format(bits >> width * k & mask) for k in range(count)]
