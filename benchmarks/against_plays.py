#!/usr/bin/env python3
"""Prediction of new moves: `dbo identify`, everything automatic, against rivals, and what it said to expect.

Invented actuators of many structures, drives and faults (``invented_actuators.py``),
and with DATA the authors' own recordings. Every model gets the same logs and predicts a
drive that it has not seen; the error is judged against what a perfect sensor would
show, its offset removed. The rivals are given the best of seven delays: play operators
alone, with a square of the drive beside them, with dead zones behind them (Kuhnen's
modified Prandtl-Ishlinskii operator), and Preisach relays.

    python benchmarks/against_plays.py [DATA] [--seed 1] [--only TEXT]

Bounds: ahead of the best rival on 90 % of the cases, geometric mean of the ratios 0.6,
no case beyond 1.5 (the sensor's noise included: what is below it nobody could tell)
without a warning; the error that came over the expected one 0.8 to 1.3 in the median
after `dbo excite`, at most 1.6; at most 2 after any other drive, or warned of, by
`identify` ("yes") or by `simulate` of the new move ("used": it leaves the range of the
logs).
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import multiprocessing
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from invented_actuators import Floats, cases, plays
from scipy.optimize import lsq_linear, nnls

from dbo_cli.errors import DboError
from dbo_cli.hysteresis.identification import IdentificationOptions, Recording, identify
from dbo_cli.hysteresis.identification.evaluation import predict
from dbo_cli.hysteresis.identification.recordings import Integers, first_wiped_row
from dbo_cli.runs.api import Model

PLAYS = 25
DEAD_ZONES = 4  # to either side
RELAYS = 20  # thresholds to either side of the diagonal
DELAYS = 7  # 0 to 6 sample periods of the first log
FIT_ROWS = 4000  # a rival's fit gains nothing from more


@dataclass(frozen=True)
class Task:
    """One line of the table: logs, the new move, what truly came of it, and the rows judged."""

    name: str
    after_excite: bool
    logs: list[Recording]
    test: Recording
    truth: Floats
    noise: float
    judged: slice
    skip: float = 0.0
    trend: bool = False

    def error(self, predicted: Floats) -> float:
        """RMSE, offset (and for a drifting sensor a straight line) removed."""
        left = (self.truth - predicted)[self.judged]
        if self.trend:
            rows = np.arange(len(left))
            left = left - np.polyval(np.polyfit(rows, left, 1), rows)
        return float(np.std(left))


@dataclass(frozen=True)
class Line:
    """What came out of one task; errors in um."""

    task: str
    after_excite: bool
    ours: float
    rival: float
    rival_name: str
    noise: float
    expected: float
    stroke: float
    warned: str

    @property
    def came(self) -> float:
        """The error on the new move, the sensor's noise included, over the expected one."""
        return float(np.hypot(self.ours, self.noise)) / self.expected


# --- the rivals ---


def relays(drive: Floats, low: float, span: float) -> Floats:
    """Return the outputs of Preisach relays on a triangular grid of thresholds, shape (samples, relays)."""
    grid = low + span * (np.arange(RELAYS + 1) / RELAYS)
    up, down = np.meshgrid(grid[1:], grid[:-1])
    kept = up > down
    up, down = up[kept], down[kept]
    state = np.zeros(len(up))
    out = np.empty((len(drive), len(up)), np.float32)
    for k, value in enumerate(drive.tolist()):
        state[value >= up] = 1.0
        state[value <= down] = 0.0
        out[k] = state
    return out.astype(np.float64)


def shifted(table: Floats, seconds: float, recording: Recording) -> Floats:
    """Return a table as it was ``seconds`` ago."""
    clock = recording.seconds()
    step = 0.005 if clock is None else float(np.median(np.diff(clock)))
    samples = round(seconds / step)
    return (
        table
        if samples == 0
        else np.vstack((np.repeat(table[:1], samples, axis=0), table[:-samples]))
    )


class Rivals:
    """All rivals on one task; ``best`` is the one that predicts the new move best, which no user can know."""

    def __init__(self, task: Task) -> None:
        self.task = task
        self.low = min(float(log.voltage.min()) for log in task.logs)
        self.span = max(float(log.voltage.max()) for log in task.logs) - self.low
        covariance = np.cov(task.logs[0].voltage, task.logs[0].displacement)[0, 1]
        self.sign = -1.0 if covariance < 0.0 else 1.0
        self.rows = [self._rows(log) for log in task.logs]
        self.target = np.concatenate(
            [
                log.displacement[rows]
                for log, rows in zip(task.logs, self.rows, strict=True)
            ]
        )
        offsets = np.repeat(
            np.eye(len(task.logs)), [len(rows) for rows in self.rows], axis=0
        )
        self.offsets = offsets
        clock = task.logs[0].seconds()
        self.step = 0.005 if clock is None else float(np.median(np.diff(clock)))
        everything = [*task.logs, task.test]
        radii = np.arange(PLAYS) / PLAYS * self.span / 2.0
        self.plays = []
        for log in everything:
            first = log.voltage[0]
            start = np.clip(self.low + radii, first - radii, first + radii)
            self.plays.append(plays(log.voltage, radii, start))
        self.squares = [
            ((log.voltage - self.low) / self.span)[:, None] ** 2 for log in everything
        ]

    def _rows(self, log: Recording) -> Integers:
        """Rows to fit: after the skip and the unknown history, thinned out, the wildest spikes left out."""
        clock = log.seconds()
        begin = 0 if clock is None else int(np.searchsorted(clock, self.task.skip))
        wiped = first_wiped_row(log.voltage)
        begin = max(begin, wiped if wiped < 0.4 * len(log.voltage) else 0)
        every = max((len(log.voltage) - begin) * len(self.task.logs) // FIT_ROWS, 1)
        return np.arange(begin, len(log.voltage), every)

    def best(self) -> tuple[float, str]:
        """Return the least error on the new move and whose it is."""
        found: list[tuple[float, str]] = []
        kept = range(DELAYS) if self.task.logs[0].seconds() is not None else range(1)
        judged = []
        for count in kept:
            tables = [
                shifted(t, count * self.step, log)
                for t, log in zip(
                    self.plays, [*self.task.logs, self.task.test], strict=True
                )
            ]
            judged.append((self._plays(tables, False), tables, count))
        (_, error), tables, count = min(judged, key=lambda one: one[0][0])
        found.append((error, "plays"))
        found.append((self._plays(tables, True)[1], "plays and square"))
        found.append((self._dead_zones(tables), "plays, dead zones"))
        found.append((self._relays(count * self.step), "relays"))
        return min(found)

    def _fitted(self, tables: list[Floats]) -> Floats:
        return np.vstack(
            [table[rows] for table, rows in zip(tables[:-1], self.rows, strict=True)]
        )

    def _plays(self, tables: list[Floats], square: bool) -> tuple[float, float]:
        """Error on the logs and on the new move of plays, bounded least squares."""
        if square:
            tables = [
                np.hstack(pair) for pair in zip(tables, self.squares, strict=True)
            ]
        table = np.hstack((self.sign * self._fitted(tables), self.offsets))
        bounded = np.r_[np.zeros(PLAYS), np.full(table.shape[1] - PLAYS, -np.inf)]
        weights = lsq_linear(
            table, self.target, bounds=(bounded, np.inf), max_iter=300
        ).x
        fit = float(np.std(self.target - table @ weights))
        predicted = self.sign * tables[-1] @ weights[: tables[-1].shape[1]]
        return fit, self.task.error(predicted)

    def _dead_zones(self, tables: list[Floats]) -> float:
        """Error on the new move of plays with dead zones behind them (equation error, Kuhnen 2003)."""
        middle, half = (
            float(np.median(self.target)),
            float(np.ptp(np.percentile(self.target, [1, 99]))) / 2.0,
        )
        y = self.sign * (self.target - middle) / half
        places = np.arange(1, DEAD_ZONES + 1) / (DEAD_ZONES + 1.0)

        def zones(values: Floats) -> Floats:
            up = [np.maximum(values - place, 0.0) for place in places]
            return np.column_stack(
                up + [np.minimum(values + place, 0.0) for place in places]
            )

        table = np.hstack((self._fitted(tables), -zones(y), self.offsets))
        bounded = np.r_[np.zeros(PLAYS), np.full(table.shape[1] - PLAYS, -np.inf)]
        weights = lsq_linear(table, y, bounds=(bounded, np.inf), max_iter=300).x
        inner = tables[-1] @ weights[:PLAYS] + weights[-self.offsets.shape[1]]
        grid = np.linspace(-1.6, 1.6, 2001)
        curve = np.maximum.accumulate(
            grid + zones(grid) @ weights[PLAYS : PLAYS + 2 * DEAD_ZONES]
        )
        return self.task.error(self.sign * half * np.interp(inner, curve, grid))

    def _relays(self, delay: float) -> float:
        """Error on the new move of Preisach relays with a straight line beside them."""
        everything = [*self.task.logs, self.task.test]
        tables = []
        for log in everything:
            table = np.hstack(
                (
                    relays(log.voltage, self.low, self.span),
                    log.voltage[:, None] / self.span,
                )
            )
            tables.append(shifted(table, delay, log))
        table = np.hstack(
            (self.sign * self._fitted(tables), self.offsets, -self.offsets)
        )
        gram, products = table.T @ table, table.T @ self.target
        factor = np.linalg.cholesky(
            gram + 1e-8 * np.trace(gram) / len(gram) * np.eye(len(gram))
        )
        weights, _ = nnls(
            factor.T, np.linalg.solve(factor, products), maxiter=100 * len(gram)
        )
        return self.task.error(self.sign * tables[-1] @ weights[: tables[-1].shape[1]])


# --- the tasks ---


def authors_tasks(folder: Path) -> Iterator[Task]:
    """Yield the authors' two logs, each predicted from the other and from parts."""

    def log(name: str, rows: slice = slice(None)) -> Recording:
        table = np.loadtxt(folder / name, usecols=(0, 4))[rows]
        return Recording(
            name, table[:, 0].copy(), table[:, 1].copy(), None, 0.005, "V", "um"
        )

    whole, test = log("identification.dat"), log("uncompensated.dat")
    half = log("uncompensated.dat", slice(600, 3500))

    def task(
        name: str, logs: list[Recording], other: Recording, judged: slice, skip: float
    ) -> Task:
        trend = other is whole
        return Task(
            f"authors: {name}",
            False,
            logs,
            other,
            other.displacement,
            0.0,
            judged,
            skip,
            trend,
        )

    yield task("one amplitude predicts many", [whole], test, slice(600, None), 2.0)
    yield task("part of the range predicts all", [test], whole, slice(600, None), 3.0)
    yield task("both predict the rest", [whole, half], test, slice(3500, None), 2.0)
    yield task("first half predicts second", [half], test, slice(3500, None), 0.0)
    yield task(
        "three cycles",
        [log("identification.dat", slice(2952, 3552))],
        test,
        slice(600, None),
        0.0,
    )
    yield task(
        "two cycles",
        [log("identification.dat", slice(3152, 3552))],
        test,
        slice(600, None),
        0.0,
    )


def tasks(data: Path | None, seed: int, only: str) -> Iterator[Task]:
    """Yield all tasks whose name holds ``only``."""
    if data is not None:
        yield from (task for task in authors_tasks(data) if only in task.name)
    for case in cases(seed):
        if only in case.name:
            excited = case.drive == "excite"
            # both ends of the range have been visited by then
            settled = slice(500, None)
            yield Task(
                case.name,
                excited,
                case.logs,
                case.test,
                case.truth,
                case.noise,
                settled,
            )


def line_of(task: Task) -> Line | str:
    """Identify, predict, compare with the rivals."""
    try:
        result = identify(task.logs, IdentificationOptions(skip_seconds=task.skip))
    except DboError as problem:
        return f"{task.name}: refused: {problem}"
    ours = task.error(predict(result.model, task.test))
    rival, name = Rivals(task).best()
    expected = result.fit["expected_rmse"]
    if not isinstance(expected, float):
        return f"{task.name}: what error to expect was not told"
    stroke = float(np.ptp(task.truth))
    used = Model(result.model).simulate(
        task.test.voltage, time=task.test.seconds(), details=True
    )
    warned = "yes" if result.warnings else "used" if used.warnings else ""
    return Line(
        task.name,
        task.after_excite,
        ours,
        rival,
        name,
        task.noise,
        expected,
        stroke,
        warned,
    )


def summary(lines: list[Line]) -> None:
    """Print the bounds' figures."""
    ratios = np.array([line.ours / line.rival for line in lines])
    print(
        f"\nahead of the best rival on {np.mean(ratios <= 1.0):.0%} of {len(lines)} (90 %)"
    )
    print(f"geometric mean of the ratios {np.exp(np.mean(np.log(ratios))):.2f} (0.6)")
    behind = [
        line.task
        for line in lines
        if np.hypot(line.ours, line.noise) > 1.5 * np.hypot(line.rival, line.noise)
        and not line.warned
    ]
    print(f"beyond 1.5 times a rival without a warning: {', '.join(behind) or 'none'}")
    for excited, name in ((True, "after excite"), (False, "after other drives")):
        some = [line for line in lines if line.after_excite == excited]
        if some:
            came = [line.came for line in some]
            unsaid = [
                one.task
                for one in some
                if one.came > (1.6 if excited else 2.0) and not one.warned
            ]
            print(f"came over expected, {name}: median {np.median(came):.2f}, largest {max(came):.2f}; "
                  f"beyond the bound without a warning: {', '.join(unsaid) or 'none'}")  # fmt: skip


def main() -> None:
    """Print one line a recording and the summary."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument(
        "data", nargs="?", type=Path, help="folder of the authors' recordings"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--only", default="", help="only the tasks whose name holds this text"
    )
    parser.add_argument("--processes", type=int, default=1)
    given = parser.parse_args()
    wanted = list(tasks(given.data, given.seed, given.only))
    print(
        f"{'recording':36}  dbo %   rival %  ratio  noise %  expected %  came/expected  warned  rival"
    )
    lines: list[Line] = []
    with multiprocessing.Pool(given.processes) as pool:
        for line in pool.imap(line_of, wanted):
            if isinstance(line, str):
                print(line, flush=True)
                continue
            share = 100.0 / line.stroke
            print(
                f"{line.task:36}  {share * line.ours:5.3f}  {share * line.rival:6.3f}  "
                f"{line.ours / line.rival:6.2f}  {share * line.noise:6.3f}  {share * line.expected:9.3f}  "
                f"{line.came:12.2f}   {line.warned or 'no':6}  {line.rival_name}",
                flush=True,
            )
            lines.append(line)
    summary(lines)


if __name__ == "__main__":
    main()
