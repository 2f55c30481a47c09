"""A few real processes: pipes in and out, a reader that leaves early, live streams, interrupts."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from conftest import SMALL_MODEL, folder_content

DBO = [sys.executable, "-m", "dbo_cli"]
posix = pytest.mark.skipif(os.name != "posix", reason="needs POSIX signals and pipes")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "model.json").write_text(json.dumps(SMALL_MODEL))
    return tmp_path


def environment() -> dict[str, str]:
    """Return an environment in which the package is found from any folder."""
    root = str(Path(__file__).resolve().parent.parent)
    return os.environ | {"PYTHONPATH": root, "NO_COLOR": "1"}


def start(words: list[str], folder: Path) -> subprocess.Popen[bytes]:
    pipe = subprocess.PIPE
    return subprocess.Popen(
        [*DBO, *words],
        cwd=folder,
        env=environment(),
        stdin=pipe,
        stdout=pipe,
        stderr=pipe,
        preexec_fn=hear_interrupts if os.name == "posix" else None,
    )


def hear_interrupts() -> None:
    """Undo what a shell does to its background jobs: they, and the tests run by them, ignore interrupts."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def scripted(script: str, folder: Path) -> tuple[int, bytes, bytes]:
    """Run a script that hears interrupts; return exit code and what was written."""
    done = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        cwd=folder,
        env=environment(),
        preexec_fn=hear_interrupts,
        check=False,
    )
    return done.returncode, done.stdout, done.stderr


def ended(running: subprocess.Popen[bytes]) -> tuple[int, bytes, bytes]:
    """Return exit code and what was written, of a process whose input stays open until it ends."""
    try:
        code = running.wait(60)
    except subprocess.TimeoutExpired:
        running.kill()
        raise
    assert (
        running.stdin is not None
        and running.stdout is not None
        and running.stderr is not None
    )
    written = running.stdout.read(), running.stderr.read()
    for stream in (running.stdin, running.stdout, running.stderr):
        stream.close()
    return code, *written


def test_pipe_in_and_out(folder: Path) -> None:
    done = subprocess.run(
        [*DBO, "simulate", "model.json", "-"],
        input=b"voltage_V\n0\n5\n10\n3\n",
        capture_output=True,
        cwd=folder,
        env=environment(),
        check=False,
    )
    expected = b"voltage_V,displacement_um\n0.0,1.0\n5.0,4.2\n10.0,9.0\n3.0,4.0\n"
    told = b"dbo: standard input: 4 rows, no time; voltage 'voltage_V' (V)\n"
    assert (done.returncode, done.stdout, done.stderr) == (0, expected, told)


def test_three_commands_in_one_pipe(folder: Path) -> None:
    """invert | simulate of a model on stdin gives the drive; each reads what the other wrote."""
    (folder / "wished.csv").write_text("1\n4.2\n9\n4\n")
    inverse = subprocess.run(
        [*DBO, "invert", "model.json"],
        capture_output=True,
        cwd=folder,
        env=environment(),
        check=True,
    )
    done = subprocess.run(
        [*DBO, "simulate", "-", "wished.csv"],
        input=inverse.stdout,
        capture_output=True,
        cwd=folder,
        env=environment(),
        check=True,
    )
    assert (
        done.stdout
        == b"displacement_um,voltage_V\n1.0,0.0\n4.2,5.0\n9.0,10.0\n4.0,3.0\n"
    )


@posix
def test_reader_that_leaves_early_is_success(folder: Path) -> None:
    (folder / "long.csv").write_text("voltage_V\n" + "1\n2\n3\n" * 100_000)
    running = start(
        ["simulate", "model.json", "long.csv", "--block-rows", "1000"], folder
    )
    assert (
        running.stdin is not None
        and running.stdout is not None
        and running.stderr is not None
    )
    assert running.stdout.readline() == b"voltage_V,displacement_um\n"
    running.stdout.close()
    error = running.stderr.read()
    assert (running.wait(60), error) == (0, b"")
    running.stderr.close()
    running.stdin.close()


@posix
def test_flush_gives_each_sample_as_it_comes(folder: Path) -> None:
    running = start(
        ["simulate", "model.json", "-", "--flush", "--state", "empty"], folder
    )
    assert running.stdin is not None and running.stdout is not None
    answers = []
    for text in (b"voltage_V\n0\n", b"5\n", b"10\n"):
        running.stdin.write(text)
        running.stdin.flush()
        if not answers:
            answers.append(running.stdout.readline())
        answers.append(running.stdout.readline())
    assert answers == [
        b"voltage_V,displacement_um\n",
        b"0.0,1.0\n",
        b"5.0,4.2\n",
        b"10.0,9.0\n",
    ]
    running.stdin.close()
    told = b"dbo: standard input: no time; voltage 'voltage_V' (V)\n"
    assert ended(running) == (0, b"", told)


def wait_until_quiet(folder: Path) -> None:
    """Wait until the unfinished output has grown as far as it can before the next row arrives."""
    size, since = 0, time.monotonic()
    while time.monotonic() - since < (0.5 if size else 60.0):
        partial = [path.stat().st_size for path in folder.glob(".out.csv*.partial")]
        if partial and partial[0] > size:
            size, since = partial[0], time.monotonic()
        time.sleep(0.02)
    assert size > 0, "no unfinished output stands beside the old one"


@posix
@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)]
)
def test_an_interrupt_leaves_the_old_output_and_no_litter(
    folder: Path, number: int, code: int
) -> None:
    (folder / "out.csv").write_text("old\n")
    running = start(["simulate", "model.json", "-", "-o", "out.csv"], folder)
    assert running.stdin is not None
    running.stdin.write(b"voltage_V\n" + b"1\n2\n" * 400_000)
    running.stdin.flush()
    wait_until_quiet(folder)
    running.send_signal(number)
    said = b"dbo: interrupted\n" if number == signal.SIGINT else b""
    assert ended(running) == (code, b"", said)
    assert folder_content(folder) == {"model.json", "out.csv"}
    assert (folder / "out.csv").read_text() == "old\n"


@posix
def test_a_full_disk_behind_a_redirection_is_said(folder: Path) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full here")
    (folder / "drive.csv").write_text("0\n5\n")
    with open("/dev/full", "wb") as full:
        done = subprocess.run(
            [*DBO, "simulate", "model.json", "drive.csv"],
            stdout=full,
            stderr=subprocess.PIPE,
            cwd=folder,
            env=environment(),
            check=False,
        )
    assert done.returncode == 1
    assert (
        done.stderr
        == b"dbo: error: standard output: the disk is full: nothing was written\n"
    )


@posix
@pytest.mark.parametrize("module", ["dbo_cli.cli.app", "dbo_cli.cli.commands", "numpy"])
def test_an_interrupt_while_modules_are_imported(module: str, folder: Path) -> None:
    """The signal comes at the import itself: before the program has begun to work, or right after."""
    script = (
        "import os, runpy, signal, sys\n"
        "class Signalling:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        f"        if name == {module!r}:\n"
        "            sys.meta_path.remove(self)\n"
        "            os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Signalling())\n"
        "sys.argv[1:] = ['simulate', 'model.json', 'none.csv']\n"
        "runpy.run_module('dbo_cli', run_name='__main__')\n"
    )
    said = b"" if module == "dbo_cli.cli.app" else b"dbo: interrupted\n"
    assert scripted(script, folder) == (130, b"", said)


@posix
def test_two_interrupts_end_like_one(folder: Path) -> None:
    script = (
        "import os, signal\n"
        "from dbo_cli.cli import app\n"
        "def interrupted(words):\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "def say(text, saying=app._print_line):\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "    saying(text)\n"
        "app._dispatch, app._print_line = interrupted, say\n"
        "app.run()\n"
    )
    assert scripted(script, folder) == (130, b"", b"dbo: interrupted\n")


@posix
@pytest.mark.parametrize("piped", [("model",), ("log",), ("model", "log")])
def test_a_model_and_a_log_through_named_descriptors(
    folder: Path, piped: tuple[str, ...]
) -> None:
    """What a shell writes as ``<(cat model.json)``: a pipe can be read once, from its beginning."""
    (folder / "drive.csv").write_text("voltage_V\n0\n5\n10\n")
    names = {"model": "model.json", "log": "drive.csv"}
    words = [
        f"<(cat {name})" if what in piped else name for what, name in names.items()
    ]
    line = " ".join([*(f"'{word}'" for word in DBO), "simulate", *words])
    done = subprocess.run(
        ["bash", "-c", line],
        cwd=folder,
        env=environment(),
        capture_output=True,
        check=False,
        timeout=60,
    )
    assert done.stdout == b"voltage_V,displacement_um\n0.0,1.0\n5.0,4.2\n10.0,9.0\n"
    assert done.returncode == 0
