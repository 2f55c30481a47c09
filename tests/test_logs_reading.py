"""Which column is meant, which row is one, and what is said of a log: against its truth, or aloud."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from dbo_cli.errors import InputError
from dbo_cli.logs import clock, columns, units
from dbo_cli.logs.columns import column_wish
from dbo_cli.logs.request import ReadingOptions
from dbo_cli.logs.signal_log import SignalLog, open_log

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "benchmarks"))

from header_fuzz import HeaderFuzz  # noqa: E402

IDENTIFY = ("voltage", "displacement")
REPORT = ("measured", "desired", "voltage")


def opened(
    folder: Path, text: str, roles: tuple[str, ...] = IDENTIFY, **options: object
) -> SignalLog:
    path = folder / "log.csv"
    path.write_text(text)
    want = {role: column_wish(role, option=role) for role in roles}
    with open_log(str(path), want, ReadingOptions(**options)) as log:  # type: ignore[arg-type]
        log.read()
    return log


def table(header: str, rows: int = 30) -> str:
    width = header.count(",") + 1
    return f"time_s,{header}\n" + "".join(
        ",".join(
            [f"{k * 0.002:g}", *(f"{(k * (j + 3)) % 11 * 1.5:g}" for j in range(width))]
        )
        + "\n"
        for k in range(rows)
    )


@pytest.mark.parametrize(
    ("header", "roles", "taken"),
    [
        ("Weg (um),Spannung (V)", IDENTIFY, "Spannung (V)|Weg (um)"),
        ("z (nm),Spannung [V]", IDENTIFY, "Spannung [V]|z (nm)"),
        ("CH1 (V),CH2 (um)", IDENTIFY, "CH1 (V)|CH2 (um)"),
        ("Channel A (nm),Channel B (V)", IDENTIFY, "Channel B (V)|Channel A (nm)"),
        ("Tension (V),Déplacement (µm)", IDENTIFY, "Tension (V)|Déplacement (µm)"),
        ("command (um),actual (um),voltage (V)", IDENTIFY, "voltage (V)|actual (um)"),
        (
            "target position (um),current position (um),u (V)",
            IDENTIFY,
            "u (V)|current position (um)",
        ),
        ("desired,measured,voltage", IDENTIFY, "voltage|measured"),
        ("desired,measured,voltage", REPORT, "measured|desired|voltage"),
        ("Reference,Measured,Voltage", REPORT, "Measured|Reference|Voltage"),
        (
            "setpoint (um),actual position (um),voltage",
            REPORT,
            "actual position (um)|setpoint (um)|voltage",
        ),
        (
            "command (um),current (um),voltage",
            REPORT,
            "current (um)|command (um)|voltage",
        ),
        (
            "Drive (V),Current (mA),Displacement (um)",
            IDENTIFY,
            "Drive (V)|Displacement (um)",
        ),
        (
            "Sensor voltage (V),Drive voltage (V)",
            IDENTIFY,
            "Drive voltage (V)|Sensor voltage (V)",
        ),
        ("desired_um,measured_um,voltage_V", ("trajectory",), "desired_um"),
        ("q", ("trajectory",), "q"),
        (
            "Voltage (measured),Position (actual)",
            IDENTIFY,
            "Voltage (measured)|Position (actual)",
        ),
        ("V,um", IDENTIFY, "V|um"),
        ("volts,microns", IDENTIFY, "volts|microns"),
        ("drive (degC),position (um)", IDENTIFY, "drive (degC)|position (um)"),
        ("drive (V),position (Hz)", IDENTIFY, "drive (V)|position (Hz)"),
        ("V,m", IDENTIFY, "V|m"),
    ],
)
def test_columns_are_told_apart(
    header: str, roles: tuple[str, ...], taken: str, tmp_path: Path
) -> None:
    log = opened(tmp_path, table(header), roles)
    assert "|".join(column.name for column in log.columns.values()) == taken


@pytest.mark.parametrize(
    ("header", "roles", "told"),
    [
        ("u,x,y", IDENTIFY, "which column is the displacement, 'x' or 'y'?"),
        (
            "Drive,Measured (V),Interferometer (nm)",
            IDENTIFY,
            "'Measured (V)' or 'Interferometer (nm)'?",
        ),
        (
            "Drive (mA),HV monitor (V),Position (um)",
            IDENTIFY,
            "no column is recognised as the voltage",
        ),
        (
            "Vx (V),Vy (V),x (um),y (um)",
            IDENTIFY,
            "no column is recognised as the voltage",
        ),
        (
            "CH1 (V),CH2 (V)",
            IDENTIFY,
            "which column is the voltage, 'CH1 (V)' or 'CH2 (V)'?",
        ),
        (
            "voltage (um),displacement (um)",
            IDENTIFY,
            "no column is recognised as the voltage",
        ),
        (
            "voltage (mA),displacement (um)",
            IDENTIFY,
            "no column is recognised as the voltage",
        ),
        (
            "drive (V),sensor (A)",
            IDENTIFY,
            "no column is recognised as the displacement",
        ),
        (
            "desired_um,voltage_V",
            IDENTIFY,
            "no column is recognised as the displacement: 'desired_um' is what was wanted, not what was ",
        ),
        (
            "sensor voltage (V),position (um)",
            IDENTIFY,
            "no column is recognised as the voltage",
        ),
        ("voltage", ("trajectory",), "no column is recognised as the trajectory"),
        ("displacement_um", ("voltage",), "no column is recognised as the voltage"),
        (
            "Snsor voltage (V),Piezo votage (mV),position (um)",
            IDENTIFY,
            "which column is the voltage",
        ),
        ("voltage,x,positionmm", IDENTIFY, "'x' or 'positionmm'?"),
        ("voltage,um,nm", IDENTIFY, "'um' or 'nm'?"),
        ("voltage,position 2,/nm", IDENTIFY, "'position 2' or '/nm'?"),
        ("voltage,Wegccm,position 2", IDENTIFY, "'Wegccm' or 'position 2'?"),
        (
            "voltage,Sensor voltage (V),Wegµm",
            IDENTIFY,
            "'Sensor voltage (V)' or 'Wegµm'?",
        ),
        (
            "voltage,position 2,Posi)tion [um]",
            IDENTIFY,
            "'position 2' or 'Posi)tion [um]'?",
        ),
    ],
)
def test_what_may_be_meant_is_asked_about(
    header: str, roles: tuple[str, ...], told: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError) as raised:
        opened(tmp_path, table(header), roles)
    assert told in str(raised.value)
    assert str(raised.value).endswith(" NAME or NUMBER)")


def test_a_first_column_in_a_unit_of_time_is_the_clock(tmp_path: Path) -> None:
    """As oscilloscopes write it: "Source,CH1,CH2" above "Second,Volt,Volt"."""
    path = tmp_path / "log.csv"
    path.write_text(
        "Source,CH1\nSecond,Volt\n" + "".join(f"{0.25 * k},{k % 5}\n" for k in range(9))
    )
    with open_log(
        str(path), {"voltage": column_wish("voltage", "CH1", option="voltage")}
    ) as log:
        block = log.read()
    assert block.time is not None
    assert block.time.tolist() == [0.25 * k for k in range(9)]
    path.write_text(
        "a (s),b (ms),voltage\n"
        + "".join(f"{0.25 * k},{k},{k % 5}\n" for k in range(9))
    )
    with pytest.raises(
        InputError, match="which column is the time, 'a \\(s\\)' or 'b \\(ms\\)'"
    ):
        open_log(str(path), {"voltage": column_wish("voltage", option="voltage")})


def test_a_number_that_is_a_name_is_asked_about(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time_s,1,2\n0,1,2\n0.001,2,3\n")
    how = ReadingOptions(header_lines=1)

    def column(selector: str) -> int:
        with open_log(
            str(path),
            {"voltage": column_wish("voltage", selector, option="voltage")},
            how,
        ) as log:
            return log.columns["voltage"].number

    with pytest.raises(InputError) as raised:
        column("2")
    assert str(raised.value) == (
        f"{path}: `voltage` 2: column 2, '1', or column 3, which is named '2'? (`voltage` number=2 or name=2)"
    )
    assert (
        column("number=2"),
        column("name=2"),
        column("3"),
        column("name=time_s"),
    ) == (2, 3, 3, 1)


def test_an_index_is_no_unit(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("data[1],data[2]\n1,2\n3,4\n")
    with open_log(str(path), {"voltage": column_wish("voltage", "data[2]")}) as log:
        assert log.columns["voltage"].unit is None


@pytest.mark.parametrize("rows", [30, 30_000])
@pytest.mark.parametrize("line", ["Channels,2,3", "X_Dimension,2,3", "time_s,1,1"])
def test_text_in_a_column_of_numbers_makes_no_sample(
    line: str, rows: int, tmp_path: Path
) -> None:
    lines = table("voltage,displacement", rows).splitlines()
    text = "\n".join([*lines[: rows // 2], line, *lines[rows // 2 :]]) + "\n"
    with pytest.raises(InputError) as raised:
        opened(tmp_path, text, sample_rate=500.0)
    word = line.partition(",")[0]
    assert str(raised.value).endswith(
        f"log.csv:{rows // 2 + 1}: column 'time_s' is not a number: '{word}' (`skip_bad` drops such rows)"
    )
    log = opened(tmp_path, text, sample_rate=500.0, skip_bad=True)
    assert log.rows_read == rows
    assert log.notes[-1].endswith(": 1 row dropped")


@pytest.mark.parametrize("rows", [30, 40_000])
def test_missing_numbers_elsewhere_do_no_harm(rows: int, tmp_path: Path) -> None:
    cells = ("", "NA", "n/a", "NaN", "none", "1.5", "2e3", "-")
    text = "time_s,voltage,displacement,temp,remark\n" + "".join(
        f"{k / 500},{k % 5},{k % 7},{cells[k % 8] if k % 3 == 0 else 20},ok {k}\n"
        for k in range(rows)
    )
    assert opened(tmp_path, text).rows_read == rows


def lvm(dated: bool, restarts: bool, rows: int = 40, segments: int = 3) -> str:
    lines = ["LabVIEW Measurement\t", "Writer_Version\t2", "Separator\tTab", "Multi_Headings\tYes",
             "X_Columns\tOne", "Time_Pref\tRelative", "***End_of_Header***\t", ""]  # fmt: skip
    for segment in range(segments):
        clock = f"10:15:{segment * 0.1:09.6f}"
        lines += ["Channels\t2\t\t\t", f"Samples\t{rows}\t{rows}\t\t"]
        if dated:
            lines += ["Date\t2024/03/09\t2024/03/09\t\t", f"Time\t{clock}\t{clock}\t\t"]
        lines += ["X_Dimension\tTime\tTime\t\t", "X0\t0.0\t0.0\t\t", "Delta_X\t0.002\t0.002\t\t",
                  "***End_of_Header***\t\t\t\t", "X_Value\tVoltage\tDisplacement\tComment"]  # fmt: skip
        begin = 0.0 if restarts else segment * rows * 0.002
        lines += [
            f"{begin + k * 0.002:.6f}\t{k % 7 * 1.5:.3f}\t{k * 0.5:.3f}"
            for k in range(rows)
        ] + [""]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("block_rows", [7, 1 << 16])
@pytest.mark.parametrize(
    ("dated", "restarts", "last"),
    [
        (True, True, 0.278),
        (True, False, 0.238),
        (False, True, 0.238),
        (False, False, 0.238),
    ],
)
def test_header_blocks_among_the_data(
    dated: bool, restarts: bool, last: float, block_rows: int, tmp_path: Path
) -> None:
    path = tmp_path / "log.lvm"
    path.write_text(lvm(dated, restarts))
    want = {role: column_wish(role, option=role) for role in IDENTIFY}
    with open_log(str(path), want, ReadingOptions(block_rows=block_rows)) as log:
        block = log.read()
    assert block.time is not None
    assert len(block) == 120
    assert block.time[-1] == pytest.approx(last, abs=1e-9)
    assert (block.time[1:] > block.time[:-1]).all()
    assert block.values["voltage"].tolist() == [k % 7 * 1.5 for k in range(40)] * 3
    assert log.notes[0].startswith(f"{path}: 2 more headers among the data: ")


def test_a_segment_that_begins_after_midnight_goes_on_by_its_date(
    tmp_path: Path,
) -> None:
    first, second = lvm(dated=True, restarts=True, segments=2).split("Channels", 2)[1:]
    first = first.replace("10:15:00.000000", "23:59:59.900000")
    second = second.replace("10:15:00.100000", "00:00:00.100000").replace(
        "2024/03/09", "2024/03/10"
    )
    path = tmp_path / "log.lvm"
    path.write_text(
        lvm(dated=True, restarts=True).split("Channels")[0]
        + f"Channels{first}Channels{second}"
    )
    with open_log(
        str(path), {role: column_wish(role, option=role) for role in IDENTIFY}
    ) as log:
        time = log.read().time
    assert time is not None
    assert time[40:42].tolist() == pytest.approx([0.2, 0.202], abs=1e-9)
    assert log.notes[0] == (
        f"{path}: 1 more header among the data: their time goes on by the dates and times stated there"
    )


@pytest.mark.whole
@pytest.mark.parametrize(
    "lines", ["fs: 1000.0004\ndt: 1 ms\n", "dt: 1 ms\nfs: 1000.0004\n"]
)
def test_a_stated_unit_of_a_rate_goes_before_an_assumed_one(
    lines: str, tmp_path: Path
) -> None:
    path = tmp_path / "log.txt"
    path.write_text(f"{lines}\nvoltage_V,displacement_um\n0,1\n1,2\n2,4\n")
    with open_log(
        str(path), {role: column_wish(role, option=role) for role in IDENTIFY}
    ) as log:
        assert log.sample_rate == 1000.0
    assert log.notes == []


def test_a_header_block_with_other_columns_is_refused(tmp_path: Path) -> None:
    text = lvm(dated=True, restarts=True)
    begin, names, end = text.rpartition("X_Value\tVoltage\tDisplacement")
    assert names
    with pytest.raises(
        InputError,
        match=r"log\.csv:\d+: a header in the middle of the data names other",
    ):
        opened(tmp_path, begin + "X_Value\tDisplacement\tVoltage" + end)


def test_what_was_read_is_said(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    rows = "".join(f"{k / 500},{k % 90},{k % 7}\n" for k in range(5786))
    path.write_text(f"time_s,CH1 (V),CH2 (um)\n{rows}")
    want = {role: column_wish(role, option=role) for role in IDENTIFY}
    with open_log(str(path), want) as log:
        assert log.opening_line() == (
            f"{path}: time 'time_s' (s), voltage 'CH1 (V)' (V), displacement 'CH2 (um)' (um)"
        )
        log.read()
    assert log.reading_line() == (
        f"{path}: 5,786 rows, 11.6 s at 500 samples/s; time 'time_s' (s), voltage 'CH1 (V)' (V), "
        "displacement 'CH2 (um)' (um)"
    )
    assert json.loads(json.dumps(log.reading_record())) == {
        "rows": 5786,
        "seconds": 11.57,
        "sample_rate": pytest.approx(500.0),
        "time": {"column": "time_s", "unit": "s"},
        "columns": {
            "voltage": {"column": "CH1 (V)", "unit": "V"},
            "displacement": {"column": "CH2 (um)", "unit": "um"},
        },
    }


def test_what_was_read_without_a_clock_or_names(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("1,2\n3,4\n5,6\n")
    want = {
        "voltage": column_wish("voltage", "1"),
        "displacement": column_wish("displacement", "2"),
    }
    for options, told in (
        (
            ReadingOptions(),
            "3 rows, no time; voltage column 1 (no unit), displacement column 2 (no unit)",
        ),
        (
            ReadingOptions(sample_rate=48000.0, scale=("voltage=20",)),
            "3 rows, 4.17e-05 s at 48,000 samples/s (given); voltage column 1 (no unit, times 20), "
            "displacement column 2 (no unit)",
        ),
    ):
        with open_log(str(path), want, options) as log:
            log.read()
        assert log.reading_line() == f"{path}: {told}"


def test_the_page_on_instruments_lists_what_the_program_knows() -> None:
    page = (ROOT / "docs" / "instruments.md").read_text(encoding="utf-8")

    def row(start: str, number: int = 0) -> set[str]:
        lines = [line for line in page.splitlines() if line.startswith(f"| {start} |")]
        return set(re.findall(r"`([^`]+)`", lines[number].split("|")[2]))

    assert row("voltage") == set(columns.VOLTAGE.guesses)
    assert row("displacement, measured") == set(columns.DISPLACEMENT.guesses)
    assert row("desired") == set(columns.DESIRED.guesses)
    assert row("time") == set(columns.TIME_NAMES)
    assert row("time, where none of these is there") == set(columns.MORE_TIME_NAMES)
    assert row("displacement, measured", 1) == set(columns.DISPLACEMENT.letters)
    channels = {"CH1", "Channel A", "ai0", "Input 2"}
    assert row("voltage", 1) - channels | {"ch"} == set(columns.VOLTAGE.by_unit)
    assert row("displacement, measured", 2) | {"ch"} == set(
        columns.DISPLACEMENT.by_unit
    )
    assert row("desired", 1) == set(columns.DESIRED.by_unit)
    assert row("displacement, measured", 3) == columns.DISPLACEMENT.contrary
    assert row("voltage", 2) == columns.VOLTAGE.contrary
    assert row("desired", 2) == columns.DESIRED.contrary
    for unit, spellings in units.SPELLINGS.items():
        assert row(unit) == set(spellings)
    for calendar in (*clock._CALENDARS, *clock._DAY_CALENDARS):
        assert f"| {calendar.name}" in page


@pytest.mark.parametrize("seed", [11, 12])
def test_changed_headers_are_read_right_or_something_is_said(
    seed: int, tmp_path: Path
) -> None:
    fuzz = HeaderFuzz(seed, tmp_path)
    fuzz.run(400)
    assert fuzz.failures == []
    assert set(fuzz.outcomes) == {"right", "refused", "warned", "said in the line"}
    assert fuzz.outcomes["right"] > 120


def test_a_header_with_one_name_too_few_is_not_taken_apart_at_its_words(
    tmp_path: Path,
) -> None:
    path = tmp_path / "log.tsv"
    rows = "".join(f"{k}.5\t{k}.25\t{k}.75\t{k}.125\n" for k in range(9))
    path.write_text(f"Desired (um)\ty/micron\tu/volts\n{rows}")
    with pytest.raises(
        InputError, match=r":2: 4 cells where the header names 3 columns"
    ):
        open_log(str(path), {"voltage": column_wish("voltage")})


@pytest.mark.parametrize(
    ("first", "row", "asked"),
    [
        ("0,1,2", "0.5,{k},{k}.5", True),
        ("1,2,3", "0.5,{k}.25,{k}.5", True),
        (",0,1,2", "{k},0.5,{k}.0,{k}.5", True),
        ("0,1", "0.5,{k}.5", True),
        ("0,1", "0.5,{k}", False),
        ("0,1,2", "{k},{k},{k}", False),
        ("0,2,1", "0.5,{k}.25,{k}.5", False),
    ],
)
def test_a_row_that_counts_the_columns(
    first: str, row: str, asked: bool, tmp_path: Path
) -> None:
    path = tmp_path / "log.csv"
    path.write_text(first + "\n" + "".join(row.format(k=k) + "\n" for k in range(9)))
    want = {"voltage": column_wish("voltage", "number=2", option="voltage")}
    if asked:
        with pytest.raises(
            InputError, match=r"counts the columns: are these names or a sample\?"
        ):
            open_log(str(path), want)
    else:
        open_log(str(path), want).close()
    for lines, count in ((0, 10), (1, 9)):
        with open_log(str(path), want, ReadingOptions(header_lines=lines)) as log:
            assert len(log.read()) == count


@pytest.mark.parametrize(
    ("bad", "remedy"),
    [
        (
            range(30, 100),
            "(and so on in 69 of the next 69 rows: name another column, or take good `rows` A:B)",
        ),
        (range(30, 100, 2), "(`skip_bad` drops such rows)"),
        (range(90, 100), "(`skip_bad` drops such rows)"),
    ],
)
def test_dropping_is_no_remedy_where_most_of_a_log_would_go(
    tmp_path: Path, bad: range, remedy: str
) -> None:
    rows = [f"{k / 100},{k},{'OVLD' if k in bad else k}" for k in range(100)]
    (tmp_path / "log.csv").write_text(
        "\n".join(["time_s,voltage_V,displacement_um", *rows]) + "\n"
    )
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["time"], file["voltage"] = np.arange(100) / 100, np.arange(100.0)
        file["displacement"] = np.where(
            np.isin(np.arange(100), bad), np.nan, np.arange(100.0)
        )
    want = {role: column_wish(role, option=role) for role in IDENTIFY}
    for name in ("log.csv", "log.h5"):
        with (
            pytest.raises(InputError) as raised,
            open_log(str(tmp_path / name), want) as log,
        ):
            log.read()
        assert str(raised.value).endswith(remedy)
