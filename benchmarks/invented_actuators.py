"""Invented actuators and recordings of them: what the benchmarks of identification are judged on.

None of them is a backlash operator. What is called hysteresis here comes from
continuous densities of plays, from Preisach relays whose small loops are not alike,
from Bouc and Wen's differential equation, from dry friction; behind it stand curves
(bent, saturating, with a dead zone), creep and lag, and a sensor with its own faults.
Everything follows from a seed.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dbo_cli.hysteresis.excitation import Excitation
from dbo_cli.hysteresis.identification import Recording

Floats = NDArray[np.float64]
Curve = Callable[[Floats], Floats]


def first_order(signal: Floats, step: float, tau: float) -> Floats:
    """First-order lag of a signal sampled every ``step`` seconds, straight between samples, at rest first."""
    from scipy.signal import lfilter

    if tau <= 0.0:
        return signal
    decay = np.exp(-step / tau)
    hold = -np.expm1(-step / tau) * tau / step
    taps = [1.0 - hold, hold - decay]
    out: Floats = lfilter(taps, [1.0, -decay], signal - signal[0])[0:] + signal[0]
    return out


def plays(drive: Floats, radii: Floats, start: Floats) -> Floats:
    """Return the outputs of play operators, shape (samples, plays)."""
    held = start.copy()
    out = np.empty((len(drive), len(radii)))
    for k, u in enumerate(drive.tolist()):
        np.maximum(held, u - radii, out=held)
        np.minimum(held, u + radii, out=held)
        out[k] = held
    return out


@dataclass(frozen=True)
class Plays:
    """A continuous density of plays: rises ``loop`` of the slope after a turn, or (negative) loses it."""

    loop: float = 0.45
    reach: float = 0.15
    power: float = 0.5

    def run(self, u: Floats) -> Floats:
        """Return the output for a drive of 0 to 1 that began at 0."""
        radii = np.asarray((np.arange(160) + 0.5) / 320.0, dtype=np.float64)
        density = radii**self.power * np.exp(-radii / self.reach)
        weights = density / float(density @ (1.0 - 2.0 * radii))
        summed = plays(u, radii, radii) @ weights - float(radii @ weights)
        out: Floats = (1.0 - self.loop) * u + self.loop * summed
        return out


@dataclass(frozen=True)
class Relays:
    """Preisach relays with a density that makes small loops at different levels different."""

    straight: float = 0.5
    spread: float = 0.16
    tilt: float = 0.3

    def run(self, u: Floats) -> Floats:
        """Return the output for a drive of 0 to 1 that began at 0."""
        grid = (np.arange(40) + 0.5) / 40.0
        centre, width = np.meshgrid(grid, grid * 0.5)
        up, down = centre + width / 2.0, centre - width / 2.0
        density = np.exp(-width / self.spread) * (1.0 + self.tilt * (centre - 0.5))
        inside = (up < 1.0) & (down > 0.0)
        up, down, density = (
            up[inside],
            down[inside],
            density[inside] / density[inside].sum(),
        )
        state = np.zeros(len(up))
        out = np.empty(len(u))
        for k, value in enumerate(u.tolist()):
            state[value >= up] = 1.0
            state[value <= down] = 0.0
            out[k] = density @ state
        return self.straight * u + (1.0 - self.straight) * out


@dataclass(frozen=True)
class BoucWen:
    """y = u - strength z, z' = u' (1 - |z/zmax| (sign(u' z) gamma + beta)): loops with rounded corners."""

    strength: float = 0.35
    reach: float = 0.12
    lean: float = 0.3

    def run(self, u: Floats) -> Floats:
        """Return the output for a drive of 0 to 1 that began at 0."""
        z, out = 0.0, np.empty(len(u))
        last = float(u[0])
        for k, value in enumerate(u.tolist()):
            parts = max(1, int(abs(value - last) / 0.002))
            step = (value - last) / parts
            for _ in range(parts):
                pull = (
                    self.lean * abs(z) * (1 if step >= 0 else -1)
                    + (1.0 - self.lean) * z
                )
                z += step - abs(step) * pull / self.reach
            last = value
            out[k] = value - self.strength * z
        return out


@dataclass(frozen=True)
class Friction:
    """A spring behind dry friction of several strengths: steep loops with corners."""

    radii: tuple[float, ...] = (0.03, 0.08)
    weights: tuple[float, ...] = (0.3, 0.5)

    def run(self, u: Floats) -> Floats:
        """Return the output for a drive of 0 to 1 that began at 0."""
        radii = np.array(self.radii)
        moved = plays(u, radii, radii)
        weights = np.array(self.weights)
        out: Floats = (1.0 - weights.sum()) * u + (moved - radii) @ weights
        return out


Hysteresis = Plays | Relays | BoucWen | Friction


def straight(x: Floats) -> Floats:
    """Return what goes in."""
    return x


def bent(square: float, cube: float = 0.0) -> Curve:
    """Return a curve that keeps both ends of 0 to 1."""
    return lambda x: x + square * x * (1.0 - x) + cube * x * (1.0 - x) * (1.0 - 2.0 * x)


def saturating(steepness: float) -> Curve:
    """Return a curve that flattens towards both ends."""
    return lambda x: (
        0.5 + 0.5 * np.tanh(steepness * (2.0 * x - 1.0)) / np.tanh(steepness)
    )


def wing(steepness: float) -> Curve:
    """Return a curve like that of a shape-memory wire: flat, steep, flat."""
    return lambda x: 1.0 / (1.0 + np.exp(-steepness * (x - 0.55))) + 0.1 * x


def dead_zone(at: float, width: float, left: float = 0.1) -> Curve:
    """Return a curve whose slope is ``left`` within ``width`` about ``at``."""
    return lambda x: x - (1.0 - left) * np.clip(x - at + width / 2.0, 0.0, width)


@dataclass(frozen=True)
class Actuator:
    """One invented actuator: drive 0 to ``top`` volt to displacement in um.

    ``bend`` acts on the drive, ``curve`` on the output; ``lag`` of the amplifier (s);
    ``creep`` as pairs of time constant (s) and share; ``widening`` the part of the
    range by which a speed of one range a second widens the loop; ``delay`` in samples.
    """

    hysteresis: Hysteresis = field(default_factory=Plays)
    top: float = 100.0
    stroke: float = 20.0
    bend: Curve = straight
    curve: Curve = straight
    lag: float = 0.0
    creep: tuple[tuple[float, float], ...] = ()
    widening: float = 0.0
    delay: int = 0

    def run(self, time: Floats, voltage: Floats) -> Floats:
        """Return the true displacement in um."""
        step = float(time[1] - time[0])
        u = first_order(self.bend(voltage / self.top), step, self.lag)
        if self.widening:
            speed = np.gradient(u, step)
            u = u - self.widening * np.arcsinh(4.0 * speed) / 4.0
            u = np.clip(u, 0.0, 1.0)
        x = self.curve(self.hysteresis.run(u))
        crept = x.copy()
        for tau, share in self.creep:
            crept += share * (first_order(x, step, tau) - x)
        if self.delay:
            crept = np.concatenate(
                (np.full(self.delay, crept[0]), crept[: -self.delay])
            )
        return self.stroke * crept


@dataclass(frozen=True)
class Bench:
    """Faults of the sensor and the logger: all sizes as shares of the stroke, times in s."""

    noise: float = 0.0005
    hum: float = 0.0
    spikes: float = 0.0
    read_back: float = 0.0
    sensor_lag: float = 0.0
    drift: float = 0.0
    warm_up: float = 0.0
    steps: float = 0.0
    stuck: float = 0.0
    lost: float = 0.0

    def log(
        self,
        name: str,
        time: Floats,
        voltage: Floats,
        displacement: Floats,
        stroke: float,
        seed: int,
    ) -> Recording:
        """Return what the logger wrote."""
        rng = np.random.default_rng(seed)
        step = float(time[1] - time[0])
        seen = first_order(displacement, step, self.sensor_lag)
        seen = seen + stroke * self.noise * rng.normal(size=len(seen))
        seen += stroke * self.hum * np.sin(2.0 * np.pi * 50.0 * time + 1.0)
        seen += stroke * self.drift * time / time[-1]
        seen += stroke * self.warm_up * (1.0 - np.exp(-time / (0.25 * time[-1])))
        if self.steps:
            seen = np.round(seen / (self.steps * stroke)) * self.steps * stroke
        if self.spikes:
            hit = rng.random(len(seen)) < self.spikes
            sizes = rng.choice([-1.0, 1.0], int(hit.sum())) * rng.uniform(
                0.1, 0.6, int(hit.sum())
            )
            seen[hit] += stroke * sizes
        if self.stuck:
            begin = int(0.55 * len(seen))
            seen[begin : begin + int(self.stuck * len(seen))] = seen[begin]
        read = voltage + np.ptp(voltage) * self.read_back * rng.normal(
            size=len(voltage)
        )
        kept = np.ones(len(time), bool)
        if self.lost:
            for at in rng.integers(
                0, len(time) - 60, max(1, int(self.lost * len(time) / 40))
            ):
                kept[at : at + 40] = False
        clock = None if self.lost else time
        return Recording(
            name,
            read[kept],
            seen[kept],
            clock,
            None if clock is not None else step,
            "V",
            "um",
        )


def nested_turns(
    seed: int, rate: float, seconds: float, speeds: tuple[float, float]
) -> Floats:
    """Return a drive of 0 to 1: full sweeps, then random turns at log-spread speeds (ranges a second)."""
    rng = np.random.default_rng(seed)
    middle = float(np.sqrt(speeds[0] * speeds[1]))
    turns, times = [0.0, 1.0, 0.0], [1.0 / middle, 1.0 / middle]
    while sum(times) < seconds:
        turn = (
            float(rng.choice([0.0, 1.0]))
            if rng.random() < 0.12
            else float(rng.uniform(0.0, 1.0))
        )
        speed = float(np.exp(rng.uniform(*np.log(speeds))))
        times.append(max(abs(turn - turns[-1]) / speed, 4.0 / rate))
        turns.append(turn)
        if rng.random() < 0.15:
            times.append(0.4 / middle)
            turns.append(turns[-1])
    return swept([*turns, 0.0], [*times, 1.0 / middle], rate)


def swept(turns: list[float], seconds: list[float], rate: float) -> Floats:
    """Half-cosine swings through ``turns``."""
    parts = [np.array([turns[0]])]
    for (a, b), duration in zip(itertools.pairwise(turns), seconds, strict=True):
        count = max(round(duration * rate), 2)
        parts.append(
            a + (b - a) * (0.5 - 0.5 * np.cos(np.pi * np.arange(1, count + 1) / count))
        )
    return np.concatenate(parts)


def sines(
    heights: list[float], frequency: float, rate: float, centre: float | None = None
) -> Floats:
    """Whole cycles of given heights, standing on 0 or about ``centre``."""
    count = round(rate / frequency)
    phase = 2.0 * np.pi * np.arange(count) / count
    if centre is None:
        return np.concatenate([h * (0.5 - 0.5 * np.cos(phase)) for h in heights])
    return np.concatenate([centre - 0.5 * h * np.cos(phase) for h in heights])


RATE = 200.0


def drive(kind: str, seed: int) -> tuple[Floats, float]:
    """Return a drive of 0 to 1 and its sample rate (Hz): what different people record."""
    if kind == "excite":
        return Excitation(0.0, 1.0, RATE, 24.0, 1.0).drive()[1], RATE
    if kind == "nested":
        return nested_turns(seed, RATE, 16.0, (0.4, 8.0)), RATE
    if kind == "sine":
        return sines([1.0] * 16, 1.0, RATE), RATE
    if kind == "two":
        return sines([1.0] * 6 + [0.5] * 6, 1.0, RATE), RATE
    if kind == "fading":
        return sines(list(np.linspace(1.0, 0.15, 16)), 1.0, RATE), RATE
    if kind == "part":
        return 0.08 + 0.86 * sines(
            [1.0, 1.0, *np.linspace(0.95, 0.2, 12)], 1.0, RATE
        ), RATE
    if kind == "short":
        return sines([1.0, 1.0], 1.0, RATE), RATE
    if kind == "few":
        return sines([1.0, 1.0, 0.6, 0.3], 2.0, 80.0), 80.0
    if kind == "ramps":
        turns = [0.0, 1.0, 0.0, 1.0, 0.2, 0.8, 0.3, 0.7, 0.4, 1.0, 0.0]
        turns += [0.6, 0.3, 0.5, 0.1, 0.9, 0.0, 1.0, 0.5, 0.75, 0.0]
        ramps = [
            np.linspace(a, b, 150, endpoint=False) for a, b in itertools.pairwise(turns)
        ]
        return np.concatenate(ramps), RATE
    raise ValueError(kind)


@dataclass(frozen=True)
class Case:
    """One task: logs to identify from, a new move of the same actuator, and how it truly moved.

    ``truth`` is what a perfect sensor would show on the new move, in um; ``noise`` of
    the logs' sensor, um.
    """

    name: str
    drive: str
    logs: list[Recording]
    test: Recording
    truth: Floats
    noise: float
    faults: bool
    beyond: bool = False


def case(
    name: str,
    actuator: Actuator,
    bench: Bench,
    kinds: str,
    seed: int,
    slow: bool = False,
) -> Case:
    """Play an actuator: the drives named in ``kinds`` (separated by +), then new moves over the range."""
    logs = []
    for number, kind in enumerate(kinds.split("+")):
        shape, rate = drive(kind.split("@")[0], seed + 17 * number)
        if "@" in kind:  # played that many times as fast
            rate *= float(kind.split("@")[1])
        time = np.arange(len(shape)) / rate
        voltage = actuator.top * shape
        moved = actuator.run(time, voltage)
        logs.append(
            bench.log(
                f"{name}-{kind}",
                time,
                voltage,
                moved,
                abs(actuator.stroke),
                seed + number,
            )
        )
    rate = RATE
    speeds = (0.8, 4.0) if not slow else (0.2, 1.0)
    shape = nested_turns(seed + 1000, rate, 14.0, speeds)
    time = np.arange(len(shape)) / rate
    truth = first_order(
        actuator.run(time, actuator.top * shape), 1.0 / rate, bench.sensor_lag
    )
    test = Recording("new", actuator.top * shape, truth, time, None, "V", "um")
    noise = abs(actuator.stroke) * float(
        np.hypot(bench.noise, bench.steps / np.sqrt(12.0))
    )
    faults = bench != Bench(noise=bench.noise, steps=bench.steps)
    return Case(name, kinds, logs, test, truth, noise, faults, "part" in kinds)


CREEP = ((0.4, 0.008), (6.0, 0.012))


def cases(seed: int = 1) -> Iterator[Case]:
    """Yield the table of benchmarks: structures, drives and faults, each with numbers drawn from ``seed``."""
    rng = np.random.default_rng(seed)

    def r(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    def piezo() -> Actuator:
        return Actuator(
            Plays(r(0.3, 0.55), r(0.1, 0.2), r(0.3, 0.8)), curve=bent(r(-0.15, 0.15), r(-0.05, 0.05)),
            lag=r(0.001, 0.004), creep=((r(0.2, 0.8), r(0.003, 0.01)), (r(4.0, 10.0), r(0.005, 0.015))),
        )  # fmt: skip

    def bent_drive() -> Actuator:
        return Actuator(
            Plays(r(0.3, 0.55), r(0.1, 0.2)), bend=bent(r(-0.3, -0.15)), curve=bent(r(0.1, 0.3)),
            lag=r(0.001, 0.004), creep=CREEP,
        )  # fmt: skip

    structures: dict[str, Callable[[], Actuator]] = {
        "piezo": piezo,
        "inverted": lambda: Actuator(
            Plays(r(0.3, 0.5), r(0.1, 0.2)),
            stroke=-15.0,
            curve=bent(0.1),
            lag=0.002,
            creep=CREEP,
        ),
        "bent drive": bent_drive,
        "relays": lambda: Actuator(
            Relays(r(0.4, 0.7), r(0.1, 0.2), r(-0.8, 0.8)),
            curve=bent(r(-0.1, 0.1)),
            lag=0.002,
        ),
        "bouc-wen": lambda: Actuator(
            BoucWen(r(0.25, 0.45), r(0.08, 0.16), r(0.1, 0.5)), lag=r(0.001, 0.004)
        ),
        "softening": lambda: Actuator(
            Plays(-r(0.4, 0.9), r(0.06, 0.12)), curve=bent(0.06), lag=0.002
        ),
        "friction": lambda: Actuator(
            Friction((r(0.02, 0.05), r(0.07, 0.12)), (r(0.2, 0.4), r(0.3, 0.5)))
        ),
        "tendon": lambda: Actuator(
            Friction((0.06, 0.1), (0.6, 0.38)), curve=bent(r(-0.1, 0.1), r(0.05, 0.2))
        ),
        "saturating": lambda: Actuator(
            Plays(0.45, 0.12), curve=saturating(r(1.2, 1.8)), lag=0.002
        ),
        "wing": lambda: Actuator(Plays(0.6, 0.2), curve=wing(r(6.0, 9.0)), lag=0.01),
        "dead zone": lambda: Actuator(
            Plays(0.4, 0.15), curve=dead_zone(r(0.4, 0.6), r(0.1, 0.2))
        ),
        "rate-widening": lambda: Actuator(
            Plays(0.4, 0.15), curve=bent(0.1), widening=r(0.008, 0.02), lag=0.002
        ),
        "creeping": lambda: Actuator(
            Plays(0.4, 0.15),
            curve=bent(-0.1),
            lag=0.002,
            creep=((0.1, 0.012), (1.5, 0.025), (20.0, 0.04)),
        ),
        "delayed": lambda: Actuator(
            Plays(0.4, 0.15), curve=bent(0.1), delay=int(rng.integers(2, 6))
        ),
    }
    number = seed * 1000
    for name, make in structures.items():
        number += 1
        yield case(f"{name}", make(), Bench(noise=r(0.0003, 0.001)), "excite", number)
    for name in ("piezo", "relays", "bent drive", "creeping", "friction"):
        number += 1
        yield case(
            f"{name}, nested turns", structures[name](), Bench(), "nested", number
        )
    for name in ("piezo", "bent drive", "bouc-wen", "tendon", "softening"):
        number += 1
        yield case(f"{name}, one sine", structures[name](), Bench(), "sine", number)
    for name, kinds in (
        ("piezo", "two"), ("tendon", "two"), ("bent drive", "fading"), ("piezo", "part"), ("wing", "part"),
        ("friction", "part"), ("piezo", "short"), ("tendon", "short"), ("piezo", "few"), ("relays", "ramps"),
        ("saturating", "ramps"), ("piezo", "sine@0.5+sine@4"), ("creeping", "fading@0.5+fading@3"),
    ):  # fmt: skip
        number += 1
        yield case(f"{name}, {kinds}", structures[name](), Bench(), kinds, number)
    faults = {
        "hum 1 %": Bench(hum=0.01),
        "hum 5 %": Bench(hum=0.05),
        "spikes 1 %": Bench(spikes=0.01),
        "spikes 4 %": Bench(spikes=0.04),
        "read-back 0.5 %": Bench(read_back=0.005),
        "sensor lag": Bench(sensor_lag=0.008),
        "drift 1 %": Bench(drift=0.01),
        "drift 5 %": Bench(drift=0.05),
        "warm-up 3 %": Bench(warm_up=0.03),
        "8 bit": Bench(steps=1 / 256),
        "stuck": Bench(stuck=0.06),
        "rows lost": Bench(lost=0.02),
    }
    for fault, bench in faults.items():
        number += 1
        yield case(f"piezo, {fault}", piezo(), bench, "excite", number)
        if fault in ("drift 5 %", "warm-up 3 %", "drift 1 %"):
            yield case(
                f"creeping, {fault}", structures["creeping"](), bench, "nested", number
            )
            yield case(f"piezo, {fault}, sine", piezo(), bench, "sine", number)
