"""The remedy that a refusal names is followed, as a person would, and works."""

from __future__ import annotations

import io
import re
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from test_logs_formats import FILES, written

from dbo_cli.errors import DboError
from dbo_cli.logs.columns import column_wish
from dbo_cli.logs.request import ReadingOptions, parse_rows
from dbo_cli.logs.signal_log import open_log
from tests.shapes.refusable import REFUSABLE

Way = dict[str, Any]
ROLES = ("voltage", "displacement")


def read(address: str, way: Way) -> None:
    """Open and read a log; ``way`` holds selectors of roles and reading options."""
    wishes = {role: column_wish(role, way.get(role), option=role) for role in ROLES}
    options = {
        name: value for name, value in way.items() if name not in (*ROLES, "suffix")
    }
    if isinstance(options.get("rows"), str):
        options["rows"] = parse_rows(options["rows"])
    with open_log(
        address + way.get("suffix", ""), wishes, ReadingOptions(**options)
    ) as log:
        assert len(log.read())


def remedies(message: str) -> Iterator[Way]:  # noqa: C901 - a list
    """Take the remedies out of a message: each is what is to be changed about the call."""
    if "`skip_bad` drops such rows" in message:
        yield {"skip_bad": True}
    if "`sample_rate` HZ" in message:
        yield {"sample_rate": 1000.0, "time": None}
    if re.search(r"`time_unit` s\b", message):
        yield {"time_unit": "us"}
    if "`decimal` point or comma" in message:
        yield from ({"decimal": "point"}, {"decimal": "comma"})
    if found := re.search(r"`skip_lines` (\d+) and `header_lines` 0", message):
        yield {"skip_lines": int(found[1]), "header_lines": 0} | dict(
            zip(ROLES, "12", strict=True)
        )
    if found := re.search(
        r"\(write .*(::[^)]+?)(?: for the first of \d+ tables)?\)", message
    ):
        yield {"suffix": found[1]}
    if found := re.search(r"which column is the (\w+), (.+?)\?.*choose with", message):
        names = re.findall(r"(\d+) '[^']+'", found[2]) or re.findall(
            r"'([^']+)'", found[2]
        )
        yield from ({found[1]: name} for name in names)
    elif "no column is recognised" in message:
        numbers = [
            number
            for number, name in re.findall(r"(\d+) (\w+)", message)
            if name not in ("t", "time")
        ]
        yield {
            role: numbers[-2 + place]
            for place, role in enumerate(ROLES)
            if f"`{role}`" in message
        }
    if found := re.search(r"\(`rows` (:\d+) reads", message):
        yield {"rows": found[1]}
    if found := re.search(r"\(such as (.+)\)", message):
        yield dict(re.findall(r"`(\w+)` (\d+)", found[1]))
    if found := re.search(
        r"\(`(\w+)` ((?:number=|name=)?\w+) or ((?:number=|name=)?\w+)\)", message
    ):
        yield from (
            {found[1]: one}
            for one in found.groups()[1:]
            if one != "comma" and found[1] != "decimal"
        )


def refused(address: str, way: Way) -> str:
    with pytest.raises(DboError) as raised:
        read(address, way)
    return str(raised.value)


def follow_all(address: str, way: Way, least: int) -> None:
    message = refused(address, way)
    found = list(remedies(message))
    assert len(found) >= least, message
    for remedy in found:
        try:
            read(address, way | remedy)
        except DboError as again:
            pytest.fail(f"{message}\n{remedy} is refused next: {again}")


# What cannot be done by an option: the file has to be written again.
WRITE_AGAIN = re.compile(
    r"MATLAB objects|save arrays of numbers|write scale_factor|not JSON|no END|export|narrow the query|"
    r"write a file for each|X_Columns|bring the signals|leave it out|turn it round|"
    r"write them without|write a line a row"
)


@pytest.mark.parametrize(
    "case", [case for case in FILES if case.refusal], ids=lambda case: case.name
)
def test_what_a_format_is_refused_with(case: Any, tmp_path: Path) -> None:
    address = written(replace(case, group=""), tmp_path)
    way = {role: case.ask.get(role) for role in ROLES} | {
        "sample_rate": case.sample_rate
    }
    follow_all(address, way, 0 if WRITE_AGAIN.search(case.refusal) else 1)


@pytest.mark.parametrize("case", REFUSABLE, ids=lambda case: case.name)
def test_what_a_log_is_refused_with(case: Any, tmp_path: Path) -> None:
    path = tmp_path / f"log{case.ending}"
    if case.content is not None:
        path.write_bytes(case.content)
    follow_all(str(path), case.ask | case.call, "(`" in case.message)


def test_signals_with_times_of_their_own_are_brought_together_as_the_message_says(
    tmp_path: Path,
) -> None:
    pandas = pytest.importorskip("pandas")
    case = next(
        one
        for one in FILES
        if one.name.startswith("PlotJuggler, signals with times of their own")
    )
    address = written(case, tmp_path)
    assert "pandas: interpolate(method='index'), dropna" in refused(address, {})
    frame = pandas.read_csv(address).set_index("__time")
    frame.interpolate(method="index").dropna().to_csv(address)
    read(address, {})


def test_samples_along_the_lines_are_turned_as_the_message_says(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    case = next(one for one in FILES if one.name == "Samples along the lines")
    address = written(case, tmp_path)
    assert "read_csv(FILE, header=None, index_col=0).T)" in refused(address, {})
    pandas.read_csv(address, header=None, index_col=0).T.to_csv(address)
    read(address, {})


def test_skip_bad_is_not_offered_where_most_rows_would_go(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    good, bad = "0.1,1,2\n", "0.1,off,2\n"
    path.write_text("time_s,voltage_V,displacement_um\n" + good * 25 + bad * 1475)
    message = refused(str(path), {})
    assert "`skip_bad`" not in message
    assert "1,474 of the next 1,474 rows" in message
    read(str(path), {"rows": "1:25"})  # good rows A:B, as the message says


def test_the_end_of_a_long_address_is_enough(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    address = str(tmp_path / "run.h5")
    with h5py.File(address, "w") as file:
        file["entry/instrument/piezo_stage_42/analog_in/channel_07/samples"] = [
            0.0,
            1.0,
            2.0,
        ]
        file["entry/instrument/piezo_stage_42/interferometer/axis_1/samples"] = [
            3.0,
            4.0,
            5.0,
        ]
    message = refused(address, {})
    assert message.endswith(
        "(the end of an address is enough: `voltage` '*/channel_07/samples')"
    )
    read(address, {"voltage": "*/channel_07/samples", "displacement": "*axis_1*"})
    assert "there is no column '*axis_2*'" in refused(
        address, {"voltage": "*/channel_07/samples", "displacement": "*axis_2*"}
    )
    both = refused(address, {"voltage": "*samples", "displacement": "*axis_1*"})
    assert "`voltage` *samples fits 2 columns: 'entry/" in both
    assert both.endswith("interferometer/axis_1/samples'? (give more of it)")


def test_a_pattern_names_a_column_of_a_text_log(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(
        "time_s,Bench 4.Piezo.Out [V],Bench 4.Sensor.Way [1]\n0,1,2\n1,2,3\n"
    )
    read(str(path), {"voltage": "*piezo*", "displacement": "bench 4.s*[1]"})


@pytest.mark.parametrize("group", ["", "run/all/"])
def test_of_too_many_datasets_those_that_are_named_are_read(
    group: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    h5py = pytest.importorskip("h5py")
    from dbo_cli.logs.hdf5 import reader

    monkeypatch.setattr(reader, "_MOST", 9)
    address = str(tmp_path / "run.h5")
    with h5py.File(address, "w") as file:
        for number in range(10):
            file[f"{group}c{number}"] = [0.0, 1.0, 2.0 + number]
    message = refused(address, {})
    assert message.endswith(
        f"run.h5: /{group.strip('/')} has 10 members, more than 9: name the datasets that are meant "
        f"(`voltage` {group}NAME `displacement` {group}NAME `time` {group}NAME)"
    )
    read(address, {"voltage": f"{group}c7", "displacement": f"{group}c8"})


def test_a_long_table_through_a_pipe_is_asked_for_as_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = "time,channel,value\n" + "".join(
        f"{n},voltage,{n}\n{n},displacement,{n}\n" for n in range(9)
    )
    monkeypatch.setattr(
        sys, "stdin", io.TextIOWrapper(io.BufferedReader(io.BytesIO(lines.encode())))
    )
    assert (
        refused("-", {})
        == "standard input: a row for each value: give it as a file, not through a pipe"
    )
    path = tmp_path / "log.csv"
    path.write_text(lines)
    read(str(path), {})
