"""Invented plants and their logs: no backlash operators, and what identification is judged on.

A plant takes a drive of 0 to 1 with ``RATE`` rows a second and returns a displacement
of about 0 to 1. It was at rest at 0 before the first row. Everything follows from
seeds.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import cont2discrete, lfilter

Floats = NDArray[np.float64]
Plant = Callable[[Floats], Floats]

RATE = 200.0  # rows a second
TOP = 100.0  # V
STROKE = 20.0  # um
NOISE = 5e-4  # of the stroke: a strain gauge's
FINEST = 0.002  # of the range: differential equations take longer steps in parts


@dataclass(frozen=True)
class Log:
    """One recording: time (s), voltage (V) and displacement (um)."""

    name: str
    time: Floats
    voltage: Floats
    displacement: Floats


@dataclass(frozen=True)
class Invented:
    """One task: a log to identify from, and a new move of the same plant, judged from row ``first`` on."""

    name: str
    log: Log
    test: Log
    first: int
    offset_free: bool


# --- plants ---


def lagged(signal: Floats, tau: float) -> Floats:
    """First-order lag, straight between samples, at rest first."""
    ratio = 1.0 / (RATE * tau)
    decay = np.exp(-ratio)
    hold = -np.expm1(-ratio) / ratio
    taps = [1.0 - hold, hold - decay]
    answer: Floats = signal[0] + lfilter(taps, [1.0, -decay], signal - signal[0])
    return answer


def plays(loop: float, reach: float, power: float = 0.5) -> Plant:
    """Return plays of a continuous density; ``loop`` is their share of the slope (negative: softening)."""
    radii = (np.arange(160) + 0.5) / 320.0
    density = radii**power * np.exp(-radii / reach)
    weights = density / float(density @ (1.0 - 2.0 * radii))

    def run(drive: Floats) -> Floats:
        state = radii.copy()
        summed = np.empty(drive.size)
        for k, u in enumerate(drive.tolist()):
            np.clip(state, u - radii, u + radii, out=state)
            summed[k] = (state - radii) @ weights
        moved: Floats = (1.0 - loop) * drive + loop * summed
        return moved

    return run


def slipping(stiffness: Floats, slips: Floats, beside: float) -> Plant:
    """Return springs that slip at their forces, and one beside them that does not (Maxwell)."""
    whole = beside + float(stiffness @ np.minimum(slips, 1.0))

    def run(drive: Floats) -> Floats:
        stretch = np.zeros(slips.size)
        moved = np.empty(drive.size)
        last = 0.0
        for k, u in enumerate(drive.tolist()):
            stretch = np.clip(stretch + u - last, -slips, slips)
            last = u
            moved[k] = beside * u + stiffness @ stretch
        return moved / whole

    return run


def in_steps(drive: Floats, change: Callable[[float, float], float]) -> Floats:
    """Integrate z' = change(step, z) along a drive in fine steps, from z = 0."""
    state, last = 0.0, float(drive[0])
    states = np.empty(drive.size)
    for k, u in enumerate(drive.tolist()):
        parts = max(1, int(abs(u - last) / FINEST))
        step = (u - last) / parts
        for _ in range(parts):
            state += change(step, state)
        last = u
        states[k] = state
    return states


def bouc_wen(strength: float, reach: float, lean: float) -> Plant:
    """Return u - strength z, z' = u' - |u'| (lean |z| sign(u') + (1 - lean) z) / reach."""

    def change(step: float, z: float) -> float:
        sign = 1.0 if step >= 0.0 else -1.0
        pull = lean * abs(z) * sign + (1.0 - lean) * z
        return step - abs(step) * pull / reach

    return lambda drive: drive - strength * in_steps(drive, change)


def dahl(force: float, reach: float, power: float) -> Plant:
    """Return a stage on a spring with Dahl's friction."""

    def change(step: float, friction: float) -> float:
        sign = 1.0 if step >= 0.0 else -1.0
        room = max(1.0 - sign * friction / force, 0.0)
        return step * force / reach * room**power

    return lambda drive: drive - in_steps(drive, change)


def relays(straight: float, spread: float, tilt: float) -> Plant:
    """Return Preisach relays; ``tilt`` makes small loops at different levels different."""
    grid = (np.arange(40) + 0.5) / 40.0
    centre, width = np.meshgrid(grid, 0.5 * grid)
    up, down = centre + 0.5 * width, centre - 0.5 * width
    density = np.exp(-width / spread) * (1.0 + tilt * (centre - 0.5))
    inside = (up < 1.0) & (down > 0.0)
    up, down = up[inside], down[inside]
    density = density[inside] / density[inside].sum()

    def run(drive: Floats) -> Floats:
        state = np.zeros(up.size)
        moved = np.empty(drive.size)
        for k, u in enumerate(drive.tolist()):
            state[u >= up] = 1.0
            state[u <= down] = 0.0
            moved[k] = straight * u + (1.0 - straight) * (density @ state)
        return moved

    return run


def two_curves(loop: float, lean: float) -> Plant:
    """Return generalised plays whose envelopes on the way up and down differ (Krasnoselskii)."""
    radii = np.linspace(0.0, 0.3, 60)
    weights = np.exp(-radii / 0.12)
    weights /= weights.sum()

    def run(drive: Floats) -> Floats:
        state = np.zeros(radii.size)
        moved = np.empty(drive.size)
        for k, u in enumerate(drive.tolist()):
            rising = u + lean * u * (u - 1.0)
            falling = np.sin(0.5 * np.pi * u)
            state = np.maximum(rising - radii, np.minimum(falling + radii, state))
            moved[k] = (1.0 - loop) * u + loop * (state @ weights)
        return moved

    return run


def bent(plant: Plant, square: float, cube: float = 0.0) -> Plant:
    """Return a plant behind which a curve stands that keeps both ends."""

    def run(drive: Floats) -> Floats:
        x = plant(drive)
        return x + x * (1.0 - x) * (square + cube * (1.0 - 2.0 * x))

    return run


def creeping(plant: Plant, share: float, longest: float = 500.0) -> Plant:
    """Return a plant that creeps by the same share every decade of time from 0.05 s on."""
    count = 1 + round(3.0 * np.log10(longest / 0.05))
    taus = 0.05 * 10.0 ** (np.arange(count) / 3.0)

    def run(drive: Floats) -> Floats:
        x = plant(drive)
        crept = x.copy()
        for tau in taus.tolist():
            crept += share / 3.0 * (lagged(x, tau) - x)
        return crept

    return run


def late(plant: Plant, lag: float, samples: int) -> Plant:
    """Return a plant behind an amplifier that lags, with a sensor that is late by whole samples."""

    def run(drive: Floats) -> Floats:
        x = plant(lagged(drive, lag))
        before = np.full(samples, x[0])
        return np.concatenate([before, x[: x.size - samples]])

    return run


def ringing(plant: Plant, frequency: float, damping: float) -> Plant:
    """Return a plant with a resonance (Hz), straight between samples."""
    w = 2.0 * np.pi * frequency
    system = [1.0], [1.0 / w**2, 2.0 * damping / w, 1.0]
    top, bottom, _ = cont2discrete(system, 1.0 / RATE, "foh")

    def run(drive: Floats) -> Floats:
        x = plant(drive)
        answer: Floats = x[0] + lfilter(top[0], bottom, x - x[0])
        return answer

    return run


PIEZO = plays(0.45, 0.15)
SPRINGS = slipping(np.array([1.2, 0.9, 0.6]), np.array([0.02, 0.06, 0.15]), 0.7)
PLANTS: dict[str, Plant] = {
    "piezo": bent(PIEZO, 0.1, 0.03),
    "creeping piezo": creeping(bent(PIEZO, -0.08), 0.02),
    "late piezo": late(bent(PIEZO, 0.1), 0.006, 3),
    "ringing piezo": ringing(late(PIEZO, 0.002, 0), 22.0, 0.03),
    "springs that slip": SPRINGS,
    "creeping springs": creeping(SPRINGS, 0.01),
    "Bouc-Wen": bouc_wen(0.4, 0.12, 0.35),
    "Dahl": dahl(0.1, 0.14, 1.5),
    "Preisach": relays(0.5, 0.16, 0.3),
    "tilted Preisach": bent(relays(0.6, 0.12, -0.8), -0.06),
    "two curves": two_curves(0.6, 0.45),
    "softening": bent(plays(-0.7, 0.08), 0.06),
}

# --- drives ---


def swept(turns: list[float], seconds: list[float]) -> Floats:
    """Half-cosine swings through turns."""
    parts = [np.array(turns[:1])]
    for begin, end, duration in zip(turns[:-1], turns[1:], seconds, strict=True):
        count = max(round(duration * RATE), 2)
        phase = np.pi * np.arange(1, count + 1) / count
        parts.append(begin + (end - begin) * (0.5 - 0.5 * np.cos(phase)))
    return np.concatenate(parts)


def nested(seed: int, seconds: float) -> Floats:
    """Two full swings, then random turns at speeds of 0.4 to 8 ranges a second, some held; then a rest."""
    rng = np.random.default_rng(seed)
    turns, times = [0.0, 1.0, 0.0], [0.5, 0.5]
    while sum(times) < seconds:
        level = float(rng.uniform(0.0, 1.0))
        if rng.random() < 0.12:
            level = float(rng.integers(0, 2))
        speed = float(np.exp(rng.uniform(np.log(0.4), np.log(8.0))))
        times.append(max(abs(level - turns[-1]) / speed, 0.02))
        turns.append(level)
        if rng.random() < 0.15:
            times.append(0.4)
            turns.append(level)
    return swept([*turns, 0.0, 0.0], [*times, 0.5, 0.5])


def cycles(heights: list[float]) -> Floats:
    """Whole sines of 1 Hz, of given heights, standing on 0."""
    phase = 2.0 * np.pi * np.arange(round(RATE)) / RATE
    return np.concatenate([h * (0.5 - 0.5 * np.cos(phase)) for h in heights])


def with_sweep(seed: int) -> Floats:
    """Nested turns, then a small sweep of 0.5 to 40 Hz about the middle."""
    time = np.arange(round(8.0 * RATE)) / RATE
    growth = np.log(80.0)
    phase = 2.0 * np.pi * 0.5 * 8.0 / growth * (np.exp(growth * time / 8.0) - 1.0)
    fade = np.clip(np.minimum(time, 8.0 - time) / 0.4, 0.0, 1.0)
    sweep = 0.5 + 0.02 * fade * np.sin(phase)
    way = swept([0.0, 0.5, 0.5], [0.5, 0.3])
    return np.concatenate([nested(seed, 12.0), way, sweep])


def ramps() -> Floats:
    """Straight ways between turns."""
    turns = [0.0, 1.0, 0.0, 1.0, 0.2, 0.8, 0.3, 0.7, 0.4, 1.0, 0.0, 0.6, 0.3, 0.5, 0.1]
    turns += [0.9, 0.0, 1.0, 0.5, 0.75, 0.0]
    parts = []
    for begin, end in itertools.pairwise(turns):
        parts.append(np.linspace(begin, end, 150, endpoint=False))
    return np.concatenate(parts)


def drive(kind: str, seed: int) -> Floats:
    """Return a drive of 0 to 1: what different people record."""
    if kind == "long":
        return nested(seed, 24.0)
    if kind == "nested":
        return nested(seed, 14.0)
    if kind == "sweep":
        return with_sweep(seed)
    if kind == "ramps":
        return ramps()
    heights = {
        "two": [1.0] * 6 + [0.5] * 6,
        "fading": np.linspace(1.0, 0.15, 16).tolist(),
        "sine": [1.0] * 14,
    }
    return cycles(heights[kind])


def new_move(seed: int) -> Floats:
    """Return a full swing, then what users do: slow, high, low, tiny, held, nested."""
    rng = np.random.default_rng(seed)
    levels = np.repeat(rng.uniform(0.05, 0.95, 6), 2).tolist()
    turns = [0.0, 1.0, 0.0, 0.9, 0.1, *[0.6, 0.9] * 3, *[0.1, 0.3] * 3]
    turns += [*[0.48, 0.55] * 3, *levels]
    times = [1.0, 1.0, 2.0, 2.0, *[0.25] * 12, *[0.15] * 6, *[0.4, 0.6] * 6]
    return np.concatenate([swept(turns, times), nested(seed, 6.0)])


# --- cases ---

CASES = (
    ("piezo", "long", ""),
    ("piezo", "nested", "spikes"),
    ("piezo", "two", ""),
    ("piezo", "fading", ""),
    ("piezo", "sine", ""),
    ("piezo", "long", "drift"),
    ("creeping piezo", "long", ""),
    ("creeping piezo", "two", ""),
    ("creeping piezo", "fading", "unknown start"),
    ("late piezo", "nested", ""),
    ("ringing piezo", "sweep", ""),
    ("springs that slip", "long", ""),
    ("springs that slip", "fading", "unknown start"),
    ("creeping springs", "nested", ""),
    ("Bouc-Wen", "nested", ""),
    ("Bouc-Wen", "fading", ""),
    ("Dahl", "long", ""),
    ("Dahl", "sine", ""),
    ("Preisach", "nested", ""),
    ("tilted Preisach", "two", ""),
    ("two curves", "ramps", ""),
    ("two curves", "nested", "drift"),
    ("softening", "nested", ""),
    ("softening", "sine", ""),
)
DRIFT = 0.03  # of the stroke, over the log
SPIKES = 0.01  # of the rows
PAST = 1.3  # s of drive before a log of unknown start
FIRST = round(2.0 * RATE)  # row of a new move behind its full swing


def played(name: str, shape: Floats, fault: str, seed: int) -> Log:
    """Return what the logger wrote of a drive of 0 to 1."""
    rng = np.random.default_rng(seed)
    skipped = 0
    if fault == "unknown start":
        past = swept([0.0, 0.8, 0.25, shape[0]], [0.5, 0.4, 0.4])
        shape = np.concatenate([past, shape])
        skipped = past.size
    moved = PLANTS[name](shape)[skipped:]
    shape = shape[skipped:]
    time = np.arange(shape.size) / RATE
    seen = moved + NOISE * rng.standard_normal(moved.size)
    if fault == "drift":
        seen += DRIFT * time / time[-1]
    if fault == "spikes":
        hit = np.flatnonzero(rng.random(seen.size) < SPIKES)
        seen[hit] += rng.choice([-1.0, 1.0], hit.size) * rng.uniform(0.1, 0.6, hit.size)
    return Log(name, time, TOP * shape, STROKE * seen)


def invented() -> Iterator[Invented]:
    """Yield the cases; the new move of each is what a perfect sensor would show."""
    for seed, (name, kind, fault) in enumerate(CASES):
        log = played(name, drive(kind, seed), fault, seed)
        shape = new_move(seed + 1000)
        time = np.arange(shape.size) / RATE
        moved = STROKE * PLANTS[name](shape)
        test = Log("new", time, TOP * shape, moved)
        label = f"{name}, {kind}"
        if fault:
            label += f", {fault}"
        yield Invented(label, log, test, FIRST, fault in ("drift", "unknown start"))
