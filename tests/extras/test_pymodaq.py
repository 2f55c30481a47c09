"""``examples/daq_move_Dbo.py`` in a running dashboard of PyMoDAQ, without a screen."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import SMALL_MODEL

pytest.importorskip("pymodaq", exc_type=ImportError)
ROOT = Path(__file__).resolve().parents[2]
PACKAGE = "pymodaq_plugins_lab"


def installed_plugin(folder: Path) -> None:
    """Write a plug-in package of the two files, as its installation would leave it."""
    plugins = folder / PACKAGE / "daq_move_plugins"
    plugins.mkdir(parents=True)
    (folder / PACKAGE / "__init__.py").write_text("")
    # The dashboard asks for the folder; the two files import each other by their names.
    (plugins / "__init__.py").write_text(
        "import sys\nfrom pathlib import Path\n\npath = Path(__file__)\nsys.path.append(str(path.parent))\n"
    )
    for name in ("daq_move_Dbo.py", "piezo_axis.py"):
        shutil.copy(ROOT / "examples" / name, plugins)
    facts = folder / f"{PACKAGE}-1.0.dist-info"
    facts.mkdir()
    (facts / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {PACKAGE}\nVersion: 1.0\n"
    )
    entry = f"lab = {PACKAGE}\n"
    (facts / "entry_points.txt").write_text(
        f"[pymodaq.instruments]\n{entry}\n[pymodaq.plugins]\n{entry}"
    )


def test_a_dashboard_moves_an_actuator(tmp_path: Path) -> None:
    installed_plugin(tmp_path)
    (tmp_path / "model.json").write_text(json.dumps(SMALL_MODEL))
    (tmp_path / "home").mkdir()
    environment = os.environ | {
        "QT_QPA_PLATFORM": "offscreen",
        "HOME": str(tmp_path / "home"),
        "PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}",
    }
    words = [
        sys.executable,
        str(ROOT / "tests" / "extras" / "pymodaq_bench.py"),
        "model.json",
        "result.json",
    ]
    done = subprocess.run(
        words,
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    result = json.loads((tmp_path / "result.json").read_text())
    assert "failed" not in result, f"{result}\n{done.stdout}{done.stderr}"
    # um: of 5 um and of 2500 nm
    assert result["places"] == pytest.approx([5.0, 2.5], abs=1e-9)
