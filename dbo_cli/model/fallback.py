"""The recursions of a model in Python, for an installation without the compiled part.

The paper's procedure, one gear after the other: some hundred times slower than the
kernel, whose functions these have the names and arguments of (``dbo_kernel.h`` says
what they are), and within 1e-9 of the range of it. Equation numbers are the paper's.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dbo_cli.arrays import Floats
from dbo_cli.model import kernel

Words = NDArray[np.uint64]


class _Walk:
    """The gears on their way through a block: B, and X_B, Y_B relative to X_0, Y_0 (1)-(3)."""

    def __init__(self, table: Floats, n: int, words: Words) -> None:
        self.rows: list[list[float]] = table[:n, :4].tolist()
        self.n = n
        self.bits = int.from_bytes(words.astype("<u8").tobytes(), "little")
        self.x = self.y = 0.0
        for gear, (dx, dy, _, _) in enumerate(self.rows):
            if self.bits >> gear & 1:
                self.x += dx
                self.y += dy

    def next_gear(self, rising: bool) -> int:
        """Return Z, the lowest zero bit (5), or S, the lowest one bit (4); n where there is none."""
        wanted = self.bits
        if rising:
            wanted = ~self.bits & ((1 << self.n) - 1)
        if not wanted:
            return self.n
        return (wanted & -wanted).bit_length() - 1

    def travel(self, goal: float, by_x: float, by_y: float) -> int:
        """Cross gears (6)-(9) until by_x X_B + by_y Y_B is within one of ``goal``; return the gear engaged.

        A sample that crosses a gear by the tolerance falls short of the new X_B and
        keeps that gear's own slope.
        """
        left = goal - (by_x * self.x + by_y * self.y)
        rising = left >= 0.0
        sign = 1.0 if rising else -1.0
        crossed = self.n
        gear = self.next_gear(rising)
        while gear < self.n:
            dx, dy, _, fraction = self.rows[gear]
            if sign * left < (by_x * dx + by_y * dy) * fraction:
                break
            self.bits ^= 1 << gear
            self.x += sign * dx
            self.y += sign * dy
            left = goal - (by_x * self.x + by_y * self.y)
            crossed = gear
            gear = self.next_gear(rising)
        if crossed < self.n and sign * left < 0.0:
            return crossed
        return gear

    def solve(
        self, u: float, kappa: float, low: float, high: float, extend: bool
    ) -> tuple[float, float]:
        """Return the relative output for the relative input u, (11)-(12), clipped, and by how much it was.

        Where it is clipped the state is that of the operator with exchanged axes driven
        by the output.
        """
        before = self.bits, self.x, self.y
        gear = self.travel(u, 1.0, kappa)
        dx, dy, _, _ = self.rows[min(gear, self.n - 1)]
        y = self.y
        if gear < self.n or extend:
            y += (u - (self.x + kappa * self.y)) * (dy / (dx + kappa * dy))
        clipped = min(max(y, low), high)
        if clipped != y:
            self.bits, self.x, self.y = before
            self.travel(clipped, 0.0, 1.0)
        return clipped, abs(clipped - y)


def backlash_run(
    table: Floats, guide: Words, n: int, run: int, x0: float, y0: float, extend: bool,
    gain: Floats, reference: float, on_output: bool, words: Words, memory: Floats,
    last: float, x: Floats, y: Floats, decay: Floats, limited: bool, low: float,
    high: float, slack: float, step: Floats,
) -> tuple[int, int, int, int]:  # fmt: skip
    """Fill ``y`` by (1)-(12) from ``x``; ``words`` and ``memory`` become the state after the block.

    What lies outside is not counted.
    With memory on the output its part kappa = sum gain_j (1 - a_j) of the present output
    widens every gear from dx to dx + kappa dy, and the rest is known.
    """
    walk = _Walk(table, n, words)
    factors = np.empty((x.size, gain.size))
    if gain.size:
        factors[:] = decay
    steps = np.broadcast_to(step if step.size else math.inf, x.shape)
    clips = []
    for k, value in enumerate(x.tolist()):
        a = factors[k]
        known = kappa = 0.0
        u = value - x0
        if on_output:
            known = float(gain @ (a * memory))
            kappa = float(gain @ (1.0 - a))
            u = (u - known) - kappa * (y0 - reference)
        else:
            memory[:] = a * memory + (1.0 - a) * (value - reference)
            known = float(gain @ memory)
        least, most = _window(last, float(steps[k]), low, high)
        part, excess = walk.solve(u, kappa, least - y0, most - y0, extend)
        last = min(max(y0 + part, least), most)
        if not on_output:
            last += known
        else:
            memory[:] = a * memory + (1.0 - a) * (last - reference)
        y[k] = last
        clips.append(excess > slack)
    _put_bits(words, walk.bits)
    count = sum(clips)
    return 0, 0, count, clips.index(True) if count else 0


def _window(last: float, change: float, low: float, high: float) -> tuple[float, float]:
    """Return the limits of one sample; the range wins over the largest change."""
    if math.isnan(last) or change == math.inf:
        return low, high
    least = math.nextafter(last - change, last)
    most = math.nextafter(last + change, last)
    return min(max(least, low), high), max(min(most, high), low)


def _put_bits(words: Words, bits: int) -> None:
    words[:] = np.frombuffer(bits.to_bytes(8 * words.size, "little"), dtype="<u8")


def backlash_decay(
    table: Floats, guide: Words, n: int, run: int, x0: float, y0: float, extend: bool,
    gain: Floats, reference: float, on_output: bool, words: Words, drive: float,
) -> None:  # fmt: skip
    """Fill ``words`` with the state after an oscillation of the drive that decays to ``drive``."""
    widths = table[:n, 1 if on_output else 0].tolist()
    target = drive - (y0 if on_output else x0)
    low, high = 0.0, math.fsum(widths)
    slack = 1e-9 * high
    bits = 0
    for gear in range(n - 1, -1, -1):
        if target > 0.0 and target - low >= (high - target) - slack:
            bits |= 1 << gear
            low += widths[gear]
        else:
            high -= widths[gear]
    _put_bits(words, bits)


def point_run(segments: Floats, x0: float, y0: float, x: Floats, y: Floats) -> None:
    """Fill ``y`` by (13)-(16); rows of ``segments`` are (X_C - X_0, Y_C - Y_0, slope)."""
    u = x - x0
    place = np.searchsorted(segments[1:, 0], u, side="right")
    start, height, slope = segments[place].T
    y[:] = y0 + (height + slope * (u - start))


def dynamics_run(
    output: Floats, state: Floats, x: Floats, y: Floats, step: Floats
) -> None:
    """Fill ``y`` with ``x`` behind all sections; ``state`` (p, q, u) becomes that after the block."""
    rows = step.reshape(len(step), -1, 6)
    for k, value in enumerate(x.tolist()):
        numbers = rows[k if len(rows) > 1 else 0]
        for section, (by_lead, by_q), c in zip(state, output, numbers, strict=True):
            p, q, before = section
            lead, change = before - p, value - before
            p = p + (c[0] * q + c[1] * lead + c[2] * change)
            q = c[3] * q + c[4] * lead + c[5] * change
            section[:] = p, q, value
            value = p + (by_lead * (value - p) + by_q * q)
        y[k] = value


def dynamics_undo(
    numbers: Floats, weight: Floats, state: Floats, y: Floats, u: Floats
) -> None:
    """Fill ``u`` with the input of one section whose output is ``y``; ``state`` is (y, a, b)."""
    changes = np.diff(y)
    aa, ab, ba, bb, a_in, b_in, a_out, b_out = numbers.tolist()
    last, a, b = state.tolist()
    for k in range(u.size):
        change = y[k] - last
        a, b = aa * a + ab * b + a_in * change, ba * a + bb * b + b_in * change
        last = y[k]
        ahead = float(weight @ changes[k : k + weight.size])
        u[k] = y[k] + (a_out * a + b_out * b + ahead)
    state[:] = last, a, b


def between_even(values: Floats, out: Floats, place: int, part: float) -> None:
    """Fill ``out`` with values the ``part`` of a step behind sample ``place`` of each six."""
    six = np.lib.stride_tricks.sliding_window_view(values, 6)
    rise = six[:, place + 1] - six[:, place]
    begins = _slopes(six, place) - rise
    ends = _slopes(six, place + 1) - rise
    rest = 1.0 - part
    out[:] = six[:, place] + part * (rise + rest * (rest * begins - part * ends))


def _slopes(six: Floats, at: int) -> Floats:
    """Return the slope at one of each six samples, limited (Huynh's scheme M3-A)."""
    secant = np.diff(six)
    # around each sample; at the ends the neighbour's
    curve = np.pad(0.5 * np.diff(secant), ((0, 0), (1, 1)), mode="edge")
    first = 0 if at < 3 else 1
    weights = np.polyfit(np.arange(first, first + 5.0) - at, np.eye(5), 4)[3]
    slope = six[:, first : first + 5] @ weights
    chords, parabolas = [], []
    if at > 0:
        chords.append(secant[:, at - 1])
        parabolas.append(chords[-1] + _nearer(curve[:, at - 1], curve[:, at]))
    if at < 5:
        chords.append(secant[:, at])
        parabolas.append(chords[-1] - _nearer(curve[:, at], curve[:, at + 1]))
    chord = 3.0 * _nearer(chords[0], chords[-1])
    parabola = 1.5 * _nearer(parabolas[0], parabolas[-1])
    low = np.minimum(np.minimum(chord, parabola), 0.0)
    limited: Floats = np.clip(slope, low, np.maximum(np.maximum(chord, parabola), 0.0))
    return limited


def _nearer(a: Floats, b: Floats) -> Floats:
    """Return the number of two that is nearer to zero; zero where their signs differ."""
    nearer: Floats = np.where(np.abs(a) < np.abs(b), a, b)
    nearer[a * b <= 0.0] = 0.0
    return nearer


def between(*arguments: object) -> int:
    """Refuse what only the compiled part does (DboError)."""
    return int(kernel.require("a delay on an uneven clock"))
