"""The program from Python: the commands' bits, the shell's messages, exceptions of one kind each."""

from __future__ import annotations

import dataclasses
import json
import math
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from conftest import ROOT, SMALL_MODEL
from test_cli_signals import lagging_model

import dbo_cli as dbo_api
from dbo_cli.hysteresis.move_error import move_error

LOG = ROOT / "sample_data" / "identification.csv"
TRAJECTORY = ROOT / "sample_data" / "trajectory.csv"


def column(path: str, number: int) -> np.ndarray[Any, Any]:
    return np.loadtxt(path, delimiter=",", skiprows=1)[:, number]


@pytest.fixture(scope="module")
def sample_model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the model of the sample log, identified by the command."""
    path = tmp_path_factory.mktemp("model") / "model.json"
    from dbo_cli.cli.app import main

    assert main(["identify", str(LOG), "-o", str(path), "-q"]) == 0
    return path


@pytest.fixture
def lagging(tmp_path: Path) -> dbo_api.Model:
    path = tmp_path / "lagging.json"
    path.write_text(json.dumps(lagging_model()))
    return dbo_api.read_model(path)


@pytest.fixture
def small(tmp_path: Path) -> dbo_api.Model:
    path = tmp_path / "small.json"
    path.write_text(json.dumps(SMALL_MODEL))
    return dbo_api.read_model(path)


def test_identify_gives_the_bytes_of_the_command(
    sample_model: Path, tmp_path: Path
) -> None:
    model = dbo_api.identify(dbo_api.read_log(LOG))
    model.save(tmp_path / "api.json")
    assert (tmp_path / "api.json").read_bytes() == sample_model.read_bytes()
    log = dbo_api.read_log(LOG)
    arrays = dbo_api.identify(
        log["voltage"],
        log["displacement"],
        time=log["time"],
        voltage_unit="V",
        displacement_unit="um",
    )
    assert (
        json.loads(arrays.to_json())["stages"]
        == json.loads(sample_model.read_text())["stages"]
    )


def test_compensate_and_simulate_give_the_bits_of_the_commands(
    dbo: Any, sample_model: Path
) -> None:
    model = dbo_api.read_model(sample_model)
    assert dbo("compensate", sample_model, TRAJECTORY, "-o", "drive.csv").code == 0
    table = dbo_api.read_log(TRAJECTORY)
    for given in (table, str(TRAJECTORY)):
        assert model.compensate(given).tolist() == column("drive.csv", 2).tolist()
    drive = model.compensate(table["displacement"], time=table["time"])
    assert drive.tolist() == column("drive.csv", 2).tolist()
    assert dbo("simulate", sample_model, "drive.csv", "-o", "back.csv").code == 0
    back = model.simulate(drive, time=table["time"])
    assert back.tolist() == column("back.csv", 2).tolist()
    assert (
        dbo_api.simulate(sample_model, drive, time=table["time"]).tolist()
        == back.tolist()
    )
    assert dbo_api.compensate(sample_model, table).tolist() == drive.tolist()


@pytest.mark.usefixtures("blank_figures")
def test_a_report_has_the_numbers_of_the_command(dbo: Any, sample_model: Path) -> None:
    done = dbo(
        "report",
        LOG,
        "--model",
        sample_model,
        "--format",
        "json",
        "--segment",
        "cycles",
    )
    report = dbo_api.report(LOG, model=sample_model, segment="cycles")
    assert report.to_json() == done.out
    log = dbo_api.read_log(LOG)
    arrays = dbo_api.report(
        log["voltage"],
        log["displacement"],
        time=log["time"],
        model=sample_model,
        unit="um",
    )
    assert arrays.rmse == report.rmse
    assert arrays.to_frame().loc["log", "rmse"] == report.rmse
    report.figures("figures")
    assert any(path.suffix == ".png" for path in Path("figures").iterdir())
    assert report.to_html().startswith("<!")


@pytest.mark.usefixtures("blank_figures")
def test_a_report_of_several_logs_has_their_errors_in_one_figure(
    dbo: Any, tmp_path: Path
) -> None:
    logs, tables = [], []
    for number in (1, 2):
        wanted = np.sin(np.arange(300) / 20.0)
        measured = wanted + 0.01 * number * np.random.default_rng(number).normal(
            size=300
        )
        columns = {
            "time_s": np.arange(300) / 100.0,
            "desired_um": wanted,
            "measured_um": measured,
        }
        tables.append(pd.DataFrame(columns))
        logs.append(tmp_path / f"pass{number}.csv")
        tables[-1].to_csv(logs[-1], index=False)
    done = dbo("report", *logs, "--format", "json", "--figures", "shell")
    several = dbo_api.report(logs)
    assert several.to_json() == done.out
    several.figures("api")
    names = {path.name for path in Path("api").iterdir()}
    assert names == {path.name for path in Path("shell").iterdir()}
    assert {
        "all-logs-errors.svg",
        "all-logs-errors.png",
        "pass1-error.svg",
        "pass2-error.svg",
    } <= names
    page = several.to_html()
    assert page.index("Error of all logs against time") < page.index(
        "Error against time"
    )
    rmse = [log.figures.rmse for log in several.report.logs]
    assert [log.figures.rmse for log in dbo_api.report(tables).report.logs] == rmse


def test_compensate_from_arrays_reads_ahead_by_the_models_delay(tmp_path: Path) -> None:
    document = json.loads(json.dumps(SMALL_MODEL))
    document["stages"].append({"type": "delay", "seconds": 0.02})
    (tmp_path / "delayed.json").write_text(json.dumps(document))
    model = dbo_api.read_model(tmp_path / "delayed.json")
    t = np.arange(2000) / 1000
    wanted = 5.0 + 3.5 * np.sin(2 * np.pi * 2 * t)
    drive = model.compensate(wanted, time=t, state="empty")
    back = model.simulate(drive, time=t, state="empty")
    assert np.abs(back - wanted)[20:].max() < 1e-12


def test_states_go_on(lagging: dbo_api.Model, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    t, v = (
        np.cumsum(rng.uniform(0.01, 0.1, 400)),
        5.0 + 4.0 * np.sin(np.cumsum(rng.normal(0, 0.3, 400))),
    )
    whole = lagging.simulate(v, time=t)
    first, state = lagging.simulate(v[:137], time=t[:137], return_state=True)
    lagging.save_state(state, tmp_path / "s.json")
    rest = lagging.simulate(v[137:], time=t[137:], state=tmp_path / "s.json")
    assert np.concatenate([first, rest]).tolist() == whole.tolist()
    assert lagging.read_state(tmp_path / "s.json") == state


def test_what_must_be_said_is_data_or_a_warning(small: dbo_api.Model) -> None:
    with pytest.warns(
        dbo_api.DboWarning, match=r"1 of 2 samples \(row 2\) beyond what the limits"
    ):
        small.compensate([2.0, 20.0], on_limit="clip")
    result = small.compensate([2.0, 20.0], on_limit="clip", details=True)
    assert (result.clipped, result.values[-1], len(result.warnings)) == (1, 10.0, 1)
    with pytest.warns(dbo_api.DboWarning, match="outside the range of the model"):
        small.simulate([0.0, 12.0])
    with pytest.raises(dbo_api.LimitError, match=r"\(`on_limit` clip goes on\)$"):
        small.compensate([2.0, 20.0], on_limit="error")


@pytest.mark.whole
def test_compensate_says_what_error_to_expect_of_the_move(
    dbo: Any, sample_model: Path
) -> None:
    expected = json.loads(sample_model.read_text())["fit"]["expected_rmse"]
    model = dbo_api.read_model(sample_model)
    table = dbo_api.read_log(TRAJECTORY)
    moved = float(np.ptp(table["displacement"]))
    drive = model.compensate(table)
    found = move_error(model.actuator, drive, float(np.median(np.diff(table["time"]))))
    assert found is not None
    assert 0.5 * expected < found.rmse < 2.0 * expected
    percent = f"{100.0 * found.rmse / moved:.2g} % of the move"
    told = (
        f"expected error of the move {found.rmse:.3g} um RMS ({percent}): shape {found.shape:.3g} um, zero "
        f"{found.zero:.3g} um ({model.actuator.fit['zero_from']}); that is from the start assumed (settled "
        "at the first row) or after --condition, from an unknown past "
    )
    assert (
        f"trajectory.csv: {told}"
        in dbo("compensate", sample_model, TRAJECTORY, "-o", "drive.csv").err
    )
    swept = model.compensate(table, details=True, condition=True)
    assert any("expected error of the move 0.0" in note for note in swept.notes)
    assert not any("unknown past" in note for note in swept.notes)
    loop = 6.0 + 4.0 * np.cos(2.0 * np.pi * np.arange(500) / 500.0)
    settled = model.compensate(loop, sample_rate=500.0, periodic=True, details=True)
    assert any(
        f"({12.5 * expected:.2g} % of the move)" in note for note in settled.notes
    )
    far = model.output.maximum * 1.2
    drive = model.input.maximum
    beyond = model.compensate(
        [6.0, far, 6.0],
        sample_rate=10.0,
        v_max=2.0 * drive,
        extrapolate=True,
        details=True,
    )
    assert any("cannot be told: the drive goes from" in note for note in beyond.notes)
    cut = [*table["displacement"][:200], far]
    clipped = model.compensate(cut, sample_rate=500.0, on_limit="clip", details=True)
    assert any(note.endswith(", clipped samples included") for note in clipped.notes)


@pytest.mark.parametrize("block_rows", [97, 65536])
@pytest.mark.parametrize(
    "limits",
    [
        "--v-max 40",
        "--max-slew 150 --from 0 --approach auto",
        "--v-max 1 --v-min 0 --from 0.5 --approach auto",
    ],
)
def test_the_expected_error_of_a_clipped_move_is_what_the_model_makes_of_it(
    dbo: Any, sample_model: Path, limits: str, block_rows: int
) -> None:
    """The drive, played through the model that it was made from, misses the move by what was said."""
    done = dbo("compensate", sample_model, TRAJECTORY, *limits.split(), "--on-limit", "clip", "-o", "d.csv",
               "--summary", "s.json", "--block-rows", block_rows)  # fmt: skip
    assert done.code == 0, done.err
    dbo("simulate", sample_model, "d.csv", "-o", "out.csv", "-q")
    wanted = np.loadtxt("d.csv", delimiter=",", skiprows=1, usecols=1)
    reached = np.loadtxt("out.csv", delimiter=",", skiprows=1, usecols=2)
    rows = len(Path(TRAJECTORY).read_text().splitlines()) - 1
    missed = (wanted - reached)[-rows:]
    rms, worst = float(np.sqrt(np.mean(missed**2))), float(np.abs(missed).max())
    said = re.search(
        r"of ([\d,]+) samples .*clipped, by which the move misses (\S+) um RMS, (\S+) um at",
        done.err,
    )
    assert said is not None, done.err
    assert int(said[1].replace(",", "")) == rows
    assert [float(said[2]), float(said[3])] == pytest.approx([rms, worst], rel=0.02)
    expected = json.loads(Path("s.json").read_text())["expected_rmse"]
    assert rms < expected < 1.1 * rms + 0.1
    assert "straight line" not in done.err


def test_a_drive_faster_than_the_logs_is_warned_of(sample_model: Path) -> None:
    model = dbo_api.read_model(sample_model)
    log = dbo_api.read_log(LOG)
    rate = 1.0 / float(np.median(np.diff(log["time"])))
    told = "more than 2 times as fast as the logs of the identification did"
    for times, warned in ((1.0, False), (1.9, False), (6.0, True)):
        run = model.simulate(log["voltage"], sample_rate=times * rate, details=True)
        assert any(told in warning for warning in run.warnings) == warned
    wanted = 6.0 + 4.0 * np.sin(np.arange(400) / 10.0)
    sent = model.compensate(wanted, sample_rate=10_000.0, state="settled", details=True)
    assert any(told in warning for warning in sent.warnings)


def test_no_error_is_expected_of_a_model_that_does_not_know(
    small: dbo_api.Model,
) -> None:
    assert not any(
        "expect" in note for note in small.compensate([2.0, 3.0], details=True).notes
    )
    fit = {"expected_rmse": None, "expected_from": "nothing could be left out"}
    untold = dbo_api.Model(dataclasses.replace(small.actuator, fit=fit))
    notes = untold.compensate([2.0, 3.0], details=True).notes
    assert notes[-1].endswith(
        "what error to expect cannot be told: nothing could be left out"
    )


def test_a_slew_limit_holds_from_the_first_sample_on(small: dbo_api.Model) -> None:
    limits: dict[str, Any] = {"max_slew": 5.0, "state": "empty", "on_limit": "clip"}
    drive = small.compensate([6.0] * 40, sample_rate=10.0, details=True, **limits)
    assert np.diff(drive.values, prepend=0.0).max() <= 0.5 * (1 + 1e-12)
    assert drive.values[0] == pytest.approx(0.5)


BAD_ARRAYS: list[tuple[Any, dict[str, Any], str]] = [
    ([], {}, "`x`: holds no samples"),
    ([1.0, float("nan")], {}, "`x`: sample 2 is not finite: nan (leave it out)"),
    ([[1.0, 2.0]], {}, "`x`: has the shape (1, 2); give one dimension"),
    (["a"], {}, "`x`: is no array of numbers"),
    ([1.0 + 2.0j], {}, "`x`: is no array of numbers"),
    ([1.0, 2.0], {"time": [0.0]}, "`time` has 1 samples where `x` has 2"),
    ([1.0, 2.0], {}, "`x`: no time is given, and this model's lag, creep or delay depends on it "
     "(`time` or `sample_rate` HZ)"),
    ([1.0, 2.0, 3.0], {"time": [0.0, 0.2, 0.1]}, "`x`: row 3: time goes backwards, and this model's lag and "
     "creep depend on the time between samples (cut the log with `rows` A:B)"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("x", "more", "message"), BAD_ARRAYS, ids=lambda value: str(value)[:30]
)
def test_bad_arrays_are_refused(
    lagging: dbo_api.Model, x: Any, more: dict[str, Any], message: str
) -> None:
    with pytest.raises(dbo_api.InputError) as raised:
        lagging.simulate(x, **more)
    assert str(raised.value) == message


def test_repeated_stamps_are_noted(lagging: dbo_api.Model) -> None:
    stamps = [0.0, 0.1, 0.1]
    with pytest.warns(
        dbo_api.DboWarning, match="`time` repeats its stamps in 1 of 3 samples: too few"
    ):
        lagging.simulate([1.0, 2.0, 3.0], time=stamps)
    result = lagging.simulate([1.0, 2.0, 3.0], time=stamps, details=True)
    assert any("repeats at row 3" in note for note in result.notes)


def test_a_log_whose_drive_is_not_recognised_is_not_read_in_silence(
    tmp_path: Path,
) -> None:
    (tmp_path / "run.csv").write_text(
        "time_s,AIN0,y_um,AIN3\n0,1,2,3\n1,2,3,4\n", encoding="utf-8"
    )
    with pytest.warns(
        dbo_api.DboWarning, match=r"run\.csv: no column is recognised as the voltage"
    ) as warned:
        table = dbo_api.read_log(tmp_path / "run.csv")
    assert str(warned[0].message).endswith("(`voltage` names it: 'AIN0' or 'AIN3')")
    assert list(table) == ["time", "displacement"]


def test_a_table_without_the_columns_is_refused() -> None:
    with pytest.raises(dbo_api.InputError) as raised:
        dbo_api.identify(pd.DataFrame({"a": [1.0], "b": [2.0]}))
    assert str(raised.value) == (
        "the table: no column is recognised as the voltage nor as the displacement: it has 1 a, 2 b "
        "(`voltage` 'a' `displacement` 'b', or `voltage` 'b' `displacement` 'a')"
    )


def test_a_state_of_another_model_is_refused(
    lagging: dbo_api.Model, small: dbo_api.Model, tmp_path: Path
) -> None:
    _, state = lagging.simulate([1.0, 2.0], time=[0.0, 0.1], return_state=True)
    lagging.save_state(state, tmp_path / "s.json")
    with pytest.raises(dbo_api.ModelError, match="the state belongs to another model"):
        small.simulate([1.0], state=tmp_path / "s.json")


@pytest.mark.parametrize(
    ("call", "message"),
    [
        ({"state": "warm"}, "`state`: 'warm' is none of auto, empty, full, settled, and there is no such "
         "file"),
        ({"outside": "ignore"}, "`outside`: 'ignore' is none of extend, hold, error"),
        ({"sample_rate": -1.0}, "`sample_rate` -1: give a positive number of samples a second"),
        ({"sample_rate": 1.0, "time": [0.0]}, "`time` and `sample_rate` exclude each other: give the one or "
         "the other"),
    ],
)  # fmt: skip
def test_senseless_calls_are_refused(
    small: dbo_api.Model, call: dict[str, Any], message: str
) -> None:
    with pytest.raises(dbo_api.UsageError) as raised:
        small.simulate([1.0], **call)
    assert str(raised.value) == message


def test_an_unknown_parameter_is_named() -> None:
    with pytest.raises(
        dbo_api.UsageError, match=r"^`gear` is no parameter of identify; there are: "
    ):
        dbo_api.identify([1.0], [1.0], gear=3)
    with pytest.raises(
        dbo_api.UsageError, match=r"^`delimeter` says nothing about reading a log"
    ):
        dbo_api.read_log(LOG, delimeter=",")


def test_rows_may_be_a_pair() -> None:
    pair, text = dbo_api.read_log(LOG, rows=(2, 5)), dbo_api.read_log(LOG, rows="2:5")  # type: ignore[arg-type]
    assert len(pair) == 4
    assert pair.equals(text)
    with pytest.raises(
        dbo_api.UsageError,
        match=r"^`rows` \(1, 2, 3\): give A:B, data rows counted from 1",
    ):
        dbo_api.read_log(LOG, rows=(1, 2, 3))  # type: ignore[arg-type]


def test_importing_the_package_loads_nothing() -> None:
    # An editable install has loaded ``__future__`` before, an installed package has
    # not.
    script = (
        "import sys, __future__; before = set(sys.modules); import dbo_cli; "
        "print(sorted(set(sys.modules) - before))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout == "['dbo_cli', 'dbo_cli.version']\n"


@pytest.mark.whole
def test_every_public_name_is_there() -> None:
    for name in dbo_api.__all__:
        assert getattr(dbo_api, name).__doc__
    assert set(dbo_api.__all__) <= set(dir(dbo_api))


def test_an_infinite_slew_limit_asks_for_no_clock(small: dbo_api.Model) -> None:
    move = [2.0, 4.0, 3.0]
    assert (
        small.compensate(move, max_slew=math.inf).tolist()
        == small.compensate(move).tolist()
    )
    with pytest.raises(dbo_api.DboError, match=r"`max_slew` depends on it"):
        small.compensate(move, max_slew=5.0)


@pytest.mark.parametrize("limit", ["v_min", "v_max"])
def test_a_limit_that_is_no_number_is_refused(small: dbo_api.Model, limit: str) -> None:
    with pytest.raises(dbo_api.UsageError, match=f"^`{limit}`: is not a number$"):
        small.compensate([2.0, 4.0], **{limit: math.nan})
