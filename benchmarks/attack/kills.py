"""Processes killed at any moment: every output is the old one or the new one, whole, and no litter stays.

    python benchmarks/attack/kills.py [COUNT] [SEED]

A command is run to its end once, for its outputs and its duration; then again and
again, ended at a random moment by SIGKILL, SIGTERM, SIGINT or SIGHUP. After SIGKILL the
temporary files may stay, until the next run removes them; after the others nothing may.
A kill between the renames of two outputs can leave the one new and the other old (they
are microseconds apart): that is counted.
"""

from __future__ import annotations

import os
import random
import signal
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from arena import fill, forked, inside, loaded, report

COMMANDS = [
    ("simulate model.json run.csv -o out.csv", ["out.csv"]),
    ("simulate model.json run.csv -o out.csv.gz", ["out.csv.gz"]),
    ("simulate model.json run.csv -o out.h5", ["out.h5"]),
    ("simulate model.json run.csv -o store.h5::/new", ["store.h5"]),
    (
        "simulate late.json run.csv -o out.csv --save-state state.json",
        ["out.csv", "state.json"],
    ),
    (
        "compensate late.json wish.csv -o drive.tsv --save-state state.json",
        ["drive.tsv", "state.json"],
    ),
    ("invert model.json -o inverse.json", ["inverse.json"]),
    ("report pair.csv -o report.html", ["report.html"]),
    (
        "excite --v-min 0 --v-max 10 --sample-rate 100 --duration 20 -o excite.csv",
        ["excite.csv"],
    ),
]
SIGNALS = [
    signal.SIGKILL,
    signal.SIGKILL,
    signal.SIGKILL,
    signal.SIGTERM,
    signal.SIGINT,
    signal.SIGHUP,
]


def prepared(folder: Path) -> None:
    """Put inputs and an old store with a group of somebody else's into the folder."""
    import h5py
    import numpy as np

    fill(folder)
    with h5py.File(folder / "store.h5", "w") as file:
        file["theirs/record"] = np.arange(1000.0)


def ended(process: int) -> int:
    """Wait for a process; return its exit code, or minus the signal's number."""
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])


class Target:
    """A command, the old and the new bytes of its outputs, and how long it takes."""

    def __init__(self, line: str, outputs: list[str]) -> None:
        self.words, self.outputs = [*line.split(), "--quiet"], outputs
        self.line = line
        self.old = {name: self.content(name) or b"as it was" for name in outputs}
        self.restore()
        begin = time.perf_counter()
        code = ended(forked(self.words))
        self.seconds = time.perf_counter() - begin
        assert code == 0, f"{line}: exit code {code}: {Path('stderr.txt').read_text()}"
        self.new = {name: self.content(name) for name in outputs}
        self.restore()

    def restore(self) -> None:
        """Put the outputs back as they were before the run."""
        for name, content in self.old.items():
            Path(name).write_bytes(content)

    @staticmethod
    def content(name: str) -> bytes | None:
        """Return what is in a file, or None where there is none."""
        return Path(name).read_bytes() if os.path.exists(name) else None

    def killed(self, number: int, delay: float) -> tuple[str, str | None]:
        """End a run after a delay; return what came of it and what is wrong with that."""
        before = set(os.listdir("."))
        process = forked(self.words)
        time.sleep(delay)
        os.kill(process, number)
        code = ended(process)
        found = {name: self.content(name) for name in self.outputs}
        states = [
            "new"
            if found[n] == self.new[n]
            else "old"
            if found[n] == self.old[n]
            else "TORN"
            for n in found
        ]
        left = set(os.listdir(".")) - before - set(self.outputs)
        wrong = None
        if "TORN" in states:
            wrong = f"{self.line} after {delay:.4f} s: {dict(zip(found, states, strict=True))}"
        elif number == signal.SIGKILL and any(
            not name.endswith(".partial") for name in left
        ):
            wrong = f"{self.line} left {sorted(left)}"
        elif number != signal.SIGKILL and (left or (len(set(states)) > 1)):
            wrong = f"{self.line}, signal {number}, code {code}: {states}, left {sorted(left)}"
        elif code == 0 and set(states) != {"new"}:
            wrong = f"{self.line}: exit code 0 and {states}"
        elif code not in (0, 130, 128 + number, -number):
            wrong = f"{self.line}: signal {number} gave exit code {code}: {Path('stderr.txt').read_text()[:200]}"
        self.restore()
        name = signal.Signals(number).name
        what = "between two renames" if len(set(states)) > 1 else f"{states[0]} outputs"
        return f"{name}: {what}{', litter' if left else ''}", wrong


def kills(count: int, seed: int, folder: Path) -> tuple[Counter[str], list[str]]:
    """Kill ``count`` runs; return what was counted and what failed."""
    pick = random.Random(seed)
    counts: Counter[str] = Counter()
    failures: list[str] = []
    loaded()
    with inside(folder):
        prepared(folder)
        Path("stderr.txt").touch()
        targets = [Target(line, outputs) for line, outputs in COMMANDS]
        for number in range(count):
            target = targets[number % len(targets)]
            told, wrong = target.killed(
                pick.choice(SIGNALS), pick.uniform(0.0, 1.2 * target.seconds)
            )
            counts[told] += 1
            failures += [wrong] if wrong else []
        for target in targets:
            assert ended(forked(target.words)) == 0
        litter = [name for name in os.listdir(".") if name.endswith(".partial")]
        failures += [f"{name} stays for ever" for name in litter]
        import h5py

        with h5py.File("store.h5") as file:
            if file["theirs/record"][-1] != 999.0 or "new" not in file:
                failures.append("the store lost a group")
    return counts, failures


def main() -> int:
    """Kill a thousand runs."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    with tempfile.TemporaryDirectory() as folder:
        return report("kills", *kills(count, seed, Path(folder)))


if __name__ == "__main__":
    sys.exit(main())
