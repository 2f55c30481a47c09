"""Files of instruments and programs: each is read right, or refused with what to type.

The files are data (``tests/shapes/text.json``): what is in them, what is asked for, and
what must come out, or the options that the refusal must name.
"""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dbo_cli.errors import DboError
from dbo_cli.logs import Reading, open_log
from dbo_cli.logs.cells import Layout
from dbo_cli.logs.dialect import find_layout
from dbo_cli.logs.names import describe_columns
from dbo_cli.logs.table import Table
from dbo_cli.logs.text import plain_layout

SHAPES = Path(__file__).resolve().parent.parent / "shapes" / "text.json"
CASES = json.loads(SHAPES.read_text(encoding="utf-8"))


def write(case: dict[str, Any], folder: Path) -> str:
    path = folder / f"run{case['ending']}"
    if "text" in case:
        path.write_bytes(case["text"].encode())
    else:
        path.write_bytes(base64.b64decode(case["base64"]))
    return str(path) + case.get("part", "")


@pytest.mark.parametrize("case", CASES, ids=[case["name"] for case in CASES])
@pytest.mark.filterwarnings("ignore::dbo_cli.errors.DboWarning")
def test_a_shape_is_right_or_refused(case: dict[str, Any], tmp_path: Path) -> None:
    path = write(case, tmp_path)
    reading = Reading(**case.get("reading", {}))
    if "refused" in case:
        with (
            pytest.raises(DboError) as raised,
            open_log(path, case["roles"], reading) as log,
        ):
            log.read()
        message = str(raised.value)
        assert "\n" not in message
        assert set(case["refused"]) <= set(re.findall(r"`\w+`", message))
        if "line" in case:
            assert f":{case['line']}:" in message
        return
    with open_log(path, case["roles"], reading) as log:
        table = log.read()
    for role in ("voltage", "displacement"):
        if role in case:
            np.testing.assert_allclose(table[role], case[role], rtol=1e-15)
    if case["time"] is None:
        assert table.time is None
    else:
        assert table.time is not None
        np.testing.assert_allclose(table.time, case["time"], rtol=1e-12, atol=1e-15)
    assert log.clock.origin == pytest.approx(case.get("origin"), abs=1e-6)
    assert [column.unit for column in log.columns.values()] == case["units"]


# --- the plain door finds what the long way finds, wherever it takes a file ---

NAMES = st.sampled_from(
    ["time_s", "t", "Time (ms)", "voltage_V", "u", "Drive [mV]", "Weg/nm", "y", "displacement_um",
     "x (µm)", "sensor", "CH1_V", "dt", "rate", "unit", "name1", "s", "V", "2 mV rms", "ts", "start",
     "increment", "name", "label", "hunit", "0", "columns: t", "current_A", "x.y_um", "-", "a b c_V"]
)  # fmt: skip
NUMBERS = st.one_of(
    st.floats(-1e6, 1e6).map(repr),
    st.floats(-1e3, 1e3).map("{:.3f}".format),
    st.floats(-1e3, 1e3).map("{:.5e}".format),
    st.integers(-9999, 9999).map(str),
    st.sampled_from(["0", "007", "+1.5", ".5", "5.", "1d-3", "nan", "", " 2 ", "1,5", "12:00:00"]),
)  # fmt: skip


def alike(lines: list[str]) -> bool | None:
    """Return whether both doors find the same; None where the plain one is shut."""
    plain = plain_layout(lines, Reading())
    if plain is None:
        return None
    table, other = Table("run.csv"), Table("run.csv")
    layout = find_layout("run.csv", lines, Reading())
    describe_columns(table, plain)
    describe_columns(other, layout)
    return table.columns == other.columns and values(plain) == values(layout)


def values(layout: Layout) -> list[Any]:
    """Return what the rows and the clock are read by."""
    rows = [layout.delimiter, layout.decimal, layout.kinds, layout.first]
    return [*rows, layout.clock]


@pytest.mark.parametrize("case", CASES, ids=[case["name"] for case in CASES])
def test_both_doors_agree_on_a_shape(case: dict[str, Any]) -> None:
    data = case["text"].encode() if "text" in case else base64.b64decode(case["base64"])
    assert alike(data.decode("utf-8", "replace").split("\n")) is not False


def test_the_plain_door_takes_what_is_common() -> None:
    number = 0
    for case in CASES:
        lines = case.get("text", "").replace("\r\n", "\n").split("\n")
        number += plain_layout(lines, Reading()) is not None
    assert number > 30
    for header in ("time_s,voltage_V,displacement_um", "t\tu\ty", "Zeit/s;Spannung/V"):
        mark = next(mark for mark in ",\t;" if mark in header)
        rows = [mark.join("1.5" for _ in header.split(mark))] * 3
        assert alike([header, *rows, ""]) is True


@settings(max_examples=600, deadline=None, derandomize=True)
@given(st.data())
def test_both_doors_agree_on_a_random_table(data: st.DataObject) -> None:
    mark = data.draw(st.sampled_from([",", ";", "\t"]))
    width = data.draw(st.integers(2, 4))
    names = data.draw(st.lists(NAMES, min_size=width, max_size=width))
    cells = st.lists(NUMBERS, min_size=width, max_size=width)
    rows = data.draw(st.lists(cells, min_size=1, max_size=6))
    lines = [mark.join(names), *(mark.join(row) for row in rows)]
    end = data.draw(st.sampled_from(["", "\r"]))
    assert alike([line + end for line in lines] + [""]) is not False
