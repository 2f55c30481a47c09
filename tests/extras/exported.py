"""Exported sources, compiled and called: what the tests and the benchmarks of the export share."""

from __future__ import annotations

import ctypes
import os
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
from compiling import WARNINGS, compile_c
from numpy.typing import NDArray

from dbo_cli.extras.export.single_code import counts_of_range
from dbo_cli.hysteresis.model import (
    ActuatorModel,
    PointStage,
    Quantity,
    Relaxation,
    ScaleStage,
)
from dbo_cli.hysteresis.operators import DiscreteBacklashOperator

TYPES: dict[str, Any] = {"double": np.float64, "float": np.float32, "q31": np.int32}


def cmake(folder: Path, *words: str) -> None:
    """Run cmake with the compiler itself: cmake asks it a dozen things, and keeps its own objects."""
    subprocess.run(
        ["cmake", *words],
        cwd=folder,
        env=os.environ | {"CC": "gcc"},
        check=True,
        capture_output=True,
    )


HARNESS = """
#include "NAME.h"
#include <stddef.h>
/* Outputs, and a number for the gears that are crossed after each sample. */
void play(const NUMBER *in, NUMBER *out, uint32_t *crossed, size_t count, int reset, NUMBER drive);
void play(const NUMBER *in, NUMBER *out, uint32_t *crossed, size_t count, int reset, NUMBER drive) {
    NAME_state state;
    if (reset) NAME_reset(&state, drive); else NAME_init(&state);
    for (size_t k = 0; k < count; k++) {
        uint32_t hash = 2166136261u;
        out[k] = NAME_step(&state, in[k]);
        size_t depth = state.gears.depth, end = 0;
        uint32_t bit = state.gears.set == 0;
        end = bit ? state.gears.zero : state.gears.set;
        for (size_t i = 0; i < GEARS; i++) {
            for (; i == end; bit = !bit) end = state.turns[--depth];
            hash = (hash ^ bit) * 16777619u;
        }
        crossed[k] = hash;
    }
}
"""


def compiled(
    folder: Path, name: str, arithmetic: str, gears: int, flags: tuple[str, ...] = ("-O2",),
    others: tuple[str, ...] = (),
) -> Any:  # fmt: skip
    """Return a function (inputs, reset drive or None) -> (outputs, hashes of the crossed gears)."""
    number = {"double": "double", "float": "float", "q31": "int32_t"}[arithmetic]
    text = (
        HARNESS.replace("NAME", name)
        .replace("NUMBER", number)
        .replace("GEARS", str(gears))
    )
    (folder / "harness.c").write_text(text)
    library = folder / "harness.so"
    sources = ["harness.c", f"{name}.c", "dbo_kernel.c", *others]
    compile_c(
        folder, *WARNINGS, *flags, "-shared", "-fPIC", *sources, "-o", str(library)
    )
    loaded = ctypes.CDLL(str(library))
    kind = np.ctypeslib.as_ctypes_type(TYPES[arithmetic])
    pointer = ctypes.c_void_p
    loaded.play.argtypes = [
        pointer,
        pointer,
        pointer,
        ctypes.c_size_t,
        ctypes.c_int,
        kind,
    ]
    loaded.play.restype = None

    def play(
        inputs: NDArray[Any], drive: Any = None
    ) -> tuple[NDArray[Any], NDArray[np.uint32]]:
        given = np.ascontiguousarray(inputs, dtype=TYPES[arithmetic])
        out, crossed = np.empty_like(given), np.empty(given.size, np.uint32)
        loaded.play(
            given.ctypes.data, out.ctypes.data, crossed.ctypes.data, given.size, drive is not None,
            0 if drive is None else drive,
        )  # fmt: skip
        return out, crossed

    return play


def made_model(
    seed: int,
    gears: int = 288,
    slopes: int = 48,
    terms: int = 3,
    points: int = 4,
    bend: bool = True,
    below: int = 0,
) -> ActuatorModel:
    """Return a model as identification makes them: even gears in runs of one slope, terms, points, scale.

    ``below`` gears to spare stand below the voltages, and as many above.
    """
    rng = np.random.default_rng(seed)
    top = float(rng.choice([1.0, 10.0, 100.0, 150.0]))
    growing = np.sort(rng.uniform(0.4, 1.6, slopes))
    heights = np.repeat(growing, -(-gears // slopes))[:gears]
    heights /= heights.sum()
    tau = tuple(sorted((10.0 ** rng.uniform(-2.5, 1.5, terms)).tolist()))
    gain = tuple((rng.uniform(0.005, 0.08, terms) / top).tolist())
    relaxation = Relaxation(0.0, tau, gain) if terms else None
    stages: list[Any] = []
    if bend:
        at = np.arange(9) / 8.0
        bent = at + 0.2 * at * (1.0 - at)
        stages.append(PointStage(np.diff(at) * top, np.diff(bent) * top, 0.0, 0.0))
    width = top / (gears - 2 * below)
    low = -below * width
    stages.append(
        DiscreteBacklashOperator(np.full(gears, width), heights, low, -0.01, relaxation)
    )
    if points:
        knots = rng.uniform(0.8, 1.2, points)
        stages.append(
            PointStage(
                1.2 * knots / knots.sum(), np.full(points, 1.2 / points), 0.0, 0.0
            )
        )
    sign = -1.0 if seed % 3 == 2 else 1.0
    stages.append(
        ScaleStage(sign * float(rng.uniform(2.0, 200.0)), float(rng.normal()))
    )
    model = ActuatorModel(
        "forward",
        Quantity("voltage", "V", 0.0, top),
        Quantity("displacement", "um", 0.0, 1.0),
        tuple(stages),
    )
    ends = model.simulate([top, 0.0], model.start(top, "empty"), time_step=1e6).y
    return ActuatorModel(
        "forward", model.input,
        Quantity("displacement", "um", float(ends.min()), float(ends.max())), model.stages,
    )  # fmt: skip


def random_moves(
    rng: np.random.Generator, low: float, high: float, count: int
) -> NDArray[np.float64]:
    """Return ramps between random turning points at random speeds, holds and full-range turns among them."""
    turns = low + (high - low) * rng.uniform(0.0, 1.0, count // 20 + 2)
    turns[rng.integers(0, turns.size, turns.size // 15)] = high
    turns[rng.integers(0, turns.size, turns.size // 15)] = low
    lengths = rng.integers(1, 80, turns.size)
    knots = np.concatenate([[0], np.cumsum(lengths)])[: turns.size]
    return np.interp(np.arange(count), knots, turns)


def as_given(moves: Any, quantity: Quantity, arithmetic: str) -> tuple[Any, Any]:
    """Return moves as the arithmetic takes them, and what they then are."""
    if arithmetic == "double":
        return moves, moves
    if arithmetic == "float":
        given = moves.astype(np.float32)
        return given, given.astype(np.float64)
    middle, unit = counts_of_range(quantity)
    given = np.rint((moves - middle) / unit).astype(np.int32)
    return given, given * unit + middle


def in_units(y: Any, quantity: Quantity, arithmetic: str) -> Any:
    """Return outputs of the arithmetic in the quantity's unit."""
    middle, unit = counts_of_range(quantity)
    return (
        y.astype(np.float64) * unit + middle
        if arithmetic == "q31"
        else y.astype(np.float64)
    )
