"""The Prandtl-Ishlinskii operator and its descendants: weighted sums of plays, forward and inverse.

All are y = g(x) + sum w_i z_i with z_i = max(x - r_i, min(x + r_i, z_i)) (one-sided:
max(x - r_i, min(x, z_i))), on a drive scaled to -1..1 (one-sided: 0..1). Sources,
numbered as in Aye and Ang (2018); what is marked * was written from memory of the
literature and not checked against it:

- [6] Kuhnen (2003): plays, and the inverse in closed form, w'_0 = 1/w_0,
  w'_i = -w_i/(W_i W_{i-1}), r'_i = sum_{j<=i} w_j (r_i - r_j), z'_i = W_i z_i +
  sum_{j>i} w_j z_j, with W_i = sum_{j<=i} w_j.
- [7] Ang, Khosla and Riviere (2007): W_i(x') = W_i(0) + c_i |x'|. *The magnitude, and
  weights that stay beyond the fastest rate, are this program's own.
- [8] Tan et al. (2009): W_0 may be 0 or below; z = y + c x, c > -min W_i, is inverted
  and x recovered. *Here carried to its limit: the drive goes from where it stands
  towards the wanted y until that is reached, the same for every such c.
- [9] Jiang et al. (2010) use one-sided operators; their equations were not to be had.
  *In their place Gu et al. (2014): y = a x^3 + b x + sum p_i F_i, F_i one-sided plays.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import FitError
from dbo_cli.model import kernel

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Kind = Literal["plays", "rate", "singular", "one-sided"]
"""Plays as in [6]; weights by the rate [7]; first slopes free [8]; one-sided plays [9]."""

NOTHING: Floats = np.empty(0)
LANES = 8  # plays that the kernel adds up side by side: tables are padded to it
FLATTEST = 1e-9  # of the largest weight, where a slope must be above 0
BLOCK_ROWS = 16_384  # of plays in memory at a time


@dataclass(frozen=True, eq=False)
class Plays:
    """A weighted sum of plays.

    Attributes
    ----------
    kind
        Which of the four.
    radii : array of shape (n,)
        r_i on the scaled drive: 0 first, growing.
    weights : array of shape (n,)
        w_i, output per unit of scaled drive.
    by_rate : array of shape (n,)
        Of [7]: what is added to each weight at the fastest rate; else empty.
    fastest
        Of [7]: that rate of the scaled drive (1/s).
    cubic, linear
        Of [9]: a and b.

    Raises
    ------
    FitError
        A slope is not above 0, so that there is no inverse.
    """

    kind: Kind
    radii: Floats
    weights: Floats
    by_rate: Floats = field(default_factory=lambda: NOTHING)
    fastest: float = 0.0
    cubic: float = 0.0
    linear: float = 0.0

    def __post_init__(self) -> None:
        """Refuse weights that leave no inverse."""
        steepest = float(np.abs(self.weights).max())
        slopes = np.cumsum(self.weights)
        if self.kind == "singular":
            slopes = slopes[-1:]
        slopes = slopes + min(self.linear, 3.0 * self.cubic + self.linear)
        if self.by_rate.size:
            slopes = np.minimum(slopes, slopes + np.cumsum(self.by_rate))
        if not (slopes > FLATTEST * steepest).all():
            raise FitError("the best fit has no inverse: one slope is not positive")

    @property
    def n(self) -> int:
        """Number of plays."""
        return int(self.radii.size)

    @property
    def low(self) -> float:
        """Lower end of the scaled drive; the upper one is 1."""
        return 0.0 if self.kind == "one-sided" else -1.0

    @cached_property
    def table(self) -> Floats:
        """The kernel's rows: up, down, weight and by_rate, padded to whole groups of lanes."""
        down = self.radii
        if self.kind == "one-sided":
            down = np.zeros(self.n)
        rows = [self.radii, down, self.weights]
        if self.by_rate.size:
            rows.append(self.by_rate)
        table = np.zeros((len(rows), _padded_count(self.n)))
        table[:2] = np.inf
        table[:, : self.n] = rows
        return table

    @cached_property
    def curve(self) -> Floats:
        """The kernel's (cubic, linear), or nothing."""
        if self.kind == "one-sided":
            return np.array([self.cubic, self.linear])
        return NOTHING

    def start(self, x: float) -> Floats:
        """Return the plays at the first drive: come from the other end at an end, else settled.

        Settled: after an oscillation that decays from the whole range to ``x``.
        """
        up, down = self.table[0, : self.n], self.table[1, : self.n]
        if x <= self.low:
            return x + down
        if x >= 1.0:
            return x - up
        settled: Floats = np.clip(x + 0.5 * (down - up), self.low + down, 1.0 - up)
        return settled

    def run(self, x: Floats, share: Floats = NOTHING) -> Floats:
        """Return the output for a scaled drive from its start; ``share`` of ``by_rate`` a sample."""
        z, y = _padded(self.start(float(x[0]))), np.empty_like(x)
        extension = kernel.require("compare")
        extension.plays_run(self.n, self.table, self.curve, z, x, y, share)
        return y

    def solve(self, y: Floats, first: float, share: Floats = NOTHING) -> Floats:
        """Return the scaled drive whose output is ``y``; it stands at ``first`` before."""
        z, x = _padded(self.start(first)), np.empty_like(y)
        extension = kernel.require("compare")
        rest = (share, False, 0.0, 0.0, 0.0, NOTHING, np.nan)
        extension.plays_solve(self.n, self.table, self.curve, z, y, x, *rest)
        return x

    def at(self, x: Floats, rows: Integers) -> Floats:
        """Return the plays themselves in some rows (increasing), shape (rows, n)."""
        z = _padded(self.start(float(x[0])))
        extension = kernel.require("compare")
        taken = []
        for begin in range(0, len(x), BLOCK_ROWS):
            block = x[begin : begin + BLOCK_ROWS]
            places = np.empty((len(block), self.n))
            extension.plays_rows(self.n, self.table, z, block, places)
            inside = rows[(rows >= begin) & (rows < begin + len(block))]
            taken.append(places[inside - begin])
        return np.concatenate(taken)

    def closed_inverse(self, y: Floats, first: float) -> Floats:
        """Return what ``solve`` does by the closed form of [6]: again plays, on the output's side.

        Of the kind "plays" alone.
        """
        z = self.start(first)
        sums = np.cumsum(self.weights)
        weights = np.append(1.0 / sums[0], -self.weights[1:] / (sums[1:] * sums[:-1]))
        reach = sums * self.radii - np.cumsum(self.weights * self.radii)
        beyond = np.append(np.cumsum((self.weights * z)[::-1])[::-1][1:], 0.0)
        table = np.zeros((3, _padded_count(self.n)))
        table[:2] = np.inf
        table[:, : self.n] = reach, reach, weights
        states, x = _padded(sums * z + beyond), np.empty_like(y)
        extension = kernel.require("compare")
        extension.plays_run(self.n, table, NOTHING, states, y, x, NOTHING)
        return x


def _padded_count(n: int) -> int:
    return -(-n // LANES) * LANES


def _padded(plays: Floats) -> Floats:
    z = np.zeros(_padded_count(len(plays)))
    z[: len(plays)] = plays
    return z
