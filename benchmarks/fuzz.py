"""Malformed inputs by the hundred thousand: no traceback, no hang, no half-written file.

    python benchmarks/fuzz.py [COUNT] [SEED]

Text logs (the shapes of the tests, mutated), HDF5 files of random structure (or cut
off), and model files (mutated trees and texts). An input is read as the commands read
it and written back; only the program's own errors may come of it, and a one-line
message. Inputs with an outcome not seen before are kept and mutated further, so that
the search goes where the code has not been. The same seed gives the same inputs.
"""

from __future__ import annotations

import contextlib
import copy
import json
import os
import random
import re
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from dbo_cli.errors import DboError  # noqa: E402
from dbo_cli.logs.columns import ColumnWish  # noqa: E402
from dbo_cli.logs.request import ReadingOptions, parse_rows  # noqa: E402
from dbo_cli.logs.sample_block import Column  # noqa: E402
from dbo_cli.logs.signal_log import open_log  # noqa: E402
from dbo_cli.logs.signal_writer import signal_writer  # noqa: E402
from tests.shapes.readable import READABLE  # noqa: E402
from tests.shapes.refusable import REFUSABLE  # noqa: E402

MOST_SECONDS = 10
TOKENS = (
    b",", b";", b"\t", b" ", b"|", b"\n", b"\r\n", b"\r", b"\n\n", b'"', b'""', b"#", b"%",
    b"\xef\xbb\xbf", b"\xff\xfe", b"\0", b"nan", b"inf", b"-", b"+", b".", b"e", b"1e400", b"1e-400",
    b"1_0", b"0x1", b"OVLD", b"\xb5",
    b"\xce\xbc", b"(V)", b"[um]", b"_s", b"time", b"voltage", b"0", b"1,5", b"1.5", b"12:00:00", b"s,V,um",
    b"\x1f\x8b", b"\xc3(",
)  # fmt: skip
MODEL: dict[str, Any] = {
    "format": "dbo-model",
    "version": 1,
    "direction": "forward",
    "input": {"quantity": "voltage", "unit": "V", "min": 0.0, "max": 10.0},
    "output": {"quantity": "displacement", "unit": "um", "min": 1.0, "max": 9.0},
    "stages": [
        {
            "type": "backlash",
            "x0": 0.0,
            "y0": 0.0,
            "dx": [1.0, 2.0, 3.0, 4.0],
            "dy": [0.25, 0.75, 1.5, 2.5],
        },
        {"type": "scale", "gain": 1.6, "offset": 1.0},
    ],
    "fit": {"rmse": 0.1, "samples": 10},
    "provenance": {"program": "dbo 0.1.0", "arguments": [], "inputs": []},
}
SHAPES = [
    (),
    (0,),
    (1,),
    (5,),
    (5, 1),
    (1, 5),
    (3, 5),
    (5, 3),
    (4, 4),
    (0, 3),
    (2, 3, 4),
]
ODD_VALUES: tuple[Any, ...] = (
    None, True, 0, -1, 1, 2, 1e308, -1e308, 1e-320, float("nan"), float("inf"), "", "x", "voltage", [], [0.0],
    [1.0, -1.0], {}, {"type": "backlash"}, [[1.0]], "1.0", 10**400,
)  # fmt: skip


class Hang(BaseException):
    """An input took too long."""


class Fuzzer:
    """Makes inputs, reads them, and remembers what came of them."""

    def __init__(self, seed: int, folder: Path) -> None:
        self.random = random.Random(seed)
        self.folder = folder
        self.corpus = [shape.content for shape in READABLE]
        self.corpus += [one.content for one in REFUSABLE if one.content is not None]
        self.models: list[Any] = [MODEL]
        self.seen: set[tuple[str, str]] = set()
        self.outcomes: Counter[str] = Counter()
        self.failures: list[str] = []

    def run(self, count: int) -> None:
        """Try ``count`` inputs."""
        choices: list[Callable[[], None]] = (
            [self.text] * 14 + [self.model] * 5 + [self.hdf5]
        )
        for number in range(count):
            maker = choices[number % len(choices)]
            state = self.random.getstate()
            try:
                with time_limit(MOST_SECONDS):
                    maker()
            except (Exception, Hang) as problem:
                self.outcomes["FAILED"] += 1
                self.failures.append(
                    f"{maker.__name__} {number}: {type(problem).__name__}: {problem}"
                )
                (self.folder / "state").write_text(repr(state))
            left = {path.name for path in self.folder.iterdir()} - {
                "log.csv",
                "log.h5",
                "model.json",
                "state",
            }
            if left:
                self.failures.append(f"{maker.__name__} {number} left {sorted(left)}")
                for name in left:
                    (self.folder / name).unlink()

    def text(self) -> None:
        """Mutate a text log, read it in some way, and write it back."""
        content = self._mutated(self.random.choice(self.corpus))
        (self.folder / "log.csv").write_bytes(content)
        if (
            self._new("text", self._copied("log.csv", self._text_call()))
            and len(content) < 20_000
        ):
            self.corpus.append(content)

    def hdf5(self) -> None:
        """Build an HDF5 file of random structure, sometimes cut off, and copy its columns."""
        import h5py

        path = self.folder / "log.h5"
        path.unlink(missing_ok=True)
        with h5py.File(path, "w") as file:
            for _ in range(self.random.randrange(4)):
                self._plant(file, 0)
        if self.random.random() < 0.2:
            with open(path, "r+b") as raw:
                raw.truncate(self.random.randrange(path.stat().st_size))
        group = self.random.choice(["", "", "::/", "::/a", "::/a/time_s", "::nothing"])
        self._new("hdf5", self._copied("log.h5" + group, {}))

    def model(self) -> None:
        """Mutate a model as a tree or as a text, and read it."""
        from dbo_cli.hysteresis.model_file import model_to_bytes, read_model

        tree = json.loads(json.dumps(self.random.choice(self.models)))
        for _ in range(self.random.randrange(1, 4)):
            self._graft(tree)
        text = json.dumps(tree).encode()
        if self.random.random() < 0.2:
            text = self._mutated(text)
        path = self.folder / "model.json"
        path.write_bytes(text)
        try:
            again = model_to_bytes(read_model(str(path)))
            path.write_bytes(again)
            outcome = (
                "read"
                if model_to_bytes(read_model(str(path))) == again
                else "not stable"
            )
            if outcome != "read":
                raise AssertionError("a model does not survive being written and read")
        except DboError as problem:
            outcome = one_line(problem)
        if self._new("model", outcome) and isinstance(tree, dict):
            self.models.append(tree)

    def _copied(self, name: str, call: dict[str, Any]) -> str:
        """Copy a log's guessed or numbered columns; give what came of it."""
        number = self.random.choice([None, None, "1", "2", "3", "time_s"])
        want = {
            "voltage": ColumnWish(
                number, ("voltage", "drive", "u", "v"), option="voltage"
            )
        }
        out = self.folder / ("out" + self.random.choice([".csv", ".tsv.gz", ".h5"]))
        out.write_bytes(b"as it was")
        try:
            with (
                open_log(str(self.folder / name), want, ReadingOptions(**call)) as log,
                signal_writer(
                    str(out),
                    [Column("voltage", "V")],
                    protect=[str(self.folder / name)],
                ) as writer,
            ):
                for block in log.blocks():
                    values = block.values["voltage"]
                    if not np.isfinite(values).all() or len(values) != len(block.rows):
                        raise AssertionError("a block is not what it says")
                    writer.write(values)
        except DboError as problem:
            if out.read_bytes() != b"as it was":
                raise AssertionError("a failed run touched the old output") from problem
            out.unlink()
            return one_line(problem)
        out.unlink()
        return re.sub(r"^.*?: ", "", log.describe())

    def _text_call(self) -> dict[str, Any]:
        """Choose how a text log is opened."""
        pick = self.random.choice
        call: dict[str, Any] = {
            "block_rows": pick([1, 3, 1000]),
            "skip_bad": pick([False, False, True]),
        }
        if self.random.random() < 0.2:
            call["rows"] = parse_rows(pick(["2:", ":3", "2:2", "9:"]))
        if self.random.random() < 0.2:
            call["sample_rate"] = 10.0
        if self.random.random() < 0.1:
            call["resample"] = pick([0.5, 10.0, 1000.0])
        if self.random.random() < 0.2:
            call |= dict(
                delimiter=pick([None, "comma", "blanks", ":"]),
                decimal=pick([None, "point", "comma"]),
                header_lines=pick([None, 0, 1, 2]),
                skip_lines=pick([None, 0, 1, 5]),
                encoding=pick([None, None, "utf-8", "latin-1", "utf-16"]),
            )
        return call

    def _mutated(self, content: bytes) -> bytes:
        """Change a few places of a text."""
        pick = self.random
        for _ in range(pick.randrange(1, 5)):
            here, there = sorted(
                (pick.randrange(len(content) + 1), pick.randrange(len(content) + 1))
            )
            there = min(there, here + 40)
            way = pick.randrange(6)
            if way == 0:
                content = content[:here] + pick.choice(TOKENS) + content[here:]
            elif way == 1:
                content = content[:here] + content[there:]
            elif way == 2:
                content = (
                    content[:here]
                    + content[here:there] * pick.randrange(2, 4)
                    + content[there:]
                )
            elif way == 3:
                content = content.replace(
                    pick.choice(TOKENS), pick.choice(TOKENS), pick.randrange(1, 50)
                )
            elif way == 4:
                content = (
                    content[:here] + bytes([pick.randrange(256)]) + content[here + 1 :]
                )
            else:
                other = pick.choice(self.corpus)
                content = content[:here] + other[len(other) // 2 :]
        return content[:50_000]

    def _plant(self, group: Any, depth: int) -> None:
        """Put something random into an HDF5 group."""
        import h5py

        pick = self.random
        name = pick.choice(
            ["voltage", "time_s", "u", "a", "b", "fs", "x/y", "µ", "data"]
        )
        if name in group:
            return
        way = pick.randrange(9)
        if way == 0 and depth < 3:
            inner = group.create_group(name)
            for _ in range(pick.randrange(3)):
                self._plant(inner, depth + 1)
            return
        shape: Any = pick.choice([*SHAPES, None])
        kind: Any = pick.choice(
            ["f8", "f4", "i2", "u8", "?", "S3", "c16", ">f8", h5py.string_dtype()]
        )
        if way == 1:
            kind = np.dtype(
                [("voltage", "f8"), ("time_s", "f4"), ("w", "S2"), ("k", "f8", (2,))]
            )
        if way == 2:
            soft = h5py.SoftLink(pick.choice(["/nowhere", "/"]))
            group[name] = pick.choice([soft, h5py.ExternalLink("no.h5", "/")])
            return
        if shape is None:
            made = group.create_dataset(name, dtype="f8", data=h5py.Empty("f8"))
        else:
            made = group.create_dataset(name, shape=shape, dtype=kind)
            if kind == "f8" and made.size:
                made[...] = pick.choice([0.0, 1.5, float("nan"), float("inf")])
        for _ in range(pick.randrange(3)):
            key = pick.choice(
                ["units", "unit", "sample_rate", "dt", "columns", "MATLAB_class", "fs"]
            )
            odd: list[Any] = [
                "V",
                b"\xb5m",
                0,
                -1.0,
                float("nan"),
                ["s", "V", "um"],
                "a,b,c",
                [],
                1e3,
            ]
            made.attrs[key] = pick.choice(odd)

    def _graft(self, node: Any) -> None:
        """Change one place of a JSON tree."""
        pick = self.random
        while isinstance(node, dict | list) and node:
            key: Any = (
                pick.choice(list(node))
                if isinstance(node, dict)
                else pick.randrange(len(node))
            )
            if not isinstance(node[key], dict | list) or pick.random() < 0.3:
                way = pick.randrange(4)
                if way == 0:
                    del node[key]
                elif way == 1 and isinstance(node, dict):
                    added = pick.choice(
                        ["relaxation", "type", "seconds", "unknown", "dx"]
                    )
                    node[added] = copy.deepcopy(pick.choice(ODD_VALUES))
                elif way == 2 and isinstance(node, list):
                    node.append(
                        copy.deepcopy(
                            pick.choice(
                                [*ODD_VALUES, {"type": "delay", "seconds": 0.1}]
                            )
                        )
                    )
                else:
                    node[key] = copy.deepcopy(pick.choice(ODD_VALUES))
                return
            node = node[key]

    def _new(self, kind: str, outcome: str) -> bool:
        """Count an outcome; tell whether its like (numbers and quoted words aside) was not there before."""
        like = re.sub(r"'[^']*'|\d+(\.\d+)?|/\S*", "*", outcome)[:150]
        self.outcomes[f"{kind}: {like}"] += 1
        fresh = (kind, like) not in self.seen
        self.seen.add((kind, like))
        return fresh


def one_line(problem: DboError) -> str:
    """Give an error's message, which must be one line that says something."""
    text = str(problem)
    if not text.strip() or "\n" in text or "Traceback" in text:
        raise AssertionError(f"not one line: {text!r}")
    return text


@contextlib.contextmanager
def time_limit(seconds: int) -> Iterator[None]:
    """Raise Hang where the work takes too long."""

    def end(*_: object) -> None:
        raise Hang(f"more than {seconds} s")

    if not hasattr(signal, "SIGALRM"):
        yield
        return
    before = signal.signal(signal.SIGALRM, end)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def main() -> None:
    """Try many inputs, and exit with 1 where one of them broke something."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 100_000
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    begin = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        fuzzer = Fuzzer(seed, Path(folder))
        fuzzer.run(count)
    for outcome, times in fuzzer.outcomes.most_common(25):
        print(f"{times:7}  {outcome}")
    print(
        f"{count} inputs, {len(fuzzer.seen)} kinds of outcome, {time.perf_counter() - begin:.0f} s"
    )
    for failure in fuzzer.failures[:20]:
        print(f"FAILED: {failure}")
    failed = len(fuzzer.failures)
    print(
        f"{failed} failures"
        if failed
        else "no traceback, no hang, no half-written file"
    )
    os._exit(1 if fuzzer.failures else 0)


if __name__ == "__main__":
    main()
