"""The files around the sources: Makefile, CMakeLists.txt, an example, the Arduino layout, a page to read."""

from __future__ import annotations

from string import Template

from dbo_cli.export.cascade_plan import CascadePlan
from dbo_cli.export.summary import ExportSummary

_MAKEFILE = Template("""\
# make test    compile and run the self-test on this computer
# make arm     compile for a Cortex-M4F (arm-none-eabi-gcc); the sizes are printed
CFLAGS = -std=c99 -O2 -Wall -Wextra -ffp-contract=off $defines
ARMFLAGS = -mcpu=cortex-m4 -mthumb -mfloat-abi=hard -mfpu=fpv4-sp-d16 -ffunction-sections -fdata-sections
SOURCES = $sources

test: ${name}_test
	./${name}_test

${name}_test: ${name}_test.c $$(SOURCES) $headers
	$$(CC) $$(CFLAGS) ${name}_test.c $$(SOURCES) -o $$@

example: example_main.c $$(SOURCES) $headers
	$$(CC) $$(CFLAGS) example_main.c $$(SOURCES) -o $$@

arm: $$(SOURCES)
	arm-none-eabi-gcc $$(CFLAGS) $$(ARMFLAGS) -c $$(SOURCES)
	arm-none-eabi-size $$(SOURCES:.c=.o)

clean:
	rm -f ${name}_test example *.o

.PHONY: test arm clean
""")

_CMAKE = Template("""\
cmake_minimum_required(VERSION 3.13)
project($name C)

add_library($name STATIC $sources)
target_include_directories($name PUBLIC $${CMAKE_CURRENT_SOURCE_DIR})
target_compile_features($name PUBLIC c_std_99)
target_compile_definitions($name PUBLIC $definitions)
if(NOT MSVC)
  target_compile_options($name PRIVATE -ffp-contract=off)
endif()

if(CMAKE_SOURCE_DIR STREQUAL CMAKE_CURRENT_SOURCE_DIR AND NOT CMAKE_CROSSCOMPILING)
  enable_testing()
  add_executable(${name}_test ${name}_test.c)
  target_link_libraries(${name}_test PRIVATE $name)
  add_test(NAME ${name}_test COMMAND ${name}_test)
endif()
""")

_EXAMPLE = Template("""\
/* Where the calls stand in a program: replace the two functions by the ones of your board. */
#include "$name.h"

#include <stdio.h>

/* $input_text in, once every sample. */
static $number next_input(unsigned k) { return $sample; }

/* $output_text out. */
static void put_output($number output) { printf($printed); }

int main(void) {
    ${name}_state state;
    ${name}_init(&state); /* the drive stands at its lower end; ${name}_reset after a trim */
    for (unsigned k = 0; k < 20U; k++) put_output(${name}_step(&state, next_input(k)));
    return 0;
}
""")

_README = Template("""\
# $name

$title, as C99 in `$arithmetic`. $origin

    make test                                  # on this computer: every bit of the self-test
    cc -std=c99 -O2 -ffp-contract=off $defines$sources your_main.c

**Flags.** $flags `${name}_test.c` finds what differs; run it on the target
once (`-DDBO_NO_MAIN` and `${name}_self_test()` where there is no console). $small

**Calls.** `${name}_init` once, then `${name}_step` once a sample. No allocation, no recursion, no library.
The state is a plain struct; several actuators are several states.

| | |
|---|---|
$rows

**In and out.** $units

**Starting in the right state.** $start

**What the caller must do.**

$duties
$bounds""")


_FLAGS = {
    "rounded": "`-ffp-contract=off`, never `-ffast-math`: a fused multiply-add rounds once where the tables"
    " expect\ntwo roundings, and gcc's default dialect (`-std=gnu99`) fuses on chips that can.",
    "whole": "Any: all arithmetic is in whole numbers.",
}


def readme(
    plan: CascadePlan, summary: ExportSummary, title: str, origin: str, units: str, sources: str
) -> str:
    """Return README.md."""
    double = summary.arithmetic == "double"
    rows = [
        ("gears", f"{summary.gears}, in {summary.table_rows} rows of {summary.run} equal ones"),
        ("constant tables (flash)", f"{summary.table_bytes} bytes"),
        ("state (RAM)", f"{summary.state_bytes} bytes on a 32-bit chip"),
        ("worst step", f"crosses {summary.worst_runs} rows; a row costs about the same however long it is"),
        ("self-test", f"{summary.vectors} samples"),
    ]
    bounds = _bounds_text(plan, summary)
    return _README.substitute(
        name=summary.name, title=title, origin=origin, arithmetic=summary.arithmetic,
        defines="-DDBO_SMALL " if double else "", sources=sources, units=units,
        flags=_FLAGS["whole" if summary.arithmetic == "q31" else "rounded"],
        small="`-DDBO_SMALL` more than halves the kernel's code and changes no bit." if double else "",
        rows="\n".join(f"| {key} | {value} |" for key, value in rows),
        start=_start_text(plan, summary.name), duties="\n".join(f"- {note}" for note in summary.notes) + "\n",
        bounds=bounds,
    )  # fmt: skip


def _start_text(plan: CascadePlan, name: str) -> str:
    drive = plan.model.output if plan.direction == "inverse" else plan.model.input
    unit = f" {drive.unit}" if drive.unit else ""
    return (
        f"The gears remember. `{name}_init` is right after the drive has been at or below {drive.minimum!r}"
        f"{unit} for a while: go there first, wait for slow terms to settle, then begin."
        f" `{name}_reset(&state, drive)` is right for an actuator that was switched on and trimmed to `drive`"
        " (an oscillation that decayed) and rests there. `dbo compensate` chooses by itself: to start as it"
        f" does, give `{name}_reset` the first drive it wrote and go on with the second sample."
        + (
            " What moves behind the gears is at rest at the first sample: hold that until it has rung out."
            if plan.model.dynamics is not None
            else ""
        )
    )


def _bounds_text(plan: CascadePlan, summary: ExportSummary) -> str:
    if not summary.bounds:
        return (
            "\nThe output is that of `dbo compensate` or `dbo simulate` from the same state, bit for bit.\n"
        )
    b, unit = summary.bounds, f" {plan.model.output.unit}" if plan.model.output.unit else ""
    return (
        "\n**Error against the float64 model**, inside its range, derived from the tables (not measured):\n\n"
        f"- {b['same_gears']:.3g}{unit} ({b['same_gears_percent']:.3g} % of the range) as long as both cross"
        " the same gears. They do unless the drive turns within"
        f" {b['close_turn_fraction']:.2g} of a gear's width from the gear's end.\n"
        f"- {b['after_close_turn']:.3g}{unit} ({b['after_close_turn_percent']:.3g} %) after such a turn,"
        " until a larger move wipes it out: the two then remember neighbouring gears. It is the resolution of"
        f" {summary.gears} gears, and shrinks as they grow in number.\n"
    )


def makefile(name: str, sources: str, headers: str, defines: str) -> str:
    """Return the Makefile."""
    return _MAKEFILE.substitute(name=name, sources=sources, headers=headers, defines=defines)


def cmake(name: str, sources: str, definitions: str) -> str:
    """Return CMakeLists.txt."""
    text = _CMAKE.substitute(name=name, sources=sources, definitions=definitions)
    return text if definitions else text.replace(f"target_compile_definitions({name} PUBLIC )\n", "")


def example(plan: CascadePlan, name: str, number: str, sample: str) -> str:
    """Return example_main.c."""
    printed = '"%.9g\\n", (double)output'
    return _EXAMPLE.substitute(
        name=name, number=number, sample=sample, printed=printed,
        input_text=_quantity(plan.model.input), output_text=_quantity(plan.model.output),
    )  # fmt: skip


def _quantity(quantity: object) -> str:
    name, unit = getattr(quantity, "quantity", ""), getattr(quantity, "unit", None)
    return f"{name[:1].upper()}{name[1:]}{f' ({unit})' if unit else ''}"


def arduino_properties(name: str, title: str, version: str) -> str:
    """Return library.properties."""
    return (
        f"name={name}\nversion={version}\nauthor=dbo export\nmaintainer=dbo export\nsentence={title}\n"
        "paragraph=Written by dbo export; README.md says how it is used.\ncategory=Device Control\nurl=\n"
        f"architectures=*\nincludes={name}.h\n"
    )


def arduino_sketch(name: str, number: str) -> str:
    """Return an example sketch: the self-test on the board, then one step a loop."""
    return (
        f"#include <{name}.h>\n\nstatic {name}_state state;\n\nvoid setup() {{\n    Serial.begin(115200);\n"
        f"    {name}_init(&state);\n}}\n\nvoid loop() {{\n"
        f"    {number} input = 0; /* what is wanted next */\n"
        f"    {number} output = {name}_step(&state, input);\n    Serial.println(output);\n}}\n"
    )
