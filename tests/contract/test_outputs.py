"""Outputs: never in place of what was read, whole or not at all, whoever ends the work."""

import os
import resource
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from .program import (
    PAIR, PASS, PROGRAM, dbo, done, listing, model, refused, table, write
)  # fmt: skip

SMALL = model("small")
posix = pytest.mark.skipif(os.name != "posix", reason="needs POSIX signals and pipes")


@pytest.fixture
def files(wish, log, drive):
    """Lay out one file of each kind."""
    shutil.copy(SMALL, "mm.json")
    time = np.arange(200) / 100.0
    desired = 5.0 + np.sin(time)
    write("pair.csv", PAIR, time, desired, desired + 0.01)
    write("track.csv", PASS, time, desired, desired)
    words = ("compensate", "mm.json", "wish.csv", "-o", "o.csv", "-q")
    done(*words, "--save-state", "st.json", "--summary", "sm.json")
    Path("o.csv").unlink()
    Path("sub").mkdir()


IN_PLACE = {
    "compensate mm.json wish.csv -o out.csv --save-state mm.json": "mm.json",
    "compensate mm.json wish.csv -o mm.json": "mm.json",
    "compensate mm.json wish.csv -o wish.csv": "wish.csv",
    "compensate mm.json wish.csv -o out.csv --summary wish.csv": "wish.csv",
    "compensate mm.json wish.csv -o st.json --state st.json": "st.json",
    "compensate mm.json wish.csv -o o.csv --state st.json --summary st.json": "st.json",
    "simulate mm.json drive.csv -o drive.csv": "drive.csv",
    "simulate mm.json drive.csv -o out.csv --save-state drive.csv": "drive.csv",
    "simulate mm.json drive.csv -o sub/../drive.csv": "drive.csv",
    "simulate mm.json drive.csv -o symbolic.csv": "drive.csv",
    "simulate mm.json drive.csv -o hard.csv": "drive.csv",
    "simulate mm.json symbolic.csv -o drive.csv": "drive.csv",
    "simulate mm.json pack.h5::/time -o pack.h5": "pack.h5",
    "simulate mm.json drive.csv --input track.csv::voltage_V -o track.csv": "track.csv",
    "identify log.csv -o log.csv": "log.csv",
    "identify log.csv -o model.json --summary log.csv": "log.csv",
    "identify log.csv --prior mm.json -o mm.json": "mm.json",
    "identify log.csv --validate pair.csv -o pair.csv": "pair.csv",
    "invert mm.json -o mm.json": "mm.json",
    "show mm.json -o mm.json": "mm.json",
    "check drive.csv --v-max 20 -o drive.csv": "drive.csv",
    "check drive.csv --against track.csv -o track.csv": "track.csv",
    "report pair.csv -o pair.csv": "pair.csv",
    "report pair.csv --expected sm.json -o sm.json": "sm.json",
    "report pair.csv --trajectory wish.csv -o wish.csv": "wish.csv",
    "compare log.csv -o log.csv": "log.csv",
    "trajectory sine --rate 100 --range 2:8 --frequency 5 --model mm.json -o linked.csv": "mm.json",
    "waveform drive.csv --to npy -o drive.csv": "drive.csv",
}


@pytest.mark.parametrize("line", IN_PLACE)
def test_nothing_is_written_in_place_of_what_is_read(files, line):
    os.symlink("drive.csv", "symbolic.csv")
    os.symlink("mm.json", "linked.csv")
    os.link("drive.csv", "hard.csv")
    if "pack.h5" in line:
        done("simulate", SMALL, "drive.csv", "-o", "pack.h5")
    before = {name: Path(name).read_bytes() for name in listing()}
    outcome = dbo(*line.split())
    assert outcome.code in (1, 2), outcome.err
    assert "read" in outcome.lines[-1] and IN_PLACE[line] in outcome.lines[-1]
    assert {name: Path(name).read_bytes() for name in listing()} == before


def test_a_state_and_a_history_may_be_replaced_by_their_next(files):
    before = Path("st.json").read_text()
    Path("st.json").write_text(f"{before}\n")
    words = ("compensate", "mm.json", "wish.csv", "-o", "out.csv", "-q")
    done(*words, "--state", "st.json", "--save-state", "st.json")
    line = ("simulate", "mm.json", "out.csv", "--input", "voltage_V", "-o", "s.csv")
    done(*line, "--state", "st.json", "--save-state", "st.json", "-q")
    assert Path("st.json").read_text() == before
    _, desired, volts = table("out.csv").values()
    write("track.csv", "voltage_V,measured_um", volts, desired)
    for passes in (1, 1):  # learned twice from the same pass: forgotten the second time
        done(*words, "--tracked", "track.csv", "--history", "h.json")
        assert Path("h.json").read_text().count("rmse") == passes


@posix
def test_standard_streams_are_compared_too(files):
    text = Path("drive.csv").read_bytes()
    with open("drive.csv", "rb") as source:
        line = [*PROGRAM, "simulate", "mm.json", "-", "-o", "drive.csv"]
        ended = subprocess.run(line, stdin=source, capture_output=True, check=False)
    assert ended.returncode == 1 and b"standard input" in ended.stderr
    with open("drive.csv", "ab") as sink:
        line = [*PROGRAM, "simulate", "mm.json", "drive.csv"]
        ended = subprocess.run(line, stdout=sink, stderr=subprocess.PIPE, check=False)
    assert ended.returncode == 1 and b"standard output" in ended.stderr
    assert Path("drive.csv").read_bytes() == text


def test_an_exported_model_is_not_replaced_by_its_export(files):
    Path("firmware").mkdir()
    shutil.copy(SMALL, "firmware/export.json")
    refused(1, "export", "firmware/export.json", "-o", "firmware")


# --- figures ---


def test_figures_follow_no_link_and_replace_no_input(files, unpainted):
    Path("figures").mkdir()
    Path("precious").write_text("precious\n")
    shutil.copy("mm.json", "figures/model-loop.png")
    outcome = dbo("show", "figures/model-loop.png", "--figures", "figures")
    assert outcome.code == 1 and os.listdir("figures") == ["model-loop.png"]
    assert Path("figures/model-loop.png").read_bytes() == SMALL.read_bytes()
    os.remove("figures/model-loop.png")
    os.symlink("../precious", "figures/.model-loop.png.part")
    done("show", "mm.json", "--figures", "figures")
    drawn = set(os.listdir("figures"))
    assert {"model-loop.png", "model-loop.svg"} <= drawn
    assert Path("precious").read_text() == "precious\n"


def test_no_figure_takes_the_name_of_another_output(files, unpainted):
    """Nor by another path to it."""
    Path("figures").mkdir()
    words = ("-o", "sub/../figures/pair-loop.svg", "--figures", "figures")
    assert "two outputs" in refused(1, "report", "pair.csv", *words)
    words = ("-o", "figures/model-loop.png", "--figures", "figures")
    assert "two outputs" in refused(1, "show", "mm.json", *words)


def test_figures_of_channels_stand_in_folders_of_their_own(files, unpainted):
    done("show", model("set"), "--figures", "figures")
    drawn = sorted(os.listdir("figures"))
    assert len(drawn) == 2
    for channel in drawn:
        assert "model-loop.png" in os.listdir(f"figures/{channel}")


@posix
@pytest.mark.parametrize("words", [
    ("show", "mm.json", "--figures", "figures", "-o", "page.txt"),
    ("compensate", "mm.json", "wish.csv", "-o", "out.h5", "--summary", "s.json"),
    ("compensate", "mm.json", "wish.csv", "-o", "out.csv", "--save-state", "s.json"),
])  # fmt: skip
def test_a_full_disk_leaves_nothing_behind(files, words, monkeypatch):
    """And figures get as far as that with the backend of another program, as in a notebook."""
    monkeypatch.setenv("MPLBACKEND", "of another program")
    before = listing()
    line = [*PROGRAM, *words, "-q"]

    def limit():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))

    ended = subprocess.run(line, capture_output=True, check=False, preexec_fn=limit)
    assert ended.returncode == 1, ended.stderr
    assert ended.stderr.count(b"\n") == 1 and b"disk is full" in ended.stderr
    assert listing() == before and not Path("figures").exists()


# --- streams that are closed ---


@posix
def test_a_reader_that_leaves_does_not_swallow_the_summary(files):
    """The reader has left before anything is sent: the summary is written, or its lack is an error."""
    reader, sink = os.pipe()
    os.close(reader)
    line = [*PROGRAM, "compensate", "mm.json", "wish.csv", "--summary", "s.json", "-q"]
    ended = subprocess.run(line, stdout=sink, stderr=subprocess.PIPE, check=False)
    os.close(sink)
    assert ended.returncode == 1 and b"s.json" in ended.stderr
    assert not Path("s.json").exists()


@posix
@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&- >&- 2>&-"])
def test_closed_streams_are_no_traceback(files, closed):
    words = " ".join(f"'{word}'" for word in PROGRAM)
    is_closed = int(">&-" in closed.split())
    lines = {f"{words} simulate mm.json drive.csv {closed}": is_closed}
    if "<&-" in closed:
        lines[f"{words} simulate mm.json drive.csv -o out.csv {closed}"] = 0
        lines[f"{words} simulate mm.json - {closed}"] = 1
        lines[f"{words} --help {closed}"] = 1
    for line, code in lines.items():
        ended = subprocess.run(["sh", "-c", line], capture_output=True, check=False)
        assert ended.returncode == code, (line, ended)
        assert b"Traceback" not in ended.stderr and b"internal" not in ended.stderr
        assert b"dbo:" not in ended.stdout
    assert "<&-" not in closed or len(table("out.csv")["voltage_V"]) == 500


# --- signals ---

AT_CALL = """
import os, signal, sys
call, number = int(sys.argv.pop(1)), int(sys.argv.pop(1))
from dbo_cli.cli import app
inner = app.main

def count(frame, event, argument):
    global call
    call -= 1
    if call == 0:
        sys.setprofile(None)
        os.kill(os.getpid(), number)

def main(words):
    sys.setprofile(count)
    return inner(words)

app.main = main
app.run()
"""
"""Sends itself a signal at the n-th call of a function."""


@posix
@pytest.mark.parametrize(
    ("number", "calls"),
    [
        (signal.SIGINT, [10, 1_000, *range(100_000, 2_000_000, 300_000)]),
        (signal.SIGTERM, [10, 250_000]),
    ],
)
def test_a_signal_at_any_call_ends_the_same_way(files, number, calls):
    """From the first import to the last rename: the code, nothing else said, all outputs or none."""
    before = set(listing())
    words = "compensate mm.json wish.csv -o out.h5 --summary s.json -q".split()
    said = b"dbo: interrupted\n" if number == signal.SIGINT else b""
    codes = []
    for call in calls:
        line = [sys.executable, "-c", AT_CALL, str(call), str(int(number)), *words]
        ended = subprocess.run(line, capture_output=True, check=False)
        codes.append(ended.returncode)
        new = set(listing()) - before
        if ended.returncode == 0:
            assert new == {"out.h5", "s.json"}
            break
        assert (ended.returncode, ended.stderr) == (128 + number, said)
        assert new == set(), call
    assert len(codes) > min(3, len(calls) - 1)


@posix
def test_outputs_get_their_names_together(files):
    """A signal between two renames waits for the second one."""
    code = (
        "import os, signal, sys\n"
        "from dbo_cli.cli import app\n"
        "rename = os.replace\n"
        "def replace(*names):\n"
        "    rename(*names)\n"
        "    os.kill(os.getpid(), signal.SIGTERM)\n"
        "os.replace = replace\n"
        "app.run()\n"
    )
    words = "compensate mm.json wish.csv -o out.csv --summary s.json -q".split()
    line = [sys.executable, "-c", code, *words]
    ended = subprocess.run(line, capture_output=True, check=False)
    assert (ended.returncode, ended.stderr) == (143, b"")
    assert Path("out.csv").exists() and Path("s.json").exists()
