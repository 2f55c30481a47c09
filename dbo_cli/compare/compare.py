"""The DBO beside its relatives: each fitted to the same logs, forward and inverse, in one table."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from dbo_cli.compare import fitting
from dbo_cli.compare.fitting import RIVALS, Design, Problem, Rival, Solution
from dbo_cli.compare.plays import NOTHING, Floats, Plays
from dbo_cli.errors import DboError
from dbo_cli.identification import Options, Recording, identify
from dbo_cli.model import Model, Points, kernel
from dbo_cli.reports.render import digits, json_text, text_table

JSON_VERSION = 1  # of the form dbo-compare
TIMED_SAMPLES = 100_000  # milliseconds, which a clock resolves
TIMED_RUNS = 5  # the fastest counts: what else the machine does can only add


@dataclass(frozen=True)
class Row:
    """The figures of one operator; lengths in the displacement's unit, None where there is none.

    Attributes
    ----------
    name, words
        What it is called, and what it is.
    rmse, expected_rmse, validation_rmse
        On its own logs (offset and drift off), expected on new moves, and on the logs
        that took no part (offset off).
    parameters
        Numbers that were fitted.
    forward_ns, inverse_ns
        CPU time of a sample, without delay and dynamics.
    refused
        Why it could not be fitted.
    """

    name: str
    words: str
    rmse: float | None = None
    expected_rmse: float | None = None
    validation_rmse: float | None = None
    parameters: int | None = None
    forward_ns: float | None = None
    inverse_ns: float | None = None
    refused: str | None = None


@dataclass(frozen=True)
class PlayModel:
    """A rival with its numbers: scaled drive, plays, dead zones, scale, delay.

    Attributes
    ----------
    plays, knots
        The operator, and the corners of S^-1.
    origin
        What is added to the plays' output.
    design, problem
        What it was fitted as, and to.
    """

    plays: Plays
    knots: Floats
    origin: float
    design: Design
    problem: Problem

    @classmethod
    def of(cls, design: Design, solution: Solution, problem: Problem) -> PlayModel:
        """Return the model of a solution; its offset is the first log's."""
        plays = fitting.operator_of(design, solution.weights)
        return cls(plays, solution.knots, float(solution.drift[0]), design, problem)

    def scaled(self, voltage: Floats) -> Floats:
        """Return the drive in the operator's range."""
        problem = self.problem
        share: Floats = (voltage - problem.low) / (problem.high - problem.low)
        if self.plays.low < 0.0:
            return 2.0 * share - 1.0
        return share

    def share(self, x: Floats, clock: Floats | None) -> Floats:
        """Return how much of the second set of weights counts, a sample; of [7] alone."""
        if not self.plays.by_rate.size:
            return NOTHING
        return np.minimum(fitting.rates_of(x, clock) / self.plays.fastest, 1.0)

    def simulate(self, voltage: Floats, clock: Floats | None = None) -> Floats:
        """Return the displacement for a voltage, without the delay."""
        x = self.scaled(voltage)
        u = self.plays.run(x, self.share(x, clock)) + self.origin
        if len(self.knots) > 2:
            u = fitting.curve(u, self.knots)
        return self.problem.offset + self.problem.scale * u

    def invert(
        self, wanted: Floats, first: float, clock: Floats | None = None
    ) -> Floats:
        """Return the voltage for a displacement; it stands at ``first`` (V) before.

        Of [7] the drive's rate is taken from that of what is wanted.
        """
        u = (wanted - self.problem.offset) / self.problem.scale
        if len(self.knots) > 2:
            u = fitting.curve_inverse(u, self.knots)
        u = u - self.origin
        begin = float(self.scaled(np.array([first]))[0])
        if self.plays.kind == "plays":
            x = self.plays.closed_inverse(u, begin)
        else:
            about = u / float(self.plays.weights.sum() or 1.0)
            x = self.plays.solve(u, begin, self.share(about, clock))
        low, high = self.problem.low, self.problem.high
        place = (x - self.plays.low) / (1.0 - self.plays.low)
        voltage: Floats = low + place * (high - low)
        return voltage

    def predict(self, log: Recording) -> Floats:
        """Return the displacement that a log's drive leads to, the delay included."""
        y = self.simulate(log.voltage, log.time)
        rows = np.arange(float(len(y)))
        return np.interp(rows - self.design.delay, rows, y)


@dataclass(frozen=True)
class DboModel:
    """The DBO with the same three functions as a rival."""

    model: Model

    def _dt(self, clock: Floats | None) -> float | None:
        if not self.model.needs_time:
            return None
        if clock is None or len(clock) < 2:
            return 1.0
        return float(np.median(np.diff(clock)))

    def simulate(self, voltage: Floats, clock: Floats | None = None) -> Floats:
        """Return the displacement for a voltage, without delay and dynamics."""
        y, _ = self.model.static.simulate(voltage, dt=self._dt(clock))
        return y

    def invert(
        self, wanted: Floats, first: float, clock: Floats | None = None
    ) -> Floats:
        """Return the voltage for a displacement, from the state that ``first`` (V) starts in."""
        still = self.model.static
        state = still.start(first)
        driven = still.drive(wanted, state, self._dt(clock))
        return driven.y

    def predict(self, log: Recording) -> Floats:
        """Return the displacement that a log's drive leads to."""
        y, _ = self.model.simulate(log.voltage, time=log.time)
        return y

    @property
    def parameters(self) -> int:
        """How many numbers were fitted: different slopes, knots, memories, an offset, dynamics, delay."""
        gears = self.model.gears
        slopes = np.unique(
            np.round(gears.dy / gears.dx / np.mean(gears.dy / gears.dx), 9)
        )
        count = len(slopes) + 1 + int(self.model.delay_seconds > 0.0)
        if gears.relaxation is not None:
            count += len(gears.relaxation.tau)
        for stage in self.model.stages:
            if isinstance(stage, Points):
                count += stage.dx.size - 1
        if self.model.dynamics is not None:
            for section in self.model.dynamics.sections:
                count += sum(value is not None for value in vars(section).values())
        return count


@dataclass(frozen=True)
class Comparison:
    """Several operators, a row each, and what they were fitted to."""

    rows: tuple[Row, ...]
    unit: str | None
    logs: tuple[str, ...]
    validation: tuple[str, ...] = field(default=())

    def json(self) -> str:
        """Return the JSON form, ``dbo-compare`` version 1."""
        content = {
            "format": "dbo-compare",
            "version": JSON_VERSION,
            "unit": self.unit,
            "logs": list(self.logs),
            "validation": list(self.validation),
            "models": [asdict(row) for row in self.rows],
        }
        return json_text(content)

    def text(self) -> str:
        """Return the table, and a line for each operator that could not be fitted."""
        heading = f"fitted to {', '.join(self.logs)}"
        if self.validation:
            heading += f"; validated on {', '.join(self.validation)}"
        if self.unit:
            heading += f"; errors (RMS) in {self.unit}"
        head = ["operator", "fit", "expected", "validated", "numbers"]
        head += ["ns forward", "ns inverse"]
        cells, remarks = [], []
        for row in self.rows:
            if row.refused is not None:
                remarks.append(f"{row.name}: {row.refused}")
                continue
            cells.append(_cells(row))
        lines = [heading, "", text_table(head, cells), ""]
        lines += [f"{row.name}: {row.words}" for row in self.rows if not row.refused]
        lines += [f"note: {remark}" for remark in remarks]
        return "\n".join(lines) + "\n"


def _cells(row: Row) -> list[str]:
    return [
        row.name,
        digits(row.rmse),
        digits(row.expected_rmse),
        digits(row.validation_rmse),
        str(row.parameters),
        digits(row.forward_ns, 3),
        digits(row.inverse_ns, 3),
    ]


def compare(
    recordings: Recording | Sequence[Recording],
    validation: Recording | Sequence[Recording] = (),
    *,
    options: Mapping[str, Any] | None = None,
) -> Comparison:
    """Fit the DBO and its relatives to the same logs, and judge them alike.

    Parameters
    ----------
    recordings, validation
        Logs to fit, and logs that take no part.
    options
        Of ``identify`` (fields of ``Options``), for the DBO; ``skip`` is everyone's.

    Raises
    ------
    FitError
        Nothing can be fitted to such logs.
    DboError
        The compiled part is missing.
    """
    kernel.require("compare")
    logs = [recordings] if isinstance(recordings, Recording) else list(recordings)
    checks = [validation] if isinstance(validation, Recording) else list(validation)
    # a DBO that is no better than a line is compared, too
    chosen = Options(**{"force": True, **(options or {})})
    problem = fitting.prepare(logs, chosen.skip)
    judge = _Judge(logs, checks, problem, chosen)
    rows = [judge.dbo()]
    for rival in RIVALS:
        rows.append(judge.rival(rival))
    unit = logs[0].output[1] or None
    names = tuple(log.name for log in logs)
    return Comparison(tuple(rows), unit, names, tuple(log.name for log in checks))


@dataclass(frozen=True)
class _Judge:
    """Judges every operator in the same way."""

    logs: Sequence[Recording]
    validation: Sequence[Recording]
    problem: Problem
    options: Options

    def dbo(self) -> Row:
        """Return the row of the DBO, or of why there is none."""
        name, words = "dbo", "Discrete Backlash Operator"
        try:
            dbo = DboModel(identify(self.logs, self.options))
        except DboError as problem:
            return Row(name, words, refused=str(problem))
        expected = dbo.model.fit.get("expected_rmse")
        return self._row(name, words, dbo, expected, dbo.parameters)

    def rival(self, rival: Rival) -> Row:
        """Return the row of a rival, or of why there is none."""
        try:
            design, solution, ratio = fitting.fit(rival, self.problem)
            model = PlayModel.of(design, solution, self.problem)
        except (DboError, np.linalg.LinAlgError) as problem:
            return Row(rival.name, rival.words, refused=str(problem))
        expected = ratio * self._fitted(model)
        return self._row(rival.name, rival.words, model, expected, design.parameters)

    def _row(
        self,
        name: str,
        words: str,
        model: PlayModel | DboModel,
        expected: float | None,
        parameters: int,
    ) -> Row:
        forward, inverse = self._times(model)
        return Row(
            name,
            words,
            rmse=self._fitted(model),
            expected_rmse=expected,
            validation_rmse=self._validated(model),
            parameters=parameters,
            forward_ns=forward,
            inverse_ns=inverse,
        )

    def _fitted(self, model: PlayModel | DboModel) -> float:
        """Return the error on the fitted rows, each log's offset and drift taken off."""
        squares, count = 0.0, 0
        for log, prepared in zip(self.logs, self.problem.logs, strict=True):
            error = (log.displacement - model.predict(log))[prepared.rows]
            drift = np.linalg.lstsq(prepared.drift, error, rcond=None)[0]
            squares += float(np.sum((error - prepared.drift @ drift) ** 2))
            count += len(error)
        return math.sqrt(squares / count)

    def _validated(self, model: PlayModel | DboModel) -> float | None:
        """Return the error on the other logs, each one's mean taken off."""
        squares, count = 0.0, 0
        for log in self.validation:
            counted = fitting.counted(log, self.options.skip)
            error = (log.displacement - model.predict(log))[counted]
            squares += float(np.sum((error - np.mean(error)) ** 2))
            count += len(error)
        if not count:
            return None
        return math.sqrt(squares / count)

    def _times(self, model: PlayModel | DboModel) -> tuple[float, float]:
        """Return nanoseconds a sample, forward and inverse, on the first log's own drive."""
        log = self.logs[0]
        voltage = np.resize(log.voltage, TIMED_SAMPLES)
        clock = None
        if log.dt is not None:
            clock = log.dt * np.arange(float(TIMED_SAMPLES))
        wanted = model.simulate(voltage, clock)
        first = float(voltage[0])
        forward = _fastest(lambda: model.simulate(voltage, clock))
        inverse = _fastest(lambda: model.invert(wanted, first, clock))
        return forward / TIMED_SAMPLES, inverse / TIMED_SAMPLES


def _fastest(run: Callable[[], Any]) -> float:
    """Return the processor's time (ns) of the fastest of several runs."""
    fastest = math.inf
    for _ in range(TIMED_RUNS):
        begun = time.thread_time_ns()
        run()
        fastest = min(fastest, time.thread_time_ns() - begun)
    return fastest
