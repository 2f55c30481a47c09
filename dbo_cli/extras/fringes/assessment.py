"""What is said of a log of fringes, and which logs are refused."""

from __future__ import annotations

import numpy as np

from dbo_cli.errors import InputError
from dbo_cli.extras.fringes.branches import TURN
from dbo_cli.extras.fringes.light import percentile_ends
from dbo_cli.extras.fringes.swings import Floats, crossings, turning_points
from dbo_cli.extras.fringes.track import Track, TurnOdds

FEWEST_ROWS = 50
"""Of a log, or of a part between interruptions; chosen."""
ENOUGH_ODDS = 100.0
"""To one: below, a turn is named."""
OFTEN = 0.1
"""Of all turns: more of them below ``ENOUGH_ODDS``, and the log is refused."""
LARGEST_STEP = 0.25
"""Fringes from row to row."""
WINDOW = 32
"""Rows over which the speed of a signal is looked at."""
NEAR_TURN = 1.0
"""Fringes on the way to or from a turn within which crossings are not compared."""
COUNTED_WITHIN = 0.3
"""Fringes; by how much the way from crossing to crossing may differ from half a fringe."""
MOST_NOISE = 0.2
"""Of the fringes' amplitude."""
LISTED = 5
"""Turns that are named one by one."""
REMEDY = (
    "a slower drive, more samples a fringe, a second photodiode in quadrature (`quadrature`), or the drive "
    "of dbo excite --fringes"
)


def _large_swings(values: Floats) -> int:
    """Return how often a signal goes through half its range."""
    low, high = percentile_ends(values)
    if high <= low:
        return 0
    return int(turning_points(np.clip(values, low, high), 0.5 * (high - low)).size) - 1


def refuse_swapped(drive: Floats, signal: Floats, name: str) -> None:
    """Refuse a drive that does not move, and one that has the fringes (InputError)."""
    if not np.ptp(drive) > 0.0:
        raise InputError(
            f"{name}: the voltage is {drive[0]:g} in every row: nothing moves"
        )
    if not np.ptp(signal) > 0.0:
        raise InputError(
            f"{name}: the signal is {signal[0]:g} in every row: no light moves there"
        )
    of_drive = _large_swings(drive)
    of_signal = _large_swings(signal)
    if of_drive > 4 and of_drive > of_signal:
        raise InputError(
            f"{name}: the voltage goes through half its range {of_drive} times, and the signal "
            f"{of_signal} times: are the two columns exchanged? (`voltage` and `signal`)"
        )


def refuse_fast(time: Floats, signal: Floats, name: str) -> None:
    """Refuse a signal that changes by more than a quarter of a fringe from row to row (InputError).

    From row to row cos p changes by sqrt(2) sin(step / 2) (RMS over all p): 1 at a
    quarter of a fringe.
    """
    low, high = percentile_ends(signal)
    amplitude = 0.5 * (high - low)
    squares = (np.diff(signal) / max(amplitude, 1e-300)) ** 2
    means = np.convolve(squares, np.full(WINDOW, 1.0 / WINDOW), mode="valid")
    if means.size == 0:
        return
    fastest = int(np.argmax(means))
    if means[fastest] > 2.0 * np.sin(0.5 * LARGEST_STEP * TURN) ** 2:
        rate = (time.size - 1) / (time[-1] - time[0])
        raise InputError(
            f"{name}: at {time[fastest]:.6g} s the signal changes by more than a quarter of a fringe from "
            f"row to row, so that fringes cannot be counted (more than {rate:.4g} samples a second, or a "
            "slower drive)"
        )


def refuse_rate(time: Floats, track: Track, name: str) -> None:
    """Refuse a phase that runs faster than a quarter of a fringe a row (InputError)."""
    steps = np.abs(np.diff(track.phase)) / TURN
    fastest = int(np.argmax(steps))
    if steps[fastest] > LARGEST_STEP:
        rate = (time.size - 1) / (time[-1] - time[0])
        raise InputError(
            f"{name}: at {time[fastest]:.6g} s the displacement moves by {steps[fastest]:.2g} of a fringe "
            f"from row to row, and {LARGEST_STEP:g} is the most that can be followed "
            f"({rate * steps[fastest] / LARGEST_STEP:.3g} samples a second, or a slower drive)"
        )


def refuse_noise(track: Track, name: str) -> None:
    """Refuse a signal that the fringes do not explain (InputError)."""
    if not track.noise < MOST_NOISE:
        raise InputError(
            f"{name}: {100.0 * track.noise:.3g} % of the fringes' amplitude is left unexplained, and "
            f"{100.0 * MOST_NOISE:g} % is the most: the signal does not follow the drive as fringes do "
            f"({REMEDY})"
        )


def refuse_miscounted(time: Floats, track: Track, name: str) -> None:
    """Refuse a phase that does not go half a fringe from crossing to crossing (InputError).

    The crossings are counted without any model; those around a turn of the drive take
    no part.
    """
    channel = track.channels[0]
    amplitude = np.hypot(channel.cosine, channel.sine)
    places, _ = crossings(channel.signal, channel.offset, amplitude)
    rows = np.arange(time.size)
    fringes = np.abs(np.diff(np.interp(places, rows, track.phase))) / TURN
    gone = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(track.phase)))]) / TURN
    at_crossings = np.interp(places, rows, gone)
    near_turn = np.zeros(places.size, dtype=bool)
    for turn in track.turns:
        near_turn |= np.abs(at_crossings - gone[turn.row]) < NEAR_TURN
    wrong = np.abs(fringes - 0.5) > COUNTED_WITHIN
    wrong &= ~(near_turn[:-1] | near_turn[1:])
    if wrong.any():
        first = int(np.flatnonzero(wrong)[0])
        raise InputError(
            f"{name}: at {time[int(places[first])]:.6g} s the light shows half a fringe and the phase "
            f"found has {fringes[first]:.2g}: there the displacement does not follow the drive that was "
            "recorded (`rows` leaves out what moved by itself; else: " + REMEDY + ")"
        )


def doubtful(track: Track) -> list[TurnOdds]:
    """Return the turns whose odds are not enough."""
    return [turn for turn in track.turns if turn.odds < ENOUGH_ODDS]


def refuse_doubtful(time: Floats, track: Track, name: str) -> None:
    """Refuse a log with many turns in doubt (InputError)."""
    turns = doubtful(track)
    if len(turns) > max(1.0, OFTEN * len(track.turns)) or (
        track.turns and track.rounds == 0
    ):
        count = f"{len(turns)} of {len(track.turns)} turns of the drive"
        if not turns:
            raise InputError(
                f"{name}: model and fringes do not agree on the turns of the drive ({REMEDY})"
            )
        worst = min(turns, key=lambda turn: turn.odds)
        raise InputError(
            f"{name}: at {count} it is open which fringe follows (the odds are {worst.odds:.2g}:1 at "
            f"{time[worst.row]:.6g} s, {ENOUGH_ODDS:g}:1 are enough): {REMEDY}"
        )


def doubtful_turns(
    time: Floats, drive: Floats, track: Track, fringe: float
) -> list[str]:
    """Return a sentence for each turn in doubt: where, the odds, what else it could be."""
    texts = []
    for turn in doubtful(track)[:LISTED]:
        distance = 1000.0 * abs(turn.other) * fringe
        where = "above" if turn.other > 0.0 else "below"
        texts.append(
            f"at the turn at {time[turn.row]:.6g} s ({drive[turn.row]:.4g} V) the odds of the branch taken "
            f"are {turn.odds:.2g}:1 only; on the other all that follows is {distance:.0f} nm {where}"
        )
    more = len(doubtful(track)) - LISTED
    if more > 0:
        texts.append(f"{more} more turns are in doubt")
    return texts


def headline(values: Floats, deviation: Floats, track: Track) -> list[str]:
    """Return what was found, in a line or two."""
    fringes = float(np.ptp(track.phase)) / TURN
    lines = [
        f"{fringes:.4g} fringes, {np.ptp(values):.5g} um; noise {100.0 * track.noise:.2g} % of the fringes; "
        f"standard deviation {1000.0 * np.median(deviation):.2g} nm (median), "
        f"{1000.0 * np.max(deviation):.2g} nm at most"
    ]
    if track.turns:
        least = min(turn.odds for turn in track.turns)
        lines.append(
            f"{len(track.turns)} turns of the drive, the branch taken at each at least {least:.2g} times as "
            "probable as all others"
        )
    if track.clipped:
        lines.append(
            f"{track.clipped:,} rows at the end of a photodiode's range say nothing; their neighbours decide"
        )
    return lines
