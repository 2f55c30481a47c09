"""Models and states changed at random and then used: the program's own errors, or finite numbers.

    python benchmarks/attack/mutants.py [COUNT] [SEED]

A model that is read in spite of its change must run over a signal, be inverted and
written again; a state must carry on. Nothing but one-line errors may come of it, and no
NaN or infinity.
"""

from __future__ import annotations

import copy
import json
import random
import re
import sys
import tempfile
import warnings
from collections import Counter
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))

import numpy as np
from arena import MODEL, RELAXATION, Hang, time_limit

from dbo_cli.errors import DboError
from dbo_cli.hysteresis.model_file import (
    model_to_bytes,
    read_model,
    read_state,
    state_to_bytes,
)
from dbo_cli.logs.columns import require_finite
from dbo_cli.logs.sample_block import Column

ODD: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2, 0.0, -0.0, 1.5, -2.5, 1e-9, 1e9, 1e150, 1e200, 1e308, -1e308, 1e-308, 5e-324,
    float("nan"), float("inf"), float("-inf"), "", "x", "voltage", "forward", "inverse", [], [0.0], [1.0, -1.0],
    {}, {"type": "backlash"}, {"type": "delay", "seconds": 0.1}, {"type": "scale", "gain": -1.0, "offset": 0.0},
    {"repeat": 3, "value": 1.0}, {"repeat": 10**12, "value": 1.0}, {"repeat": -1, "value": 1.0}, [[1.0]], "1.0",
    10**400, 2**53 + 1, "\ud800", "a\x1b[31m", {"repeat": 2, "value": 0.0},
)  # fmt: skip


def models() -> list[Any]:
    """Return the models to be changed."""
    late = copy.deepcopy(MODEL)
    late["stages"][0]["relaxation"] = RELAXATION
    point = {"type": "point", "x0": 0.0, "y0": 0.0, "dx": [2.0, 3.0], "dy": [2.5, 2.5]}
    late["stages"].insert(1, point)
    late["stages"].append({"type": "delay", "seconds": 0.02})
    second = copy.deepcopy(MODEL) | {"version": 2}
    second["stages"][0]["dx"] = [{"repeat": 4, "value": 2.5}]
    return [MODEL, late, second]


def changed(tree: Any, pick: random.Random) -> Any:
    """Return a copy with one to three places changed."""
    tree = copy.deepcopy(tree)
    for _ in range(pick.randrange(1, 4)):
        node, place = tree, None
        while isinstance(node, dict | list) and node:
            place = node
            key: Any = (
                pick.choice(list(node))
                if isinstance(node, dict)
                else pick.randrange(len(node))
            )
            if not isinstance(node[key], dict | list) or pick.random() < 0.2:
                break
            node = node[key]
        if place is None or key not in (
            place if isinstance(place, dict) else range(len(place))
        ):
            continue
        way = pick.randrange(5)
        if way == 0:
            del place[key]
        elif way == 1 and isinstance(place, list):
            place.insert(key, copy.deepcopy(pick.choice(ODD)))
        elif way == 2 and isinstance(place[key], float):
            place[key] = place[key] * pick.choice(
                [-1, 0.5, 2, 1e3, 1e-3, 1e12, 1e-12, 1 + 1e-15]
            )
        else:
            place[key] = copy.deepcopy(pick.choice(ODD))
    return tree


class Mutants:
    """Changes files, uses them, and remembers what came of it."""

    def __init__(self, seed: int, folder: Path) -> None:
        self.pick = random.Random(seed)
        self.model, self.state = folder / "model.json", folder / "state.json"
        self.good = folder / "good.json"
        self.counts: Counter[str] = Counter()
        self.failures: list[str] = []
        self.sources = models()
        self.drive = 5.0 - 5.0 * np.cos(np.arange(60) * 0.3)

    def run(self, count: int) -> None:
        """Try ``count`` changed files."""
        for number in range(count):
            kind = "state" if number % 3 == 0 else "model"
            try:
                with time_limit(60.0), warnings.catch_warnings():
                    warnings.simplefilter("error")
                    told = self._state() if kind == "state" else self._model()
            except DboError as problem:
                told = str(problem)
                if "\n" in told or not told:
                    self.failures.append(f"{kind} {number}: not one line: {told!r}")
                told = "refused"
            except (Exception, Hang) as problem:
                told = "FAILED"
                text = (self.state if kind == "state" else self.model).read_text(
                    errors="replace"
                )
                self.failures.append(
                    f"{kind} {number}: {type(problem).__name__}: {problem}: {text[:600]}"
                )
            self.counts[f"{kind}: {told}"] += 1

    def _written(self, path: Path, tree: Any) -> None:
        text = json.dumps(tree)
        if self.pick.random() < 0.1:
            place = self.pick.randrange(len(text))
            text = (
                text[:place]
                + self.pick.choice(["", "{", "]", ",", "0", "\x00", "e", '"'])
                + text[place + 1 :]
            )
        if self.pick.random() < 0.03:
            text = text[: self.pick.randrange(len(text))]
        path.write_text(text, encoding="utf-8", errors="surrogatepass")

    def _used(self, model: Any, start: Any) -> Any:
        with np.errstate(over="ignore", invalid="ignore"):
            done = model.simulate(self.drive, start, time_step=0.01)
        require_finite([Column("result")], ["result"], [done.y])  # as the writers do
        return done.state

    def _model(self) -> str:
        self._written(self.model, changed(self.pick.choice(self.sources), self.pick))
        model = read_model(str(self.model))
        text = model_to_bytes(model)
        self.model.write_bytes(text)
        if model_to_bytes(read_model(str(self.model))) != text or re.search(
            rb"NaN|Infinity", text
        ):
            raise AssertionError("a model does not survive being written and read")
        state = self._used(model, model.start(float(self.drive[0])))
        if re.search(rb"NaN|Infinity", state_to_bytes(state, model)):
            raise AssertionError("a state is not finite")
        inverse = model.inverse()
        model_to_bytes(inverse)
        return "used"

    def _state(self) -> str:
        tree = self.pick.choice(self.sources)
        self.good.write_text(json.dumps(tree))
        model = read_model(str(self.good))
        state = self._used(model, model.start(float(self.drive[0])))
        good = json.loads(state_to_bytes(state, model))
        self._written(self.state, changed(good, self.pick))
        self._used(model, read_state(str(self.state), model))
        return "used"


def main() -> int:
    """Try many changed files."""
    from arena import report

    count = int(sys.argv[1]) if len(sys.argv) > 1 else 50_000
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    with tempfile.TemporaryDirectory() as folder:
        mutants = Mutants(seed, Path(folder))
        mutants.run(count)
    return report("mutants", mutants.counts, mutants.failures)


if __name__ == "__main__":
    sys.exit(main())
