"""Actuators of kinds that the package does not have: how well moves are predicted, and what is stated of it.

Each plant is recorded with several drives. The model of every recording, and its rivals
from ``dbo_cli.extras.compare``, predict moves of other levels, amplitudes, speeds and
dwell, each after a full sweep. Printed are the test error over that of the best rival
(chosen by test error, which no user can), and the actual error, offset and the sensor's
noise included, over the one stated for that very move.

    python benchmarks/foreign_plants.py [--only TEXT] [--processes N] [--held-out] [--without-rivals]

The errors are judged in two parts: shape, less the mean error, and zero, the mean
error's size, with or without a word of doubt behind it. The kinds of
``held_out_plants.py`` took no part in any choice; only --held-out judges them, and them
alone.
"""

from __future__ import annotations

import argparse
import itertools
import multiprocessing
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parent))
import held_out_plants
from invented_actuators import (
    RATE,
    BoucWen,
    Plays,
    bent,
    drive,
    first_order,
    nested_turns,
    swept,
)

from dbo_cli.extras.compare.judging import compare
from dbo_cli.hysteresis.identification import Recording
from dbo_cli.hysteresis.identification.evaluation import predict
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.move_error import UNLIKE, ZERO_STAYS, MoveError, move_error
from dbo_cli.runs.api import Model

Floats = NDArray[np.float64]
# drive of 0 to 1 and seconds since switching on, to 0 to 1
Plant = Callable[[Floats, float], Floats]

STEP = 1.0 / RATE
TOP, STROKE = 100.0, 20.0
NOISE = 0.0005  # of the stroke: a strain gauge's
RIVALS = ("pi", "rate", "asymmetric")
LOGS = ("excite", "nested", "fading", "two", "ramps", "sine")
CONDITION = swept([0.0, 1.0, 0.0], [1.0, 1.0], RATE)
LATER = 60.0  # seconds from the beginning of a log to that of a move


# --- the plants ---


def preisach(up: Floats, down: Floats, straight: float, taken: float = 1.0) -> Plant:
    """Relays that switch at ``up`` and ``down``; a switch goes the part ``taken`` of the way."""

    def run(u: Floats, _: float) -> Floats:
        state, out = np.zeros(len(up)), np.empty(len(u))
        above, below = np.zeros(len(up), bool), np.ones(len(up), bool)
        for k, value in enumerate(u.tolist()):
            on, off = value >= up, value <= down
            state += (
                taken * (on & ~above) * (1.0 - state) - taken * (off & ~below) * state
            )
            above, below = (above | on) & ~off, (below | off) & ~on
            out[k] = state.mean()
        return straight * u + (1.0 - straight) * out

    return run


def relays(
    centre: float, centre_spread: float, width: float, seed: int
) -> tuple[Floats, Floats]:
    """Thresholds up and down of 1,200 relays, scattered about a level with random widths."""
    rng = np.random.default_rng(seed)
    middle = centre + centre_spread * rng.uniform(-1.0, 1.0, 1200)
    half = 0.5 * width * rng.gamma(2.0, 0.5, 1200)
    return np.minimum(middle + half, 0.995), np.maximum(middle - half, 0.005)


def duhem(pull: float, lean: float, slope: float) -> Plant:
    """Coleman and Hodgdon's form: y' = pull |u'| (f(u) - y) + slope u'."""

    def run(u: Floats, since: float) -> Floats:
        y, out, last = 0.0, np.empty(len(u)), float(u[0])
        for k, value in enumerate(u.tolist()):
            parts = max(1, int(abs(value - last) / 0.002))
            step = (value - last) / parts
            for _ in range(parts):
                last += step
                y += (
                    pull * abs(step) * (last + lean * last * (1.0 - last) - y)
                    + slope * step
                )
            last = value
            out[k] = y
        return out

    return run


def maxwell(stiffness: Floats, slips: Floats, beside: float) -> Plant:
    """Springs that slip at their forces, and one that does not: steep after each turn."""

    def run(u: Floats, _: float) -> Floats:
        z, out = np.zeros(len(slips)), np.empty(len(u))
        last = 0.0
        for k, value in enumerate(u.tolist()):
            z = np.clip(z + value - last, -slips, slips)
            last = value
            out[k] = beside * value + float(stiffness @ z)
        return out / (beside + float(stiffness @ np.minimum(slips, 1.0)))

    return run


def krasnoselskii(loop: float, seed: int) -> Plant:
    """Generalised plays whose envelopes on the way up and down are different curves."""
    radii = np.linspace(0.0, 0.3, 60)
    weights = np.exp(-radii / 0.12) / float(np.exp(-radii / 0.12).sum())
    lean = float(np.random.default_rng(seed).uniform(0.3, 0.6))

    def run(u: Floats, _: float) -> Floats:
        held, out = np.zeros(60), np.empty(len(u))
        for k, value in enumerate(u.tolist()):
            rising, falling = (
                value + lean * value * (value - 1.0),
                np.sin(0.5 * np.pi * value),
            )
            held = np.maximum(rising - radii, np.minimum(falling + radii, held))
            out[k] = float(held @ weights)
        return (1.0 - loop) * u + loop * out

    return run


def slow_amplifier(rise: float, fall: float, lag: float) -> Plant:
    """Return a piezo behind an amplifier that slews at most ``rise`` and ``fall`` ranges a second."""

    def run(u: Floats, _: float) -> Floats:
        out, at = np.empty(len(u)), float(u[0])
        for k, value in enumerate(u.tolist()):
            at += min(max(value - at, -fall * STEP), rise * STEP)
            out[k] = at
        return Plays(0.4, 0.15).run(first_order(out, STEP, lag))

    return run


def warming(share: float, tau: float) -> Plant:
    """Return a plant whose gain grows from switching on."""

    def run(u: Floats, since: float) -> Floats:
        clock = since + STEP * np.arange(len(u))
        return Plays(0.4, 0.12).run(u) * (1.0 + share * (1.0 - np.exp(-clock / tau)))

    return run


def drifting(share: float, period: float) -> Plant:
    """Return a piezo whose zero goes to and fro by ``share`` of the stroke, as the air conditioning does."""

    def run(u: Floats, since: float) -> Floats:
        clock = since + STEP * np.arange(len(u))
        return Plays(0.4, 0.15).run(u) + 0.5 * share * np.sin(
            2.0 * np.pi * clock / period
        )

    return run


def log_creep(share: float) -> Plant:
    """Creep by the same share every decade from 0.05 to 500 s."""

    def run(u: Floats, _: float) -> Floats:
        x = bent(0.08)(Plays(0.45, 0.15).run(u))
        taus = 0.05 * 10.0 ** (np.arange(13) / 3.0)
        return x + share / 3.0 * sum(
            first_order(x, STEP, float(tau)) - x for tau in taus
        )

    return run


def late(lag: float) -> Plant:
    """Return a piezo behind an amplifier's first-order lag."""
    return lambda u, _: bent(0.1)(Plays(0.4, 0.15).run(first_order(u, STEP, lag)))


def widening(part: float) -> Plant:
    """Loops that widen with the logarithm of the speed."""

    def run(u: Floats, _: float) -> Floats:
        speed = np.gradient(u, STEP)
        return Plays(0.4, 0.15).run(
            np.clip(u - part * np.sign(speed) * np.log1p(np.abs(speed) / 0.1), 0.0, 1.0)
        )

    return run


@dataclass(frozen=True)
class Kind:
    """A plant, and how late its sensor is: samples of delay and a first-order lag (s)."""

    plant: Plant
    sensor_delay: int = 0
    sensor_lag: float = 0.0


KINDS: dict[str, Kind] = {
    "bouc-wen": Kind(lambda u, _: BoucWen(0.4, 0.12, 0.35).run(u)),
    "preisach wide": Kind(preisach(*relays(0.5, 0.6, 0.45, 1), 0.45)),
    "preisach steep": Kind(preisach(*relays(0.5, 0.22, 0.2, 2), 0.15)),
    "duhem": Kind(duhem(6.0, 0.3, 0.35)),
    "maxwell slip": Kind(
        maxwell(np.array([1.2, 0.9, 0.6]), np.array([0.02, 0.06, 0.15]), 0.7)
    ),
    "log creep": Kind(log_creep(0.02)),
    "krasnoselskii": Kind(krasnoselskii(0.6, 3)),
    "slow amplifier": Kind(slow_amplifier(4.0, 2.0, 0.003)),
    "warm-up gain": Kind(warming(0.03, 20.0)),
    "first-order lag": Kind(late(0.012)),
    "late sensor": Kind(late(0.002), 2, 0.004),
    "accommodation": Kind(preisach(*relays(0.5, 0.5, 0.35, 4), 0.5, 0.6)),
    "rate-widening": Kind(widening(0.008)),
    "drifting zero": Kind(drifting(0.02, 170.0)),
}
HELD_OUT: dict[str, Kind] = {
    name: Kind(plant) for name, plant in held_out_plants.PLANTS.items()
}


# --- what is recorded, and what is asked of the models ---


def recorded(kind: Kind, log: str, seed: int) -> Recording:
    """Return what the logger wrote of one drive."""
    shape, rate = drive(log, seed)
    assert rate == RATE
    moved = kind.plant(shape, 0.0)
    seen = first_order(moved, STEP, kind.sensor_lag)
    if kind.sensor_delay:
        seen = np.concatenate(
            (np.full(kind.sensor_delay, seen[0]), seen[: -kind.sensor_delay])
        )
    seen = STROKE * (seen + NOISE * np.random.default_rng(seed).normal(size=len(seen)))
    return Recording(
        log, TOP * shape, seen, STEP * np.arange(len(shape)), None, "V", "um"
    )


def moves(seed: int) -> Iterator[tuple[str, Floats]]:
    """Yield drives of 0 to 1, each from 0: levels, amplitudes, speeds and dwell of all kinds."""
    rng = np.random.default_rng(seed)
    yield "nested", nested_turns(seed, RATE, 12.0, (0.4, 6.0))
    yield "slow", swept([0.0, 1.0, 0.0, 1.0, 0.0], [3.0] * 4, RATE)
    yield "high", swept([0.0, *[0.6, 0.9] * 8, 0.6], [1.0] + [0.25] * 16, RATE)
    yield "low", swept([0.0, *[0.1, 0.3] * 8, 0.1], [0.5] + [0.2] * 16, RATE)
    yield "tiny", swept([0.0, *[0.48, 0.55] * 6, 0.5], [1.0] + [0.15] * 12, RATE)
    yield "fast", swept([0.0, *[1.0, 0.0] * 8], [0.25] * 16, RATE)
    levels = rng.uniform(0.05, 0.95, 12)
    yield "dwell", swept([0.0, *np.repeat(levels, 2)], [0.4, 0.6] * 12, RATE)
    levels = np.concatenate((np.linspace(0.05, 0.95, 60), np.linspace(0.95, 0.05, 60)))
    yield "pixels", np.concatenate((np.zeros(20), np.repeat(levels, 8)))


@dataclass(frozen=True)
class Line:
    """One move of one plant after one log; errors in % of the stroke."""

    kind: str
    log: str
    move: str
    ours: float
    rival: float
    rival_name: str
    shape: float
    zero: float
    stated: float
    stated_shape: float
    stated_zero: float
    warned: str
    zero_doubted: bool

    @property
    def ratio(self) -> float:
        """Actual error, the sensor's noise included, over the stated one."""
        return float(np.hypot(self.ours, 100.0 * NOISE)) / self.stated

    @property
    def shape_ratio(self) -> float:
        """The same of the error less its mean."""
        return float(np.hypot(self.shape, 100.0 * NOISE)) / self.stated_shape

    @property
    def zero_ratio(self) -> float:
        """The mean error over the one stated."""
        return self.zero / self.stated_zero


def lines_of(task: tuple[str, str, int, tuple[str, ...]]) -> list[Line] | str:
    """Identify from one log, and judge all models on all moves."""
    name, log, seed, others = task
    kind = (KINDS | HELD_OUT)[name]
    rows = compare([recorded(kind, log, seed)], names=("dbo", *others), timed=False)
    own = rows[0].model
    if own is None:
        return f"{name}, {log}: refused: {rows[0].refused}"
    if not isinstance(own.fit["expected_rmse"], float):
        return f"{name}, {log}: what error to expect was not told"
    rivals = [(row.name, row.model) for row in rows[1:] if row.model is not None]
    found = []
    for move, shape in moves(seed + 500):
        shape = np.concatenate((CONDITION, shape))
        truth = STROKE * kind.plant(shape, LATER)
        test = Recording(
            move, TOP * shape, truth, STEP * np.arange(len(shape)), None, "V", "um"
        )
        begin = len(CONDITION)
        left = _left(own, test, begin)
        ours = float(np.sqrt(np.mean(left**2)))
        rival, rival_name = min(
            ((_error(model, test, begin), label) for label, model in rivals),
            default=(ours, "none"),
        )
        stated, warnings = stated_error(own, test, begin)
        doubted = (
            stated.unlike > UNLIKE
            or stated.repeats_small
            or own.fit["zero_from"] != ZERO_STAYS
        )
        parts = [
            100.0 / STROKE * part for part in (stated.rmse, stated.shape, stated.zero)
        ]
        warned = "model" if own.fit["warnings"] else "use" if warnings else ""
        errors = ours, rival, rival_name, float(left.std()), abs(float(left.mean()))
        found.append(Line(name, log, move, *errors, *parts, warned, doubted))
    return found


def _left(model: ActuatorModel, test: Recording, begin: int) -> Floats:
    """Return the error of each row from ``begin`` on, in % of the stroke."""
    left: Floats = (test.displacement - predict(model, test, "empty"))[begin:]
    return 100.0 * left / STROKE


def _error(model: ActuatorModel, test: Recording, begin: int) -> float:
    """RMSE in % of the stroke, offset included."""
    return float(np.sqrt(np.mean(_left(model, test, begin) ** 2)))


def stated_error(
    model: ActuatorModel, test: Recording, begin: int
) -> tuple[MoveError, bool]:
    """Return what is stated of this move, and whether it is warned of."""
    found = move_error(model, test.voltage, STEP, begin)
    assert found is not None and found.shape is not None and found.zero is not None
    used = Model(model).simulate(test.voltage, time=test.seconds(), details=True)
    return found, bool(used.warnings) or found.form >= found.straight_line


def main() -> None:
    """Print one line a move and the summary."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument(
        "--only", default="", help="only the plants and logs whose names hold this text"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument(
        "--held-out", action="store_true", help="the kinds held out instead"
    )
    parser.add_argument(
        "--without-rivals", action="store_true", help="judge what is stated alone"
    )
    given = parser.parse_args()
    others = () if given.without_rivals else RIVALS
    wanted = [
        (kind, log, given.seed, others)
        for kind, log in itertools.product(HELD_OUT if given.held_out else KINDS, LOGS)
        if given.only in f"{kind}, {log}"
    ]
    lines: list[Line] = []
    print(
        f"{'plant':16}{'log':8}{'move':8} dbo %  rival %  ratio  stated %  actual/stated  warned  rival"
    )
    with multiprocessing.Pool(given.processes) as pool:
        for found in pool.imap(lines_of, wanted):
            if isinstance(found, str):
                print(found, flush=True)
                continue
            for one in found:
                print(
                    f"{one.kind:16}{one.log:8}{one.move:8}{one.ours:6.3f}  {one.rival:7.3f}  "
                    f"{one.ours / one.rival:5.2f}  {one.stated:8.3f}  {one.ratio:13.2f}  "
                    f"{one.warned or 'no':6}  {one.rival_name}",
                    flush=True,
                )
            lines += found
    if lines:
        print(
            f"\n{len(lines)} moves of {'the kinds held out' if given.held_out else 'the kinds known'}"
        )
        summary(lines)


def summary(lines: list[Line]) -> None:
    """Print the figures of all lines."""
    for kind in [*dict.fromkeys(one.kind for one in lines), ""]:
        some = [one for one in lines if kind in ("", one.kind)]
        over = np.array([one.ours / one.rival for one in some])
        percentiles = np.percentile([one.ratio for one in some], [10.0, 50.0, 90.0])
        print(
            f"{kind or 'all':16} over the best rival's {np.exp(np.mean(np.log(over))):5.2f}, ahead on "
            f"{np.mean(over <= 1.0):4.0%}; actual over stated 10/50/90 % "
            f"{'/'.join(f'{value:.2f}' for value in percentiles)}"
        )
    unwarned = [one for one in lines if not one.warned]
    warned = np.mean([bool(one.warned) for one in lines if one.shape_ratio <= 1.5])
    print(
        f"{len(unwarned)} without a warning; of those within 1.5 warned of: {warned:.0%}"
    )
    parts = {
        "whole": [one.ratio for one in unwarned],
        "shape": [one.shape_ratio for one in unwarned],
        "zero": [one.zero_ratio for one in unwarned],
    }
    for part, ratios in parts.items():
        if ratios:
            shown = "/".join(
                f"{value:.2f}" for value in np.percentile(ratios, [10.0, 50.0, 90.0])
            )
            print(
                f"  {part}: actual over stated 10/50/90 % {shown}, {sum(r > 2.0 for r in ratios)} beyond 2"
            )
    unsaid = [one for one in unwarned if one.zero_ratio > 2.0 and not one.zero_doubted]
    for one in unsaid:
        print(
            f"    zero {one.zero_ratio:.2f} times what was stated: {one.kind}, {one.log}, {one.move}"
        )
    doubted = sum(one.zero_doubted for one in unwarned)
    print(
        f"  doubt stands behind {doubted} zeros; {len(unsaid)} are beyond 2 without a doubt"
    )


if __name__ == "__main__":
    main()
