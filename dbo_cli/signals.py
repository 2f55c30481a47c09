"""Signals of any kind: even clocks, noise, turns, and how much later one signal is than another.

Everything here knows arrays only: no unit, no file, no actuator.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from dbo_cli.arrays import Booleans, Floats, Integers

EVEN = 1e-6
"""Part of a step by which the steps of an even clock may differ."""
COARSEST_DECIMAL = 0.05
"""Part of a step: a last decimal place above it is no rounding of an even clock."""
DECIMAL_SAMPLE = 50
"""Stamps that tell in how many decimals all are written."""

FIRST_ORDER, LAST_ORDER = 2, 10
"""Differences by which noise is told from motion."""
STILL_FALLING = 0.85
"""Ratio of the noise by two orders of differences below which motion is still in it."""
NORMAL_MEDIAN = 0.6745
"""Median of |x| of a normal variable of standard deviation 1."""

FEWEST_SHARED = 16
"""Rows that two signals must have in common for a lag of a part of a row."""
SHARED = 0.25
"""Part of the shorter signal that must overlap with the other."""
MARGIN = 3.0
"""Rows at either end of the reference that values between rows need."""
PLACES = 4
"""Best places of the correlation that are refined."""
RIVAL = 0.9
"""Part of the best place's evidence from which on another one explains the signals as well."""
REPEATS = 1e-6
"""Part of its variance by which a reference that repeats itself may differ after a period."""
FOLLOWS = 0.25
"""Part of the reference's variance by which rows that follow it may differ."""
ITERATIONS = 20
"""Gauss-Newton steps at most."""
LONGEST_STEP = 0.01
"""Part of the signal that one Gauss-Newton step may go, beside two rows."""
TRIED_ROWS, REFINED_ROWS = 3_000, 20_000
"""Rows of the signal, evenly picked, at each of the places and at the best."""
TIME_BLOCKS = 8
"""Blocks of time whose scatter is the uncertainty of a lag."""


def even(stamps: Floats, step: float | None = None) -> float | None:
    """Return the step (s) of an even clock, or None.

    Steps are even where they differ by no more than a millionth of a step, the rounding
    of the numbers, or the last decimal that they are written in.

    Parameters
    ----------
    stamps : array of shape (rows,)
        Seconds.
    step
        The step that is known already, of a clock that goes on; None: the mean step.
    """
    if len(stamps) < 2:
        return step
    if step is None:
        step = float(stamps[-1] - stamps[0]) / (len(stamps) - 1)
    if not 0.0 < step < math.inf:
        return None
    difference = float(np.abs(np.diff(stamps) - step).max())
    rounding = 4.0 * float(np.spacing(np.abs(stamps).max()))
    slack = EVEN * step + rounding
    if difference > slack:
        slack += _last_decimal(stamps[:DECIMAL_SAMPLE], COARSEST_DECIMAL * step)
    return step if difference <= slack else None


def step_of(stamps: Floats) -> float:
    """Return the step (s) of a clock: the even one, else the median; 0 where most stamps repeat."""
    step = even(stamps)
    if step is None and len(stamps) > 1:
        step = float(np.median(np.diff(stamps)))
    return step or 0.0


def usual_step(steps: Floats) -> float:
    """Return the median of the steps (s) of a clock that are above 0; 0 where there is none."""
    forward = steps[steps > 0.0]
    return float(np.median(forward)) if forward.size else 0.0


def _last_decimal(stamps: Floats, coarsest: float) -> float:
    """Return the last decimal place of numbers; 0 where it is coarser, or there is none."""
    rounding = 4.0 * float(np.spacing(np.abs(stamps).max()))
    for places in range(1, 16):
        unit = 10.0**-places
        if unit > coarsest:
            continue
        rounded = float(np.abs(stamps - np.round(stamps, places)).max())
        if rounded < 1e-3 * unit + rounding:
            return 1.01 * unit
    return 0.0


def noise(values: Floats) -> float:
    """Return the standard deviation of what is white in a signal; 0 where nothing shows it.

    The k-th differences of white noise of variance s^2 have the variance C(2k, k) s^2,
    whatever k is; those of motion fall from order to order. The estimate is the one from
    which on it falls no more. Motion that is as fast as the samples cannot be told from
    noise. Medians leave out jumps, turns and spikes.

    Parameters
    ----------
    values : array of shape (rows,)
        Evenly sampled, finite.
    """
    differences = np.asarray(values, dtype=np.float64)
    estimate = math.inf
    for order in range(1, LAST_ORDER + 1):
        differences = np.diff(differences)
        if differences.size < FEWEST_SHARED // 2:
            return 0.0
        if order < FIRST_ORDER:
            continue
        spread = float(np.median(np.abs(differences))) / NORMAL_MEDIAN
        lower = spread / math.sqrt(math.comb(2 * order, order))
        if lower > STILL_FALLING * estimate:
            return min(lower, estimate)
        estimate = lower
    return 0.0


def turns(values: Floats, smallest: float) -> Integers:
    """Return the rows where a signal turns by more than ``smallest``, the first and the last row included.

    Where it rests before it turns, the last row of the rest counts.
    """
    steps = np.diff(values)
    moving = np.flatnonzero(steps)
    rising = steps[moving] > 0.0
    extremes = [*moving[1:][rising[1:] != rising[:-1]].tolist(), len(values) - 1]
    rows = [0]
    direction, row, level = 0, 0, float(values[0])
    for extreme, value in zip(extremes, values[extremes].tolist(), strict=True):
        change = value - level
        if direction and change * direction >= 0.0:
            row, level = extreme, value
        elif abs(change) > smallest:
            if direction:
                rows.append(row)
            direction = 1 if change > 0.0 else -1
            row, level = extreme, value
    return np.asarray([*rows, len(values) - 1], dtype=np.int64)


# --- the lag between two signals ---


@dataclass(frozen=True)
class TimeLag:
    """How much later one signal is than another.

    A time t of the signal is ``t (1 - rate) - seconds`` of the reference, each
    counted from the first row of its own signal.

    Attributes
    ----------
    seconds
        In the unit of the step that was given.
    deviation
        One standard deviation of it, in the middle; infinite where it is known to a row only.
    rate
        Part by which the signal's clock runs fast; 0 where it was not looked for.
    residual
        Part of the signal's variance that is left unexplained.
    rival
        Another lag (s) that explains the signals as well; None: there is none.
    evidence
        How strongly the rows speak for it.
    """

    seconds: float
    deviation: float = math.inf
    rate: float = 0.0
    residual: float = 0.0
    rival: float | None = None
    evidence: float = 0.0


def lag(
    signal: Floats,
    reference: Floats,
    step: float = 1.0,
    *,
    rate: bool = False,
    inverted: bool = False,
) -> TimeLag | None:
    """Return how much later a signal is than another; None where nothing shows it.

    ``signal(t) = c + sum_k w_k reference_k(t - lag)``, with weights that leave least. The
    places to begin at are those where the evidence of a correlation r of n rows, n
    log(1/(1 - r^2)), is greatest, so that either signal may begin or end first. From
    there Gauss and Newton go on, with the weights projected out (Golub and Pereyra,
    1973). The uncertainty is that of the scatter between blocks of time.

    Parameters
    ----------
    signal : array of shape (rows,)
        Evenly sampled.
    reference : array of shape (other rows,) or (other rows, columns)
        Sampled alike: what ``signal`` may be made of; the first column is correlated.
    step
        Seconds a row.
    rate
        Whether the two clocks may run at different rates.
    inverted
        Whether the signal may fall where the reference rises.
    """
    columns = reference.reshape(len(reference), -1)
    if min(len(signal), len(columns)) < 2:
        return None
    if np.ptp(signal) == 0.0 or np.ptp(columns[:, 0]) == 0.0:
        return None
    lags, strengths = _peaks(columns[:, 0], signal, inverted)
    # of lags that are alike to rounding, the one nearest to none
    height = np.round(strengths / max(strengths.max(), 1e-300), 9)
    order = np.lexsort([np.abs(lags), -height])
    starts = lags[order[:PLACES]].tolist()
    tried = [_refined(signal, columns, start, rate, TRIED_ROWS) for start in starts]
    fits = [fit for fit in tried if fit is not None]  # in rows
    if not fits:
        return None
    best = max(fits, key=lambda fit: fit.evidence)
    nearest = _without_periods(best, signal, columns[:, 0])
    if nearest != best.seconds:
        best = _refined(signal, columns, nearest, rate, TRIED_ROWS) or best
    first = best
    if len(signal) > TRIED_ROWS:
        most_rows = max(REFINED_ROWS // columns.shape[1], TRIED_ROWS)
        best = _refined(signal, columns, best.seconds, rate, most_rows) or best
    rivals = [step * fit.seconds for fit in fits if _is_rival(fit, first)]
    seconds, deviation = step * best.seconds, step * best.deviation
    rival = rivals[0] if rivals else None
    return replace(best, seconds=seconds, deviation=deviation, rival=rival)


def _is_rival(fit: TimeLag, best: TimeLag) -> bool:
    """Return whether a lag is another one than the best, and explains the signals as well."""
    distance = abs(fit.seconds - best.seconds)
    is_other = distance > max(2.0, 5.0 * best.deviation)
    return is_other and fit.evidence >= RIVAL * best.evidence


def _evidence(count: Integers | int, unexplained: Floats | float) -> Floats:
    """Return how strongly rows speak for a lag, of which a part is left unexplained."""
    return np.asarray(-count * np.log(np.clip(unexplained, 1e-12, 1.0)))


def _peaks(
    reference: Floats, signal: Floats, inverted: bool
) -> tuple[Integers, Floats]:
    """Return the lags (rows) around which two signals correlate most, and the evidence for them."""
    a, b = reference - reference.mean(), signal - signal.mean()
    lags = np.arange(1 - a.size, b.size)
    begin, end = np.maximum(0, -lags), np.minimum(a.size, b.size - lags)
    count = end - begin
    size = 1 << (a.size + b.size - 2).bit_length()
    circular = np.fft.irfft(np.fft.rfft(b, size) * np.fft.rfft(a, size).conj(), size)
    products = np.concatenate([circular[size - a.size + 1 :], circular[: b.size]])
    sum_a, sum_b = _sums(a, begin, end), _sums(b, begin + lags, end + lags)
    spread_a = _sums(a * a, begin, end) - sum_a**2 / count
    spread_b = _sums(b * b, begin + lags, end + lags) - sum_b**2 / count
    spread = spread_a * spread_b
    shared = products - sum_a * sum_b / count
    enough = count >= max(SHARED * min(a.size, b.size), 2)
    moving = (spread > 1e-12 * spread.max()) & enough
    if not inverted:
        moving &= shared > 0.0
    alike = np.divide(shared**2, spread, out=np.zeros(lags.size), where=moving)
    evidence = _evidence(count, 1.0 - alike)
    padded = np.concatenate([[-1.0], evidence, [-1.0]])
    peaks = np.flatnonzero((evidence >= padded[:-2]) & (evidence >= padded[2:]))
    return lags[peaks], evidence[peaks]


def _without_periods(best: TimeLag, signal: Floats, reference: Floats) -> float:
    """Return a lag (rows) less the periods of a reference by which it leaves out rows that follow, too.

    A reference that repeats itself explains the signal at any period. The lag that leaves
    out what follows less well, as a first period does, explains the others better, and
    would be believed for that.
    """
    shift = best.seconds
    period = _period(reference, max(REPEATS, 2.0 * best.residual))
    for step in (period, -period):
        while step and _explains_more(signal, reference, shift - step, shift):
            shift -= step
    return shift


def _period(reference: Floats, slack: float) -> float:
    """Return the rows after which a signal repeats itself, but for a part of its variance; 0: it does not."""
    lags, evidence = _peaks(reference, reference, False)
    for row in lags[(lags > 0) & (evidence > 0.0)][:PLACES].tolist():
        repeat = _refined(reference, reference[:, None], row, False, TRIED_ROWS)
        if repeat is None or repeat.residual > slack:
            continue
        if repeat.seconds > 0.5 * row:  # and has not come back to none
            return repeat.seconds
    return 0.0


def _explains_more(
    signal: Floats, reference: Floats, shift: float, other: float
) -> bool:
    """Return whether a lag (rows) leaves out fewer rows than another one, and these follow the reference.

    Where both leave out the same, whether it is the smaller one.
    """
    begin, end = _rows_within(signal, reference, shift)
    other_begin, other_end = _rows_within(signal, reference, other)
    if (begin, end) == (other_begin, other_end):
        return abs(shift) < abs(other)
    common = np.arange(max(begin, other_begin), min(end, other_end))
    gained = np.arange(other_end, end)
    if begin < other_begin:
        gained = np.arange(begin, other_begin)
    if end - begin <= other_end - other_begin or not len(common):
        return False
    expected = between(reference, common.astype(np.float64) - shift)
    followed = signal[common]
    expected, followed = expected - expected.mean(), followed - followed.mean()
    square = float(expected @ expected)
    if not square > 0.0:
        return False
    gain = float(followed @ expected) / square
    expected = gain * between(reference, gained.astype(np.float64) - shift)
    error = signal[gained] - expected
    return float(np.var(error)) < FOLLOWS * float(np.var(expected))


def _rows_within(signal: Floats, reference: Floats, shift: float) -> tuple[int, int]:
    """Return the first row of a signal within a reference at a lag (rows), and the one behind the last."""
    end = min(math.floor(shift) + len(reference), len(signal))
    return max(math.ceil(shift), 0), end


def _sums(values: Floats, begin: Integers, end: Integers) -> Floats:
    """Return the sum of the values of each stretch of rows."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    sums: Floats = total[end] - total[begin]
    return sums


def _refined(
    signal: Floats, columns: Floats, start: float, rate: bool, most_rows: int
) -> TimeLag | None:
    """Return the best lag (rows) near a first one; None where too little overlaps."""
    rows = np.arange(0, len(signal), -(-len(signal) // most_rows), dtype=np.float64)
    picked = signal[rows.astype(np.intp)]
    fewest = min(FEWEST_SHARED, len(rows))
    moves = [np.ones(len(rows))]
    if rate:
        moves.append(rows - 0.5 * rows[-1])  # about the middle, where it is known best
    unknown = np.zeros(len(moves))
    unknown[0] = start
    farthest = 2.0 + LONGEST_STEP * len(signal)
    deviation, error, inside = math.inf, picked, np.ones(len(rows), dtype=bool)
    for _ in range(ITERATIONS):
        places = rows - sum(u * move for u, move in zip(unknown, moves, strict=True))
        inside = (places >= MARGIN) & (places <= len(columns) - 1.0 - MARGIN)
        if np.count_nonzero(inside) < fewest:
            if len(rows) < FEWEST_SHARED:
                return _whole(signal, columns, int(start))
            return None
        at, target = places[inside], picked[inside]
        error = _unexplained(target, columns, at)
        later = _unexplained(target, columns, at - 0.5)
        slope = later - _unexplained(target, columns, at + 0.5)
        slopes = np.column_stack([slope * move[inside] for move in moves])
        size = np.sqrt(np.sum(slopes**2, axis=0))
        if not np.all(size > 1e-12 * math.sqrt(float(target @ target)) + 1e-300):
            break
        inverse = np.linalg.pinv(slopes / size)
        change = -(inverse @ error) / size
        too_far = abs(change[0]) / farthest
        if too_far > 1.0:
            change = change / too_far
        unknown = unknown + change
        deviation = _deviation(error, slopes / size, size)
        settled = 1e-3 * np.sqrt(error @ error) + 1e-12 * size[0]
        if np.abs(change * size).max() <= settled:
            break
    target = picked[inside]
    residual = float(np.mean(error**2)) / max(float(np.var(target)), 1e-300)
    evidence = float(_evidence(len(target), residual))
    slope_of_clocks = float(unknown[1]) if rate else 0.0
    shift = float(unknown[0]) - 0.5 * rows[-1] * slope_of_clocks
    return TimeLag(shift, deviation, slope_of_clocks, residual, evidence=evidence)


def _whole(signal: Floats, columns: Floats, start: int) -> TimeLag:
    """Return a lag of whole rows, of signals that are too short for more."""
    begin = max(0, -start)
    count = min(len(columns) - begin, len(signal) - begin - start)
    a = columns[begin : begin + count, 0]
    b = signal[begin + start : begin + start + count]
    residual = 1.0
    if np.ptp(a) > 0.0 and np.ptp(b) > 0.0:
        residual = 1.0 - float(np.corrcoef(a, b)[0, 1]) ** 2
    evidence = float(_evidence(count, residual))
    return TimeLag(float(start), residual=residual, evidence=evidence)


def _unexplained(target: Floats, columns: Floats, places: Floats) -> Floats:
    """Return what columns at places between their rows, and a constant, leave of a target."""
    table = between(columns, places)
    table = table - table.mean(axis=0)
    if table.shape[1] > 1:
        basis = np.linalg.qr(table)[0]
    else:
        basis = table / max(math.sqrt(float(np.sum(table**2))), 1e-300)
    error: Floats = target - target.mean()
    error = error - basis @ (basis.T @ error)
    return error


def residual_at(signal: Floats, reference: Floats, shift: float) -> float:
    """Return the part of the signal's variance that is left at a lag (rows); see ``lag``."""
    columns = reference.reshape(len(reference), -1)
    rows = np.arange(0, len(signal), -(-len(signal) // TRIED_ROWS), dtype=np.int64)
    places = rows.astype(np.float64) - shift
    inside = (places >= 0.0) & (places <= len(columns) - 1.0)
    target = signal[rows[inside]]
    if not len(target) or not np.ptp(target) > 0.0:
        return math.inf
    error = _unexplained(target, columns, places[inside])
    return float(np.mean(error**2) / np.var(target))


def between(values: Floats, places: Floats) -> Floats:
    """Return values between the rows of an even signal, by cubics with slopes of five rows.

    Parameters
    ----------
    values : array of shape (rows,) or (rows, columns)
        At least two rows.
    places : array of shape (n,)
        Rows, with parts of one; beyond the ends the end values hold.
    """
    last = len(values) - 1
    places = np.clip(places, 0.0, last)
    row = places.astype(np.intp)  # at a row its value, to the last digit
    fraction = (places - row).reshape(-1, *[1] * (values.ndim - 1))
    six = [values[np.clip(row + offset, 0, last)] for offset in range(-2, 4)]
    here, after = six[2], six[3]
    slope = (8.0 * (after - six[1]) - (six[4] - six[0])) / 12.0
    next_slope = (8.0 * (six[4] - here) - (six[5] - six[1])) / 12.0
    rise = after - here
    cubic = slope + next_slope - 2.0 * rise
    square = 3.0 * rise - 2.0 * slope - next_slope
    result: Floats = here + fraction * (slope + fraction * (square + fraction * cubic))
    return result


def without_delay(
    time: Floats, values: Floats, delay: float
) -> tuple[Floats, Booleans]:
    """Return a signal as a sensor without delay (s) would have made it, and which rows were measured.

    The others, at the end, hold the last value.
    """
    step = even(time)
    if step is None:
        shifted = np.interp(time + delay, time, values)
    else:
        shifted = between(values, np.arange(float(len(values))) + delay / step)
    return shifted, time <= time[-1] - delay


def _deviation(error: Floats, slopes: Floats, size: Floats) -> float:
    """Return the standard deviation of a lag, from how its pull scatters between blocks.

    What is wrong with the description scatters so, and clocks of different rates.
    """
    blocks = np.array_split(slopes * error[:, None], TIME_BLOCKS)
    pulls = np.array([block.sum(axis=0) for block in blocks])
    scatter = pulls.T @ pulls * TIME_BLOCKS / (TIME_BLOCKS - 1)
    inverse = np.linalg.pinv(slopes.T @ slopes)
    covariance = inverse @ scatter @ inverse
    return math.sqrt(max(float(covariance[0, 0]), 0.0)) / float(size[0])
