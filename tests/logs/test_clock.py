"""The clock of a log: stamps, units, rates, even and uneven steps, and what is asked or refused."""

import numpy as np
import pandas as pd
import pytest

from dbo_cli.errors import DboWarning, InputError, UsageError
from dbo_cli.logs import Reading, frame_table, open_log

VOLTAGE = {"voltage": None}


def write(folder, times, header="time_s"):
    path = folder / "run.csv"
    rows = [f"{time},{number}.5" for number, time in enumerate(times)]
    path.write_text("\n".join([f"{header},voltage_V", *rows]) + "\n")
    return str(path)


def read(path, **reading):
    with open_log(path, VOLTAGE, Reading(**reading)) as log:
        return log.read(), log


def test_uneven_time_gives_each_step(tmp_path):
    with pytest.warns(DboWarning) as said:
        stamps = "0 0.001 0.003 0.004 0.020 0.020"
        table, _ = read(write(tmp_path, stamps.split()))
    assert isinstance(table.dt, np.ndarray)
    assert table.dt.tolist() == pytest.approx([0.001, 0.001, 0.002, 0.001, 0.016, 0.0])
    texts = [str(warning.message) for warning in said]
    assert len(texts) == 1
    assert "3 gaps or repeats" in texts[0] and "row 3" in texts[0]


@pytest.mark.parametrize("times", [[0.0, 0.1, 0.2, 0.3], [0.0, 0.1, 0.22, 0.32], [0.0]])
def test_a_row_that_comes_alone_waits_for_the_one_that_tells_its_step(times):
    """A pipe brings its first row long before the second; what is driven needs a step."""
    frame = pd.DataFrame({"time_s": times, "voltage_V": times})
    table = frame_table(frame)
    table.block_rows = 1
    with open_log(table, VOLTAGE, Reading()) as log:
        blocks = list(log.blocks())
    assert [len(block) for block in blocks] == [min(2, len(times)), 1, 1][: len(blocks)]
    assert sum(map(len, blocks)) == len(times)
    if len(times) > 1:
        assert np.all(np.asarray(blocks[0].dt) == pytest.approx(0.1))


@pytest.mark.parametrize(
    ("header", "factor"),
    [("t_ms", 1e-3), ("Time (us)", 1e-6), ("time [min]", 60.0), ("Zeit/Sekunden", 1.0), ("millis", 1e-3)],
)  # fmt: skip
def test_units_of_time(header, factor, tmp_path):
    step = 0.5 if factor >= 1.0 else 1000.0
    path = write(tmp_path, [str(step * n) for n in range(4)], header)
    time = read(path)[0].time
    assert time.tolist() == pytest.approx(step * factor * np.arange(4), rel=1e-15)


@pytest.mark.parametrize("header", ["time_100us", "t 10 ms", "10ms_time"])
def test_a_multiple_of_a_unit_is_no_unit(header, tmp_path):
    path = write(tmp_path, ["0", "0.5", "1"], header)
    with pytest.raises(InputError, match="`time_unit`"):
        read(path)
    assert read(path, time_unit="10us")[0].time.tolist() == [0.0, 5e-6, 1e-5]


@pytest.mark.parametrize(
    "stamps",
    [
        ["2026-01-02T03:04:05.000", "2026-01-02T03:04:05.500", "2026-01-02T03:04:06.000"],
        ["2026-01-02 03:04:05Z", "2026-01-02 03:04:05.5Z", "2026-01-02 03:04:06Z"],
        ["2026-01-02T05:04:05+02:00", "2026-01-02T05:04:05.5+02:00", "2026-01-02T05:04:06+02:00"],
        ["02.01.2026 03:04:05", "02.01.2026 03:04:05.5", "02.01.2026 03:04:06"],
    ],
)  # fmt: skip
def test_stamps(stamps, tmp_path):
    table, log = read(write(tmp_path, stamps, "when"))
    assert table.time.tolist() == [0.0, 0.5, 1.0]
    assert log.clock.first_stamp == 1767323045 * 10**9
    assert log.clock.kind == "stamps"


def test_polars_reads_stamps_as_the_cells_are_read(tmp_path):
    stamps = np.datetime64("2026-01-02T23:59:30", "us") + np.arange(20_000) * 3000
    path = write(tmp_path, [str(stamp) + "+01:00" for stamp in stamps], "time")
    table, log = read(path)
    np.testing.assert_array_equal(table.time, np.arange(20_000) * 3 / 1000)
    assert log.clock.first_stamp == 1767394770 * 10**9


@pytest.mark.parametrize("typed", [{"time_unit": "ms"}, {"time": "1"}])
def test_a_rate_stands_in_the_place_of_a_column(tmp_path, typed):
    path, unit = write(tmp_path, "0 1 2".split()), typed.get("time_unit")
    roles = {"time": typed.get("time"), **VOLTAGE}
    with pytest.raises(UsageError, match="exclude each other"):
        open_log(path, roles, Reading(sample_rate=10.0, time_unit=unit))


@pytest.mark.filterwarnings("ignore::dbo_cli.errors.DboWarning")
def test_resampling_is_said_and_needs_a_rate_that_leaves_rows(tmp_path):
    path = write(tmp_path, ["0", "0.1", "0.4", "0.5"])
    _, log = read(path, resample=10.0)
    assert any("interpolated" in remark for remark in log.remarks)
    with pytest.raises(InputError, match="`resample`"):
        read(path, resample=0.1)
    with pytest.raises(UsageError, match="`resample`"):
        read(path, resample=-1.0)


def test_a_frame_with_a_load_in_tonnes_keeps_the_clock_of_its_index():
    columns = {"force [t]": np.ones(5), "voltage_V": np.arange(5.0)}
    index = pd.Index(np.arange(5) / 1e3, name="time_s")
    with open_log(frame_table(pd.DataFrame(columns, index)), {"voltage": None}) as log:
        np.testing.assert_array_equal(log.read().time, index)
