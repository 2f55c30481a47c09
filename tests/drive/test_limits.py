from __future__ import annotations

import math

import numpy as np
import pytest

from dbo_cli.drive.limits import Gate, GateError, Limits
from dbo_cli.errors import InputError, LimitError, UsageError
from dbo_cli.model import Quantity

RANGE = Quantity("voltage", "V", 0.236, 3.424)


def test_two_ranges() -> None:
    limits = Limits.within(RANGE, 0, 5)
    assert limits.rating == (0.0, 5.0)
    assert limits.move == (0.236, 3.424)
    assert Limits.within(RANGE).rating == (0.236, 3.424)
    assert Limits.within(RANGE, v_min=1).rating == (1.0, 3.424)
    assert Limits.within(RANGE, v_max=1.5).move == (0.236, 1.5)
    wide = Limits.within(RANGE, -1, 5, extrapolate=True)
    assert wide.move == wide.rating == (-1.0, 5.0)


@pytest.mark.parametrize(
    ("v_min", "v_max", "slew"),
    [
        (4, None, None),
        (None, 0.1, None),
        (2, 1, None),
        (math.nan, None, None),
        (None, math.inf, None),
        (None, None, 0),
        (None, None, -5),
        (None, None, math.nan),
        ("two", None, None),
    ],
)
def test_limits_that_are_none(v_min: object, v_max: object, slew: object) -> None:
    with pytest.raises(UsageError):
        Limits.within(RANGE, v_min, v_max, slew)  # type: ignore[arg-type]


def test_extrapolation_needs_an_end() -> None:
    with pytest.raises(UsageError):
        Limits.within(RANGE, extrapolate=True)


def test_units_of_limits() -> None:
    limits = Limits.within(RANGE, "500mV", "3V", "2V/ms")
    assert limits.rating == (0.5, 3.0)
    assert limits.slew == pytest.approx(2000.0)
    kilo = Quantity("voltage", "kV", 0.0, 1.0)
    assert Limits.within(kilo, v_max="800V").rating[1] == pytest.approx(0.8)
    with pytest.raises(UsageError, match="800kV"):
        Limits.within(kilo, v_max=800)
    with pytest.raises(UsageError, match="kV/s"):
        Limits.within(kilo, max_slew=2)
    bar = Quantity("pressure", "bar", 0.0, 6.0)
    assert Limits.within(bar, 0, 5, 2).slew == 2.0


def test_limits_made_by_hand_are_looked_at() -> None:
    for move, slew in (((-1.0, 3.0), None), ((2.0, 1.0), None), ((0.0, 1.0), math.nan)):
        with pytest.raises(UsageError):
            Limits((0.0, 5.0), move, (0.0, 5.0), slew)


def test_start_inside_the_rating_and_outside_the_move() -> None:
    Limits.within(RANGE, 0, 5).require_start(0.0, "`from_`")
    with pytest.raises(LimitError, match="v_min"):
        Limits.within(RANGE).require_start(0.0, "`from_`")


def broken(
    voltage: list[float], limits: Limits, last: float | None = None, phase: str = "move"
) -> list[bool]:
    return Gate(limits, last).broken(np.array(voltage), 0.1, phase).tolist()


def test_gate_of_ranges() -> None:
    limits = Limits.within(RANGE, 0, 5)
    rows = [0.0, 0.236, 3.424, 3.4241, math.nan, math.inf, -math.inf]
    assert broken(rows, limits) == [True, False, False, True, True, True, True]
    assert broken(rows, limits, phase="lead") == [
        False,
        False,
        False,
        False,
        True,
        True,
        True,
    ]
    assert broken([5.0, 5.0001, -1e-9], limits, phase="return") == [False, True, True]


def test_gate_of_slew_counts_every_step() -> None:
    limits = Limits.within(RANGE, 0, 5, 10)
    assert broken([0.5, 1.5, 2.5, 1.4], limits) == [False, False, False, True]
    assert broken([2.0, 2.0], limits, last=0.9) == [True, False]
    assert broken([1.9], limits, last=0.9) == [False]
    gate = Gate(limits, 1.0)
    assert not gate.broken(np.array([1.5]), np.array([0.05])).any()
    assert gate.broken(np.array([2.0]), np.array([0.04])).all()
    assert gate.last == 2.0


def test_gate_needs_a_clock_for_slew() -> None:
    with pytest.raises(InputError):
        Gate(Limits.within(RANGE, max_slew=1)).broken(np.array([1.0]), None)


def test_gate_refuses() -> None:
    gate = Gate(Limits.within(RANGE, 0, 5))
    gate.admit(np.array([0.0, 5.0]), None, "lead")
    with pytest.raises(GateError, match="report it"):
        gate.admit(np.array([1.0, 3.5]), None)
