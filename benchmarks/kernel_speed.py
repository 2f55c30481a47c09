"""How fast is the compiled kernel: against the fastest Prandtl-Ishlinskii loop found, and against a copy.

    python benchmarks/kernel_speed.py [--samples N] [--repeats N] [--against CHECKOUT]
    [--only WORD] [--plays]

One run, one machine, ratios. 2,000 samples a cycle; times are the best of the repeats,
in ns a sample. "dither" turns at every sample: every low bit is set and one of them
toggles. Needs g++ (or CXX) for the competitor. A second table has the inputs that cross
many gears in a sample (100 samples a cycle, random, jumps over the whole range, nested
turns) and the fastest plays on the same inputs. "identified" has 1,280 gears in 80 runs
of equal ones, as identification makes them, and with 5,120 gears as many equal ones.
With --against, the compiled kernel of another checkout of this project runs the same
cases instead, turn by turn with this one, so that whatever else the machine does meets
both; --only runs those whose name has WORD; --plays has as many plays as gears beside
the operators of n gears.
"""

from __future__ import annotations

import argparse
import ctypes
import functools
import importlib.util
import os
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.hysteresis import kernel
from dbo_cli.hysteresis.operators import (
    BacklashState,
    DiscreteBacklashOperator,
    Relaxation,
)

Floats = NDArray[np.float64]
LAYOUTS = {"plain": 1, "lanes4x1": 4, "lanes4x2": 8, "lanes4x4": 16,
           "lanes8x1": 8, "lanes8x2": 16, "lanes8x4": 32, "lanes8x7": 56}  # fmt: skip
GEARS = (25, 100, 400, 1000)
SIZES = (8, 25, 64, 256, 1024, 5120)
BESIDE_PLAYS = (25, 256, 1024)
NOTHING = np.empty(0)


def best(run: Callable[[], object], repeats: int) -> float:
    """Return the shortest of the run times, in seconds of the processor's time."""
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        run()
        times.append(time.process_time() - begin)
    return min(times)


def backlash(
    operator: DiscreteBacklashOperator, start: BacklashState, x: Floats
) -> Callable[[], object]:
    """Return one run of the compiled kernel over ``x``, buffers ready."""
    y, words = np.empty_like(x), operator._words(start)
    return lambda: kernel.CHOSEN.backlash_run(
        *operator.table, operator.n, 1, operator.x0, operator.y0, True, NOTHING, 0.0, False,
        words.copy(), NOTHING, 0.0, x, y, NOTHING, False, 0.0, 0.0, 0.0, NOTHING,
    )  # fmt: skip


def competitor(folder: Path) -> ctypes.CDLL:
    """Compile the play operators for this machine."""
    source = Path(__file__).with_name("play_operators.cc")
    library = folder / "plays.so"
    compiler = os.environ.get("CXX", "g++")
    flags = [
        "-O3",
        "-march=native",
        "-ffast-math",
        "-funroll-loops",
        "-shared",
        "-fPIC",
    ]
    subprocess.run([compiler, *flags, str(source), "-o", str(library)], check=True)
    return ctypes.CDLL(str(library))


def plays(
    library: ctypes.CDLL, layout: str, n: int, x: Floats
) -> tuple[Callable[[], object], Floats]:
    """Return one run of n plays in one layout, and where its output goes."""
    size = -(-n // LAYOUTS[layout]) * LAYOUTS[layout]
    thresholds, weights, held, y = (
        np.zeros(size),
        np.zeros(size),
        np.zeros(size),
        np.empty_like(x),
    )
    thresholds[:n] = np.linspace(0.0, 1.7, n)
    weights[:n] = 1.0 / n
    function = getattr(library, layout)
    pointers = [ctypes.c_void_p(a.ctypes.data) for a in (thresholds, weights, held)]
    signals = [ctypes.c_void_p(a.ctypes.data) for a in (x, y)]
    count = ctypes.c_size_t(x.size)

    def run() -> None:
        assert held.size == weights.size == thresholds.size  # keeps the arrays alive
        function(*pointers, ctypes.c_size_t(size), *signals, count)

    return run, y


def fastest_plays(
    library: ctypes.CDLL, n: int, x: Floats, repeats: int
) -> tuple[float, str]:
    """Return the best time over all layouts and its name; all of them must agree."""
    results, expected = {}, None
    for layout in LAYOUTS:
        run, y = plays(library, layout, n, x)
        run()
        expected = y.copy() if expected is None else expected
        assert np.abs(y - expected).max() < 1e-9, layout
        results[layout] = best(run, repeats)
    layout = min(results, key=lambda name: results[name])
    return results[layout], layout


def dither(
    n: int, samples: int
) -> tuple[DiscreteBacklashOperator, BacklashState, Floats]:
    """Return an operator, the state with all bits but the highest set, and a dither of gear 0."""
    operator = DiscreteBacklashOperator(np.ones(n), np.ones(n))
    x = np.full(samples, n - 1.0)
    x[::2] -= 1.0
    return operator, BacklashState((1 << n - 1) - 1), x


def kernel_of(checkout: Path) -> ModuleType:
    """Load the compiled kernel of another checkout."""
    path = next((checkout / "dbo_cli" / "hysteresis").glob("_kernel*.so"))
    spec = importlib.util.spec_from_file_location("_kernel", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def operators() -> dict[str, DiscreteBacklashOperator]:
    """Return operators of n gears with a slope each, and one as identification makes them."""
    found = {}
    for n in SIZES:
        rng = np.random.default_rng(n)
        dx = rng.uniform(0.5, 1.5, n) * 3.6 / n
        found[f"n = {n}"] = DiscreteBacklashOperator(dx, dx * np.linspace(0.5, 1.5, n))
    slopes = np.repeat(np.linspace(0.5, 1.5, 80), 16)
    found["identified"] = DiscreteBacklashOperator(
        np.full(1280, 3.6 / 1280), slopes * 3.6 / 1280
    )
    slopes = np.repeat(np.linspace(0.5, 1.5, 80), 64)
    found["identified, 5,120"] = DiscreteBacklashOperator(
        np.full(5120, 3.6 / 5120), slopes * 3.6 / 5120
    )
    return found


def inputs(operator: DiscreteBacklashOperator, samples: int) -> dict[str, Floats]:
    """Return what drives an operator from its lower end: smooth, faster, random, and jumps."""
    low, high = operator.x_range
    ramp, rng = np.arange(samples), np.random.default_rng(1)
    return {
        "smooth": low
        + (high - low) * (0.5 - 0.5 * np.cos(2.0 * np.pi / 2000.0 * ramp)),
        "100 a cycle": low
        + (high - low) * (0.5 - 0.5 * np.cos(2.0 * np.pi / 100.0 * ramp)),
        "random": rng.uniform(low, high, samples),
        "jumps": np.where(ramp % 2 == 0, high, low),
        "nested turns": nested(low, high, samples),
    }


def nested(low: float, high: float, samples: int) -> Floats:
    """Return turns at every sample, each a little less far than the one before, 64 of them at a time."""
    ramp = np.arange(samples)
    reach = 0.5 * (1.0 - ramp % 64 / 64.0)
    return low + (high - low) * (0.5 + np.where(ramp % 2 == 0, reach, -reach))


def cases(
    samples: int,
) -> dict[str, tuple[DiscreteBacklashOperator, BacklashState, Floats, bool]]:
    """Operators, starts, inputs, and whether limits bind, for the comparison of two kernels."""
    found = {}
    for name, operator in operators().items():
        terms = Relaxation(0.0, (0.01, 1.0), (0.1, 0.1))
        lagging = DiscreteBacklashOperator(operator.dx, operator.dy, 0.0, 0.0, terms)
        for kind, x in inputs(operator, samples).items():
            found[f"{name}, {kind}"] = operator, operator.empty(), x, False
            if operator.n >= 1024 or kind == "smooth":
                y = operator.run(x, operator.empty())[0]
                found[f"{name}, {kind}, relaxation"] = (
                    lagging,
                    operator.empty(),
                    x,
                    False,
                )
                found[f"{name}, {kind}, inverse, limits"] = (
                    lagging.inverse(),
                    operator.empty(),
                    y,
                    True,
                )
    for n in GEARS:
        found[f"dither, {n} gears"] = *dither(n, samples), False
    return found


def prepared(
    module: Any,
    operator: DiscreteBacklashOperator,
    start: BacklashState,
    x: Floats,
    limited: bool,
) -> tuple[Callable[[], object], Floats]:
    """Return one run of a kernel, of today's or of the older arguments, and where its output goes."""
    y, terms = np.empty_like(x), operator.relaxation
    # older kernels need more than the bits
    words = np.zeros(operator.n // 8 + 64, np.uint64)
    words[: kernel.state_words(operator.n)] = operator._words(start)
    gain = np.array(terms.gain if terms else ())
    decay = terms.decay(0.001) if terms else NOTHING
    tables: list[tuple[Any, ...]] = [
        (*operator.table, operator.n, 1),
        (operator.gears, operator.n, operator.equal_run),
    ]

    def arguments(table: tuple[Any, ...]) -> tuple[Any, ...]:
        return (
            *table, operator.x0, operator.y0, True, gain, 0.0, operator.memory_on == "output", words.copy(),
            np.zeros(gain.size), 0.0, x, y, decay, limited, 0.0, 3.6, 1e-9, NOTHING,
        )  # fmt: skip

    for table in tables:
        try:
            module.backlash_run(*arguments(table))
        except TypeError:
            continue
        return functools.partial(
            lambda one: module.backlash_run(*arguments(one)), table
        ), y
    raise SystemExit("the other kernel's arguments are not known here")


def compare(
    other: ModuleType,
    samples: int,
    repeats: int,
    word: str,
    library: ctypes.CDLL | None,
) -> None:
    """Print ns a sample of this kernel and of another, and their ratio; outputs must be the same bits."""
    print(
        "case                                      this ns  other ns  this/other  plays ns"
    )
    for name, case in cases(samples).items():
        if word not in name:
            continue
        (own, y), (old, z) = prepared(kernel.CHOSEN, *case), prepared(other, *case)
        assert y.tobytes() == z.tobytes(), name
        times: list[list[float]] = [[], []]
        for _ in range(repeats):
            for k, run in enumerate((own, old)):
                times[k].append(best(run, 1) * 1e9 / samples)
        this, that = min(times[0]), min(times[1])
        beside = ""
        if library is not None and name.startswith("n = ") and name.count(",") == 1:
            slow = fastest_plays(library, case[0].n, case[2], 2)[0] * 1e9 / samples
            beside = f"  {slow:8.1f}"
        print(
            f"{name:40}  {this:8.2f}  {that:8.2f}  {this / that:10.2f}{beside}",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=1_000_000)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--against", type=Path, metavar="CHECKOUT")
    parser.add_argument("--only", default="", metavar="WORD")
    parser.add_argument("--plays", action="store_true")
    options = parser.parse_args()
    if kernel.KIND != "compiled":
        raise SystemExit("the compiled kernel is not there")
    if options.against:
        with tempfile.TemporaryDirectory() as folder:
            library = competitor(Path(folder)) if options.plays else None
            old = kernel_of(options.against)
            compare(old, options.samples, 5 * options.repeats, options.only, library)
        return
    x = 1.8 - 1.8 * np.cos(2.0 * np.pi / 2000.0 * np.arange(options.samples))
    scale = 1e9 / options.samples
    y = np.empty_like(x)
    copy = best(lambda: np.copyto(y, x), options.repeats) * scale
    print(
        f"{options.samples:,} samples, 2,000 a cycle; copying the array: {copy:.2f} ns a sample"
    )
    print("gears  DBO ns  dither ns  plays ns  layout     plays/DBO  DBO/copy")
    with tempfile.TemporaryDirectory() as folder:
        library = competitor(Path(folder))
        for n in GEARS:
            gears = DiscreteBacklashOperator(
                np.full(n, 3.6 / n), np.linspace(0.5, 1.5, n) * 3.6 / n
            )
            own = best(backlash(gears, gears.empty(), x), options.repeats) * scale
            worst = best(backlash(*dither(n, options.samples)), options.repeats) * scale
            repeats = max(2, options.repeats * 25 // n) if n > 25 else options.repeats
            other, layout = fastest_plays(library, n, x, repeats)
            other *= scale
            print(
                f"{n:5}  {own:6.2f}  {worst:9.2f}  {other:8.2f}  {layout:9}"
                f"  {other / own:9.1f}  {own / copy:8.1f}"
            )
        print(
            "\nns a sample               smooth  100 a cycle    random     jumps  nested turns"
        )
        for name, operator in operators().items():
            signals = list(inputs(operator, options.samples).values())
            runs = [backlash(operator, operator.empty(), x) for x in signals]
            print(line(name, [best(run, options.repeats) * scale for run in runs]))
            if operator.n in BESIDE_PLAYS:
                costs = [
                    fastest_plays(library, operator.n, x, 2)[0] * scale for x in signals
                ]
                print(line(f"  {operator.n} plays", costs))


def line(name: str, costs: list[float]) -> str:
    """Return a row of the second table, in ns a sample."""
    return f"{name:20}  {costs[0]:9.2f}  {costs[1]:11.1f}  {costs[2]:8.1f}  {costs[3]:8.1f}  {costs[4]:12.1f}"


if __name__ == "__main__":
    main()
