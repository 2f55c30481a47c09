"""The operators: round trips, states, blocks, the range, and what is refused."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from trials import random_operator, random_trajectory

from dbo_cli.errors import InputError, ModelError
from dbo_cli.hysteresis import kernel
from dbo_cli.hysteresis.cascade import interpolated
from dbo_cli.hysteresis.operators import (
    BacklashState,
    Counts,
    DiscreteBacklashOperator,
    DiscretePointOperator,
    OutputLimits,
    Relaxation,
    on_binary_grid,
)

FAST = kernel.KIND == "compiled"
FIGURE_2 = DiscreteBacklashOperator([1.0, 2.0, 3.0], [0.5, 2.0, 4.5], 1.0, -1.0)


def test_round_trips_at_every_kind_of_turn() -> None:
    """Inverse after forward and forward after inverse, n = 1 ... 1000: 4,000 operators when compiled."""
    rng = np.random.default_rng(2018)
    worst = 0.0
    for _ in range(4_000 if FAST else 150):
        operator = random_operator(
            rng, round(10.0 ** rng.uniform(0.0, 3.0 if FAST else 2.0))
        )
        inverse = operator.inverse()
        x = random_trajectory(rng, operator, 40)
        start = operator.settled(x[0])
        y, after, _ = operator.run(x, start)
        back, same, _ = inverse.run(y, start)
        again, _, _ = operator.run(back, start)
        assert same == after
        (low, high), (bottom, top) = operator.x_range, operator.y_range
        worst = max(worst, float(np.abs(back - x).max()) / (high - low))
        worst = max(worst, float(np.abs(again - y).max()) / (top - bottom))
    assert worst <= 1e-12


@pytest.mark.parametrize("even", [True, False])
def test_round_trips_with_relaxation(even: bool) -> None:
    rng = np.random.default_rng(7)
    worst = 0.0
    for _ in range(400 if FAST else 60):
        operator = random_operator(
            rng, round(10.0 ** rng.uniform(0.0, 2.0)), relaxation=True
        )
        assert operator.relaxation is not None
        x = random_trajectory(rng, operator, 60)
        decay = operator.relaxation.decay(
            0.01 if even else rng.uniform(0.0, 0.3, x.size)
        )
        start = operator.settled(x[0])
        y, after, _ = operator.run(x, start, decay=decay)
        back, same, _ = operator.inverse().run(y, start, decay=decay)
        low, high = operator.x_range
        worst = max(worst, float(np.abs(back - x).max()) / (high - low))
        assert same.bits == after.bits
    assert worst <= 1e-12


@given(
    st.integers(0, 2**32 - 1),
    st.lists(st.integers(0, 60), min_size=1, max_size=5),
    st.booleans(),
)
@settings(derandomize=True, max_examples=60, deadline=None)
def test_blocks_of_any_size_give_the_same_bits(
    seed: int, cuts: list[int], relaxation: bool
) -> None:
    rng = np.random.default_rng(seed)
    operator = random_operator(rng, int(rng.integers(1, 90)), relaxation)
    x = random_trajectory(rng, operator, 60)
    terms = operator.relaxation
    decay = terms.decay(rng.uniform(0.0, 0.1, 60)) if terms else None
    for one in (operator, operator.inverse()):
        signal = (
            x if one is operator else operator.run(x, operator.empty(), decay=decay)[0]
        )
        whole, end, counts = one.run(signal, operator.empty(), decay=decay)
        state, parts, total = operator.empty(), [], Counts()
        for begin, stop in itertools.pairwise([0, *sorted(cuts), 60]):
            part = None if decay is None else decay[begin:stop]
            y, state, found = one.run(signal[begin:stop], state, decay=part)
            parts.append(y)
            total = total.then(found, begin)
        assert np.concatenate(parts).tobytes() == whole.tobytes()
        assert (state, total) == (end, counts)


@given(st.integers(0, 2**32 - 1))
@settings(derandomize=True, max_examples=40, deadline=None)
def test_rate_independent_and_wiping_out(seed: int) -> None:
    """Only turning points matter, and a larger excursion wipes out the smaller ones before it."""
    rng = np.random.default_rng(seed)
    operator = random_operator(rng, int(rng.integers(1, 40)))
    low, high = operator.x_range
    turns = rng.uniform(low, high, 12)
    turns[4], turns[5] = high, low
    slow = np.concatenate(
        [np.linspace(a, b, 17)[1:] for a, b in itertools.pairwise(turns)]
    )
    fast, one, _ = operator.run(turns, operator.empty())
    fine, other, _ = operator.run(np.concatenate([turns[:1], slow]), operator.empty())
    np.testing.assert_allclose(
        fine[::16], fast, rtol=0.0, atol=1e-11 * (operator.y_range[1] + 1e3)
    )
    assert one == other
    late, end, _ = operator.run(turns[5:], operator.full())
    assert end == one
    assert late.tobytes() == fast[5:].tobytes()


def test_turn_at_full_scale_of_a_sum_that_rounds_up() -> None:
    """The authors' gears add up to 3.6000000000000005 V and the drive peaks at 3.6 V."""
    operator = DiscreteBacklashOperator([0.144] * 25, np.linspace(0.05, 0.2, 25))
    _, state, counts = operator.run([3.6], operator.empty())
    assert (state, counts) == (operator.full(), Counts())


def test_outside_of_the_range() -> None:
    x = [0.0, 8.0, 7.0, 1.0, 0.5]
    extended, state, counts = FIGURE_2.run(x, FIGURE_2.empty())
    assert extended.tolist() == [-2.5, 7.5, 6.0, -1.0, -1.75]
    assert (state, counts) == (FIGURE_2.empty(), Counts(3, 0, 0, 0))
    held, _, counts = FIGURE_2.run(x, FIGURE_2.empty(), outside="hold")
    assert held.tolist() == [-1.0, 6.0, 6.0, -1.0, -1.0]
    assert counts == Counts(3, 0, 0, 0)
    back, _, _ = FIGURE_2.inverse().run(extended, FIGURE_2.empty())
    assert back.tolist() == x


def test_coordinates_are_the_papers_sums() -> None:
    assert FIGURE_2.coordinates(BacklashState(0b101)) == (
        1.0 + 1.0 + 3.0,
        -1.0 + 0.5 + 4.5,
    )
    assert FIGURE_2.x_range == (1.0, 7.0)
    assert FIGURE_2.y_range == (-1.0, 6.0)


def test_inverse_exchanges_axes_and_keeps_the_given_widths() -> None:
    widths = [0.1, 0.2, 0.30000000000000004]
    operator = DiscreteBacklashOperator(
        widths, [1 / 3, 0.1, 0.7], 0.5, 2.0, Relaxation(0.1, (1.0,), (0.2,))
    )
    inverse = operator.inverse()
    assert inverse.dy.tolist() == widths
    assert (inverse.x0, inverse.y0, inverse.memory_on) == (2.0, 0.5, "output")
    assert inverse.x_range == operator.y_range
    assert inverse.y_range == operator.x_range
    np.testing.assert_array_equal(inverse.inverse().gears, operator.gears)
    np.testing.assert_array_equal(inverse.gears[:, 3], operator.gears[:, 3])


def test_widths_lie_on_a_grid_of_exact_sums() -> None:
    rng = np.random.default_rng(3)
    for _ in range(200):
        widths = rng.uniform(
            0.01, 1.0, int(rng.integers(1, 1000))
        ) * 10.0 ** rng.uniform(-6, 6)
        rounded = on_binary_grid("dx", widths)
        assert np.array_equal(on_binary_grid("dx", rounded), rounded)
        assert np.abs(rounded - widths).max() <= 2.0**-53 * widths.sum() * 1.001
        assert np.cumsum(rounded)[-1] == np.cumsum(rounded[::-1])[-1] == np.sum(rounded)


@pytest.mark.parametrize("seed", range(12))
def test_settled_is_the_end_of_a_slowly_decaying_oscillation(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 9))
    operator = DiscreteBacklashOperator(
        rng.uniform(0.1, 1.0, n), rng.uniform(0.1, 1.0, n)
    )
    low, high = operator.x_range
    value = float(rng.uniform(low, high))
    swing = np.linspace(high - low, 0.0, 4000 if FAST else 1500)
    swing[1::2] *= -1.0
    _, slowly, _ = operator.run(
        [*np.clip(value + swing, low, high), value], operator.empty()
    )
    probe = np.concatenate(
        [[value], np.linspace(value, high, 30), np.linspace(high, value, 30)]
    )
    for way in (probe, low + high - probe[::-1]):
        path = np.concatenate([[value], way])
        expected, _, _ = operator.run(path, slowly)
        found, _, _ = operator.run(path, operator.settled(value))
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12)


def test_settled_at_the_ends_and_halfway() -> None:
    even = DiscreteBacklashOperator(np.ones(8), np.ones(8))
    assert even.settled(0.0) == even.settled(-1.0) == even.empty()
    assert even.settled(8.0) == even.settled(9.0) == even.full()
    assert even.settled(0.01).bits == 0
    assert even.settled(7.99).bits == 0b11111111
    assert even.settled(4.0).bits == even.settled(4.0 - 1e-15).bits == 0b10101010
    assert even.inverse().settled(4.0) == even.settled(4.0)


def test_a_tie_of_the_settled_state_is_decided_the_same_whatever_rounding_does() -> (
    None
):
    for x0 in (0.0, 0.1, 0.3, -0.7, 1e3 + 0.1):
        operator = DiscreteBacklashOperator([0.1] * 10, [0.1] * 10, x0)
        low, high = operator.x_range
        halfway = low + 0.5 * (high - low)
        bits = [
            operator.settled(voltage).bits
            for voltage in (
                halfway,
                x0 + 0.5,
                np.nextafter(halfway, 1e4),
                np.nextafter(halfway, -1e4),
            )
        ]
        assert bits == [bits[0]] * 4
        assert bits[0] >> 9 == 1


def test_the_first_sample_outside_is_named_behind_one_at_rest() -> None:
    """With relaxation a sample at rest is a run of its own."""
    terms = Relaxation(0.0, (0.1,), (0.05,))
    operator = DiscreteBacklashOperator([1.0, 2.0], [1.0, 2.0], relaxation=terms)
    x = [1.0, 2.0, 2.5, 4.0, 5.0]
    _, _, counts = operator.run(x, operator.empty(), decay=terms.decay(0.01))
    assert (counts.outside, counts.first_outside) == (2, 3)


@pytest.mark.parametrize("group_size", [1, 4, 7])
def test_engagement_makes_heights_linear_unknowns(group_size: int) -> None:
    rng = np.random.default_rng(12)
    for _ in range(20):
        operator = random_operator(rng, int(rng.integers(1, 130)))
        columns = -(-operator.n // group_size)
        groups = rng.uniform(0.2, 2.0, columns)
        heights = np.repeat(groups / group_size, group_size)[: operator.n]
        operator = DiscreteBacklashOperator(
            operator.dx, heights, operator.x0, operator.y0
        )
        low, high = operator.x_range
        x = random_trajectory(rng, operator, 80)
        x[::9] += 0.3 * (high - low)
        start = operator.settled(x[0])
        y, after, _ = operator.run(x, start)
        rows, state = operator.engagement(x, start, group_size=group_size)
        span = operator.y_range[1] - operator.y_range[0]
        assert rows.shape == (80, columns)
        assert (
            np.abs(rows @ groups + operator.y0 - y).max() <= 1e-12 * span * operator.n
        )
        assert state.bits == after.bits


def test_limits_leave_the_state_of_the_driven_operator() -> None:
    """The inverse with limits, then the forward operator driven by the clipped output: the same state."""
    rng = np.random.default_rng(21)
    for trial in range(300 if FAST else 60):
        operator = random_operator(
            rng, int(rng.integers(1, 60)), relaxation=trial % 2 == 1
        )
        low, high = operator.x_range
        a, b = np.sort(rng.uniform(low - 0.1, high + 0.1, 2))
        terms = operator.relaxation
        decay = terms.decay(rng.uniform(0.0, 0.1, 50)) if terms else None
        wanted = rng.uniform(operator.y_range[0], operator.y_range[1], 50)
        step = (high - low) * 0.1 if trial % 3 else None
        start = operator.settled(wanted[0])
        drive, state, counts = operator.inverse().run(
            wanted, start, decay=decay, limits=OutputLimits(a, b, step), last=None
        )
        assert drive.min() >= a
        assert drive.max() <= b
        if step is not None:
            assert np.abs(np.diff(drive)).max() <= step * (1.0 + 1e-12)
        _, driven, _ = operator.run(drive, start, decay=decay)
        assert driven == state
        assert counts.clipped > 0


def test_limits_count_what_was_clipped() -> None:
    inverse = FIGURE_2.inverse()
    y, state, counts = inverse.run(
        [6.0, -1.0, 6.0], inverse.empty(), limits=OutputLimits(1.0, 6.0)
    )
    assert y.tolist() == [6.0, 1.0, 6.0]
    assert counts == Counts(0, 0, 2, 0)
    assert state.bits == 0b011
    y, _, counts = inverse.run(
        [6.0, 6.0],
        inverse.empty(),
        limits=OutputLimits(1.0, 7.0, step=np.array([9.0, 2.5])),
        last=1.5,
    )
    assert y.tolist() == [7.0, 7.0]
    y, _, counts = inverse.run(
        [6.0, 6.0], inverse.empty(), limits=OutputLimits(1.0, 7.0, 2.5), last=1.5
    )
    assert y.tolist() == [4.0, 6.5]
    assert counts.clipped == 2


def test_relaxation_follows_its_equation() -> None:
    terms = Relaxation(0.5, (0.01, 2.0), (0.3, 0.1))
    operator = DiscreteBacklashOperator([10.0], [20.0], 0.0, 0.0, terms)
    x, steps = np.array([1.0, 3.0, 2.0]), np.array([9.0, 0.01, 0.5])
    held = np.array([0.5, 0.5])
    expected = []
    for value, step in zip(x, steps, strict=True):
        a = np.exp(-step / np.array(terms.tau)) if expected else np.zeros(2)
        held = a * held + (1.0 - a) * (value - 0.5)
        expected.append(2.0 * value + held @ np.array(terms.gain))
    y, state, _ = operator.run(x, operator.empty(), decay=terms.decay(steps))
    np.testing.assert_allclose(y, expected, rtol=1e-15)
    rows, memory = terms.lags(x, steps)
    assert tuple(rows[-1].tolist()) == memory == state.memory
    np.testing.assert_allclose(rows @ np.array(terms.gain) + 2.0 * x, y, rtol=1e-15)
    assert operator.y_range == pytest.approx((-0.2, 20.0 + 0.4 * 9.5), rel=1e-15)


def test_relaxation_needs_time() -> None:
    operator = DiscreteBacklashOperator(
        [1.0], [1.0], 0.0, 0.0, Relaxation(0.0, (1.0,), (0.5,))
    )
    with pytest.raises(
        ModelError,
        match=r"^relaxation needs the time between samples \(`sample_rate`\)$",
    ):
        operator.run([0.1, 0.2], operator.empty())
    assert operator.relaxation is not None
    with pytest.raises(
        InputError, match=r"^time step 2: -0.1 s; time must not go backwards$"
    ):
        operator.relaxation.decay([0.1, -0.1])


def test_repeated_time_steps_have_the_factors_of_single_ones() -> None:
    terms = Relaxation(0.0, (0.01, 1.0, 30.0), (0.1, 0.1, 0.1))
    rng = np.random.default_rng(3)
    uneven = rng.uniform(0.0, 0.1, 50)
    # few different steps, and one that comes late
    decimals = np.diff(np.arange(400) / 1000.0)
    paused = np.append(decimals, 0.5)
    for steps in (
        uneven,
        np.repeat(uneven, 9),
        np.full(40, 0.002),
        [0.5, *[0.002] * 40],
        decimals,
        paused,
    ):
        steps = np.array(steps)
        expected = np.concatenate([terms.decay(float(step)) for step in steps])
        found = terms.decay(steps)
        assert len(found) == (1 if steps.size == 40 else steps.size)
        assert np.broadcast_to(found, expected.shape).tobytes() == expected.tobytes()
    assert terms.decay([]).shape == (0, 3)


def test_times_on_even_and_uneven_clocks_are_found_as_by_a_search() -> None:
    for seed in range(400):
        rng = np.random.default_rng(seed)
        count = int(rng.integers(1, 60))
        even = np.round(np.arange(count) / 500.0, 9) + float(rng.integers(0, 5))
        clock = (even, np.cumsum(rng.choice([0.0, 0.002, 0.004], count)))[seed % 2]
        wanted = clock - rng.choice([0.0, 0.002, 0.0033, 1.0])
        if seed % 3 == 0:
            wanted = np.sort(rng.uniform(clock[0] - 0.1, clock[-1] + 0.1, 30))
        expected = [
            max(sum(time <= each for time in clock.tolist()) - 1, 0)
            for each in wanted.tolist()
        ]
        y, last = interpolated(clock, np.arange(float(count)), wanted)
        assert last == expected[-1]
        assert np.all((y >= expected) & (y <= np.add(expected, 1.0)))
        # a zero has a sign to keep
        values = rng.normal(size=count) * rng.integers(0, 2, count)
        both = [np.empty(wanted.size), np.empty(wanted.size)]
        for own, found in zip((kernel.PythonKernel, kernel.CHOSEN), both, strict=True):
            assert own.interpolated(clock, values, wanted, found, 1e-9) == last
        assert both[0].tobytes() == both[1].tobytes()


REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"dx": [], "dy": []}, "dx: is empty; at least one width is needed"),
    (
        {"dx": [1.0, 0.0], "dy": [1.0, 1.0]},
        "dx[1]: 0.0 is not a finite width greater than 0",
    ),
    (
        {"dx": [1.0], "dy": [float("nan")]},
        "dy[0]: nan is not a finite width greater than 0",
    ),
    ({"dx": [1.0], "dy": [-1.0]}, "dy[0]: -1.0 is not a finite width greater than 0"),
    ({"dx": [1.0, 1.0], "dy": [1.0]}, "dy: has 1 entries where dx has 2"),
    ({"dx": [1.0], "dy": [1.0], "x0": float("inf")}, "x0: inf is not a finite number"),
    (
        {"dx": [1.0, 1e-14], "dy": [1.0, 1.0]},
        "dx[1]: 1e-14 is less than 2^-42 of the sum of all widths, 1.00000000000001",
    ),
    (
        {"dx": [1e300], "dy": [1.0]},
        "dx: the widths add up to 1e+300, beyond the range of the arithmetic",
    ),
]


@pytest.mark.parametrize(("arguments", "message"), REFUSED)
def test_what_is_refused(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ModelError) as problem:
        DiscreteBacklashOperator(**arguments)
    assert str(problem.value) == message


def test_state_of_another_operator_is_refused() -> None:
    with pytest.raises(
        ModelError, match=r"^state: has bits beyond the 3 gears of this operator$"
    ):
        FIGURE_2.run([1.0], BacklashState(8))
    with pytest.raises(
        ModelError, match=r"^state: remembers 1 relaxation terms, this model has 0$"
    ):
        FIGURE_2.run([1.0], BacklashState(0, (1.0,)))


def test_narrow_gears_and_far_origins_still_round_trip() -> None:
    """Where rounding is coarser than 1e-9 of a gear, the tolerance grows, on both axes alike."""
    rng = np.random.default_rng(31)
    for trial in range(200):
        dx = 10.0 ** rng.uniform(-9.0, 0.0, 20)
        dy = dx * rng.uniform(0.5, 2.0, 20)
        operator = DiscreteBacklashOperator(
            dx, dy, 1e5 if trial % 2 else 0.0, -3e5 if trial % 3 else 0.0
        )
        x = random_trajectory(rng, operator, 60)
        y, after, _ = operator.run(x, operator.empty())
        back, same, _ = operator.inverse().run(y, operator.empty())
        assert same == after
        assert np.abs(back - x).max() <= 1e-9


def test_point_operator() -> None:
    operator = DiscretePointOperator([1.0, 2.0], [3.0, 1.0], 10.0, 20.0)
    assert operator.run([9.0, 10.0, 10.5, 11.0, 12.0, 13.0, 15.0]).tolist() == [
        17.0, 20.0, 21.5, 23.0, 23.5, 24.0, 25.0,
    ]  # fmt: skip
    assert (operator.x_range, operator.y_range) == ((10.0, 13.0), (20.0, 24.0))
    x = np.linspace(5.0, 20.0, 301)
    np.testing.assert_allclose(operator.inverse().run(operator.run(x)), x, rtol=1e-14)
    rng = np.random.default_rng(1)
    shuffled = rng.permutation(x)  # memory-free to the last bit
    assert (
        operator.run(shuffled).tobytes()
        == operator.run(x)[np.searchsorted(x, shuffled)].tobytes()
    )
