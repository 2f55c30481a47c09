from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dbo_cli.drive import Limits
from dbo_cli.drive.lead import Lead
from dbo_cli.drive.smooth import swings
from dbo_cli.errors import LimitError, UsageError
from dbo_cli.model import Cascade, Lag, Resonance

from .actuators import actuator, actuators, plan, ripple

pytestmark = pytest.mark.filterwarnings("ignore::dbo_cli.errors.DboWarning")
DT = 2e-4


def limits_of(model: Cascade, *typed: float | None, **named: float | bool) -> Limits:
    return Limits.within(model.input, *typed, **named)  # type: ignore[arg-type]


def played(
    model: Cascade, voltage: np.ndarray, dt: float = DT, start: str = "auto"
) -> np.ndarray:
    return np.asarray(model.run(voltage, model.start(float(voltage[0]), start), dt).y)


def test_typed_seconds() -> None:
    model = actuator()
    wanted = ripple(model, 1000, 0.6)
    drive = plan(model, wanted, 0.01, limits_of(model), start=0.0, approach=2.0)
    assert drive.lead_seconds == pytest.approx(2.0, abs=0.03)
    rest = plan(model, wanted, 0.01, limits_of(model), lead=0.5)
    assert rest.move.start == 50
    assert np.ptp(rest.desired[:51]) == 0.0


def test_lead_auto_is_what_is_read_ahead() -> None:
    model = actuator(sections=(Resonance(60.0, 0.02),), delay=0.002)
    drive = plan(
        model,
        ripple(model, 1000, 0.5),
        DT,
        limits_of(model),
        lead="auto",
        on_limit="clip",
    )
    assert drive.move.start == model.inverter(DT).ahead


def test_sweep_stays_in_the_moves_range() -> None:
    model = actuator(low=0.0, high=100.0)
    drive = plan(
        model,
        ripple(model, 200, 0.3),
        DT,
        limits_of(model, -20, 150),
        start=-10.0,
        condition=True,
    )
    swept = drive.voltage[: drive.move.start]
    assert swept[0] == -10.0
    assert swept.max() == 100.0
    typed = plan(
        model, ripple(model, 200, 0.3), DT, limits_of(model, 5, 80), condition=True
    )
    assert (typed.voltage.min(), typed.voltage.max()) == (5.0, 80.0)


@pytest.mark.parametrize("start", [0.15, 0.5, 0.8])
@pytest.mark.parametrize("slew", [None, 600.0])
def test_sweep_joins_the_move(start: float, slew: float | None) -> None:
    model = actuator(
        tau=(0.01, 0.3, 4.0),
        gain=(0.003, 0.004, 0.004),
        curve=(1.0, 0.8, 1.1),
        sections=(Lag(4e-4), Resonance(250.0, 0.02)),
    )
    t = np.arange(10000) * DT
    hump = np.sin(np.pi * np.clip((t - 0.3) / 1.2, 0, 1)) ** 2
    wanted = model.output.min + model.output.span * (start + 0.1 * hump)
    drive = plan(model, wanted, DT, limits_of(model, max_slew=slew), condition=True)
    steps = np.abs(np.diff(drive.voltage))
    join = drive.move.start
    around = steps[join - 3 : join + 3].max()
    elsewhere = np.r_[steps[: join - 3], steps[join + 3 :]].max()
    assert around <= elsewhere
    y = played(model, drive.voltage)
    assert np.abs(y - wanted_rows(drive.desired, y))[join:].max() < 5e-3


def wanted_rows(desired: np.ndarray, y: np.ndarray) -> np.ndarray:
    assert desired.size == y.size
    return desired


@pytest.mark.parametrize("rows", [200, 40_000])
def test_at_most_a_minute_is_chosen_and_a_refusal_names_the_seconds(rows: int) -> None:
    """However long the move is; the named seconds are then typed, and drive."""
    model = actuator(tau=(0.1, 2.0), gain=(0.01, 0.02))
    wanted = ripple(model, rows, 0.3)
    for more in ({"condition": True}, {"condition": True, "start": 70.0}):
        options: dict[str, Any] = {**more, "on_limit": "clip"}
        limits = limits_of(model, max_slew=1.0)
        with pytest.raises(LimitError, match="`approach`") as refused:
            plan(model, wanted, 0.01, limits, **options)
        seconds = float(str(refused.value).split("`approach` ")[1].split(" ")[0])
        drive = plan(model, wanted, 0.01, limits, approach=seconds, **options)
        assert 300.0 < drive.lead_seconds <= seconds + 1.0
        quick = limits_of(model, max_slew=10.0)
        assert plan(model, wanted, 0.01, quick, **options).lead_seconds <= 60.0


def test_typed_seconds_are_the_whole_way_of_a_sweep() -> None:
    model = actuator(tau=(0.1, 2.0), gain=(0.01, 0.02))
    wanted = ripple(model, 300, 0.3)
    for start, seconds in ((None, 4.0), (60.0, 200.0), (0.0, 5.0)):
        drive = plan(
            model,
            wanted,
            0.01,
            limits_of(model, max_slew=120.0),
            start=start,
            condition=True,
            approach=seconds,
            on_limit="clip",
        )
        assert drive.lead_seconds == pytest.approx(seconds, abs=0.05)
        lead = drive.voltage[: drive.move.start]
        assert (lead.min(), lead.max()) == (0.0, 100.0)
    with pytest.raises(LimitError, match="whole way") as refused:
        limits = limits_of(model, max_slew=40.0)
        plan(model, wanted, 0.01, limits, condition=True, approach=2.0)
    fits = float(str(refused.value).split("at least ")[1].split(" ")[0])
    plan(model, wanted, 0.01, limits, condition=True, approach=fits, on_limit="clip")


def test_options_that_are_none() -> None:
    model = actuator()
    limits = limits_of(model)
    for wrong in (0.0, -1.0, math.nan, math.inf, "soon"):
        with pytest.raises(UsageError):
            Lead(approach=wrong)  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="exclude"):
        Lead(condition=True, state="empty")
    with pytest.raises(UsageError, match="from"):
        plan(model, [1.0, 2.0, 3.0], DT, limits, approach="auto")
    for number in (np.float32(0.5), np.int64(1), 1):
        assert Lead(approach=number, rest=number) == Lead(  # type: ignore[arg-type]
            approach=float(number), rest=float(number)
        )
    state = plan(model, [1.0, 2.0, 3.0], DT, limits).state
    with pytest.raises(UsageError, match="contradicts"):
        plan(model, [1.0, 2.0, 3.0], DT, limits, start=77.0, state=state)


@given(
    st.lists(st.floats(-100, 100), min_size=2, max_size=5),
    st.integers(1, 50),
)
def test_swings_stay_between_their_turns(turns: list[float], rows: int) -> None:
    voltage = swings(turns, [rows] * (len(turns) - 1))
    assert voltage.size == 1 + rows * (len(turns) - 1)
    assert voltage.min() == min(turns) and voltage.max() == max(turns)
    assert voltage[0] == turns[0] and voltage[-1] == turns[-1]


@given(
    actuators(),
    st.floats(0.0, 1.0),
    st.floats(0.0, 1.0),
    st.sampled_from([None, 1.0, 20.0]),
)
@settings(max_examples=60, deadline=None, derandomize=True)
def test_the_way_joins_the_move(
    model: Cascade, stands: float, begins: float, slew: float | None
) -> None:
    """Where the move is at rest, the way ends without a step larger than those within."""
    start = model.input.min + stands * model.input.span
    rest = model.output.min + (0.1 + 0.8 * begins) * model.output.span
    wanted = np.full(400, rest)
    typed = None if slew is None else slew * model.input.span
    drive = plan(
        model,
        wanted,
        1e-3,
        limits_of(model, max_slew=typed),
        start=start,
        approach="auto",
        on_limit="clip",
    )
    assert drive.voltage[0] == start
    steps = np.abs(np.diff(drive.voltage))
    join = drive.move.start
    assert steps[join - 2 :].max(initial=0.0) <= max(steps.max(), 1e-9)
    # gentle: no step of the way is larger than a soft rise in a tenth of a second makes it
    most = 1.9 / 100 * model.input.span * 4.0
    assert steps.max(initial=0.0) <= most
