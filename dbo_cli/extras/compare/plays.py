"""The Prandtl-Ishlinskii operator and its descendants: weighted sums of plays, forward and inverse.

All of them are y = g(x) + Σ w_i z_i with z_i = max(x − r_i, min(x + r_i, z_i))
(one-sided: max(x − r_i, min(x, z_i))), on a drive scaled to the operator's range (−1 to
1; one-sided 0 to 1). Sources, numbered as in Aye and Ang (2018); what is marked * was
written from memory of the literature and not checked against it:

- [6] Kuhnen (2003): plays, w_i ≥ 0, and the inverse in closed form, w'_0 = 1/w_0, w'_i
  = −w_i/(W_i W_{i−1}), r'_i = Σ_{j≤i} w_j (r_i − r_j), z'_i = W_i z_i + Σ_{j>i} w_j
  z_j, W_i = Σ_{j≤i} w_j.
- [7] Ang, Khosla and Riviere (2007): W_i(ẋ) = W_i(0) + c_i |ẋ|. *The magnitude (a
  signed rate would make rising and falling branches differ) and weights that stay
  beyond the fastest rate are this program's own.
- [8] Tan et al. (2009): where slopes W_i of the first plays are not above 0, z = y + c
  x, c > −min W_i, is inverted and x recovered. *Here x = Γ_c⁻¹(y + c x) is carried to
  its limit: from where the drive stands it goes towards the wanted y until that is
  reached (see ``dbo_plays.c``), the same for every such c.
- [9] Jiang et al. (2010) use one-sided operators; their equations were not to be had.
  In their place *Gu et al. (2014): y = a₁ x³ + a₂ x + Σ p_i F_i, F_i one-sided plays.
"""

from __future__ import annotations

import math
import operator
import sys
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import ArrayLike

from dbo_cli.errors import ModelError
from dbo_cli.hysteresis import kernel
from dbo_cli.hysteresis.cascade import OtherHysteresis
from dbo_cli.hysteresis.model_file import relaxation_values
from dbo_cli.hysteresis.operators import (
    Axis,
    BacklashState,
    Floats,
    OutputLimits,
    Relaxation,
)

Memory = tuple[float, ...] | None  # of relaxation; None: at rest at the sample to come
Kind = Literal["plays", "rate-plays", "singular-plays", "one-sided-plays"]
KINDS: tuple[Kind, ...] = get_args(Kind)
NOTHING: Floats = np.empty(0)
# chosen: a thousand times what the fit offers; bounds what a file may ask for
MOST_PLAYS = 100_000
FLATTEST = 1e-9  # of the largest weight, where a slope must be above 0 for an inverse
# a bound: so many threefold steps pass any range, so many halvings leave 1e-60 of it
HALVINGS = 200
LANES = 8  # plays that the kernel adds up side by side, one order of summing for all
MOST_STEPS = 64  # of Newton's method and of halving, in the kernel


# ---- the readable twin of dbo_plays.c: the same arguments, the same bits.
#
# Every floating-point operation is written in the same order in both; sums run over
# lanes of ``LANES`` plays. The rows of ``table`` are up, down, weight and, where
# weights depend on the rate, by_rate, padded to whole groups of lanes; ``curve`` is
# empty or (cubic, linear). See ``dbo_plays.h`` for their meaning.


def _follow(table: Floats, z: Floats, v: float) -> None:
    """Move all plays to the input."""
    low, high = v - table[0], v + table[1]
    clipped = np.where(z > high, high, z)
    z[:] = np.where(clipped < low, low, clipped)


def _weighted(table: Floats, z: Floats, share: float) -> float:
    weight = table[2]
    if len(table) > 3:
        weight = weight + share * table[3]
    total = np.zeros(LANES)
    for group in (weight * z).reshape(-1, LANES):
        total = total + group
    s: list[float] = total.tolist()
    return ((s[0] + s[1]) + (s[2] + s[3])) + ((s[4] + s[5]) + (s[6] + s[7]))


def _curve(curve: Floats, x: float) -> float:
    cubic, linear = float(curve[0]), float(curve[1])
    if x <= 0.0:
        return linear * x
    if x >= 1.0:
        return (cubic + linear) + (3.0 * cubic + linear) * (x - 1.0)
    return (cubic * (x * x) + linear) * x


def _curve_slope(curve: Floats, x: float) -> float:
    cubic, linear = float(curve[0]), float(curve[1])
    if x <= 0.0:
        return linear
    if x >= 1.0:
        return 3.0 * cubic + linear
    return 3.0 * cubic * (x * x) + linear


def plays_run(
    n: int, table: Floats, curve: Floats, z: Floats, x: Floats, y: Floats, share: Floats
) -> None:
    """Fill ``y`` with the output for ``x``; ``z`` becomes the state after it."""
    shares = share.tolist() if share.size else [0.0] * x.size
    for k, v in enumerate(x.tolist()):
        _follow(table, z, v)
        y[k] = _weighted(table, z, shares[k])
        if curve.size:
            y[k] = float(y[k]) + _curve(curve, v)


def plays_rows(n: int, table: Floats, z: Floats, x: Floats, rows: Floats) -> None:
    """Fill ``rows`` (samples × n) with the plays themselves; ``z`` becomes the state after them."""
    for k, v in enumerate(x.tolist()):
        _follow(table, z, v)
        rows[k] = z[:n]


def _on_curve(curve: Floats, at: float, slope: float, wanted: float) -> float:
    """Return where curve(x) - curve(at) + slope (x - at) = wanted, going from ``at`` towards it."""
    begin = _curve(curve, at)
    step = wanted / (slope + _curve_slope(curve, at))
    near, far = at, at + step
    for _ in range(MOST_STEPS):
        missing = wanted - ((_curve(curve, far) - begin) + slope * (far - at))
        passed = missing <= 0.0 if wanted > 0.0 else missing >= 0.0
        if passed:
            break
        near = far
        step = step + step
        far = at + step
    x = far
    for _ in range(MOST_STEPS):
        missing = wanted - ((_curve(curve, x) - begin) + slope * (x - at))
        if missing == 0.0:
            break
        short = missing > 0.0 if wanted > 0.0 else missing < 0.0
        if short:
            near = x
        else:
            far = x
        following = x + missing / (slope + _curve_slope(curve, x))
        if not min(near, far) < following < max(near, far):
            following = near + 0.5 * (far - near)
        if following == x:
            break
        x = following
    return x


def _solved(
    n: int, table: Floats, curve: Floats, z: Floats, y: float, share: float
) -> float:
    """Return the input at which the output is ``y``."""
    places: list[float] = z[:n].tolist()
    up, down, weight = (row[:n].tolist() for row in table[:3])
    by_rate: list[float] = table[3, :n].tolist() if len(table) > 3 else []
    at = places[0]
    reached = _weighted(table, z, share)
    if curve.size:
        reached = reached + _curve(curve, at)
    if y == reached:
        return at
    rising = y > reached
    slope: float = weight[0]
    if by_rate:
        slope = slope + share * by_rate[0]
    for i in range(1, n):
        if rising:
            edge = max(places[i] + up[i], at)
        else:
            edge = min(places[i] - down[i], at)
        gained = slope * (edge - at)
        if curve.size:
            gained = gained + (_curve(curve, edge) - _curve(curve, at))
        gained = reached + gained
        enough = gained >= y if rising else gained <= y
        if enough:
            break
        reached = gained
        at = edge
        slope = slope + weight[i]
        if by_rate:
            slope = slope + share * by_rate[i]
    if curve.size:
        return _on_curve(curve, at, slope, y - reached)
    return at + (y - reached) / slope


def plays_solve(
    n: int,
    table: Floats,
    curve: Floats,
    z: Floats,
    y: Floats,
    x: Floats,
    share: Floats,
    limited: bool,
    low: float,
    high: float,
    slack: float,
    step: Floats,
    last: float,
) -> tuple[int, int]:
    """Fill ``x`` with the input whose output is ``y``; return how many were clipped, and the first."""
    shares = share.tolist() if share.size else [0.0] * y.size
    clipped = first = 0
    for k, value in enumerate(y.tolist()):
        wanted = v = _solved(n, table, curve, z, value, shares[k])
        if limited:
            if step.size and not math.isnan(last):
                most = float(step[k if step.size > 1 else 0])
                v = min(v, last + most)
                v = max(v, last - most)
            v = min(v, high)
            v = max(v, low)
            if abs(v - wanted) > slack:
                if not clipped:
                    first = k
                clipped += 1
        _follow(table, z, v)
        x[k] = last = v
    return clipped, first


# ---- the operator


def _kernel() -> Any:
    """Return the compiled plays, or their readable twin, this module, where the Python kernel was chosen."""
    if kernel.CHOSEN is kernel.PythonKernel:
        return sys.modules[__name__]
    return kernel.CHOSEN


@dataclass(frozen=True)
class PlayState(BacklashState):
    """Where the plays stand, in the scaled drive; play 0 is the last input.

    Attributes
    ----------
    plays : tuple of float
        z_i.
    inverse_plays : tuple of float, or None
        z'_i of the inverse in closed form, while one runs, so that going on changes no
        bit.
    wanted : float, or None
        The last output that an inverse was asked for; its rate is taken from there.
    """

    plays: tuple[float, ...] = ()
    inverse_plays: tuple[float, ...] | None = None
    wanted: float | None = None

    def to_json_dict(self) -> dict[str, object]:
        """Return the state as plain JSON values."""
        values: dict[str, object] = {
            "places": list(self.plays),
            "inverse_places": None,
            "wanted": self.wanted,
        }
        if self.inverse_plays is not None:
            values["inverse_places"] = list(self.inverse_plays)
        if self.memory is not None:
            values["memory"] = list(self.memory)
        return values


@dataclass(frozen=True, eq=False)
class PlayOperator(OtherHysteresis):
    """A weighted sum of plays, one of four kinds.

    Parameters
    ----------
    kind : {"plays", "rate-plays", "singular-plays", "one-sided-plays"}
        [6], [7], [8] and Gu's form of [9].
    radii : array_like
        r_i, in the scaled drive: 0 first, growing, below 1.
    weights : array_like
        w_i, output per unit of scaled drive.
    by_rate : array_like, optional
        Of [7]: what is added to each weight at the fastest rate.
    fastest : float, optional
        Of [7]: the rate of the scaled drive (1/s) at which all of ``by_rate`` is added;
        beyond it no more is.
    cubic, linear : float
        Of [9]: a₁ and a₂; beyond the range the curve goes straight on.
    relaxation : Relaxation, optional
        Of [6]: lag and creep beside the plays, as beside the gears; it follows the
        scaled drive.
    inverted : bool
        As it stands in an inverse model.

    Raises
    ------
    ModelError
        The numbers are not finite, not in order, or leave no inverse; the message
        begins with the key.
    """

    kind: Kind
    radii: Floats
    weights: Floats
    by_rate: Floats = field(default_factory=lambda: NOTHING)
    fastest: float = 0.0
    cubic: float = 0.0
    linear: float = 0.0
    relaxation: Relaxation | None = None
    inverted: bool = False

    def __post_init__(self) -> None:
        """Check the numbers."""
        for key in ("radii", "weights", "by_rate"):
            values = np.array(getattr(self, key), dtype=np.float64).reshape(-1)
            values.flags.writeable = False
            object.__setattr__(self, key, values)
            for i in np.flatnonzero(~np.isfinite(values))[:1]:
                raise ModelError(
                    f"{key}[{i}]: {float(values[i])!r} is not a finite number"
                )
        for key in ("cubic", "linear", "fastest"):
            if not np.isfinite(getattr(self, key)):
                raise ModelError(
                    f"{key}: {getattr(self, key)!r} is not a finite number"
                )
        self._check_lengths()
        self._check_slopes()

    def _check_lengths(self) -> None:
        radii, n = self.radii, self.radii.size
        if n == 0 or n > MOST_PLAYS:
            raise ModelError(
                f"radii: has {n:,} entries, and there must be 1 to {MOST_PLAYS:,}"
            )
        if radii[0] != 0.0 or not (np.diff(radii) > 0.0).all() or not radii[-1] < 1.0:
            raise ModelError("radii: must begin with 0, grow, and stay below 1")
        if self.weights.size != n:
            raise ModelError(
                f"weights: has {self.weights.size} entries where radii has {n}"
            )
        if self.by_rate.size != (n if self.kind == "rate-plays" else 0):
            raise ModelError(
                f"by_rate: has {self.by_rate.size} entries where radii has {n}"
            )
        if self.kind == "rate-plays" and not self.fastest > 0.0:
            raise ModelError(f"fastest: {self.fastest!r} is not a rate above 0")
        if self.relaxation is not None and self.kind != "plays":
            raise ModelError("relaxation: stands beside plays of the first kind alone")

    def _check_slopes(self) -> None:
        """Refuse what has no inverse: W_i must be above 0, with [8] the last one alone."""
        least = FLATTEST * float(np.abs(self.weights).max())
        ends = (self.linear, 3.0 * self.cubic + self.linear)
        slopes = np.cumsum(self.weights) + min(ends)
        slopes = (
            np.minimum(slopes, slopes + np.cumsum(self.by_rate))
            if self.by_rate.size
            else slopes
        )
        if self.kind == "singular-plays":
            slopes = slopes[-1:]
        if not (slopes > least).all():
            raise ModelError(
                f"weights: the slope is {float(slopes.min())!r} somewhere, and must be above 0"
            )

    @property
    def n(self) -> int:
        """Number of plays."""
        return int(self.radii.size)

    @property
    def one_sided(self) -> bool:
        """Whether the plays give way on one side alone."""
        return self.kind == "one-sided-plays"

    @property
    def low(self) -> float:
        """Lower end of the scaled drive; the upper one is 1."""
        return 0.0 if self.one_sided else -1.0

    def inverse(self) -> PlayOperator:
        """Return the same operator as it stands in a model of the other direction."""
        return replace(self, inverted=not self.inverted)

    def file_values(self) -> dict[str, Any]:
        """Return the stage as the model file has it (docs/model-file.md)."""
        lists = {"radii": self.radii.tolist(), "weights": self.weights.tolist()}
        values: dict[str, Any] = {"type": self.kind, **lists}
        if self.kind == "rate-plays":
            values |= {"by_rate": self.by_rate.tolist(), "fastest": self.fastest}
        if self.one_sided:
            values |= {"cubic": self.cubic, "linear": self.linear}
        axis: Axis = "output" if self.inverted else "input"
        beside = relaxation_values(self.relaxation, axis)
        if beside is not None:
            values["relaxation"] = beside
        return values

    @cached_property
    def table(self) -> Floats:
        """The kernel's rows: up, down, weight and by_rate, padded to whole groups of lanes."""
        down = np.zeros(self.n) if self.one_sided else self.radii
        rows = [self.radii, down, self.weights]
        if self.by_rate.size:
            rows.append(self.by_rate)
        table = np.zeros((len(rows), -(-self.n // LANES) * LANES))
        table[:2] = np.inf
        table[:, : self.n] = rows
        return table

    @cached_property
    def curve(self) -> Floats:
        """The kernel's (cubic, linear), or nothing."""
        if not self.one_sided:
            return NOTHING
        return np.array([self.cubic, self.linear])

    def settled(self, x: float) -> Floats:
        """Return the plays after an oscillation that decays from the whole range to ``x``."""
        up, down = self.table[0, : self.n], self.table[1, : self.n]
        return np.clip(x + 0.5 * (down - up), self.low + down, 1.0 - up)

    def after(self, x: float) -> Floats:
        """Return the plays after the drive came to ``x``, an end of its range, from the other one."""
        up, down = self.table[0, : self.n], self.table[1, : self.n]
        return x + down if x <= self.low else x - up

    def _padded(self, plays: ArrayLike) -> Floats:
        z = np.zeros(self.table.shape[1])
        z[: self.n] = plays
        return z

    def run(
        self, x: Floats, plays: Floats, share: Floats = NOTHING
    ) -> tuple[Floats, Floats]:
        """Return the output for a block of scaled drive, and the plays after it; ``share`` of ``by_rate``."""
        z, y = self._padded(plays), np.empty_like(x)
        _kernel().plays_run(self.n, self.table, self.curve, z, x, y, share)
        return y, z[: self.n]

    def rows(self, x: Floats, plays: Floats) -> tuple[Floats, Floats]:
        """Return the plays in every sample, shape (samples, n), and after the block."""
        z, out = self._padded(plays), np.empty((x.size, self.n))
        _kernel().plays_rows(self.n, self.table, z, x, out)
        return out, z[: self.n]

    def solve(
        self,
        y: Floats,
        plays: Floats,
        share: Floats = NOTHING,
        bounds: OutputLimits | None = None,
        last: float | None = None,
    ) -> tuple[Floats, Floats, tuple[int, int]]:
        """Return the scaled drive whose output is ``y``, the plays after it, and what was clipped.

        Exact for every kind; ``run`` of the result with the same ``share`` gives ``y``
        back to rounding.
        """
        z, x = self._padded(plays), np.empty_like(y)
        bound = bounds or OutputLimits()
        step = NOTHING
        if bound.step is not None:
            step = np.array(bound.step, dtype=np.float64).reshape(-1)
        clipped = _kernel().plays_solve(
            self.n, self.table, self.curve, z, y, x, share, bounds is not None, bound.low, bound.high,
            bound.slack, step, np.nan if last is None else last,
        )  # fmt: skip
        return x, z[: self.n], clipped

    def remembered(
        self, x: Floats, memory: Memory, steps: float | Floats
    ) -> tuple[Floats, Memory]:
        """Return what relaxation adds to the output for a block of scaled drive, and its memory after it."""
        total = np.zeros(x.size)
        if self.relaxation is None:
            return total, None
        lags, memory = self.relaxation.lags(x, steps, memory)
        for gain, lag in zip(self.relaxation.gain, lags.T, strict=True):
            total += gain * lag
        return total, memory

    def solve_beside(
        self,
        y: Floats,
        begun: PlayState,
        steps: float | Floats,
        bounds: OutputLimits,
        last: float | None,
    ) -> tuple[Floats, PlayState, tuple[int, int]]:
        """Return what ``solve`` does where relaxation stands beside the plays.

        One sample after the other: L_j = a_j L_j + (1 - a_j)(x - reference), so what is
        remembered is taken off, and what the drive x of this very sample adds, Σ gain_j
        (1 - a_j) x, is weight of play 0, which is x. As beside the gears, the equation
        stays monotone and straight between the plays' edges.
        """
        terms, z, x = self.relaxation, self._padded(begun.plays), np.empty_like(y)
        assert terms is not None
        table = np.vstack((self.table, np.arange(z.size) == 0))
        rows = np.broadcast_to(terms.decay(steps), (y.size, len(terms.tau))).tolist()
        memories = list(begun.memory or [0.0] * len(terms.tau))
        if begun.memory is None:
            rows[0] = [0.0] * len(memories)  # at rest at the first sample
        most = NOTHING
        if bounds.step is not None:
            most = np.broadcast_to(bounds.step, y.shape).copy()
        before = math.nan if last is None else last
        clipped = first = 0
        for k, (wanted, decays) in enumerate(zip(y.tolist(), rows, strict=True)):
            past = [a * memory for a, memory in zip(decays, memories, strict=True)]
            share = sum(
                gain * (1.0 - a) for gain, a in zip(terms.gain, decays, strict=True)
            )
            wanted += share * terms.reference - sum(map(operator.mul, terms.gain, past))
            limited, _ = _kernel().plays_solve(
                self.n, table, NOTHING, z, np.array([wanted]), x[k : k + 1], np.array([share]), True,
                bounds.low, bounds.high, bounds.slack, most[k : k + 1], before,
            )  # fmt: skip
            if limited and not clipped:
                first = k
            clipped += limited
            before = float(x[k])
            memories = [
                memory + (1.0 - a) * (before - terms.reference)
                for a, memory in zip(decays, past, strict=True)
            ]
        after = PlayState(0, tuple(memories), tuple(z[: self.n].tolist()))
        return x, after, (clipped, first)

    def slow_output(self, x: float, plays: Floats) -> float:
        """Return the output for one input that comes slowly."""
        still, drive = np.zeros(1) if self.by_rate.size else NOTHING, np.array([x])
        return float(
            self.run(drive, plays, still)[0][0]
            + self.remembered(drive, None, 0.0)[0][0]
        )

    @cached_property
    def ends(self) -> tuple[float, float]:
        """The slow output at the ends of the drive's range, each come to from the other."""
        low, high = (self.slow_output(end, self.after(end)) for end in (self.low, 1.0))
        return low, high

    def settled_at(self, y: float) -> float:
        """Return the drive whose own settled state gives the output ``y``, by halving."""
        below, above = self.low - 1.0, 2.0
        for _ in range(HALVINGS):
            if self.slow_output(below, self.settled(below)) <= y:
                break
            below -= 2.0 * (above - below)
        for _ in range(HALVINGS):
            if self.slow_output(above, self.settled(above)) >= y:
                break
            above += 2.0 * (above - below)
        for _ in range(HALVINGS):
            middle = below + 0.5 * (above - below)
            if not below < middle < above:
                break
            if self.slow_output(middle, self.settled(middle)) < y:
                below = middle
            else:
                above = middle
        return above

    @cached_property
    def closed_inverse(self) -> ClosedInverse:
        """The inverse of [6] in closed form; of plays of the first kind alone."""
        sums = np.cumsum(self.weights)
        primed = np.append(1.0 / sums[0], -self.weights[1:] / (sums[1:] * sums[:-1]))
        reach = sums * self.radii - np.cumsum(self.weights * self.radii)
        table = np.zeros((3, self.table.shape[1]))
        table[:2] = np.inf
        table[:, : self.n] = reach, reach, primed
        return ClosedInverse(self.weights, sums, table)


class ClosedInverse(NamedTuple):
    """The inverse of [6]: again plays, with r'_i, w'_i, and states z'_i on the side of the output."""

    weights: Floats
    sums: Floats
    table: Floats

    def states_of(self, plays: Floats) -> Floats:
        """Return z'_i = W_i z_i + Σ_{j>i} w_j z_j."""
        beyond = np.append(np.cumsum((self.weights * plays)[::-1])[::-1][1:], 0.0)
        states: Floats = self.sums * plays + beyond
        return states

    def plays_of(self, states: Floats) -> Floats:
        """Return the z_i of states z'_i."""
        plays = np.empty(states.size, dtype=np.float64)
        beyond = 0.0
        for i in range(states.size - 1, -1, -1):
            plays[i] = (float(states[i]) - beyond) / float(self.sums[i])
            beyond += float(self.weights[i] * plays[i])
        return plays

    def run(self, y: Floats, states: Floats) -> tuple[Floats, Floats]:
        """Return the scaled drive for a block of output, and the states after it."""
        z, x = np.zeros(self.table.shape[1]), np.empty_like(y)
        z[: states.size] = states
        _kernel().plays_run(states.size, self.table, NOTHING, z, y, x, NOTHING)
        return x, z[: states.size]
