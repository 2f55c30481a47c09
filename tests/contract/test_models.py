"""Model files: every key is checked, the schema agrees, sets hold models by name, ``show`` tells."""

import copy
from pathlib import Path

import jsonschema
import pytest

import dbo_cli

from .program import HERE, MODELS, done, load, model, refused, store, values_of, write

STORED = sorted(path.stem for path in MODELS.glob("*.json"))
SCHEMA = HERE.parent.parent / "docs" / "model-file.schema.json"


@pytest.fixture(scope="session")
def schema():
    return load(SCHEMA)


def valid(schema, values):
    return bool(jsonschema.Draft202012Validator(schema).is_valid(values))


@pytest.mark.parametrize("name", STORED)
def test_stored_and_saved_models_fit_the_schema(schema, name):
    assert valid(schema, values_of(name))
    dbo_cli.read_model(model(name)).save("saved.json")
    assert valid(schema, load("saved.json"))
    dbo_cli.read_model("saved.json").save("again.json")
    assert Path("again.json").read_bytes() == Path("saved.json").read_bytes()


def at(values, path):
    """Return what holds a key (``stages.0.dx``) of a model's values, and the key."""
    *parents, last = (int(key) if key.isdigit() else key for key in path.split("."))
    for key in parents:
        values = values[key]
    return values, last


def put(path, value):
    """Return a function that sets a key."""

    def change(values):
        holder, key = at(values, path)
        holder[key] = value

    return change


def append(stage):
    """Return a function that adds a stage."""
    return lambda values: values["stages"].append(stage)


def relaxed(tau, gain):
    """Return a function that gives the gears a memory."""
    term = {"on": "input", "reference": 0.0, "tau": [tau], "gain": [gain]}
    return put("stages.0.relaxation", term)


def candidates(weight, count):
    """Return a function that gives the model candidates."""
    return lambda values: values.update(
        candidates=[{"weight": weight, "stages": values["stages"]}] * count
    )


BROKEN = {
    "another format": (put("format", "dbo-state"), "format"),
    "a version to come": (put("version", 2), "version"),
    "no direction": (lambda values: values.pop("direction"), "direction"),
    "an odd direction": (put("direction", "up"), "direction"),
    "an unknown key": (put("colour", "red"), "colour"),
    "an unknown key of a stage": (put("stages.0.height", 1), "height"),
    "an unknown stage": (put("stages.0.type", "spline"), "stages[0]"),
    "no stages": (put("stages", []), "stages"),
    "two backlash stages": (
        lambda values: values["stages"].append(copy.deepcopy(values["stages"][0])),
        "stages",
    ),
    "a width of 0": (put("stages.0.dx.2", 0.0), "stages[0].dx[2]"),
    "a negative height": (put("stages.0.dy.1", -1.0), "stages[0].dy[1]"),
    "widths and heights that differ": (put("stages.0.dx", [1.0, 2.0]), "stages[0]"),
    "a text for a number": (put("stages.0.x0", "0"), "stages[0].x0"),
    "a gain of 0": (put("stages.1.gain", 0.0), "stages[1].gain"),
    "a range turned round": (put("input.min", 11.0), "input"),
    "a unit that is a number": (put("input.unit", 5), "input.unit"),
    "a negative time constant": (relaxed(-1.0, 0.1), "tau"),
    "negative gains that leave no slope": (relaxed(1.0, -0.26), "gain"),
    "a negative delay": (
        append({"type": "delay", "seconds": -1.0}),
        "stages[2].seconds",
    ),
    "a resonance without damping": (
        append({"type": "dynamics", "sections": [{"frequency": 100.0}]}),
        "stages[2]",
    ),
    "a weight below 0": (candidates(-1.0, 1), "candidates[0].weight"),
    "a figure that is a text": (
        put("fit", {"unknown_past_rmse": "much"}),
        "fit.unknown_past_rmse",
    ),
    "a negative figure": (put("fit", {"swings": -1}), "fit.swings"),
    "six candidates": (candidates(0.1, 6), "candidates"),
}


NO_SCHEMA_KNOWS = {
    "a negative delay",
    "widths and heights that differ",
    "a range turned round",
    "negative gains that leave no slope",
}
"""What only a reader can refuse (docs/model-file.md)."""


@pytest.mark.parametrize("fault", BROKEN)
def test_a_broken_key_is_named_and_the_schema_refuses_it(schema, fault):
    change, key = BROKEN[fault]
    values = values_of("small")
    change(values)
    store("broken.json", values)
    error = refused(1, "show", "broken.json")
    assert error.startswith("broken.json: ") and key in error
    with pytest.raises(dbo_cli.ModelError, match=r"broken\.json"):
        dbo_cli.read_model("broken.json")
    assert valid(schema, values) == (fault in NO_SCHEMA_KNOWS)


def test_a_broken_key_of_an_inverse_is_named_as_its_file_has_it():
    """Its axes are exchanged where it becomes a forward model, and with them what is wrong there."""
    values = done("invert", model("small")).json
    stage = next(each for each in values["stages"] if each["type"] == "backlash")
    stage["dx"], stage["dy"] = [1.0, 1e-20, 1.0], [1.0, 1.0, 1.0]
    store("broken.json", values)
    index = values["stages"].index(stage)
    assert f"stages[{index}].dx[1]: 1e-20" in refused(1, "show", "broken.json")


# --- sets ---


def test_one_model_of_a_set_is_named():
    write("drive.csv", "voltage_V", [0.0, 5.0, 10.0, 3.0])
    alone = done("simulate", model("small"), "drive.csv").raw
    assert done("simulate", f"{model('set')}::x", "drive.csv").raw == alone
    error = refused(1, "simulate", f"{model('set')}::q", "drive.csv")
    assert "q" in error and "x" in error and "y" in error
    error = refused(1, "simulate", model("set"), "drive.csv")
    assert "set.json" in error and "::" in error
    values = values_of("set")
    values["models"]["y"]["stages"][0]["dx"] = [0.0, 1.0]
    store("set.json", values)
    error = refused(1, "invert", "set.json::y")
    assert "y" in error and "stages[0].dx[0]" in error


# --- show ---


@pytest.mark.parametrize("name", ["bent", "known", "moving"])
def test_show_is_one_screen(name):
    page = done("show", model(name)).out
    lines = page.splitlines()
    assert 3 <= len(lines) <= 40 and max(map(len, lines)) <= 120
    values = values_of(name)
    for side in ("input", "output"):
        assert f"{values[side]['max']:.6g}" in page
        assert values[side]["unit"] in page


def test_show_tells_gears_sign_and_error_and_each_of_a_set():
    page = done("show", model("creep")).out
    assert "40" in page and "0.01" in page and "ris" in page
    assert "fall" in done("show", model("bent")).out
    page = done("show", model("set")).out
    assert "120" in page and "10" in page
    told = done("show", model("late"), "--format", "json").json
    assert (told["format"], told["version"]) == ("dbo-show", 1)
    assert told["gears"] == 40 and told["output"]["unit"] == "um"
    assert told["delay_seconds"] == pytest.approx(0.0025)
