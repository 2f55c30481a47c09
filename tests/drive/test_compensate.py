import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dbo_cli.drive import Driver, Lead
from dbo_cli.errors import InputError, LimitError, UsageError
from dbo_cli.model import Resonance

from . import actuators as rig
from .actuators import limits_of

pytestmark = pytest.mark.filterwarnings("ignore::dbo_cli.errors.DboWarning")
RATE = 1000.0
DT = 1.0 / RATE


def played(model, voltage, dt=DT, state="auto"):
    """Return what a model makes of a whole drive."""
    if isinstance(state, str):
        state = model.start(float(voltage[0]), state)
    return np.asarray(model.run(voltage, state, dt).y)


@given(rig.actuators(), st.sampled_from([1, 7, 60, 333]), st.booleans())
@settings(max_examples=40, deadline=None, derandomize=True)
def test_values_do_not_depend_on_blocks(model, rows, slow):
    wanted = rig.gentle(model, 300, 0.5)
    slew = 3.0 * model.input.span if slow else None
    limits = limits_of(model, max_slew=slew)
    whole = rig.plan(model, wanted, DT, limits, on_limit="clip")
    driver = Driver(Lead(model, limits), on_limit="clip")
    drive = rig.driven_in_blocks(driver, rig.blocks_of(wanted, DT, rows))
    assert np.abs(drive.voltage - whole.voltage).max() <= 1e-12 * model.input.span
    assert drive.clipped == whole.clipped
    assert drive.first_clipped == whole.first_clipped
    assert drive.lost_rms == pytest.approx(whole.lost_rms, rel=1e-9, abs=1e-15)


@pytest.mark.parametrize("rows", [2, 37, 150])
def test_rows_around_a_move_do_not_depend_on_blocks(rows):
    """Nor does their step: of an uneven clock it is the first one, which every block tells."""
    model = rig.actuator(tau=(0.5,), gain=(0.02,))
    wanted, limits = rig.gentle(model, 300, 0.5), limits_of(model, max_slew=3000.0)
    time = np.cumsum(np.random.default_rng(3).uniform(0.5, 1.5, 300) * DT)
    around = {"start": 20.0, "approach": "auto"}
    whole = rig.plan(model, wanted, time, limits, return_to=5.0, **around)
    steps = np.diff(time, prepend=time[0])
    blocks = []
    for k in range(0, 300, rows):
        part = slice(k, k + rows)
        blocks.append((time[part], steps[part], wanted[part]))
    driver = Driver(Lead(model, limits, **around), return_to=5.0)
    drive = rig.driven_in_blocks(driver, blocks)
    np.testing.assert_allclose(drive.voltage, whole.voltage, rtol=0, atol=1e-9)
    np.testing.assert_allclose(drive.time, whole.time, rtol=0, atol=1e-12)


def test_a_pause_lets_memory_go_on():
    model = rig.actuator(tau=(0.5,), gain=(0.02,))
    wanted = rig.ripple(model, 500, 0.4)
    first = rig.plan(model, wanted, np.arange(500) * DT, limits_of(model))
    hold = np.full(2000, first.voltage[-1])
    y = played(model, np.concatenate([first.voltage, hold]))
    time = 2.5 + np.arange(500) * DT
    later = rig.plan(model, wanted, time, limits_of(model), state=first.state)
    back = played(model, np.concatenate([first.voltage, hold, later.voltage]))
    assert np.abs(back[2500:] - wanted).max() < 1e-9
    assert abs(y[-1] - wanted[-1]) > 1e-3  # it crept meanwhile


def off_at_first(drive):
    """Return how far off a drive says that it starts."""
    texts = [text for text in drive.warnings if "row 1 starts" in text]
    return float(texts[0].split("row 1 starts ")[1].split()[0]) if texts else 0.0


@pytest.mark.parametrize("more", [{}, {"delay": 0.004}])
def test_a_move_that_starts_in_motion_is_said_to_ring(more):
    model = rig.actuator(sections=(Resonance(60.0, 0.02),), **more)
    wanted, limits = rig.ripple(model, 300, 0.5), limits_of(model)
    drive = rig.plan(model, wanted, DT, limits, on_limit="clip")
    assert off_at_first(drive) > 0.1 * model.output.span
    for rested in (rig.plan(model, wanted, DT, limits, on_limit="clip", lead="auto"),
                   rig.plan(model, rig.gentle(model, 300), DT, limits)):  # fmt: skip
        assert off_at_first(rested) < 0.01 * model.output.span


@pytest.mark.parametrize("rows", [4.0, 4.3])
def test_a_delay_begins_with_what_was_before_and_that_is_said(rows):
    """The first rows show the past: on a move in motion they miss what no later voltage mends."""
    model = rig.actuator(delay=rows * DT)
    wanted, limits = rig.ripple(model, 300, 0.5), limits_of(model)
    drive = rig.plan(model, wanted, DT, limits)
    off = np.abs(played(model, drive.voltage) - wanted)
    assert off[:5].max() > 20.0 * off[10:].max()
    assert off_at_first(drive) == pytest.approx(off[0], rel=0.05)
    rested = rig.plan(model, wanted, DT, limits, lead="auto")
    assert off_at_first(rested) < 0.05 * off[0]


@pytest.mark.parametrize(
    ("top", "begins"), [(None, False), (50.0, False), (None, True)]
)
def test_a_first_row_off_its_value_is_said_where_no_limit_moved_it(top, begins):
    """Two gears stand settled at a few voltages only; a limit is told of as one."""
    model = rig.actuator(gears=2 if begins else 200)
    wanted = np.linspace(6.2, 6.0, 50)
    limits = limits_of(model, 0, top)
    drive = rig.plan(model, wanted, DT, limits, on_limit="clip")
    assert (drive.clipped > 0) is (top is not None)
    assert any("row 1 starts" in text for text in drive.warnings) is begins


# --- limits ---


LATE = rig.actuator(delay=0.1)
UNEVEN = np.cumsum([0.0, 1e-3, 5e-3, 1e-3, 1e-3])


@pytest.mark.parametrize(
    ("error", "words", "wanted", "clock", "options"),
    [
        (InputError, "unit", np.full(10, 1e4), DT, {}),
        (InputError, "row 3: time goes back", np.arange(4.0), [0.0, 0.2, 0.1, 0.3], {}),
        (InputError, None, [], DT, {}),
        (InputError, "sample_rate", [1.0, 2.0], None, {"slew": 1}),
        (InputError, "sample_rate", [1.0, 2.0], None, {"condition": True}),
        (UsageError, None, [1.0, 2.0], DT, {"on_limit": "maybe"}),
        (LimitError, "delay", rig.ripple(LATE, 20, 0.1), DT, {"model": LATE}),
        (InputError, "resample", rig.ripple(LATE, 5, 0.1), UNEVEN, {"model": LATE}),
    ],
)
def test_what_cannot_be_driven(error, words, wanted, clock, options):
    options = {"model": rig.actuator(), "slew": None, **options}
    limits = limits_of(options["model"], max_slew=options.pop("slew"))
    with pytest.raises(error, match=words):
        rig.plan(desired=wanted, clock=clock, limits=limits, **options)


@pytest.mark.parametrize("value", [1e308, -1e61, math.inf, math.nan])
def test_a_row_that_is_no_displacement_is_named(value):
    model = rig.actuator()
    wanted = rig.ripple(model, 100, 0.5)
    wanted[41] = value
    for options in ({}, {"bandwidth": 50.0}, {"periodic": True}):
        with pytest.raises(InputError, match="row 42"):
            rig.plan(model, wanted, DT, limits_of(model), **options)
    driver = Driver(Lead(model, limits_of(model)))
    with pytest.raises(InputError, match="row 42"):
        rig.driven_in_blocks(driver, rig.blocks_of(wanted, DT, 30))
