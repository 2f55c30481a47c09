"""Everyday logs, and what is asked where a log is not clear: nothing is read wrong in silence."""

import re
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
import scipy.io

from dbo_cli.errors import UsageError
from dbo_cli.logs import Reading

from .program import DRIVE, dbo, done, model, process, refused, table, write

ROWS = 60
TIME = np.arange(ROWS) / 1000.0
VOLTS = np.round(5.0 - 5.0 * np.cos(2.0 * np.pi * 40.0 * TIME), 4)


def driven(name, *words):
    """Return the input that ``simulate`` writes beside its output, whatever it is called."""
    written = table(done("simulate", model("small"), name, *words))
    return list(written.values())[-2]


def asked(name, *words, command="simulate"):
    """Return what is asked of a log that is not clear."""
    models = () if command == "identify" else (model("small"),)
    return refused(1, command, *models, name, *words)


def text(name, head, line, *columns):
    """Write a log as text, each row formatted by ``line``."""
    rows = "".join(line.format(*row) + "\n" for row in zip(*columns, strict=True))
    Path(name).write_text(head + rows, encoding="utf-8")
    return name


def told():
    text("log.txt", "", "{:.4f}|{:.4f}", TIME, VOLTS)
    rows = Path("log.txt").read_text().replace(".", ",")
    Path("log.txt").write_text("bench 3|7|x\ntime_s|voltage_V\n" + rows, "utf-16")
    words = "--delimiter | --decimal comma --skip-lines 1 --encoding utf-16"
    return f"log.txt {words}"


def test_an_everyday_log_is_read():
    """Dialects and formats: ``tests/shapes``, ``tests/logs``."""
    outcome = done("simulate", model("creep"), *told().split(), "-o", "out.csv")
    time, volts, _ = table("out.csv").values()
    np.testing.assert_allclose(volts, VOLTS, atol=1e-9)
    np.testing.assert_allclose(time - time[0], TIME, atol=1e-6)
    assert "60 rows" in outcome.err


# --- what is not clear is asked ---


def plain(header="a,b,c"):
    return text("log.csv", header + "\n", "{:.4f},{:.4f},{:.4f}", TIME, VOLTS, VOLTS)


def test_no_column_or_several_fit_and_the_option_is_said():
    error = asked(plain())
    for word in ("log.csv", "--input", "a", "b", "c"):
        assert word in error
    error = asked(plain("time_s,voltage1_V,voltage2_V"))
    assert "--input" in error and "voltage1_V" in error and "voltage2_V" in error
    done("simulate", model("small"), "log.csv", "--input", "voltage2_V")
    np.testing.assert_allclose(driven(plain("time_s,CH1_V,CH2_um")), VOLTS)


def test_a_time_column_of_unknown_unit_is_asked_about():
    """Counting up by 1 a row over a minute: seconds, milliseconds or rows."""
    write("log.csv", "time,voltage_V", np.arange(ROWS, dtype=float), VOLTS)
    error = refused(1, "simulate", model("creep"), "log.csv")
    assert "--time-unit" in error
    words = ("--time-unit", "ms")
    written = table(done("simulate", model("creep"), "log.csv", *words))
    np.testing.assert_allclose(written["time_s"], TIME, atol=1e-12)


LONG = np.arange(600) / 500.0
SWING = np.round(50.0 - 50.0 * np.cos(2.0 * np.pi * 2.5 * LONG), 4)
MOVED = np.round(0.1 * SWING + 0.3 * np.sin(2.0 * np.pi * 2.5 * LONG), 5)
COUNT = np.arange(1.0, 601.0)
HELD = np.full(600, 50.0)
BOTH = {"voltage": "NAME", "displacement": "NAME"}


@pytest.mark.parametrize(
    ("header", "columns", "options"),
    [
        ("seq_num,time,setpoint,piezo,offset", (COUNT, LONG, SWING, MOVED, 0 * HELD), BOTH),
        ("Time(s),Voltage(V):Stage,Voltage(V)", (LONG, SWING, MOVED), {"displacement": "NAME"}),
        ("t[s],Vx[V],Vy[V],x[nm],y[nm]", (LONG, SWING, HELD, MOVED, MOVED / 9), BOTH),
        ("time_s,a,b", (LONG, SWING, MOVED), BOTH),
        ("time_s,voltage_V,a,b", (LONG, SWING, MOVED, HELD), {"displacement": "NAME"}),
        ("time_s,voltage_V,CH2", (LONG, SWING, MOVED), {"displacement": "NAME"}),
        ("time_s,index,displacement_um", (LONG, COUNT, MOVED), {"voltage": "NAME"}),
    ],
)  # fmt: skip
def test_a_question_names_all_columns_and_proposes_none(header, columns, options):
    write("log.csv", header, *columns)
    message = asked("log.csv", command="identify")
    example = message.partition("(for example ")[2].partition(")")[0]
    pairs = re.findall(r"--(\w+) ('[^']*'|\S+)", example)
    assert {role: name.strip("'") for role, name in pairs} == options
    for name in header.split(","):
        assert name in message


def test_the_names_of_the_data_stand_right_above_the_numbers():
    above = "R,Ohm\tC,nF\tTemp,C\n0000000000\t0000001000\t+024.50\n"
    line = "{:+09.4f}\t{:+09.4f}\t{:08.3f}"
    text("log.txt", f"{above}Drive,V\tGap,um\tTime,s\n", line, SWING, MOVED, LONG)
    message = asked("log.txt", command="identify")
    assert "log.txt:3: " in message and "--skip-lines 2" in message
    words = ("--skip-lines", 2, "--voltage", "x")
    message = asked("log.txt", *words, command="identify")
    assert "1 Drive,V, 2 Gap,um, 3 Time,s" in message


# --- options ---


def pair():
    return text("log.csv", "time_s,voltage_V\n", "{:.4f},{:.4f}", TIME, VOLTS)


def test_an_offset_needs_columns_of_two_files():
    words = (pair(), "--clock-offset", "0.1")
    for command in ("simulate", "compensate"):
        error = refused(2, command, model("small"), *words)
        assert "--clock-offset" in error and "FILE::COLUMN" in error
    assert "FILE::COLUMN" in refused(2, "identify", *words)


def test_an_offset_of_recordings_is_none_of_the_trajectory():
    write("sensor.csv", "time_s,measured_um", TIME, VOLTS / 10.0)
    write("move.csv", "time_s,displacement_um", TIME, VOLTS / 10.0)
    words = ("compensate", model("small"), "move.csv", "--tracked", "sensor.csv")
    joined = ("--voltage", f"{pair()}::voltage_V", "--clock-offset", "0")
    outcome = dbo(*words, *joined, "-o", "out.csv")
    assert "FILE::COLUMN" not in outcome.err and outcome.code != 2
    assert "FILE::COLUMN" in refused(2, *words, "--clock-offset", "0")


def test_resample_makes_an_even_clock():
    jittered = TIME + 0.0002 * np.sin(np.arange(ROWS))
    write("log.csv", DRIVE, jittered, 100.0 * jittered)
    written = table(done("simulate", model("small"), "log.csv", "--resample", "500"))
    np.testing.assert_allclose(np.diff(written["time_s"]), 0.002, rtol=1e-9)
    time, volts, _ = written.values()
    np.testing.assert_allclose(volts, 100.0 * time, atol=1e-6)


def test_an_encoding_that_does_not_fit_is_refused():
    assert "utf-16-le" in asked(pair(), "--encoding", "utf-16")


@pytest.mark.parametrize("offset", [0.0, 0.3])
def test_a_column_of_another_file_is_joined_by_time(offset):
    """The drive is interpolated onto the displacement's rows, its clock moved as typed."""
    fine = np.arange(3000) / 10_000.0
    write("drive.csv", "time_s,CH1_V", fine + offset, 10.0 * fine)
    slow = np.arange(100) / 500.0 + 0.01
    write("sensor.csv", "time_s,measured_um", slow, 10.0 * slow)
    words = ("--desired", "drive.csv::CH1_V", "--scale", "desired=1um/V")
    moved = ("--clock-offset", -offset) if offset else ()
    told = done("report", "sensor.csv", *words, *moved, "--format", "json").json
    assert told["logs"][0]["samples"] == 100
    assert told["logs"][0]["rmse"] < 1e-9


# --- what is no log, and files of other libraries ---


@pytest.mark.parametrize("content", ["", "\n\n", "# nothing\n", "time_s,voltage_V\n"])
def test_an_empty_file_is_called_empty(content):
    Path("log.csv").write_text(content)
    told = asked("log.csv")
    assert "empty" in told and "--" not in told
    assert "--skip-lines" in asked(pair(), "--skip-lines", 10**6)
    with pytest.raises(UsageError, match="`skip_lines` -1"):
        Reading(skip_lines=-1)


@pytest.mark.parametrize("cells", ["{0},5,1{0},5", "1'00{0};2'00{0}"])
def test_numbers_that_are_not_plain_are_asked_for_plainly(cells):
    rows = [cells.format(n) for n in range(5)]
    Path("log.csv").write_text("\n".join(["voltage_V,displacement_um", *rows]) + "\n")
    typed = ("--delimiter", "comma", "--decimal", "comma")
    for words in ((), typed):
        told = asked("log.csv", *words, command="identify")
        assert "plain numbers" in told or "no numbers" in told


@pytest.mark.parametrize(
    ("content", "values"),
    [
        ("0,5\n1,5\n2,5\n3,5\n", ["--delimiter comma", "--decimal comma"]),
        ("1,500;1\n1,501;2\n1,502;1\n1,503;2\n", ["--decimal comma"]),
        ("0\t500;1\n1\t501;2\n2\t502;1\n", ["--delimiter tab", "--delimiter semicolon"]),
    ],
)  # fmt: skip
def test_what_may_be_read_in_two_ways_is_asked_with_the_values_to_type(content, values):
    Path("log.csv").write_text(content)
    told = asked("log.csv", command="identify")
    assert "two ways" in told
    assert all(value in told for value in values), told
    for value in values:
        assert "two ways" not in asked("log.csv", *value.split(), command="identify")


def test_columns_that_their_units_call_exchanged_are_refused():
    time = np.arange(1000) / 500.0
    drive = 50.0 - 50.0 * np.cos(2.0 * np.pi * time)
    write("log.csv", "time_s,drive_V,place_um", time, drive, 0.1 * drive)
    words = ("--voltage", "place_um", "--displacement", "drive_V")
    told = asked("log.csv", *words, command="identify")
    assert "exchanged" in told and "--voltage" in told and "--scale" in told
    words = (*words, "--scale", "displacement=2um/V", "--gears", 20, "--points", 0)
    done("identify", "log.csv", *words, "--relaxation", 0, "--delay", 0, "--force")


@pytest.mark.parametrize("blank", [" ", "\t", ","])
def test_a_lone_quote_at_the_end_is_no_internal_error(blank):
    rows = "".join(f"{k / 100}{blank}{k % 10}\n" for k in range(100))
    Path("log.txt").write_text(f'time_s{blank}voltage_V\n{rows}"')
    outcome = dbo("simulate", model("small"), "log.txt", "-o", "out.csv")
    assert outcome.code in (0, 1)
    assert "internal" not in outcome.err


@pytest.mark.parametrize("suffix", ["parquet", "feather"])
def test_brackets_in_a_name_are_no_pattern(suffix):
    """A pattern ``run[1]`` matches ``run1``: that is another file."""
    for name, factor in (("run1", 0.5), ("run[1]", 1.0)):
        frame = pd.DataFrame({"time_s": TIME, "voltage_V": factor * VOLTS})
        getattr(frame, f"to_{suffix}")(f"{name}.{suffix}")
    np.testing.assert_array_equal(driven(f"run[1].{suffix}"), VOLTS)
    np.testing.assert_array_equal(driven(f"run1.{suffix}"), 0.5 * VOLTS)


ATTACK = """
import pathlib
from dbo_cli.errors import DboError
from dbo_cli.logs import open_log
whole = pathlib.Path("run.mat").read_bytes()
refused = 0
for place in range(116, len(whole)):
    damaged = bytearray(whole)
    damaged[place] = 255 * (damaged[place] < 128)
    pathlib.Path("damaged.mat").write_bytes(damaged)
    try:
        with open_log("damaged.mat", {"time": None, "voltage": "2"}) as log:
            log.read()
    except DboError as problem:
        refused += 1
        assert chr(10) not in str(problem)
print(refused)
"""
"""Every byte takes another value, in one process that has to survive."""


@pytest.mark.parametrize("packed", [False, True])
def test_a_matlab_file_is_read_whole_or_its_damage_said(packed):
    columns = {"time_s": TIME[:, None], "voltage_V": VOLTS[None, :]}
    scipy.io.savemat("run.mat", columns, do_compression=packed)
    np.testing.assert_array_equal(driven("run.mat"), VOLTS)
    integers = {"time_s": TIME, "voltage_V": np.arange(ROWS, dtype=np.int16)}
    scipy.io.savemat("run.mat", integers, do_compression=packed)
    found = driven("run.mat", "--outside", "extend")
    np.testing.assert_array_equal(found, np.arange(float(ROWS)))
    columns = {"time_s": TIME[:3], "voltage_V": VOLTS[:3], "gain": np.array([2.0])}
    scipy.io.savemat("run.mat", columns, do_compression=packed)
    line = [sys.executable, "-c", ATTACK]
    ended = subprocess.run(line, capture_output=True, check=False, timeout=300)
    assert ended.returncode == 0, ended.stderr[-500:]
    assert int(ended.stdout) > 100


def cells(*values):
    array = np.empty((1, len(values)), dtype=object)
    array[0, :] = np.array([*values, None], dtype=object)[:-1]
    return array


RUN = {"t": TIME, "u": VOLTS}
RUNS = np.array([(1.0, 2.0), (2.0, 3.0)], dtype=[("t", "O"), ("u", "O")])


@pytest.mark.parametrize(
    "contents",
    [{"run": RUN, "note": 1.0}, {"run": cells(TIME, VOLTS)}, {"run": RUNS}],
)
def test_what_matlab_holds_is_named_with_lines_that_save_it(contents):
    scipy.io.savemat("run.mat", contents)
    error = asked("run.mat")
    assert "run is no array" in error
    assert "save('flat.mat', '-struct', 'NAME')" in error and "writetable" in error


def test_a_cut_tdms_file_is_said():
    """At a chunk a cut leaves rows that look whole."""
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter("run.tdms") as file:
        for start in range(0, ROWS, 10):
            columns = {"time_s": TIME, "voltage_V": VOLTS}
            file.write_segment([
                nptdms.ChannelObject("g", name, values[start : start + 10])
                for name, values in columns.items()
            ])  # fmt: skip
    whole = Path("run.tdms").read_bytes()
    outcome = done("simulate", model("small"), "run.tdms", "--verbose")
    assert len(table(outcome)["voltage_V"]) == ROWS and "cut" not in outcome.err
    for lost in (1, 80, 160):
        Path("cut.tdms").write_bytes(whole[:-lost])
        outcome = dbo("simulate", model("small"), "cut.tdms", "--verbose")
        assert "cut" in outcome.err and outcome.code in (0, 1)


def test_what_a_library_logs_is_no_line_of_the_program():
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter("run.tdms") as file:
        time = nptdms.ChannelObject("g", "time_s", TIME)
        volts = nptdms.ChannelObject("g", "voltage_V", VOLTS, {"unit_string": "V"})
        file.write_segment([time, volts])
    damaged = Path("run.tdms").read_bytes().replace(b"unit_string", b"unit\xcdstring")
    Path("run.tdms").write_bytes(damaged)
    ended = process("simulate", model("small"), "run.tdms", "-o", "out.csv")
    assert ended.returncode == 0
    assert all(said.startswith(b"dbo: ") for said in ended.stderr.splitlines())


def test_the_first_line_tells_each_unit_and_whether_it_is_assumed():
    text("run.csv", "time_s,voltage\n", "{:.4f},{:.4f}", TIME, VOLTS)
    assert "; voltage (V assumed)" in done("simulate", model("small"), "run.csv").err
    scaled = done("simulate", model("small"), "run.csv", "--scale", "input=2V/mV")
    assert "assumed" not in scaled.err
    with h5py.File("run.h5", "w") as file:
        file["time"], file["drive"] = TIME, 1000.0 * VOLTS
        file["time"].attrs["units"], file["drive"].attrs["units"] = "s", "mV"
    assert "; drive (mV)" in done("simulate", model("small"), "run.h5").err


def test_a_rate_without_an_end_is_no_rate():
    for statement in ("Sample Interval,1e308,s", "Sample Rate,1e-308,Hz"):
        text("run.csv", f"{statement}\nvoltage_V\n", "{:.4f}", VOLTS)
        outcome = dbo("simulate", model("small"), "run.csv")
        assert "inf" not in outcome.out and "time_s" not in outcome.out


def test_columns_of_one_short_name_are_named_by_their_paths():
    kind = [("t", "f8"), ("values", "f8")]
    with h5py.File("run.h5", "w") as file:
        for name, values in (("sensor", VOLTS / 10.0), ("drive", VOLTS)):
            rows = list(zip(TIME, values, strict=True))
            file[f"data/{name}"] = np.array(rows, dtype=kind)
    error = asked("run.h5")
    assert "'drive/t'" in error and "'sensor/t'" in error
    error = asked("run.h5", "--time", "drive/t")
    assert "drive/values" in error and "sensor/values" in error
    words = ("--time", "drive/t", "--input")
    np.testing.assert_array_equal(driven("run.h5", *words, "drive/values"), VOLTS)
