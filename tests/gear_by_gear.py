"""The kernel gear by gear: each transition of (6)-(9) is one of its own, and nothing is looked up.

Slow and plain, in float64, with the operations of ``kernel.py`` in their order, whose
other functions it takes: the bits that the compiled kernel and its twin must give.
``reference.py`` is the paper's procedure in rationals.
"""

from __future__ import annotations

import types
from collections.abc import Callable
from typing import Any

import numpy as np

from dbo_cli.hysteresis import kernel
from dbo_cli.hysteresis.kernel import Floats, Words, find_first_one, find_first_zero


class Walk:
    """The state on its way through a block: bits, S, Z, and X_B, Y_B relative to X_0, Y_0 (1)-(5)."""

    def __init__(self, gears: Floats, n: int, run: int, words: Words) -> None:
        rows: list[list[float]] = gears.tolist()
        self.gears = [rows[i // run] for i in range(n)]
        self.n, self.words = n, words
        self.bits = int.from_bytes(words.tobytes(), "little")
        self.x = self.y = 0.0
        for i in range(n):
            if self.bits >> i & 1:
                self.x += self.gears[i][0]
                self.y += self.gears[i][1]
        self.set, self.zero = find_first_one(self.bits, n), find_first_zero(self.bits)

    def gear(self, gear: int) -> list[float]:
        return self.gears[min(gear, self.n - 1)]

    def cross(self, rising: bool) -> None:
        """Go to the neighbour on the way: set b_Z (6)-(7), or clear b_S (8)-(9)."""
        gear, sign = (self.zero, 1.0) if rising else (self.set, -1.0)
        self.x += sign * self.gears[gear][0]
        self.y += sign * self.gears[gear][1]
        self.bits ^= 1 << gear
        self.set, self.zero = (
            find_first_one(self.bits, self.n),
            find_first_zero(self.bits),
        )

    def state(self) -> int:
        return self.bits

    def finish(self) -> None:
        content = self.bits.to_bytes(8 * len(self.words), "little")
        self.words[:] = np.frombuffer(content, dtype="<u8")


def travel(
    walk: Walk,
    u: float,
    kappa: float,
    low: float,
    high: float,
    tell: Callable[[int, int, float], None] | None = None,
) -> tuple[int, float, bool]:
    """Steps 1 to 4, one gear after the other; see ``kernel._travel``."""
    d = u - (walk.x + kappa * walk.y)
    rising = d >= 0.0
    last = walk.n
    while (gear := walk.zero if rising else walk.set) < walk.n:
        dx, dy, _, fraction, _, _ = walk.gears[gear]
        travelled, room = (d, high - walk.y) if rising else (-d, walk.y - low)
        if not (travelled >= (dx + kappa * dy) * fraction and room >= dy * fraction):
            break
        last = gear
        walk.cross(rising)
        if tell is not None:
            tell(gear, gear + 1, 1.0 if rising else -1.0)
        d = u - (walk.x + kappa * walk.y)
    return (
        (last if last < walk.n and (d < 0.0 if rising else d > 0.0) else gear),
        d,
        rising,
    )


def gear_by_gear() -> Any:
    """Return a copy of the Python twin's functions in which runs are not known."""
    copy = types.ModuleType("gear_by_gear")
    names = copy.__dict__
    names.update(vars(kernel), _Walk=Walk, _travel=travel)
    for name in (
        "_solve",
        "_follow_output",
        "_solve_within",
        "backlash_run",
        "backlash_engagement",
    ):
        function = vars(kernel)[name]
        names[name] = types.FunctionType(
            function.__code__, names, name, function.__defaults__
        )
    return copy
