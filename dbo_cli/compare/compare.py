"""The DBO beside its relatives: each fitted to the same logs, forward and inverse, in one table."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.compare.fitting import (
    RIVALS,
    Design,
    PlayModel,
    RivalProblem,
    counted,
    fit,
    prepare_logs,
)
from dbo_cli.errors import DboError
from dbo_cli.identification import Options, Recording, identify
from dbo_cli.model import Cascade, Points
from dbo_cli.reports.words import digits, json_text, text_table

JSON_VERSION = 1  # of the form dbo-compare
HEADINGS = "operator,fit,expected,validated,numbers,ns forward,ns inverse".split(",")
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
class DboModel:
    """The DBO with the functions of a rival."""

    model: Cascade

    def _dt(self, clock: Floats | None) -> float | None:
        if not self.model.needs_time:
            return None
        if clock is None:
            return 1.0
        return float(np.median(np.diff(clock)))

    def simulate(self, voltage: Floats, clock: Floats | None = None) -> Floats:
        """Return the displacement for a voltage, without delay and dynamics."""
        return self.model.static.simulate(voltage, dt=self._dt(clock))[0]

    def invert(
        self, desired: Floats, first: float, clock: Floats | None = None
    ) -> Floats:
        """Return the voltage for a displacement, from the state that ``first`` (V) starts in."""
        static = self.model.static
        return static.drive(desired, static.start(first), self._dt(clock)).y

    def predict(self, log: Recording) -> Floats:
        """Return the displacement that a log's drive leads to."""
        return self.model.simulate(log.voltage, time=log.time)[0]

    def expected(self, rmse: float) -> float | None:
        """Return the error on new moves, as the model states it."""
        return self.model.fit.get("expected_rmse")

    @property
    def parameters(self) -> int:
        """How many numbers were fitted: different slopes, knots, memories, an offset, dynamics, delay."""
        gears = self.model.gears
        slopes = gears.dy / gears.dx
        slopes = np.unique(np.round(slopes / np.mean(slopes), 9))
        count = len(slopes) + 1 + int(self.model.delay_seconds > 0.0)
        if gears.relaxation is not None:
            count += len(gears.relaxation.tau)
        for stage in self.model.stages:
            if isinstance(stage, Points):
                count += stage.m - 1
        if self.model.dynamics is not None:
            for section in self.model.dynamics.sections:
                # a lag may have no lead, a resonance no antiresonance
                count += sum(bool(value) for value in vars(section).values())
                count += int(getattr(section, "antiresonance", None) is not None)
        return count


@dataclass(frozen=True)
class OperatorTable:
    """Several operators, a row each, and what they were fitted to."""

    rows: tuple[Row, ...]
    unit: str | None
    logs: tuple[str, ...]
    validation: tuple[str, ...] = ()

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
        cells, about, notes = [], [], []
        for row in self.rows:
            if row.refused is not None:
                notes.append(f"note: {row.name}: {row.refused}")
                continue
            errors = [row.rmse, row.expected_rmse, row.validation_rmse]
            costs = [row.forward_ns, row.inverse_ns]
            numbers = [*map(digits, errors), str(row.parameters)]
            numbers += [digits(cost, 3) for cost in costs]
            cells.append([row.name, *numbers])
            about.append(f"{row.name}: {row.words}")
        lines = [heading, "", text_table(HEADINGS, cells), "", *about, *notes]
        return "\n".join(lines) + "\n"


def compare(
    logs: Sequence[Recording], validation: Sequence[Recording] = (), skip: float = 0.0
) -> OperatorTable:
    """Fit the DBO and its relatives to the same logs, and judge them alike.

    Parameters
    ----------
    logs, validation
        Logs to fit, and logs that take no part.
    skip
        Seconds at the beginning of each log that do not count.

    Raises
    ------
    FitError
        Nothing can be fitted to such logs.
    """
    problem = prepare_logs(logs, skip)
    rows = []
    for rival in (Design("dbo", "Discrete Backlash Operator"), *RIVALS):
        model: PlayModel | DboModel
        try:
            if rival.name == "dbo":  # also where it is no better than a line
                model = DboModel(identify(logs, Options(skip=skip, force=True)))
            else:
                model = fit(rival, problem)
        except DboError as reason:
            rows.append(Row(rival.name, rival.words, refused=str(reason)))
            continue
        rmse = fitted_error(model, problem)
        forward, inverse = costs_of(model, logs[0])
        rows.append(
            Row(
                rival.name,
                rival.words,
                rmse=rmse,
                expected_rmse=model.expected(rmse),
                validation_rmse=validation_error(model, validation, skip),
                parameters=model.parameters,
                forward_ns=forward,
                inverse_ns=inverse,
            )
        )
    names = tuple(log.name for log in logs)
    tests = tuple(log.name for log in validation)
    return OperatorTable(tuple(rows), logs[0].output[1] or None, names, tests)


def fitted_error(model: PlayModel | DboModel, problem: RivalProblem) -> float:
    """Return the error on the fitted rows, each log's offset and drift taken off."""
    errors = []
    for log, rows in zip(problem.logs, problem.rows, strict=True):
        errors.append((log.displacement - model.predict(log))[rows])
    error = np.concatenate(errors)
    drift = np.linalg.lstsq(problem.drift, error, rcond=None)[0]
    return float(np.sqrt(np.mean((error - problem.drift @ drift) ** 2)))


def validation_error(
    model: PlayModel | DboModel, logs: Sequence[Recording], skip: float
) -> float | None:
    """Return the error on other logs, each one's mean taken off; None without any."""
    errors = []
    for log in logs:
        error = (log.displacement - model.predict(log))[counted(log, skip)]
        errors.append(error - np.mean(error))
    if not errors:
        return None
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


def costs_of(model: PlayModel | DboModel, log: Recording) -> tuple[float, float]:
    """Return nanoseconds a sample, forward and inverse, on a log's own drive."""
    voltage = np.resize(log.voltage, TIMED_SAMPLES)
    clock = None
    if log.dt is not None:
        clock = log.dt * np.arange(float(TIMED_SAMPLES))
    desired = model.simulate(voltage, clock)
    first = float(voltage[0])
    forward = fastest(lambda: model.simulate(voltage, clock))
    inverse = fastest(lambda: model.invert(desired, first, clock))
    return forward / TIMED_SAMPLES, inverse / TIMED_SAMPLES


def fastest(run: Callable[[], object]) -> float:
    """Return the processor's time (ns) of the fastest of several runs."""
    times = []
    for _ in range(TIMED_RUNS):
        start = time.thread_time_ns()
        run()
        times.append(time.thread_time_ns() - start)
    return float(min(times))
