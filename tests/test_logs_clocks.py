"""What the figures and stamps of a time column count; whatever is not known is refused or said."""

from __future__ import annotations

import datetime
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dbo_cli.errors import InputError, UsageError
from dbo_cli.logs.columns import column_wish
from dbo_cli.logs.request import ReadingOptions
from dbo_cli.logs.sample_block import SampleBlock
from dbo_cli.logs.signal_log import SignalLog, open_log
from dbo_cli.logs.text.lines import (
    clock_seconds,
    date_seconds,
    minute_seconds,
    stamp_seconds,
    writing_of,
)

ROWS = 40
STEP = 0.002
LATE = datetime.datetime(2024, 3, 9, 23, 59, 59, 950000)
UNKNOWN = (
    ", which is no known unit of time (`time_unit` s, ms, us, ns, ps, min, h, d or a number of them such as "
    "10us, or `sample_rate` HZ)"
)


def read(
    folder: Path, header: str, cell: Callable[[int], object], **options: object
) -> tuple[SignalLog, SampleBlock]:
    path = folder / "log.csv"
    rows = "".join(f"{cell(k)},{k % 7},{k % 5}\n" for k in range(ROWS))
    path.write_text(f"{header},voltage_V,displacement_um\n{rows}")
    want = {
        role: column_wish(role, option=role) for role in ("voltage", "displacement")
    }
    with open_log(str(path), want, ReadingOptions(**options)) as log:  # type: ignore[arg-type]
        return log, log.read()


def steps(block: SampleBlock) -> float:
    assert block.time is not None
    return float(block.time[-1] - block.time[0]) / (len(block) - 1)


@pytest.mark.parametrize(
    ("header", "size"),
    [
        ("time_s", 1.0), ("Time (Sec.)", 1.0), ("Zeit [Sekunden]", 1.0), ("t/S", 1.0), ("time_ms", 1e-3),
        ("Time (mS)", 1e-3), ("time in ms", 1e-3), ("time_msecs", 1e-3), ("millis", 1e-3),
        ("elapsed_ms_total", 1e-3),
        ("t [µs]", 1e-6), ("Time (microseconds)", 1e-6), ("time [nanoseconds]", 1e-9), ("time (ps)", 1e-12),
        ("time (min)", 60.0), ("t_h", 3600.0), ("time (days)", 86400.0), ("timeSeconds", 1.0),
        ("time (milliseconds since 2024-03-09 10:15:00)", 1e-3), ("time (days since 2024-03-09)", 86400.0),
    ],
)  # fmt: skip
def test_units_of_time(header: str, size: float, tmp_path: Path) -> None:
    log, block = read(tmp_path, header, lambda k: repr(k * STEP / size))
    assert steps(block) == pytest.approx(STEP, rel=1e-12)
    assert log.warnings == []


@pytest.mark.parametrize(
    ("header", "unit"),
    [
        ("time (samples)", "samples"), ("Time [ticks]", "ticks"), ("time_ticks", "ticks"),
        ("time_index", "index"), ("Time (m)", "m"), ("time (V)", "V"), ("TIME in u0sec", "u0sec"),
        ("Time/frames", "frames"),
    ],
)  # fmt: skip
def test_an_unknown_unit_is_refused(header: str, unit: str, tmp_path: Path) -> None:
    # naming the column, as messages used to advise, leads to the same answer
    for named in (None, "1"):
        with pytest.raises(InputError) as raised:
            read(tmp_path, header, lambda k: k, time=named)
        assert str(raised.value).endswith(
            f": the time column '{header}' counts '{unit}'{UNKNOWN}"
        )
    log, block = read(tmp_path, header, lambda k: k, time="1", time_unit="10us")
    assert steps(block) == pytest.approx(1e-5)
    assert "(10us)" in log.reading_line()


@pytest.mark.parametrize(
    "header", ["t_nano#seconds", "time nano seconds", "Time_nano-Seconds"]
)
def test_a_unit_in_two_words(header: str, tmp_path: Path) -> None:
    assert steps(read(tmp_path, header, lambda k: 1e9 * STEP * k)[1]) == pytest.approx(
        STEP
    )


def test_a_stated_unit_that_makes_a_step_of_hours_is_doubted(tmp_path: Path) -> None:
    log, _ = read(tmp_path, "time_s", lambda k: 4000 * k)
    [warning] = log.warnings
    assert (
        "is stated in s, but its usual step would be 4e+03 s (`time_unit` says what it counts)"
        in warning
    )
    assert read(tmp_path, "time_s", lambda k: 60 * k)[0].warnings == []


def test_the_time_unit_goes_before_the_header(tmp_path: Path) -> None:
    assert steps(
        read(tmp_path, "time_s", lambda k: 2 * k, time_unit="ms")[1]
    ) == pytest.approx(STEP)
    with pytest.raises(UsageError, match=r"`time_unit` fortnights: give s, ms, us"):
        ReadingOptions(time_unit="fortnights")
    with pytest.raises(UsageError, match="exclude each other"):
        ReadingOptions(time_unit="ms", sample_rate=5.0)
    with pytest.raises(InputError, match="no column is recognised as the time"):
        read(tmp_path, "n", lambda k: k, time_unit="ms")
    with pytest.raises(InputError, match="is in s by its name and in ms by its unit"):
        path = tmp_path / "two.csv"
        path.write_text("time_s,voltage\nms,V\n0,1\n1,2\n")
        open_log(str(path), {"voltage": column_wish("voltage")})


@pytest.mark.parametrize(
    ("style", "cell"),
    [
        ("dates and clock times", "%Y-%m-%dT%H:%M:%S.%f"),
        ("dates and clock times", "%Y-%m-%d %H:%M:%S.%fZ"),
        ("dates and clock times", "%d.%m.%Y %H:%M:%S.%f"),
        ("dates and clock times", "%m/%d/%Y %I:%M:%S.%f %p"),
        ("dates and clock times", "%d-%b-%Y %H:%M:%S.%f"),
        ("dates and clock times", "%Y%m%dT%H%M%S.%f"),
        ("clock times", "%H:%M:%S.%f"),
        ("minutes and seconds", "%M:%S.%f"),
    ],
)
@pytest.mark.parametrize("block_rows", [1, 1 << 16])
def test_stamps_go_on_over_midnight(
    style: str, cell: str, block_rows: int, tmp_path: Path
) -> None:
    log, block = read(
        tmp_path,
        "Timestamp",
        lambda k: (LATE + datetime.timedelta(milliseconds=2 * k)).strftime(cell),
        block_rows=block_rows,
    )
    assert steps(block) == pytest.approx(STEP, abs=1e-8)
    assert log.reading_line().endswith(
        f"40 rows, 0.078 s at 500 samples/s; time 'Timestamp' ({style}), voltage 'voltage_V' (V), "
        "displacement 'displacement_um' (um)"
    )
    midnight = {"clock times": "midnight", "minutes and seconds": "the full hour"}.get(
        style
    )
    assert [note.partition(": ")[2] for note in log.notes] == (
        [f"the clock passes {midnight} and goes on"] if midnight else []
    )


def test_dates_beside_clock_times(tmp_path: Path) -> None:
    _, block = read(
        tmp_path,
        "Date,Time",
        lambda k: (LATE + datetime.timedelta(milliseconds=2 * k)).strftime(
            "%d.%m.%Y,%H:%M:%S.%f"
        ),
    )
    assert steps(block) == pytest.approx(STEP, abs=1e-8)
    assert block.time is not None
    assert block.time[0] == LATE.replace(tzinfo=datetime.UTC).timestamp()
    with pytest.raises(InputError, match="holds dates without a time of day"):
        read(tmp_path, "Time", lambda k: "09.03.2024")
    with pytest.raises(InputError, match="say by themselves what they count"):
        read(tmp_path, "Time", lambda k: f"10:15:{k:02d}", time_unit="ms")


@pytest.mark.parametrize(
    ("header", "begin", "step", "said"),
    [
        ("time", 1709999999.25, STEP, "s since 1970"),
        ("Timestamp", 1709999999250, 2, "ms since 1970"),
        ("time", 1709999999250000, 2000, "us since 1970"),
        ("timestamp", 1709999999250000128, 2000000, "ns since 1970"),
        ("time", 133000000000000000, 20000, "100 ns since 1601"),
        ("time", 45360.43, STEP / 86400, "days since 1899-12-30"),
        ("Date", 739320.43, STEP / 86400, "days since year 0"),
    ],
)
@pytest.mark.parametrize("block_rows", [1, 1 << 16])
def test_calendars(
    header: str, begin: float, step: float, said: str, block_rows: int, tmp_path: Path
) -> None:
    log, block = read(
        tmp_path, header, lambda k: repr(begin + k * step), block_rows=block_rows
    )
    assert steps(block) == pytest.approx(STEP, rel=2e-3)
    assert f"(no unit, read as {said})" in log.reading_line()
    assert len(log.warnings) == ("days" in said)


@pytest.mark.parametrize(
    ("cell", "told"),
    [
        (
            lambda k: k,
            "counts whole numbers one by one: read as seconds, though it may count rows",
        ),
        (lambda k: 2 * k, "no unit: read as seconds, its usual step is 2 s"),
        (
            lambda k: 2.5e8 + k * 0.5,
            "no unit: read as seconds, its stamps reach 2.5e+08 s",
        ),
        (
            lambda k: 0.4 + k * STEP / 86400,
            "no unit: read as seconds, the whole log lasts 9.03e-07 s",
        ),
        (
            lambda k: 40000 + k * 5e-5,
            "read as seconds of a day, but may be days since 1899-12-30",
        ),
        (
            lambda k: 3.6e12 + k * 1e6,
            "no unit, read as ms since 1970, and a usual step of 1000 s",
        ),
    ],
)
def test_figures_that_can_hardly_be_seconds(
    cell: Callable[[int], float], told: str, tmp_path: Path
) -> None:
    log, _ = read(tmp_path, "time", lambda k: repr(cell(k)))
    assert len(log.warnings) == 1
    assert told in log.warnings[0]
    assert "(`time_unit` " in log.warnings[0]
    assert (
        read(tmp_path, "time", lambda k: repr(cell(k)), time_unit="s")[0].warnings == []
    )


@pytest.mark.parametrize(
    ("header", "cell", "told"),
    [
        (
            "time_s",
            lambda k: 1.7e12 + k,
            "is stated in s, but its stamps would be 1.7e+12 s",
        ),
        (
            "time_ns",
            lambda k: k * STEP,
            "is stated in ns, but the whole log would last 7.8e-11 s",
        ),
        (
            "T",
            lambda k: 20 + (k * 7 % 11) / 100,
            "goes backwards in 24 of 40 rows: is it a clock?",
        ),
        (
            "time_s",
            lambda k: k // 20,
            "repeats its stamps in 38 of 40 rows: they have too few digits",
        ),
    ],
)
def test_clocks_that_can_hardly_be_one(
    header: str, cell: Callable[[int], float], told: str, tmp_path: Path
) -> None:
    log, _ = read(tmp_path, header, lambda k: repr(cell(k)))
    assert [told in text for text in log.warnings] == [True]


def test_a_temperature_called_t_is_no_time(tmp_path: Path) -> None:
    assert read(tmp_path, "T (degC)", lambda k: k)[0].time is None


def test_good_clocks_are_not_doubted(tmp_path: Path) -> None:
    for header, size in (
        ("time", 1.0),
        ("t", 1.0),
        ("time_s", 0.0005),
        ("time_ms", 1e-3),
    ):
        assert read(tmp_path, header, lambda k: repr(k * STEP / size))[0].warnings == []  # noqa: B023


def test_cells_of_stamps() -> None:
    at = datetime.datetime(
        2024, 3, 9, 22, 15, 0, 125000, tzinfo=datetime.UTC
    ).timestamp()
    for text in (
        "2024-03-09T22:15:00.125Z", "2024-03-09 23:15:00.125+01:00", "2024/3/9 10:15:00.125 PM",
        "20240309T221500.125", "09.03.2024 22:15:00,125", "03/09/24 22:15:00.125",
        "09-Mar-2024 22:15:00.125", "2024-03-09T17:15:00.125-0500",
    ):  # fmt: skip
        assert stamp_seconds(text) == at, text
    assert clock_seconds("1 day, 0:00:01") == 86401.0
    assert clock_seconds("10:15:00:125") == 36900.125
    assert clock_seconds("12:00:00 AM") == 0.0
    assert minute_seconds("15:00.1") == 900.1
    assert date_seconds("13/02/2024") == date_seconds("2024-02-13")
    for text in (
        "2024-13-09T22:15:00",
        "25:61:00",
        "13:00:00 PM",
        "1.5",
        "",
        "10:15",
        "2024-02-30",
    ):
        read = [
            stamp_seconds(text),
            clock_seconds(text),
            minute_seconds(text),
            date_seconds(text),
        ]
        assert read == [None] * 4, text
    assert writing_of(["10:15:00", "10:15:01", "late"]) == "clock"
    assert writing_of(["10:15:00", "late", "later"]) is None


def test_stamps_read_the_same_by_every_parser(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from dbo_cli.logs.text import text_table

    def cell(k: int) -> str:
        return (LATE + datetime.timedelta(microseconds=1237 * k)).isoformat()

    first = read(tmp_path, "time", cell)[1].time
    monkeypatch.setattr(text_table, "_parse_plain", lambda *_: None)
    second = read(tmp_path, "time", cell)[1].time
    assert first is not None and second is not None
    assert first.tolist() == second.tolist()
    assert np.all(np.diff(first) > 0)


def test_a_clock_that_jumps_far_is_told_in_a_few_digits(tmp_path: Path) -> None:
    log, _ = read(tmp_path, "time_s", lambda k: 1e308 if k == 5 else 0.01 * k)
    assert any(
        "time goes backwards at line 8 (from 1e+308 s to 0.06 s)" in note
        for note in log.notes
    )


def test_a_unit_that_lost_a_letter_is_asked_for(tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match=r"counts 'TIME/#secs', which is no known unit of time"
    ):
        read(tmp_path, "TIME/#secs", lambda k: 1e3 * STEP * k)
