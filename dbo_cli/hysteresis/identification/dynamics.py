"""Identification of dynamics: resonances and a lag, from small sweeps and fast logs.

The gears, the points and creep come from the slow rows; what they predict for the fast
ones is the input of the dynamics, and what was measured their output. Frequencies and
dampings start from the ratio of the two spectra and are refined on the output error.
None, one or two resonances, with an antiresonance or without, the lag before or behind
the gears: by the error on rows left out. Then the slow rows are identified again, now
that the lag is known.

Creep that follows the displacement has sections behind the gears, too, from the slow
rows. The gears' own relaxation follows the drive. Where the loop is wide the two differ
by the loop's part of the creep: measured on four stages of 1.6 % creep and loops of 30
to 45 %, moves at f_r/1000 to f_r/30 were 0.03 to 0.07 % off in the mean with the one,
and 0.00 to 0.02 with the other. In turn, the displacement is freed of the creep found
so far and the gears are identified from it, and the creep is fitted to what they
predict.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import nnls

from dbo_cli.errors import FitError
from dbo_cli.hysteresis.cascade import slow_output_range
from dbo_cli.hysteresis.dynamics import DynamicsStage, Lag
from dbo_cli.hysteresis.identification.cleaning import Sensor
from dbo_cli.hysteresis.identification.dynamics_fit import (
    MOST_RESONANCES,
    TRUSTED,
    Band,
    FittedDynamics,
    Signals,
    chosen_dynamics,
    fitted,
    interval,
    one_more,
    residuals,
    response,
    said,
    trusted,
    with_delay,
)
from dbo_cli.hysteresis.identification.evaluation import (
    predict,
    validated,
    validations_of,
)
from dbo_cli.hysteresis.identification.identify import Identification, identify_static
from dbo_cli.hysteresis.identification.recordings import (
    FastPart,
    Floats,
    IdentificationOptions,
    Recording,
    first_wiped_row,
    grid_step,
    split,
)
from dbo_cli.hysteresis.identification.search import SEGMENTS
from dbo_cli.hysteresis.identification.statistics import EARNED, INDIFFERENCE
from dbo_cli.hysteresis.model import (
    ActuatorModel,
    BacklashStage,
    DelayStage,
    Relaxation,
    Stage,
)

STILL_GOOD = 1.25
"""The slow rows' second reading is taken where the sweep's error grows by at most this factor. Measured:
docs/choices.md.
"""
FINER = 4  # times the segments of asymmetry that slow moves need (see _again)
# periods of the lowest swept frequency: shorter relaxation is part of the dynamics
FAST_LAGS = 2.0

# of gears and creep in turn; from the memories' gains two bring it to 2 % of itself
ROUNDS = 3
LEAST_SHARE = 1e-5  # of the displacement: less is no creep


def with_dynamics(
    recordings: Sequence[Recording],
    options: IdentificationOptions,
    validation: Sequence[Recording],
) -> Identification | list[str]:
    """Return a model with dynamics, or what to warn of where the logs show none.

    Parameters
    ----------
    recordings, options, validation
        As of ``identify``.

    Raises
    ------
    FitError
        Resonances are asked for, and no log has a part in which they would show.
    """
    slow, fast = split(recordings)
    wanted = options.dynamics
    if not fast or not slow:
        if wanted:
            raise FitError(
                f"`dynamics` {wanted}: no log has a small sweep, nor is one ten times as fast as another "
                "(record a drive of excite with `sweep_to`)"
            )
        return []
    try:
        base = identify_static(slow, dataclasses.replace(options, dynamics=0))
    except FitError:
        if wanted:
            raise
        return []
    fast = [_without_sensor(part, options) for part in fast]
    lowest = min(part.lowest for part in fast)
    highest = max(part.highest for part in fast)
    band = lowest, highest
    model = _without_fast_lags(base.model.without(base.model.delay), FAST_LAGS / lowest)
    reading = _Reading(base, model, [Signals(model, part) for part in fast], ())
    chosen, doubts = chosen_dynamics(reading.signals, band, wanted)
    chosen, doubts = with_delay(reading.signals, band, wanted, chosen, doubts)
    if not chosen.resonances:
        return _unexplained(reading.signals, chosen, fast)
    chosen = _sharpened(reading.signals, _placed(reading.signals, chosen, band), band)
    for _ in range(MOST_RESONANCES):
        reading, chosen = _read_again(reading, chosen, slow, fast, band, options)
        if wanted is not None or len(chosen.resonances) == MOST_RESONANCES:
            break
        # What hides a weak resonance from the first reading of the slow rows is gone
        # with the second.
        best = fitted(reading.signals, [chosen.parameters], chosen.structure, band)
        more = one_more(reading.signals, best, band)
        if more is None:
            break
        chosen = _sharpened(reading.signals, more, band)
    return _assembled(reading, chosen, fast, validation, options, highest, doubts)


def _unexplained(
    signals: Sequence[Signals], chosen: FittedDynamics, fast: Sequence[FastPart]
) -> list[str]:
    """Return a warning for each fast part of which the slow model and a lag leave much over."""
    warnings = []
    left = residuals(signals, chosen.parameters, chosen.structure)
    for part, one, rest in zip(fast, signals, left, strict=True):
        # noise is no move that a model could explain
        white = float(np.mean(np.diff(rest, 2) ** 2)) / 6.0
        share = math.sqrt(max(float(np.var(rest)) - white, 0.0)) / float(
            np.std(one.measured)
        )
        if share > TRUSTED:
            first = part.recording.row(part.rows.start)
            last = part.recording.row(part.rows.stop - 1)
            warnings.append(
                f"{part.recording.name}: rows {first} to {last} move at "
                f"{part.lowest:.3g} to {part.highest:.3g} Hz, and {100.0 * share:.0f} % of what they do is "
                "not explained: no resonance fits them; the model is for slow moves only (a sweep of more "
                "volts, or to a higher frequency, may show what moves)"
            )
    return warnings


@dataclass(frozen=True)
class _Reading:
    """What the slow rows told.

    Attributes
    ----------
    base
        As ``identify_static`` found it.
    model : ActuatorModel
        Its gears and points, with creep behind them; lag and delay are left to the
        dynamics.
    signals : sequence of Signals
        The fast parts, by this model.
    creep : tuple of Lag
        The creep behind the gears.
    """

    base: Identification
    model: ActuatorModel
    signals: Sequence[Signals]
    creep: tuple[Lag, ...]


def _read_again(
    reading: _Reading,
    chosen: FittedDynamics,
    slow: Sequence[Recording],
    fast: Sequence[FastPart],
    band: Band,
    options: IdentificationOptions,
) -> tuple[_Reading, FittedDynamics]:
    """Return the last reading of the slow rows that the fast ones do not speak against, and the dynamics."""
    best = chosen
    for again, creep in _again(
        slow, chosen, options, reading.base, FAST_LAGS / band[0]
    ):
        model = _without_fast_lags(
            again.model.without(again.model.delay), FAST_LAGS / band[0]
        )
        if creep:
            model = dataclasses.replace(
                model, stages=(*model.stages, DynamicsStage(creep))
            )
        signals = [Signals(model, part) for part in fast]
        if _left_over(signals, chosen) <= STILL_GOOD * chosen.rmse:
            reading = _Reading(again, model, signals, creep)
            best = min(
                best, _sharpened(signals, chosen, band), key=lambda one: one.left_out
            )
    return reading, best


def _sharpened(
    signals: Sequence[Signals], chosen: FittedDynamics, band: Band
) -> FittedDynamics:
    """Return the dynamics refined, with an exact lag where that of the stage does not earn its place."""
    forms = [
        dataclasses.replace(chosen.structure, sampled_lag=sampled)
        for sampled in (False, True)
    ]
    exact, sampled = [
        fitted(signals, [chosen.parameters], structure, band) for structure in forms
    ]
    return sampled if sampled.left_out <= EARNED * exact.left_out else exact


def _left_over(signals: Sequence[Signals], chosen: FittedDynamics) -> float:
    """Return the error (RMS) on the fast rows."""
    left = np.concatenate(residuals(signals, chosen.parameters, chosen.structure))
    return float(np.sqrt(np.mean(left * left)))


def _without_sensor(part: FastPart, options: IdentificationOptions) -> FastPart:
    """Return a fast part as a sensor without delay and lag would have made it."""
    log = Sensor.of(options).taken_off(part.recording)
    rows = slice(part.rows.start, min(part.rows.stop, log.voltage.size))
    return dataclasses.replace(part, recording=log, rows=rows)


def _again(
    slow: Sequence[Recording],
    chosen: FittedDynamics,
    options: IdentificationOptions,
    base: Identification,
    shortest: float,
) -> list[tuple[Identification, tuple[Lag, ...]]]:
    """Return what the slow rows tell once the lag is known.

    Without it they take the lag for memories of milliseconds or for wider loops.
    Measured on a stage whose amplifier lags by 0.2 ms, sine at f_r/30: an offset of
    0.19 % of the move, and 0.16 with the lag known; of a log twice as long, which shows
    the creep, 0.07 and 0.03. The asymmetry gets more segments, since their corners, of
    which slow moves see nothing, meet the resonance. With 8, 16, 32 of them the same
    stage, whose resonance makes 25 of 1, errs at f_r/10 by 0.117, 0.054, 0.054 %, at
    f_r/5 by 0.18, 0.20, 0.11.

    Creep that follows the displacement comes second, with its sections, where the slow
    rows do not speak against it.
    """
    late = _late(chosen)
    known: dict[str, Any] = {"dynamics": 0}
    if options.delay is None:
        known["delay"] = late
    points = base.fit["points"]
    assert isinstance(points, int)
    if options.points is None and points > 0:
        known["points"] = min(FINER * points, SEGMENTS[-1][0])
    lagged = slow
    if chosen.lag_before > 0.0:
        lagged = [_led(log, chosen.lag_before) for log in slow]
    asked = dataclasses.replace(options, **known)
    try:
        again = identify_static(lagged, asked)
    except FitError:
        return []
    same_range = dataclasses.replace(
        again, model=dataclasses.replace(again.model, input=base.model.input)
    )
    found: list[tuple[Identification, tuple[Lag, ...]]] = [(same_range, ())]
    steps = [grid_step(log) for log in lagged]
    if options.relaxation is None and all(step is not None for step in steps):
        slower = dataclasses.replace(
            again, model=_without_fast_lags(again.model, shortest)
        )
        even = [step for step in steps if step is not None]
        creeping = creep_behind(slower, lagged, even, asked)
        if creeping is not None and _as_good(creeping[0], again):
            model = dataclasses.replace(creeping[0].model, input=base.model.input)
            found.append((dataclasses.replace(creeping[0], model=model), creeping[1]))
    return found


def _late(chosen: FittedDynamics) -> float:
    """Return the lag (s) of what is behind the gears, for slow moves."""
    late = sum(
        section.damping / (math.pi * section.frequency) for section in chosen.resonances
    )
    return late + chosen.lag - chosen.lag_before + chosen.structure.delay


def _as_good(one: Identification, other: Identification) -> bool:
    left_out = "cross_validated_rmse"
    mine, its = one.fit[left_out], other.fit[left_out]
    assert isinstance(mine, float) and isinstance(its, float)
    return mine <= (1.0 + INDIFFERENCE) * its


def _led(log: Recording, lag: float) -> Recording:
    """Return a log with the drive that has passed the lag."""
    seconds = log.seconds()
    assert seconds is not None
    steps = np.maximum(np.diff(seconds, prepend=seconds[0]), 0.0)
    passed, _ = DynamicsStage((Lag(lag),)).run(log.voltage, steps, None)
    return dataclasses.replace(log, voltage=passed)


def _placed(
    signals: Sequence[Signals], behind: FittedDynamics, band: Band
) -> FittedDynamics:
    """Return the dynamics with the lag before the gears, where the fast rows do not speak against it."""
    if behind.lag == 0.0:
        return behind
    structure = dataclasses.replace(behind.structure, lag_before=True)
    before = fitted(signals, [behind.parameters], structure, band)
    return before if EARNED * before.left_out <= behind.left_out else behind


def _without_fast_lags(model: ActuatorModel, shortest: float) -> ActuatorModel:
    """Return a model whose relaxation of less than ``shortest`` (s) is immediate.

    Relaxation of milliseconds stands in a slow model, as its delay does, for what the
    dynamics say better.
    """
    gears = model.backlash
    terms = gears.relaxation
    if terms is None:
        return model
    pairs = list(zip(terms.tau, terms.gain, strict=True))
    slow = [(tau, gain) for tau, gain in pairs if tau >= shortest]
    added = sum(gain for tau, gain in pairs if tau < shortest)
    # gain·(v − reference), at once: every gear steeper by it, and the corner where it
    # then lies.
    heights = gears.dy + added * gears.dx
    y0 = gears.y0 + added * (gears.x0 - terms.reference)
    rest = None
    if slow:
        taus, gains = zip(*slow, strict=True)
        rest = Relaxation(terms.reference, taus, gains)
    stages = list(model.stages)
    stages[stages.index(gears)] = BacklashStage(gears.dx, heights, gears.x0, y0, rest)
    return dataclasses.replace(model, stages=tuple(stages))


def _assembled(
    reading: _Reading,
    chosen: FittedDynamics,
    fast: Sequence[FastPart],
    validation: Sequence[Recording],
    options: IdentificationOptions,
    highest: float,
    doubts: Sequence[str],
) -> Identification:
    """Return the whole model with what is to be said of it."""
    base = reading.base
    model = _with_stages(reading, chosen)
    figures = _figures(reading, chosen, fast, highest)
    trusted_hz, why = trusted(reading.signals, chosen, highest)
    figures["trusted_hz"] = trusted_hz
    terms = reading.model.backlash.relaxation
    figures["relaxation_seconds"] = list(terms.tau) if terms else []
    figures["delay_seconds"] = chosen.structure.delay
    figures["delay_interval_seconds"] = None
    figures["lag_seconds"] = _late(chosen) + chosen.lag_before
    warnings = [*base.warnings, *doubts]
    if warnings:
        figures["warnings"] = warnings
    sensor = Sensor.of(options)
    checks = validations_of(model, validation, sensor, options.skip_seconds)
    unit = model.output.suffix
    # Of lag and memories the slow rows tell what the dynamics say better.
    summary = [line for line in base.summary if not line.startswith("lag ")]
    summary += said(figures, chosen, trusted_hz, why, unit)
    validation_figures, lines = validated(checks, model.output.span, unit)
    figures |= validation_figures
    summary += lines
    model = dataclasses.replace(model, fit=figures)
    return Identification(model, figures, summary, warnings)


def _with_stages(reading: _Reading, chosen: FittedDynamics) -> ActuatorModel:
    """Return the slow rows' model with the lag before, creep and dynamics behind its gears."""
    model = reading.model
    stages: list[Stage] = []
    if chosen.lag_before > 0.0:
        stages.append(DynamicsStage((Lag(chosen.lag_before),)))
    stages += [stage for stage in model.stages if not isinstance(stage, DynamicsStage)]
    stages.append(DynamicsStage((*reading.creep, *chosen.behind)))
    if chosen.structure.delay:
        stages.append(DelayStage(chosen.structure.delay))
    low, high = slow_output_range(stages, model.input.minimum, model.input.maximum)
    output = dataclasses.replace(model.output, minimum=low, maximum=high)
    return dataclasses.replace(model, stages=tuple(stages), output=output, fit={})


def _figures(
    reading: _Reading,
    chosen: FittedDynamics,
    fast: Sequence[FastPart],
    highest: float,
) -> dict[str, object]:
    """Return what the slow rows' file says of its fit, with dynamics and creep."""
    lowest = min(part.lowest for part in fast)
    resonances = []
    for k, resonance in enumerate(chosen.resonances):
        frequency, damping = resonance.frequency, resonance.damping
        resonances.append(
            {
                "frequency": frequency,
                "damping": damping,
                "frequency_interval": interval(frequency, chosen.spread[2 * k]),
                "damping_interval": interval(damping, chosen.spread[2 * k + 1]),
            }
        )
    figures: dict[str, object] = dict(reading.base.fit)
    figures["dynamics"] = {
        "resonances": resonances,
        "lag_seconds": chosen.lag,
        "lag_place": "before" if chosen.structure.lag_before else "behind",
        "rmse": chosen.rmse,
        "cross_validated_rmse": chosen.left_out,
        "logs": [part.recording.name for part in fast],
        "swept": [lowest, highest],
        "response": response(reading.signals, lowest, highest),
    }
    if reading.creep:
        figures["creep"] = [
            {"seconds": lag.seconds, "share": 1.0 - lag.lead / lag.seconds}
            for lag in reading.creep
        ]
    return figures


def creep_behind(
    found: Identification,
    logs: Sequence[Recording],
    steps: Sequence[float],
    options: IdentificationOptions,
) -> tuple[Identification, tuple[Lag, ...]] | None:
    """Return what the logs tell when creep stands behind the gears, and its sections; None without creep.

    Parameters
    ----------
    found
        What ``identify_static`` found with creep beside the gears.
    logs, steps
        Slow logs, the lag of their drive known, and their even time steps (s).
    options
        Of ``identify``.
    """
    gears = found.model.backlash
    taus, shares = _memories(gears)
    if not taus.size:
        return None
    again, sections = None, _sections(taus, shares)
    asked = dataclasses.replace(options, relaxation=(), slopes=str(found.fit["slopes"]))
    for _ in range(ROUNDS):
        if not sections:
            return None
        try:
            again = identify_static(
                [
                    _freed(log, sections, step)
                    for log, step in zip(logs, steps, strict=True)
                ],
                asked,
            )
        except FitError:
            return None
        used = sections
        shares = _fitted_shares(again, logs, steps, taus)
        sections = _sections(taus, shares)
    return None if again is None else (again, used)


def _memories(gears: BacklashStage) -> tuple[Floats, Floats]:
    """Return the time constants of an operator's memories, and their shares of its displacement."""
    terms = gears.relaxation
    if terms is None:
        return np.zeros(0), np.zeros(0)
    taus, gains = np.array(terms.tau), np.array(terms.gain) * float(gears.dx.sum())
    return taus, gains / (float(gears.dy.sum()) + float(gains.sum()))


def _sections(taus: Floats, shares: Floats) -> tuple[Lag, ...]:
    """Return 1 - Σ c + Σ c/(1 + τs) as a product of sections (1 + λs)/(1 + τs), λ < τ."""
    large = shares > LEAST_SHARE
    taus, shares = taus[large], shares[large]
    if not taus.size or float(shares.sum()) >= 0.5:
        return ()
    numerator = (1.0 - shares.sum()) * np.poly(-1.0 / taus)
    for k, share in enumerate(shares):
        others = np.poly(-1.0 / np.delete(taus, k))  # 1 where there are none
        numerator[1:] += share / taus[k] * others
    leads = np.sort(-1.0 / np.roots(numerator).real).tolist()
    return tuple(map(Lag, np.sort(taus).tolist(), leads))


def _freed(log: Recording, sections: tuple[Lag, ...], step: float) -> Recording:
    """Return a log whose displacement has not crept."""
    inverter = DynamicsStage(sections).inverter(step)
    freed, _ = inverter.run(log.displacement, inverter.rest(float(log.displacement[0])))
    return dataclasses.replace(log, displacement=freed)


def _fitted_shares(
    found: Identification,
    logs: Sequence[Recording],
    steps: Sequence[float],
    taus: Floats,
) -> Floats:
    """Return the shares of creep with which the gears' prediction comes nearest to the logs."""
    count = taus.size
    square, along = np.zeros((count + 2, count + 2)), np.zeros(count + 2)
    for log, step in zip(logs, steps, strict=True):
        bare = predict(found.model, log)
        late = [
            DynamicsStage((Lag(float(tau)),)).run(bare, step, None)[0] - bare
            for tau in taus
        ]
        rows = slice(first_wiped_row(log.voltage), None)
        columns = np.column_stack([*late, bare, -bare])[rows]
        offset = columns.mean(axis=0)
        measured = log.displacement[rows] - log.displacement[rows].mean()
        square += (columns - offset).T @ (columns - offset)
        along += (columns - offset).T @ measured
    size = np.sqrt(np.maximum(np.diag(square), 1e-300))
    scaled = square / size / size[:, None]
    # far above rounding, far below a share
    root = np.linalg.cholesky(scaled + 1e-10 * np.eye(count + 2))
    gains = nnls(root.T, np.linalg.solve(root, along / size))[0] / size
    shares: Floats = gains[:count] / max(float(gains[count] - gains[count + 1]), 1e-300)
    return shares
