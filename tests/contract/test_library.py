"""``import dbo_cli as dbo``: the examples of DESIGN, section 3, their types, and the numbers of the shell."""

import inspect
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import dbo_cli as dbo
from dbo_cli.library import Move

from .program import (
    LOG, MOVE, SAMPLES, compensated, done, model, rms, store, table, write,
)  # fmt: skip

TIME = np.arange(400) / 1000.0
WANTED = 5.0 - 3.0 * np.cos(2.0 * np.pi * 5.0 * TIME)
SLOW = 2.5 - np.cos(2.0 * np.pi * 5.0 * TIME)
RISING = 50.0 - 50.0 * np.cos(30.0 * TIME)
QUICK = {
    "gears": 20, "points": 0, "delay": 0.0, "relaxation": (0.01, 0.3), "dynamics": 0
}  # fmt: skip
pytestmark = pytest.mark.filterwarnings("ignore::dbo_cli.errors.DboWarning")


@pytest.fixture
def small():
    return dbo.read_model(model("small"))


def test_every_public_name_is_there(creep):
    for name in dbo.__all__:
        assert getattr(dbo, name) is not None
    promised = "read_log read_model identify report DboError DboWarning"
    assert set(promised.split()) <= set(dbo.__all__)
    assert creep.sign == "rising" and creep.input.unit == "V"
    for owner in (dbo, creep):
        with pytest.raises(AttributeError):
            owner.colour  # noqa: B018


# --- signatures; what a type checker knows of them: ``tests/use_of_the_library.py`` ---

CALLS = [
    dbo.read_log, dbo.read_model, dbo.read_models, dbo.identify, dbo.report, dbo.Model.simulate,
    dbo.Model.compensate, dbo.Model.controller, dbo.Model.save, dbo.Model.save_state,
]  # fmt: skip


def test_a_signature_names_what_there_is():
    for call in CALLS:
        signature = inspect.signature(call)
        for parameter in signature.parameters.values():
            assert parameter.kind is not inspect.Parameter.VAR_KEYWORD
            if parameter.name != "self":
                assert parameter.annotation not in ("Any", inspect.Parameter.empty)
            if parameter.kind is inspect.Parameter.KEYWORD_ONLY:
                assert parameter.name in (call.__doc__ or "")
        assert signature.return_annotation not in ("Any", inspect.Signature.empty)
    # overloads take the keywords of a move from one table, which must hold every one
    named = set(inspect.signature(dbo.Model.compensate).parameters)
    assert set(Move.__annotations__) == named - {"self", "wanted", "time", "details"}


# --- logs and identification ---


def test_read_log_takes_columns_and_reading_options_and_has_units(log):
    frame = dbo.read_log(SAMPLES / "identification.csv")
    assert isinstance(frame, pd.DataFrame) and len(frame) == 15000
    assert frame.attrs["units"] == {"time": "s", "voltage": "V", "displacement": "um"}
    assert [frame[column].dtype for column in frame.attrs["units"]] == [float] * 3
    text = log.read_text().replace("voltage_V", "CH1").replace("displacement_um", "CH2")
    Path("run.csv").write_text(text)
    words = {"voltage": "CH1", "displacement": "CH2", "rows": "1:500"}
    frame = dbo.read_log("run.csv", **words, scale={"displacement": "10um/V"})
    moved = table(log)["displacement_um"][:500]
    np.testing.assert_allclose(frame["displacement"], 10.0 * moved)
    with pytest.raises(dbo.InputError, match=r"run\.csv"):
        dbo.read_log("run.csv")


def test_what_is_warned_of_is_part_of_the_result():
    drive = 50.0 - 50.0 * np.cos(np.arange(1200) * np.pi / 120.0)
    moved = dbo.read_model(model("small")).simulate(drive / 10.0)
    noise = np.random.default_rng(5).normal(0.0, 0.01, 1200)
    plain = {**QUICK, "relaxation": (), "force": True}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = dbo.identify(drive, moved + noise, sample_rate=500.0, **plain)
    said = [str(one.message) for one in caught if one.category is dbo.DboWarning]
    assert said and set(said) <= set(found.fit["warnings"])


def test_a_warning_points_at_the_line_that_called():
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        soft = dbo.read_model(model("small"))
        soft.compensate(np.linspace(1.0, 9.0, 50), sample_rate=1e3, from_=9.0)
        soft.simulate([0.0, 12.0])
    lines = {one.lineno for one in caught if one.filename == __file__}
    assert len(caught) >= 2 and len(lines) == 2


# --- models ---


def test_compensate_is_the_shell_s(creep):
    write("wish.csv", MOVE, TIME, SLOW)
    limits = ("--v-max", 60, "--max-slew", 2000, "--on-limit", "clip")
    shell = compensated("creep", *limits, "--from", 0, "--approach", "auto")
    options = {"v_max": 60, "max_slew": "2V/ms", "on_limit": "clip"}
    options |= {"from_": 0.0, "approach": "auto", "details": True}
    drive = creep.compensate(SLOW, time=TIME, **options)
    np.testing.assert_array_equal(drive.voltage, shell["voltage_V"])
    np.testing.assert_allclose(drive.time, shell["time_s"], atol=1e-12)
    plain = creep.compensate(SLOW, time=TIME)
    assert isinstance(plain, np.ndarray) and plain.shape == SLOW.shape


@pytest.mark.parametrize("zone", [None, "UTC", "Asia/Tokyo"])
def test_pandas_and_lists_come_in_with_their_clocks(creep, zone):
    expected = creep.simulate(RISING, time=TIME)
    index = pd.date_range("2026-01-01", periods=400, freq="1ms", tz=zone)
    seconds = pd.Index(TIME, name="time")
    for found in (
        creep.simulate(pd.Series(RISING, index=index)),
        creep.simulate(RISING, time=pd.Series(index)),
        creep.simulate(pd.Series(RISING, index=pd.to_timedelta(TIME, unit="s"))),
        creep.simulate(pd.Series(RISING, index=seconds)),
        creep.simulate(RISING.tolist(), time=TIME.tolist()),
    ):
        np.testing.assert_allclose(found, expected, atol=1e-7)
    expected = creep.compensate(SLOW, time=TIME)
    found = creep.compensate(pd.Series(SLOW, index=seconds))
    np.testing.assert_allclose(found, expected, atol=1e-7)
    with pytest.raises(dbo.DboError, match="sample_rate"):  # a plain count is no clock
        creep.simulate(pd.Series(RISING))


def test_what_is_wrong_is_an_error_of_a_class(small, creep):
    far = WANTED + 5.0
    with pytest.raises(dbo.LimitError):
        small.compensate(far, time=TIME)
    assert small.compensate(far, time=TIME, on_limit="clip").max() == 10.0
    with pytest.raises(dbo.DboError):
        small.compensate(WANTED, time=TIME, v_max="8um")
    with pytest.raises(dbo.DboError):
        small.compensate(np.array([5.0, np.nan, 6.0]))
    with pytest.raises(dbo.UsageError, match=r"outside.*extend"):
        small.simulate(WANTED, outside="Error")
    for wrong in ({"lag": 0.5}, {"rows": "12"}, {"rows": "0:4"}):
        with pytest.raises(dbo.UsageError, match=next(iter(wrong))):
            dbo.report(WANTED, WANTED, time=TIME, **wrong)
    with pytest.raises(dbo.DboError, match="sample_rate"):
        creep.simulate(WANTED)
    for time in (TIME[::-1], TIME[:-1]):
        with pytest.raises(dbo.DboError):
            creep.simulate(WANTED, time=time)
    with pytest.raises(dbo.OutputError):
        creep.save("no/where.json")


@pytest.mark.parametrize(
    "wrong",
    [
        {"slopes": "Growing"}, {"method": "Paper"}, {"sign": "up"}, {"zero": "first row"},
        {"gears": "12x"}, {"points": "x"}, {"relaxation": "0.1s,x"}, {"relaxation": ["a"]},
        {"delay": "soon"}, {"dynamics": "two"}, {"gears": 1.5}, {"gears": 2**40},
        {"points": 2.5}, {"points": 2**20},
    ],
)  # fmt: skip
def test_a_wrong_value_of_identify_is_named_and_not_taken_for_another(wrong):
    with pytest.raises(dbo.UsageError, match=next(iter(wrong))):
        dbo.identify(SLOW, WANTED, time=TIME, **wrong)


def test_a_list_that_holds_no_log_is_refused(small):
    """A pattern that matches no file was no learning, and no validation."""
    with pytest.raises(dbo.InputError, match=r"validate.*empty"):
        dbo.identify(SLOW, WANTED, time=TIME, **QUICK, validate=[])
    with pytest.raises(dbo.InputError, match=r"tracked.*empty"):
        small.compensate(WANTED, time=TIME, tracked=[])


def test_a_time_constant_is_typed_as_in_the_shell(creep):
    moved = creep.simulate(RISING, time=TIME)
    models = []
    for typed in (0, "0", [0.0], np.array([0]), np.int64(0)):
        options = {**QUICK, "relaxation": typed}
        models.append(dbo.identify(RISING, moved, time=TIME, **options))
    assert len({model.digest for model in models}) == 1


def test_plot_and_html(creep):
    axes = creep.plot().axes[0]
    label = axes.get_ylabel().replace("\N{GREEK SMALL LETTER MU}", "u")
    assert "V" in axes.get_xlabel() and "um" in label.replace("µ", "u")
    assert "100" in repr(creep)


def test_a_set_is_a_mapping_of_models(tmp_path):
    models = dbo.read_models(model("set"))
    assert list(models) == ["x", "y"]
    with pytest.raises(dbo.ModelError, match=r"set\.json::x"):
        dbo.read_model(model("set"))
    models.save(tmp_path / "set.json")
    assert dbo.read_models(tmp_path / "set.json") == models
    assert dbo.read_model(f"{tmp_path}/set.json::y") == models["y"]
    assert models["x"].inverse() != models["x"]
    with pytest.raises(KeyError):
        models["z"]


# --- reports ---


def test_report(creep, unpainted):
    error = np.random.default_rng(1).normal(0.0, 0.05, 400)
    found = dbo.report(WANTED, WANTED + error, time=TIME)
    assert found.rmse == pytest.approx(rms(error), rel=1e-12)
    frame = found.to_frame()
    assert isinstance(frame, pd.DataFrame) and len(frame) == 1
    assert found.to_html().lstrip().startswith("<")
    drawn = found.figures("figures")
    assert drawn and all(Path(one).exists() for one in drawn)
    assert found.passed is None
    assert dbo.report(WANTED, WANTED, time=TIME, max_rmse=0.1).passed is True
    moved = creep.simulate(RISING, time=TIME) + 0.25
    by_time = dbo.report(RISING, moved, time=TIME, model=creep)
    by_rate = dbo.report(RISING, moved, sample_rate=1000.0, model=creep)
    assert by_time.rmse == pytest.approx(0.25)
    assert by_rate.rmse == pytest.approx(0.25)


def test_a_report_of_a_drive_is_the_shell_s(creep):
    """Rows of the way back counted in the library, whose summary did not say when the move ends."""
    options = {"from_": 0.0, "approach": 0.5, "return_": 0.0, "v_max": 100}
    drive = creep.compensate(SLOW, time=TIME, details=True, **options)
    time, wanted, volts = drive.time, drive.desired, drive.voltage
    measured = creep.simulate(volts, time=time) + 0.01 * time
    write("drive.csv", "time_s,desired_um,voltage_V", time, wanted, volts)
    write("seen.csv", "time_s,voltage_V,measured_um", time, volts, measured)
    store("summary.json", drive.summary())
    line = ("report", "seen.csv", "--trajectory", "drive.csv", "--format", "json")
    shell = done(*line, "--expected", "summary.json").json["logs"][0]
    library = dbo.report(wanted, measured, time=time, expected=drive.summary())
    assert library.logs[0]["samples"] == shell["samples"] == len(SLOW)
    assert library.rmse == pytest.approx(shell["rmse"], rel=1e-9)


def test_a_report_leaves_the_process_alone():
    code = (
        "import signal, warnings, numpy as np, dbo_cli as dbo\n"
        "before = signal.getsignal(signal.SIGINT), list(warnings.filters)\n"
        "dbo.report(np.arange(9.0), np.arange(9.0), time=np.arange(9.0))\n"
        f"dbo.read_model({str(model('small'))!r}).compensate([2.0, 3.0, 4.0])\n"
        "print((signal.getsignal(signal.SIGINT), list(warnings.filters)) == before)\n"
    )
    line = [sys.executable, "-W", "ignore", "-c", code]
    ended = subprocess.run(line, capture_output=True, check=True)
    assert ended.stdout.strip() == b"True" and ended.stderr == b""


IDLE = {"state": {"state": "full"}, "voltage_unit": {"voltage_unit": "kV"}}


@pytest.mark.parametrize("name", IDLE)
def test_a_report_refuses_what_it_would_ignore(name):
    desired = 3.0 + np.sin(np.arange(100) / 9.0)
    frame = pd.DataFrame({"desired_um": desired, "measured_um": desired})
    for signals in ((desired, desired), (frame,)):
        with pytest.raises(dbo.UsageError):
            dbo.report(*signals, **IDLE[name])
    actuator = dbo.read_model(model("small"))
    with pytest.raises(dbo.UsageError, match="voltage"):
        dbo.report(desired, desired, model=actuator, voltage=desired)


def test_a_file_keeps_its_clock():
    log = write("log.csv", LOG, *np.zeros((3, 30)))
    with pytest.raises(dbo.UsageError, match="time"):
        dbo.identify(log, time=np.arange(30.0))
    with pytest.raises(dbo.UsageError, match="clock_offset"):
        dbo.read_log(log, clock_offset=0.5)
