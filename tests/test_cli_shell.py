# ruff: noqa: E501  (a message of one line stands on one line here)
"""The shell around the commands: exit codes, one-line errors, help, and processes that end early."""

from __future__ import annotations

import io
import json
import os
import re
import shlex
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from dbo_cli import __version__
from dbo_cli.cli import app, commands
from dbo_cli.cli.commands import Reporter
from dbo_cli.cli.typer_adapter import root_command
from dbo_cli.errors import (
    FitError,
    InputError,
    LimitError,
    ModelError,
    OutputError,
    UsageError,
)
from dbo_cli.hysteresis.identification import IdentificationOptions
from dbo_cli.logs.request import ReadingOptions, parse_address
from dbo_cli.runs.identifying import IdentifyRun

COMMANDS = commands.every()
ROOT = Path(__file__).resolve().parent.parent
LIST = "identify, show, invert, simulate, compensate, check, report, excite, export, compare, fringes, trajectory, waveform"


def test_version(dbo: Any) -> None:
    assert dbo("--version") == (0, f"dbo {__version__}\n", "")


def test_module_and_console_script_are_the_same_program() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "dbo_cli", "--version"],
        capture_output=True,
        text=True,
        cwd=ROOT,
    )
    assert (done.returncode, done.stdout, done.stderr) == (
        0,
        f"dbo {__version__}\n",
        "",
    )


WRONG = {
    "identfy a.csv": f"no such command: 'identfy': dbo identify?; there are: {LIST}",
    "fit a.csv": f"no such command: 'fit': dbo identify?; there are: {LIST}",
    "--loud": "no such option: --loud (dbo --help lists what there is)",
    "identify": "LOG is missing (dbo identify --help lists what there is)",
    "simulate model.json": "LOG is missing (dbo simulate --help lists what there is)",
    "invert a.json b.json": "got unexpected extra argument(s) (b.json) (dbo invert --help lists what there is)",
    "identify a.csv --gears": "option '--gears' requires an argument (dbo identify --help lists what there is)",
    "identify a.csv --gears many": "--gears: not a whole number: 'many'",
    "identify a.csv --gears 0": "--gears: must be at least 1, not 0",
    "identify a.csv --points -1": "--points: must be at least 0, not -1",
    "identify a.csv --relaxation 1,x": "--relaxation: not a number: 'x'",
    "identify a.csv --relaxation 1,0": "--relaxation: time constants must differ and be above 0: '1,0'",
    "identify a.csv --delay -1": "--delay: must not be below 0, not -1",
    "identify a.csv --skip soon": "--skip: not a number: 'soon'",
    "identify a.csv --skip nan": "--skip: not a number: 'nan'",
    "identify a.csv --method best": "--method: 'best' is none of least-squares, paper",
    "identify a.csv --zero here": "--zero: 'here' is none of none, mean, first and not a number",
    "identify a.csv --slopes up": "--slopes: 'up' is none of auto, growing, falling, free",
    "identify a.csv --sample-rate 0": "--sample-rate: must be above 0, not 0",
    "identify a.csv --format xls": "--format: 'xls' is none of csv, tsv, hdf5",
    "identify a.csv --header-lines 3": "--header-lines: '3' is none of 0, 1, 2",
    "identify a.csv --block-rows 0": "--block-rows: must be at least 1, not 0",
    "simulate m.json a.csv --outside wrap": "--outside: 'wrap' is none of extend, hold, error",
    "compensate m.json a.csv --on-limit stop": "--on-limit: 'stop' is none of auto, clip, error",
    "compensate m.json a.csv --v-min 5 --v-max 5": "--v-min 5 must be below --v-max 5",
    "compensate m.json a.csv --max-slew 0": "--max-slew: must be above 0, not 0",
    "report a.csv --lag soon": "--lag soon: neither a whole number of samples nor 'auto'",
    "report a.csv --segment long": "--segment long: neither 'cycles' nor a number of seconds above 0",
    "report a.csv --format pdf": "--format: 'pdf' is none of text, json, csv, html",
    "report a.csv --max-rmse x": "--max-rmse: not a number: 'x'",
    "excite": "--v-max is missing (dbo excite --help lists what there is)",
    "excite --v-max 0": "--v-min 0V must be below --v-max 0V",
}


@pytest.mark.whole
@pytest.mark.parametrize("line", WRONG)
def test_wrong_command_lines(dbo: Any, line: str, tmp_path: Path) -> None:
    """Refused with exit code 2 and one line, before any file is looked for."""
    assert dbo(*line.split()) == (2, "", f"dbo: error: {WRONG[line]}\n")
    assert not list(tmp_path.iterdir())


OUTCOMES = [
    (InputError("run.csv:7: odd"), 1, "error: run.csv:7: odd"),
    (ModelError("m.json: odd"), 1, "error: m.json: odd"),
    (FitError("no turn"), 1, "error: no turn"),
    (OutputError("full"), 1, "error: full"),
    (UsageError("--x"), 2, "error: --x"),
    (LimitError("too far"), 3, "error: too far"),
    (
        FileNotFoundError(2, "No such file or directory", "a.csv"),
        1,
        "error: a.csv: No such file or directory",
    ),
    (MemoryError(), 1, "error: out of memory (--rows A:B takes a part of a log)"),
    (
        ZeroDivisionError("division by zero"),
        1,
        "error: internal error: ZeroDivisionError: division by zero (--debug shows where; please report it)",
    ),
    (KeyboardInterrupt(), 130, "interrupted"),
]


@pytest.mark.parametrize(
    ("problem", "code", "text"), OUTCOMES, ids=lambda value: type(value).__name__
)
def test_every_exception_has_one_line_and_a_code(
    dbo: Any,
    monkeypatch: pytest.MonkeyPatch,
    problem: BaseException,
    code: int,
    text: str,
) -> None:
    def fail(words: list[str]) -> int:
        raise problem

    monkeypatch.setattr(app, "_dispatch", fail)
    assert dbo("identify", "a.csv") == (code, "", f"dbo: {text}\n")


def test_debug_shows_the_traceback_and_then_the_line(dbo: Any) -> None:
    done = dbo("simulate", "missing.json", "a.csv", "--debug")
    assert done.code == 1
    assert done.err.startswith("Traceback (most recent call last):\n")
    assert done.err.splitlines()[-1].startswith("dbo: error: missing.json: ")


def test_a_message_is_one_line_whatever_it_holds(
    dbo: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(words: list[str]) -> int:
        raise InputError("two\nlines\tand tabs")

    monkeypatch.setattr(app, "_dispatch", fail)
    assert dbo().err == "dbo: error: two lines and tabs\n"


# --- README and --help hold together ---


def help_of(dbo: Any, name: str) -> str:
    done = dbo("help", name)
    assert (done.code, done.err) == (0, "")
    text: str = done.out
    return text


def test_root_help_names_every_command(dbo: Any) -> None:
    done = dbo("--help")
    assert (done.code, done.err) == (0, "")
    assert re.findall(
        r"^  (\w+)  +\S", done.out[done.out.index("Commands:") :], re.MULTILINE
    ) == list(COMMANDS)


@pytest.mark.whole
def test_readme_points_to_the_help_of_every_command() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    place = " ".join(text[text.index("`dbo help COMMAND`") :].split())
    named = re.findall(r"`(\w+)`", place[: place.index("--show-completion")])
    assert named == [*COMMANDS]


@pytest.mark.whole
def test_every_option_that_the_readme_uses_exists(dbo: Any) -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8").replace("\\", "/")
    used = re.findall(r"\bdbo ({})\b([^\n`|]*)".format("|".join(COMMANDS)), text)
    assert len(used) > 10
    for name, rest in used:
        page = help_of(dbo, name)
        for option in re.findall(r"(?<!\S)--?[a-z][a-z-]*", rest.partition("#")[0]):
            assert re.search(rf"(?<![\w-]){option}(?![\w-])", page), (
                f"dbo {name} {option}"
            )


PROMISED = {
    "identify": "--gears --points --relaxation --delay --skip --validate --method --zero --slopes --force "
    "--time --voltage --displacement --sample-rate --rows --skip-bad --format",
    "show": "--format --figures",
    "invert": "--output",
    "simulate": "--input --state --save-state --outside --time --sample-rate --rows --flush --resample",
    "compensate": "--displacement --v-min --v-max --on-limit --max-slew --max-current --capacitance --from "
    "--approach --condition --lead --return --periodic --passes --tracked --state --save-state --summary",
    "check": "--v-min --v-max --max-slew --from --loop --against --tolerance --format --voltage",
    "report": "--desired --measured --lag --remove-offset --model --figures --max-rmse --max-abs "
    "--max-nrmse-percent --segment --rows --format",
    "excite": "--v-min --v-max --sample-rate --duration --frequency",
    "compare": "--models --validate --skip --format --figures --save-models --no-timings --voltage --displacement",
    "export": "--name --direction --arithmetic --sample-rate --gears --v-min --v-max --max-slew --lookup "
    "--arduino --fmu --shared --overwrite",
    "fringes": "--voltage --signal --quadrature --wavelength --per-fringe --sign --scale-uncertainty --figures "
    "--time --rows --summary --header",
    "trajectory": "--rate --range --slow-range --frequency --lines --pixels --overscan --one-way --turns --cycles --steps "
    "--dwell --rest --loop --bandwidth --model --unit",
    "waveform": "--to --gain --points --rate --codes --volts --loop --v-min --v-max --max-slew --tolerance --voltage",
}


@pytest.mark.whole
@pytest.mark.parametrize("name", COMMANDS)
def test_promised_options_are_there_and_explained(dbo: Any, name: str) -> None:
    page = help_of(dbo, name)
    for option in [
        *PROMISED[name].split(),
        "-o",
        "--output",
        "--quiet",
        "--verbose",
        "--debug",
        "--help",
    ]:
        assert re.search(
            rf"^  (-\w, )?{option}\b.*(  \w|\n {{10,}}\w)|^  {option}, ",
            page,
            re.MULTILINE,
        ), option


@pytest.mark.parametrize("name", COMMANDS)
def test_help_fits_a_terminal_and_holds_no_escapes(dbo: Any, name: str) -> None:
    page = help_of(dbo, name)
    assert max(map(len, page.splitlines())) <= 100
    assert "\x1b" not in page


@pytest.mark.whole
@pytest.mark.parametrize("name", COMMANDS)
def test_the_short_help_fits_a_screen_and_points_to_the_rest(
    dbo: Any, name: str
) -> None:
    short, whole = dbo(name, "-h"), dbo(name, "--help-all")
    assert short == dbo(name, "--help")
    assert whole == dbo("help", name)
    assert (short.code, short.err, whole.code, whole.err) == (0, "", 0, "")
    assert len(short.out.splitlines()) <= 40
    assert len(short.out) < len(whole.out)
    command = COMMANDS[name]
    usual = re.findall(
        r"^  (?:-\w, )?(--[a-z-]+)",
        short.out[short.out.index("Usual options:") :],
        re.MULTILINE,
    )
    assert usual == [
        "--output" if option == "-o" else option for option in command.usual
    ]
    number = sum(1 for option in (*command.options, *command.brought) if option.names)
    assert f"dbo help {name} (or --help-all) has all {number} options" in " ".join(
        short.out.split()
    )
    assert ("dbo help reading" in short.out) == ("\nReading logs:\n" in whole.out)


def test_the_options_of_reading_have_a_page_of_their_own(dbo: Any) -> None:
    done = dbo("help", "reading")
    assert (done.code, done.err) == (0, "")
    whole = help_of(dbo, "identify")
    listed = re.findall(r"^  (--[a-z-]+)", done.out, re.MULTILINE)
    in_identify = whole[
        whole.index("Reading logs:") : whole.index("Output and messages:")
    ]
    assert sorted(listed) == sorted(
        re.findall(r"^  (--[a-z-]+)", in_identify, re.MULTILINE)
    )


@pytest.mark.parametrize(
    ("word", "meant"),
    [("fit", "dbo identify"), ("Plot", "dbo report --figures"), ("version", "dbo --version"), ("run", "dbo simulate"),
     ("reprot", "dbo report")],
)  # fmt: skip
def test_words_that_people_try_are_answered_with_the_command(
    dbo: Any, word: str, meant: str
) -> None:
    assert f"no such command: '{word}': {meant}?; there are: identify," in dbo(word).err


def test_a_name_with_a_blank_that_was_not_quoted_is_recognised(
    dbo: Any, tmp_path: Path
) -> None:
    (tmp_path / "my log.csv").write_text("time_s,voltage_V\n", encoding="utf-8")
    done = dbo(
        "identify", *f"{tmp_path}/my log.csv".split(" "), "-o", tmp_path / "model.json"
    )
    assert done.code == 1
    assert done.err.endswith(
        f"(is '{tmp_path}/my log.csv' meant? A name with a blank needs quotation marks)\n"
    )


def test_the_bare_program_shows_its_help(dbo: Any) -> None:
    done = dbo()
    assert (done.code, done.err) == (0, "")
    assert done.out.startswith("Usage: dbo ")
    assert all(f"  {name} " in done.out for name in COMMANDS)


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_scripts_are_printed(shell: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "dbo_cli", "--show-completion", shell],
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert f"_DBO_COMPLETE=complete_{shell}" in done.stdout


@pytest.mark.whole
@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("dbo identify --ge", "--gears"),
        ("dbo simulate --header ", "plain comment"),
        ("dbo simulate model.json log.csv --header c", "comment"),
        ("dbo identify log.csv other.csv --time ", "time_s Drive Pos where"),
        ("dbo identify log.csv other.csv --displacement w", "where"),
        ("dbo identify missing.csv model.json --voltage ", ""),
        ("dbo identify 'log.csv --voltage ", ""),
        ("dbo help co", "compensate compare"),
        ("dbo waveform drive.csv --to p", "pi-gcs picoscope"),
        ("dbo trajectory s", "spiral staircase sine"),
    ],
)
def test_a_shell_is_told_what_could_be_typed(
    typed: str, offered: str, tmp_path: Path, model_file: Path
) -> None:
    (tmp_path / "log.csv").write_text(
        "time_s,Drive (V),Pos (um),a b (V)\n0,1,2,3\n1,2,3,4\n"
    )
    (tmp_path / "other.csv").write_text("time_s,Drive (V),where\n0,1,2\n1,2,3\n")
    asked = os.environ | {
        "_DBO_COMPLETE": "complete_bash",
        "COMP_WORDS": typed,
        "COMP_CWORD": str(len(typed.split(" ")) - 1),
    }
    done = subprocess.run(
        [sys.executable, "-m", "dbo_cli"],
        capture_output=True,
        text=True,
        env=asked,
        cwd=tmp_path,
    )
    assert (done.returncode, done.stdout.split(), done.stderr) == (
        0,
        offered.split(),
        "",
    )


def test_swapped_arguments_are_recognised(dbo: Any, model_file: Path) -> None:
    Path("drive.csv").write_text("voltage_V\n0\n")
    for command in ("simulate", "compensate"):
        assert dbo(command, "drive.csv", "model.json") == (
            2, "", "dbo: error: model.json is a model: the model comes first, then the log (model.json drive.csv)\n"
        )  # fmt: skip


def test_show_tells_on_which_side_of_the_gears_the_points_stand(
    dbo: Any, tmp_path: Path
) -> None:
    quantity = {"unit": "V", "min": 0.0, "max": 1.0}
    gears = {
        "type": "backlash",
        "x0": 0.0,
        "y0": 0.0,
        "dx": [0.5, 0.5],
        "dy": [0.4, 0.6],
    }
    points = [
        {
            "type": "point",
            "x0": 0.0,
            "y0": 0.0,
            "dx": [1.0 / m] * m,
            "dy": [1.0 / m] * m,
        }
        for m in (3, 2)
    ]
    model = {
        "format": "dbo-model",
        "version": 1,
        "direction": "forward",
        "input": {"quantity": "voltage", **quantity},
        "output": {"quantity": "displacement", **quantity},
        "stages": [points[0], gears, points[1]],
    }
    (tmp_path / "model.json").write_text(json.dumps(model))
    assert dbo("invert", "model.json", "-o", "inverse.json").code == 0
    for name in ("model.json", "inverse.json"):
        told = " ".join(dbo("show", name).out.split())
        assert (
            "2 gears, bent by 3 straight pieces on the drive's side and 2 on the displacement's"
            in told
        )


@pytest.mark.whole
def test_show_tells_what_is_in_a_model(dbo: Any) -> None:
    old = Path(__file__).parent / "old_files" / "model-v1.json"
    done = dbo("show", old)
    assert (done.code, done.err) == (0, "")
    lines = done.out.splitlines()
    assert (
        lines[0]
        == "forward model: voltage 0 to 100 V to displacement 0.798299 to 12.6191 um"
    )
    assert lines[1] == "displacement rises as voltage rises"
    assert lines[2].startswith(
        "40 gears, bent by a curve of 8 straight pieces; lag and creep with time constants of "
    )
    assert any(line.startswith("fit: RMSE 0.0") and "um" in line for line in lines)
    assert any(
        line.startswith("from identification.csv (5,786 rows), by dbo 0.1.0")
        for line in lines
    )
    told = json.loads(dbo("show", old, "--format", "json", "--figures", "curves").out)
    assert (told["gears"], told["output"]["unit"], told["delay_seconds"]) == (
        40,
        "um",
        pytest.approx(0.001),
    )
    assert {path.suffix for path in Path("curves").iterdir()} == {".png", ".svg"}


class Terminal(io.StringIO):
    """Standard error as a person sees it."""

    def isatty(self) -> bool:
        return True


def test_a_fit_counts_its_seconds_on_a_terminal(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setattr(Reporter, "PATIENCE", 0.001)
    progress = Reporter()
    progress.working("fitting 5 rows")
    # the thread comes to it sooner or later
    while "fitting 5 rows" not in screen.getvalue():
        time.sleep(0.001)
    progress.finished()
    said = screen.getvalue()
    assert said.startswith("\r\x1b[Kdbo: fitting 5 rows, 0 s") and said.endswith(
        "\r\x1b[K"
    )
    quiet = Reporter(quiet=True)
    quiet.working("fitting")
    quiet.finished()
    assert screen.getvalue() == said


def test_identify_tells_a_listener_of_its_rows_and_its_fit(tmp_path: Path) -> None:
    class Ear:
        def __init__(self) -> None:
            self.heard: list[object] = []

        def __getattr__(self, name: str) -> Any:
            return lambda *words: self.heard.append((name, *words))

    ear: Any = Ear()
    asked = IdentificationOptions(gears=8, points=0, relaxation=(), delay=0.0)
    log, output = map(
        parse_address,
        (ROOT / "sample_data" / "identification.csv", tmp_path / "m.json"),
    )
    IdentifyRun([log], [], ReadingOptions(block_rows=4000), asked).run(output, ear)
    assert [one for one in ear.heard if one[0] != "opened"] == [
        ("progressed", 4000, "read"), ("progressed", 1786, "read"), ("working", "fitting 5,786 rows"), ("finished",),
    ]  # fmt: skip


@pytest.mark.whole
@pytest.mark.parametrize("command", COMMANDS)
def test_every_help_says_what_is_written_and_has_two_examples_that_parse(
    dbo: Any, command: str
) -> None:
    page = help_of(dbo, command)
    assert len(COMMANDS[command].examples) == 2
    for part in (
        "\nWrites:\n  ",
        "\nExamples:\n  ",
        "\nExit codes:\n  0  ",
        *(line for _, line in COMMANDS[command].examples),
    ):
        assert part in page
    for _, line in COMMANDS[command].examples:
        words = next(
            one
            for one in map(shlex.split, line.split(" | "))
            if one[:2] == ["dbo", command]
        )
        root = root_command().make_context("dbo", [], resilient_parsing=True)
        root_command().get_command(root, command).make_context(
            command, words[2:], parent=root
        )


@pytest.mark.whole
def test_help_is_a_word_too(dbo: Any) -> None:
    assert dbo("help") == dbo("--help")
    assert dbo("help", "check") == dbo("check", "--help-all")
    assert dbo("help", "chek") == (
        2,
        "",
        f"dbo: error: no such command: 'chek': dbo check?; there are: {LIST}\n",
    )
