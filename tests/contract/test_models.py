"""Model files: every key is checked, the schema agrees, sets hold models by name, ``show`` tells."""

from pathlib import Path

import jsonschema
import pytest

import dbo_cli

from .program import HERE, MODELS, done, load, model, refused, store, values_of, write

STORED = sorted(path.stem for path in MODELS.glob("*.json"))
SCHEMA = HERE.parent.parent / "docs" / "model-file.schema.json"


@pytest.mark.parametrize("name", STORED)
def test_stored_and_saved_models_fit_the_schema(name):
    schema = jsonschema.Draft202012Validator(load(SCHEMA))
    schema.validate(values_of(name))
    read = dbo_cli.read_models if name == "set" else dbo_cli.read_model
    read(model(name)).save("saved.json")
    schema.validate(load("saved.json"))
    read("saved.json").save("again.json")
    assert Path("again.json").read_bytes() == Path("saved.json").read_bytes()


def test_a_broken_key_of_an_inverse_is_named_as_its_file_has_it():
    """Its axes are exchanged where it becomes a forward model, and with them what is wrong there."""
    values = done("invert", model("small")).json
    stage = next(each for each in values["stages"] if each["type"] == "backlash")
    stage["dx"], stage["dy"] = [1.0, 1e-20, 1.0], [1.0, 1.0, 1.0]
    store("broken.json", values)
    index = values["stages"].index(stage)
    assert f"stages[{index}].dx[1]: 1e-20" in refused(1, "show", "broken.json")


def test_one_model_of_a_set_is_named():
    write("drive.csv", "voltage_V", [0.0, 5.0, 10.0, 3.0])
    alone = done("simulate", model("small"), "drive.csv").raw
    assert done("simulate", f"{model('set')}::x", "drive.csv").raw == alone
    error = refused(1, "simulate", f"{model('set')}::q", "drive.csv")
    assert "no model q; models: x, y" in error
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
