"""One door for units: files, frames, Series, arrays and typed numbers; nothing is invented."""

import inspect
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import dbo_cli as dbo
from dbo_cli.recordings import RECORDING_ROLES
from dbo_cli.units import spell

from .program import MOVE as MOVED
from .program import (
    QUICK, compensated, model, refused, simulated, store, values_of, write,
)  # fmt: skip
from .program import dbo as shell

TIME = np.arange(400) / 1000.0
pytestmark = pytest.mark.filterwarnings("ignore::dbo_cli.errors.DboWarning")


def without_units():
    """Write a stored model that states no units."""
    values = values_of("creep")
    values["input"]["unit"] = values["output"]["unit"] = None
    return store("unitless.json", values)


# --- typed numbers ---

PLAIN = "states no unit: type a plain number"


def test_a_typed_unit_where_the_file_states_none():
    write("v.csv", "time_s,voltage", TIME, 98.0 * np.sin(TIME) ** 2)
    lines = "--v-max 200mV", "--v-min -1kV --v-max 120", "--v-max 50um"
    for words in (*lines, "--max-slew 1300V/min", "--v-max 120 --from 5V"):
        assert PLAIN in refused(2, "check", "v.csv", *words.split())
    assert shell("check", "v.csv", "--v-min", 0, "--v-max", 120).code == 0
    write("log.csv", "time_s,desired,measured", TIME, TIME, TIME + 0.001)
    assert PLAIN in refused(2, "report", "log.csv", "--max-rmse", "10nm")
    assert shell("report", "log.csv", "--max-rmse", 10).code == 0


def test_a_log_with_units_and_a_model_without_is_said():
    path, move = without_units(), 2.5 - np.cos(30.0 * TIME)
    text = "displacement_nm' is in nm, model or trajectory states no unit"
    write("move.csv", "time_s,displacement_nm", TIME, move)
    assert text in shell("compensate", path, "move.csv", "-o", "drive.csv").err
    series = dbo.read_log("move.csv")["displacement"]
    with pytest.warns(dbo.DboWarning, match=text.partition(" is ")[2]):
        dbo.read_model(path).compensate(series, time=TIME)
    write("move.csv", "time_s,displacement", TIME, move)
    assert "no unit" not in shell("compensate", path, "move.csv", "-o", "drive.csv").err


@pytest.mark.parametrize("figure", ["50mV", "50um", "50V"])
def test_a_typed_unit_where_the_model_states_none(figure):
    path = without_units()
    write("move.csv", "time_s,displacement", TIME, 2.5 - np.cos(30.0 * TIME))
    line = ("compensate", path, "move.csv", "-o", "drive.csv")
    for option in ("--v-max", "--from", "--return"):
        assert PLAIN in refused(2, *line, option, figure)
    assert PLAIN in refused(2, *line, "--max-slew", f"{figure}/s")
    assert PLAIN in refused(2, "export", path, "--v-max", figure, "-o", "firmware")
    actuator = dbo.read_model(path)
    for words in ({"v_max": figure}, {"from_": figure}, {"max_slew": f"{figure}/s"}):
        with pytest.raises(dbo.UsageError, match=PLAIN):
            actuator.compensate(2.5 - np.cos(30.0 * TIME), time=TIME, **words)
        with pytest.raises(dbo.UsageError, match=PLAIN):
            actuator.controller(sample_rate=1000.0, **words)


@pytest.mark.parametrize(
    ("unit", "pascal"),
    [("psi", 6894.757293), ("bar", 1e5), ("mbar", 100.0), ("kPa", 1000.0)],
)
def test_a_pressure_is_converted_to_ten_digits(unit, pascal):
    for factor, code in ((1.0 - 1e-9, 0), (1.0 + 1e-9, 3)):
        write("air.csv", "time_s,pressure_Pa", [0.0, 1.0], [0.0, pascal * factor])
        words = ("check", "air.csv", "--voltage", "pressure_Pa", "--v-max", f"1{unit}")
        assert shell(*words).code == code


# --- Series, frames and arrays ---

MOVE = 2.5 - np.cos(30.0 * TIME)
WRONG = 'displacement is in nm, the model in um: pass `unit="nm"`, or `.to_numpy()` for numbers in um'


@pytest.fixture
def nanometers():
    """Return a frame of ``read_log`` in nm and mV."""
    drive = 1e3 * (50.0 - 50.0 * np.cos(30.0 * TIME))
    write("u.csv", "t (ms),U (mV),x (nm)", 1e3 * TIME, drive, 1e3 * MOVE)
    return dbo.read_log("u.csv", voltage="U (mV)", displacement="x (nm)")


def test_a_series_in_another_unit_is_refused(creep, nanometers):
    moved, time = nanometers["displacement"], nanometers["time"]
    expected = creep.compensate(MOVE, time=TIME)
    rounded = creep.compensate(moved.to_numpy(), time=time, unit="nm")
    np.testing.assert_allclose(rounded, expected, rtol=0, atol=1e-9)
    named = creep.compensate(moved, time=time, unit="nm")
    np.testing.assert_array_equal(named, rounded)
    plain = creep.compensate((moved / 1e3).to_numpy(), time=time)
    np.testing.assert_allclose(plain, expected, rtol=0, atol=1e-9)
    for wrong in (moved, moved / 1e3, moved - moved[0], (moved / 1e3).rename(None)):
        with pytest.raises(dbo.InputError) as refusal:
            creep.compensate(wrong, time=time)
        assert str(refusal.value) == WRONG
        with pytest.raises(dbo.InputError, match="in nm, the model in um"):
            creep.inverse().simulate(wrong, time=time)
        with pytest.raises(dbo.InputError, match="in nm, the model in um"):
            dbo.report(TIME, wrong, time=time, model=creep)
    wrong_unit = 'voltage is in mV, the model in V: pass `unit="mV"`'
    with pytest.raises(dbo.InputError, match=wrong_unit):
        creep.simulate(nanometers["voltage"], time=time)
    with pytest.raises(dbo.InputError, match="is in nm, the model in V: give another"):
        creep.simulate(moved, time=time)
    with pytest.raises(dbo.UsageError, match="`unit` mV: not convertible to um"):
        creep.compensate(moved, time=time, unit="mV")


@pytest.mark.parametrize("library", [pd.Series, pl.Series])
def test_a_name_states_a_unit_as_a_header_does(library, creep):
    def series(values, name):
        if library is pd.Series:
            return library(values, name=name)
        return library(name, values)

    time = series(TIME, "t_s")
    with pytest.raises(dbo.InputError) as refusal:
        creep.compensate(series(1e3 * MOVE, "x (nm)"), time=time)
    assert str(refusal.value) == WRONG
    for name in ("x (um)", "x", "Weg [µm]", "data[2]"):
        drive = creep.compensate(series(MOVE, name), time=time)
        np.testing.assert_array_equal(drive, creep.compensate(MOVE, time=TIME))
    with pytest.raises(dbo.InputError, match="`time` is in ms"):
        creep.compensate(MOVE, time=series(1e3 * TIME, "t (ms)"))


def test_report_takes_two_signals_in_one_unit(nanometers):
    moved = nanometers["displacement"]
    wished = pd.Series(MOVE, name="desired_um")
    with pytest.raises(dbo.InputError, match="desired is in um, measured in nm"):
        dbo.report(wished, moved, time=TIME)
    same = dbo.report(moved, moved + 10.0, time=TIME, max_rmse="0.02um")
    assert same.unit == "nm" and same.rmse == pytest.approx(10.0) and same.passed
    assert dbo.report(MOVE, MOVE, time=TIME).unit is None
    with pytest.raises(dbo.UsageError, match=PLAIN):
        dbo.report(MOVE, MOVE, time=TIME, max_rmse="10nm")


def test_a_unit_that_one_of_two_signals_states_is_no_unit_of_both():
    """Desired in nm beside a bare array is refused; a column beside one with a unit is said."""
    wished = pd.Series(MOVE, name="wished (nm)")
    for pair in ((wished, MOVE), (MOVE, wished)):
        with pytest.raises(dbo.InputError, match="no unit"):
            dbo.report(*pair, time=TIME)
    write("log.csv", "time_s,desired_nm,measured", TIME, MOVE, MOVE)
    assert "measured states no unit" in shell("report", "log.csv").err
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        dbo.report(wished, MOVE, time=TIME, unit="nm")


def test_a_drive_of_a_report_is_taken_in_the_unit_that_is_given(creep):
    volts = 50.0 - 50.0 * np.cos(30.0 * TIME)
    expected = dbo.report(volts, MOVE, time=TIME, model=creep).rmse
    again = dbo.report(1e3 * volts, MOVE, time=TIME, model=creep, voltage_unit="mV")
    assert again.rmse == pytest.approx(expected, rel=1e-12)
    drive = pd.Series(volts, name="U (V)")
    found = dbo.report(MOVE, MOVE, time=TIME, voltage=drive, voltage_unit="mV")
    assert found.voltage_unit == "mV"


def masked(values):
    hidden = np.ma.array(values.copy(), mask=np.zeros(len(values), bool))
    hidden[7] = np.ma.masked
    hidden.data[7] = 1e36
    return hidden


def test_a_masked_row_is_a_missing_row(creep):
    far = MOVE.copy()
    far[7] = 9.97e36
    nothing = pd.Series(MOVE).astype("Float64")
    nothing[7] = pd.NA
    polar = pl.Series([*MOVE[:7], None, *MOVE[8:]])
    for wrong in (masked(MOVE), far, nothing, polar, [*MOVE[:7], None, *MOVE[8:]]):
        with pytest.raises(dbo.InputError, match="row 8"):
            creep.compensate(wrong, time=TIME)
        with pytest.raises(dbo.InputError, match="row 8"):
            creep.simulate(wrong, time=TIME)
        with pytest.raises(dbo.InputError, match="row 8"):
            dbo.report(MOVE, wrong, time=TIME)
        with pytest.raises(dbo.InputError, match="row 8"):
            dbo.identify(TIME, wrong, time=TIME)
    with pytest.raises(dbo.InputError, match="row 8"):
        creep.compensate(MOVE, time=masked(TIME))
    for wrong in (MOVE > 2.5, MOVE.astype(complex), MOVE.astype(str), MOVE[:, None]):
        with pytest.raises(dbo.InputError, match="of numbers"):
            creep.compensate(wrong, time=TIME)


def test_truth_is_no_rate_and_no_limit(creep):
    for wrong in (True, False, np.True_, float("nan"), "5 5"):
        with pytest.raises(dbo.UsageError, match="v_max"):
            creep.compensate([2.0, 2.1, 2.2], sample_rate=1000.0, v_max=wrong)
    with pytest.raises(dbo.UsageError, match="max_slew"):
        creep.controller(sample_rate=1000.0, max_slew=-1.0)
    write("log.csv", "voltage_V,displacement_um", TIME, MOVE)
    for wrong in (True, np.True_, 0, -5.0, float("nan"), "5V"):
        for call in (
            lambda wrong: creep.simulate(MOVE, sample_rate=wrong),
            lambda wrong: creep.compensate(MOVE, sample_rate=wrong),
            lambda wrong: creep.controller(sample_rate=wrong),
            lambda wrong: creep.controller(wrong),
            lambda wrong: dbo.identify(TIME, MOVE, sample_rate=wrong),
            lambda wrong: dbo.report(MOVE, MOVE, sample_rate=wrong),
            lambda wrong: dbo.read_log("log.csv", sample_rate=wrong),
        ):
            with pytest.raises(dbo.UsageError, match="sample_rate"):
                call(wrong)
    typed, plain = (creep.simulate(MOVE, sample_rate=rate) for rate in ("1kHz", 1e3))
    np.testing.assert_array_equal(typed, plain)


# --- recordings: files, frames and arrays are one way ---

PLAIN_GEARS = {"gears": 20, "points": 0, "delay": 0.0, "relaxation": ()}


def quick(*data, **more):
    return dbo.identify(*data, **PLAIN_GEARS, dynamics=0, slopes="growing", **more)


@pytest.fixture
def played():
    """Return time, volts and micrometers of some swings of a stored model."""
    time = np.arange(900) / 300.0
    swing = np.repeat([50.0, 40.0, 25.0], 300)
    volts = 50.0 - swing * np.cos(2.0 * np.pi * time)
    moved = dbo.read_model(model("known")).simulate(volts, time=time)
    return time, volts, moved + 0.002 * np.cos(977.0 * time)


HEADERS = ["t (ms),U (mV),x [nm]", "time,voltage,displacement", "t_s,U_V,x_um"]


@pytest.mark.parametrize("header", HEADERS)
def test_a_frame_and_a_file_give_the_same_bytes(header, played):
    write("run.csv", header, *played)
    shell("identify", "run.csv", *QUICK, "-o", "shell.json", "-q")
    frame = pd.read_csv("run.csv")
    file, nameless = Path("shell.json").read_text(), "the frame"
    for data, expected in (
        (dbo.read_log("run.csv"), file),
        (Path("run.csv"), file),
        (frame, file.replace("run.csv", nameless)),
        (pl.from_pandas(frame), file.replace("run.csv", nameless)),
    ):
        found = quick(data)
        assert found.input.unit == dbo.read_model("shell.json").input.unit
        found.save("library.json")
        assert Path("library.json").read_text() == expected
    assert len(quick([frame, frame]).fit["logs"]) == 2


def test_no_unit_is_invented(played):
    time, volts, moved = played
    drive = pd.Series(volts, name="U (V)")
    nanometers = pd.Series(1e3 * moved, name="x (nm)")
    named = quick(drive, nanometers, time=time)
    assert (named.input.unit, named.output.unit) == ("V", "nm")
    bare = quick(volts, moved, time=time)
    assert (bare.input.unit, bare.output.unit) == (None, None)
    typed = quick(volts, moved, time=time, voltage_unit="V", displacement_unit="um")
    assert (typed.input.unit, typed.output.unit) == ("V", "um")
    frame = pd.DataFrame({"time": time, "voltage": volts, "displacement": moved})
    assert quick(frame).output.unit is None
    first, second = quick(frame), quick(frame.set_index("time"))
    pair = [one.simulate(volts, time=time) for one in (first, second)]
    np.testing.assert_array_equal(*pair)
    with pytest.raises(dbo.InputError, match=r"`voltage`.*of a frame: rename"):
        dbo.identify(pd.DataFrame({"a": volts, "b": moved}))


def test_a_prior_has_units(played):
    time, volts, moved = played
    prior = quick(volts, moved, time=time, voltage_unit="V", displacement_unit="um")
    prior.save("prior.json")
    write("run.csv", "t_s,U_V,x_nm", time, volts, 1e3 * moved)
    shell("identify", "run.csv", "--prior", "prior.json", "-o", "again.json", "-q")
    again, frame = dbo.read_model("again.json"), dbo.read_log("run.csv")
    for found in (again, dbo.identify(frame, prior=prior)):
        assert found.output.unit == "um"
        assert found.output.span == pytest.approx(prior.output.span, rel=1e-3)
    columns = frame["voltage"], frame["displacement"]
    with pytest.raises(dbo.InputError, match="displacement is in nm, the model in um"):
        dbo.identify(*columns, time=time, prior=prior)
    with pytest.raises(dbo.InputError, match="899 rows"):
        dbo.identify(volts, moved[:-1], time=time)


def test_whole_frames_are_read_as_files_are(creep, nanometers):
    drive = creep.compensate(nanometers)
    np.testing.assert_allclose(drive, creep.compensate(MOVE, time=TIME), atol=1e-9)
    with pytest.raises(dbo.UsageError, match="`unit`"):
        creep.compensate(nanometers, unit="nm")
    renamed = nanometers.rename(columns={"displacement": "position"})
    with pytest.raises(dbo.InputError, match="'position' has no unit"):
        creep.compensate(renamed)
    with pytest.raises(dbo.InputError, match="in nm, the model in um"):
        creep.compensate(renamed["position"], time=renamed["time"])
    named = nanometers.rename(columns={"displacement": "position (nm)"})
    np.testing.assert_array_equal(creep.compensate(named), drive)


def test_a_state_is_of_its_model(creep):
    other = dbo.read_model(model("soft"))
    drive = 50.0 - 50.0 * np.cos(30.0 * TIME)
    _, state = creep.simulate(drive, time=TIME, return_state=True)
    planned = creep.compensate(MOVE, time=TIME, details=True).state
    live = creep.controller(sample_rate=1000.0)
    live.step(2.5)
    creep.save_state(state, "st.json")
    for own in (state, planned, live.state, "st.json", Path("st.json")):
        creep.simulate(drive, time=TIME, state=own)
        creep.inverse().simulate(MOVE, time=TIME, state=own)
        creep.controller(sample_rate=1000.0, state=own)
        for refusing in (
            lambda own: other.simulate(drive, time=TIME, state=own),
            lambda own: other.compensate(MOVE, time=TIME, state=own),
            lambda own: other.controller(sample_rate=1000.0, state=own),
            lambda own: dbo.report(drive, MOVE, time=TIME, model=other, state=own),
            lambda own: other.save_state(own, "no.json"),
        ):
            with pytest.raises(dbo.ModelError, match="belongs to another model"):
                refusing(own)
    by_file = creep.controller(sample_rate=1000.0, state="st.json")
    by_value = creep.controller(sample_rate=1000.0, state=state)
    assert [by_file.step(x) for x in MOVE] == [by_value.step(x) for x in MOVE]
    with pytest.raises(dbo.InputError, match=r"no\.json"):
        creep.controller(sample_rate=1000.0, state="no.json")
    with pytest.raises(dbo.ModelError, match="give auto"):
        creep.simulate(MOVE, time=TIME, state=None)


def test_nothing_is_no_signal(creep):
    for call in (creep.simulate, creep.compensate, creep.inverse().simulate):
        with pytest.raises(dbo.InputError, match="give an array"):
            call(None)
    for logs in (None, []):
        with pytest.raises(dbo.InputError, match="no log"):
            dbo.identify(logs)


@pytest.mark.parametrize("names", [[None, None], ["time_s", "t_s"]])
def test_two_times_of_an_index_are_asked_about(names, creep):
    index = pd.MultiIndex.from_arrays([TIME, 2.0 * TIME], names=names)
    drive = pd.Series(np.linspace(1.0, 2.0, len(TIME)), index)
    with pytest.raises(dbo.InputError, match=r"which level .* Give `time`"):
        creep.simulate(drive)
    creep.simulate(drive, time=TIME)


# --- the property: library and shell are one ---

UNITS = {
    "voltage": ["V", "mV", "kV", None],
    "displacement": ["um", "nm", "mm", "µm", None],
    "time": ["s", "ms", "us"],
}
SIZES = {"mV": 1e3, "kV": 1e-3, "nm": 1e3, "mm": 1e-3, "ms": 1e3, "us": 1e6}
SHAPES = ["{}_{}", "{} ({})", "{} [{}]", "{}/{}", "{} in {}"]


def header(name, unit, shape):
    return name if unit is None else shape.format(name, unit)


@settings(max_examples=25)
@given(
    units=st.fixed_dictionaries({k: st.sampled_from(v) for k, v in UNITS.items()}),
    shape=st.sampled_from(SHAPES),
    order=st.permutations(["time", "voltage", "displacement"]),
    seed=st.integers(0, 2**32 - 1),
    library=st.sampled_from(["read_log", "pandas", "polars", "index"]),
)
def test_the_library_reads_what_the_shell_reads(units, shape, order, seed, library):
    draw = np.random.default_rng(seed)
    time = np.cumsum(draw.uniform(0.8e-3, 1.2e-3, 200))
    signals = {"time": time}
    rows, corners = np.arange(200), np.arange(0, 201, 20)
    for role, low, high in (("voltage", 0.0, 100.0), ("displacement", 1.0, 5.0)):
        signals[role] = np.interp(rows, corners, draw.uniform(low, high, 11))
    names = {role: header(role, units[role], shape) for role in order}
    columns = [SIZES.get(units[role] or "", 1.0) * signals[role] for role in order]
    write("log.csv", ",".join(names[role] for role in order), *columns)
    data = pl.read_csv("log.csv").to_pandas()
    frame = {
        "read_log": lambda: dbo.read_log("log.csv"),
        "pandas": lambda: data,
        "polars": lambda: pl.read_csv("log.csv"),
        "index": lambda: data.set_index(names["time"]),
    }[library]()
    actuator = dbo.read_model(model("creep"))
    volts = compensated("creep", "--on-limit", "clip", wish="log.csv")["voltage_V"]
    moved = simulated("creep", "log.csv")
    near = {"rtol": 0, "atol": 1e-10}
    np.testing.assert_allclose(actuator.simulate(frame), moved, **near)
    driven = actuator.compensate(frame, on_limit="clip")
    np.testing.assert_allclose(driven, volts, **near)
    # the same columns as Series: taken as they are, or refused; never as something else
    clip = {"time": time, "on_limit": "clip"}
    for role, call, wanted in (
        ("voltage", lambda x: actuator.simulate(x, time=time), "V"),
        ("displacement", lambda x: actuator.compensate(x, **clip), "um"),
    ):
        series, unit = data[names[role]], spell(units[role])
        if unit in (wanted, None):
            np.testing.assert_array_equal(call(series), call(series.to_numpy()))
            continue
        refusal = f"is in {unit}, the model in {wanted}"
        with pytest.raises(dbo.InputError, match=refusal):
            call(series)


def test_a_report_of_a_frame_is_that_of_a_file(creep):
    drive = 50.0 - 50.0 * np.cos(30.0 * TIME)
    moved = 1e3 * creep.simulate(drive, time=TIME) + 7.0
    head = "time_s,U_mV,desired_um,measured_nm"
    write("log.csv", head, TIME, 1e3 * drive, MOVE, moved)
    for words, more in (((), {}), (("--model", model("creep")), {"model": creep})):
        printed = shell("report", "log.csv", *words, "--format", "json").json
        for frame in (pl.read_csv("log.csv"), pl.read_csv("log.csv").to_pandas()):
            found = dbo.report(frame, **more)
            assert found.rmse == printed["logs"][0]["rmse"]
            assert found.unit == printed["unit"] == "um"
    with pytest.raises(dbo.UsageError, match="a frame has its own"):
        dbo.report(frame, MOVE)
    with pytest.raises(dbo.UsageError, match="give `desired` and `measured`"):
        dbo.report(MOVE)


def test_a_report_of_arrays_is_that_of_a_frame(creep):
    drive, desired = 50.0 - 50.0 * np.cos(30.0 * TIME), pd.Series(MOVE, name="x (um)")
    measured = pd.Series(MOVE + 0.007, name="y (um)")
    frame = pd.DataFrame(
        {"t_s": TIME, "U_V": drive, "desired_um": desired, "measured_um": measured}
    )
    for arrays, more in (
        ((desired, measured), {}),
        ((drive, measured), {"model": creep}),
    ):
        found, expected = (
            dbo.report(*arrays, time=TIME, **more),
            dbo.report(frame, **more),
        )
        assert (found.rmse, found.unit) == (expected.rmse, expected.unit)
    bare = dbo.read_model(without_units())  # a unit was ignored, and a clock taken
    with pytest.raises(dbo.UsageError, match="the model states no unit"):
        dbo.report(drive, MOVE, time=TIME, model=bare, voltage_unit="V")
    with pytest.raises(dbo.InputError, match=r"goes back in row 2.* `rows` :1,"):
        dbo.report(MOVE, MOVE, time=TIME[::-1])


def test_learning_is_that_of_the_shell():
    actuator = dbo.read_model(model("known"))
    write("move.csv", MOVED, TIME, MOVE)
    drive = actuator.compensate(MOVE, time=TIME)
    moved = 1e3 * (actuator.simulate(drive, time=TIME) + 0.02 * np.sin(60.0 * TIME))
    write("tracked.csv", "time_s,voltage_mV,measured_nm", TIME, 1e3 * drive, moved)
    words = ("--tracked", "tracked.csv", "--history", "shell.json", "--absolute")
    written = compensated("known", *words, wish="move.csv")["voltage_V"]
    frame = pl.read_csv("tracked.csv")
    options = {"time": TIME, "absolute": True, "details": True}
    sources = "tracked.csv", Path("tracked.csv"), frame, frame.to_pandas(), [frame]
    for source in sources:
        for history in ("python.json", ()):
            options |= {"tracked": source, "history": history}
            learned = actuator.compensate(MOVE, **options)
            np.testing.assert_allclose(learned.voltage, written, rtol=0, atol=1e-9)
            assert len(learned.history) == 1
        assert Path("python.json").read_bytes() == Path("shell.json").read_bytes()
        Path("python.json").unlink()
    alone = {"history": learned.history}, {"history": "new.json"}, {"absolute": True}
    for more in alone:
        with pytest.raises(dbo.UsageError, match="needs `tracked`"):
            actuator.compensate(MOVE, time=TIME, **more)
    assert not Path("new.json").exists()


def test_a_role_is_known_to_shell_and_library():
    """Who adds a role to recordings adds it to the functions that read them."""
    from dbo_cli.cli import compare, identify

    for role in RECORDING_ROLES:
        for call in (dbo.read_log, compare.compare, identify.identify):
            assert role in inspect.signature(call).parameters


# --- other members of the kind ---


def test_a_generator_s_limits_have_the_units_of_the_drive():
    volts = 40.0 + 40.0 * np.sin(TIME)
    line = ("--to", "npy", "-o", "drive.npy", "--v-max")
    write("bare.csv", "time_s,voltage", TIME, volts)
    assert PLAIN in refused(2, "waveform", "bare.csv", *line, "200mV")
    assert shell("waveform", "bare.csv", *line, 120).code == 0
    np.testing.assert_array_equal(np.load("drive.npy"), volts)
    write("mv.csv", "time_s,voltage_mV", TIME, 1e3 * volts)
    assert shell("waveform", "mv.csv", *line, "120V").code == 0
    np.testing.assert_allclose(np.load("drive.npy"), volts, atol=1e-9)
    write("bar.csv", "time_s,pressure_bar", TIME, volts)
    error = refused(1, "waveform", "bar.csv", *line, 120, "--voltage", "pressure_bar")
    assert "bar.csv: the drive is in bar, not V: add --scale" in error


def test_a_range_has_a_unit_that_there_is():
    line = ("trajectory", "sine", "--rate", 1000, "--frequency", 5, "--range")
    assert "no unit" in refused(2, *line, "0:5volts_or_so")
    assert shell(*line, "0:5µm").out.startswith("time_s,displacement_um")
    assert PLAIN in refused(2, *line, "0:5um", "--model", without_units())
    values = values_of("small")
    values["output"] |= {"unit": "nm"}  # a plain range asks for the unit
    by_model = ("--model", store("nm.json", values))
    assert "3:10nm or 3:10um" in refused(2, *line, "3:10", *by_model)
    assert shell(*line, "3:8nm", *by_model).out.startswith("time_s,displacement_nm")


def test_a_model_in_mv_says_its_voltages_in_full():
    values = values_of("small")
    values["input"] |= {"unit": "mV", "max": 1e5}
    values["stages"][0]["dx"] = [1e4 * width for width in values["stages"][0]["dx"]]
    path = store("mv.json", values)
    write("move.csv", MOVED, TIME, 5.0 - 4.9 * np.cos(30.0 * TIME))
    words = ("move.csv", "--on-limit", "clip", "-o", "d.csv")
    said = shell("compensate", path, *words).err
    assert " mV" in said and "e+0" not in said


def test_an_expected_error_is_said_in_full(played):
    time, volts, moved = played
    model = quick(volts, 1e5 * moved, time=time)
    drive = model.compensate(1e5 * moved, time=time, on_limit="clip", details=True)
    assert drive.expected_error > 100.0 and "e+" not in drive.expected_line()


def test_logs_of_one_actuator_have_units_alike(played):
    time, volts, moved = played
    write("a.csv", "time,voltage,displacement", time, volts, moved)
    write("b.csv", "t_s,U_V,x_nm", time, volts, 1e3 * moved)
    error = refused(1, "identify", "a.csv", "b.csv", *QUICK, "-o", "m.json")
    assert "b.csv: voltage is in V, a.csv states no unit" in error
    with pytest.raises(dbo.InputError, match="states no unit"):
        quick(["a.csv", dbo.read_log("b.csv")])


def test_typed_figures_of_python(played):
    time, volts, moved = played
    plain = {**PLAIN_GEARS, "dynamics": 0, "relaxation": (0.02, 0.3)}
    expected = dbo.identify(volts, moved, time=time, **plain, skip=0.1)
    typed = {**plain, "relaxation": ("20ms", 0.3), "skip": "100ms"}
    assert dbo.identify(volts, moved, time=time, **typed) == expected
    for word in ("zero", "gears", "points", "delay", "skip", "sensor_delay"):
        with pytest.raises(dbo.UsageError, match=f"`{word}` True"):
            dbo.identify(volts, moved, time=time, **{word: True})
    within = dbo.report(moved, moved, time=time, max_nrmse_percent="1%")
    assert within.passed
    index = pd.Series(volts, index=pd.Index(1e3 * time, name="t (ms)"))
    in_ms = expected.simulate(index)
    assert in_ms == pytest.approx(expected.simulate(volts, time=time), abs=1e-9)


def test_attrs_and_a_name_that_disagree_are_refused():
    move = 2.5 - np.cos(30.0 * TIME)
    drive = dbo.read_model(model("creep")).compensate
    series = pd.Series(1e3 * move, index=TIME, name="x_nm")
    series.attrs["units"] = "um"
    with pytest.raises(dbo.InputError, match="attrs"):
        drive(series)
    with pytest.raises(dbo.InputError, match="attrs"):
        drive(series.to_frame())
    clock = pd.Series(move, index=pd.Index(1e3 * TIME, name="ms"))
    assert drive(clock) == pytest.approx(drive(move, time=TIME), abs=1e-9)


INDEXES = {
    "integers": pd.Index((1e6 * TIME).round().astype(int), name="t_us"),
    "a count": pd.RangeIndex(0, 1000 * len(TIME), 1000, name="t_us"),
    "categories": pd.CategoricalIndex(TIME, name="time_s"),
}


@pytest.mark.parametrize("name", INDEXES)
def test_an_index_that_is_called_a_time_is_no_plain_count(name, creep):
    """A frame that went without it had no clock."""
    volts = 2.0 - 2.0 * np.cos(30.0 * TIME)
    series = pd.Series(volts, index=INDEXES[name], name="voltage_V")
    expected = creep.simulate(volts, time=TIME)
    for source in (series, series.to_frame()):
        np.testing.assert_allclose(creep.simulate(source), expected, atol=1e-12)


TEXTS = [f"{second:.3f}" for second in TIME]


@pytest.mark.parametrize(
    ("times", "name", "words"),
    [
        (TEXTS, "time_s", "time"),
        (TEXTS, "time", "time"),
        (1e3 * TIME, None, "has no unit, and in seconds"),
        (1e3 * TIME, "time", "has no unit, and in seconds"),
        (1e3 * TIME, "t", "has no unit, and in seconds"),
    ],
)
def test_an_index_that_is_no_clear_clock_is_refused(times, name, words, creep):
    series = pd.Series(2.0 + TIME, pd.Index(times, name=name), name="voltage_V")
    for source in (series, series.to_frame()):
        with pytest.raises(dbo.InputError, match=words):
            creep.simulate(source)
    if times is TEXTS:
        return
    with pytest.raises(dbo.InputError, match="has no unit, and in seconds"):
        dbo.identify(series, series.rename("displacement_um"))
    assert len(creep.simulate(series.set_axis(pd.Index(1e3 * TIME, name="t_s")))) == 400


def test_two_series_have_one_clock(played):
    time, volts, moved = played
    drive = pd.Series(volts, index=time, name="voltage_V")
    for clock in (1.1 * time, time[::-1], time + 0.5):
        moves = pd.Series(moved, index=clock, name="displacement_um")
        with pytest.raises(dbo.InputError, match="have other times"):
            quick(drive, moves)
        with pytest.raises(dbo.InputError, match="have other times"):
            dbo.report(moves.set_axis(time), moves)
        assert quick(drive, moves, time=time) == quick(drive, moves.set_axis(time))
    days = pd.to_datetime(time, unit="s") + np.timedelta64(1, "D")
    for clock in (days, pd.to_timedelta(time, unit="h")):
        with pytest.raises(dbo.InputError, match="other times"):
            quick(drive.set_axis(pd.to_datetime(time, unit="s")), moves.set_axis(clock))
    assert quick(volts, moves.set_axis(time)) == quick(volts, moved, time=time)
