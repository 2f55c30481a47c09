"""Live control: the values of ``compensate``; ``test_never_beyond`` looks at calls in any order."""

import numpy as np
import pytest

from dbo_cli.drive import Limits
from dbo_cli.drive.live import Controller
from dbo_cli.errors import UsageError
from dbo_cli.model import Lag, Resonance

from .actuators import actuator, plan, ripple

RATE = 1000.0
pytestmark = pytest.mark.filterwarnings("ignore::dbo_cli.errors.DboWarning")


def stepped(live, wanted):
    return np.array([live.step(x) for x in wanted])


def test_a_state_without_a_voltage_takes_the_typed_one():
    model, wanted = actuator(), np.full(20, 5.0)
    limits = Limits.within(model.input, None, None, 1e4)
    begun = model.start(40.0, "empty")
    options = {"state": begun, "start": 20.0, "on_limit": "clip"}
    whole = plan(model, wanted, 1 / RATE, limits, **options)
    live = Controller(model, RATE, limits, state=begun, from_=20.0)
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
    limits = Limits.within(model.input)
    live = Controller(model, RATE, limits, lookahead="auto")
    sent = stepped(live, wanted)
    drive = plan(model, wanted, 1 / RATE, limits, lead="auto", on_limit="clip")
    led = drive.voltage
    shared = min(len(sent), len(led))
    np.testing.assert_allclose(sent[:shared], led[:shared], rtol=0, atol=1e-7)
    later = Controller(model, RATE, limits, lookahead=(live.lookahead + 3) / RATE)
    found = stepped(later, wanted)[4:]
    np.testing.assert_allclose(found, sent[1:-3], rtol=0, atol=1e-9)
    for short in (None, 0.0, (live.lookahead - 1) / RATE):
        if live.lookahead:
            with pytest.raises(UsageError):
                Controller(model, RATE, limits, lookahead=short)


def test_a_limit_is_kept_to_the_last_digit_behind_points():
    """What comes back through the points is off by a last digit, on either side of the limit."""
    model = actuator(bend=(1.0, 1.3))
    for high in np.linspace(40.0, 60.0, 200):
        limits = Limits.within(model.input, 0.5 * float(high), float(high))
        live = Controller(model, RATE, limits)
        for wanted in (5.0, 20.0, -20.0):
            assert limits.move[0] <= live.step(wanted) <= limits.move[1]
