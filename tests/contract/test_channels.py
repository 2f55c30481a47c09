"""Many channels of one log: ``{}`` in the names of columns, and a set of models as one file."""

import wave
from pathlib import Path

import h5py
import numpy as np
import pytest

from .program import (
    DRIVE, QUICK, dbo, done, load, model, refused, simulated, store, store_set, table,
    values_of, write,
)  # fmt: skip

TIME = np.arange(600) / 500.0
NAMES = ("a", "b", "c")
FORCED = (*QUICK, "--force")
SIDES = ("--voltage", "V{}", "--displacement", "D{}")
KINDS = (("voltage", "V"), ("displacement", "um"))


def swings(number):
    size = np.where(TIME < 0.7, 5.0, 3.0)
    return 5.0 - size * np.cos(2.0 * np.pi * 2.5 * TIME + 0.3 * number)


@pytest.fixture
def channels():
    """Return a log of three channels, and write ``set.json`` with a model for each."""
    columns = {"time_s": TIME}
    models = {}
    for number, name in enumerate(NAMES):
        drive = np.clip(swings(number), 0.0, 10.0)
        moved = simulated("small", write("one.csv", DRIVE, TIME, drive))
        columns[f"V{name}_V"] = drive
        columns[f"D{name}_um"] = (1.0 + 0.1 * number) * moved
        models[name] = values_of("small")
        models[name]["stages"][1] |= {"gain": 1.6 + 0.1 * number}
    Path("one.csv").unlink()
    store_set("set.json", **models)
    return write("mirror.csv", ",".join(columns), *columns.values())


def of_channel(written, name, quantity):
    """Return the one column of a channel with a quantity."""
    [values] = [
        column for key, column in written.items()
        if name in key.split("_") and quantity in key
    ]  # fmt: skip
    return values


def test_identify_makes_the_model_of_each_channel(channels):
    words = (*SIDES, *FORCED, "-o", "models.json", "--summary", "s.json")
    outcome = done("identify", channels, *words)
    held = load("models.json")
    assert (held["format"], held["version"]) == ("dbo-model-set", 1)
    assert list(held["models"]) == list(NAMES)
    summaries = load("s.json")["summaries"]
    assert list(summaries) == list(NAMES) and summaries["a"]["rmse"] >= 0.0
    assert all(any(f" {n}: " in f" {line}" for line in outcome.said) for n in NAMES)
    alone = ("--voltage", "Vc_V", "--displacement", "Dc_um")
    done("identify", channels, *alone, *FORCED, "-o", "alone.json", "-q")
    assert held["models"]["c"]["stages"] == load("alone.json")["stages"]
    words = (*SIDES, "--prior", "models.json", "--force", "-o", "again.json")
    done("identify", channels, *words)
    line = refused(1, "identify", channels, *alone, "--prior", "set.json")
    assert "set.json" in line and "set.json::" in line


def test_simulate_and_compensate_write_all_channels_side_by_side(channels):
    """With the log's own clock, which is uneven."""
    columns = table(channels)
    columns["time_s"] += 4e-4 * np.sin(np.arange(len(TIME)))
    write(channels, ",".join(columns), *columns.values())
    done("simulate", "set.json", channels, "--input", "V{}_V", "-o", "out.csv", "-q")
    moved = table("out.csv")
    names = (f"{kind}_{n}_{unit}" for n in NAMES for kind, unit in KINDS)
    assert list(moved) == ["time_s", *names]
    words = ("--v-max", 9, "--max-slew", 60, "--on-limit", "clip", "-q")
    line = ("compensate", "set.json", channels, "--displacement", "D{}_um", *words)
    done(*line, "-o", "drives.csv")
    drives = table("drives.csv")
    for name in NAMES:
        alone = ("--input", f"V{name}_V", "-q")
        single = table(done("simulate", f"set.json::{name}", channels, *alone))
        ours = of_channel(moved, name, "displacement")
        np.testing.assert_allclose(ours, single["displacement_um"], atol=1e-12)
        alone = ("--displacement", f"D{name}_um", *words, "-o", "one.csv")
        done("compensate", f"set.json::{name}", channels, *alone)
        ours = of_channel(drives, name, "voltage")
        assert ours.max() <= 9.0
        time, _, one = table("one.csv").values()
        np.testing.assert_allclose(ours, one, atol=1e-12)
        np.testing.assert_array_equal(drives["time_s"], time)


@pytest.mark.parametrize("command", [
    "simulate set.json torn.csv --input V{}_V",
    "compensate set.json torn.csv --displacement D{}_um --on-limit clip",
])  # fmt: skip
@pytest.mark.parametrize("time", ["time_s", "count"])
@pytest.mark.parametrize("rows", [{"a": 100, "b": 200, "c": 200}, {"b": 7}])
def test_rows_left_out_of_one_channel_alone_are_refused(channels, command, time, rows):
    log = table(channels)
    for name, row in rows.items():
        log[f"V{name}_V"][row] = log[f"D{name}_um"][row] = np.nan
    write("torn.csv", ",".join(log).replace("time_s", time), *log.values())
    rate = () if time == "time_s" else ("--sample-rate", 500)
    words = (*command.split(), *rate, "--skip-bad", "-o", "out.csv")
    told = refused(1, *words)
    first = min(rows.values())
    assert f"row {first + 1} " in told and f"--rows :{first}" in told
    done(*words, "--rows", f":{first}")


def test_identify_says_what_was_read_of_each_channel(channels):
    log = table(channels)
    columns = {name: log[name] for name in log if name[1:2] != "c"}
    write("two.csv", ",".join(columns), *columns.values())
    said = done("identify", "two.csv", *SIDES, *FORCED, "-o", "models.json").said
    for name in "ab":
        assert any("500 Hz" in line and f"V{name}_V" in line for line in said)


def test_identify_warns_of_the_channel_whose_log_is_doubtful(channels):
    """Two channels of one log: nobody could tell which one it was."""
    log = table(channels)
    volts, moved, drift = log["Va_V"], log["Da_um"], 50.0 * log["time_s"]
    columns = (log["time_s"], volts, moved, volts, moved + drift)
    write("two.csv", "time_s,Va_V,Da_um,Vb_V,Db_um", *columns)
    words = ("identify", "two.csv", *SIDES, *FORCED, "-o", "models.json")
    [drifting] = [text for text in done(*words).warnings if "drift" in text]
    assert "warning: channel b: two.csv: " in drifting


def test_a_unit_that_is_assumed_is_told_of_a_channel_and_of_what_was_to_be_played():
    time = np.arange(200) / 100.0
    volts = 5.0 + 2.0 * np.sin(time)
    write("bare.csv", "time_s,Vx,Vy,Dx,Dy", time, volts, volts, volts, volts)
    write("milli.csv", "time_s,voltage_mV", time, 1000.0 * volts)
    write("one.csv", "time_s,voltage", time, 1000.0 * volts)
    simulate = ("simulate", model("set"), "bare.csv", "--input", "V{}")
    compensate = ("compensate", model("set"), "bare.csv", "--displacement", "D{}")
    check = ("check", "milli.csv", "--against", "one.csv")
    for words, held in ((simulate, "Vy"), (compensate, "Dy"), (check, "voltage")):
        warnings = [text for text in dbo(*words).warnings if "assumed" in text]
        assert held in warnings[-1] and "--scale" in warnings[-1]


def test_a_model_in_another_case_is_offered(channels):
    assert "type set.json::a" in refused(1, "simulate", "set.json::A", channels)
    log = table(channels)
    write("upper.csv", "time_s,DA_um,DB_um", TIME, log["Da_um"], log["Db_um"])
    words = ("compensate", "set.json", "upper.csv", "--displacement", "D{}_um")
    line = refused(1, *words)
    assert "no model A" in line and "set.json::a" in line and "--displacement" in line
    done(*words[:1], "set.json::a", "upper.csv", "--displacement", "DA_um", "-q")


@pytest.mark.parametrize("header", ["t_s,x_um,y_um", "t_s,Vx_V,Vy_V,x_um,y_um"])
def test_a_bare_pattern_takes_the_columns_of_its_role(channels, header):
    models = load("set.json")["models"].values()
    store_set("xy.json", **dict(zip("xy", models, strict=False)))
    moves = [2.0 + 0.2 * swings(number) for number in range(2)]
    volts = [swings(2), swings(3)] if "V" in header else []
    write("xy.csv", header, TIME, *volts, *moves)
    command = ("compensate", "xy.json", "xy.csv", "--on-limit", "clip", "-q")
    bare = done(*command, "--displacement", "{}")
    assert bare.out == done(*command, "--displacement", "{}_um").out
    error = refused(1, "simulate", "xy.json", "xy.csv", "--input", "{}_A")
    assert "finds none" in error


@pytest.mark.parametrize("pattern", ["/axes/V{}_V", "/{}/drive_V", "{}/drive_V"])
def test_a_pattern_may_be_the_path_of_datasets(channels, pattern):
    log = table(channels)
    with h5py.File("log.h5", "w") as file:
        file["time_s"] = TIME
        for name in NAMES:
            file[pattern.replace("{}", name)] = log[f"V{name}_V"]
            file[f"axes/deep/V{name}_V"] = np.zeros(3)
    words = ("-q", "-o", "out.csv", "--input")
    done("simulate", "set.json", channels, *words, "V{}_V")
    expected = table("out.csv")
    done("simulate", "set.json", "log.h5", *words, pattern)
    for name in NAMES:
        moved, alone = (of_channel(t, name, "um") for t in (table("out.csv"), expected))
        np.testing.assert_array_equal(moved, alone)
    words = ("simulate", "set.json", "log.h5", "--input", "/none/V{}_V")
    assert "finds none" in refused(1, *words)


REFUSED = {
    "simulate set.json mirror.csv --input Q{}": ("mirror.csv", "Q{}"),
    "simulate two.json mirror.csv --input V{}_V": ("b", "two.json"),
    "simulate set.json mirror.csv": ("type set.json::a", "--input '{}'"),
    "compensate set.json mirror.csv": ("type set.json::a", "--displacement '{}'"),
    "simulate set.json mirror.csv --input v{}": ("finds none", "--input COLUMN"),
    "identify upper.csv --voltage V{} --displacement D{}": (
        "finds X, Y", "finds x, y", "rename", "--voltage COLUMN --displacement COLUMN"
    ),
    "check one.csv --against mirror.csv": ("--against", "mirror.csv", "voltage_V"),
}  # fmt: skip


def test_what_does_not_pair_is_named_with_what_to_type(channels):
    log = list(table(channels).values())
    write("upper.csv", "time_s,VX_V,VY_V,Dx_um,Dy_um", TIME, *log[1:5])
    write("one.csv", "time_s,U_V", TIME, log[1])
    held = load("set.json")
    del held["models"]["b"]
    store("two.json", held)
    for line, words in REFUSED.items():
        error = refused(1, *line.split())
        assert all(word in error for word in words), error


@pytest.mark.parametrize("line", ["export set.json -o out", "invert set.json",
    "trajectory sine --rate 1kHz --range 1:2um --frequency 5 --model set.json"])  # fmt: skip
def test_a_set_for_one_model_is_refused_with_what_to_type(channels, line):
    """Where no column can be a pattern, none is asked for."""
    error = refused(1, *line.split())
    assert "a, b, c" in error and "type set.json::a" in error and "pattern" not in error
    error = refused(
        1, *line.replace("set.json", "-").split(), stdin=Path("set.json").read_bytes()
    )
    assert "type -::a" in error
    done(*line.replace("set.json", "set.json::a").split(), "-q")


def test_an_error_and_a_warning_of_one_channel_name_it(channels):
    words = ("--displacement", "D{}_um", "--v-max", "7", "--on-limit", "clip")
    warned = dbo("compensate", "set.json", channels, *words, "-o", "x.csv").err
    for name in NAMES:
        assert f"warning: channel {name}: " in warned
    lines = channels.read_text().splitlines()
    cells = lines[50].split(",")
    cells[3] = "OVLD"  # the drive of channel b
    lines[50] = ",".join(cells)
    channels.write_text("\n".join(lines) + "\n")
    error = refused(1, "simulate", "set.json", channels, "--input", "V{}_V")
    assert "Vb" in error and "OVLD" in error


# --- a scanner as one thing: every option, one table, one lead ---

SCANNER = ("--displacement", "D{}_um", "--on-limit", "clip")


@pytest.fixture
def scanner(folder):
    """Return two axes of 0 to 10 V, one with relaxation and a delay, and write ``scanner.json``."""
    quick, slow = values_of("small"), values_of("small")
    term = {"on": "input", "reference": 0.0, "tau": [0.05], "gain": [0.02]}
    slow["stages"][0]["relaxation"] = term
    slow["stages"].append({"type": "delay", "seconds": 0.004})
    store_set("scanner.json", x=quick, y=slow)
    phase = 2.0 * np.pi * np.arange(600) / 600
    axes = [5.0 - 2.0 * np.cos(phase), 5.0 + 1.5 * np.sin(phase)]
    return write("wish.csv", "time_s,Dx_um,Dy_um", TIME, *axes)


def drives_of(*words):
    """Return the drives of both axes in one table; their lengths and clocks are one."""
    line = ("compensate", "scanner.json", "wish.csv", *SCANNER, *words)
    done(*line, "-o", "d.csv", "-q")
    return table("d.csv")


@pytest.mark.parametrize(
    "words",
    [
        "--from 0 --approach auto",
        "--from x=9 --from y=0.5 --approach auto --max-slew x=10 --max-slew y=200",
        "--condition",
        "--condition --approach 3 --from 1",
        "--condition --v-max y=8 --return x=4 --return y=0",
        "--lead auto",
    ],
)
def test_what_stands_around_the_move_takes_equally_long(scanner, words):
    written = drives_of(*words.split())
    time = written["time_s"]
    move = (time > -1e-9) & (time < TIME[-1] + 1e-9)
    np.testing.assert_allclose(time[move], TIME, atol=1e-9)
    np.testing.assert_allclose(np.diff(time), 0.002, atol=1e-9)
    wanted = table(scanner)
    for axis in "xy":
        desired = written[f"desired_{axis}_um"][move]
        np.testing.assert_allclose(desired, wanted[f"D{axis}_um"], atol=1e-12)
        assert np.isfinite(written[f"voltage_{axis}_V"]).all()
    if "y=8" in words:
        assert written["voltage_y_V"].max() <= 8.0 < written["voltage_x_V"].max()
        assert (written["voltage_x_V"][-1], written["voltage_y_V"][-1]) == (4.0, 0.0)
    if "x=10" in words:
        assert np.abs(np.diff(written["voltage_x_V"])).max() <= 0.02 * (1.0 + 1e-9)
        assert (written["voltage_x_V"][0], written["voltage_y_V"][0]) == (9.0, 0.5)


def played(columns):
    """Write a recording of both axes: the drives, and displacements by their columns."""
    drives = table("d.csv")
    volts = {f"v{axis}_V": drives[f"voltage_{axis}_V"] for axis in "xy"}
    all_columns = {"time_s": drives["time_s"], **columns, **volts}
    return write("track.csv", ",".join(all_columns), *all_columns.values())


def test_a_channel_of_a_set_is_driven_as_if_alone(scanner):
    """The axis with the longest way is the one that a single drive gives, to the bit."""
    words = ("--from", "0", "--approach", "auto", "--condition")
    both = drives_of(*words)["voltage_y_V"]
    alone = ("--displacement", "Dy_um", *SCANNER[2:], *words, "-q", "-o", "one.csv")
    done("compensate", "scanner.json::y", scanner, *alone)
    one = table("one.csv")["voltage_V"]
    assert both.size >= one.size
    np.testing.assert_allclose(both[-one.size :], one, atol=1e-9)


def test_states_and_summaries_of_a_set_are_sets(scanner):
    words = ("--save-state", "s.json", "--summary", "sum.json", "-o", "d.csv")
    outcome = done("compensate", "scanner.json", scanner, *SCANNER, *words)
    for axis in "xy":  # a line and an expected error a channel
        assert any(f" {axis}: " in f" {line}" for line in outcome.said), outcome.err
    states = load("s.json")
    assert (states["format"], states["version"]) == ("dbo-state-set", 1)
    assert list(states["states"]) == ["x", "y"]
    rows = load("sum.json")["summaries"]["y"]["rows"]
    assert rows == table("d.csv")["time_s"].size
    assert drives_of("--state", "s.json")["voltage_x_V"].size == 600
    line = ("simulate", "scanner.json", "d.csv", "--input", "voltage_{}", "-q")
    done(*line, "--save-state", "t.json")
    done(*line, "--state", "t.json")
    del states["states"]["y"]
    store("s.json", states)
    words = ("--state", "s.json", "-o", "x.csv")
    error = refused(1, "compensate", "scanner.json", scanner, *SCANNER, *words)
    assert "s.json" in error and "y" in error


def test_a_scanner_is_learned_and_looped(scanner):
    loop = ("--periodic", "--passes", 2, "--from", "x=0", "--from", "y=1")
    drives = drives_of(*loop, "--approach", "auto")
    assert (drives["voltage_x_V"][0], drives["voltage_y_V"][0]) == (0.0, 1.0)
    desired = drives_of()
    played({f"m{axis}_um": 1.01 * desired[f"desired_{axis}_um"] for axis in "xy"})
    tracked = ("--tracked", "track.csv", "--voltage", "v{}", "--measured", "m{}")
    for _ in range(2):
        drives_of(*tracked, "--history", "h.json")
    histories = load("h.json")
    assert histories["format"] == "dbo-history-set"
    assert len(histories["histories"]["y"]["passes"]) == 1


def test_a_limit_of_a_channel_is_typed_with_its_name(scanner):
    words = ("compensate", "scanner.json", scanner, *SCANNER, "-o", "x.csv")
    twice = ("--v-max z=9", "--v-max x=9 --v-max x=8")
    # one limit for all would let a small channel go to the end of a large one
    beyond = ("--v-max 120 --extrapolate", "--v-max 120 --from 0 --return 110")
    for wrong in (*twice, *beyond):
        assert "--v-max" in refused(2, *words, *wrong.split())
    done(*words, "--v-max", "x=12", "--v-max", "y=10", "--extrapolate")
    line = ("compensate", "scanner.json::x", scanner, "--displacement", "Dx_um")
    refused(2, *line, "--v-max", "x=9", "-o", "x.csv")


def test_check_looks_at_every_channel(scanner):
    drives_of("--v-max", "y=8", "--from", "0", "--approach", "auto")
    words = ("check", "d.csv", "--voltage", "voltage_{}")
    done(*words, "--v-min", 0, "--v-max", "x=10", "--v-max", "y=8", "--from", 0)
    outcome = dbo(*words, "--v-max", "x=10", "--v-max", "y=5", "--format", "json")
    assert outcome.code == 3 and "channel y" in outcome.lines[-1]
    checks = outcome.json["checks"]
    assert checks["x"]["passed"] and not checks["y"]["passed"]
    done(*words, "--against", "d.csv")


def test_waveforms_of_all_channels(scanner):
    drives = drives_of("--from", "0", "--approach", "auto")
    words = ("waveform", "d.csv", "--voltage", "voltage_{}", "--to")
    done(*words, "npy", "-o", "d.npy")
    volts = np.load("d.npy")
    stacked = np.column_stack([drives["voltage_x_V"], drives["voltage_y_V"]])
    np.testing.assert_array_equal(volts, stacked)
    done(*words, "wav", "-o", "d.wav")
    with wave.open("d.wav") as file:
        assert (file.getnchannels(), file.getnframes()) == (2, volts.shape[0])
        codes = np.frombuffer(file.readframes(volts.shape[0]), "<i2").reshape(-1, 2)
    for place in (0, 1):
        low, high = volts[:, place].min(), volts[:, place].max()
        heard = low + (codes[:, place] + 32767.0) / 65534.0 * (high - low)
        np.testing.assert_allclose(heard, volts[:, place], atol=1e-3)
    done(*words, "uint16", "--volts", "0:10", "-o", "d.bin")
    for axis in "xy":
        assert Path(f"d_{axis}.bin").stat().st_size == 2 * volts.shape[0]
    refused(2, *words, "uint16", "--volts", "0:10")
    refused(3, *words, "npy", "--v-max", "y=5", "-o", "e.npy")


def test_report_of_every_channel(scanner, unpainted):
    desired = drives_of("--summary", "sum.json")
    played({f"m{axis}_um": desired[f"desired_{axis}_um"] + 0.01 for axis in "xy"})
    words = ("report", "track.csv", "--measured", "m{}", "--voltage", "v{}")
    by_model = done(*words, "--model", "scanner.json", "--format", "json").json
    for axis in "xy":
        assert by_model["reports"][axis]["format"] == "dbo-report"
    words = (*words, "--trajectory", "d.csv", "--desired", "desired_{}_um")
    bound = ("--max-rmse", "5nm", "-o", "r.txt")
    outcome = dbo(*words, "--expected", "sum.json", *bound)
    assert outcome.code == 3
    text = Path("r.txt").read_text()
    assert "channel x" in text and "channel y" in text and "0.01" in text
    assert len([line for line in outcome.said if " y: " in f" {line}"]) == 1
    done(*words, "-o", "r.html")
    assert Path("r_x.html").exists() and Path("r_y.html").exists()
