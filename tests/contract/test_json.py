"""One strict reader of JSON for models, states, histories and summaries."""

import contextlib
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from .program import MOVE, PAIR, done, load, model, refused, table, write

KINDS = ("model", "state", "history", "summary")
HUGE = int("9" * 400)


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """Make a good file of each kind."""
    folder = tmp_path_factory.mktemp("good")
    with contextlib.chdir(folder):
        make_files()
    return folder


@pytest.fixture
def files(good, folder):
    """Lay out a good file of each kind."""
    shutil.copytree(good, folder, dirs_exist_ok=True)


def make_files():
    """Write model, state, history and summary, and what they are read with."""
    time = np.arange(500) / 1000.0
    wish = 2.0 - np.cos(25.0 * time)
    write("wish.csv", MOVE, time, wish)
    shutil.copy(model("creep"), "model.json")
    words = ("compensate", "model.json", "wish.csv", "-o", "out.csv", "-q")
    done(*words, "--save-state", "state.json", "--summary", "summary.json")
    played = table("out.csv")
    rows = played["time_s"] >= 0.0
    columns = [played[name][rows] for name in ("time_s", "voltage_V", "desired_um")]
    write("track.csv", "time_s,voltage_V,measured_um", *columns)
    done(*words, "--tracked", "track.csv", "--history", "history.json")
    write("pair.csv", PAIR, time, wish, wish + 0.01)


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


def with_value(kind, path, value):
    """Return the file with another value at a path."""
    content = load(f"{kind}.json")
    inner = content
    for key in path[:-1]:
        inner = inner.setdefault(key, {}) if isinstance(key, str) else inner[key]
    inner[path[-1]] = value
    return json.dumps(content)


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_wrong_is_named_by_its_key(files, kind):
    """A version is the whole number 1, a number a number, and no key is unknown."""
    for value in (True, "1", 2, 1.0, None, HUGE):
        spoil(kind, with_value(kind, ("version",), value), "version")
    for value in (True, "0.1", HUGE, 1e61):
        path = FIRST_NUMBER[kind]
        spoil(kind, with_value(kind, path, value), str(path[-1]))
    for text in ("NaN", "-Infinity", "1e999", "9" * 5000):
        marked = with_value(kind, FIRST_NUMBER[kind], "HERE")
        spoil(kind, marked.replace('"HERE"', text), f"{kind}.json")
    for value in (-1.0, -1e-300):
        if kind != "state":
            path = POSITIVE[kind]
            spoil(kind, with_value(kind, path, value), str(path[-1]))
    if kind != "summary":
        spoil(kind, with_value(kind, ("surprise",), 1), "surprise")


DAMAGE = {
    "empty": lambda text: "",
    "cut": lambda text: text[: len(text) // 2],
    "a list": lambda text: f"[{text}]",
    "nested": lambda text: "[" * 100_000,
    "doubled": lambda text: text.replace('"version":', '"version": 1, "version":', 1),
    "another format": lambda text: text.replace('"dbo-', '"dbo-dbo-', 1),
    "a tail": lambda text: text + "{}",
}


@pytest.mark.parametrize("kind", KINDS)
def test_damage_is_one_line(files, kind):
    good = Path(f"{kind}.json").read_text()
    for damage in DAMAGE.values():
        spoil(kind, damage(good), f"{kind}.json")
    Path(f"{kind}.json").write_bytes(b"\xff\xfe{\x00}\x80")
    refused(1, *READ[kind].split())


def test_an_error_of_minus_nothing_is_nothing(files):
    Path("summary.json").write_text(with_value("summary", ("expected_rmse",), -0.0))
    outcome = done(*READ["summary"].split())
    assert "-0" not in outcome.out + outcome.err


def spoil(kind, text, held):
    """Read a file with this text; the refusal is a short line with the file and ``held``."""
    path = Path(f"{kind}.json")
    before = path.read_text()
    path.write_text(text)
    line = refused(1, *READ[kind].split())
    assert f"{kind}.json" in line and held in line and "Expecting" not in line, line
    assert len(line) < 200, line
    path.write_text(before)
