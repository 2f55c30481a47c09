"""The page on clusters, run with Dask where it is installed."""

from __future__ import annotations

import multiprocessing
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from virtual_mirror import VirtualMirror, save_table

import dbo_cli
from dbo_cli.extras.channels.excitation import channel_drives
from dbo_cli.hysteresis.excitation import Excitation

PAGE = Path(__file__).resolve().parents[2] / "docs" / "cluster.md"
CHANNELS = 4


def test_the_page_makes_models_and_drives(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    mirror = VirtualMirror(CHANNELS)
    time, volts = channel_drives(Excitation(0.0, 100.0, 200.0, 3.0, 2.0), CHANNELS)
    rows = slice(0, 600)
    shown = mirror.play(time[rows], volts[rows], seed=1)
    seconds, wanted = mirror.move()
    log, frames = {"time_s": time[rows]}, {"time_s": seconds}
    for k in range(CHANNELS):
        log |= {
            f"voltage_{k + 1}_V": volts[rows, k],
            f"displacement_{k + 1}_um": shown[:, k],
        }
        frames |= {f"desired_{k + 1}_um": wanted[:, k]}
    save_table(str(tmp_path / "log.h5"), log)
    save_table(str(tmp_path / "frames.h5"), frames)
    blocks = re.findall(
        r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL
    )
    code = "\n".join(blocks) + '    import numpy; numpy.save("drives.npy", drives)\n'
    (tmp_path / "page.py").write_text(code, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "page.py"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    made = dbo_cli.read_model(tmp_path / "mirror.json")
    assert list(made) == [str(k) for k in range(1, CHANNELS + 1)]
    drives = np.load(tmp_path / "drives.npy")
    for k, model in enumerate(made.values()):
        alone = model.compensate(wanted[:, k], time=seconds, state="auto")
        assert np.array_equal(drives[k], alone)
    assert multiprocessing.active_children() == []
