# ruff: noqa: E501  (a message of one line stands on one line here)
"""simulate, compensate, invert and excite by command line: exact outputs, messages, exit codes."""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from conftest import SMALL_MODEL, folder_content

from dbo_cli import read_model

DRIVE = "time_s,voltage_V\n0,0\n0.1,5\n0.2,10\n0.3,3\n"
RESPONSE = "time_s,voltage_V,displacement_um\n0.0,0.0,1.0\n0.1,5.0,4.2\n0.2,10.0,9.0\n0.3,3.0,4.0\n"


def write(name: str, text: str) -> Path:
    path = Path(name)
    path.write_text(text)
    return path


def lagging_model() -> dict[str, Any]:
    """Return the small model with relaxation and a delay of 0.15 s."""
    model = json.loads(json.dumps(SMALL_MODEL))
    terms = {"on": "input", "reference": 0.0, "tau": [0.05, 2.0], "gain": [0.02, 0.01]}
    model["stages"][0]["relaxation"] = terms
    model["stages"].append({"type": "delay", "seconds": 0.15})
    model["output"]["max"] = 9.5
    return dict(model)


def feed_stdin(monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    monkeypatch.setattr(
        sys, "stdin", io.TextIOWrapper(io.BufferedReader(io.BytesIO(text.encode())))
    )


# --- simulate ---


def test_simulate_writes_time_input_and_result(dbo: Any, model_file: Path) -> None:
    write("drive.csv", DRIVE)
    assert dbo("simulate", "model.json", "drive.csv") == (0, RESPONSE, "")


def test_simulate_to_a_file_says_nothing_and_leaves_nothing_else(
    dbo: Any, model_file: Path
) -> None:
    write("drive.csv", DRIVE)
    assert dbo("simulate", "model.json", "drive.csv", "-o", "out.csv") == (0, "", "")
    assert Path("out.csv").read_text() == RESPONSE
    assert folder_content(Path()) == {"model.json", "drive.csv", "out.csv"}


@pytest.mark.parametrize("command", ["simulate", "compensate"])
def test_a_comment_says_where_a_text_comes_from_and_is_read_over(
    dbo: Any, model_file: Path, command: str
) -> None:
    write(
        "drive.csv",
        DRIVE
        if command == "simulate"
        else DRIVE.replace("voltage_V", "displacement_um"),
    )
    clip = ["--on-limit", "clip"] * (command == "compensate")
    plain = dbo(command, "model.json", "drive.csv", "-q", *clip).out
    words = [
        command,
        "model.json",
        "drive.csv",
        *clip,
        "--header",
        "comment",
        "-q",
        "-o",
        "out.csv",
    ]
    assert dbo(*words).code == 0
    comment, _, rest = Path("out.csv").read_text().partition("\n")
    assert rest == plain
    assert comment == (
        f"# dbo 0.2.0; model_sha256: {read_model('model.json').actuator.digest}; "
        f"command: dbo {' '.join(words)}"
    )
    column = ("--input", "2") if command == "simulate" else ("--displacement", "2")
    again = dbo(command, "model.json", "out.csv", *column, "-q", *clip).out.splitlines()
    assert [line.split(",")[-1] for line in again[1:]] == [
        line.split(",")[-1] for line in rest.splitlines()[1:]
    ]


def test_simulate_from_standard_input(
    dbo: Any, model_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    feed_stdin(monkeypatch, DRIVE)
    assert dbo("simulate", "model.json", "-") == (0, RESPONSE, "")


def test_simulate_without_time_writes_none(dbo: Any, model_file: Path) -> None:
    write("drive.csv", "voltage_V\n0\n5\n10\n3\n")
    expected = "voltage_V,displacement_um\n0.0,1.0\n5.0,4.2\n10.0,9.0\n3.0,4.0\n"
    assert dbo("simulate", "model.json", "drive.csv") == (0, expected, "")
    assert (
        dbo("simulate", "model.json", "drive.csv", "--sample-rate", "10").out
        == RESPONSE
    )


def test_simulate_takes_rows_and_columns_by_number(dbo: Any, model_file: Path) -> None:
    write("drive.csv", "7;0\n7;5\n7;10\n7;3\n")
    no_unit = (
        "dbo: warning: drive.csv: column '2' has no unit, but model.json takes voltage in V: its figures are taken as "
        "V (name the unit in the header, or convert with --scale)\n"
    )
    done = dbo(
        "simulate",
        "model.json",
        "drive.csv",
        "--input",
        "2",
        "--rows",
        "2:3",
        "--state",
        "empty",
    )
    assert done == (0, "voltage_V,displacement_um\n5.0,4.2\n10.0,9.0\n", no_unit)


@pytest.mark.parametrize("block_rows", [1, 7, 1000])
@pytest.mark.parametrize(
    "document", [SMALL_MODEL, lagging_model()], ids=["static", "lagging"]
)
@pytest.mark.parametrize("command", ["simulate", "compensate"])
def test_block_size_changes_no_byte(
    dbo: Any, block_rows: int, document: Any, command: str
) -> None:
    write("model.json", json.dumps(document))
    rng = np.random.default_rng(3)
    x = np.cumsum(rng.normal(0.0, 0.8, 500)) % 8.0 + 1.2
    t = np.cumsum(rng.uniform(0.01, 0.1, 500))
    name = "voltage_V" if command == "simulate" else "displacement_um"
    rows = "".join(
        f"{a!r},{b!r}\n" for a, b in zip(t.tolist(), x.tolist(), strict=True)
    )
    write("in.csv", f"time_s,{name}\n{rows}")
    whole = dbo(command, "model.json", "in.csv", "-q")
    assert whole.code == 0 and whole.out.count("\n") == 501
    assert (
        dbo(command, "model.json", "in.csv", "-q", "--block-rows", block_rows) == whole
    )


def test_a_saved_state_goes_on_where_the_run_stopped(
    dbo: Any, model_file: Path
) -> None:
    write("all.csv", "0\n5\n10\n3\n6\n2\n")
    write("first.csv", "0\n5\n10\n")
    write("second.csv", "3\n6\n2\n")
    whole = dbo("simulate", "model.json", "all.csv").out.splitlines()
    dbo("simulate", "model.json", "first.csv", "--save-state", "state.json")
    rest = dbo(
        "simulate", "model.json", "second.csv", "--state", "state.json"
    ).out.splitlines()
    assert rest[1:] == whole[4:]


def test_initial_states(dbo: Any, model_file: Path) -> None:
    write("drive.csv", "5\n6\n")
    values = {}
    for state in ("auto", "empty", "full", "settled"):
        lines = dbo(
            "simulate", "model.json", "drive.csv", "--state", state
        ).out.splitlines()
        values[state] = [float(line.split(",")[1]) for line in lines[1:]]
    assert values["auto"] == values["settled"]
    assert values["empty"] == [4.2, 5.0]
    assert values["full"][0] > values["settled"][0] > values["empty"][0]


def test_outside_the_range(dbo: Any, model_file: Path) -> None:
    write("drive.csv", "voltage_V\n0\n10\n12\n11\n")
    where = "outside the range of the model (voltage 0 to 10 V)"
    done = dbo("simulate", "model.json", "drive.csv")
    counted = "dbo: warning: drive.csv: 2 of 4 samples (first in row 3)"
    assert done.err == f"{counted} {where}: extended with the last slope\n"
    assert done.out.splitlines()[3:] == ["12.0,11.0", "11.0,10.0"]
    done = dbo("simulate", "model.json", "drive.csv", "--outside", "hold")
    assert done.err == f"{counted} {where}: held\n"
    assert done.out.splitlines()[3:] == ["12.0,9.0", "11.0,9.0"]
    done = dbo(
        "simulate", "model.json", "drive.csv", "--outside", "error", "-o", "out.csv"
    )
    assert done == (
        1,
        "",
        f"dbo: error: drive.csv:4: 12 is {where} (--outside extend or hold)\n",
    )
    assert folder_content(Path()) == {"model.json", "drive.csv"}


def test_quiet_keeps_warnings_to_itself(dbo: Any, model_file: Path) -> None:
    write("drive.csv", "0\n12\n")
    assert dbo("simulate", "model.json", "drive.csv", "--quiet").err == ""


BAD_INPUT = {
    "simulate model.json none.csv": "none.csv: ",
    "simulate none.json drive.csv": "none.json: cannot be read: No such file or directory",
    "simulate model.json empty.csv": "empty.csv: the file is empty",
    "simulate model.json drive.csv --input speed": "drive.csv: there is no column 'speed'",
    "simulate model.json drive.csv --input 9": "drive.csv: there is no column 9",
    "simulate model.json drive.csv -o none/out.csv": "none/out.csv: there is no folder 'none': create it first",
    "simulate model.json drive.csv -o .": ".: this is a folder: give a file name",
    "simulate lagging.json bare.csv": "bare.csv: no time column and no sample rate, and this model's lag, creep "
    "or delay depends on it (--time COLUMN or --sample-rate HZ)",
    "simulate lagging.json back.csv": "back.csv:4: time goes backwards, and this model's lag and creep depend "
    "on the time between samples (cut the log with --rows A:B)",
    "simulate model.json amps.csv --input 2": "amps.csv: column 'voltage_mA' is in mA, but model.json takes voltage in V "
    "(--scale ROLE=FACTORV/mA converts it)",
    "simulate model.json drive.csv --state other.json": 'other.json: is not a state file ("format" must be '
    '"dbo-state")',
    "compensate inverse.json wanted.csv": "inverse.json: is an inverse model where a forward one is needed "
    "(dbo invert turns it)",
    "compensate model.json bare.csv --max-slew 5": "bare.csv: no time column and no sample rate, and --max-slew "
    "depends on it (--time COLUMN or --sample-rate HZ)",
    "compensate model.json bare.csv --condition": "bare.csv: no time column and no sample rate, and --condition "
    "depends on it (--time COLUMN or --sample-rate HZ)",
    "invert drive.csv": "drive.csv:1: is not JSON: Expecting value (identify makes a model from a log)",
    "invert other.json": 'other.json: is not a model file ("format" must be "dbo-model")',
    "invert newer.json": "newer.json: version: 4 is newer than this program reads, 3; upgrade dbo-cli",
    "invert uneven.json": "uneven.json: stages[0].d",
    "invert negative.json": "negative.json: stages[0].dx[1]: ",
    "invert unknown.json": "unknown.json: colour: is not a known key",
}
BAD_USE = {
    "simulate model.json drive.csv -o drive.csv": "drive.csv: this output is also an input: write to another file",
    "simulate model.json drive.csv --save-state model.json": "model.json: this output is also an input: write to "
    "another file",
    "simulate model.json drive.csv -o a.csv --save-state a.csv": "a.csv is one file, and two outputs go there: give each a file of its own",
    "simulate model.json drive.csv --state warm": "--state: 'warm' is none of auto, empty, full, settled, and "
    "there is no such file",
    "simulate model.json drive.csv --rows 3:2": "--rows 3:2: ",
    "compensate model.json wanted.csv --condition --max-slew 1e-9": "--condition: the sweep at --max-slew 1e-09 "
    "takes 1.745e+10 s, 1.745e+11 rows, more than the 100,000,000 that are written at most (another --max-slew)",
    "compensate model.json wanted.csv --condition --max-slew 1e-308": "--condition: the sweep at --max-slew 1e-308 "
    "takes inf s, inf rows, more than the 100,000,000 that are written at most (another --max-slew)",
    "compensate model.json loop.csv --periodic --passes 99999999999": "--passes 99999999999: the run-in takes "
    "4e+10 s, 4e+11 rows, more than the 100,000,000 that are written at most (another rate)",
    "compensate model.json wanted.csv --condition --state empty": "--condition and --state empty exclude each "
    "other: the sweep makes its own state",
}


def with_stage(**changes: Any) -> dict[str, Any]:
    model = json.loads(json.dumps(SMALL_MODEL))
    model["stages"][0] |= changes
    return dict(model)


@pytest.fixture
def bench(dbo: Any, model_file: Path) -> Any:
    """Return the runner inside a folder with good and bad inputs."""
    write("drive.csv", DRIVE)
    write("wanted.csv", "time_s,displacement_um\n0,2\n0.1,5\n")
    write("loop.csv", "time_s,displacement_um\n0,2\n0.1,5\n0.2,8\n0.3,5\n")
    write("empty.csv", "")
    write("bare.csv", "0\n5\n")
    write("back.csv", "time_s,voltage_V\n0,0\n0.1,1\n0.05,2\n")
    write("amps.csv", "time_s,voltage_mA\n0,0\n0.1,1\n")
    write("lagging.json", json.dumps(lagging_model()))
    write("other.json", '{"format": "something"}')
    write("newer.json", json.dumps(SMALL_MODEL | {"version": 4}))
    write("uneven.json", json.dumps(with_stage(dx=[1.0, 2.0])))
    write("negative.json", json.dumps(with_stage(dx=[1.0, -2.0, 3.0, 4.0])))
    write("unknown.json", json.dumps(SMALL_MODEL | {"colour": "red"}))
    assert dbo("invert", "model.json", "-o", "inverse.json") == (0, "", "")
    return dbo


@pytest.mark.whole
@pytest.mark.parametrize("line", [*BAD_INPUT, *BAD_USE])
def test_bad_input_is_one_line_and_leaves_nothing(bench: Any, line: str) -> None:
    before = folder_content(Path())
    done = bench(*line.split())
    message = BAD_INPUT.get(line) or BAD_USE[line]
    assert done.code == (1 if line in BAD_INPUT else 2)
    assert done.out == ""
    assert done.err.startswith(f"dbo: error: {message}")
    assert done.err.count("\n") == 1
    assert folder_content(Path()) == before


# --- invert ---


def test_invert_and_back_gives_the_same_widths(bench: Any) -> None:
    inverse = json.loads(Path("inverse.json").read_text())
    assert inverse["direction"] == "inverse"
    assert inverse["stages"][1]["dx"] == SMALL_MODEL["stages"][0]["dy"]
    bench("invert", "inverse.json", "-o", "again.json")
    again = json.loads(Path("again.json").read_text())
    assert (again["direction"], again["stages"][0]["dx"]) == (
        "forward",
        SMALL_MODEL["stages"][0]["dx"],
    )


def test_simulating_the_inverse_gives_the_drive(bench: Any) -> None:
    write("wished.csv", "time_s,displacement_um\n0,1\n0.1,4.2\n0.2,9\n0.3,4\n")
    lines = bench("simulate", "inverse.json", "wished.csv").out.splitlines()
    assert lines[0] == "time_s,displacement_um,voltage_V"
    assert [float(line.split(",")[2]) for line in lines[1:]] == pytest.approx(
        [0, 5, 10, 3], abs=1e-12
    )


# --- compensate ---


def depends(spread: str) -> str:
    """Return what is said of a start inside the loop."""
    return (
        f"where it starts, the displacement depends on the past by up to {spread} um; the actuator is taken to "
        "have settled there (--condition sweeps it there, --state empty where it comes from its lower end)"
    )


def begins(name: str, voltage: str) -> str:
    """Return what is said of a drive whose first row nobody knows the way to."""
    return (
        f"dbo: {name}: the drive begins at {voltage} V; from where the amplifier comes is not known (--from "
        "VOLT says it, --approach ramps there)\n"
    )


def test_compensate_then_simulate_is_the_identity(dbo: Any) -> None:
    write(
        "model.json",
        json.dumps(lagging_model() | {"stages": lagging_model()["stages"][:2]}),
    )
    t = np.arange(400) / 50
    wanted = 5.0 - 3.5 * np.cos(2 * np.pi * t) * np.exp(-0.1 * t)
    rows = "".join(
        f"{a!r},{b!r}\n" for a, b in zip(t.tolist(), wanted.tolist(), strict=True)
    )
    write("wanted.csv", f"time_s,displacement_um\n{rows}")
    done = dbo("compensate", "model.json", "wanted.csv", "-o", "drive.csv")
    assert done == (
        0,
        "",
        f"dbo: wanted.csv: {depends('0.632')}\n{begins('wanted.csv', '1.08025')}",
    )
    assert Path("drive.csv").read_text().startswith("time_s,desired_um,voltage_V\n")
    assert dbo("simulate", "model.json", "drive.csv", "-o", "back.csv").code == 0
    back = np.loadtxt("back.csv", delimiter=",", skiprows=1)[:, 2]
    assert np.abs(back - wanted).max() < 1e-10 * 8.0


def test_compensate_reads_the_trajectory_ahead_by_the_delay(
    dbo: Any, model_file: Path
) -> None:
    delayed = json.loads(json.dumps(SMALL_MODEL))
    delayed["stages"].append({"type": "delay", "seconds": 0.2})
    write("delayed.json", json.dumps(delayed))
    values = [1.0, 4.2, 9.0, 3.5, 3.0, 2.0]
    rows = "".join(f"{k / 10},{v}\n" for k, v in enumerate(values))
    write("wanted.csv", f"time_s,displacement_um\n{rows}")
    late = dbo(
        "compensate", "delayed.json", "wanted.csv", "--state", "empty"
    ).out.splitlines()
    plain = [9.0, 3.5, 3.0, 2.0, 2.0, 2.0]
    write(
        "shifted.csv",
        "time_s,displacement_um\n"
        + "".join(f"{k / 10},{v}\n" for k, v in enumerate(plain)),
    )
    early = dbo(
        "compensate", "model.json", "shifted.csv", "--state", "empty"
    ).out.splitlines()
    assert [line.split(",")[2] for line in late] == [
        line.split(",")[2] for line in early
    ]
    assert [float(line.split(",")[1]) for line in late[1:]] == values


def test_compensate_clips_counts_and_says(bench: Any) -> None:
    write("far.csv", "time_s,displacement_um\n0,2\n0.1,5\n0.2,10\n0.3,3\n")
    done = bench(
        "compensate", "model.json", "far.csv", "-o", "drive.csv", "--on-limit", "clip"
    )
    place = "far.csv: 1 of 4 samples (row 3) beyond what the limits of the drive allow (voltage 0 to 10 V)"
    told = f"dbo: far.csv: {depends('0.867')}\n{begins('far.csv', '1.66667')}dbo: warning: {place}: clipped"
    # 9 um are reached of 10, in one row of four
    told += ", by which the move misses 0.5 um RMS, 1 um at worst"
    assert done == (0, "", f"{told} (--on-limit error refuses this)\n")
    drive = np.loadtxt("drive.csv", delimiter=",", skiprows=1)
    assert drive[2, 2] == 10.0
    before = folder_content(Path())
    done = bench(
        "compensate",
        "model.json",
        "far.csv",
        "-o",
        "refused.csv",
        "--on-limit",
        "error",
    )
    assert done == (3, "", f"dbo: error: {place} (--on-limit clip goes on)\n")
    assert folder_content(Path()) == before


@pytest.mark.parametrize("block_rows", [1, 3, 1000])
def test_the_first_unusual_row_is_that_of_the_file(bench: Any, block_rows: int) -> None:
    """Rows that were dropped before it count."""
    words = ["--skip-bad", "--block-rows", block_rows]
    write(
        "far.csv",
        "time_s,displacement_um\n0,2\n0.1,5\n0.2,nan\n0.3,nan\n0.4,10\n0.5,3\n0.6,10\n",
    )
    done = bench(
        "compensate",
        "model.json",
        "far.csv",
        "-o",
        "drive.csv",
        "--on-limit",
        "clip",
        *words,
    )
    limits = "beyond what the limits of the drive allow (voltage 0 to 10 V): clipped"
    assert done.code == 0
    assert (
        f"dbo: warning: far.csv: 2 of 5 samples (first in row 5) {limits}" in done.err
    )
    write("drive_far.csv", "voltage_V\n0\nnan\n10\n12\nnan\n11\n")
    done = bench("simulate", "model.json", "drive_far.csv", *words)
    where = "outside the range of the model (voltage 0 to 10 V): extended with the last slope"
    assert done.code == 0
    assert (
        f"dbo: warning: drive_far.csv: 2 of 4 samples (first in row 4) {where}\n"
        in done.err
    )


def test_compensate_keeps_tighter_limits_and_slew(bench: Any) -> None:
    write("far.csv", "time_s,displacement_um\n0,2\n0.1,5\n0.2,8\n0.3,3\n")
    done = bench("compensate", "model.json", "far.csv", "--v-min", "2", "--v-max", "7", "--max-slew", "20",
                 "--on-limit", "clip")  # fmt: skip
    voltage = np.array(
        [float(line.split(",")[2]) for line in done.out.splitlines()[1:]]
    )
    assert voltage.min() >= 2.0 and voltage.max() <= 7.0
    assert np.abs(np.diff(voltage)).max() <= 2.0 * (1 + 1e-12)
    assert "(voltage 2 to 7 V, 20 V/s): clipped" in done.err


def test_a_limit_beyond_the_range_does_not_widen_it(bench: Any) -> None:
    write("far.csv", "displacement_um\n5\n9.5\n12.5\n")
    plain = bench("compensate", "model.json", "far.csv", "--on-limit", "clip")
    done = bench(
        "compensate", "model.json", "far.csv", "--v-max", "15", "--on-limit", "clip"
    )
    assert done.out == plain.out
    note = "dbo: far.csv: the drive may go from 0 to 10 V (identified: 0 to 10 V)\n"
    assert done.err.replace(note, "") == plain.err and note in done.err


def test_extrapolate_goes_beyond_the_range_and_says_by_how_much(bench: Any) -> None:
    write("far.csv", "displacement_um\n5\n9.5\n12.5\n")
    done = bench(
        "compensate", "model.json", "far.csv", "--v-max", "15", "--extrapolate"
    )
    voltage = [float(line.split(",")[1]) for line in done.out.splitlines()[1:]]
    assert done.code == 0 and 10.0 < max(voltage) < 15.0
    beyond = f"{max(voltage) - 10.0:.3g} V above the 0 to 10 V on which the model was identified"
    assert (
        f"dbo: warning: far.csv: the drive goes {beyond}; it extrapolates there\n"
        in done.err
    )


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            "--v-min 12 --v-max 15",
            "--v-min 12 V leaves nothing of the range on which the model was identified, 0 to 10 V (another "
            "limit, or --extrapolate with --v-min and --v-max to go beyond it)",
        ),
        (
            "--v-max -1",
            "--v-max -1 V leaves nothing of the range on which the model was identified, 0 to 10 V (another "
            "limit, or --extrapolate with --v-min and --v-max to go beyond it)",
        ),
        (
            "--extrapolate",
            "--extrapolate goes as far as --v-min and --v-max say: give one of them",
        ),
    ],
)
def test_limits_that_leave_nothing_are_refused(
    bench: Any, words: str, message: str
) -> None:
    done = bench("compensate", "model.json", "wanted.csv", *words.split())
    assert done == (2, "", f"dbo: error: {message}\n")


def test_condition_prepends_a_sweep_in_negative_time(bench: Any) -> None:
    plain = bench(
        "compensate", "model.json", "wanted.csv", "--state", "empty"
    ).out.splitlines()
    done = bench(
        "compensate", "model.json", "wanted.csv", "--condition", "-o", "drive.csv"
    )
    before = (
        "dbo: wanted.csv: before the first row stand 23 rows, 2.3 s, from 0 to 10 V\n"
    )
    assert (done.code, done.err) == (0, before + begins("wanted.csv", "0"))
    rows = np.loadtxt("drive.csv", delimiter=",", skiprows=1)
    sweep = rows[rows[:, 0] < -1e-9]
    assert sweep[:, 2].min() == 0.0 and sweep[:, 2].max() == 10.0
    assert sweep[-1, 0] == pytest.approx(-0.1)
    assert np.diff(rows[:, 0]) == pytest.approx(0.1)
    lines = Path("drive.csv").read_text().splitlines()
    assert lines[-2:] == plain[-2:]
    back = bench(
        "simulate", "model.json", "drive.csv", "--state", "empty"
    ).out.splitlines()
    assert [float(line.split(",")[2]) for line in back[-2:]] == pytest.approx(
        [2.0, 5.0], abs=1e-12
    )


# --- excite ---


def test_excite_stays_inside_and_starts_and_ends_at_the_bottom(dbo: Any) -> None:
    done = dbo(
        "excite",
        "--v-min",
        "-20",
        "--v-max",
        "120",
        "--sample-rate",
        "200",
        "--duration",
        "12",
    )
    lines = done.out.splitlines()
    table = np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]])
    fastest = np.abs(np.diff(table[:, 1])).max() * 200
    said = (
        f"dbo: 2,400 rows, 12 s at 200 rows a second, from -20 to 120 V, at most {fastest:.3g} V/s\n"
        "dbo: it begins and ends at -20 V: bring the amplifier there slowly first\n"
        "dbo: play it, record drive and displacement side by side, then: dbo identify RECORDED -o model.json\n"
    )
    assert (done.code, done.err, lines[0]) == (0, said, "time_s,voltage_V")
    assert len(table) == 2400
    assert (table[0, 1], table[:, 1].min(), table[:, 1].max()) == (-20.0, -20.0, 120.0)
    assert table[-1, 1] == pytest.approx(-20.0, abs=0.1)


def test_what_drives_is_named_by_the_unit_of_its_limit(dbo: Any) -> None:
    done = dbo(
        "excite",
        "--v-max",
        "4bar",
        "--v-min",
        "500mbar",
        "--max-slew",
        "0.02bar/ms",
        "-o",
        "e.csv",
    )
    assert done.code == 0
    header, *rows = Path("e.csv").read_text().splitlines()
    assert header == "time_s,pressure_bar"
    pressure = np.array([float(row.partition(",")[2]) for row in rows])
    assert (pressure.min(), pressure.max()) == (0.5, 4.0)
    assert np.abs(np.diff(pressure)).max() * 1000.0 <= 20.0
    assert " from 0.5 to 4 bar, at most " in done.err
    assert (
        "dbo: it begins and ends at 0.5 bar: bring the amplifier there slowly first\n"
        in done.err
    )
    done = dbo("excite", "--v-max", "4bar", "--v-min", "1V", "-o", "other.csv")
    assert done.code == 2
    assert (
        done.err
        == "dbo: error: --v-min 1V: cannot be converted; a figure in bar is needed\n"
    )
    assert not Path("other.csv").exists()


@pytest.mark.parametrize(("words", "message"), [
    ("--v-max 4bar --max-slew 10bar/s", "--max-slew 10bar/s: the whole range at 1 Hz needs 12.5664 bar/s "
     "(--frequency 0.795 and a --duration of at least 8)"),
    ("--v-max 4bar --v-min 5bar", "--v-min 5bar must be below --v-max 4bar"),
    ("--v-max 1e300bar --v-min -1e300bar", "--v-min -1e+300bar and --v-max 1e+300bar: give limits within "
     "1e+60bar"),
    ("--v-max 4bar --sweep-to 20 --sweep-amplitude 3bar", "--sweep-amplitude 3bar: give one above 0, at most 2bar"),
])  # fmt: skip
def test_excite_refuses_in_the_unit_of_the_drive(
    dbo: Any, words: str, message: str
) -> None:
    done = dbo("excite", *words.split(), "-o", "e.csv")
    assert (done.code, done.err) == (2, f"dbo: error: {message}\n")
    assert not Path("e.csv").exists()


def test_excite_is_chosen_by_its_seed(dbo: Any) -> None:
    words = ["excite", "--v-max", "120", "--sample-rate", "200"]
    first = dbo(*words).out
    assert first.count("\n") == 3001
    assert dbo(*words, "--seed", "1", "--duration", "15").out == first
    assert dbo(*words, "--seed", "2").out != first
    done = dbo(*words, "--seed", "x")
    assert (done.code, done.err) == (2, "dbo: error: --seed: not a whole number: 'x'\n")


def test_excite_refuses_too_few_cycles(dbo: Any) -> None:
    done = dbo("excite", "--v-max", "100", "--duration", "2", "-o", "x.csv")
    assert (done.code, done.out) == (2, "")
    assert done.err == (
        "dbo: error: --duration 2: 2 cycles of 1 Hz, at least 6 are needed (a --duration of 6)\n"
    )
    assert folder_content(Path()) == set()


def test_an_inverse_model_looks_ahead_as_compensate_does(dbo: Any) -> None:
    delayed = json.loads(json.dumps(SMALL_MODEL))
    delayed["stages"].append({"type": "delay", "seconds": 0.2})
    write("delayed.json", json.dumps(delayed))
    rows = "".join(f"{k / 10},{1.0 + 0.3 * k - 0.01 * k * k}\n" for k in range(15))
    write("wanted.csv", "time_s,displacement_um\n" + rows)
    assert dbo("invert", "delayed.json", "-o", "inverse.json").code == 0
    drive = dbo("compensate", "delayed.json", "wanted.csv", "--state", "empty").out
    simulated = dbo("simulate", "inverse.json", "wanted.csv", "--state", "empty").out
    assert simulated.replace("displacement_um", "desired_um", 1) == drive


@pytest.mark.parametrize("jitter", [0.0, 0.004])
def test_condition_does_not_depend_on_the_block_size(dbo: Any, jitter: float) -> None:
    write("model.json", json.dumps(lagging_model()))
    rng = np.random.default_rng(5)
    t = 0.02 * np.arange(300) + jitter * rng.uniform(-1, 1, 300)
    x = 5.0 - 3.0 * np.cos(2 * np.pi * t)
    rows = "".join(
        f"{a!r},{b!r}\n" for a, b in zip(t.tolist(), x.tolist(), strict=True)
    )
    write("wanted.csv", f"time_s,displacement_um\n{rows}")
    whole = dbo("compensate", "model.json", "wanted.csv", "--condition", "-q")
    assert whole.code == 0 and whole.out.count("\n") > 400
    for block_rows in (1, 2, 77):
        cut = dbo(
            "compensate",
            "model.json",
            "wanted.csv",
            "--condition",
            "-q",
            "--block-rows",
            block_rows,
        )
        assert cut == whole


def test_a_trajectory_that_is_never_reached_is_refused(
    dbo: Any, model_file: Path
) -> None:
    write("nm.csv", "time_s,displacement\n0,2000\n0.1,5000\n0.2,4000\n")
    done = dbo("compensate", "model.json", "nm.csv", "-o", "drive.csv")
    assert done == (
        1, "", "dbo: error: nm.csv: every row is outside what the model reaches (displacement 1 to 9 um): check "
        "unit, column and zero of the trajectory\n"
    )  # fmt: skip
    assert folder_content(Path()) == {"model.json", "nm.csv"}


def test_standard_input_is_read_once(dbo: Any) -> None:
    assert dbo("simulate", "-", "-") == (
        2, "", "dbo: error: standard input can be read once only: give the model or the signal as a file\n"
    )  # fmt: skip


def test_a_foreign_delimiter_is_read_in_a_large_file(
    dbo: Any, model_file: Path
) -> None:
    rows = "".join(f"{k / 1000}§{(k % 100) / 10}\n" for k in range(150_000))
    Path("drive.csv").write_text("time_s§voltage_V\n" + rows, encoding="utf-8")
    assert (
        dbo(
            "simulate", "model.json", "drive.csv", "--delimiter", "§", "-o", "out.csv"
        ).code
        == 0
    )
    assert Path("out.csv").read_text().count("\n") == 150_001


def test_the_first_line_says_what_was_read(whole_dbo: Any, model_file: Path) -> None:
    write("drive.csv", "time_ms,CH1_mV\n0,0\n100,5000\n200,10000\n300,3000\n")
    done = whole_dbo("simulate", "model.json", "drive.csv")
    assert done.err.splitlines()[0] == (
        "dbo: drive.csv: 4 rows, 0.3 s at 10 samples/s; time 'time_ms' (ms), voltage 'CH1_mV' (mV)"
    )
    assert done.err.splitlines()[1:] == [
        "dbo: drive.csv: column 'CH1_mV' is converted from mV to V"
    ]
    assert done.out.splitlines()[0] == "time_s,CH1_V,displacement_um"
    assert done.out.splitlines()[2] == "0.1,5.0,4.2"
    assert whole_dbo("simulate", "model.json", "drive.csv", "-q").err == ""


@pytest.mark.whole
@pytest.mark.parametrize(
    ("more", "rows"),
    [
        ([], 16384),
        (["--sweep-to", "200"], 65536),
        (["--duration", "8", "--frequency", "2"], 4096),
    ],
)
def test_excite_fits_a_generator(dbo: Any, more: list[str], rows: int) -> None:
    done = dbo("excite", "--v-max", 100, "--points", rows, *more, "-o", "e.csv")
    assert done.code == 0, done.err
    drive = np.loadtxt("e.csv", delimiter=",", skiprows=1)
    assert (
        drive.shape == (rows, 2) and drive[-1, 1] == 0.0 and drive[:, 1].max() == 100.0
    )
    assert (
        dbo("waveform", "e.csv", "--to", "rigol-raf", "--gain", 20, "-o", "e.raf").code
        == 0
    )


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--points 16384 --sample-rate 100", "--points and --sample-rate exclude each other: the rate follows from the "
         "points"),
        ("--points 200", "--points 200: 13.33 rows a second, at least 20 are needed (--points 300)"),
        ("--points 16384 --sweep-to 200", "--points 16,384: 885.6 rows a second, at least 2000 are needed (--points "
         "37,001)"),
    ],
)  # fmt: skip
def test_excite_refuses_points_that_are_too_few(
    dbo: Any, words: str, message: str
) -> None:
    done = dbo("excite", "--v-max", "100", *words.split())
    assert (done.code, done.out, done.err) == (2, "", f"dbo: error: {message}\n")


def test_whose_volts_a_drive_is_in_is_said_where_the_logs_were_scaled(
    dbo: Any, tmp_path: Path
) -> None:
    content = SMALL_MODEL | {
        "version": 2,
        "provenance": {
            "inputs": [
                {
                    "name": "a.csv",
                    "read": {"columns": {"voltage": {"scale": "times 20"}}},
                }
            ]
        },
    }
    (tmp_path / "scaled.json").write_text(json.dumps(content))
    write = "time_s,displacement_um\n" + "".join(
        f"{k / 100},{2 + k / 50}\n" for k in range(100)
    )
    (tmp_path / "wish.csv").write_text(write)
    done = dbo("compensate", "scaled.json", "wish.csv", "-o", "drive.h5")
    assert (
        "dbo: wish.csv: the drive is in the voltages of the model's logs times 20 (--gain of waveform takes it back to "
        "the converter's)\n"
    ) in done.err
    with h5py.File("drive.h5") as file:
        assert (
            file.attrs["voltage_scale"]
            == "times 20, of the voltages in the model's logs"
        )


def test_a_summary_has_the_figures_of_the_drive(dbo: Any, model_file: Path) -> None:
    """In volts, whatever the clock: the largest step is no speed, and the range is in order."""
    moves = 5.0 + 3.0 * np.sin(np.arange(40) / 4.0) ** 3
    rows = [f"{0.01 * k:.2f},{float(x)!r}" for k, x in enumerate(moves)]
    Path("move.csv").write_text("\n".join(["time_s,displacement_um", *rows]) + "\n")
    words = (
        "compensate",
        "model.json",
        "move.csv",
        "-o",
        "drive.csv",
        "--summary",
        "s.json",
    )
    assert dbo(*words, "--v-max", "6", "--on-limit", "clip").code == 0
    drive = np.loadtxt("drive.csv", delimiter=",", skiprows=1)[:, -1]
    summary = json.loads(Path("s.json").read_text())
    assert (summary["rows"], summary["range"]) == (40, [drive.min(), drive.max()])
    assert summary["largest_step"] == np.abs(np.diff(drive)).max()
    assert summary["clipped"] == np.count_nonzero(drive == 6.0) > 0
    (read,) = summary["read"]
    assert (read["rows"], read["seconds"]) == (40, pytest.approx(0.39))
