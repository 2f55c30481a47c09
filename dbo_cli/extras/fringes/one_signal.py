"""From one photodiode and the drive to a phase: branches by a model of the actuator, values by the light."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import InputError
from dbo_cli.extras.fringes import branches
from dbo_cli.extras.fringes.actuator_prior import Columns, columns_of
from dbo_cli.extras.fringes.branches import TURN, Fit, Light, Nodes
from dbo_cli.extras.fringes.light import (
    DRIFT,
    FIRST_DRIFT,
    clipped_rows,
    fit_light,
    percentile_ends,
    travelled,
)
from dbo_cli.extras.fringes.phase_smoother import Channel, Smoothed, smooth
from dbo_cli.extras.fringes.swings import (
    Floats,
    Indices,
    crossings,
    drive_threshold,
    kinks_of,
    turning_points,
)
from dbo_cli.extras.fringes.track import Track, TurnOdds
from dbo_cli.extras.fringes.whole_counts import added_counts, joint_odds, swing_counts

ROUNDS = 10
"""Rounds of model and branches at most."""
FEWEST_ROUNDS = 3
"""Rounds at least: the light is fitted better in each."""
VALUE_ROUNDS = 3
"""Rounds of phases and of the light that they fit."""
FIRST_ROUNDS = 4
"""Rounds of the first fit whose bends act on the phase of the round before."""
INSIDE = (0.12, 0.97)
"""Of a swing's voltage: crossings between these are counted in the first fit; a lag is over there. The first
swing has no turn before it, and counts from its beginning.
"""
FEWEST_CROSSINGS = 8
"""Crossings of the middle: four fringes on the whole way."""


@dataclass(frozen=True)
class _Log:
    """A log, cut into swings and blocks.

    ``weight`` (rows) is 0 where the photodiode is clipped. ``half_stroke`` is about, in
    rad.
    """

    time: Floats
    drive: Floats
    signal: Floats
    weight: Floats
    turns: Indices
    nodes: Nodes
    fringes_a_volt: float

    @property
    def half_stroke(self) -> float:
        """Half of the whole displacement, about, rad."""
        return 0.5 * TURN * self.fringes_a_volt * float(np.ptp(self.drive))

    def columns(self, phase: Floats | None = None) -> Columns:
        """Return the terms of an actuator at the blocks, bent as an earlier model's phase."""
        starts = self.nodes.starts
        return columns_of(
            self.time[starts], self.drive[starts], self.turns.size - 1, phase
        )

    def at_rows(self, at_blocks: Floats) -> Floats:
        """Return values of the blocks' first rows at every row."""
        return np.interp(np.arange(self.signal.size), self.nodes.starts, at_blocks)


def track_one_signal(time: Floats, drive: Floats, signal: Floats) -> Track:
    """Return the phase of one photodiode's log; it rises with the drive.

    Parameters
    ----------
    time, drive, signal
        s, V, and the photodiode in any unit (rows).

    Raises
    ------
    InputError
        There are no fringes, or too few of them.
    """
    log, fit = _first_model(time, drive, signal)
    light = _demodulated(signal, log.at_rows(fit.phase), log.weight)
    fit, light, rounds = _settled(log, fit, light)
    chain, distance, phase = _path(log, light, fit, branches.REACH)
    records = _odds(log, fit, chain, distance)
    doubt = log.at_rows(branches.doubt(chain, distance))
    smoothed, channel = _values(log, light, phase)
    deviation = np.sqrt(smoothed.deviation**2 + doubt)
    noise = channel.noise / float(np.mean(np.abs(channel.cosine)))
    clipped = int(signal.size - log.weight.sum())
    return Track(smoothed.phase, deviation, records, noise, [channel], rounds, clipped)


def _first_model(time: Floats, drive: Floats, signal: Floats) -> tuple[_Log, Fit]:
    """Return the log cut into blocks, and a model from the crossings inside the swings."""
    turns = turning_points(drive, drive_threshold(drive))
    weight = np.where(clipped_rows(signal), 0.0, 1.0)
    low, high = percentile_ends(signal)
    middle = np.full(signal.size, 0.5 * (low + high))
    amplitude = np.full(signal.size, 0.5 * (high - low))
    places, slopes = crossings(signal, middle, amplitude)
    if places.size < FEWEST_CROSSINGS:
        raise InputError(_few(places.size))
    volts = np.interp(places, np.arange(drive.size), drive)
    chosen, phases, swings = _phases_inside(places, slopes, volts, drive, turns)
    fringes_a_volt = _slope(phases, volts[chosen], swings, places.size)
    nodes = branches.make_nodes(time, drive, turns, fringes_a_volt)
    log = _Log(time, drive, signal, weight, turns, nodes, fringes_a_volt)
    at_blocks = np.interp(places[chosen], nodes.starts, np.arange(nodes.starts.size))
    phase = None
    for _ in range(FIRST_ROUNDS):
        fit = branches.first_fit(
            log.columns(phase),
            at_blocks,
            phases,
            swings,
            log.half_stroke,
            turns.size - 2,
        )
        phase = fit.phase
    return log, fit


def _settled(log: _Log, fit: Fit, light: Light) -> tuple[Fit, Light, int]:
    """Return model and light once another round changes no branch, and the rounds; 0 where none came."""
    before = None
    reach = 2.0 * branches.REACH
    for number in range(ROUNDS):
        _, distance, phase = _path(log, light, fit, reach)
        reach = branches.REACH
        drift = FIRST_DRIFT if number < FEWEST_ROUNDS - 1 else DRIFT
        factors, noise = fit_light(
            log.signal, [np.cos(phase)], travelled(phase), log.weight, drift
        )
        light = Light(factors[0], factors[1], noise, log.weight)
        at_blocks = fit.phase + distance
        columns = log.columns(fit.phase)
        counts = swing_counts(columns, log.nodes, at_blocks, log.half_stroke)
        at_blocks = at_blocks + TURN * added_counts(log.nodes, counts)
        fit = branches.refit(columns, log.nodes, at_blocks, log.half_stroke)
        anchors = branches.anchors_of(log.nodes, fit.phase)
        if before is not None and number >= FEWEST_ROUNDS:
            moved = (at_blocks - at_blocks[0]) - (before - before[0])
            if np.max(np.abs(moved[anchors])) < branches.SAME_BRANCH * TURN:
                return fit, light, number
        before = at_blocks
    return fit, light, 0


def _odds(
    log: _Log, fit: Fit, chain: branches.Chain, distance: Floats
) -> list[TurnOdds]:
    """Return the odds of each inner turn: by itself, and with all others."""
    odds, others = branches.turn_odds(
        chain, distance, branches.anchors_of(log.nodes, fit.phase)
    )
    counts = swing_counts(
        log.columns(fit.phase), log.nodes, fit.phase + distance, log.half_stroke
    )
    odds, others = joint_odds(odds, others, counts)
    records = []
    for row, odd, other in zip(log.turns[1:-1], odds, others, strict=True):
        records.append(TurnOdds(int(row), float(odd), float(other) / TURN))
    return records


def _values(log: _Log, light: Light, phase: Floats) -> tuple[Smoothed, Channel]:
    """Return the phases that the light gives on these branches, and what it is like there."""
    kinks = kinks_of(log.drive, log.fringes_a_volt)
    none = np.zeros(phase.size)
    for _ in range(VALUE_ROUNDS):
        channel = Channel(
            log.signal, light.offset, light.amplitude, none, light.noise, log.weight
        )
        smoothed = smooth(log.time, [channel], phase, kinks)
        phase = smoothed.phase
        factors, _ = fit_light(
            log.signal, [np.cos(phase)], travelled(phase), log.weight
        )
        light = Light(factors[0], factors[1], smoothed.noise[0], log.weight)
    return smoothed, channel


def _few(crossed: int) -> str:
    """Return the complaint about too few fringes."""
    return (
        f"it crosses its middle {crossed} times on the whole way, and at least {FEWEST_CROSSINGS} crossings "
        "inside the drive's swings are needed: there are no fringes to count (is it the photodiode, does the "
        "light interfere, does the actuator move by two fringes and back?)"
    )


def _demodulated(signal: Floats, model: Floats, weight: Floats) -> Light:
    """Return offset and amplitude at a model's phases, whatever its slow error: by cosine and sine."""
    terms = [np.cos(model), np.sin(model)]
    factors, noise = fit_light(signal, terms, travelled(model), weight, FIRST_DRIFT)
    return Light(factors[0], np.hypot(factors[1], factors[2]), noise, weight)


def _path(
    log: _Log, light: Light, fit: Fit, reach: float
) -> tuple[branches.Chain, Floats, Floats]:
    """Return the chain, its path (rad from the model, blocks), and the phase on it (rows)."""
    nodes = log.nodes
    rows = np.arange(log.signal.size)
    model = log.at_rows(fit.phase)
    chain = branches.follow(nodes, log.signal, light, fit, model, reach)
    distance = chain.distance
    middles = nodes.starts + 0.5 * np.diff(np.append(nodes.starts, log.signal.size))
    return chain, distance, model + np.interp(rows, middles, distance)


def _phases_inside(
    places: Floats,
    slopes: NDArray[np.int_],
    volts: Floats,
    drive: Floats,
    turns: Indices,
) -> tuple[NDArray[np.bool_], Floats, NDArray[np.int_]]:
    """Return which crossings are well inside a swing, their phases in it, and its number."""
    chosen = np.zeros(places.size, dtype=bool)
    phases = np.zeros(places.size)
    swings = np.zeros(places.size, dtype=np.int_)
    for number, (begin, end) in enumerate(pairwise(turns)):
        travel = drive[end] - drive[begin]
        part = (volts - drive[begin]) / travel
        least = INSIDE[0] if number > 0 else 0.0
        inside = (places > begin) & (places < end) & (part > least) & (part < INSIDE[1])
        rows = np.flatnonzero(inside)
        if rows.size == 0:
            continue
        direction = 1 if travel > 0.0 else -1
        first = -0.5 * np.pi * direction * slopes[rows[0]]
        phases[rows] = first + direction * np.pi * np.arange(rows.size)
        swings[rows] = number
        chosen[rows] = True
    return chosen, phases[chosen], swings[chosen]


def _slope(
    phases: Floats, volts: Floats, swings: NDArray[np.int_], crossed: int
) -> float:
    """Return the fringes in a volt, from the crossings inside the swings."""
    same = np.diff(swings) == 0
    travel = float(np.abs(np.diff(volts))[same].sum())
    count = float(np.abs(np.diff(phases))[same].sum())
    if travel == 0.0:
        raise InputError(_few(crossed))
    return count / TURN / travel
