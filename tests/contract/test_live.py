"""Live control: a sample at a time, the numbers of ``compensate``, and never beyond a limit."""

import math

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis import stateful

import dbo_cli as dbo

from .program import model, rms

RATE = 1000.0
TIME = np.arange(400) / RATE
pytestmark = pytest.mark.filterwarnings("ignore::dbo_cli.errors.DboWarning")


def actuator(name):
    return dbo.read_model(model(name))


def wish(name):
    """Return a move inside the range, from its lower end."""
    out = actuator(name).output
    middle, span = 0.45 * (out.min + out.max), out.max - out.min
    return middle - 0.35 * span * np.cos(2.0 * np.pi * 5.0 * TIME)


def followed(live, wanted):
    volts = []
    for value in wanted:
        volts.append(live.plan(float(value)))
        live.commit()
    return np.array(volts)


@pytest.mark.parametrize("name", ["small", "creep", "bent", "soft"])
def test_plan_and_commit_give_the_drive_of_compensate(name):
    found = followed(actuator(name).controller(sample_rate=RATE), wish(name))
    expected = actuator(name).compensate(wish(name), sample_rate=RATE)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10)


def test_what_was_applied_instead_counts():
    """The amplifier gives 1 % less: the model follows what it gave."""
    live = actuator("creep").controller(sample_rate=RATE)
    applied = []
    for value in wish("creep"):
        applied.append(0.99 * live.plan(float(value)))
        live.commit(applied[-1])
    creep, options = actuator("creep"), {"sample_rate": RATE, "state": "empty"}
    came = creep.simulate(np.array(applied), **options)
    assert rms(came - wish("creep")) < 0.1
    played = np.array([*applied, live.plan(3.0)])
    assert creep.simulate(played, **options)[-1] == pytest.approx(3.0, abs=0.05)


def test_looking_ahead_undoes_a_delay():
    late = actuator("late")
    live = late.controller(sample_rate=RATE, lookahead="auto")
    wanted = wish("late")
    found = followed(live, wanted)
    came = late.simulate(found, sample_rate=RATE, state="empty")
    ahead = live.lookahead
    assert ahead > 0
    assert rms(came[ahead:][50:] - wanted[:-ahead][50:]) < 0.1


def test_what_cannot_be_is_refused():
    with pytest.raises(dbo.DboError, match="lookahead"):
        actuator("moving").controller(sample_rate=RATE)
    with pytest.raises(dbo.DboError):  # a commit needs a plan
        actuator("small").controller(sample_rate=RATE).commit()
    settings = [{"v_min": 5, "v_max": 5}, {"max_slew": -1.0}, {"v_max": "8um"}]
    for options in settings:
        with pytest.raises(dbo.DboError):
            actuator("small").controller(sample_rate=RATE, **options)


# --- a machine that does what a laboratory does ---

SETTINGS = st.fixed_dictionaries(
    {
        "name": st.sampled_from(["small", "creep", "bent", "soft"]),
        "margin": st.sampled_from([0.0, 0.1]),
        "slew": st.sampled_from([None, 0.3, 0.02, 0.001]),
    }
)
PART = st.one_of(st.sampled_from([-0.5, 0.0, 0.5, 1.0, 1.5, 1e9]), st.floats(0.0, 1.0))
APPLIED = st.one_of(st.sampled_from([-0.15, 0.0, 1.0, 1.12]), st.floats(0.0, 1.0))


class Laboratory(stateful.RuleBasedStateMachine):
    """Plans, plans again, refused plans, commits, and voltages that were applied instead."""

    live = None

    @stateful.initialize(setting=SETTINGS)
    def begin(self, setting):
        """Make a controller within limits, and one that hears of commits alone."""
        self.model = actuator(setting["name"])
        span = self.model.input.max - self.model.input.min
        self.low = self.model.input.min + setting["margin"] * span
        self.high = self.model.input.max - setting["margin"] * span
        self.slew = None if setting["slew"] is None else setting["slew"] * span * RATE
        self.live, self.twin = self.made(), self.made()
        self.last = None
        self.planned = None
        self.wanted = 0.0

    def made(self):
        return self.model.controller(
            sample_rate=RATE, v_min=self.low, v_max=self.high, max_slew=self.slew
        )

    @stateful.rule(part=PART)
    def plan(self, part):
        out = self.model.output
        self.wanted = out.min + part * (out.max - out.min)
        self.planned = self.live.plan(self.wanted)
        assert self.planned == self.live.plan(self.wanted)

    @stateful.rule(bad=st.sampled_from([math.nan, math.inf, -math.inf, "5", None, 1j]))
    def refused(self, bad):
        """A wish or a voltage that is no number is refused, and changes nothing."""
        error = (dbo.DboError, TypeError, ValueError)
        if self.planned is not None and bad is not None:
            with pytest.raises(error):
                self.live.commit(bad)
        with pytest.raises(error):
            self.live.plan(bad)
        if self.planned is not None:
            assert self.live.plan(self.wanted) == self.planned

    @stateful.precondition(lambda self: self.planned is not None)
    @stateful.rule()
    def commit(self):
        self.both(None)

    @stateful.precondition(lambda self: self.planned is not None)
    @stateful.rule(part=APPLIED)
    def applied(self, part):
        span = self.model.input.max - self.model.input.min
        self.both(self.model.input.min + part * span)

    def both(self, applied):
        """Commit, here and in the twin that never planned in vain."""
        assert self.twin.plan(self.wanted) == self.planned
        for live in (self.live, self.twin):
            if applied is None:
                live.commit()
            else:
                live.commit(applied)
        self.last = self.planned if applied is None else applied
        self.planned = None

    @stateful.invariant()
    def within_limits(self):
        """Inside the range; from a voltage outside it, inwards at the slew's pace at most."""
        if self.live is None or self.planned is None:
            return
        volts = self.planned
        assert math.isfinite(volts)
        step = math.inf if self.slew is None else self.slew / RATE
        near = 1e-9 * (self.high - self.low)
        if self.last is None:
            assert self.low <= volts <= self.high
        elif self.low <= self.last <= self.high:
            assert self.low <= volts <= self.high
            assert abs(volts - self.last) <= step + near
        else:
            bound = self.low if self.last < self.low else self.high
            inside = self.low - near <= volts <= self.high + near
            assert inside or abs(volts - bound) <= abs(self.last - bound) + near


Laboratory.TestCase.settings = settings(max_examples=60, stateful_step_count=40)
TestLaboratory = Laboratory.TestCase
