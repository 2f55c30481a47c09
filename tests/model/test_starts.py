"""Where gears begin, and gears that go on beyond the range of the drive."""

from dataclasses import replace

import numpy as np
import pytest
from random_actuators import DT, random_drive, undone

from dbo_cli.model import Cascade, Gears, Points, Quantity, Relaxation, Scale, State

WIDTH = 0.125
GEARS = 80  # of the range, 0 to 10 V
SPARE = 10  # beyond either end
STARTS = ("auto", "empty", "full", "settled")


def plain_and_spare(seed):
    """A model of 0 to 10 V, and the same one with gears to spare."""
    rng = np.random.default_rng(seed)
    dy = rng.uniform(0.1, 0.3, GEARS)
    terms = None
    if seed % 2:
        terms = Relaxation(0.0, (5e-3, 0.3), (0.2, -0.05))
    more = np.append(dy, np.full(2 * SPARE, dy[-1]))
    below = SPARE * WIDTH
    y0 = -SPARE * float(dy[-1])
    plain = Gears(np.full(GEARS, WIDTH), dy, 0.0, 0.0, terms)
    spare = Gears(np.full(more.size, WIDTH), more, -below, y0, terms)
    before = ()
    if seed % 3 == 0:
        before = (Points([4.0, 6.0], [5.0, 5.0]),)
    if seed % 3 == 1:
        before = (Scale(-1.0, 10.0),)
    drive = Quantity("voltage", "V", 0.0, 10.0)
    reach = Quantity("displacement", "um", 0.0, plain.height)
    pair = [(*before, gears) for gears in (plain, spare)]
    return tuple(Cascade("forward", drive, reach, stages) for stages in pair)


@pytest.mark.parametrize("start", STARTS)
@pytest.mark.parametrize("seed", range(12))
def test_inside_the_range_spare_gears_play_no_part(seed, start):
    plain, spare = plain_and_spare(seed)
    rng = np.random.default_rng(seed)
    drive = random_drive(rng, 0.0, 10.0, 400)
    y, _ = plain.simulate(drive, dt=DT, state=start)
    same, _ = spare.simulate(drive, dt=DT, state=start)
    np.testing.assert_allclose(same, y, rtol=0, atol=1e-12)
    back, _ = undone(plain, y, DT, start)
    same_back, _ = undone(spare, y, DT, start)
    np.testing.assert_allclose(same_back, back, rtol=0, atol=1e-9)
    voltages = [driven(model, y, start) for model in (plain, spare)]
    np.testing.assert_allclose(voltages[1], voltages[0], rtol=0, atol=1e-9)


def driven(model, wanted, start):
    """The drive within limits, which a slow one clips."""
    state = model.start_drive(float(wanted[0]), start, 0.5, 9.5)
    return model.drive(wanted, state, DT, (0.5, 9.5), 2000.0).y


def halved(model, output):
    """The plain procedure: between which voltages the one lies whose settled state leads to an output."""
    low, high = model.input.min, model.input.max
    margin = 1e-12 * (high - low)
    while high - low > margin:
        middle = low + 0.5 * (high - low)
        bits = model.starts.bits(middle)
        voltage = float(model.gears.undo([output], State(bits)).y[0])
        if low <= voltage <= high and model.starts.bits(voltage) == bits:
            return voltage, voltage
        if voltage > middle:
            low = middle
        else:
            high = middle
    return low, high


@pytest.mark.parametrize("seed", range(2, 40, 3))
def test_a_drive_starts_where_its_own_settled_state_leads(seed):
    for model in plain_and_spare(seed):
        for output in np.linspace(0.02, 0.98, 40) * model.output.span:
            low, high = halved(model, float(output))
            first = model.start_drive(float(output)).first
            if low == high:
                assert first == low
            else:
                assert first == pytest.approx(low, abs=2e-8)


def test_a_settled_start_is_that_of_a_swing_that_has_died_away():
    """Of spare gears, too: the swing goes over the range. Below it they are empty."""
    _, spare = plain_and_spare(2)
    assert spare.start(-1.0) == spare.start(-1.0, "empty")
    swings = np.arange(6000)
    swing = 6.3 + 10.0 * np.exp(-swings / 600) * np.cos(np.pi * swings)
    swung, _ = spare.simulate(np.append(np.clip(swing, 0.0, 10.0), 6.3), state="empty")
    settled, _ = spare.simulate([6.3])
    assert settled[0] == pytest.approx(swung[-1], abs=0.3)  # one gear


def test_a_drive_beyond_the_range_turns_as_inside():
    plain, spare = plain_and_spare(2)
    there_and_back = np.array([0.0, 11.0, 10.5])
    straight, _ = plain.simulate(there_and_back)
    turned, _ = spare.simulate(there_and_back)
    assert straight[1] == pytest.approx(turned[1], abs=1e-12)
    first = float(spare.gears.dy[0])
    assert turned[1] - turned[2] == pytest.approx(4 * first, abs=4 * 0.2)
    assert turned[2] != pytest.approx(straight[2], abs=1e-3)
    assert spare.outside(there_and_back).tolist() == [False, True, True]
    held = spare.run(there_and_back, spare.start(0.0), outside="hold").y
    assert held[1] == held[2] == pytest.approx(spare.simulate([0.0, 10.0])[0][1])


def test_a_range_that_ends_inside_a_gear():
    """The starts stand within a gear of the ends of the range."""
    _, spare = plain_and_spare(2)
    shifted = replace(spare, input=Quantity("voltage", "V", 0.31, 9.27))
    for name, end in (("empty", 0.31), ("full", 9.27)):
        crossed = shifted.start(5.0, name).bits.bit_count()
        begin = shifted.gears.x0 + crossed * WIDTH
        assert begin == pytest.approx(end, abs=WIDTH)
    wanted = shifted.simulate([5.0])[0] + [0.0, 1.0]
    back, _ = undone(shifted, wanted, None)
    np.testing.assert_allclose(shifted.simulate(back)[0], wanted, rtol=0, atol=1e-9)


def test_a_start_ends_where_the_range_is_small_beside_the_gears_origin():
    """Halving 0.1 V at 1000 V comes to neighbours in float64 before it comes to the tolerance."""
    gears = Gears([0.01] * 10, [0.1 + 0.02 * k for k in range(10)], 1000.0, 0.0)
    drive = Quantity("voltage", "V", 1000.0, 1000.1)
    actuator = Cascade("forward", drive, Quantity("x", "um", 0.0, 1.9), (gears,))
    for k in range(40):
        start = actuator.start_drive(0.05 * k, "auto", 1000.0, 1000.1)
        assert 1000.0 <= start.first <= 1000.1
