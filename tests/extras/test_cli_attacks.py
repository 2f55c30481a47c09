"""What an attack on the command line found: outputs that fight, numbers that are none, names of any bytes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from conftest import folder_content

from dbo_cli.errors import InputError
from dbo_cli.extras.repeat.learning import read_history

ROOT = str(Path(__file__).resolve().parents[2])
DBO = [sys.executable, "-m", "dbo_cli"]
posix = pytest.mark.skipif(os.name != "posix", reason="needs POSIX streams")
LOG = "voltage_V\n0\n5\n10\n3\n"


def process(folder: Path, *words: str, **more: Any) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONPATH": ROOT}
    return subprocess.run(
        [*DBO, *words],
        cwd=folder,
        env=environment,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
        **more,
    )


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            "-o out.csv --save-state ./out.csv",
            "out.csv and ./out.csv are one file, and two outputs go there",
        ),
        (
            "-o out.h5::/g --save-state out.h5",
            "out.h5 is one file, and two outputs go there",
        ),
        (
            "-o out.csv --save-state model.json",
            "model.json: this output is also an input",
        ),
        ("-o ./log.csv", "./log.csv: this output is also an input"),
        ("-o drive.mat", "drive.mat: MATLAB's own files are not written"),
        ("-o out.h5.gz", "out.h5.gz: HDF5 is compressed inside: leave out .gz"),
        ("-o out.h5 --format csv", "out.h5: --format csv contradicts this name"),
    ],
)
def test_outputs_that_fight_are_refused(
    dbo: Any, model_file: Path, tmp_path: Path, words: str, said: str
) -> None:
    (tmp_path / "log.csv").write_text(LOG)
    outcome = dbo("simulate", "model.json", "log.csv", *words.split())
    assert (outcome.code, outcome.out) == (2, "")
    assert outcome.err.startswith(f"dbo: error: {said}")
    assert folder_content(tmp_path) == {"model.json", "log.csv"}


@pytest.mark.parametrize(
    "line", ["simulate \0 log.csv", "report \0", "report log.csv --displacement=\0"]
)
def test_a_nul_character_is_refused(dbo: Any, line: str) -> None:
    outcome = dbo(*line.split(" "))
    assert outcome.code == 2
    assert outcome.err == (
        "dbo: error: a word of the command line holds a NUL character, which no name and no value can\n"
    )


@pytest.mark.parametrize("option", ["comment", "delimiter"])
def test_a_byte_that_is_no_character_is_refused(
    dbo: Any, tmp_path: Path, option: str
) -> None:
    (tmp_path / "log.csv").write_text("measured,desired\n" + "1,2\n" * 9)
    outcome = dbo("report", "log.csv", f"--{option}", "\udcff")
    assert outcome.code == 2
    assert outcome.err == (
        f"dbo: error: --{option}: holds a byte that is no character in this terminal's encoding\n"
    )


def test_two_inputs_are_not_both_standard_input(dbo: Any) -> None:
    outcome = dbo("simulate", "-", "-")
    assert outcome.code == 2
    assert outcome.err.startswith("dbo: error: standard input can be read once only")
    outcome = dbo("report", "-", "-")
    assert outcome.code == 2
    assert outcome.err.startswith("dbo: error: two inputs are standard input")


@posix
def test_a_closed_standard_output_is_no_success(
    model_file: Path, tmp_path: Path
) -> None:
    (tmp_path / "log.csv").write_text(LOG)

    def closed() -> None:
        os.close(1)

    done = process(
        tmp_path, "simulate", "model.json", "log.csv", "--quiet", preexec_fn=closed
    )
    assert done.returncode == 1
    assert (
        done.stderr
        == "dbo: error: standard output: cannot be written: Bad file descriptor\n"
    )
    done = process(
        tmp_path,
        "simulate",
        "model.json",
        "log.csv",
        "-o",
        "out.csv",
        "--quiet",
        preexec_fn=closed,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "out.csv").read_text().startswith("voltage_V,displacement_um\n")


@posix
def test_a_state_that_was_asked_for_is_written_or_missed(
    model_file: Path, tmp_path: Path
) -> None:
    (tmp_path / "log.csv").write_text("voltage_V\n" + "1\n2\n" * 200_000)
    words = [
        *DBO,
        "simulate",
        "model.json",
        "log.csv",
        "--save-state",
        "state.json",
        "--quiet",
    ]
    running = subprocess.Popen(
        words,
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": ROOT},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    assert running.stdout is not None and running.stderr is not None
    running.stdout.readline()
    running.stdout.close()
    assert (
        b"its reader left before the end, so there is no last state to save"
        in running.stderr.read()
    )
    running.stderr.close()
    assert running.wait(60) == 1
    assert folder_content(tmp_path) == {"model.json", "log.csv"}


@posix
@pytest.mark.parametrize("limit", [500, 3000, 20_000])
def test_figures_and_report_appear_together_or_not_at_all(
    tmp_path: Path, limit: int
) -> None:
    import resource

    rows = "".join(
        f"{n / 100},{np.sin(n / 20)},{np.sin(n / 20) + 0.01}\n" for n in range(300)
    )
    (tmp_path / "run.csv").write_text("time_s,desired_um,measured_um\n" + rows)

    def full() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    words = [
        "report",
        "run.csv",
        "--figures",
        "all/figures",
        "-o",
        "report.json",
        "--quiet",
    ]
    done = process(tmp_path, *words, preexec_fn=full)
    assert done.returncode == 1
    assert (
        len(done.stderr.splitlines()) == 1
        and "cannot be written: File too large" in done.stderr
    )
    assert folder_content(tmp_path) == {"run.csv"}


def test_the_instruments_overflow_is_no_number(
    dbo: Any, model_file: Path, tmp_path: Path
) -> None:
    for text in ("9.91E+37", "-9.9e37", "+9.90000000E+37"):
        (tmp_path / "log.csv").write_text(f"voltage_V\n1\n{text}\n2\n")
        outcome = dbo("simulate", "model.json", "log.csv")
        shown = f"log.csv:3: column 'voltage_V' is the instrument's overflow: '{text}'"
        assert (outcome.code, outcome.err) == (
            1,
            f"dbo: error: {shown} (--skip-bad drops such rows)\n",
        )
    (tmp_path / "log.csv").write_text("voltage_V\n" + "1\n" * 300_000 + "9.91E37\n")
    assert (
        "log.csv:300002: column 'voltage_V' is the instrument's"
        in dbo("simulate", "model.json", "log.csv").err
    )
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["voltage"] = np.array([1.0, 9.91e37, 2.0], dtype=np.float32)
    assert (
        "row 2: column 'voltage' is not finite"
        in dbo("simulate", "model.json", "log.h5").err
    )


def test_numbers_beyond_sense_are_refused(
    dbo: Any, model_file: Path, tmp_path: Path
) -> None:
    (tmp_path / "log.csv").write_text("time_s,voltage_V\n0,0\n1,5\n2,3\n")
    for words, said in {
        "--resample 1e308": "--resample 1e+308: give between 1e-09 and 1e+12 samples a second",
        "--resample 1e10": "log.csv: --resample 1e+10 makes 20,000,000,001 rows of 3: give a lower rate",
        "--sample-rate 1e308": "--sample-rate 1e+308: give between 1e-09 and 1e+12 samples a second",
    }.items():
        outcome = dbo("simulate", "model.json", "log.csv", *words.split())
        assert outcome.code in (1, 2)
        assert outcome.err == f"dbo: error: {said}\n"
    outcome = dbo("simulate", "model.json", "log.csv", "--input", "1" * 5000)
    assert outcome.code == 1 and "there is no column '1111" in outcome.err
    outcome = dbo("identify", "log.csv", "--gears", "10000000")
    assert (outcome.code, outcome.err.count("\n")) == (2, 1)


def test_a_large_resampling_is_made_in_pieces(
    dbo: Any, model_file: Path, tmp_path: Path
) -> None:
    (tmp_path / "log.csv").write_text("time_s,voltage_V\n0,0\n1,5\n2,3\n")
    one = dbo("simulate", "model.json", "log.csv", "--resample", "100000", "--quiet")
    other = dbo(
        "simulate",
        "model.json",
        "log.csv",
        "--resample",
        "100000",
        "--block-rows",
        "1",
        "--quiet",
    )
    assert one == other
    assert one.out.count("\n") == 200_002


@posix
def test_file_names_of_any_bytes(model_file: Path, tmp_path: Path) -> None:
    name = os.fsdecode(b"\xffrun\xe9.csv")
    try:
        (tmp_path / name).write_text(LOG)
    except OSError:
        pytest.skip("this file system takes UTF-8 only")
    for locale in ("C", "C.UTF-8"):
        environment = os.environ | {"PYTHONPATH": ROOT, "LC_ALL": locale}
        for out in ("out.csv", "out.h5"):
            done = subprocess.run(
                [*DBO, "simulate", "model.json", name, "-o", out],
                cwd=tmp_path, env=environment, capture_output=True, check=False,
            )  # fmt: skip
            assert done.returncode == 0, done.stderr
            assert done.stderr.decode().startswith("dbo: ÿruné.csv: 4 rows")
    with h5py.File(tmp_path / "out.h5") as file:
        assert file.attrs["command"].startswith("dbo simulate model.json 'ÿruné.csv'")


def test_names_and_units_command_no_terminal(
    dbo: Any, model_file: Path, tmp_path: Path
) -> None:
    (tmp_path / "log.csv").write_text("\x1b]0;owned\x07voltage_V,\x1b[31mx\n0,1\n5,2\n")
    outcome = dbo("simulate", "model.json", "log.csv")
    assert (
        outcome.code == 0
        and "\x1b" not in outcome.out + outcome.err
        and "\x07" not in outcome.out
    )
    outcome = dbo("simulate", "model.json", "log.csv", "--input", "\x1b[2J")
    assert outcome.code == 1 and "\x1b" not in outcome.err
    model = json.loads(model_file.read_text())
    model["output"]["unit"] = "\x1b[31mum"
    model_file.write_text(json.dumps(model))
    outcome = dbo("simulate", "model.json", "log.csv")
    assert (
        outcome.code == 1 and "output.unit" in outcome.err and "\x1b" not in outcome.err
    )


def test_latin_1_units_in_hdf5(dbo: Any, tmp_path: Path, model_file: Path) -> None:
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["displacement"] = np.array([1.0, 2.0, 3.0])
        file["displacement"].attrs["units"] = np.bytes_(b"\xb5m")
    outcome = dbo("compensate", "model.json", "log.h5")
    assert outcome.code == 0, outcome.err
    assert outcome.out.splitlines()[0] == "desired_um,voltage_V"


def test_nothing_but_numbers_is_written(
    dbo: Any, model_file: Path, tmp_path: Path
) -> None:
    model = json.loads(model_file.read_text())
    model["stages"][1]["gain"] = 1e60
    model_file.write_text(json.dumps(model))
    (tmp_path / "log.csv").write_text(LOG + "1e280\n")
    for words in ((), ("-o", "out.csv"), ("-o", "out.h5")):
        with np.errstate(over="ignore"):
            outcome = dbo("simulate", "model.json", "log.csv", *words)
        assert outcome.code == 1
        assert (
            "column 'displacement_um' would hold a number that is not finite"
            in outcome.err
        )
        assert folder_content(tmp_path) == {"model.json", "log.csv"}


def test_a_delay_of_too_many_samples_is_refused(
    dbo: Any, model_file: Path, tmp_path: Path
) -> None:
    model = json.loads(model_file.read_text())
    model["stages"].append({"type": "delay", "seconds": 1.0})
    model_file.write_text(json.dumps(model))
    (tmp_path / "log.csv").write_text(LOG)
    outcome = dbo("simulate", "model.json", "log.csv", "--sample-rate", "1e12")
    assert outcome.code == 1
    assert "1e-12 s is 1,000,000,000,000 times in the delay of 1 s" in outcome.err


# --- numbers that are none of a model, and JSON without an end ---


def with_value(model: dict[str, Any], path: str, value: Any) -> dict[str, Any]:
    """Return a model with the value at a path such as ``stages[0].dx[1]`` replaced."""
    changed: Any = json.loads(json.dumps(model))
    keys = path.replace("[", ".").replace("]", "").split(".")
    place = changed
    for key in keys[:-1]:
        place = place[int(key) if isinstance(place, list) else key]
    place[int(keys[-1]) if isinstance(place, list) else keys[-1]] = value
    return dict(changed)


RELAXING = {"on": "input", "reference": 0.0, "tau": [0.1], "gain": [0.01]}
FAR = "is beyond 1e+60, which no signal reaches"
SMALL = "is below 1e-60, which is nothing"
NO_TIME = "is not from 1e-15 to 1e+15"


@pytest.mark.parametrize(
    ("path", "value", "reason"),
    [
        ("stages[0].dx[1]", 1e307, FAR), ("stages[0].dy[0]", 1e307, FAR), ("stages[0].dx[0]", 1e-300, SMALL),
        ("stages[0].dy[3]", 5e-324, SMALL), ("stages[0].x0", -1e307, FAR), ("stages[0].y0", 1e61, FAR),
        ("stages[1].gain", 1e308, FAR), ("stages[1].offset", 1e307, FAR), ("input.max", 1e307, FAR),
        ("output.min", -1e307, FAR), ("stages[0].relaxation.tau[0]", 5e-324, NO_TIME),
        ("stages[0].relaxation.tau[0]", 1e16, NO_TIME), ("stages[0].relaxation.gain[0]", 1e307, FAR),
        ("stages[0].relaxation.reference", 1e307, FAR), ("stages[2].sections[0].frequency", 1e-300, NO_TIME),
        ("stages[2].sections[0].frequency", 1e300, FAR), ("stages[2].sections[0].damping", 5e-324, SMALL),
        ("stages[2].sections[1].lag", 1e-300, NO_TIME), ("stages[3].seconds", 1e308, FAR),
        ("stages[3].seconds", 1e17, NO_TIME),
    ],
)  # fmt: skip
def test_a_number_that_is_none_of_a_model_is_refused_with_its_key(
    dbo: Any, model_file: Path, path: str, value: float, reason: str
) -> None:
    model = json.loads(model_file.read_text())
    model["stages"][0]["relaxation"] = RELAXING
    model["stages"].append(
        {
            "type": "dynamics",
            "sections": [{"frequency": 90.0, "damping": 0.1}, {"lag": 0.01}],
        }
    )
    model["stages"].append({"type": "delay", "seconds": 0.01})
    model_file.write_text(json.dumps(model))
    assert dbo("show", "model.json").code == 0
    model_file.write_text(json.dumps(with_value(model, path, value)))
    done = dbo("show", "model.json")
    assert (done.code, done.out) == (1, "")
    assert done.err == f"dbo: error: model.json: {path}: {value!r} {reason}\n"


@pytest.mark.parametrize("path", ["stages[0].x0", "stages[0].y0"])
def test_gears_that_rounding_takes_away_are_refused(
    dbo: Any, model_file: Path, path: str
) -> None:
    model = json.loads(model_file.read_text())
    model_file.write_text(json.dumps(with_value(model, path, 1e59)))
    done = dbo("show", "model.json")
    message = (
        f"{path}: rounding leaves nothing of the gears beside 1e+59, where they begin"
    )
    assert (done.code, done.err) == (1, f"dbo: error: model.json: {message}\n")


@pytest.mark.parametrize(
    "words", ["show deep.json", "simulate model.json log.csv --state deep.json"]
)
def test_json_that_is_nested_without_an_end_is_refused(
    dbo: Any, model_file: Path, words: str
) -> None:
    Path("log.csv").write_text(LOG)
    Path("deep.json").write_text("[" * 100_000)
    done = dbo(*words.split())
    assert done.code == 1 and "deep.json: is not readable JSON" in done.err, done.err


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[" * 100_000, "cannot be read as a history: maximum recursion depth exceeded"),
        ('{"format": "dbo-history", "version": 1, "passes": [{"rmse": 1' + "0" * 400 + "}]}",
         "a pass has no `rmse`"),
    ],
)  # fmt: skip
def test_a_history_that_cannot_be_one_is_refused(
    tmp_path: Path, text: str, reason: str
) -> None:
    path = tmp_path / "history.json"
    path.write_text(text)
    with pytest.raises(InputError, match=f"{path}: {reason}"):
        read_history(str(path))


def test_a_million_gears_stand_in_a_short_file(dbo: Any, model_file: Path) -> None:
    """Setting bits of B one by one would copy it a million times."""
    model = json.loads(model_file.read_text())
    run = [{"repeat": 1_000_000, "value": 1e-5}]
    model["version"], model["stages"][0] = (
        2,
        model["stages"][0] | {"dx": run, "dy": run},
    )
    model_file.write_text(json.dumps(model))
    Path("log.csv").write_text("voltage_V\n5\n7\n3\n5\n")
    done = dbo("simulate", "model.json", "log.csv")
    assert done.code == 0, done.err
    measured = [float(line.split(",")[1]) for line in done.out.splitlines()[1:]]
    assert measured == pytest.approx(
        [1.0 + 1.6 * volts for volts in (5.0, 7.0, 3.0, 5.0)], abs=1e-4
    )
