"""Every file shape reads right, whichever of the three parsers and whatever block size takes it."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dbo_cli.errors import InputError
from dbo_cli.extras.instruments.headers import read_instrument_header
from dbo_cli.logs.columns import ColumnWish
from dbo_cli.logs.request import ReadingOptions
from dbo_cli.logs.sample_block import SampleBlock
from dbo_cli.logs.signal_log import SignalLog, open_log
from dbo_cli.logs.text import text_table
from dbo_cli.logs.text import text_table as parsing
from dbo_cli.logs.text.dialect import Dialect, detect
from tests.shapes.instrument_files import INSTRUMENT_FILES
from tests.shapes.readable import READABLE, Shape

VOLTAGE = ("voltage", "drive", "command", "u", "v")
DISPLACEMENT = ("displacement", "position", "measured", "sensor", "y")


def open_shape(shape: Shape, path: Path, block_rows: int = 1 << 18) -> SignalLog:
    return open_log(
        str(path),
        {
            "voltage": ColumnWish(shape.ask.get("voltage"), VOLTAGE, option="voltage"),
            "displacement": ColumnWish(
                shape.ask.get("displacement"), DISPLACEMENT, option="displacement"
            ),
        },
        replace(
            shape.options,
            time=shape.ask.get("time"),
            sample_rate=shape.sample_rate,
            block_rows=block_rows,
        ),
    )


def check(shape: Shape, log: SignalLog, block: SampleBlock) -> None:
    assert block.values["voltage"].tolist() == list(shape.voltage)
    assert block.values["displacement"].tolist() == list(shape.displacement)
    if shape.time is None:
        assert block.time is None
    else:
        assert block.time is not None
        assert block.time.tolist() == list(shape.time)
    assert (
        log.columns["voltage"].unit,
        log.columns["displacement"].unit,
    ) == shape.units
    assert list(block.rows) == list(range(1, len(shape.voltage) + 1))
    assert block.lines is not None
    assert block.lines[0] == shape.first_line


@pytest.mark.parametrize("shape", READABLE, ids=lambda shape: shape.name)
@pytest.mark.parametrize("packed", [False, True], ids=["plain", "gzip"])
def test_shape_reads_right(shape: Shape, packed: bool, tmp_path: Path) -> None:
    path = tmp_path / ("log" + shape.ending + (".gz" if packed else ""))
    content = shape.content
    if packed and not content.rstrip(b"\0").endswith((b"\n", b"\r")):
        content += b"\n"  # without it, compressed data count as cut
    path.write_bytes(gzip.compress(content) if packed else content)
    with open_shape(shape, path) as log:
        check(shape, log, log.read())


@pytest.mark.parametrize("shape", READABLE, ids=lambda shape: shape.name)
def test_shape_reads_the_same_row_by_row(shape: Shape, tmp_path: Path) -> None:
    path = tmp_path / ("log" + shape.ending)
    path.write_bytes(shape.content)
    with open_shape(shape, path, block_rows=1) as log:
        parts = list(log.blocks())
    assert {len(part) for part in parts} == {1}
    assert [part.values["voltage"][0] for part in parts] == list(shape.voltage)


@pytest.mark.parametrize("parser", ["slow", "fast"])
@pytest.mark.parametrize("shape", READABLE, ids=lambda shape: shape.name)
def test_shape_reads_the_same_by_every_parser(
    shape: Shape, parser: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    replacement = parsing._parse_fast if parser == "fast" else lambda *_: None
    monkeypatch.setattr(parsing, "_parse_plain", replacement)
    path = tmp_path / ("log" + shape.ending)
    path.write_bytes(shape.content)
    with open_shape(shape, path) as log:
        check(shape, log, log.read())


def test_there_are_forty_shapes() -> None:
    assert len({shape.name for shape in READABLE}) == len(READABLE) >= 40


def test_numbers_survive_both_ways(tmp_path: Path) -> None:
    """The longest decimal spellings, subnormals and the extremes read back bit for bit."""
    values = [
        5e-324,
        2.2250738585072014e-308,
        1.7976931348623157e308,
        -0.0,
        0.1,
        1 / 3,
        1e22,
        9007199254740993.0,
    ]
    path = tmp_path / "log.csv"
    path.write_text("voltage\n" + "".join(f"{value:.30e}\n" for value in values))
    with open_log(str(path), {"voltage": ColumnWish(None, VOLTAGE)}) as log:
        read = log.read().values["voltage"]
    assert read.view(np.uint64).tolist() == np.array(values).view(np.uint64).tolist()


def test_what_is_taken_for_a_plain_log_has_no_instruments_header(
    tmp_path: Path,
) -> None:
    """One line of names above numbers is not shown to the makers' readers: they would find nothing there."""
    contents = [shape.content for shape in READABLE]
    for number, one in enumerate(INSTRUMENT_FILES):
        one.write(path := tmp_path / f"{number}{one.ending}")
        contents.append(path.read_bytes())
    plain = [content for content in contents if text_table._PLAIN.fullmatch(content)]
    assert len(plain) > 10

    def outcome(read: Callable[..., Dialect], content: bytes) -> Dialect | str:
        try:
            return read("log", content, ReadingOptions())
        except InputError as problem:
            return str(problem)

    for content in plain:
        assert outcome(read_instrument_header, content) == outcome(detect, content)
