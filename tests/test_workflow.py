"""The batches of ``workflow/``: a table of all logs, whatever becomes of each."""

import csv
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from contract.program import LOG, MOVE, write

import dbo_cli as dbo

ROOT = Path(__file__).resolve().parent.parent
WORKFLOW = ROOT / "workflow"
MODEL = ROOT / "tests" / "contract" / "models" / "small.json"
MANY = int(os.environ.get("DBO_LOGS", "3"))  # make labs: 40
IDENTIFY = (
    "--gears 32 --points 0 --relaxation 0 --delay 0 --dynamics 0 --slopes growing"
)


@pytest.fixture
def batch(tmp_path):
    """Logs of one actuator, of which one faces the other way and two are broken."""
    model = dbo.read_model(MODEL)
    rng = np.random.default_rng(1)
    clock = np.arange(600) / 500.0
    fading = np.cos(2.0 * np.pi * 5.0 * clock) * (1.0 - 0.6 * clock / 1.2)
    middle = 0.5 * (model.input.min + model.input.max)
    voltage = middle - 0.5 * (model.input.max - model.input.min) * fading
    (tmp_path / "logs").mkdir()
    for number in range(MANY):
        moved = model.simulate(voltage) + rng.normal(0.0, 1e-3, clock.size)
        if number == 0:
            moved = model.output.min + model.output.max - moved
        path = tmp_path / "logs" / f"a{number:02}.csv"
        write(path, LOG, clock, voltage, moved)
    lines = (tmp_path / "logs" / "a01.csv").read_text().splitlines()
    lines[101] = "0.2,OVLD,1"
    (tmp_path / "logs" / "cell.csv").write_text("\n".join(lines))
    text = (tmp_path / "logs" / "a01.csv").read_text()
    (tmp_path / "logs" / "unit.csv").write_text(text.replace("voltage_V", "voltage_N"))
    part = 0.3 - 0.2 * np.cos(2.0 * np.pi * clock[:200])
    low, high = model.output.min, model.output.max
    wanted = low + part * (high - low)
    write(tmp_path / "trajectory.csv", MOVE, clock[:200], wanted)
    return tmp_path


def made(folder, *words):
    environment = os.environ | {
        "OPENBLAS_NUM_THREADS": "1",
        "PYTHONPATH": str(ROOT),
        "DBO": f"{sys.executable} -m dbo_cli",
        "IDENTIFY": IDENTIFY,
        "PYTHON": sys.executable,
        "XDG_CACHE_HOME": str(folder / "cache"),
    }
    return subprocess.run(
        words, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


def require_table(folder, said):
    """Look at the table of a batch whose log a00 falls, and where ``cell`` and ``unit`` are broken."""
    with open(folder / "results" / "summary.csv", newline="") as file:
        lines = {line["log"]: line for line in csv.DictReader(file)}
    assert len(lines) == MANY + 2
    assert {name for name, line in lines.items() if line["failed"]} == {"cell", "unit"}
    assert "OVLD" in lines["cell"]["failed"] and "--skip-bad" in lines["cell"]["failed"]
    assert "--voltage" in lines["unit"]["failed"]
    good = lines["a01"]
    assert good["sign"] == "rising" and float(good["report_rmse"]) < 0.4  # um of 8
    assert int(good["rows"]) == 600 and good["clipped"] == "0"
    assert f"{MANY + 2} logs, 2 failed" in said and "falling in a00" in said


@pytest.mark.skipif(shutil.which("make") is None, reason="there is no make")
def test_make_leaves_a_table_and_goes_on(batch):
    words = ("make", "-s", "-f", str(WORKFLOW / "day.mk"))
    first = made(batch, *words)
    assert first.returncode == 2, first.stderr
    require_table(batch, first.stderr)
    # A log is mended: it alone is made, and the other broken one is tried again.
    before = (batch / "results" / "a01.model.json").stat().st_mtime_ns
    shutil.copy(batch / "logs" / "a01.csv", batch / "logs" / "cell.csv")
    second = made(batch, *words)
    assert second.returncode == 2
    assert f"{MANY + 2} logs, 1 failed" in second.stderr
    assert (batch / "results" / "a01.model.json").stat().st_mtime_ns == before
    assert (batch / "results" / "cell.drive.csv").exists()
    # With nothing broken left, make is content; a second time it makes nothing.
    (batch / "logs" / "unit.csv").unlink()
    assert made(batch, *words).returncode == 0
    table = (batch / "results" / "summary.csv").stat().st_mtime_ns
    assert made(batch, *words).returncode == 0
    assert (batch / "results" / "summary.csv").stat().st_mtime_ns == table


@pytest.mark.skipif(
    shutil.which("snakemake", path=f"{Path(sys.executable).parent}") is None,
    reason="there is no Snakemake (make labs has it)",
)
def test_snakemake_leaves_the_same_table(batch):
    program = Path(sys.executable).parent / "snakemake"
    words = [str(program), "-s", str(WORKFLOW / "Snakefile"), "--cores", "2"]
    words.append("--config")
    words += [f"dbo={sys.executable} -m dbo_cli", f"identify={IDENTIFY}"]
    done = made(batch, *words)
    assert done.returncode == 1, done.stderr
    require_table(batch, done.stderr)


TABLE = """log,failed,sign,gain,delay_s,model_rmse
a,,rising,0.10,0.0010,0.01
b,,rising,0.11,0.0011,0.02
c,,rising,0.25,0.0010,0.01
d,,falling,-0.10,0.0009,0.05
e,,rising,0.09,0.0300,0.01
f,,rising,0.10,0.0010,0.01
"""


def test_the_table_flags_what_is_unlike_the_others(tmp_path):
    (tmp_path / "summary.csv").write_text(TABLE)
    line = [sys.executable, WORKFLOW / "table.py", "logs", tmp_path, "--judge"]
    ended = subprocess.run(line, capture_output=True, text=True, check=False)
    assert ended.returncode == 0
    flagged = [text for text in ended.stderr.splitlines() if text.startswith("warning")]
    assert len(flagged) == 4
    assert "falling in d" in flagged[0]
    assert flagged[1].startswith("warning: c: gain 0.25")
    assert flagged[2].startswith("warning: d: error 0.05")
    assert flagged[3].startswith("warning: e: delay 0.03")
