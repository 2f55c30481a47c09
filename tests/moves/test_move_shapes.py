"""Moves: their places, speeds and seams, and what a model does not reach."""

import numpy as np
import pytest

from dbo_cli.errors import UsageError
from dbo_cli.model import Cascade, Dynamics, Gears, Quantity, Resonance, Scale
from dbo_cli.moves import check_reach, trajectory

RATE = 1000.0
ENDS = (2.0, 8.0)


def actuator(low=0.0, high=10.0, dynamics=()):
    gears = Gears(np.full(10, 10.0), np.full(10, (high - low) / 10.0))
    stages = (gears, Scale(1.0, low), *dynamics)
    voltage = Quantity("voltage", "V", 0.0, 100.0)
    reached = Quantity("displacement", "um", low, high)
    return Cascade("forward", voltage, reached, stages)


def test_a_move_is_trusted_to_a_third_of_the_lowest_resonance():
    swinging = Dynamics((Resonance(900.0, 0.02), Resonance(300.0, 0.02)))
    assert actuator(dynamics=(swinging,)).trusted_frequency == pytest.approx(100.0)
    assert actuator().trusted_frequency is None


def test_each_axis_has_its_own_model():
    made = trajectory("raster", rate=RATE, range=ENDS, frequency=5.0, lines=3)
    check_reach(made, [actuator(), actuator(2.0, 8.0)])
    for model in (actuator(3.0, 9.0), actuator(1.0, 7.0)):
        with pytest.raises(UsageError, match="`range`"):
            check_reach(made, [actuator(), model])


@pytest.mark.parametrize(("shape", "largest"), [("triangle", 19.23), ("raster", 35.7)])
def test_the_frequency_that_a_refusal_proposes_fits(shape, largest):
    more = {"lines": 4} if shape == "raster" else {}
    trajectory(shape, rate=RATE, range=ENDS, bandwidth=40.0, frequency=largest, **more)
