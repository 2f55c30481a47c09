import numpy as np
import pytest

from dbo_cli.drive.limits import Gate, Limits
from dbo_cli.errors import InputError, UsageError
from dbo_cli.model import Quantity

RANGE = Quantity("voltage", "V", 0.236, 3.424)


def test_units_of_limits():
    kilo = Quantity("voltage", "kV", 0.0, 1.0)
    assert Limits.within(kilo, v_max="800V").rating[1] == pytest.approx(0.8)
    with pytest.raises(UsageError, match="800kV"):
        Limits.within(kilo, v_max=800)
    with pytest.raises(UsageError, match="kV/s"):
        Limits.within(kilo, max_slew=2)
    bar = Quantity("pressure", "bar", 0.0, 6.0)
    assert Limits.within(bar, 0, 5, 2).slew == 2.0


def test_gate_needs_a_clock_for_slew():
    with pytest.raises(InputError):
        Gate(Limits.within(RANGE, max_slew=1)).broken(np.array([1.0]), None)
