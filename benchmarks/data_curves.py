#!/usr/bin/env python3
"""What a longer log, a better sensor or a faster logger is worth: the error of new moves after each.

Two invented actuators (``invented_actuators.py``) are recorded with random nested
turns, three times each. One property of the log changes, the others stay at 20 s, 0.1 %
of noise, 500 samples a second. The error is that of a new move, offset included, in
percent of the stroke; of the six logs the geometric mean is taken.

    python benchmarks/data_curves.py [--figure FILE.svg] [--processes N] [--only length|noise|rate]

Exit code 1 where more data, or less noise, is worse by more than 10 %.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import multiprocessing
from dataclasses import dataclass, replace

import numpy as np
from invented_actuators import (
    Actuator,
    BoucWen,
    Floats,
    Plays,
    bent,
    nested_turns,
    swept,
)

from dbo_cli.errors import DboError
from dbo_cli.hysteresis.identification import Recording, identify
from dbo_cli.hysteresis.identification.evaluation import predict

LENGTHS = (2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0)  # s
NOISES = (3.0, 1.0, 0.3, 0.1, 0.03, 0.01)  # % of the stroke
RATES = (100.0, 300.0, 1000.0, 3000.0, 10000.0)  # samples a second
SPEEDS = (0.8, 8.0)  # ranges a second
TEST_RATE = 1000.0
ALLOWED = 1.1  # times the error with less data
SEEDS = (1, 2, 3)

ACTUATORS = {
    "plays": Actuator(
        Plays(0.45, 0.15), curve=bent(0.1), lag=0.001, creep=((0.5, 0.01), (5.0, 0.01))
    ),
    "bouc-wen": Actuator(BoucWen(0.35, 0.12, 0.3), lag=0.001),
}


@dataclass(frozen=True)
class Log:
    """What a log is like: seconds, noise in % of the stroke, samples a second."""

    length: float = 20.0
    noise: float = 0.1
    rate: float = 500.0


CURVES: dict[str, list[Log]] = {
    "length": [replace(Log(), length=value) for value in LENGTHS],
    "noise": [replace(Log(), noise=value) for value in NOISES],
    "rate": [replace(Log(), rate=value) for value in RATES],
}
AXES = {
    "length": "length of the log (s)",
    "noise": "noise (% of the stroke)",
    "rate": "samples a second",
}


def recording(actuator: Actuator, log: Log, seed: int) -> Recording:
    """Return what the logger wrote."""
    shape = nested_turns(seed, log.rate, log.length, SPEEDS)
    time = np.arange(len(shape)) / log.rate
    voltage = actuator.top * shape
    noise = np.random.default_rng(seed).normal(size=len(shape))
    seen = actuator.run(time, voltage) + 0.01 * log.noise * actuator.stroke * noise
    return Recording("log", voltage, seen, time, None, "V", "um")


def error_of(task: tuple[str, Log, int]) -> float:
    """Return the error of a new move, in percent of the stroke; NaN where the log is refused."""
    name, log, seed = task
    actuator = ACTUATORS[name]
    try:
        model = identify([recording(actuator, log, seed)]).model
    except DboError:
        return float("nan")
    before = swept([0.0, 1.0, 0.0], [1.0, 1.0], TEST_RATE)
    shape = np.concatenate((before, nested_turns(seed + 500, TEST_RATE, 12.0, SPEEDS)))
    time = np.arange(len(shape)) / TEST_RATE
    voltage = actuator.top * shape
    test = Recording("new", voltage, actuator.run(time, voltage), time, None, "V", "um")
    left = (test.displacement - predict(model, test, "empty"))[len(before) :]
    return 100.0 * float(np.sqrt(np.mean(left**2))) / actuator.stroke


def measured(logs: list[Log], processes: int) -> Floats:
    """Return the errors, shape (logs, actuators, seeds)."""
    tasks = [(name, log, seed) for log in logs for name in ACTUATORS for seed in SEEDS]
    with multiprocessing.Pool(processes) as pool:
        errors = pool.map(error_of, tasks, chunksize=1)
    return np.reshape(errors, (len(logs), len(ACTUATORS), len(SEEDS)))


def geometric_mean(errors: Floats) -> float:
    """Return the geometric mean; NaN where one of the logs was refused."""
    return float(np.exp(np.mean(np.log(errors))))


def draw(curves: dict[str, Floats], figure: Path) -> None:
    """Draw one panel a curve: each actuator, and the mean of all."""
    import matplotlib

    matplotlib.use("svg")
    matplotlib.rcParams["svg.hashsalt"] = "dbo"
    from matplotlib import pyplot

    canvas, panels = pyplot.subplots(
        1, len(curves), figsize=(9.0, 3.0), sharey=True, layout="constrained"
    )
    styles = dict(zip(ACTUATORS, ("--", ":"), strict=True))
    for panel, (key, errors) in zip(np.atleast_1d(panels), curves.items(), strict=True):
        at = [getattr(log, key) for log in CURVES[key]]
        for place, name in enumerate(ACTUATORS):
            means = [geometric_mean(row[place]) for row in errors]
            panel.plot(
                at,
                means,
                styles[name],
                color="0.45",
                label=f"{name} (mean of three logs)",
            )
        panel.plot(
            at,
            [geometric_mean(row) for row in errors],
            "o-",
            color="C0",
            label="mean of all",
        )
        panel.set_xscale("log")
        panel.set_yscale("log")
        panel.set_xlabel(AXES[key])
        panel.grid(True, which="major", alpha=0.3)
        if key == "noise":
            panel.plot(at, at, "-", color="0.8", label="the noise itself")
            panel.invert_xaxis()
    first = np.atleast_1d(panels)[0]
    first.set_ylabel("error of a new move (% of the stroke)")
    handles, labels = np.atleast_1d(panels)[
        min(1, len(curves) - 1)
    ].get_legend_handles_labels()
    canvas.legend(
        handles, labels, loc="outside upper center", ncols=4, fontsize="small"
    )
    canvas.savefig(figure, metadata={"Date": None})


def main() -> None:
    """Print one line a log and say whether a curve rises."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--figure", type=Path)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--only", choices=tuple(CURVES))
    given = parser.parse_args()
    held = True
    curves: dict[str, Floats] = {}
    for key, logs in CURVES.items():
        if given.only not in (None, key):
            continue
        curves[key] = measured(logs, given.processes)
        means = [geometric_mean(row) for row in curves[key]]
        for place, (log, row) in enumerate(zip(logs, curves[key], strict=True)):
            worse = place > 0 and not means[place] <= ALLOWED * means[place - 1]
            held = held and not worse
            each = "  ".join(
                " ".join(f"{error:6.4f}" for error in some) for some in row
            )
            mark = "  WORSE than with less" if worse else ""
            print(
                f"{key} {getattr(log, key):8g}: mean {means[place]:7.4f} %   {each}{mark}",
                flush=True,
            )
    if given.figure is not None:
        draw(curves, given.figure)
    sys.exit(0 if held else 1)


if __name__ == "__main__":
    main()
