"""What each part of a model is worth: the error on new moves where it is left out, over that with all parts.

Ten kinds of plants (``foreign_plants.py``), each identified from the drive of
``excite`` and judged on eight moves; with DATA the authors' pair, offset removed; and a
stage with a resonance, on a move at a fifth of it. Prints the table of
docs/comparison.md: the error of the whole in % of the stroke (RMS over the moves), and
the geometric mean of the ratios of the moves. The last two columns keep every stage and
put plays in the place of the gears: one for each slope (``same-stages`` of ``dbo
compare``), and 25.

    python benchmarks/ablation.py [DATA] [--log excite] [--only TEXT]
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "sample_data"))
from against_plays import authors_tasks
from foreign_plants import (
    CONDITION,
    KINDS,
    LATER,
    NOISE,
    STEP,
    STROKE,
    TOP,
    moves,
    recorded,
)
from test_hysteresis_identification_dynamics import RATE, plant
from test_hysteresis_identification_dynamics import recorded as recorded_stage

from dbo_cli.extras.compare.play_model import with_plays
from dbo_cli.hysteresis.dynamics import Lag, Resonance
from dbo_cli.hysteresis.excitation import Excitation
from dbo_cli.hysteresis.identification import (
    IdentificationOptions,
    Recording,
    identify,
    search,
)
from dbo_cli.hysteresis.identification.evaluation import predict
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.operators import DiscreteBacklashOperator

OTHERS = ("accommodation", "rate-widening", "drifting zero")  # are of other questions
LATE = ("late sensor",)  # what is late there is not the actuator
FREQUENCY = 80.0  # of the stage's resonance, Hz
WITHOUT = ("memories", "bend", "segments", "delay", "dynamics")
FEW_PLAYS = 25  # as many as the paper has gears
Errors = Callable[[ActuatorModel], list[float]]


def coarser(model: ActuatorModel, count: int) -> ActuatorModel:
    """Return a model with so many even gears on the curve of its own, the spare ones left away."""
    gears = model.covered_gears
    ends = np.concatenate(([0.0], np.cumsum(gears.dx)))
    even = np.linspace(0.0, float(ends[-1]), count + 1)
    heights = np.diff(
        np.interp(even, ends, np.concatenate(([0.0], np.cumsum(gears.dy))))
    )
    few = DiscreteBacklashOperator(
        np.diff(even), heights, gears.x0, gears.y0, gears.relaxation
    )
    return replace(
        model,
        stages=tuple(
            few if stage is model.backlash else stage for stage in model.stages
        ),
    )


def without(part: str, logs: list[Recording], skip: float) -> ActuatorModel:
    """Identify with one part left out, or ("") with all."""
    options = {
        "memories": {"relaxation": ()},
        "delay": {"delay": 0.0},
        "dynamics": {"dynamics": 0},
    }
    trials, segments = search.BEND_TRIALS, search.SEGMENTS
    try:
        search.BEND_TRIALS = -1 if part == "bend" else trials
        search.SEGMENTS = segments[:1] if part == "segments" else segments
        chosen = IdentificationOptions(skip_seconds=skip, **options.get(part, {}))  # type: ignore[arg-type]
        return identify(logs, chosen).model
    finally:
        search.BEND_TRIALS, search.SEGMENTS = trials, segments


def cases(
    data: Path | None, log: str
) -> Iterator[tuple[str, list[Recording], float, Errors]]:
    """Yield a name, logs, the seconds left out, and a function that gives errors in % of the stroke."""
    if data is not None:
        task = next(authors_tasks(data))
        span = float(np.ptp(task.truth[task.judged]))
        yield (
            "authors' pair",
            task.logs,
            task.skip,
            lambda model: [100.0 * task.error(predict(model, task.test)) / span],
        )
    for name, kind in KINDS.items():
        if name not in (*OTHERS, *LATE):
            tests = []
            for move, shape in moves(501):
                drive = np.concatenate((CONDITION, shape))
                truth = STROKE * kind.plant(drive, LATER)
                tests.append(
                    Recording(
                        move,
                        TOP * drive,
                        truth,
                        STEP * np.arange(len(drive)),
                        None,
                        "V",
                        "um",
                    )
                )

            def errors(
                model: ActuatorModel, tests: list[Recording] = tests
            ) -> list[float]:
                left = [
                    (one.displacement - predict(model, one, "empty"))[len(CONDITION) :]
                    for one in tests
                ]
                return [
                    100.0 * float(np.sqrt(np.mean(one**2))) / STROKE for one in left
                ]

            yield name, [recorded(kind, log, 1)], 0.0, errors
    stage = plant(Lag(5e-4), Resonance(FREQUENCY, 0.05))
    sweep = Excitation(0.0, 100.0, RATE, 6.0, 1.0, sweep_to=200.0).drive()[1]
    clock = np.arange(round(2.0 * RATE)) / RATE
    sine = 50.0 - 30.0 * np.cos(2.0 * np.pi * FREQUENCY / 5.0 * clock)
    move = recorded_stage(stage, sine, 1)

    def stage_error(model: ActuatorModel) -> list[float]:
        left = (move.displacement - predict(model, move))[len(clock) // 2 :]
        return [100.0 * float(np.std(left)) / float(np.ptp(move.displacement))]

    yield "stage with a resonance", [recorded_stage(stage, sweep, 0)], 0.0, stage_error


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument(
        "data", nargs="?", type=Path, help="folder of the authors' recordings"
    )
    parser.add_argument(
        "--log", default="excite", help="drive that the plants are identified from"
    )
    parser.add_argument(
        "--only", default="", help="only the cases whose names hold this text"
    )
    given = parser.parse_args()
    titles = [*(f"no {one}" for one in WITHOUT), "plays", f"{FEW_PLAYS} plays"]
    print(f"| identified from `{given.log}` | all parts, % | {' | '.join(titles)} |")
    print(f"|---|---|{'---|' * len(titles)}")
    for name, logs, skip, errors in cases(given.data, given.log):
        if given.only not in name:
            continue
        model = without("", logs, skip)
        whole = certain(errors(model))
        cells = []
        for part in WITHOUT:
            if part == "dynamics" and "resonance" not in name:
                cells.append("")
                continue
            cells.append(ratio(errors(without(part, logs, skip)), whole))
        cells += [
            ratio(errors(with_plays(one)), whole)
            for one in (model, coarser(model, FEW_PLAYS))
        ]
        rms = float(np.sqrt(np.mean(np.square(whole))))
        print(f"| {name} | {rms:.3g} | {' | '.join(cells)} |", flush=True)


def certain(errors: list[float]) -> Any:
    """Return errors with a tenth of the sensor's noise in them: nobody could tell smaller ones."""
    return np.hypot(errors, 100.0 * NOISE / 10.0)


def ratio(errors: list[float], whole: Any) -> str:
    """Return the geometric mean of errors over those of the whole."""
    return f"{np.exp(np.mean(np.log(certain(errors) / whole))):.2f}"


if __name__ == "__main__":
    main()
