"""Live control: the values of ``compensate``, nothing beyond a limit, nothing half done."""

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from dbo_cli.drive import Limits
from dbo_cli.drive.live import Controller
from dbo_cli.errors import InputError, ModelError, UsageError
from dbo_cli.model import Lag, Resonance

from .actuators import actuator, plan, ripple

RATE = 1000.0
pytestmark = pytest.mark.filterwarnings("ignore::dbo_cli.errors.DboWarning")


def stepped(live: Controller, wanted: np.ndarray) -> np.ndarray:
    return np.array([live.step(x) for x in wanted])


@pytest.mark.parametrize(
    "parts",
    [
        {},
        {"tau": (0.01, 1.0), "gain": (0.01, 0.02)},
        {"tau": (0.05,), "gain": (-0.01,)},
        {"bend": (1.0, 1.5), "curve": (2.0, 1.0), "scale": -0.5},
    ],
)
def test_live_is_compensate(parts):
    model = actuator(**parts)
    wanted = ripple(model, 400)
    limits = {"v_min": 5.0, "v_max": 80.0, "max_slew": 900.0}
    live = Controller(model, RATE, **limits)
    whole = plan(
        model, wanted, 1 / RATE, Limits.within(model.input, **limits), on_limit="clip"
    )
    sent = stepped(live, wanted)
    np.testing.assert_allclose(sent, whole.voltage, rtol=0, atol=1e-9)
    assert live.clipped == whole.clipped > 0
    assert np.abs(np.diff(sent)).max() <= 0.9 * (1 + 1e-12)


def test_a_state_without_a_voltage_takes_the_typed_one():
    model, wanted = actuator(), np.full(20, 5.0)
    limits = Limits.within(model.input, None, None, 1e4)
    begun = model.start(40.0, "empty")
    whole = plan(
        model, wanted, 1 / RATE, limits, state=begun, start=20.0, on_limit="clip"
    )
    live = Controller(model, RATE, max_slew=1e4, state=begun, from_=20.0)
    assert abs(whole.voltage[0] - 20.0) <= 10.0 + 1e-12
    np.testing.assert_allclose(stepped(live, wanted), whole.voltage, atol=1e-9)


@pytest.mark.parametrize(
    "parts",
    [
        {"delay": 0.0035},
        {"sections": (Resonance(80.0, 0.05),)},
        {"sections": (Lag(0.004),), "delay": 0.002},
    ],
)
def test_lookahead_undoes_what_needs_the_future(parts):
    model = actuator(**parts)
    wanted = ripple(model, 600)
    live = Controller(model, RATE, lookahead="auto")
    sent = stepped(live, wanted)
    led = plan(
        model,
        wanted,
        1 / RATE,
        Limits.within(model.input),
        lead="auto",
        on_limit="clip",
    ).voltage
    shared = min(len(sent), len(led))
    np.testing.assert_allclose(sent[:shared], led[:shared], rtol=0, atol=1e-7)
    later = Controller(model, RATE, lookahead=(live.lookahead + 3) / RATE)
    np.testing.assert_allclose(
        stepped(later, wanted)[4:], sent[1:-3], rtol=0, atol=1e-9
    )
    with pytest.raises(ModelError):
        Controller(model, RATE)
    with pytest.raises(UsageError):
        Controller(model, RATE, lookahead=0.0)


def test_an_applied_voltage_outside_walks_inwards():
    live = Controller(actuator(), RATE, v_min=0, v_max=80, max_slew=1000)
    live.plan(3.0)
    live.commit(82.5)
    inwards = [live.step(3.0) for _ in range(4)]
    np.testing.assert_allclose(inwards, [81.5, 80.5, 80.0, 79.0], rtol=0, atol=1e-12)


class LiveMachine(RuleBasedStateMachine):
    """Any order of plans, commits and read-backs: a planned voltage is inside, slow, or on the way in."""

    @initialize(slew=st.sampled_from([None, 300.0, 20000.0]), parts=st.integers(0, 3))
    def begin(self, slew, parts):
        kinds = [
            {},
            {"tau": (0.03,), "gain": (0.02,)},
            {"bend": (1.0, 2.0)},
            {"delay": 0.0021},
        ]
        self.model = actuator(**kinds[parts])
        look = "auto" if parts == 3 else None
        self.live = Controller(
            self.model, RATE, v_min=10, v_max=90, max_slew=slew, lookahead=look
        )
        self.slew, self.planned = slew, False

    @rule(wanted=st.floats(-20.0, 30.0))
    def plan(self, wanted):
        voltage = self.live.plan(wanted)
        self.planned = True
        last = self.live.last
        if last is None:
            assert 10 <= voltage <= 90
            return
        if self.slew is not None:
            assert abs(voltage - last) <= self.slew / RATE * (1 + 1e-9) + 1e-12
        assert (
            10 <= voltage <= 90
            or (last > 90 and 90 <= voltage < last)
            or (last < 10 and last < voltage <= 10)
        )

    @rule()
    def commit(self):
        if self.planned:
            self.live.commit()
        self.planned = False

    @rule(applied=st.one_of(st.floats(-50.0, 150.0), st.just(math.nan)))
    def read_back(self, applied):
        before = self.live.last
        if not self.planned:
            with pytest.raises(UsageError):
                self.live.commit(applied)
        elif math.isnan(applied):
            with pytest.raises(InputError):
                self.live.commit(applied)
            assert self.live.last == before
        else:
            self.live.commit(applied)
            assert self.live.last == applied
            self.planned = False

    @invariant()
    def a_refusal_leaves_nothing(self):
        if hasattr(self, "live") and not self.planned:
            with pytest.raises(UsageError):
                self.live.commit()


TestLiveMachine = LiveMachine.TestCase
TestLiveMachine.settings = settings(
    max_examples=30,
    stateful_step_count=40,
    derandomize=True,
    deadline=None,
    suppress_health_check=list(HealthCheck),
)
