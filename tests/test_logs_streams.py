"""Logs through pipes, row by row as they come, and the same numbers whatever the block size or the parser."""

from __future__ import annotations

import gzip
import hashlib
import io
import os
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from dbo_cli.errors import InputError
from dbo_cli.logs.columns import ColumnWish
from dbo_cli.logs.request import ReadingOptions
from dbo_cli.logs.sample_block import Column
from dbo_cli.logs.signal_log import open_log
from dbo_cli.logs.signal_writer import shortest, signal_writer, write_rows
from dbo_cli.logs.text import text_table as parsing
from dbo_cli.logs.text.dialect import Dialect

WANT = {"voltage": ColumnWish(None, ("voltage",))}
ECHO = """
import sys
from dbo_cli.logs.columns import ColumnWish
from dbo_cli.logs.signal_log import open_log
from dbo_cli.logs.sample_block import Column
from dbo_cli.logs.signal_writer import signal_writer
live = sys.argv[1] == "live"
with open_log("-", {"voltage": ColumnWish(None, ("voltage",))}, live=live, digest=True) as log:
    with signal_writer("-", [Column("voltage", "V")], flush=live) as writer:
        for block in log.blocks():
            writer.write(block.values["voltage"])
print(log.record(), *log.notes, sep="|", file=sys.stderr)
"""


def echo(data: bytes) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(
        [sys.executable, "-c", ECHO, "whole"],
        input=data,
        capture_output=True,
        timeout=60,
    )


def test_a_live_pipe_gives_each_row_as_it_comes() -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", ECHO, "live"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    assert (
        process.stdin is not None
        and process.stdout is not None
        and process.stderr is not None
    )
    process.stdin.write(b"time_s,voltage_V\n")
    process.stdin.flush()
    for number in range(5):
        row = f"{number},{number / 2}\n".encode()
        for piece in (row[:3], row[3:]):  # half a row is no row yet
            process.stdin.write(piece)
            process.stdin.flush()
        if number == 0:
            assert process.stdout.readline() == b"voltage_V\n"
        assert process.stdout.readline() == f"{number / 2}\n".encode()
    process.stdin.close()
    assert process.wait(timeout=60) == 0
    assert b"'rows': 5" in process.stderr.read()
    process.stdout.close()
    process.stderr.close()


@pytest.mark.parametrize("packed", [False, True])
def test_a_pipe_reads_like_a_file(packed: bool) -> None:
    data = b"time_s,voltage_V\n" + b"".join(
        f"{k / 8},{k}\n".encode() for k in range(100_000)
    )
    data = gzip.compress(data, 1) if packed else data
    done = echo(data)
    assert done.stdout == b"voltage_V\n" + b"".join(
        f"{k}.0\n".encode() for k in range(100_000)
    )
    digest = hashlib.sha256(data).hexdigest()
    assert done.stderr.decode().strip() == str(
        {"name": "-", "sha256": digest, "rows": 100_000}
    )


@pytest.mark.skipif(not os.path.exists("/dev/fd"), reason="there is no /dev/fd here")
def test_of_a_pipe_at_most_so_many_rows_are_waited_for() -> None:
    rows = b"1.250000\n" * 200_000
    read, write = os.pipe()

    def pour() -> None:
        with os.fdopen(write, "wb") as pipe:
            pipe.write(b"voltage_V\n" + rows)

    pouring = threading.Thread(target=pour)
    pouring.start()
    with os.fdopen(read, "rb"), open_log(f"/dev/fd/{read}", WANT) as log:
        counts = [len(block) for block in log.blocks()]
    pouring.join()
    assert sum(counts) == 200_000
    assert max(counts) < 66_000


def test_an_empty_pipe_is_refused() -> None:
    assert b"InputError: standard input: the file is empty" in echo(b"").stderr


def test_the_place_of_a_bad_cell_deep_in_a_large_log(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    rows = [f"{k},{k / 2}" for k in range(300_000)]
    rows[250_000] = "250000,OVLD"
    path.write_text("# bench\ntime_s,voltage_V\n" + "\n".join(rows) + "\n")
    for block_rows in (1000, 1 << 18):
        options = ReadingOptions(block_rows=block_rows)
        with (
            pytest.raises(InputError) as raised,
            open_log(str(path), WANT, options) as log,
        ):
            for _ in log.blocks():
                pass
        assert str(raised.value) == (
            f"{path}:250003: column 'voltage_V' is not a number: 'OVLD' (`skip_bad` drops such rows)"
        )


def calls_for_a_table_with_words(columns: int) -> int:
    """How many functions are called to read one of many columns, of which the last holds words."""
    text = (",".join(["1.5"] * (columns - 1) + ["ok"]) + "\n").encode() * 50
    dialect = Dialect(",", ".", "#%", columns, 1, (), (), frozenset(range(columns - 1)))
    parser = parsing.BlockParser("log", dialect, {"one": Column("1", None, "", 1)})
    calls = 0

    def count(frame: object, event: str, argument: object) -> None:
        nonlocal calls
        calls += event in ("call", "c_call")

    sys.setprofile(count)
    try:
        blocks = list(parser.parse(iter([text]), small=False))
    finally:
        sys.setprofile(None)
    assert [block.values["one"].tolist() for block in blocks] == [[1.5] * 50]
    return calls


def test_columns_that_nobody_asked_for_cost_next_to_nothing() -> None:
    calls_for_a_table_with_words(1000)  # the first one imports
    more = calls_for_a_table_with_words(2000) - calls_for_a_table_with_words(1000)
    assert more < 100


CELLS = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False).map(repr),
    st.integers(-10**20, 10**20).map(str),
    st.sampled_from(
        ["1.", ".5", "+1.5", " 2.5", "2.5 ", "1e5", "1E-5", "1d3", "1e400", "nan", "inf", "-inf", "NaN", "",
         " ", "OVLD", "1_0", "0x10", "1,5", '"1.5"', '"1', "--1", "1 2", "#", "# x", "1#", "%", ";", "µ",
         "١", "\t3", "3\r", "1e", "."]
    ),
)  # fmt: skip


def outcome(text: bytes, dialect: Dialect, skip: bool) -> object:
    """What one block gives: numbers with their places, or the message of its refusal."""
    first = Column("one", None, "one", 1)
    picks = {"one": first, "three": Column("three", None, "three", dialect.width)}
    parser = parsing.BlockParser("log", dialect, picks, skip_bad=skip)
    try:
        blocks = list(parser.parse(iter([text]), small=True))
    except InputError as problem:
        return str(problem)
    return [
        (list(b.rows), list(b.lines or []) if isinstance(b.lines, range) else np.asarray(b.lines).tolist(),
         [a.view(np.uint64).tolist() for a in b.values.values()])
        for b in blocks
    ], parser.dropped  # fmt: skip


@settings(derandomize=True, deadline=None, max_examples=300)
@example([["1", "2", "3", "4"], ["5", "6"]], ",", ".", True, True)
@given(
    st.lists(st.lists(CELLS, min_size=3, max_size=3), min_size=1, max_size=6),
    st.sampled_from([",", ";", "\t", " "]),
    st.sampled_from([".", ","]),
    st.booleans(),
    st.booleans(),
)
def test_the_three_parsers_always_agree(
    rows: list[list[str]], delimiter: str, decimal: str, ended: bool, skip: bool
) -> None:
    if delimiter == decimal:
        decimal = "."
    text = (
        "\n".join(delimiter.join(row) for row in rows) + ("\n" if ended else "")
    ).encode()
    dialect = Dialect(delimiter, decimal, "#%", 3, 1, (), ())
    results = []
    patch = pytest.MonkeyPatch()
    for plain in (parsing._parse_plain, parsing._parse_fast, lambda *_: None):
        with patch.context() as patched:
            patched.setattr(parsing, "_parse_plain", plain)
            results.append(outcome(text, dialect, skip))
    assert results[0] == results[1] == results[2]


@settings(derandomize=True, deadline=None, max_examples=300)
@given(st.lists(st.floats(), min_size=1, max_size=20))
@example(
    [
        1e-5,
        1.5e-5,
        9.999999999999999e-6,
        -1e-5,
        1e16,
        1e22,
        5e-324,
        -0.0,
        123456789012345680.0,
    ]
)
def test_both_writers_give_the_same_bytes_and_they_read_back(
    values: list[float],
) -> None:
    import polars  # the fast writer's library

    array, fast = np.array(values), io.BytesIO()
    write_rows(fast, [array], ",")
    assert fast.getvalue().decode() == "".join(
        shortest(value) + "\n" for value in values
    )
    lines = fast.getvalue().decode().split("\n")[:-1]  # NaN is an empty cell
    assert [line == "" for line in lines] == np.isnan(array).tolist()
    back = np.array([float(line or "nan") for line in lines])
    assert np.array_equal(back, array, equal_nan=True)
    finite = array[np.isfinite(array)]
    if len(finite):
        fast = io.BytesIO()
        write_rows(fast, [finite], ",", blanks=False)
        table = polars.read_csv(
            fast.getvalue(), has_header=False, schema={"column_1": polars.Float64}
        )
        assert table["column_1"].to_numpy().tobytes() == finite.tobytes()


def test_the_written_bytes_do_not_depend_on_the_cut(tmp_path: Path) -> None:
    values = np.random.default_rng(4).normal(size=(2, 140_000))
    contents = set()
    for step in (140_000, 131_072, 1_000):
        path = tmp_path / "out.csv"
        with signal_writer(str(path), [Column("a"), Column("b")]) as writer:
            for start in range(0, 140_000, step):
                writer.write(*values[:, start : start + step])
        contents.add(path.read_bytes())
    assert len(contents) == 1


@settings(derandomize=True, deadline=None, max_examples=40)
@given(st.integers(1, 5000), st.integers(0, 2**32 - 1))
def test_the_samples_do_not_depend_on_the_block_size(
    block_rows: int, seed: int
) -> None:
    import tempfile

    random = np.random.default_rng(seed)
    values = random.normal(size=2000).tolist()
    lines = [f"{k / 100};{value!r};x" for k, value in enumerate(values)]
    for place in random.integers(0, 2000, 5):
        lines.insert(int(place), "# remark")
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "log.csv")
        with open(path, "w") as file:
            file.write("t;voltage;remark\n" + "\n".join(lines))
        with open_log(path, WANT, ReadingOptions(block_rows=block_rows)) as log:
            block = log.read()
        with open_log(path, WANT) as log:
            whole = log.read()
    assert (
        block.values["voltage"].tolist() == values == whole.values["voltage"].tolist()
    )
    assert block.lines is not None and whole.lines is not None
    assert list(block.lines) == list(whole.lines)


def test_standard_input_is_read_where_it_was_replaced(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The command-line tests hand in their input this way."""
    fake = io.TextIOWrapper(io.BufferedReader(io.BytesIO(b"voltage\n1\n2\n")))
    monkeypatch.setattr(sys, "stdin", fake)
    with open_log("-", WANT) as log:
        assert log.read().values["voltage"].tolist() == [1.0, 2.0]
