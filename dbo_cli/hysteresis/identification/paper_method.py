"""Identification as in the paper's Section V: one cycle, K, X_0 and Y_0 by its rule, few gears, no lag.

K is the range of the cycle's output over that of its drive, Y_0 the output's minimum, X_0 the drive's; the
gears then map volts to volts. The paper does not say how its 25 gears were placed and fitted beyond "least
squares". Here their edges are spaced as a sine is in time, narrow where the drive turns. A turn inside a
gear retraces it; fitted to the one full cycle alone, so few gears therefore predict smaller loops badly (0.76
against 0.67 um on the authors' other log). So a fine operator is fitted to the cycle first, and the few gears
to what it does on the cycle and on the cycle shrunk about its middle. Slopes may only grow, so that the model
can be inverted.
"""

from __future__ import annotations

import numpy as np

from dbo_cli.errors import FitError
from dbo_cli.hysteresis.identification.normal_equations import Structure, solve
from dbo_cli.hysteresis.identification.recordings import Floats, Recording
from dbo_cli.hysteresis.identification.refinement import corners, zero_shift
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

GEARS = 25  # the paper's
SEGMENTS = 2  # on its cycle 1, 2, 4 fit to 0.38, 0.22, 0.23 um and leave 0.89, 0.90, 1.04 um on the other log
FINE = (64, 16)  # slopes, gears for each
SMOOTHNESS = 1e-11  # of the fine slopes; 1e-9 to 1e-13: 0.233 to 0.213 um on the cycle, 0.90 on the other log
SHRUNK = tuple(part / 20 for part in range(20, 5, -1))  # amplitudes, over the cycle's own; the first is it

CYCLE_WEIGHT = 10.0
"""Of the cycle's own amplitude, over each smaller one. On the authors' recordings, fit of the cycle and error
on their other log in um: 0.28 and 0.63 with 1, 0.22 and 0.67 with 10, 0.20 and 0.69 with 20 (theirs: 0.19 and
0.68)."""

LEAST_SLOPE = 0.3
"""Of the mean slope. After a turn, few gears of which the first is flat let the inverse jump: by up to 130 mV
between samples of a 1 Hz drive of 3.6 V with 0.1, by 70 with 0.3 (theirs: 55)."""


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
            f"{recording.name}: the displacement falls as the voltage rises; `method` paper knows positive "
            "gains only: use `method` least-squares"
        )
    x0, swing = float(voltage.min()), float(np.ptp(voltage))
    gain = float(np.ptp(displacement)) / swing
    y0 = float(displacement.min())
    basis = Basis(FINE[0], x0, x0 + swing, FINE[1])
    log = twice_over(recording, y0, gain * swing)
    fine, knots = _fine_heights(log, basis, max(SEGMENTS if segments is None else segments, 1))
    count = gears or GEARS
    edges = 0.5 - 0.5 * np.cos(np.pi * np.arange(count + 1) / count)
    widths = np.diff(edges) * swing
    heights = _few_heights(voltage, basis, fine, widths)
    stages: list[Stage] = [BacklashStage(widths, heights * swing, x0, 0.0)]
    parts = len(knots) - 1
    if parts > 1:
        stages.append(PointStage(np.diff(knots) * swing, np.full(parts, swing / parts), 0.0, 0.0))
    stages.append(ScaleStage(gain, y0 - zero_shift(recording, zero)))
    low, high = slow_output_range(stages, x0, x0 + swing)
    model = ActuatorModel(
        direction="forward",
        input=Quantity("voltage", recording.voltage_unit, x0, x0 + swing),
        output=Quantity("displacement", recording.displacement_unit, low, high),
        stages=tuple(stages),
    )
    return model, log


def _fine_heights(log: PreparedLog, basis: Basis, segments: int) -> tuple[Floats, Floats]:
    """Heights of the fine operator (a slope's gears together) and the corners of the asymmetry."""
    statistics = gather([log], basis, segments)
    gram, rows = statistics.total()
    solution = solve(gram, statistics.columns, Structure("growing", (), segments, SMOOTHNESS), rows)
    return solution.heights, corners(solution.knots, segments)


def _few_heights(cycle: Floats, basis: Basis, fine: Floats, widths: Floats) -> Floats:
    """Heights of gears of the given widths that do what the fine operator does, over all amplitudes.

    Each amplitude has an offset of its own. The first of two cycles of each only sets the state.
    """
    from scipy.optimize import nnls

    middle = 0.5 * (basis.low + basis.high)
    drive = np.concatenate([np.tile(middle + part * (cycle - middle), 2) for part in SHRUNK])
    judged = np.tile(np.repeat([False, True], len(cycle)), len(SHRUNK))
    operator = basis.operator()
    engaged, _ = operator.engagement(drive, operator.empty(), group_size=basis.split)
    target = (engaged @ fine)[judged]
    few = BacklashStage(widths, widths, basis.low, 0.0)
    parts, _ = few.engagement(drive, few.empty())
    shares = widths / basis.span
    floor = LEAST_SLOPE * shares
    growing = (parts * shares)[judged] @ np.tril(np.ones((len(widths), len(widths))))
    amplitude = np.repeat(np.eye(len(SHRUNK)), len(cycle), axis=0)
    table = np.hstack((growing, amplitude, -amplitude))
    weight = np.sqrt(np.repeat([CYCLE_WEIGHT] + [1.0] * (len(SHRUNK) - 1), len(cycle)))
    goal = weight * (target - parts[judged] @ floor)
    increments, _ = nnls(weight[:, None] * table, goal, maxiter=100 * table.shape[1])
    heights: Floats = floor + shares * np.cumsum(increments[: len(widths)])
    return heights
