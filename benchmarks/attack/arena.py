"""A folder with small models, logs and old outputs, and a way to run the program in it and look what is left.

The commands run in this process, or in one forked from it: starting an interpreter
takes longer than most of the runs. Inputs stay small, so that no library with threads
of its own is imported before a fork.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import os
import re
import signal
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT))

CODES = {0, 1, 2, 3, 130}
_BAD_WORDS = re.compile(
    r"internal error|Traceback|Warning\b|warnings\.warn|Exception ignored|Segmentation"
)
_NOT_FINITE = re.compile(rb"(?i)(?<![a-z])(nan|[+-]?inf(inity)?)(?![a-z])")

MODEL: dict[str, Any] = {
    "format": "dbo-model",
    "version": 1,
    "direction": "forward",
    "input": {"quantity": "voltage", "unit": "V", "min": 0.0, "max": 10.0},
    "output": {"quantity": "displacement", "unit": "um", "min": 1.0, "max": 9.0},
    "stages": [
        {
            "type": "backlash",
            "x0": 0.0,
            "y0": 0.0,
            "dx": [1.0, 2.0, 3.0, 4.0],
            "dy": [0.25, 0.75, 1.5, 2.5],
        },
        {"type": "scale", "gain": 1.6, "offset": 1.0},
    ],
}
RELAXATION = {"on": "input", "reference": 0.0, "tau": [0.01, 0.3], "gain": [0.05, 0.02]}


class Outcome(NamedTuple):
    """How one run ended."""

    code: int
    out: bytes
    err: str


def fill(folder: Path) -> None:
    """Put models, logs and trajectories into a folder."""
    late = json.loads(json.dumps(MODEL))
    late["stages"][0]["relaxation"] = RELAXATION
    late["stages"].append({"type": "delay", "seconds": 0.02})
    (folder / "model.json").write_text(json.dumps(MODEL))
    (folder / "late.json").write_text(json.dumps(late))
    drive = [5.0 - 5.0 * math.cos(0.07 * n) for n in range(400)]
    moved = [1.0 + 0.08 * v * v for v in drive]
    rows = [
        f"{n / 100:.2f},{v:.5f},{x:.5f}"
        for n, (v, x) in enumerate(zip(drive, moved, strict=True))
    ]
    (folder / "run.csv").write_text(
        "\n".join(["time_s,voltage_V,displacement_um", *rows, ""])
    )
    wished = [f"{n / 100:.2f},{5.0 + 3.0 * math.sin(0.05 * n):.5f}" for n in range(300)]
    (folder / "wish.csv").write_text("\n".join(["time_s,displacement_um", *wished, ""]))
    (folder / "bare.txt").write_text("".join(f"{v:.4f}\n" for v in drive[:50]))
    pairs = [
        f"{n / 100:.2f},{v:.4f},{v + 0.01 * math.sin(n):.4f}"
        for n, v in enumerate(drive)
    ]
    (folder / "pair.csv").write_text(
        "\n".join(["time_s,desired_um,measured_um", *pairs, ""])
    )


@contextlib.contextmanager
def inside(folder: Path) -> Iterator[None]:
    """Work in a folder."""
    before = os.getcwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


def run(words: Sequence[str]) -> Outcome:
    """Run one command line in this process; what it writes is caught."""
    from dbo_cli.cli.app import main

    raw, err = io.BytesIO(), io.StringIO()
    out = io.TextIOWrapper(raw, encoding="utf-8", write_through=True)
    stdin = io.TextIOWrapper(io.BufferedReader(io.BytesIO(b"")), encoding="utf-8")
    kept = sys.stdin, sys.stdout, sys.stderr
    sys.stdin, sys.stdout, sys.stderr = stdin, out, err
    try:
        code = main(list(words))
        out.flush()
    finally:
        sys.stdin, sys.stdout, sys.stderr = kept
    return Outcome(code, raw.getvalue(), err.getvalue())


def complaint(outcome: Outcome) -> str | None:
    """Say what is wrong with how a run ended, None where nothing is."""
    if outcome.code not in CODES:
        return f"exit code {outcome.code}"
    if found := _BAD_WORDS.search(outcome.err):
        return f"{found[0]!r} on stderr: {outcome.err.strip()[:300]}"
    errors = [
        line for line in outcome.err.splitlines() if line.startswith("dbo: error: ")
    ]
    if (outcome.code in (1, 2, 3)) != (len(errors) == 1):
        return f"exit code {outcome.code} with {len(errors)} errors: {outcome.err.strip()[:300]}"
    if any(not line.startswith("dbo: ") for line in outcome.err.splitlines()):
        return f"a line that is not the program's: {outcome.err.strip()[:300]}"
    if outcome.code == 0 and _NOT_FINITE.search(outcome.out):
        return f"not a number, with exit code 0: {outcome.out[:200]!r}"
    if any(ord(letter) < 32 and letter != "\n" for letter in outcome.err):
        return f"control characters on stderr: {outcome.err!r}"
    return None


class Hang(BaseException):
    """A run took too long."""


@contextlib.contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Raise Hang where the work takes too long."""

    def end(*_: object) -> None:
        raise Hang(f"more than {seconds} s")

    before = signal.signal(signal.SIGALRM, end)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def forked(words: Sequence[str], limit: int | None = None) -> int:
    """Run one command line in a forked process, its streams to nowhere; return the process id.

    ``limit`` is the most bytes that a file may get: a disk that is full at a certain
    byte.
    """
    process = os.fork()
    if process:
        return process
    code = 99
    try:
        nowhere = os.open(os.devnull, os.O_RDWR)
        for descriptor in (0, 1):
            os.dup2(nowhere, descriptor)
        os.dup2(os.open("stderr.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 2)
        sys.stdin, sys.stdout, sys.stderr = (
            open(n, m) for n, m in ((0, "r"), (1, "w"), (2, "w"))
        )
        signal.signal(signal.SIGINT, signal.default_int_handler)
        if limit is not None:
            import resource

            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
        from dbo_cli.cli.app import main, prepare_process

        prepare_process()
        code = main(list(words))
    except SystemExit as leaving:
        code = leaving.code if isinstance(leaving.code, int) else 1
    except KeyboardInterrupt:
        code = 130
    finally:
        os._exit(code)


def loaded() -> None:
    """Import what the commands need, once, before any fork."""
    import h5py  # noqa: F401

    for name in ("app", "commands", "typer_adapter"):
        __import__(f"dbo_cli.cli.{name}")
    for name in ("files", "reporting"):
        __import__(f"dbo_cli.runs.{name}")
    for name in ("hdf5.store", "signal_writer", "text.text_table"):
        __import__(f"dbo_cli.logs.{name}")


def report(title: str, counts: dict[str, int], failures: Sequence[str]) -> int:
    """Print what was counted; return the exit code."""
    for what, times in sorted(counts.items(), key=lambda one: -one[1])[:30]:
        print(f"{times:9,}  {what}")
    for failure in failures[:20]:
        print(f"FAILED: {failure}")
    print(f"{title}: {sum(counts.values()):,} runs, {len(failures)} failures")
    return 1 if failures else 0
