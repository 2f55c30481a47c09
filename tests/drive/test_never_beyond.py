"""Random models, moves and options: no row of a drive is ever beyond a limit."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dbo_cli.drive import Limits
from dbo_cli.drive.limits import GateError
from dbo_cli.errors import DboError, InputError, LimitError, ModelError, UsageError
from dbo_cli.model import Cascade

from .actuators import actuators, blocks_of, driver_of, in_blocks, plan

pytestmark = pytest.mark.filterwarnings("ignore::dbo_cli.errors.DboWarning")
MANY = int(os.environ.get("DBO_DRIVES", "400"))  # by hand: DBO_DRIVES=100000


@st.composite
def moves(draw: st.DrawFn, model: Cascade) -> np.ndarray:
    """Draw a trajectory: smooth, jumping, beyond what can be reached, short, constant."""
    rows = draw(st.integers(1, 300))
    seed = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    low, span = model.output.min, model.output.span
    kind = draw(st.sampled_from(["sine", "walk", "jumps", "hold", "beyond", "ramp"]))
    t = np.arange(rows) / max(rows, 1)
    if kind == "sine":
        cycles = draw(st.sampled_from([1.0, 2.0, 7.3]))
        return low + span * (
            0.5
            + seed.uniform(0.1, 0.6)
            * np.sin(2 * np.pi * cycles * t + seed.uniform(0, 6))
        )
    if kind == "walk":
        return low + 0.5 * span + np.cumsum(seed.normal(0, 0.05 * span, rows))
    if kind == "jumps":
        return low + span * seed.uniform(-0.2, 1.2, 5)[seed.integers(0, 5, rows)]
    if kind == "beyond":
        return low + span * seed.uniform(-3, 4, rows)
    if kind == "ramp":
        return low + span * (seed.uniform(0, 1) + seed.uniform(-1, 1) * t)
    return np.full(rows, low + span * seed.uniform(0, 1))


@st.composite
def wishes(draw: st.DrawFn) -> tuple[Cascade, np.ndarray, Any, Limits, dict[str, Any]]:
    """Draw a model, a move, a clock, limits and options."""
    model = draw(actuators())
    voltage = model.input
    part = st.floats(-0.5, 1.5)
    low, high = sorted([draw(part), draw(part)])
    typed_low = draw(st.sampled_from([None, voltage.min + low * voltage.span]))
    typed_high = draw(st.sampled_from([None, voltage.min + high * voltage.span]))
    slew = draw(st.sampled_from([None, None, 0.5, 5.0, 100.0]))
    slew = None if slew is None else slew * voltage.span
    extrapolate = draw(st.booleans())
    limits = Limits.within(voltage, typed_low, typed_high, slew, extrapolate)
    desired = draw(moves(model))
    clock: Any = draw(st.sampled_from([1e-3, 1e-2, None]))
    if draw(st.integers(0, 5)) == 0:
        clock = np.cumsum(np.random.default_rng(0).uniform(0.0, 0.01, desired.size))
    stands = voltage.min + draw(st.floats(-0.6, 1.6)) * voltage.span
    options = {
        "on_limit": draw(st.sampled_from(["clip", "clip", "auto", "error"])),
        "start": draw(st.sampled_from([None, stands])),
        "approach": draw(st.sampled_from([None, "auto", 0.05, 3.0])),
        "lead": draw(st.sampled_from([None, "auto", 0.02])),
        "return_to": draw(st.sampled_from([None, voltage.min, stands])),
    }
    kind = draw(
        st.sampled_from(
            ["plain", "condition", "periodic", "empty", "full", "bandwidth"]
        )
    )
    if kind == "condition":
        options["condition"] = True
    if kind in ("empty", "full"):
        options["state"] = kind
    if kind == "bandwidth":
        options["bandwidth"] = 20.0
    if kind == "periodic":
        options |= {
            "periodic": True,
            "passes": draw(st.integers(0, 2)),
            "return_to": None,
        }
        options["lead"] = None
    return model, desired, clock, limits, options


def require_kept(
    voltage: np.ndarray, move: slice, limits: Limits, steps: Any, start: float | None
) -> None:
    """Look at every row, on its own terms: nothing here knows the gate."""
    assert np.isfinite(voltage).all()
    assert voltage.min() >= limits.rating[0] and voltage.max() <= limits.rating[1]
    own = voltage[move]
    assert own.min(initial=np.inf) >= limits.move[0]
    assert own.max(initial=-np.inf) <= limits.move[1]
    if limits.slew is None:
        return
    before = voltage[0] if start is None else start
    change = np.abs(np.diff(voltage, prepend=before))
    slack = 1e-12 * np.maximum(np.abs(voltage), limits.rating[1])
    assert (change <= limits.slew * steps + slack).all()


@settings(
    max_examples=MANY,
    deadline=None,
    derandomize=MANY <= 1000,
    suppress_health_check=[
        HealthCheck.too_slow,
        HealthCheck.filter_too_much,
        HealthCheck.data_too_large,
    ],
)
@given(st.data())
def test_no_row_is_beyond_a_limit(data: st.DataObject) -> None:
    try:
        model, desired, clock, limits, options = data.draw(wishes())
    except (UsageError, ModelError):
        return
    try:
        drive = plan(model, desired, clock, limits, **options)
    except GateError:
        raise  # a fault of the program
    except (LimitError, InputError, UsageError):
        return
    assert drive.voltage.size == drive.desired.size == drive.rows
    assert drive.move.stop - drive.move.start == desired.size
    steps: Any = np.inf
    if limits.slew is not None:
        steps = clock
        if np.ndim(clock):
            usual = (
                np.median(np.diff(clock)[np.diff(clock) > 0])
                if desired.size > 1
                else 0.0
            )
            steps = np.diff(drive.time, prepend=drive.time[0] - usual)
            steps = steps + 1e-12
    require_kept(drive.voltage, drive.move, limits, steps, options["start"])
    if options.get("periodic") and limits.slew is not None:
        period = drive.voltage[drive.move]
        assert abs(period[0] - period[-1]) <= limits.slew * clock * (1 + 1e-9) + 1e-12
    if drive.clipped and options["on_limit"] == "auto":
        assert (
            drive.lost_rms <= 0.01 * max(np.ptp(desired), 1e-300)
            or np.ptp(desired) == 0.0
        )
    assert options["on_limit"] != "error" or drive.clipped == 0


@settings(
    max_examples=150,
    deadline=None,
    derandomize=True,
    suppress_health_check=list(HealthCheck),
)
@given(st.data(), st.integers(1, 100))
def test_a_stream_keeps_limits_row_by_row(data: st.DataObject, rows: int) -> None:
    """What has left before a refusal keeps the limits, too."""
    try:
        model, desired, clock, limits, options = data.draw(wishes())
    except (UsageError, ModelError):
        return
    for name in ("periodic", "passes", "bandwidth"):
        options.pop(name, None)
    if not isinstance(clock, float):
        clock = 1e-3
    sent: list[np.ndarray] = []
    try:
        blocks = blocks_of(desired, clock, rows)
        for part in in_blocks(driver_of(model, limits, options), blocks):
            sent.append(part.y)
    except GateError:
        raise
    except DboError:
        pass
    voltage = np.concatenate([np.empty(0), *sent])
    if voltage.size:
        nothing = slice(0, 0)  # the rows of a lead are among them
        require_kept(voltage, nothing, limits, clock, options["start"])


@pytest.mark.parametrize("start", [1000.0, -20.1, 120.1, np.nan])
def test_a_typing_error_in_start_writes_nothing(start: float) -> None:
    from .actuators import actuator, ripple

    model = actuator()
    limits = Limits.within(model.input, -20, 120, 2000)
    for options in ({}, {"approach": 1.0}, {"approach": "auto"}, {"condition": True}):
        for on_limit in ("auto", "clip", "error"):
            with pytest.raises((LimitError, UsageError)):
                plan(
                    model,
                    ripple(model, 100),
                    1e-3,
                    limits,
                    start=start,
                    on_limit=on_limit,
                    **options,
                )  # type: ignore[arg-type]
    for passes in (0, 1):
        with pytest.raises((LimitError, UsageError)):
            plan(
                model,
                ripple(model, 100),
                1e-3,
                limits,
                start=start,
                approach="auto",
                periodic=True,
                passes=passes,
            )
