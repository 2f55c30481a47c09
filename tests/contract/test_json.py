"""One strict reader of JSON for models, states, histories and summaries."""

from __future__ import annotations

import contextlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from .program import done, model, refused, table, write

KINDS = ("model", "state", "history", "summary")
HUGE = int("9" * 400)


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a good file of each kind."""
    folder = tmp_path_factory.mktemp("good")
    with contextlib.chdir(folder):
        make_files()
    return folder


@pytest.fixture
def files(good: Path, folder: Path) -> None:
    """Lay out a good file of each kind."""
    shutil.copytree(good, folder, dirs_exist_ok=True)


def make_files() -> None:
    """Write model, state, history and summary, and what they are read with."""
    time = np.arange(500) / 1000.0
    wish = 2.0 - np.cos(25.0 * time)
    write("wish.csv", "time_s,displacement_um", time, wish)
    shutil.copy(model("creep"), "model.json")
    words = ("compensate", "model.json", "wish.csv", "-o", "out.csv", "-q")
    done(*words, "--save-state", "state.json", "--summary", "summary.json")
    played = table("out.csv")
    rows = played["time_s"] >= 0.0
    columns = [played[name][rows] for name in ("time_s", "voltage_V", "desired_um")]
    write("track.csv", "time_s,voltage_V,measured_um", *columns)
    done(*words, "--tracked", "track.csv", "--history", "history.json")
    write("pair.csv", "time_s,desired_um,measured_um", time, wish, wish + 0.01)


READ = {
    "model": "show model.json",
    "state": "compensate model.json wish.csv --state state.json",
    "history": "compensate model.json wish.csv --tracked track.csv --history history.json",
    "summary": "report pair.csv --expected summary.json",
}
FIRST_NUMBER = {
    "model": ("input", "min"),
    "state": ("time",),
    "history": ("passes", 0, "rmse"),
    "summary": ("expected_rmse",),
}
POSITIVE = {**FIRST_NUMBER, "model": ("fit", "expected_rmse")}
"""A number of each that may not be negative; a state has none."""


def with_value(kind: str, path: tuple[Any, ...], value: Any) -> str:
    """Return the file with another value at a path."""
    content = json.loads(Path(f"{kind}.json").read_text())
    inner = content
    for key in path[:-1]:
        inner = inner.setdefault(key, {}) if isinstance(key, str) else inner[key]
    inner[path[-1]] = value
    return json.dumps(content)


@pytest.mark.parametrize("kind", KINDS)
def test_good_files_are_read(files: None, kind: str) -> None:
    done(*READ[kind].split())


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("value", [True, "1", 2, 1.0, None, HUGE])
def test_a_version_is_the_whole_number_1(files: None, kind: str, value: Any) -> None:
    spoil(kind, with_value(kind, ("version",), value), "version")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("value", [True, "0.1", HUGE, 1e61])
def test_a_number_is_a_number(files: None, kind: str, value: Any) -> None:
    path = FIRST_NUMBER[kind]
    spoil(kind, with_value(kind, path, value), str(path[-1]))


@pytest.mark.parametrize("kind", ["model", "history", "summary"])
@pytest.mark.parametrize("value", [-1.0, -1e-300])
def test_an_error_is_not_negative(files: None, kind: str, value: float) -> None:
    path = POSITIVE[kind]
    spoil(kind, with_value(kind, path, value), str(path[-1]))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("text", ["NaN", "-Infinity", "1e999", "9" * 5000])
def test_a_number_is_finite(files: None, kind: str, text: str) -> None:
    marked = with_value(kind, FIRST_NUMBER[kind], "HERE")
    spoil(kind, marked.replace('"HERE"', text), f"{kind}.json")


@pytest.mark.parametrize("kind", ["model", "state", "history"])
def test_no_key_is_unknown(files: None, kind: str) -> None:
    spoil(kind, with_value(kind, ("surprise",), 1), "surprise")


DAMAGE: dict[str, Callable[[str], str]] = {
    "empty": lambda text: "",
    "cut": lambda text: text[: len(text) // 2],
    "a list": lambda text: f"[{text}]",
    "nested": lambda text: "[" * 100_000,
    "doubled": lambda text: text.replace('"version":', '"version": 1, "version":', 1),
    "another format": lambda text: text.replace('"dbo-', '"dbo-dbo-', 1),
    "a tail": lambda text: text + "{}",
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("how", DAMAGE)
def test_damage_is_one_line(files: None, kind: str, how: str) -> None:
    spoil(kind, DAMAGE[how](Path(f"{kind}.json").read_text()), f"{kind}.json")


@pytest.mark.parametrize("kind", KINDS)
def test_bytes_that_are_no_text(files: None, kind: str) -> None:
    Path(f"{kind}.json").write_bytes(b"\xff\xfe{\x00}\x80")
    refused(1, *READ[kind].split())


def test_an_error_of_minus_nothing_is_nothing(files: None) -> None:
    Path("summary.json").write_text(with_value("summary", ("expected_rmse",), -0.0))
    outcome = done(*READ["summary"].split())
    assert "-0" not in outcome.out + outcome.err


def spoil(kind: str, text: str, held: str) -> None:
    """Read a file with this text; the refusal is a short line with the file and ``held``."""
    Path(f"{kind}.json").write_text(text)
    line = refused(1, *READ[kind].split())
    assert f"{kind}.json" in line and held in line and "Expecting" not in line, line
    assert len(line) < 200, line
