"""The table of sentences, of files: clocks, columns, and drives that were played otherwise.

Each row is what is said of a log in which something is the matter, and its figures
there; ``test_silent`` holds that none of it is said of the same log with nothing the
matter. More stand in ``test_sentences.py``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

ROWS, STEP = 400, 0.01
CLOCK = STEP * np.arange(ROWS)
WANTED = 5.0 - 4.0 * np.cos(np.pi * CLOCK)
MEASURED = WANTED + 0.01 * np.sin(np.arange(ROWS))
HEAD = "time_s,desired_um,measured_um"


def written(
    name: str, columns: Sequence[Any], head: str = HEAD, end: str = "\n"
) -> str:
    rows = zip(*(column.tolist() for column in columns), strict=True)
    lines = "\n".join(",".join(repr(value) for value in row) for row in rows)
    Path(name).write_text(f"{head}\n{lines}{end}")
    return name


def clocked(change: Callable[[Any], Any]) -> Callable[[], str]:
    """Return what writes the log with another clock."""
    return lambda: written("run.csv", [change(CLOCK.copy()), WANTED, MEASURED])


def from_row_200(clock: Any, by: float) -> Any:
    clock[200:] += by
    return clock


def repeated(clock: Any) -> Any:
    clock[200] = clock[199]
    return clock


def in_nanometres() -> str:
    return written(
        "run.csv", [CLOCK, WANTED, 1000.0 * MEASURED], "time_s,desired_um,measured_nm"
    )


def in_furlongs() -> str:
    return written(
        "run.csv",
        [CLOCK, WANTED, MEASURED],
        "time_s,desired (furlong),measured (furlong)",
    )


def cut() -> str:
    return written("run.csv", [CLOCK, WANTED, MEASURED], end="")


def with_a_word() -> str:
    written("run.csv", [CLOCK, WANTED, MEASURED])
    lines = Path("run.csv").read_text().split("\n")
    lines[50] = "0.49,overload,3.0"
    Path("run.csv").write_text("\n".join(lines))
    return "run.csv"


def clean() -> str:
    return written("run.csv", [CLOCK, WANTED, MEASURED])


class Sentence(NamedTuple):
    """What is said (a pattern), the log, what its groups must be, and further words of the command line."""

    pattern: str
    case: Callable[[], str]
    true: Sequence[Any] = ()
    words: Sequence[str] = ()


TABLE = [
    Sentence(
        r"run\.csv: a gap at line (\d+) \(from (\S+) s to (\S+) s, usual step (\S+) s\)",
        clocked(lambda clock: from_row_200(clock, 0.5)),
        (202, 1.99, 2.5, STEP),
    ),
    Sentence(
        r"run\.csv: time goes backwards at line (\d+) \(from (\S+) s to (\S+) s\)",
        clocked(lambda clock: from_row_200(clock, -0.5)),
        (202, 1.99, 1.5),
    ),
    Sentence(
        r"run\.csv: the clock starts again at line (\d+) \(from (\S+) s to (\S+) s\)",
        clocked(lambda clock: from_row_200(clock, -2.0)),
        (202, 1.99, 0.0),
    ),
    Sentence(
        r"run\.csv: the time stamp (\S+) s repeats at line (\d+)",
        clocked(repeated),
        (1.99, 202),
    ),
    Sentence(
        r"run\.csv: time steps vary from (\S+) s to (\S+) s \(usual step (\S+) s\)",
        clocked(lambda clock: clock + 0.002 * np.sin(np.arange(ROWS))),
        (
            pytest.approx(STEP - 0.004 * np.sin(0.5), rel=1e-3),
            pytest.approx(STEP + 0.004 * np.sin(0.5), rel=1e-3),
            STEP,
        ),
    ),
    Sentence(
        r"run\.csv: (\d+) rows, (\S+) s at (\d+) samples/s",
        clocked(lambda clock: 2.0 * clock),
        (ROWS, 7.98, 50),
    ),
    Sentence(
        r"run\.csv: --sample-rate replaces the column 'time_s'",
        clean,
        (),
        ("--sample-rate", "50"),
    ),
    Sentence(
        r"run\.csv: column 'desired_um' is converted from um to nm", in_nanometres
    ),
    Sentence(
        r"the unit 'furlong' of column '\w+ \(furlong\)' is not known and carried as it is",
        in_furlongs,
    ),
    Sentence(
        r"run\.csv:(\d+): the last line has no line end: was the record cut there\?",
        cut,
        (401,),
    ),
    Sentence(
        r"run\.csv:(\d+): column 'desired_um' is not a number: 'overload': (\d+) row dropped",
        with_a_word,
        (51, 1),
        ("--skip-bad",),
    ),
]


@pytest.mark.parametrize("row", TABLE, ids=[row.pattern[:48] for row in TABLE])
def test_what_is_said_of_a_log_is_so(row: Sentence, whole_dbo: Any) -> None:
    done = whole_dbo("report", row.case(), *row.words)
    assert done.code == 0, done.err
    found = re.search(row.pattern, done.err)
    assert found is not None, done.err
    assert [float(text.replace(",", "")) for text in found.groups()] == list(row.true)


def test_silent_where_nothing_is_the_matter(whole_dbo: Any) -> None:
    said = whole_dbo("report", clean()).err
    assert "400 rows, 3.99 s at 100 samples/s" in said
    of_every_log = TABLE[5]
    assert not [
        row.pattern
        for row in TABLE
        if row is not of_every_log and re.search(row.pattern, said)
    ]


def test_the_error_of_a_converted_column_is_in_the_unit_that_is_said(
    whole_dbo: Any,
) -> None:
    error = float(np.sqrt(np.mean((MEASURED - WANTED) ** 2)))
    for case, factor, unit in ((in_nanometres, 1000.0, "nm"), (clean, 1.0, "um")):
        found = re.match(r"run\.csv: (\S+) (\w+) RMSE", whole_dbo("report", case()).out)
        assert found is not None
        assert (float(found[1]), found[2]) == (
            pytest.approx(factor * error, rel=0.01),
            unit,
        )


# --- what was played beside what was to be played ---

PLAN = 50.0 - 35.0 * np.cos(np.pi * CLOCK) * np.linspace(1.0, 0.6, ROWS)


def played(volts: Any, clock: Any = CLOCK) -> str:
    return written("played.csv", [clock, volts], "time_s,voltage_V")


TOP = 78.0

PLAYED = [
    (
        lambda: played(1.02 * PLAN + 0.5),
        r"differs by up to (\S+) V, more than .* \(gain (\S+) and offset (\S+) V explain all",
        (pytest.approx(0.02 * PLAN.max() + 0.5, rel=1e-3), 1.02, 0.5),
    ),
    (
        lambda: played(np.minimum(PLAN, TOP)),
        r"differs by up to (\S+) V, .*it is the drive cut off at (\S+) V: a limit of the amplifier",
        (pytest.approx(PLAN.max() - TOP, rel=1e-3), TOP),
    ),
    (
        lambda: played(PLAN[::2], CLOCK[:200]),
        r"the drive was played (\S+) times as fast",
        (2,),
    ),
    (
        lambda: played(PLAN[:300], CLOCK[:300]),
        r"(\d+) of (\d+) rows were not played",
        (100, ROWS),
    ),
    (
        lambda: played(np.random.default_rng(1).uniform(15.0, 85.0, ROWS)),
        r"what was played is another drive: the two have nothing in common",
        (),
    ),
]


@pytest.mark.parametrize(
    ("case", "pattern", "true"), PLAYED, ids=["gain", "cut", "fast", "short", "other"]
)
def test_what_is_said_of_a_drive_that_was_played_is_so(
    case: Any, pattern: str, true: Any, dbo: Any
) -> None:
    written("plan.csv", [CLOCK, PLAN], "time_s,voltage_V")
    done = dbo("check", case(), "--against", "plan.csv")
    found = re.search(pattern, done.out)
    assert done.code == 3
    assert found is not None, done.out
    assert [float(text) for text in found.groups()] == list(true)


def test_of_the_drive_itself_nothing_is_said(dbo: Any) -> None:
    written("plan.csv", [CLOCK, PLAN], "time_s,voltage_V")
    done = dbo("check", played(PLAN), "--against", "plan.csv")
    assert (done.code, done.out.splitlines()[0]) == (0, "played.csv: passed")
    assert not [pattern for _, pattern, _ in PLAYED if re.search(pattern, done.out)]
