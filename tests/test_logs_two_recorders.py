"""Two recorders, one log: joined by time at any rates, their clocks' offset and drift found, or refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from dbo_cli.errors import InputError, UsageError
from dbo_cli.logs.clock_offset import _Fit, _require_sure, find_offset
from dbo_cli.logs.columns import ColumnWish
from dbo_cli.logs.request import ReadingOptions
from dbo_cli.logs.sample_block import FloatArray, SampleBlock
from dbo_cli.logs.signal_log import open_log


def drive(time: FloatArray, slowest: float) -> FloatArray:
    """Return a drive (V) without a period: three tones, the slowest in Hz."""
    tones = ((1.0, 25.0, 0.3), (1.37, 13.0, 1.0), (2.71, 7.0, 2.0))
    volts = 50.0 + 0.0 * time
    for ratio, size, phase in tones:
        volts += size * np.sin(2.0 * np.pi * slowest * ratio * time + phase)
    return volts


def sensor(time: FloatArray, slowest: float, seed: int = 0) -> FloatArray:
    """Return what a stack with a loop shows (um): plays of the drive, followed on a fine clock, and noise."""
    fine = np.linspace(time[0] - 1.0 / slowest, time[-1], 40_000)
    volts = drive(fine, slowest)
    radii = np.linspace(0.0, 30.0, 16)
    held, moved = np.full(16, volts[0]), np.empty(fine.size)
    weights = np.exp(-radii / 8.0)
    for k, value in enumerate(volts.tolist()):
        held = np.minimum(np.maximum(held, value - radii), value + radii)
        moved[k] = weights @ held
    moved *= 0.1 / weights.sum()
    noise = np.random.default_rng(seed).normal(size=time.size)
    return np.interp(time, fine, moved) + 0.003 * noise


class Pair(NamedTuple):
    """Two recorders of one move: rates (Hz), seconds, and how the drive's clock differs."""

    sensor_rate: float
    drive_rate: float
    seconds: float
    slowest: float
    offset: float = 0.0
    ppm: float = 0.0
    later: float = 0.0  # s, by which the drive's recorder begins
    gap: tuple[float, float] | None = None
    asked: float | str | None = None


PAIRS = {
    "5 and 2 kHz": Pair(5000.0, 2000.0, 2.0, 5.0),
    "2 and 5 kHz": Pair(2000.0, 5000.0, 2.0, 5.0),
    "100 Hz beside 100 kHz": Pair(100.0, 100_000.0, 0.8, 2.0),
    "100 kHz beside 1 kHz": Pair(100_000.0, 1000.0, 0.5, 8.0),
    "rates that do not divide": Pair(441.0, 1000.0, 4.0, 3.0),
    "another start": Pair(500.0, 400.0, 5.0, 2.0, later=1.3),
    "a gap": Pair(500.0, 400.0, 5.0, 2.0, gap=(2.0, 2.5)),
    "2 s typed": Pair(500.0, 400.0, 8.0, 1.0, offset=2.0, asked=2.0),
    "-2 s typed": Pair(500.0, 400.0, 8.0, 1.0, offset=-2.0, asked=-2.0),
    "2 s found": Pair(200.0, 500.0, 12.0, 0.7, offset=2.0, asked="auto"),
    "-2 s found, another start": Pair(
        500.0, 200.0, 12.0, 0.7, offset=-2.0, later=1.0, asked="auto"
    ),
    "82 ms found": Pair(250.0, 250.0, 12.0, 0.7, offset=0.082, asked="auto"),
    "50 ppm found": Pair(1000.0, 1000.0, 60.0, 1.5, offset=0.5, ppm=50.0, asked="auto"),
}


def write(path: Path, header: str, *columns: FloatArray) -> str:
    rows = zip(*(column.tolist() for column in columns), strict=True)
    path.write_text("\n".join([header, *(",".join(map(repr, row)) for row in rows)]))
    return str(path)


def recorded(pair: Pair, folder: Path) -> tuple[str, str]:
    """Write what both recorders have; return the files of sensor and drive."""
    seen = np.arange(0.0, pair.seconds, 1.0 / pair.sensor_rate)
    sent = np.arange(
        pair.later, pair.seconds + 1.0 / pair.drive_rate, 1.0 / pair.drive_rate
    )
    if pair.gap is not None:
        sent = sent[(sent < pair.gap[0]) | (sent > pair.gap[1])]
    theirs = sent - pair.offset - 1e-6 * pair.ppm * (sent - 0.5 * pair.seconds)
    displacement = write(
        folder / "sensor.csv",
        "time_s,displacement_um",
        seen,
        sensor(seen, pair.slowest),
    )
    voltage = write(
        folder / "drive.csv", "time_s,voltage_V", theirs, drive(sent, pair.slowest)
    )
    return displacement, voltage


def read(
    displacement: str, voltage: str, **options: Any
) -> tuple[SampleBlock, list[str], list[str]]:
    wishes = {
        "voltage": ColumnWish(f"{voltage}::voltage_V", ("voltage",), option="voltage"),
        "displacement": ColumnWish(None, ("displacement",), option="displacement"),
    }
    with open_log(displacement, wishes, ReadingOptions(**options)) as log:
        return log.read(), log.notes, log.warnings


@pytest.mark.parametrize("name", PAIRS)
def test_two_recorders_are_joined_by_time(name: str, tmp_path: Path) -> None:
    pair = PAIRS[name]
    block, notes, warnings = read(*recorded(pair, tmp_path), clock_offset=pair.asked)
    assert block.time is not None
    fifth = 0.2 / min(pair.sensor_rate, pair.drive_rate)
    away = block.values["voltage"] - drive(block.time, pair.slowest)
    speed = np.abs(np.gradient(drive(block.time, pair.slowest), block.time)).max()
    allowed = 1e-4 * 45.0 if pair.asked != "auto" else fifth * speed
    assert np.abs(away).max() <= allowed
    assert not [text for text in warnings if "apart" in text or "faster" in text]
    assert any("joined by time" in text for text in notes)
    if pair.later:
        assert block.time[0] >= pair.later - 1.0 / pair.sensor_rate
        assert any("before it begins" in text for text in notes)
    if pair.gap is not None:
        assert not (
            (block.time > pair.gap[0] + 0.01) & (block.time < pair.gap[1] - 0.01)
        ).any()
        assert any("in its gaps" in text for text in notes)
    if pair.ppm:
        assert any("ppm" in text for text in notes)


def test_clocks_that_are_apart_are_told_of(tmp_path: Path) -> None:
    files = recorded(PAIRS["82 ms found"], tmp_path)
    _, _, warnings = read(*files)
    assert (
        len(
            [
                text
                for text in warnings
                if "by what they recorded their clocks are 0.082" in text
            ]
        )
        == 1
    )


def test_clocks_without_a_moment_in_common_are_refused(tmp_path: Path) -> None:
    displacement, voltage = recorded(
        PAIRS["5 and 2 kHz"]._replace(offset=1.7e9), tmp_path
    )
    with pytest.raises(InputError) as raised:
        read(displacement, voltage)
    assert "have no time in common: 0 to 1.9998 s and " in str(raised.value)
    assert "`clock_offset` 1700000000 lets both begin together, auto finds it" in str(
        raised.value
    )


def test_a_file_without_a_clock_is_refused(tmp_path: Path) -> None:
    displacement, _ = recorded(PAIRS["5 and 2 kHz"], tmp_path)
    voltage = write(
        tmp_path / "bare.csv", "voltage_V,current_A", np.arange(10.0), np.arange(10.0)
    )
    with pytest.raises(
        InputError,
        match=r"bare\.csv: has no clock, and rows of two files belong together by time",
    ):
        read(displacement, voltage)
    with pytest.raises(InputError, match=r"^the files are not equally long: "):
        read(displacement, voltage, sample_rate=5000.0)


def test_an_offset_that_the_log_cannot_tell_is_refused() -> None:
    """A sine repeats itself; a drive that stands still tells nothing; noise is no displacement."""
    time = np.arange(0.0, 20.0, 0.005)
    sine = 50.0 + 40.0 * np.sin(2.0 * np.pi * time)
    noise = np.random.default_rng(0).normal(size=time.size)
    with pytest.raises(InputError, match="the drive repeats itself"):
        find_offset(time, sine, time + 0.3, 0.1 * sine + 1e-3 * noise, "two files")
    with pytest.raises(InputError, match="one of the two stands still"):
        find_offset(time, np.full(time.size, 3.0), time, sine, "two files")
    with pytest.raises(
        InputError, match=r"clock_offset` auto (finds no offset|cannot tell)"
    ):
        find_offset(time, drive(time, 0.7), time, noise, "two files")


def test_an_offset_needs_two_files(tmp_path: Path) -> None:
    displacement, _ = recorded(PAIRS["5 and 2 kHz"], tmp_path)
    wishes = {
        "displacement": ColumnWish(None, ("displacement",), option="displacement")
    }
    with pytest.raises(UsageError, match="`clock_offset` joins two files"):
        open_log(displacement, wishes, ReadingOptions(clock_offset=1.0))


def test_an_unsure_offset_is_refused_with_the_fifth_it_is_measured_by() -> None:
    fit = _Fit(
        offset=0.3,
        residual=0.0,
        deviation=0.0019,
        drift=0.0,
        drift_deviation=1.0,
        about=0.0,
    )
    message = r"two: .* 0.3 s, but uncertain by 0.0038 s, more than 0.002 s, a fifth of a sample \(give "
    with pytest.raises(InputError, match=message):
        _require_sure(fit, [], 0.01, "two")
