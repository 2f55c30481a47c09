"""Every bad log is refused in one exact line with its place, and with the right exit code."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from dbo_cli.errors import DboError
from dbo_cli.logs.columns import ColumnWish
from dbo_cli.logs.request import ReadingOptions, parse_rows
from dbo_cli.logs.signal_log import open_log
from dbo_cli.logs.text import text_table as parsing
from tests.shapes.refusable import REFUSABLE, Refusal

VOLTAGE = ("voltage", "drive", "command", "u", "v")
DISPLACEMENT = ("displacement", "position", "measured", "sensor", "y")


def told(refusal: Refusal, folder: Path, **more: Any) -> DboError:
    path = folder / ("log" + refusal.ending)
    if refusal.content is not None:
        path.write_bytes(refusal.content)
    call = refusal.call | more
    suffix = call.pop("suffix", "")
    want = {
        "voltage": ColumnWish(refusal.ask.get("voltage"), VOLTAGE, option="voltage"),
        "displacement": ColumnWish(
            refusal.ask.get("displacement"), DISPLACEMENT, option="displacement"
        ),
    }
    with pytest.raises(DboError) as raised:
        if "rows" in call:
            call["rows"] = parse_rows(call["rows"])
        with open_log(str(path) + suffix, want, ReadingOptions(**call)) as log:
            log.read()
    return raised.value


@pytest.mark.whole
@pytest.mark.parametrize("parser", ["plain", "fast"])
@pytest.mark.parametrize("refusal", REFUSABLE, ids=lambda refusal: refusal.name)
def test_refusal_is_told_exactly(
    refusal: Refusal, parser: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if parser == "fast":
        monkeypatch.setattr(parsing, "_parse_plain", parsing._parse_fast)
    problem = told(refusal, tmp_path)
    assert str(problem) == refusal.message.replace(
        "{log}", str(tmp_path / ("log" + refusal.ending))
    )
    assert problem.exit_code == refusal.code


@pytest.mark.parametrize("refusal", REFUSABLE, ids=lambda refusal: refusal.name)
def test_refusal_does_not_depend_on_the_block_size(
    refusal: Refusal, tmp_path: Path
) -> None:
    assert str(told(refusal, tmp_path, block_rows=1)) == str(told(refusal, tmp_path))


def test_there_are_forty_refusals() -> None:
    assert len({refusal.name for refusal in REFUSABLE}) == len(REFUSABLE) >= 40
