"""From one photodiode and the drive to a phase: branches by a model of the actuator, values by the light."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import InputError
from dbo_cli.extras.fringes import branches
from dbo_cli.extras.fringes.actuator_prior import columns_of
from dbo_cli.extras.fringes.branches import TURN, Fit, Light, Nodes
from dbo_cli.extras.fringes.light import clipped_rows, fit_light, percentile_ends, travelled
from dbo_cli.extras.fringes.phase_smoother import Channel, smooth
from dbo_cli.extras.fringes.swings import (
    Floats,
    Indices,
    crossings,
    drive_threshold,
    noise_of,
    turning_points,
)
from dbo_cli.extras.fringes.track import Track, TurnOdds
from dbo_cli.extras.fringes.whole_counts import added_counts, joint_odds, swing_counts

ROUNDS = 10
"""Rounds of model and branches at most."""
FIRST_ROUNDS = 3
"""Rounds of the first fit whose bends act on the phase of the round before."""
INSIDE = (0.12, 0.97)
"""Of a swing's voltage: crossings between these are counted in the first fit; a lag is over there."""
FEWEST_CROSSINGS = 8
"""Crossings of the middle: four fringes on the whole way."""


def track_one_signal(time: Floats, drive: Floats, signal: Floats) -> Track:
    """Return the phase of one photodiode's log; it rises with the drive."""
    turns = turning_points(drive, drive_threshold(drive))
    clipped = clipped_rows(signal)
    weight = np.where(clipped, 0.0, 1.0)
    low, high = percentile_ends(signal)
    middle = np.full(signal.size, 0.5 * (low + high))
    amplitude = np.full(signal.size, 0.5 * (high - low))
    places, slopes = crossings(signal, middle, amplitude)
    if places.size < FEWEST_CROSSINGS:
        raise InputError("few")
    volts = np.interp(places, np.arange(drive.size), drive)
    chosen, phases, swings = _phases_inside(places, slopes, volts, drive, turns)
    fringes_a_volt = _slope(phases, volts[chosen], swings, places.size)
    nodes = branches.make_nodes(time, drive, turns, fringes_a_volt)
    half_stroke = 0.5 * TURN * fringes_a_volt * float(np.ptp(drive))
    node_time = time[nodes.starts]
    node_drive = drive[nodes.starts]
    count = nodes.turns.size - 2
    columns = columns_of(node_time, node_drive, count + 1)
    at_nodes = np.interp(places[chosen], nodes.starts, np.arange(nodes.starts.size))
    fit = branches.first_fit(columns, at_nodes, phases, swings, half_stroke, count)
    for _ in range(FIRST_ROUNDS):
        columns = columns_of(node_time, node_drive, count + 1, fit.phase)
        fit = branches.first_fit(columns, at_nodes, phases, swings, half_stroke, count)
    model = np.interp(np.arange(drive.size), nodes.starts, fit.phase)
    light = _demodulated(signal, model, weight)
    reach = 2.0 * branches.REACH
    before: NDArray[np.float64] | None = None
    rounds = 0
    for number in range(ROUNDS):
        chain, distance, phase = _path(nodes, signal, light, fit, reach)
        factors, noise = fit_light(signal, [np.cos(phase)], travelled(phase), weight)
        light = Light(factors[0], factors[1], noise, weight)
        at_node = fit.phase + distance
        columns = columns_of(node_time, node_drive, count + 1, fit.phase)
        found = swing_counts(columns, nodes, at_node, half_stroke)
        if np.any(found.counts != 0):
            at_node = at_node + TURN * added_counts(nodes, found)
        fit = branches.refit(columns, nodes, at_node, half_stroke)
        reach = branches.REACH
        anchors = branches.anchors_of(nodes, fit.phase)
        if before is not None and np.max(np.abs(at_node - before)[anchors]) < 0.25 * TURN:
            rounds = number
            if number >= 3:
                break
        before = at_node
    chain, distance, phase = _path(nodes, signal, light, fit, reach)
    odds, others = branches.turn_odds(chain, distance, branches.anchors_of(nodes, fit.phase))
    found = swing_counts(columns, nodes, fit.phase + distance, half_stroke)
    doubt = np.interp(np.arange(signal.size), nodes.starts, branches.doubt(chain, distance))
    odds, others = joint_odds(odds, others, found)
    kinks = kinks_of(drive, fringes_a_volt)
    smoothed = None
    for _ in range(3):
        channel = Channel(signal, light.offset, light.amplitude, np.zeros(signal.size), light.noise, weight)
        smoothed = smooth(time, [channel], phase, kinks)
        phase = smoothed.phase
        factors, noise = fit_light(signal, [np.cos(phase)], travelled(phase), weight)
        light = Light(factors[0], factors[1], smoothed.noise[0], weight)
    assert smoothed is not None
    records = [
        TurnOdds(int(row), float(odd), float(other) / TURN)
        for row, odd, other in zip(turns[1:-1], odds, others, strict=True)
    ]
    ratio = light.noise / float(np.mean(np.abs(light.amplitude)))
    deviation = np.sqrt(smoothed.deviation**2 + doubt)
    return Track(smoothed.phase, deviation, records, ratio, [channel], rounds, int(clipped.sum()))


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
    factors, noise = fit_light(signal, terms, travelled(model), weight)
    return Light(factors[0], np.hypot(factors[1], factors[2]), noise, weight)


def _path(
    nodes: Nodes, signal: Floats, light: Light, fit: Fit, reach: float
) -> tuple[branches.Chain, Floats, Floats]:
    rows = np.arange(signal.size)
    model = np.interp(rows, nodes.starts, fit.phase)
    chain = branches.follow(nodes, signal, light, fit, model, reach)
    distance = chain.distance
    middles = nodes.starts + 0.5 * np.diff(np.append(nodes.starts, signal.size))
    return chain, distance, model + np.interp(rows, middles, distance)


def kinks_of(drive: Floats, fringes_a_volt: float) -> Floats:
    """Return how sharply the phase may turn because the drive has a corner, rad^2 (rows)."""
    second = np.zeros(drive.size)
    second[1:-1] = np.abs(np.diff(drive, 2))
    usual = float(np.median(second)) + noise_of(drive)
    sharp = np.where(second > 10.0 * usual, second, 0.0) * TURN * fringes_a_volt
    wide = sharp.copy()
    for shift in (1, 2, 3):
        wide[shift:] = np.maximum(wide[shift:], sharp[:-shift])
        wide[:-shift] = np.maximum(wide[:-shift], sharp[shift:])
    return wide**2


def _phases_inside(
    places: Floats, slopes: NDArray[np.int_], volts: Floats, drive: Floats, turns: Indices
) -> tuple[NDArray[np.bool_], Floats, NDArray[np.int_]]:
    """Return which crossings are well inside a swing, their phases in it, and its number."""
    chosen = np.zeros(places.size, dtype=bool)
    phases = np.zeros(places.size)
    swings = np.zeros(places.size, dtype=np.int_)
    for number, (begin, end) in enumerate(zip(turns[:-1], turns[1:], strict=True)):
        travel = drive[end] - drive[begin]
        part = (volts - drive[begin]) / travel
        inside = (places > begin) & (places < end) & (part > INSIDE[0]) & (part < INSIDE[1])
        rows = np.flatnonzero(inside)
        if rows.size == 0:
            continue
        direction = 1 if travel > 0.0 else -1
        first = -0.5 * np.pi * direction * slopes[rows[0]]
        phases[rows] = first + direction * np.pi * np.arange(rows.size)
        swings[rows] = number
        chosen[rows] = True
    return chosen, phases[chosen], swings[chosen]


def _slope(phases: Floats, volts: Floats, swings: NDArray[np.int_], crossed: int) -> float:
    """Return the fringes in a volt, from the crossings inside the swings."""
    same = np.diff(swings) == 0
    travel = float(np.abs(np.diff(volts))[same].sum())
    count = float(np.abs(np.diff(phases))[same].sum())
    if travel == 0.0:
        raise InputError(_few(crossed))
    return count / TURN / travel
