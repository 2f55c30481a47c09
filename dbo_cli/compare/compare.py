"""The DBO beside its relatives: each fitted to the same logs, forward and inverse, in one table."""

import time
import timeit
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.compare.fitting import RIVALS, Design, Rival, RivalProblem, fit
from dbo_cli.errors import DboError
from dbo_cli.identification import Options, Recording, identify
from dbo_cli.identification.clean import without_late_and_skipped_rows
from dbo_cli.model import Cascade, Points
from dbo_cli.reports.words import digits, text_table

KEYS = (
    "name words rmse expected_rmse validation_rmse parameters forward_ns inverse_ns "
    "refused"
).split()
"""Of an operator in the JSON form."""
HEADINGS = "operator,fit,expected,validated,numbers,ns forward,ns inverse".split(",")
TIMED_SAMPLES = 100_000  # milliseconds, which a clock resolves
TIMED_RUNS = 5  # the fastest counts: what else the machine does can only add


@dataclass(frozen=True)
class DboModel:
    """The DBO with the functions of a rival."""

    model: Cascade

    def _dt(self, clock: Floats | None) -> float:
        return 1.0 if clock is None else float(np.median(np.diff(clock)))

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
        model, gears = self.model, self.model.gears
        slopes = gears.dy / gears.dx
        slopes = np.unique(np.round(slopes / np.mean(slopes), 9))
        count = len(slopes) + 1 + (model.delay is not None) + gears.gain.size
        for curve in (*model.head, *model.tail):
            if isinstance(curve, Points):
                count += curve.dx.size - 1
        if model.dynamics is not None:
            for section in model.dynamics.sections:
                keys = section.keys()
                count += len(keys) + ("antiresonance" in keys)  # which is two
        return count


def compare_operators(
    logs: Sequence[Recording], validation: Sequence[Recording] = (), skip: float = 0.0
) -> dict[str, Any]:
    """Fit the DBO and its relatives to the same logs, and judge them alike.

    Parameters
    ----------
    logs, validation
        Logs to fit, and logs that take no part.
    skip
        Seconds at the beginning of each log that do not count.

    Returns
    -------
    dict
        The JSON form, ``dbo-compare`` version 1. Of each operator: what it is called,
        and what it is; the error (RMS, in the unit) on its own logs, offset and drift
        off, the one expected on new moves, and the one on the logs that took no part,
        offset off; the numbers that were fitted; CPU time of a sample, without delay and
        dynamics; why it could not be fitted. None where there is none.

    Raises
    ------
    FitError
        Nothing can be fitted to such logs.
    UsageError
        Seconds are to be skipped, and a log has no clock.
    """
    options = Options(skip=skip, force=True)  # the DBO also where a line is as good
    logs = [without_late_and_skipped_rows(log, options) for log in logs]
    validation = [without_late_and_skipped_rows(log, options) for log in validation]
    problem = RivalProblem(logs)
    rows = []
    for design in (Design("dbo", "Discrete Backlash Operator"), *RIVALS):
        row: dict[str, Any] = dict.fromkeys(KEYS)
        row |= {"name": design.name, "words": design.words}
        rows.append(row)
        model: Rival | DboModel
        try:
            if design.name == "dbo":
                model = DboModel(identify(logs, options))
            else:
                model = fit(design, problem)
            rmse = fitted_error(model, problem)
            forward, inverse = costs_of(model, logs[0])
            row |= {
                "rmse": rmse,
                "expected_rmse": model.expected(rmse),
                "validation_rmse": validation_error(model, validation),
                "parameters": model.parameters,
                "forward_ns": forward,
                "inverse_ns": inverse,
            }
        except DboError as reason:
            row["refused"] = str(reason)
    return {
        "format": "dbo-compare",
        "version": 1,
        "unit": logs[0].output[1] or None,
        "logs": [log.name for log in logs],
        "validation": [log.name for log in validation],
        "models": rows,
    }


def compared_text(content: Mapping[str, Any]) -> str:
    """Return the JSON form as a table, and a line for each operator that could not be fitted."""
    heading = f"fitted to {', '.join(content['logs'])}"
    if content["validation"]:
        heading += f"; validated on {', '.join(content['validation'])}"
    if content["unit"]:
        heading += f"; errors (RMS) in {content['unit']}"
    cells, about, notes = [], [], []
    for row in content["models"]:
        name = row["name"]
        if row["refused"] is not None:
            notes.append(f"note: {name}: {row['refused']}")
            continue
        errors = [digits(row[key]) for key in KEYS[2:5]]
        costs = [digits(row[key], 3) for key in KEYS[6:8]]
        cells.append([name, *errors, str(row["parameters"]), *costs])
        about.append(f"{name}: {row['words']}")
    lines = [heading, "", text_table(HEADINGS, cells), "", *about, *notes]
    return "\n".join(lines) + "\n"


def fitted_error(model: Rival | DboModel, problem: RivalProblem) -> float:
    """Return the error on the fitted rows, each log's offset and drift taken off."""
    errors = []
    for log, rows in zip(problem.logs, problem.rows, strict=True):
        errors.append((log.displacement - model.predict(log))[rows])
    error = np.concatenate(errors)
    drift = np.linalg.lstsq(problem.drift, error, rcond=None)[0]
    return float(np.sqrt(np.mean((error - problem.drift @ drift) ** 2)))


def validation_error(
    model: Rival | DboModel, logs: Sequence[Recording]
) -> float | None:
    """Return the error on other logs, each one's mean taken off; None without any."""
    errors = []
    for log in logs:
        error = (log.displacement - model.predict(log))[log.usable]
        errors.append(error - np.mean(error))
    if not errors:
        return None
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


def costs_of(model: Rival | DboModel, log: Recording) -> tuple[float, float]:
    """Return nanoseconds a sample, forward and inverse, on a log's own drive."""
    voltage = np.resize(log.voltage, TIMED_SAMPLES)
    clock = None
    if log.dt is not None:
        clock = log.dt * np.arange(float(TIMED_SAMPLES))
    desired = model.simulate(voltage, clock)
    first = float(voltage[0])

    def cost(run: Callable[[], object]) -> float:
        """Return the processor's time (ns) of a sample, of the fastest of several runs."""
        timer = timeit.Timer(run, timer=time.thread_time_ns)
        return min(timer.repeat(TIMED_RUNS, number=1)) / TIMED_SAMPLES

    forward = cost(lambda: model.simulate(voltage, clock))
    return forward, cost(lambda: model.invert(desired, first, clock))
