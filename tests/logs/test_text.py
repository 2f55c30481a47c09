"""Text logs: blocks and pipes, irregular rows, cut records, and the reading options."""

from __future__ import annotations

import gzip
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dbo_cli.errors import InputError, UsageError
from dbo_cli.logs import Block, Log, Reading, open_log, stream, text
from dbo_cli.logs.cells import split_cells, to_number

BOTH: dict[str, str | None] = {"voltage": None, "displacement": None}
HEAD = "time_s,voltage_V,displacement_um\n"


def read(path: Path | str, **reading: object) -> tuple[Block, Log]:
    with open_log(str(path), BOTH, Reading(**reading)) as log:  # type: ignore[arg-type]
        return log.read(), log


def large(
    rows: int = 30_000, delimiter: str = ",", decimal: str = ".", end: str = "\n"
) -> str:
    """Write a log that is read by polars; row n holds n and n + 0.25."""
    lines = [delimiter.join(["time_s", "voltage_V", "displacement_um"])]
    for n in range(rows):
        cells = f"{n / 1000:.3f} {n}.00 {n}.25".replace(".", decimal).split()
        lines.append(delimiter.join(cells))
    return end.join(lines) + end


# --- blocks ---


@pytest.mark.parametrize("block", [100, 4096, 1 << 22])
@pytest.mark.parametrize("small", [0, 1 << 30])
def test_blocks_and_ways_of_reading_give_the_same(
    block: int, small: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stream, "_BLOCK", block)
    monkeypatch.setattr(text, "_SMALL", small)
    monkeypatch.setattr(text, "_TINY", min(small, 1 << 12) if small == 0 else 1 << 30)
    path = tmp_path / "run.csv"
    path.write_text(large(4000))
    with open_log(str(path), BOTH) as log:
        blocks = list(log.blocks(rows=700))
    assert max(map(len, blocks)) <= 700
    assert [b.first_row for b in blocks] == np.cumsum(
        [1, *map(len, blocks[:-1])]
    ).tolist()
    assert all(b.dt == pytest.approx(0.001) for b in blocks)
    voltage = np.concatenate([b.values["voltage"] for b in blocks])
    np.testing.assert_array_equal(voltage, np.arange(4000.0))
    assert log.line().endswith("4,000 rows, 4 s at 1 kHz; voltage_V, displacement_um")


@pytest.mark.parametrize(
    "change",
    [
        lambda s: s,
        lambda s: s.replace("\n", "\r\n"),
        lambda s: s.replace(",", ";").replace(".", ","),
        lambda s: s.replace(",", "\t"),
        lambda s: s.replace(",", "   ").replace("\n", "  \n "),
        lambda s: s.replace(",", " , "),
        lambda s: s.replace(",", '","').replace("\n", '"\n"')[:-1],
        lambda s: s.replace("\n", ",\n"),
        lambda s: s.replace("\n20000", "\n\n# a remark\n\n20000").replace("\n1.000", "\n\n1.000"),
        lambda s: s.replace("\n", ",ok\n"),
        lambda s: "junk\nRate: 5 kHz\n\n" + s,
    ],
)  # fmt: skip
def test_large_files_of_many_ways(change: Callable[[str], str], tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text(change('"' + large() if '"' in change(",") else large()))
    table, _ = read(path)
    np.testing.assert_array_equal(table["voltage"], np.arange(30_000.0))
    np.testing.assert_array_equal(table["displacement"], np.arange(30_000) + 0.25)


@pytest.mark.filterwarnings("ignore::dbo_cli.errors.DboWarning")
@pytest.mark.parametrize(
    ("damage", "line", "what"),
    [
        ("20.000,20000.00", 20002, "2 cells where"),
        ("20.000,20000.00,20000.25,7", 20002, "4 cells where"),
        ("20.000,20000.00,", 20002, "'displacement_um' is empty"),
        ("20.000,x,20000.25", 20002, "'voltage_V'"),
        ("20.000,inf,20000.25", 20002, "'voltage_V'"),
        ("20.000,nan,20000.25", 20002, "'voltage_V'"),
        ("20.000,9.9E37,20000.25", 20002, "'voltage_V'"),
        ('20.000,",20000.25', 20002, "'voltage_V'"),
        ("20.000,1_000,20000.25", 20002, "'voltage_V'"),
        ("20.000,1,5,20000.25", 20002, "4 cells where"),
        (HEAD.strip(), 20002, "'voltage_V'"),
    ],
)
def test_an_irregular_row_of_a_large_file_is_named(
    damage: str, line: int, what: str, tmp_path: Path
) -> None:
    path = tmp_path / "run.csv"
    path.write_text(large().replace("20.000,20000.00,20000.25", damage))
    with pytest.raises(InputError) as raised:
        read(path)
    assert f"run.csv:{line}: " in str(raised.value)
    assert what in str(raised.value) and "`skip_bad`" in str(raised.value)
    table, log = read(path, skip_bad=True)
    np.testing.assert_array_equal(
        table["voltage"], np.delete(np.arange(30_000.0), 20_000)
    )
    assert len(log.doubtful) == 1 and "1 row left out" in log.doubtful[0]


def test_points_under_a_decimal_comma_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text(large(delimiter=";", decimal=",").replace("20000,25", "20000.25"))
    with pytest.raises(InputError, match=r"run.csv:20002: .*'20000.25'"):
        read(path)


def test_points_are_refused_beside_stamps_as_well(tmp_path: Path) -> None:
    lines = ["Zeitstempel;Spannung [V];Weg [nm]"]
    for k in range(9000):
        lines.append(
            f"02.01.2026 10:00:{k // 1000:02d},{k % 1000:03d};{k % 97},5;900,5"
        )
    lines[8000] = lines[8000].replace("900,5", "1.001")
    path = tmp_path / "run.csv"
    path.write_text("\n".join([*lines, ""]))
    with pytest.raises(InputError, match=r"run.csv:8001: .*'1.001'"):
        read(path)


@pytest.mark.parametrize("rows", [20, 30_000])
def test_rows_of_statistics_are_no_rows(rows: int, tmp_path: Path) -> None:
    table = "".join(f"{k};{k % 97}.5;{k % 89}.25\n" for k in range(rows))
    path = tmp_path / "run.csv"
    path.write_text(
        f"Nr;voltage_V;position_um\n{table}Mean;48;44\nMax;96.5;88.25\n;;\n"
    )
    with pytest.raises(InputError, match=f"run.csv:{rows + 2}: .*'Mean'"):
        read(path, sample_rate=1000.0)
    assert read(path, sample_rate=1000.0, skip_bad=True)[0].rows == rows


@pytest.mark.parametrize("block", [1 << 9, 1 << 22])
def test_a_torn_line_is_refused_where_the_time_is_counted(
    block: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stream, "_BLOCK", block)
    path = tmp_path / "run.csv"
    lines = [f"{k % 97}.5,{k % 89}.25" for k in range(8000)]
    for place in range(7000, 7040):  # so that one begins and one ends a block
        cut = [*lines[:place], "restarted", *lines[place:]]
        path.write_text("\n".join(["voltage_V,position_um", *cut, ""]))
        with pytest.raises(InputError, match=f"`rows` 1:{place}"):
            read(path, sample_rate=1000.0, skip_bad=True)


def test_short_and_long_rows_do_not_make_up_for_each_other(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text(
        large().replace("\n", ",a\n").replace("5.25,a\n0.006,", "5.25\n0.006,a,", 1)
    )
    with pytest.raises(InputError, match=r"cells where"):
        read(path)


def test_decimal_commas_that_come_late_are_asked_about(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    rows = ["1;2"] * 30_000 + ["1,5;2,25"] * 30_000
    path.write_text("\n".join(["voltage_V;displacement_um", *rows]) + "\n")
    with pytest.raises(InputError, match=r"run.csv:30002: .*`decimal` comma"):
        read(path)
    assert read(path, decimal="comma")[0]["voltage"].sum() == 75_000.0


# --- pipes and files ---

SUM = """
import sys
from dbo_cli.logs import open_log
with open_log("-", {"voltage": None}) as log:
    for block in log.blocks():
        print(len(block), block.values["voltage"].sum(), flush=True)
"""


def test_a_pipe_gives_each_row_as_it_comes() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", SUM], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        assert process.stdin is not None and process.stdout is not None
        process.stdin.write(b"time_s,voltage_V\n")
        process.stdin.flush()
        for number in range(3):
            process.stdin.write(f"{number / 1000},{number}\n".encode())
            process.stdin.flush()
            assert process.stdout.readline() == f"1 {number}.0\n".encode()
        process.stdin.close()
        assert process.wait() == 0


def test_packed_and_encoded_files(tmp_path: Path) -> None:
    content = HEAD.replace("_um", " (µm)") + "0,1,2\n0.1,3,4\n"
    packed = tmp_path / "run.csv.gz"
    packed.write_bytes(gzip.compress(content.encode()))
    plain = tmp_path / "run.csv"
    assert read(packed)[0]["voltage"].tolist() == [1.0, 3.0]
    for encoding in (
        "utf-8",
        "utf-8-sig",
        "cp1252",
        "utf-16",
        "utf-16-be",
        "shift-jis",
        "latin-1",
    ):
        plain.write_bytes(
            content.replace("µ", "μ" if encoding[0] == "s" else "µ").encode(encoding)
        )
        must_be_typed = encoding in ("utf-16-be", "shift-jis", "latin-1")
        table, log = read(plain, encoding=encoding if must_be_typed else None)
        assert table["displacement"].tolist() == [2.0, 4.0]
        assert log.columns["displacement"].unit == "um"
    packed.write_bytes(gzip.compress(large(5000).encode())[:-20])
    with pytest.raises(InputError, match="gzip"):
        read(packed)
    with pytest.raises(UsageError, match="`encoding`"):
        read(plain, encoding="klingon")


@pytest.mark.parametrize("name", ["missing.csv", "."])
def test_what_is_no_file(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no such file|folder"):
        read(tmp_path / name)


# --- the end of a record ---


def test_a_record_that_may_be_cut_is_told(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    lines = [f"{n / 100:.2f},{n}.5,{n}.25" for n in range(20)]
    content = HEAD + "\n".join(lines)
    for size in range(content.rindex("\n") + 2, len(content) + 1):
        path.write_text(content[:size])
        try:
            table, log = read(path)
        except InputError as problem:
            assert "run.csv:21: " in str(problem) and size < len(content)
            assert read(path, skip_bad=True)[0].rows == 19
            continue
        assert log.doubtful[0].startswith("line 21, the last one, has no line end")
        assert table["displacement"][:19].tolist() == [n + 0.25 for n in range(19)]


# --- options ---


def test_rows(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text(large(5000).replace("\n0.000,0.00,0.25", "\n0.000,x,0.25"))
    assert read(path, rows="2:4000")[0]["voltage"].tolist() == list(range(1, 4000))
    assert read(path, rows="4997:")[0].rows == 4
    with pytest.raises(InputError, match=r"`rows` 9000: the log has 5,000"):
        read(path, rows="9000:")
    for rows in ("5", "7:3", "0:2", "a:b"):
        with pytest.raises(UsageError, match="`rows`"):
            read(path, rows=rows)


def test_how_a_text_is_written_can_be_said(tmp_path: Path) -> None:
    path = tmp_path / "run.txt"
    path.write_text("1 2 3\n4 5 6\nt_s:voltage_V:position_um\n0:1:2\n0.5:3:4\n")
    table, _ = read(path, delimiter=":", skip_lines=2)
    assert table["voltage"].tolist() == [1.0, 3.0]
    path.write_text("voltage_V;position_um\n1,234;2,345\n1,235;2,346\n")
    with pytest.raises(InputError, match="`decimal`"):
        read(path)
    assert read(path, decimal="comma")[0]["voltage"].tolist() == [1.234, 1.235]
    for options in ({"delimiter": "colons"}, {"delimiter": "1"}, {"decimal": "dot"}):
        with pytest.raises(UsageError, match=r"`delimiter`|`decimal`"):
            read(path, **options)


def test_rows_above_the_table_are_not_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("1,2\n3,4\nvoltage_V,position_um,flag\n1,2,0\n3,4,0\n")
    with pytest.raises(InputError, match="`skip_lines` 2"):
        read(path)
    assert read(path, skip_lines=2)[0]["voltage"].tolist() == [1.0, 3.0]


def test_cells() -> None:
    assert split_cells('"a, b", c ,"d"', ",") == ["a, b", "c", "d"]
    assert split_cells('1"2"3,4', ",") == ['1"2"3', "4"]
    assert split_cells('1,"4', ",") == ["1", '"4']
    assert split_cells('t,"DB".Drive [V]', ",") == ["t", '"DB".Drive [V]']
    assert split_cells(' 1 \t "2 3"  4 ', " ") == ["1", "2 3", "4"]
    assert to_number("1.5D-3", ".") == 0.0015
    assert np.isnan(
        [
            to_number(cell, ".")
            for cell in ("", "1,5", "0x1F", "1_0", "1.234.5", "1'234.5", "١")
        ]
    ).all()
