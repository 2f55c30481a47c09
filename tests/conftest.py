"""What several test modules share: running the program in this process, and small models and logs."""

from __future__ import annotations

import contextlib
import gc
import hashlib
import json
import os
import pickle
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import pytest

# As the program itself does: threads only wait for each other in the many small
# factorisations.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

ROOT = Path(__file__).resolve().parent.parent
CACHED_CC = Path(__file__).with_name("cached_cc.py")
sys.path.insert(0, str(ROOT / "sample_data"))
# their tests share fixtures with those of the core
sys.path.insert(0, str(ROOT / "tests" / "extras"))

SMALL_MODEL: dict[str, Any] = {
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


def pytest_configure(config: pytest.Config) -> None:
    """Let all workers, and later runs, share compiled objects in one folder (``cached_cc.py``)."""
    if (
        "DBO_TEST_OBJECTS" not in os.environ
        and os.name == "posix"
        and shutil.which("gcc")
    ):
        folder = objects_folder(config)
        os.environ["DBO_TEST_OBJECTS"] = str(folder)
        # this Python, found before, and without its site
        compiler = folder / "cc"
        fresh = folder / f"cc.{os.getpid()}"
        fresh.write_text(
            f'#!/bin/sh\nexec "{sys.executable}" -SE "{CACHED_CC}" "$@"\n',
            encoding="utf-8",
        )
        fresh.chmod(0o700)
        fresh.replace(compiler)
        os.environ["CC"] = str(compiler)


def objects_folder(config: pytest.Config) -> Path:
    """Return a folder for the objects of this compiler; what no run of a month used is gone.

    It is pytest's own cache (``pytest --cache-clear`` empties it), or, without one, a
    folder of this run.
    """
    if not hasattr(config, "cache"):  # -p no:cacheprovider
        temporary = tempfile.TemporaryDirectory(prefix="dbo-objects-")
        config.add_cleanup(temporary.cleanup)
        return Path(temporary.name)
    compiler = subprocess.run(["gcc", "-v"], capture_output=True, check=True).stderr
    folder = config.cache.mkdir(f"objects-{hashlib.sha256(compiler).hexdigest()[:16]}")
    oldest = time.time() - 30 * 86400.0
    for kept in folder.iterdir():
        with contextlib.suppress(FileNotFoundError):  # another run removed it
            if kept.stat().st_mtime < oldest:
                kept.unlink()
    return folder


@pytest.fixture
def identified_once(monkeypatch: pytest.MonkeyPatch, known_models: Path) -> None:
    """Identify the same logs with the same options once in a run of the suite, whichever worker comes first.

    For tests of what is done with a model. Those of identification itself do without.
    """
    from dbo_cli.runs import identifying

    identify = identifying.identify_model

    def known_or_identified(*arguments: Any) -> Any:
        key = hashlib.sha256(pickle.dumps(arguments)).hexdigest()
        file = known_models / f"{key}.pickle"
        if not file.exists():
            fresh = file.with_suffix(f".{os.getpid()}")
            fresh.write_bytes(pickle.dumps(identify(*arguments)))
            fresh.replace(file)
        return pickle.loads(file.read_bytes())

    monkeypatch.setattr(identifying, "identify_model", known_or_identified)


@pytest.fixture(scope="session")
def known_models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder that all workers of this run share."""
    own = tmp_path_factory.getbasetemp()
    folder = (
        own.parent if "PYTEST_XDIST_WORKER" in os.environ else own
    ) / "known-models"
    folder.mkdir(exist_ok=True)
    return folder


def pytest_collection_finish() -> None:
    """Leave what was collected, and the libraries, out of every later search for garbage."""
    gc.freeze()
    # what a test makes goes as it ends, without a search
    gc.set_threshold(20_000, 20, 20)


class Outcome(NamedTuple):
    """How one run of the program ended."""

    code: int
    out: str
    err: str


READ = re.compile(
    r"^dbo: (?!error|warning).*: ([\d,]+ rows?[,;]|no time;|time ').*\n", re.MULTILINE
)
"""The line that says what was read of a log, which stands before everything else a command says."""


@pytest.fixture
def whole_dbo(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Any:
    """Return a function that runs one command line inside an empty folder and returns its outcome."""
    from dbo_cli.cli.app import main

    monkeypatch.chdir(tmp_path)

    def run(*words: object) -> Outcome:
        code = main([str(word) for word in words])
        captured = capsys.readouterr()
        return Outcome(code, captured.out, captured.err)

    return run


@pytest.fixture
def dbo(whole_dbo: Any) -> Any:
    """Return the same, the lines that say what was read left out of what is said."""

    def run(*words: object) -> Outcome:
        done = whole_dbo(*words)
        return done._replace(err=READ.sub("", done.err))

    return run


@pytest.fixture
def model_file(tmp_path: Path) -> Path:
    """Return a small, hand-made forward model in the working folder."""
    path = tmp_path / "model.json"
    path.write_text(json.dumps(SMALL_MODEL))
    return path


@pytest.fixture
def blank_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave figures empty, for tests of which there are and where they stand."""
    monkeypatch.setattr("dbo_cli.reports.drawing._painted", lambda *_, **__: None)
    monkeypatch.setattr("dbo_cli.reports.drawing._saved", lambda *_: b"<svg >")


def folder_content(folder: Path) -> set[str]:
    """Return the names of everything in a folder, so that litter is seen."""
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}
