"""Damaged files: only a refusal of one line may come out, and no number that is wrong in silence.

    python benchmarks/attack_files.py [COUNT] [SEED]         20,000 of each kind from seed 1

``tables``: random tables under random headers, most of them damaged in one place
(``random_tables.py``): every row that was not damaged must come out as it
was written. ``texts``: the files of ``tests/shapes/text.json``, mutated; ``models``:
stored models, mutated as JSON and as text; one that is read must survive being written.
Exit 1 where something else than a ``DboError`` came out, where one took longer than ten
seconds, or where a table was misread.
"""

from __future__ import annotations

import base64
import copy
import json
import random
import signal
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from random_tables import once

from dbo_cli.errors import DboError
from dbo_cli.logs import Reading, open_log
from dbo_cli.model import dumps_model, read_cascade

ROOT = Path(__file__).resolve().parent.parent
MOST_SECONDS = 10
TOKENS = (
    b",", b";", b"\t", b" ", b"|", b"\n", b"\r\n", b"\r", b"\n\n", b'"', b'""', b"#", b"%",
    b"\xef\xbb\xbf", b"\xff\xfe", b"\0", b"nan", b"inf", b"-", b"+", b".", b"e", b"1e400",
    b"1_0", b"0x1", b"OVLD", b"\xb5", b"\xce\xbc", b"(V)", b"[um]", b"_s", b"time",
    b"voltage", b"0", b"1,5", b"1.5", b"12:00:00", b"s,V,um", b"\x1f\x8b", b"\xc3(",
)  # fmt: skip
ODD: tuple[Any, ...] = (
    None, True, 0, -1, 1, 1e308, -1e308, 1e-320, float("nan"), float("inf"), "", "x", [], [0.0],
    [1.0, -1.0], {}, {"type": "backlash"}, {"repeat": 10**9, "value": 1.0}, [[1.0]], "1.0", 10**400,
)  # fmt: skip


class Hang(BaseException):
    """A file took too long."""


def too_long(*_: object) -> None:
    """Answer the alarm."""
    raise Hang(f"more than {MOST_SECONDS} s")


def mutated(rng: random.Random, content: bytes, corpus: list[bytes]) -> bytes:
    """Change a few places of a text."""
    for _ in range(rng.randrange(1, 5)):
        begin = rng.randrange(len(content) + 1)
        end = min(len(content), begin + rng.randrange(40))
        way = rng.randrange(6)
        if way == 0:
            content = content[:begin] + rng.choice(TOKENS) + content[begin:]
        elif way == 1:
            content = content[:begin] + content[end:]
        elif way == 2:
            content = content[:end] + content[begin:end] + content[end:]
        elif way == 3:
            content = content.replace(rng.choice(TOKENS), rng.choice(TOKENS), 20)
        elif way == 4:
            content = (
                content[:begin] + bytes([rng.randrange(256)]) + content[begin + 1 :]
            )
        else:
            other = rng.choice(corpus)
            content = content[:begin] + other[len(other) // 2 :]
    return content[:50_000]


def one_line(problem: DboError) -> str:
    """Return the kind of a refusal, whose message must be one line."""
    text = str(problem)
    if not text.strip() or "\n" in text or "Traceback" in text:
        raise AssertionError(f"not one line: {text!r}")
    return f"refused: {type(problem).__name__}"


class Files:
    """Makes damaged files of three kinds in a folder, and reads them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        shapes = json.loads((ROOT / "tests" / "shapes" / "text.json").read_text())
        self.texts = []
        for shape in shapes:
            if "text" in shape:
                self.texts.append(shape["text"].encode())
            else:
                self.texts.append(base64.b64decode(shape["base64"]))
        stored = sorted((ROOT / "tests" / "contract" / "models").glob("*.json"))
        self.models = [json.loads(path.read_text()) for path in stored]
        self.models = [tree for tree in self.models if "stages" in tree]
        self.model_texts = [json.dumps(tree).encode() for tree in self.models]

    def tables(self, seed: int) -> str:
        """Write, damage and read a table whose numbers are known."""
        return once(seed, self.folder / "table.csv")

    def texts_mutated(self, seed: int) -> str:
        """Mutate a text log and read it in some way."""
        rng = random.Random(f"texts {seed}")
        path = self.folder / "log.csv"
        path.write_bytes(mutated(rng, rng.choice(self.texts), self.texts))
        column = rng.choice([None, None, "1", "2", "time_s"])
        reading = Reading(
            skip_bad=rng.random() < 0.3,
            sample_rate=10.0 if rng.random() < 0.2 else None,
            resample=rng.choice([0.5, 10.0, 1000.0]) if rng.random() < 0.1 else None,
            rows=rng.choice(["2:", ":3", "2:2", "9:"]) if rng.random() < 0.2 else None,
            delimiter=rng.choice([None, None, None, "comma", ";"]),
            decimal=rng.choice([None, None, None, "comma"]),
            encoding=rng.choice([None, None, None, "latin-1", "utf-16"]),
        )
        try:
            with open_log(str(path), {"voltage": column}, reading) as log:
                table = log.read()
        except DboError as problem:
            return one_line(problem)
        values = table["voltage"]
        if values.size != len(table) or not np.isfinite(values).all():
            raise AssertionError("a table is not what it says")
        return "read"

    def models_mutated(self, seed: int) -> str:
        """Mutate a model as a tree or as a text, and read it."""
        rng = random.Random(f"models {seed}")
        path = self.folder / "model.json"
        tree = copy.deepcopy(rng.choice(self.models))
        for _ in range(rng.randrange(1, 4)):
            graft(rng, tree)
        text = json.dumps(tree).encode()
        if rng.random() < 0.2:
            text = mutated(rng, text, self.model_texts)
        path.write_bytes(text)
        try:
            model = read_cascade(str(path))
        except DboError as problem:
            return one_line(problem)
        written = dumps_model(model)
        path.write_text(written)
        if dumps_model(read_cascade(str(path))) != written:
            raise AssertionError("a model does not survive being written and read")
        return "read"


def graft(rng: random.Random, node: Any) -> None:
    """Change one place of a JSON tree."""
    while isinstance(node, dict | list) and node:
        keys = list(node) if isinstance(node, dict) else range(len(node))
        key: Any = rng.choice(keys)
        if isinstance(node[key], dict | list) and rng.random() < 0.7:
            node = node[key]
            continue
        way = rng.randrange(4)
        if way == 0:
            del node[key]
        elif way == 1 and isinstance(node, dict):
            node[rng.choice(["relaxation", "type", "seconds", "unknown", "dx"])] = odd(
                rng
            )
        elif way == 2 and isinstance(node, list):
            node.append(odd(rng))
        else:
            node[key] = odd(rng)
        return


def odd(rng: random.Random) -> Any:
    """Return a value that hardly anything expects."""
    return copy.deepcopy(rng.choice(ODD))


def attack(name: str, attempt: Callable[[int], str], seeds: range) -> int:
    """Try one kind of file so many times; return how many broke something."""
    begun = time.perf_counter()
    outcomes: Counter[str] = Counter()
    faults = 0
    for seed in seeds:
        signal.alarm(MOST_SECONDS)
        try:
            outcome = attempt(seed)
        except KeyboardInterrupt:
            raise
        except BaseException as problem:  # a panic of polars is no Exception
            outcome = f"FAULT: {type(problem).__name__}"
            print(
                f"{name} {seed}: {type(problem).__name__}: {str(problem)[:300]}",
                flush=True,
            )
        if outcome == "wrong":
            print(f"{name} {seed}: misread", flush=True)
        faults += outcome == "wrong" or outcome.startswith("FAULT")
        outcomes[outcome] += 1
    signal.alarm(0)
    told = ", ".join(
        f"{times:,} {outcome}" for outcome, times in outcomes.most_common()
    )
    print(f"{name}: {len(seeds):,} files, {faults} faults; {told}; "
          f"{time.perf_counter() - begun:.0f} s", flush=True)  # fmt: skip
    return faults


def main() -> int:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 20_000
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    warnings.simplefilter("ignore")
    signal.signal(signal.SIGALRM, too_long)
    seeds = range(seed * 1_000_000, seed * 1_000_000 + count)
    with tempfile.TemporaryDirectory() as folder:
        files = Files(Path(folder))
        faults = attack("tables", files.tables, seeds)
        faults += attack("texts", files.texts_mutated, seeds)
        faults += attack("models", files.models_mutated, seeds)
    return int(faults > 0)


if __name__ == "__main__":
    sys.exit(main())
