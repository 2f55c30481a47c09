"""Where no compiler was at installation the paper's procedure serves, and identify says what it needs.

Skipped where the compiled part is there; ``.ci/run`` runs it, with the goldens, where it is not.
"""

from __future__ import annotations

import pytest

from dbo_cli.model import kernel

from .program import done, model, process, refused, write

pytestmark = pytest.mark.skipif(
    kernel.extension is not None, reason="the compiled part is there"
)


def test_it_is_said_once() -> None:
    write("drive.csv", "voltage_V", [0.0, 5.0, 10.0, 3.0])
    said = process("simulate", model("small"), "drive.csv", "-o", "out.csv")
    assert said.returncode == 0
    assert said.stderr.count(b"warning") == 1


def test_the_inverse_needs_none() -> None:
    done("invert", model("small"), "-o", "inverse.json")


def test_identify_says_what_it_needs() -> None:
    rows = [float(row % 40) for row in range(200)]
    write("log.csv", "voltage_V,displacement_um", rows, rows)
    assert "compile" in refused(1, "identify", "log.csv", "-o", "model.json")
