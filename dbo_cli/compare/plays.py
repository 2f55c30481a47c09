"""The Prandtl-Ishlinskii operator and its descendants: weighted sums of plays, forward and inverse.

All are y = g(x) + sum w_i z_i with z_i = max(x - r_i, min(x + r_i, z_i)) (one-sided:
max(x - r_i, min(x, z_i))), on a drive scaled to 0..1. Sources, numbered as in Aye and
Ang (2018); what is marked * was written from memory of the literature and not checked
against it:

- [6] Kuhnen (2003): plays, and the inverse in closed form, w'_0 = 1/w_0,
  w'_i = -w_i/(W_i W_{i-1}), r'_i = sum_{j<=i} w_j (r_i - r_j), z'_i = W_i z_i +
  sum_{j>i} w_j z_j, with W_i = sum_{j<=i} w_j, the slope behind play i.
- [7] Ang, Khosla and Riviere (2007): W_i(x') = W_i(0) + c_i |x'|. *The magnitude, and
  weights that stay beyond the fastest rate, are this program's own.
- [8] Tan et al. (2009): W_0 may be 0 or below; z = y + c x, c > -min W_i, is inverted
  and x recovered. *Here carried to its limit: the drive goes from where it stands
  towards the wanted y until that is reached, the same for every such c.
- [9] Jiang et al. (2010) use one-sided operators; their equations were not to be had.
  *In their place Gu et al. (2014): y = a x^3 + b x + sum p_i F_i, F_i one-sided plays.
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from dbo_cli.arrays import Floats, Integers
from dbo_cli.model import kernel

EMPTY: Floats = np.empty(0)
PLAY_LANES = 8  # plays that the kernel adds up side by side: tables are padded to it
PLAY_ROWS = 16_384  # of plays in memory at a time


@dataclass(frozen=True, eq=False)
class Plays:
    """A weighted sum of plays on a drive that is scaled to 0..1.

    Attributes
    ----------
    radii : array of shape (n,)
        r_i: 0 first, growing.
    weights : array of shape (n,)
        w_i, output per unit of scaled drive.
    one_sided : bool
        Whether the plays are those of [9].
    by_rate : array of shape (n,)
        Of [7]: what is added to each weight at the fastest rate; else empty.
    curve : array of shape (2,)
        Of [9]: a and b; else empty.
    """

    radii: Floats
    weights: Floats
    one_sided: bool = False
    by_rate: Floats = field(default_factory=lambda: EMPTY)
    curve: Floats = field(default_factory=lambda: EMPTY)

    @cached_property
    def table(self) -> Floats:
        """The kernel's rows: up, down, weight and by_rate; to whole groups of lanes plays of weight 0."""
        down = self.radii
        if self.one_sided:
            down = np.zeros_like(self.radii)
        rows = [self.radii, down, self.weights]
        if self.by_rate.size:
            rows.append(self.by_rate)
        return np.pad(rows, ((0, 0), (0, -self.radii.size % PLAY_LANES)))

    def start(self, x: float) -> Floats:
        """Return the plays of the table at the first drive: come from the other end at an end, else settled.

        Settled: after an oscillation that decays from the whole range to ``x``.
        """
        up, down = self.table[:2]
        settled: Floats = np.clip(x + 0.5 * (down - up), down, 1.0 - up)
        if x <= 0.0:
            settled = x + down
        if x >= 1.0:
            settled = x - up
        return settled

    def run(self, x: Floats, share: Floats = EMPTY) -> Floats:
        """Return the output for a scaled drive from its start; ``share`` of ``by_rate`` a sample."""
        z, y, n = self.start(float(x[0])), np.empty_like(x), self.radii.size
        kernel.extension.plays_run(n, self.table, self.curve, z, x, y, share)
        return y

    def solve(self, y: Floats, first: float, share: Floats = EMPTY) -> Floats:
        """Return the scaled drive whose output is ``y``; it stands at ``first`` before."""
        z, x, n = self.start(first), np.empty_like(y), self.radii.size
        kernel.extension.plays_solve(n, self.table, self.curve, z, y, x, share)
        return x

    def closed_inverse(self, y: Floats, first: float) -> Floats:
        """Return what ``solve`` does by the closed form of [6]: again plays, on the output's side.

        For symmetric plays with weights that do not change.
        """
        z, (radii, _, w) = self.start(first), self.table
        sums = np.cumsum(w)
        weights = np.append(1.0 / sums[0], -w[1:] / (sums[1:] * sums[:-1]))
        reach = sums * radii - np.cumsum(w * radii)
        outer = np.append(np.cumsum((w * z)[:0:-1])[::-1], 0.0)
        table, state = np.stack([reach, reach, weights]), sums * z + outer
        x, n = np.empty_like(y), self.radii.size
        kernel.extension.plays_run(n, table, EMPTY, state, y, x, EMPTY)
        return x


def places(radii: Floats, one_sided: bool, x: Floats, rows: Integers) -> Floats:
    """Return plays under a scaled drive in some rows (increasing), shape (rows, n)."""
    plays = Plays(radii, np.ones_like(radii), one_sided)
    z = plays.start(float(x[0]))
    tables = []
    for begin in range(0, len(x), PLAY_ROWS):
        block = x[begin : begin + PLAY_ROWS]
        table = np.empty((len(block), radii.size))
        kernel.extension.plays_rows(radii.size, plays.table, z, block, table)
        inside = rows[(rows >= begin) & (rows < begin + len(block))]
        tables.append(table[inside - begin])
    return np.concatenate(tables)
