"""The table of operators: what is counted, and what is said of a refusal."""

import dbo_cli.model as dm
from dbo_cli.compare import compared_text
from dbo_cli.compare.compare import KEYS, DboModel


def test_the_numbers_of_the_dbo_are_counted():
    memory = dm.Relaxation(0.0, (0.1, 1.0), (0.01, 0.01))
    gears = dm.Gears([1.0, 2.0, 3.0], [1.0, 2.0, 6.0], 0.0, 0.0, memory)  # two slopes
    points = dm.Points([3.0, 3.0, 3.0], [2.0, 3.0, 4.0])
    moving = dm.Dynamics((dm.Lag(1e-3), dm.Resonance(100.0, 0.1, dm.Mode(80.0, 0.1))))
    stages = (gears, points, dm.Scale(2.0, 1.0), moving, dm.Delay(0.1))
    voltage, reach = (dm.Quantity("x", "V", 0.0, end) for end in (6.0, 9.0))
    model = DboModel(dm.Cascade("forward", voltage, reach, stages))
    # slopes, offset, delay, memories, knots, a lag and two modes
    assert model.parameters == 2 + 1 + 1 + 2 + 2 + 1 + 4


def test_a_table_of_refusals_is_a_table():
    row = dict.fromkeys(KEYS) | {"name": "pi", "words": "plays", "refused": "no"}
    content = {"logs": ["a"], "validation": [], "unit": None, "models": [row]}
    text = compared_text(content)
    assert "note: pi: no" in text
