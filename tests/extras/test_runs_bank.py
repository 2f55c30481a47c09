"""The bank of a model set: the bits of one controller a channel, in one call a frame."""

from __future__ import annotations

import dataclasses
import pickle
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dbo_cli as dbo
from dbo_cli.drives.gate import GateError
from dbo_cli.errors import InputError, ModelError, UsageError
from dbo_cli.hysteresis import kernel, stepper
from dbo_cli.hysteresis.model import (
    ActuatorModel,
    BacklashStage,
    PointStage,
    Quantity,
    Relaxation,
    ScaleStage,
)

RATE = 1000.0
FRAMES = 200


def actuator(seed: int) -> dbo.Model:
    """Return a model of 20 to 150 gears: with or without memories, points before or behind the gears."""
    rng = np.random.default_rng(seed)
    gears = int(rng.integers(20, 150))
    memory = Relaxation(0.0, (0.01, 0.3), (0.0004, 0.0002)) if seed % 3 else None
    stages: list[Any] = [
        BacklashStage(
            np.full(gears, 100.0 / gears),
            np.sort(rng.uniform(0.5, 1.5, gears)) / gears,
            0.0,
            0.0,
            memory,
        )
    ]
    if seed % 2:
        stages.append(
            PointStage(np.array([0.3, 0.4, 0.6]), np.array([0.25, 0.4, 0.7]), 0.0, 0.0)
        )
    if seed % 4 == 2:
        stages.insert(
            0, PointStage(np.array([50.0, 50.0]), np.array([48.0, 52.0]), 0.0, 0.0)
        )
    stages.append(ScaleStage(10.0 + seed, -1.0))
    given, made = (
        Quantity("voltage", "V", 0.0, 100.0),
        Quantity("displacement", "um", -1.0, 9.0 + seed),
    )
    return dbo.Model(ActuatorModel("forward", given, made, tuple(stages)))


SET = dbo.ModelSet({f"x{seed}": actuator(seed) for seed in range(9)})


def frames(seed: int = 1) -> np.ndarray:
    """Return moves that turn, leave the range, and jump."""
    rng = np.random.default_rng(seed)
    walk = np.cumsum(rng.normal(0.0, 0.2, (FRAMES, len(SET))), axis=0) + 4.0
    walk[100:120] += 40.0
    return np.asarray(walk)


@pytest.fixture(params=["compiled", "python"])
def either_kernel(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> str:
    if request.param == "python":
        for module in (kernel, stepper.kernel):
            monkeypatch.setattr(module, "CHOSEN", kernel.PythonKernel)
    elif kernel.compiled_kernel() is None:
        pytest.skip("the compiled kernel is not there")
    return str(request.param)


LIMITS = (
    {},
    {"v_min": 5.0, "v_max": 80.0, "max_slew": 3000.0},
    {"v_max": 90.0, "from_": 110.0, "max_slew": 30000.0},
    {"max_slew": 4000.0, "dac": np.linspace(0.0, 100.0, 1024)},
    {"max_slew": 60.0, "v_max": 70.0, "dac": np.linspace(-1.0, 101.0, 256)},
    {"dac": np.linspace(0.0, 100.0, 4096)},
)


@pytest.mark.parametrize("limits", LIMITS, ids=lambda one: "-".join(one) or "none")
def test_each_channel_gets_the_bits_of_its_own_controller(
    limits: dict[str, Any], either_kernel: str
) -> None:
    wanted = frames()
    bank = SET.controller(RATE, **limits)
    played = np.array([bank.step(frame) for frame in wanted])
    for place, (channel, model) in enumerate(SET.items()):
        alone = model.controller(RATE, **limits)
        assert [alone.step(value) for value in wanted[:, place].tolist()] == played[
            :, place
        ].tolist()
        assert bank.states[channel] == alone.state
        assert bank.clipped[place] == alone.clipped


@pytest.mark.parametrize(
    "limits",
    [{}, {"max_slew": 4000.0, "dac": np.linspace(0.0, 100.0, 1024)}],
    ids=["volts", "codes"],
)
def test_a_plan_that_is_not_committed_leaves_no_trace(
    limits: dict[str, Any], either_kernel: str
) -> None:
    wanted, other = frames(), frames(2)
    bank, plain = SET.controller(RATE, **limits), SET.controller(RATE, **limits)
    for now, frame in enumerate(wanted):
        bank.plan(other[now])
        bank.plan(other[-now])
        assert (bank.step(frame) == plain.step(frame)).all()


@pytest.mark.parametrize(
    "limits", [{}, {"dac": np.linspace(0.0, 100.0, 1024)}], ids=["volts", "codes"]
)
def test_what_was_applied_instead_counts(
    limits: dict[str, Any], either_kernel: str
) -> None:
    wanted = frames()[:60]
    bank = SET.controller(RATE, **limits)
    alone = [model.controller(RATE, **limits) for model in SET.values()]
    for now, frame in enumerate(wanted):
        planned = bank.plan(frame)
        one_by_one = [
            one.plan(value) for one, value in zip(alone, frame.tolist(), strict=True)
        ]
        assert planned.tolist() == one_by_one
        applied = np.clip(
            planned + (1 if limits else 0.01) * (now % 3 - 1),
            0,
            1023 if limits else 100.0,
        )
        bank.commit(applied)
        for one, value in zip(alone, applied.tolist(), strict=True):
            one.commit(value)
    assert list(bank.states.values()) == [one.state for one in alone]


def test_limits_of_each_channel() -> None:
    tops = np.linspace(20.0, 100.0, len(SET))
    bank = SET.controller(RATE, v_max=tops, v_min={"x3": 10.0})
    bank.step(frames()[0])
    volts = bank.step(np.full(len(SET), 100.0))
    assert (volts == tops).all()
    assert bank.step(np.full(len(SET), -100.0))[3] == 10.0


def test_going_on_from_states() -> None:
    wanted = frames()
    bank = SET.controller(RATE)
    for frame in wanted[:50]:
        bank.step(frame)
    again = SET.controller(
        RATE,
        states={
            name: state for name, state in bank.states.items() if state is not None
        },
    )
    for frame in wanted[50:90]:
        assert (again.step(frame) == bank.step(frame)).all()


def test_what_is_refused() -> None:
    bank = SET.controller(RATE)
    with pytest.raises(
        UsageError, match="nothing was planned to be committed: call plan first"
    ):
        bank.commit()
    for _ in range(2):
        for wanted, message in (
            (
                [1.0, 2.0],
                r"what is wanted has the shape \(2,\); give 9 values, one a channel",
            ),
            (
                [4.0] * 7 + [np.nan, 1.0],
                "channel x7: what is wanted is not a finite number: ",
            ),
            (["a"] * 9, "what is wanted is no array of numbers"),
        ):
            with pytest.raises(InputError, match=message):
                bank.plan(wanted)
        bank.step(np.full(9, 4.0))
    with pytest.raises(
        InputError, match="channel x2: what was applied is not a finite number"
    ):
        bank.commit([1.0, 1.0, np.inf, *[1.0] * 6])
    with pytest.raises(UsageError, match="`v_max`: 2 values for 9 channels"):
        SET.controller(RATE, v_max=[1.0, 2.0])
    with pytest.raises(
        UsageError,
        match="channel x1: this model and these limits need the time between samples",
    ):
        SET.controller()
    inverse = dbo.ModelSet({"a": SET["x0"], "b": SET["x0"].inverse()})
    with pytest.raises(
        ModelError,
        match="channel b: the model: is an inverse model where a forward one is needed",
    ):
        inverse.controller(RATE)
    codes = SET.controller(RATE, dac=np.linspace(0.0, 100.0, 16))
    codes.step(np.full(9, 4.0))
    with pytest.raises(
        InputError, match="channel x1: code 99 is not one of the converter's, 0 to 15"
    ):
        codes.commit([1, 99, *[1] * 7])


@pytest.mark.parametrize("coded", [False, True])
def test_a_frame_that_would_break_the_limits_never_leaves(
    coded: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The gate is a second look: here the first one is made to fail."""
    limits = {"v_max": 50.0, **({"dac": np.linspace(0.0, 100.0, 64)} if coded else {})}
    bank = SET.controller(RATE, **limits)
    bank.step(np.full(9, 2.0))
    if coded:
        bank._codes._high[:] = 63  # type: ignore[union-attr]
    live = bank._live
    monkeypatch.setattr(bank, "_live", Lying(live))
    with pytest.raises(
        GateError, match=r"channel x4: this program planned .* which breaks its limits"
    ):
        bank.plan(np.full(9, 2.0))


class Lying:
    """A bank that plans 80 V for channel 4."""

    def __init__(self, live: Any) -> None:
        self.live = live

    def plan(self, x: Any, y: Any, clipped: Any, gate: bool) -> int:
        """Plan, and spoil it."""
        self.live.plan(x, y, clipped, gate)
        y[4] = 80.0
        found = int(self.live.check(y))
        return -2 - found if gate else -1


def test_the_kernels_bank_refuses_what_would_read_beyond_a_buffer() -> None:
    if kernel.compiled_kernel() is None:
        pytest.skip("the compiled kernel is not there")
    bank = SET.controller(RATE)
    bank.step(np.full(9, 4.0))
    live = bank._live
    good, flags = np.zeros(9), np.zeros(9, np.uint8)
    for words in (
        (np.zeros(8), good, flags, True),
        (good, np.zeros(10), flags, True),
        (good, good, np.zeros(3, np.uint8), True),
    ):
        with pytest.raises(ValueError, match="bank: arrays of the wrong length"):
            live.plan(*words)
    with pytest.raises(ValueError, match="bank: arrays of the wrong length"):
        live.follow(np.zeros(3))
    make, steppers = kernel.CHOSEN.Bank, (bank._controllers[0].begun[0].inner,)  # type: ignore[index]
    empty, places = np.empty(0), np.zeros(2, np.uint64)
    limits = np.array([0.0, 1.0, np.nan, np.nan, -9.0, 9.0, -9.0, 9.0])
    make(steppers, empty, places, empty, places, empty, places, limits)
    for curves in (
        [1.0, 5.0, 0.0, 0.0, 1.0, 1.0, 1.0],
        [0.0, 1.0],
        [1.0, np.nan, 0.0, 0.0, 1.0, 1.0, 1.0],
        [1.0, 1e300, 0.0, 0.0, 0.0, 0.0, 0.0],
    ):
        numbers = np.array(curves)
        with pytest.raises(ValueError, match="bank: curves"):
            make(
                steppers,
                numbers,
                np.array([0, numbers.size], np.uint64),
                empty,
                places,
                empty,
                places,
                limits,
            )
    for wrong in ([0, 2**63], [1, 3], [0, 4]):
        with pytest.raises(ValueError, match="bank: places of curves"):
            make(
                steppers,
                np.array([0.0, 1.0, 0.0]),
                np.array(wrong, np.uint64),
                empty,
                places,
                empty,
                places,
                limits,
            )
    with pytest.raises(ValueError, match="bank: limits"):
        make(steppers, empty, places, empty, places, empty, places, np.zeros(3))
    with pytest.raises(TypeError, match="a tuple of steppers is needed"):
        make((1,), empty, places, empty, places, empty, places, limits)


# --- model sets in Python ---


def test_a_set_is_saved_and_read(tmp_path: Path) -> None:
    SET.save(tmp_path / "set.json")
    again = dbo.read_model(tmp_path / "set.json")
    assert isinstance(again, dbo.ModelSet)
    assert (list(again), again.to_json()) == (list(SET), SET.to_json())
    assert dbo.read_model(f"{tmp_path}/set.json::x3").to_json() == SET["x3"].to_json()


@pytest.mark.filterwarnings("ignore::dbo_cli.DboWarning")
def test_matrices_in_and_out() -> None:
    wanted = frames()[:50]
    volts = SET.compensate(wanted, sample_rate=RATE)
    moved = SET.simulate(volts, sample_rate=RATE)
    for place, model in enumerate(SET.values()):
        alone = model.compensate(wanted[:, place], sample_rate=RATE)
        assert (volts[:, place] == alone).all()
        assert (moved[:, place] == model.simulate(alone, sample_rate=RATE)).all()
    with pytest.raises(
        InputError,
        match=r"`wanted`: has the shape \(50, 3\); give \(samples, 9 channels\)",
    ):
        SET.compensate(wanted[:, :3])


QUICK = {
    "gears": 4,
    "points": 0,
    "relaxation": (),
    "delay": 0.0,
    "dynamics": 0,
    "force": True,
}


@pytest.mark.filterwarnings("ignore::dbo_cli.DboWarning")
def test_identify_of_patterns_gives_a_set(tmp_path: Path) -> None:
    import pandas as pd

    up = np.linspace(0.0, 10.0, 50)
    volts = np.concatenate([up, up[::-1]] * 3)
    rng = np.random.default_rng(2)
    frame = pd.DataFrame({"time_s": np.arange(volts.size) * 0.01})
    for k in (1, 2):
        frame[f"V{k}_V"] = volts
        frame[f"D{k}_um"] = k * (volts + 0.6 * np.sin(0.3 * volts)) + 0.01 * rng.normal(
            size=volts.size
        )
    made = dbo.identify(frame, voltage="V{}", displacement="D{}", **QUICK)
    assert list(made) == ["1", "2"]
    one = dbo.identify(frame, voltage="V2", displacement="D2", **QUICK)
    kept, alone = (
        {**dataclasses.asdict(m.actuator), "provenance": 0} for m in (made["2"], one)
    )
    assert str(kept) == str(alone)
    frame.to_csv(tmp_path / "log.csv", index=False)
    read = dbo.identify(
        tmp_path / "log.csv", voltage="V{}", displacement="D{}", **QUICK
    )
    assert str(read["1"].actuator.stages) == str(made["1"].actuator.stages)
    with pytest.raises(
        UsageError,
        match="`displacement` is not given where `voltage` 'V\\{\\}' is many",
    ):
        dbo.identify(frame, voltage="V{}", **QUICK)


def test_a_warning_of_identify_names_the_line_that_called_it() -> None:
    import pandas as pd

    volts = np.concatenate([np.linspace(0.0, 10.0, 50), np.linspace(10.0, 0.0, 50)])
    moved = volts + 0.6 * np.sin(0.3 * volts)
    frame = pd.DataFrame(
        {"time_s": 0.01 * np.arange(100), "V1_V": volts, "D1_um": moved}
    )
    for names in (("V1", "D1"), ("V{}", "D{}")):
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            dbo.identify(frame, voltage=names[0], displacement=names[1], **QUICK)
        assert {one.filename for one in said} == {__file__}


@pytest.mark.parametrize("dac", [None, np.linspace(0.0, 100.0, 4096)])
def test_a_bank_goes_on_in_another_process(either_kernel: str, dac: Any) -> None:
    options: dict[str, Any] = {
        "v_min": 0.0,
        "v_max": 100.0,
        "max_slew": 9000.0,
        "dac": dac,
    }
    stays = SET.controller(RATE, **options)
    for frame in frames()[:150]:
        stays.step(frame)
    gone = pickle.loads(pickle.dumps(stays))
    for frame in frames()[150:]:
        assert gone.step(frame).tolist() == stays.step(frame).tolist()
    assert gone.clipped.tolist() == stays.clipped.tolist()
