"""``import dbo_cli as dbo``: the examples of DESIGN, section 3, and the same numbers as the shell."""

from __future__ import annotations

import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import dbo_cli as dbo

from .program import SAMPLES, Floats, done, model, rms, table, write

TIME = np.arange(400) / 1000.0
WANTED = 5.0 - 3.0 * np.cos(2.0 * np.pi * 5.0 * TIME)
SLOW = 2.5 - np.cos(2.0 * np.pi * 5.0 * TIME)
QUICK: dict[str, Any] = {
    "gears": 20,
    "points": 0,
    "delay": 0.0,
    "relaxation": (0.01, 0.3),
    "dynamics": 0,
}
pytestmark = pytest.mark.filterwarnings("ignore::dbo_cli.errors.DboWarning")


@pytest.fixture
def small() -> Any:
    return dbo.read_model(model("small"))


@pytest.fixture
def creep() -> Any:
    return dbo.read_model(model("creep"))


def test_every_public_name_is_there() -> None:
    for name in dbo.__all__:
        assert getattr(dbo, name) is not None
    for name in (
        "read_log",
        "read_model",
        "identify",
        "report",
        "DboError",
        "DboWarning",
    ):
        assert name in dbo.__all__
    with pytest.raises(AttributeError):
        dbo.nothing  # noqa: B018


# --- logs ---


def test_read_log_has_units_and_time() -> None:
    frame = dbo.read_log(SAMPLES / "identification.csv")
    assert isinstance(frame, pd.DataFrame) and len(frame) == 15000
    assert frame.attrs["units"] == {"time": "s", "voltage": "V", "displacement": "um"}
    for column in ("time", "voltage", "displacement"):
        assert frame[column].dtype == float


def test_read_log_takes_columns_and_reading_options(log: Path) -> None:
    text = log.read_text().replace("voltage_V", "CH1").replace("displacement_um", "CH2")
    Path("run.csv").write_text(text)
    words = {"voltage": "CH1", "displacement": "CH2", "rows": "1:500"}
    frame = dbo.read_log("run.csv", **words, scale={"displacement": "10um/V"})
    assert len(frame) == 500
    np.testing.assert_allclose(
        frame["displacement"], 10.0 * table(log)["displacement_um"][:500]
    )


def test_a_log_that_is_not_clear_is_refused(log: Path) -> None:
    Path("run.csv").write_text("a,b,c\n" + "".join(f"{k},{k},{k}\n" for k in range(50)))
    with pytest.raises(dbo.InputError, match=r"run\.csv"):
        dbo.read_log("run.csv")


# --- identify ---


def test_a_frame_and_arrays_give_the_model_of_the_shell(log: Path) -> None:
    words = "--gears 20 --points 0 --delay 0 --relaxation 0.01,0.3 --dynamics 0".split()
    done("identify", log, *words, "-o", "shell.json", "-q")
    shell = dbo.read_model("shell.json")
    frame = dbo.read_log(log)
    values = table(log)
    arrays = dbo.identify(
        values["voltage_V"], values["displacement_um"], time=values["time_s"], **QUICK
    )
    framed = dbo.identify(frame, **QUICK)
    for found in (framed, arrays):
        assert same_stages(found, shell)
        assert found.fit["rmse"] == pytest.approx(shell.fit["rmse"], rel=1e-12)
    assert framed.output.unit == "um"


def same_stages(one: Any, other: Any) -> bool:
    """Return whether two models give the same numbers."""
    drive = 50.0 + 50.0 * np.sin(np.arange(500) / 30.0)
    pair = [each.simulate(drive, sample_rate=500.0) for each in (one, other)]
    return bool(np.array_equal(pair[0], pair[1]))


def test_several_logs_are_a_list(log: Path) -> None:
    frame = dbo.read_log(log)
    found = dbo.identify([frame, frame], **QUICK)
    assert len(found.fit["logs"]) == 2


def test_senseless_arrays_are_refused() -> None:
    drive = 5.0 + 5.0 * np.sin(np.arange(300) / 10.0)
    with pytest.raises(dbo.DboError):
        dbo.identify(drive, drive[:-1], sample_rate=100.0)
    with pytest.raises(dbo.DboError):
        dbo.identify(drive, np.full(300, np.nan), sample_rate=100.0)
    with pytest.raises((dbo.DboError, TypeError)):
        dbo.identify(drive, drive, sample_rate=100.0, colour="red")


def test_what_is_warned_of_is_part_of_the_result() -> None:
    drive = 50.0 - 50.0 * np.cos(np.arange(1200) * np.pi / 120.0)
    moved = dbo.read_model(model("small")).simulate(drive / 10.0)
    noise = np.random.default_rng(5).normal(0.0, 0.01, 1200)
    plain = {**QUICK, "relaxation": (), "force": True}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = dbo.identify(drive, moved + noise, sample_rate=500.0, **plain)
    said = [str(one.message) for one in caught if one.category is dbo.DboWarning]
    assert said and set(said) <= set(found.fit["warnings"])


# --- models ---


def test_a_folder_that_there_is_not(creep: Any) -> None:
    with pytest.raises(dbo.OutputError):
        creep.save("no/where.json")


def test_simulate_is_the_shell_s(creep: Any) -> None:
    drive = np.round(100.0 * np.abs(np.sin(TIME * 20.0)), 6)
    write("drive.csv", "time_s,voltage_V", TIME, drive)
    shell = table(done("simulate", model("creep"), "drive.csv"))["displacement_um"]
    np.testing.assert_array_equal(creep.simulate(drive, time=TIME), shell)
    np.testing.assert_allclose(
        creep.simulate(drive, sample_rate=1000.0), shell, atol=1e-12
    )
    series = pd.Series(drive, index=pd.to_timedelta(TIME, unit="s"))
    np.testing.assert_allclose(creep.simulate(series), shell, atol=1e-9)


def test_compensate_is_the_shell_s(creep: Any) -> None:
    write("wish.csv", "time_s,displacement_um", TIME, SLOW)
    limits = ("--v-max", 60, "--max-slew", 2000, "--on-limit", "clip")
    words = (*limits, "--from", 0, "--approach", "auto")
    done("compensate", model("creep"), "wish.csv", *words, "-o", "drive.csv", "-q")
    shell = table("drive.csv")
    drive = creep.compensate(
        SLOW,
        time=TIME,
        v_max=60,
        max_slew="2V/ms",
        on_limit="clip",
        from_=0.0,
        approach="auto",
        details=True,
    )
    np.testing.assert_array_equal(drive.voltage, shell["voltage_V"])
    np.testing.assert_allclose(drive.time, shell["time_s"], atol=1e-12)
    plain = creep.compensate(SLOW, time=TIME)
    assert isinstance(plain, np.ndarray) and plain.shape == SLOW.shape


def test_details_are_numbers(creep: Any) -> None:
    known = dbo.read_model(model("known"))
    drive = known.compensate(SLOW, time=TIME, condition=True, details=True)
    assert isinstance(drive.expected_error, float) and drive.expected_error > 0.0
    assert drive.clipped == 0 and drive.lost_rms == 0.0
    assert drive.time[0] < 0.0 and len(drive.voltage[drive.move]) == len(SLOW)
    came = known.simulate(drive.voltage, time=drive.time, state="full")
    assert rms(came[drive.move][1:] - SLOW[1:]) < 0.05
    assert drive.summary()["expected_rmse"] == drive.expected_error


@pytest.mark.parametrize("kind", ["series", "frame", "list"])
def test_pandas_and_lists_come_in(creep: Any, kind: str) -> None:
    expected = creep.compensate(SLOW, time=TIME)
    if kind == "list":
        found = creep.compensate(SLOW.tolist(), time=TIME.tolist())
    elif kind == "series":
        index = pd.Timestamp("2026-01-01") + pd.to_timedelta(TIME, unit="s")
        found = creep.compensate(pd.Series(SLOW, index=index))
    else:
        found = creep.compensate(pd.Series(SLOW, index=pd.Index(TIME, name="time")))
    np.testing.assert_allclose(found, expected, atol=1e-7)


def test_limits_are_errors_of_a_class(small: Any) -> None:
    far = WANTED + 5.0
    with pytest.raises(dbo.LimitError):
        small.compensate(far, time=TIME)
    assert small.compensate(far, time=TIME, on_limit="clip").max() == 10.0
    with pytest.raises(dbo.DboError):
        small.compensate(WANTED, time=TIME, v_max="8um")
    with pytest.raises((dbo.DboError, TypeError)):
        small.compensate(WANTED, time=TIME, colour="red")
    with pytest.raises(dbo.DboError):
        small.compensate(np.array([5.0, np.nan, 6.0]))


def test_a_clock_is_needed_where_the_model_depends_on_time(creep: Any) -> None:
    with pytest.raises(dbo.DboError, match="sample_rate"):
        creep.simulate(WANTED)
    with pytest.raises(dbo.DboError):
        creep.simulate(WANTED, time=TIME[::-1])
    with pytest.raises(dbo.DboError):
        creep.simulate(WANTED, time=TIME[:-1])


def test_an_inverse_is_a_model(small: Any) -> None:
    inverse = small.inverse()
    np.testing.assert_allclose(
        inverse.simulate(WANTED), small.compensate(WANTED), atol=1e-12
    )


def test_plot_and_html(creep: Any) -> None:
    figure = creep.plot()
    axes = figure.axes[0]
    assert "V" in axes.get_xlabel() and "um" in axes.get_ylabel().replace(
        "µm", "um"
    ).replace("\N{GREEK SMALL LETTER MU}m", "um")
    assert "<" in creep._repr_html_() and "100" in repr(creep)


# --- reports ---


def test_report(small: Any) -> None:
    error: Floats = np.random.default_rng(1).normal(0.0, 0.05, 400)
    found = dbo.report(WANTED, WANTED + error, time=TIME)
    assert found.rmse == pytest.approx(rms(error), rel=1e-12)
    frame = found.to_frame()
    assert isinstance(frame, pd.DataFrame) and len(frame) == 1
    assert found.to_html().lstrip().startswith("<")
    drawn = found.figures("figures")
    assert drawn and all(Path(one).exists() for one in drawn)
    assert found.passed is None
    assert dbo.report(WANTED, WANTED, time=TIME, max_rmse=0.1).passed is True


def test_a_report_leaves_the_process_alone() -> None:
    code = (
        "import signal, warnings, numpy as np, dbo_cli as dbo\n"
        "before = signal.getsignal(signal.SIGINT), list(warnings.filters)\n"
        "dbo.report(np.arange(9.0), np.arange(9.0), time=np.arange(9.0))\n"
        f"dbo.read_model({str(model('small'))!r}).compensate([2.0, 3.0, 4.0])\n"
        "print((signal.getsignal(signal.SIGINT), list(warnings.filters)) == before)\n"
    )
    ended = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code], capture_output=True, check=True
    )
    assert ended.stdout.strip() == b"True" and ended.stderr == b""


# --- what comes in ---

RISING = 50.0 - 50.0 * np.cos(30.0 * TIME)


@pytest.mark.parametrize("zone", [None, "UTC", "Asia/Tokyo"])
def test_dates_with_and_without_a_zone_are_a_clock(creep: Any, zone: str) -> None:
    index = pd.date_range("2026-01-01", periods=400, freq="1ms", tz=zone)
    expected = creep.simulate(RISING, time=TIME)
    np.testing.assert_allclose(
        creep.simulate(pd.Series(RISING, index=index)), expected, atol=1e-9
    )
    stamps = pd.Series(index)
    np.testing.assert_allclose(creep.simulate(RISING, time=stamps), expected, atol=1e-9)


def test_a_plain_count_is_no_clock(creep: Any) -> None:
    with pytest.raises(dbo.DboError, match="sample_rate"):
        creep.simulate(pd.Series(RISING))


def test_a_report_of_a_model(creep: Any) -> None:
    moved = creep.simulate(RISING, time=TIME) + 0.25
    by_time = dbo.report(RISING, moved, time=TIME, model=creep)
    by_rate = dbo.report(RISING, moved, sample_rate=1000.0, model=creep)
    assert by_time.rmse == pytest.approx(0.25)
    assert by_rate.rmse == pytest.approx(0.25)


def test_a_set_is_a_mapping_of_models(tmp_path: Path) -> None:
    models = dbo.read_models(model("set"))
    assert list(models) == ["x", "y"] and dbo.read_model(model("set")) == models
    models.save(tmp_path / "set.json")
    assert dbo.read_model(tmp_path / "set.json") == models
    assert dbo.read_model(f"{tmp_path}/set.json::y") == models["y"]
    assert models["x"].inverse() != models["x"]
    with pytest.raises(KeyError):
        models["z"]


def test_an_attribute_that_there_is_not(creep: Any) -> None:
    assert creep.sign == "rising" and creep.input.unit == "V"
    with pytest.raises(AttributeError):
        creep.colour  # noqa: B018
