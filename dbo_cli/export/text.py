"""Text of exported files: templates, and numbers, arrays and names as C."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from string import Template

from dbo_cli.errors import UsageError

_IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_LONGEST = 40  # characters of a name; linkers and disks hold more
_TAKEN = ("dbo_", "dboq_", "int8_t", "int16_t", "int32_t", "int64_t", "size_t", "uint")
_RESERVED = frozenset(
    """
    alignas alignof and and_eq asm auto bitand bitor bool break case catch char char8_t char16_t
    char32_t class compl concept const consteval constexpr constinit const_cast continue co_await
    co_return co_yield decltype default delete do double dynamic_cast else enum explicit export
    extern false float for friend goto if inline int long mutable namespace new noexcept not not_eq
    nullptr operator or or_eq private protected public register reinterpret_cast requires restrict
    return short signed sizeof static static_assert static_cast struct switch template this
    thread_local throw true try typedef typeid typename typeof union unsigned using virtual void
    volatile wchar_t while xor xor_eq main setup loop errno assert offsetof stdin stdout stderr
    """.split()
)  # words of C and C++, and names that every program has
_LINE = 108  # characters of a line of numbers


@dataclass(frozen=True)
class Run:
    """One run of the self-test as C constants: the drive given to reset (None: init), inputs, outputs."""

    reset: str | None
    inputs: Sequence[str]
    outputs: Sequence[str]


@dataclass(frozen=True)
class Sources:
    """What a model puts into its sources, in one arithmetic.

    Attributes
    ----------
    values : dict
        What the template of NAME.c is filled with.
    members : list of str
        Members of the state.
    kernel : list of str
        The kernel's files that are used.
    runs : list of Run
        The self-test.
    """

    values: dict[str, str]
    members: list[str]
    kernel: list[str]
    runs: list[Run]


def own_file(name: str) -> str:
    """Return the text of a file of ``templates``."""
    folder = resources.files("dbo_cli.export") / "templates"
    return (folder / name).read_text(encoding="utf-8")


def kernel_file(name: str) -> str:
    """Return the text of a file of the kernel: one of this room, or the package's own, unchanged."""
    if name.startswith(("dbo_q31", "dbo_lookup")):
        return own_file(name)
    return (resources.files("dbo_cli.model") / name).read_text(encoding="utf-8")


def fill(template: str, values: Mapping[str, str]) -> str:
    """Return a file of ``templates`` filled in; lines on which nothing is left go."""
    text = own_file(template)
    for name, value in values.items():
        if not value:
            text = text.replace(f"\n${name}\n", "\n")
    return Template(text).substitute(values)


def plain(text: str) -> str:
    """Return text on one line that cannot end the comment it stands in, nor begin another."""
    words = "".join(letter if letter.isprintable() else " " for letter in text)
    return words.replace("*/", "* /").replace("/*", "/ *").replace("$", " ")


def check_name(name: str) -> None:
    """Refuse a name that cannot begin the names of files, types and functions in C, C++ and on every disk.

    Raises
    ------
    UsageError
        It is no identifier, reserved, or taken by the files that are exported beside
        it.
    """
    why = ""
    if not _IDENTIFIER.fullmatch(name):
        why = (
            "is no C identifier (a letter first, then letters, digits and underscores)"
        )
    elif len(name) > _LONGEST:
        why = f"has {len(name)} characters; at most {_LONGEST} are allowed"
    elif name.lower() in _RESERVED:
        why = "is a reserved word of C or C++ (choose another)"
    elif name.lower().startswith(_TAKEN):
        why = "is taken by the files of the export (choose another)"
    if why:
        raise UsageError(f"`name` {name!r}: {why}")


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
    lines = textwrap.fill(
        ", ".join(items),
        _LINE,
        initial_indent="    ",
        subsequent_indent="    ",
        break_long_words=False,
        break_on_hyphens=False,
    )
    return f"static const {kind} {name}[{len(items)}] = {{\n{lines}}};\n"


def reals(name: str, values: Iterable[float]) -> str:
    """Return the definition of an array of float64."""
    return array("double", name, [real(value) for value in values])


def structs(rows: Iterable[Iterable[str]]) -> list[str]:
    """Return initialisers of structures."""
    return ["{" + ", ".join(row) + "}" for row in rows]


def real_structs(rows: Iterable[Iterable[float]]) -> list[str]:
    """Return initialisers of structures of float64."""
    return structs([real(value) for value in row] for row in rows)


def words_of(bits: int, gears: int, width: int) -> list[str]:
    """Return bits as C constants of ``width`` bits; empty where none is set."""
    if not bits:
        return []
    mask = (1 << width) - 1
    form = "UINT64_C(0x{:x})" if width == 64 else "0x{:x}U"
    count = -(-gears // width)
    return [form.format(bits >> width * k & mask) for k in range(count)]
