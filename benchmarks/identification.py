"""Development table of identification: error, what was stated of it, and seconds, case by case.

    python benchmarks/identification.py RECORDINGS [--before FILE] [--save FILE] [CASE...]

RECORDINGS holds a folder a case (``case.json``, logs as CSV); the authors' logs are
looked for in ``../paper`` beside it; invented plants come from ``plants.py``. Columns:
the test error over that of the best rival and of the fair one (the authors' logs: over
their bounds), and over that of the state before; the error over the one stated by
``fit.expected_rmse``, and over that for this very move; seconds. A refusal counts as
four times, or as one where no rival is better than a line.

``--before`` is a table saved by ``--save``, by another state of the package. ``--set
cross_validation.PRICE=0`` switches a rule off: another value (a literal of Python) for a
constant of ``dbo_cli.identification``, wherever it is used; an unknown name is refused.
``--copies`` identifies again from each log rounded to five digits, with 1 % noise, and
without its first or last 2 or 5 %, and prints how far the test error moves; noise counts
only where the error is larger than it.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import importlib.abc
import importlib.machinery
import json
import math
import sys
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from types import CodeType
from typing import Any

import numpy as np
from plants import NOISE, STROKE, Log, invented

WORST = 4.0  # ratio that a refusal counts as, and the most that any case counts as
PAPER_RATE = 200.0  # Hz
COPIES = ("five digits", "1 % noise", "first 2 %", "first 5 %", "last 2 %", "last 5 %")


@dataclass(frozen=True)
class Test:
    """A log and the rows of it that count (from 0)."""

    log: Log
    rows: slice
    offset_free: bool
    drift_free: bool = False


@dataclass(frozen=True)
class Case:
    """Logs to identify from, logs to predict, and rivals' errors where they are known."""

    name: str
    group: str
    source: str
    logs: list[Log]
    tests: list[Test]
    best: float | None = None
    fair: float | None = None
    line: float | None = None
    delay: float | None = None
    state: str = "auto"
    skip: float = 0.0
    noise: float = 0.0


@dataclass(frozen=True)
class Result:
    """What one way of identification made of one case."""

    name: str
    group: str
    source: str
    rmse: float | None
    stated: float | None = None
    stated_move: float | None = None
    seconds: float = 0.0
    warned: int = 0
    refused: str = ""
    noise: float = 0.0
    ratios: dict[str, float] = field(default_factory=dict)


# --- cases ---


def read_log(path: Path) -> Log:
    table = np.genfromtxt(path, delimiter=",", skip_header=1)
    return Log(path.stem, table[:, 0], table[:, 1], table[:, 2])


def given(folder: Path) -> Case:
    """Read a case of RECORDINGS."""
    facts = json.loads((folder / "case.json").read_text())
    best = facts["best_rival"]["rmse"]
    fair = (facts["rival_by_its_own_left_out"] or facts["best_rival"])["rmse"]
    tests = []
    for test in facts["tests"]:
        first, last = test["rows"]
        log = read_log(folder / test["file"])
        tests.append(Test(log, slice(first - 1, last), test["offset_free"]))
    delay = 0.0 if "--delay" in facts["identify"] else None
    state = "empty" if "empty" in facts["simulate"] else "auto"
    group = "scanners" if folder.name.startswith("afm") else "others"
    source = facts["source"].split("@")[0].split(" ")[0]
    logs = [read_log(folder / name) for name in facts["train"]]
    return Case(facts["name"], group, source, logs, tests, best, fair, facts["line"],
                delay, state)  # fmt: skip


def authors(folder: Path) -> Iterator[Case]:
    """Yield the authors' logs, each predicted from the other, with the bounds that hold today."""

    def log(name: str, rows: slice = slice(None)) -> Log:
        table = np.loadtxt(folder / name, usecols=(0, 4))[rows]
        clock = np.arange(len(table)) / PAPER_RATE
        return Log(name, clock, table[:, 0], table[:, 1])

    first, second = log("identification.dat"), log("uncompensated.dat")
    begin = log("uncompensated.dat", slice(600, 3500))
    cases = (
        ("one log", [first], Test(second, slice(600, 7000), True), 0.145, 2.0),
        ("two logs", [first, begin], Test(second, slice(3500, 7000), True), 0.15, 2.0),
        ("wider use", [second], Test(first, slice(600, None), True, True), 0.18, 3.0),
    )
    for name, logs, test, bound, skip in cases:
        yield Case(f"authors' {name}", "authors", "authors", logs, [test], bound, bound,
                   skip=skip)  # fmt: skip


def plants() -> Iterator[Case]:
    """Yield the invented plants."""
    for one in invented():
        test = Test(one.test, slice(one.first, None), one.offset_free)
        source = one.name.split(",")[0]
        yield Case(
            one.name, "invented", source, [one.log], [test], noise=NOISE * STROKE
        )


def all_cases(recordings: Path, paper: Path, words: Sequence[str]) -> list[Case]:
    cases = []
    for folder in sorted(recordings.iterdir()):
        if (folder / "case.json").exists():
            cases.append(given(folder))
    if paper.exists():
        cases += authors(paper)
    cases += plants()
    if not words:
        return cases
    wanted = []
    for case in cases:
        label = f"{case.group}: {case.name}"
        if any(word in label for word in words):
            wanted.append(case)
    return wanted


def copied(case: Case, kind: str) -> Case:
    """Return a case whose logs are a copy that should make no difference."""
    logs = []
    for log in case.logs:
        displacement, rows = log.displacement, slice(None)
        if kind == "five digits":
            displacement = np.array([float(f"{value:.5g}") for value in displacement])
        elif kind == "1 % noise":
            noise = np.random.default_rng(1).standard_normal(displacement.size)
            displacement = displacement + 0.01 * np.std(displacement) * noise
        else:
            end, share = kind.removesuffix(" %").split()
            cut = displacement.size * int(share) // 100
            rows = slice(cut, None) if end == "first" else slice(0, -cut)
        logs.append(
            Log(log.name, log.time[rows], log.voltage[rows], displacement[rows])
        )
    return replace(case, logs=logs)


# --- identification ---

Predicted = tuple[list[Any], dict[str, Any], float, list[float | None]]


def predicted(case: Case) -> Predicted:
    """Identify and predict."""
    from dbo_cli.identification import Options, Recording, identify
    from dbo_cli.model.expect import expected_error

    options = Options(skip=case.skip)
    if case.delay is not None:
        options = replace(options, delay=case.delay)
    recordings = []
    for log in case.logs:
        recordings.append(Recording(log.name, log.voltage, log.displacement, log.time))
    begun = time.process_time()
    model = identify(recordings, options)
    seconds = time.process_time() - begun
    predictions, stated = [], []
    for test in case.tests:
        clock = test.log.time
        moved, _ = model.simulate(test.log.voltage, time=clock, state=case.state)
        predictions.append(moved)
        steps = np.diff(clock, prepend=clock[0] - (clock[1] - clock[0]))
        error = expected_error(model, test.log.voltage, steps)
        stated.append(None if error is None else math.hypot(*error))
    return predictions, dict(model.fit), seconds, stated


def error_of(case: Case, predictions: Sequence[Any]) -> float:
    """RMS error of the rows that count."""
    squares = count = 0.0
    for test, moved in zip(case.tests, predictions, strict=True):
        error = (test.log.displacement - moved)[test.rows]
        if test.drift_free:
            clock = np.arange(error.size)
            error = error - np.polyval(np.polyfit(clock, error, 1), clock)
        if test.offset_free:
            error = error - error.mean()
        squares += float(error @ error)
        count += error.size
    return math.sqrt(squares / count)


def measured(case: Case) -> Result:
    """Return what identification makes of a case; a refusal is a result, too."""
    result = Result(case.name, case.group, case.source, None, noise=case.noise)
    begun = time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            predictions, fit, seconds, stated = predicted(case)
    except Exception as problem:  # one case must not hide the others
        text = f"{type(problem).__name__}: {problem}"
        return replace(result, refused=text, seconds=time.perf_counter() - begun)
    known = [value for value in stated if value is not None]
    move = math.sqrt(float(np.mean(np.square(known)))) if known else None
    return replace(result, rmse=error_of(case, predictions), seconds=seconds,
                   stated=fit.get("expected_rmse"), stated_move=move,
                   warned=len(fit.get("warnings") or ()))  # fmt: skip


# --- the table ---


def compared(case: Case, result: Result, before: dict[str, Result]) -> Result:
    """Return a result with its ratios to rivals and to the state before."""
    hopeless = case.best is not None and case.best >= 0.98 * (case.line or math.inf)
    references = {"best": case.best, "fair": case.fair}
    old = before.get(case.name)
    if old is not None:
        references["before"] = old.rmse
    ratios = {}
    for key, reference in references.items():
        if result.rmse is None:
            ratios[key] = 1.0 if hopeless else WORST
        elif reference:
            ratios[key] = result.rmse / reference
        elif key == "before":
            ratios[key] = 1.0 if hopeless else 1.0 / WORST
    return replace(result, ratios=ratios)


def cell(value: float | None, width: int = 7) -> str:
    return f"{'-':>{width}}" if value is None else f"{value:{width}.2f}"


def over(result: Result, stated: float | None) -> float | None:
    """Return the error that a user meets over the stated one, the sensor's noise added to both."""
    if result.rmse is None or not stated:
        return None
    met = math.hypot(result.rmse, result.noise)
    return met / math.hypot(stated, result.noise)


HEAD = (
    f"{'case':50}{'rmse':>10}{'best':>7}{'fair':>7}{'before':>7}"
    f"{'stated':>7}{'move':>7}{'s':>6} warnings"
)


def row(result: Result) -> str:
    error = "refused" if result.rmse is None else f"{result.rmse:.4g}"
    ratios = "".join(cell(result.ratios.get(key)) for key in ("best", "fair", "before"))
    stated = cell(over(result, result.stated))
    move = cell(over(result, result.stated_move))
    label = f"{result.group[:3]} {result.name}"[:49]
    text = f"{label:50}{error:>10}{ratios}{stated}{move}{result.seconds:6.1f}"
    return f"{text} {result.warned or ''} {result.refused[:120]}".rstrip()


def mean(values: Sequence[float]) -> float:
    """Geometric mean, each value at most WORST."""
    return math.exp(sum(math.log(min(value, WORST)) for value in values) / len(values))


def summary(results: Sequence[Result]) -> Iterator[str]:
    """Yield the lines below the table: means by group, what is stated, each source left out."""
    for group in dict.fromkeys(result.group for result in results):
        some = [result for result in results if result.group == group]
        parts = []
        for key in ("best", "fair", "before"):
            values = [one.ratios[key] for one in some if key in one.ratios]
            if values:
                parts.append(f"{mean(values):.3f} of {key}")
        refused = sum(one.rmse is None for one in some)
        yield f"{len(some)} {group}: {', '.join(parts)}; {refused} refused"
    for key, name in (("stated", "fit.expected_rmse"), ("stated_move", "of the move")):
        ratios = []
        for one in results:
            ratio = over(one, getattr(one, key))
            if ratio is not None:
                ratios.append(ratio)
        if ratios:
            shown = " ".join(f"{q:.2f}" for q in np.percentile(ratios, [10, 50, 90]))
            yield f"actual over stated, {name}: 10/50/90 % {shown}, most {max(ratios):.1f}"
    pairs = [(one.source, one.ratios.get("before")) for one in results]
    known = [(source, ratio) for source, ratio in pairs if ratio is not None]
    if known:
        without = {}
        for source in dict.fromkeys(source for source, _ in known):
            rest = [ratio for other, ratio in known if other != source]
            without[source] = mean(rest) if rest else math.nan
        low, high = min(without.values()), max(without.values())
        whole = mean([ratio for _, ratio in known])
        yield f"all over before: {whole:.3f}; each source left out in turn {low:.3f} to {high:.3f}"
    yield f"seconds: {sum(one.seconds for one in results):.0f}"


def table(cases: Sequence[Case], before: dict[str, Result]) -> list[Result]:
    """Measure and print all cases."""
    print(HEAD)
    results = []
    for case in cases:
        result = compared(case, measured(case), before)
        results.append(result)
        print(row(result), flush=True)
    for line in summary(results):
        print(line)
    return results


def copies(cases: Sequence[Case]) -> None:
    """Print how far the test error moves where the logs are copied."""
    print(f"{'copies':50}{'rmse':>10}" + "".join(f"{kind:>14}" for kind in COPIES))
    moved = []
    for case in cases:
        errors = [measured(one).rmse for one in
                  (case, *(copied(case, kind) for kind in COPIES))]  # fmt: skip
        if errors[0] is None:
            continue
        cells = ""
        noise = 0.01 * max(float(np.std(log.displacement)) for log in case.logs)
        for kind, error in zip(COPIES, errors[1:], strict=True):
            change = WORST if error is None else error / errors[0]
            if "noise" not in kind or errors[0] > noise:
                moved.append(abs(math.log(change)))
            cells += f"{100.0 * (change - 1.0):+13.0f}%"
        print(f"{case.name[:49]:50}{errors[0]:10.4g}{cells}", flush=True)
    small = np.mean(np.array(moved) < math.log(1.2))
    print(f"moved by less than 20 %: {100.0 * small:.0f} % of {len(moved)} copies; "
          f"mean of |ln| {np.mean(moved):.3f}, 90 % {np.percentile(moved, 90):.3f}")  # fmt: skip


def loaded(path: str) -> dict[str, Result]:
    results = {}
    for values in json.loads(Path(path).read_text()):
        results[values["name"]] = Result(**values)
    return results


class ChangedConstants(importlib.machinery.SourceFileLoader):
    """Loads a module with other constants: defaults and names made of them follow."""

    values: dict[str, Any]

    def get_code(self, fullname: str) -> CodeType:
        """Compile the source, each constant's value replaced; SystemExit where there is none."""
        path = self.get_filename(fullname)
        tree = ast.parse(self.get_data(path))
        missing = dict(self.values)
        for node in tree.body:
            if not isinstance(node, ast.Assign) or len(node.targets) != 1:
                continue
            target = node.targets[0]
            if isinstance(target, ast.Name) and target.id in missing:
                value = ast.parse(repr(missing.pop(target.id)), mode="eval").body
                node.value = value
        if missing:
            raise SystemExit(f"no constant {', '.join(missing)} in {fullname}")
        return compile(ast.fix_missing_locations(tree), path, "exec")


class ConstantsFinder(importlib.abc.MetaPathFinder):
    """Finds the modules whose constants are to be changed."""

    def __init__(self, changes: dict[str, dict[str, Any]]) -> None:
        self.changes = changes

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> Any:
        """Return the module's spec with a loader that changes it."""
        if fullname not in self.changes:
            return None
        spec = importlib.machinery.PathFinder.find_spec(fullname, path)
        if spec is None or spec.origin is None:
            raise SystemExit(f"no module {fullname}")
        loader = ChangedConstants(fullname, spec.origin)
        loader.values = self.changes[fullname]
        spec.loader = loader
        return spec


def set_constants(texts: Sequence[str]) -> None:
    """Give constants of ``dbo_cli.identification`` other values: each text is ``module.NAME=VALUE``.

    The modules' sources are changed before they are imported, so that nothing keeps the
    value that it has.
    """
    changes: dict[str, dict[str, Any]] = {}
    for text in texts:
        place, value = text.split("=", 1)
        module, name = place.rsplit(".", 1)
        values = changes.setdefault(f"dbo_cli.identification.{module}", {})
        values[name] = ast.literal_eval(value)
    loaded = [module for module in changes if module in sys.modules]
    if loaded:
        raise SystemExit(f"{', '.join(loaded)}: imported already")
    sys.meta_path.insert(0, ConstantsFinder(changes))
    for module in changes:
        importlib.import_module(module)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recordings", type=Path)
    parser.add_argument("cases", nargs="*", help="only cases whose names hold this")
    parser.add_argument("--paper", type=Path, help="folder of the authors' logs")
    parser.add_argument("--before", help="a saved table")
    parser.add_argument("--save", type=Path, help="keep this table as JSON")
    parser.add_argument("--set", action="append", default=[], help="module.NAME=VALUE")
    parser.add_argument("--copies", action="store_true")
    asked = parser.parse_intermixed_args()
    paper = asked.paper or asked.recordings.parent / "paper"
    set_constants(asked.set)
    cases = all_cases(asked.recordings, paper, asked.cases)
    if asked.copies:
        copies(cases)
        return 0
    results = table(cases, loaded(asked.before) if asked.before else {})
    if asked.save:
        rows = [asdict(result) for result in results]
        asked.save.write_text(json.dumps(rows, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
