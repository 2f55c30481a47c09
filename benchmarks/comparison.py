"""The DBO beside its relatives on every recording at hand: the tables of docs/comparison.md.

    python benchmarks/comparison.py [FOLDER] [--only NAME] [--write]

FOLDER holds the authors' recordings (identification.dat and uncompensated.dat;
README.md says where they are public). Beside them: the virtual actuators and
positioners of sample_data, and the invented actuators. Each model is fitted to the same
logs and predicts a new move of the same actuator; where that was simulated, its true
displacement is known. ``--write`` puts the tables into docs/comparison.md and draws the
figures there.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "sample_data"))

import numpy as np
import virtual_actuator
import virtual_positioner
from invented_actuators import cases, nested_turns
from numpy.typing import NDArray

from dbo_cli.errors import DboError
from dbo_cli.extras.compare.judging import NAMES, SAME_STAGES, Row, compare
from dbo_cli.hysteresis.excitation import Excitation
from dbo_cli.hysteresis.identification import Recording

ROOT = Path(__file__).resolve().parents[1]
Floats = NDArray[np.float64]
PAGE = ROOT / "docs" / "comparison.md"
FIGURES = ROOT / "docs" / "figures"
TIE = 0.05  # errors that differ by less than this share are a tie


@dataclass(frozen=True)
class Task:
    """Logs to fit, and a recording that took no part; ``stroke`` is what errors are a share of."""

    group: str
    name: str
    logs: list[Recording]
    test: Recording
    skip: float = 0.0
    judged_from: float | None = None  # s; the model runs from the first row on

    @property
    def stroke(self) -> float:
        """Peak to peak of the move that is predicted."""
        return float(np.ptp(self.test.displacement))


def authors(folder: Path) -> Iterator[Task]:
    """Yield the authors' two logs, each predicted from the other and from parts."""

    def log(name: str, rows: slice = slice(None)) -> Recording:
        table = np.loadtxt(folder / name, usecols=(0, 4))[rows]
        return Recording(
            name, table[:, 0].copy(), table[:, 1].copy(), None, 0.005, "V", "um"
        )

    whole, test = log("identification.dat"), log("uncompensated.dat")
    half = log("uncompensated.dat", slice(600, 3500))
    group = "authors' recordings"
    yield Task(group, "one amplitude predicts many", [whole], test, 2.0, 3.0)
    yield Task(group, "part of the range predicts all", [test], whole, 3.0)
    yield Task(group, "both predict the rest", [whole, half], test, 2.0, 17.5)
    yield Task(group, "first half predicts second", [half], test, 0.0, 17.5)


def virtual_actuators() -> Iterator[Task]:
    """Yield the virtual actuators of sample_data, driven by ``excite``; judged on the true displacement."""
    for number, (name, parameters) in enumerate(virtual_actuator.PRESETS.items()):
        bench = virtual_actuator.VirtualActuator(parameters)
        low, span = parameters.v_min, parameters.v_max - parameters.v_min
        time, voltage = Excitation(
            low, parameters.v_max, 500.0, 15.0, 1.0, seed=number + 1
        ).drive()
        log = Recording(
            name, voltage, bench.play(time, voltage, seed=number), time, None, "V", "um"
        )
        new = low + span * nested_turns(number, 500.0, 10.0, (0.5, 5.0))
        clock = np.arange(len(new)) / 500.0
        truth = bench.displacement(clock, new)
        yield Task(
            "virtual actuators",
            name,
            [log],
            Recording("new", new, truth, clock, None, "V", "um"),
        )


def virtual_positioners() -> Iterator[Task]:
    """Yield the virtual positioners of sample_data: fast moves, up to a tenth of the resonance."""
    rate = 10_000.0
    for number, (name, parameters) in enumerate(virtual_positioner.PRESETS.items()):
        stage = virtual_positioner.VirtualPositioner(parameters)
        voltage = Excitation(
            0.0, 100.0, rate, 6.0, 1.0, seed=number + 1, sweep_to=1000.0
        ).drive()[1]
        log = Recording(
            name,
            voltage,
            stage.play(voltage, rate, number),
            None,
            1.0 / rate,
            "V",
            "um",
        )
        new = 100.0 * nested_turns(number, rate, 3.0, (2.0, 60.0))
        truth = stage.displacement(new, rate)
        yield Task(
            "virtual positioners",
            name,
            [log],
            Recording("new", new, truth, None, 1.0 / rate, "V", "um"),
        )


def invented(seed: int) -> Iterator[Task]:
    """Yield the invented actuators."""
    for case in cases(seed):
        test = Recording(
            "new", case.test.voltage, case.truth, case.test.time, None, "V", "um"
        )
        yield Task("invented actuators", case.name, case.logs, test)


def tasks(folder: Path | None, seed: int) -> Iterator[Task]:
    """Yield all tasks."""
    if folder is not None:
        yield from authors(folder)
    yield from virtual_actuators()
    yield from virtual_positioners()
    yield from invented(seed)


def percent(row: Row, stroke: float) -> str:
    """Return an error on the new move in % of the stroke."""
    if row.validation_rmse is None:
        return "refused"
    return f"{100.0 * row.validation_rmse / stroke:.3g}"


def line_of(task: Task) -> tuple[str, list[float]] | str:
    """Compare on one task; return the line of the table, and errors over the DBO's, or why there is none."""
    try:
        rows = compare(
            task.logs, [task.test], NAMES, task.skip, False, task.judged_from
        )
    except DboError as problem:
        return f"| {task.name} | {problem} |"
    errors = [
        np.nan if row.validation_rmse is None else row.validation_rmse for row in rows
    ]
    cells = [percent(row, task.stroke) for row in rows]
    named = dict(zip(NAMES, errors, strict=True))
    own = named.pop("dbo")
    del named[SAME_STAGES]  # the DBO's own model with plays is no other fit
    rival = min(error for error in named.values() if error == error)
    best = min(own, rival)
    cells = [
        f"**{cell}**" if error <= (1.0 + TIE) * best else cell
        for cell, error in zip(cells, errors, strict=True)
    ]
    ratio = rival / own
    verdict = (
        "tie"
        if 1.0 / (1.0 + TIE) <= ratio <= 1.0 + TIE
        else "ahead"
        if ratio > 1.0
        else "behind"
    )
    return f"| {task.name} | {' | '.join(cells)} | {ratio:.2f} | {verdict} |", [
        error / own for error in errors
    ]


def show_tables(folder: Path | None, seed: int, only: str, write: bool) -> None:
    """Print the tables by group; with ``write`` put each into the page as far as it is."""
    groups: dict[str, list[Task]] = {}
    for task in tasks(folder, seed):
        if only in f"{task.group}: {task.name}":
            groups.setdefault(task.group, []).append(task)
    head = ["recording", *NAMES, "best other / dbo", "dbo is"]
    for group, members in groups.items():
        lines, ratios = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"], []
        print(f"\n{group}\n\n" + "\n".join(lines))
        for task in members:
            line = line_of(task)
            if not isinstance(line, str):
                ratios.append(line[1])
                line = line[0]
            lines.append(line)
            print(line, flush=True)
        if ratios:
            means = np.exp(np.nanmean(np.log(np.array(ratios)), axis=0))
            cells = " | ".join(f"{mean:.2f}" for mean in means)
            lines.append(f"| geometric mean of the ratios to dbo | {cells} | | |")
            print(lines[-1], flush=True)
        if write:
            written(group, "\n".join(lines))


def written(name: str, content: str) -> None:
    """Put a block into the page, between its marks."""
    text = PAGE.read_text(encoding="utf-8")
    mark = f"(<!-- made: {re.escape(name)} -->\n).*?(<!-- end -->)"
    changed, count = re.subn(
        mark, lambda found: f"{found[1]}{content}\n{found[2]}", text, flags=re.DOTALL
    )
    if count != 1:
        raise SystemExit(f"{PAGE.name}: has no place for {name!r}")
    PAGE.write_text(changed, encoding="utf-8")


def cost() -> str:
    """Return the tables of relatives_cost.py, its figures drawn beside the page."""
    script = Path(__file__).with_name("relatives_cost.py")
    command = [sys.executable, str(script), "--figures", str(FIGURES)]
    done = subprocess.run(command, capture_output=True, text=True)
    print(done.stdout)
    return "\n".join(
        f"    {line}".rstrip() for line in done.stdout.strip().splitlines()
    )


def command(folder: Path) -> str:
    """Return what ``dbo compare`` prints for the authors' logs, its figures drawn beside the page."""
    base = [
        sys.executable,
        "-m",
        "dbo_cli",
        "compare",
        "identification.dat",
        "--validate",
        "uncompensated.dat",
    ]
    how = [
        "--voltage",
        "1",
        "--displacement",
        "5",
        "--sample-rate",
        "200",
        "--skip",
        "2",
        "--quiet",
    ]
    with tempfile.TemporaryDirectory() as drawn:
        done = subprocess.run(
            [*base, *how, "--figures", drawn],
            cwd=folder,
            capture_output=True,
            text=True,
            check=True,
        )
        for key in ("cost", "loops"):
            (FIGURES / f"compare-{key}.svg").write_bytes(
                (Path(drawn) / f"models-{key}.svg").read_bytes()
            )
    print(done.stdout)
    shown = "    $ dbo " + " ".join([*base[3:], *how])
    return (
        shown
        + "\n\n"
        + "\n".join(f"    {line}".rstrip() for line in done.stdout.strip().splitlines())
    )


def main() -> None:
    """Print the tables; with ``--write`` also put them into the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument(
        "data", nargs="?", type=Path, help="folder of the authors' recordings"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--only",
        default="",
        help="only the recordings whose group and name hold this text",
    )
    parser.add_argument(
        "--write", action="store_true", help="write docs/comparison.md and its figures"
    )
    given = parser.parse_args()
    if given.write and not given.only:
        written("cost", cost())
        if given.data is not None:
            written("command", command(given.data))
    show_tables(given.data, given.seed, given.only, given.write)


if __name__ == "__main__":
    main()
