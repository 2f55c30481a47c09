"""Text logs: blocks and pipes, irregular rows, cut records, and the reading options."""

import numpy as np
import pytest

from dbo_cli.errors import InputError
from dbo_cli.logs import Reading, open_log, stream, text
from dbo_cli.logs import log as log_module

BOTH = {"voltage": None, "displacement": None}
HEAD = "time_s,voltage_V,displacement_um\n"


def read(path, **reading):
    with open_log(str(path), BOTH, Reading(**reading)) as log:
        return log.read(), log


def large(rows=8_000, delimiter=",", decimal=".", end="\n"):
    """Write a log that is read by polars; row n holds n and n + 0.25."""
    lines = [delimiter.join(["time_s", "voltage_V", "displacement_um"])]
    for n in range(rows):
        cells = f"{n / 1000:.3f} {n}.00 {n}.25".replace(".", decimal).split()
        lines.append(delimiter.join(cells))
    return end.join(lines) + end


# --- blocks ---


@pytest.mark.parametrize("block", [100, 4096, 1 << 22])
@pytest.mark.parametrize("small", [0, 1 << 30])
def test_blocks_and_ways_of_reading_give_the_same(block, small, tmp_path, monkeypatch):
    monkeypatch.setattr(stream, "_BLOCK", block)
    monkeypatch.setattr(text, "_SMALL", small)
    monkeypatch.setattr(text, "_TINY", min(small, 1 << 12) if small == 0 else 1 << 30)
    path = tmp_path / "run.csv"
    path.write_text(large(4000))
    monkeypatch.setattr(log_module, "ROWS_A_BLOCK", 700)
    with open_log(str(path), BOTH) as log:
        blocks = list(log.blocks())
    assert max(map(len, blocks)) <= 700
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
        lambda s: s.replace(",", "\t,\t"),
        lambda s: s.replace(",", ",\u00a0"),
        lambda s: s.replace("\n7,", "\n7\t,").replace(",9.00,", ",\u00a09.00,"),
        lambda s: s.replace(",", '","').replace("\n", '"\n"')[:-1],
        lambda s: s.replace("\n", ",\n"),
        lambda s: s.replace("\n5.000", "\n\n# a remark\n\n5.000").replace("\n1.000", "\n\n1.000"),
        lambda s: s.replace("\n", ",ok\n"),
        lambda s: "junk\nRate: 5 kHz\n\n" + s,
        lambda s: "," + s.replace("\n", "\n,")[:-1],
    ],
)  # fmt: skip
def test_large_files_of_many_ways(change, tmp_path):
    path = tmp_path / "run.csv"
    path.write_text(change('"' + large() if '"' in change(",") else large()))
    table, _ = read(path)
    np.testing.assert_array_equal(table["voltage"], np.arange(8_000.0))
    np.testing.assert_array_equal(table["displacement"], np.arange(8_000) + 0.25)


@pytest.mark.filterwarnings("ignore::dbo_cli.errors.DboWarning")
@pytest.mark.parametrize(
    ("damage", "what"),
    [
        ("5.000,5000.00", "2 cells where"),
        ("5.000,5000.00,5000.25,7", "4 cells where"),
        ("5.000,5000.00,", "'displacement_um' is no finite number: ''"),
        ("5.000,x,5000.25", "'voltage_V'"),
        ("5.000,inf,5000.25", "'voltage_V'"),
        ("5.000,nan,5000.25", "'voltage_V'"),
        ("5.000,9.9E37,5000.25", "'voltage_V'"),
        ('5.000,",5000.25', "'voltage_V'"),
        ("5.000,1_000,5000.25", "'voltage_V'"),
        ("5.000,1,5,5000.25", "4 cells where"),
        (HEAD.strip(), "'voltage_V'"),
    ],
)
def test_an_irregular_row_of_a_large_file_is_named(damage, what, tmp_path):
    path = tmp_path / "run.csv"
    path.write_text(large().replace("5.000,5000.00,5000.25", damage))
    with pytest.raises(InputError) as raised:
        read(path)
    assert "run.csv:5002: " in str(raised.value)
    assert what in str(raised.value) and "`skip_bad`" in str(raised.value)
    table, log = read(path, skip_bad=True)
    left = np.delete(np.arange(8_000.0), 5_000)
    np.testing.assert_array_equal(table["voltage"], left)
    assert len(log.doubtful) == 1 and "1 row left out" in log.doubtful[0]


@pytest.mark.filterwarnings("ignore::dbo_cli.errors.DboWarning")
def test_a_word_in_front_of_a_row_of_a_large_file_is_named(tmp_path):
    path = tmp_path / "run.csv"
    text = "," + large().replace("\n", "\n,")[:-1]
    path.write_text(text.replace(",5.000,", "AVG,5.000,"))
    with pytest.raises(InputError, match=r"run\.csv:5002: .*'AVG'.*`skip_bad`"):
        read(path)
    table, _ = read(path, skip_bad=True)
    left = np.delete(np.arange(8_000.0), 5_000)
    np.testing.assert_array_equal(table["voltage"], left)


@pytest.mark.filterwarnings("ignore::dbo_cli.errors.DboWarning")  # of gaps
@pytest.mark.parametrize("rows", [100, 8_000])
def test_a_second_table_is_not_read_in_the_units_of_the_first(rows, tmp_path):
    path, content = tmp_path / "run.csv", large(rows)
    below = f"time_ms,voltage_mV,displacement_nm\n{rows}000.0,1000.0,2000.0\n"
    content = content.replace("\n0.020,20.00,", "\n0.020,,") + below
    path.write_text(content)
    advice = rf":{rows + 2}: another table begins: cut with `rows` :{rows}$"
    for reading in ({}, {"rows": f"{rows + 2}:"}):
        with pytest.raises(InputError, match=advice):
            read(path, skip_bad=True, **reading)
    table, _ = read(path, skip_bad=True, rows=f":{rows}")
    assert len(table) == rows - 1
    again = content.replace("time_ms,voltage_mV,displacement_nm\n", HEAD)
    path.write_text(again)
    assert len(read(path, skip_bad=True)[0]) == rows


def test_points_are_refused_beside_stamps_as_well(tmp_path):
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


@pytest.mark.parametrize("block", [1 << 9, 1 << 22])
def test_a_torn_line_is_refused_where_the_time_is_counted(block, tmp_path, monkeypatch):
    monkeypatch.setattr(stream, "_BLOCK", block)
    path = tmp_path / "run.csv"
    lines = [f"{k % 97}.5,{k % 89}.25" for k in range(8000)]
    for place in range(7000, 7040, 8):  # so that one begins and one ends a block
        cut = [*lines[:place], "restarted", *lines[place:]]
        path.write_text("\n".join(["voltage_V,position_um", *cut, ""]))
        with pytest.raises(InputError, match=f"`rows` 1:{place}"):
            read(path, sample_rate=1000.0, skip_bad=True)


def test_a_pipe_of_utf_16_may_pause_within_a_line_end(tmp_path, monkeypatch):
    path, content = tmp_path / "run.csv", "# bench\n" + HEAD + "0,0.5,1.5\n"
    cut = len(content.encode("utf-16")) - 1
    data = (content + "0.001,1.5,2.5\n").encode("utf-16")
    path.write_bytes(data)
    chunks = [data[:cut], data[cut:], b""]
    monkeypatch.setattr(stream.stat, "S_ISREG", lambda mode: False)
    monkeypatch.setattr(stream.TextStream, "_has_more", lambda self: False)
    monkeypatch.setattr(stream.TextStream, "_read", lambda self, size: chunks.pop(0))
    assert read(path)[0]["voltage"].tolist() == [0.5, 1.5]


def test_a_record_that_may_be_cut_is_told(tmp_path):
    path = tmp_path / "run.csv"
    lines = [f"{n / 100:.2f},{n}.5,{n}.25" for n in range(20)]
    content = HEAD + "\n".join(lines)
    for size in range(content.rindex("\n") + 2, len(content) + 1):
        path.write_text(content[:size])
        try:
            table, log = read(path)
        except InputError as problem:
            assert "run.csv:21: " in str(problem) and size < len(content)
            assert len(read(path, skip_bad=True)[0]) == 19
            continue
        assert log.doubtful[0].startswith("line 21, the last one, has no line end")
        assert table["displacement"][:19].tolist() == [n + 0.25 for n in range(19)]


def test_a_numbered_name_names_no_other_column(tmp_path):
    """NAME0 alone is the first column's."""
    path = tmp_path / "run.dat"
    rows = "\n".join(f"{n}.5\t{n}.25" for n in range(4))
    path.write_text(f"#SAMPLE_TIME = 0.001\n#NAME0 = Voltage\n#END_HEADER\n{rows}\n")
    with open_log(str(path), {"voltage": "1", "displacement": "2"}) as log:
        assert log.columns["displacement"].name == ""


def test_a_column_that_ends_early_is_no_delimiter_behind_the_rows(tmp_path):
    """Two names above three columns were taken for those of the first two."""
    path = tmp_path / "run.csv"
    rows = [f"{n},{0.001 * n},{n + 0.5 if n < 20 else ''}" for n in range(1, 421)]
    path.write_text("\n".join(["time_s,voltage_V", *rows]) + "\n")
    with pytest.raises(InputError, match="row or names"):
        open_log(str(path), {"voltage": None}, Reading())
