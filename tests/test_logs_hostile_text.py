"""Text that would take hours where time grew faster than its size; here it is simply read, or refused.

Nothing is timed: a regression shows as a test that does not end (a million blanks once
took eight minutes).
"""

from __future__ import annotations

import gzip
from pathlib import Path

import pytest

from dbo_cli.errors import InputError
from dbo_cli.logs.columns import ColumnWish, split_header
from dbo_cli.logs.request import ReadingOptions
from dbo_cli.logs.signal_log import open_log

HEADER = b"time_s,voltage_V\n"
ROWS = b"".join(b"%d,2\n" % number for number in range(30))
LATER = b"".join(b"%d,2\n" % number for number in range(30, 60))
WANT = {"voltage": ColumnWish(None, ("voltage",), option="voltage")}


def rows_of(path: Path, content: bytes, **options: object) -> tuple[int, int]:
    path.write_bytes(content)
    with open_log(str(path), WANT, ReadingOptions(**options)) as log:  # type: ignore[arg-type]
        block = log.read()
        assert block.lines is not None
        return len(block), int(block.lines[-1])


@pytest.mark.parametrize(
    ("content", "rows", "last_line"),
    [
        pytest.param(
            HEADER + ROWS + b"30" + b" " * 1_000_000 + b",2\n",
            31,
            32,
            id="blanks before a comma",
        ),
        pytest.param(
            HEADER + ROWS + b"30," + b" " * 1_000_000 + b"2\n",
            31,
            32,
            id="blanks after a comma",
        ),
        pytest.param(
            HEADER + ROWS + b"30,2" + b" " * 1_000_000 + b"\n",
            31,
            32,
            id="blanks at the end",
        ),
        pytest.param(
            HEADER + ROWS + b"\n" * 1_000_000 + LATER,
            60,
            1_000_061,
            id="empty lines within",
        ),
        pytest.param(
            b"\n" * 1_000_000 + HEADER + ROWS, 30, 1_000_031, id="empty lines above"
        ),
        pytest.param(
            b" \r\n" * 300_000 + HEADER + ROWS, 30, 300_031, id="blank lines above"
        ),
        pytest.param(
            b"# remark\n" * 200_000 + HEADER + ROWS, 30, 200_031, id="remarks above"
        ),
        pytest.param(
            b"," * 400_000 + b"\n" + HEADER + ROWS, 30, 32, id="a line of commas above"
        ),
        pytest.param(
            b"time_s," + b"/a" * 50_000 + b" b,voltage_V\n1,2,3\n2,3,4\n",
            2,
            3,
            id="slashes",
        ),
        pytest.param(
            b"# x " + b"(a" * 50_000 + b" voltage_V\n1,2,3\n2,3,4\n",
            2,
            3,
            id="brackets",
        ),
        pytest.param(
            b",".join(b"c%06d" % number for number in range(49_999))
            + b",voltage_V\n"
            + 3 * (b"1," * 49_999 + b"5\n"),
            3,
            4,
            id="fifty thousand columns",
        ),
    ],
)
def test_it_is_read(content: bytes, rows: int, last_line: int, tmp_path: Path) -> None:
    assert rows_of(tmp_path / "run.csv", content) == (rows, last_line)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (
            b"1" * 200_000 + b"x,2\n",
            "run.csv:32: column 'time_s' is not a number: '11111",
        ),
        (
            b"," * 4_000_000 + b"\n",
            "run.csv:32: 4000001 cells where the other rows have 2",
        ),
        (b'"' * 200_000 + b"\n", "run.csv:32: 1 cell where the other rows have 2"),
        (
            b'"x,' * 100_000 + b"\n",
            "run.csv:32: 100001 cells where the other rows have 2",
        ),
    ],
)
def test_it_is_refused(line: bytes, said: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as raised:
        rows_of(tmp_path / "run.csv", HEADER + ROWS + line + LATER)
    assert said in str(raised.value)


@pytest.mark.parametrize("block_rows", [7, 1 << 16])
def test_fifty_million_line_ends_in_a_small_file(
    tmp_path: Path, block_rows: int
) -> None:
    content = HEADER + ROWS + b"\n" * 50_000_000 + LATER
    path = tmp_path / "run.csv.gz"
    if block_rows == 7:
        content = HEADER + ROWS + b"\n" * 5_000_000 + LATER
    assert rows_of(path, gzip.compress(content, 1), block_rows=block_rows) == (
        60,
        content.count(b"\n"),
    )


def test_empty_lines_count_wherever_the_block_ends(tmp_path: Path) -> None:
    content = HEADER + b"".join(
        b"%d,2\n%s" % (number, b"\n" * (number % 3)) for number in range(100)
    )
    for block_rows in (1, 2, 3, 1000):
        assert rows_of(tmp_path / "run.csv", content, block_rows=block_rows) == (
            100,
            200,
        )
    with pytest.raises(
        InputError, match=r"run\.csv:203: column 'time_s' is not a number: 'x'"
    ):
        rows_of(tmp_path / "run.csv", content + b"\n\nx,2\n")


def test_a_skipped_header_counts_empty_lines_too(tmp_path: Path) -> None:
    content = b"\n" * 300_000 + b"junk 1 2\n" + HEADER + ROWS
    assert rows_of(tmp_path / "run.csv", content, skip_lines=300_001) == (30, 300_032)


@pytest.mark.parametrize(
    "piece", ["/a", "(a", "[a", "in a ", ", ", "_a", " ", "{", ")", "a) ", "<>"]
)
def test_headers_are_taken_apart_in_linear_time(piece: str) -> None:
    for tail in ("", " b c", "(", ")", " /"):
        split_header("x" + piece * 100_000 + tail)


@pytest.mark.parametrize("text", [b"\0" * (1 << 24), (b"\0" * 99 + b"\n") * (1 << 14)])
def test_nothing_but_nul_bytes_is_no_text_of_any_encoding(
    text: bytes, tmp_path: Path
) -> None:
    path = tmp_path / "log.csv.gz"
    path.write_bytes(gzip.compress(text, 1))
    with pytest.raises(
        InputError,
        match="this is a binary file, not a text log: export it as CSV or HDF5",
    ):
        open_log(str(path), {})


def test_a_line_of_millions_of_delimiters_is_none_of_a_log(tmp_path: Path) -> None:
    path = tmp_path / "log.csv.gz"
    path.write_bytes(gzip.compress(b"," * (1 << 24), 1))
    with pytest.raises(InputError, match="no data rows: no line holds numbers"):
        open_log(str(path), {})
