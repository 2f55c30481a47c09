"""Columns, the bounded least-squares problem, and the model made of a fit."""

from dataclasses import replace

import numpy as np
import pytest
from contract.program import plays_of

from dbo_cli.errors import DboWarning, FitError, InputError, UsageError
from dbo_cli.identification import search
from dbo_cli.identification.averaging import weighed
from dbo_cli.identification.basis import (
    Cells,
    PreparedLog,
    Structure,
    fitted_columns,
    sums_of,
)
from dbo_cli.identification.clean import clean
from dbo_cli.identification.problem import prepare
from dbo_cli.identification.recording import Options, Recording
from dbo_cli.identification.solve import Equations, FittedRows, minimum
from dbo_cli.identification.stages import model_of

TIME = np.arange(4000) / 200.0
DRIVE = 50.0 - 50.0 * np.cos(2.0 * np.pi * 0.5 * TIME) * np.exp(-TIME / 15.0)


def hysteresis(drive):
    """Return a sum of plays of a drive from 0 to 100 V that has come down."""
    reach = np.linspace(0.0, 0.4, 9)
    x = drive / 100.0
    plays = plays_of(x, reach, np.maximum(reach, x[0] - reach))
    return 5.0 * plays @ np.linspace(2.0, 0.4, 9)


def log_of(drive, cells):
    every = np.arange(len(drive))
    return PreparedLog(drive, drive, 0.01 * every, 0.01, every, every + 1)


def columns(log, taus, delay=0.0):
    cells = Cells.of()
    sums = sums_of(log, cells, np.asarray(taus), 0.0)
    return fitted_columns(log, sums, cells, delay)


def test_a_gain_is_believed_as_far_as_the_log_shows_it():
    drive = (DRIVE - DRIVE.min()) / np.ptp(DRIVE)
    table = columns(log_of(drive, Cells.of()), [0.02, 100.0])
    noise = np.random.default_rng(3).standard_normal(len(drive))
    slow = table[:, -3] - table[:, -3].mean()
    weights, shares = np.full(len(drive), 1.0 / len(drive)), Cells.of().shares
    gains = []
    for size in (1e-4, 1e-2, 1e-1):
        output = drive + 0.5 * slow + size * noise
        rows = FittedRows(table, output, weights, np.zeros((len(drive), 0)), shares)
        gains.append(float(Equations(rows, Structure(memories="t")).solve().gains[1]))
    assert gains[0] == pytest.approx(0.5, rel=0.05)
    assert gains[0] > gains[1] > gains[2]
    assert gains[2] < 0.1


def test_a_solution_beyond_all_numbers_is_refused():
    matrix = np.eye(3)
    matrix[0, 1] = matrix[1, 0] = 1.0 - 1e-15
    right = np.array([1e300, -1e300, 1.0])
    bounded = np.array([False, False, True])
    with pytest.raises(FitError), np.errstate(all="ignore"):
        minimum(matrix, right, bounded, np.ones(3, bool))


def test_a_fit_without_a_score_is_left_out(monkeypatch):
    def unjudged(problem, fit, equations):
        score = fit.rmse if fit.structure.bend else np.nan
        return replace(
            fit, score=score, residuals=tuple(fit.error for _ in problem.parts)
        )

    monkeypatch.setattr(search, "cross_validate", unjudged)
    log = Recording("log", DRIVE, hysteresis(DRIVE), TIME)
    problem, choices = search.choices_for(prepare([log], Options()), Options())
    choices = replace(choices, bends=(0.25,), memories=("",))
    found = search.Search(problem, choices)
    with pytest.raises(FitError):
        found.run()
    found.fit([Structure(bend=0.25, memories="")])
    assert len(found.fits) == 1
    assert np.isfinite(weighed(found.fits)[0].weight)


@pytest.mark.parametrize("slopes", ["growing", "falling", "free"])
@pytest.mark.parametrize("memories", ["", "t", "tr"])
def test_model_is_what_was_fitted(slopes, memories):
    lagging = hysteresis(DRIVE) + 0.3 * np.sin(TIME)
    log = Recording("log", DRIVE, lagging, TIME)
    problem = prepare([log], Options())
    for curve in (np.inf, 1e-3):
        structure = Structure(slopes, memories, 2e-3, curve, delay=0.01, bend=0.1)
        fit = problem.equations(structure).solve()
        model = model_of(problem, fit, log, Options())
        every = np.arange(len(TIME))
        whole = replace(problem.logs[0], rows=every, ends=every + 1)
        sums = sums_of(whole, problem.cells, problem.taus, structure.bend)
        table = fitted_columns(whole, sums, problem.cells, structure.delay)
        expected = problem.offset + problem.scale * fit.predict(table)
        played, _ = model.simulate(DRIVE, time=TIME)
        # a turn inside a gear retraces it, which plays do not
        assert np.abs(played - expected)[8:].max() < 2e-3 * abs(problem.scale)
        model.inverse()


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_a_drive_beyond_the_range_goes_on_as_the_last_gears_do(direction):
    log = Recording("log", DRIVE, hysteresis(DRIVE), TIME)
    problem = prepare([log], Options())
    structure = Structure(memories="")
    fit = problem.equations(structure).solve()
    low, high = problem.low, problem.high
    end = high if direction > 0.0 else low
    drive = np.array([low + high - end, end, end + 0.1 * direction * (high - low)])
    moves = []
    for last in (1.0, 20.0):
        slopes = np.append(np.ones(len(fit.slopes) - 1), last)
        model = model_of(problem, replace(fit, slopes=slopes), log, Options())
        moved, _ = model.simulate(drive, dt=1.0)
        moves.append(abs(moved[2] - moved[1]))
    assert moves[1] < 10.0 * moves[0]  # by the last cell alone, 1.6 % of the range: 20


def test_slopes_keep_their_floor():
    log = Recording("log", DRIVE, 100.0 - hysteresis(DRIVE)[::-1], TIME)
    problem = prepare([log], Options())
    structure = Structure("free", "tr", 1e-6, 1e-5)
    fit = problem.equations(structure).solve()
    rests = float(fit.gains[len(problem.taus) :].sum())
    mean = float(fit.slopes @ problem.cells.shares) + rests
    assert fit.slopes.min() >= 0.03 * mean
    assert fit.curve.min() >= 0.03 - 1e-12


# --- recordings, and what no actuator does ---


def test_stuck_and_clipped_sensors_are_left_out():
    stuck = hysteresis(DRIVE)
    stuck += 0.005 * np.random.default_rng(7).normal(size=len(TIME))
    stuck[1000:1100] = stuck[1000]
    with pytest.warns(DboWarning, match="100 rows left out"):
        logs, _ = clean([Recording("log", DRIVE, stuck, TIME)], Options())
    assert (~logs[0].usable).sum() == 100
    clipped = np.minimum(hysteresis(DRIVE), 35.0)
    with pytest.warns(DboWarning, match="rows left out"):
        logs, _ = clean([Recording("log", DRIVE, clipped, TIME)], Options())
    assert (~logs[0].usable).sum() > 0.8 * (clipped == clipped.max()).sum()


def test_skip_needs_a_clock():
    with pytest.raises(UsageError, match="skip"):
        clean([Recording("log", DRIVE, hysteresis(DRIVE))], Options(skip=1.0))


def test_recordings_are_checked():
    with pytest.raises(FitError, match="too few"):
        Recording("log", DRIVE[:10], DRIVE[:10])
    with pytest.raises(FitError, match="skip less"):
        clean([Recording("log", DRIVE, DRIVE, TIME)], Options(skip=TIME[-10]))
    with pytest.raises(InputError, match="sample_rate"):
        Recording("log", DRIVE, DRIVE, np.floor(np.arange(len(DRIVE)) / 5.0))
