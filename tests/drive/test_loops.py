import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dbo_cli.drive.limits import GateError
from dbo_cli.drive.loops import Loop
from dbo_cli.errors import InputError, LimitError, UsageError

from .actuators import actuator, actuators, limits_of, plan, ripple

pytestmark = pytest.mark.filterwarnings("ignore::dbo_cli.errors.DboWarning")
DT = 1e-3


def passes_of(model, drive, lead, passes, start="auto"):
    """Return what a model makes of a lead and so many passes of the period, a row a pass."""
    period = drive[lead:]
    voltage = np.concatenate([drive[:lead], np.tile(period, passes)])
    y = model.run(voltage, model.start(float(voltage[0]), start), DT).y
    return np.asarray(y[lead:]).reshape(passes, period.size)


@given(actuators(static=True), st.floats(0.0, 1.0), st.sampled_from([0, 1, 2]))
@settings(max_examples=40, deadline=None, derandomize=True)
def test_a_loop_is_a_fixed_point_of_the_pass(model, phase, passes):
    wanted = ripple(model, 250, 0.6, 1.0, phase)
    try:
        drive = plan(model, wanted, DT, limits_of(model), periodic=True, passes=passes)
    except LimitError as refused:  # few gears: no start leads to the loop
        assert "does not settle" in str(refused) and model.gears.n <= 7
        return
    lead = drive.move.start
    assert drive.move.stop - lead == 250
    assert drive.clipped == 0
    forever = passes_of(model, drive.voltage, lead, 80)
    error = np.abs(forever - wanted).max(axis=1)
    slow = max(model.gears.relaxation.tau) if model.gears.relaxation else 0.0
    if slow <= 1.0:
        assert error[-1] < 1e-6 * np.ptp(wanted)
    assert error[-1] <= error[0] * (1 + 1e-9) + 1e-9


def test_what_is_no_loop():
    model = actuator()
    limits = limits_of(model)
    wanted = ripple(model, 200, 0.5, 1.0)
    for rows, clock, words in ((120, DT, "open"), (200, None, None)):
        with pytest.raises(InputError, match=words):
            plan(model, wanted[:rows], clock, limits, periodic=True)
    with pytest.raises(UsageError, match="whole number"):
        plan(model, wanted, DT, limits, periodic=True, passes=1.5)
    drive = plan(model, wanted, DT, limits, periodic=True, passes=np.int64(2))
    assert drive.rows == 600


def test_the_gate_looks_at_the_seam(monkeypatch):
    """Whatever makes the loop: a saw tooth keeps the slew limit but for its seam."""
    model = actuator()
    tooth = np.linspace(20.0, 60.0, 200)
    monkeypatch.setattr(Loop, "_closed", lambda loop, voltage: tooth)
    wanted = ripple(model, 200, 0.1, 1.0)
    with pytest.raises(GateError, match="60 to 20 V"):
        plan(model, wanted, DT, limits_of(model, max_slew=300.0), periodic=True)


def test_a_run_in_that_grows_onto_a_limit_stays_inside_to_the_last_digit():
    """In a long period it has risen before its last row, and begin + (end - begin) may be above the end."""
    model = actuator(low=-20.0, high=80.0)
    begin, top = -8.9, 55.3
    assert begin + (top - begin) > top
    limits = limits_of(model, v_max=top)
    phase = 2 * np.pi * np.arange(600_000) / 600_000
    wanted = 5.0 + 5.0 * np.cos(phase)
    options = {"periodic": True, "passes": 1, "start": begin, "on_limit": "clip"}
    drive = plan(model, wanted, DT, limits, **options)
    assert drive.clipped > 0
    assert drive.voltage.max() == top
