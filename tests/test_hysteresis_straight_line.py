"""The straight line that a model must beat."""

from __future__ import annotations

import numpy as np
import pytest

from dbo_cli.hysteresis.identification import Recording
from dbo_cli.hysteresis.identification.evaluation import straight_line
from dbo_cli.hysteresis.identification.preparation import prepare


@pytest.mark.parametrize("displacement_offset", [0.0, 1e7])
@pytest.mark.parametrize("voltage_offset", [0.0, 1e6, -1e9])
def test_a_straight_line_fits_as_well_far_from_zero(
    voltage_offset: float, displacement_offset: float
) -> None:
    time = np.arange(4000) / 100.0
    voltage = np.sin(2.0 * time)
    displacement = 3.0 * voltage + np.random.default_rng(0).normal(0.0, 0.1, 4000)
    far = Recording(
        "far", voltage + voltage_offset, displacement + displacement_offset, time, None
    )
    prepared = prepare([far], 0.0)
    rows = prepared.logs[0].used
    columns = np.column_stack([voltage[rows], prepared.logs[0].drift[rows]])
    target = displacement[rows]
    left = target - columns @ np.linalg.lstsq(columns, target, rcond=None)[0]
    assert straight_line(far, prepared.logs[0]) == pytest.approx(
        float(np.sqrt(np.mean(left**2))), rel=1e-5
    )
