"""Text of exported files: templates, and numbers, arrays and names as C."""

import re
import textwrap
from collections.abc import Callable, Iterable, Mapping
from importlib import resources
from string import Template
from typing import Any, NamedTuple

from dbo_cli.export.plan import SelfTestRun

Constant = Callable[[Any], str]
"""Writes a number as C."""
_LINES = textwrap.TextWrapper(
    112, "    ", "    ", break_long_words=False, break_on_hyphens=False
)  # of numbers
_VALUE = re.compile(r"\$\{?([A-Z0-9_]+)")  # in a template


class Sources(NamedTuple):
    """What a model puts into its sources, in one arithmetic.

    Attributes
    ----------
    kernel : list of str
        The kernel's files that are used.
    runs : list of SelfTestRun
        The self-test.
    input, drive : callable
        Write a number that goes in, or comes out, as C.
    tables : str
        Constant tables.
    numbers : dict
        Numbers and switches of NAME.c, by their names there.
    values : dict
        Sizes of the state, and what else the templates are filled with.
    bounds : dict
        How far the numbers can be from the library's; empty: they are the same.
    """

    kernel: list[str]
    runs: list[SelfTestRun]
    input: Constant
    drive: Constant
    tables: str
    numbers: dict[str, str]
    values: dict[str, str]
    bounds: Mapping[str, float] = {}


def template_text(name: str) -> str:
    """Return a file of the kernel, or of this room's templates."""
    folder = resources.files("dbo_cli.export") / "templates"
    if name.startswith("dbo_") and not name.startswith(("dbo_q31", "dbo_lookup")):
        folder = resources.files("dbo_cli.model")
    return (folder / name).read_text(encoding="utf-8")


def fill(template: str, values: Mapping[str, str]) -> str:
    """Return a template filled in; a line goes where it names a value that is empty or missing."""
    kept = []
    for line in template_text(template).splitlines(keepends=True):
        if all(values.get(name) for name in _VALUE.findall(line)):
            kept.append(line)
    text = Template("".join(kept)).substitute(values)
    return re.sub("\n{3,}", "\n\n", text)


def plain(text: str) -> str:
    """Return text on one line that cannot end the comment it stands in, nor begin another."""
    line = "".join(letter if letter.isprintable() else " " for letter in text)
    return line.replace("*/", "* /").replace("/*", "/ *").replace("$", " ")


def real(value: float) -> str:
    """Return a C99 constant that is this float64 to the bit."""
    return float(value).hex()


def whole(value: int) -> str:
    """Return a C constant; the least number of 32 bits has no literal of its own."""
    value = int(value)
    if value == -(2**31):
        return "(-2147483647 - 1)"
    return str(value) if abs(value) < 2**31 else f"INT64_C({value})"


def array(kind: str, name: str, rows: Iterable[Any], constant: Constant = str) -> str:
    """Return the definition of a constant array, private to its file: of numbers, or of structures."""
    items = []
    for row in rows:
        if isinstance(row, Iterable) and not isinstance(row, str):
            items.append("{" + ", ".join(map(constant, row)) + "}")
        else:
            items.append(constant(row))
    body = _LINES.fill(", ".join(items))
    return f"static const {kind} {name}[{len(items)}] = {{\n{body}}};\n"


def spare(bits: int, gears: int, width: int) -> tuple[str, str]:
    """Return the bits of gears as an array of words of ``width`` bits, and its name; 0 where none is set."""
    if not bits:
        return "", "0"
    mask = (1 << width) - 1
    form = "UINT64_C(0x{:x})" if width == 64 else "0x{:x}U"
    words = [form.format(bits >> k & mask) for k in range(0, gears, width)]
    return array(f"uint{width}_t", "spare", words), "spare"
