"""Whole models with dynamics, inverse after forward and forward after inverse, in bulk.

    python benchmarks/dynamics_round_trip.py [--trials N] [--seed N] [--speed]

Random cascades of 1 to 1,152 gears, half of them with relaxation, with points, with a
delay of whole samples, with a lag behind the gears, with one before them; one or two
resonances of damping 0.002 to 0.9, some with an antiresonance, 6 to 400 samples a
period of the highest. The trajectory is a random move between two rests, a swing in 2
to 6 periods of the lowest resonance. It goes through the inverse whole and in random
blocks, and the drive through the model. Exits 1 where an error of a sample exceeds 1e-9
of the range, or a bit depends on the blocks or on the kernel. ``--speed`` prints
instead what dynamics cost a sample beside the gears, in one run.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.special import betainc

from dbo_cli.hysteresis import drive_lag, kernel
from dbo_cli.hysteresis.cascade import read_ahead, slow_output_range
from dbo_cli.hysteresis.dynamics import (
    Antiresonance,
    DynamicsStage,
    Lag,
    Resonance,
    Section,
    undone,
)
from dbo_cli.hysteresis.model import (
    ActuatorModel,
    DelayStage,
    PointStage,
    Quantity,
    ScaleStage,
    Stage,
)
from dbo_cli.hysteresis.model_state import DriveLimits

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
from trials import random_operator

Floats = NDArray[np.float64]
# Hz, the highest resonance; only its ratio to the sampling rate matters
FASTEST = 1_000.0
BOUND = 1e-9


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def random_sections(rng: np.random.Generator) -> list[Section]:
    frequencies = [
        FASTEST,
        *([FASTEST * rng.uniform(0.3, 0.9)] if rng.random() < 0.5 else []),
    ]
    sections: list[Section] = []
    for frequency in frequencies:
        notch = None
        if rng.random() < 0.3:
            notch = Antiresonance(
                frequency * rng.uniform(0.6, 0.95), log_uniform(rng, 0.002, 0.9)
            )
        sections.append(
            Resonance(float(frequency), log_uniform(rng, 0.002, 0.9), notch)
        )
    if rng.random() < 0.5:
        sections.insert(
            int(rng.integers(len(sections) + 1)), Lag(log_uniform(rng, 1e-5, 1e-2))
        )
    return sections


def random_model(rng: np.random.Generator, step: float) -> ActuatorModel:
    gears = random_operator(
        rng, round(log_uniform(rng, 1.0, 1152.0)), relaxation=bool(rng.random() < 0.5)
    )
    stages: list[Stage] = [gears]
    if rng.random() < 0.5:
        low, high = gears.y_range
        widths = rng.uniform(0.5, 1.0, 4)
        stages.append(
            PointStage(
                widths * (high - low) / widths.sum(), rng.uniform(0.5, 1.0, 4), low
            )
        )
    stages.append(ScaleStage(float(rng.choice([-3.0, 2.0])), 0.7))
    bottom, top = slow_output_range(stages, *gears.x_range)
    stages.append(DynamicsStage(tuple(random_sections(rng))))
    if rng.random() < 0.5:
        stages.append(DelayStage(step * int(rng.integers(1, 40))))
    if rng.random() < 0.5:
        stages.insert(0, DynamicsStage((Lag(log_uniform(rng, 1e-5, 1e-2)),)))
    return ActuatorModel(
        "forward",
        Quantity("v", "V", *gears.x_range),
        Quantity("x", "um", bottom, top),
        tuple(stages),
    )


def random_move(
    rng: np.random.Generator, model: ActuatorModel, step: float, swings: int
) -> Floats:
    """Return a move between rests; each swing takes a few periods of the lowest resonance."""
    assert model.dynamics is not None
    lowest = min(section.frequency for section in model.dynamics.resonances)
    turns = model.output.minimum + model.output.span * rng.uniform(0.3, 0.7, swings + 1)
    parts = [np.full(100, turns[0])]
    for begin, end in pairwise(turns.tolist()):
        t = np.linspace(
            0.0, 1.0, max(round(rng.uniform(2.0, 6.0) / (lowest * step)), 20)
        )
        # five smooth derivatives
        parts.append(begin + (end - begin) * betainc(7.0, 7.0, t))
    return np.concatenate([*parts, np.full(100, turns[-1])])


def drive_for(
    model: ActuatorModel, wanted: Floats, step: float, cuts: list[int]
) -> Floats:
    """Return the drive, its trajectory cut into blocks."""
    assert model.dynamics is not None
    parts = list(
        zip(
            np.split(np.arange(wanted.size) * step, cuts),
            np.split(wanted, cuts),
            strict=True,
        )
    )

    def blocks() -> Iterator[tuple[None, Floats, Floats]]:
        return ((None, at, part) for at, part in parts)

    inverter = model.dynamics.inverter(step)
    low, high = model.forward_backlash.x_range
    # so far that nothing is cut off: what limits cut off is no error
    beyond = 1e3 * (high - low)
    limits = DriveLimits(low - beyond, high + beyond)
    state, drives = None, []
    for _, u, _ in undone(read_ahead(blocks(), model.delay_seconds), inverter):
        if state is None:
            state = model.start_compensation(float(u[0]), "empty", limits)
        done = model.compensate(u, state, limits=limits, time_step=step)
        state = done.state
        drives.append(done.y)
    return np.concatenate(drives)


def trial(seed: int, swings: int) -> tuple[bytes, float]:
    """Return the bits of all that was computed, and the largest error as a part of the range."""
    rng = np.random.default_rng(seed)
    step = 1.0 / (FASTEST * log_uniform(rng, 6.0, 400.0))
    model = random_model(rng, step)
    wanted = random_move(rng, model, step, swings)
    drive = drive_for(model, wanted, step, [])
    cuts = np.sort(rng.integers(0, wanted.size, 4)).tolist()
    if drive_for(model, wanted, step, cuts).tobytes() != drive.tobytes():
        return b"", np.inf
    start = model.start(float(drive[0]), "empty")
    reached = model.simulate(drive, start, time_step=step).y
    late = round(model.delay_seconds / step)
    error = np.abs(reached - wanted)[late:].max() / model.output.span
    return drive.tobytes() + reached.tobytes(), float(error)


def speed() -> None:
    """Print what dynamics cost a sample, as ratios to the gears' cost in the same run."""
    rng = np.random.default_rng(0)
    operator = random_operator(rng, 128)
    low, high = operator.x_range
    # some gears a sample
    x = low + (high - low) * (0.5 + 0.5 * np.sin(np.arange(1_000_000) * 0.05))
    gears = clock(lambda: operator.run(x, operator.empty()))
    inverse, y = operator.inverse(), operator.run(x, operator.empty())[0]
    back = clock(lambda: inverse.run(y, operator.empty()))
    one, two = Resonance(800.0, 0.02), Resonance(1_900.0, 0.01)
    for name, sections in (
        ("one resonance", (one,)),
        ("two and a lag", (one, two, Lag(1e-4))),
    ):
        stage = DynamicsStage(sections)
        inverter = stage.inverter(1.0 / 20_000.0)
        forward = clock(lambda stage=stage: stage.run(x, 1.0 / 20_000.0, None))
        undo = clock(lambda inverter=inverter: list(undone([(None, x)], inverter)))
        print(
            f"{name}: forward {forward / gears:.2f} of 128 gears, inverse {undo / back:.2f} of their inverse"
        )

    lag = DynamicsStage((Lag(1e-4),))
    numbers = drive_lag.coefficients(lag, 1.0 / 20_000.0)
    forward = clock(lambda: lag.run(x, 1.0 / 20_000.0, None))
    undo = clock(lambda: drive_lag.undone(numbers, x, None))
    print(
        f"a lag before the gears: forward {forward / gears:.2f}, inverse {undo / back:.2f}"
    )


def clock(work: object) -> float:
    times = []
    for _ in range(7):
        begin = time.perf_counter()
        work()  # type: ignore[operator]
        times.append(time.perf_counter() - begin)
    return min(times)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--swings", type=int, default=4)
    parser.add_argument(
        "--twins", type=int, default=20, help="every so many trials in both kernels"
    )
    parser.add_argument("--speed", action="store_true")
    options = parser.parse_args()
    compiled = kernel.compiled_kernel()
    if compiled is None:
        raise SystemExit("the compiled kernel is not there")
    if options.speed:
        speed()
        return 0
    begin, worst, where, different = time.perf_counter(), 0.0, 0, 0
    for seed in range(options.seed, options.seed + options.trials):
        kernel.CHOSEN = compiled
        bits, error = trial(seed, options.swings)
        if error > worst:
            worst, where = error, seed
        if seed % options.twins == 0:
            kernel.CHOSEN = kernel.PythonKernel
            different += trial(seed, options.swings)[0] != bits
    print(f"{options.trials:,} models in {time.perf_counter() - begin:.0f} s")
    print(f"forward after inverse: worst error {worst:.1e} of the range (seed {where})")
    print(
        f"trials in which the two kernels differ in a bit: {different} of {options.trials // options.twins:,}"
    )
    return int(worst > BOUND or different > 0)


if __name__ == "__main__":
    sys.exit(main())
