"""Model, set and state files: round trips, the schema, and refusals that name file and key."""

import copy
import json
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest

import dbo_cli.model as dm
from dbo_cli.errors import ModelError
from dbo_cli.reports.show import shown_text

DT = 1e-4
DOCS = Path(__file__).resolve().parents[2] / "docs"
SCHEMA = jsonschema.Draft202012Validator(
    json.loads((DOCS / "model-file.schema.json").read_text())
)


def full_model():
    """A model that has everything."""
    gears = dm.Gears(
        [0.1] * 50,
        np.linspace(0.1, 0.3, 50),
        0.0,
        -1.0,
        dm.Relaxation(0.0, (0.006, 0.5), (0.3, -0.9)),
    )
    sections = (
        dm.Resonance(800.0, 0.02, dm.Mode(900.0, 0.03)),
        dm.Lag(2e-4),
        dm.Lag(3e-4, 1e-4),
    )
    stages = (
        dm.Amplifier(3e-3),
        dm.Points([1.0, 4.0], [1.2, 3.8]),
        gears,
        dm.Points([5.0, 6.0], [6.0, 7.0], -1.0),
        dm.Scale(-1.5, 1.0 / 3.0),
        dm.Dynamics(sections),
        dm.Delay(0.00207),
    )
    return dm.Cascade(
        "forward",
        dm.Quantity("voltage", "V", 0.0, 5.0),
        dm.Quantity("displacement", None, -20.0, 5.0),
        stages,
        {"sign": "falling", "rmse": 0.1, "logs": [{"name": "µ.csv"}]},
        (dm.Candidate(0.4, stages[2:]), dm.Candidate(0.6, (gears,))),
        {"program": "dbo"},
    )


def written(tmp_path, text, name="model.json"):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return str(path)


def test_a_model_comes_back(tmp_path):
    model = full_model()
    for each in (model, model.inverse()):
        text = dm.dumps_model(each)
        back = dm.read_cascade(written(tmp_path, text))
        assert dm.dumps_model(back) == text
        assert back.digest == model.digest
        SCHEMA.validate(json.loads(text))
    back = dm.read_cascade(written(tmp_path, dm.dumps_model(model)))
    drive = np.linspace(0.0, 5.0, 300)
    moved, again = (each.simulate(drive, dt=DT)[0] for each in (model, back))
    assert np.array_equal(moved, again)
    faster = model.with_stages((dm.Amplifier(2e-3), *model.stages[1:]))
    assert faster.digest != model.digest
    assert len(dm.dumps_model(model).splitlines()) < 120


def read_back(values, tmp_path):
    path = tmp_path / "model.json"
    path.write_text(json.dumps(values))
    return dm.read_cascade(str(path))


def test_a_model_keeps_the_start_of_its_logs_and_shows_it(tmp_path):
    model = replace(full_model(), auto_start="full")
    values = json.loads(dm.dumps_model(model))
    assert values["past"] == "full"
    back = read_back(values, tmp_path)
    assert back.start(2.0) == model.start(2.0, "full") != model.start(2.0, "settled")
    page = shown_text(back.inverse(), "model.json")
    assert "full, as the logs began" in page
    assert "logs began" not in shown_text(full_model(), "model.json")


def test_the_example_of_the_page_is_a_model(tmp_path):
    page = (DOCS / "model-file.md").read_text()
    begin = page.index('    {\n      "format": "dbo-model"')
    example = page[begin : page.index("\n\n", begin)]
    SCHEMA.validate(json.loads(example))
    model = read_back(json.loads(example), tmp_path)
    assert model.gears.n == 5


BROKEN = [
    (lambda m: m.pop("direction"), "direction", True),
    (lambda m: m.update(direction="up"), "direction", True),
    (lambda m: m["input"].update(min=11.0), "input", False),
    (lambda m: m["input"].update(unit=5), "input.unit", True),
    (lambda m: m.update(stages=[]), "stages", True),
    (lambda m: m["stages"][2].update(height=1), "stages[2].height", True),
    (lambda m: m["stages"][2].update(type="spline"), "stages[2]", True),
    (lambda m: m["stages"][2].update(x0="0"), "stages[2].x0", True),
    (lambda m: m["stages"][2]["dx"].insert(0, 0.0), "stages[2].dx[0]", True),
    (lambda m: m["stages"][2]["dy"].__setitem__(1, -1.0), "stages[2].dy[1]", True),
    (lambda m: m["stages"][2].update(dx=[1.0, 2.0]), "stages[2]", False),
    (lambda m: m["stages"][2]["relaxation"].update(gain=[0.3, -9.0]), "stages[2].relaxation.gain", False),
    (lambda m: m["stages"][4].update(gain=0.0), "stages[4].gain", True),
    (lambda m: m["stages"][5]["sections"][0].pop("damping"), "stages[5]", True),
    (lambda m: m["stages"][6].update(seconds=-1.0), "stages[6].seconds", False),
    (lambda m: m["fit"].update(swings=-1), "fit.swings", True),
    (lambda m: m["fit"].update(left_out_rmse="much"), "fit.left_out_rmse", True),
    (lambda m: m["candidates"][0].update(weight=-1.0), "candidates[0].weight", True),
    (lambda m: m.update(candidates=3 * m["candidates"]), "candidates", True),
    (lambda m: m["stages"][2].update(dx=[{"repeat": 0, "value": 1.0}]), "stages[2].dx[0].repeat", True),
    (lambda m: m["stages"][2].update(dx=[{"repeat": 10**7, "value": 1.0}]), "stages[2].dx[0].repeat", True),
    (lambda m: m["stages"][2].update(x0=1e99), "stages[2].x0: 1e+99", True),
    (lambda m: m["stages"][2].update(x0=True), "stages[2].x0: true", True),
    (lambda m: m["stages"][2]["relaxation"].update(tau=[0.1]), "stages[2].relaxation.gain", False),
    (lambda m: m["stages"][2]["relaxation"].update(tau=[0.1, 0.0]), "stages[2].relaxation.tau[1]", True),
    (lambda m: m["stages"][2]["relaxation"].update(on="output"), "stages[2].relaxation.", False),
    (lambda m: m["stages"][5]["sections"][0].update(damping=1.0), "stages[5].sections[0].damping", True),
    (lambda m: m["stages"][5]["sections"][2].update(lead=1.0), "stages[5].sections[2].lead", False),
    (lambda m: m["stages"].reverse(), "stages: ", False),
    (lambda m: m["stages"].insert(3, m["stages"][2]), "stages: wrong order", True),
    (lambda m: m["stages"].append(m["stages"][6]), "stages: wrong order", False),
    (lambda m: m["candidates"][1]["stages"][0].update(y0="a"), "candidates[1].stages[0].y0", True),
    (lambda m: m["candidates"][1].update(stages=[]), "candidates[1].stages", True),
    (lambda m: m["stages"][0].update(seconds=0.0), "stages[0].seconds", True),
]  # fmt: skip


@pytest.mark.parametrize(("change", "place", "in_schema"), BROKEN)
def test_what_is_wrong_is_named(change, place, in_schema, tmp_path):
    values = copy.deepcopy(json.loads(dm.dumps_model(full_model())))
    change(values)
    with pytest.raises(ModelError) as problem:
        read_back(values, tmp_path)
    assert str(problem.value).startswith(f"{tmp_path / 'model.json'}: {place}")
    assert "\n" not in str(problem.value)
    assert SCHEMA.is_valid(values) is not in_schema


# ---- states ----


def test_a_state_comes_back_and_serves_the_inverse(tmp_path):
    model = full_model()
    drive = 2.5 + 2.0 * np.sin(np.arange(700) * 0.03)
    whole, _ = model.simulate(drive, dt=DT)
    _, state = model.simulate(drive[:300], dt=DT)
    state = replace(state, time=0.0299)
    text = dm.dumps_state(state, model)
    SCHEMA.validate(json.loads(text))
    path = written(tmp_path, text, "state.json")
    back = dm.read_state(path, model.inverse())
    assert back == replace(state, model=model.digest)
    assert dm.dumps_state(back, model) == text
    rest, _ = model.simulate(drive[300:], dt=DT, state=back)
    assert np.array_equal(rest, whole[300:])
    bare = dm.dumps_state(model.start(2.0), model)
    SCHEMA.validate(json.loads(bare))
    back = dm.read_state(written(tmp_path, bare, "s.json"), model)
    assert back.bits == model.start(2.0).bits


@pytest.mark.parametrize(
    ("change", "place"),
    [
        (lambda s: s.update(model="0" * 64), "model: the state belongs to another"),
        (lambda s: s.update(model="0", amplifier=1.0), "model: the state belongs to"),
        (lambda s: s.update(bits="xyz"), "bits: "),
        (lambda s: s.update(bits="f" * 99), "bits: "),
        (lambda s: s.update(gears=49), "gears: "),
        (lambda s: s.update(memory=[1.0]), "memory: "),
        (lambda s: s.update(sections=[0, 0, 0]), "sections: "),
        (lambda s: s["sections"].__setitem__(1, [0, 0]), "sections[1]: "),
        (lambda s: s["delay"]["values"].pop(), "delay: "),
        (lambda s: s["delay"]["times"].reverse(), "delay: "),
    ],
)
def test_bad_states_are_named(change, place, tmp_path):
    model = full_model()
    _, state = model.simulate(np.linspace(0, 3, 50), dt=DT)
    values = json.loads(dm.dumps_state(state, model))
    change(values)
    path = written(tmp_path, json.dumps(values), "state.json")
    with pytest.raises(ModelError) as problem:
        dm.read_state(path, model)
    assert str(problem.value).startswith(f"{path}: {place}")
