"""Text of exported files: templates that are files of their own kind; numbers, arrays and names as C."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import resources

import numpy as np

from dbo_cli.errors import UsageError
from dbo_cli.hysteresis.cascade import window_place
from dbo_cli.hysteresis.model import Quantity
from dbo_cli.hysteresis.model_file import filled

_IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
# NAME_names.h and the longest names of the kernel stay far below what linkers and disks
# hold
_LONGEST = 40
_TAKEN = (
    "dbo_",
    "fmi2",
    "example_main",
    "int8_t",
    "int16_t",
    "int32_t",
    "int64_t",
    "size_t",
    "uint",
)

Values = Mapping[str, str | bool]

_MARK, _END = r"^[ \t]*(?:/\*|<!--|#)", r"(?: \*/| -->)?\n"
_SECTION = re.compile(rf"{_MARK}\? (!?)(\w+){_END}(.*?){_MARK}: \2{_END}", re.M | re.S)
_LINES = re.compile(rf"{_MARK}\+ (\w+){_END}", re.M)


def _template(name: str) -> str:
    return (resources.files("dbo_cli.extras.export") / "templates" / name).read_text(
        encoding="utf-8"
    )


RESERVED = frozenset(_template("reserved_words.txt").split())
"""Words of C and C++, and names that every program has."""


def fill(template: str, values: Values) -> str:
    """Return a file of ``templates/`` filled in.

    A name in capitals stands for its value (``NAME_step``, and ``TERMSU`` for the
    unsigned constant), a line that is the comment ``+ name`` for lines of text; lines
    between the comments ``? name`` and ``: name`` stay where the value is true (``?
    !name``: where it is not). Values are not searched for names.
    """
    text = _template(template)
    while _SECTION.search(text):
        text = _SECTION.sub(
            lambda at: at[3] if bool(values[at[2]]) != bool(at[1]) else "", text
        )
    names = sorted((name for name in values if name.isupper()), key=len, reverse=True)
    if names:
        word = re.compile(
            rf"(?<![A-Za-z0-9_])(?:{'|'.join(names)})(?=U?(?![A-Za-z0-9]))"
        )
        text = word.sub(lambda at: str(values[at[0]]), text)
    return _LINES.sub(lambda at: str(values[at[1]]), text)


def plain(text: str) -> str:
    """Return text on one line that cannot end the comment it stands in, nor begin another."""
    words = "".join(c if c.isprintable() else " " for c in text)
    return re.sub(r"\*(?=/)|/(?=\*)", lambda at: f"{at[0]} ", words)


def plain_quantity(quantity: Quantity) -> Quantity:
    """Return a quantity whose name and unit end no comment that they stand in."""
    return replace(
        quantity,
        quantity=plain(quantity.quantity),
        unit=quantity.unit and plain(quantity.unit),
    )


def check_name(name: str) -> None:
    """Refuse a name that cannot begin the names of files, types and functions in C, C++ and on every disk.

    Raises
    ------
    UsageError
        It is no identifier, reserved, or taken by the files that are exported beside
        it.
    """
    problems = (
        (not _IDENTIFIER.fullmatch(name),
         "is no C identifier (a letter first, then letters, digits and underscores)"),
        (len(name) > _LONGEST, f"has {len(name)} characters; at most {_LONGEST} are allowed"),
        (bool(RESERVED & {name, name.lower()}), "is a reserved word of C or C++ (choose another)"),
        (name.lower().startswith(_TAKEN), "is taken by the files of the export (choose another)"),
    )  # fmt: skip
    for wrong, why in problems:
        if wrong:
            raise UsageError(f"`name` {name!r}: {why}")


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


def array(kind: str, name: str, items: Sequence[str]) -> str:
    """Return the definition of a constant array, private to its file, in lines of at most 108 characters."""
    # as if one more followed
    lines = filled([*items[:-1], f"{items[-1]},"], 108, "    ").removesuffix(",")
    return f"static const {kind} {name}[{len(items)}] = {{\n{lines}}};\n"


def struct_rows(rows: Iterable[Iterable[str]]) -> list[str]:
    """Return initialisers of structures."""
    return ["{" + ", ".join(row) + "}" for row in rows]


def double_rows(rows: Iterable[Iterable[float]]) -> list[str]:
    """Return initialisers of structures of float64."""
    return struct_rows([hex_double(value) for value in row] for row in rows)


@dataclass(frozen=True)
class Vectors:
    """One run of the self-test, as C constants: the start, the inputs, and the outputs expected.

    ``reset`` is None for a run after ``NAME_init``, else the drive given to
    ``NAME_reset``.
    """

    reset: str | None
    inputs: Sequence[str]
    outputs: Sequence[str]


SAMPLE_ROW = 10
"""The row, from 0, of the self-test's first run whose input the examples show."""


@dataclass(frozen=True)
class ModelCode:
    """A model in one arithmetic as C, before it has a name.

    Attributes
    ----------
    number : str
        The type of inputs, outputs and drives.
    members : list of str
        Members of the state beside the output.
    template : str
        The template of NAME.c.
    values : mapping
        What it is filled with.
    vectors : list of Vectors
        The self-test.
    headers : tuple of str
        The kernel's headers beside ``dbo_kernel.h``.
    table_bytes : int
        The size of the constant tables.
    bounds : mapping
        Derived bounds on the error by name; empty for double.
    """

    number: str
    members: list[str]
    template: str
    values: Values
    vectors: list[Vectors]
    headers: tuple[str, ...]
    table_bytes: int
    bounds: Mapping[str, float]

    @property
    def sample_input(self) -> str:
        """An input for the examples: one of the self-test, from its beginning."""
        return self.vectors[0].inputs[SAMPLE_ROW]

    def state_bytes(self, gears: int) -> int:
        """Return the size of the state on a 32-bit chip, where the kernel knows so many gears.

        Members stand at their natural alignment.
        """
        place = place_bits(gears) // 8
        operator = operator_state_bytes(self.number, place)
        sizes = {
            "double": (8, 8), "float": (4, 4), "int32_t": (4, 4), "uint32_t": (4, 4), "size_t": (4, 4),
            "int": (4, 4), "dbo_place": (place, place), "dbo_backlash_state": (operator, 8),
            "dbo_checkpoint": (16, 8),
            "dbo_lookup_state": (16, 8), "dbo_section_state": (24, 8), "dbo_inverse_state": (24, 8),
            "dbo_memory": (8, 8),
        }  # fmt: skip
        total = 0
        for kind, _, count in map(declared, [*self.members, f"{self.number} output;"]):
            size, alignment = sizes[kind]
            total = -(-total // alignment) * alignment + size * (count or 1)
        return -(-total // 8) * 8


def operator_state_bytes(number: str, place: int) -> int:
    """Return the size of a ``dbo_backlash_state``: pointers, depth, S and Z, and three numbers of 64 bits."""
    index = 4 if number == "double" else place  # size_t, or dbo_place
    pointers_and_indices = 3 * 4 + 3 * index
    return -(-pointers_and_indices // 8) * 8 + 3 * 8


def place_bits(gears: int) -> int:
    """Return the bits of a ``dbo_place``: the index of a gear, or how many there are."""
    for bits in (8, 16):
        if gears < 2**bits:
            return bits
    return 32


def checkpoint_spacing(gears: int, arithmetic: str) -> int:
    """Return how many turns share a checkpoint, ``DBO_SPACING``: a power of two.

    A checkpoint takes 16 bytes, and a turn one with few gears, else two: 2.5 bytes a
    gear at most. In double, where to cross a run takes most time, checkpoints stand
    closer.
    """
    if place_bits(gears) == 8:
        return 16
    return 32 if arithmetic == "double" else 64


def turns_members(gears: int, arithmetic: str) -> list[str]:
    """Return the members of a state that hold the turns of so many gears and their checkpoints."""
    members = [f"dbo_place turns[{gears}];"]
    checkpoints = (gears - 1) // checkpoint_spacing(gears, arithmetic)
    if checkpoints:
        members.insert(0, f"dbo_checkpoint checkpoints[{checkpoints}];")
    return members


def checkpoints_of(gears: int, arithmetic: str) -> str:
    """Return the place of the checkpoints in the state."""
    return (
        "state->checkpoints" if gears > checkpoint_spacing(gears, arithmetic) else "0"
    )


def declared(member: str) -> tuple[str, str, int]:
    """Return type, name and length of a member of the state; 0 where it is no array."""
    kind, rest = member.removesuffix(";").split(" ", 1)
    name, _, count = rest.removesuffix("]").partition("[")
    return kind, name, int(count or 0)


def delay_line(samples: int, number: str, between: str) -> tuple[list[str], str]:
    """Return members and steps of a delay of so many samples and a part.

    ``between`` is the expression between two samples, of ``later`` and ``earlier``.
    Before the first sample the first value holds.
    """
    size = samples + 2
    values = {
        "SLOTS": str(size), "LATER": str(size - samples), "EARLIER": str(size - samples - 1),
        "NUMBER": number, "BETWEEN": between,
    }  # fmt: skip
    members = [f"{number} delayed[{size}];", "uint32_t delay_at;", "int delay_filled;"]
    return members, fill("delay_line.c", values)


INTERPOLATION = "dbo_interpolation.h"
"""The header of a smooth delay, beside the kernel's."""


def interpolation_header(arithmetic: str) -> str:
    """Return the header that a smooth delay needs, in an arithmetic."""
    if arithmetic == "q31":
        folder, name = (
            resources.files("dbo_cli.extras.export") / "firmware",
            "dbo_interpolation_q31.h",
        )
    else:
        folder, name = resources.files("dbo_cli.interpolation"), INTERPOLATION
    text = (folder / name).read_text(encoding="utf-8")
    if arithmetic == "float":
        text = re.sub(r"(\d\.\d)", r"\1F", text.replace("double", "float"))
    return text


def smooth_delay_line(
    samples: int, part: str, number: str, suffix: str
) -> tuple[list[str], str]:
    """Return members and steps of a smooth delay of so many samples and a part.

    ``part``, as C, is what is left of the step in which the value lies; ``suffix`` ends
    the literals.
    """
    place = window_place(samples)
    size = samples + 2 + place
    words = ("ZERO", "ONE", "TWO", "THREE", "FOUR", "FIVE")
    literals = {word: f"{k}.0{suffix}" for k, word in enumerate(words)}
    values: dict[str, str | bool] = {
        "SLOTS": str(size), "PLACE_IN_WINDOW": str(place), "PART": part, "NUMBER": number,
        "counts": number == "int32_t", **literals,
    }  # fmt: skip
    members = [f"{number} delayed[{size}];", "uint32_t delay_at;", "int delay_filled;"]
    return members, fill("smooth_delay_line.c", values)


def model_sources(words: Values, code: ModelCode) -> dict[str, str]:
    """Return a model's header, source and self-test; ``words`` are what every file of an export knows."""
    values = {
        **words, **code.values, "NUMBER": code.number,
        "members": "".join(f"    {member}\n" for member in code.members),
        "kernel_headers": "".join(f'#include "{header}"\n' for header in code.headers),
    }  # fmt: skip
    name = words["NAME"]
    return {
        f"{name}.h": fill("NAME.h", values),
        f"{name}.c": fill(code.template, values),
        f"{name}_test.c": _self_test(values, code),
    }


def _self_test(values: Values, code: ModelCode) -> str:
    vectors, runs = [], ""
    for k, run in enumerate(code.vectors):
        vectors.append(array(code.number, f"inputs_{k}", run.inputs))
        vectors.append(array(code.number, f"expected_{k}", run.outputs))
        start = "init(&state)" if run.reset is None else f"reset(&state, {run.reset})"
        label = f"after {start[: start.index('(')]}"
        runs += (
            f"    {values['NAME']}_{start};\n"
            f'    wrong += play("{label}", &state, inputs_{k}, expected_{k}, {len(run.inputs)}U);\n'
        )
    bits = {"double": "uint64_t", "float": "uint32_t", "int32_t": "int32_t"}[
        code.number
    ]
    count = str(sum(len(run.inputs) for run in code.vectors))
    return fill(
        "NAME_test.c",
        {
            **values,
            "BITS": bits,
            "COUNT": count,
            "vectors": "\n".join(vectors),
            "runs": runs,
        },
    )
