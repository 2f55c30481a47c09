"""What error to expect of a very move: what was left out, and how far candidates go apart on it.

    known^2 = left_out^2 + sum_k w_k mean (y_k - y)^2

over the model's candidates, played on this move. An unknown past adds the spread over
starts, the mean of (y_s - y)^2 over empty, full and settled (at an end of the range these
are one, and a start that a model keeps may be another), and what memories may hold that
came to rest at any voltage of the range, equally likely.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.model.cascade import Cascade
from dbo_cli.model.state import Steps
from dbo_cli.signals import turns

FIRST_ROWS = 131_072  # of a move, that expectations and refusals look at
STARTS = ("empty", "full", "settled")
UNLIKE = 3.0
"""Times the logs' fastest drive or longest swing: time constants of a model are as far apart."""
SWING = 0.05  # of the range: a drive that goes back by more has turned
STILL = 1e-3  # of the range, within which a drive rests
FAST_WAY = 0.05  # of the way: it is gone at the fastest rate, or faster


class ExpectedError(NamedTuple):
    """The error to expect on a move (RMS), in the displacement's unit, by what is not known before it.

    Attributes
    ----------
    known : where nothing before the move is unknown
    past : what an unknown past of the gears adds that nothing before the move has swept
    memory : what memories add that have not come to rest
    """

    known: float
    past: float
    memory: float


def expected_error(
    model: Cascade, voltage: Floats, dt: Steps, begin: int = 0
) -> ExpectedError | None:
    """Return the error to expect on a move; None without candidates.

    Parameters
    ----------
    model : a forward model
    voltage : shape (n,), the drive in its unit
    dt : seconds since the sample before, one number or one each
    begin : rows before the move, played but not counted; 131,072 rows from there on are
    """
    left_out = model.fit.get("left_out_rmse")
    if left_out is None or not model.candidates:
        return None
    last = begin + FIRST_ROWS
    drive = np.asarray(voltage, dtype=np.float64)[:last]
    if isinstance(dt, np.ndarray):
        dt = dt[:last]

    def simulated(candidate: Cascade, start: str = "auto") -> Floats:
        return candidate.simulate(drive, dt=dt, state=start)[0][begin:]

    expected = simulated(model)
    squares = float(left_out) ** 2
    for weight, candidate in model.candidate_models:
        squares += weight * _mean_square(simulated(candidate) - expected)
    past = 0.0
    for start in STARTS:
        past += _mean_square(simulated(model, start) - expected) / len(STARTS)
    memory = 0.0
    # at rest elsewhere than at the first voltage
    if model.gears.relaxation is not None:
        share, added = unknown_memory(model, drive, dt)
        memory = share * _mean_square(added[begin:])
    return ExpectedError(math.sqrt(squares), math.sqrt(past), math.sqrt(memory))


def unknown_memory(model: Cascade, drive: Floats, dt: Steps) -> tuple[float, Floats]:
    """Return the mean square of the share that memories of an unknown past add of D, and D; (rows,).

    D is the difference between a rest at the greatest and the least voltage before the
    drive. A rest that is equally likely anywhere is off by 1/12 + (p - 1/2)^2 of that,
    squared, where the first voltage is at the part p of the range.
    """
    relaxation = model.gears.relaxation
    assert relaxation is not None
    state, simulated = model.start(float(drive[0])), []
    for voltage in (model.input.min, model.input.max):
        remaining = model.head.value(voltage) - relaxation.reference
        rested = replace(state, memory=(remaining,) * len(relaxation.tau))
        simulated.append(model.simulate(drive, dt=dt, state=rested)[0])
    index = (float(drive[0]) - model.input.min) / model.input.span
    return 1.0 / 12.0 + (index - 0.5) ** 2, simulated[1] - simulated[0]


def _mean_square(values: Floats) -> float:
    """Return the mean of the squares."""
    return float(np.mean(values**2))


def move_warnings(model: Cascade, voltage: Floats, dt: Steps, move: slice) -> list[str]:
    """Return what of a move the logs did not show: a faster drive, a slower swing; in words.

    Parameters
    ----------
    voltage, dt : as of ``expected_error``
    move : its rows
    """
    if dt is None or len(voltage[move]) < 2:
        return []
    steps = np.broadcast_to(np.asarray(dt), (len(voltage),))[move][1:]
    voltage = voltage[move]
    texts = []
    fit, unit = model.fit, model.input.suffix.strip() or "units"
    fastest, speed = fit.get("fastest"), fastest_drive(voltage, steps)
    if fastest and speed > UNLIKE * float(fastest):
        texts.append(
            f"{speed:.3g} {unit}/s, the logs at most {float(fastest):.3g}: the error may be larger; "
            "identify with a faster log"
        )
    shown = [fit.get("longest_rest"), fit.get("longest_swing")]
    slowest = max((float(seconds) for seconds in shown if seconds), default=None)
    swing = longest_swing(voltage, np.concatenate(([0.0], np.cumsum(steps))))
    if slowest is not None and swing > UNLIKE * slowest:
        texts.append(
            f"takes {swing:.3g} s from turn to turn or holds so long, the logs at most {slowest:.3g}: creep "
            f"may add to the error; identify with a slower log (excite `rest` {swing:.2g})"
        )
    return texts


def longest_swing(voltage: Floats, time: Floats) -> float:
    """Return the seconds from one turn of the drive to the next, at most; a hold belongs to the swing."""
    rows = turns(voltage, SWING * float(np.ptp(voltage)))
    return float(np.diff(time[rows]).max())


def fastest_drive(voltage: Floats, steps: Floats) -> float:
    """Return the rate (a second) at which 5 % of the way is gone, or faster; ``steps`` in seconds, (n - 1,).

    Of the way and not of the rows, so that no rest hides the jumps.
    """
    way = np.abs(np.diff(voltage))
    output = (way > 0.0) & (steps > 0.0)
    if not output.any():
        return 0.0
    way = way[output]
    rates = way / steps[output]
    order = np.argsort(-rates, kind="stable")
    gone = np.cumsum(way[order])
    return float(rates[order[np.searchsorted(gone, FAST_WAY * gone[-1])]])


def longest_rest(voltage: Floats, steps: Floats) -> float:
    """Return the seconds of the longest hold of the drive, within a thousandth of its range."""
    band = STILL * float(np.ptp(voltage)) or 1.0
    longest = 0.0
    for shift in (0.0, 0.5):  # a hold at the edge of one band is within the other
        still = np.diff(np.floor(voltage / band + shift)) == 0.0
        time = np.concatenate(([0.0], np.cumsum(np.where(still, steps, 0.0))))
        output = np.where(np.append(True, ~still), time, 0.0)
        held = time - np.maximum.accumulate(output)
        longest = max(longest, float(held.max()))
    return longest
