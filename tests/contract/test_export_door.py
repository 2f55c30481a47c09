"""An export replaces an export of any arithmetic, and names the key of the file where it refuses."""

from __future__ import annotations

from pathlib import Path

import pytest

from dbo_cli.model import Cascade, Gears, Quantity

from .program import done, model, refused

WORDS = ("--sample-rate", 1000, "-q", "-o", "firmware")


def files() -> set[str]:
    return {path.name for path in Path("firmware").iterdir()}


def test_an_export_replaces_one_of_another_arithmetic_and_name() -> None:
    done("export", model("creep"), "--arithmetic", "q31", "--name", "old", *WORDS)
    fixed = files()
    done("export", model("creep"), *WORDS)
    assert "old.c" in fixed and "old.c" not in files()
    done("export", model("creep"), "--arithmetic", "q31", "--name", "old", *WORDS)
    assert files() == fixed
    Path("firmware/notes.txt").write_text("mine")
    assert "notes.txt" in refused(1, "export", model("creep"), *WORDS)


@pytest.mark.parametrize(
    ("name", "words", "key"),
    [
        ("soft", ["--arithmetic", "q31"], "relaxation.gain"),
        ("creep", ["--lookup", "--gears", 12], "relaxation"),
        ("creep", ["--lookup"], "dx"),
    ],
)
def test_a_refusal_names_file_and_key(name: str, words: list[object], key: str) -> None:
    said = refused(1, "export", model(name), *words, *WORDS)
    assert f"{name}.json: stages[" in said
    assert f"].{key}: " in said


def test_a_start_ends_where_the_range_is_small_beside_the_gears_origin() -> None:
    """Halving 0.1 V at 1000 V comes to neighbours in float64 before it comes to the tolerance."""
    gears = Gears([0.01] * 10, [0.1 + 0.02 * k for k in range(10)], 1000.0, 0.0)
    drive = Quantity("voltage", "V", 1000.0, 1000.1)
    actuator = Cascade("forward", drive, Quantity("x", "um", 0.0, 1.9), (gears,))
    for k in range(40):
        start = actuator.start_drive(0.05 * k, "auto", 1000.0, 1000.1)
        assert start.first is not None
        assert 1000.0 <= start.first <= 1000.1
