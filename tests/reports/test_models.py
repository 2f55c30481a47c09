"""A model in a report, on the screen and in figures."""

from __future__ import annotations

import json

import numpy as np
import pytest

import dbo_cli as dbo
from dbo_cli.errors import DboError
from dbo_cli.library import Model as Public
from dbo_cli.model import (
    Candidate,
    Cascade,
    Delay,
    Dynamics,
    Gears,
    Lag,
    Points,
    Quantity,
    Relaxation,
    Resonance,
)
from dbo_cli.reports import Pair, Report, ShownModel
from dbo_cli.reports import predict as predicted
from dbo_cli.reports.plots import draw, model_plots, plot_model, slow_loop

FIT = {
    "sign": "rising",
    "rmse": 0.02,
    "expected_rmse": 0.05,
    "left_out_rmse": 0.03,
    "line_rmse": 3.2,
    "fastest": 820.0,
    "longest_rest": 2.5,
    "logs": [{"name": "recorded.csv", "rows": 24_000, "rmse": 0.02}],
    "validation": [{"name": "other.csv", "rmse": 0.06}],
    "warnings": ["the log has one amplitude"],
    "notes": ["2 spikes were left out"],
}


def gears(n=40, steeper=1.3, relaxation=None):
    widths = np.full(n, 100.0 / n)
    return Gears(widths, np.linspace(0.6, steeper, n) * widths, relaxation=relaxation)


def model(*behind, relaxation=None, candidates=()):
    stages = (gears(relaxation=relaxation), *behind)
    high = stages[0].y_range[1]
    drive, way = (
        Quantity("voltage", "V", 0.0, 100.0),
        Quantity("displacement", "um", 0.0, high),
    )
    return Cascade(
        "forward", drive, way, stages, FIT, candidates, {"program": "dbo 1.0.0"}
    )


def predict(actuator, drive, measured, time=None, rows=None, model_name="the model"):
    """Predict a recording of these columns."""
    recording = Pair("log", measured, measured, time, drive, rows)
    return predicted(recording, actuator, model_name=model_name)


def run(rows=4000, rate=1000.0):
    time = np.arange(rows) / rate
    return time, 50.0 - 50.0 * np.cos(2.0 * np.pi * time) * np.exp(-time / 3.0)


def test_the_model_runs_from_the_first_row_on():
    actuator, (time, drive) = model(), run()
    displacement, _ = actuator.simulate(drive)
    measured = displacement + 0.1
    whole = predict(actuator, drive, measured, time=time)
    found = Report.of([whole], labels=("model", "measured"))
    assert found.rmse == pytest.approx(0.1, abs=1e-9)
    part = predict(actuator, drive, measured, time=time, rows=(2001, None))
    found = Report.of([part], labels=("model", "measured"))
    assert found.logs[0].merits.samples == 2000
    # from row 2001 on alone, the state would be another
    assert found.rmse == pytest.approx(0.1, abs=1e-9)
    assert json.loads(found.render("json"))["compared"] == ["model", "measured"]


def test_library_function_with_a_model():
    actuator, (time, drive) = model(), run()
    displacement, _ = actuator.simulate(drive)
    public = Public(actuator)
    found = dbo.report(drive, displacement, time, model=public, name="run.csv")
    assert found.rmse < 1e-12 and found.unit == "um" and found.voltage_unit == "V"


def test_an_inverse_model_is_refused():
    with pytest.raises(DboError, match="inverse"):
        predict(model().inverse(), np.arange(50.0), np.arange(50.0))


def test_expected_error_of_the_very_drive():
    other = Candidate(0.4, (gears(steeper=1.25),))
    same = Candidate(0.6, (gears(),))
    actuator, (time, drive) = model(candidates=(same, other)), run()
    displacement, _ = actuator.simulate(drive)
    pair = predict(actuator, drive, displacement, time=time, model_name="m.json")
    assert pair.expected.rmse > 0.03
    assert "m.json" in pair.expected.footer
    # beyond the identified range nobody knows
    beyond = predict(actuator, 1.2 * drive, displacement, time=time)
    assert beyond.expected.rmse is None


def test_page_of_a_model_report():
    actuator, (time, drive) = model(), run(800)
    displacement, _ = actuator.simulate(drive)
    pair = predict(actuator, drive, displacement + 0.01, time=time, model_name="m.json")
    found = Report.of([pair], unit="um", voltage_unit="V", model=actuator,
                      labels=("model", "measured"))  # fmt: skip
    text = found.to_html()
    assert f"Model m.json ({actuator.digest[:12]})" in text
    assert "Residual (µm)" in text and "Input of the gears" not in text
    assert "The model" in text


def test_slow_loop():
    actuator = model(Delay(0.01), relaxation=Relaxation(0.0, (0.1,), (0.05,)))
    drive, rising, falling = slow_loop(actuator)
    assert (drive[0], drive[-1]) == (0.0, 100.0)
    assert (np.diff(rising) > 0.0).all() and (np.diff(falling) > 0.0).all()
    assert (falling - rising)[1:-1].min() > 0.0
    assert falling[-1] == pytest.approx(rising[-1])
    # of an inverse model the loop of the actuator that it undoes
    again = slow_loop(actuator.inverse())
    assert np.abs(again[1] - rising).max() < 1e-9


def test_figures_of_a_model(tmp_path):
    plots = model_plots(model())
    assert [plot.key for plot in plots] == ["model-loop", "model-hysteresis"]
    loop = draw(plots[0], "inline").decode()
    assert "Voltage (V)" in loop and "Displacement (µm)" in loop
    files = ShownModel(model()).figures(tmp_path)
    assert {path.suffix for path in files} == {".png", ".svg"}
    for path in files:
        assert path.stat().st_size > 1000
    assert plot_model(model()).axes[0].get_xlabel() == "Voltage (V)"


def test_figures_into_a_file_are_refused(tmp_path):
    file = tmp_path / "file"
    file.write_text("x")
    with pytest.raises(DboError, match="`figures`"):
        ShownModel(model()).figures(file)


def test_show_as_text():
    stages = (
        Points([60.0, 40.0], [55.0, 40.0]),
        Dynamics((Resonance(800.0, 0.02),)),
        Delay(0.002),
    )
    shown = ShownModel(
        model(*stages, relaxation=Relaxation(0.0, (0.05, 2.0), (0.02, 0.03))), "m.json"
    )
    text = shown.text()
    lines = text.splitlines()
    assert len(lines) <= 24 and max(map(len, lines)) <= 96
    for words in ("m.json", "forward", "voltage 0 to 100 V", "rising", "40 gears", "2 straight pieces",
                  "50 ms, 2 s", "800 Hz", "0.05 um", "3.2 um", "other.csv", "24,000 rows",
                  "820 V/s", "one amplitude", "2 spikes", "dbo 1.0.0"):  # fmt: skip
        assert words in text


def test_show_as_json():
    stages = (Dynamics((Resonance(800.0, 0.02), Lag(1e-4))), Delay(0.002))
    content = json.loads(ShownModel(model(*stages)).json())
    assert (content["format"], content["version"]) == ("dbo-show", 1)
    assert content["input"] == {
        "quantity": "voltage",
        "unit": "V",
        "min": 0.0,
        "max": 100.0,
    }
    assert content["fit"]["expected_rmse"] == 0.05
    assert "logs" not in content["fit"] and content["logs"][0]["rows"] == 24_000
    assert content["dynamics"] == [{"frequency": 800.0, "damping": 0.02}, {"lag": 1e-4}]
    assert content["delay_seconds"] == 0.002
    assert content["gears"] == 40 and content["segments"] == []
    assert content["warnings"] == FIT["warnings"]


def test_show_an_inverse_and_a_bare_model():
    inverse = ShownModel(model().inverse())
    assert "inverse model" in inverse.text()
    assert json.loads(inverse.json())["input"]["unit"] == "um"
    bare = Cascade(
        "forward",
        Quantity("voltage", None, 0.0, 100.0),
        Quantity("x", None, 0.0, 95.0),
        (gears(),),
    )
    assert "expected" not in ShownModel(bare).text()
    assert ShownModel(bare).json() == ShownModel(bare).json()
