"""Outputs: values that read back, whole or not at all, together or none."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest

from dbo_cli.errors import OutputError, UsageError
from dbo_cli.files import Outputs, check_outputs, write_text
from dbo_cli.logs.write import create, header_cell

COLUMNS = [("time", "s"), ("desired", "um"), ("voltage", "V")]


def rows(count=1000):
    rng = np.random.default_rng(3)
    return [
        np.arange(count) / 1e4,
        rng.normal(size=count),
        rng.normal(size=count) * 1e-7,
    ]


def only(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_few_rows_read_back_without_polars(tmp_path, monkeypatch):
    monkeypatch.delitem(sys.modules, "polars", raising=False)
    values = np.array([0.1, -1e-5, 1e22, 5e-324, 1.0, 123456789.123456789])
    with create(tmp_path / "a.csv", [("x", None)]) as out:
        out.write(values)
    lines = (tmp_path / "a.csv").read_text().splitlines()
    assert [float(line) for line in lines[1:]] == values.tolist()


@pytest.mark.parametrize(
    ("name", "unit"),
    [("voltage", "V"), ("n", None), ("force", "odd unit"), ("a,b", "V")],
)
def test_a_header_is_read_back(name, unit):
    from dbo_cli.units import split_header

    cell = header_cell(name, unit, ",")
    assert split_header(cell.strip('"')) == (name, unit)
    assert cell.startswith('"') == ("," in name)


def test_no_row_that_is_no_number_is_written(tmp_path):
    path = tmp_path / "a.csv"
    with (
        pytest.raises(OutputError, match=r"row 1003.*desired.*nan"),
        create(path, COLUMNS) as out,
    ):
        out.write(*rows())
        out.write([1.0, 2.0, 3.0], [0.0, 0.0, np.nan], [0.0, 0.0, 0.0])
    assert only(tmp_path) == []


def test_permissions_links_and_inputs(tmp_path):
    target = tmp_path / "real.csv"
    target.write_text("x\n1\n")
    target.chmod(0o640)
    link = tmp_path / "link.csv"
    link.symlink_to(target)
    with target.open() as before, create(link, [("x", None)]) as out:
        out.write([2.0])
        assert before.read() == "x\n1\n"  # an input that is replaced is read to its end
    assert link.is_symlink()
    assert target.read_text() == "x\n2.0\n"
    assert target.stat().st_mode & 0o777 == 0o640
    mask = os.umask(0o027)
    try:
        write_text(tmp_path / "new.json", "{}")
    finally:
        os.umask(mask)
    assert (tmp_path / "new.json").stat().st_mode & 0o777 == 0o640


def test_places_that_cannot_be_written(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "x.csv")
    cases = [
        ([tmp_path / "missing" / "a.csv"], OutputError),
        ([tmp_path / "folder"], OutputError),
        ([tmp_path / "x.csv", tmp_path / "folder" / ".." / "x.csv"], OutputError),
        ([tmp_path / "x.csv", tmp_path / "link"], OutputError),
        ([Path("-"), Path("/dev/stdout")], OutputError),
        ([tmp_path / ("n" * 300)], OutputError),
    ]
    for paths, kind in cases:
        with pytest.raises(kind), Outputs() as outputs:
            check_outputs(*paths)
            outputs.write_bytes(paths[0], b"")
    for name in ("a.npy", "a.xlsx", "a.h5.gz", "a.h5::/group"):
        with pytest.raises(UsageError), create(tmp_path / name, COLUMNS):
            pass
    with pytest.raises(UsageError), create("a.h5::/group", COLUMNS):
        pass
    write_text("/dev/null", "x")
    assert only(tmp_path) == ["folder", "link"]
