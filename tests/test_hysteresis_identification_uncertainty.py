# ruff: noqa: E501  (a message of one line stands on one line here)
"""Rows that are known with unlike uncertainty, and a scale that is not known exactly."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from virtual_actuator import PRESETS, VirtualActuator

import dbo_cli as dbo
from dbo_cli.errors import FitError, UsageError
from dbo_cli.hysteresis.excitation import swings
from dbo_cli.hysteresis.identification import IdentificationOptions, Recording, identify
from dbo_cli.hysteresis.identification.evaluation import predict
from dbo_cli.hysteresis.model_file import model_to_bytes

FEW = IdentificationOptions(
    gears=64, points=4, slopes="growing", relaxation=(), delay=0.0
)
QUICK = ["--gears", "32", "--points", "2", "--relaxation", "0", "--delay", "0"]
RATE = 500.0
LOUDER = 20.0


def drive(seed: int, turns: int) -> Any:
    """Return random swings between 0 and 100 V, two of them over the whole range first."""
    ends = [0.0, 1.0, 0.0, *np.random.default_rng(seed).random(turns).tolist()]
    counts = [max(int(150 * size), 8) for size in np.abs(np.diff(ends))]
    return 100.0 * swings(ends, counts)


def moved(voltage: Any) -> Any:
    """Return what the simulated stack does, um."""
    return VirtualActuator(PRESETS["stack"]).displacement(
        np.arange(voltage.size) / RATE, voltage
    )


def log_of_two_halves(seed: int = 1) -> Recording:
    """Return a log whose second half is twenty times as noisy as the first, and says so."""
    voltage = drive(seed, 24)
    uncertainty = np.full(voltage.size, 0.01)
    uncertainty[voltage.size // 2 :] *= LOUDER
    noise = uncertainty * np.random.default_rng(seed).standard_normal(voltage.size)
    return Recording(
        "log",
        voltage,
        moved(voltage) + noise,
        sample_period=1.0 / RATE,
        voltage_unit="V",
        displacement_unit="um",
        uncertainty=uncertainty,
    )


def error_on_a_new_move(model: Any) -> float:
    """Return the standard deviation of a model's error on other swings, um."""
    voltage = drive(99, 20)
    return float(
        np.std(
            predict(model, Recording("new", voltage, voltage, sample_period=1.0 / RATE))
            - moved(voltage)
        )
    )


def test_weights_bring_the_model_nearer_to_the_truth() -> None:
    log = log_of_two_halves()
    weighted = identify([log])
    alike = identify([replace(log, uncertainty=None)])
    assert error_on_a_new_move(weighted.model) < 0.5 * error_on_a_new_move(alike.model)
    assert error_on_a_new_move(weighted.model) < float(weighted.fit["expected_rmse"])  # type: ignore[arg-type]
    # Half of the rows hardly count: what is left is the noise of the others, times the
    # root of two.
    assert weighted.fit["rmse"] == pytest.approx(0.01 * np.sqrt(2.0), rel=0.15)
    assert weighted.summary[1].startswith(
        "rows weighted by their uncertainty, which differs by up to 20 times: they tell as much as "
    )


def test_rows_that_are_equally_uncertain_change_no_bit() -> None:
    log = replace(log_of_two_halves(), uncertainty=None)
    alike = replace(log, uncertainty=np.full(log.voltage.size, 0.3))
    results = [identify([one], FEW) for one in (log, alike)]
    assert model_to_bytes(results[0].model) == model_to_bytes(results[1].model)
    assert results[0].summary == results[1].summary


def test_a_prior_is_moved_by_the_rows_that_are_known_best() -> None:
    log = log_of_two_halves()
    prior = identify(
        [replace(log, displacement=moved(log.voltage), uncertainty=None)], FEW
    ).model
    gain = np.where(np.arange(log.voltage.size) < log.voltage.size // 2, 1.1, 1.0)
    half = replace(log, displacement=gain * moved(log.voltage))
    spans = [
        identify(
            [one], IdentificationOptions(force=True), prior=prior
        ).model.output.span
        / prior.output.span
        for one in (half, replace(half, uncertainty=None))
    ]
    assert spans[0] == pytest.approx(1.1, abs=0.003)
    assert 1.02 < spans[1] < 1.08


def test_what_is_no_standard_deviation_is_refused() -> None:
    log = log_of_two_halves()
    assert log.uncertainty is not None
    for bad in (0.0, -1.0, 1e-300, 1e300, np.nan, np.inf):
        wrong = log.uncertainty.copy()
        wrong[7] = bad
        with pytest.raises(
            FitError,
            match=r"^log: the uncertainty in row 8 is \S+: a standard deviation is a "
            r"number from 1e-30 to 1e\+30$",
        ):
            identify([replace(log, uncertainty=wrong)], FEW)
    steep = log.uncertainty.copy()
    steep[1000] = 1e-9
    with pytest.raises(
        FitError,
        match=r"a few rows outweigh all others \(1,\d+ rows tell as much as 1 of equal",
    ):
        identify([replace(log, uncertainty=steep)], FEW)
    with pytest.raises(UsageError, match="does not go with `method` paper"):
        identify([log], IdentificationOptions(method="paper"))


def written(log: Recording, name: str, unit: str = "um", factor: float = 1.0) -> Path:
    """Write a log with its standard deviations in a unit, and return its path."""
    assert log.uncertainty is not None
    table = np.column_stack(
        (
            np.arange(log.voltage.size) / RATE,
            log.voltage,
            log.displacement,
            factor * log.uncertainty,
        )
    )
    header = f"time_s,voltage_V,displacement_um,deviation_{unit}"
    np.savetxt(name, table, delimiter=",", header=header, comments="", fmt="%.9g")
    return Path(name)


def test_the_column_of_uncertainty_from_the_shell(whole_dbo: Any) -> None:
    log = log_of_two_halves()
    written(log, "log.csv")
    words = ("--uncertainty", "deviation", *QUICK, "-o")
    done = whole_dbo("identify", "log.csv", *words, "um.json")
    assert done.code == 0
    assert (
        "dbo: rows weighted by their uncertainty, which differs by up to 20 times: they tell as much as"
        in done.err
    )
    model = json.loads(Path("um.json").read_text())
    assert model["provenance"]["arguments"][-2:] == ["--uncertainty", "deviation"]
    shown = whole_dbo("show", "um.json").out
    assert (
        "\nrows count by their uncertainty, column 'deviation_um', and do so in the RMSE\n"
        in shown
    )
    written(log, "nm.csv", "nm", 1000.0)
    done = whole_dbo("identify", "nm.csv", *words, "nm.json")
    assert "column 'deviation_nm' is converted from nm to um" in done.err
    assert json.loads(Path("nm.json").read_text())["fit"]["rmse"] == pytest.approx(
        model["fit"]["rmse"], rel=1e-6
    )
    volts = Path("nm.csv").read_text().replace("deviation_nm", "deviation_V")
    Path("volts.csv").write_text(volts)
    done = whole_dbo("identify", "volts.csv", *words, "v.json")
    assert done.code == 1
    assert done.err.endswith(
        "dbo: error: volts.csv: column 'deviation_V' is in V, but the displacement is in um (--scale "
        "ROLE=FACTORum/V converts it)\n"
    )


@pytest.mark.parametrize(("text", "why"), [
    ("0", "column 'deviation_um' is 0: a standard deviation is a number from 1e-30 to 1e+30 (--rows leaves such rows out)"),
    ("-0.5", "column 'deviation_um' is -0.5: a standard deviation is a number from 1e-30 to 1e+30 (--rows leaves such rows out)"),
    ("1e-160", "column 'deviation_um' is 1e-160: a standard deviation is a number from 1e-30 to 1e+30 (--rows leaves such rows out)"),
    ("1e300", "column 'deviation_um' is 1e+300: a standard deviation is a number from 1e-30 to 1e+30 (--rows leaves such rows out)"),
    ("nan", "column 'deviation_um' is not finite: 'nan' (--skip-bad drops such rows)"),
])  # fmt: skip
def test_a_bad_uncertainty_is_refused_by_its_line(
    whole_dbo: Any, text: str, why: str
) -> None:
    lines = written(log_of_two_halves(), "log.csv").read_text().splitlines()
    lines[40] = lines[40].rpartition(",")[0] + "," + text
    Path("log.csv").write_text("\n".join(lines) + "\n")
    done = whole_dbo(
        "identify", "log.csv", "--uncertainty", "deviation", *QUICK, "-o", "m.json"
    )
    assert (done.code, done.err.splitlines()[-1]) == (
        1,
        f"dbo: error: log.csv:41: {why}",
    )
    assert not Path("m.json").exists()


@pytest.mark.parametrize(("words", "message"), [
    ("--uncertainty displacement_um", "column 'displacement_um' is the displacement, not the uncertainty "
     "(--displacement names another)"),
    ("--uncertainty 3 --displacement 3", "column 'displacement_um' cannot be the uncertainty: it is the "
     "displacement (--uncertainty or --displacement names another)"),
    ("--voltage log.csv::displacement_um", "column 'log.csv::displacement_um' cannot be the voltage: it is "
     "the displacement (--voltage or --displacement names another)"),
])  # fmt: skip
def test_no_column_has_two_roles(whole_dbo: Any, words: str, message: str) -> None:
    written(log_of_two_halves(), "log.csv")
    done = whole_dbo("identify", "log.csv", *words.split(), *QUICK, "-o", "m.json")
    assert (done.code, done.err.splitlines()[-1]) == (
        1,
        f"dbo: error: log.csv: {message}",
    )
    assert not Path("m.json").exists()


def test_uncertainty_from_python() -> None:
    log = log_of_two_halves()
    words: dict[str, Any] = {
        "sample_rate": RATE,
        "gears": 32,
        "points": 2,
        "relaxation": (),
        "delay": 0.0,
    }
    model = dbo.identify(
        log.voltage, log.displacement, uncertainty=log.uncertainty, **words
    )
    direct = identify([replace(log, voltage_unit=None, displacement_unit=None)], IdentificationOptions(
        gears=32, points=2, relaxation=(), delay=0.0))  # fmt: skip
    assert model.actuator.fit["rmse"] == direct.fit["rmse"]
    with pytest.raises(
        dbo.UsageError,
        match="beside arrays of voltage and displacement it is an array, too",
    ):
        dbo.identify(log.voltage, log.displacement, uncertainty="deviation", **words)
    with pytest.raises(
        dbo.InputError, match=r"`uncertainty` has 10 samples where `voltage` has 1718"
    ):
        dbo.identify(log.voltage, log.displacement, uncertainty=np.ones(10), **words)
    with pytest.raises(
        dbo.UsageError, match="of tables and files it is the name of a column"
    ):
        dbo.identify("log.csv", uncertainty=np.ones(10))


def test_the_uncertainty_of_the_scale_is_stated_with_the_gain(whole_dbo: Any) -> None:
    written(log_of_two_halves(), "log.csv")
    words = (
        "identify",
        "log.csv",
        *QUICK,
        "-o",
        "m.json",
        "--summary",
        "s.json",
        "--scale-uncertainty",
    )
    for text, percent in (("0.5", 0.5), ("0.5%", 0.5), ("5000ppm", 0.5)):
        done = whole_dbo(*words, text)
        assert done.code == 0
        model, summary = (
            json.loads(Path(name).read_text()) for name in ("m.json", "s.json")
        )
        fit, span = model["fit"], model["output"]["max"] - model["output"]["min"]
        assert fit["scale_uncertainty_percent"] == pytest.approx(percent, rel=1e-12)
        assert fit["gain"] == summary["gain"] == pytest.approx(span / 100.0, rel=1e-9)
        ends = np.sqrt(2.0) * fit["expected_shape_rmse"] / span
        assert fit["gain_uncertainty"] == pytest.approx(
            fit["gain"] * np.hypot(ends, 0.005), rel=1e-9
        )
        assert summary["gain_uncertainty"] == fit["gain_uncertainty"]
        assert "um/V: 0.5 % of the displacement's scale, " in done.err
        shown = " ".join(whole_dbo("show", "m.json").out.split())
        assert (
            f"gain: {fit['gain']:.6g} um/V from end to end, standard uncertainty "
            in shown
        )
        assert "of which the displacement's scale is 0.5 %" in shown
    assert whole_dbo(*words[:-1]).code == 0
    assert json.loads(Path("s.json").read_text())["gain_uncertainty"] is None
    done = whole_dbo(*words, "-1ppm")
    assert (done.code, done.err.splitlines()[-1]) == (
        2,
        "dbo: error: --scale-uncertainty: must not be below 0, not -1",
    )
