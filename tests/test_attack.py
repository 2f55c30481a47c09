"""A short, seeded part of each attack: killed runs, full disks, changed models, random command lines."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
ATTACKS = ROOT / "benchmarks" / "attack"


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the attacks fork")
@pytest.mark.parametrize(
    ("program", "count"),
    [("kills", 9), ("full_disk", 9), ("mutants", 400), ("command_lines", 200)],
)
def test_nothing_is_lost_and_nothing_breaks(program: str, count: int) -> None:
    """In a process of its own: the attacks fork, and change streams and signals."""
    done = subprocess.run(
        [sys.executable, str(ATTACKS / f"{program}.py"), str(count), "7"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"{count} runs, 0 failures" in done.stdout
