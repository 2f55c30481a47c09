"""A rival of the DBO fitted to recordings by bounded least squares.

Each rival gets the same rows, an offset for each log and a drift where the log has four
swings or more, and its best delay. Its numbers of plays and of dead zones are chosen on
parts of the time that are left out. The measured side holds the dead zones, as in [6]:
G(v) - S^-1(y) = 0, which is linear in all unknowns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dbo_cli.compare.plays import NOTHING, Floats, Integers, Kind, Plays
from dbo_cli.errors import FitError
from dbo_cli.identification.recording import Booleans, Recording, Swings

FIT_ROWS = 3000  # of all logs together; 7,000 changed no error by more than 1 %
PLAYS = (12, 25, 50)  # to choose from; 25 is what the paper takes
SEGMENTS = (1, 2, 4, 8)  # of the dead zones' curve, to choose from; 1: none
FOLDS = 6  # blocks of time that are left out in turn
SWINGS_FOR_DRIFT = 4  # of a log: fewer tell no drift from creep
SLOPE_FLOOR = 0.03  # of the mean slope: what a slope is at least
STEEPEST = 10.0  # times the mean slope: the steepest piece of the dead zones' curve
NORMALISING = 1e3  # times all rows: weight of the row that fixes the curve's mean slope
RESTING = 1e-9  # of a column's length: what is left of one that rests, by rounding
WORTH = 0.02  # by which more plays or segments must lower the error on what is left out
DELAYS = (0.0, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)  # rows, to choose from
FINEST_DELAY = 0.125  # of a row
LONGEST_DELAY = 0.1  # of a swing
FASTEST_SHARE = (
    0.999  # of the rows are slower than the rate of the second set of weights
)


@dataclass(frozen=True)
class Rival:
    """One operator to compare with: its name, what it is, and what is chosen from."""

    name: str
    words: str
    kind: Kind
    plays: tuple[int, ...] = PLAYS
    segments: tuple[int, ...] = (1,)


RIVALS = (
    Rival("line", "straight line", "plays", plays=(1,)),
    Rival("pi", "Prandtl-Ishlinskii, plays [6]", "plays"),
    Rival("modified", "plays and dead zones [6]", "plays", segments=SEGMENTS),
    Rival("rate", "rate-dependent, dead zones [7]", "rate", segments=SEGMENTS),
    Rival(
        "extended", "singularity-free, dead zones [8]", "singular", segments=SEGMENTS
    ),
    Rival("asymmetric", "one-sided plays and a cubic [9]", "one-sided"),
)


@dataclass(frozen=True)
class Design:
    """What is fixed before the least-squares problem is solved.

    Attributes
    ----------
    kind, plays, segments
        Of the operator; radii are spread evenly.
    delay
        Of the output, in rows.
    falling
        Whether slopes fall from play to play (loops that soften after a turn).
    fastest
        Of [7]: the rate (1/s, scaled drive) of the second set of weights.
    """

    kind: Kind
    plays: int
    segments: int = 1
    delay: float = 0.0
    falling: bool = False
    fastest: float = 0.0

    @property
    def radii(self) -> Floats:
        """The radii on the scaled drive: below half of its range, or of one-sided plays the whole."""
        return np.arange(self.plays) / self.plays

    @property
    def bare(self) -> Plays:
        """Plays of weight 1, for their places."""
        one_sided = self.kind == "one-sided"
        return Plays(
            "one-sided" if one_sided else "plays", self.radii, np.ones(self.plays)
        )

    @property
    def parameters(self) -> int:
        """How many numbers are fitted, the offset and the delay among them."""
        counts = {"rate": 2 * self.plays, "one-sided": self.plays + 1}
        count = counts.get(self.kind, self.plays)
        return count + self.segments - 1 + 1 + int(self.delay > 0.0)


@dataclass(frozen=True)
class FitLog:
    """One log in units of the fit.

    Attributes
    ----------
    drive : array of shape (samples,)
        Voltage, scaled to 0..1.
    output : array of shape (samples,)
        Displacement, scaled to 0..1, rising with the drive.
    rate : array of shape (samples,)
        |change of the drive| a second; 0 without a clock.
    rows : array of int
        The rows that are fitted.
    drift : array of shape (rows, 1 or 2)
        An offset, and a line in time where the log has swings enough.
    """

    drive: Floats
    output: Floats
    rate: Floats
    rows: Integers
    drift: Floats


@dataclass(frozen=True)
class Problem:
    """All logs, and what brings them to units of the fit."""

    logs: tuple[FitLog, ...]
    low: float
    high: float
    scale: float
    offset: float
    longest_delay: float
    has_clock: bool


def prepare(recordings: Sequence[Recording], skip: float = 0.0) -> Problem:
    """Return recordings in units of the fit; ``skip`` seconds of each are not fitted."""
    low = min(float(log.voltage.min()) for log in recordings)
    high = max(float(log.voltage.max()) for log in recordings)
    bottom = min(float(log.displacement.min()) for log in recordings)
    top = max(float(log.displacement.max()) for log in recordings)
    together = 0.0
    for log in recordings:
        together += float(np.cov(log.voltage, log.displacement)[0, 1]) * len(
            log.voltage
        )
    scale, offset = top - bottom, bottom
    if together < 0.0:
        scale, offset = -scale, top
    total = sum(len(log.voltage) for log in recordings)
    stride = -(-total // FIT_ROWS)
    logs, swing_rows = [], []
    for log in recordings:
        drive = (log.voltage - low) / (high - low)
        swings = Swings.of(log.voltage)
        swing_rows.append(swings.usual_rows)
        rows = np.flatnonzero(counted(log, skip))[::stride]
        if len(rows) < FOLDS:
            raise FitError(f"{log.name}: only {len(rows)} rows left: reduce `skip`")
        drift = [np.ones(len(rows))]
        if len(swings.sizes) >= SWINGS_FOR_DRIFT:
            drift.append(np.linspace(-1.0, 1.0, len(rows)))
        output = (log.displacement - offset) / scale
        rate = rates_of(drive, log.time)
        logs.append(FitLog(drive, output, rate, rows, np.column_stack(drift)))
    longest = LONGEST_DELAY * min(swing_rows)
    clock = all(log.time is not None for log in recordings)
    return Problem(tuple(logs), low, high, scale, offset, longest, clock)


def counted(log: Recording, skip: float) -> Booleans:
    """Return which rows of a recording count."""
    usable = log.usable.copy()
    if skip and log.time is not None:
        usable &= log.time - log.time[0] >= skip
    return usable


def rates_of(drive: Floats, time: Floats | None) -> Floats:
    """Return |change of the drive| a second since the sample before; 0 first, and without a clock."""
    rates = np.zeros(len(drive))
    if time is None or len(drive) < 2:
        return rates
    steps = np.diff(time)
    usual = float(np.median(steps[steps > 0.0]))
    rates[1:] = np.abs(np.diff(drive)) / np.maximum(steps, 0.01 * usual)
    return rates


@dataclass(frozen=True)
class Equations:
    """The rows of a least-squares problem: columns of the weights, drift of each log, and the output.

    Attributes
    ----------
    columns : array of shape (rows, weights)
    drift : array of shape (rows, unknowns of drift)
    output : array of shape (rows,)
    fold : array of int
        The block of time of each row.
    least : array of shape (weights,)
        Lower bounds.
    segments
        Of the dead zones' curve.
    """

    columns: Floats
    drift: Floats
    output: Floats
    fold: Integers
    least: Floats
    segments: int

    @property
    def ramps(self) -> Floats:
        """The output's part in each segment of the curve, shape (rows, segments)."""
        places = np.arange(self.segments)
        inside = np.clip(self.output[:, None] * self.segments - places, 0.0, 1.0)
        ramps: Floats = inside / self.segments
        return ramps


def equations(problem: Problem, design: Design) -> Equations:
    """Return the rows of all logs for a design."""
    columns, outputs, folds = [], [], []
    width = sum(log.drift.shape[1] for log in problem.logs)
    drifts = []
    place = 0
    for log in problem.logs:
        table, least = weight_columns(log, design)
        columns.append(table)
        outputs.append(log.output[log.rows])
        folds.append(np.arange(len(log.rows)) * FOLDS // len(log.rows))
        drift = np.zeros((len(log.rows), width))
        drift[:, place : place + log.drift.shape[1]] = log.drift
        place += log.drift.shape[1]
        drifts.append(drift)
    return Equations(
        np.concatenate(columns),
        np.concatenate(drifts),
        np.concatenate(outputs),
        np.concatenate(folds),
        least,
        design.segments,
    )


def weight_columns(log: FitLog, design: Design) -> tuple[Floats, Floats]:
    """Return the columns of the unknown weights in the fitted rows, and their lower bounds.

    Growing slopes: z_i, at least 0. Falling ones: z_0 - z_i, at least 0, and z_0. The
    first is at least the flattest slope, of [8] it is free.
    """
    one_sided = design.kind == "one-sided"
    drive = log.drive if one_sided else 2.0 * log.drive - 1.0
    floor = SLOPE_FLOOR if one_sided else 0.5 * SLOPE_FLOOR
    before, part = delayed(log.rows, design.delay)
    needed = np.unique(np.concatenate([before, before + 1]))
    needed = needed[needed < len(drive)]
    places = design.bare.at(drive, needed)
    first = np.searchsorted(needed, before)
    second = np.minimum(first + 1, len(needed) - 1)
    z = (1.0 - part)[:, None] * places[first] + part[:, None] * places[second]
    x = z[:, 0]
    least = np.zeros(design.plays)
    if one_sided:
        cube = x**3 / 3.0
        table = np.column_stack([x - cube, cube, z[:, 1:]])
        return table, np.concatenate([[floor, floor], least[1:]])
    least[0] = -np.inf if design.kind == "singular" else floor
    if design.falling:
        z = np.column_stack([x, x[:, None] - z[:, 1:]])
    if design.kind == "rate":
        share = np.minimum(2.0 * log.rate[before] / design.fastest, 1.0)[:, None]
        return np.hstack([(1.0 - share) * z, share * z]), np.tile(least, 2)
    return z, least


def delayed(rows: Integers, delay: float) -> tuple[Integers, Floats]:
    """Return the row at or before ``delay`` rows earlier, and the part of the one after it."""
    at = np.maximum(rows - delay, 0.0)
    before = np.floor(at).astype(np.int64)
    return before, at - before


@dataclass(frozen=True)
class Solution:
    """The unknowns: weights, knots of the curve S^-1 (0 first), and drift."""

    weights: Floats
    knots: Floats
    drift: Floats

    def output(self, rows: Equations) -> Floats:
        """Return the output that it gives."""
        return curve(rows.columns @ self.weights + rows.drift @ self.drift, self.knots)


def curve(u: Floats, knots: Floats) -> Floats:
    """Return S(u): straight pieces of even height, going straight on beyond both ends."""
    heights = np.linspace(0.0, 1.0, len(knots))
    return _on_pieces(u, knots, heights)


def curve_inverse(y: Floats, knots: Floats) -> Floats:
    """Return S^-1(y)."""
    heights = np.linspace(0.0, 1.0, len(knots))
    return _on_pieces(y, heights, knots)


def _on_pieces(x: Floats, corners: Floats, values: Floats) -> Floats:
    piece = np.clip(np.searchsorted(corners, x, side="right") - 1, 0, len(corners) - 2)
    slopes = np.diff(values) / np.diff(corners)
    y: Floats = values[piece] + slopes[piece] * (x - corners[piece])
    return y


def solve(rows: Equations, taken: Booleans | slice = slice(None)) -> Solution:
    """Return the bounded least-squares solution for some of the rows."""
    columns, drift = rows.columns[taken], rows.drift[taken]
    count, weights = len(columns), columns.shape[1]
    least = rows.least
    if rows.segments == 1:
        matrix, right = columns, rows.output[taken]
    else:
        # scale: one more row says that the curve's slopes have the mean 1
        weight = NORMALISING * np.sqrt(count)
        fixing = np.zeros(weights + rows.segments)
        fixing[weights:] = weight / rows.segments
        matrix = np.vstack([np.hstack([columns, -rows.ramps[taken]]), fixing])
        right = np.append(np.zeros(count), weight)
        drift = np.vstack([drift, np.zeros(drift.shape[1])])
        least = np.append(least, np.full(rows.segments, 1.0 / STEEPEST))
    bounded, free = bounded_minimum(matrix, drift, right, least)
    slopes = np.ones(1)
    if rows.segments > 1:
        slopes = bounded[weights:]
    knots = np.append(0.0, np.cumsum(slopes) / rows.segments)
    return Solution(bounded[:weights], knots, free)


def bounded_minimum(
    matrix: Floats, drift: Floats, right: Floats, least: Floats
) -> tuple[Floats, Floats]:
    """Return x >= least and z that minimise |matrix x + drift z - right|; least -inf: free.

    What is free is projected out, what is left are non-negative least squares.
    """
    from scipy.optimize import nnls

    bound = np.isfinite(least)
    floor: Floats = np.where(bound, least, 0.0)
    free = np.hstack([matrix[:, ~bound], drift])
    base = np.linalg.qr(free).Q
    table = np.column_stack([matrix[:, bound], right - matrix @ floor])
    whole = np.linalg.norm(table[:, :-1], axis=0)
    table = table - base @ (base.T @ table)
    triangle = np.linalg.qr(table).R
    scale = np.linalg.norm(triangle[:, :-1], axis=0)
    # a play that does not move in these rows is an offset: nothing tells its weight
    scale[scale <= RESTING * whole] = np.inf
    above, _ = nnls(triangle[:, :-1] / scale, triangle[:, -1], maxiter=50 * len(scale))
    x: Floats = np.array(floor)
    x[bound] += above / scale
    missing = right - matrix[:, bound] @ x[bound]
    rest = np.linalg.lstsq(free, missing, rcond=None)[0].astype(np.float64)
    alone = np.count_nonzero(~bound)
    x[~bound] = rest[:alone]
    return x, rest[alone:]


def fit_error(rows: Equations, solution: Solution) -> float:
    """Return the RMS error of the output on all rows."""
    return float(np.sqrt(np.mean((solution.output(rows) - rows.output) ** 2)))


def left_out_error(rows: Equations) -> float:
    """Return the RMS error on blocks of time that are left out in turn."""
    squares = 0.0
    for fold in range(FOLDS):
        left_out = rows.fold == fold
        solution = solve(rows, ~left_out)
        error = (solution.output(rows) - rows.output)[left_out]
        squares += float(np.sum(error**2))
    return float(np.sqrt(squares / len(rows.output)))


def fit(rival: Rival, problem: Problem) -> tuple[Design, Solution, float]:
    """Return the design, the unknowns, and the error on what was left out over that of the fit.

    Raises
    ------
    FitError
        The rival cannot be fitted to these logs; the message says why.
    """
    usual = rival.plays[min(1, len(rival.plays) - 1)]
    design = Design(rival.kind, usual, rival.segments[-1])
    if rival.kind == "rate":
        design = replace(design, fastest=_fastest(problem))
    design, error = _with_delay(problem, design)
    if rival.kind in ("plays", "rate") and usual > 1:
        falling, again = _with_delay(problem, replace(design, falling=True))
        if again < error:
            design = falling
    design = _simplest(problem, [replace(design, segments=m) for m in rival.segments])
    design = _simplest(problem, [replace(design, plays=n) for n in rival.plays])
    rows = equations(problem, design)
    solution = solve(rows)
    ratio = left_out_error(rows) / max(fit_error(rows, solution), 1e-12)
    return design, solution, max(ratio, 1.0)


def _fastest(problem: Problem) -> float:
    """Return the fastest rate of the drive scaled to -1..1 (1/s), the wildest rows aside."""
    if not problem.has_clock:
        raise FitError("the rate needs a clock: give `time` or `sample_rate`")
    rates = np.concatenate([log.rate for log in problem.logs])
    fastest = 2.0 * float(np.quantile(rates, FASTEST_SHARE))
    if not fastest > 0.0:
        raise FitError("the drive is at rest nearly everywhere: no rate to fit")
    return fastest


def _with_delay(problem: Problem, design: Design) -> tuple[Design, float]:
    """Return a design with the delay of least error, and that error."""
    errors: dict[float, float] = {}

    def attempt(delay: float) -> None:
        rows = equations(problem, replace(design, delay=delay))
        errors[delay] = fit_error(rows, solve(rows))

    for delay in DELAYS:
        if delay and delay > problem.longest_delay:
            break
        attempt(delay)
    step = 1.0
    while step >= FINEST_DELAY and len(errors) > 1:
        best = min(errors, key=errors.__getitem__)
        for near in (best - step, best + step):
            if near >= 0.0 and near not in errors:
                attempt(near)
        if min(errors, key=errors.__getitem__) == best:
            step *= 0.5
    best = min(errors, key=errors.__getitem__)
    return replace(design, delay=best), errors[best]


def _simplest(problem: Problem, designs: Sequence[Design]) -> Design:
    """Return the first design, simplest first, that none of the later ones betters by much."""
    if len(designs) == 1:
        return designs[0]
    errors = [left_out_error(equations(problem, design)) for design in designs]
    least = min(errors)
    for design, error in zip(designs, errors, strict=True):
        if error <= (1.0 + WORTH) * least:
            return design
    return designs[-1]


def operator_of(design: Design, weights: Floats) -> Plays:
    """Return the plays with the weights that were found (FitError where they have no inverse)."""
    if design.kind == "one-sided":
        falling, rising = float(weights[0]), float(weights[1])
        plays = np.concatenate([[0.0], weights[2:]])
        cubic = (rising - falling) / 3.0
        return Plays("one-sided", design.radii, plays, cubic=cubic, linear=falling)
    slow = _weights(weights[: design.plays], design.falling)
    by_rate = NOTHING
    if design.kind == "rate":
        by_rate = _weights(weights[design.plays :], design.falling) - slow
    return Plays(design.kind, design.radii, slow, by_rate, design.fastest)


def _weights(unknowns: Floats, falling: bool) -> Floats:
    """Return w_i from the unknowns; of falling slopes these are what each play takes off."""
    if not falling:
        return unknowns
    return np.concatenate([[unknowns.sum()], -unknowns[1:]])
