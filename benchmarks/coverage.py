"""Whether what is said with an interval or a limit comes true, as it is printed.

    python benchmarks/coverage.py [--trials N] [--only prior|loops] [--seed N]

*prior*: the same actuator with another gain, offset and delay, a short log of random
swings with noise; how often the true gain, offset and change of the lag lie within the
interval that ``identify --prior`` prints, with the prior that is true and with one that
was identified from a noisy log.

*loops*: random loops of a model that creeps, after ``--lead auto``; the error of the
first pass, when the actuator came from its lower end, from its upper end, and from
where it is taken to have settled, over what is said.
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))
from invented_actuators import nested_turns

from dbo_cli.hysteresis.identification import Recording, identify
from dbo_cli.hysteresis.identification.evaluation import predict
from dbo_cli.hysteresis.model import (
    ActuatorModel,
    BacklashStage,
    DelayStage,
    PointStage,
    Quantity,
    Relaxation,
    ScaleStage,
)
from dbo_cli.hysteresis.move_error import rms
from dbo_cli.runs.api import Model

RATE = 200.0
GAIN, OFFSET, LATER = 1.00937, 0.4, 0.003
PRIORS = 10  # each identified from a log of its own
PRINTED = re.compile(
    r"gain ([\d.]+) times the prior's \(within ([\d.e-]+)\)"
    r".*lag (?:([+-][\d.]+) ms|as it was) \(within ([\d.]+)"
)


def actuator(creep: bool = False) -> ActuatorModel:
    """Return an actuator of 0 to 100 V and some 20 um, perhaps with two terms of creep."""
    slopes = np.linspace(0.65, 1.35, 200)
    beside = Relaxation(0.0, (1.5, 20.0), (0.0006, 0.0009)) if creep else None
    stages = (
        BacklashStage(np.full(200, 0.5), slopes / slopes.sum(), 0.0, 0.0, beside),
        PointStage([0.5, 0.7], [0.45, 0.55]),
        ScaleStage(20.0, 0.0),
        DelayStage(0.01),
    )
    ends = (
        Quantity("voltage", "V", 0.0, 100.0),
        Quantity("displacement", "um", 0.0, 20.0),
    )
    fit = {"rmse": 0.01, "expected_rmse": 0.02, "left_out_rmse": 0.02}
    return ActuatorModel("forward", *ends, stages if not creep else stages[:3], fit)


def log_of(
    model: ActuatorModel, drive: np.ndarray, seed: int, changed: bool
) -> Recording:
    """Return what a sensor saw of a drive; of an actuator that has ``changed`` if asked."""
    clock = np.arange(drive.size) / RATE
    stages = tuple(
        DelayStage(stage.seconds + LATER)
        if changed and isinstance(stage, DelayStage)
        else stage
        for stage in model.stages
    )
    plant = ActuatorModel("forward", model.input, model.output, stages)
    seen = predict(
        plant, Recording("log", drive, np.zeros(drive.size), clock, None, "V", "um")
    )
    if changed:
        seen = GAIN * seen + OFFSET
    seen = seen + 0.01 * np.random.default_rng(seed).normal(size=drive.size)
    return Recording("log", drive, seen, clock, None, "V", "um")


def priors(trials: int, seed: int) -> None:
    """Print how often the truth lies within what is printed."""
    truth = actuator()
    identified = []
    for k in range(PRIORS):
        first = 100.0 * nested_turns(seed + 500 + k, RATE, 16.0, (0.4, 8.0))
        identified.append(identify([log_of(truth, first, 900 + seed + k, False)]).model)
    for name, known in (
        ("the true model", [truth]),
        (f"{PRIORS} identified", identified),
    ):
        inside, above, lags = 0, 0, 0
        for trial in range(trials):
            drive = 100.0 * nested_turns(seed + 10 + trial, RATE, 8.0, (0.4, 6.0))
            done = identify(
                [log_of(truth, drive, trial, True)], prior=known[trial % len(known)]
            )
            found = PRINTED.search(done.summary[0]) or PRINTED.search(
                " ".join(done.summary)
            )
            assert found is not None, done.summary
            gain, within = float(found[1]), float(found[2])
            lag, lag_within = float(found[3] or 0.0), float(found[4])
            inside += abs(gain - GAIN) <= within
            above += gain > GAIN
            lags += abs(lag - 1e3 * LATER) <= lag_within
        print(
            f"prior, {name}: gain within what is printed {inside} of {trials} ({above} above); lag {lags}"
        )


def loops(trials: int, seed: int) -> None:
    """Print the error of the first pass from three pasts, and what was said of it."""
    model = actuator(creep=True)
    steps = {start: [] for start in ("settled", "empty", "full")}
    broken, said_from = 0, 0
    for trial in range(trials):
        rng = np.random.default_rng([seed, trial])
        phase = np.arange(400) / 400.0 * 2.0 * np.pi
        size, level = rng.uniform(2.0, 5.0), rng.uniform(8.0, 12.0)
        wanted = (
            level
            + size * np.sin(phase)
            + 0.3 * size * np.sin(2.0 * phase + rng.uniform(0.0, 6.0))
        )
        made = Model(model).compensate(
            wanted, sample_rate=RATE, periodic=True, passes=2, lead="auto", details=True
        )
        drive, notes = made.values, " ".join(made.notes)
        move = float(np.ptp(wanted))
        for start, errors in steps.items():
            begun = model.start(float(drive[0]), start)
            y = model.simulate(drive, begun, time_step=1.0 / RATE).y[-wanted.size :]
            errors.append(rms(y - wanted) / move)
        stated = re.search(
            r"first pass is ([\d.e-]+) um off .*upper end ([\d.e-]+) um", notes
        )
        if stated:
            said_from += 1
            broken += any(
                abs(move * steps[start][-1] - float(value))
                > 0.1 * float(value) + 1e-3 * move
                for start, value in zip(("empty", "full"), stated.groups(), strict=True)
            )
        else:
            within = re.search(r"within [^,]*, ([\d.e-]+) um", notes)
            assert within is not None, notes
            broken += any(
                move * errors[-1] > 1.02 * float(within[1]) for errors in steps.values()
            )
    for start, errors in steps.items():
        shown = ", ".join(
            f"{100.0 * value:.2g}"
            for value in np.percentile(errors, [50.0, 90.0, 100.0])
        )
        print(
            f"loops, from {start}: error of the first pass {shown} % of the move (50, 90, 100 %)"
        )
    print(
        f"loops: the other pasts are said {said_from} of {trials} times; {broken} sentences are not true"
    )


def main() -> None:
    """Print a line a claim."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--trials", type=int, default=100)
    parser.add_argument("--only", choices=("prior", "loops"))
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    if options.only != "loops":
        priors(options.trials, options.seed)
    if options.only != "prior":
        loops(options.trials, options.seed)


if __name__ == "__main__":
    main()
