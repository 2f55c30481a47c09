"""A rival of the DBO fitted to recordings by bounded least squares.

Each rival gets the same rows, an offset for each log and a drift where the log has four
swings or more, and its best delay. Its numbers of plays and of dead zones are chosen on
parts of the time that are left out. The measured side holds the dead zones, as in [6]:
G(v) - S^-1(y) = 0, which is linear in all unknowns.
"""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import minimize_scalar

from dbo_cli.arrays import Booleans, Floats, Integers
from dbo_cli.compare.plays import EMPTY, Plays, places
from dbo_cli.errors import FitError
from dbo_cli.identification.recording import Recording, Swings, falling
from dbo_cli.identification.search import FEWEST_SWINGS
from dbo_cli.identification.solve import nonnegative
from dbo_cli.model import Points, Scale
from dbo_cli.model.points import Curves
from dbo_cli.signals import usual_step

FIT_ROWS = 3000  # of all logs together; 7,000 changed no error by more than 1 %
PLAY_COUNTS = (12, 25, 50)  # to choose from; 25 is what the paper takes
SEGMENT_COUNTS = (1, 2, 4, 8)  # of the dead zones' curve, to choose from; 1: none
FOLDS = 6  # blocks of time that are left out in turn
SLOPE_FLOOR = 0.03  # of the mean slope: what a slope is at least
STEEPEST = 10.0  # times the mean slope: the steepest piece of the dead zones' curve
NORMALISING = 1e3  # times all rows: weight of the row that fixes the curve's mean slope
RESTING = 1e-9  # of a column's length: what is left of one that rests, by rounding
WORTH = 0.02  # by which more plays or segments must lower the error on what is left out
MOST_DELAY_ROWS = 48.0  # rows
FINEST_DELAY = 0.125  # of a row: to so much the delay is found
DELAY_OF_SWING = 0.1  # of a swing
FASTEST_SHARE = 0.999  # of the rows are slower than the second set of weights of [7]


@dataclass(frozen=True)
class Design:
    """An operator to compare with, and what is fixed before the least-squares problem is solved.

    Attributes
    ----------
    name, words
        What it is called, and what it is.
    plays, segments
        Of the operator, and of the dead zones' curve; 1: no choice.
    delay
        Of the output, in rows.
    falling
        Whether slopes fall from play to play: loops that soften after a turn.
    by_rate, free_first, one_sided
        What [7], [8] and [9] have: two sets of weights, a first weight without a bound,
        one-sided plays and a cubic.
    """

    name: str
    words: str
    plays: int = PLAY_COUNTS[1]
    segments: int = 1
    delay: float = 0.0
    falling: bool = False
    by_rate: bool = False
    free_first: bool = False
    one_sided: bool = False

    @property
    def radii(self) -> Floats:
        """The radii, spread evenly: below half of the range, or of one-sided plays the whole."""
        even = np.arange(self.plays) / self.plays
        return even if self.one_sided else 0.5 * even


RIVALS = (
    Design("line", "straight line", plays=1),
    Design("pi", "Prandtl-Ishlinskii, plays [6]"),
    Design("modified", "plays and dead zones [6]", segments=8),
    Design("rate", "rate-dependent, dead zones [7]", segments=8, by_rate=True),
    Design("extended", "singularity-free, dead zones [8]", segments=8, free_first=True),
    Design("asymmetric", "one-sided plays and a cubic [9]", one_sided=True),
)


class RivalProblem:
    """All logs in units of the fit.

    Parameters
    ----------
    logs : sequence of Recording
        Of which the usable rows are fitted.

    Attributes
    ----------
    rows : list of array of int
        The rows of each log that are fitted.
    output : array of shape (rows,)
        Displacement of all fitted rows, scaled to 0..1, rising with the drive.
    drift : array of shape (rows, unknowns)
        For each log an offset, and a line in time where it has swings enough.
    fold : array of int
        The block of time of each row.
    low, high : float
        The ends of the drive.
    scale : Scale
        From the output of the fit to the displacement.
    longest_delay : float
        In rows.
    fastest : float
        Of [7]: the rate (1/s, scaled drive) of the second set of weights; 0 without a
        clock.
    """

    def __init__(self, logs: Sequence[Recording]) -> None:
        self.logs = logs
        self.low = min(float(log.voltage.min()) for log in logs)
        self.high = max(float(log.voltage.max()) for log in logs)
        bottom = min(float(log.displacement.min()) for log in logs)
        top = max(float(log.displacement.max()) for log in logs)
        self.scale = Scale(top - bottom, bottom)
        if falling(logs):
            self.scale = Scale(bottom - top, top)
        stride = -(-sum(int(log.usable.sum()) for log in logs) // FIT_ROWS)
        self.rows: list[Integers] = []
        self.longest_delay = math.inf
        outputs, drifts, folds = [], [], []
        for log in logs:
            swings = Swings.of(log.voltage)
            longest = DELAY_OF_SWING * swings.usual_rows
            self.longest_delay = min(self.longest_delay, longest)
            rows = np.flatnonzero(log.usable)[::stride]
            if len(rows) < FOLDS:
                raise FitError(
                    f"{log.name}: only {len(rows)} rows to fit: leave it out"
                )
            self.rows.append(rows)
            outputs.append(self.scale.inverse(log.displacement[rows]))
            folds.append(np.arange(len(rows)) * FOLDS // len(rows))
            drift = np.ones((len(rows), 1))
            if len(swings.sizes) >= FEWEST_SWINGS:
                line = np.linspace(-1.0, 1.0, len(rows))
                drift = np.column_stack([drift, line])
            drifts.append(drift)
        self.output: Floats = np.concatenate(outputs)
        self.drift: Floats = block_diag(*drifts)
        self.fold: Integers = np.concatenate(folds)
        rates = [rates_of(self.scaled(log.voltage), log.time) for log in logs]
        self.fastest = float(np.quantile(np.concatenate(rates), FASTEST_SHARE))

    def scaled(self, voltage: Floats) -> Floats:
        """Return a drive, scaled to 0..1."""
        return (voltage - self.low) / (self.high - self.low)


def late(signal: Floats, delay: float) -> Floats:
    """Return a signal some rows later; its first value stands before it."""
    row = np.arange(float(len(signal)))
    return np.interp(row - delay, row, signal)


def rates_of(drive: Floats, time: Floats | None) -> Floats:
    """Return |change of the drive| a second since the sample before; 0 first, and without a clock."""
    if time is None:
        return np.zeros(len(drive))
    steps = np.diff(time)
    shortest = 0.01 * usual_step(steps)
    rates: Floats = np.abs(np.diff(drive)) / np.maximum(steps, shortest)
    return np.concatenate([[0.0], rates])


class Rival:
    """A design with its least-squares problem, its solution and what is made of that.

    Attributes
    ----------
    columns : array of shape (rows, weights)
        Of the unknown weights: z_i, or where slopes fall z_0 - z_i behind the first; of
        [7] once at rest and once at the fastest rate; of [9] behind two columns of the
        cubic, whose unknowns are its slopes at both ends.
    """

    def __init__(self, design: Design, problem: RivalProblem) -> None:
        self.design, self.problem = design, problem
        tables = []
        for log, rows in zip(problem.logs, problem.rows, strict=True):
            drive = problem.scaled(late(log.voltage, design.delay))
            z = places(design.radii, design.one_sided, drive, rows)
            if design.one_sided:
                cube = z[:, :1] ** 3 / 3.0
                tables.append(np.hstack([z[:, :1] - cube, cube, z[:, 1:]]))
                continue
            if design.falling:
                z[:, 1:] = z[:, :1] - z[:, 1:]
            if design.by_rate:
                share = self.shares(drive, log.time)[rows, None]
                z = np.hstack([(1.0 - share) * z, share * z])
            tables.append(z)
        self.columns: Floats = np.concatenate(tables)

    def solve(
        self, rows: Booleans | slice = slice(None)
    ) -> tuple[Floats, Points, Floats]:
        """Return weights, the curve of the dead zones, and drift, which fit some of the rows best."""
        columns, output = self.columns[rows], self.problem.output[rows]
        drift, segments = self.problem.drift[rows], self.design.segments
        begins = np.arange(segments) / segments
        ramps = np.clip(output[:, None] - begins, 0.0, 1.0 / segments)
        # scale: one more row says that the curve's slopes have the mean 1
        weight = NORMALISING * math.sqrt(len(output))
        fixing = np.zeros(columns.shape[1] + segments)
        fixing[columns.shape[1] :] = weight / segments
        matrix = np.vstack([np.hstack([columns, -ramps]), fixing])
        right = np.append(np.zeros(len(output)), weight)
        drift = np.vstack([drift, np.zeros(drift.shape[1])])
        # weights of at least 0, and slopes where no play has moved
        lower = np.zeros(columns.shape[1])
        lower[0] = -np.inf if self.design.free_first else SLOPE_FLOOR
        if self.design.by_rate:
            lower[self.design.plays] = SLOPE_FLOOR
        if self.design.one_sided:
            lower[1] = SLOPE_FLOOR
        lower = np.append(lower, np.full(segments, 1.0 / STEEPEST))
        bounded, offsets = bounded_minimum(matrix, drift, right, lower)
        weights, slopes = np.split(bounded, [columns.shape[1]])
        curve = Points(slopes / segments, np.full(segments, 1.0 / segments))
        return weights, curve, offsets

    def errors(self, rows: Booleans | slice = slice(None)) -> Floats:
        """Return the error of the output in each row, of the solution for some of them."""
        weights, curve, drift = self.solve(rows)
        bare = self.columns @ weights + self.problem.drift @ drift
        return curve(bare) - self.problem.output

    @functools.cached_property
    def fit_error(self) -> float:
        """The RMS error on all rows."""
        return float(np.sqrt(np.mean(self.errors() ** 2)))

    @functools.cached_property
    def left_out_error(self) -> float:
        """The RMS error on blocks of time that are left out in turn."""
        squares = 0.0
        for fold in range(FOLDS):
            left_out = self.problem.fold == fold
            squares += float(np.sum(self.errors(~left_out)[left_out] ** 2))
        return math.sqrt(squares / len(self.problem.output))

    @functools.cached_property
    def operator(self) -> tuple[Plays, float, Curves]:
        """The plays, the first log's offset behind them, and from there to the displacement."""
        weights, curve, drift = self.solve()
        curves = Curves([self.problem.scale])
        if self.design.segments > 1:
            curves = Curves([curve, *curves])
        return plays_of(self.design, weights), float(drift[0]), curves

    def shares(self, drive: Floats, time: Floats | None) -> Floats:
        """Return how much of the second set of weights counts in each row; of [7] alone."""
        if not self.design.by_rate:
            return EMPTY
        if time is None or not self.problem.fastest > 0.0:
            raise FitError("the rate needs a clock: give `time` or `sample_rate`")
        return np.minimum(rates_of(drive, time) / self.problem.fastest, 1.0)

    def simulate(self, voltage: Floats, time: Floats | None = None) -> Floats:
        """Return the displacement for a voltage, without the delay."""
        plays, offset, curves = self.operator
        x = self.problem.scaled(voltage)
        return curves(plays.run(x, self.shares(x, time)) + offset)

    def invert(
        self, desired: Floats, first: float, time: Floats | None = None
    ) -> Floats:
        """Return the voltage for a displacement; it stands at ``first`` (V) before.

        Of [7] the drive's rate is taken from what is wanted, whose range is the drive's.
        """
        plays, offset, curves = self.operator
        problem, design = self.problem, self.design
        begin = float(problem.scaled(np.array([first]))[0])
        u = curves.inverse(desired) - offset
        if design.by_rate or design.free_first or design.one_sided:
            x = plays.solve(u, begin, self.shares(u, time))
        else:
            x = plays.closed_inverse(u, begin)
        return problem.low + (problem.high - problem.low) * x

    def predict(self, log: Recording) -> Floats:
        """Return the displacement that a log's drive leads to, the delay included."""
        return self.simulate(late(log.voltage, self.design.delay), log.time)

    def expected(self, rmse: float) -> float:
        """Return the error on new moves: what left-out parts add to that of the fit."""
        return rmse * max(self.left_out_error / max(self.fit_error, 1e-12), 1.0)

    @property
    def parameters(self) -> int:
        """How many numbers were fitted, the offset and the delay among them."""
        design = self.design
        weights = design.plays * (1 + design.by_rate) + design.one_sided
        return weights + design.segments - 1 + 1 + (design.delay > 0.0)


def bounded_minimum(
    matrix: Floats, drift: Floats, right: Floats, lower: Floats
) -> tuple[Floats, Floats]:
    """Return x >= least and z that minimise |matrix x + drift z - right|; least -inf: free.

    What is free is projected out, what is left are non-negative least squares.
    """
    bound = np.isfinite(lower)
    x: Floats = np.where(bound, lower, 0.0)
    free = np.hstack([matrix[:, ~bound], drift])
    base = np.linalg.qr(free).Q
    table = np.column_stack([matrix[:, bound], right - matrix @ x])
    lengths = np.linalg.norm(table, axis=0)
    table -= base @ (base.T @ table)
    # a play that does not move in these rows is an offset: nothing tells its weight
    table[:, np.linalg.norm(table, axis=0) <= RESTING * lengths] = 0.0
    triangle = np.linalg.qr(table).R
    x[bound] += nonnegative(triangle[:, :-1], triangle[:, -1])
    unbounded: Floats = np.linalg.pinv(free) @ (right - matrix @ x)
    alone = np.count_nonzero(~bound)
    x[~bound] = unbounded[:alone]
    return x, unbounded[alone:]


def plays_of(design: Design, weights: Floats) -> Plays:
    """Return the plays with the weights that were fitted.

    Raises
    ------
    FitError
        The last slope of [8] is not above 0, so that there is no inverse.
    """
    if design.one_sided:
        falling, rising = weights[:2]
        curve = np.array([(rising - falling) / 3.0, falling])
        plays = np.concatenate([[0.0], weights[2:]])
        return Plays(design.radii, plays, True, curve=curve)
    if not weights.sum() > 0.0:
        raise FitError("the best fit has no inverse: its last slope is not positive")
    sets = np.split(weights, 1 + design.by_rate)
    if design.falling:
        sets = [np.append(members.sum(), -members[1:]) for members in sets]
    by_rate = EMPTY
    if design.by_rate:
        by_rate = sets[1] - sets[0]
    return Plays(design.radii, sets[0], by_rate=by_rate)


def fit(design: Design, problem: RivalProblem) -> Rival:
    """Return a rival with the best delay, and with no more plays and dead zones than help.

    Raises
    ------
    FitError
        It cannot be fitted to these logs; the message says why.
    """
    rival = with_delay(design, problem)
    if design.plays > 1 and not (design.free_first or design.one_sided):
        softening = with_delay(replace(design, falling=True), problem)
        rival = min(rival, softening, key=lambda each: each.fit_error)
    if design.segments > 1:
        designs = [replace(rival.design, segments=m) for m in SEGMENT_COUNTS]
        rival = simplest(designs, problem)
    if design.plays > 1:
        designs = [replace(rival.design, plays=n) for n in PLAY_COUNTS]
        rival = simplest(designs, problem)
    return rival


def with_delay(design: Design, problem: RivalProblem) -> Rival:
    """Return a rival with the delay of least error."""

    def delayed(delay: float) -> Rival:
        return Rival(replace(design, delay=float(delay)), problem)

    found = minimize_scalar(
        lambda delay: delayed(delay).fit_error,
        bounds=(0.0, min(problem.longest_delay, MOST_DELAY_ROWS)),
        method="bounded",
        options={"xatol": FINEST_DELAY},
    )
    rivals = delayed(0.0), delayed(found.x)
    return min(rivals, key=lambda rival: rival.fit_error)


def simplest(designs: Sequence[Design], problem: RivalProblem) -> Rival:
    """Return the rival of the first design, simplest first, that no later one betters by much."""
    rivals = [Rival(design, problem) for design in designs]
    smallest = min(rival.left_out_error for rival in rivals)
    return next(r for r in rivals if r.left_out_error <= (1.0 + WORTH) * smallest)
