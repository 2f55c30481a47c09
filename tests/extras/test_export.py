"""The exported sources: the same bits as the package, bounds that hold, and what is refused."""

from __future__ import annotations

import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from compiling import COMPILERS, SANITIZERS, WARNINGS, compile_c
from exported import as_given, cmake, compiled, in_units, made_model, random_moves

from dbo_cli.errors import DboError, ModelError, OutputError, UsageError
from dbo_cli.extras.export.cascade_plan import plan_cascade
from dbo_cli.extras.export.export import export_model
from dbo_cli.extras.export.single_code import (
    axes_of,
    derive_bounds,
    fold,
    row_shift,
    single_tables,
)
from dbo_cli.extras.export.single_kernel import SingleKernel
from dbo_cli.extras.export.source_text import RESERVED, check_name, hex_double, integer
from dbo_cli.hysteresis import kernel
from dbo_cli.hysteresis.cascade import through
from dbo_cli.hysteresis.dynamics import DynamicsStage, Lag, Resonance
from dbo_cli.hysteresis.model import (
    ActuatorModel,
    DelayStage,
    DriveLimits,
    ModelState,
    Quantity,
    Relaxation,
)
from dbo_cli.hysteresis.operators import BacklashState, DiscreteBacklashOperator

needs_compiler = pytest.mark.skipif(not COMPILERS, reason="no C compiler")
RATE = 1000.0


def delayed(model: ActuatorModel, seconds: float) -> ActuatorModel:
    stages = (*model.stages, DelayStage(seconds))
    return ActuatorModel("forward", model.input, model.output, stages)


def compile_and_run(
    folder: Path, name: str, compiler: str, flags: list[str]
) -> subprocess.CompletedProcess[str]:
    """Compile the self-test, warnings being errors, and run it."""
    sources = [f"{name}_test.c", f"{name}.c", "dbo_kernel.c"]
    compile_c(folder, *WARNINGS, *flags, *sources, "-o", "self_test", compiler=compiler)
    return subprocess.run(
        ["./self_test"], cwd=folder, capture_output=True, text=True, check=False
    )


@needs_compiler
@pytest.mark.parametrize("arithmetic", ["double", "float", "q31"])
@pytest.mark.parametrize("direction", ["inverse", "forward"])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_self_test_passes(
    arithmetic: Any, direction: Any, seed: int, tmp_path: Path
) -> None:
    """Every arithmetic and direction, with memory, points, slew and delay or without; warnings are errors."""
    model = made_model(
        seed,
        gears=(8, 90, 300)[seed],
        slopes=(8, 30, 50)[seed],
        terms=(0, 2, 4)[seed],
        below=(0, 9, 25)[seed],
    )
    if seed or direction == "forward":
        # 1, 2 or 3 of six samples behind the moment
        model = delayed(model, (0.0004, 0.0016, 0.00325)[seed])
    slew = 40.0 * model.input.span if direction == "inverse" and seed else None
    export_model(
        model, str(tmp_path / "out"), name="x", direction=direction, arithmetic=arithmetic,
        sample_rate=RATE, max_slew=slew,
    )  # fmt: skip
    # All of it for every compiler would be 54 compilations; each way of compiling meets
    # each arithmetic. The first two are those of the libraries below and in
    # test_export_safety.py, which share the kernel.
    small = [
        "-DDBO_SMALL",
        "-DDBO_SOFT_DOUBLE",
        "-DDBO_SOFT_FLOAT",
        "-DDBO_PORTABLE_SCAN",
        *SANITIZERS,
    ]
    ways = ["-O2", "-fPIC"], ["-O1", "-fPIC"], small
    done = compile_and_run(
        tmp_path / "out", "x", COMPILERS[-1 if seed == 1 else 0], ways[seed]
    )
    assert (done.returncode, done.stdout) == (
        0,
        "x: 526 samples, every bit as expected\n",
    )


@needs_compiler
@pytest.mark.parametrize("arithmetic", ["double", "float", "q31"])
def test_the_self_test_finds_what_differs(arithmetic: Any, tmp_path: Path) -> None:
    """One table entry changed by one unit in the last place, or one count, is told and ends with 1."""
    export_model(
        made_model(1),
        str(tmp_path / "out"),
        name="x",
        arithmetic=arithmetic,
        sample_rate=RATE,
    )
    path = tmp_path / "out" / "x.c"
    lines = path.read_text().splitlines()
    row = (
        next(k for k, line in enumerate(lines) if "static const dbo_gear gears" in line)
        + 1
    )
    first, rest = lines[row].split(",", 1)
    value = first.strip(" {")
    changed = (
        str(int(value) + 1000)
        if arithmetic != "double"
        else hex_double(float.fromhex(value) * (1 + 1e-6))
    )
    lines[row] = first.replace(value, changed) + "," + rest
    path.write_text("\n".join(lines))
    done = compile_and_run(tmp_path / "out", "x", COMPILERS[0], [])
    assert done.returncode == 1
    assert "x: after init, sample " in done.stdout
    assert "samples differ; were the flags as README.md says?" in done.stdout


@needs_compiler
@pytest.mark.parametrize("slew", [None, 20.0])
def test_double_gives_the_bits_of_compensate(
    slew: float | None, tmp_path: Path
) -> None:
    """Ten thousand samples of random moves: started as `compensate` starts, by its first drive."""
    for seed in range(3):
        model = made_model(
            seed,
            gears=(90, 1152, 25)[seed],
            slopes=(30, 64, 25)[seed],
            below=(0, 36, 3)[seed],
        )
        rng = np.random.default_rng(seed)
        desired = random_moves(rng, model.output.minimum, model.output.maximum, 10_000)
        limits = DriveLimits(
            model.input.minimum,
            model.input.maximum,
            None if slew is None else slew * model.input.span,
        )
        start = model.start_compensation(float(desired[0]), "auto", limits)
        drive = model.compensate(desired, start, limits=limits, time_step=1.0 / RATE).y
        folder = tmp_path / f"out{seed}"
        summary = export_model(
            model, str(folder), name="x", sample_rate=RATE, max_slew=limits.max_slew
        )
        play = compiled(folder, "x", "double", summary.gears)
        got, _ = play(desired[1:], float(drive[0]))
        assert got.tobytes() == drive[1:].tobytes()


@needs_compiler
def test_double_forward_gives_the_bits_of_simulate(tmp_path: Path) -> None:
    for seed, seconds in enumerate((0.0, 0.003, 0.00272)):
        model = delayed(made_model(seed), seconds) if seconds else made_model(seed)
        rng = np.random.default_rng(seed)
        drive = random_moves(rng, model.input.minimum, model.input.maximum, 5_000)
        empty = ModelState(BacklashState(0, (0.0, 0.0, 0.0)), drive=0.0)
        expected = model.simulate(drive, empty, time_step=1.0 / RATE).y
        folder = tmp_path / f"out{seed}"
        summary = export_model(
            model, str(folder), name="x", direction="forward", sample_rate=RATE
        )
        got, _ = compiled(folder, "x", "double", summary.gears)(drive)
        assert got.tobytes() == expected.tobytes()


@needs_compiler
@pytest.mark.parametrize("arithmetic", ["float", "q31"])
@pytest.mark.parametrize("direction", ["inverse", "forward"])
def test_errors_stay_within_the_derived_bounds(
    arithmetic: Any, direction: Any, tmp_path: Path
) -> None:
    """benchmarks/export_bounds.py does the same over 10^6 samples on ten models."""
    judged = 0
    for seed in range(3):
        model = made_model(
            seed, gears=(8, 64, 1152)[seed], slopes=(8, 32, 64)[seed], terms=seed
        )
        turned = model.inverse() if direction == "inverse" else model
        source, result = turned.input, turned.output
        play = {}
        for kind in ("double", arithmetic):
            folder = tmp_path / f"{kind}{seed}"
            summary = export_model(
                model,
                str(folder),
                name="x",
                direction=direction,
                arithmetic=kind,
                sample_rate=RATE,
            )
            play[kind] = compiled(folder, "x", kind, summary.gears)
        for run in range(30):
            moves = random_moves(
                np.random.default_rng(run), source.minimum, source.maximum, 700
            )
            given, seen = as_given(moves, source, arithmetic)
            (exact, gears), (y, others) = play["double"](seen), play[arithmetic](given)
            error = np.abs(in_units(y, result, arithmetic) - exact)
            always = np.logical_and.accumulate(gears == others)
            judged += int(always.sum())
            assert error[always].max(initial=0.0) <= summary.bounds["same_gears"]
            assert error.max() <= summary.bounds["after_close_turn"]
    assert judged > 30_000


@needs_compiler
@pytest.mark.parametrize("arithmetic", ["double", "float", "q31"])
def test_anything_may_come_in(arithmetic: Any, tmp_path: Path) -> None:
    """NaN, infinities, the ends of the type, under the sanitizers: outputs stay numbers within the limits."""
    model = made_model(2)
    folder = tmp_path / "out"
    export_model(
        model,
        str(folder),
        name="x",
        arithmetic=arithmetic,
        sample_rate=RATE,
        v_min=0.1,
        v_max=0.8,
    )
    rng = np.random.default_rng(5)
    if arithmetic == "q31":
        bad = rng.integers(-(2**31), 2**31, 3000).astype(np.int32)
        bad[::7] = [2**31 - 1, -(2**31), 0][0]
        bad[::11] = -(2**31)
        texts = [integer(v) for v in bad.tolist()]
    else:
        bad = rng.normal(0.0, 1.0, 3000) * 10.0 ** rng.uniform(-3.0, 37.0, 3000)
        special = [
            "(1e300 * 1e300)",
            "(-1e300 * 1e300)",
            "(1e300 * 1e300 - 1e300 * 1e300)",
        ]
        texts = [
            special[k % 3] if k % 5 == 0 else repr(v)
            for k, v in enumerate(bad.tolist())
        ]
        texts = [
            f"({'float' if arithmetic == 'float' else 'double'}){v}" for v in texts
        ]
    (folder / "flood.c").write_text(
        f'#include "x.h"\n#include <stdio.h>\nstatic const {TYPES_IN_C[arithmetic]} in[] = {{\n'
        + ",\n".join(texts)
        + "};\nint main(void) {\n    x_state s;\n    x_init(&s);\n"
        '    for (unsigned k = 0; k < 3000; k++) printf("%.17g\\n", (double)x_step(&s, in[k]));\n'
        '    x_reset(&s, in[1]);\n    printf("%.17g\\n", (double)x_step(&s, in[2]));\n    return 0;\n}\n'
    )
    sources = ["flood.c", "x.c", "dbo_kernel.c"]
    compile_c(
        folder, "-std=c99", "-ffp-contract=off", *SANITIZERS, *sources, "-o", "flood"
    )
    done = subprocess.run(
        ["./flood"], cwd=folder, capture_output=True, text=True, check=True
    )
    out = in_units(
        np.array([float(v) for v in done.stdout.split()]), model.input, arithmetic
    )
    assert out.size == 3001
    assert np.isfinite(out).all()
    assert out.min() >= 0.1 - 1e-9
    assert out.max() <= 0.8 + 1e-9


TYPES_IN_C = {"double": "double", "float": "float", "q31": "int32_t"}


@needs_compiler
@pytest.mark.parametrize("arithmetic", ["double", "float", "q31"])
def test_the_range_wins_over_the_slew_limit_in_every_arithmetic(
    arithmetic: Any, tmp_path: Path
) -> None:
    """Slew is kept from the drive given to reset on; a drive outside of the limits comes back at once."""
    model = made_model(1, terms=0, bend=False)
    span = model.input.span
    folder = tmp_path / "out"
    summary = export_model(
        model, str(folder), name="x", arithmetic=arithmetic, sample_rate=RATE, max_slew=5.0 * span,
        v_min=0.2 * span, v_max=0.9 * span,
    )  # fmt: skip
    play = compiled(folder, "x", arithmetic, summary.gears)
    desired = np.concatenate(
        [np.full(60, model.output.minimum), np.full(400, model.output.maximum)]
    )
    given, _ = as_given(desired, model.output, arithmetic)
    trimmed, _ = as_given(np.array([0.5 * span, 0.0]), model.input, arithmetic)
    for drive, first in zip(trimmed.tolist(), (0.495 * span, 0.2 * span), strict=True):
        out = in_units(play(given, drive)[0], model.input, arithmetic)
        assert out[0] == pytest.approx(first, abs=1e-6 * span)
        assert np.abs(np.diff(out)).max() <= 0.005 * span + 3e-7 * span
        assert out.min() >= 0.2 * span - 1e-9 * span
        assert out.max() == pytest.approx(0.9 * span, rel=1e-6)


def test_folding_points_and_scales_changes_nothing() -> None:
    model = made_model(2)
    for one in (model, model.inverse()):
        for stages, (low, high) in (
            (one.head, (one.input.minimum, one.input.maximum)),
            (one.tail, one.backlash.y_range),
        ):
            folded = fold(stages, low, high)
            x = np.linspace(low - 0.2 * (high - low), high + 0.2 * (high - low), 999)
            c = np.clip(np.searchsorted(folded.x, x, side="right") - 1, 0, None)
            y = folded.y[c] + folded.slope[c] * (x - folded.x[c])
            expected = through(stages, x.copy())
            np.testing.assert_allclose(
                y, expected, rtol=0.0, atol=1e-9 * np.ptp(expected)
            )


@pytest.mark.parametrize(
    ("n", "run"), [(1, 1), (1152, 18), (46340, 46340), (46340, 3), (46340, 1), (97, 7)]
)
def test_the_row_of_a_gear_without_a_division(n: int, run: int) -> None:
    shift = row_shift(n, run)
    factor = (2**shift + run - 1) // run
    gears = np.arange(n, dtype=np.uint64)
    assert int(gears[-1]) * factor < 2**32
    np.testing.assert_array_equal(gears * factor >> shift, gears // run)


@needs_compiler
def test_build_files(tmp_path: Path) -> None:
    """make test and the example work as they are; cmake where it is there."""
    folder = tmp_path / "out"
    export_model(made_model(0), str(folder), name="stage", sample_rate=RATE)
    done = subprocess.run(
        ["make", "test", "example"],
        cwd=folder,
        capture_output=True,
        text=True,
        check=True,
    )
    assert "every bit as expected" in done.stdout
    shown = subprocess.run(
        ["./example"], cwd=folder, capture_output=True, text=True, check=True
    )
    drive = np.asarray(shown.stdout.split(), float)
    assert drive.size == 200 and np.ptp(drive) > 0.2 * made_model(0).input.span
    # no leap for an amplifier to follow
    assert np.abs(np.diff(drive)).max() < 0.1 * np.ptp(drive)
    if shutil.which("cmake"):
        cmake(folder, "-S", ".", "-B", "build")
        cmake(folder, "--build", "build")
        subprocess.run(["ctest"], cwd=folder / "build", capture_output=True, check=True)


@needs_compiler
def test_arduino_layout(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    export_model(
        made_model(0),
        str(folder),
        name="stage",
        sample_rate=RATE,
        arduino=True,
        arithmetic="float",
    )
    assert (
        (folder / "library.properties").read_text().startswith("name=stage\nversion=")
    )
    assert (
        "stage_step(&state, input)"
        in (folder / "examples" / "stage" / "stage.ino").read_text()
    )
    sources = ["extras/stage_test.c", "src/stage.c", "src/dbo_kernel.c"]
    compile_c(folder, *WARNINGS, "-Isrc", *sources, "-o", "t")
    subprocess.run(["./t"], cwd=folder, check=True, capture_output=True)


@pytest.mark.skipif(shutil.which("cppcheck") is None, reason="no cppcheck")
def test_a_static_check_finds_nothing(tmp_path: Path) -> None:
    for arithmetic, gears in (
        ("double", None),
        ("float", None),
        ("q31", None),
        ("double", 8),
    ):
        folder = tmp_path / f"{arithmetic}{gears}"
        export_model(
            made_model(1), str(folder), name="x", arithmetic=arithmetic, sample_rate=RATE, gears=gears,  # type: ignore[arg-type]
            lookup=gears is not None,
        )  # fmt: skip
        done = subprocess.run(
            ["cppcheck", "--std=c99", "--enable=warning,style,performance,portability", "--inconclusive",
             "--quiet", "--error-exitcode=3", "."],
            cwd=folder, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert (done.returncode, done.stderr) == (0, "")


def test_the_same_model_gives_the_same_bytes(tmp_path: Path) -> None:
    for arithmetic in ("double", "float", "q31"):
        contents = []
        for k in range(2):
            folder = tmp_path / f"{arithmetic}{k}"
            export_model(
                made_model(1),
                str(folder),
                name="x",
                arithmetic=arithmetic,
                sample_rate=RATE,
            )  # type: ignore[arg-type]
            contents.append(
                {p.name: p.read_bytes() for p in folder.rglob("*") if p.is_file()}
            )
        assert contents[0] == contents[1]


COUNTED = """
#include "x.c"
#include <stdio.h>
extern uint32_t runs;
int main(void) {
    static const NUMBER ends[2] = {LOW, HIGH};
    static x_state state;
    uint32_t most = 0u;
    for (uint32_t k = 0u; k < 200u; k++) {
        x_reset(&state, (NUMBER)(DRIVE_LOW + (DRIVE_HIGH - DRIVE_LOW) * k / 200.0));
        runs = 0u;
        x_step(&state, ends[k % 2u]);
        if (runs > most) most = runs;
    }
    printf("%u", (unsigned)most);
    return 0;
}
"""


@needs_compiler
@pytest.mark.parametrize("arithmetic", ["float", "q31"])
@pytest.mark.parametrize(("gears", "slopes"), [(90, 90), (300, 100), (1000, 4)])
def test_a_step_crosses_no_more_runs_than_its_page_says(
    arithmetic: Any, gears: int, slopes: int, tmp_path: Path
) -> None:
    """A decayed oscillation leaves a turn every other gear; a move to an end looks up most of them."""
    folder, model = tmp_path / "out", made_model(3, gears=gears, slopes=slopes, terms=0)
    summary = export_model(model, str(folder), name="x", arithmetic=arithmetic)
    kernel = (
        "#include <stdint.h>\nuint32_t runs;\n" + (folder / "dbo_kernel.c").read_text()
    )
    end_of_run = "if (!turned) depth--;"
    assert kernel.count(end_of_run) == 1
    kernel = kernel.replace(end_of_run, f"runs++; {end_of_run}")
    (folder / "dbo_kernel.c").write_text(kernel)
    ends = {
        "LOW": model.output.minimum, "HIGH": model.output.maximum,
        "DRIVE_LOW": model.drive.minimum, "DRIVE_HIGH": model.drive.maximum,
    }  # fmt: skip
    if arithmetic == "q31":
        ends = {
            "LOW": -(2**30),
            "HIGH": 2**30,
            "DRIVE_LOW": -(2.0**30),
            "DRIVE_HIGH": 2.0**30,
        }
    source = COUNTED.replace("NUMBER", "float" if arithmetic == "float" else "int32_t")
    for name in sorted(ends, key=len, reverse=True):
        source = source.replace(name, repr(ends[name]))
    (folder / "count.c").write_text(source)
    subprocess.run(
        [COMPILERS[0], "-O1", "count.c", "dbo_kernel.c", "-o", "count"],
        cwd=folder,
        check=True,
    )
    most = int(
        subprocess.run(
            ["./count"], cwd=folder, capture_output=True, text=True, check=True
        ).stdout
    )
    one_pass = summary.worst_runs // 2  # limits may ask for another
    assert one_pass == {90: 2 + 8 + 1, 300: 2 + 32 + 1, 1000: 2 + 32 + 1}[gears]
    assert one_pass / 2 <= most <= one_pass


@needs_compiler
@pytest.mark.parametrize("arithmetic", ["float", "q31"])
@pytest.mark.parametrize(
    ("gears", "slopes"), [(33, 3), (127, 9), (192, 24), (130, 130)]
)
def test_jumps_end_in_the_states_of_the_gear_by_gear_twin(
    arithmetic: Any, gears: int, slopes: int, tmp_path: Path
) -> None:
    """Jumps from an end to anywhere, and to just before a run's end, where the tolerance decides."""
    folder, model = (
        tmp_path / "out",
        made_model(gears, gears=gears, slopes=slopes, terms=0, bend=False),
    )
    plan = plan_cascade(model, "forward", None, None)
    axes = axes_of(plan)
    close = derive_bounds(plan, axes, arithmetic == "q31")["close_turn_fraction"]
    tables = single_tables(plan, axes, arithmetic == "q31", close)
    export_model(
        model, str(folder), name="x", arithmetic=arithmetic, direction="forward"
    )
    rng = np.random.default_rng(gears)
    at = np.column_stack([rng.integers(0, 2, 2_000), rng.uniform(0.0, 1.0, 2_000)])
    ends = np.rint(at[::2, 1] * slopes) * tables.run
    at[::2, 1] = (
        ends + np.where(at[::2, 0] > 0.5, 1.0, -1.0) * rng.uniform(0.0, close, 1_000)
    ) / gears
    at = at.ravel()
    given, _ = as_given(
        model.input.minimum + model.input.span * at, model.input, arithmetic
    )
    kernel = SingleKernel(tables)
    twin = [kernel.step(x if arithmetic == "float" else int(x)) for x in given]
    for flags in (("-O2",), ("-O2", "-DDBO_SOFT_FLOAT")):
        got, _ = compiled(folder, "x", arithmetic, gears, flags)(given)
        assert got.tobytes() == np.array(twin, got.dtype).tobytes()


@needs_compiler
@pytest.mark.parametrize("arithmetic", ["double", "float", "q31"])
@pytest.mark.parametrize("gears", [17, 60, 255, 256, 400])
def test_many_turns_are_wiped_out_as_gear_by_gear(
    arithmetic: Any, gears: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Swings that shrink by a gear leave a turn each; moves then wipe out a part of them, or all."""
    folder, model = (
        tmp_path / "out",
        made_model(gears, gears=gears, slopes=gears, terms=0, bend=False),
    )
    rng = np.random.default_rng(gears)
    swings = 0.5 + 0.5 * (-1.0) ** np.arange(gears) * (1.0 - np.arange(gears) / gears)
    moves = [
        np.append(swings[: rng.integers(2, gears)], rng.uniform(-0.1, 1.1, 3))
        for _ in range(12)
    ]
    x = model.input.minimum + model.input.span * np.concatenate(moves)
    export_model(
        model, str(folder), name="x", arithmetic=arithmetic, direction="forward"
    )
    if arithmetic == "double":
        monkeypatch.setattr(kernel, "CHOSEN", kernel.PythonKernel)
        given, expected = (
            x,
            model.simulate(x, ModelState(BacklashState(0, ()), drive=0.0)).y,
        )
    else:
        given, _ = as_given(x, model.input, arithmetic)
        plan = plan_cascade(model, "forward", None, None)
        axes = axes_of(plan)
        close = derive_bounds(plan, axes, arithmetic == "q31")["close_turn_fraction"]
        twin = SingleKernel(single_tables(plan, axes, arithmetic == "q31", close))
        expected = np.array(
            [twin.step(v if arithmetic == "float" else int(v)) for v in given]
        )
    got, _ = compiled(folder, "x", arithmetic, gears)(given)
    assert got.tobytes() == expected.astype(got.dtype).tobytes()


def test_the_summary_and_the_page_agree(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    model = delayed(made_model(1), 0.002)
    summary = export_model(
        model, str(folder), name="x", arithmetic="q31", sample_rate=RATE, gears=48
    )
    told = json.loads((folder / "export.json").read_text())
    found = (str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file())
    assert sorted(summary.files) == sorted(found)
    assert (told["format"], told["gears"], told["table_bytes"]) == (
        "dbo-export",
        48,
        summary.table_bytes,
    )
    page = (folder / "README.md").read_text()
    assert f"{summary.table_bytes} bytes" in page
    assert f"{summary.bounds['same_gears_percent']:.3g}" in page
    assert "Read 0.002 s (2 samples) ahead" in page
    assert summary.gears_loss["max_percent"] > 0.0
    assert f"{summary.gears_loss['max']:.3g}" in page
    assert "#define X_READ_AHEAD_S   0.002" in (folder / "x.h").read_text()


def test_sizes_are_those_of_a_32_bit_chip(tmp_path: Path) -> None:
    compiler = shutil.which("arm-none-eabi-gcc")
    if compiler is None:
        pytest.skip("no arm-none-eabi-gcc")
    for arithmetic in ("double", "float", "q31"):
        folder = tmp_path / arithmetic
        summary = export_model(
            made_model(1),
            str(folder),
            name="x",
            arithmetic=arithmetic,
            sample_rate=RATE,
        )  # type: ignore[arg-type]
        (folder / "size.c").write_text(
            f'#include "x.h"\ntypedef char right[sizeof(x_state) == {summary.state_bytes} ? 1 : -1];\n'
        )
        subprocess.run(
            [compiler, "-std=c99", "-c", "size.c", "-o", "size.o"],
            cwd=folder,
            check=True,
        )


REFUSED: list[tuple[dict[str, Any], type[DboError], str]] = [
    (
        {"name": "2fast"},
        UsageError,
        "`name` '2fast': is no C identifier (a letter first, then",
    ),
    ({"name": "größe"}, UsageError, "`name` 'größe': is no C identifier"),
    (
        {"name": "while"},
        UsageError,
        "`name` 'while': is a reserved word of C or C++ (choose another)",
    ),
    ({"name": "Class"}, UsageError, "`name` 'Class': is a reserved word"),
    (
        {"name": "dbo_kernel"},
        UsageError,
        "`name` 'dbo_kernel': is taken by the files of the export",
    ),
    (
        {"name": "x" * 41},
        UsageError,
        "`name` '" + "x" * 41 + "': has 41 characters; at most 40",
    ),
    (
        {"arithmetic": "q15"},
        UsageError,
        "`arithmetic` 'q15': there are double, float, q31",
    ),
    ({"direction": "up"}, UsageError, "`direction` 'up': there are inverse, forward"),
    (
        {"sample_rate": None},
        UsageError,
        "the model depends on the time between samples: give `sample_rate`",
    ),
    (
        {"sample_rate": 0.0},
        UsageError,
        "`sample_rate` 0.0: must be a frequency in Hz greater than 0",
    ),
    ({"sample_rate": float("nan")}, UsageError, "`sample_rate` nan: must be"),
    (
        {"gears": 0},
        UsageError,
        "`gears` 0: the model has 288; give a number from 1 to that",
    ),
    ({"gears": 289}, UsageError, "`gears` 289: the model has 288"),
    (
        {"direction": "forward", "max_slew": 1.0},
        UsageError,
        "limits on the drive (`v_min`, `v_max`",
    ),
    ({"v_min": 5.0, "v_max": 4.0}, UsageError, "`v_min` 5 must be below `v_max` 4"),
    (
        {"arithmetic": "q31", "v_max": 1e6, "extrapolate": True},
        ModelError,
        "`v_min`, `v_max`: beyond twice the model's range",
    ),
    (
        {"extrapolate": True},
        UsageError,
        "`extrapolate` goes as far as `v_min` and `v_max` say",
    ),
    (
        {"arithmetic": "q31", "max_slew": 1e-9},
        ModelError,
        "`max_slew`: less than this arithmetic resolves",
    ),
    (
        {"arithmetic": "q31", "sample_rate": 1e14},
        ModelError,
        "relaxation.tau: a memory this slow at",
    ),
    ({"sample_rate": 1e300}, ModelError, "relaxation.tau: "),
]


@pytest.mark.parametrize(
    ("changes", "kind", "message"), REFUSED, ids=lambda value: str(value)[:40]
)
def test_what_is_refused(
    changes: dict[str, Any], kind: type[DboError], message: str, tmp_path: Path
) -> None:
    """One line, and nothing is left behind."""
    arguments: dict[str, Any] = {"name": "x", "sample_rate": RATE, **changes}
    with pytest.raises(kind) as problem:
        export_model(made_model(1), str(tmp_path / "out"), **arguments)
    assert str(problem.value).startswith(message)
    assert "\n" not in str(problem.value)
    assert list(tmp_path.iterdir()) == []


def test_reserved_words_are_no_names() -> None:
    for word in RESERVED:
        with pytest.raises(UsageError):
            check_name(word)
    for word in ("stage", "Piezo_2", "x", "main_stage"):
        check_name(word)


@needs_compiler
@pytest.mark.parametrize("arithmetic", ["float", "q31"])
@pytest.mark.parametrize("direction", ["forward", "inverse"])
def test_a_memory_may_refer_to_what_is_far_from_the_range(
    arithmetic: Any, direction: Any, tmp_path: Path
) -> None:
    """0 V where the range is 100 to 120 V: at first the memories lie five ranges away."""
    terms = Relaxation(0.0, (0.05,), (0.01,))
    gears = DiscreteBacklashOperator(
        np.full(64, 20 / 64), np.full(64, 1 / 64), 100.0, 0.0, terms
    )
    model = ActuatorModel(
        "forward",
        Quantity("voltage", "V", 100.0, 120.0),
        Quantity("displacement", "um", 1.0, 2.2),
        (gears,),
    )
    source, result = (model.input, model.output)[:: 1 if direction == "forward" else -1]
    wave = 0.5 + 0.4 * np.sin(0.02 * np.arange(3000))
    given, real = as_given(source.minimum + source.span * wave, source, arithmetic)
    found = {}
    for kind, x in (("double", real), (arithmetic, given)):
        summary = export_model(
            model,
            str(tmp_path / kind),
            name="x",
            arithmetic=kind,
            direction=direction,
            sample_rate=RATE,
        )
        y = compiled(tmp_path / kind, "x", kind, summary.gears)(x)[0]
        found[kind] = in_units(y, result, kind)
    assert (
        np.abs(found[arithmetic] - found["double"]).max()
        < 1.5 * summary.bounds["same_gears"]
    )
    assert compile_and_run(tmp_path / arithmetic, "x", COMPILERS[0], []).returncode == 0


def test_gears_too_narrow_for_float(tmp_path: Path) -> None:
    """A range of 1 V at 1000 V: float32 resolves 7 % of a gear there, q31 counts from the range's middle."""
    model = ActuatorModel(
        "forward", Quantity("voltage", "V", 1000.0, 1001.0), Quantity("displacement", "um", 0.0, 1.0),
        (DiscreteBacklashOperator(np.full(1152, 1 / 1152), np.full(1152, 1 / 1152), 1000.0, 0.0),),
    )  # fmt: skip
    refused = (
        r"^1152 gears are too narrow .* % of the smallest"
        r" \(`gears` 288, or `arithmetic` double or q31\)$"
    )
    with pytest.raises(ModelError, match=refused):
        export_model(
            model,
            str(tmp_path / "out"),
            name="x",
            arithmetic="float",
            direction="forward",
        )
    export_model(
        model,
        str(tmp_path / "less"),
        name="x",
        arithmetic="float",
        direction="forward",
        gears=288,
    )
    export_model(
        model, str(tmp_path / "out"), name="x", arithmetic="q31", direction="forward"
    )


def test_folders(tmp_path: Path) -> None:
    """Whole or not at all; an export is replaced only when asked for, anything else never."""
    model, folder = made_model(0, terms=0), tmp_path / "out"
    export_model(model, str(folder), name="first")
    with pytest.raises(
        OutputError,
        match=r"the folder exists already \(`overwrite` replaces an export\)$",
    ):
        export_model(model, str(folder), name="second")
    export_model(model, str(folder), name="second", overwrite=True)
    assert not (folder / "first.c").exists()
    (folder / "second_test").write_text("what make test leaves")
    (folder / "second.o").write_text("what make arm leaves")
    export_model(model, str(folder), name="second", overwrite=True)
    (folder / "mine.c").write_text("int mine;\n")
    with pytest.raises(
        OutputError,
        match=r"holds 'mine\.c', which no export wrote: it is not overwritten",
    ):
        export_model(model, str(folder), name="third", overwrite=True)
    assert (folder / "second.c").exists()
    assert (folder / "mine.c").read_text() == "int mine;\n"
    with pytest.raises(OutputError, match="create it first"):
        export_model(model, str(tmp_path / "no" / "out"), name="x")
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="is no folder: choose another name"):
        export_model(model, str(tmp_path / "file"), name="x", overwrite=True)
    assert {p.name for p in tmp_path.iterdir()} == {"out", "file"}


def test_a_folder_that_cannot_be_written_leaves_the_old_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model, folder = made_model(0, terms=0), tmp_path / "out"
    export_model(model, str(folder), name="first")
    before = {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()}

    def full(self: Path, data: bytes) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OutputError, match="cannot be written: No space left on device"):
        export_model(model, str(folder), name="second", overwrite=True)
    assert {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()} == before
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_a_stage_of_another_kind_is_refused() -> None:
    class Resonance:
        def inverse(self) -> Resonance:
            return self

    model = made_model(1, terms=0)
    stages = (*model.stages, Resonance())
    with pytest.raises(
        ModelError, match=r"^stages\[4\]: a Resonance cannot be exported"
    ):
        plan_cascade(
            ActuatorModel("forward", model.input, model.output, stages),
            "forward",
            None,
            None,
        )  # type: ignore[arg-type]


def resonant_model() -> ActuatorModel:
    model = made_model(1, terms=2)
    sections = (Resonance(60.0, 0.05), Lag(0.002))
    stages = (*model.stages, DynamicsStage(sections), DelayStage(0.003))
    return ActuatorModel("forward", model.input, model.output, stages)


def test_dynamics_are_beyond_float_and_q31(tmp_path: Path) -> None:
    for arithmetic in ("float", "q31"):
        with pytest.raises(
            ModelError,
            match=r"^dynamics are beyond float and q31 \(`arithmetic` double, or",
        ):
            export_model(
                resonant_model(),
                str(tmp_path / "o"),
                name="x",
                arithmetic=arithmetic,
                sample_rate=RATE,  # type: ignore[arg-type]
            )
    assert list(tmp_path.iterdir()) == []


@needs_compiler
@pytest.mark.parametrize("direction", ["inverse", "forward"])
def test_dynamics_at_a_fixed_step(direction: Any, tmp_path: Path) -> None:
    """Resonance, lag and delay; the inverse answers later by the samples it holds back."""
    model = resonant_model()
    summary = export_model(
        model, str(tmp_path / "out"), name="x", direction=direction, sample_rate=RATE
    )
    sources = ["x_test.c", "x.c", "dbo_kernel.c", "dbo_dynamics.c"]
    compile_c(tmp_path / "out", *WARNINGS, *SANITIZERS, *sources, "-o", "t")
    subprocess.run(["./t"], cwd=tmp_path / "out", check=True, capture_output=True)
    if direction == "forward":
        return
    inverter = model.inverse().dynamics.inverter(1.0 / RATE)  # type: ignore[union-attr]
    assert f"Read {inverter.ahead / RATE + 0.003!r} s" in summary.notes[1]


def lagging_model(seed: int, gears: int = 288, **more: Any) -> ActuatorModel:
    plain = made_model(seed, gears=gears, **more)
    first = DynamicsStage((Lag((0.0005, 0.004, 0.02)[seed]),))
    return replace(plain, stages=(first, *plain.stages))


@needs_compiler
@pytest.mark.parametrize("direction", ["inverse", "forward"])
@pytest.mark.parametrize("behind", [False, True])
def test_a_lag_before_the_gears_at_a_fixed_step(
    direction: Any, behind: bool, tmp_path: Path
) -> None:
    """Alone, its gears a table of all their states; with dynamics and a delay behind, and a slew limit."""
    model = lagging_model(1, 288 if behind else 10, slopes=5, terms=2)
    if behind:
        stages = (
            *model.stages,
            DynamicsStage((Resonance(60.0, 0.05),)),
            DelayStage(0.003),
        )
        model = replace(model, stages=stages)
    slew = 40.0 * model.input.span if direction == "inverse" and behind else None
    export_model(
        model, str(tmp_path / "out"), name="x", direction=direction, sample_rate=RATE, max_slew=slew,
        lookup=not behind,
    )  # fmt: skip
    sources = [
        "x_test.c",
        "x.c",
        "dbo_kernel.c",
        "dbo_dynamics.c",
        *([] if behind else ["dbo_lookup.c"]),
    ]
    compile_c(tmp_path / "out", *WARNINGS, *SANITIZERS, *sources, "-o", "t")
    done = subprocess.run(
        ["./t"], cwd=tmp_path / "out", check=False, capture_output=True, text=True
    )
    assert (done.returncode, done.stdout) == (
        0,
        "x: 526 samples, every bit as expected\n",
    )


@needs_compiler
@pytest.mark.parametrize("slew", [None, 20.0])
def test_a_lag_before_the_gears_gives_the_bits_of_compensate(
    slew: float | None, tmp_path: Path
) -> None:
    """Random moves, many of which the limits cut off; bent drives and falling ones among them."""
    for seed in range(3):
        model = lagging_model(seed, bend=seed != 1)
        low, high = model.input.minimum, model.input.maximum
        limits = DriveLimits(
            low + 0.03 * (high - low),
            high,
            None if slew is None else slew * (high - low),
        )
        folder = tmp_path / f"out{seed}"
        summary = export_model(
            model,
            str(folder),
            name="x",
            sample_rate=RATE,
            v_min=limits.v_min,
            max_slew=limits.max_slew,
        )
        plan = plan_cascade(model, "inverse", RATE, limits)
        rng = np.random.default_rng(seed)
        desired = random_moves(rng, model.output.minimum, model.output.maximum, 2_000)
        done = plan.model.simulate(
            desired, plan.empty_state(), time_step=1.0 / RATE, limits=limits
        )
        assert done.clipped_count > 20
        play = compiled(
            folder, "x", "double", summary.gears, others=("dbo_dynamics.c",)
        )
        got, _ = play(desired)
        assert got.tobytes() == done.y.tobytes()
        start = model.start_compensation(float(desired[0]), "auto", limits)
        drive = model.compensate(desired, start, limits=limits, time_step=1.0 / RATE).y
        got, _ = play(desired[1:], float(drive[0]))
        # the first drive is rounded by a bend
        assert np.abs(got - drive[1:]).max() <= 1e-13 * (high - low)


def test_steep_gears_are_beyond_q31(tmp_path: Path) -> None:
    base = made_model(1, terms=0, points=0, bend=False)
    gears = DiscreteBacklashOperator([1.0, 1e-7], [1e-7, 1.0], 0.0, 0.0)
    stages = tuple(
        gears if isinstance(s, DiscreteBacklashOperator) else s for s in base.stages
    )
    with pytest.raises(ModelError):
        export_model(
            ActuatorModel("forward", base.input, base.output, stages), str(tmp_path / "o"), name="x",
            arithmetic="q31",
        )  # fmt: skip
    assert list(tmp_path.iterdir()) == []


def test_slow_memories_do_not_stand_still_in_float(tmp_path: Path) -> None:
    """A time constant of 10^5 samples: float32 alone would stop at 2^-24 of the value a step."""
    if not COMPILERS:
        pytest.skip("no C compiler")
    base = made_model(0, gears=16, slopes=16, terms=0, points=0, bend=False)
    old = base.backlash
    gears = DiscreteBacklashOperator(
        old.dx, old.dy, old.x0, old.y0, Relaxation(0.0, (100.0,), (0.05,))
    )
    stages = tuple(
        gears if isinstance(s, DiscreteBacklashOperator) else s for s in base.stages
    )
    model = ActuatorModel("forward", base.input, base.output, stages)
    held = np.full(300_000, 0.7 * base.input.maximum)
    results = []
    for arithmetic in ("double", "float"):
        folder = tmp_path / arithmetic
        summary = export_model(
            model,
            str(folder),
            name="x",
            direction="forward",
            arithmetic=arithmetic,
            sample_rate=RATE,  # type: ignore[arg-type]
        )
        results.append(
            compiled(folder, "x", arithmetic, summary.gears)(held)[0].astype(np.float64)
        )
    crept = results[0][-1] - results[0][0]
    assert abs(crept) > 0.01 * model.output.span
    assert np.abs(results[1] - results[0]).max() <= summary.bounds["same_gears"]


@pytest.mark.parametrize(("narrow", "fits"), [(1e-4, True), (1e-5, False)])
def test_a_gear_too_steep_for_q31_is_refused(
    narrow: float, fits: bool, tmp_path: Path
) -> None:
    widths, heights = np.ones(8), np.full(8, 0.01)
    widths[0], heights[0] = narrow, 1.0
    gears = DiscreteBacklashOperator(widths, heights, 0.0, 0.0)
    volts = Quantity("voltage", "V", 0.0, float(widths.sum()))
    moved = Quantity("displacement", "um", 0.0, float(heights.sum()))
    model = ActuatorModel("forward", volts, moved, (gears,))
    words: dict[str, Any] = {"name": "x", "direction": "forward", "arithmetic": "q31"}
    if fits:
        assert export_model(model, str(tmp_path / "out"), **words).gears == 8
        return
    with pytest.raises(
        ModelError,
        match=r"^dy: a gear too steep for q31 \(`arithmetic` float or double\)$",
    ):
        export_model(model, str(tmp_path / "out"), **words)
    assert not (tmp_path / "out").exists()
