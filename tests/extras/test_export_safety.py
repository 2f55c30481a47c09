"""Exports in a machine: what is no number, limits and slew, several in one program, odd names in comments."""

from __future__ import annotations

import ctypes
import json
import shutil
import subprocess
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from compiling import COMPILERS, SANITIZERS, WARNINGS, compile_c
from exported import TYPES, cmake, made_model, random_moves

from dbo_cli.errors import ModelError
from dbo_cli.extras.export.cascade_plan import plan_cascade
from dbo_cli.extras.export.export import export_model
from dbo_cli.extras.export.single_code import axes_of, counts_of_range, single_tables
from dbo_cli.extras.export.source_text import fill, plain
from dbo_cli.hysteresis.dynamics import DynamicsStage, Lag, Resonance
from dbo_cli.hysteresis.model import NEGLIGIBLE, ActuatorModel, DriveLimits

needs_compiler = pytest.mark.skipif(not COMPILERS, reason="no C compiler")
RATE = 1000.0
NUMBERS = {"double": "double", "float": "float", "q31": "int32_t"}


def built(folder: Path, sources: list[str], *flags: str) -> str:
    """Compile and run a program, warnings being errors; return what it prints."""
    compile_c(folder, *WARNINGS, *flags, *sources, "-lm", "-o", "program")
    done = subprocess.run(
        ["./program"], cwd=folder, capture_output=True, text=True, check=True
    )
    return done.stdout


# ---- what is no number


TAKEN = """
#include "x.h"
#include <math.h>
#include <stdio.h>
static const int32_t constant = X_IN(MIDDLE);
int main(void) {
    const double given[] = {NAN, INFINITY, -INFINITY, 1e9, -1e9, BEYOND, BELOW};
    x_state state;
    int32_t last = 0;
    x_init(&state);
    for (int k = 0; k < 50; k++) last = x_step(&state, constant);
    printf("%d %d %d\\n", (int)last, (int)X_IN(INSIDE), (int)X_IN(UNDER));
    for (unsigned k = 0; k < 7; k++) printf("%d ", (int)x_step(&state, X_IN(given[k])));
    return 0;
}
"""


@needs_compiler
def test_q31_repeats_its_last_output_for_what_is_no_number(tmp_path: Path) -> None:
    """NaN, infinities and what 32 bits do not hold; just inside twice the range is still a count."""
    model = made_model(1)
    export_model(
        model, str(tmp_path / "x"), name="x", arithmetic="q31", sample_rate=RATE
    )
    low, high = model.output.minimum, model.output.maximum
    span, middle = high - low, 0.5 * (low + high)
    places = {
        "MIDDLE": middle + 0.1 * span, "BEYOND": middle + 1.01 * span, "BELOW": middle - 1.01 * span,
        "INSIDE": middle + 0.99 * span, "UNDER": middle - 0.99 * span,
    }  # fmt: skip
    text = TAKEN
    for key, value in places.items():
        text = text.replace(key, repr(value))
    (tmp_path / "x" / "main.c").write_text(text)
    first, again = built(
        tmp_path / "x", ["main.c", "x.c", "dbo_kernel.c"], "-Wno-float-conversion",
        "-fsanitize=undefined,float-cast-overflow", "-fno-sanitize-recover=all",
    ).splitlines()  # fmt: skip
    last, inside, under = (int(word) for word in first.split())
    assert last not in (0, -(2**30), 2**30)
    assert [int(word) for word in again.split()] == [last] * 7
    assert abs(inside - 0.99 * 2**31) < 3.0
    assert abs(under + 0.99 * 2**31) < 3.0
    page = (tmp_path / "x" / "README.md").read_text()
    assert (
        "beyond twice the range, are ignored: the last output comes again. X_IN(x) gives X_IGNORED"
        in page
    )


# ---- limits and slew


PLAY = """
#include "x.h"
#include <stddef.h>
/* Kinds: 0 a step, 1 a reset, 2 the start; the output that stands after each. */
void play(const NUMBER *in, const int *kind, NUMBER *out, size_t count);
void play(const NUMBER *in, const int *kind, NUMBER *out, size_t count) {
    x_state state;
    x_init(&state);
    for (size_t k = 0; k < count; k++) {
        if (kind[k] == 1)
            x_reset(&state, in[k]);
        else if (kind[k] == 2)
            x_init(&state);
        out[k] = kind[k] == 0 ? x_step(&state, in[k]) : state.output;
    }
}
"""


def played(folder: Path, arithmetic: str, inputs: Any, kinds: Any) -> list[Fraction]:
    """Return the outputs as exact numbers, in counts where the arithmetic counts."""
    number = NUMBERS[arithmetic]
    (folder / "play.c").write_text(PLAY.replace("NUMBER", number))
    sources = sorted(p.name for p in folder.glob("*.c") if p.name.startswith("dbo_"))
    compile_c(
        folder,
        *WARNINGS,
        "-O1",
        "-shared",
        "-fPIC",
        "play.c",
        "x.c",
        *sources,
        "-o",
        "play.so",
    )
    library = ctypes.CDLL(str(folder / "play.so"))
    given = np.ascontiguousarray(inputs, dtype=TYPES[arithmetic])
    kind, out = np.ascontiguousarray(kinds, dtype=np.intc), np.empty_like(given)
    pointers = [ctypes.c_void_p(a.ctypes.data) for a in (given, kind, out)]
    library.play(*pointers, ctypes.c_size_t(given.size))
    assert np.isfinite(out).all()
    return [Fraction(value) for value in out.tolist()]


def hostile(
    rng: np.random.Generator, model: ActuatorModel, arithmetic: str, count: int
) -> tuple[Any, Any]:
    """Return inputs and kinds: moves with jumps, no numbers among them, resets to drives of every sort."""
    low, high = model.output.minimum, model.output.maximum
    moves = random_moves(rng, low, high, count)
    wild = rng.random(count)
    moves = np.where(
        wild < 0.1, low + (high - low) * rng.uniform(-3.0, 4.0, count), moves
    )
    kinds = np.zeros(count, np.intc)
    kinds[rng.integers(1, count, count // 60)] = 1
    kinds[rng.integers(1, count, count // 150)] = 2
    drives = model.input.minimum + model.input.span * rng.uniform(-0.5, 1.5, count)
    bad = np.array([np.nan, np.inf, -np.inf, 1e30, -1e30])[rng.integers(0, 5, count)]
    if arithmetic == "q31":
        counted = []
        for values, quantity in ((moves, model.output), (drives, model.input)):
            middle, unit = counts_of_range(quantity)
            counted.append(
                np.clip(np.rint((values - middle) / unit), -(2**31) + 1, 2**31 - 1)
            )
        moves, drives = counted
        bad = np.array([-(2**31), 2**31 - 1, -(2**31) + 1, -(2**31), -(2**31)])[
            rng.integers(0, 5, count)
        ]
    given = np.where(kinds == 1, drives, moves)
    given = np.where(rng.random(count) < 0.05, bad, given)
    given[0] = bad[0]  # no number before there was any other
    return given, kinds


def lagging(model: ActuatorModel) -> ActuatorModel:
    return replace(model, stages=(DynamicsStage((Lag(0.004),)), *model.stages))


def resonant(model: ActuatorModel) -> ActuatorModel:
    return replace(
        model,
        stages=(*model.stages, DynamicsStage((Resonance(60.0, 0.05), Lag(0.002)))),
    )


CASES = [
    *((arithmetic, seed, None, False) for arithmetic in NUMBERS for seed in range(3)),
    ("double", 1, lagging, False), ("double", 2, lagging, False), ("double", 1, resonant, False),
    ("double", 0, None, True),
]  # fmt: skip


@needs_compiler
@pytest.mark.parametrize(("arithmetic", "seed", "changed", "lookup"), CASES)
def test_an_inverse_never_leaves_its_limits_or_its_slew(
    arithmetic: Any, seed: int, changed: Any, lookup: bool, tmp_path: Path
) -> None:
    """Whatever comes in, from the first sample on, after every reset; float and q31 to the last bit.

    In double a sum rounds, and a lag before the gears is held back from a billionth of
    the range on.
    """
    gears = 10 if lookup else (8, 90, 300)[seed]
    model = made_model(
        seed, gears=gears, slopes=min(gears, 30), terms=seed, below=(0, 3, 25)[seed]
    )
    model = model if changed is None else changed(model)
    rng = np.random.default_rng(seed)
    span = model.input.span
    limits = DriveLimits(
        model.input.minimum + span * float(rng.uniform(0.01, 0.3)),
        model.input.minimum + span * float(rng.uniform(0.6, 0.97)),
        span * float(rng.uniform(2.0, 40.0)),
    )
    export_model(
        model, str(tmp_path / "x"), name="x", arithmetic=arithmetic, sample_rate=RATE, lookup=lookup,
        v_min=limits.v_min, v_max=limits.v_max, max_slew=limits.max_slew,
    )  # fmt: skip
    given, kinds = hostile(rng, model, arithmetic, 6000)
    out = played(tmp_path / "x", arithmetic, given, kinds)
    if arithmetic == "q31":  # as X_OUT converts them
        middle, unit = counts_of_range(model.input)
        assert min(float(value) * unit + middle for value in out) >= limits.v_min
        assert max(float(value) * unit + middle for value in out) <= limits.v_max
        out = [value * Fraction(unit) for value in out]
    else:
        assert min(out) >= limits.v_min
        assert max(out) <= limits.v_max
    assert limits.max_slew is not None
    asked = Fraction(limits.max_slew) / Fraction(RATE)
    slack = {
        "double": Fraction(4 * np.spacing(limits.v_max)),
        "float": Fraction(0),
        "q31": Fraction(0),
    }
    spare = (
        Fraction(NEGLIGIBLE * (limits.v_max - limits.v_min))
        if changed is lagging
        else slack[arithmetic]
    )
    changes = [
        abs(b - a)
        for a, b, kind in zip(out, out[1:], kinds[1:], strict=False)
        if kind == 0
    ]
    assert max(changes) <= asked + spare
    # bends are counted at their steepest
    assert sum(change > 0.6 * asked for change in changes) > 100
    ends = {min(out), max(out)}
    assert sum(value in ends for value in out) > 100


@pytest.mark.parametrize("q31", [False, True])
def test_limits_are_converted_inwards(q31: bool) -> None:
    """Each is inside of the one asked for, and the next number is outside."""
    model = made_model(1)
    rng = np.random.default_rng(3)
    middle, unit = counts_of_range(model.input) if q31 else (0.0, 1.0)
    outwards = 0
    for _ in range(300):
        low, high = np.sort(
            model.input.minimum + model.input.span * rng.uniform(0.0, 1.0, 2)
        ).tolist()
        slew = model.input.span * float(rng.uniform(1.0, 100.0))
        plan = plan_cascade(model, "inverse", RATE, DriveLimits(low, high, slew))
        t = single_tables(plan, axes_of(plan), q31, 2.0**-10)
        assert t.clip is not None
        assert t.limits is not None
        least, most = t.clip
        if q31:
            assert least * unit + middle >= low > (least - 1) * unit + middle
            assert most * unit + middle <= high < (most + 1) * unit + middle
        else:
            assert float(least) >= low > float(np.nextafter(least, np.float32(-np.inf)))
            assert float(most) <= high < float(np.nextafter(most, np.float32(np.inf)))
            outwards += float(np.float32(low)) < low
        assert float(t.change) * unit <= slew / RATE
        assert float(t.change) * unit > 0.999 * slew / RATE
        assert t.clip[0] <= t.first <= t.clip[1]
        step = Fraction(t.limits[2]) * Fraction(axes_of(plan).y_unit)
        assert step <= Fraction(plan.slew_step or 0.0)
    assert q31 or outwards > 100  # to nearest, so many would lie below


@pytest.mark.parametrize("arithmetic", ["float", "q31"])
def test_limits_that_an_arithmetic_cannot_hold_are_refused(
    arithmetic: Any, tmp_path: Path
) -> None:
    model, out = made_model(1), str(tmp_path / "out")
    with pytest.raises(
        ModelError, match=r"^`v_min`, `v_max`: too close for this arithmetic \(`arith"
    ):
        export_model(
            model,
            out,
            name="x",
            arithmetic=arithmetic,
            sample_rate=RATE,
            v_min=5.1,
            v_max=5.1 + 1e-11,
        )
    with pytest.raises(
        ModelError, match=r"^`max_slew`: less than this arithmetic resolves in one step"
    ):
        export_model(
            model, out, name="x", arithmetic=arithmetic, sample_rate=RATE, max_slew=1e-6
        )
    assert list(tmp_path.iterdir()) == []


# ---- several in one program


MAIN = """
INCLUDES
#include <stdio.h>
static double next(unsigned *seed) {
    *seed = *seed * 1664525U + 1013904223U;
    return (double)(*seed >> 8) / 16777216.0;
}
FUNCTIONS
int main(void) {
CALLS
    return 0;
}
"""
ONE = """
static void play_NAME(void) {
    NAME_state state;
    unsigned seed = 7;
    NAME_init(&state);
    for (unsigned k = 0; k < 2000; k++) {
        const double x = LOW + (HIGH - LOW) * next(&seed);
        printf("%a\\n", (double)NAME_step(&state, (NUMBER)TAKEN));
    }
}
"""


def program(exports: dict[str, tuple[str, ActuatorModel]]) -> str:
    """Return a program that plays exports one after the other."""
    functions = ""
    for name, (arithmetic, model) in exports.items():
        words = {
            "NAME": name, "LOW": repr(model.output.minimum), "HIGH": repr(model.output.maximum),
            "NUMBER": NUMBERS[arithmetic], "TAKEN": f"{name.upper()}_IN(x)" if arithmetic == "q31" else "x",
        }  # fmt: skip
        text = ONE
        for key, value in words.items():
            text = text.replace(key, value)
        functions += text
    text = MAIN.replace(
        "INCLUDES", "\n".join(f'#include "{name}/{name}.h"' for name in exports)
    )
    text = text.replace("FUNCTIONS", functions)
    return text.replace("CALLS", "\n".join(f"    play_{name}();" for name in exports))


@needs_compiler
def test_exports_of_three_arithmetics_stand_in_one_program(tmp_path: Path) -> None:
    """Their numbers are those of three programs, whatever the order of the headers."""
    exports = {
        "fine": ("double", resonant(made_model(1))),
        "quick": ("float", made_model(0)),
        "whole": ("q31", made_model(2)),
    }
    for name, (arithmetic, model) in exports.items():
        export_model(
            model,
            str(tmp_path / name),
            name=name,
            arithmetic=arithmetic,
            sample_rate=RATE,
        )  # type: ignore[arg-type]
    sources = {
        name: [str(p.relative_to(tmp_path)) for p in sorted((tmp_path / name).glob("*.c"))
               if not p.name.endswith(("_test.c", "_main.c"))]
        for name in exports
    }  # fmt: skip
    alone = ""
    for name in exports:
        (tmp_path / "main.c").write_text(program({name: exports[name]}))
        alone += built(tmp_path, ["main.c", *sources[name]])
    assert len(alone.splitlines()) == 6000
    every = [path for paths in sources.values() for path in paths]
    (tmp_path / "main.c").write_text(program(exports))
    assert built(tmp_path, ["main.c", *every]) == alone
    (tmp_path / "main.c").write_text(program(dict(reversed(exports.items()))))
    assert sorted(built(tmp_path, ["main.c", *every]).splitlines()) == sorted(
        alone.splitlines()
    )
    if shutil.which("g++"):
        (tmp_path / "main.cpp").write_text(
            "".join(f'#include "{name}/{name}.h"\n' for name in exports)
        )
        subprocess.run(
            ["g++", "-Wall", "-Werror", "-fsyntax-only", "main.cpp"],
            cwd=tmp_path,
            check=True,
        )


@needs_compiler
def test_every_symbol_of_an_export_bears_its_name(tmp_path: Path) -> None:
    """The kernel's source is the package's own, byte for byte."""
    import dbo_cli.hysteresis as package

    export_model(
        resonant(made_model(1)), str(tmp_path / "x"), name="axis", sample_rate=RATE
    )
    kept = Path(package.__file__).parent
    for file in ("dbo_kernel.c", "dbo_dynamics.c"):
        assert (tmp_path / "x" / file).read_bytes() == (kept / file).read_bytes()
    for file in ("dbo_kernel.h", "dbo_dynamics.h"):
        assert (kept / file).read_text() in (tmp_path / "x" / file).read_text()
    sources = ["axis.c", "dbo_kernel.c", "dbo_dynamics.c"]
    compile_c(tmp_path / "x", *WARNINGS, "-c", *sources)
    listed = subprocess.run(
        ["nm", "-g", "--defined-only", "axis.o", "dbo_kernel.o", "dbo_dynamics.o"],
        cwd=tmp_path / "x", capture_output=True, text=True, check=True,
    )  # fmt: skip
    symbols = [
        line.split()[2] for line in listed.stdout.splitlines() if len(line.split()) == 3
    ]
    assert "axis_dbo_backlash_step_fixed" in symbols
    assert [name for name in symbols if not name.startswith("axis_")] == []


@needs_compiler
@pytest.mark.skipif(shutil.which("cmake") is None, reason="no cmake")
def test_two_exports_are_installed_and_found_by_cmake(tmp_path: Path) -> None:
    exports = {"Fine": ("double", made_model(0)), "quick": ("float", made_model(1))}
    for name, (arithmetic, model) in exports.items():
        export_model(
            model,
            str(tmp_path / name),
            name=name,
            arithmetic=arithmetic,
            sample_rate=RATE,
        )  # type: ignore[arg-type]
        for step in (["-S", name, "-B", f"b_{name}"], ["--build", f"b_{name}"],
                     ["--install", f"b_{name}", "--prefix", "installed"]):  # fmt: skip
            cmake(tmp_path, *step)
    user = tmp_path / "user"
    user.mkdir()
    text = program(exports).replace('"Fine/', '"').replace('"quick/', '"')
    (user / "main.c").write_text(text)
    (user / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.13)\nproject(user C)\nfind_package(Fine REQUIRED)\n"
        "find_package(quick REQUIRED)\nadd_executable(user main.c)\n"
        "target_link_libraries(user PRIVATE Fine::Fine quick::quick)\n"
    )
    prefix = f"-DCMAKE_PREFIX_PATH={tmp_path / 'installed'}"
    for step in (["-S", ".", "-B", "b", prefix], ["--build", "b"]):
        cmake(user, *step)
    done = subprocess.run(
        ["b/user"], cwd=user, capture_output=True, text=True, check=True
    )
    assert len(done.stdout.splitlines()) == 4000


def test_the_platformio_manifest_leaves_out_the_programs(tmp_path: Path) -> None:
    """Read as JSON; PlatformIO itself is not at hand."""
    export_model(made_model(0), str(tmp_path / "x"), name="axis", sample_rate=RATE)
    manifest = json.loads((tmp_path / "x" / "library.json").read_text())
    assert manifest["name"] == "axis"
    assert manifest["build"]["srcFilter"] == [
        "+<*.c>",
        "-<axis_test.c>",
        "-<example_main.c>",
    ]
    mains = [
        p.name
        for p in (tmp_path / "x").glob("*.c")
        if "int main(void)" in p.read_text()
    ]
    assert sorted(mains) == ["axis_test.c", "example_main.c"]


ZEPHYR = """cmake_minimum_required(VERSION 3.13)
project(stand_in C)
macro(zephyr_library_named name)
  add_library(${name} STATIC)
  set(ZEPHYR_LIBRARY ${name})
endmacro()
macro(zephyr_library_sources)
  target_sources(${ZEPHYR_LIBRARY} PRIVATE ${ARGN})
endmacro()
macro(zephyr_library_compile_definitions)
  target_compile_definitions(${ZEPHYR_LIBRARY} PRIVATE ${ARGN})
endmacro()
macro(zephyr_library_compile_options)
  target_compile_options(${ZEPHYR_LIBRARY} PRIVATE ${ARGN})
endmacro()
macro(zephyr_include_directories)
  include_directories(${ARGN})
endmacro()
add_subdirectory(x/zephyr axis)
add_executable(user x/axis_test.c)
target_include_directories(user PRIVATE x)
target_link_libraries(user PRIVATE axis)
"""


@needs_compiler
@pytest.mark.skipif(shutil.which("cmake") is None, reason="no cmake")
@pytest.mark.parametrize("arithmetic", ["double", "q31"])
def test_the_zephyr_module_builds_with_stand_ins(
    arithmetic: Any, tmp_path: Path
) -> None:
    """Zephyr itself is not at hand: its commands are those of CMake that they stand for."""
    export_model(
        made_model(0),
        str(tmp_path / "x"),
        name="axis",
        sample_rate=RATE,
        arithmetic=arithmetic,
    )
    assert (
        tmp_path / "x/zephyr/module.yml"
    ).read_text() == "name: axis\nbuild:\n  cmake: zephyr\n"
    (tmp_path / "CMakeLists.txt").write_text(ZEPHYR)
    for step in (["-S", ".", "-B", "b"], ["--build", "b"]):
        cmake(tmp_path, *step)
    assert (
        "every bit as expected"
        in subprocess.run(
            ["b/user"], cwd=tmp_path, capture_output=True, text=True, check=True
        ).stdout
    )


# ---- comments, templates


def test_text_that_ends_a_comment_is_taken_apart() -> None:
    assert plain("displacement (um/V²)") == "displacement (um/V²)"
    assert plain("a */ b /* c") == "a * / b / * c"
    assert plain("*/*/") == "* / * / "[:-1]
    assert plain("one\nline\ttoo") == "one line too"


@needs_compiler
@pytest.mark.parametrize("arithmetic", ["double", "float", "q31"])
def test_a_quantity_or_unit_ends_no_comment(arithmetic: Any, tmp_path: Path) -> None:
    model = made_model(0)
    model = replace(
        model,
        input=replace(model.input, quantity="drive */ #error\n/*", unit="V*/s"),
        output=replace(model.output, quantity="/* x */ int main(", unit="*/"),
    )
    export_model(
        model, str(tmp_path / "x"), name="x", arithmetic=arithmetic, sample_rate=RATE
    )
    assert built(tmp_path / "x", ["x_test.c", "x.c", "dbo_kernel.c"]) == (
        "x: 526 samples, every bit as expected\n"
    )
    built(tmp_path / "x", ["example_main.c", "x.c", "dbo_kernel.c"])


def test_a_template_is_filled_by_words_lines_and_sections(tmp_path: Path) -> None:
    values: dict[str, str | bool] = {"NAME": "NUMBER", "NUMBER": "float"}
    text = fill("NAME.ino", values)
    # a value is not searched
    assert text.startswith("#include <NUMBER.h>\n\nstatic NUMBER_state state;\n")
    assert "    float input = 0; /* what is wanted next */\n" in text
    files: dict[str, str | bool] = {
        "TARGET_NAME": "x",
        "SOURCE_FILES": "x.c",
        "HEADER_FILES": "x.h",
    }
    for small in (True, False):
        text = fill(
            "CMakeLists.txt", {**files, "CONFIG_FILE": "xConfig.cmake", "small": small}
        )
        assert ("DBO_SMALL" in text) == small
        assert "#?" not in text
    with pytest.raises(KeyError):
        fill("CMakeLists.txt", files)


# ---- a unit for simulation tools, of a model without time


@needs_compiler
def test_the_fmu_of_a_model_without_time_takes_any_step(tmp_path: Path) -> None:
    fmpy = pytest.importorskip("fmpy")
    from fmpy.validation import validate_fmu

    model = made_model(0, terms=0)
    export_model(model, str(tmp_path / "out"), name="piezo", fmu=True)
    path = str(tmp_path / "out" / "piezo.fmu")
    assert validate_fmu(path) == []
    described = fmpy.read_model_description(path)
    assert described.coSimulation.canHandleVariableCommunicationStepSize is True
    assert described.defaultExperiment.stepSize is None
    unit = fmpy.instantiate_fmu(
        fmpy.extract(path, unzipdir=str(tmp_path / "unpacked")), described
    )
    unit.setupExperiment(startTime=0.0)
    unit.enterInitializationMode()
    unit.exitInitializationMode()
    desired = random_moves(
        np.random.default_rng(3), model.output.minimum, model.output.maximum, 200
    )
    plan = plan_cascade(
        model, "inverse", None, DriveLimits(model.input.minimum, model.input.maximum)
    )
    expected = plan.model.simulate(desired, plan.empty_state(), limits=plan.limits).y
    outputs, time = [], 0.0
    for k, value in enumerate(desired.tolist()):
        unit.setReal([1], [value])
        step = (1e-5, 0.37, 1.0, 12.5)[k % 4]
        unit.doStep(currentCommunicationPoint=time, communicationStepSize=step)
        outputs.append(unit.getReal([2])[0])
        time += step
    assert np.array(outputs).tobytes() == expected.tobytes()
    with pytest.raises(fmpy.fmi1.FMICallException):
        unit.doStep(currentCommunicationPoint=time, communicationStepSize=0.0)
    unit.terminate()
    unit.freeInstance()


@needs_compiler
def test_reset_to_no_number_is_a_start(tmp_path: Path) -> None:
    """As after the drive stood at its lower end, in every bit; sanitizers silent."""
    model = made_model(1)
    folder = tmp_path / "x"
    export_model(model, str(folder), name="x", sample_rate=RATE)
    (folder / "main.c").write_text(
        '#include "x.h"\n#include <math.h>\n#include <stdio.h>\nint main(void) {\n    x_state a, b;\n'
        "    x_init(&a);\n    x_reset(&b, NAN);\n    for (int k = 0; k < 99; k++)\n"
        f"        if (x_step(&a, {model.output.maximum!r} * k / 99) != x_step(&b, {model.output.maximum!r}"
        ' * k / 99))\n            return 1;\n    puts("alike");\n    return 0;\n}\n'
    )
    assert built(folder, ["main.c", "x.c", "dbo_kernel.c"], *SANITIZERS) == "alike\n"
