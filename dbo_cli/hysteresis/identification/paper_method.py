"""Identification as in the paper's Section V: one cycle, K, X_0 and Y_0 by its rule, few even gears.

K is the range of the cycle's output over that of its drive, Y_0 the output's minimum, X_0 the drive's; the
gears then map volts to volts. The paper does not say how its gears were fitted beyond "least squares"; here
slopes may only grow, so that the model can be inverted, and the point operator is found together with them.
"""

from __future__ import annotations

import numpy as np

from dbo_cli.errors import FitError
from dbo_cli.hysteresis.identification.assembly import zero_shift
from dbo_cli.hysteresis.identification.normal_equations import Structure, solve
from dbo_cli.hysteresis.identification.recordings import Recording
from dbo_cli.hysteresis.identification.refinement import corners, invertible
from dbo_cli.hysteresis.identification.regressors import Basis
from dbo_cli.hysteresis.identification.statistics import PreparedLog, gather
from dbo_cli.hysteresis.model import (
    ActuatorModel,
    BacklashStage,
    PointStage,
    Quantity,
    ScaleStage,
    Stage,
    slow_output_range,
)

GEARS = 25
SEGMENTS = 4


def twice_over(recording: Recording, low: float, scale: float) -> PreparedLog:
    """Return the cycle played twice, the first time to bring the gears into the state in which it begins."""
    samples = len(recording.voltage)
    output = (recording.displacement - low) / scale
    return PreparedLog(
        recording.name,
        np.tile(recording.voltage, 2),
        np.tile(output, 2),
        None,
        np.repeat([-1, 0], samples),
        np.empty((2 * samples, 0)),
        "empty",
    )


def identify_as_in_paper(
    recording: Recording, gears: int | None, segments: int | None, zero: str | float
) -> tuple[ActuatorModel, PreparedLog]:
    """Identify from one cycle; returns the model and the cycle as it was fitted (played twice).

    Raises
    ------
    FitError
        The displacement falls where the voltage rises: the paper's rule takes K > 0.
    """
    voltage, displacement = recording.voltage, recording.displacement
    if float(np.cov(voltage, displacement)[0, 1]) < 0.0:
        raise FitError(
            f"{recording.name}: the displacement falls as the voltage rises; --method paper knows positive "
            "gains only: use --method least-squares"
        )
    x0, swing = float(voltage.min()), float(np.ptp(voltage))
    gain = float(np.ptp(displacement)) / swing
    y0 = float(displacement.min())
    basis = Basis(gears or GEARS, x0, x0 + swing)
    log = twice_over(recording, y0, gain * swing)
    fine = max(SEGMENTS if segments is None else segments, 1)
    while True:
        statistics = gather([log], basis, fine)
        gram, rows = statistics.total()
        solution = solve(gram, statistics.columns, Structure("growing", (), fine, 0.0), rows)
        knots = corners(solution.knots, fine)
        if fine == 1 or invertible(knots):
            break
        fine //= 2
    shift = zero_shift(recording, zero)
    widths = np.full(basis.gears, swing / basis.gears)
    stages: list[Stage] = [BacklashStage(widths, solution.heights * swing, x0, 0.0)]
    if fine > 1:
        stages.append(PointStage(np.diff(knots) * swing, np.full(fine, swing / fine), 0.0, 0.0))
    stages.append(ScaleStage(gain, y0 - shift))
    low, high = slow_output_range(stages, x0, x0 + swing)
    model = ActuatorModel(
        direction="forward",
        input=Quantity("voltage", recording.voltage_unit, x0, x0 + swing),
        output=Quantity("displacement", recording.displacement_unit, low, high),
        stages=tuple(stages),
    )
    return model, log
