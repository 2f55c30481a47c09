"""What a sample costs: the Discrete Backlash Operator beside the Prandtl-Ishlinskii operators, built alike.

    python benchmarks/relatives_cost.py [--samples N] [--repeats N] [--figures FOLDER]

One run, one machine, ratios. All operators are C99 in one extension, compiled with the
same flags, and called for blocks of samples; plays are summed in eight lanes, so that a
compiler may use vector registers. Every gear and weight differs from the others. The
inverse of [6] is the closed form, again plays; those of [7] to [9] walk from play to
play. Times are the processor's own, the best of the repeats, in ns a sample.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from machine import verdict
from numpy.typing import NDArray

from dbo_cli.extras.compare.judging import processor_ns
from dbo_cli.extras.compare.plays import PlayOperator
from dbo_cli.hysteresis import kernel
from dbo_cli.hysteresis.operators import DiscreteBacklashOperator

Floats = NDArray[np.float64]

COUNTS = (5, 10, 25, 50, 100, 250, 500, 1000, 2000)
CYCLES = (100, 200, 500, 2000, 5000, 20000)
USUAL_CYCLE = 2000
NOISES = (0.0, 1e-4, 1e-3)  # of the range, standard deviation, on the input
CLAIMS = {25: 4.0, 1000: 40.0}
BLOCK = 65_536


@dataclass(frozen=True)
class Cost:
    """Nanoseconds a sample of one operator, forward and inverse."""

    forward: float
    inverse: float


def drive(samples: int, cycle: int, noise: float) -> Floats:
    """Return a sine over the range from -1 to 1, with noise."""
    x = np.sin(2.0 * np.pi / cycle * np.arange(samples))
    return (
        x + np.random.default_rng(1).normal(0.0, 2.0 * noise, samples) if noise else x
    )


def gears(n: int) -> DiscreteBacklashOperator:
    """Return n gears whose slopes grow, no two alike."""
    slopes = 0.6 + 0.8 * (np.arange(n) + 0.5) / n
    return DiscreteBacklashOperator(np.full(n, 2.0 / n), slopes * 2.0 / n, -1.0, -1.0)


def plays(n: int, kind: Any = "plays") -> PlayOperator:
    """Return n plays that make nearly the loop of ``gears``."""
    weights = np.full(n, 0.8 / n) * np.linspace(0.9, 1.1, n)
    weights[0] += 0.6
    if kind == "rate-plays":
        return PlayOperator(kind, np.arange(n) / n, weights, -0.1 * weights, 1.0)
    if kind == "one-sided-plays":
        return PlayOperator(kind, np.arange(n) / n, weights, cubic=0.1, linear=0.1)
    return PlayOperator(kind, np.arange(n) / n, weights)


def best(run: Callable[[Floats], Any], x: Floats, repeats: int) -> float:
    """Return the least time a sample (ns) of a run in blocks; blocks go on from the same state."""
    blocks = [x[begin : begin + BLOCK] for begin in range(0, x.size, BLOCK)]
    fastest = math.inf
    for _ in range(repeats):
        begun = processor_ns()
        for block in blocks:
            run(block)
        fastest = min(fastest, processor_ns() - begun)
    return fastest / x.size


def cost_of_gears(n: int, x: Floats, repeats: int) -> Cost:
    """Measure the backlash operator."""
    operator = gears(n)
    inverse, state = operator.inverse(), operator.settled(float(x[0]))
    y = operator.run(x, state)[0]
    return Cost(
        best(lambda block: operator.run(block, state), x, repeats),
        best(lambda block: inverse.run(block, state), y, repeats),
    )


def cost_of_plays(n: int, x: Floats, repeats: int, kind: Any = "plays") -> Cost:
    """Measure an operator of plays; of the first kind the inverse in closed form."""
    operator = plays(n, kind)
    if operator.one_sided:
        x = 0.5 + 0.5 * x
    begun = operator.settled(float(x[0]))

    def share(block: Floats) -> Floats:
        return np.full(block.size, 0.5) if operator.by_rate.size else np.empty(0)

    y = operator.run(x, begun, share(x))[0]
    forward = best(lambda block: operator.run(block, begun, share(block)), x, repeats)
    if kind == "plays":
        closed = operator.closed_inverse
        states = closed.states_of(begun)
        return Cost(forward, best(lambda block: closed.run(block, states), y, repeats))
    return Cost(
        forward,
        best(lambda block: operator.solve(block, begun, share(block)), y, repeats),
    )


def shortened(samples: int, n: int, cycle: int) -> int:
    """Return how many samples to time: fewer where one costs more, but a whole cycle."""
    return max(
        min(samples, samples * 50 // n), 2 * cycle if cycle < samples else samples
    )


def against_count(samples: int, repeats: int) -> dict[str, list[Cost]]:
    """Print and return the costs for every number of gears or plays."""
    names = {"rate-plays": "[7]", "singular-plays": "[8]", "one-sided-plays": "[9]"}
    print(f"{USUAL_CYCLE:,} samples a cycle, ns a sample; [7] to [9] inverse alone\n")
    print(
        "     n     DBO     PI  ratio   DBO inverse  PI inverse  ratio      [7]     [8]     [9]"
    )
    found: dict[str, list[Cost]] = {name: [] for name in ("DBO", "PI", *names.values())}
    for n in COUNTS:
        x = drive(shortened(samples, n, USUAL_CYCLE), USUAL_CYCLE, 0.0)
        own, rival = cost_of_gears(n, x, repeats), cost_of_plays(n, x, repeats)
        others = [cost_of_plays(n, x, repeats, kind) for kind in names]
        for name, one in zip(found, [own, rival, *others], strict=True):
            found[name].append(one)
        print(
            f"{n:6}  {own.forward:6.2f} {rival.forward:6.1f} {rival.forward / own.forward:6.1f}   "
            f"{own.inverse:11.2f} {rival.inverse:11.1f} {rival.inverse / own.inverse:6.1f}  "
            + " ".join(f"{one.inverse:7.0f}" for one in others),
            flush=True,
        )
    return found


def against_cycle(samples: int, repeats: int) -> dict[tuple[int, float], list[float]]:
    """Print and return how many times faster the inverse is, for samples a cycle and noise on the input."""
    print(
        "\nPI inverse over DBO inverse, by samples a cycle and noise on the input (of the range)\n"
    )
    print("     n    noise " + "".join(f"{cycle:>9,}" for cycle in CYCLES))
    found = {}
    for n in CLAIMS:
        for noise in NOISES:
            ratios = []
            for cycle in CYCLES:
                x = drive(shortened(samples, n, cycle), cycle, noise)
                ratios.append(
                    cost_of_plays(n, x, repeats).inverse
                    / cost_of_gears(n, x, repeats).inverse
                )
            found[n, noise] = ratios
            print(
                f"{n:6}  {noise:7g} " + "".join(f"{ratio:9.1f}" for ratio in ratios),
                flush=True,
            )
    return found


def paint_counts(found: dict[str, list[Cost]], axes: Any) -> None:
    """Draw ns a sample against n."""
    from dbo_cli.reports import drawing as style
    from dbo_cli.reports.figures import label_decades, mark_curves

    for name, look in zip(found, style.SEVERAL, strict=False):
        costs = found[name]
        dashed = look | {"linestyle": (0, (3.2, 1.4))}
        if name in ("DBO", "PI"):
            axes.plot(COUNTS, [one.forward for one in costs], label=name, **look)
        axes.plot(
            COUNTS, [one.inverse for one in costs], label=f"{name} inverse", **dashed
        )
    axes.set(xscale="log", yscale="log", xlabel="Gears or plays", ylabel="ns a sample")
    label_decades(axes.xaxis)
    label_decades(axes.yaxis)
    mark_curves(axes)


def paint_cycles(found: dict[tuple[int, float], list[float]], axes: Any) -> None:
    """Draw how many times faster the inverse is against samples a cycle."""
    from dbo_cli.reports import drawing as style
    from dbo_cli.reports.figures import label_decades, mark_curves

    for ((n, noise), ratios), look in zip(found.items(), style.SEVERAL, strict=False):
        dashed = {"linestyle": (0, (3.2, 1.4))} if noise else {}
        said = f"n = {n}, noise {noise:g}" if noise else f"n = {n}"
        axes.plot(CYCLES, ratios, label=said, **(look | dashed))
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="Samples a cycle",
        ylabel="PI inverse over DBO inverse",
    )
    label_decades(axes.xaxis)
    label_decades(axes.yaxis)
    mark_curves(axes, columns=2)


def save_figures(
    folder: Path,
    counts: dict[str, list[Cost]],
    cycles: dict[tuple[int, float], list[float]],
) -> None:
    """Write both figures as SVG."""
    from dbo_cli.reports import drawing as style
    from dbo_cli.reports.drawing import Plot, draw

    folder.mkdir(parents=True, exist_ok=True)
    plots: Sequence[Plot] = (
        Plot(
            "cost",
            "Cost against n",
            "ns a sample",
            style.TALL,
            partial(paint_counts, counts),
            head=0.34,
        ),
        Plot(
            "cost-cycle",
            "Ratio",
            "times faster",
            style.TALL,
            partial(paint_cycles, cycles),
            head=0.34,
        ),
    )
    for plot in plots:
        (folder / f"{plot.key}.svg").write_bytes(draw(plot, "svg"))


def main() -> int:
    """Print the tables; 1 where a claim does not hold."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--samples", type=int, default=200_000)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument(
        "--figures", type=Path, help="folder for cost.svg and cost-cycle.svg"
    )
    given = parser.parse_args()
    print(f"kernel: {kernel.KIND}\n")
    counts = against_count(given.samples, given.repeats)
    cycles = against_cycle(given.samples, given.repeats)
    if given.figures is not None:
        save_figures(given.figures, counts, cycles)
    holds = True
    print()
    for n, least in CLAIMS.items():
        place = COUNTS.index(n)
        ratio = counts["PI"][place].inverse / counts["DBO"][place].inverse
        holds &= ratio >= least
        print(
            f"inverse at n = {n}: {ratio:.1f} times faster than PI's (at least {least:g} wanted)"
        )
    return verdict(holds)


if __name__ == "__main__":
    raise SystemExit(main())
