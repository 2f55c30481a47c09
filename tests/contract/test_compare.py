"""``dbo compare``: the DBO beside the operators that its publication names, in one table."""

from pathlib import Path

import pytest

from .conftest import creep_log
from .program import done, load, refused, table, write

KEYS = """name words rmse expected_rmse validation_rmse parameters forward_ns inverse_ns
refused""".split()


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    """Return the table of a log without a clock as text, and that of one judged on another as JSON."""
    folder = tmp_path_factory.mktemp("compare")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        log, other = creep_log("log.csv"), creep_log("other.csv", seed=2)
        part = ("--rows", "1:600")
        done("compare", log, "--validate", other, *part, "-o", "table.json", "-q")
        _, *columns = table(log).values()
        header = "voltage_V,displacement_um"
        write("bare.csv", header, *(values[:401] for values in columns))
        text = done("compare", "bare.csv")
    return text, load(folder / "table.json")


def test_there_is_a_row_for_each_operator(compared):
    told = compared[1]
    assert (told["format"], told["version"], told["unit"]) == ("dbo-compare", 1, "um")
    assert (told["logs"], told["validation"]) == (["log.csv"], ["other.csv"])
    names = [row["name"] for row in told["models"]]
    assert names == "dbo line pi modified rate extended asymmetric".split()
    assert [list(row) for row in told["models"]] == [KEYS] * len(names)
    errors = {}
    for row in told["models"]:
        if row["refused"]:
            continue
        assert 0.0 < row["rmse"] < 1.0
        assert 0.0 < row["validation_rmse"] < 1.0
        assert row["parameters"] >= 1
        assert row["forward_ns"] is None or row["forward_ns"] > 0.0
        errors[row["name"]] = row["validation_rmse"]
    assert min(errors, key=lambda name: errors[name]) == "dbo"  # where there is creep


def test_the_table_is_aligned_text(compared):
    lines = compared[0].out.splitlines()
    assert len(lines) >= 5 and max(map(len, lines)) <= 120
    assert "um" in compared[0].out
    assert "note: rate: the rate needs a clock" in compared[0].out
    for row in compared[1]["models"]:
        assert row["name"].lower() in compared[0].out.lower()


def test_a_log_that_shows_nothing_is_refused():
    Path("log.csv").write_text("time_s,voltage_V,displacement_um\n0,0,0\n1,1,1\n")
    assert "log.csv" in refused(1, "compare", "log.csv")
