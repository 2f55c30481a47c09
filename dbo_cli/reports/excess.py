"""An error that is far larger than was expected: what is wrong, and what to do about it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.reports.expected import Expected
from dbo_cli.reports.pair import Pair
from dbo_cli.signals import between, noise

SAME_MOVE = 0.01
"""Part of the move by which the ends of a summary's move may differ from the log's."""
HALVED = 0.5
"""Part of the error that a cause must leave at most to be named."""
BEYOND_EXPECTED = 2.0
"""Times the expected error, from which on a warning says so."""


def excess(pair: Pair, expected: Expected, figures: Mapping[str, Any]) -> str:
    """Return a warning where the error is far above the expected one, or that is another move's.

    The sensor's noise is no error of the actuator: it is taken out first. ``figures``
    are those of ``merits``.
    """
    low, high = figures["desired_min"], figures["desired_max"]
    first, last = expected.move or (low, high)
    if max(abs(first - low), abs(last - high)) > SAME_MOVE * (high - low):
        return (
            f"the move is {low:.4g} to {high:.4g}, the expected error is for"
            f" {first:.4g} to {last:.4g}: use the summary of this move"
        )
    white = noise(pair.measured)
    error = math.sqrt(max(figures["rmse"] ** 2 - white**2, 0.0))
    if expected.rmse is None or error <= BEYOND_EXPECTED * expected.rmse:
        return ""
    cause = _cause(pair, figures, white, expected.past_known)
    return f"the error is {error / expected.rmse:.2g} times the expected one{cause}"


def _cause(
    pair: Pair, figures: Mapping[str, Any], white: float, past_known: bool
) -> str:
    """Return the largest cause of an error, what it would leave, and what to do about it."""
    offset = figures["offset_removed"]
    error = pair.measured - pair.desired - offset
    sweep = "" if past_known else "sweep the range before the move, "
    causes = [
        (
            _left(error - np.mean(error), white),
            f"its mean is {figures['mean']:.3g}",
            f"set the sensor's zero, {sweep}or `remove_offset`",
        )
    ]
    lag, seconds = figures["lag_left_samples"], figures["lag_left_s"]
    if seconds is not None:
        rows = np.arange(float(len(error))) - lag
        inside = (rows >= 0.0) & (rows <= len(error) - 1.0)
        shifted = pair.measured[inside] - between(pair.desired, rows[inside])
        side, remedy = "late", "identify with `sensor_delay`, or `lag`"
        if lag < 0.0:
            side = "early"
            remedy = "match the clocks, or take the delay out of the model"
        text = f"it is {1e3 * abs(seconds):.3g} ms {side}"
        causes.append((_left(shifted - offset, white), text, remedy))
    smallest = np.argsort(np.abs(error))[: math.floor(0.99 * len(error))]
    row = figures["max_abs_row"]
    text = f"one row in a hundred holds most of it, the largest at row {row:,}"
    causes.append(
        (_left(error[smallest], white), text, "look there for a gap or a limit")
    )
    residual, text, remedy = min(causes)
    if residual > HALVED * _left(error, white):
        if pair.drive_error is not None:
            percent = f"{100.0 * pair.drive_error:.2g} % of its range"
            return f": another drive was played, up to {percent} apart: dbo check `against` tells more"
        return f": {sweep}or identify again" if sweep else ": identify again"
    return f": {text}, without which {residual:.2g} is left: {remedy}"


def _left(error: Floats, white: float) -> float:
    """Return the RMS of an error without its white noise."""
    return math.sqrt(max(float(np.mean(np.square(error))) - white**2, 0.0))
