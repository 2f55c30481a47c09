"""What error to expect of a very move: what was left out, and how far candidates go apart on it.

    expected = sqrt(left_out^2 + sum_k w_k mean (y_k - y)^2)

over the model's candidates, played on this move; for an unknown past the spread over
starts is part of it: the mean of (y_s - y)^2 over empty, full and settled.
"""

from __future__ import annotations

import math

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.model.cascade import Cascade

MOST_ROWS = 131_072  # of a move that are played
STARTS = ("empty", "full", "settled")
NEAR_END = 0.02  # of the range
LONGER = 1.1  # times the log's fastest drive or longest rest: less is not worth a word


def expected_error(
    model: Cascade,
    voltage: Floats,
    dt: float | Floats | None,
    past_known: bool = False,
    begin: int = 0,
) -> float | None:
    """Return the RMS error to expect on a move, in the displacement's unit; None without candidates.

    Parameters
    ----------
    model : a forward model
    voltage : shape (n,), the drive in its unit
    dt : seconds since the sample before, one number or one each
    past_known : whether the state before the first row is known
    begin : rows before the move, played but not counted; 131,072 rows from there on are
    """
    left = model.fit.get("left_out_rmse")
    if left is None or not model.candidates:
        return None
    last = begin + MOST_ROWS
    drive = np.asarray(voltage, dtype=np.float64)[:last]
    steps = dt
    if isinstance(dt, np.ndarray):
        steps = dt[:last]

    def played(candidate: Cascade, start: str = "auto") -> Floats:
        return candidate.simulate(drive, dt=steps, state=start)[0][begin:]

    expected = played(model)
    squares = float(left) ** 2
    for weight, candidate in model.candidate_models():
        squares += weight * _mean_square(played(candidate) - expected)
    if not past_known and _begins_inside(model, float(drive[0])):
        for start in STARTS:
            squares += _mean_square(played(model, start) - expected) / len(STARTS)
    return math.sqrt(squares)


def _begins_inside(model: Cascade, voltage: float) -> bool:
    """Whether a move begins where the past shows: at the ends of the range it does not."""
    near = NEAR_END * model.input.span
    return model.input.min + near < voltage < model.input.max - near


def _mean_square(values: Floats) -> float:
    """Return the mean of the squares."""
    return float(np.mean(values**2))


def move_warnings(
    model: Cascade, voltage: Floats, dt: float | Floats | None
) -> list[str]:
    """Return what of a move the logs did not show: a faster drive, a longer rest; in words.

    Parameters
    ----------
    voltage, dt : as of ``expected_error``
    """
    if dt is None or len(voltage) < 2:
        return []
    steps = np.broadcast_to(np.asarray(dt, dtype=np.float64), (len(voltage),))[1:]
    texts = []
    fastest, rest = model.fit.get("fastest"), model.fit.get("longest_rest")
    unit = model.input.suffix.strip() or "units"
    speed = fastest_drive(voltage, steps)
    if fastest and speed > LONGER * float(fastest):
        texts.append(
            f"{speed:.3g} {unit}/s, the logs at most {float(fastest):.3g}: the error may be larger; "
            "identify with a faster log"
        )
    hold = longest_rest(voltage, steps)
    if rest is not None and hold > LONGER * float(rest):
        texts.append(
            f"holds for {hold:.3g} s, the logs at most {float(rest):.3g}: the error may be larger; "
            "identify with a longer hold"
        )
    return texts


def fastest_drive(voltage: Floats, steps: Floats) -> float:
    """Return the rate (a second) that 2 % of the steps exceed; ``steps`` in seconds, shape (n - 1,)."""
    moving = steps > 0.0
    if not moving.any():
        return 0.0
    rates = np.abs(np.diff(voltage)[moving]) / steps[moving]
    return float(np.percentile(rates, 98.0))


def longest_rest(voltage: Floats, steps: Floats) -> float:
    """Return the seconds of the longest hold of the drive."""
    still = np.abs(np.diff(voltage)) <= 1e-4 * float(np.ptp(voltage))
    time = np.concatenate(([0.0], np.cumsum(np.where(still, steps, 0.0))))
    last_moved = np.maximum.accumulate(np.where(np.append(True, ~still), time, 0.0))
    return float((time - last_moved).max())
