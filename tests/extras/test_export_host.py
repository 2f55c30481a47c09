"""Exports for this computer and for few gears: the lookup table, the flat library, the FMU, the command."""

from __future__ import annotations

import ctypes
import json
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from compiling import COMPILERS, SANITIZERS, WARNINGS, compile_c
from exported import made_model, random_moves

from dbo_cli.errors import ModelError, OutputError, UsageError
from dbo_cli.extras.export.export import export_model
from dbo_cli.hysteresis.model import ActuatorModel, DriveLimits
from dbo_cli.hysteresis.model_file import model_to_bytes

needs_compiler = pytest.mark.skipif(not COMPILERS, reason="no C compiler")
RATE = 500.0


def small_model(seed: int, gears: int = 8, terms: int = 2) -> ActuatorModel:
    return made_model(seed, gears=gears, slopes=gears, terms=terms)


def compensated(model: ActuatorModel, desired: Any, slew: float | None = None) -> Any:
    limits = DriveLimits(model.input.minimum, model.input.maximum, slew)
    start = model.start_compensation(float(desired[0]), "auto", limits)
    return model.compensate(desired, start, limits=limits, time_step=1.0 / RATE).y


@needs_compiler
@pytest.mark.parametrize("gears", [1, 2, 12])
@pytest.mark.parametrize("direction", ["inverse", "forward"])
def test_the_lookup_table_gives_the_bits_of_the_recursion(
    gears: int, direction: Any, tmp_path: Path
) -> None:
    """The vectors come from the package's recursion; 10^5 more samples against the exported one."""
    model = small_model(gears % 3, gears, terms=gears % 3)
    slew = {"max_slew": 30.0 * model.input.span} if direction == "inverse" else {}
    outputs = []
    for lookup in (True, False):
        folder = tmp_path / f"lookup{lookup}"
        export_model(
            model, str(folder), name="x", direction=direction, sample_rate=RATE, lookup=lookup, shared=True,
            **slew,  # type: ignore[arg-type]
        )  # fmt: skip
        quantity = model.output if direction == "inverse" else model.input
        moves = random_moves(
            np.random.default_rng(gears), quantity.minimum, quantity.maximum, 100_000
        )
        moves[::97] += 0.1 * quantity.span
        outputs.append(run_flat(folder, "x", moves, None))
        outputs.append(run_flat(folder, "x", moves[:5000], 0.3 * model.input.maximum))
    assert outputs[0].tobytes() == outputs[2].tobytes()
    assert outputs[1].tobytes() == outputs[3].tobytes()
    folder = tmp_path / "lookupTrue"
    sources = ["x_test.c", "x.c", "dbo_kernel.c", "dbo_lookup.c"]
    compile_c(
        folder, *WARNINGS, *SANITIZERS, *sources, "-o", "t", compiler=COMPILERS[-1]
    )
    subprocess.run(["./t"], cwd=folder, check=True, capture_output=True)


def run_flat(folder: Path, name: str, inputs: Any, settled: float | None) -> Any:
    """Play inputs through the flat library by ctypes, in place, in two blocks."""
    library = ctypes.CDLL(str(next(folder.glob(f"lib{name}.*"))))
    create = getattr(library, f"{name}_create")
    create.restype = ctypes.c_void_p
    run = getattr(library, f"{name}_run")
    run.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int]
    start = getattr(library, f"{name}_start_settled")
    start.argtypes = [ctypes.c_void_p, ctypes.c_double]
    destroy = getattr(library, f"{name}_destroy")
    destroy.argtypes = [ctypes.c_void_p]
    handle = create()
    if settled is not None:
        assert start(handle, settled) == 0
    data = np.ascontiguousarray(inputs, dtype=np.float64).copy()
    cut = data.size // 3
    for part in (data[:cut], data[cut:]):
        assert run(handle, part.ctypes.data, part.ctypes.data, part.size) == 0
    assert run(None, 0, 0, 1) == -1
    assert destroy(handle) == 0
    return data


@needs_compiler
def test_the_shared_library_gives_the_bits_of_compensate(tmp_path: Path) -> None:
    model = made_model(1)
    desired = random_moves(
        np.random.default_rng(2), model.output.minimum, model.output.maximum, 4000
    )
    drive = compensated(model, desired)
    export_model(model, str(tmp_path / "out"), name="x", sample_rate=RATE, shared=True)
    assert (
        run_flat(tmp_path / "out", "x", desired[1:], float(drive[0])).tobytes()
        == drive[1:].tobytes()
    )
    library = ctypes.CDLL(str(next((tmp_path / "out").glob("libx.*"))))
    library.x_sample_rate.restype = ctypes.c_double
    assert library.x_sample_rate() == RATE


@needs_compiler
def test_fmpy_drives_the_fmu_as_compensate_does(tmp_path: Path) -> None:
    fmpy = pytest.importorskip("fmpy")
    from fmpy.validation import validate_fmu

    model = made_model(1, gears=90, slopes=30)
    desired = random_moves(
        np.random.default_rng(3), model.output.minimum, model.output.maximum, 600
    )
    drive = compensated(model, desired)
    export_model(model, str(tmp_path / "out"), name="x", sample_rate=RATE, fmu=True)
    path = str(tmp_path / "out" / "x.fmu")
    assert validate_fmu(path) == []
    described = fmpy.read_model_description(path)
    assert [v.name for v in described.modelVariables] == [
        "displacement", "drive" if False else "voltage", "initial_drive", "settled",
    ]  # fmt: skip
    unpacked = fmpy.extract(path, unzipdir=str(tmp_path / "unpacked"))
    unit = fmpy.instantiate_fmu(unpacked, described)
    unit.setupExperiment(startTime=0.0)
    unit.setReal([3], [float(drive[0])])
    unit.setBoolean([4], [True])
    unit.enterInitializationMode()
    unit.exitInitializationMode()
    outputs, saved, again = [], None, []
    for k, value in enumerate(desired[1:]):
        if k == 300:
            saved = unit.serializeFMUstate(unit.getFMUstate())
        unit.setReal([1], [float(value)])
        unit.doStep(
            currentCommunicationPoint=k / RATE, communicationStepSize=1.0 / RATE
        )
        outputs.append(unit.getReal([2])[0])
    assert np.array(outputs).tobytes() == drive[1:].tobytes()
    unit.setFMUstate(unit.deSerializeFMUstate(saved))
    for k, value in enumerate(desired[301:]):
        unit.setReal([1], [float(value)])
        unit.doStep(
            currentCommunicationPoint=k / RATE, communicationStepSize=1.0 / RATE
        )
        again.append(unit.getReal([2])[0])
    assert again == outputs[300:]
    with pytest.raises(fmpy.fmi1.FMICallException):
        unit.doStep(currentCommunicationPoint=0.0, communicationStepSize=0.4 / RATE)
    unit.terminate()
    unit.freeInstance()


@needs_compiler
def test_the_fmu_holds_the_sources_that_it_was_made_of(tmp_path: Path) -> None:
    for k in range(2):
        export_model(
            made_model(0),
            str(tmp_path / f"out{k}"),
            name="x",
            sample_rate=RATE,
            fmu=True,
        )
    contents = [(tmp_path / f"out{k}" / "x.fmu").read_bytes() for k in range(2)]
    assert contents[0] == contents[1]
    with zipfile.ZipFile(tmp_path / "out0" / "x.fmu") as archive:
        for name in ("x.c", "x.h", "dbo_kernel.c", "dbo_kernel.h"):
            assert (
                archive.read(f"sources/{name}")
                == (tmp_path / "out0" / name).read_bytes()
            )
        archive.extractall(tmp_path / "unpacked")
    compile_c(tmp_path / "unpacked" / "sources", *WARNINGS, "-c", "x_fmu.c")


def test_without_a_compiler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    for option in ("fmu", "shared"):
        with pytest.raises(OutputError, match="no C compiler"):
            export_model(
                small_model(0),
                str(tmp_path / "out"),
                name="x",
                sample_rate=RATE,
                **{option: True},
            )  # type: ignore[arg-type]
    assert list(tmp_path.iterdir()) == []


def test_what_contradicts_itself_is_refused(tmp_path: Path) -> None:
    model = made_model(0)
    for option in ("lookup", "fmu", "shared"):
        with pytest.raises(UsageError, match=f"^`{option}` needs `arithmetic` double$"):
            export_model(
                model,
                str(tmp_path / "out"),
                name="x",
                sample_rate=RATE,
                arithmetic="q31",
                **{option: True},  # type: ignore[arg-type]
            )
    with pytest.raises(
        UsageError, match=r"^`arduino` goes with neither `fmu` nor `shared`"
    ):
        export_model(
            model,
            str(tmp_path / "out"),
            name="x",
            sample_rate=RATE,
            arduino=True,
            fmu=True,
        )
    with pytest.raises(
        ModelError,
        match=r"^dx: 288 gears are too many for a table of all states, 12 at most",
    ):
        export_model(
            model, str(tmp_path / "out"), name="x", sample_rate=RATE, lookup=True
        )
    assert list(tmp_path.iterdir()) == []


def test_the_command(dbo: Any, tmp_path: Path) -> None:
    (tmp_path / "model.json").write_bytes(model_to_bytes(made_model(1)))
    done = dbo(
        "export",
        "model.json",
        "-o",
        "out",
        "--name",
        "piezo",
        "--arithmetic",
        "q31",
        "--sample-rate",
        1000,
    )
    assert (done.code, done.out) == (0, "")
    assert done.err.startswith("dbo: out: inverse model 'piezo' in q31, 288 gears in ")
    assert "dbo: error at most " in done.err
    assert (tmp_path / "out" / "piezo_test.c").exists()
    again = dbo(
        "export", "model.json", "-o", "out", "--name", "piezo", "--sample-rate", 1000
    )
    assert (again.code, again.err) == (
        1, "dbo: error: out: the folder exists already (--overwrite replaces an export)\n",
    )  # fmt: skip
    quiet = dbo(
        "export",
        "model.json",
        "-o",
        "out",
        "--name",
        "b",
        "--sample-rate",
        1000,
        "--overwrite",
        "-q",
    )
    assert quiet == (0, "", "")
    assert not (tmp_path / "out" / "piezo.c").exists()
    bad = dbo("export", "model.json", "-o", "new", "--name", "int")
    assert (bad.code, bad.err) == (
        2, "dbo: error: --name 'int': is a reserved word of C or C++ (choose another)\n",
    )  # fmt: skip
    missing = dbo("export", "model.json", "-o", "new", "--name", "x")
    assert (missing.code, missing.err) == (
        2,
        "dbo: error: the model depends on the time between samples: give --sample-rate in Hz\n",
    )
    assert not (tmp_path / "new").exists()


def test_the_manifest_tells_what_was_asked_for(tmp_path: Path) -> None:
    export_model(
        small_model(0), str(tmp_path / "out"), name="x", sample_rate=RATE, lookup=True
    )
    told = json.loads((tmp_path / "out" / "export.json").read_text())
    assert told["table_bytes"] > 17 * 2**8
    assert "dbo_lookup.c" in told["files"]
    assert sys.version_info >= (3, 11)
