"""From two photodiodes in quadrature to a phase: an ellipse that drifts, the angle on it, unwrapped.

    first  = A1 + B1 cos p                   + noise
    second = A2 + C2 cos p + S2 sin p        + noise

Offsets, amplitudes and the error of the phase between the two (C2) drift with the way.
Source of the ellipse: P. L. M. Heydemann, "Determination and correction of quadrature
fringe measurement errors in interferometers", Applied Optics 20 (1981).
"""

from __future__ import annotations

import numpy as np

from dbo_cli.errors import InputError
from dbo_cli.extras.fringes.branches import TURN
from dbo_cli.extras.fringes.light import clipped_rows, fit_light, travelled
from dbo_cli.extras.fringes.phase_smoother import Channel, smooth
from dbo_cli.extras.fringes.swings import Floats, kinks_of
from dbo_cli.extras.fringes.track import Track

ROUNDS = 4
"""Rounds of ellipse and angle; chosen."""
LEAST_ROUND = 0.02
"""The least ratio of the ellipse's axes, squared: a flatter one is no quadrature."""


def track_quadrature(
    time: Floats, drive: Floats, first: Floats, second: Floats
) -> Track:
    """Return the phase of two photodiodes; its sign is the interferometer's.

    Raises
    ------
    InputError
        The two signals are no ellipse, or less than a fringe of one.
    """
    clipped = clipped_rows(first) | clipped_rows(second)
    weight = np.where(clipped, 0.0, 1.0)
    phase = _first_angle(first, second, weight)
    if float(np.ptp(phase)) < TURN:
        raise InputError(
            f"the two signals go through {np.ptp(phase) / TURN:.2g} of a fringe"
        )
    channels: list[Channel] = []
    for _ in range(ROUNDS):
        channels = _channels(first, second, phase, weight)
        phase = _angle(channels)
    kinks = kinks_of(drive, float(np.ptp(phase)) / TURN / float(np.ptp(drive)))
    smoothed = smooth(time, channels, phase, kinks)
    for _ in range(2):
        channels = _channels(first, second, smoothed.phase, weight)
        channels = [
            Channel(light.signal, light.offset, light.cosine, light.sine, noise, weight)
            for light, noise in zip(channels, smoothed.noise, strict=True)
        ]
        smoothed = smooth(time, channels, smoothed.phase, kinks)
    amplitude = float(np.mean(np.hypot(channels[0].cosine, channels[0].sine)))
    ratio = smoothed.noise[0] / amplitude
    return Track(
        smoothed.phase,
        smoothed.deviation,
        [],
        ratio,
        channels,
        ROUNDS,
        int(clipped.sum()),
    )


def _first_angle(first: Floats, second: Floats, weight: Floats) -> Floats:
    """Return the unwrapped angle on one ellipse for the whole log.

    The conic of least squares x^2 + a x y + b y^2 + c x + d y + e = 0.
    """
    used = weight > 0.0
    middle = [float(np.mean(signal[used])) for signal in (first, second)]
    scale = [max(float(np.std(signal[used])), 1e-300) for signal in (first, second)]
    x = (first - middle[0]) / scale[0]
    y = (second - middle[1]) / scale[1]
    rows = np.column_stack([x * y, y * y, x, y, np.ones(x.size)])[used]
    a, b, c, d, e = np.linalg.lstsq(rows, -(x[used] ** 2), rcond=None)[0]
    shape = np.array([[1.0, 0.5 * a], [0.5 * a, b]])
    axes = np.linalg.eigvalsh(shape)
    if axes[0] <= LEAST_ROUND * axes[1]:
        raise InputError("the two signals lie on a line and not on an ellipse")
    centre = np.linalg.solve(2.0 * shape, [-c, -d])
    size = float(centre @ shape @ centre) - e
    if size <= 0.0:
        raise InputError("the two signals are no ellipse")
    # x = cos p in units of the ellipse; the upper factor of the shape makes a circle of
    # it
    circle = np.linalg.cholesky(shape[::-1, ::-1])[::-1, ::-1].T
    u, v = circle @ np.array([x - centre[0], y - centre[1]])
    unwrapped: Floats = np.unwrap(np.arctan2(v, u))
    return unwrapped


def _channels(
    first: Floats, second: Floats, phase: Floats, weight: Floats
) -> list[Channel]:
    """Fit both signals by the phase, whose zero is where the first is highest."""
    terms = [np.cos(phase), np.sin(phase)]
    gone = travelled(phase)
    channels = []
    for signal in (first, second):
        factors, noise = fit_light(signal, terms, gone, weight)
        channels.append(
            Channel(signal, factors[0], factors[1], factors[2], noise, weight)
        )
    return channels


def _angle(channels: list[Channel]) -> Floats:
    """Return the unwrapped phase that both signals give together."""
    first, second = channels
    x = first.signal - first.offset
    y = second.signal - second.offset
    determinant = first.cosine * second.sine - first.sine * second.cosine
    cosine = (x * second.sine - y * first.sine) / determinant
    sine = (y * first.cosine - x * second.cosine) / determinant
    unwrapped: Floats = np.unwrap(np.arctan2(sine, cosine))
    return unwrapped
