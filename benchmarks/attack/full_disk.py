"""A disk that is full at any byte: exit code 1, one line, the old outputs as they were and nothing else.

    python benchmarks/attack/full_disk.py [COUNT] [SEED]

A limit on the size of files stands for the disk (the write fails at that very byte);
where standard output is the disk, ``/dev/full`` does.
"""

from __future__ import annotations

import os
import random
import sys
import tempfile
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from arena import forked, inside, loaded, report
from kills import COMMANDS, Target, ended, prepared

_ROOM_FOR_MESSAGE = 500  # bytes


def full_disks(count: int, seed: int, folder: Path) -> tuple[Counter[str], list[str]]:
    """Run ``count`` commands with a limit somewhere in their outputs; return counts and failures."""
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
            sizes = [len(target.new[name] or b"") for name in target.outputs]
            limit = pick.randrange(max(sizes))
            before = set(os.listdir("."))
            code = ended(forked(target.words, limit))
            said = Path("stderr.txt").read_text()
            if limit < _ROOM_FOR_MESSAGE:  # the message is a file, too
                said = "cannot be written"
            changed = [
                name
                for name in target.outputs
                if target.content(name) != target.old[name]
            ]
            left = set(os.listdir(".")) - before
            counts[f"{target.line.split()[0]}: exit code {code}"] += 1
            if (
                code != 1
                or changed
                or left
                or len(said.splitlines()) != 1
                or "cannot be written" not in said
            ):
                failures.append(
                    f"{target.line} at {limit} of {sizes}: {code}, {changed}, {left}, {said[:200]!r}"
                )
            target.restore()
    return counts, failures


def main() -> int:
    """Fill the disk five hundred times."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 500
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    with tempfile.TemporaryDirectory() as folder:
        return report("full disks", *full_disks(count, seed, Path(folder)))


if __name__ == "__main__":
    sys.exit(main())
