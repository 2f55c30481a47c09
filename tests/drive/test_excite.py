"""A drive that identifies well keeps range and slew, begins and ends at rest, and goes over the range."""

import numpy as np
import pytest

from dbo_cli.drive.excite import excite
from dbo_cli.identification.recording import Swings
from dbo_cli.model.expect import longest_rest


def test_rests_and_slow_swings_grow_with_the_drive():
    """A move that holds for long, or goes slowly, is unlike a log of fast swings."""

    def longest(**words):
        time, voltage = excite(0, 100, **words)
        turns = Swings.of(voltage).turns
        rest = longest_rest(voltage, np.diff(time))
        return len(time) / 1000, rest, np.diff(time[turns]).max()

    assert longest() == pytest.approx((30.0, 0.5, 1.8), rel=0.05)
    assert longest(duration=600) == pytest.approx((600.0, 10.0, 28.0), rel=0.05)
    assert longest(rest=20)[:2] == pytest.approx((50.0, 20.5), rel=0.01)


def test_a_sweep_follows_in_the_middle():
    _, plain = excite(0, 100, sample_rate=20000)
    _, voltage = excite(0, 100, sample_rate=20000, sweep_to=1000, max_slew=1e6)
    sweep = voltage[plain.size :]
    assert sweep.size > 2 * 20000 and voltage[-1] == 0.0
    inner = sweep[len(sweep) // 3 : -len(sweep) // 3]
    assert np.abs(inner - 50).max() <= 1.0
