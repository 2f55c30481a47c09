"""docs/model-file.schema.json and the reader agree, as far as a schema can."""

from __future__ import annotations

import copy
import dataclasses
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator
from test_hysteresis_model import build
from test_hysteresis_model_file import (
    EXAMPLE,
    JSON,
    KEYS,
    OLD,
    REFUSED,
    STATES,
    changed,
    state_of,
    write,
)

from dbo_cli.errors import DboError
from dbo_cli.extras.channels.model_set import Coupling, set_to_bytes
from dbo_cli.hysteresis.dynamics import (
    Antiresonance,
    DynamicsStage,
    InverseMemory,
    Lag,
    Resonance,
)
from dbo_cli.hysteresis.model import ModelState
from dbo_cli.hysteresis.model_file import (
    model_to_bytes,
    read_model,
    read_state,
    state_to_bytes,
)
from dbo_cli.hysteresis.operators import BacklashState

DOCS = Path(__file__).resolve().parents[2] / "docs"
SCHEMA = json.loads((DOCS / "model-file.schema.json").read_text(encoding="utf-8"))
CHECK = Draft202012Validator(SCHEMA)
BEYOND = re.compile(
    r"is not greater than min|entries where|goes backwards|belongs to another model|"
    r"the number of gears of the model|is not a hexadecimal number of 3 bits"
)
"""What compares two places of a file with each other, or with a model: no schema can."""


def is_json(values: object) -> bool:
    try:
        json.dumps(values, allow_nan=False)
    except ValueError:
        return False
    return True


def test_the_schema_is_one() -> None:
    Draft202012Validator.check_schema(SCHEMA)


def test_models_and_states_with_dynamics_fit() -> None:
    plain = build(3)
    notched = Resonance(800.0, 0.02, Antiresonance(900.0, 0.01))
    stages = (*plain.stages, DynamicsStage((Lag(1e-3), notched)))
    model = dataclasses.replace(plain, stages=stages)
    for one in (model, model.inverse()):
        CHECK.validate(json.loads(model_to_bytes(one)))
    moving = ((1.0, 0.0, 1.0), (2.0, 0.5, 1.0))
    for state in (
        ModelState(BacklashState(1), dynamics=moving),
        ModelState(
            BacklashState(1), dynamics=moving, undoing=InverseMemory(1e-3, moving)
        ),
    ):
        CHECK.validate(json.loads(state_to_bytes(state, model)))


def test_every_model_and_state_that_is_written_fits() -> None:
    for seed in range(20):
        model = build(seed, relaxation=seed % 2 == 0, delay=0.01 * (seed % 3))
        for one in (model, model.inverse()):
            CHECK.validate(json.loads(model_to_bytes(one)))
        CHECK.validate(json.loads(state_to_bytes(ModelState(BacklashState(1)), model)))
        done = model.simulate([0.5, 1.0, 0.8], model.start(0.5), time_step=0.005)
        CHECK.validate(json.loads(state_to_bytes(done.state, model)))


def test_a_coupled_set_fits() -> None:
    models = {"a": build(1), "b": build(2)}
    values = json.loads(
        set_to_bytes(
            models,
            Coupling(("a", "b"), np.array([[1, 0.1], [0, 1]]), np.zeros(2), np.ones(2)),
        )
    )
    CHECK.validate(values)
    assert not CHECK.is_valid(values | {"version": 1})
    assert not CHECK.is_valid(values | {"coupling": {"reference": {}}})


@pytest.mark.parametrize("name", sorted(path.name for path in OLD.glob("*.json")))
def test_files_of_old_versions_fit(name: str) -> None:
    CHECK.validate(json.loads((OLD / name).read_text()))


@pytest.mark.parametrize("page", ["model", "state"])
def test_the_examples_of_the_page_fit_and_are_read(page: str, tmp_path: Path) -> None:
    text = (DOCS / "model-file.md").read_text(encoding="utf-8")
    [found] = [
        one for one in re.findall(r"(?m)(?:^    .*\n)+", text) if f'"dbo-{page}"' in one
    ]
    values = json.loads(found)
    CHECK.validate(values)
    if page == "model":
        model = read_model(write(tmp_path, values))
        assert model.backlash.n == 5
        assert model.delay_seconds == 0.002


CASES = [
    (values, message)
    for values, message in REFUSED
    if isinstance(values, dict) and is_json(values)
]


@pytest.mark.parametrize(
    ("values", "message"), CASES, ids=[message[:50] for _, message in CASES]
)
def test_what_the_reader_refuses_by_structure_the_schema_refuses(
    values: object, message: str
) -> None:
    assert CHECK.is_valid(values) == bool(BEYOND.search(message))


@pytest.mark.parametrize(("path", "value", "message"), STATES)
def test_states_that_the_reader_refuses(
    tmp_path: Path, path: str, value: Any, message: str
) -> None:
    model = read_model(write(tmp_path, EXAMPLE))
    values = json.loads(state_to_bytes(state_of(model), model))
    place = values
    *way, last = path.split(".")
    for key in way:
        place = place[key]
    place[last] = value
    expected = bool(BEYOND.search(message)) and value not in ("0", "0x3", [])
    assert CHECK.is_valid(values) == expected


@given(st.sampled_from(KEYS), JSON)
@settings(derandomize=True, max_examples=300, deadline=None)
def test_what_the_reader_takes_the_schema_takes(
    tmp_path_factory: pytest.TempPathFactory, key: str, value: Any
) -> None:
    values = changed(key, value)
    path = write(tmp_path_factory.getbasetemp(), values, "any-schema.json")
    try:
        read_model(path)
    except DboError:
        return
    assert CHECK.is_valid(json.loads(Path(path).read_text()))


@pytest.mark.parametrize(
    "item", [1, 2.5, {"repeat": 7, "value": 0.5}, {"repeat": 1, "value": 3}]
)
def test_runs_that_are_read_fit(tmp_path: Path, item: object) -> None:
    values = copy.deepcopy(EXAMPLE)
    values["stages"][1] |= {"dx": [item], "dy": [item]}
    read_model(write(tmp_path, values))
    CHECK.validate(values)


@pytest.mark.parametrize(
    "item", [0, -1.0, True, "1", None, [], {"repeat": 0, "value": 1.0}, {"repeat": 1.5, "value": 1.0},
             {"repeat": 2}, {"repeat": 2, "value": 0}, {"repeat": 2, "value": 1, "x": 1},
             {"repeat": 10**7, "value": 1.0}],
)  # fmt: skip
def test_widths_that_are_none_do_not_fit(tmp_path: Path, item: object) -> None:
    values = copy.deepcopy(EXAMPLE)
    values["stages"][1] |= {"dx": [item], "dy": [item]}
    assert not CHECK.is_valid(values)
    with pytest.raises(DboError):
        read_model(write(tmp_path, values))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"direction": "inverse"}, "relaxation.on"),
        ({"time": 1.0}, "time"),
        ({"version": 0}, "version"),
    ],
)
def test_direction_and_version_matter(
    tmp_path: Path, change: dict[str, Any], message: str
) -> None:
    values = copy.deepcopy(EXAMPLE) | change
    assert not CHECK.is_valid(values)
    with pytest.raises(DboError, match=message):
        read_model(write(tmp_path, values))


def test_a_state_of_version_1_has_no_time(tmp_path: Path) -> None:
    model = read_model(str(OLD / "model-v1.json"))
    values = json.loads((OLD / "state-v1.json").read_text())
    values["time"] = 1.4
    assert not CHECK.is_valid(values)
    with pytest.raises(DboError, match="time: is not a known key"):
        read_state(write(tmp_path, values), model)


LAG, RESONANCE = {"lag": 0.0002}, {"frequency": 800.0, "damping": 0.02}
STATES_OF_ONE = [[0.1, 0.0, 0.1]]


def with_dynamics(sections: object) -> dict[str, Any]:
    """Return the example with these sections before its delay."""
    values = copy.deepcopy(EXAMPLE)
    values["stages"].insert(3, {"type": "dynamics", "sections": sections})
    return values


@pytest.mark.parametrize(
    "sections",
    [[LAG], [RESONANCE], [LAG, RESONANCE, RESONANCE],
     [RESONANCE | {"antiresonance": {"frequency": 950, "damping": 0.5}}]],
)  # fmt: skip
def test_dynamics_that_are_read_fit_in_both_directions(
    tmp_path: Path, sections: object
) -> None:
    model = read_model(write(tmp_path, with_dynamics(sections)))
    CHECK.validate(with_dynamics(sections))
    for one in (model, model.inverse()):
        CHECK.validate(json.loads(model_to_bytes(one)))
        x = (
            one.simulate([0.5, 0.6, 0.4], one.start(0.5), time_step=0.005)
            if one is model
            else None
        )
        if x is not None:
            CHECK.validate(json.loads(state_to_bytes(x.state, one)))


@pytest.mark.parametrize(
    "sections",
    [[], {}, [{}], [{"lag": 0}], [{"lag": "1"}], [LAG | RESONANCE], [{"frequency": 800.0}],
     [RESONANCE | {"damping": 1.0}], [RESONANCE | {"damping": 0}], [RESONANCE | {"frequency": -1}],
     [RESONANCE | {"antiresonance": None}], [RESONANCE | {"antiresonance": {"frequency": 900.0}}],
     [RESONANCE | {"zeta": 0.1}]],
)  # fmt: skip
def test_dynamics_that_are_none_do_not_fit(tmp_path: Path, sections: object) -> None:
    assert not CHECK.is_valid(with_dynamics(sections))
    with pytest.raises(DboError):
        read_model(write(tmp_path, with_dynamics(sections)))


def test_dynamics_stand_once_on_either_side_of_the_gears(tmp_path: Path) -> None:
    values = with_dynamics([LAG])
    at = [stage["type"] for stage in values["stages"]].index("dynamics")
    values["stages"].insert(at, values["stages"][at])
    with pytest.raises(DboError, match="and once"):
        read_model(write(tmp_path, values))
    values["stages"].insert(at, values["stages"][at])
    assert not CHECK.is_valid(values)
    first = with_dynamics([RESONANCE])
    first["stages"].insert(0, {"type": "dynamics", "sections": [LAG]})
    CHECK.validate(first)
    model = read_model(write(tmp_path, first))
    assert model.drive_lag is not None
    held = ModelState(BacklashState(1), drive_lag=((1.0, 0.0, 1.0),))
    CHECK.validate(json.loads(state_to_bytes(held, model)))
    CHECK.validate(json.loads(model_to_bytes(model.inverse())))


@pytest.mark.parametrize(
    ("held", "good"),
    [({"sections": STATES_OF_ONE, "inverse": None}, True),
     ({"sections": None, "inverse": {"time_step": 0.001, "sections": STATES_OF_ONE}}, True),
     ({"sections": STATES_OF_ONE}, False), ({"sections": [[0.1, 0.0]], "inverse": None}, False),
     ({"sections": [0.1, 0.0, 0.1], "inverse": None}, False),
     ({"sections": None, "inverse": {"sections": STATES_OF_ONE}}, False), (None, False),
     ({"sections": None, "inverse": None, "rest": 1}, False)],
)  # fmt: skip
def test_states_of_dynamics(tmp_path: Path, held: object, good: bool) -> None:
    model = read_model(write(tmp_path, with_dynamics([LAG])))
    values = json.loads(state_to_bytes(ModelState(BacklashState(1)), model)) | {
        "dynamics": held
    }
    assert CHECK.is_valid(values) == good
    path = write(tmp_path, values, "state.json")
    if good:
        read_state(path, model)
    else:
        with pytest.raises(DboError):
            read_state(path, model)
    values["version"] = 1
    del values["time"]
    assert not CHECK.is_valid(values)
