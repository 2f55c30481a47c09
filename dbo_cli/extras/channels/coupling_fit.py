"""Gains between channels, from logs in which all move: what a channel shows while its own drive rests.

While the drive of a channel rests, its displacement changes by its creep and by what
other actuators do. Both are fitted to every such stretch at once: creep as a straight
line and decays of its own for each stretch, the others by what their sensors show, with
one gain each. From the gains that are left when what is shown is the sum of all (B: y_i
= u_i + sum b_ij y_j) follow those of the actuators themselves: C = (1 - B)^-1, its
columns scaled to ones on the diagonal. ``excite --channels`` makes drives that rest in
turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dbo_cli.errors import FitError
from dbo_cli.extras.channels.model_set import Coupling
from dbo_cli.hysteresis.identification.recordings import Floats, runs

# of a drive's range, at most: what a voltmeter may scatter while nothing is asked of
# the amplifier
AT_REST = 1e-3
QUIET = 0.02
"""Part of a log whose stillest windows tell that scatter: a drive that was logged as it was asked for has
none, and the slow ends of its swings are then no rest.
"""
SHORTEST = 100
"""Rows at rest: the slow ends of swings are shorter. Measured: docs/choices.md."""
DECAYS = (0.01, 0.1, 1.0, 10.0, 100.0)
"""s: the creep of a stretch is made of decays a decade apart, which follow its logarithm to a percent."""
# of a channel's stroke: another that moved less while this one rested tells of no gain
LEAST_MOVED = 0.1
LEAST_OWN = 0.05
"""Of a channel's motion while another rests, what no third channel's motion makes up: below it, which of
them shows cannot be told. Measured: docs/choices.md.
"""

REMEDY = "play a drive in which every channel also moves alone (dbo excite with `channels` N)"


class Frames(NamedTuple):
    """One log of all channels: seconds, and of shape (samples, channels) what was applied and measured."""

    seconds: Floats
    voltage: Floats
    displacement: Floats


def find_coupling(channels: Sequence[str], logs: Sequence[Frames]) -> Coupling:
    """Return the gains between channels; those that the logs do not tell from 0 are 0.

    A gain is kept where its square over that of its standard error exceeds log(rows) +
    2 log(channels): the information criterion with as many candidates as channels (Chen
    and Chen 2008, extended by 2 log p).

    Raises
    ------
    FitError
        A channel never moves, or the logs do not tell what it does to another.
    ModelError
        The gains cannot be undone.
    """
    moved = [
        np.vstack([getattr(log, name) for log in logs])
        for name in ("voltage", "displacement")
    ]
    ranges, strokes = (np.ptp(frames, axis=0) for frames in moved)
    for name, spans in (("drive", ranges), ("displacement", strokes)):
        if not spans.all():
            raise FitError(
                f"coupling: channel {channels[int(np.argmin(spans))]} never moves (its {name} stays where it "
                f"is), so that what it does to others is not known; {REMEDY}"
            )
    logs = [
        log._replace(displacement=log.displacement - log.displacement.mean(axis=0))
        for log in logs
    ]
    squares = [log.displacement.T @ log.displacement for log in logs]
    shown, least = np.zeros((2, len(channels), len(channels)))
    for place in range(len(channels)):
        rest = np.arange(len(channels)) != place
        found = _gains_in(
            channels, place, logs, squares, AT_REST * ranges[place], strokes
        )
        shown[place, rest], least[place, rest] = found
    everything = np.eye(len(channels)) - shown
    if (
        not np.linalg.cond(everything * strokes / strokes[:, None])
        < 1.0 / np.finfo(float).eps
    ):
        gains = everything  # Coupling says what is wrong with it
    else:
        undone = np.asarray(np.linalg.inv(everything), dtype=np.float64)
        gains = undone / np.diag(undone)
    # most nearly at rest, all of them
    lowest = int(np.argmin((moved[0] / ranges).sum(axis=1)))
    clear = np.where(np.abs(gains) > least, gains, 0.0)
    return Coupling(tuple(channels), clear, moved[1][lowest].copy(), strokes)


def _gains_in(
    channels: Sequence[str],
    place: int,
    logs: Sequence[Frames],
    squares: Sequence[Floats],
    still: float,
    strokes: Floats,
) -> tuple[Floats, Floats]:
    """Return how much of what each other channel shows is seen in one, and the least that is told from 0.

    ``squares`` are each log's displacements times themselves: only the rows that do not
    count are taken off, of many channels the fewer ones.
    """
    count = len(channels)
    products, moved, freedom = np.zeros((count, count)), np.zeros(count), 1 - count
    for log, square in zip(logs, squares, strict=True):
        moving = np.ones(len(log.seconds), dtype=bool)
        products += square
        for start, stop in stretches(log.voltage[:, place], still):
            seconds, measured = log.seconds[start:stop], log.displacement[start:stop]
            creep = _creep(seconds - seconds[0])
            crept = creep.T @ measured
            products -= crept.T @ crept
            moved = np.maximum(moved, np.ptp(measured, axis=0))
            freedom += stop - start - creep.shape[1]
            moving[start:stop] = False
        unused = log.displacement[moving]
        products -= unused.T @ unused
    rest = np.arange(count) != place
    names = [channel for channel in channels if channel != channels[place]]
    unmoved = moved[rest] < LEAST_MOVED * strokes[rest]
    if unmoved.any() or freedom < 1:
        raise FitError(
            f"coupling: channel {names[int(np.argmax(unmoved))]} hardly moves while the drive of channel "
            f"{channels[place]} rests, so that what the one does to the other is not known; {REMEDY}"
        )
    scale = np.sqrt(np.diag(products)[rest])
    normal = products[np.ix_(rest, rest)] / np.outer(scale, scale)
    inverse = np.linalg.pinv(normal, hermitian=True)
    own_part = 1.0 / np.diag(inverse)
    if (
        own_part.min() < LEAST_OWN
        or np.linalg.matrix_rank(normal, hermitian=True) < count - 1
    ):
        raise FitError(
            f"coupling: channel {names[int(np.argmin(own_part))]} moves like others while the drive of "
            f"channel "
            f"{channels[place]} rests: which of them shows there cannot be told; {REMEDY}"
        )
    seen_here = products[rest, place] / scale
    gains = inverse @ seen_here
    noise = max(products[place, place] - float(gains @ seen_here), 0.0) / freedom
    rows = freedom + count - 1
    least = np.sqrt(noise / own_part * (np.log(rows) + 2.0 * np.log(count)))
    return gains / scale, least / scale


def stretches(drive: Floats, still: float) -> list[tuple[int, int]]:
    """Return first row and end of the stretches in which a drive stays within ``still`` or less."""
    if len(drive) < SHORTEST:
        return []
    windows = np.lib.stride_tricks.sliding_window_view(drive, SHORTEST)
    spread = windows.max(axis=1) - windows.min(axis=1)
    still = min(still, 2.0 * float(np.quantile(spread, QUIET)))
    apart: list[tuple[int, int]] = []
    for start, end in runs(spread <= still):
        begin, stop = max(start, apart[-1][1] if apart else 0), end + SHORTEST - 1
        # Where a drive creeps on all the time, no window shows it.
        if stop - begin >= SHORTEST and np.ptp(drive[begin:stop]) <= 2.0 * still:
            apart.append((begin, stop))
    return apart


def _creep(seconds: Floats) -> Floats:
    """Return orthonormal columns of what may go on by itself in a stretch."""
    step, length = seconds[-1] / (len(seconds) - 1), seconds[-1]
    decays = [
        np.exp(-seconds / tau) for tau in DECAYS if 2.0 * step < tau < 2.0 * length
    ]
    columns: Floats = np.linalg.qr(
        np.column_stack([np.ones_like(seconds), seconds, *decays])
    )[0]
    return columns
