"""Two recorders, one log: joined by time at any rates, their clocks' offset found or refused."""

import numpy as np
import pytest
from contract.program import write

from dbo_cli.errors import DboWarning, InputError, UsageError
from dbo_cli.logs.log import open_log
from dbo_cli.logs.table import Reading

TIME = np.arange(0.0, 10.0, 1e-2)
TONES = ((0.7, 25.0, 0.3), (0.96, 13.0, 1.0), (1.9, 7.0, 2.0))
DRIVE = 50.0 + sum(
    size * np.sin(2.0 * np.pi * hertz * TIME + phase) for hertz, size, phase in TONES
)


def read(displacement, voltage, reading=None):
    roles = {"voltage": f"{voltage}::voltage_V", "displacement": None}
    with open_log(displacement, roles, reading) as log:
        return log, log.read()


def test_the_drive_as_the_first_file_changes_nothing(tmp_path):
    path = tmp_path / "sensor.csv"
    displacement = write(path, "time_s,displacement_um", TIME, 0.1 * DRIVE)
    fine = np.arange(0.3, 9.0, 1.0 / 370.0)
    volts = np.interp(fine, TIME, DRIVE)
    voltage = write(tmp_path / "drive.csv", "time_s,voltage_V", fine, volts)
    _, table = read(displacement, voltage)
    roles = {"voltage": None, "displacement": f"{displacement}::displacement_um"}
    with open_log(voltage, roles) as log:
        other = log.read()
    np.testing.assert_array_equal(table.time, other.time)
    np.testing.assert_array_equal(table["voltage"], other["voltage"])
    np.testing.assert_array_equal(table["displacement"], other["displacement"])


def test_where_it_cannot_tell_how_much_it_still_tells_that(tmp_path):
    """A drive that repeats itself, by the third of a period late: no offset, but a warning."""
    time = np.arange(0.0, 10.0, 2e-3)
    volts = 50.0 - 50.0 * np.cos(2.0 * np.pi * time)
    seen = write(tmp_path / "sensor.csv", "time_s,displacement_um", time, 0.1 * volts)
    sent = write(tmp_path / "drive.csv", "time_s,voltage_V", time - 0.3, volts)
    with pytest.warns(DboWarning, match="line up"):
        read(seen, sent)
    with pytest.raises(InputError, match="not sure"):
        read(seen, sent, Reading(clock_offset="auto"))


def test_what_cannot_tell_is_refused(tmp_path):
    noise = np.random.default_rng(1).normal(size=TIME.size)
    periodic = 50.0 + 50.0 * np.sin(2.0 * np.pi * TIME)
    slow = np.interp(TIME / 8.0, TIME, DRIVE)
    cases = {
        "both move": (np.full(TIME.size, 3.0), DRIVE),
        "not sure": (DRIVE, noise),
        "does not repeat": (periodic, 0.1 * periodic),
        "give SECONDS": (slow, 0.1 * slow + 0.4 * noise),
    }
    for words, (volts, shown) in cases.items():
        seen = write(tmp_path / "sensor.csv", "time_s,displacement_um", TIME, shown)
        sent = write(tmp_path / "drive.csv", "time_s,voltage_V", TIME, volts)
        with pytest.raises(InputError, match=words):
            read(seen, sent, Reading(clock_offset="auto"))


def test_files_that_cannot_be_joined(tmp_path):
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
        (dated, "stamps"),
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
    with pytest.raises(UsageError, match="one second file"):
        open_log(seen, roles, Reading(clock_offset=1.0))


def test_stamps_of_two_files_are_one_clock(tmp_path):
    def stamped(name, first, header):
        lines = [f"time,{header}"]
        for second in range(first, first + 40):
            lines.append(f"2026-01-02T03:04:{second:02d}.500,{second}")
        (tmp_path / name).write_text("\n".join(lines) + "\n")
        return tmp_path / name

    sensor = stamped("s.csv", 0, "displacement_um")
    _, table = read(sensor, stamped("d.csv", 10, "voltage_V"))
    np.testing.assert_array_equal(table["voltage"], table["displacement"])
    assert len(table) == 30
    assert table.time[0] == 10.0
