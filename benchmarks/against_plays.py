"""Prediction of the next recording: `dbo identify`, everything automatic, against 25 play operators.

Simulated recordings of several kinds (fast piezo with resonance, fringe-counted minor loops, tendon drives,
softening loops, creep, 8-bit sensor, unknown history), seeded; the first half of each is fitted, the second
half predicted in one run over the whole log. The plays (Prandtl-Ishlinskii) are fitted to the same rows by
bounded least squares. With DATA, the authors' own two logs are added.

    python benchmarks/against_plays.py [DATA]
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import itertools

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear
from scipy.signal import bilinear, lfilter

from dbo_cli.hysteresis.identification import IdentificationOptions, Recording, identify
from dbo_cli.hysteresis.identification.evaluation import predict

Floats = NDArray[np.float64]
PLAYS = 25


def play_outputs(drive: Floats, radii: Floats, start: Floats | None = None) -> Floats:
    """Return the outputs of play operators, shape (samples, plays)."""
    held = np.full(len(radii), drive[0]) if start is None else start.copy()
    outputs = np.empty((len(drive), len(radii)))
    for k, u in enumerate(drive):
        held = np.minimum(np.maximum(held, u - radii), u + radii)
        outputs[k] = held
    return outputs


def plays_error(voltage: Floats, displacement: Floats, fitted: slice, judged: slice) -> float:
    """RMSE, offset removed, of 25 plays fitted by bounded least squares to the rows ``fitted``."""
    radii = np.arange(PLAYS) / PLAYS * np.ptp(voltage[fitted]) / 2.0
    sign = np.sign(np.cov(voltage[fitted], displacement[fitted])[0, 1])
    table = np.column_stack((sign * play_outputs(voltage, radii), np.ones(len(voltage))))
    bounds = (np.r_[np.zeros(PLAYS), -np.inf], np.inf)
    weights = lsq_linear(table[fitted], displacement[fitted], bounds=bounds, max_iter=2000).x
    return float(np.std((displacement - table @ weights)[judged]))


def piezo(
    voltage: Floats,
    rate: float,
    rng: np.random.Generator,
    *,
    lag: float = 0.0,
    creep: float = 0.0,
    resonance: float = 0.0,
    softening: bool = False,
    noise: float = 0.05,
    asymmetry: float = 0.1,
) -> Floats:
    """Displacement in um of 300 plays with asymmetry, creep, lag, resonance and noise."""
    drive = (voltage - voltage.min()) / np.ptp(voltage)
    radii = np.linspace(0.0, 0.5, 300)
    plays = play_outputs(drive, radii, np.clip(np.zeros(300), drive[0] - radii, drive[0] + radii))
    weights = np.exp(-radii / 0.1) if softening else np.sqrt(radii) * np.exp(-radii / 0.15)
    weights /= weights.sum()
    shape = drive + 0.5 * (drive - plays @ weights) if softening else 0.7 * drive + 0.6 * plays @ weights
    shape = shape + asymmetry * shape**2
    for tau in (0.5, 5.0, 50.0):
        keep = np.exp(-1.0 / rate / tau)
        shape = shape + creep / 3.0 * lfilter([1 - keep], [1, -keep], drive, zi=[keep * drive[0]])[0]
    if lag:
        keep = np.exp(-1.0 / rate / lag)
        shape = lfilter([1 - keep], [1, -keep], shape, zi=[keep * shape[0]])[0]
    if resonance:
        w = 2.0 * np.pi * resonance
        shape = lfilter(*bilinear([w * w], [1.0, 0.06 * w, w * w], rate), shape - shape[0]) + shape[0]
    measured: Floats = 50.0 * shape + rng.normal(0.0, noise, len(shape))
    return measured


def through(points: list[float], steps: int) -> Floats:
    """Straight ramps between turning points."""
    ramps = [np.linspace(a, b, steps, endpoint=False) for a, b in itertools.pairwise(points)]
    return np.concatenate(ramps)


def recordings() -> dict[str, tuple[float, Floats, Floats]]:
    """Sample rate (Hz), voltage and displacement of each kind of recording."""
    rng = np.random.default_rng(1)
    found: dict[str, tuple[float, Floats, Floats]] = {}
    t = np.arange(50_000) / 5000.0
    fading = np.interp(t, [0.0, 3.0, 5.0, 7.0, 10.0], [1.0, 1.0, 0.5, 0.8, 0.3])
    v = 150.0 * fading * np.sin(2 * np.pi * 10.0 * t)
    found["piezo 5 kHz, fading"] = 5000.0, v, piezo(v, 5000.0, rng, lag=3e-4, resonance=900.0)
    tones = ((7.0, 1.0, 0.0), (11.3, 0.6, 1.0), (23.0, 0.4, 0.0))
    v = 75.0 * sum(a * np.sin(2 * np.pi * f * t + p) for f, a, p in tones)
    found["piezo 5 kHz, tones"] = 5000.0, v, piezo(v, 5000.0, rng, lag=3e-4, resonance=900.0)
    v = through([0, 100, 0, 100, 20, 80, 30, 70, 40, 100, 0, 60, 30, 50, 10, 90, 0, 100, 50, 75, 0], 60)
    y = piezo(v, 10.0, rng, creep=0.03, noise=0.0)
    found["fringes, minor loops"] = 10.0, v, np.round(y / 0.158) * 0.158
    v = through([30, 70, 30, 80, 20, 100, 0, 100, 10, 50, 20, 90, 40, 60, 0, 100], 80)
    found["unknown history"] = 10.0, v, piezo(v, 10.0, rng)
    t = np.arange(6000) / 100.0
    v = 30.0 * np.sin(2 * np.pi * 0.2 * t) + 10.0 * np.sin(2 * np.pi * 0.53 * t)
    p = play_outputs(v, np.array([4.0, 6.0, 1.0])) @ np.array([0.6, 0.3, 0.1])
    found["tendon, compliant"] = 100.0, v, p + 0.002 * p * np.abs(p) + rng.normal(0.0, 0.05, len(v))
    v = np.interp(t, np.arange(0.0, 61.0, 1.5), rng.uniform(-30.0, 30.0, 41))
    p = play_outputs(v, np.array([3.0, 5.0])) @ np.array([0.5, 0.5])
    found["tendon, random"] = 100.0, v, p + rng.normal(0.0, 0.1, len(v))
    t = np.arange(8000) / 200.0
    v = 50.0 + 50.0 * np.sin(np.pi * t) * np.interp(t, [0.0, 20.0, 40.0], [1.0, 0.4, 0.9])
    found["softening"] = 200.0, v, piezo(v, 200.0, rng, softening=True)
    found["softening, negative"] = 200.0, v, -piezo(v, 200.0, rng, softening=True)
    found["creep and lag"] = 200.0, v, piezo(v, 200.0, rng, creep=0.05, lag=0.005)
    v = 50.0 - 50.0 * np.cos(2 * np.pi * t) * np.interp(t, [0.0, 40.0], [1.0, 0.1])
    found["decay, 8 bit"] = 200.0, v, np.round(piezo(v, 200.0, rng) / 0.4) * 0.4
    return found


def one_line(name: str, rate: float, voltage: Floats, displacement: Floats, half: int, skip: float) -> float:
    """Identify, predict, compare, print; returns the ratio of the errors."""
    first = Recording(name, voltage[:half], displacement[:half], None, 1.0 / rate)
    result = identify([first], IdentificationOptions(skip_seconds=skip))
    whole = Recording(name, voltage, displacement, None, 1.0 / rate)
    ours = float(np.std((displacement - predict(result.model, whole))[half:]))
    plays = plays_error(voltage, displacement, slice(int(skip * rate), half), slice(half, None))
    print(f"{name:22}  {ours:8.4f} um  {plays:8.4f} um  {ours / plays:6.2f}")
    return ours / plays


def authors_logs(folder: Path) -> float:
    """Fit one of the authors' logs and predict the other (rows 601 on)."""
    fit, test = (
        np.loadtxt(folder / name, usecols=(0, 4)) for name in ("identification.dat", "uncompensated.dat")
    )
    log = Recording("fit", fit[:, 0].copy(), fit[:, 1].copy(), None, 0.005)
    model = identify([log], IdentificationOptions(skip_seconds=2.0)).model
    other = Recording("test", test[:, 0].copy(), test[:, 1].copy(), None, 0.005)
    ours = float(np.std((other.displacement - predict(model, other))[600:]))
    radii = np.arange(PLAYS) / PLAYS * np.ptp(fit[:, 0]) / 2.0
    tables = [np.column_stack((play_outputs(one[:, 0], radii), np.ones(len(one)))) for one in (fit, test)]
    bounds = (np.r_[np.zeros(PLAYS), -np.inf], np.inf)
    weights = lsq_linear(tables[0][400:], fit[400:, 1], bounds=bounds, max_iter=2000).x
    plays = float(np.std((test[:, 1] - tables[1] @ weights)[600:]))
    print(f"{'authors, one log':22}  {ours:8.4f} um  {plays:8.4f} um  {ours / plays:6.2f}")
    return ours / plays


def main() -> None:
    """Print one line a recording and how many are predicted worse than by the plays."""
    print("recording                    dbo       25 plays   ratio")
    ratios = [one_line(name, rate, v, y, len(v) // 2, 0.0) for name, (rate, v, y) in recordings().items()]
    if len(sys.argv) > 1:
        ratios.append(authors_logs(Path(sys.argv[1])))
    worse = sum(ratio > 1.0 for ratio in ratios)
    mean = float(np.exp(np.mean(np.log(ratios))))
    print(f"geometric mean of the ratios {mean:.2f}; worse on {worse} of {len(ratios)}")


if __name__ == "__main__":
    main()
