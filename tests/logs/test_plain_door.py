"""The plain door to text finds what the long way finds, wherever it takes a file."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dbo_cli.logs.cells import Layout
from dbo_cli.logs.dialect import find_layout
from dbo_cli.logs.names import describe_columns
from dbo_cli.logs.table import Reading, Table
from dbo_cli.logs.text import plain_layout

SHAPES = Path(__file__).resolve().parent.parent / "shapes" / "text.json"
CASES = json.loads(SHAPES.read_text(encoding="utf-8"))
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
