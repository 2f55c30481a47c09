import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dbo_cli.drive.lead import Lead
from dbo_cli.drive.limits import Limits
from dbo_cli.errors import InputError, LimitError, UsageError
from dbo_cli.model import Quantity

from .actuators import actuator, actuators, limits_of, plan, ripple

pytestmark = pytest.mark.filterwarnings("ignore::dbo_cli.errors.DboWarning")
DT = 2e-4


@pytest.mark.parametrize("rows", [200, 40_000])
def test_at_most_a_minute_is_chosen_and_a_refusal_names_the_seconds(rows):
    """However long the move is; the named seconds are then typed, and drive."""
    model = actuator(tau=(0.1, 2.0), gain=(0.01, 0.02))
    wanted = ripple(model, rows, 0.3)
    for more in ({"condition": True}, {"condition": True, "start": 70.0}):
        options = {**more, "on_limit": "clip"}
        limits = limits_of(model, max_slew=1.0)
        with pytest.raises(LimitError, match="`approach`") as refused:
            plan(model, wanted, 0.01, limits, **options)
        seconds = float(str(refused.value).split("`approach` ")[1].split(" ")[0])
        drive = plan(model, wanted, 0.01, limits, approach=seconds, **options)
        assert 300.0 < drive.lead_seconds <= seconds + 1.0
        quick = limits_of(model, max_slew=10.0)
        assert plan(model, wanted, 0.01, quick, **options).lead_seconds <= 60.0


def test_typed_seconds_are_the_whole_way_of_a_sweep():
    model = actuator(tau=(0.1, 2.0), gain=(0.01, 0.02))
    wanted = ripple(model, 300, 0.3)
    for start, seconds in ((None, 4.0), (60.0, 200.0), (0.0, 5.0)):
        limits = limits_of(model, max_slew=120.0)
        options = {"start": start, "approach": seconds}
        options |= {"condition": True, "on_limit": "clip"}
        drive = plan(model, wanted, 0.01, limits, **options)
        assert drive.lead_seconds == pytest.approx(seconds, abs=0.05)
        lead = drive.voltage[: drive.move.start]
        assert (lead.min(), lead.max()) == (0.0, 100.0)
    with pytest.raises(LimitError, match="whole way") as refused:
        limits = limits_of(model, max_slew=40.0)
        plan(model, wanted, 0.01, limits, condition=True, approach=2.0)
    fits = float(str(refused.value).split("at least ")[1].split(" ")[0])
    plan(model, wanted, 0.01, limits, condition=True, approach=fits, on_limit="clip")


def test_numbers_of_any_type_and_a_start_that_contradicts():
    model = actuator()
    limits = limits_of(model)
    for number in (np.float32(0.5), np.int64(1), 1):
        plain = Lead(model, limits, "auto", 0.0, float(number), rest=float(number))
        typed = Lead(model, limits, "auto", 0.0, number, rest=number)
        assert typed == plain
    state = plan(model, [1.0, 2.0, 3.0], DT, limits).state
    with pytest.raises(UsageError, match="contradicts"):
        plan(model, [1.0, 2.0, 3.0], DT, limits, start=77.0, state=state)


@given(
    actuators(),
    st.floats(0.0, 1.0),
    st.floats(0.0, 1.0),
    st.sampled_from([None, 1.0, 20.0]),
)
@settings(max_examples=60, deadline=None, derandomize=True)
def test_the_way_joins_the_move(model, stands, begins, slew):
    """Where the move is at rest, the way ends without a step larger than those within."""
    start = model.input.min + stands * model.input.span
    rest = model.output.min + (0.1 + 0.8 * begins) * model.output.span
    wanted = np.full(400, rest)
    typed = None if slew is None else slew * model.input.span
    limits = limits_of(model, max_slew=typed)
    options = {"start": start, "approach": "auto", "on_limit": "clip"}
    drive = plan(model, wanted, 1e-3, limits, **options)
    assert drive.voltage[0] == start
    steps = np.abs(np.diff(drive.voltage))
    join = drive.move.start
    assert steps[join - 2 :].max(initial=0.0) <= max(steps.max(), 1e-9)
    # gentle: no step of the way is larger than a soft rise in a tenth of a second makes it
    most = 1.9 / 100 * model.input.span * 4.0
    assert steps.max(initial=0.0) <= most


# --- limits ---


def test_units_of_limits():
    kilo = Quantity("voltage", "kV", 0.0, 1.0)
    assert Limits.within(kilo, v_max="800V").rating[1] == pytest.approx(0.8)
    with pytest.raises(UsageError, match="800kV"):
        Limits.within(kilo, v_max=800)
    with pytest.raises(UsageError, match="kV/s"):
        Limits.within(kilo, max_slew=2)
    bar = Quantity("pressure", "bar", 0.0, 6.0)
    assert Limits.within(bar, 0, 5, 2).slew == 2.0


def test_gate_needs_a_clock_for_slew():
    limits = Limits.within(Quantity("voltage", "V", 0.0, 4.0), max_slew=1)
    with pytest.raises(InputError):
        limits.broken(np.array([1.0]), None, None, "move")
