"""The program as a user meets it: a command line in, exit code and both streams out."""

import contextlib
import functools
import io
import json
import os
import signal
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path
from typing import NamedTuple
from unittest import mock

import numpy as np
import polars as pl

from dbo_cli.cli import app

HERE = Path(__file__).resolve().parent
MODELS = HERE / "models"
GOLDENS = HERE / "goldens"
SAMPLES = HERE.parent.parent / "sample_data"
PROGRAM = [sys.executable, "-m", "dbo_cli"]


class Outcome(NamedTuple):
    """How a run of the program ended."""

    code: int
    raw: bytes
    err: str

    @property
    def out(self):
        """Return standard output as text."""
        return self.raw.decode()

    @property
    def lines(self):
        """Return what was said, line by line."""
        return self.err.splitlines()

    @property
    def warnings(self):
        """Return the warnings that were said."""
        return [line for line in self.lines if line.startswith("dbo: warning: ")]

    @property
    def said(self):
        """Return what was said beside the warnings."""
        return [line for line in self.lines if line not in self.warnings]

    @property
    def json(self):
        """Return standard output as JSON."""
        return json.loads(self.out)


def dbo(*words, stdin=b""):
    """Run one command line inside this process."""
    given = stdin.encode() if isinstance(stdin, str) else stdin
    typed = [str(word) for word in words]
    out, err = _stream(), _stream()
    with tempfile.TemporaryFile() as source, warnings.catch_warnings():
        source.write(given)
        source.seek(0)
        streams = {
            "argv": ["dbo", *typed],
            "stdin": io.TextIOWrapper(source),
            "stdout": out,
            "stderr": err,
        }
        kept = mock.patch.object(app.Commands, "get_command", _command)
        with kept, mock.patch.multiple(sys, **streams):
            try:
                code = app.main(typed)
            except SystemExit as end:
                code = int(end.code or 0)
        out.flush()
        err.flush()
        raw, said = out.buffer.getvalue(), err.buffer.getvalue()
    return Outcome(code, raw, said.decode())


BUILD = app.Commands.get_command


def _command(group, context, name):
    """Return a command; those of the program are built once, which takes as long as a short log."""
    if name in app.COMMANDS:
        return _built(name, "--help-all" in sys.argv)
    return BUILD(group, context, name)


@functools.cache
def _built(name, _is_whole_page):
    return BUILD(None, None, name)


def _stream():
    """Return a stream of text over bytes in memory."""
    return io.TextIOWrapper(io.BytesIO(), encoding="utf-8", newline="")


def done(*words, stdin=b""):
    """Run one command line that has to succeed."""
    outcome = dbo(*words, stdin=stdin)
    assert outcome.code == 0, outcome.err
    return outcome


def refused(code, *words, stdin=b""):
    """Run one command line that has to fail with a code, one line and no output; return the line."""
    before = listing()
    outcome = dbo(*words, stdin=stdin)
    assert outcome.code == code, (outcome.code, outcome.err)
    errors = [line for line in outcome.lines if line.startswith("dbo: error: ")]
    assert len(errors) == 1 and outcome.lines[-1] == errors[0], outcome.err
    assert "internal error" not in errors[0], errors[0]
    assert outcome.raw == b""
    assert listing() == before, "a command that failed left something behind"
    return errors[0].removeprefix("dbo: error: ")


def process(*words, **more):
    """Run one command line as a process of its own."""
    line = [*PROGRAM, *(str(word) for word in words)]
    return subprocess.run(line, capture_output=True, check=False, timeout=600, **more)


@contextlib.contextmanager
def started(*words, program=PROGRAM):
    """Start one command line as a process with pipes, which hears interrupts; none outlives the test."""
    line = [*program, *(str(word) for word in words)]
    pipe = subprocess.PIPE
    running = subprocess.Popen(
        line, stdin=pipe, stdout=pipe, stderr=pipe, preexec_fn=_hear_interrupts
    )
    try:
        yield running
    finally:
        running.kill()
        running.wait()
        for stream in (running.stdin, running.stdout, running.stderr):
            with contextlib.suppress(OSError):
                stream.close()


def _hear_interrupts():
    """Undo what a shell does to its background jobs: they ignore interrupts."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def listing():
    """Return everything in the working folder, with sizes and times."""
    found = {}
    for folder, _, names in os.walk("."):
        for name in names:
            path = Path(folder, name)
            status = path.stat()
            found[str(path)] = (status.st_size, status.st_mtime_ns)
    return found


def model(name):
    """Return the file of a stored model."""
    return MODELS / f"{name}.json"


def values_of(name):
    """Return a stored model as JSON values."""
    return load(model(name))


def load(path):
    """Return what a JSON file holds."""
    return json.loads(Path(path).read_text())


def store(path, values):
    """Write a JSON file."""
    Path(path).write_text(json.dumps(values))
    return Path(path)


def store_set(path, **models):
    """Write models by name as one file."""
    return store(path, {"format": "dbo-model-set", "version": 1, "models": models})


QUICK = "--gears 20 --points 0 --delay 0 --relaxation 0 --dynamics 0 --slopes growing"
QUICK = QUICK.split()
"""A structure that is identified in a moment."""
DRIVE = "time_s,voltage_V"
MOVE = "time_s,displacement_um"
LOG = "time_s,voltage_V,displacement_um"
PAIR = "time_s,desired_um,measured_um"
PASS = "time_s,voltage_V,measured_um"


def write(name, header, *columns):
    """Write a CSV file whose numbers read back exactly."""
    texts = [map(repr, np.asarray(column, float).tolist()) for column in columns]
    rows = map(",".join, zip(*texts, strict=True))
    Path(name).write_text("\n".join([header, *rows, ""]))
    return Path(name)


def table(source):
    """Return the columns of a CSV, a file or what a command wrote, by header; an empty cell is NaN."""
    text = source.out if isinstance(source, Outcome) else Path(source).read_text()
    frame = pl.read_csv(text.encode(), infer_schema=False).cast(pl.Float64)
    return {name: frame[name].to_numpy(writable=True) for name in frame.columns}


def simulated(actuator, drive, *words):
    """Return the output that ``simulate`` writes, of a stored model by its name or of a file."""
    path = model(actuator) if isinstance(actuator, str) else actuator
    return list(table(done("simulate", path, drive, *words, "-q")).values())[-1]


def compensated(name, *words, wish="wish.csv"):
    """Return what ``compensate`` with a stored model writes, and leave it as ``drive.csv``."""
    done("compensate", model(name), wish, *words, "-o", "drive.csv", "-q")
    return table("drive.csv")


def rms(values):
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def plays_of(drive, reach, plays):
    """Return plays of each reach, a row a voltage, that stood at ``plays`` before."""
    rows = []
    for voltage in drive:
        plays = np.clip(plays, voltage - reach, voltage + reach)
        rows.append(plays)
    return np.asarray(rows)
