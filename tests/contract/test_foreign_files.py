"""Files of other libraries: the file that was named is read, damage is said, refusals say what to type."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
import scipy.io

from .program import dbo, done, model, refused, table

TIME = np.arange(1000) / 1000.0
VOLTS = np.round(5.0 - 5.0 * np.cos(2.0 * np.pi * 4.0 * TIME), 4)


def frame(factor: float = 1.0) -> pd.DataFrame:
    return pd.DataFrame({"time_s": TIME, "voltage_V": factor * VOLTS})


def drives(name: str, *words: object) -> np.ndarray:
    written = table(done("simulate", model("small"), name, *words))
    return list(written.values())[-2]


@pytest.mark.parametrize("suffix", ["parquet", "feather"])
def test_brackets_in_a_name_are_no_pattern(suffix: str) -> None:
    """A pattern ``run[1]`` matches ``run1``: that is another file."""
    for name, factor in (("run1", 0.5), ("run[1]", 1.0)):
        if suffix == "parquet":
            frame(factor).to_parquet(f"{name}.parquet")
        else:
            frame(factor).to_feather(f"{name}.feather")
    np.testing.assert_array_equal(drives(f"run[1].{suffix}"), VOLTS)
    np.testing.assert_array_equal(drives(f"run1.{suffix}"), 0.5 * VOLTS)


@pytest.mark.parametrize("is_compressed", [False, True])
def test_a_damaged_byte_of_a_matlab_file_ends_in_a_line_or_in_numbers(
    is_compressed: bool,
) -> None:
    """Every byte takes another value, in one process that has to survive."""
    columns = {"time_s": TIME[:3], "voltage_V": VOLTS[:3], "gain": 2.0}
    scipy.io.savemat("run.mat", columns, do_compression=is_compressed)
    Path("attack.py").write_text(
        """
import pathlib
from dbo_cli.errors import DboError
from dbo_cli.logs import open_log
whole = pathlib.Path("run.mat").read_bytes()
refused = 0
for place in range(116, len(whole)):
    damaged = bytearray(whole)
    damaged[place] = 255 * (damaged[place] < 128)
    pathlib.Path("damaged.mat").write_bytes(damaged)
    try:
        with open_log("damaged.mat", {"time": None, "voltage": "2"}) as log:
            log.read()
    except DboError as problem:
        refused += 1
        assert chr(10) not in str(problem)
print(refused)
"""
    )
    ended = subprocess.run(
        [sys.executable, "attack.py"], capture_output=True, check=False, timeout=300
    )
    assert ended.returncode == 0, ended.stderr[-500:]
    assert int(ended.stdout) > 100


def test_a_matlab_file_is_read_in_either_byte_order_and_packing() -> None:
    columns = {"time_s": TIME[:, None], "voltage_V": VOLTS[None, :]}
    for compressed in (False, True):
        scipy.io.savemat("run.mat", columns, do_compression=compressed)
        np.testing.assert_array_equal(drives("run.mat"), VOLTS)
    integers = {"time_s": TIME, "voltage_V": np.arange(1000, dtype=np.int16)}
    scipy.io.savemat("run.mat", integers)
    found = drives("run.mat", "--outside", "extend")
    np.testing.assert_array_equal(found, np.arange(1000.0))


def cells(*values: object) -> np.ndarray:
    array = np.empty((1, len(values)), dtype=object)
    array[0, :] = np.array([*values, None], dtype=object)[:-1]
    return array


RUN = {"t": TIME, "u": VOLTS}
RUNS = np.array([(1.0, 2.0), (2.0, 3.0)], dtype=[("t", "O"), ("u", "O")])


@pytest.mark.parametrize(
    ("contents", "line"),
    [
        ({"run": RUN}, "save('flat.mat', '-struct', 'run')"),
        ({"run": RUN, "note": 1.0}, "save('flat.mat', '-struct', 'run')"),
        ({"run": cells(TIME, VOLTS)}, "cell2struct(run(:)"),
        ({"run": RUNS}, "struct2table(run)"),
    ],
)
def test_what_matlab_holds_is_named_with_a_line_that_saves_it(
    contents: dict[str, object], line: str
) -> None:
    scipy.io.savemat("run.mat", contents)
    error = refused(1, "simulate", model("small"), "run.mat")
    assert "run (" in error and line in error


def test_a_cut_tdms_file_is_said() -> None:
    """At a chunk a cut leaves rows that look whole."""
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter("run.tdms") as file:
        for start in range(0, 1000, 100):
            rows = slice(start, start + 100)
            channels = [
                nptdms.ChannelObject("g", "time_s", TIME[rows]),
                nptdms.ChannelObject("g", "voltage_V", VOLTS[rows]),
            ]
            file.write_segment(channels)
    whole = Path("run.tdms").read_bytes()
    assert len(drives("run.tdms")) == 1000
    assert "cut" not in done("simulate", model("small"), "run.tdms", "--verbose").err
    for lost in (1, 800, 1600):
        Path("cut.tdms").write_bytes(whole[:-lost])
        outcome = dbo("simulate", model("small"), "cut.tdms", "--verbose")
        assert "cut" in outcome.err
        assert outcome.code in (0, 1)


def test_what_a_library_logs_is_no_line_of_the_program() -> None:
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter("run.tdms") as file:
        stated = {"unit_string": "V"}
        channels = [
            nptdms.ChannelObject("g", "time_s", TIME),
            nptdms.ChannelObject("g", "voltage_V", VOLTS, stated),
        ]
        file.write_segment(channels)
    damaged = Path("run.tdms").read_bytes().replace(b"unit_string", b"unit\xcdstring")
    Path("run.tdms").write_bytes(damaged)
    words = ["simulate", str(model("small")), "run.tdms", "-o", "out.csv"]
    line = [sys.executable, "-m", "dbo_cli", *words]
    ended = subprocess.run(line, capture_output=True, check=True, timeout=300)
    assert all(said.startswith(b"dbo: ") for said in ended.stderr.splitlines())


def test_a_rate_without_an_end_is_no_rate() -> None:
    rows = "".join(f"{volt}\n" for volt in VOLTS.tolist())
    for statement in ("Sample Interval,1e308,s", "Sample Rate,1e-308,Hz"):
        Path("run.csv").write_text(f"{statement}\nvoltage_V\n{rows}")
        outcome = dbo("simulate", model("small"), "run.csv")
        assert "inf" not in outcome.out
        assert "time_s" not in outcome.out


@pytest.mark.parametrize("key", ["scale_factor", "Scale", "Scale Factor", "GAIN"])
def test_a_factor_beside_a_dataset_is_never_passed_over(key: str) -> None:
    with h5py.File("run.h5", "w") as file:
        file["time_s"], file["voltage_V"] = TIME, VOLTS
        file["voltage_V"].attrs[key] = 2.0
    error = refused(1, "simulate", model("small"), "run.h5")
    assert key in error and "--scale" in error


def test_columns_of_one_short_name_are_named_by_their_paths() -> None:
    with h5py.File("run.h5", "w") as file:
        for name, values in (("sensor", VOLTS / 10.0), ("drive", VOLTS)):
            rows = list(zip(TIME, values, strict=True))
            kind = [("t", "f8"), ("values", "f8")]
            file[f"data/{name}"] = np.array(rows, dtype=kind)
    error = refused(1, "simulate", model("small"), "run.h5")
    assert "'drive/t'" in error and "'sensor/t'" in error
    error = refused(1, "simulate", model("small"), "run.h5", "--time", "drive/t")
    assert "drive/values" in error and "sensor/values" in error
    words = ("--time", "drive/t", "--input", "drive/values")
    np.testing.assert_array_equal(drives("run.h5", *words), VOLTS)
