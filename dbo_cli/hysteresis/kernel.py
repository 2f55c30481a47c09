"""The recursions of the paper in readable Python, and the choice between them and the compiled kernel.

The functions here and those of the extension ``_kernel`` (``dbo_kernel.c``,
``dbo_dynamics.c``) have the same arguments and give the same bits: every floating-point
operation is written in the same order in both. The compiled kernel is taken where it
was built; ``DBO_KERNEL=python`` in the environment chooses the Python twin,
``DBO_KERNEL=compiled`` insists on the other.

Equation numbers are those of Aye and Ang (2018). The state's bits are runs of ones and
zeros, since a move changes the lowest first: it is kept as the ends of the runs
(``dbo_kernel.h`` says how), and how many gears of a run are crossed is looked up. The
kernel's table has a row for each ``run`` of equal gears, ``(dx, dy, slope,
crossing_fraction, x, y)``: the two widths of (10), dy/dx, the fraction of a gear at
which it counts as crossed, and where the first of them begins; one more row begins
where the last gear ends. ``guide`` tells the compiled kernel where to look first;
nothing here uses it.
"""

from __future__ import annotations

import bisect
import itertools
import math
import os
import sys
from collections.abc import Callable, Iterator
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import DboError, UsageError

Floats = NDArray[np.float64]


def dynamics_run(
    output: Floats, state: Floats, x: Floats, y: Floats, step: Floats
) -> None:
    """Fill ``y`` with ``x`` after all sections; ``state`` (sections × 3: p, q, u) becomes that after it.

    ``output`` has two numbers a section, ``step`` six a section in one row or in one
    row for each sample; see ``dbo_dynamics.h`` for their meaning.
    """
    sections = state.size // 3
    memories = [list(row) for row in state.reshape(sections, 3).tolist()]
    outputs = output.reshape(sections, 2).tolist()
    rows = step.reshape(-1, sections, 6).tolist()
    result = []
    for k, value in enumerate(x.tolist()):
        row = rows[k] if len(rows) > 1 else rows[0]
        for s, (p_q, p_lead, p_change, q_q, q_lead, q_change), (by_lead, by_q) in zip(
            memories, row, outputs, strict=True
        ):
            p, q, u = s
            lead, change = u - p, value - u
            p = p + ((p_q * q + p_lead * lead) + p_change * change)
            q = (q_q * q + q_lead * lead) + q_change * change
            s[:] = p, q, value
            value = p + (by_lead * (value - p) + by_q * q)
        result.append(value)
    y[:] = result
    state[:] = np.array(memories).reshape(state.shape)


def dynamics_undo(
    numbers: Floats, weight: Floats, state: Floats, y: Floats, u: Floats
) -> None:
    """Fill ``u`` with the input of one section whose output is ``y``, which goes on for ``len(weight)`` more.

    ``numbers`` are aa, ab, ba, bb, a_in, b_in, a_out, b_out of ``dbo_section_inverse``;
    ``state`` (y, a, b) becomes that after the samples of ``u``.
    """
    count = u.size
    future = np.zeros(count)
    for j in range(weight.size, 0, -1):
        future += weight[j - 1] * (y[j : j + count] - y[j - 1 : j - 1 + count])
    aa, ab, ba, bb, a_in, b_in, a_out, b_out = numbers.tolist()
    last, a, b = state.tolist()
    result = []
    for value, ahead in zip(y[:count].tolist(), future.tolist(), strict=True):
        change = value - last
        a, b = (aa * a + ab * b) + a_in * change, (ba * a + bb * b) + b_in * change
        last = value
        result.append(value + ((a_out * a + b_out * b) + ahead))
    u[:] = result
    state[:] = last, a, b


def smooth(weight: Floats, x: Floats, y: Floats) -> None:
    """Fill ``y`` with a symmetric weighted mean of ``x``, which has ``len(weight)`` more at either end."""
    reach, count = weight.size, y.size
    middle = x[reach : reach + count]
    total = np.zeros(count)
    for j in range(reach, 0, -1):
        total += weight[j - 1] * (
            (x[reach - j : reach - j + count] - middle)
            + (x[reach + j : reach + j + count] - middle)
        )
    y[:] = middle + total


Words = NDArray[np.uint64]
Constants = tuple[Floats, Words, int, int, float, float, bool, Floats, float, bool]
"""The first arguments of ``backlash_run``, the same for all blocks."""

MOST_HALVINGS = 2000  # of a range: more than float64 has

WORD = 64  # bits of a uint64, in which the kernel keeps the states of gears


def state_words(n: int) -> int:
    """Return how many 64-bit words hold the bits of n gears."""
    return (n + WORD - 1) // WORD


def find_first_one(bits: int, n: int) -> int:
    """Return S, the index of the least significant one bit (4), or n where all bits are zero."""
    if not bits:
        return n
    return (bits & -bits).bit_length() - 1


def find_first_zero(bits: int) -> int:
    """Return Z, the index of the least significant zero bit (5); n where all n bits are one."""
    return (~bits & (bits + 1)).bit_length() - 1


class _Walk:
    """The state on its way through a block: the ends of its runs, and X_B, Y_B relative to X_0, Y_0 (1)-(5).

    ``ends`` begins with n, the end of the highest run; its last is the end of the
    lowest, which is of ``ones`` or of zeros.
    """

    def __init__(self, gears: Floats, n: int, run: int, words: Words) -> None:
        self.rows: list[list[float]] = gears.tolist()
        self.n, self.run, self.words = n, run, words
        bits = int.from_bytes(words.tobytes(), "little")
        self.ones = bool(bits & 1)
        changes = bits ^ bits >> 1
        self.ends = [n, *(i for i in range(n - 1, 0, -1) if changes >> i - 1 & 1)]
        self.x = self.y = 0.0
        ones = self.ones
        for begin, end in itertools.pairwise([0, *reversed(self.ends)]):
            if ones:
                self.x += self.begin(end)[0] - self.begin(begin)[0]
                self.y += self.begin(end)[1] - self.begin(begin)[1]
            ones = not ones

    def gear(self, gear: int) -> list[float]:
        """Return the row of a gear; that of the last one, where there is none."""
        return self.rows[min(gear, self.n - 1) // self.run]

    def begin(self, gear: int) -> tuple[float, float]:
        """Return where a gear begins with all gears below it crossed and no others."""
        row, before = divmod(gear, self.run)
        dx, dy, _, _, x, y = self.rows[row]
        if not before:
            return x, y
        return x + before * dx, y + before * dy

    def open(self, rising: bool) -> tuple[int, int]:
        """Return the next gear to be crossed, Z or S, n where there is none, and the end of its run."""
        if self.ones != rising:
            return 0, self.ends[-1]
        if len(self.ends) == 1:
            return self.ends[-1], self.n
        return self.ends[-1], self.ends[-2]

    def cross(self, rising: bool, gear: int) -> None:
        """Go on from the next gear to another one of its run, or the run's end: (6)-(7), or (8)-(9)."""
        next_gear, end = self.open(rising)
        before, after = self.begin(next_gear), self.begin(gear)
        sign = 1.0 if rising else -1.0
        self.x += sign * (after[0] - before[0])
        self.y += sign * (after[1] - before[1])
        if self.ones == rising:
            self.ends.pop()
        if gear < end:
            self.ends.append(gear)
        # the run melts into the one above
        elif self.ones == rising or len(self.ends) > 1:
            self.ends.pop()
            self.ends = self.ends or [self.n]
        self.ones = rising

    def state(self) -> int:
        """Return B (1)."""
        bits = 0
        for end in self.ends:
            bits ^= (1 << end) - 1
        if self.ones != bool(bits & 1):
            bits ^= (1 << self.n) - 1
        return bits

    def finish(self) -> None:
        """Write the bits back into the caller's words."""
        content = self.state().to_bytes(8 * len(self.words), "little")
        self.words[:] = np.frombuffer(content, dtype="<u8")


def _travel(
    walk: _Walk,
    u: float,
    kappa: float,
    low: float,
    high: float,
    tell: Callable[[int, int, float], None] | None = None,
) -> tuple[int, float, bool]:
    """Carry out steps 1 to 4 for the relative input u: the engaged gear, u - X_B, and whether it went up.

    Gears are taken with the input widths ``dx + kappa dy``, and none is crossed that
    would leave [low, high] on the output. Only one direction is taken for one sample,
    so that it always ends. A sample that crosses a gear by the tolerance falls short of
    the new X_B and keeps that gear's own slope: an operator and its inverse then see
    the same fraction of the same gear, and decide alike. ``tell`` hears of the gears
    crossed, from one up to another, and 1 or -1.
    """
    rising = u - (walk.x + kappa * walk.y) >= 0.0
    sign = 1.0 if rising else -1.0
    last = walk.n

    def crossed(gear: int) -> bool:
        """Whether a gear of the run is crossed, all those before it being crossed."""
        begin = walk.begin(gear)
        x = walk.x + sign * (begin[0] - first[0])
        y = walk.y + sign * (begin[1] - first[1])
        d = u - (x + kappa * y)
        travelled, room = -d, y - low
        if rising:
            travelled, room = d, high - y
        dx, dy, _, fraction, _, _ = walk.gear(gear)
        return travelled >= (dx + kappa * dy) * fraction and room >= dy * fraction

    while True:
        gear, end = walk.open(rising)
        first = walk.begin(gear)
        run = range(gear, end)
        reached = gear + bisect.bisect_left(run, True, key=lambda i: not crossed(i))
        if reached == gear:
            break
        if tell is not None:
            tell(gear, reached, sign)
        walk.cross(rising, reached)
        last = reached - 1
    d = u - (walk.x + kappa * walk.y)
    falls_short = d < 0.0 if rising else d > 0.0
    if last < walk.n and falls_short:
        gear = last
    return gear, d, rising


def _solve(
    walk: _Walk, u: float, kappa: float, low: float, high: float, extend: bool
) -> tuple[float, bool]:
    """Return the relative output for the relative input u, and "outside"; see ``_travel``."""
    gear, d, rising = _travel(walk, u, kappa, low, high)
    dx, dy, _, fraction, _, _ = walk.gear(gear)
    width = dx + kappa * dy
    if gear < walk.n:
        return walk.y + d * (dy / width), False
    beyond = d if rising else -d
    outside = beyond >= width * (1.0 - fraction)
    if not extend:
        return walk.y, outside
    return walk.y + d * (dy / width), outside


def _follow_output(walk: _Walk, y: float, rising: bool) -> None:
    """Drive the operator with exchanged axes one way, to the relative output y."""
    end = math.inf if rising else -math.inf
    _travel(walk, end, 0.0, y, y)


def _solve_within(
    walk: _Walk,
    u: float,
    kappa: float,
    y0: float,
    low: float,
    high: float,
    extend: bool,
) -> tuple[float, float, bool]:
    """Return the output within [low, high], by how much it was clipped, and "outside".

    The state becomes that of the operator with exchanged axes driven by the clipped
    output.
    """
    low_part, high_part = low - y0, high - y0
    rising = u - (walk.x + kappa * walk.y) >= 0.0
    # the output may stand beyond the limit that it moves towards
    if rising and high_part < walk.y:
        _follow_output(walk, high_part, False)
        return high, math.inf, False
    if not rising and low_part > walk.y:
        _follow_output(walk, low_part, True)
        return low, math.inf, False
    rest, outside = _solve(walk, u, kappa, low_part, high_part, extend)
    y = y0 + rest
    if y > high:
        if not rising:
            _follow_output(walk, high_part, False)
        return high, y - high, outside
    if y < low:
        if rising:
            _follow_output(walk, low_part, True)
        return low, low - y, outside
    return y, -1.0, outside


def _decay_rows(decay: Floats, terms: int, count: int) -> Iterator[list[float]]:
    """Yield the decay factors of each sample; one row serves all of them."""
    rows = decay.reshape(-1, terms).tolist() if terms else [[]]
    for k in range(count):
        yield rows[k] if len(rows) > 1 else rows[0]


def _remember(memory: list[float], decay: list[float], drive: float) -> None:
    """Go on with every relaxation term by one sample."""
    for j, a in enumerate(decay):
        memory[j] = a * memory[j] + (1.0 - a) * drive


def _recalled(weights: list[float], memories: list[float]) -> float:
    """Return what the terms add up to."""
    total = 0.0
    for c, memory in zip(weights, memories, strict=True):
        total += c * memory
    return total


def _known_part(
    weights: list[float], memories: list[float], decay: list[float]
) -> tuple[float, float]:
    """Return what the terms keep of the past, and their part kappa of the present output."""
    remembered = kappa = 0.0
    for c, memory, a in zip(weights, memories, decay, strict=True):
        remembered += c * (a * memory)
        kappa += c * (1.0 - a)
    return remembered, kappa


def window(
    low: float, high: float, step: float | None, last: float | None
) -> tuple[float, float]:
    """Return the output limits of one sample; the range wins over the slew limit."""
    if step is None or last is None or math.isnan(last):
        return low, high
    least = min(max(towards(last, -step), low), high)
    most = max(min(towards(last, step), high), low)
    return least, most


def towards(last: float, step: float) -> float:
    """Return last + step, rounded towards ``last``, so that a slew limit is kept to the last bit.

    What the sum lost (two-sum, exact) tells which way it was rounded; one part in 2^52
    is at least its last digit.
    """
    total = last + step
    part = total - last
    lost = (last - (total - part)) + (step - part)
    digit = abs(total) * 2.220446049250313e-16
    if step > 0.0 and lost < 0.0:
        return total - digit
    if not step > 0.0 and lost > 0.0:
        return total + digit
    return total


def _counted(flags: list[bool]) -> tuple[int, int]:
    """Return how many flags are set, and the first of them; 0 where there is none."""
    if not any(flags):
        return 0, 0
    return sum(flags), flags.index(True)


def backlash_run(
    gears: Floats,
    guide: Words,
    n: int,
    run: int,
    x0: float,
    y0: float,
    extend: bool,
    gain: Floats,
    reference: float,
    memory_on_output: bool,
    words: Words,
    memory: Floats,
    last: float,
    x: Floats,
    y: Floats,
    decay: Floats,
    limited: bool,
    low: float,
    high: float,
    slack: float,
    step: Floats,
) -> tuple[int, int, int, int]:
    """Fill ``y`` by (1)-(12) from ``x``; ``words`` and ``memory`` become the state after the block.

    Relaxation terms L_j = a_j L_j + (1 - a_j)(z - reference) follow z, the input or the
    output; a_j is ``decay`` and the part of the output they make up is sum gain_j L_j.
    On the output they are solved for together with the gears: their part kappa = sum
    gain_j (1 - a_j) of the present output widens every gear from dx to dx + kappa dy,
    and the rest is known. Returns the counts of ``dbo_counts``.
    """
    walk = _Walk(gears, n, run, words)
    outsides: list[bool] = []  # of each sample: whether it lies outside the range
    clips: list[bool] = []  # and whether it was clipped
    weights: list[float] = gain.tolist()
    memories: list[float] = memory.tolist()
    steps: list[float | None] = [None] if not step.size else step.tolist()
    after = len(weights) > 0 and not memory_on_output
    rows = _decay_rows(decay, len(weights), x.size)
    for k, (value, a) in enumerate(zip(x.tolist(), rows, strict=True)):
        kappa = remembered = 0.0
        u = value - x0
        if after:
            _remember(memories, a, value - reference)
            remembered = _recalled(weights, memories)
        elif weights:
            remembered, kappa = _known_part(weights, memories, a)
            u = (u - remembered) - kappa * (y0 - reference)
        excess = -1.0
        if limited:
            least, most = window(low, high, steps[k if len(steps) > 1 else 0], last)
            last, excess, outside = _solve_within(
                walk, u, kappa, y0, least, most, extend
            )
        else:
            rest, outside = _solve(walk, u, kappa, -math.inf, math.inf, extend)
            if after:
                rest = rest + remembered
            last = y0 + rest
        y[k] = last
        outsides.append(outside)
        clips.append(excess > slack)
        if weights and not after:
            _remember(memories, a, last - reference)
    walk.finish()
    memory[:] = memories
    return *_counted(outsides), *_counted(clips)


def backlash_decay(
    gears: Floats,
    guide: Words,
    n: int,
    run: int,
    x0: float,
    y0: float,
    extend: bool,
    gain: Floats,
    reference: float,
    memory_on_output: bool,
    words: Words,
    drive: float,
) -> None:
    """Fill ``words`` with the state after an oscillation of the drive that decays to ``drive``.

    The gears stop flipping from the highest to the lowest: see
    ``DiscreteBacklashOperator.settled``.
    """
    walk = _Walk(gears, n, run, np.zeros_like(words))
    axis, target = 0, drive - x0
    if memory_on_output:
        axis, target = 1, drive - y0
    low = 0.0
    high = walk.begin(n)[axis]
    slack = 1e-9 * high
    digits = bytearray(b"0") * n  # of B, the highest gear first
    places = range(n) if target > 0.0 else range(0)
    for place in places:
        width = walk.gear(n - 1 - place)[axis]
        if target - low >= (high - target) - slack:
            digits[place] = ord("1")
            low += width
        else:
            high -= width
    content = int(digits, 2).to_bytes(8 * len(words), "little")
    words[:] = np.frombuffer(content, dtype="<u8")


def backlash_start(
    forward: Constants, inverse: Constants, output: float, below: float, above: float
) -> tuple[float, float]:
    """Return the drive whose own settled state leads to ``output``, twice, by halving a range of drives.

    Where the output steps over it, these are the drives next to the step. ``forward``
    and ``inverse`` are the first arguments of ``backlash_run``; they rest at every
    sample.
    """
    size, gain = state_words(forward[2]), forward[7]

    def settled(drive: float) -> Words:
        words = np.zeros(size, np.uint64)
        backlash_decay(*forward, words, drive)
        return words

    def at_rest(operator: Constants, words: Words, x: float) -> float:
        y, memory, decay = np.empty(1), np.zeros(gain.size), np.zeros((1, gain.size))
        backlash_run(
            *operator,
            words.copy(),
            memory,
            math.nan,
            np.array([x]),
            y,
            decay,
            False,
            0.0,
            0.0,
            0.0,
            np.empty(0),
        )
        return float(y[0])

    for _ in range(MOST_HALVINGS):
        middle = below + 0.5 * (above - below)
        if not below < middle < above:
            break
        words = settled(middle)
        drive = at_rest(inverse, words, output)
        if np.array_equal(settled(drive), words):
            return drive, drive
        if at_rest(forward, words, middle) < output:
            below = middle
        else:
            above = middle
    return below, above


def backlash_engagement(
    gears: Floats,
    guide: Words,
    n: int,
    run: int,
    x0: float,
    extend: bool,
    words: Words,
    x: Floats,
    rows: Floats,
    crossed: Floats,
    group_size: int,
) -> None:
    """Fill ``rows`` (samples × ceil(n / group_size)) with the part of the gears that is in the output.

    Row k is phi with y - y0 = sum phi_i dy_i (before any relaxation); with
    ``group_size`` > 1 that many neighbours share a column, their mean. ``crossed`` is
    scratch, one number a column.
    """
    walk = _Walk(gears, n, run, words)
    columns, part = len(crossed), 1.0 / group_size

    def shift(begin: int, end: int, sign: float) -> None:
        for gear in range(begin, end):
            crossed[gear // group_size] += sign

    crossed[:] = 0.0
    state = walk.state()
    for i in range(n):
        if state >> i & 1:
            shift(i, i + 1, 1.0)
    for row, value in zip(rows.reshape(-1, columns), x.tolist(), strict=True):
        gear, d, _ = _travel(walk, value - x0, 0.0, -math.inf, math.inf, shift)
        row[:] = crossed * part
        if gear == n and not extend:
            continue
        gear = min(gear, n - 1)
        row[gear // group_size] += d / walk.gear(gear)[0] * part
    walk.finish()


def memory_run(
    reference: float, memory: Floats, x: Floats, rows: Floats, decay: Floats
) -> None:
    """Fill ``rows`` (samples × terms) with L_j after each sample; ``memory`` becomes the last row."""
    memories: list[float] = memory.tolist()
    terms = len(memories)
    table = rows.reshape(-1, terms) if terms else rows
    for k, (value, a) in enumerate(
        zip(x.tolist(), _decay_rows(decay, terms, x.size), strict=True)
    ):
        _remember(memories, a, value - reference)
        if terms:
            table[k] = memories
    memory[:] = memories


def point_run(segments: Floats, x0: float, y0: float, x: Floats, y: Floats) -> None:
    """Fill ``y`` by (13)-(16); rows of ``segments`` are (X_C - X_0, Y_C - Y_0, slope).

    The paper leaves a breakpoint to the segment found last; here it always begins the
    upper one, so that the last bit of the output does not depend on the past. The end
    segments extend.
    """
    u = x - x0
    c = np.searchsorted(segments[1:, 0], u, side="right")
    start, height, slope = segments[c].T
    y[:] = y0 + (height + slope * (u - start))


def interpolated(
    times: Floats, values: Floats, wanted: Floats, out: Floats, whole: float
) -> int:
    """Fill ``found`` with a signal at the times wanted; see ``cascade.interpolated``."""
    first = np.clip(np.searchsorted(times, wanted, side="right") - 1, 0, None)
    second = np.minimum(first + 1, times.size - 1)
    begin, lower, upper = times[first], values[first], values[second]
    gap = times[second] - begin
    with np.errstate(invalid="ignore", divide="ignore"):
        part = np.where(gap > 0.0, (wanted - begin) / gap, 0.0)
    out[:] = lower + np.where(part < whole, 0.0, part) * (upper - lower)
    np.copyto(out, upper, where=part > 1.0 - whole)
    return int(first[-1])


INTERFACE = 1
"""Of the extension's functions, as ``_kernel.c`` has it: raised with every change of their arguments."""


def compiled_kernel() -> ModuleType | None:
    """Return the extension, or None where it was not built at installation."""
    try:
        from dbo_cli.hysteresis import _kernel  # type: ignore[attr-defined,unused-ignore]
    except ImportError:
        return None
    module: ModuleType = _kernel
    return module


def require_this_state(extension: Any) -> None:
    """Refuse an extension that was built from another state of the sources.

    Raises
    ------
    DboError
        It was: the sources of an editable installation have changed since it was built.
    """
    if getattr(extension, "INTERFACE", None) != INTERFACE:
        raise DboError(
            "the compiled kernel was built from another state of the sources (pip install -e . in the"
            " checkout builds it again; DBO_KERNEL=python does without it, about a hundred times slower)"
        )


PythonKernel = sys.modules[__name__]
"""This module: its functions have the names that the extension gives its own."""


def choose(wish: str) -> tuple[str, Any]:
    """Return the kind and the kernel for ``wish``, the value of DBO_KERNEL.

    Raises
    ------
    UsageError
        ``wish`` names no kernel, or the compiled one where it was not built.
    DboError
        The compiled one was built from another state of the sources.
    """
    if wish not in {"", "python", "compiled"}:
        raise UsageError(
            f"environment DBO_KERNEL: no kernel is called {wish!r} (use python or compiled)"
        )
    compiled = None if wish == "python" else compiled_kernel()
    if compiled is not None:
        require_this_state(compiled)
        return "compiled", compiled
    if wish == "compiled":
        raise UsageError(
            "environment DBO_KERNEL: the compiled kernel was not built at installation"
            " (install again where a C compiler is, or unset DBO_KERNEL)"
        )
    return "python", PythonKernel


KIND, CHOSEN = choose(os.environ.get("DBO_KERNEL", ""))
