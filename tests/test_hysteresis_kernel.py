"""Both kernels: equal to each other bit for bit, and to the paper's procedure in exact rationals."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import sysconfig
from fractions import Fraction
from importlib.machinery import ExtensionFileLoader, ModuleSpec
from importlib.util import module_from_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import reference
from compiling import COMPILERS, WARNINGS, compile_c
from gear_by_gear import gear_by_gear
from trials import Floats, random_operator, random_trajectory

import dbo_cli.hysteresis
from dbo_cli.errors import DboError, UsageError
from dbo_cli.hysteresis import kernel
from dbo_cli.hysteresis.model_state import start_drive
from dbo_cli.hysteresis.operators import (
    BacklashState,
    Counts,
    DiscreteBacklashOperator,
    DiscretePointOperator,
    OutputLimits,
)
from dbo_cli.hysteresis.stepper import BacklashStepper

SOURCE = Path(dbo_cli.hysteresis.__file__).parent
COMPILED = kernel.compiled_kernel()
needs_compiled = pytest.mark.skipif(
    COMPILED is None, reason="the compiled kernel was not built"
)
KINDS = [
    pytest.param(COMPILED, id="compiled", marks=needs_compiled),
    pytest.param(kernel.PythonKernel, id="python"),
]


@pytest.fixture(params=KINDS)
def chosen(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Each kernel in turn."""
    monkeypatch.setattr(kernel, "CHOSEN", request.param)
    return request.param


def bits_of(values: Any) -> bytes:
    return np.asarray(values, dtype=np.float64).tobytes()


def everything(
    seed: int,
    monkeypatch: pytest.MonkeyPatch,
    chosen: Any,
    relaxation: bool,
    run: int = 1,
) -> list[Any]:
    """One random case through every path of a kernel, as comparable values."""
    monkeypatch.setattr(kernel, "CHOSEN", chosen)
    rng = np.random.default_rng(seed)
    n = round(10.0 ** rng.uniform(0.0, 2.4))
    operator = random_operator(rng, n, relaxation, run)
    inverse = operator.inverse()
    low, high = operator.x_range
    x = random_trajectory(rng, operator, 48)
    # some of it outside
    x[7::11] += (high - low) * rng.uniform(-0.5, 0.5, x[7::11].size)
    terms = operator.relaxation
    decay = None
    if terms is not None:
        decay = terms.decay(
            float(rng.uniform(0.0, 0.1)) if seed % 4 == 1 else rng.uniform(0.0, 0.1, 48)
        )
    start = operator.settled(x[0])
    step = (high - low) * (0.3 if seed % 3 else rng.uniform(0.0, 0.5, 48))
    limits = OutputLimits(
        low + 0.1 * (high - low), high - 0.2 * (high - low), step, 1e-9
    )
    found: list[Any] = []
    for outside in ("extend", "hold"):
        y, state, counts = operator.run(x, start, decay=decay, outside=outside)  # type: ignore[arg-type]
        found += [bits_of(y), state, counts]
        z, state, counts = inverse.run(y, start, decay=decay, outside=outside)  # type: ignore[arg-type]
        found += [bits_of(z), state, counts]
        z, state, counts = inverse.run(
            y, start, decay=decay, outside=outside, limits=limits
        )  # type: ignore[arg-type]
        found += [bits_of(z), state, counts]
        for group_size in (1, 3):
            rows, state = operator.engagement(
                x, start, group_size=group_size, outside=outside
            )  # type: ignore[arg-type]
            found += [bits_of(rows), state]
    if terms is not None:
        rows, memory = terms.lags(x, 0.01)
        found += [bits_of(rows), memory]
    return found


@needs_compiled
@pytest.mark.parametrize("relaxation", [False, True])
def test_kernels_agree_bit_for_bit(
    relaxation: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    for seed in range(60):
        compiled = everything(seed, monkeypatch, COMPILED, relaxation)
        assert compiled == everything(
            seed, monkeypatch, kernel.PythonKernel, relaxation
        ), seed


@needs_compiled
@pytest.mark.parametrize("relaxation", [False, True])
def test_many_equal_gears_at_once_are_crossed_as_one_by_one(
    relaxation: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows of the table that serve 4 ... 300 gears: jumps over whole rows and into them, limits in them."""
    for seed in range(40):
        run = (4, 5, 18, 70, 300)[seed % 5]
        compiled = everything(seed, monkeypatch, COMPILED, relaxation, run)
        assert compiled == everything(
            seed, monkeypatch, kernel.PythonKernel, relaxation, run
        ), seed


class Grouped:
    """A kernel that is given one row a run of equal gears, and no guide, as small chips are."""

    def __init__(self, inner: Any, run: int) -> None:
        self.inner, self.run = inner, run
        self.point_run, self.memory_run = inner.point_run, inner.memory_run

    def grouped(self, gears: Floats, n: int) -> tuple[Any, ...]:
        table = np.vstack([gears[: -1 : self.run], gears[-1]])
        return table, np.empty(0, np.uint32), n, self.run

    def backlash_run(
        self, gears: Floats, _guide: Any, n: int, _run: int, *rest: Any
    ) -> Any:
        return self.inner.backlash_run(*self.grouped(gears, n), *rest)

    def backlash_decay(
        self, gears: Floats, _guide: Any, n: int, _run: int, *rest: Any
    ) -> Any:
        return self.inner.backlash_decay(*self.grouped(gears, n), *rest)

    def backlash_engagement(
        self, gears: Floats, _guide: Any, n: int, _run: int, *rest: Any
    ) -> Any:
        return self.inner.backlash_engagement(*self.grouped(gears, n), *rest)


@needs_compiled
@pytest.mark.parametrize("relaxation", [False, True])
def test_grouped_tables_give_the_same_bits(
    relaxation: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One row a run of equal gears, in both kernels, against one row a gear."""
    for seed in range(10):
        run = (4, 5, 18, 70, 300)[seed % 5]
        expanded = everything(seed, monkeypatch, COMPILED, relaxation, run)
        for inner in (COMPILED, kernel.PythonKernel):
            assert expanded == everything(
                seed, monkeypatch, Grouped(inner, run), relaxation, run
            ), seed


@pytest.mark.parametrize("relaxation", [False, True])
def test_runs_are_crossed_as_gears_are_one_by_one(
    relaxation: bool, chosen: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Against the procedure that looks nothing up: outputs, states and counts."""
    slow = gear_by_gear()
    for seed in range(60):
        run = (1, 1, 4, 18)[seed % 4]
        expected = everything(seed, monkeypatch, slow, relaxation, run)
        assert everything(seed, monkeypatch, chosen, relaxation, run) == expected, seed


@pytest.fixture(scope="module")
def firmware(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The extension with the kernel as small chips have it."""
    if COMPILED is None or not COMPILERS:
        pytest.skip("no C compiler, or the compiled kernel was not built")
    if not (SOURCE / "_kernel.c").exists():
        pytest.skip("the sources of the extension are not installed, as from a wheel")
    folder = tmp_path_factory.mktemp("firmware")
    library = folder / "_kernel.so"
    compile_c(
        folder, "-std=c99", "-O1", "-ffp-contract=off", "-shared", "-fPIC", "-DDBO_SMALL",
        f"-I{sysconfig.get_path('include')}",
        *map(str, sorted((*SOURCE.glob("_[bk]*.c"), *SOURCE.glob("dbo_*.c")))),
        "-o", str(library), compiler=COMPILERS[0],
    )  # fmt: skip
    loader = ExtensionFileLoader("_kernel", str(library))
    module = module_from_spec(ModuleSpec("_kernel", loader, origin=str(library)))
    loader.exec_module(module)
    return module


@pytest.mark.parametrize("relaxation", [False, True])
def test_the_kernel_of_small_chips_gives_the_same_bits(
    relaxation: bool, firmware: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    for seed in range(60):
        run = (1, 4, 5, 18, 70, 300)[seed % 6]
        expected = everything(seed, monkeypatch, COMPILED, relaxation, run)
        assert expected == everything(
            seed, monkeypatch, Grouped(firmware, run), relaxation, run
        ), seed


@pytest.mark.parametrize("n", [64, 65, 128, 1000, 1280])
def test_small_chips_jump_as_others(
    n: int, firmware: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert jumps(n, firmware, monkeypatch) == jumps(n, gear_by_gear(), monkeypatch)


@needs_compiled
@pytest.mark.parametrize("n", [64, 65, 128, 1000, 1280])
def test_jumps_from_any_state_cross_runs_as_gears(
    n: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = jumps(n, gear_by_gear(), monkeypatch)
    assert jumps(n, COMPILED, monkeypatch) == expected
    assert jumps(n, kernel.PythonKernel, monkeypatch) == expected


def jumps(n: int, chosen: Any, monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Ones and zeros are mixed at first; full jumps, into words, back, and with limits on the way."""
    monkeypatch.setattr(kernel, "CHOSEN", chosen)
    found = []
    for seed in range(8):
        rng = np.random.default_rng([n, seed])
        operator = random_operator(rng, n, seed % 2 == 1, (1, 1, 16, 70)[seed // 2])
        bits = int.from_bytes(rng.bytes(n // 8), "little")
        terms = operator.relaxation
        start = BacklashState(bits, None if terms is None else (0.5,) * len(terms.tau))
        decay = None if terms is None else terms.decay(rng.uniform(0.0, 0.1, 24))
        x, y = random_trajectory(rng, operator, 24), rng.uniform(*operator.y_range, 24)
        span = operator.x_range[1] - operator.x_range[0]
        limits = OutputLimits(
            operator.x_range[0] + 0.2 * span, operator.x_range[1], 0.4 * span
        )
        forward = operator.run(x, start, decay=decay)
        inverse = operator.inverse().run(y, start, decay=decay, limits=limits)
        found.append(
            [(bits_of(out), state, counts) for out, state, counts in (forward, inverse)]
        )
    return found


def test_a_gear_far_off_is_crossed_by_the_tolerance(chosen: Any) -> None:
    operator = DiscreteBacklashOperator(np.ones(128), np.ones(128))
    for short, bits in ((0.5e-9, (1 << 64) - 1), (2e-9, (1 << 63) - 1)):
        y, state, _ = operator.run([64.0 - short], operator.empty())
        assert (y.tolist(), state.bits) == ([64.0 - short], bits)
        y, state, _ = operator.run([64.0 + short], operator.full())
        assert (y.tolist(), state.bits) == ([64.0 + short], (1 << 128) - 1 - bits)


def test_equal_neighbours() -> None:
    # the last run goes on: spare gears
    slopes = np.repeat([1.0, 2.0, 3.0], [18, 18, 25])
    assert DiscreteBacklashOperator(np.full(61, 0.1), 0.1 * slopes).equal_run == 18
    assert DiscreteBacklashOperator([1.0, 2.0], [1.0, 1.0]).equal_run == 1
    assert DiscreteBacklashOperator(np.ones(7), np.ones(7)).equal_run == 7


@pytest.mark.parametrize("count", [1, 2, 3, 18, 63, 64, 65, 1000, 65535])
def test_a_row_is_found_without_a_division(count: int) -> None:
    """DBO_ROW_FACTOR, in 64-bit integers, for every gear up to 2^32 / count that can go wrong."""
    factor = (2**32 + count - 1) // count
    rows = 2**32 // count // count  # n * run < 2^32
    for row in {0, rows // 3, rows // 2, rows - 1}:
        for gear in (row * count, row * count + count - 1):
            assert gear * factor >> 32 == row


def test_the_range_wins_over_the_slew_limit(chosen: Any) -> None:
    """The output before lies outside the range: it comes back in one step, whatever the slew limit says."""
    operator = DiscreteBacklashOperator([1.0, 2.0, 3.0], [0.5, 2.0, 4.5]).inverse()
    for last, wanted, expected in (
        (9.0, 6.0, 5.0),
        (9.0, 0.5, 5.0),
        (-4.0, 0.2, 1.0),
        (-4.0, 6.0, 1.0),
    ):
        limits = OutputLimits(1.0, 5.0, 0.25)
        y, state, counts = operator.run(
            [wanted], operator.empty(), limits=limits, last=last
        )
        assert y.tolist() == [expected]
        driven = operator.inverse().run(y, operator.empty())[1]
        assert (state, counts.clipped) == (driven, 1)
    y, _, _ = operator.run(
        [6.0, 6.0], operator.empty(), limits=OutputLimits(1.0, 5.0, 0.25), last=4.9
    )
    assert y.tolist() == [5.0, 5.0]


@needs_compiled
def test_point_kernels_agree_bit_for_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(5)
    for m in (1, 2, 3, 17, 200):
        operator = DiscretePointOperator(
            rng.uniform(0.1, 1.0, m), rng.uniform(0.1, 1.0, m), 0.3, -7.0
        )
        low, high = operator.x_range
        x = rng.uniform(low - 1.0, high + 1.0, 500)
        x[: m - 1] = low + operator.segments[1:, 0][:500]
        outputs = []
        for chosen in (COMPILED, kernel.PythonKernel):
            monkeypatch.setattr(kernel, "CHOSEN", chosen)
            outputs.append(bits_of(operator.run(x)))
        assert outputs[0] == outputs[1]


def dyadic(rng: np.random.Generator, n: int) -> Floats:
    """Widths that are whole multiples of 1/64, so that breakpoints are floats exactly."""
    return rng.integers(8, 64, n) / 64.0


@pytest.mark.parametrize("n", range(1, 13))
def test_every_state_equals_the_reference(
    n: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From each of the 2^n states: onto it, into and exactly to the end of the next gear, and far beyond.

    Beyond 10 gears from every seventh state alone.
    """
    rng = np.random.default_rng(n)
    operator = DiscreteBacklashOperator(dyadic(rng, n), dyadic(rng, n), 1.5, -0.25)
    widths = operator.dx.tolist(), operator.dy.tolist()
    kernels = [
        chosen for chosen in (COMPILED, kernel.PythonKernel) if chosen is not None
    ]
    paper = reference.Backlash(*widths, 1.5, -0.25)
    for bits in range(0, 1 << n, 1 if n <= 10 else 7):
        paper.state = bits
        x_b, y_b = paper.coordinates()
        assert operator.coordinates(BacklashState(bits)) == (float(x_b), float(y_b))
        s, z = (
            reference.find_first_one(paper.bits),
            reference.find_first_zero(paper.bits),
        )
        up = paper.dx[z] if z < n else Fraction(1)
        down = paper.dx[s] if s < n else Fraction(1)
        for x in (
            x_b,
            x_b + up / 4,
            x_b + up,
            x_b + up * 3,
            x_b - down / 4,
            x_b - down,
            x_b - down * 3,
        ):
            paper.state = bits
            expected = paper.step(float(x))
            for chosen in kernels:
                monkeypatch.setattr(kernel, "CHOSEN", chosen)
                y, after, _ = operator.run([float(x)], BacklashState(bits))
                assert after.bits == paper.state
                assert abs(Fraction(float(y[0])) - expected) <= Fraction(1, 2**49)


@pytest.mark.parametrize("n", [1, 2, 25, 63, 64, 65, 128, 200, 1000])
def test_random_paths_equal_the_reference(n: int, chosen: Any) -> None:
    rng = np.random.default_rng(100 + n)
    operator = DiscreteBacklashOperator(dyadic(rng, n), dyadic(rng, n), -2.0, 3.0)
    low, high = operator.x_range
    paper = reference.Backlash(operator.dx.tolist(), operator.dy.tolist(), -2.0, 3.0)
    # Steps of a few gears, on multiples of 1/256: breakpoints are met exactly and
    # often.
    x = np.cumsum(rng.normal(0.0, 2.0, 40 if n < 1000 else 12))
    x = np.rint(np.clip(low + np.abs(x), low - 1.0, high + 1.0) * 256.0) / 256.0
    y, after, _ = operator.run(x, operator.empty())
    expected = [paper.step(value) for value in x.tolist()]
    assert after.bits == paper.state
    assert max(
        abs(Fraction(a) - b) for a, b in zip(y.tolist(), expected, strict=True)
    ) <= Fraction(1, 10**11)


def test_point_procedure_equals_the_reference(chosen: Any) -> None:
    rng = np.random.default_rng(9)
    dx, dy = dyadic(rng, 7), dyadic(rng, 7)
    operator = DiscretePointOperator(dx, dy, 0.5, -1.0)
    low, high = operator.x_range
    x = rng.integers(int(256 * (low - 1.0)), int(256 * (high + 1.0)), 300) / 256.0
    expected = reference.point(dx.tolist(), dy.tolist(), 0.5, -1.0, x.tolist())
    error = [
        abs(Fraction(a) - b)
        for a, b in zip(operator.run(x).tolist(), expected, strict=True)
    ]
    assert max(error) <= Fraction(1, 2**49)


def test_sums_never_drift(chosen: Any) -> None:
    """2 x 10^6 transitions with the compiled kernel; benchmarks/drift.py makes 10^9."""
    rng = np.random.default_rng(4)
    operator = DiscreteBacklashOperator(
        rng.uniform(0.1, 1.0, 100), rng.uniform(0.1, 1.0, 100), 0.0, 0.0
    )
    low, high = operator.x_range
    sweeps = 10_000 if chosen is COMPILED else 200
    x = np.tile([high, low], sweeps)
    x[1::2] += rng.uniform(0.0, 0.3, sweeps) * (high - low)
    probe = rng.uniform(low, high, 50)
    _, state, _ = operator.run(x, operator.empty())
    y, _, _ = operator.run(probe, state)
    # The state as it was carried through all of them, against the sums (2)-(3) of its
    # bits.
    carried, _, _ = operator.run(np.concatenate([x, probe]), operator.empty())
    assert bits_of(carried[-50:]) == bits_of(y)


@pytest.mark.parametrize("n", [2, 63, 64, 65, 4096, 4097, 9000])
def test_many_gears(n: int, chosen: Any) -> None:
    """Full sweeps, and a dither with all low bits set."""
    operator = DiscreteBacklashOperator(np.ones(n), np.full(n, 0.5))
    x = np.array(
        [
            float(n),
            n - 1.0,
            float(n),
            0.0,
            float(n - 1),
            n - 1.5,
            n - 1.0,
            float(n),
            n - 2.0,
        ]
    )
    y, state, counts = operator.run(x, operator.empty())
    assert bits_of(y) == bits_of(0.5 * x)
    assert counts == Counts()
    assert state.bits == (1 << n) - 4


def test_crossing_by_the_tolerance_keeps_the_gears_own_slope(chosen: Any) -> None:
    operator = DiscreteBacklashOperator([1.0, 1.0], [1.0, 3.0])
    short = 2.0 - 0.5e-9
    y, state, _ = operator.run([short], operator.empty())
    assert state.bits == 0b11
    assert y[0] == pytest.approx(4.0 - 1.5e-9, abs=1e-15)
    back, again, _ = operator.inverse().run(y, operator.empty())
    assert again == state
    assert back[0] == pytest.approx(short, abs=1e-15)


def test_a_gear_travelled_exactly_to_the_tolerance_counts_as_crossed(
    chosen: Any,
) -> None:
    """Also where the samples before it stayed in the gear, which the compiled kernel hurries through."""
    operator = DiscreteBacklashOperator([1.0, 2.0, 4.0], [1.0, 3.0, 5.0])
    reach = 1.0 - 1e-9
    quiet = [0.25, 0.5, 0.5, 0.75, 0.5, 0.25, 0.5]
    below = np.nextafter(reach, 0.0)
    assert operator.run([*quiet, below], operator.empty())[1].bits == 0
    assert operator.run([*quiet, reach], operator.empty())[1].bits == 1
    begun = BacklashState(1)
    down = [1.0 - value for value in (*quiet, reach)]
    assert operator.run(down, begun)[1].bits == 0
    assert operator.run([*down[:-1], 1.0 - below], begun)[1].bits == 1


@pytest.mark.parametrize("relaxation", [False, True])
def test_steps_planned_committed_and_applied_are_those_of_blocks(
    relaxation: bool, chosen: Any
) -> None:
    """Plans that are never committed leave no trace; what was applied instead drives the forward operator."""
    for seed in range(12):
        rng = np.random.default_rng([seed, 11])
        forward = random_operator(
            rng, (5, 64, 200)[seed % 3], relaxation, (1, 16)[seed % 2]
        )
        inverse, (low, high) = forward.inverse(), forward.x_range
        terms, before = forward.relaxation, low + 0.3 * (high - low)
        decay = None if terms is None else terms.decay(0.01)
        memory = (
            None
            if terms is None
            else tuple(rng.normal(0.0, 1.0, len(terms.tau)).tolist())
        )
        state = BacklashState(forward.settled(before).bits, memory)
        limits = OutputLimits(low, high - 0.1 * (high - low), 0.3 * (high - low), 1e-9)
        stepper = BacklashStepper(inverse, state, before, 0.01, limits)
        for k, wanted in enumerate(rng.uniform(*forward.y_range, 40).tolist()):
            assert (stepper.state, stepper.last) == (state, before)
            stepper.plan(wanted + 0.1)
            y, after, counts = inverse.run(
                [wanted], state, decay=decay, limits=limits, last=before
            )
            assert (stepper.plan(wanted), stepper.clipped) == (y[0], counts.clipped)
            if k % 3:
                stepper.commit()
                state, before = after, float(y[0])
            else:
                before = float(rng.uniform(low, high))
                stepper.follow(before)
                stepper.commit()
                state = forward.run([before], state, decay=decay)[1]
        with pytest.raises(ValueError, match=r"^nothing was planned to be committed$"):
            BacklashStepper(inverse, state, before, 0.01, limits).commit()
        if relaxation:
            with pytest.raises(
                ValueError, match=r"^memory on the input: its output does not give the"
            ):
                BacklashStepper(forward, state, before, 0.01).follow(0.0)


@pytest.mark.parametrize("relaxation", [False, True])
def test_the_drive_whose_own_start_leads_to_an_output(
    relaxation: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both kernels give the same bits; at rest there the output is the one wanted, or just beside a step."""
    reached = 0
    for seed in range(20):
        rng = np.random.default_rng([seed, 12])
        operator = random_operator(
            rng, (3, 25, 100)[seed % 3], relaxation, (1, 16)[seed % 2]
        )
        low, high = operator.y_range
        output = float(rng.uniform(low, high))
        starts = []
        for each in (COMPILED or kernel.PythonKernel, kernel.PythonKernel):
            monkeypatch.setattr(kernel, "CHOSEN", each)
            starts.append(start_drive(operator, output))
        assert starts[0] == starts[1]
        reached += abs(starts[0].reached - output) < 1e-9 * (high - low)
    assert reached == (11 if relaxation else 13)


@needs_compiled
def test_compiled_stepper_checks_lengths() -> None:
    assert COMPILED is not None
    gears, guide, one = np.ones((3, 6)), np.empty(0, np.uint32), np.ones(1)
    end = (False, 0.0, 0.0, 0.0, np.nan)
    with pytest.raises(ValueError, match="kernel buffer of the wrong length: gears"):
        COMPILED.Stepper(gears, guide, 3, 1, 0.0, 0.0, True, one, 0.0, True, one, *end)
    with pytest.raises(ValueError, match="kernel buffer of the wrong length: decay"):
        COMPILED.Stepper(
            gears, guide, 2, 1, 0.0, 0.0, True, one, 0.0, True, np.ones(2), *end
        )
    made = COMPILED.Stepper(
        gears, guide, 2, 1, 0.0, 0.0, True, one, 0.0, True, one, *end
    )
    words = np.zeros(kernel.state_words(2), np.uint64)
    for call in (made.get, lambda *buffers: made.set(*buffers, 0.0)):
        with pytest.raises(
            ValueError, match="kernel buffer of the wrong length: words"
        ):
            call(words[1:], one)
        with pytest.raises(
            ValueError, match="kernel buffer of the wrong length: memory"
        ):
            call(words, np.ones(2))
    with pytest.raises(TypeError, match="must be real number, not str"):
        made.plan("1")


def test_odd_values_end(chosen: Any) -> None:
    """The commands refuse NaN and inf; the kernel must survive them all the same."""
    operator = DiscreteBacklashOperator([1.0, 2.0], [1.0, 3.0])
    y, state, _ = operator.run([np.nan, np.inf, -np.inf, 1.0], operator.empty())
    assert np.isnan(y[0])
    assert y[1:].tolist() == [np.inf, -np.inf, 1.0]
    assert state.bits == 1


def test_blocks_of_no_samples(chosen: Any) -> None:
    operator = DiscreteBacklashOperator([1.0, 2.0], [1.0, 3.0])
    y, state, counts = operator.run([], BacklashState(2))
    assert (y.size, state, counts) == (0, BacklashState(2), Counts())
    rows, _ = operator.engagement([], BacklashState(2))
    assert rows.shape == (0, 2)


@needs_compiled
def test_compiled_kernel_checks_lengths() -> None:
    assert COMPILED is not None
    gears, guide = np.ones((3, 6)), np.empty(0, np.uint32)
    none = np.empty(0)
    with pytest.raises(ValueError, match="kernel buffer of the wrong length: words"):
        COMPILED.backlash_engagement(
            gears,
            guide,
            2,
            1,
            0.0,
            True,
            np.zeros(0, np.uint64),
            none,
            none,
            np.empty(2),
            1,
        )
    words = np.zeros(kernel.state_words(2), np.uint64)
    with pytest.raises(ValueError, match="kernel buffer of the wrong length: rows"):
        COMPILED.backlash_engagement(
            gears, guide, 2, 1, 0.0, True, words, np.ones(3), none, np.empty(2), 1
        )
    with pytest.raises(ValueError, match="kernel buffer of the wrong length: gears"):
        COMPILED.backlash_engagement(
            gears, guide, 7, 3, 0.0, True, words, np.ones(3), none, np.empty(3), 1
        )
    with pytest.raises(ValueError, match="kernel buffer of the wrong length: y"):
        COMPILED.point_run(np.ones((1, 3)), 0.0, 0.0, np.ones(3), np.empty(2))


def test_choice_of_kernel() -> None:
    assert kernel.choose("python") == ("python", kernel.PythonKernel)
    with pytest.raises(
        UsageError,
        match=r"^environment DBO_KERNEL: no kernel is called 'fast' \(use python",
    ):
        kernel.choose("fast")


def test_without_extension(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernel, "compiled_kernel", lambda: None)
    assert kernel.choose("")[0] == "python"
    with pytest.raises(UsageError, match="was not built at installation"):
        kernel.choose("compiled")


def test_an_extension_of_another_state_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """After new sources in an editable installation, until it is built again."""
    for older in (SimpleNamespace(), SimpleNamespace(INTERFACE=kernel.INTERFACE - 1)):
        monkeypatch.setattr(kernel, "compiled_kernel", lambda older=older: older)
        with pytest.raises(
            DboError, match=r"^the compiled kernel was built from another state"
        ):
            kernel.choose("")
        assert kernel.choose("python")[0] == "python"


def test_environment_selects_the_python_twin() -> None:
    done = subprocess.run(
        [sys.executable, "-c", "from dbo_cli.hysteresis import kernel; print(kernel.KIND)"],
        env={**os.environ, "DBO_KERNEL": "python"}, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout.strip() == "python"


@pytest.mark.skipif(not COMPILERS, reason="no C compiler")
@pytest.mark.parametrize(
    "flags",
    [
        ["-O2"],
        ["-O2", "-DDBO_SPACING=4"],
        ["-O1", "-DDBO_SMALL", "-DDBO_PLACE=uint16_t"],
    ],
)
def test_random_blocks_give_the_bits_of_single_gears(
    flags: list[str], tmp_path: Path
) -> None:
    """All kinds of widths, inputs, memories, limits and cuts, in short; the benchmark goes on for ever."""
    program = tmp_path / "kernel_reference"
    source = (
        Path(__file__).resolve().parent.parent / "benchmarks" / "kernel_reference.c"
    )
    compile_c(
        tmp_path, "-std=c99", *flags, "-ffp-contract=off", f"-I{SOURCE}", str(source),
        "-o", str(program), "-lm",
    )  # fmt: skip
    for seed in ("11", "12"):
        done = subprocess.run(
            [str(program), "3e5", seed], capture_output=True, text=True, check=False
        )
        assert (done.returncode, done.stdout.split()[1:]) == (
            0,
            "steps, every bit as gear by gear".split(),
        )


HARNESS = """
#include "dbo_kernel.c"
void drive(const dbo_gear *gears, size_t n, dbo_place *turns, const double *x, double *y, size_t count) {
    dbo_backlash op = {gears, n, 1, DBO_ROW_FACTOR(1), 0, 0, 0.0, 0.0, 0.0, 1, 0, 0, 0.0, 0};
    dbo_checkpoint checkpoints[150 / DBO_SPACING];
    dbo_backlash_state state = {turns, checkpoints, 0, 0, 0, 0, 0.0, 0.0, 0.0};
    dbo_counts counts = {0, 0, 0, 0};
    dbo_backlash_load(&op, &state, 0);
    for (size_t k = 0; k < count; k++) y[k] = dbo_backlash_step(&op, &state, x[k], 0, 0, &counts);
}
"""


@pytest.mark.skipif(not COMPILERS, reason="no C compiler")
def test_single_steps_with_small_places(tmp_path: Path) -> None:
    """The file on its own, warnings as errors, with places of 16 bits and without the package's guide."""
    (tmp_path / "kernel_harness.c").write_text(HARNESS)
    rng = np.random.default_rng(8)
    operator = DiscreteBacklashOperator(
        rng.uniform(0.1, 1.0, 150), rng.uniform(0.1, 1.0, 150)
    )
    x = random_trajectory(rng, operator, 300)
    expected, _, _ = operator.run(x, operator.empty())
    few = "-DDBO_PLACE=uint8_t", "-DDBO_SPACING=16"
    for flags in (
        ["-O1"],
        ["-O1", "-DDBO_PLACE=uint16_t"],
        ["-O1", *few, "-DDBO_SMALL"],
    ):
        library = tmp_path / f"kernel{''.join(flags)}.so"
        compile_c(
            tmp_path, *WARNINGS, "-Wno-unused-function", "-shared", "-fPIC", *flags,
            f"-I{SOURCE}", "kernel_harness.c", "-o", str(library),
        )  # fmt: skip
        loaded = ctypes.CDLL(str(library))
        y = np.empty_like(x)
        turns, (table, _) = np.zeros(operator.n, np.uint32), operator.table
        pointer = ctypes.c_void_p
        loaded.drive.argtypes = [
            pointer,
            ctypes.c_size_t,
            pointer,
            pointer,
            pointer,
            ctypes.c_size_t,
        ]
        loaded.drive(
            table.ctypes.data,
            operator.n,
            turns.ctypes.data,
            x.ctypes.data,
            y.ctypes.data,
            x.size,
        )
        assert bits_of(y) == bits_of(expected)
