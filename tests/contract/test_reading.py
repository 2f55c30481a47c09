"""Ten everyday logs, and what is asked where a log is not clear: nothing is read wrong in silence."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
import scipy.io

from .program import Floats, dbo, done, model, refused, table, write

ROWS = 60


def driven(written: dict[str, Floats]) -> Floats:
    """Return the input that ``simulate`` wrote beside its output, whatever it is called."""
    return list(written.values())[-2]


TIME = np.arange(ROWS) / 1000.0
VOLTS = np.round(5.0 - 5.0 * np.cos(2.0 * np.pi * 40.0 * TIME), 4)


def text(name: str, head: str, line: str, *columns: Floats) -> str:
    """Write a log as text, each row formatted by ``line``."""
    rows = "".join(line.format(*row) + "\n" for row in zip(*columns, strict=True))
    Path(name).write_text(head + rows, encoding="utf-8")
    return name


def german() -> str:
    rows = [
        f"{t:.4f};{v:.4f}".replace(".", ",") for t, v in zip(TIME, VOLTS, strict=True)
    ]
    Path("log.csv").write_text("Zeit [s];Spannung [V]\n" + "\n".join(rows) + "\n")
    return "log.csv --input 2"


def oscilloscope() -> str:
    head = "Model,DSO\nSample Interval,0.001\nVertical Units,V\n\ntime_s,voltage_V\n"
    return text("scope.csv", head, "{:.4f},{:.4f}", TIME, VOLTS)


def blanks() -> str:
    return (
        text("log.dat", "", "  {:8.4f}   {:8.4f}", TIME, VOLTS) + " --time 1 --input 2"
    )


def commented() -> str:
    head = "# drive of Tuesday\n# amplifier: 20x\ntime_ms\tvoltage_V\n"
    return text("log.tsv", head, "{:.3f}\t{:.4f}", 1000.0 * TIME, VOLTS)


def units_row() -> str:
    head = "time,voltage\ns,mV\n"
    return text("log.csv", head, "{:.4f},{:.1f}", TIME, 1000.0 * VOLTS)


def zipped() -> str:
    plain = text("log.csv", "time_s,voltage_V\n", "{:.4f},{:.4f}", TIME, VOLTS)
    Path("log.csv.gz").write_bytes(gzip.compress(Path(plain).read_bytes()))
    Path(plain).unlink()
    return "log.csv.gz"


def stamped() -> str:
    stamps = pd.Timestamp("2026-03-04T05:06:07") + pd.to_timedelta(TIME, unit="s")
    rows = [f"{s.isoformat()},{v:.4f}" for s, v in zip(stamps, VOLTS, strict=True)]
    Path("log.csv").write_text("timestamp,voltage_V\n" + "\n".join(rows) + "\n")
    return "log.csv"


def one_column() -> str:
    return text("log.txt", "voltage_V\n", "{:.4f}", VOLTS) + " --sample-rate 1000"


def hdf5() -> str:
    with h5py.File("log.h5", "w") as file:
        group = file.create_group("run 1")
        for name, values, unit in (("time", TIME, "s"), ("voltage", VOLTS, "V")):
            group[name] = values
            group[name].attrs["units"] = unit
    return "log.h5::/run_1".replace("_", " ")


def numpy_array() -> str:
    np.save("log.npy", np.column_stack([TIME, VOLTS]))
    return "log.npy --time 1 --input 2"


def matlab() -> str:
    scipy.io.savemat("log.mat", {"time_s": TIME, "voltage_V": VOLTS})
    return "log.mat"


LOGS: list[Callable[[], str]] = [
    german,
    oscilloscope,
    blanks,
    commented,
    units_row,
    zipped,
    stamped,
    one_column,
    hdf5,
    numpy_array,
    matlab,
]


@pytest.mark.parametrize("make", LOGS, ids=lambda make: make.__name__)
def test_an_everyday_log_is_read(make: Callable[[], str]) -> None:
    path, *options = make().replace("run 1", "run\0001").split()
    path = path.replace("\0001", " 1")
    outcome = done("simulate", model("creep"), path, *options, "-o", "out.csv")
    written = table("out.csv")
    np.testing.assert_allclose(driven(written), VOLTS, atol=1e-9)
    np.testing.assert_allclose(
        written["time_s"] - written["time_s"][0], TIME, atol=1e-6
    )
    assert "60 rows" in outcome.err


# --- what is not clear is asked ---


def plain(header: str = "a,b,c") -> str:
    return text("log.csv", header + "\n", "{:.4f},{:.4f},{:.4f}", TIME, VOLTS, VOLTS)


def test_no_column_fits_and_the_option_is_said() -> None:
    error = refused(1, "simulate", model("small"), plain())
    for word in ("log.csv", "--input", "a", "b", "c"):
        assert word in error


def test_several_columns_fit_and_the_option_is_said() -> None:
    name = plain("time_s,voltage1_V,voltage2_V")
    error = refused(1, "simulate", model("small"), name)
    assert "--input" in error and "voltage1_V" in error and "voltage2_V" in error
    done("simulate", model("small"), name, "--input", "voltage2_V", "-o", "out.csv")


def test_a_column_by_name_or_number() -> None:
    for chosen in ("b", "2"):
        words = ("--input", chosen, "--time", "a", "--time-unit", "s")
        written = table(done("simulate", model("small"), plain(), *words))
        np.testing.assert_allclose(driven(written), VOLTS)
    for chosen, code in (("d", 1), ("4", 1), ("0", 2)):
        words = ("simulate", model("small"), plain(), "--input", chosen)
        outcome = dbo(*words)
        assert outcome.code in (1, code) and outcome.raw == b""
        assert chosen in outcome.lines[-1]


def test_one_unit_that_fits_is_enough() -> None:
    name = plain("time_s,CH1_V,CH2_um")
    written = table(done("simulate", model("small"), name))
    np.testing.assert_allclose(driven(written), VOLTS)


def test_a_time_column_of_unknown_unit_is_asked_about() -> None:
    """Counting up by 1 a row over a minute: seconds, milliseconds or rows."""
    counted = np.arange(ROWS, dtype=float)
    write("log.csv", "time,voltage_V", counted, VOLTS)
    error = refused(1, "simulate", model("creep"), "log.csv")
    assert "--time-unit" in error
    words = ("--time-unit", "ms")
    written = table(done("simulate", model("creep"), "log.csv", *words))
    np.testing.assert_allclose(written["time_s"], TIME, atol=1e-12)


# --- options ---


def pair() -> str:
    return text("log.csv", "time_s,voltage_V\n", "{:.4f},{:.4f}", TIME, VOLTS)


def test_rows() -> None:
    kept = {"11:20": slice(10, 20), "51:": slice(50, 60), ":5": slice(0, 5)}
    for rows, part in kept.items():
        written = table(done("simulate", model("small"), pair(), "--rows", rows))
        np.testing.assert_array_equal(driven(written), VOLTS[part])


def test_rows_beyond_the_end_are_refused() -> None:
    assert "100" in refused(1, "simulate", model("small"), pair(), "--rows", "100:200")


def test_scale() -> None:
    factors = {"2": 2.0, "0.5": 0.5, "20V/V": 20.0, "1000mV/V": 1.0}
    for factor, expected in factors.items():
        words = ("--scale", f"input={factor}")
        written = table(done("simulate", model("small"), pair(), *words))
        np.testing.assert_allclose(driven(written), expected * VOLTS, rtol=1e-12)


def test_scale_turns_volts_of_a_sensor_into_length() -> None:
    sensor = text("log.csv", "desired_um,CH2_V\n", "{:.4f},{:.5f}", VOLTS, VOLTS / 10.0)
    words = ("--measured", "CH2_V", "--scale", "measured=10um/V", "--format", "json")
    told = done("report", sensor, *words).json
    assert told["unit"] == "um" and told["logs"][0]["rmse"] < 1e-4


def bad_row(cell: str = "OVLD") -> str:
    lines = Path(pair()).read_text().splitlines()
    lines[30] = lines[30].split(",")[0] + f",{cell}"
    Path("log.csv").write_text("\n".join(lines) + "\n")
    return "log.csv"


@pytest.mark.parametrize("cell", ["OVLD", "", "1e999"])
def test_a_bad_row_is_named_or_dropped_on_request(cell: str) -> None:
    error = refused(1, "simulate", model("small"), bad_row(cell))
    assert "log.csv" in error and ("31" in error or "row 30" in error)
    assert "--skip-bad" in error
    words = ("--skip-bad", "--verbose", "-o", "out.csv")
    outcome = done("simulate", model("small"), "log.csv", *words)
    np.testing.assert_array_equal(driven(table("out.csv")), np.delete(VOLTS, 29))
    assert any("1 row" in line for line in outcome.lines)


def test_resample_makes_an_even_clock() -> None:
    jittered = TIME + 0.0002 * np.sin(np.arange(ROWS))
    text("log.csv", "time_s,voltage_V\n", "{:.9f},{:.9f}", jittered, 100.0 * jittered)
    written = table(done("simulate", model("small"), "log.csv", "--resample", "500"))
    np.testing.assert_allclose(np.diff(written["time_s"]), 0.002, rtol=1e-9)
    np.testing.assert_allclose(driven(written), 100.0 * written["time_s"], atol=1e-6)


def test_delimiter_decimal_and_lines_to_skip() -> None:
    rows = [
        f"{t:.4f}|{v:.4f}".replace(".", ",") for t, v in zip(TIME, VOLTS, strict=True)
    ]
    Path("log.txt").write_text(
        "bench 3|7|x\ntime_s|voltage_V\n" + "\n".join(rows) + "\n"
    )
    words = ("--delimiter", "|", "--decimal", "comma", "--skip-lines", "1")
    written = table(done("simulate", model("small"), "log.txt", *words))
    np.testing.assert_allclose(driven(written), VOLTS)


def test_encoding() -> None:
    head = "time_µs,voltage_V\n"
    rows = "".join(f"{1e6 * t:.0f},{v:.4f}\n" for t, v in zip(TIME, VOLTS, strict=True))
    Path("log.csv").write_bytes((head + rows).encode("utf-16"))
    words = ("--encoding", "utf-16")
    written = table(done("simulate", model("small"), "log.csv", *words))
    np.testing.assert_allclose(written["time_s"], TIME, atol=1e-12)
    assert "utf-16-le" in refused(1, "simulate", model("small"), pair(), *words)


def test_a_column_of_another_file_is_joined_by_time() -> None:
    """The drive is interpolated onto the displacement's rows."""
    fine = np.arange(3000) / 10_000.0
    write("drive.csv", "time_s,CH1_V", fine, 10.0 * fine)
    slow = np.arange(100) / 500.0 + 0.01
    write("sensor.csv", "time_s,measured_um", slow, 10.0 * slow)
    words = ("--desired", "drive.csv::CH1_V", "--scale", "desired=1um/V")
    told = done("report", "sensor.csv", *words, "--format", "json").json
    assert told["logs"][0]["samples"] == 100
    assert told["logs"][0]["rmse"] < 1e-9


def test_a_clock_offset_moves_the_drive() -> None:
    time = np.arange(100) / 500.0
    write("drive.csv", "time_s,CH1_V", time + 0.3, 10.0 * time)
    write("sensor.csv", "time_s,measured_um", time, 10.0 * time)
    words = ("--desired", "drive.csv::CH1_V", "--scale", "desired=1um/V")
    shifted = ("--clock-offset", -0.3)
    told = done("report", "sensor.csv", *words, *shifted, "--format", "json").json
    assert told["logs"][0]["rmse"] < 1e-9


def test_what_is_no_log_is_refused() -> None:
    contents = (
        b"",
        b"\n\n\n",
        b"time_s,voltage_V\n",
        b"\x00\x01\x02\x03" * 100,
        b"PK\x03\x04" + b"\x00" * 100,
        b"no numbers\nat all\n",
    )
    for content in contents:
        Path("log.csv").write_bytes(content)
        assert "log.csv" in refused(1, "simulate", model("small"), "log.csv")


def test_pickles_are_refused_with_a_way_out() -> None:
    pd.DataFrame({"time_s": TIME, "voltage_V": VOLTS}).to_pickle("log.pkl")
    error = refused(1, "simulate", model("small"), "log.pkl")
    assert "log.pkl" in error and "parquet" in error


def test_links_to_other_files_are_refused() -> None:
    with h5py.File("other.h5", "w") as file:
        file["voltage"] = VOLTS
    with h5py.File("log.h5", "w") as file:
        file["voltage"] = h5py.ExternalLink("other.h5", "/voltage")
    error = refused(1, "simulate", model("small"), "log.h5", "--input", "voltage")
    assert "log.h5" in error
