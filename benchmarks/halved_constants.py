"""What constants of the identification decide: ten invented logs identified with another value of each.

    python benchmarks/halved_constants.py search:BEND_TRIALS:2,8 [MODULE:NAME:VALUE,VALUE ...]

Printed are, over those with the constant as it is, the error of each model on new moves (geometric mean of
four) and, behind the bar, the error that the model states. The plants are those of ``foreign_plants.py``; the
last four logs have spikes, a sensor that warms up, hum of 50 Hz, and a late sensor.
"""

from __future__ import annotations

import ast
import dataclasses
import importlib
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))
from foreign_plants import CONDITION, KINDS, STEP, STROKE, TOP, Floats, _error, moves, recorded

from dbo_cli.errors import DboError
from dbo_cli.hysteresis.identification import Recording, identify

ROOM = "dbo_cli.hysteresis.identification"
LOGS = [
    ("bouc-wen", "nested"), ("maxwell slip", "two"), ("krasnoselskii", "nested"), ("log creep", "two"),
    ("warm-up gain", "nested"), ("preisach steep", "fading"), ("bouc-wen", "nested"),
    ("krasnoselskii", "nested"), ("krasnoselskii", "nested"), ("late sensor", "nested"),
]  # fmt: skip
MOVES = ("nested", "dwell", "pixels", "low")


def faults(rows: int) -> dict[int, Floats]:
    """Return what the sensor adds to some of the logs (um), by their place in the list."""
    random, spikes = np.random.default_rng(3), np.zeros(rows)
    spikes[random.integers(0, rows, 12)] = 3.0 * random.normal(size=12)
    time = STEP * np.arange(rows)
    drift = 0.6 * (1.0 - np.exp(-4.0 * np.linspace(0.0, 1.0, rows)))
    return {6: spikes, 7: drift, 8: 0.04 * np.sin(2.0 * np.pi * 50.0 * time)}


def logs() -> Iterator[tuple[Recording, list[Recording]]]:
    """Yield each log, and the moves on which its model is judged."""
    for place, (name, drive) in enumerate(LOGS):
        log, tests = recorded(KINDS[name], drive, 1), []
        wrong = faults(len(log.voltage)).get(place, 0.0)
        for move, shape in moves(501):
            if move in MOVES:
                whole = np.concatenate((CONDITION, shape))
                truth = STROKE * KINDS[name].plant(whole, 60.0)
                time = STEP * np.arange(len(whole))
                tests.append(Recording(move, TOP * whole, truth, time, None, "V", "um"))
        yield dataclasses.replace(log, displacement=log.displacement + wrong), tests


def errors(made: list[tuple[Recording, list[Recording]]]) -> Floats:
    """Return the errors on new moves and those stated; NaN where there is no model or it states none."""
    found = np.full((2, len(made)), np.nan)
    for k, (log, tests) in enumerate(made):
        try:
            model = identify([log]).model
        except DboError as problem:
            print(f"{LOGS[k]}: {problem}")
            continue
        found[0, k] = np.exp(np.mean([np.log(_error(model, one, len(CONDITION))) for one in tests]))
        stated = model.fit["expected_rmse"]
        found[1, k] = stated if isinstance(stated, float) else np.nan
    return found


def put(module: str, name: str, value: Any) -> Any:
    """Give a constant another value wherever it was imported to; returns the one it had."""
    own = importlib.import_module(f"{ROOM}.{module}")
    before = getattr(own, name)
    for label, one in list(sys.modules.items()):
        if label.startswith("dbo_cli.") and vars(one).get(name) is before:
            if one is own or f"{module} import" in Path(str(one.__file__)).read_text(encoding="utf-8"):
                setattr(one, name, value)
    return before


def main() -> None:
    """Print a line for each value."""
    warnings.simplefilter("ignore")
    made = list(logs())
    usual = errors(made)
    for asked in sys.argv[1:]:
        module, name, values = asked.split(":")
        for text in values.split(","):
            before = put(module, name, ast.literal_eval(text))
            ratios = [" ".join(f"{one:.3f}" for one in row) for row in errors(made) / usual]
            put(module, name, before)
            print(f"{module}.{name} {before} -> {text}: {' | '.join(ratios)}", flush=True)


if __name__ == "__main__":
    main()
