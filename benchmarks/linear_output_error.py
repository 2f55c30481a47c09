"""An ordinary linear output-error model of order 1 to 3 on the recordings of others: a rival.

    python benchmarks/linear_output_error.py RECORDINGS FILE

Output = offset + B(q)/A(q) drive on an even clock of at most 3,000 rows, begun settled, with
B and A of one order. Starts come from a regression; then the simulated output is fitted
(scipy). FILE becomes a JSON object: for each case the errors of orders 1, 2 and 3 on its test.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from identification import Case, all_cases, error_of
from numpy.typing import NDArray
from plants import Log
from scipy.optimize import least_squares
from scipy.signal import lfilter

Floats = NDArray[np.float64]
ROWS = 3_000  # of a log
UNSTABLE = 1e3  # of the log's range: what an output that grows is cut to


def even(log: Log, step: float) -> tuple[Floats, Floats, Floats]:
    """Return clock, drive and output at even steps (s)."""
    clock = np.arange(log.time[0], log.time[-1], step)
    drive = np.interp(clock, log.time, log.voltage)
    return clock, drive, np.interp(clock, log.time, log.displacement)


def output(parameters: Floats, order: int, drive: Floats) -> Floats:
    """Return what the model makes of a drive at whose first value it has settled."""
    offset, numerator, rest = (
        parameters[0],
        parameters[1 : order + 2],
        parameters[order + 2 :],
    )
    denominator = np.concatenate(([1.0], rest))
    settled = drive[0] * numerator.sum() / (denominator.sum() or 1e-12)
    with np.errstate(all="ignore"):
        moved = settled + lfilter(numerator, denominator, drive - drive[0])
    return np.nan_to_num(offset + np.clip(moved, -UNSTABLE, UNSTABLE))


def start(order: int, logs: list[tuple[Floats, Floats]]) -> Floats:
    """Return parameters of least equation error."""
    columns, targets = [], []
    for drive, moved in logs:
        late = [moved[order - lag : moved.size - lag] for lag in range(1, order + 1)]
        driven = [drive[order - lag : drive.size - lag] for lag in range(order + 1)]
        ones = np.ones(moved.size - order)
        columns.append(np.stack([ones, *driven, *(-x for x in late)], axis=1))
        targets.append(moved[order:])
    found = np.linalg.lstsq(np.vstack(columns), np.concatenate(targets), rcond=None)[0]
    found[0] /= 1.0 + found[order + 2 :].sum() or 1e-12
    return np.asarray(found)


def error(case: Case, order: int) -> float:
    """Return the error on a case's test, in the unit of its output."""
    step = max((log.time[-1] - log.time[0]) / ROWS for log in case.logs)
    step = max(step, max(float(np.median(np.diff(log.time))) for log in case.logs))
    low = min(float(log.voltage.min()) for log in case.logs)
    span = max(float(log.voltage.max()) for log in case.logs) - low
    size = max(float(np.ptp(log.displacement)) for log in case.logs)
    logs = [((drive - low) / span, moved / size)
            for _, drive, moved in (even(log, step) for log in case.logs)]  # fmt: skip

    def residuals(parameters: Floats) -> Floats:
        return np.concatenate([output(parameters, order, v) - x for v, x in logs])

    best = least_squares(residuals, start(order, logs), x_scale="jac", max_nfev=200).x
    predictions = []
    for test in case.tests:
        clock, drive, _ = even(test.log, step)
        moved = size * output(best, order, (drive - low) / span)
        predictions.append(np.interp(test.log.time, clock, moved))
    return error_of(case, predictions)


if __name__ == "__main__":
    errors = {}
    for case in all_cases(Path(sys.argv[1]), Path("none"), ["scanners", "others"]):
        errors[case.name] = [error(case, order) for order in (1, 2, 3)]
        print(
            f"{case.name[:50]:50}"
            + "".join(f"{one:11.4g}" for one in errors[case.name])
        )
    Path(sys.argv[2]).write_text(json.dumps(errors, indent=1) + "\n")
