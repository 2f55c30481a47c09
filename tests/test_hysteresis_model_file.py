"""Model and state files: the same bytes, exact floats, and every wrong key named."""

from __future__ import annotations

import copy
import dataclasses
import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_hysteresis_model import build

import dbo_cli as dbo
from dbo_cli.errors import DboError, InputError, ModelError
from dbo_cli.hysteresis.model import ActuatorModel, DelayStage, ModelState
from dbo_cli.hysteresis.model_file import (
    AMOUNTS_OF_FIT,
    SIGNED_OF_FIT,
    model_to_bytes,
    read_model,
    read_state,
    state_to_bytes,
)
from dbo_cli.hysteresis.operators import BacklashState
from dbo_cli.runs.showing import as_text, contents

EXAMPLE: dict[str, Any] = {
    "format": "dbo-model",
    "version": 2,
    "direction": "forward",
    "input": {"quantity": "voltage", "unit": "V", "min": 0.0, "max": 3.6},
    "output": {"quantity": "displacement", "unit": None, "min": -23, "max": 22.1},
    "stages": [
        {
            "type": "backlash", "x0": 0.0, "y0": 0, "dx": [1.2, 1.0, 1.4],
            "dy": [0.1, 0.2, 0.30000000000000004],
            "relaxation": {"on": "input", "reference": 0.1, "tau": [0.01, 5.0], "gain": [0.02, 0.0]},
        },
        {"type": "point", "x0": 0.0, "y0": 0.0, "dx": [0.3, 0.3], "dy": [1.0, 2.0]},
        {"type": "scale", "gain": 12.53, "offset": -22.97},
        {"type": "delay", "seconds": 0.015},
    ],
    "fit": {"rmse": 0.19, "samples": 8000, "notes": ["µm", None, True]},
    "provenance": {"program": "dbo 0.1.0", "arguments": ["identify"], "inputs": []},
}  # fmt: skip


def write(folder: Path, values: object, name: str = "model.json") -> str:
    path = folder / name
    path.write_text(
        values if isinstance(values, str) else json.dumps(values), encoding="utf-8"
    )
    return str(path)


def test_a_file_keeps_every_float_and_its_bytes(tmp_path: Path) -> None:
    model = read_model(write(tmp_path, EXAMPLE))
    first = model_to_bytes(model)
    assert json.loads(first) == EXAMPLE
    assert list(json.loads(first)) == list(EXAMPLE)
    (tmp_path / "again.json").write_bytes(first)
    assert model_to_bytes(read_model(str(tmp_path / "again.json"))) == first
    assert first.endswith(b"}\n")
    assert "µm".encode() in first


def test_random_models_and_their_inverses_keep_their_bytes(tmp_path: Path) -> None:
    for seed in range(20):
        model = build(seed, relaxation=seed % 2 == 0, delay=0.01 * (seed % 3))
        for one in (model, model.inverse()):
            (tmp_path / "m.json").write_bytes(model_to_bytes(one))
            again = read_model(str(tmp_path / "m.json"))
            assert model_to_bytes(again) == model_to_bytes(one)
            assert again.digest == model.digest
        gears, exchanged = (
            json.loads(model_to_bytes(m))["stages"] for m in (model, model.inverse())
        )
        assert exchanged[-1]["dx"] == gears[0]["dy"]
        assert exchanged[-1]["dy"] == gears[0]["dx"]


def test_figures_of_the_fit_may_be_null(tmp_path: Path) -> None:
    values = copy.deepcopy(EXAMPLE)
    values["fit"] = dict.fromkeys((*AMOUNTS_OF_FIT, *SIGNED_OF_FIT))
    model = read_model(write(tmp_path, values))
    assert json.loads(model_to_bytes(model)) == values
    assert "fit: " not in as_text(contents(model))


def test_fit_and_provenance_may_be_absent(tmp_path: Path) -> None:
    values = {key: EXAMPLE[key] for key in EXAMPLE if key not in {"fit", "provenance"}}
    assert json.loads(model_to_bytes(read_model(write(tmp_path, values)))) == values


def changed(path: str, value: Any) -> dict[str, Any]:
    """Return the example with one key set, or removed where the value is ``...``."""
    values = copy.deepcopy(EXAMPLE)
    place: Any = values
    *way, last = path.split(".")
    for key in way:
        place = place[int(key)] if key.isdigit() else place[key]
    if value is ...:
        del place[last]
    else:
        place[int(last) if last.isdigit() else last] = value
    return values


def test_a_version_may_be_written_as_any_whole_number(tmp_path: Path) -> None:
    """The schema has it so: JSON knows one kind of number."""
    model = read_model(write(tmp_path, changed("version", 2.0)))
    assert json.loads(model_to_bytes(model)) == EXAMPLE


REFUSED: list[tuple[dict[str, Any] | str, str]] = [
    ("", "is empty; this is no model file"),
    ("{", "1: is not JSON: Expecting property name enclosed in double quotes"),
    ("[]", 'is not a model file ("format" must be "dbo-model")'),
    ("[" * 100_000, "is not readable JSON"),
    ('{"format": "dbo-model", "version": 1, "version": 1}', "version: occurs twice in one object"),
    ('{"format": "dbo-model", "note": "\\ud800"}', "is not readable JSON"),
    (changed("format", "other"), 'is not a model file ("format" must be "dbo-model")'),
    (changed("version", ...), "version: is missing"),
    (changed("version", "1"), 'version: "1" is not a version'),
    (changed("version", True), "version: true is not a version"),
    (changed("version", 1.5), "version: 1.5 is not a version"),
    (changed("version", 4), "version: 4 is newer than this program reads, 3; upgrade dbo-cli"),
    (changed("direction", "up"), "direction: 'up' is neither 'forward' nor 'inverse'"),
    (changed("colour", "red"), "colour: is not a known key"),
    (changed("input", ...), "input: is missing"),
    (changed("input", 3), "input: is not an object"),
    (changed("input.unit", ...), "input.unit: is missing"),
    (changed("input.unit", 3), "input.unit: 3 is not a text"),
    (changed("input.max", 0.0), "input.max: 0.0 is not greater than min, 0.0"),
    (changed("output.min", float("nan")), "output.min: nan is not a finite number"),
    (changed("output.min", "0"), 'output.min: "0" is not a number'),
    (changed("output.low", 1), "output.low: is not a known key"),
    (changed("stages", {}), "stages: is not a list"),
    (changed("stages", []), "stages: no backlash stage is among them"),
    (changed("stages.0", 7), "stages[0]: is not an object"),
    (changed("stages.0.type", ...), "stages[0].type: is missing"),
    (changed("stages.0.type", "gear"),
     "stages[0].type: 'gear' is not a known stage; there are: backlash, point, scale, dynamics, delay, "
     "plays, rate-plays, singular-plays, one-sided-plays"),
    (changed("stages.0.dx", 1.2), "stages[0].dx: is not a list of numbers"),
    (changed("stages.0.dx.2", -0.1), "stages[0].dx[2]: -0.1 is not a finite width greater than 0"),
    (changed("stages.0.dx.1", 0), "stages[0].dx[1]: 0.0 is not a finite width greater than 0"),
    (changed("stages.0.dy.0", float("nan")), "stages[0].dy[0]: nan is not a finite number"),
    (changed("stages.0.dy.0", 10**400), "stages[0].dy[0]: inf is not a finite number"),
    (changed("stages.0.dy.0", None), "stages[0].dy[0]: null is not a number"),
    (changed("stages.0.dy.0", True), "stages[0].dy[0]: true is not a number"),
    (changed("stages.0.dx", []), "stages[0].dx: is empty; at least one width is needed"),
    (changed("stages.0.dy", [1.0]), "stages[0].dy: has 1 entries where dx has 3"),
    (changed("stages.0.x0", ...), "stages[0].x0: is missing"),
    (changed("stages.0.n", 3), "stages[0].n: is not a known key"),
    (changed("stages.0.relaxation.on", "both"),
     "stages[0].relaxation.on: 'both' is neither 'input' nor 'output'"),
    (changed("stages.0.relaxation.on", "output"),
     "stages[0].relaxation.on: must be 'input' in this direction"),
    (changed("stages.0.relaxation.tau.1", 0),
     "stages[0].relaxation.tau[1]: 0.0 is not a finite time greater than 0"),
    (changed("stages.0.relaxation.gain.0", -1),
     "stages[0].relaxation.gain[0]: -1.0 is not a finite number of at least 0"),
    (changed("stages.0.relaxation.gain", [1]),
     "stages[0].relaxation.gain: has 1 entries where relaxation.tau has 2"),
    (changed("stages.1.dy.1", 0.0), "stages[1].dy[1]: 0.0 is not a finite width greater than 0"),
    (changed("stages.2.gain", 0), "stages[2].gain: 0.0 is not a finite number other than 0"),
    (changed("stages.2.offset", float("inf")), "stages[2].offset: inf is not a finite number"),
    (changed("stages.3.seconds", -1), "stages[3].seconds: -1.0 has the wrong sign here"),
    (changed("stages.1.type", "backlash"), "stages[1]: only one backlash stage is possible"),
    (changed("fit.rmse", float("nan")), "fit.rmse: nan is not a finite number"),
    (changed("fit.notes.0", float("inf")), "fit.notes[0]: inf is not a finite number"),
    (changed("fit", []), "fit: is not an object"),
    (changed("fit.rmse", "0.19"), 'fit.rmse: "0.19" is not a number'),
    (changed("fit.expected_rmse", "small"), 'fit.expected_rmse: "small" is not a number'),
    (changed("fit.expected_rmse", -1), "fit.expected_rmse: -1.0 is not a finite number of at least 0"),
    (changed("fit.zero_drift", [1.0]), "fit.zero_drift: [1.0] is not a number"),
    (changed("fit.lag_seconds", True), "fit.lag_seconds: true is not a number"),
]  # fmt: skip


@pytest.mark.whole
@pytest.mark.parametrize(
    ("values", "message"), REFUSED, ids=[message[:50] for _, message in REFUSED]
)
def test_what_is_refused(tmp_path: Path, values: Any, message: str) -> None:
    path = write(tmp_path, values)
    with pytest.raises(ModelError) as problem:
        read_model(path)
    separator = ":" if message.startswith("1:") else ": "
    assert str(problem.value) == f"{path}{separator}{message}"


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot be read: No such file or directory$"):
        read_model(str(tmp_path / "none.json"))
    with pytest.raises(InputError, match="cannot be read"):
        read_model(str(tmp_path))
    (tmp_path / "model.h5").write_bytes(b"\x89HDF\r\n\x1a\n")
    with pytest.raises(
        ModelError, match=r"byte 1 is not UTF-8; this is no model file$"
    ):
        read_model(str(tmp_path / "model.h5"))


def state_of(model: ActuatorModel) -> ModelState:
    done = model.simulate([0.5, 1.0, 0.8], model.start(0.5), time_step=0.005)
    return done.state


def test_states_come_back_exactly_and_serve_the_inverse(tmp_path: Path) -> None:
    model = read_model(write(tmp_path, EXAMPLE))
    state = state_of(model)
    (tmp_path / "state.json").write_bytes(state_to_bytes(state, model))
    assert read_state(str(tmp_path / "state.json"), model) == state
    assert read_state(str(tmp_path / "state.json"), model.inverse()) == state
    fresh = ModelState(BacklashState(3))
    (tmp_path / "state.json").write_bytes(state_to_bytes(fresh, model))
    assert read_state(str(tmp_path / "state.json"), model) == fresh


def test_a_resumed_run_gives_the_same_bits(tmp_path: Path) -> None:
    model = read_model(write(tmp_path, EXAMPLE))
    x = [0.3, 3.6, 0.0, 1.7, 1.1, 2.9, 2.2, 0.4]
    whole = model.simulate(x, model.start(x[0]), time_step=0.004)
    first = model.simulate(x[:3], model.start(x[0]), time_step=0.004)
    (tmp_path / "state.json").write_bytes(state_to_bytes(first.state, model))
    rest = model.simulate(
        x[3:], read_state(str(tmp_path / "state.json"), model), time_step=0.004
    )
    assert [*first.y.tolist(), *rest.y.tolist()] == whole.y.tolist()


STATES: list[tuple[str, Any, str]] = [
    (
        "model",
        "0",
        "model: the state belongs to another model (save it again with this one)",
    ),
    ("version", 3, "version: 3 is newer than this program reads, 2; upgrade dbo-cli"),
    ("backlash.gears", 4, "backlash.gears: is not 3, the number of gears of the model"),
    ("backlash.bits", "8", "backlash.bits: is not a hexadecimal number of 3 bits"),
    ("backlash.bits", "0x3", "backlash.bits: is not a hexadecimal number of 3 bits"),
    (
        "backlash.memory",
        [1.0],
        "backlash.memory: has 1 entries where the model has 2 relaxation terms",
    ),
    ("drive", "x", 'drive: "x" is not a number'),
    ("delay.values", [], "delay.values: has 0 entries where times has 4"),
    ("delay.times", [3, 2, 1, 0], "delay.times: goes backwards"),
    ("more", 1, "more: is not a known key"),
]


@pytest.mark.parametrize(("path", "value", "message"), STATES)
def test_states_that_are_refused(
    tmp_path: Path, path: str, value: Any, message: str
) -> None:
    model = read_model(write(tmp_path, EXAMPLE))
    values = json.loads(state_to_bytes(state_of(model), model))
    place = values
    *way, last = path.split(".")
    for key in way:
        place = place[key]
    place[last] = value
    file = write(tmp_path, values, "state.json")
    with pytest.raises(ModelError) as problem:
        read_state(file, model)
    assert str(problem.value) == f"{file}: {message}"


JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.text(max_size=5), inner, max_size=4)
    ),
    max_leaves=12,
)
KEYS = [
    "version", "direction", "input", "input.min", "output.max", "stages", "stages.0", "stages.0.dx",
    "stages.0.dx.1", "stages.0.relaxation", "stages.0.relaxation.tau", "stages.1.dy.0", "stages.2",
    "stages.2.gain", "stages.3.seconds", "fit", "provenance.inputs",
]  # fmt: skip


@given(st.sampled_from(KEYS), JSON)
@settings(derandomize=True, max_examples=300, deadline=None)
def test_any_json_is_read_or_refused_in_one_line(
    tmp_path_factory: pytest.TempPathFactory, key: str, value: Any
) -> None:
    path = write(tmp_path_factory.getbasetemp(), changed(key, value), "any.json")
    try:
        model_to_bytes(read_model(path))
    except DboError as problem:
        assert "\n" not in str(problem)


RUNS = [0.5, *[0.25] * 40, 0.75, 0.75, *[0.125] * 3]


def test_runs_of_equal_widths_are_written_once(tmp_path: Path) -> None:
    values = copy.deepcopy(EXAMPLE)
    values["stages"][0] |= {"dx": RUNS, "dy": RUNS}
    model = read_model(write(tmp_path, values))
    written = model_to_bytes(model)
    assert json.loads(written)["stages"][0]["dx"] == [
        0.5, {"repeat": 40, "value": 0.25}, 0.75, 0.75, {"repeat": 3, "value": 0.125}
    ]  # fmt: skip
    (tmp_path / "runs.json").write_bytes(written)
    again = read_model(str(tmp_path / "runs.json"))
    assert again.backlash.dx.tolist() == RUNS
    assert model_to_bytes(again) == written


def test_no_line_of_a_model_file_is_long(tmp_path: Path) -> None:
    values = copy.deepcopy(EXAMPLE)
    values["stages"][0] |= {"dx": [1.0 + k / 7 for k in range(300)], "dy": [1.0] * 300}
    del values["stages"][0]["relaxation"]
    written = model_to_bytes(read_model(write(tmp_path, values)))
    assert max(map(len, written.splitlines())) <= 130


@pytest.mark.parametrize(
    ("item", "message"),
    [
        (
            {"repeat": 0, "value": 1.0},
            "stages[0].dx[0].repeat: 0 is not a number of times",
        ),
        (
            {"repeat": True, "value": 1.0},
            "stages[0].dx[0].repeat: true is not a number of times",
        ),
        (
            {"repeat": 1.5, "value": 1.0},
            "stages[0].dx[0].repeat: 1.5 is not a number of times",
        ),
        ({"repeat": 2}, "stages[0].dx[0].value: is missing"),
        ({"repeat": 2, "value": "x"}, 'stages[0].dx[0].value: "x" is not a number'),
        (
            {"repeat": 10**12, "value": 1.0},
            "stages[0].dx: has more than 1,000,000 entries",
        ),
    ],
)
def test_a_run_that_is_none_is_refused(
    tmp_path: Path, item: object, message: str
) -> None:
    values = copy.deepcopy(EXAMPLE)
    values["stages"][0]["dx"] = [item]
    path = write(tmp_path, values)
    with pytest.raises(ModelError) as problem:
        read_model(path)
    assert str(problem.value) == f"{path}: {message}"


OLD = Path(__file__).parent / "old_files"


def test_files_of_version_1_stay_readable() -> None:
    model = read_model(str(OLD / "model-v1.json"))
    assert json.loads((OLD / "model-v1.json").read_text())["version"] == 1
    assert (
        model.backlash.dx.tolist()
        == json.loads((OLD / "model-v1.json").read_text())["stages"][0]["dx"]
    )
    state = read_state(str(OLD / "state-v1.json"), model)
    assert state.time is None
    assert state.drive == json.loads((OLD / "state-v1.json").read_text())["drive"]


def test_a_linear_delay_of_version_2_keeps_its_bits(tmp_path: Path) -> None:
    """A model of the version before, with what the program of that version made of it."""
    model = dbo.read_model(str(OLD / "model-v2.json"))
    x = 1.8 - 1.8 * np.cos(np.arange(12) / 2.0)
    wanted = 10.0 * np.sin(np.arange(12) / 3.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        outputs = (
            model.simulate(x, sample_rate=200.0),
            model.simulate(x, time=0.005 * np.arange(12)),
            model.compensate(wanted, sample_rate=200.0, on_limit="clip"),
        )
    assert [[float(value).hex() for value in output] for output in outputs] == LINEAR
    again = model_to_bytes(model.actuator)
    assert again == (OLD / "model-v2.json").read_bytes()
    assert json.loads(model_to_bytes(model.actuator.inverse()))["version"] == 2
    smooth = dataclasses.replace(
        model.actuator, stages=(*model.actuator.stages[:-1], DelayStage(0.0125))
    )
    written = json.loads(model_to_bytes(smooth))
    assert written["version"] == 3
    (tmp_path / "new.json").write_bytes(model_to_bytes(smooth))
    assert model_to_bytes(read_model(str(tmp_path / "new.json"))) == model_to_bytes(
        smooth
    )
    # a state of the one is none of the other's
    assert smooth.digest != model.actuator.digest


LINEAR = [
    [
        "-0x1.6f851eb851eb8p+4",
        "-0x1.6f851eb851eb8p+4",
        "-0x1.6f851eb851eb8p+4",
        "-0x1.6663e9a2b912ep+4",
        "-0x1.437c4d8301ea6p+4",
        "-0x1.fd84b2cda1084p+3",
        "-0x1.413a249147296p+3",
        "-0x1.020ccb8e972f8p+2",
        "0x1.d6d89a2981a80p-3",
        "0x1.45ca7ee3c4080p+0",
        "-0x1.4794c9ff422e8p+0",
        "-0x1.6134f83d95360p+2",
    ],
    [
        "-0x1.6f851eb851eb8p+4",
        "-0x1.6f851eb851eb8p+4",
        "-0x1.6f851eb851eb8p+4",
        "-0x1.6663e9a2b912ep+4",
        "-0x1.437c4d8301ea6p+4",
        "-0x1.fd84b2cda1084p+3",
        "-0x1.413a249147297p+3",
        "-0x1.020ccb8e972f6p+2",
        "0x1.d6d89a2981a80p-3",
        "0x1.45ca7ee3c4080p+0",
        "-0x1.4794c9ff422f4p+0",
        "-0x1.6134f83d9535cp+2",
    ],
    [
        "0x1.ccccccccccccdp+1",
        "0x1.ccccccccccccdp+1",
        "0x1.ccccccccccccdp+1",
        "0x1.ccccccccccccdp+1",
        "0x1.ccccccccccccdp+1",
        "0x1.ccccccccccccdp+1",
        "0x1.ccccccccccccdp+1",
        "0x1.993a9ca7fe698p+1",
        "0x1.4f8373d8f6ab6p+1",
        "0x1.2f5818cb571fcp+1",
        "0x1.2f5818cb571fcp+1",
        "0x1.2f5818cb571fcp+1",
    ],
]
"""Simulated at an even rate, simulated along stamps, and compensated."""
