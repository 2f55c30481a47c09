"""C source text: numbers that read back to the same bits, arrays, and names that a compiler takes."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

import numpy as np

from dbo_cli.errors import UsageError

_IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_LONGEST = 40
RESERVED = frozenset(
    """alignas alignof and and_eq asm auto bitand bitor bool break case catch char char8_t char16_t
    char32_t class compl concept const consteval constexpr constinit const_cast continue co_await
    co_return co_yield decltype default delete do double dynamic_cast else enum explicit export
    extern false float for friend goto if inline int long mutable namespace new noexcept not not_eq
    nullptr operator or or_eq private protected public register reinterpret_cast requires restrict
    return short signed sizeof static static_assert static_cast struct switch template this
    thread_local throw true try typedef typeid typename typeof union unsigned using virtual void
    volatile wchar_t while xor xor_eq main setup loop errno assert offsetof stdin stdout stderr
    NULL INFINITY NAN abort exit free malloc memcmp memcpy memset printf puts""".split()
)
_TAKEN = ("dbo_", "fmi2", "example_main", "int8_t", "int16_t", "int32_t", "int64_t", "size_t", "uint")


def check_name(name: str) -> None:
    """Refuse a name that cannot begin the names of files, types and functions in C, C++ and on every disk.

    Raises
    ------
    UsageError
        It is no identifier, reserved, or taken by the files that are exported beside it.
    """
    if not _IDENTIFIER.fullmatch(name):
        raise UsageError(
            f"`name` {name!r}: is no C identifier (a letter first, then letters, digits and underscores)"
        )
    if len(name) > _LONGEST:
        raise UsageError(f"`name` {name!r}: has {len(name)} characters; at most {_LONGEST} are allowed")
    if name in RESERVED or name.lower() in RESERVED:
        raise UsageError(f"`name` {name!r}: is a reserved word of C or C++ (choose another)")
    if name.lower().startswith(_TAKEN):
        raise UsageError(f"`name` {name!r}: is taken by the files of the export (choose another)")


def hex_double(value: float) -> str:
    """Return a C99 constant that is this float64 to the bit."""
    return float(value).hex()


def hex_float(value: float) -> str:
    """Return a C99 constant that is this number's float32 to the bit."""
    return float(np.float32(value)).hex() + "f"


def integer(value: int) -> str:
    """Return a C constant; the least 32-bit and 64-bit numbers have no literal of their own."""
    value = int(value)
    if value == -(2**31):
        return "(-2147483647 - 1)"
    if value == -(2**63):
        return "(-INT64_C(9223372036854775807) - 1)"
    return str(value) if abs(value) < 2**31 else f"INT64_C({value})"


def wrapped(items: Iterable[str], indent: str = "    ", width: int = 108) -> str:
    """Return items, separated by commas, in lines of at most ``width`` characters."""
    lines, line = [], indent
    for item in items:
        if len(line) + len(item) + 1 > width and line.strip():
            lines.append(line.rstrip())
            line = indent
        line += item + ", "
    lines.append(line.rstrip().removesuffix(","))
    return "\n".join(lines)


def array(kind: str, name: str, items: Sequence[str]) -> str:
    """Return the definition of a constant array, private to its file."""
    return f"static const {kind} {name}[{len(items)}] = {{\n{wrapped(items)}}};\n"


def struct_rows(rows: Iterable[Iterable[str]]) -> list[str]:
    """Return initialisers of structures."""
    return ["{" + ", ".join(row) + "}" for row in rows]
