"""``dbo check``, the pieces of a drive from the command line, and ``--summary``."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import SMALL_MODEL
from scipy.interpolate import CubicSpline
from scipy.signal import correlate

from dbo_cli.drives import check
from dbo_cli.drives.gate import DriveFigures, DriveGate
from dbo_cli.hysteresis.model_state import DriveLimits


def write(name: str, header: str, *columns: Any) -> None:
    rows = "".join(
        ",".join(map(repr, map(float, row))) + "\n"
        for row in zip(*columns, strict=True)
    )
    Path(name).write_text(header + "\n" + rows)


TIME = np.arange(400) / 1000.0
DRIVE = 50.0 + 40.0 * np.sin(2.0 * np.pi * 5.0 * TIME)


@pytest.fixture
def bench(dbo: Any) -> Any:
    write("drive.csv", "time_s,voltage_V", TIME, DRIVE)
    Path("model.json").write_text(json.dumps(SMALL_MODEL))
    write(
        "wish.csv",
        "time_s,displacement_um",
        TIME,
        5.0 + 2.0 * np.sin(2.0 * np.pi * 5.0 * TIME),
    )
    return dbo


def test_a_drive_within_its_limits_passes(bench: Any) -> None:
    done = bench(
        "check",
        "drive.csv",
        "--v-min",
        "10",
        "--v-max",
        "90",
        "--max-slew",
        "1260",
        "--loop",
    )
    assert (done.code, done.err) == (0, "")
    assert done.out == (
        "drive.csv: passed\n  400 rows, 10 to 90 V, largest step 1.25643 V, at most 1256.43 V/s; first row "
        "50 V, last row 48.7436 V\n"
    )


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        ("--v-max 89", "row 44: 89.0366705 V is outside -inf to 89 V (30 rows in all)"),
        ("--max-slew 1000", "row 2: from 50 to 51.2564304 V in one row is faster than 1000 V per "
         "second (167 rows in all)"),
        ("--from 0 --max-slew 2000", "row 1: from 0 to 50 V in one row is faster than 2000 V per second"),
        ("--rows 1:250 --loop", "from the last row, 89.9803 V, to the first, 50 V, is a step of 40 V "
         "where the largest inside is 1.26 V: the loop does not close"),
        ("--rows 1:205 --loop", "from the last row, 55.0133 V, to the first, 50 V, is a step of 5.01 V "
         "where the largest inside is 1.26 V: the loop does not close"),
        ("--from 49.9 --max-slew 1256", "row 2: from 50 to 51.2564304 V in one row is faster than 1256 V "
         "per second (7 rows in all)"),
        ("--from 49 --max-slew 1255 --rows 3:400", "row 3: from 49 to 52.5116208 V in one row is faster than "
         "1255 V per second (14 rows in all)"),
    ],
)  # fmt: skip
def test_what_breaks_a_limit_is_named(bench: Any, words: str, problem: str) -> None:
    done = bench("check", "drive.csv", *words.split())
    assert (done.code, done.err) == (3, f"dbo: error: drive.csv: {problem}\n")
    assert done.out.startswith("drive.csv: NOT PASSED\n") and done.out.endswith(
        f"  {problem}\n"
    )


def test_gaps_repeats_and_rows_without_a_number_are_named(bench: Any) -> None:
    time = TIME.copy()
    time[100:] += 0.05
    time[200] = time[199]
    write("odd.csv", "time_s,voltage_V", time, DRIVE)
    lines = Path("odd.csv").read_text().splitlines()
    lines[21] = lines[21].split(",")[0] + ",OVLD"
    Path("odd.csv").write_text("\n".join(lines) + "\n")
    done = bench("check", "odd.csv", "-o", "found.json")
    assert done.code == 3
    found = json.loads(Path("found.json").read_text())
    assert found["format"] == "dbo-check" and not found["passed"]
    assert found["problems"] == [
        "row 21: column 'voltage_V' is not a number: 'OVLD'",
        "row 201: the time stamp repeats",
        "row 22: a gap in time (3 rows in all)",
    ]
    assert done.err == f"dbo: error: odd.csv: {found['problems'][0]} (and 2 more)\n"


def test_what_was_played_is_told_from_what_was_to_be(bench: Any) -> None:
    late = np.concatenate([np.full(7, DRIVE[0]), DRIVE])
    write("played.csv", "time_s,monitor_V", np.arange(late.size) / 1000.0, late)
    done = bench("check", "played.csv", "--against", "drive.csv")
    assert done.code == 0
    assert "  played: 400 rows, 7 later (7 ms), gain 1, offset" in done.out
    write("scaled.csv", "time_s,monitor_V", TIME, 1.02 * DRIVE + 0.3)
    done = bench("check", "scaled.csv", "--against", "drive.csv", "--tolerance", "0.1")
    assert done.code == 3
    assert (
        "differs by up to 2.1 V, more than 0.1 V (gain 1.02 and offset 0.3 V explain all but"
        in done.err
    )
    write("part.csv", "time_s,monitor_V", TIME[:150], DRIVE[:150])
    assert (
        "250 of 400 rows were not played"
        in bench("check", "part.csv", "--against", "drive.csv").err
    )
    noise = np.random.default_rng(1).normal(50.0, 20.0, 400)
    write("other.csv", "time_s,monitor_V", TIME, noise)
    assert (
        "is another drive" in bench("check", "other.csv", "--against", "drive.csv").err
    )
    slow = np.arange(200) / 500.0
    write("slow.csv", "time_s,monitor_V", slow, np.interp(slow, TIME, DRIVE))
    done = bench("check", "slow.csv", "--against", "drive.csv")
    assert (done.code, "at another rate" in done.out) == (0, True)


@pytest.mark.parametrize("rows", [200, 400, 90])
def test_a_recording_that_begins_late_and_ends_early_is_found(
    bench: Any, rows: int
) -> None:
    drive = 50.0 + 40.0 * np.sin(2.0 * np.pi * (5.0 * TIME + 20.0 * TIME**2))
    write("sweep.csv", "time_s,voltage_V", TIME, drive)
    late = np.concatenate([np.zeros(137), drive[:rows]])
    write("cut.csv", "time_s,monitor_V", np.arange(late.size) / 1000.0, late)
    done = bench("check", "cut.csv", "--against", "sweep.csv", "--format", "json")
    played = json.loads(done.out)["played"]
    assert (played["lag_rows"], played["rows"]) == (137, rows)
    assert played["largest_difference"] < 1e-9


def test_the_noise_of_a_recording_is_no_difference(bench: Any) -> None:
    noise = np.random.default_rng(4).normal(0.0, 0.5, 400)
    write("played.csv", "time_s,monitor_V", TIME, DRIVE + noise)
    limits = ["--v-min", "10", "--v-max", "90"]
    done = bench("check", "played.csv", *limits, "--against", "drive.csv")
    assert done.code == 0
    told = re.search(r"; read back with noise of (\S+) V \(up to (\S+) V\)", done.out)
    assert told is not None
    assert float(told[1]) == pytest.approx(0.5, rel=0.15)
    assert float(told[2]) == pytest.approx(6.0 * float(told[1]), rel=0.05)
    # What the user typed holds, and what noise does not explain is a difference.
    assert (
        bench(
            "check", "played.csv", "--against", "drive.csv", "--tolerance", "0.5"
        ).code
        == 3
    )
    write("played.csv", "time_s,monitor_V", TIME, np.minimum(DRIVE, 84.0) + noise)
    done = bench("check", "played.csv", "--against", "drive.csv", "--format", "json")
    assert done.code == 3
    played = json.loads(done.out)["played"]
    assert played["tolerance"] == 6.0 * played["read_back_noise"]


def test_an_amplifier_that_cuts_a_drive_off_is_recognised(bench: Any) -> None:
    noise = np.random.default_rng(3).normal(0.0, 0.005, 400)
    write("cut.csv", "time_s,monitor_V", TIME, np.minimum(DRIVE, 80.0) + noise)
    done = bench("check", "cut.csv", "--against", "drive.csv")
    assert "more than 0.08 V (it is the drive cut off at 80.0115 V: " in done.err


def test_the_tolerance_of_a_recording_holds_for_its_limits_too(bench: Any) -> None:
    noise = np.random.default_rng(2).normal(0.0, 0.01, 400)
    write("played.csv", "time_s,monitor_V", TIME, DRIVE + noise)
    limits = ["--v-min", "10", "--v-max", "90", "--max-slew", "1257", "--from", "50"]
    done = bench("check", "played.csv", *limits)
    assert done.code == 3 and "faster than 1257 V per second" in done.err
    assert bench("check", "played.csv", *limits, "--against", "drive.csv").code == 0
    low = ["check", "played.csv", "--v-min", "12", "--against", "drive.csv"]
    assert (
        "is outside 12 to inf V by more than the tolerance, 0.08 V (" in bench(*low).err
    )
    assert (
        "1e-06"
        in bench(
            "check",
            "played.csv",
            *limits,
            "--against",
            "drive.csv",
            "--tolerance",
            "1e-6",
        ).err
    )
    write(
        "before.csv", "time_s,monitor_V", TIME, (DRIVE + noise) / 20.0
    )  # its limits are before the amplifier
    words = ["--against", "drive.csv", "--gain", "20", "--v-min"]
    assert bench("check", "before.csv", *words, "0.5").code == 0
    assert bench("check", "before.csv", *words, "0.51").code == 3


def test_the_pieces_of_a_drive_from_the_command_line(bench: Any) -> None:
    words = ["--from", "0", "--approach", "0.2", "--return", "0.3", "--max-slew", "900"]
    done = bench(
        "compensate",
        "model.json",
        "wish.csv",
        *words,
        "-o",
        "d.csv",
        "--summary",
        "s.json",
    )
    assert done.code == 0, done.err
    table = np.loadtxt("d.csv", delimiter=",", skiprows=1, usecols=(0, 2))
    assert table[0, 1] == 0.0 and table[-1, 1] == 0.0
    assert table[0, 0] == pytest.approx(-0.2, abs=2e-3) and table[
        -1, 0
    ] == pytest.approx(0.7, abs=2e-3)
    passed = bench(
        "check",
        "d.csv",
        "--v-min",
        "0",
        "--v-max",
        "10",
        "--max-slew",
        "900.001",
        "--from",
        "0",
    )
    assert passed.code == 0, passed.err
    summary = json.loads(Path("s.json").read_text())
    assert set(summary) >= {
        "format", "version", "command", "read", "rows", "clipped", "range", "largest_step", "expected_rmse",
        "expected_percent", "expected_percent_of_move", "expected_shape_rmse", "before", "notes", "warnings",
    }  # fmt: skip
    assert (summary["format"], summary["version"], summary["rows"]) == (
        "dbo-summary",
        1,
        len(table),
    )
    assert summary["expected_percent_of_move"] == summary["expected_percent"]
    wish = np.loadtxt("wish.csv", delimiter=",", skiprows=1, usecols=1)
    assert summary["move_range"] == [wish.min(), wish.max()]
    assert (
        summary["range"] == [table[:, 1].min(), table[:, 1].max()]
        and summary["clipped"] == 0
    )
    assert summary["largest_step"] == pytest.approx(np.abs(np.diff(table[:, 1])).max())
    before = table[table[:, 0] < -5e-4]
    rows, reach = len(before), [before[:, 1].min(), before[:, 1].max()]
    assert summary["before"] == {
        "rows": rows,
        "seconds": pytest.approx(rows / 1000.0),
        "range": reach,
    }
    said = f"before the first row stand {rows} rows, {rows / 1000.0:.4g} s, from 0 to {reach[1]:.6g} V"
    assert any(said in note for note in summary["notes"])
    assert (
        summary["read"][0]["file"] == "wish.csv" and summary["read"][0]["rows"] == 400
    )


@pytest.mark.whole
@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (
            "--approach auto",
            2,
            "--approach needs --from VOLT (what the amplifier stands at) or a --state",
        ),
        ("--approach 0", 2, "--approach: must be above 0, not 0"),
        (
            "--from 50 --max-slew 10",
            3,
            "the drive comes from 50 V, and 10 V per second does not bring it to its",
        ),
        (
            "--periodic --return auto",
            2,
            "--periodic and --return exclude each other: a loop goes on",
        ),
        ("--max-current 1", 2, "--max-current and --capacitance belong together"),
        ("--v-min 5 --v-max 5", 2, "--v-min 5 must be below --v-max 5"),
    ],
)
def test_what_cannot_be_kept_is_refused(
    bench: Any, words: str, code: int, message: str
) -> None:
    done = bench("compensate", "model.json", "wish.csv", *words.split(), "-o", "d.csv")
    assert (done.code, done.err.startswith(f"dbo: error: {message}")) == (code, True), (
        done.err
    )
    assert not Path("d.csv").exists()


@pytest.mark.parametrize("name", ["d.csv", "d.tsv.gz", "d.h5"])
def test_the_rows_of_a_drive_without_a_desired_value(bench: Any, name: str) -> None:
    done = bench("compensate", "model.json", "wish.csv", "--return", "0.3", "-o", name)
    assert done.code == 0, done.err
    assert bench("simulate", "model.json", name, "-o", "s.csv").code == 0
    time, measured = np.loadtxt("s.csv", delimiter=",", skiprows=1, usecols=(0, 2)).T
    wanted = 5.0 + 2.0 * np.sin(2.0 * np.pi * 5.0 * TIME)
    rows = len(time)
    assert rows == pytest.approx(700, abs=2)
    assert bench("check", name, "--v-min", "0", "--v-max", "10").code == 0
    write("run.csv", "time_s,sensor_um", time, measured + 0.25)
    done = bench("report", "run.csv", "--trajectory", name, "--format", "json")
    assert done.code == 0, done.err
    log = json.loads(done.out)["logs"][0]
    assert log["samples"] == 400 and log["mean"] == pytest.approx(0.25, abs=0.002)
    wished = [*map(repr, wanted.tolist()), *[""] * (rows - 400)]
    lines = [
        f"{a!r},{b},{c!r}"
        for a, b, c in zip(time.tolist(), wished, measured.tolist(), strict=True)
    ]
    Path("both.csv").write_text(
        "\n".join(["time_s,desired_um,measured_um", *lines]) + "\n"
    )
    done = bench("report", "both.csv", "--format", "json")
    assert (done.code, json.loads(done.out)["logs"][0]["samples"]) == (0, 400)
    assert (
        "blank" not in done.err
        and "empty" not in done.err
        and "dropped" not in done.err
    )
    lines[500] += "x"
    Path("both.csv").write_text(
        "\n".join(["time_s,desired_um,measured_um", *lines]) + "\n"
    )
    done = bench("report", "both.csv")
    assert done.code == 1
    assert done.err.startswith(
        "dbo: error: both.csv:502: column 'measured_um' is not a number: "
    )
    lines[500] = f"{time[500]!r},nan,1.0"
    Path("both.csv").write_text(
        "\n".join(["time_s,desired_um,measured_um", *lines]) + "\n"
    )
    done = bench("report", "both.csv")
    assert done.err.startswith(
        "dbo: error: both.csv:502: column 'desired_um' is not finite: 'nan'"
    )


def test_a_recording_between_the_rows_at_another_speed_or_before_the_amplifier(
    bench: Any,
) -> None:
    def checked(time: Any, values: Any, *words: Any) -> Any:
        write("played.csv", "time_s,monitor_V", time, values)
        done = bench(
            "check", "played.csv", "--against", "drive.csv", *words, "--format", "json"
        )
        return done.code, json.loads(done.out)["played"], done.err

    def exact(seconds: Any) -> Any:
        return 50.0 + 40.0 * np.sin(2.0 * np.pi * 5.0 * seconds)

    code, found, _ = checked(TIME, exact(TIME - 0.0004))
    assert code == 0 and found["lag_rows"] in (0, 1) and found["rows"] >= 399
    assert found["lag_seconds"] == pytest.approx(0.0004, abs=1e-6)
    assert (
        found["gain"] == pytest.approx(1.0, abs=1e-6)
        and found["largest_difference"] < 1e-3
    )
    noise = np.random.default_rng(2).normal(0.0, 0.01, 400)
    code, found, _ = checked(TIME, DRIVE / 20.0 + noise / 20.0, "--gain", 20)
    assert (
        code == 0
        and found["gain"] == pytest.approx(1.0, abs=1e-3)
        and found["amplifier_gain"] == 20.0
    )
    code, found, problem = checked(TIME, 0.051 * DRIVE + 0.1, "--gain", 20)
    assert code == 3 and found["gain"] == pytest.approx(1.02)
    assert problem.startswith(
        "dbo: error: played.csv: what was played differs by up to 3.8 V, more than 0.08 V (gain 1.02 "
    )
    assert problem.endswith(
        "e-14 V; before the amplifier an amplitude of 102 % and an offset of 0.1 V)\n"
    )
    code, found, problem = checked(TIME / 2.0, DRIVE)
    assert code == 3 and found["speed"] == pytest.approx(2.0, rel=0.01)
    assert "the drive was played 2 times as fast as it was to be" in problem
    code, found, problem = checked(TIME[:200], DRIVE[::2])
    assert (
        code == 3 and "the drive was played 2 times as fast as it was to be" in problem
    )
    code, found, problem = checked(TIME[:200], DRIVE[:200])
    assert found["speed"] == 1.0 and "200 of 400 rows were not played" in problem


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            "--gain 20",
            "--gain is that behind a recording (--against FILE is the drive it is of)",
        ),
        (
            "--against drive.csv --gain 0",
            "--gain 0: an amplifier of no gain moves nothing (give its volts out per",
        ),
    ],
)
def test_gains_that_mean_nothing(bench: Any, words: str, message: str) -> None:
    done = bench("check", "drive.csv", *words.split())
    assert (done.code, done.err.startswith(f"dbo: error: {message}")) == (2, True), (
        done.err
    )


def test_what_the_way_there_leaves_is_not_said_of_the_file(bench: Any) -> None:
    words = "--from -2 --v-min -3 --extrapolate --approach auto"
    done = bench("compensate", "model.json", "wish.csv", *words.split())
    # the model begins there
    assert done.code == 0 and float(done.out.splitlines()[1].split(",")[1]) < 1.0
    assert done.err == (
        "dbo: wish.csv: before the first row stand 751 rows, 0.751 s, from -2 to 6 V\n"
        "dbo: wish.csv: the drive may go from -3 to 10 V (identified: 0 to 10 V)\n"
        "dbo: warning: wish.csv: the drive goes 2 V below the 0 to 10 V on which the model was identified; "
        "it extrapolates there\n"
    )


# --- limits have units ---


def in_other_unit(unit: str, volts: float) -> dict[str, Any]:
    """Return the small model with its drive in a unit of so many volts: the same actuator."""
    stage = SMALL_MODEL["stages"][0]
    return SMALL_MODEL | {
        "input": {"quantity": "voltage", "unit": unit, "min": 0.0, "max": 10.0 / volts},
        "stages": [
            stage | {"dx": [one / volts for one in stage["dx"]]},
            SMALL_MODEL["stages"][1],
        ],
    }


@pytest.mark.parametrize(("unit", "volts"), [("kV", 1000.0), ("mV", 1e-3)])
def test_limits_with_units_and_currents_mean_the_same_for_every_model(
    bench: Any, unit: str, volts: float
) -> None:
    Path("other.json").write_text(json.dumps(in_other_unit(unit, volts)))
    for limits in (
        "--v-min 500mV --v-max 0.007kV --max-slew 80V/s --from 0.5V --max-current 1 --capacitance 4e-6",
        "--max-current 0.4mA --capacitance 4uF --from 0V --approach auto",
    ):
        words = ["wish.csv", *limits.split(), "--on-limit", "clip"]
        own = bench("compensate", "model.json", *words, "-o", "own.csv")
        done = bench("compensate", "other.json", *words, "-o", "other.csv")
        assert (own.code, done.code) == (0, 0), done.err
        drives = [
            np.loadtxt(name, delimiter=",", skiprows=1, usecols=2)
            for name in ("own.csv", "other.csv")
        ]
        np.testing.assert_allclose(drives[1] * volts, drives[0], atol=1e-9)
        load = [
            next(line for line in one.err.splitlines() if "into 4e-06 F" in line)
            for one in (own, done)
        ]
        assert load[0] == load[1] and "A at most" in load[0]
        assert " A and " in load[0] and "without a unit" not in done.err
    # 0.4 mA / 4 uF, in 1 ms
    assert np.abs(np.diff(drives[0])).max() == pytest.approx(0.1, rel=1e-3)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            "--v-max 3000",
            "--v-max 3000: plain numbers are read in kV, and the model goes from 0 to 0.01 kV: give its unit "
            "(3000V, 3000kV)",
        ),
        (
            "--from 5",
            "--from 5: plain numbers are read in kV, and the model goes from 0 to 0.01 kV: give its unit "
            "(5V, 5kV)",
        ),
        (
            "--max-slew 2000",
            "--max-slew 2000: the model's drive is in kV: give its unit (2000V/s, 2000kV/s)",
        ),
    ],
)
def test_plain_limits_that_are_probably_in_volts_are_refused(
    bench: Any, words: str, message: str
) -> None:
    Path("kv.json").write_text(json.dumps(in_other_unit("kV", 1000.0)))
    done = bench("compensate", "kv.json", "wish.csv", *words.split(), "-o", "kv.csv")
    assert done == (2, "", f"dbo: error: {message}\n")
    assert not Path("kv.csv").exists()


def test_plain_limits_are_said_to_be_in_the_drive_s_unit(bench: Any) -> None:
    Path("kv.json").write_text(json.dumps(in_other_unit("kV", 1000.0)))
    said = "limits without a unit are read in kV, the drive's (1.2kV, 2000V/s are converted)"
    done = bench("compensate", "kv.json", "wish.csv", "--v-max", "0.1", "-o", "kv.csv")
    assert done.code == 0 and done.err.count(f"dbo: wish.csv: {said}\n") == 1
    done = bench(
        "check", "kv.csv", "--v-max", "100V", "--max-slew", "2V/ms", "--from", "5V"
    )
    assert (done.code, done.err) == (0, "")
    done = bench("check", "kv.csv", "--max-slew", "2V/s")
    assert (
        done.code == 3
        and "kV in one row is faster than 0.002 kV per second" in done.err
    )
    done = bench(
        "compensate", "model.json", "wish.csv", "--max-slew", "2000", "-o", "v.csv"
    )
    assert "without a unit" not in done.err


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        ("compensate model.json wish.csv --v-max 5um",
         "--v-max 5um: cannot be converted; a figure in V is needed"),
        ("compensate model.json wish.csv --max-slew 5V",
         "--max-slew 5V: cannot be converted; a figure in V/s is needed"),
        ("compensate model.json wish.csv --v-max 5V/s",
         "--v-max 5V/s: cannot be converted; a figure in V is needed"),
        ("compensate model.json wish.csv --max-slew=-5V/s", "--max-slew: must be above 0, not -5"),
        ("compensate model.json wish.csv --v-max V", "--v-max: not a number: 'V'"),
        ("compensate model.json wish.csv --v-min 2V --v-max 1500mV", "--v-min 2 must be below --v-max 1.5"),
        ("compensate none.json wish.csv --v-max 5V",
         "--v-max 5V: cannot be converted; a figure without a unit is needed"),
        ("compensate counts.json wish.csv --max-current 1 --capacitance 1e-6",
         "--max-current and --capacitance: the drive is in counts, no voltage"),
        ("check drive.csv --max-slew 2000Hz",
         "--max-slew 2000Hz: cannot be converted; a figure in V/s is needed"),
    ],
)  # fmt: skip
def test_limits_in_units_that_are_none_are_refused(
    bench: Any, words: str, problem: str
) -> None:
    for name, unit in (("none", None), ("counts", "counts")):
        Path(f"{name}.json").write_text(
            json.dumps(SMALL_MODEL | {"input": SMALL_MODEL["input"] | {"unit": unit}})
        )
    done = bench(*words.split())
    assert (done.code, done.err) == (2, f"dbo: error: {problem}\n")


@pytest.mark.whole
def test_waveform_and_excite_take_limits_in_units(bench: Any) -> None:
    done = bench(
        "waveform", "drive.csv", "--to", "npy", "--max-slew", "1kV/s", "-o", "o.npy"
    )
    assert done.code == 3
    assert (
        "row 2: from 50 to 51.2564304 V in one row is faster than 1000 V per second"
        in done.err
    )
    done = bench(
        "waveform", "drive.csv", "--to", "npy", "--v-max", "0.1kV", "-o", "o.npy"
    )
    assert done.code == 0, done.err
    plain = bench("excite", "--v-max", "100", "--max-slew", "2000", "--duration", "4")
    assert (
        bench(
            "excite", "--v-max", "0.1kV", "--max-slew", "2V/ms", "--duration", "4"
        ).out
        == plain.out
    )


def test_identify_takes_the_rating_in_units(bench: Any) -> None:
    log = "time_s,voltage_kV,displacement_um"
    write(
        "log.csv",
        log,
        TIME,
        DRIVE / 1000.0,
        5.0 + 0.04 * DRIVE + np.sin(2.0 * np.pi * 5.0 * TIME - 0.3),
    )
    said = [
        bench("identify", "log.csv", "-o", "m.json", "--force", "--v-min", *ends).err
        for ends in (("0", "--v-max", "0.3"), ("0V", "--v-max", "300V"))
    ]
    assert (
        said[0] == said[1]
        and "the logs cover 0.01 to 0.09, 27 % of the rated range 0 to 0.3" in said[0]
    )
    assert json.loads(Path("m.json").read_text())["provenance"]["arguments"][-3:] == [
        "--v-max",
        "300V",
        "--force",
    ]
    done = bench(
        "identify", "log.csv", "-o", "m.json", "--v-min", "0", "--v-max", "3um"
    )
    assert (done.code, done.err) == (
        2,
        "dbo: error: --v-max 3um: cannot be converted; a figure in kV is needed\n",
    )


@pytest.mark.whole
def test_export_takes_limits_in_units_and_warns_beyond_the_model(bench: Any) -> None:
    done = bench("export", "model.json", "-o", "out", "--v-max", "0.015kV", "--v-min", "0",
                 "--max-slew", "20V/s", "--sample-rate", "1000")  # fmt: skip
    assert done.code == 0 and "warning" not in done.err
    done = bench("export", "model.json", "-o", "out", "--v-max", "0.015kV", "--v-min", "0",
                 "--extrapolate", "--max-slew", "20V/s", "--sample-rate", "1000", "--overwrite")  # fmt: skip
    warning = (
        "the limits allow 5 V above the 0 to 10 V on which the model was identified;"
        " it extrapolates there"
    )
    assert done.code == 0 and f"dbo: warning: {warning}\n" in done.err
    assert (
        "0.0 ... 15.0 V, changing by at most 20.0 V a second" in done.err
        and f"- {warning}\n" in Path("out/README.md").read_text()
    )
    assert (
        "warning" not in bench("export", "model.json", "-o", "in", "--v-max", "10").err
    )


def test_a_recording_in_another_unit_is_compared_in_its_own(bench: Any) -> None:
    write("played.csv", "time_s,voltage_kV", TIME, DRIVE / 1000.0)
    done = bench("check", "played.csv", "--against", "drive.csv", "--tolerance", "1mV")
    assert (done.code, done.err) == (
        0,
        "dbo: drive.csv: column 'voltage_V' is converted from V to kV\n",
    ), done.out
    assert "400 rows, 0 later, gain 1, offset" in done.out
    write("other.csv", "time_s,voltage_mA", TIME, DRIVE)
    done = bench(
        "check", "other.csv", "--voltage", "voltage_mA", "--against", "drive.csv"
    )
    assert (
        done.code == 1
        and "drive.csv: column 'voltage_V' is in V, but the recording is in mA"
        in done.err
    )


# --- as strict as what writes a generator's file ---

BAD_CELLS = {
    "inf": "is not finite: 'inf'", "-inf": "is not finite: '-inf'", "nan": "is not finite: 'nan'",
    "1e400": "is not finite: '1e400'", "": "is empty", "abort": "is not a number: 'abort'",
    "9.9e37": "is the instrument's overflow: '9.9e37'",
}  # fmt: skip


def with_rows(name: str, rows: dict[int, str], end: str = "\n") -> None:
    """Write the drive with some rows (from 1) replaced; {time} is the row's time."""
    lines = [
        f"{time:.3f},{volts:.4f}"
        for time, volts in zip(TIME.tolist(), DRIVE.tolist(), strict=True)
    ]
    for row, text in rows.items():
        lines[row - 1] = text.format(time=lines[row - 1].split(",")[0])
    Path(name).write_text("time_s,voltage_V\n" + "\n".join(lines) + end)


@pytest.mark.whole
@pytest.mark.parametrize("row", [1, 2, 200, 399, 400])
@pytest.mark.parametrize("cell", BAD_CELLS)
def test_a_row_without_a_number_is_a_problem_wherever_it_stands(
    bench: Any, cell: str, row: int
) -> None:
    with_rows("bad.csv", {row: "{time}," + cell})
    done = bench(
        "check", "bad.csv", "--v-min", "0", "--v-max", "100", "--format", "json"
    )
    problem = f"row {row}: column 'voltage_V' {BAD_CELLS[cell]}"
    assert done.code == 3 and done.err.startswith(f"dbo: error: bad.csv: {problem}"), (
        done.err
    )
    assert json.loads(done.out)["problems"][0] == problem
    assert bench("waveform", "bad.csv", "--to", "npy", "-o", "bad.npy").code == 1


@pytest.mark.parametrize("row", [1, 200, 400])
@pytest.mark.parametrize(
    ("text", "cells"), [("{time}", "1 cell"), ("{time},1,2", "3 cells")]
)
def test_a_row_of_another_width_is_a_problem(
    bench: Any, row: int, text: str, cells: str
) -> None:
    with_rows("bad.csv", {row: text})
    done = bench("check", "bad.csv")
    problem = f"row {row}: {cells} where the other rows have 2"
    assert done.code == 3 and done.err.startswith(f"dbo: error: bad.csv: {problem}"), (
        done.err
    )


@pytest.mark.whole
@pytest.mark.parametrize("last", ["0.399,48.7", "0.399,", "0.399", "0.39", "0"])
def test_a_file_that_is_cut_in_its_last_line_does_not_pass(
    bench: Any, last: str
) -> None:
    with_rows("cut.csv", {400: last}, end="")
    done = bench("check", "cut.csv")
    assert done.code == 3 and done.err.startswith("dbo: error: cut.csv: row 400: "), (
        done.err
    )
    assert bench("waveform", "cut.csv", "--to", "npy", "-o", "cut.npy").code == 1


@pytest.mark.parametrize(
    ("line", "shown"),
    [(",", ","), ("stopped", "stopped"), ("nothing,here", "nothing,here")],
)
def test_a_first_row_that_is_taken_for_a_part_of_the_header_is_a_problem(
    bench: Any, line: str, shown: str
) -> None:
    with_rows("bad.csv", {1: line})
    done = bench("check", "bad.csv", "--time", "1", "--voltage", "2")
    problem = f"line 2: '{shown}' is neither a row nor a header"
    assert done.code == 3 and done.err.startswith(f"dbo: error: bad.csv: {problem}"), (
        done.err
    )
    with_rows("ruled.csv", {1: "------,-------"})
    assert bench("check", "ruled.csv").code == 0
    Path("units.csv").write_text(
        "time,drive\ns,V\n" + "".join(f"{k},{k}\n" for k in range(9))
    )
    assert bench("check", "units.csv").code == 0


def test_an_empty_line_among_rows_of_one_cell_is_a_problem(bench: Any) -> None:
    lines = [f"{volts:.4f}" for volts in DRIVE.tolist()]
    Path("one.csv").write_text(
        "\n".join(["voltage_V", "", *lines, "", ""])
    )  # above and below it means nothing
    assert bench("check", "one.csv", "--sample-rate", "1000").code == 0
    lines[199] = ""
    Path("one.csv").write_text("\n".join(["voltage_V", *lines]) + "\n")
    done = bench("check", "one.csv", "--sample-rate", "1000", "--block-rows", "7")
    assert (done.code, done.err) == (
        3,
        "dbo: error: one.csv: line 201: holds no number between two rows\n",
    )


def test_many_bad_rows_are_named_up_to_twenty_and_counted(bench: Any) -> None:
    with_rows("bad.csv", dict.fromkeys(range(1, 401, 10), "{time},nan"))
    done = bench("check", "bad.csv", "--format", "json")
    problems = json.loads(done.out)["problems"]
    assert problems[19] == "row 191: column 'voltage_V' is not finite: 'nan'"
    assert problems[20] == "20 more rows hold no number"


@pytest.mark.whole
@pytest.mark.parametrize("name", ["bad.npy", "bad.h5"])
def test_binary_files_are_as_strict(bench: Any, name: str) -> None:
    drive = DRIVE.copy()
    drive[[0, 399]] = np.nan, np.inf
    if name.endswith("npy"):
        np.save(name, np.stack([TIME, drive], 1))
    else:
        h5py = pytest.importorskip("h5py")
        with h5py.File(name, "w") as file:
            file["time_s"], file["voltage_V"] = TIME, drive
    columns = ["--time", "1", "--voltage", "2"] if name.endswith("npy") else []
    done = bench("check", name, *columns, "--format", "json")
    problems = json.loads(done.out)["problems"]
    assert (done.code, [text.split(":")[0] for text in problems]) == (
        3,
        ["row 1", "row 400"],
    )
    assert problems[0].endswith(" is not finite: 'nan'") and problems[1].endswith(
        " is not finite: 'inf'"
    )


@pytest.mark.parametrize("selector", ["fast.csv::V", "fast.csv"])
def test_a_drive_is_checked_in_its_own_file(bench: Any, selector: str) -> None:
    """On the rows of another file its peak of 500 V, and its end, were looked at by nobody."""
    rows = np.arange(2 * len(TIME))
    fast = np.where(rows == 51, 500.0, 5.0)
    write("fast.csv", "time_s,V", rows * (TIME[1] - TIME[0]) / 2.0, fast)
    limits = ("--v-min", 0, "--v-max", 10)
    done = bench("check", "drive.csv", "--voltage", selector, *limits)
    assert (done.code, done.out) == (2, "")
    assert done.err == (
        "dbo: error: --voltage: a drive is checked in its own file, not on the rows of drive.csv: "
        "check fast.csv (--voltage V)\n"
    )
    done = bench("check", "fast.csv", "--voltage", "V", *limits)
    assert done.code == 3 and "row 52: 500 is outside 0 to 10" in done.err
    assert bench("check", "drive.csv", "--voltage", "drive.csv::voltage_V").code == 0


def test_files_of_unequal_length_and_a_meant_drive_with_bad_rows_are_problems(
    bench: Any,
) -> None:
    write("time.csv", "time_s", TIME[:300])
    done = bench("check", "drive.csv", "--time", "time.csv::time_s")
    assert done.code == 3 and "the files do not end at the same row: " in done.err
    with_rows("meant.csv", {1: "{time},nan"})
    done = bench("check", "drive.csv", "--against", "meant.csv")
    assert done.code == 3
    assert done.err.startswith(
        "dbo: error: drive.csv: meant.csv: row 1: column 'voltage_V' is not finite: 'nan'"
    )


# --- plain numbers are no limits of a column in kV or mV ---


@pytest.mark.parametrize(
    ("unit", "words", "message"),
    [
        ("kV", "--v-max 100", "--v-max 100: the drive is in kV, and a plain number may be meant in V "
         "(--v-max 0.1kV or --v-max 100kV)"),
        ("kV", "--v-min -20", "--v-min -20: the drive is in kV, and a plain number may be meant in V "
         "(--v-min -0.02kV or --v-min -20kV)"),
        ("mV", "--max-slew 2000", "--max-slew 2000: the drive is in mV, and a plain number may be meant in V "
         "(--max-slew 2000000mV/s or --max-slew 2000mV/s)"),
        ("mA", "--from 1", "--from 1: the drive is in mA, and a plain number may be meant in A "
         "(--from 1000mA or --from 1mA)"),
        ("mbar", "--against played.csv --tolerance 1", "--tolerance 1: the drive is in mbar, and a plain "
         "number may be meant in bar (--tolerance 1000mbar or --tolerance 1mbar)"),
        ("kV", "--v-max 5bar", "--v-max 5bar: cannot be converted; a figure in kV is needed"),
        ("bar", "--v-max 5V", "--v-max 5V: cannot be converted; a figure in bar is needed"),
    ],
)  # fmt: skip
def test_a_limit_that_may_mean_something_else_is_refused(
    bench: Any, unit: str, words: str, message: str
) -> None:
    for name in ("d.csv", "played.csv"):
        write(name, f"time_s,drive ({unit})", TIME, DRIVE / 1000.0)
    done = bench("check", "d.csv", "--voltage", "2", *words.split())
    assert (done.code, done.out, done.err) == (2, "", f"dbo: error: {message}\n")


@pytest.mark.parametrize(
    ("unit", "passing", "breaking"),
    [
        (
            "kV",
            "--v-min 0 --v-max 0.0901kV --max-slew 1.3kV/s --from 50V",
            "--v-max 89V",
        ),
        (
            "mA",
            "--v-min 0 --v-max 0.0901A --max-slew 1.3A/s --from 50mA",
            "--v-max 0.089A",
        ),
        ("bar", "--v-max 90.1bar --max-slew 1300", "--v-max 89"),
        ("mbar", "--v-max 0.0901bar", "--v-max 8900Pa"),
    ],
)
def test_limits_with_a_unit_are_taken(
    bench: Any, unit: str, passing: str, breaking: str
) -> None:
    scale = 1000.0 if unit == "kV" else 1.0
    write("d.csv", f"time_s,drive ({unit})", TIME, DRIVE / scale)
    done = bench("check", "d.csv", "--voltage", "2", *passing.split())
    assert done.code == 0, done.err
    assert bench("check", "d.csv", "--voltage", "2", *breaking.split()).code == 3


def test_limits_of_a_column_without_a_unit_are_said_to_be_plain(bench: Any) -> None:
    write("d.csv", "time_s,drive", TIME, DRIVE)
    done = bench("check", "d.csv", "--v-max", "100")
    said = "dbo: d.csv: column 'drive' has no unit: limits are taken in what its figures count\n"
    assert (done.code, done.err) == (0, said)
    assert bench("check", "d.csv").err == ""
    done = bench("check", "d.csv", "--v-max", "0.1kV")
    assert (
        done.code == 2
        and "--v-max 0.1kV: cannot be converted; a figure without a unit is needed"
        in done.err
    )


@pytest.mark.whole
def test_figures_that_no_amplifier_has(bench: Any) -> None:
    write("huge.csv", "time_s,voltage_V", TIME[:4], [0.0, 1e99, 1e101, 1.0])
    message = "row 3: 1e+101 V is no voltage: it is beyond 1e+100"
    for words in (
        ["check", "huge.csv"],
        ["waveform", "huge.csv", "--to", "npy", "-o", "d.npy"],
    ):
        done = bench(*words)
        assert (done.code, done.out, message in done.err) == (1, "", True), done.err
    done = bench("check", "drive.csv", "--against", "huge.csv")
    assert (done.code, done.err) == (
        1,
        "dbo: error: huge.csv: row 3: 1e+101 is no voltage: it is beyond 1e+100\n",
    )
    write(
        "close.csv",
        "time_s,voltage_V",
        [0.0, 5e-324, 1e-323, 1.5e-323],
        [0.0, 1.0, 2.0, 3.0],
    )
    done = bench("check", "close.csv", "--format", "json")
    assert (
        done.code == 0
        and json.loads(done.out)["fastest"] is None
        and "Infinity" not in done.out
    )


def test_no_escape_character_of_a_file_s_name_reaches_the_terminal(bench: Any) -> None:
    odd = "a\x1b[31mb\u009bc"
    with_rows(odd + ".csv", {1: "{time},nan"})
    write(odd + "d.csv", "time_s,vol\x1b[31mtage_V", TIME, DRIVE)
    for words in (
        [odd + ".csv"],
        [odd + "d.csv"],
        ["drive.csv", "--against", odd + ".csv"],
    ):
        for form in ("text", "json"):
            done = bench("check", *words, "--format", form)
            assert not {"\x1b", "\u009b"} & set(done.out + done.err), done.out
            assert words[0] == "drive.csv" or "a [31mb c" in done.out


@pytest.mark.parametrize("rows", [16, 17, 40, 100, 3000])
def test_the_spline_and_the_correlation_are_those_of_scipy(rows: int) -> None:
    rng = np.random.default_rng(rows)
    drive, other = rng.normal(size=rows).cumsum(), rng.normal(size=rows // 2)
    curve, places = (
        CubicSpline(np.arange(float(rows)), drive),
        rng.uniform(0.0, rows - 1.0, 200),
    )
    value, slope = check._Curve(drive).at(places)
    np.testing.assert_allclose(value, curve(places), atol=1e-13 * np.ptp(drive))
    np.testing.assert_allclose(slope, curve(places, 1), atol=1e-13 * np.ptp(drive))
    for a, b in ((drive, other), (other, drive), (drive, drive)):
        exact = correlate(b, a, method="direct")
        np.testing.assert_allclose(
            check._correlated(b, a), exact, atol=1e-12 * np.abs(exact).max()
        )


def test_a_comparison_needs_no_scipy(bench: Any) -> None:
    write(
        "played.csv",
        "time_s,monitor_V",
        TIME + 0.0,
        50.0 + 40.0 * np.sin(31.4159 * (TIME - 0.0004)),
    )
    script = (
        "import sys; from dbo_cli.cli.app import main; "
        "main(['check', 'played.csv', '--against', 'drive.csv']); assert 'scipy' not in sys.modules"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0 and "  played: " in done.stdout, done.stderr


# --- an amplifier that stands outside the limits ---


@pytest.mark.parametrize(
    ("rows", "words", "broken"),
    [
        (
            [150, 150, 150],
            ("--from", "150"),
            "row 2: 150 V is outside 5 to 100 V (2 rows in all)",
        ),
        ([0, 0, 50], ("--from", "0"), "row 2: 0 V is outside 5 to 100 V"),
        ([0, 2, 1, 50], ("--from", "0"), "row 3: 1 V is outside 5 to 100 V"),
        ([0, 2, 2, 50], ("--from", "0"), "row 3: 2 V is outside 5 to 100 V"),
        ([-1, 50, 50], ("--from", "0"), "row 1: -1 V is outside 5 to 100 V"),
        ([0, 2, 50], (), "row 1: 0 V is outside 5 to 100 V (2 rows in all)"),
    ],
)
def test_only_what_comes_inwards_may_be_outside(
    dbo: Any, rows: list[float], words: tuple[str, ...], broken: str
) -> None:
    Path("d.csv").write_text("voltage_V\n" + "".join(f"{row}\n" for row in rows))
    done = dbo("check", "d.csv", "--v-min", "5", "--v-max", "100", *words)
    assert done.code == 3
    assert done.err.splitlines()[-1] == f"dbo: error: d.csv: {broken}"


def test_a_recording_may_repeat_a_value_on_the_way_inwards_but_has_to_arrive(
    dbo: Any,
) -> None:
    words = ("--v-min", "5", "--v-max", "100", "--from", "0", "--against", "d.csv")
    drive = [0.0, 0.5, 1.0, 2.0, 4.0, *np.linspace(8.0, 60.0, 40)]
    recorded = [0.0, 0.0, 1.0, 2.0, 4.0, *np.linspace(8.0, 60.0, 40)]
    for name, rows in (("d", drive), ("p", recorded), ("stuck", [0.0, *[1.0] * 44])):
        Path(f"{name}.csv").write_text(
            "voltage_V\n" + "".join(f"{row}\n" for row in rows)
        )
    assert dbo("check", "p.csv", *words, "--tolerance", "1").code == 0
    assert dbo("check", "p.csv", *words[:6]).code == 3
    done = dbo("check", "stuck.csv", *words, "--tolerance", "1")
    assert done.code == 3
    assert (
        "row 45: 1 V is outside 5 to 100 V by more than the tolerance, 1 V" in done.out
    )


def test_rows_that_come_inwards_are_counted(dbo: Any) -> None:
    Path("d.csv").write_text("voltage_V\n0\n2\n4\n50\n50\n")
    done = dbo("check", "d.csv", "--v-min", "5", "--v-max", "100", "--from", "0")
    assert done.code == 0
    assert (
        "dbo: warning: d.csv: the first 3 rows outside the limits, on the way inwards from where the "
        "amplifier stands (--from)\n"
    ) in done.err


def test_the_first_row_has_the_time_up_to_the_second(dbo: Any) -> None:
    """As in the drive of compensate, whose clock may be uneven."""
    Path("d.csv").write_text(
        "time_s,voltage_V\n0,12\n0.012,13\n0.022,14\n0.032,15\n0.042,16\n"
    )
    assert dbo("check", "d.csv", "--from", "0", "--max-slew", "1000").code == 0
    assert dbo("check", "d.csv", "--from", "0", "--max-slew", "999").code == 3


def test_the_figures_of_a_drive_by_hand() -> None:
    """Travel, work, time and the fastest step; what there was before the first row counts for none."""
    figures = DriveFigures()
    figures.see(np.array([-1.0, -3.0, 1.0]), np.array([7.0, 0.5, 2.0]))
    figures.see(np.array([2.0, -4.0]), np.array([0.25, 1.0]))
    assert (figures.low, figures.high) == (-4.0, 2.0)
    assert (figures.first, figures.last, figures.rows) == (-1.0, -4.0, 5)
    assert (figures.largest_step, figures.travel) == (6.0, 13.0)
    assert figures.work == 3.0 * 2.0 + 1.0 * 4.0 + 2.0 * 1.0 + 4.0 * 6.0
    assert figures.seconds == 0.5 + 2.0 + 0.25 + 1.0
    assert figures.fastest == 6.0


def test_a_step_may_exceed_the_slew_limit_by_rounding_alone() -> None:
    limits = DriveLimits(0.0, 100.0, 1000.0)
    gate = DriveGate(limits)
    assert gate.broken(np.array([50.0, 51.0, 52.0 + 1e-14]), 0.001).tolist() == [
        False,
        False,
        False,
    ]
    assert DriveGate(limits).broken(np.array([50.0, 51.0 + 1e-9]), 0.001).tolist() == [
        False,
        True,
    ]
