"""Excitation, and reading ahead."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest
from test_hysteresis_model import build, wanted

from dbo_cli.errors import UsageError
from dbo_cli.hysteresis.cascade import read_ahead
from dbo_cli.hysteresis.excitation import Excitation, swing_samples, swings
from dbo_cli.hysteresis.model import DriveLimits
from dbo_cli.interpolation.smooth import interpolated


def test_swings_turn_exactly_where_they_say() -> None:
    drive = swings([0.0, 3.6, 1.2], [10, 5])
    assert drive.size == 16
    assert (drive[0], drive[10], drive[15]) == (0.0, 3.6, 1.2)
    assert np.all(np.diff(drive[:11]) > 0.0)
    assert np.all(np.diff(drive[10:]) < 0.0)


def test_swing_samples_keep_the_slew() -> None:
    count = swing_samples(5.0, 0.001, 0.01, max_slew=100.0)
    drive = swings([0.0, 5.0], [count])
    assert 0.99 * 100.0 < np.diff(drive).max() / 0.001 <= 100.0
    assert swing_samples(5.0, 0.001, 0.01) == 10


def excited(**change: Any) -> Any:
    arguments = {
        "v_min": -30.0,
        "v_max": 120.0,
        "sample_rate": 1000.0,
        "duration": 15.0,
        "frequency": 1.0,
    }
    return Excitation(**{**arguments, **change}).drive()


def turns_of(drive: Any) -> Any:
    moving = drive[np.concatenate([[True], np.diff(drive) != 0.0])]
    step = np.diff(moving)
    return moving[1:-1][step[:-1] * step[1:] < 0.0]


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(
    ("rate", "duration", "frequency"),
    [
        (1000.0, 15.0, 1.0),
        (20.0, 6.0, 1.0),
        (77.7, 61.3, 0.3),
        (5000.0, 2.4, 2.5),
        (200.0, 600.0, 1.0),
    ],
)
def test_excitation_stays_within_range_slew_and_duration(
    rate: float, duration: float, frequency: float, seed: int
) -> None:
    span = 150.0
    for slew in (
        None,
        np.pi * frequency * span * (1.0 + 1e-12),
        2.0 * np.pi * frequency * span,
    ):
        time, drive = excited(
            sample_rate=rate,
            duration=duration,
            frequency=frequency,
            max_slew=slew,
            seed=seed,
        )
        assert time.size == drive.size == round(duration * rate)
        assert np.array_equal(time, np.arange(time.size) / rate)
        assert (drive.min(), drive.max(), drive[0], drive[-1]) == (
            -30.0,
            120.0,
            -30.0,
            -30.0,
        )
        if slew is not None:
            assert np.abs(np.diff(drive)).max() * rate <= slew * (1.0 + 1e-9)


def test_excitation_begins_with_sweeps_and_ends_at_rest() -> None:
    _, drive = excited()
    assert (drive[500], drive[1000]) == (120.0, -30.0)
    assert np.all(np.diff(drive[:501]) > 0.0)
    assert np.all(np.diff(drive[500:1001]) < 0.0)
    assert np.all(drive[-500:] == -30.0)


def test_excitation_turns_everywhere_at_many_speeds_and_holds() -> None:
    levels, speeds, held = [], [], 0.0
    for seed in range(10):
        _, drive = excited(seed=seed)
        levels += ((turns_of(drive)[2:] + 30.0) / 150.0).tolist()
        speeds.append(np.abs(np.diff(drive)).max() * 1000.0 / 150.0)
        held += np.mean(np.diff(drive[1000:-501]) == 0.0) / 10
    assert len(levels) > 250
    counts = np.histogram(levels, bins=8, range=(0.0, 1.0))[0]
    assert counts.min() > 0.05 * len(levels)
    assert np.mean(np.isin(levels, (0.0, 1.0))) > 0.05
    assert max(speeds) > 2.5 * np.pi
    assert 0.05 < held < 0.4


def test_excitation_is_chosen_by_its_seed() -> None:
    first, again, other = excited(seed=3)[1], excited(seed=3)[1], excited(seed=4)[1]
    assert first.tobytes() == again.tobytes() != other.tobytes()
    assert excited()[1].tobytes() == excited(seed=1)[1].tobytes()
    # the choices themselves are part of the contract: a seed noted today gives the same
    # drive tomorrow
    assert np.round(turns_of(excited(seed=1)[1])[:6], 6).tolist() == TURNS_OF_SEED_1


TURNS_OF_SEED_1 = [120.0, -30.0, 97.115061, 37.42366, 120.0, -29.684092]

REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"v_min": 3.0, "v_max": 3.0}, "`v_min` 3V must be below `v_max` 3V"),
    ({"v_min": float("nan")}, "`v_min` nanV must be below `v_max` 3.6V"),
    (
        {"v_min": -1e308, "v_max": 1e308},
        "`v_min` -1e+308V and `v_max` 1e+308V: give limits within 1e+60V",
    ),
    (
        {"v_min": 0.0, "v_max": 1e-320, "unit": "bar"},
        "`v_min` 0bar and `v_max` 9.99989e-321bar: give limits at least 1e-60bar apart",
    ),
    (
        {"sample_rate": 19.0},
        "`frequency` 1: fewer than 20 samples a cycle (raise `sample_rate` to 20, or lower it)",
    ),
    (
        {"duration": 5.9},
        "`duration` 5.9: 5.9 cycles of 1 Hz, at least 6 are needed (a `duration` of 6)",
    ),
    (
        {"max_slew": 1.0},
        "`max_slew` 1V/s: the whole range at 1 Hz needs 11.3097 V/s"
        " (`frequency` 0.0884 and a `duration` of at least 68)",
    ),
    (
        {"duration": 1e7},
        "`duration` 1e+07 at `sample_rate` 200: 2e+09 rows are more than the 100,000,000 that are written at"
        " most",
    ),
    ({"frequency": 0.0}, "`frequency` 0: give a number above 0"),
    ({"duration": float("inf")}, "`duration` inf: give a number above 0"),
    ({"sample_rate": float("nan")}, "`sample_rate` nan: give a number above 0"),
    ({"max_slew": -1.0}, "`max_slew` -1: give a number above 0"),
    ({"seed": -1}, "`seed` -1: give a whole number of at least 0"),
]


@pytest.mark.parametrize(("change", "message"), REFUSED)
def test_excitation_that_is_refused(change: dict[str, Any], message: str) -> None:
    arguments = {
        "v_min": 0.0,
        "v_max": 3.6,
        "sample_rate": 200.0,
        "duration": 10.0,
        "frequency": 1.0,
    }
    with pytest.raises(UsageError) as problem:
        Excitation(**{**arguments, **change}).drive()
    assert str(problem.value) == message


def test_excitation_with_the_values_of_the_remedy_is_made() -> None:
    _, drive = Excitation(0.0, 3.6, 200.0, 68.0, 0.0884, 1.0).drive()
    assert np.abs(np.diff(drive)).max() * 200.0 <= 1.0


def test_reading_ahead_does_not_depend_on_blocks() -> None:
    rng = np.random.default_rng(0)
    time = np.cumsum(rng.uniform(1e-4, 0.02, 600))
    values = rng.normal(size=600)
    for seconds, between in product((0.0, 0.003, 0.1, 100.0), ("linear", "smooth")):
        expected = np.interp(time + seconds, time, values)
        if between == "smooth":
            expected, _ = interpolated(time, values, time + seconds)
        whole = None
        for size in (600, 1, 7, 64):
            blocks = [
                (k, time[k : k + size], values[k : k + size])
                for k in range(0, 600, size)
            ]
            shifted = list(read_ahead(blocks, seconds, between))
            assert [payload for payload, _ in shifted] == [
                payload for payload, _, _ in blocks
            ]
            found = np.concatenate([part for _, part in shifted])
            np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12)
            assert whole is None or found.tobytes() == whole
            whole = found.tobytes()


def test_reading_ahead_keeps_only_what_it_needs() -> None:
    given = 0

    def blocks() -> Any:
        nonlocal given
        for k in range(100):
            given = k
            yield k, np.arange(10.0) + 10.0 * k, np.arange(10.0)

    for payload, _ in read_ahead(blocks(), 25.0):
        assert given <= min(payload + 3, 99)
    for payload, _ in read_ahead(blocks(), 25.0, "linear"):
        assert given <= min(payload + 3, 99)


def test_delay_read_ahead_and_lagged_again_is_the_identity() -> None:
    model = build(2, delay=0.02)
    assert model.delay_seconds == 0.02
    desired = wanted(model, 2)
    time = 0.005 * np.arange(desired.size)
    ahead = np.concatenate(
        [part for _, part in read_ahead([(None, time, desired)], model.delay_seconds)]
    )
    limits = DriveLimits(model.input.minimum, model.input.maximum)
    drive = model.compensate(
        ahead, model.start_compensation(ahead[0], "auto", limits), limits=limits
    )
    back = model.simulate(drive.y, model.start(drive.y[0]), time_step=0.005)
    assert np.abs(back.y - desired)[5:].max() <= 1e-12 * model.output.span
