"""The dynamics stage: exact for any clock, its inverse exact and two-sided, both kernels bit for bit."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from scipy.signal import lsim, lti
from trials import Floats

from dbo_cli.errors import InputError, ModelError, UsageError
from dbo_cli.hysteresis import kernel
from dbo_cli.hysteresis.dynamics import (
    Antiresonance,
    DynamicsStage,
    Lag,
    Resonance,
    ZeroPhaseLowPass,
    latency_text,
    undone,
)

RATE = 20_000.0
STEP = 1.0 / RATE
NOTCHED = Resonance(800.0, 0.02, Antiresonance(1_100.0, 0.01))


@pytest.fixture(params=["compiled", "python"])
def either_kernel(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> Iterator[str]:
    compiled = kernel.compiled_kernel()
    if request.param == "compiled" and compiled is None:
        pytest.skip("the compiled kernel was not built")
    monkeypatch.setattr(
        kernel,
        "CHOSEN",
        compiled if request.param == "compiled" else kernel.PythonKernel,
    )
    yield request.param


def stage(*sections: Any) -> DynamicsStage:
    return DynamicsStage(tuple(sections))


def polynomials(section: Resonance) -> tuple[list[float], list[float]]:
    """Return numerator and denominator in s."""
    w = 2.0 * np.pi * section.frequency
    below = [1.0 / w**2, 2.0 * section.damping / w, 1.0]
    if section.antiresonance is None:
        return [1.0], below
    wz = 2.0 * np.pi * section.antiresonance.frequency
    return [1.0 / wz**2, 2.0 * section.antiresonance.damping / wz, 1.0], below


def smooth_move(count: int, seed: int, quiet: int = 150) -> Floats:
    """Return a move between rests, with corners."""
    rng = np.random.default_rng(seed)
    turns = rng.uniform(0.0, 10.0, 9)
    return np.interp(np.arange(count), np.linspace(quiet, count - quiet, 9), turns)


@pytest.mark.parametrize(
    "section", [Resonance(800.0, 0.02), Resonance(90.0, 0.7), NOTCHED]
)
def test_a_section_is_exact_for_a_straight_input(
    section: Resonance, either_kernel: str
) -> None:
    time = np.arange(1_500) * STEP
    x = np.interp(time, [0.0, 0.01, 0.03, 0.05, 0.08], [1.0, 1.0, 4.0, -2.0, 0.0])
    expected = lsim(lti(*polynomials(section)), x - 1.0, time)[1] + 1.0
    got, _ = stage(section).run(x, STEP, None)
    assert np.abs(got - expected).max() < 1e-11


@pytest.mark.parametrize("section", [Resonance(800.0, 0.02), NOTCHED])
def test_any_clock_gives_the_same_samples(
    section: Resonance, either_kernel: str
) -> None:
    time = np.arange(600) * STEP
    knots = time[::50]
    x = np.interp(time, knots, np.random.default_rng(3).normal(size=knots.size))
    whole, _ = stage(section).run(x, STEP, None)
    chosen = np.union1d(
        np.arange(0, 600, 50), np.random.default_rng(4).integers(0, 600, 200)
    )
    steps = np.diff(time[chosen], prepend=time[chosen[0]])
    few, _ = stage(section).run(x[chosen], steps, None)
    assert np.abs(few - whole[chosen]).max() < 1e-11


def test_a_lag_is_late_by_its_time_at_any_rate(either_kernel: str) -> None:
    for step in (1e-5, 1e-4, 1e-3):
        ramp = np.concatenate([np.zeros(3), np.arange(6_000.0) * step])
        y, _ = stage(Lag(2e-3)).run(ramp, step, None)
        assert ramp[-1] - y[-1] == pytest.approx(2e-3, rel=1e-9)


def test_a_rest_stays_a_rest_to_the_last_bit(either_kernel: str) -> None:
    still = np.full(200, 0.1 + 0.2)
    every = stage(Lag(1e-3), NOTCHED, Resonance(300.0, 0.9))
    assert np.array_equal(every.run(still, STEP, None)[0], still)
    ((_, u, _),) = undone([(None, still)], every.inverter(STEP))
    assert np.array_equal(u, still)


SECTIONS = [
    (Resonance(800.0, 0.002),),
    (Resonance(3_300.0, 0.02),),
    (Lag(2e-4), Resonance(50.0, 0.9)),
    (Resonance(500.0, 0.02), Resonance(1_400.0, 0.01), Lag(1e-4)),
    (NOTCHED, Resonance(2_000.0, 0.05)),
    (Lag(1e-5),),
    (Lag(8.0, 7.92), Lag(0.05, 0.049), Resonance(500.0, 0.02)),
]


@pytest.mark.parametrize("sections", SECTIONS)
def test_inverse_and_forward_compose_to_the_identity(
    sections: Any, either_kernel: str
) -> None:
    one, y = stage(*sections), smooth_move(900, 5)
    ((_, u, _),) = undone([(None, y)], one.inverter(STEP))
    back, _ = one.run(u, STEP, None)
    assert np.abs(back - y).max() < 1e-9
    ((_, again, _),) = undone([(None, back)], one.inverter(STEP))
    assert np.abs(again - u)[200:-200].max() < 1e-6 * np.abs(u).max()


@pytest.mark.parametrize("sections", SECTIONS)
def test_blocks_and_kernels_give_the_same_bits(sections: Any) -> None:
    compiled = kernel.compiled_kernel()
    if compiled is None:
        pytest.skip("the compiled kernel was not built")
    one, y, rng = stage(*sections), smooth_move(700, 6), np.random.default_rng(7)
    steps = rng.uniform(0.2, 3.0, y.size) * STEP
    found = []
    for chosen in (compiled, kernel.PythonKernel):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(kernel, "CHOSEN", chosen)
            for cuts in ([], np.sort(rng.integers(0, y.size, 9)), np.arange(y.size)):
                parts, at = np.split(y, cuts), np.split(steps, cuts)
                state, uneven = None, []
                for part, step in zip(parts, at, strict=True):
                    out, state = one.run(part, step, state)
                    uneven.append(out)
                u = np.concatenate(
                    [
                        u
                        for _, u, _ in undone(
                            ((None, p) for p in parts), one.inverter(STEP)
                        )
                    ]
                )
                found.append((np.concatenate(uneven).tobytes(), u.tobytes(), state))
    assert all(one_found == found[0] for one_found in found)


def test_the_inverse_goes_on_from_the_memory_or_from_the_forward_state() -> None:
    one, y = stage(Resonance(500.0, 0.02), NOTCHED, Lag(1e-4)), smooth_move(900, 8)
    inverter = one.inverter(STEP)
    ((_, u, _),) = undone([(None, y)], inverter)
    first, memory = inverter.run(y[: 400 + inverter.ahead], inverter.rest(y[0]))
    assert np.array_equal(first, u[:400])
    ((_, rest, _),) = undone([(None, y[400:])], inverter, memory)
    assert np.array_equal(rest, u[400:])
    _, state = one.run(first, STEP, None)
    assert state is not None
    ((_, rest, _),) = undone([(None, y[400:])], inverter, inverter.memory_of(state))
    assert np.abs(rest - u[400:]).max() < 1e-7 * np.abs(u).max()


@pytest.mark.parametrize(
    ("section", "rate", "named"),
    [
        (
            Resonance(800.0, 0.02),
            1_000.0,
            "resonance at 800 Hz is above half the sampling rate of 1000 Hz",
        ),
        (
            Resonance(800.0, 0.02),
            2_000.0,
            "its inverse is not to be had there (`resample` 4800 or more)",
        ),
        (
            NOTCHED,
            1_200.0,
            "resonance at 800 Hz with its antiresonance at 1100 Hz is above half",
        ),
    ],
)
def test_a_clock_that_does_not_resolve_a_section_is_refused(
    section: Resonance, rate: float, named: str
) -> None:
    with pytest.raises(InputError) as refused:
        stage(section).inverter(1.0 / rate)
    assert named in str(refused.value)


def test_what_is_no_section_is_refused() -> None:
    for make, text in (
        (
            lambda: Resonance(-1.0, 0.1),
            "frequency: -1.0 is not a finite number greater than 0",
        ),
        (
            lambda: Resonance(1.0, 1.0),
            "damping: 1.0 is not a finite number between 0 and 1",
        ),
        (lambda: Lag(0.0), "lag: 0.0 is not a finite number greater than 0"),
        (lambda: stage(), "sections: is empty; leave the stage out instead"),
    ):
        with pytest.raises(ModelError) as refused:
            make()
        assert str(refused.value) == text
    with pytest.raises(
        InputError, match=r"time step 2: -1.0 s; time must not go backwards"
    ):
        stage(Lag(1.0)).run(np.zeros(2), np.array([0.0, -1.0]), None)


def test_the_response_is_that_of_the_polynomials() -> None:
    at = np.array([1.0, 100.0, 800.0, 1_100.0, 4_000.0])
    above, below = polynomials(NOTCHED)
    s = 2j * np.pi * at
    expected = np.polyval(above, s) / np.polyval(below, s) / (1.0 + 1e-3 * s)
    assert stage(NOTCHED, Lag(1e-3)).response(at) == pytest.approx(expected, rel=1e-12)


def test_the_low_pass_is_zero_phase_keeps_constants_and_halves_at_its_cutoff(
    either_kernel: str,
) -> None:
    low_pass = ZeroPhaseLowPass(200.0, STEP)
    still = np.full(50, 0.1 + 0.2)
    assert np.array_equal(low_pass.whole(still), still)
    time = np.arange(4_000) * STEP
    for frequency in (20.0, 200.0, 400.0):
        wave = np.cos(2.0 * np.pi * frequency * time)
        middle = slice(1_500, 2_500)
        gain = 1.0 / (1.0 + (frequency / 200.0) ** 4)
        assert low_pass.whole(wave)[middle] == pytest.approx(
            gain * wave[middle], abs=2e-3 * gain
        )
    step = low_pass.whole(np.repeat([0.0, 1.0], 2_000))
    assert 1.0 < step.max() < 1.034
    cut = np.random.default_rng(1).normal(size=700)
    parts = np.split(cut, [1, 2, 90, 500])
    joined = np.concatenate(
        [part for _, part in low_pass.blocks((None, p) for p in parts)]
    )
    assert np.array_equal(joined, low_pass.whole(cut))
    assert np.array_equal(
        low_pass.loop(cut), low_pass.whole(np.tile(cut, 5))[1_400:2_100]
    )


def test_a_low_pass_that_the_rate_does_not_allow_is_refused() -> None:
    with pytest.raises(
        UsageError, match=r"`bandwidth` 600: above half the sampling rate of 1000 Hz"
    ):
        ZeroPhaseLowPass(600.0, 1e-3)
    with pytest.raises(
        UsageError, match=r"`bandwidth` 0.01: too low .* `resample` at a lower rate"
    ):
        ZeroPhaseLowPass(0.01, 1e-3)


def test_a_single_time_step_has_the_bits_of_many() -> None:
    rng = np.random.default_rng(8)
    for turn, damping in zip(
        rng.uniform(1e-6, 1.0, 300), 10.0 ** rng.uniform(-4.0, -0.01, 300), strict=True
    ):
        section = Resonance(turn * RATE / (2.0 * np.pi), damping)
        (one,), two = (
            section.step(np.array([STEP])),
            section.step(np.array([STEP, STEP])),
        )
        assert one.tobytes() == two[0].tobytes() == two[1].tobytes()


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.003623, "3.62 ms"),
        (0.9994, "999 ms"),
        (1.0, "1 s"),
        (8.851, "8.85 s"),
        (-2.5, "-2.5 s"),
        (0.0, "0 ms"),
    ],
)
def test_a_lag_of_seconds_is_said_in_seconds(seconds: float, text: str) -> None:
    """A lag of 8.85 s was printed as 8.85e+03 ms."""
    assert latency_text(seconds) == text
