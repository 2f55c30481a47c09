"""The last choice: candidates at their least error of the output, judged by it on parts left out.

The search (``search``) is convex and quick, and ranks by the equation error. What it
chose stands here beside simpler and other models: without its delay, without memories,
with other rules for the slopes, from gears alone to many segments. What it chose holds
unless another does better by more than the error bar; among those as good as the best
the simplest is taken. It is refined on more rows, and becomes the stages of a model.

What a linear frequency response explains far better than gears do is not of this class:
a mass on a spring whose restoring force has hysteresis swings, which no model of gears
with memories follows, but a linear filter does. The filter here is a finite impulse
response, fitted by least squares with a little damping, and judged on quarters of each
log left out in turn, as the candidates are.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from dbo_cli.errors import FitError
from dbo_cli.hysteresis.identification.normal_equations import (
    KNOT_SMOOTHNESS,
    SLOPE_FLOOR,
    Structure,
    least_squares,
    sum_of_squares,
)
from dbo_cli.hysteresis.identification.output_error import (
    BLOCKS,
    TINY,
    Candidate,
    OutputProblem,
    finer,
    output_problem,
)
from dbo_cli.hysteresis.identification.preparation import Prepared
from dbo_cli.hysteresis.identification.recordings import (
    EVEN,
    Floats,
    IdentificationOptions,
    Integers,
    Recording,
    drive_shape,
)
from dbo_cli.hysteresis.identification.search import Choice, swings_of_two_kinds
from dbo_cli.hysteresis.identification.statistics import (
    EARNED,
    FIT_ROWS,
    INDIFFERENCE,
    Basis,
    PreparedLog,
    Score,
    fewer_rows,
    gather,
    weighted,
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

JUDGED_ROWS = 4000  # of the logs
# different slopes, at most; what is delivered begins with theirs and has all
JUDGED_GEARS = 64
# times the least RMS error among candidates of as many segments: more are not tried
OUT_OF_REACH = 1.5
SEGMENTS = ((1, KNOT_SMOOTHNESS), (2, KNOT_SMOOTHNESS), (4, KNOT_SMOOTHNESS), (8, KNOT_SMOOTHNESS),
            (16, KNOT_SMOOTHNESS), (32, 1e-7))  # fmt: skip
"""Segments and smoothness of the asymmetry; each begins where the one before ended."""
FAR_BETTER = 0.5
"""Of the model's error: a linear response that leaves less shows dynamics that no gears follow. A plant whose
spring has hysteresis leaves a third; a servo with a current limit 0.7, and is followed
well enough.
"""
SMOOTHNESS = (1e-6, 1e-8, 1e-10, 1e-12, 1e-16)  # of the slopes


def best_of(
    prepared: Prepared, choice: Choice, options: IdentificationOptions
) -> Candidate:
    """Return the candidate that predicts best what was left out; the simplest of those as good.

    Raises
    ------
    FitError
        No candidate can be solved.
    """
    return _Finalists(prepared, choice, options).best()


class _Finalists:
    """The candidates beside a choice, on some rows of the logs."""

    def __init__(
        self, prepared: Prepared, choice: Choice, options: IdentificationOptions
    ) -> None:
        self._full_logs: Sequence[PreparedLog] = prepared.logs
        self._logs: Sequence[PreparedLog] = fewer_rows(prepared.logs, JUDGED_ROWS)
        self._one_amplitude = prepared.one_amplitude
        self._gears = choice.basis.gears
        few = replace(choice.basis, gears=min(self._gears, JUDGED_GEARS))
        few = replace(few, split=choice.basis.gears * choice.basis.split // few.gears)
        if few.gears * few.split != choice.basis.gears * choice.basis.split:
            few = choice.basis  # a number of gears that the user fixed
        self._choice, self._options = replace(choice, basis=few), options
        self._problems: dict[Basis, OutputProblem] = {}
        self._alone: dict[tuple[Basis, Structure], Candidate] = {}

    def _problem(self, basis: Basis) -> OutputProblem:
        if basis not in self._problems:
            self._problems[basis] = output_problem(self._logs, basis)
        return self._problems[basis]

    def best(self) -> Candidate:
        """Return the winner."""
        chosen = self._judged_choice()
        if self._at_noise(chosen):
            return self._finalist(chosen)
        refined: list[Candidate] = []
        least_squares: dict[int, float] = {}
        basis = chosen.basis  # the delay has been judged
        for structure in self._starts(basis, least_squares):
            try:
                refined += self._within_reach(
                    self._chain(basis, structure), least_squares
                )
            except (
                FitError
            ):  # a candidate that cannot be solved is no reason to refuse the log
                continue
        # What is left out is predicted no better than what is fitted: most need not be
        # left out at all.
        refined.sort(key=lambda candidate: candidate.squares)
        judged = [chosen]
        least = chosen.score
        for candidate in refined:
            if candidate.least_score > least:
                break
            try:
                judged.append(self._problem(basis).judged(candidate))
            except FitError:
                continue
            least = min(least, judged[-1].score)
        winner = self._no_worse_than_simpler(self._winner(judged))
        return self._finalist(winner, self._beaten(winner))

    def _finalist(self, winner: Candidate, beaten: str = "") -> Candidate:
        """Return the winner with all the gears that were chosen."""
        parts = self._gears // winner.basis.gears
        basis = replace(
            winner.basis, gears=self._gears, split=winner.basis.split // parts
        )
        heights, rest = np.split(winner.vector, [winner.basis.gears])
        vector = np.concatenate((np.repeat(heights / parts, parts), rest))
        return replace(winner, basis=basis, vector=vector, beaten=beaten)

    def _no_worse_than_simpler(self, winner: Candidate) -> Candidate:
        """Return the winner, or what is simpler and has a smaller error.

        That is: itself without its delay, and gears alone; where they predict what was
        left out surely better, or fit the logs better by more than ``INDIFFERENCE``.
        """
        for structure in self._simpler(winner):
            basis = replace(winner.basis, delay=self._options.delay or 0.0)
            if structure.segments == 1:
                basis = replace(basis, bend=0.0)
            if (basis, structure) == (winner.basis, winner.structure):
                continue
            try:
                simpler = self._judged(basis, structure)
            except FitError:
                continue
            much_better = simpler.least_score < winner.least_score - math.log1p(
                INDIFFERENCE
            )
            if much_better or winner.surely_beaten_by(simpler):
                winner = simpler
        return winner

    def _simpler(self, winner: Candidate) -> Iterator[Structure]:
        """Yield the structures that are tried without a delay: the winner's, and gears alone."""
        yield winner.structure
        memories = (
            winner.structure.memories if self._options.relaxation is not None else ()
        )
        alone = replace(winner.structure, segments=1, memories=memories)
        if self._options.points in (None, 0, 1):
            yield replace(alone, knot_smoothness=KNOT_SMOOTHNESS)

    def _beaten(self, winner: Candidate) -> str:
        """Return what predicts parts left out better than the winner, in words; empty where nothing does."""
        straight = replace(winner.basis, delay=0.0, bend=0.0)
        line = self._problem(straight).line()
        if winner.surely_beaten_by(line):
            return (
                "parts of the logs that were left out are predicted better by a straight line "
                f"({_percent(line)}) than by any model of this class, gears alone among them "
                f"({_percent(winner)})"
            )
        quarters = winner.errors.get("blocks")
        fixed = (self._options.dynamics, self._options.delay, self._options.relaxation)
        if quarters is None or any(value is not None for value in fixed):
            return ""  # how the model behaves in time was the user's choice
        ours = math.sqrt(quarters.mean_square)
        linear = linear_response(self._full_logs, FAR_BETTER * ours)
        if linear is None or math.sqrt(linear.mean_square) > FAR_BETTER * ours:
            return ""
        return (
            "quarters of the logs that were left out are predicted far better by a linear frequency response "
            f"({100.0 * math.sqrt(linear.mean_square):.3g} % of the range) than by gears "
            f"({100.0 * ours:.3g} %): what swings is not of this class"
        )

    def _reaches(self, basis: Basis, alone: Structure, least: dict[int, float]) -> bool:
        """Return whether gears alone, of a smoothness not yet chosen, are not far worse than the best."""
        problem = self._problem(basis)
        start = np.zeros(problem.columns(1).total)
        squares = problem.refined(alone, start, steps=1).squares
        return squares <= OUT_OF_REACH**2 * least.get(1, np.inf)

    def _within_reach(
        self, chain: Iterator[Candidate], least: dict[int, float]
    ) -> Iterator[Candidate]:
        """Yield the candidates of a chain until one is far worse than others of as many segments.

        ``least`` holds the least sum of squares of each number of segments, and is
        brought up to date.
        """
        for refined in chain:
            yield refined
            segments = refined.structure.segments
            least[segments] = min(least.get(segments, np.inf), refined.squares)
            if refined.squares > OUT_OF_REACH**2 * least[segments]:
                return

    def _needed(self) -> float:
        """Return the share of the error by which another candidate has to do better."""
        return 1.0 / EARNED - 1.0 if self._one_amplitude else INDIFFERENCE

    def _at_noise(self, chosen: Candidate) -> bool:
        """Return whether the choice leaves so little beyond white noise that none could do so much better."""
        noise = self._problem(chosen.basis).noise(chosen)
        return chosen.score - 0.5 * math.log(noise + TINY) <= math.log1p(self._needed())

    def _winner(self, judged: Sequence[Candidate]) -> Candidate:
        """Return the simplest candidate within the error bar of the best; the choice where it is as good.

        What cannot be left out cannot be judged: among the cycles of one amplitude the
        larger model always wins, so there another one has to earn its place.
        """
        chosen = judged[0]
        best = min(judged, key=lambda candidate: candidate.score)
        if not chosen.beaten_by(best, self._needed()):
            return chosen
        as_good = []
        for candidate in judged:
            if not candidate.beaten_by(best, 0.0):
                as_good.append(candidate)
        return min(as_good, key=lambda each: (_complexity(each), each.score))

    def _judged_choice(self) -> Candidate:
        """Return what the search chose, refined and judged; without its delay where that is as good."""
        basis, structure = self._choice.basis, self._choice.structure
        chosen = self._judged(basis, structure)
        if not basis.delay or self._options.delay is not None:
            return chosen
        try:
            prompt = self._judged(replace(basis, delay=0.0), structure)
        except FitError:
            return chosen
        return chosen if prompt.beaten_by(chosen, 0.0) else prompt

    def _judged(self, basis: Basis, structure: Structure) -> Candidate:
        """Return one candidate, refined from gears alone and judged."""
        key = basis, structure
        if key not in self._alone:
            *_, last = self._chain(basis, structure, upto=structure)
            self._alone[key] = self._problem(basis).judged(last)
        return self._alone[key]

    def _starts(self, basis: Basis, least: dict[int, float]) -> Iterator[Structure]:
        """Yield gears alone of every chain of candidates that is within reach of the first one's."""
        every = tuple(range(len(basis.time_constants)))
        memories = [every]
        if self._options.relaxation is None and every:
            memories.append(())
        rules: tuple[str, ...] = ("growing", "falling")
        if swings_of_two_kinds(self._logs, basis):
            rules = (*rules, "free")
        chosen = self._choice.structure.slopes
        rules = (chosen, *(rule for rule in rules if rule != chosen))
        if self._options.slopes is not None or self._one_amplitude:
            rules = (chosen,)
        for slopes in rules:
            alone = Structure(slopes, memories[0], 1, self._choice.structure.smoothness)
            if slopes != chosen and not self._reaches(basis, alone, least):
                continue
            try:
                smoothest = self._problem(basis).smoothest(alone, SMOOTHNESS)
            except FitError:
                continue
            for some in memories:
                yield replace(smoothest, memories=some)

    def _chain(
        self, basis: Basis, structure: Structure, upto: Structure | None = None
    ) -> Iterator[Candidate]:
        """Yield the refined candidates of more and more segments, each begun where the last one ended."""
        problem = self._problem(basis)
        segments = list(SEGMENTS)
        if upto is not None:
            last = upto.segments
            coarser = [step for step in SEGMENTS if step[0] < last]
            segments = [step for step in coarser if last % step[0] == 0]
            segments.append((last, upto.knot_smoothness))
        elif self._options.points is not None:
            last = max(self._options.points, 1)
            segments = [(1, KNOT_SMOOTHNESS), (last, KNOT_SMOOTHNESS)]
        vector = np.zeros(problem.columns(1).total)
        before = 1
        for count, kinks in segments:
            some = replace(structure, segments=count, knot_smoothness=kinks)
            start = finer(vector, problem.columns(before), before, count)
            refined = problem.refined(some, start)
            vector, before = refined.vector, count
            if self._options.points is None or count == max(self._options.points, 1):
                yield refined


def _percent(candidate: Candidate) -> str:
    """Return the error left out, mean over the kinds, as a share of the range."""
    return f"{100.0 * math.exp(candidate.score):.3g} % of the range"


def _complexity(candidate: Candidate) -> float:
    """Return how much a candidate has: halvings of its segments, memories, delay, bend, free slopes."""
    basis, structure = candidate.basis, candidate.structure
    complexity = math.log2(structure.segments)
    if structure.memories:
        complexity += 1.0
    if basis.delay:
        complexity += 1.0
    if basis.bend:
        complexity += 1.0
    if structure.slopes == "free":
        complexity += 2.0
    return complexity


# --- the numbers of what was chosen, and its stages ---


def fit(logs: Sequence[PreparedLog], finalist: Candidate) -> Candidate:
    """Refine a finalist on ``FIT_ROWS`` rows, without the memories that do nothing.

    Raises
    ------
    FitError
        The solver failed.
    """
    finalist = _without_idle_memories(finalist)
    basis, structure = finalist.basis, finalist.structure
    some = fewer_rows(logs, FIT_ROWS)
    problem = output_problem(some, basis)
    best = problem.refined(structure, finalist.vector)
    convex = _convex(some, problem, structure)
    if convex is not None and convex.penalised * (1.0 - INDIFFERENCE) <= best.penalised:
        best = convex
    return replace(best, beaten=finalist.beaten)


def _without_idle_memories(candidate: Candidate) -> Candidate:
    """Return a candidate without the memories whose gains are next to nothing."""
    basis, structure = candidate.basis, candidate.structure
    least = SLOPE_FLOOR * candidate.heights.sum()
    acting = [k for k in structure.memories if candidate.gains[k] > least]
    if acting == list(range(len(basis.time_constants))):
        return candidate
    rest = candidate.vector[basis.gears + len(basis.time_constants) :]
    parts = (candidate.heights, candidate.gains[acting], rest)
    time_constants = tuple(basis.time_constants[k] for k in acting)
    return replace(
        candidate,
        basis=replace(basis, time_constants=time_constants),
        structure=replace(structure, memories=tuple(range(len(acting)))),
        vector=np.concatenate(parts),
    )


def _convex(
    logs: Sequence[PreparedLog], problem: OutputProblem, structure: Structure
) -> Candidate | None:
    """Return the solution of the equation error, which holds where the output's own gains too little.

    Where noise is small beside what no model of this class can follow, the two errors
    differ by their weights alone, and the convex problem's solution predicts as well or
    better.
    """
    try:
        statistics = gather(logs, problem.basis, structure.segments)
        solution, _ = statistics.solved(structure)
    except FitError:
        return None
    return problem.levelled(solution.vector, structure)


# of the range, in gears beyond its top; half and double: the same errors
MARGIN = 0.125


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
    candidate: Candidate, prepared: Prepared, shift: float, gears: int | None = None
) -> tuple[Stage, ...]:
    """Stages of the forward cascade: points on the drive, backlash with relaxation, point, scale, delay.

    Gears are in the unit of the voltage on their input and without a unit on their
    output (sum about 1); the scale stage carries the displacement's unit. ``shift`` is
    taken off the displacement. ``gears``: their number where the user fixed it.
    """
    basis = candidate.basis
    stages: list[Stage] = [basis.bend_points()] if basis.bend else []
    stages.append(_backlash_of(candidate, gears))
    segments = candidate.structure.segments
    if segments > 1:
        outputs = np.full(segments, 1.0 / segments)
        stages.append(PointStage(np.diff(candidate.knots), outputs, 0.0, 0.0))
    stages.append(ScaleStage(prepared.scale, prepared.offset - shift))
    if basis.delay > 0.0:
        stages.append(DelayStage(basis.delay))
    return tuple(stages)


def _backlash_of(candidate: Candidate, gears: int | None) -> BacklashStage:
    """Return the gears and the memories beside them; each slope is shared by neighbours.

    A drive that goes a little further than the logs did shall turn there as it does
    inside, so gears follow beyond either end, unless the user fixed their number.
    """
    basis = candidate.basis
    count = gears or basis.gears * basis.split
    places = (np.arange(count) + 0.5) * basis.gears / count
    slope = np.minimum(places, basis.gears - 1).astype(np.int64)
    heights = candidate.heights[slope] * basis.gears / count
    spare = 0 if gears is not None else int(MARGIN * count)
    heights = np.append(heights, np.full(2 * spare, heights[-1]))
    widths = np.full(len(heights), basis.span / count)
    x0 = basis.low - spare * widths[0]
    y0 = candidate.origin - spare * heights[-1]
    return BacklashStage(widths, heights, x0, y0, _relaxation_of(candidate))


def _relaxation_of(candidate: Candidate) -> Relaxation | None:
    """Return the memories that act, their gains per volt."""
    basis, gains = candidate.basis, candidate.gains
    acting = np.flatnonzero(gains > 0.0)
    if not acting.size:
        return None
    taus = tuple(float(basis.time_constants[k]) for k in acting)
    return Relaxation(basis.low, taus, tuple((gains[acting] / basis.span).tolist()))


def model_of(
    candidate: Candidate,
    prepared: Prepared,
    recording: Recording,
    zero: str | float,
    gears: int | None = None,
) -> ActuatorModel:
    """Build the forward model; its input range is what the logs cover."""
    stages = stages_of(candidate, prepared, zero_shift(recording, zero), gears)
    low, high = slow_output_range(stages, prepared.low, prepared.high)
    return ActuatorModel(
        direction="forward",
        input=Quantity(
            recording.voltage_quantity,
            recording.voltage_unit,
            prepared.low,
            prepared.high,
        ),
        output=Quantity(
            recording.displacement_quantity, recording.displacement_unit, low, high
        ),
        stages=stages,
    )


# --- a linear response as a bar ---

TAPS = (16, 64, 256)  # rows of the responses tried, shortest first
ROWS_PER_TAP = 8  # fewer rows than this are no evidence of so long a response
ROWS = 8192  # of a log, at most: thirty for each tap of the longest response
# between turns: a resonance that a drive excites is sampled by about as many
SWING_ROWS = 20
DAMPING = 1e-6  # of the mean square of the drive, on every tap
# times the error to beat: a short response that is further off is not made longer
WITHIN_REACH = 4.0


def linear_response(logs: Sequence[PreparedLog], to_beat: float) -> Score | None:
    """Return the errors on quarters left out of the best response, None where no clock is even.

    Parameters
    ----------
    logs : the logs
    to_beat : RMS error of the model on the same quarters: longer responses are tried
        within reach of it
    """
    span = max(float(np.ptp(log.voltage)) for log in logs)
    some = [_few_rows(log, span) for log in logs if _even(log)]
    if len(some) < len(logs):
        return None
    best: Score | None = None
    for taps in TAPS:
        if min(len(log.output) for log in some) < ROWS_PER_TAP * taps:
            break
        errors = _response_left_out(some, taps)
        if best is None or errors.mean_square < best.mean_square:
            best = errors
        if errors.mean_square > (WITHIN_REACH * to_beat) ** 2:
            break
    return best


def _even(log: PreparedLog) -> bool:
    """Return whether a log's clock has steps of one length."""
    if log.seconds is None:
        return False
    steps = np.diff(log.seconds)
    usual = float(np.median(steps))
    return usual > 0.0 and float(np.abs(steps - usual).max()) <= EVEN * usual


def _few_rows(log: PreparedLog, span: float) -> PreparedLog:
    """Return at most ``ROWS`` rows of a log, evenly thinned to some rows between turns, then cut.

    The drive is counted from the log's first row, in units of ``span``; the folds are
    quarters of the log.
    """
    rows = len(log.voltage)
    swing = rows / (len(drive_shape(log.voltage).turns) + 1)
    every = max(1, int(swing / SWING_ROWS))
    chosen = np.arange(0, rows, every)[:ROWS]
    used = log.used[chosen]
    count = int(used.sum())
    quarter = np.full(len(chosen), -1)
    quarter[used] = np.arange(count) * BLOCKS // max(count, 1)
    return PreparedLog(
        log.name,
        (log.voltage[chosen] - log.voltage[0]) / span,
        log.output[chosen],
        None,
        quarter,
        log.drift[chosen],
        log.start,
        weights=log.weights_at(chosen),
    )


def _table(log: PreparedLog, taps: int) -> Floats:
    """Return the drive of the last ``taps`` rows, offset and drift, and (last) the output, weighted."""
    padded = np.concatenate((np.zeros(taps - 1), log.voltage))
    past = np.lib.stride_tricks.sliding_window_view(padded, taps)[:, ::-1]
    return weighted(np.column_stack((past, log.drift, log.output)), log.weights)


def _response_left_out(logs: Sequence[PreparedLog], taps: int) -> Score:
    """Return the errors of a response of so many taps on quarters left out."""
    size = taps + sum(log.drift.shape[1] for log in logs) + 1
    grams = np.zeros((BLOCKS, size, size))
    tables: list[tuple[Floats, Integers, Integers]] = []
    begin = taps
    for log in logs:
        end = begin + log.drift.shape[1]
        columns = np.concatenate((np.arange(taps), np.arange(begin, end), [size - 1]))
        table = _table(log, taps)
        for k in range(BLOCKS):
            some = table[log.fold == k]
            grams[k][np.ix_(columns, columns)] += some.T @ some
        tables.append((table, columns[:-1], log.fold))
        begin = end
    squares = np.zeros(BLOCKS)
    rows = np.zeros(BLOCKS)
    for k in range(BLOCKS):
        rest = grams.sum(axis=0) - grams[k]
        gram = rest[:-1, :-1].copy()
        gram[np.arange(taps), np.arange(taps)] += (
            DAMPING * np.trace(gram[:taps, :taps]) / taps
        )
        response = least_squares(gram, rest[:-1, -1])
        for table, columns, quarter in tables:
            some = table[quarter == k]
            left = some[:, -1] - some[:, :-1] @ response[columns]
            squares[k] += sum_of_squares(left)
            rows[k] += len(left)
    return Score(squares, rows)
