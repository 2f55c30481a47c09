"""The shell around the commands: help, exit codes, one-line errors, what is said and what is not."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from dbo_cli import __version__

from .program import SAMPLES, dbo, done, listing, model, refused, table, write

COMMANDS = (
    "excite identify show invert simulate compensate check report export compare "
    "trajectory waveform"
).split()

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
"""The options that 1.0 promises, by command (DESIGN, section 2)."""

EVERY = "--output --quiet --verbose --debug"
READING = (
    "--time-unit --sample-rate --scale --rows --skip-bad --resample --delimiter --decimal --skip-lines "
    "--encoding --clock-offset"
)
READERS = (
    "identify",
    "simulate",
    "compensate",
    "check",
    "report",
    "compare",
    "waveform",
)

WITHDRAWN = (
    "--flush --settle --sensor-lag --uncertainty --scale-uncertainty --max-current --capacitance --max-abs "
    "--segment --header --jobs -j --keep-going --drive-lag --block-rows --comment --header-lines"
)


def test_version() -> None:
    assert done("--version").out == f"dbo {__version__}\n"


def test_help_names_every_command_in_the_order_of_a_day() -> None:
    page = done("--help").out
    listed = re.findall(r"^  ([a-z]+)  +\S", page, re.MULTILINE)
    assert [name for name in listed if name in COMMANDS] == COMMANDS
    assert done("-h").out == page


@pytest.mark.parametrize("command", COMMANDS)
def test_help(command: str) -> None:
    """One screen by ``-h``; every option that is promised, and none withdrawn, by ``--help-all``."""
    page = done(command, "-h").out
    lines = page.splitlines()
    assert len(lines) <= 52 and max(map(len, lines)) <= 100
    assert page.startswith(f"Usage: dbo {command} ")
    promised = f"{OPTIONS[command]} {EVERY}"
    if command in READERS:
        promised += f" {READING}"
    named = set(
        re.findall(r"(?<![\w-])--?[a-z][a-z-]*", done(command, "--help-all").out)
    )
    assert not set(promised.split()) - named
    assert not set(WITHDRAWN.split()) & named


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
    "identify a.csv --method best": "--method",
    "identify a.csv --zero here": "--zero",
    "identify a.csv --slopes up": "--slopes",
    "identify a.csv --sign up": "--sign",
    "identify a.csv --sample-rate 0": "--sample-rate",
    "identify a.csv --scale voltage": "--scale",
    "identify a.csv --rows 9:3": "--rows",
    "identify a.csv --samplerate 5": "--sample-rate",
    "simulate m.json a.csv --outside wrap": "--outside",
    "compensate m.json a.csv --on-limit stop": "--on-limit",
    "compensate m.json a.csv --max-slew fast": "--max-slew",
    "compensate m.json a.csv --history h.json": "--tracked",
    "compensate m.json a.csv --uncertainty 1": "--uncertainty",
    "report r.csv --lag soon": "--lag",
    "report r.csv --format pdf": "--format",
    "report r.csv --max-rmse x": "--max-rmse",
    "excite": "--v-max",
    "excite --v-max 0": "--v-max",
    "trajectory circle --rate 1 --range 0:1": "circle",
    "trajectory sine --rate 0 --range 0:1 --frequency 1": "--rate",
    "trajectory sine --rate 100 --range 1:0 --frequency 1": "--range",
    "waveform d.csv --to mp3": "--to",
    "export m.json --arithmetic float -o f --sample-rate 9": "--arithmetic",
}


@pytest.mark.parametrize("command", [*COMMANDS, "identfy", "--loud"])
def test_wrong_command_lines(command: str) -> None:
    """Exit code 2, one line that names the option, nothing written."""
    time = np.arange(60) / 100.0
    swing = 5.0 + 5.0 * np.sin(40.0 * time)
    write("a.csv", "time_s,voltage_V,displacement_um", time, swing, swing**2)
    write("r.csv", "time_s,desired_um,measured_um", time, swing, swing)
    Path("m.json").write_text(model("small").read_text())
    Path("d.csv").write_text("time_s,voltage_V\n0,0\n1,1\n2,0\n")
    for line in WRONG:
        if line.split()[0] == command:
            assert WRONG[line] in refused(2, *line.split()), line


@pytest.mark.parametrize(
    ("line", "code", "held"),
    [
        ("simulate missing.json drive.csv", 1, ["missing.json"]),
        ("simulate m.json missing.csv", 1, ["missing.csv"]),
        ("simulate m.json drive.csv -o no/where.csv", 1, ["no/where.csv"]),
        ("simulate m.json drive.csv --input 7", 1, ["drive.csv", "7"]),
        ("compensate inverse.json wish.csv -o x.csv", 1, ["inverse.json", "inver"]),
        ("compensate m.json wish.csv --from 11 -o x.csv", 3, ["11", "--from"]),
        ("compensate m.json wish.csv --v-min 5 --v-max 5 -o x.csv", 2, ["--v-m"]),
        ("check drive.csv --v-max 9 -o x.txt", 3, ["drive.csv", "9"]),
    ],
)
def test_exit_codes(
    line: str, code: int, held: list[str], drive: Path, wish: Path
) -> None:
    Path("m.json").write_text(model("small").read_text())
    done("invert", "m.json", "-o", "inverse.json")
    outcome = dbo(*line.split())
    assert outcome.code == code, outcome.err
    for word in held:
        assert word in outcome.lines[-1]
    assert len(outcome.lines[-1]) < 300


def test_swapped_arguments_are_recognised(drive: Path) -> None:
    Path("model.json").write_text(model("small").read_text())
    outcome = dbo("simulate", drive, "model.json")
    assert outcome.code in (1, 2)
    assert "model.json" in outcome.lines[-1] or "drive.csv" in outcome.lines[-1]


def test_debug_shows_where_before_the_line() -> None:
    outcome = dbo("invert", "missing.json", "--debug")
    assert outcome.code == 1
    assert outcome.err.startswith("Traceback ")
    assert outcome.lines[-1].startswith("dbo: error: missing.json: ")


# --- three lines ---

DAY: dict[str, str] = {
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


@pytest.fixture
def day(drive: Path, wish: Path, log: Path) -> None:
    Path("small.json").write_text(model("small").read_text())
    time = np.arange(200) / 100.0
    wanted = 5.0 + np.sin(time)
    write("pair.csv", "time_s,desired_um,measured_um", time, wanted, wanted + 0.01)


@pytest.mark.parametrize("command", DAY)
def test_a_command_says_three_lines_or_none_and_writes_the_same(
    day: None, command: str
) -> None:
    """At most three lines; none with ``-q``, and the same bytes again."""
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


def contents() -> dict[str, bytes]:
    """Return every file below the working folder with its bytes, command lines of footers aside."""
    skipped = {"summary.json"}  # may name the command line
    return {
        name: Path(name).read_bytes()
        for name in listing()
        if Path(name).name not in skipped
    }


def test_verbose_says_more(day: None) -> None:
    few = done(*shlex.split(DAY["identify"]))
    many = done(*shlex.split(DAY["identify"]), "--verbose")
    assert set(few.said) <= set(many.said)
    assert len(many.said) > len(few.said)


def test_what_was_read_is_said_first(drive: Path) -> None:
    first = done("simulate", model("small"), drive, "-o", "out.csv").lines[0]
    for word in ("drive.csv", "500 rows", "voltage"):
        assert word in first


def test_a_dash_is_stdin_and_stdout(drive: Path) -> None:
    from_file = done("simulate", model("small"), drive, "-o", "-")
    from_stdin = done("simulate", model("small"), "-", stdin=drive.read_bytes())
    assert from_file.raw == from_stdin.raw
    inverse = done("invert", "-", stdin=model("small").read_bytes())
    assert inverse.raw == done("invert", model("small")).raw


def test_an_output_replaces_what_was_there_or_leaves_it(drive: Path) -> None:
    Path("out.csv").write_text("old\n")
    good = drive.read_text()
    drive.write_text(good + "0.5,broken\n")
    refused(1, "simulate", model("small"), drive, "-o", "out.csv")
    assert Path("out.csv").read_text() == "old\n"
    drive.write_text(good)
    done("simulate", model("small"), drive, "-o", "out.csv")
    assert len(table("out.csv")["time_s"]) == 500


def test_the_same_output_twice_is_refused(wish: Path) -> None:
    outcome = dbo("compensate", model("small"), wish, "-o", "o", "--summary", "o")
    assert outcome.code in (1, 2)
    assert set(listing()) == {"wish.csv"}


@pytest.mark.parametrize("suffix", [".csv", ".tsv", ".csv.gz", ".h5", ".txt"])
def test_what_is_written_can_be_read_again(drive: Path, suffix: str) -> None:
    done("simulate", model("small"), drive, "-o", f"first{suffix}")
    again = done("simulate", model("small"), f"first{suffix}")
    assert again.raw == done("simulate", model("small"), drive).raw


@pytest.mark.parametrize("name", ["out.xlsx", "out.parquet", "out.mat"])
def test_a_form_that_is_not_written_is_refused(drive: Path, name: str) -> None:
    outcome = dbo("simulate", model("small"), drive, "-o", name)
    assert outcome.code in (1, 2)
    assert name in outcome.lines[-1]
    assert not Path(name).exists()


def test_sample_data_is_read() -> None:
    text = done("simulate", model("creep"), SAMPLES / "identification.csv")
    other = done("simulate", model("creep"), SAMPLES / "identification.h5")
    found, stored = table(text), table(other)
    np.testing.assert_allclose(
        found["displacement_um"], stored["displacement_um"], rtol=0, atol=1e-9
    )
