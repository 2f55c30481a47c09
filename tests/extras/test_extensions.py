"""The table where core and extras meet: what is there, what is not, and what another package brings."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dbo_cli import extensions
from dbo_cli.errors import UsageError
from dbo_cli.extensions import OWN, Extra

ROOT = Path(__file__).resolve().parents[2]
LAB = ROOT / "examples" / "lab_extra"


def test_every_place_in_the_table_has_what_it_says() -> None:
    for extra in OWN:
        assert extra.is_installed, extra.name
        for kind, things in extra.brings.items():
            for key in things:
                assert extensions.find(kind, key) is not None, (kind, key)


def test_every_folder_of_extras_is_in_the_table() -> None:
    folders = {
        path.parent.name for path in (ROOT / "dbo_cli" / "extras").glob("*/__init__.py")
    }
    assert folders == {extra.name for extra in OWN}


def test_a_part_that_is_not_installed_is_named(
    monkeypatch: pytest.MonkeyPatch, dbo: Any
) -> None:
    missing = Extra(
        "gone",
        "what this test is about",
        {"command": {"vanish": "dbo_cli.extras.gone:VANISH"}},
    )
    monkeypatch.setattr(extensions, "OWN", (*OWN, missing))
    said = (
        "'vanish' belongs to the part 'gone' (what this test is about), which this installation lacks "
        "(dbo_cli/extras/gone)"
    )
    with pytest.raises(UsageError) as refused:
        extensions.find("command", "vanish")
    assert str(refused.value) == said
    assert dbo("vanish", "x") == (2, "", f"dbo: error: {said}\n")
    assert extensions.find_installed("command", "vanish") is None
    assert "vanish" not in extensions.keys("command")


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Install the package of a laboratory into a folder, as ``pip install --target`` leaves it."""
    folder = tmp_path_factory.mktemp("lab")
    copy = folder / "source"
    shutil.copytree(LAB, copy)
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation",
               "--disable-pip-version-check", "--target", str(folder / "site"), str(copy)]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder / "site"


def run(lab: Path, script: str) -> subprocess.CompletedProcess[str]:
    """Run Python with the laboratory's package beside this program."""
    begin = f"import sys; sys.path.insert(0, {str(lab)!r}); from dbo_cli.cli.app import main\n"
    return subprocess.run(
        [sys.executable, "-c", begin + script],
        capture_output=True,
        text=True,
        check=False,
    )


def recording(path: Path, rate: float = 500.0) -> None:
    """Write the sample log as the laboratory's recorder would."""
    table = np.loadtxt(
        ROOT / "sample_data" / "identification.csv", delimiter=",", skiprows=1
    )
    path.write_bytes(
        b"REC1" + np.float64(rate).tobytes() + table[:, 1:3].astype("<f8").tobytes()
    )


def test_another_package_brings_a_reader_a_generator_a_command_and_a_name(
    lab: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    recording(Path("run.rec"))
    done = run(
        lab,
        "assert main(['identify', 'run.rec', '-o', 'model.json']) == 0\n"
        "assert main(['rest', 'model.json']) == 0\n"
        "assert main(['excite', '--v-max', '10', '--duration', '6', '-o', 'd.csv']) == 0\n"
        "assert main(['waveform', 'd.csv', '--to', 'lab-steps', '-o', 'd.steps']) == 0\n"
        "assert main(['--help']) == 0 and main(['rest', '--help']) == 0\n"
        "import dbo_cli; print(dbo_cli.millivolts(1.5))\n",
    )
    assert done.returncode == 0, done.stderr
    assert "run.rec: 5,786 rows, 11.6 s at 500 samples/s" in done.stderr
    assert "voltage 'voltage' (V), displacement 'displacement' (um)" in done.stderr
    assert "dbo: leave it at " in done.stderr
    assert (
        "  rest        Say at which voltage an actuator is left over night"
        in done.stdout
    )
    assert done.stdout.endswith("1500.0\n")
    steps = Path("d.steps").read_text().splitlines()
    drive = np.loadtxt("d.csv", delimiter=",", skiprows=1)[:, 1]
    assert [float(line.removeprefix("STEP ")) for line in steps] == drive.tolist()


def test_another_package_s_reader_refuses_in_one_line(
    lab: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("cut.rec").write_bytes(b"REC1" + bytes(13))
    done = run(lab, "assert main(['identify', 'cut.rec', '-o', 'model.json']) == 1")
    said = "cut.rec: no file of our recorder, or one that ends early (record it again)"
    assert (done.returncode, done.stderr) == (0, f"dbo: error: {said}\n")


def test_another_package_that_cannot_be_imported_is_named(tmp_path: Path) -> None:
    info = tmp_path / "broken-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: broken\nVersion: 1.0\n"
    )
    (info / "entry_points.txt").write_text(
        "[dbo_cli.extras]\nbroken = no_such_module:EXTRA\n"
    )
    done = run(tmp_path, "assert main(['vanish']) == 2")
    said = (
        "the extra 'broken' (no_such_module:EXTRA) cannot be imported: ModuleNotFoundError: "
        "No module named 'no_such_module'"
    )
    assert (done.returncode, done.stderr) == (0, f"dbo: error: {said}\n")
