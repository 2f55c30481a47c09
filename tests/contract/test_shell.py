"""The shell around the commands: help, exit codes, one-line errors, what is said and what is not."""

import os
import subprocess
import sys
import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest

from dbo_cli import __version__

from .conftest import creep_log
from .program import (
    LOG, PAIR, QUICK, SAMPLES, dbo, done, listing, model, refused, simulated, table, write,
)  # fmt: skip

OPTIONS = {
    "excite": "--v-min --v-max --max-slew --sample-rate --duration --rest --sweep-to --sweep-amplitude",
    "identify": "--validate --prior --sign --skip --zero --sensor-delay --gears --points --relaxation "
    "--delay --dynamics --slopes --method --force --summary --time --voltage --displacement",
    "show": "--format --figures",
    "invert": "",
    "simulate": "--input --time --state --save-state --outside",
    "compensate": "--v-min --v-max --max-slew --extrapolate --on-limit --from --approach --condition --lead "
    "--return --bandwidth --periodic --passes --tracked --history --absolute --state --save-state --summary "
    "--displacement --time",
    "check": "--v-min --v-max --max-slew --from --loop --gain --against --tolerance --voltage --time",
    "report": "--desired --measured --trajectory --match --model --lag --rows --remove-offset --max-rmse "
    "--max-nrmse-percent --expected --format --figures",
    "export": "--name --arithmetic --sample-rate --gears --lookup --v-min --v-max --max-slew",
    "compare": "--validate --format",
    "trajectory": "--rate --range --frequency --lines --steps --dwell --duration --loop --bandwidth --model",
    "waveform": "--to --gain --rate --points --codes --volts --max-rounding",
}
"""The commands of a day and the options that 1.0 promises (DESIGN, section 2)."""

EVERY = "--output --quiet --verbose --debug"
READING = (
    "--time-unit --sample-rate --scale --rows --skip-bad --resample --delimiter --decimal --skip-lines "
    "--encoding --clock-offset"
)
READERS = "identify simulate compensate check report compare waveform".split()
WITHDRAWN = (
    "--flush --settle --sensor-lag --uncertainty --scale-uncertainty --max-current --capacitance --max-abs "
    "--segment --header --jobs -j --keep-going --drive-lag --block-rows --comment --header-lines"
)


# --- help ---


def test_version_and_help_name_every_command_and_exit_code():
    assert done("--version").out == f"dbo {__version__}\n"
    page = done("--help").out
    listed = re.findall(r"^  ([a-z]+)  +\S", page, re.MULTILINE)
    assert [name for name in listed if name in OPTIONS] == list(OPTIONS)
    assert done("-h").out == page
    words = " ".join(page.split())
    codes = "0 done", "1 input", "2 wrong command line", "3 outside", "130 interr"
    for code in codes:
        assert code in words


@pytest.mark.parametrize("command", OPTIONS)
def test_help(command):
    """One screen by ``-h``; every option that is promised, and none withdrawn, by ``--help-all``."""
    page = done(command, "-h").out
    lines = page.splitlines()
    assert len(lines) <= 52 and max(map(len, lines)) <= 100
    assert page.startswith(f"Usage: dbo {command} ")
    promised = f"{OPTIONS[command]} {EVERY}"
    if command in READERS:
        promised += f" {READING}"
    page = done(command, "--help-all").out
    named = set(re.findall(r"(?<![\w-])--?[a-z][a-z-]*", page))
    assert not set(promised.split()) - named
    assert not set(WITHDRAWN.split()) & named


# --- wrong command lines ---

WRONG = {
    "identfy a.csv": "identify",
    "--loud": "--loud",
    "identify": "LOG",
    "simulate model.json": "LOG",
    "invert a.json b.json": "b.json",
    "identify a.csv --gears": "--gears",
    "identify a.csv --gears many": "--gears",
    "identify a.csv --gears 0": "--gears",
    "identify a.csv --points -1": "--points",
    "identify a.csv --relaxation 1,x": "--relaxation",
    "identify a.csv --relaxation 1,0": "--relaxation",
    "identify a.csv --delay -1": "--delay",
    "identify a.csv --dynamics 3": "--dynamics",
    "identify a.csv --skip soon": "--skip",
    "identify a.csv --skip nan": "--skip",
    "identify a.csv --method best": "--method",  # a Literal, as others are
    "identify a.csv --zero here": "--zero",
    "identify a.csv --sample-rate 0": "--sample-rate",
    "identify a.csv --scale voltage": "--scale",
    "identify a.csv --scale voltage=0": "--scale",
    "identify a.csv --scale voltage=1um": "--scale",
    "identify a.csv --scale time=2": "--scale",
    "identify a.csv --time-unit furlongs": "--time-unit",
    "identify a.csv --resample -1": "--resample",
    "identify a.csv --rows 9:3": "--rows",
    "identify a.csv --samplerate 5": "--sample-rate",
    "compensate m.json a.csv --max-slew fast": "--max-slew",
    "compensate m.json a.csv --history h.json": "--tracked",
    "compensate m.json a.csv --extrapolate": "--extrapolate",
    "compensate m.json a.csv --from 0 --approach 0": "--approach",
    "compensate m.json a.csv --from 0 --approach inf": "--approach",
    "compensate m.json a.csv --from 0 --approach soon": "--approach",
    "compensate m.json a.csv --approach auto": "--from",
    "compensate m.json a.csv --condition --state empty": "--condition",
    "compensate m.json a.csv --passes 1": "--periodic",
    "compensate m.json a.csv --periodic --passes -1": "--passes",
    "compensate m.json a.csv --periodic --condition": "--condition",
    "compensate m.json a.csv --periodic --return 0": "--return",
    "compensate m.json a.csv --periodic --lead 1": "--lead",
    "compensate m.json a.csv --uncertainty 1": "--uncertainty",
    "report r.csv --max-rmse x": "--max-rmse",
    "excite": "--v-max",
    "excite --v-max 0": "--v-max",
    "excite --v-max 100 --sample-rate 0": "--sample-rate",
    "excite --v-max 100 --duration 1": "--duration",
    "excite --v-max 100 --duration nan": "--duration",
    "excite --v-max 100 --duration 1e9": "--duration",
    "excite --v-max 100 --rest -1": "--rest",
    "excite --v-max 100 --max-slew -5": "--max-slew",
    "excite --v-max 100 --sweep-to 500": "--sweep-to",
    "excite --v-max 100 --sweep-to 50 --sweep-amplitude 60": "--sweep-amplitude",
    "excite --v-max 100 --sweep-amplitude 1": "--sweep-amplitude",
    "trajectory circle --rate 1 --range 0:1": "circle",
    "trajectory sine --rate 0 --range 0:1 --frequency 1": "--rate",
    "trajectory sine --rate 100 --range 1:0 --frequency 1": "--range",
    "trajectory sine --rate 1000 --range 2:8": "--frequency",
    "trajectory sine --rate 1000 --range 2:8 --frequency -5": "--frequency",
    "trajectory sine --rate 1000 --range 2:8 --frequency 5 --lines 3": "--lines",
    "trajectory raster --rate 1000 --range 2:8 --frequency 5": "--lines",
    "trajectory spiral --rate 1000 --range 2:8 --frequency 5 --duration 1 --loop": "--loop",
    "trajectory sine --rate 1000 --range 2:8 --frequency 300": "give 250",
    "trajectory sine --rate 1000 --range 2:8 --frequency 50 --bandwidth 40": "give 37.03",
    "trajectory triangle --rate 1000 --range 2:8 --frequency 30 --bandwidth 40": "give 19.23",
    "trajectory raster --rate 1000 --range 2:8 --frequency 39 --lines 4 --bandwidth 39.8": "give 35.71",
    "waveform d.csv --to mp3": "--to",
    "waveform d.csv --to npy --codes 0:255": "--codes",
    "waveform d.csv --to pi-gcs --volts 0:5": "--volts",
    "waveform d.csv --to uint16": "--volts",
    "waveform d.csv --to int16 --volts 0:100 --codes 0:65535": "--codes",
    "waveform d.csv --to uint16 --volts 0:100 --codes 0:0.5": "--codes",
    "waveform d.csv --to wav --volts 5:0": "--volts",
    "waveform d.csv --to npy --gain 0": "--gain",
    "waveform d.csv --to npy --points 1": "--points",
    "waveform d.csv --to npy --points 100 --rate 10": "--points",
    "waveform d.csv --to npy --rate -1000": "--rate",
    "waveform d.csv --to wav --rate 1000.5": "--rate",
}


def test_wrong_command_lines():
    """Exit code 2, one line that names the option, and nothing written."""
    time = np.arange(60) / 100.0
    swing = 5.0 + 5.0 * np.sin(40.0 * time)
    write("a.csv", LOG, time, swing, swing**2)
    write("r.csv", PAIR, time, swing, swing)
    shutil.copy(model("small"), "m.json")
    Path("d.csv").write_text("time_s,voltage_V\n0,0\n1,1\n2,0\n")
    for line, held in WRONG.items():
        assert held in refused(2, *line.split()), line
    for line in ("--lag 1e9", "--lag soon", "--lag 0.5"):
        assert "--lag" in refused(2, "report", "r.csv", *line.split())
    assert "--gain" in refused(2, "check", "d.csv", "--gain", "much")


@pytest.mark.parametrize(
    ("line", "code", "held"),
    [
        ("simulate missing.json drive.csv", 1, "missing.json"),
        ("simulate m.json missing.csv", 1, "missing.csv"),
        ("simulate m.json drive.csv -o no/where.csv", 1, "no/where.csv"),
        ("simulate m.json drive.csv --input 7", 1, "drive.csv 7"),
        ("simulate drive.csv m.json", 1, "drive.csv"),
        ("compensate inverse.json wish.csv -o x.csv", 1, "inverse.json inver"),
        ("compensate m.json wish.csv --v-min 5 --v-max 5 -o x.csv", 2, "--v-m"),
        ("compensate m.json wish.csv -o o --summary o", 1, "o"),
        ("simulate m.json drive.csv -o out.xlsx", 2, "out.xlsx"),
        ("simulate m.json drive.csv -o out.parquet", 2, "out.parquet"),
        ("check drive.csv --v-max 9 -o x.txt", 3, "drive.csv 9"),
    ],
)
def test_exit_codes(line, code, held, drive, wish):
    shutil.copy(model("small"), "m.json")
    done("invert", "m.json", "-o", "inverse.json")
    outcome = dbo(*line.split())
    assert outcome.code == code, outcome.err
    for word in held.split():
        assert word in outcome.lines[-1]
    assert len(outcome.lines[-1]) < 300
    left = {"m.json", "inverse.json", "drive.csv", "wish.csv", "x.txt"}
    assert {Path(name).name for name in listing()} <= left


def test_debug_shows_where_before_the_line():
    outcome = dbo("invert", "missing.json", "--debug")
    assert outcome.code == 1
    assert outcome.err.startswith("Traceback ")
    assert outcome.lines[-1].startswith("dbo: error: missing.json: ")


# --- three lines ---

DAY = {
    "identify": "identify log.csv -o model.json --relaxation 0 --gears 20 --points 0 --delay 0 --force",
    "simulate": "simulate small.json drive.csv -o out.csv",
    "compensate": "compensate small.json wish.csv -o out.csv --summary summary.json",
    "check": "check drive.csv --v-min 0 --v-max 10 -o out.txt",
    "report": "report pair.csv -o report.json",
    "excite": "excite --v-max 100 -o out.csv",
    "invert": "invert small.json -o inverse.json",
    "show": "show small.json",
    "trajectory": "trajectory sine --rate 1000 --range 2:8 --frequency 5 --model small.json -o out.csv",
    "waveform": "waveform drive.csv --to npy -o out.npy",
    "export": "export small.json --sample-rate 1000 -o firmware",
}


@pytest.mark.parametrize("command", DAY)
def test_a_command_says_three_lines_or_none_and_writes_the_same(
    drive, wish, log, command
):
    """At most three lines; none with ``-q``, and the same bytes again."""
    shutil.copy(model("small"), "small.json")
    time = np.arange(200) / 100.0
    wanted = 5.0 + np.sin(time)
    write("pair.csv", PAIR, time, wanted, wanted + 0.01)
    words = shlex.split(DAY[command])
    loud = done(*words)
    assert len(loud.said) <= 3, loud.err
    for line in loud.lines:
        assert line.startswith("dbo: ") and line.isprintable()
        assert len(line) <= 300
    for line in loud.said:
        assert len(line) <= 140
    written = contents()
    quiet = done(*words, "-q")
    assert quiet.err == ""
    assert quiet.raw == loud.raw
    assert contents() == written


def contents():
    """Return every file below the working folder with its bytes."""
    return {name: Path(name).read_bytes() for name in listing()}


def test_verbose_says_more(log):
    words = shlex.split(DAY["identify"])
    few, many = done(*words), done(*words, "--verbose")
    assert set(few.said) <= set(many.said)
    assert len(many.said) > len(few.said)


# --- outputs ---


def test_a_dash_is_stdin_and_stdout(drive):
    from_file = done("simulate", model("small"), drive, "-o", "-")
    from_stdin = done("simulate", model("small"), "-", stdin=drive.read_bytes())
    assert from_file.raw == from_stdin.raw
    for word in ("drive.csv", "500 rows", "voltage"):  # what was read is said first
        assert word in from_file.lines[0]
    inverse = done("invert", "-", stdin=model("small").read_bytes())
    assert inverse.raw == done("invert", model("small")).raw


@pytest.mark.parametrize("suffix", [".csv", ".tsv", ".csv.gz", ".h5", ".txt"])
def test_what_is_written_can_be_read_again(drive, suffix):
    done("simulate", model("small"), drive, "-o", f"first{suffix}")
    again = done("simulate", model("small"), f"first{suffix}")
    assert again.raw == done("simulate", model("small"), drive).raw


def test_sample_data_is_read():
    text = simulated("creep", SAMPLES / "identification.csv")
    other = simulated("creep", SAMPLES / "identification.h5")
    np.testing.assert_allclose(text, other, rtol=0, atol=1e-9)


# --- what identification says ---


def test_each_validation_log_has_its_line(log):
    creep_log("other.csv", seed=2)
    words = ("identify", log, *QUICK, "-o", "model.json", "--validate")
    once = done(*words, "other.csv")
    [line] = [line for line in once.said if "other.csv" in line]
    other = table("other.csv")
    error = other["displacement_um"] - simulated(Path("model.json"), "other.csv")
    assert f"error {np.sqrt(np.mean(error**2)):.3g} um" in line
    assert f"{np.std(error):.3g} without" in line
    assert not [text for text in once.warnings if "other.csv" in text]
    other["displacement_um"] *= 1.3
    write("far.csv", LOG, *other.values())
    shutil.copy(log, "copy.csv")
    for name, held in (("far", "times the stated error"), ("copy", "of the fit")):
        warned = done(*words, f"{name}.csv").warnings
        [warning] = [text for text in warned if f"{name}.csv" in text]
        assert held in warning


def test_the_sign_and_exchanged_columns_are_said(log):
    words = ("-o", "model.json", *QUICK)
    right = done("identify", log, *words)
    assert right.lines[0].endswith("(rising)")
    assert not [text for text in right.warnings if "leads" in text]
    write("bare.csv", "time_s,voltage,displacement", *table(log).values())
    exchanged = ("--voltage", "displacement", "--displacement", "voltage")
    wrong = done("identify", "bare.csv", *exchanged, *words, "--force")
    [warning] = [text for text in wrong.warnings if "leads" in text]
    assert "--voltage" in warning and "--clock-offset" in warning
    time, volts, moved = table(log).values()
    falling = done("identify", write("falling.csv", LOG, time, volts, -moved), *words)
    assert falling.lines[0].endswith("(falling)")


def test_percent_of_range_is_of_what_the_log_moved(log):
    outcome = done("identify", log, *QUICK, "-o", "model.json")
    [line] = [line for line in outcome.said if "% of range" in line]
    expected, percent = re.findall(r"error (\S+) um \((\S+) % of range", line)[0]
    moved = float(np.ptp(table(log)["displacement_um"]))
    # two digits: half a unit of the second is a twentieth at most
    assert float(percent) == pytest.approx(100.0 * float(expected) / moved, rel=0.05)


# --- names ---

EVIL = "a\x1b[31m\x9b1m\u202eb.csv"
SIGNS = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e]")


@pytest.mark.parametrize("name", [EVIL, os.fsdecode(b"b\xff\x1b.csv")])
def test_no_name_of_a_file_reaches_a_terminal_as_it_is(log, name, unpainted):
    try:
        shutil.copy(log, name)
    except OSError:
        pytest.skip("the file system does not take such a name")
    done("identify", name, *QUICK, "-o", "model.json")
    time, volts, wanted = table(log).values()
    pair = name.replace(".csv", "2.csv")
    write(pair, f"{PAIR},voltage_V", time, wanted, wanted + 0.01, volts)
    shutil.copy("model.json", f"{name}.json")
    for words in (
        ("identify", name, *QUICK, "--validate", name, "--verbose"),
        ("show", "model.json"),
        ("show", f"{name}.json", "--format", "json"),
        ("check", name, "--v-max", "200"),
        ("check", name, "--v-max", "200", "--format", "json"),
        ("report", pair, pair),
        ("report", pair, "--format", "json"),
        ("report", pair, "--format", "csv"),
        ("report", pair, "--format", "html"),
        ("report", pair, "--expected", name),
        ("simulate", f"{name}.json", name),
        ("compensate", f"{name}.json", name, "--v-max", "50", "--on-limit", "clip"),
        ("simulate", name, name),
    ):
        outcome = dbo(*words)
        assert "internal error" not in outcome.err and "Traceback" not in outcome.err
        assert not SIGNS.search(outcome.out), (words, outcome.out[:300])
        assert not SIGNS.search(outcome.err), (words, outcome.err)


def test_the_first_page_of_help_is_the_same_for_any_order_of_sets():
    pages = set()
    for seed in range(3):
        environment = {**os.environ, "PYTHONHASHSEED": str(seed)}
        command = [sys.executable, "-m", "dbo_cli", "-h"]
        pages.add(subprocess.run(command, capture_output=True, env=environment).stdout)
    assert len(pages) == 1
