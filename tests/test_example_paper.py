"""docs/example-paper.md, its commands run as they stand there, where the authors' recordings are at hand."""

from __future__ import annotations

import os
import re
import shlex
import shutil
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parent.parent
PAPER = Path(
    os.environ.get("DBO_PAPER_DATA", ROOT.parent / "shared" / "data" / "paper")
)
PAGE = (ROOT / "docs" / "example-paper.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^    (dbo .*)$", PAGE, re.MULTILINE)


@pytest.mark.skipif(
    not (PAPER / "uncompensated.dat").exists(),
    reason=f"the authors' recordings are not in {PAPER}",
)
def test_the_commands_find_what_the_page_says(dbo: Any) -> None:
    for name in ("identification.dat", "uncompensated.dat"):
        shutil.copy(PAPER / name, name)
    assert len(COMMANDS) == 7
    done = []
    for line in COMMANDS:
        done.append(dbo(*shlex.split(line)[1:]))
        assert done[-1].code == 0, (line, done[-1].err)
    line, found, shown, _, predicted, drive, checked = done
    # What was fitted may differ in its last digits from machine to machine.
    wanted = [
        (line.out, r"uncompensated\.dat +1000 +([\d.]+)", 1.679),
        (found.err, r"expected on new moves inside the range: ([\d.]+) \(", 0.2899),
        (shown.out, r"expect: RMSE ([\d.]+) on new moves", 0.2899),
        (predicted.out, r"uncompensated\.dat +6400 +([\d.]+)", 0.1466),
        (drive.err, r"expected error of the move ([\d.]+) RMS", 0.184),
    ]
    for text, pattern, number in wanted:
        [value] = re.findall(pattern, text)
        assert (
            float(value) == pytest.approx(number, rel=0.01) and f"{number} um" in PAGE
        )
    assert "all cycles go over one and the same range" in found.err
    assert checked.out.startswith("drive.csv: passed")
    assert Path("prediction.html").exists() and Path("figures/model-gears.png").exists()
