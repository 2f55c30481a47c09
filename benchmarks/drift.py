"""X_B and Y_B after a billion transitions, against the sums (2)-(3).

    python benchmarks/drift.py [--transitions N] [--gears N]

Random gears are driven to random turning points, so that the state wanders through the
range; the sums the kernel carried, read off its output, are compared with those of its
bits, and, for contrast, with the same adding and subtracting of the widths as they were
given, before they are put on the binary grid.
"""

from __future__ import annotations

import argparse
import math
import time

import numpy as np

from dbo_cli.hysteresis import kernel
from dbo_cli.hysteresis.operators import DiscreteBacklashOperator


def naive_drift(widths: list[float], transitions: int) -> float:
    """Return how far full sweeps, added and subtracted in plain float64, wander, as part of the range."""
    total = 0.0
    for _ in range(transitions // (2 * len(widths))):
        for width in widths:
            total += width
        for width in widths:
            total -= width
    return abs(total) / math.fsum(widths)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--transitions", type=float, default=1e9)
    parser.add_argument("--gears", type=int, default=100)
    options = parser.parse_args()
    rng = np.random.default_rng(1)
    dx, dy = rng.uniform(0.1, 1.0, options.gears), rng.uniform(0.1, 1.0, options.gears)
    operator = DiscreteBacklashOperator(dx, dy)
    low, high = operator.x_range
    words = np.zeros(kernel.state_words(operator.n), np.uint64)
    # One call, in place: the kernel carries its sums from the first sample to the last.
    block = rng.uniform(low, high, 20_000)
    block[::50] = high
    block[25::50] = low
    rows, _ = operator.engagement(block, operator.empty())
    crossed = np.abs(np.diff((rows >= 1.0).sum(axis=1))).sum()
    repeats = math.ceil(options.transitions / crossed)
    probe = np.array([low + 0.37 * (high - low)])
    x, nothing = np.empty(repeats * block.size + 1), np.empty(0)
    x[:-1].reshape(repeats, -1)[:] = block
    x[-1] = probe[0]
    begin = time.perf_counter()
    kernel.CHOSEN.backlash_run(
        *operator.table, operator.n, 1, 0.0, 0.0, True, nothing, 0.0, False, words, nothing,
        0.0, x, x, nothing, False, 0.0, 0.0, 0.0, nothing,
    )  # fmt: skip
    seconds = time.perf_counter() - begin
    _, before, _ = operator.run(block, operator.run(block, operator.empty())[1])
    expected, state, _ = operator.run(probe, before)
    assert operator._bits(words) == state.bits
    print(
        f"{crossed * repeats:.3g} transitions or more in {x.size:,} samples, {seconds:.1f} s"
    )
    print(
        f"wandered from (2)-(3): {abs(x[-1] - expected[0]) / operator.y_range[1]:.1e} of the range"
    )
    print(
        f"plain float64 sums, 1e7 transitions: {naive_drift(dx.tolist(), 10_000_000):.1e} of the range"
    )


if __name__ == "__main__":
    main()
