"""Exports of ten identified models over 10^6 samples of random moves: errors against their derived bounds.

    python benchmarks/export_bounds.py [--samples N] [--models N] [--flood N]

Ten simulated recordings (invented_actuators.py) are identified, everything automatic;
each model is exported both ways in double, float and q31. float and q31 must stay
within their bounds, reduced to 12 gears the lookup table must give the bits of the
recursion. --flood N plays N random samples with NaN and infinities among them under the
address and undefined-behaviour sanitizers. Needs a C compiler.
"""

from __future__ import annotations

import argparse
import itertools
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [
    str(ROOT / "tests"),
    str(ROOT / "tests" / "extras"),
    str(ROOT / "benchmarks"),
]

from compiling import COMPILERS, SANITIZERS  # noqa: E402
from exported import as_given, compiled, in_units, random_moves  # noqa: E402
from invented_actuators import cases  # noqa: E402

from dbo_cli.errors import ModelError  # noqa: E402
from dbo_cli.extras.export.export import export_model  # noqa: E402
from dbo_cli.hysteresis.identification import IdentificationOptions, identify  # noqa: E402
from dbo_cli.hysteresis.model import ActuatorModel  # noqa: E402

# samples from one start: once gears differ, a model with memory remembers that
RUN = 5000

FLOOD = """
#include "x.h"
#include <stdio.h>
int main(void) {
    x_state s;
    uint64_t seed = 1;
    unsigned long finite = 0;
    x_init(&s);
    for (unsigned long k = 0; k < COUNTul; k++) {
        union { uint64_t u; double d; } wide;
        union { uint32_t u; float f; int32_t i; } narrow;
        NUMBER in, out;
        seed ^= seed << 13, seed ^= seed >> 7, seed ^= seed << 17;
        wide.u = seed;
        narrow.u = (uint32_t)(seed >> 17);
        in = PICK;
        if (k % 3 == 0 && BETWEEN) in = (NUMBER)(LOW + (HIGH - LOW) * (double)(seed % 1000003u) / 1000003.0);
        if (k % 100000 == 0) x_reset(&s, (NUMBER)0);
        out = x_step(&s, in);
        finite += out - out == 0;
    }
    printf("%lu\\n", finite);
    return 0;
}
"""


def identified(count: int) -> list[tuple[str, ActuatorModel, float]]:
    """Return name, model and sample rate of the first cases."""
    found = []
    for case in itertools.islice(cases(), count):
        seconds = case.test.seconds()
        rate = round((len(seconds) - 1) / float(seconds[-1]), 6)
        found.append(
            (case.name, identify(case.logs, IdentificationOptions()).model, rate)
        )
    return found


def compare(
    model: ActuatorModel, rate: float, direction: Any, arithmetic: Any, samples: int
) -> str:
    """Return errors beside bounds, in % of the output's range."""
    turned = model.inverse() if direction == "inverse" else model
    source, result = turned.input, turned.output
    with tempfile.TemporaryDirectory() as name:
        play = {}
        for kind in ("double", arithmetic):
            folder = Path(name) / kind
            summary = export_model(
                model,
                str(folder),
                name="x",
                direction=direction,
                arithmetic=kind,
                sample_rate=rate,
            )
            play[kind] = compiled(folder, "x", kind, summary.gears)
        same = every = differing = 0.0
        for k in range(samples // RUN):
            moves = random_moves(
                np.random.default_rng(k), source.minimum, source.maximum, RUN
            )
            taken, seen = as_given(moves, source, arithmetic)
            (exact, gears), (y, others) = play["double"](seen), play[arithmetic](taken)
            error = np.abs(in_units(y, result, arithmetic) - exact)
            always = np.logical_and.accumulate(gears == others)
            differing += float(np.count_nonzero(gears != others))
            same, every = (
                max(same, float(error[always].max(initial=0.0))),
                max(every, float(error.max())),
            )
    bounds = summary.bounds
    verdict = (
        "ok"
        if same <= bounds["same_gears"] and every <= bounds["after_close_turn"]
        else "BEYOND"
    )
    percent = [
        100.0 * v / result.span
        for v in (same, bounds["same_gears"], every, bounds["after_close_turn"])
    ]
    return (
        f"{summary.gears:5} {direction:8} {arithmetic:6} {percent[0]:9.2e} {percent[1]:9.2e}"
        f" {percent[2]:9.2e} {percent[3]:9.2e} {100.0 * differing / samples:8.3f}  {verdict}"
    )


def lookup_equals(model: ActuatorModel, rate: float, samples: int) -> bool:
    """Return whether the lookup table of 12 gears gives the bits of the recursion."""
    outputs = []
    moves = random_moves(
        np.random.default_rng(0), model.output.minimum, model.output.maximum, samples
    )
    with tempfile.TemporaryDirectory() as name:
        for lookup in (True, False):
            folder = Path(name) / str(lookup)
            export_model(
                model,
                str(folder),
                name="x",
                sample_rate=rate,
                gears=12,
                lookup=lookup,
                shared=True,
            )
            from test_export_host import run_flat

            outputs.append(run_flat(folder, "x", moves, None).tobytes())
    return outputs[0] == outputs[1]


def flood(model: ActuatorModel, rate: float, arithmetic: Any, count: int) -> str:
    """Play anything at all under the sanitizers; return how many outputs were numbers."""
    number = {"double": "double", "float": "float", "q31": "int32_t"}[arithmetic]
    pick = {"double": "wide.d", "float": "narrow.f", "q31": "narrow.i"}[arithmetic]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "x"
        export_model(
            model, str(folder), name="x", arithmetic=arithmetic, sample_rate=rate
        )
        text = (
            FLOOD.replace("COUNT", str(count))
            .replace("NUMBER", number)
            .replace("PICK", pick)
        )
        text = text.replace("BETWEEN", str(int(arithmetic != "q31")))
        text = text.replace("LOW", repr(model.output.minimum)).replace(
            "HIGH", repr(model.output.maximum)
        )
        (folder / "flood.c").write_text(text)
        subprocess.run(
            [COMPILERS[0], "-std=c99", "-ffp-contract=off", *SANITIZERS, "flood.c", "x.c", "dbo_kernel.c",
             "-o", "f"],
            cwd=folder, check=True,
        )  # fmt: skip
        done = subprocess.run(
            ["./f"], cwd=folder, capture_output=True, text=True, check=False
        )
    if done.returncode != 0:
        raise SystemExit(f"{arithmetic}: {done.stderr[:2000]}")
    return f"{arithmetic}: {int(done.stdout):,} of {count:,} outputs are finite, sanitizers silent"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=1_000_000)
    parser.add_argument("--models", type=int, default=10)
    parser.add_argument("--flood", type=int, default=0)
    options = parser.parse_args()
    models = identified(options.models)
    print("errors and bounds in % of the output's range; gears differ: % of samples")
    print(
        "model                   gears direction        same     bound       any     bound   differ"
    )
    beyond = False
    for name, model, rate in models:
        for direction in ("inverse", "forward"):
            for arithmetic in ("float", "q31"):
                try:
                    told = compare(model, rate, direction, arithmetic, options.samples)
                except (
                    ModelError
                ) as problem:  # what the arithmetic cannot hold is refused
                    told = f"{direction} {arithmetic}: {problem}"
                beyond |= "BEYOND" in told
                print(f"{name:22} {told}", flush=True)
        equal = lookup_equals(model, rate, options.samples)
        beyond |= not equal
        print(
            f"{name:22} lookup of 12 gears {'equals' if equal else 'DIFFERS FROM'} the recursion",
            flush=True,
        )
    if options.flood:
        for arithmetic in ("double", "float", "q31"):
            print(
                flood(models[0][1], models[0][2], arithmetic, options.flood), flush=True
            )
    if beyond:
        raise SystemExit("a bound does not hold")


if __name__ == "__main__":
    main()
