"""What to expect of a model on new moves inside the range: the figure that a user relies on.

Two things are added as squares. What the logs themselves can tell: the error on
amplitudes, levels and speeds left out of the fit in turn. And what they cannot tell:
other models, with other slopes, another lag, memory or bend, may explain the logs as
well and yet predict other things. They are kept with the model and played over every
move (``hysteresis/move_error.py``); the figure without a move is that of invented ones:
random nested turns over the whole range, at the speeds of the logs.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import FitError
from dbo_cli.hysteresis.excitation import AT_AN_END
from dbo_cli.hysteresis.identification.evaluation import (
    FEWEST_SWINGS,
    TINY,
    Judged,
    most_noise,
    pooled,
    residual_of,
)
from dbo_cli.hysteresis.identification.finalists import stages_of
from dbo_cli.hysteresis.identification.normal_equations import (
    Solution,
    Structure,
    dot,
    sum_of_squares,
)
from dbo_cli.hysteresis.identification.output_error import Candidate, corners
from dbo_cli.hysteresis.identification.preparation import Prepared, level_moves
from dbo_cli.hysteresis.identification.recordings import (
    FEWEST_ROWS,
    MOST,
    Floats,
    Recording,
)
from dbo_cli.hysteresis.identification.search import BEND_STEP, Choice, sample_period
from dbo_cli.hysteresis.identification.statistics import (
    LENGTHS,
    Basis,
    PreparedLog,
    fewer_rows,
    gather,
    groupings,
    groups_left_out,
    swings_of,
    weighted,
)
from dbo_cli.hysteresis.model import ActuatorModel, Relaxation, ScaleStage
from dbo_cli.hysteresis.move_error import (
    ZERO_STAYS,
    Alternative,
    StatedError,
    capped,
    changed_gain,
    moving_zero,
    played,
    rms,
    spread,
    stated,
    swings_between_turns,
    thinned,
    unlike,
)

LIKELIHOOD_WIDTH = 0.1
"""A model whose RMSE is this share above the chosen one's counts exp(-1). Measured: docs/choices.md."""

MOVES = 26  # swings of the invented drive; what another drive changes stands below
# of them all; 1,500 and 6,000 led to 0.997 to 1.003 of the stated errors of ten logs
MOVE_ROWS = 3000
MOVE_SEED = 20180701  # any number: with 1, 2 and 3 they were 0.81 to 1.01 of these


FORGETTING_EXPLAINS = 0.8
"""Memories that fade with the way gone must leave at most this share of the squared error beyond noise.
Measured: docs/choices.md.
"""


@dataclass(frozen=True)
class Expectation:
    """The expected error of the invented moves and its parts, in the displacement's unit.

    ``known`` is the error on what was left out of the fit; ``fitted`` the equation
    error that was fitted, in the normalised output; ``alternatives`` the models that
    explain the logs as well, and ``figure`` the error stated for the invented moves;
    ``seen`` some of the logs' swings, ``swings`` their number; ``left_out`` names what
    was left out; ``gain_trend`` by how much the gain changes along a log where that
    makes most of the error; ``line`` what a straight line leaves of what was left out,
    RMS, ``zero_drift`` by how much the zero moved along a log and ``zero_drift_rate``
    how fast, a second, all in the displacement's unit; ``one_level`` whether the mean
    of the drive stays where it is, from cycle to cycle.
    """

    known: float
    fitted: float
    figure: StatedError
    alternatives: tuple[Alternative, ...]
    seen: Floats
    left_out: tuple[str, ...]
    swings: int
    gain_trend: float | None
    line: float
    zero_drift: float
    zero_drift_rate: float
    one_level: bool

    @property
    def rmse(self) -> float | None:
        """The expected RMSE; None where the logs have no way up and down that another one could predict."""
        return None if self.swings < FEWEST_SWINGS else self.figure.rmse

    @property
    def shape(self) -> float | None:
        """The expected RMS of the error less its mean; None as ``rmse`` is."""
        return None if self.swings < FEWEST_SWINGS else self.figure.shape

    @property
    def zero(self) -> float | None:
        """The expected size of the mean error; None as ``rmse`` is."""
        return None if self.swings < FEWEST_SWINGS else self.figure.zero

    @property
    def forgets(self) -> bool:
        """Whether the displacement forgets with the way gone, which no gears do."""
        return any(model.forgetting is not None for model in self.alternatives)

    def swing_values(self) -> list[list[float]]:
        """Return the logs' swings for the model file: from which voltage to which."""
        values = []
        for start, end in self.seen.tolist():
            values.append([float(f"{start:.4g}"), float(f"{end:.4g}")])
        return values

    def zero_words(self, unit: str) -> str:
        """Say under which condition the zero is as stated; ``unit`` follows a number."""
        if self.zero_drift > self.known:
            moved = f"{self.zero_drift:.2g}{unit}"
            return f"it moved by {moved} along a log, which may go on and is not in the whole"
        if self.one_level:
            return "logs at one mean level hardly tell creep from a moving zero"
        return ZERO_STAYS

    def words(self) -> str:
        """Say what the figure rests on, or why there is none."""
        if self.swings < FEWEST_SWINGS:
            return "the logs go up and down less than twice, so nothing could be left out: record more"
        spread = "how far other models that explain the logs as well go apart (more for swings unlike theirs)"
        if not self.left_out:
            return f"whole cycles left out of the fit (nothing else could be), and {spread}"
        return (
            f"{' and '.join(self.left_out)} left out of the fit in turn, and {spread}"
        )


def expect(
    prepared: Prepared, choice: Choice, model: ActuatorModel, judged: Judged
) -> Expectation:
    """Estimate the error on new moves.

    The equation error, which counts on the wrong side of the asymmetry, is brought over
    to the output's by the ratio of the two.

    Parameters
    ----------
    prepared : the logs as they were fitted
    choice : what the search settled on
    model : what was made of it
    judged : what the model leaves of its own logs
    """
    logs = fewer_rows(prepared.logs)
    basis, structure = choice.basis, choice.structure
    own, square = gather(logs, basis, structure.segments).solved(structure)
    fitted = max(float(np.sqrt(square)), 1e-12)
    floor = judged.noise * fitted**2
    cycles = max(choice.score.rmse, fitted)
    held_out, left_out = groups_left_out(logs, basis, structure, cycles)
    known = judged.rmse * held_out / fitted
    trend = _gain_trend(logs, choice, own, floor)
    swings = np.vstack(
        [swings_between_turns(log.voltage, basis.span)[1] for log in logs]
    )
    seen = thinned(swings, basis.span)
    moves = _invented_moves(logs, basis)
    own_moves, others, apart = _alternatives(
        prepared, logs, choice, model, moves, fitted, floor
    )
    distance = unlike(moves[0], seen, basis.span, len(moves[0]) - len(own_moves))
    drifted = changed_gain(own_moves, trend)
    line = abs(prepared.scale) * line_left_out(logs, basis)
    lasted = 0.0
    if logs[0].seconds is not None:
        lasted = float(moves[1][-1] - moves[1][0])
    zero = moving_zero(judged.zero_drift, judged.zero_drift_rate, lasted)
    figure = stated(known, distance, apart, drifted, zero)
    return Expectation(
        known=known,
        fitted=fitted,
        figure=capped(figure, line),
        alternatives=others,
        seen=seen,
        left_out=left_out,
        swings=len(swings),
        gain_trend=trend,
        line=line,
        zero_drift=judged.zero_drift,
        zero_drift_rate=judged.zero_drift_rate,
        one_level=_one_level(prepared),
    )


def _one_level(prepared: Prepared) -> bool:
    """Return whether the mean of the drive stays where it is, from cycle to cycle."""
    shapes = zip(prepared.shapes, prepared.logs, strict=True)
    return not any(level_moves(shape, log.voltage) for shape, log in shapes)


def line_left_out(logs: Sequence[PreparedLog], basis: Basis) -> float:
    """Return what a straight line leaves of groups of swings left out of its fit, RMS, the worst grouping.

    It is in units of the normalised output; offset and drift are fitted beside it.
    Where nothing can be left out it is that of all rows.
    """
    voltage = [(log.voltage - basis.low) / basis.span for log in logs]
    everywhere = [log.used for log in logs]
    worst = _line_error(logs, voltage, everywhere, everywhere)
    for _, grouped in groupings(logs, basis):
        squares, rows = 0.0, 0
        for group in range(1, 1 + max(int(log.fold.max()) for log in grouped)):
            mine = [log.fold == group for log in grouped]
            rest = [log.used & (log.fold != group) for log in grouped]
            count = sum(int(some.sum()) for some in mine)
            if (
                count < FEWEST_ROWS
                or sum(int(some.sum()) for some in rest) < FEWEST_ROWS
            ):
                continue
            squares += count * _line_error(grouped, voltage, rest, mine) ** 2
            rows += count
        if rows:
            worst = max(worst, float(np.sqrt(squares / rows)))
    return worst


def _line_error(
    logs: Sequence[PreparedLog],
    voltage: Sequence[Floats],
    fitted: Sequence[NDArray[np.bool_]],
    judged: Sequence[NDArray[np.bool_]],
) -> float:
    """Return what the slope of some rows leaves of others, RMS, each log's offset and drift taken off."""
    free = [
        _free_of_drift(log, x, rows)
        for log, x, rows in zip(logs, voltage, fitted, strict=True)
    ]
    together = sum(dot(x, y) for x, y in free)
    slope = together / max(sum(sum_of_squares(x) for x, _ in free), TINY)
    squares, count = 0.0, 0
    for log, x, rows in zip(logs, voltage, judged, strict=True):
        if rows.any():
            moved, output = _free_of_drift(log, x, rows)
            left = output - slope * moved
            squares += sum_of_squares(left)
            count += left.size
    return float(np.sqrt(squares / count))


def _free_of_drift(
    log: PreparedLog, voltage: Floats, rows: NDArray[np.bool_]
) -> tuple[Floats, Floats]:
    """Return voltage and output of some rows of a log without the offset and drift of those rows."""
    if not rows.any():
        return np.zeros(0), np.zeros(0)
    weights = log.weights_at(rows)
    table = weighted(np.column_stack((voltage[rows], log.output[rows])), weights)
    columns = weighted(log.drift[rows], weights)
    left: Floats = table - columns @ np.linalg.lstsq(columns, table, rcond=None)[0]
    return left[:, 0], left[:, 1]


def _gain_trend(
    logs: Sequence[PreparedLog], choice: Choice, solution_before: Solution, floor: float
) -> float | None:
    """Return by how much the gain changes along a log, where that explains most of the error beyond noise.

    A part of the output that grows along the log goes through the slope of the
    asymmetry's inverse as a change of the output does. So does a zero that moves, which
    is no change of the gain: what that explains does not count. ``floor`` is the mean
    square that is noise.
    """
    steepness = (
        np.diff(corners(solution_before.knots, choice.structure.segments))
        * choice.structure.segments
    )
    moving, changing = [], []
    for log in logs:
        place = np.clip(
            (log.output * len(steepness)).astype(np.int64), 0, len(steepness) - 1
        )
        grown = steepness[place] * np.linspace(-0.5, 0.5, len(log.output))
        moving.append(replace(log, drift=np.column_stack((log.drift, grown))))
        changing.append(
            replace(log, drift=np.column_stack((log.drift, grown, grown * log.output)))
        )
    lefts = []
    for some in (moving, changing):
        solution, left = gather(some, choice.basis, choice.structure.segments).solved(
            choice.structure
        )
        lefts.append(left)
    rows = sum(int(log.used.sum()) for log in logs)
    if lefts[0] <= most_noise(floor, rows) or lefts[1] - floor > MOST * (
        lefts[0] - floor
    ):
        return None
    last = np.cumsum([log.drift.shape[1] for log in changing]) - 1
    return float(max(solution.drift[last], key=abs))


def _alternatives(
    prepared: Prepared,
    logs: Sequence[PreparedLog],
    choice: Choice,
    model: ActuatorModel,
    moves: tuple[Floats, Floats],
    fitted: float,
    floor: float,
) -> tuple[Floats, tuple[Alternative, ...], StatedError]:
    """Return what the model makes of invented moves, the other models, and how far these are from it there.

    Of each kind of change the one that goes farthest is kept. None counts that leaves
    as much of the logs as a straight line does.
    """
    drive, seconds = moves
    begin = int(np.argmax(drive >= choice.basis.high - 1e-9 * choice.basis.span))
    steps = None if logs[0].seconds is None else np.diff(seconds, prepend=0.0)
    # the first two swings wipe out the start
    own = played(model, drive, steps)[2 * begin :]
    least, level = _on_logs(model, prepared, logs)
    every = [log.used for log in logs]
    voltages = [(log.voltage - choice.basis.low) / choice.basis.span for log in logs]
    line = abs(prepared.scale) * _line_error(logs, voltages, every, every)
    farthest: dict[str, tuple[float, Alternative, Floats]] = {}
    gathered = {}
    for kind, basis, structure in _changes(choice, logs):
        if basis not in gathered:
            gathered[basis] = gather(logs, basis, structure.segments)
        try:
            solution, _ = gathered[basis].solved(structure)
        except FitError:
            continue
        other = _other(solution, basis, structure, prepared, model)
        rmse, mean = _on_logs(other, prepared, logs)
        if rmse >= line:
            continue
        other = _shifted(other, level - mean)
        one = Alternative(
            kind, float(np.exp(-max(rmse / least - 1.0, 0.0) / LIKELIHOOD_WIDTH)), other
        )
        predicted = played(other, drive, steps)[2 * begin :]
        apart = one.weight * rms(predicted - own)
        if kind not in farthest or apart > farthest[kind][0]:
            farthest[kind] = apart, one, predicted
    found = [(one, predicted) for _, one, predicted in farthest.values()]
    for one in _forgetting(prepared, logs, choice, model, fitted, floor):
        found.append((one, one.played(drive, steps)[2 * begin :]))
    return own, tuple(one for one, _ in found), spread(own, found)


def _other(
    solution: Solution,
    basis: Basis,
    structure: Structure,
    prepared: Prepared,
    model: ActuatorModel,
) -> ActuatorModel:
    """Return what was fitted with another basis or structure as a model."""
    candidate = Candidate(basis, structure, solution.vector)
    return replace(model, stages=stages_of(candidate, prepared, 0.0), fit={})


def _forgetting(
    prepared: Prepared,
    logs: Sequence[PreparedLog],
    choice: Choice,
    model: ActuatorModel,
    fitted: float,
    floor: float,
) -> tuple[Alternative, ...]:
    """Return the model that forgets with the way gone, if it explains the logs far better than the chosen.

    ``fitted`` is the chosen one's equation error, RMS.
    """
    basis, count = (
        replace(choice.basis, lengths=LENGTHS),
        len(choice.basis.time_constants),
    )
    more = tuple(range(count, count + len(LENGTHS)))
    structure = replace(choice.structure, memories=(*choice.structure.memories, *more))
    try:
        solution, left = gather(logs, basis, structure.segments).solved(structure)
    except FitError:
        return ()
    rows = sum(int(log.used.sum()) for log in logs)
    if fitted**2 <= most_noise(floor, rows) or left - floor > FORGETTING_EXPLAINS * (
        fitted**2 - floor
    ):
        return ()
    per_volt = tuple((solution.gains[count:] / basis.span).tolist())
    memory = Relaxation(
        basis.low, tuple(length * basis.span for length in LENGTHS), per_volt
    )
    forgetful = Alternative(
        "forgetting", 1.0, _other(solution, basis, structure, prepared, model), memory
    )
    log = logs[0]
    steps = None
    if log.seconds is not None:
        steps = np.diff(log.seconds, prepend=log.seconds[0])
    apart = played(model, log.voltage, steps) - forgetful.played(log.voltage, steps)
    shifted = _shifted(forgetful.model, float(apart[log.used].mean()))
    return (replace(forgetful, model=shifted),)


def _changes(
    choice: Choice, logs: Sequence[PreparedLog]
) -> Iterator[tuple[str, Basis, Structure]]:
    """Yield what may differ from the chosen model: (the thing, basis, structure).

    Delays, segments and roughness of the asymmetry, free slopes and fits without one
    fold changed nothing in how well the figure agrees with what came
    (benchmarks/foreign_plants.py).
    """
    basis, structure = choice.basis, choice.structure
    for factor in (0.01, 100.0):
        yield (
            "smoothness",
            basis,
            replace(structure, smoothness=factor * structure.smoothness),
        )
    for bend in (-BEND_STEP, BEND_STEP):
        if abs(basis.bend + bend) < 1.0:
            yield "bend", replace(basis, bend=basis.bend + bend), structure
    if basis.time_constants:
        yield "memory", basis, replace(structure, memories=())
        # halfway to the next of the grid
        longer = tuple(1.7 * tau for tau in basis.time_constants)
        yield "memory", replace(basis, time_constants=longer), structure
    if choice.delay_interval is not None and (
        basis.delay > 0.0 or not basis.time_constants
    ):
        # The same lateness as a first-order lag: where a delay was found, in its place.
        taus = sorted(
            {basis.delay or sample_period(logs) or 1.0, *basis.time_constants}
        )
        every = tuple(range(len(taus)))
        yield (
            "lag",
            replace(basis, delay=0.0, time_constants=tuple(taus)),
            replace(structure, memories=every),
        )


def _on_logs(
    model: ActuatorModel, prepared: Prepared, logs: Sequence[PreparedLog]
) -> tuple[float, float]:
    """Return a model's RMSE on the logs, drift fitted, and the mean displacement it predicts of the first."""
    left, means = [], []
    for log in logs:
        moved = prepared.offset + prepared.scale * log.output
        residual = residual_of(
            model, Recording(log.name, log.voltage, moved, log.seconds), log
        )
        left.append(residual)
        means.append(residual.mean_predicted)
    return pooled([residual.rmse for residual in left], left), means[0]


def _shifted(model: ActuatorModel, by: float) -> ActuatorModel:
    """Return a model whose displacement is ``by`` larger."""
    stages = list(model.stages)
    for place, stage in enumerate(stages):
        if isinstance(stage, ScaleStage):
            stages[place] = replace(stage, offset=stage.offset + by)
    return replace(model, stages=tuple(stages))


def _invented_moves(logs: Sequence[PreparedLog], basis: Basis) -> tuple[Floats, Floats]:
    """Voltage and seconds of random nested turns over the whole range, as fast as the logs' own swings."""
    rng = np.random.default_rng(MOVE_SEED)
    speeds = np.concatenate([swings_of(log, basis).speed for log in logs])
    slow, fast = np.percentile(speeds, [10.0, 90.0])
    turns = [0.0, 1.0, 0.0]
    for _ in range(MOVES - 2):
        if rng.random() < AT_AN_END:
            turns.append(float(rng.choice((0.0, 1.0))))
        else:
            turns.append(rng.random())
    total = float(np.abs(np.diff(turns)).sum())
    voltage, seconds = [np.zeros(1)], [np.zeros(1)]
    for begin, end in itertools.pairwise(turns):
        distance = abs(end - begin)
        duration = max(distance, 0.02) / float(np.exp(rng.uniform(slow, fast)))
        count = max(int(MOVE_ROWS * distance / total), 6)
        part = np.arange(1, count + 1) / count
        voltage.append(begin + (end - begin) * (0.5 - 0.5 * np.cos(np.pi * part)))
        seconds.append(seconds[-1][-1] + duration * part)
    return basis.low + basis.span * np.concatenate(voltage), np.concatenate(seconds)
