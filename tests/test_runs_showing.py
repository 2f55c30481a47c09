"""What `show` says of a model, and what is said of many files: the numbers, with their units."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from conftest import SMALL_MODEL

from dbo_cli.errors import InputError, Listener
from dbo_cli.hysteresis.model_file import read_model
from dbo_cli.runs.jobs import Outcome, Work, named, spread_line
from dbo_cli.runs.showing import as_text, contents


@pytest.fixture
def content(tmp_path: Path) -> dict[str, Any]:
    """Return what is in the small model."""
    file = tmp_path / "model.json"
    file.write_text(json.dumps(SMALL_MODEL))
    return contents(read_model(str(file)))


def shown(content: dict[str, Any], fit: dict[str, Any] | None = None) -> str:
    """Return in one line what is shown of a model with this fit."""
    content["fit"] = fit or {}
    return " ".join(as_text(content).split())


def test_creep_is_the_part_that_comes_late(content: dict[str, Any]) -> None:
    content["dynamics"] = [{"lag": 2.0, "lead": 1.9}]
    assert "creep of 5 % with 2 s" in shown(content)


def test_a_bent_drive_is_in_percent(content: dict[str, Any]) -> None:
    fit = {"loop_width_percent": 15.26, "slopes": "growing", "drive_bend": 0.053}
    assert "loop: 15.3 % of the model's range wide" in shown(content, fit)
    assert "growing slopes, drive bent by 5 %" in shown(content, fit)


@pytest.mark.parametrize("direction", ["forward", "inverse"])
def test_a_gain_is_displacement_over_drive(
    content: dict[str, Any], direction: str
) -> None:
    fit = {
        "gain": 1.2345678,
        "gain_uncertainty": 0.012,
        "scale_uncertainty_percent": 0.5,
    }
    content["direction"] = direction
    if direction == "inverse":
        content["input"], content["output"] = content["output"], content["input"]
    text = shown(content, fit)
    assert "gain: 1.23457 um/V from end to end" in text
    assert "standard uncertainty 0.012 um/V" in text
    assert "the displacement's scale is 0.5 %" in text


def test_eight_names_are_all_named_and_nine_are_counted() -> None:
    names = [f"c{number}" for number in range(1, 10)]
    assert named(names[:8]) == "c1, c2, c3, c4, c5, c6, c7, c8"
    assert named(names) == "c1, c2, c3, c4, c5, c6, c7, … 9 in all"


def test_nine_of_ten_are_below_a_round_figure() -> None:
    figures = [0.1, 3.0, 0.1, 3.0, 0.1, 3.0, 0.1, 0.1, 0.1, 7.0]
    percents = {f"c{number}": figure for number, figure in enumerate(figures, 1)}
    line = spread_line(percents, "channel", "error", {"c10": "a cable hangs"})
    assert line == ("error: 9 of 10 channels below 5 %; worst: c10, 7 %: a cable hangs")


class Heard(Listener):
    """Keeps what is said to be worked on."""

    def __init__(self) -> None:
        self.words: list[str] = []

    def working(self, what: str) -> None:
        self.words.append(what)


def test_the_job_at_work_is_counted_from_the_second_one_on() -> None:
    def fails() -> int:
        raise InputError("no rows")

    outcome, heard = Outcome(), Heard()
    jobs = [("a", lambda: 1), ("b", fails), ("c", lambda: 3)]
    work = Work(keep_going=True)
    done = outcome.good(jobs, work, "channel", 3, heard, keep=False)
    assert [job.value for job in done] == [1, 3]
    assert heard.words == ["channel 2 of 3", "channel 3 of 3"]
    assert outcome.failures == {"b": "no rows"}
    assert str(outcome.failure) == "1 of 3 channels failed (b): the others are written"
