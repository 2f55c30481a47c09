"""Command lines put together at random: the documented exit codes, one line each, and no litter.

    python benchmarks/attack/command_lines.py [COUNT] [SEED]

Every run happens in this process. Words come from what the commands take, from numbers
and names that are odd, and from noise; half of the lines begin as good ones. The same
seed gives the same lines.
"""

from __future__ import annotations

import os
import random
import re
import sys
import tempfile
import time
import warnings
from collections import Counter
from itertools import pairwise
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from arena import complaint, fill, inside, run, time_limit

GOOD = [
    "simulate model.json run.csv", "simulate late.json run.csv -o out.csv --save-state s.json",
    "simulate model.json bare.txt --sample-rate 100 -o out.h5", "simulate model.json run.csv -o out.h5::/g",
    "compensate model.json wish.csv", "compensate late.json wish.csv -o out.tsv --v-min 0 --v-max 8",
    "compensate model.json wish.csv --condition", "invert model.json", "invert late.json -o inv.json",
    "report pair.csv", "report pair.csv -o r.json", "report run.csv --model model.json --format csv",
    "excite --v-min 0 --v-max 10 --sample-rate 50 --duration 20", "simulate model.json -", "--help", "--version",
]  # fmt: skip
OPTIONS = [
    "-o", "--output", "--save-state", "--state", "--outside", "--v-min", "--v-max", "--max-slew", "--on-limit",
    "--condition", "--rows", "--skip-bad", "--sample-rate", "--resample", "--time", "--voltage", "--displacement",
    "--input", "--desired", "--measured", "--lag", "--remove-offset", "--segment", "--max-rmse", "--max-abs",
    "--format", "--delimiter", "--decimal", "--comment", "--header-lines", "--skip-lines", "--encoding",
    "--block-rows", "--quiet", "--verbose", "--flush", "--model", "--gears", "--points", "--delay", "--zero",
    "--duration", "--frequency", "--time-unit", "--scale", "--trajectory", "--help", "-h", "--", "-", "--x", "-z",
]  # fmt: skip
VALUES = [
    "0", "1", "-1", "2", "0.5", "1e-300", "1e308", "-1e308", "1e400", "nan", "inf", "-inf", "1:10", "5:", ":5",
    "10:1", "0:0", ":", "a:b", "", " ", "auto", "empty", "full", "settled", "none", "mean", "first", "clip",
    "error", "hold", "extend", "csv", "tsv", "h5", "json", "html", "text", "comma", "point", "tab", "|", "§",
    "utf-8", "utf-16", "latin-1", "rot13", "idna", "run.csv", "model.json", "late.json", "wish.csv", "pair.csv",
    "bare.txt", "nowhere.csv", "no/where.csv", ".", "/", "/dev/null", "out.csv", "out.h5", "out.h5::/g",
    "out.h5::/.", "out.h5::/..", "out.mat", "x.json", "voltage_V", "displacement_um", "time_s", "3", "99", "1,2",
    "-o", "--", "1" * 5000, "9" * 400, "x" * 300, "\udcff", "µ", "\x1b[31m", "\n", "\x00", "💥", "s", "ms", "um/V",
    "voltage=20", "displacement=10um/V", "=", "voltage=", "1e6", "123456789", "0x10", "1_000", "１", "٣",
]  # fmt: skip
COMMANDS = [
    "simulate",
    "compensate",
    "invert",
    "report",
    "excite",
    "identify",
    "show",
    "x",
]


class Lines:
    """Makes command lines, runs them, and remembers what came of them."""

    def __init__(self, seed: int, folder: Path) -> None:
        self.pick = random.Random(seed)
        self.folder = folder
        self.counts: Counter[str] = Counter()
        self.failures: list[str] = []
        with inside(folder):
            fill(folder)
            self.inputs = {name: Path(name).read_bytes() for name in os.listdir(".")}

    def words(self) -> list[str]:
        """Return the words of one command line."""
        pick = self.pick
        words = (
            pick.choice(GOOD).split()
            if pick.random() < 0.9
            else [pick.choice(COMMANDS)]
        )
        for _ in range(pick.randrange(5)):
            way = pick.random()
            place = pick.randrange(min(len(words), pick.random() < 0.9), len(words) + 1)
            if way < 0.55:
                words[place:place] = [pick.choice(OPTIONS), pick.choice(VALUES)]
            elif way < 0.7:
                words.insert(place, pick.choice(OPTIONS) + "=" + pick.choice(VALUES))
            elif way < 0.85:
                words.insert(place, pick.choice(VALUES))
            elif words:
                words[min(place, len(words) - 1)] = pick.choice(VALUES)
        return words

    def run(self, count: int, seconds: float = float("inf")) -> None:
        """Run up to ``count`` command lines, no longer than ``seconds``."""
        end = time.monotonic() + seconds
        with inside(self.folder), warnings.catch_warnings():
            warnings.simplefilter("error")
            for number in range(count):
                words = self.words()
                if words[:1] == ["identify"] and self.pick.random() < 0.98:
                    words[:1] = ["invert"]  # a fit takes a second
                self._tried(number, words)
                if time.monotonic() > end:
                    break

    def _tried(self, number: int, words: list[str]) -> None:
        try:
            with time_limit(20.0):
                outcome = run(words)
            wrong = complaint(outcome)
            told = f"exit code {outcome.code}"
            line = next(
                (one for one in outcome.err.splitlines() if "error: " in one), ""
            )
            told += (
                ": " + re.sub(r"'[^']*'|[^ ]*[/\d][^ ]*", "*", line)[11:80]
                if line
                else ""
            )
        except BaseException as problem:
            if isinstance(problem, KeyboardInterrupt):
                raise
            wrong, told = f"{type(problem).__name__}: {problem}", "FAILED"
        shown = " ".join(
            repr(word) if len(word) < 60 else repr(word[:20] + "...") for word in words
        )
        litter = self._litter(outcome.code if told != "FAILED" else 1, words)
        wrong = wrong or litter
        if wrong:
            self.failures.append(f"{number}: dbo {shown}: {wrong}")
        self.counts[told] += 1

    def _litter(self, code: int, words: list[str]) -> str | None:
        """Look what is in the folder; take away what is new."""
        wrong = None
        found = set(os.listdir("."))
        for name in found - set(self.inputs):
            if code in (1, 2) or name.endswith(".partial"):
                wrong = f"exit code {code}, and '{name}' is left"
            path = Path(name)
            if path.is_dir():
                for inner in path.rglob("*"):
                    inner.unlink()
                path.rmdir()
            else:
                path.unlink()
        for name, content in self.inputs.items():
            if name not in found or Path(name).stat().st_size != len(content):
                if code not in (0, 3) or not _is_asked_for(name, words):
                    wrong = f"the input {name} was changed"
                Path(name).write_bytes(content)
        return wrong


def _is_asked_for(name: str, words: list[str]) -> bool:
    """Tell whether a line names a file as its output: other lines read it, this one may replace it."""
    options = ("-o", "--output", "--save-state")
    after = [word for option, word in pairwise(words) if option in options]
    joined = [word.removeprefix(f"{option}=") for word in words for option in options]
    return name in [
        *after,
        *joined,
        *(word.removeprefix("-o") for word in words if word[:2] == "-o"),
    ]


def main() -> int:
    """Try many command lines."""
    from arena import report

    count = int(sys.argv[1]) if len(sys.argv) > 1 else 20_000
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    with tempfile.TemporaryDirectory() as folder:
        lines = Lines(seed, Path(folder))
        lines.run(count)
    return report("command lines", lines.counts, lines.failures)


if __name__ == "__main__":
    sys.exit(main())
