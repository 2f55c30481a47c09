"""An error that is far larger than was expected: what it consists of, and what to do about it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from dbo_cli.reports.expected import Expected
from dbo_cli.reports.pair import Pair
from dbo_cli.signals import noise

SAME_MOVE = 0.01
"""Part of the move by which the ends of a summary's move may differ from the log's."""
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
    text = f"the error is {error / expected.rmse:.2g} times the expected one"
    if pair.drive_error is not None:
        percent = f"{100.0 * pair.drive_error:.2g} % of its range"
        return f"{text}: another drive was played, up to {percent} apart: dbo check `against` tells more"
    text += f": its mean is {figures['mean']:.3g}"
    if figures["lag_left_s"] is not None:
        text += f", its lag {1e3 * figures['lag_left_s']:.3g} ms"
    text += f", the largest {figures['max_abs']:.3g} at row {figures['max_abs_row']:,}"
    sweep = "" if expected.past_known else "sweep the range before the move, "
    return f"{text}: {sweep}try `remove_offset` or `lag`, or identify again"
