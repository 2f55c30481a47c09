"""From equation error to output error: Gauss-Newton steps on what the model will be judged by.

The equation error asks S^-1 of the *measured* output, so the sensor's noise stands among the regressors and
counts differently where the asymmetry is steep. Here the asymmetry is a function of the *predicted* output.
For y = S(w), w = Gamma(v) + sum c L + w0, with S piecewise linear and given by where its knots X_k stand,

    dy = S'(w) (dw - sum_k hat_k(y) dX_k),

exactly on each segment, so that a step is the same bounded least-squares problem with other rows.
What was fitted becomes stages in the actuator's own units last.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dbo_cli.errors import FitError
from dbo_cli.hysteresis.identification.normal_equations import (
    SLOPE_FLOOR,
    Columns,
    Solution,
    Structure,
    least_squares,
    penalties,
    quadratic,
    solve,
    squared_error_free_of,
)
from dbo_cli.hysteresis.identification.preparation import Prepared
from dbo_cli.hysteresis.identification.recordings import Floats, Recording
from dbo_cli.hysteresis.identification.statistics import (
    FIT_ROWS,
    INDIFFERENCE,
    Basis,
    Linearise,
    PreparedLog,
    fewer_rows,
    gather,
    hat_functions,
)
from dbo_cli.hysteresis.model import (
    ActuatorModel,
    BacklashStage,
    DelayStage,
    PointStage,
    Quantity,
    Relaxation,
    ScaleStage,
    Stage,
    slow_output_range,
)
from dbo_cli.records import dataclass

STEPS = 4  # of Gauss and Newton: 2 left one of eight invented logs 5 % worse, 8 changed nothing


@dataclass(frozen=True)
class Fitted:
    """A fitted cascade in normalised terms: gears and memories, then the asymmetry, then offset and drift.

    ``origin`` is w0, the gears' output with all bits cleared; ``knots`` the corners of the asymmetry on its
    input axis, shape (segments + 1,), from 0 to 1; ``drift`` the output's drift coefficients of all logs in
    turn.
    """

    basis: Basis
    heights: Floats
    gains: Floats
    origin: float
    knots: Floats
    drift: Floats


def corners(deviation: Floats, segments: int) -> Floats:
    """Corners of the asymmetry on its input axis from the inner knots' deviation from the diagonal."""
    at = np.arange(segments + 1) / segments
    at[1:-1] += deviation
    return at


def asymmetry(w: Floats, knots: Floats) -> tuple[Floats, Floats]:
    """Output and slope of the piecewise-linear asymmetry at ``w``; the end segments go straight on."""
    segments = len(knots) - 1
    place = np.clip(np.searchsorted(knots, w, side="right") - 1, 0, segments - 1)
    slope = 1.0 / (segments * np.diff(knots))
    return place / segments + slope[place] * (w - knots[place]), slope[place]


def fit(logs: Sequence[PreparedLog], basis: Basis, structure: Structure) -> Fitted:
    """Solve the equation-error problem, prune memories, refine on the output error where that helps.

    What to prune and whether refining helps is found out on at most ``SELECTION_ROWS`` rows; the model itself
    is fitted to ``FIT_ROWS``.

    Raises
    ------
    FitError
        The solver failed.
    """
    some, logs = fewer_rows(logs), fewer_rows(logs, FIT_ROWS)
    fitted = _equation_error(some, basis, structure)
    kept = tuple(k for k in structure.memories if fitted.gains[k] > SLOPE_FLOOR * fitted.heights.sum())
    if kept != tuple(range(len(basis.time_constants))):
        basis = replace(basis, time_constants=tuple(basis.time_constants[k] for k in kept))
        structure = replace(structure, memories=tuple(range(len(kept))))
        fitted = _equation_error(some, basis, structure)
    helps = _refined(some, fitted, structure) is not None
    fitted = _equation_error(logs, basis, structure)
    refined = _refined(logs, fitted, structure) if helps else None
    return refined or _levelled(logs, fitted)


def _equation_error(logs: Sequence[PreparedLog], basis: Basis, structure: Structure) -> Fitted:
    """Solve the convex problem."""
    solution, _ = gather(logs, basis, structure.segments).solved(structure)
    knots = corners(solution.knots, structure.segments)
    return Fitted(basis, solution.heights, solution.gains, float(solution.drift[0]), knots, solution.drift)


def _rows_about(fitted: Fitted) -> Linearise:
    """Rows of the output-error problem, linearised about ``fitted``."""
    segments = len(fitted.knots) - 1
    known = np.concatenate((fitted.heights, fitted.gains))
    moved = fitted.knots[1:-1] - np.arange(1, segments) / segments

    def rows(drive: Floats, output: Floats) -> tuple[Floats, Floats]:
        from_drive = drive @ known
        predicted, slope = asymmetry(from_drive + fitted.origin, fitted.knots)
        hats = hat_functions(predicted, segments) * slope[:, None]
        target = output - predicted + slope * from_drive - hats @ moved
        return np.hstack((drive * slope[:, None], -hats)), target

    return rows


def _refined(logs: Sequence[PreparedLog], start: Fitted, structure: Structure) -> Fitted | None:
    """Gauss-Newton steps while they lower the penalised output error; None where they gain too little.

    Where noise is small beside what no model of this class can follow, the two errors differ by their
    weights alone and the convex problem's solution predicts as well or better; so a refined model must earn
    its place.
    """
    segments = len(start.knots) - 1
    if segments == 1:
        return None  # without an asymmetry the two errors are one
    first = best = np.inf
    found: Fitted | None = None
    current = start
    for _ in range(STEPS):
        statistics = gather(logs, current.basis, segments, _rows_about(current))
        gram, rows = statistics.total()
        vector, drift = _vector_of(current, statistics.columns)
        full = np.append(vector, -1.0)
        slopes, kinks = penalties(statistics.columns)
        form = rows * (structure.smoothness * slopes + structure.knot_smoothness * kinks)
        error = squared_error_free_of(gram, vector, drift) + quadratic(form, full)
        if error > best * (1.0 - 1e-4):  # chosen: what INDIFFERENCE would never notice
            break
        first = error if found is None else first
        best, found = error, _with_drift(current, gram, vector, drift)
        try:
            solution: Solution = solve(gram, statistics.columns, structure, rows)
        except FitError:
            break
        current = replace(
            current,
            heights=solution.heights,
            gains=solution.gains,
            knots=corners(solution.knots, segments),
            drift=solution.drift,
        )
    return found if best < (1.0 - INDIFFERENCE) * first else None


def _levelled(logs: Sequence[PreparedLog], fitted: Fitted) -> Fitted:
    """Return the same model with offset and drift taken from the output error."""
    statistics = gather(logs, fitted.basis, len(fitted.knots) - 1, _rows_about(fitted))
    gram, _ = statistics.total()
    return _with_drift(fitted, gram, *_vector_of(fitted, statistics.columns))


def _vector_of(fitted: Fitted, columns: Columns) -> tuple[Floats, slice]:
    """Return the unknowns as they are in ``fitted``, drift left at zero, and where the drift stands."""
    segments = len(fitted.knots) - 1
    deviation = fitted.knots[1:-1] - np.arange(1, segments) / segments
    vector = np.concatenate((fitted.heights, fitted.gains, deviation, np.zeros(columns.drift)))
    return vector, slice(columns.total - columns.drift, columns.total)


def _with_drift(fitted: Fitted, gram: Floats, vector: Floats, drift: slice) -> Fitted:
    """Return the same model with offset and drift fitted to what it leaves over."""
    full = np.append(vector, -1.0)
    return replace(fitted, drift=-least_squares(gram[drift, drift], gram[drift, :] @ full))


MARGIN = 0.125  # of the range, in gears beyond its top; half and double: the same errors


def zero_shift(recording: Recording, zero: str | float) -> float:
    """Displacement that counts as zero: 'none' (as logged), 'mean' or 'first' of the log, or a value.

    Returns it in the unit of the displacement.
    """
    if zero == "none":
        return 0.0
    if zero == "mean":
        return float(recording.displacement.mean())
    if zero == "first":
        return float(recording.displacement[0])
    return float(zero)


def stages_of(
    fitted: Fitted, prepared: Prepared, shift: float, gears: int | None = None
) -> tuple[Stage, ...]:
    """Stages of the forward cascade: points on the drive, backlash with relaxation, point, scale, delay.

    Gears are in the unit of the voltage on their input and without a unit on their output (sum about 1);
    the scale stage carries the displacement's unit. ``shift`` is taken off the displacement. ``gears``: their
    number where the user fixed it.
    """
    basis = fitted.basis
    relaxation = None
    if fitted.gains.any():
        acting = fitted.gains > 0.0
        relaxation = Relaxation(
            basis.low,
            tuple(float(tau) for tau, on in zip(basis.time_constants, acting, strict=True) if on),
            tuple((fitted.gains[acting] / basis.span).tolist()),
        )
    count = gears or basis.gears * basis.split
    slope = np.minimum((np.arange(count) + 0.5) * basis.gears / count, basis.gears - 1).astype(np.int64)
    heights = fitted.heights[slope] * basis.gears / count
    x0, y0 = basis.low, fitted.origin
    spare = 0 if gears is not None else int(MARGIN * count)
    # A drive that goes a little further than the logs did shall turn there as it does inside.
    heights = np.append(heights, np.full(2 * spare, heights[-1]))
    widths = np.full(len(heights), basis.span / count)
    x0, y0 = x0 - spare * widths[0], y0 - spare * heights[-1]
    stages: list[Stage] = [basis.bend_points()] if basis.bend else []
    stages.append(BacklashStage(widths, heights, x0, y0, relaxation))
    segments = len(fitted.knots) - 1
    if segments > 1:
        stages.append(PointStage(np.diff(fitted.knots), np.full(segments, 1.0 / segments), 0.0, 0.0))
    level = float(fitted.drift[0])  # the first log's offset; the later terms are its drift
    stages.append(ScaleStage(prepared.scale, prepared.offset + prepared.scale * level - shift))
    if basis.delay > 0.0:
        stages.append(DelayStage(basis.delay))
    return tuple(stages)


def model_of(
    fitted: Fitted, prepared: Prepared, recording: Recording, zero: str | float, gears: int | None = None
) -> ActuatorModel:
    """Build the forward model; its input range is what the logs cover."""
    stages = stages_of(fitted, prepared, zero_shift(recording, zero), gears)
    low, high = slow_output_range(stages, prepared.low, prepared.high)
    return ActuatorModel(
        direction="forward",
        input=Quantity("voltage", recording.voltage_unit, prepared.low, prepared.high),
        output=Quantity("displacement", recording.displacement_unit, low, high),
        stages=stages,
    )
