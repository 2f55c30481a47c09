"""The program as it is installed, on whatever system: processes, files and exit codes, and nothing of POSIX.

.github/workflows/wheels.yml and .ci/run run these against wheels; they need pytest and
the program alone.
"""

from __future__ import annotations

import gzip
import json
import os
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import h5py
import numpy as np
import polars
import pytest
import scipy.io

# A checkout that is in use lists none of the package's files.
RECORDS = [
    found.read_text("RECORD") or "" for found in metadata.distributions(name="dbo-cli")
]
FILES = {line.split(",")[0] for record in RECORDS for line in record.splitlines()}
if "dbo_cli/__init__.py" not in FILES:
    pytest.skip(
        "the program is used from its checkout, as in all other tests",
        allow_module_level=True,
    )

DBO = [sys.executable, "-m", "dbo_cli"]
COMMANDS = [
    "identify", "show", "invert", "simulate", "compensate", "check", "report", "excite", "export", "compare",
    "trajectory", "waveform",
]  # fmt: skip
MODEL = {
    "format": "dbo-model",
    "version": 1,
    "direction": "forward",
    "input": {"quantity": "voltage", "unit": "V", "min": 0.0, "max": 10.0},
    "output": {"quantity": "displacement", "unit": "um", "min": 1.0, "max": 11.0},
    "stages": [
        {
            "type": "backlash",
            "x0": 0.0,
            "y0": 0.0,
            "dx": [1.0, 2.0, 3.0, 4.0],
            "dy": [0.25, 0.75, 1.5, 2.5],
        },
        {"type": "scale", "gain": 2.0, "offset": 1.0},
    ],
}
DRIVE = {"time_s": [0.0, 0.5, 1.0, 1.5], "voltage_V": [0.0, 5.0, 10.0, 5.0]}
DRIVE_CSV = "time_s,voltage_V\n0.0,0.0\n0.5,5.0\n1.0,10.0\n1.5,5.0\n"
RESULT = [1.0, 5.0, 11.0, 7.0]
RESULT_CSV = b"time_s,voltage_V,displacement_um\n0.0,0.0,1.0\n0.5,5.0,5.0\n1.0,10.0,11.0\n1.5,5.0,7.0\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder, its name not of the English alphabet, with a model and a drive."""
    place = tmp_path / "Größe µm, 位置"
    place.mkdir()
    (place / "model.json").write_text(json.dumps(MODEL), encoding="utf-8")
    (place / "drive.csv").write_text(DRIVE_CSV, encoding="utf-8", newline="\n")
    return place


def dbo(
    folder: Path, *words: str, stdin: bytes = b""
) -> subprocess.CompletedProcess[bytes]:
    """Run a command line in a folder, without what the environment says about Python."""
    clean = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith("PYTHON")
    }
    return subprocess.run(
        [*DBO, *words],
        cwd=folder,
        env=clean,
        input=stdin,
        capture_output=True,
        check=False,
        timeout=300,
    )


def test_the_kernel_is_the_compiled_one(folder: Path) -> None:
    script = "from dbo_cli.hysteresis import kernel; print(kernel.KIND)"
    run = [sys.executable, "-c", script]
    done = subprocess.run(run, cwd=folder, capture_output=True, text=True, check=True)
    assert done.stdout == "compiled\n"


def test_version(folder: Path) -> None:
    done = dbo(folder, "--version")
    assert (done.returncode, done.stdout.split()[:1]) == (0, [b"dbo"])


@pytest.mark.parametrize("command", COMMANDS)
def test_help(folder: Path, command: str) -> None:
    done = dbo(folder, command, "--help")
    assert done.returncode == 0
    assert b"Usage: dbo " + command.encode() in done.stdout


def test_what_a_wheel_brings_beside_the_modules() -> None:
    for name in (
        *(f"share/man/man1/dbo-{one}.1" for one in COMMANDS),
        "dbo_cli/py.typed",
        "/licenses/LICENSE",
    ):
        assert any(one.endswith(name) for one in FILES), name


def hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        for name, values in DRIVE.items():
            file[name] = values


def npy(path: Path) -> None:
    record = np.empty(4, [(name, "f8") for name in DRIVE])
    for name, values in DRIVE.items():
        record[name] = values
    np.save(path, record)


WRITERS = {
    "run.csv": lambda path: path.write_bytes(DRIVE_CSV.encode()),
    "run.csv.gz": lambda path: path.write_bytes(gzip.compress(DRIVE_CSV.encode())),
    "crlf.txt": lambda path: path.write_bytes(DRIVE_CSV.replace("\n", "\r\n").encode()),
    "run.h5": hdf5,
    "run.npy": npy,
    "run.npz": lambda path: np.savez(
        path, **{name: np.array(values) for name, values in DRIVE.items()}
    ),
    "run.mat": lambda path: scipy.io.savemat(path, DRIVE),
    "run.parquet": lambda path: polars.DataFrame(DRIVE).write_parquet(path),
}


@pytest.mark.parametrize("name", WRITERS)
def test_formats_that_are_read(folder: Path, name: str) -> None:
    WRITERS[name](folder / name)
    done = dbo(folder, "simulate", "model.json", name)
    assert (done.returncode, done.stdout) == (0, RESULT_CSV), done.stderr


@pytest.mark.parametrize(
    "name", ["out.csv", "out.tsv", "out.csv.gz", "out.h5", "out.h5::/run/1"]
)
def test_formats_that_are_written_and_replaced(folder: Path, name: str) -> None:
    for _ in range(2):
        done = dbo(folder, "simulate", "model.json", "drive.csv", "-o", name)
        assert (done.returncode, done.stdout) == (0, b""), done.stderr
    path, _, group = name.partition("::")
    if path.endswith(".h5"):
        with h5py.File(folder / path) as file:
            assert file[f"{group}/displacement_um"][:].tolist() == RESULT
    else:
        data = (folder / path).read_bytes()
        data = gzip.decompress(data) if path.endswith(".gz") else data
        assert data.replace(b"\t", b",") == RESULT_CSV
    assert sorted(os.listdir(folder)) == sorted(["model.json", "drive.csv", path])


def test_pipes(folder: Path) -> None:
    done = dbo(folder, "simulate", "model.json", "-", stdin=DRIVE_CSV.encode())
    assert (done.returncode, done.stdout) == (0, RESULT_CSV)
    done = dbo(folder, "invert", "-", stdin=json.dumps(MODEL).encode())
    assert (done.returncode, json.loads(done.stdout)["direction"]) == (0, "inverse")


def test_a_state_is_saved_and_taken_up(folder: Path) -> None:
    (folder / "two.csv").write_text("time_s,voltage_V\n1.5,5.0\n", encoding="utf-8")
    (folder / "one.csv").write_text(
        DRIVE_CSV.replace("1.5,5.0\n", ""), encoding="utf-8"
    )
    assert (
        dbo(
            folder, "simulate", "model.json", "one.csv", "--save-state", "state.json"
        ).returncode
        == 0
    )
    done = dbo(folder, "simulate", "model.json", "two.csv", "--state", "state.json")
    assert (done.returncode, done.stdout) == (
        0,
        b"time_s,voltage_V,displacement_um\n1.5,5.0,7.0\n",
    )


def test_compensation_undoes_the_model(folder: Path) -> None:
    assert (
        dbo(folder, "simulate", "model.json", "drive.csv", "-o", "moved.csv").returncode
        == 0
    )
    done = dbo(folder, "compensate", "model.json", "moved.csv", "-o", "back.csv")
    assert done.returncode == 0, done.stderr
    back = np.genfromtxt(folder / "back.csv", delimiter=",", names=True)
    assert back["voltage_V"] == pytest.approx(DRIVE["voltage_V"], abs=1e-12)


def test_identification_and_report(folder: Path) -> None:
    done = dbo(folder, "excite", "--v-min", "0", "--v-max", "10", "--sample-rate", "100", "--duration", "20",
               "--frequency", "1", "-o", "drive.h5")  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert (
        dbo(folder, "simulate", "model.json", "drive.h5", "-o", "log.csv").returncode
        == 0
    )
    done = dbo(folder, "identify", "log.csv", "-o", "found.json")
    assert done.returncode == 0, done.stderr
    done = dbo(folder, "report", "log.csv", "--model", "found.json", "--format", "json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["logs"][0]["nrmse_percent"] < 5.0
    assert b"um" in dbo(folder, "show", "found.json").stdout


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        ("simulate model.json none.csv", 1, "none.csv: no such file"),
        ("simulate model.json drive.csv --nonsense", 2, "--nonsense"),
        (
            "simulate model.json drive.csv -o drive.csv",
            2,
            "drive.csv: this output is also an input",
        ),
        (
            "simulate model.json drive.csv -o nowhere/out.csv",
            1,
            "there is no folder 'nowhere'",
        ),
        ("simulate model.json drive.csv -o .", 1, "this is a folder: give a file name"),
        ("simulate model.json drive.csv -o out.xlsx", 2, ".xlsx files are not written"),
        ("simulate drive.csv model.json", 2, "the model comes first, then the log"),
        (
            "simulate model.json drive.csv --outside error --scale voltage=2",
            1,
            "is outside the range",
        ),
    ],
)
def test_errors_are_one_line_and_write_nothing(
    folder: Path, words: str, code: int, message: str
) -> None:
    done = dbo(folder, *words.split())
    lines = done.stderr.decode().splitlines()
    assert done.returncode == code, lines
    assert message in lines[-1]
    assert [line for line in lines if "Traceback" in line] == []
    assert sorted(os.listdir(folder)) == ["drive.csv", "model.json"]


@pytest.mark.skipif(os.name != "nt", reason="names of Windows")
@pytest.mark.parametrize("name", ["CON", "aux.csv", "com1.h5", "a:b.csv"])
def test_a_name_that_windows_gives_to_no_file(folder: Path, name: str) -> None:
    done = dbo(folder, "simulate", "model.json", "drive.csv", "-o", name)
    assert done.returncode == 1
    assert b"Windows has no file of this name" in done.stderr


def test_the_library(folder: Path) -> None:
    script = (
        "import dbo_cli, numpy\n"
        "model = dbo_cli.read_model('model.json')\n"
        "print(model.simulate(numpy.array([0.0, 5.0, 10.0, 5.0])).tolist())\n"
    )
    run = [sys.executable, "-c", script]
    done = subprocess.run(run, cwd=folder, capture_output=True, text=True, check=True)
    assert done.stdout == f"{RESULT}\n"
