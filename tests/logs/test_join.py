"""Two recorders, one log: joined by time at any rates, their clocks' offset found or refused."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import dbo_cli
from dbo_cli.arrays import Floats
from dbo_cli.errors import DboWarning, InputError, UsageError
from dbo_cli.logs.log import Log, open_log
from dbo_cli.logs.table import Block, Reading

ROLES = {"voltage": None, "displacement": None}


def drive(time: Floats, slowest: float) -> Floats:
    """Return a drive (V) without a period: three tones, the slowest in Hz."""
    tones = ((1.0, 25.0, 0.3), (1.37, 13.0, 1.0), (2.71, 7.0, 2.0))
    volts = 50.0 + 0.0 * time
    for ratio, size, phase in tones:
        volts += size * np.sin(2.0 * np.pi * slowest * ratio * time + phase)
    return volts


def sensor(time: Floats, slowest: float, noise: float = 0.003) -> Floats:
    """Return what a stack with a loop shows (um): plays of the drive, followed on a fine clock."""
    fine = np.linspace(time[0] - 1.0 / slowest, time[-1], 15_000)
    radii = np.linspace(0.0, 30.0, 16)
    weights = np.exp(-radii / 8.0)
    held = np.full(16, drive(fine[:1], slowest)[0])
    moved = np.empty(fine.size)
    for k, value in enumerate(drive(fine, slowest).tolist()):
        held = np.minimum(np.maximum(held, value - radii), value + radii)
        moved[k] = weights @ held
    moved *= 0.1 / weights.sum()
    return np.interp(time, fine, moved) + noise * np.random.default_rng(0).normal(
        size=time.size
    )


class Pair(NamedTuple):
    """Two recorders of one move: rates (Hz), seconds, and how the drive's clock differs."""

    sensor_rate: float
    drive_rate: float
    seconds: float
    slowest: float
    offset: float = 0.0
    later: float = 0.0  # s, by which the drive's recorder begins
    gap: tuple[float, float] | None = None
    asked: float | str | None = None


PAIRS = {
    "5 and 2 kHz": Pair(5000.0, 2000.0, 2.0, 5.0),
    "100 kHz beside 1 kHz": Pair(100_000.0, 1000.0, 0.5, 8.0),
    "another start": Pair(500.0, 400.0, 5.0, 2.0, later=1.3),
    "a gap": Pair(500.0, 400.0, 5.0, 2.0, gap=(2.0, 2.5)),
    "-2 s typed": Pair(500.0, 400.0, 8.0, 1.0, offset=-2.0, asked=-2.0),
    "2 s found": Pair(200.0, 500.0, 12.0, 0.7, offset=2.0, asked="auto"),
    "-2 s, another start": Pair(500.0, 200.0, 12.0, 0.7, offset=-2.0, later=1.0, asked="auto"),
    "82 ms found": Pair(250.0, 250.0, 12.0, 0.7, offset=0.082, asked="auto"),
}  # fmt: skip


def write(path: Path, header: str, *columns: Floats) -> Path:
    np.savetxt(path, np.column_stack(columns), "%.17g", ",", header=header, comments="")
    return path


def recorded(pair: Pair, folder: Path) -> tuple[Path, Path]:
    """Write what both recorders have; return the files of sensor and drive."""
    seen = np.arange(0.0, pair.seconds, 1.0 / pair.sensor_rate)
    sent = np.arange(
        pair.later, pair.seconds + 1.0 / pair.drive_rate, 1.0 / pair.drive_rate
    )
    if pair.gap is not None:
        sent = sent[(sent < pair.gap[0]) | (sent > pair.gap[1])]
    shown = sensor(seen, pair.slowest)
    volts = drive(sent, pair.slowest)
    displacement = write(folder / "sensor.csv", "time_s,displacement_um", seen, shown)
    return displacement, write(
        folder / "drive.csv", "time_s,voltage_V", sent - pair.offset, volts
    )


def read(
    displacement: Path, voltage: Path, reading: Reading | None = None
) -> tuple[Log, Block]:
    roles = {"voltage": f"{voltage}::voltage_V", "displacement": None}
    with open_log(displacement, roles, reading) as log:
        return log, log.read()


@pytest.mark.parametrize("name", PAIRS)
def test_two_recorders_are_joined_by_time(name: str, tmp_path: Path) -> None:
    pair = PAIRS[name]
    with warnings.catch_warnings():
        warnings.simplefilter("error", DboWarning)
        if pair.gap is not None:
            warnings.filterwarnings("ignore", ".*1 gap in time", DboWarning)
        log, table = read(*recorded(pair, tmp_path), Reading(clock_offset=pair.asked))
    assert table.time is not None
    wanted = drive(table.time, pair.slowest)
    slope = np.abs(np.gradient(wanted, table.time)).max()
    bend = np.abs(np.gradient(np.gradient(wanted, table.time), table.time)).max()
    allowed = 1e-9 + bend / pair.drive_rate**2 / 4.0  # of linear interpolation
    if pair.asked == "auto":
        allowed += slope * 0.2 / min(pair.sensor_rate, pair.drive_rate)
    assert np.abs(table["voltage"] - wanted).max() <= allowed
    assert table.time[0] >= pair.later
    assert table.time[0] - pair.later <= 1.01 / pair.sensor_rate
    if pair.gap is not None:
        assert not (
            (table.time > pair.gap[0] + 0.01) & (table.time < pair.gap[1] - 0.01)
        ).any()
        assert isinstance(table.dt, np.ndarray)
        assert table.dt.max() > 0.49
    assert (log.clock.offset is not None) == (pair.asked is not None)
    if pair.asked == "auto":
        assert log.clock.offset is not None
        assert log.clock.holds_delay
        error = abs(log.clock.offset - pair.offset)
        assert error <= 0.1 / min(pair.sensor_rate, pair.drive_rate)
        assert "moved by" in log.line()


def test_the_drive_as_the_first_file_changes_nothing(tmp_path: Path) -> None:
    displacement, voltage = recorded(PAIRS["5 and 2 kHz"], tmp_path)
    _, table = read(displacement, voltage)
    roles = {"voltage": None, "displacement": f"{displacement}::displacement_um"}
    with open_log(voltage, roles) as log:
        other = log.read()
    np.testing.assert_array_equal(table.time, other.time)
    np.testing.assert_array_equal(table["voltage"], other["voltage"])
    np.testing.assert_array_equal(table["displacement"], other["displacement"])


def test_clocks_that_are_apart_are_told_of(tmp_path: Path) -> None:
    files = recorded(PAIRS["82 ms found"], tmp_path)
    with pytest.warns(DboWarning, match=r"do not line up.*0\.082.*`clock_offset` auto"):
        read(*files)


SAMPLE = Path(__file__).parents[2] / "sample_data" / "identification.csv"


def split_sample(folder: Path, offset: float) -> tuple[Path, Path]:
    """Split the sample log in two: a sensor of 500 Hz, a drive of 800 Hz with an early clock."""
    time, volts, moved = np.loadtxt(SAMPLE, delimiter=",", skiprows=1).T
    sent = np.arange(0.0, time[-1], 1.0 / 800.0)
    seen = write(folder / "sensor.csv", "time_s,displacement_um", time, moved)
    volts = np.interp(sent, time, volts)
    return seen, write(folder / "drive.csv", "time_s,voltage_V", sent - offset, volts)


@pytest.mark.parametrize("offset", [0.37, -0.37, -0.02, 0.0])
def test_the_sample_is_told_of_unless_it_lines_up(
    offset: float, tmp_path: Path
) -> None:
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", DboWarning)
        read(*split_sample(tmp_path, offset))
    told = [str(one.message) for one in said if "line up" in str(one.message)]
    assert len(told) == (offset != 0.0)
    sign = "+" if offset > 0.0 else "-"
    for text in told:
        assert f"by {sign}0." in text
        assert "try `clock_offset` auto" in text


def test_where_it_cannot_tell_how_much_it_still_tells_that(tmp_path: Path) -> None:
    """A drive that repeats itself, by the third of a period late: no offset, but a warning."""
    time = np.arange(0.0, 10.0, 2e-3)
    volts = 50.0 - 50.0 * np.cos(2.0 * np.pi * time)
    seen = write(tmp_path / "sensor.csv", "time_s,displacement_um", time, 0.1 * volts)
    sent = write(tmp_path / "drive.csv", "time_s,voltage_V", time - 0.3, volts)
    with pytest.warns(DboWarning, match="line up"):
        read(seen, sent)
    with pytest.raises(InputError, match="fit equally"):
        read(seen, sent, Reading(clock_offset="auto"))


def test_what_cannot_tell_is_refused(tmp_path: Path) -> None:
    time = np.arange(0.0, 10.0, 1e-2)
    moved = sensor(time, 0.7)
    noise = np.random.default_rng(1).normal(size=time.size)
    periodic = 50.0 + 50.0 * np.sin(2.0 * np.pi * time)
    cases = {
        "both move": (np.full(time.size, 3.0), moved),
        "explain": (drive(time, 0.7), noise),
        "fit equally": (periodic, 0.1 * periodic),
        "uncertain": (drive(time, 0.7), moved + 0.4 * noise),
    }
    for words, (volts, shown) in cases.items():
        seen = write(tmp_path / "sensor.csv", "time_s,displacement_um", time, shown)
        sent = write(tmp_path / "drive.csv", "time_s,voltage_V", time, volts)
        with pytest.raises(InputError, match=words):
            read(seen, sent, Reading(clock_offset="auto"))


def test_files_that_cannot_be_joined(tmp_path: Path) -> None:
    time = np.arange(100.0) / 10.0
    seen = write(tmp_path / "sensor.csv", "time_s,displacement_um", time, time)
    late = write(tmp_path / "late.csv", "time_s,voltage_V", time + 60.0, time)
    bare = write(tmp_path / "bare.csv", "voltage_V", time)
    dated = tmp_path / "dated.csv"
    lines = ["time,voltage_V"]
    for second in range(60):
        lines.append(f"2026-01-02T03:04:{second:02d}.000,{second}")
    dated.write_text("\n".join(lines) + "\n")
    for file, words in [
        (late, "no time in common.*-60"),
        (bare, "no clock"),
        (dated, "dates"),
    ]:
        with pytest.raises(InputError, match=words):
            read(seen, file)
    _, table = read(seen, late, Reading(clock_offset=-60.0))
    np.testing.assert_allclose(table["voltage"], table["displacement"], atol=1e-12)
    roles = {
        "voltage": f"{late}::voltage_V",
        "displacement": None,
        "desired": f"{dated}::voltage_V",
    }
    with pytest.raises(UsageError, match="one more file"):
        open_log(seen, roles, Reading(clock_offset=1.0))


def test_a_model_of_a_found_offset_has_no_delay(tmp_path: Path) -> None:
    seen, sent = split_sample(tmp_path, 0.37)
    log = {"voltage": f"{sent}::voltage_V", "clock_offset": "auto"}
    frame = dbo_cli.read_log(seen, **log)
    assert frame.attrs["holds_delay"]
    assert dbo_cli.identify(frame).actuator.delay is None


def test_stamps_of_two_files_are_one_clock(tmp_path: Path) -> None:
    def stamped(name: str, first: int, header: str) -> Path:
        lines = [f"time,{header}"]
        for second in range(first, first + 40):
            lines.append(f"2026-01-02T03:04:{second:02d}.500,{second}")
        (tmp_path / name).write_text("\n".join(lines) + "\n")
        return tmp_path / name

    _, table = read(
        stamped("s.csv", 0, "displacement_um"), stamped("d.csv", 10, "voltage_V")
    )
    np.testing.assert_array_equal(table["voltage"], table["displacement"])
    assert len(table) == 30
    assert table.time is not None
    assert table.time[0] == 10.0
