"""What every arithmetic's sources have in common: the header, the steps around the gears, the self-test."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from string import Template

from dbo_cli.export.c_text import array


@dataclass(frozen=True)
class Vectors:
    """One run of the self-test, as C constants: the start, the inputs, and the outputs expected.

    ``reset`` is None for a run after ``NAME_init``, else the drive given to ``NAME_reset``.
    """

    label: str
    reset: str | None
    inputs: Sequence[str]
    outputs: Sequence[str]


@dataclass(frozen=True)
class SourceParts:
    """What an arithmetic puts into the frame; every text is C.

    Attributes
    ----------
    number : str
        The type of inputs, outputs and drives.
    tables : str
        Constant tables and functions private to the source file.
    members : list of str
        Members of the state beside the output.
    initialise, start : str
        Statements of ``NAME_init`` and ``NAME_reset`` on ``state`` (and ``drive``).
    step : str
        Statements that turn ``x`` into the output.
    lowest, highest : str
        Inputs beyond these, or that are not numbers, are ignored; None where every input is a number.
    first_output : str
        What is returned for an input that is ignored before there was any other.
    drive_is_output : bool
        Whether that is the drive itself after ``NAME_reset``: of an inverse.
    macros : list of (str, str, str)
        Name without the prefix, value, and what it is.
    """

    number: str
    tables: str
    members: list[str]
    initialise: str
    start: str
    step: str
    lowest: str | None
    highest: str | None
    first_output: str
    drive_is_output: bool
    macros: list[tuple[str, str, str]]
    vectors: list[Vectors] = field(default_factory=list)
    kernel_headers: tuple[str, ...] = ()
    declarations: str = ""


_HEADER = Template("""\
/* $title
 * $origin
 * Call ${name}_init once, then ${name}_step once every sample. README.md says the rest. */
#ifndef ${guard}_H
#define ${guard}_H

#include "dbo_kernel.h"
$kernel_headers
#ifdef __cplusplus
extern "C" {
#endif

$macros
/* All that one sample leaves behind for the next; may be copied. */
typedef struct {
$members
    $number output; /* the last one */
} ${name}_state;

/* The start after the drive has been at or below its lower end: no gear is engaged, nothing remembered. */
void ${name}_init(${name}_state *state);

/* The start of an actuator that was switched on and trimmed to this drive, and rests there. */
void ${name}_reset(${name}_state *state, $number drive);

/* One sample: $what. $ignored */
$number ${name}_step(${name}_state *state, $number input);

#ifdef __cplusplus
}
#endif

#endif
""")

_SOURCE = Template("""\
/* $title
 * $origin
 * Compile without fast-math and without contraction (-ffp-contract=off). */
#include "$name.h"

$tables
void ${name}_init(${name}_state *state) {
$initialise
    state->output = $first_output;
}

void ${name}_reset(${name}_state *state, $number drive) {
    $number x = drive;
    ${name}_init(state);$drive_is_output
$start
}

$number ${name}_step(${name}_state *state, $number input) {
    $number x = input;
$guard$step
    state->output = x;
    return x;
}
""")

_TEST = Template("""\
/* $title
 * The self-test: plays inputs and compares every output with what the package computed, to the last bit.
 * On a computer: prints what differs and exits with 1. On a target without a console compile with
 * -DDBO_NO_MAIN and call ${name}_self_test. */
#include "$name.h"

#ifndef DBO_NO_MAIN
#include <stdio.h>
#endif

unsigned ${name}_self_test(void);

$vectors
typedef union {
    $number value;
    $bits bits;
} bits_of;

/* Play one run; returns how many samples differ. */
static unsigned play(const char *label, ${name}_state *state, const $number *inputs,
                     const $number *expected, unsigned count) {
    unsigned wrong = 0;
    for (unsigned k = 0; k < count; k++) {
        bits_of got, wanted;
        got.value = ${name}_step(state, inputs[k]);
        wanted.value = expected[k];
        if (got.bits == wanted.bits) continue;
#ifndef DBO_NO_MAIN
        if (wrong < 10U)
            printf("$name: %s, sample %u: $format where $format is expected\\n", label, k + 1U, $shown);
#endif
        wrong++;
    }
    (void)label;
    return wrong;
}

unsigned ${name}_self_test(void) {
    ${name}_state state;
    unsigned wrong = 0;
$runs
    return wrong;
}

#ifndef DBO_NO_MAIN
int main(void) {
    const unsigned wrong = ${name}_self_test();
    if (wrong > 0)
        printf("$name: %u of $count samples differ; were the flags as README.md says?\\n", wrong);
    else
        printf("$name: $count samples, every bit as expected\\n");
    return wrong > 0;
}
#endif
""")


def header(name: str, title: str, origin: str, parts: SourceParts, what: str) -> str:
    """Return NAME.h."""
    width = max((len(macro[0]) for macro in parts.macros), default=0)
    macros = "".join(
        f"#define {name.upper()}_{key:<{width}} {value} /* {meaning} */\n"
        for key, value, meaning in parts.macros
    )
    return _HEADER.substitute(
        title=title, origin=origin, name=name, guard=name.upper(), macros=macros + parts.declarations,
        members="\n".join(f"    {member}" for member in parts.members), number=parts.number, what=what,
        kernel_headers="".join(f'#include "{name}"\n' for name in parts.kernel_headers),
        ignored="Every input is a number." if parts.lowest is None else (
            "An input that is not a number is ignored:\n * the last output comes again."
        ),
    )  # fmt: skip


def source(name: str, title: str, origin: str, parts: SourceParts) -> str:
    """Return NAME.c."""
    return _SOURCE.substitute(
        title=title, origin=origin, name=name, tables=parts.tables, initialise=parts.initialise,
        start=parts.start, step=parts.step, number=parts.number, first_output=parts.first_output,
        drive_is_output="\n    state->output = drive;" if parts.drive_is_output else "",
        guard="" if parts.lowest is None else (
            f"    if (!(x >= {parts.lowest} && x <= {parts.highest})) return state->output;\n"
        ),
    )  # fmt: skip


def self_test(name: str, title: str, parts: SourceParts) -> str:
    """Return NAME_test.c."""
    bits = {"double": "uint64_t", "float": "uint32_t", "int32_t": "int32_t"}[parts.number]
    shown = "(double)got.value, (double)wanted.value"
    vectors, runs, count = [], [], 0
    for k, run in enumerate(parts.vectors):
        vectors.append(array(parts.number, f"inputs_{k}", run.inputs))
        vectors.append(array(parts.number, f"expected_{k}", run.outputs))
        start = f"{name}_init(&state);" if run.reset is None else f"{name}_reset(&state, {run.reset});"
        runs.append(
            f"    {start}\n"
            f'    wrong += play("{run.label}", &state, inputs_{k}, expected_{k}, {len(run.inputs)}U);'
        )
        count += len(run.inputs)
    return _TEST.substitute(
        title=title, name=name, vectors="\n".join(vectors), number=parts.number, bits=bits, shown=shown,
        format="%.17g", runs="\n".join(runs), count=count,
    )  # fmt: skip


def delay_line(samples: float, number: str, lagged: str) -> tuple[list[str], str, str]:
    """Return members, initialising statements and steps of a delay of so many samples.

    ``lagged`` is the expression between two samples, of ``later`` and ``earlier``, where the delay is no
    whole number of samples. Before the first sample the first value holds.
    """
    whole = int(samples)
    size = whole + 2
    members = [f"{number} delayed[{size}];", "uint32_t delay_at;", "int delay_filled;"]
    step = f"""\
    if (!state->delay_filled) {{
        for (uint32_t k = 0U; k < {size}U; k++) state->delayed[k] = x;
        state->delay_filled = 1;
    }}
    state->delayed[state->delay_at] = x;
    {{
        const {number} later = state->delayed[(state->delay_at + {size - whole}U) % {size}U];
        const {number} earlier = state->delayed[(state->delay_at + {size - whole - 1}U) % {size}U];
        (void)earlier;
        x = {lagged};
    }}
    state->delay_at = (state->delay_at + 1U) % {size}U;"""
    return members, "    state->delay_at = 0U;\n    state->delay_filled = 0;", step
