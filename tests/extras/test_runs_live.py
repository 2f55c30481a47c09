"""Half-done steps of live control: what is refused leaves nothing behind, and an operator may turn a knob."""

from __future__ import annotations

import pickle
from decimal import Decimal
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from test_runs_bank import either_kernel  # noqa: F401
from test_runs_controller import LIVE, moving
from test_runs_repeated import actuator

import dbo_cli as dbo
from dbo_cli.errors import InputError, UsageError
from dbo_cli.extras.live.bank import Bank
from dbo_cli.extras.live.converter import Codes, Converter
from dbo_cli.hysteresis.model_state import DriveLimits

RATE = 1000.0
SLEW = 1000.0  # V/s: 1 V a sample
CURVE = np.linspace(0.0, 120.0, 1201)  # of a converter: 0.1 V a code
CODE_SLEW = 1050.0  # V/s: ten codes a sample


def model() -> dbo.Model:
    """Return an actuator of 0 to 100 V and some 12 um."""
    return dbo.Model(actuator(frequency=None))


def pair() -> dbo.ModelSet:
    return dbo.ModelSet({"a": model(), "b": model()})


def left_as_it_was(live: Any, refused: Any, *wrong: Any) -> None:
    """Hold that something is refused with an error of this program, and that nothing has moved."""
    before, clipped = snapshot(live), np.array(live.clipped)
    with pytest.raises(dbo.DboError) as raised:
        refused(*wrong)
    assert isinstance(raised.value, (InputError, UsageError))
    assert snapshot(live) == before
    assert (np.array(live.clipped) == clipped).all()


def snapshot(live: Any) -> Any:
    return live.states if isinstance(live, Bank) else live.state


# --- a refused plan leaves nothing to commit ---


@pytest.mark.usefixtures("either_kernel")
@pytest.mark.parametrize("dac", [None, CURVE], ids=["volts", "codes"])
def test_a_frame_that_was_refused_is_not_committed(dac: Any) -> None:
    bank = pair().controller(RATE, max_slew=SLEW, dac=dac)
    volts = (lambda frame: frame) if dac is None else (lambda frame: dac[frame])
    for _ in range(60):
        before = volts(bank.step([5.0, 5.0]))
    for begun in range(2):
        if begun:
            bank.plan([5.0, 5.0])
        left_as_it_was(bank, bank.plan, [9.0, np.nan])
        left_as_it_was(bank, bank.commit)
        assert bank.planned is None
        assert not bank.held_back.any()
    assert np.abs(volts(bank.plan([9.0, 9.0])) - before).max() <= 1.0 + 1e-12


@pytest.mark.parametrize("begun", [False, True])
def test_a_row_that_was_refused_is_not_committed(begun: bool) -> None:
    live = model().controller(RATE, max_slew=SLEW)
    if begun:
        live.step(5.0)
    live.plan(5.0)
    left_as_it_was(live, live.plan, float("nan"))
    left_as_it_was(live, live.commit)
    with pytest.raises(
        UsageError, match=r"^nothing was planned to be committed: call plan first$"
    ):
        live.commit()
    assert live.planned is None


def test_channels_that_go_on_alone_forget_a_refused_frame_together() -> None:
    bank = Bank(
        {"a": moving("plain").actuator, "b": moving("plain").actuator},
        LIVE,
        lookahead="auto",
    )
    for _ in range(3):
        left_as_it_was(bank, bank.plan, [6.0, np.inf])
        left_as_it_was(bank, bank.commit)
        bank.plan([6.0, 6.0])
        left_as_it_was(bank, bank.commit, [50.0, np.inf])
        bank.commit()
    assert (bank.plan([6.0, 6.0])[0] == bank.plan([6.0, 6.0])).all()


# --- codes before any plan ---


@pytest.mark.usefixtures("either_kernel")
def test_codes_before_any_plan_are_taken_and_the_slew_is_kept() -> None:
    bank, alone = (
        made.controller(RATE, max_slew=CODE_SLEW, dac=CURVE)
        for made in (pair(), model())
    )
    bank.step([0.2, 0.2])
    alone.step(0.2)
    bank.commit([17, 500])
    alone.commit(17)
    for now in range(20):
        frame = CURVE[bank.plan([9.0, 0.0])]
        assert frame[0] == CURVE[alone.step(9.0)]
        assert frame == pytest.approx([1.7 + now + 1.0, 50.0 - now - 1.0])
        bank.commit()


# --- from outside the range inwards ---


@pytest.mark.usefixtures("either_kernel")
@pytest.mark.parametrize("turned, sign", [(105.0, -1.0), (-7.0, 1.0), (103.5, -1.0)])
def test_after_a_knob_was_turned_the_drive_comes_inwards(
    turned: float, sign: float
) -> None:
    live, bank = (
        model().controller(RATE, max_slew=SLEW),
        pair().controller(RATE, max_slew=SLEW),
    )
    live.step(5.0)
    bank.step([5.0, 5.0])
    live.commit(turned)
    bank.commit([turned, 50.0])
    edge = 0.0 if sign > 0.0 else 100.0
    volts = turned
    while not 0.0 <= volts <= 100.0:
        before, volts = volts, live.plan(5.0)
        frame = bank.plan([5.0, 5.0])
        if abs(before - edge) > 1.0:
            assert volts == pytest.approx(before + sign, rel=1e-15)
            assert live.held_back and bank.held_back[0]
        assert abs(volts - before) <= 1.0 + 1e-12
        assert frame[0] == volts
        live.commit()
        bank.commit()
    assert bank.states["a"] == live.state
    assert live.clipped >= 4


@pytest.mark.parametrize("kind", ["plain", "drive lag", "points"])
def test_with_dynamics_the_drive_comes_inwards(kind: str) -> None:
    made = moving(kind)
    low, span = made.input.minimum, made.input.span
    live = made.controller(LIVE, lookahead="auto", max_slew=0.01 * span * LIVE)
    live.step(made.output.minimum + 0.5 * made.output.span)
    live.commit(low - 0.05 * span)
    last = low - 0.05 * span
    for _ in range(8):
        volts = live.plan(made.output.minimum + 0.5 * made.output.span)
        assert 0.0 < volts - last <= 0.01 * span * (1.0 + 1e-12)
        live.commit()
        last = volts
    assert low < last


@pytest.mark.usefixtures("either_kernel")
@pytest.mark.parametrize("slew, samples", [(CODE_SLEW, 11), (40.0, 310)])
def test_codes_come_inwards_too(slew: float, samples: int) -> None:
    live = model().controller(RATE, max_slew=slew, v_max=99.0, dac=CURVE)
    bank = pair().controller(RATE, max_slew=slew, v_max=99.0, dac=CURVE)
    live.step(11.0)
    bank.step([11.0, 11.0])
    live.commit(1091)
    bank.commit([1091, 1091])
    codes = []
    for _ in range(samples):
        codes.append(live.step(11.9))
        assert (bank.step([11.9, 11.9]) == codes[-1]).all()
    assert codes[-1] <= 990 and sorted(codes, reverse=True) == codes
    assert np.abs(np.diff(CURVE[[1091, *codes]])).max() <= max(0.1, slew / RATE) + 1e-9


def test_what_stands_outside_at_the_start_comes_inwards() -> None:
    for begin in ({"from_": 110.0}, {"from_": "110V"}):
        live = model().controller(RATE, max_slew=SLEW, **begin)
        assert [live.step(5.0) for _ in range(3)] == pytest.approx(
            [109.0, 108.0, 107.0], rel=1e-15
        )
    again = model().controller(RATE, max_slew=SLEW, state=live.state)
    assert [again.step(5.0) for _ in range(8)] == pytest.approx(
        np.arange(106.0, 98.0, -1.0), rel=1e-14
    )
    free = model().controller(RATE, from_=110.0)
    assert 0.0 <= free.step(5.0) <= 100.0


def test_a_converter_between_two_codes_goes_to_one_of_them() -> None:
    live = model().controller(RATE, max_slew=10.0, dac=CURVE, from_=50.03)
    assert live.plan(11.0) == 500
    with pytest.raises(UsageError) as raised:
        model().controller(RATE, max_slew=10.0, dac=CURVE, from_=130.0)
    assert str(raised.value) == (
        "`from_`: the drive stands at 130, and the converter gives 0 to 120 (`dac`)"
    )


def test_an_empty_actuator_stands_at_its_lower_end_for_codes_too() -> None:
    for dac, volts, slew in (
        (None, lambda x: x, SLEW),
        (CURVE, lambda code: CURVE[code], CODE_SLEW),
    ):
        live = model().controller(RATE, max_slew=slew, state="empty", dac=dac)
        assert [volts(live.step(9.0)) for _ in range(3)] == pytest.approx(
            [1.0, 2.0, 3.0]
        )


# --- what is refused before anything moves ---

NO_NUMBERS: list[Any] = [
    True, np.True_, "5", b"5", None, [5.0], np.array([5.0]), 5j, np.array("5"), np.ma.masked, {}, 10**400,
    float("nan"), float("inf"), -float("inf"), np.float32("nan"), 1e300, -1e300, object,
]  # fmt: skip


def shown(wrong: Any) -> str:
    """Return a name of a case that is the same in every process."""
    return "object" if type(wrong) is object else repr(wrong)


@pytest.mark.parametrize("dac", [None, CURVE], ids=["volts", "codes"])
@pytest.mark.parametrize("begun", [False, True])
@pytest.mark.parametrize("wrong", NO_NUMBERS, ids=shown)
def test_what_is_no_number_is_refused(wrong: Any, begun: bool, dac: Any) -> None:
    live = model().controller(RATE, max_slew=SLEW, dac=dac)
    if begun:
        live.step(5.0)
    planned = live.plan(5.0)
    if wrong is not None:
        left_as_it_was(live, live.commit, wrong)
        assert live.planned == planned  # which can still be committed
        live.commit()
    left_as_it_was(live, live.plan, wrong)


@pytest.mark.usefixtures("either_kernel")
@pytest.mark.parametrize("dac", [None, CURVE], ids=["volts", "codes"])
@pytest.mark.parametrize(
    "wrong", [one for one in NO_NUMBERS if one is not None], ids=shown
)
def test_a_frame_with_what_is_no_number_is_refused(wrong: Any, dac: Any) -> None:
    bank = pair().controller(RATE, max_slew=SLEW, dac=dac)
    for _ in range(2):
        planned = bank.plan([5.0, 5.0])
        left_as_it_was(bank, bank.commit, [5, wrong])
        assert (bank.planned == planned).all()
        bank.commit()
        left_as_it_was(bank, bank.plan, [5.0, wrong])


@pytest.mark.parametrize("code", [-1, 1201, 3.5, 1e9])
def test_codes_that_are_none_are_refused(code: Any) -> None:
    bank, live = pair().controller(RATE, dac=CURVE), model().controller(RATE, dac=CURVE)
    for _ in range(2):
        left_as_it_was(bank, bank.commit, [5, code])
        left_as_it_was(live, live.commit, code)
        bank.commit([5, 7])
        live.commit(7)


def test_other_numbers_are_numbers() -> None:
    for value in (
        5,
        np.float32(5.0),
        np.int16(5),
        np.array(5.0),
        Fraction(5),
        Decimal(5),
    ):
        live, plain = model().controller(RATE), model().controller(RATE)
        assert live.plan(value) == plain.plan(5.0)
        live.commit(value)
        plain.commit(5.0)
        assert live.state == plain.state
    bank = pair().controller(RATE)
    assert (
        bank.plan((5, Decimal(5))).tolist() == [plain.step(5.0)] * 2
        or bank.planned is not None
    )


@pytest.mark.parametrize("name", ["from_", "v_min", "v_max", "max_slew"])
@pytest.mark.parametrize("wrong", [True, np.float32("nan"), [1.0], b"1", 1j], ids=shown)
def test_limits_that_are_no_numbers_are_refused(name: str, wrong: Any) -> None:
    with pytest.raises((InputError, UsageError), match=rf"^`{name}`"):
        model().controller(RATE, **{name: wrong})


def test_messages_of_what_is_refused() -> None:
    live = model().controller(RATE)
    for wrong, message in (
        (True, "what was applied is no number: True"),
        (np.array([1.0, 2.0]), "what was applied is no number: array([1., 2.])"),
        (float("inf"), "what was applied is not a finite number: inf"),
        (1e9, "what was applied, 1e+09 V, is too far away to be meant (it has to lie between -100000 and"
         " 100100 V)"),
    ):  # fmt: skip
        with pytest.raises(InputError) as raised:
            live.commit(wrong)
        assert str(raised.value) == message
    with pytest.raises(
        InputError, match=r"^`from_`, 1e\+09 V, is too far away to be meant "
    ):
        model().controller(RATE, from_=1e9)
    with pytest.raises(UsageError, match=r"^`v_max`: there is no channel 'c'$"):
        pair().controller(RATE, v_max={"c": 10.0})
    with pytest.raises(UsageError, match=r"^`states`: there is no channel 'c'$"):
        pair().controller(RATE, states={"c": None})
    with pytest.raises(UsageError, match=r"^channel a: `state`: is of another model "):
        other = moving("lag alone").controller(RATE)
        other.step(5.0)
        pair().controller(RATE, states={"a": other.state})


def test_limits_by_channel_may_be_texts_and_states_may_be_missing() -> None:
    bank = pair().controller(
        RATE, v_max=["50V", 40.0], states=pair().controller(RATE).states
    )
    assert bank.step([20.0, 20.0]).tolist() == [50.0, 40.0]


# --- what else goes with a row ---


def test_codes_held_back_by_the_slew_are_counted() -> None:
    live = model().controller(RATE, max_slew=SLEW, dac=CURVE, state="empty")
    bank = pair().controller(RATE, max_slew=SLEW, dac=CURVE, from_=0.0)
    for _ in range(10):
        live.step(5.0)
        bank.step([5.0, 5.0])
    assert live.clipped == 10
    assert bank.clipped.tolist() == [10, 10]


def test_a_plan_does_not_travel_and_leaves_with_what_was_committed() -> None:
    live = model().controller(RATE, max_slew=SLEW)
    live.step(5.0)
    live.plan(9.0)
    gone = pickle.loads(pickle.dumps(live))
    with pytest.raises(UsageError, match="nothing was planned"):
        gone.commit()
    assert gone.step(9.0) == live.step(9.0)


def test_a_ramp_to_rest_arrives_and_is_refused_whole() -> None:
    slow = model().controller(RATE, max_slew=20.0, dac=CURVE, from_=0.7)
    slow.commit(8)
    codes = slow.close()
    assert codes[-1] == 0 and sorted(codes, reverse=True) == codes
    live = model().controller(RATE, max_slew=SLEW)
    live.step(5.0)
    for wrong in (
        {"to": float("nan")},
        {"to": "5"},
        {"seconds": -1.0},
        {"seconds": 1e-3},
    ):
        before = live.state
        with pytest.raises(dbo.DboError):
            live.close(**wrong)
        assert live.state == before
    live.commit(105.0)
    way = live.close(to=101.0)
    assert way[-1] == 100.0 and np.abs(np.diff([105.0, *way])).max() <= 1.0 + 1e-12


@pytest.mark.parametrize("seed", range(40))
def test_codes_of_many_are_those_of_each(seed: int) -> None:
    """Random curves, limits and places, on codes and between them, inside and outside."""
    rng = np.random.default_rng(seed)
    curve = np.cumsum(rng.uniform(0.01, 1.0, 40)) - 5.0
    converters = []
    for _ in range(20):
        low, high = np.sort(rng.uniform(curve[0] - 1.0, curve[-1] + 1.0, 2))
        if not ((curve >= low) & (curve <= high)).any():
            low, high = curve[0] - 1.0, curve[-1] + 1.0
        step = None if rng.random() < 0.2 else float(10.0 ** rng.uniform(-3.0, 1.0))
        converters.append(Converter(curve, DriveLimits(float(low), float(high)), step))
    codes = Codes(converters)
    last = np.where(
        rng.random(20) < 0.5,
        rng.choice(curve, 20),
        rng.uniform(curve[0], curve[-1], 20),
    )
    volts, saved = (
        rng.uniform(curve[0] - 3.0, curve[-1] + 3.0, 20),
        rng.uniform(0.0, 0.5, 20),
    )
    together = [part.tolist() for part in codes.next(volts, last, saved)]
    for k, converter in enumerate(converters):
        alone = converter.next(float(volts[k]), float(last[k]), float(saved[k]))
        assert list(alone) == [part[k] for part in together]
