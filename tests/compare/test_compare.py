"""The whole table: the DBO and its rivals on one log, judged on another."""

from __future__ import annotations

import numpy as np
import pytest

from dbo_cli.compare import OperatorTable, Row, compare
from dbo_cli.compare.compare import DboModel
from dbo_cli.identification import Recording
from dbo_cli.model import (
    Cascade,
    Delay,
    Dynamics,
    Gears,
    Lag,
    Mode,
    Points,
    Quantity,
    Relaxation,
    Resonance,
    Scale,
)

NAMES = ["dbo", "line", "pi", "modified", "rate", "extended", "asymmetric"]


def log(name, decay):
    """Plays under a sine that fades from the whole range, come down to its lower end."""
    time = np.arange(1500) / 200.0
    drive = 50.0 - 50.0 * np.exp(-time / decay) * np.cos(2.0 * np.pi * time)
    places = np.empty((len(drive), 8))
    for k, radius in enumerate(np.linspace(0.0, 35.0, 8)):
        state = float(drive[0]) + radius
        for row, value in enumerate(drive):
            state = min(max(state, value - radius), value + radius)
            places[row, k] = state
    y = 0.5 * drive + places @ np.full(8, 0.06)
    y = y + 0.01 * np.random.default_rng(7).standard_normal(len(y))
    return Recording(name, drive, y, time)


@pytest.fixture(scope="module")
def table():
    return compare([log("a.csv", 5.0)], [log("b.csv", 2.0)])


def test_every_operator_has_a_row(table):
    assert [row.name for row in table.rows] == NAMES
    rows = {row.name: row for row in table.rows}
    for row in table.rows:
        assert row.refused is None
        assert row.rmse > 0.0 and row.expected_rmse > 0.0
        assert row.validation_rmse > 0.0 and row.parameters > 1
        assert row.forward_ns > 0.0 and row.inverse_ns > 0.0
    line = rows["line"].validation_rmse
    assert rows["dbo"].validation_rmse < line
    # the plant is of plays
    for name in NAMES[2:]:
        assert rows[name].validation_rmse < 0.05 * line
        assert rows[name].rmse == pytest.approx(0.01, rel=0.2)
        assert rows[name].rmse <= rows[name].expected_rmse < 3.0 * rows[name].rmse


def test_the_numbers_of_the_dbo_are_counted():
    memory = Relaxation(0.0, (0.1, 1.0), (0.01, 0.01))
    gears = Gears([1.0, 2.0, 3.0], [1.0, 2.0, 6.0], 0.0, 0.0, memory)  # two slopes
    points = Points([3.0, 3.0, 3.0], [2.0, 3.0, 4.0])
    moving = Dynamics((Lag(1e-3), Resonance(100.0, 0.1, Mode(80.0, 0.1))))
    stages = (gears, points, Scale(2.0, 1.0), moving, Delay(0.1))
    sides = (Quantity("voltage", "V", 0.0, 6.0), Quantity("displacement", "um", 0, 9))
    model = DboModel(Cascade("forward", *sides, stages))
    # slopes, offset, delay, memories, knots, a lag and two modes
    assert model.parameters == 2 + 1 + 1 + 2 + 2 + 1 + 4


def test_a_table_of_refusals_is_a_table():
    text = OperatorTable((Row("pi", "plays", refused="no"),), None, ("a",)).text()
    assert "note: pi: no" in text
