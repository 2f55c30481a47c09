"""A dozen real processes: pipes, a reader that leaves, interrupts and kills, a full disk, no compiler."""

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from dbo_cli import __version__

from .program import PROGRAM, listing, model, process, started, write

posix = pytest.mark.skipif(os.name != "posix", reason="needs POSIX signals and pipes")
SMALL = model("small")
HEADER = b"voltage_V,displacement_um\n"


def test_the_module_is_the_program_between_pipes():
    ended = process("--version")
    said = f"dbo {__version__}\n".encode()
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, said, b"")
    ended = process("simulate", SMALL, "-", input=b"voltage_V\n0\n5\n10\n3\n")
    assert ended.returncode == 0
    assert ended.stdout == HEADER + b"0.0,1.0\n5.0,4.2\n10.0,9.0\n3.0,4.0\n"
    assert all(line.startswith(b"dbo: ") for line in ended.stderr.splitlines())
    ended = process("simulate", "none.json", "none.csv")
    assert ended.returncode == 1
    assert ended.stderr.startswith(b"dbo: error: none.json: ")
    assert ended.stderr.count(b"\n") == 1


@posix
def test_a_reader_that_leaves_early_is_success():
    Path("long.csv").write_text("voltage_V\n" + "1\n2\n3\n" * 200_000)
    with started("simulate", SMALL, "long.csv") as running:
        assert running.stdout.readline() == HEADER
        running.stdout.close()
        said = running.stderr.read()
        assert running.wait() == 0
    assert b"error" not in said and b"Traceback" not in said


@posix
def test_rows_come_out_while_rows_come_in():
    """On a pipe a block ends where the pipe has no more: rows come before the input ends."""
    with started("simulate", SMALL, "-", "--state", "empty", "-q") as running:
        alarm = threading.Timer(100.0, running.kill)  # a program that waits is ended
        alarm.start()
        running.stdin.write(b"voltage_V\n")
        for first in (True, False):
            running.stdin.write(b"0\n5\n10\n")
            running.stdin.flush()
            if first:
                assert running.stdout.readline() == HEADER
            rows = [running.stdout.readline() for _ in range(3)]
            assert rows[-1] == b"10.0,9.0\n"
        running.stdin.close()
        assert running.stdout.read() == b""
        assert running.wait() == 0
        alarm.cancel()


HALF_WAY = """
import os, sys
number = int(sys.argv.pop(1))
from dbo_cli.cli import app
from dbo_cli.logs.write import Writer
write = Writer.write
def then_signal(self, *arrays):
    write(self, *arrays)
    os.kill(os.getpid(), number)
Writer.write = then_signal
app.run()
"""
"""Sends itself a signal when its first rows are written."""


@posix
@pytest.mark.parametrize(
    ("number", "code"),
    [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGKILL, -9)],
)
def test_an_interrupt_leaves_the_old_output(number, code):
    Path("out.csv").write_text("old\n")
    write("drive.csv", "voltage_V", np.arange(60_000) % 10)
    line = [sys.executable, "-c", HALF_WAY, str(int(number))]
    line += ["simulate", str(SMALL), "drive.csv", "-o", "out.csv", "-q"]
    ended = subprocess.run(line, capture_output=True, check=False)
    assert ended.returncode == code
    assert b"Traceback" not in ended.stderr
    assert Path("out.csv").read_text() == "old\n"
    litter = set(listing()) - {"drive.csv", "out.csv"}
    assert not litter or number == signal.SIGKILL


MEMORY = """
import sys
from dbo_cli.cli.app import main
assert main(sys.argv[1:]) == 0
[line] = [line for line in open("/proc/self/status") if line.startswith("VmHWM")]
print(int(line.split()[1]) / 1024.0)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")
@pytest.mark.parametrize("command", ["simulate", "compensate"])
def test_memory_does_not_grow_with_the_file(command):
    """Three times as many rows take less than 20 MB more; whole, 1.6 million take 40."""
    header = "voltage_V" if command == "simulate" else "displacement_um"
    most = []
    for rows in (800_000, 2_400_000):
        content = "1.2345678\n5.2345678\n" * (rows // 2)
        Path("long.csv").write_text(f"{header}\n{content}")
        words = [command, str(SMALL), "long.csv", "-o", "out.csv", "-q"]
        line = [sys.executable, "-c", MEMORY, *words]
        ended = subprocess.run(line, capture_output=True, check=True)
        most.append(float(ended.stdout))
    assert most[1] - most[0] < 20.0


@posix
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_full_disk_is_said():
    Path("drive.csv").write_text("voltage_V\n0\n5\n")
    line = [*PROGRAM, "simulate", str(SMALL), "drive.csv", "-q"]
    with open("/dev/full", "wb") as full:
        ended = subprocess.run(line, stdout=full, stderr=subprocess.PIPE, check=False)
    assert ended.returncode == 1
    assert ended.stderr.startswith(b"dbo: error: ")
    assert ended.stderr.count(b"\n") == 1


@posix
def test_descriptors_that_a_shell_names():
    Path("drive.csv").write_text("voltage_V\n0\n5\n10\n")
    words = " ".join(f"'{word}'" for word in PROGRAM)
    line = f"{words} simulate <(cat {SMALL}) <(cat drive.csv) -q"
    ended = subprocess.run(["bash", "-c", line], capture_output=True, check=False)
    assert ended.stdout == HEADER + b"0.0,1.0\n5.0,4.2\n10.0,9.0\n"
    assert ended.returncode == 0


WITHOUT_THE_KERNEL = """
import sys
sys.modules["dbo_cli.model._kernel"] = None
from dbo_cli.__main__ import main
main()
"""


def test_without_the_compiled_part_one_line_says_what_to_type():
    write("drive.csv", "voltage_V", [0.0, 5.0, 10.0])
    for words in (("simulate", str(SMALL), "drive.csv"), ("identify", "drive.csv")):
        line = [sys.executable, "-c", WITHOUT_THE_KERNEL, *words, "-o", "out"]
        ended = subprocess.run(line, capture_output=True, check=False)
        assert ended.returncode == 1
        assert ended.stderr.startswith(b"dbo: error: the compiled part of dbo")
        assert b"`pip install -e .`" in ended.stderr and ended.stderr.count(b"\n") == 1
        assert not Path("out").exists()
