"""One log in two files: `voltage` FILE::COLUMN."""

from __future__ import annotations

import hashlib
from pathlib import Path

import h5py
import pytest

from dbo_cli.cli.app import main
from dbo_cli.errors import InputError
from dbo_cli.logs.columns import ColumnWish
from dbo_cli.logs.request import ReadingOptions
from dbo_cli.logs.signal_log import SignalLog, open_log
from tests.shapes.format_files import D, T, V
from tests.shapes.instrument_files import _TEK, TEK_T, TEK_V, beside, rows

MODEL = Path(__file__).parent / "old_files" / "model-v1.json"


def write(path: Path, header: str, *columns: tuple[float, ...]) -> Path:
    path.write_text("\n".join([header, *rows(",", columns)]) + "\n")
    return path


def joined(
    first: Path | str, voltage: str, displacement: str | None = None, **options: object
) -> SignalLog:
    want = {
        "voltage": ColumnWish(voltage, ("voltage",), option="voltage"),
        "displacement": ColumnWish(
            displacement, ("displacement", "position"), option="displacement"
        ),
    }
    return open_log(str(first), want, ReadingOptions(**options))  # type: ignore[arg-type]


@pytest.mark.parametrize("block_rows", [1, 2, 3, 100])
@pytest.mark.parametrize("drive_time", ["time_s", "time_ms", None])
@pytest.mark.parametrize("sensor_time", ["time_s", None])
def test_columns_of_two_files(
    drive_time: str | None, sensor_time: str | None, block_rows: int, tmp_path: Path
) -> None:
    stamps = {"time_s": T, "time_ms": tuple(1000 * t for t in T)}
    sensor = (
        [("displacement_um", D)]
        if sensor_time is None
        else [("time_s", T), ("displacement_um", D)]
    )
    drive = (
        [("CH1 (V)", V)]
        if drive_time is None
        else [(drive_time, stamps[drive_time]), ("CH1 (V)", V)]
    )
    first = write(
        tmp_path / "sensor.csv",
        ",".join(name for name, _ in sensor),
        *(v for _, v in sensor),
    )
    other = write(
        tmp_path / "drive.csv",
        ",".join(name for name, _ in drive),
        *(v for _, v in drive),
    )
    known = {}
    if drive_time is None or sensor_time is None:
        without = first if sensor_time is None else other
        with (
            pytest.raises(InputError) as raised,
            joined(first, f"{other}::CH1", block_rows=block_rows) as log,
        ):
            log.read()
        assert str(raised.value) == (
            f"{without}: has no clock, and rows of two files belong together by time (`time` COLUMN names "
            "it; where both were recorded row by row, `sample_rate` HZ or `time` FILE::COLUMN is the clock "
            "of both)"
        )
        known = {"sample_rate": 1000.0}
    with joined(first, f"{other}::CH1", block_rows=block_rows, **known) as log:
        block = log.read()
    assert block.values["voltage"].tolist() == list(V)
    assert block.values["displacement"].tolist() == list(D)
    assert (log.columns["voltage"].unit, log.columns["displacement"].unit) == (
        "V",
        "um",
    )
    assert log.columns["voltage"].name == f"{other}::CH1 (V)"
    assert block.time is not None and block.time.tolist() == list(T)


def test_clocks_that_disagree_are_joined_by_time(tmp_path: Path) -> None:
    first = write(tmp_path / "sensor.csv", "time_s,displacement_um", T, D)
    other = write(
        tmp_path / "drive.csv",
        "time_s,voltage_V",
        (*T[:2], 0.0025, 0.0035),
        (0.0, 1.0, 2.5, 3.5),
    )
    with joined(first, f"{other}::voltage") as log:
        block = log.read()
    assert block.values["voltage"].tolist() == pytest.approx(
        [0.0, 1.0, 2.0, 3.0], rel=1e-12
    )
    assert log.notes == [
        f"{other}: 'voltage_V' joined by time: interpolated onto the rows of {first}",
    ]
    with joined(first, f"{other}::voltage", sample_rate=1000.0) as log:
        block = log.read()
    assert block.values["voltage"].tolist() == [0.0, 1.0, 2.5, 3.5]
    assert block.time is not None and block.time.tolist() == list(T)


@pytest.mark.whole
def test_rates_that_disagree_are_joined_by_time(tmp_path: Path) -> None:
    first, other = tmp_path / "sensor.csv", tmp_path / "drive.csv"
    first.write_text(
        "\n".join(
            ["Sample rate: 1 kHz", "displacement_um,error_um", *rows(",", (D, D))]
        )
        + "\n"
    )
    ramp = tuple(float(k) for k in range(8))
    other.write_text(
        "\n".join(
            ["Sample rate: 2 kHz", "voltage_V,current_A", *rows(",", (ramp, ramp))]
        )
        + "\n"
    )
    with joined(first, f"{other}::voltage", "displacement") as log:
        block = log.read()
    assert block.values["voltage"].tolist() == [0.0, 2.0, 4.0, 6.0]
    assert block.time is not None and block.time.tolist() == list(T)


@pytest.mark.parametrize("short", ["sensor", "drive"])
@pytest.mark.parametrize("block_rows", [1, 3, 100])
def test_files_of_unequal_length_are_refused(
    short: str, block_rows: int, tmp_path: Path
) -> None:
    lengths = {"sensor": 4, "drive": 4} | {short: 2}
    d, v = D[: lengths["sensor"]], V[: lengths["drive"]]
    first = write(tmp_path / "sensor.csv", "x_um,displacement_um", d, d)
    other = write(tmp_path / "drive.csv", "y_um,voltage_V", v, v)
    selector = f"{other}::voltage"
    known = {"block_rows": block_rows, "sample_rate": 1000.0}
    with pytest.raises(InputError) as raised, joined(first, selector, **known) as log:
        log.read()
    told = f"{first} {lengths['sensor']}, {other} {lengths['drive']}"
    assert (
        str(raised.value)
        == f"the files are not equally long: {told} rows (`rows` A:B cuts all of them)"
    )
    with joined(first, f"{other}::voltage", rows=(1, 2), **known) as log:
        assert log.read().values["voltage"].tolist() == list(V[:2])


@pytest.mark.parametrize("block_rows", [1, 3, 100])
def test_a_bad_row_of_one_file_is_dropped_from_both(
    block_rows: int, tmp_path: Path
) -> None:
    first, other = tmp_path / "sensor.csv", tmp_path / "drive.csv"
    first.write_text(
        "time_s,displacement_um\n0,10.25\n0.001,oops\n0.002,9.125\n0.003,8\n"
    )
    other.write_text("time_s,voltage_V\n0,0\n0.001,1.5\n0.002,\n0.003,4\n")
    with joined(
        first, f"{other}::voltage", skip_bad=True, block_rows=block_rows
    ) as log:
        block = log.read()
    assert block.values["voltage"].tolist() == [0.0, 4.0]
    assert block.values["displacement"].tolist() == [10.25, 8.0]
    assert list(block.rows) == [1, 4]
    assert block.lines is not None and list(block.lines) == [2, 5]
    assert len(log.notes) == 4  # and that the drive was joined by time, and lacks row 3


def test_an_hdf5_dataset_beside_a_text_file(tmp_path: Path) -> None:
    first = write(tmp_path / "sensor.csv", "time_s,displacement_um", T, D)
    with h5py.File(tmp_path / "drive.h5", "w") as file:
        file["run/a/voltage"], file["run/b/voltage"] = V, D
    for path in ("/run/a/voltage", "/run/a::voltage"):
        with joined(first, f"{tmp_path}/drive.h5::{path}", sample_rate=1000.0) as log:
            assert log.read().values["voltage"].tolist() == list(V)


@pytest.mark.parametrize("block_rows", [1, 3, 100])
@pytest.mark.parametrize("where", ["drive", "clock"])
def test_the_time_lies_in_another_file(
    where: str, block_rows: int, tmp_path: Path
) -> None:
    first = write(tmp_path / "sensor.csv", "displacement_um", D)
    if where == "drive":
        other = clock = write(
            tmp_path / "drive.csv",
            "n,stamps,CH1 (V)",
            range(4),
            [1000 * t for t in T],
            V,
        )
    else:
        other = write(tmp_path / "drive.csv", "CH1 (V)", V)
        clock = write(tmp_path / "clock.csv", "stamps", [1000 * t for t in T])
    said = {"time": f"{clock}::stamps", "time_unit": "ms", "block_rows": block_rows}
    with joined(first, f"{other}::CH1", **said) as log:
        block = log.read()
        record, read = log.record(), log.reading_record()
    assert block.time is not None and block.time.tolist() == list(T)
    assert block.values["voltage"].tolist() == list(V)
    assert [one["name"] for one in record["joined"]] == list(
        dict.fromkeys([other.name, clock.name])
    )
    assert (
        record["joined"][0]["sha256"] == hashlib.sha256(other.read_bytes()).hexdigest()
    )
    assert read["time"]["column"] == f"{clock.name}::stamps"  # without the folder
    assert read["columns"]["voltage"]["column"] == "drive.csv::CH1 (V)"


def test_a_unit_of_time_where_only_the_other_file_has_a_clock(tmp_path: Path) -> None:
    first = write(tmp_path / "sensor.csv", "displacement_um", D)
    other = write(tmp_path / "drive.csv", "time,voltage", [1000 * t for t in T], V)
    with joined(
        first, f"{other}::voltage", time=f"{other}::time", time_unit="ms"
    ) as log:
        block = log.read()
    assert block.time is not None and block.time.tolist() == list(T)


@pytest.mark.parametrize(
    ("selector", "said"),
    [
        (
            "none.csv::t",
            "none.csv: no such file (`time` FILE::COLUMN takes a column of another file)",
        ),
        ("drive.csv::q", "drive.csv: there is no column 'q': it has 1 voltage_V"),
    ],
)
def test_a_time_that_is_not_there(selector: str, said: str, tmp_path: Path) -> None:
    first = write(tmp_path / "sensor.csv", "displacement_um", D)
    other = write(tmp_path / "drive.csv", "voltage_V", V)
    with pytest.raises(InputError) as raised:
        joined(first, f"{other}::voltage", time=f"{tmp_path}/{selector}")
    assert str(raised.value) == f"{tmp_path}/{said}"


def test_no_output_over_a_file_that_a_column_comes_from(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "sensor.csv", "displacement_um", D)
    write(tmp_path / "drive", "voltage_V", V)
    before = (tmp_path / "drive").read_bytes()
    said = "drive: this output is also an input: write to another file"
    for words in (
        ["identify", "sensor.csv", "--voltage", "drive::voltage"],
        ["simulate", str(MODEL), "sensor.csv", "--input", "drive::voltage"],
        ["compensate", str(MODEL), "sensor.csv", "--displacement", "drive::voltage"],
        ["report", "sensor.csv", "--desired", "drive::voltage"],
    ):
        assert main([*words, "-o", "drive"]) == 2
        assert capsys.readouterr().err == f"dbo: error: {said}\n"
    assert (tmp_path / "drive").read_bytes() == before
    words = [
        "simulate",
        str(MODEL),
        "sensor.csv",
        "--input",
        "drive::voltage",
        "--sample-rate",
        "1000",
    ]
    assert main(words) == 0
    # not the file's name
    assert capsys.readouterr().out.startswith("time_s,voltage_V,")


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    first = write(tmp_path / "sensor.csv", "time_s,displacement_um", T, D)
    with pytest.raises(InputError) as raised:
        joined(first, f"{tmp_path}/none.csv::voltage")
    assert str(raised.value) == (
        f"{tmp_path}/none.csv: no such file (`voltage` FILE::COLUMN takes a column of another file)"
    )


@pytest.mark.whole
def test_two_channels_of_a_tektronix_oscilloscope(tmp_path: Path) -> None:
    first, other = tmp_path / "F0001CH2.CSV", tmp_path / "F0001CH1.CSV"
    second = [line.replace("Source,CH1", "Source,CH2") for line in _TEK]
    first.write_text("\n".join(beside(second, rows(",", (TEK_T, TEK_T)))) + "\n")
    other.write_text("\n".join(beside(_TEK, rows(",", (TEK_T, TEK_V)))) + "\n")
    with joined(first, f"{other}::CH1", "CH2") as log:
        block = log.read()
    assert block.values["voltage"].tolist() == list(TEK_V)
    assert block.time is not None and block.time.tolist() == list(TEK_T)
