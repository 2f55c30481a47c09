"""What each part of a model is worth: the error on new moves where it is left out, over that with all parts.

Ten kinds of plants (``foreign_plants.py``), each identified from the drive of ``excite`` and judged on eight
moves; with DATA the authors' pair, offset removed; and a stage with a resonance, on a move at a fifth of it.
Prints the table of docs/comparison.md: the error of the whole in % of the stroke (RMS over the moves), and
the geometric mean of the ratios of the moves. The last two columns keep every stage and put plays in the
place of the gears: one for each slope, and 25.

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
from foreign_plants import CONDITION, HELD_OUT, KINDS, LATER, NOISE, STEP, STROKE, TOP, moves, recorded
from test_hysteresis_identification_dynamics import RATE, plant
from test_hysteresis_identification_dynamics import recorded as recorded_stage

from dbo_cli.hysteresis import cascade
from dbo_cli.hysteresis.dynamics import Lag, Resonance
from dbo_cli.hysteresis.excitation import Excitation
from dbo_cli.hysteresis.identification import IdentificationOptions, Recording, identify, search
from dbo_cli.hysteresis.identification.evaluation import predict
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.operators import BacklashState, DiscreteBacklashOperator

LATE = ("late sensor",)  # what is late there is not the actuator
FREQUENCY = 80.0  # of the stage's resonance, Hz
WITHOUT = ("memories", "bend", "segments", "delay", "dynamics")
FEW_PLAYS = 25  # as many as the paper has gears
Errors = Callable[[ActuatorModel], list[float]]


class Plays(DiscreteBacklashOperator):
    """The curve that the gears follow after every turn, followed by plays instead (Kuhnen's [6]).

    After a turn both give y(d) = sum of s_i times the part of gear i that d reaches: the gears one after
    the other, the plays z_i = max(x - r_i, min(x + r_i, z_i)) with r_i half of where slope i begins and
    w_i = s_i - s_(i-1). What differs is a turn inside a gear, and what fewer plays leave out. Only a run from
    its beginning is right: the plays are no part of the state.
    """

    plays: int | None = None

    def run(self, x: Any, state: BacklashState, **options: Any) -> tuple[Any, BacklashState, Any]:
        """Return the output for a whole move from one end of the range."""
        remembered, after, counts = super().run(x, state, **options)
        gears = DiscreteBacklashOperator(self.dx, self.dy, self.x0, self.y0).run(
            x, BacklashState(state.bits)
        )[0]
        ends = np.concatenate(([0.0], np.cumsum(self.dx)))
        heights = np.concatenate(([0.0], np.cumsum(self.dy)))
        begins = ends[:-1][np.diff(self.dy / self.dx, prepend=0.0) != 0.0]
        if self.plays is not None:
            begins = np.linspace(0.0, float(ends[-1]), self.plays, endpoint=False)
        curve = np.interp(np.append(begins, ends[-1]), ends, heights)
        slopes = np.diff(curve) / np.diff(np.append(begins, ends[-1]))
        summed = np.zeros(len(gears))
        for weight, radius in zip(np.diff(slopes, prepend=0.0), begins / 2.0, strict=True):
            z = self.x0 + radius
            for row, drive in enumerate(np.asarray(x).tolist()):
                z = max(drive - radius, min(drive + radius, z))
                summed[row] += weight * (z - self.x0 - radius)
        return remembered - gears + self.y0 + summed, after, counts


def by_plays(errors: Errors, model: ActuatorModel, count: int | None) -> list[float]:
    """Return a model's errors with plays in the place of its gears, the spare ones left away as always."""
    stages = tuple(
        Plays(stage.dx, stage.dy, stage.x0, stage.y0, stage.relaxation)
        if isinstance(stage, DiscreteBacklashOperator)
        else stage
        for stage in model.stages
    )
    ordinary, Plays.plays = cascade.DiscreteBacklashOperator, count
    try:
        cascade.DiscreteBacklashOperator = Plays  # type: ignore[misc]
        return errors(replace(model, stages=stages))
    finally:
        cascade.DiscreteBacklashOperator = ordinary  # type: ignore[misc]


def without(part: str, logs: list[Recording], skip: float) -> ActuatorModel:
    """Identify with one part left out, or ("") with all."""
    options = {"memories": {"relaxation": ()}, "delay": {"delay": 0.0}, "dynamics": {"dynamics": 0}}
    trials, segments = search.BEND_TRIALS, search.SEGMENTS
    try:
        search.BEND_TRIALS = -1 if part == "bend" else trials
        search.SEGMENTS = segments[:1] if part == "segments" else segments
        chosen = IdentificationOptions(skip_seconds=skip, **options.get(part, {}))  # type: ignore[arg-type]
        return identify(logs, chosen).model
    finally:
        search.BEND_TRIALS, search.SEGMENTS = trials, segments


def cases(data: Path | None, log: str) -> Iterator[tuple[str, list[Recording], float, Errors]]:
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
        if name not in (*HELD_OUT, *LATE):
            tests = []
            for move, shape in moves(501):
                drive = np.concatenate((CONDITION, shape))
                truth = STROKE * kind.plant(drive, LATER)
                tests.append(
                    Recording(move, TOP * drive, truth, STEP * np.arange(len(drive)), None, "V", "um")
                )

            def errors(model: ActuatorModel, tests: list[Recording] = tests) -> list[float]:
                left = [(one.displacement - predict(model, one, "empty"))[len(CONDITION) :] for one in tests]
                return [100.0 * float(np.sqrt(np.mean(one**2))) / STROKE for one in left]

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
    parser.add_argument("data", nargs="?", type=Path, help="folder of the authors' recordings")
    parser.add_argument("--log", default="excite", help="drive that the plants are identified from")
    parser.add_argument("--only", default="", help="only the cases whose names hold this text")
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
        cells += [ratio(by_plays(errors, model, count), whole) for count in (None, FEW_PLAYS)]
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
