"""Live control: the values of ``compensate``; ``test_never_beyond`` looks at calls in any order."""

import numpy as np
import pytest

from dbo_cli.drive import Limits
from dbo_cli.drive.live import Controller
from dbo_cli.errors import ModelError, UsageError
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
