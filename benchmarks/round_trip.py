"""Round trips in bulk: inverse after forward and forward after inverse, both kernels bit by bit.

    python benchmarks/round_trip.py [--trials N] [--seed N] [--samples N]

Random operators of 1 to 1,000 gears; trajectories that turn inside gears, on
breakpoints exactly and within a unit in the last place, and at full scale
(tests/trials.py); every third operator with relaxation, evenly and unevenly sampled.
Exits 1 where an error exceeds 1e-12 of the range or the kernels differ in one bit.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.hysteresis import kernel

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
from trials import random_operator, random_trajectory


def trial(seed: int, samples: int) -> tuple[bytes, Any, float, float]:
    """Return the bits of everything computed, the states, and the two errors as parts of the range."""
    rng = np.random.default_rng(seed)
    operator = random_operator(
        rng, round(10.0 ** rng.uniform(0.0, 3.0)), relaxation=seed % 3 == 0
    )
    inverse = operator.inverse()
    x: NDArray[np.float64] = random_trajectory(rng, operator, samples)
    terms = operator.relaxation
    steps = 0.01 if seed % 2 else rng.uniform(0.0, 0.1, samples)
    decay = terms.decay(steps) if terms else None
    start = operator.settled(x[0])
    y, after, _ = operator.run(x, start, decay=decay)
    back, same, _ = inverse.run(y, start, decay=decay)
    again, once_more, _ = operator.run(back, start, decay=decay)
    if not after.bits == same.bits == once_more.bits:
        return b"", None, np.inf, np.inf
    spans = [float(np.subtract(*one.x_range[::-1])) for one in (operator, inverse)]
    errors = [
        float(np.abs(back - x).max()) / spans[0],
        float(np.abs(again - y).max()) / spans[1],
    ]
    return (
        y.tobytes() + back.tobytes() + again.tobytes(),
        (after, same, once_more),
        errors[0],
        errors[1],
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--samples", type=int, default=24)
    options = parser.parse_args()
    compiled = kernel.compiled_kernel()
    if compiled is None:
        raise SystemExit("the compiled kernel is not there")
    begin, worst, different = time.perf_counter(), [0.0, 0.0], 0
    for seed in range(options.seed, options.seed + options.trials):
        kernel.CHOSEN = compiled
        bits, states, *errors = trial(seed, options.samples)
        kernel.CHOSEN = kernel.PythonKernel
        different += trial(seed, options.samples)[:2] != (bits, states)
        worst = [max(pair) for pair in zip(worst, errors, strict=True)]
    print(
        f"{options.trials:,} trials of {options.samples} samples in {time.perf_counter() - begin:.0f} s"
    )
    print(f"inverse after forward: worst error {worst[0]:.1e} of the range")
    print(f"forward after inverse: worst error {worst[1]:.1e} of the range")
    print(f"trials in which the two kernels differ in a bit: {different}")
    return int(max(worst) > 1e-12 or different > 0)


if __name__ == "__main__":
    sys.exit(main())
