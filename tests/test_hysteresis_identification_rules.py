"""Rules of the identification, each alone: units, ends, signs and special cases."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from test_hysteresis_identification_parts import prepared as prepared_log
from test_hysteresis_identification_parts import sine
from virtual_actuator import PRESETS, VirtualActuator

from dbo_cli.errors import FitError
from dbo_cli.hysteresis.excitation import Excitation
from dbo_cli.hysteresis.identification import search
from dbo_cli.hysteresis.identification.evaluation import (
    Residual,
    _slew_warnings,
    fit_notes,
    predict,
    validation_of,
)
from dbo_cli.hysteresis.identification.finalists import MARGIN, stages_of
from dbo_cli.hysteresis.identification.normal_equations import (
    MAX_STEEPNESS,
    SLOPE_FLOOR,
    Columns,
    Structure,
    penalties,
    quadratic,
    solve,
)
from dbo_cli.hysteresis.identification.output_error import (
    Candidate,
    OutputProblem,
    asymmetry,
    corners,
    finer,
)
from dbo_cli.hysteresis.identification.paper import SHRUNK, _few_heights
from dbo_cli.hysteresis.identification.preparation import (
    Prepared,
    gain_sign,
    prepare,
    without_outliers,
)
from dbo_cli.hysteresis.identification.recordings import (
    IdentificationOptions,
    Recording,
    first_wiped_row,
)
from dbo_cli.hysteresis.identification.search import choose
from dbo_cli.hysteresis.identification.statistics import (
    Basis,
    Score,
    Statistics,
    gather,
    no_worse,
)
from dbo_cli.hysteresis.model import ActuatorModel, BacklashStage, Quantity, ScaleStage


def small_model() -> ActuatorModel:
    """Return a model of 0 to 10 V and 0 to 4 um."""
    gears = BacklashStage([2.0, 3.0, 5.0], [0.1, 0.3, 0.6])
    return ActuatorModel(
        "forward",
        Quantity("voltage", "V", 0.0, 10.0),
        Quantity("displacement", "um", 0.0, 4.0),
        (gears, ScaleStage(4.0, 0.0)),
    )


def fitted_with(
    basis: Basis, gains: list[float] | None = None
) -> tuple[Candidate, Prepared]:
    heights = np.linspace(0.5, 1.5, basis.gears) / basis.gears
    deviation, origin = -0.1, 0.05
    vector = np.array([*heights, *(gains or []), deviation, origin])
    ready = Prepared((), (), basis.low, basis.high, 3.0, 7.0)
    return Candidate(basis, Structure("free", (), 2, 1e-8), vector), ready


def test_a_greatest_speed_that_the_model_does_not_know_is_a_slew_limit() -> None:
    phase = np.linspace(0.0, 20.0 * np.pi, 4001)
    free = (5.0 - 5.0 * np.cos(phase)) * np.linspace(1.0, 0.4, 4001)
    limited, at = np.empty(len(free)), 0.0
    for row, wanted in enumerate(free):
        at = max(wanted, at - 0.05)
        limited[row] = at

    def said(moved: Any) -> list[str]:
        log = Recording("run.csv", free, moved, None, 0.01, "V", "um")
        return _slew_warnings(
            [log], [Residual("run.csv", moved - free, np.arange(len(free)), 0.0)]
        )

    assert said(free) == []
    assert said(0.99 * free) == []
    [warning] = said(limited)
    assert warning.startswith(
        "run.csv: the displacement falls at one greatest speed (40 % of the rows are near it, 5 % of "
    )


# --- from numbers to stages ---


def test_gears_go_on_beyond_the_range_of_the_logs_at_either_end() -> None:
    basis = Basis(8, 10.0, 50.0, 4)
    fitted, ready = fitted_with(basis)
    backlash = next(
        s for s in stages_of(fitted, ready, 0.0) if isinstance(s, BacklashStage)
    )
    assert MARGIN >= 0.1
    assert backlash.x_range == pytest.approx(
        (10.0 - MARGIN * 40.0, 50.0 + MARGIN * 40.0)
    )
    assert np.all(backlash.dx == backlash.dx[0])


def test_the_gains_of_memories_are_output_per_volt_and_zero_is_where_it_was_asked_for() -> (
    None
):
    basis = Basis(8, 10.0, 50.0, 4, (0.01, 0.1, 1.0))
    fitted, ready = fitted_with(basis, [0.02, 0.0, 0.04])
    plain, shifted = (stages_of(fitted, ready, shift) for shift in (0.0, 2.0))
    terms = next(s for s in plain if isinstance(s, BacklashStage)).relaxation
    assert terms is not None
    assert (terms.reference, terms.tau) == (10.0, (0.01, 1.0))
    assert terms.gain == pytest.approx((0.02 / 40.0, 0.04 / 40.0))
    before, after = (
        next(s for s in stages if isinstance(s, ScaleStage))
        for stages in (plain, shifted)
    )
    assert (before.gain, before.offset) == pytest.approx((3.0, 7.0))
    assert after.offset == pytest.approx(before.offset - 2.0)


# --- judging a model on another log ---


def test_validation_takes_the_sensors_offset_off_and_nothing_else() -> None:
    model = small_model()
    voltage = np.concatenate([sine(4), sine(3, high=6.0)])
    log = Recording("other", voltage, np.zeros(len(voltage)), sample_period=0.01)
    error = 0.01 * np.sin(np.arange(len(voltage)))
    log = replace(log, displacement=predict(model, log) + 123.0 + error)
    found = validation_of(model, log, 0.0)
    kept = error[found.rows]
    assert found.values == pytest.approx(kept - kept.mean(), abs=1e-12)
    assert found.rmse < 0.01


def test_validation_leaves_out_what_came_before_both_ends_were_visited() -> None:
    model = small_model()
    voltage = np.concatenate([[4.0], np.linspace(4.0, 10.0, 30), sine(6)[::-1]])
    log = Recording("other", voltage, np.zeros(len(voltage)), sample_period=0.01)
    wiped = first_wiped_row(voltage)
    assert 30 < wiped < 100
    history = np.where(np.arange(len(voltage)) < wiped, 0.5, 0.0)
    found = validation_of(
        model, replace(log, displacement=predict(model, log) + history), 0.0
    )
    assert found.rows[0] == wiped
    assert found.rmse < 1e-12


# --- the bounded problem ---


def test_no_gear_is_flat() -> None:
    basis, voltage = Basis(10, 0.0, 10.0), sine(4)
    flat = np.array([0.0, 0.0, 0.0, 0.1, 0.1, 0.1, 0.1, 0.2, 0.2, 0.2])
    engaged, _ = basis.operator().engagement(voltage, basis.operator().empty())
    output = engaged @ flat
    statistics = gather([prepared_log(voltage, output)], basis, 1)
    gram, rows = statistics.total()
    solution = solve(gram, statistics.columns, Structure("free", (), 1, 0.0), rows)
    assert solution.heights.min() == pytest.approx(SLOPE_FLOOR / 10, rel=1e-6)


@pytest.mark.parametrize("segments", [4, 8])
def test_segments_stay_wide_enough_to_be_inverted(segments: int) -> None:
    """The output falls back halfway, which no invertible asymmetry follows."""
    basis, voltage = Basis(10, 0.0, 10.0), sine(4)
    engaged, _ = basis.operator().engagement(voltage, basis.operator().empty())
    inner = engaged.mean(axis=1)
    output = np.interp(inner, [0.0, 0.4, 0.5, 1.0], [0.0, 0.6, 0.4, 1.0])
    statistics = gather([prepared_log(voltage, output)], basis, 8)
    gram, rows = statistics.total()
    solution = solve(
        gram, statistics.columns, Structure("free", (), segments, 0.0, 0.0), rows
    )
    widths = np.diff(corners(solution.knots, 8)).reshape(segments, -1).sum(axis=1)
    assert widths.min() == pytest.approx(1.0 / (MAX_STEEPNESS * segments), rel=1e-4)
    assert widths.sum() == pytest.approx(1.0)
    assert solution.heights.min() >= SLOPE_FLOOR / 10 * (1.0 - 1e-9)


def test_one_smoothness_means_the_same_for_any_number_of_gears() -> None:
    def weight(gears: int) -> float:
        at = (np.arange(gears) + 0.5) / gears
        heights = (0.5 + at**2) / gears
        return quadratic(penalties(Columns(gears, 0, 1, 0))[0], np.append(heights, 0.0))

    assert weight(64) == pytest.approx(weight(512), rel=0.05)


def test_rows_of_the_output_error_leave_the_output_error_over() -> None:
    """At the point about which they are linearised."""
    basis = Basis(6, 0.0, 10.0, 2, (0.1,))
    knots = np.array([0.0, 0.2, 0.55, 0.7, 1.0])
    heights, gains = np.linspace(0.1, 0.2, 6), np.array([0.03])
    moved = knots[1:-1] - np.array([0.25, 0.5, 0.75])
    rng = np.random.default_rng(3)
    drive = rng.uniform(0.0, 1.0, (50, 7))
    output = rng.uniform(0.0, 1.0, 50)
    problem = OutputProblem(
        basis, drive, output, np.ones((50, 1)), (slice(0, 50),), {}, np.arange(50)
    )
    vector = np.concatenate((heights, gains, moved, [0.02]))
    table = problem.table(vector, 4)
    predicted = asymmetry(drive @ np.concatenate((heights, gains)) + 0.02, knots)[0]
    left = table[:, -1] - table[:, :-1] @ vector
    assert left == pytest.approx(output - predicted, abs=1e-12)


def test_finer_segments_are_the_same_curve() -> None:
    columns = Columns(3, 1, 2, 1)
    vector = np.array([0.3, 0.3, 0.3, 0.1, -0.2, 0.05])
    fine = finer(vector, columns, 2, 8)
    at = np.linspace(-0.1, 1.1, 50)
    coarse_curve = asymmetry(at, corners(vector[4:5], 2))[0]
    fine_curve = asymmetry(at, corners(fine[4:11], 8))[0]
    assert fine_curve == pytest.approx(coarse_curve, abs=1e-12)
    assert fine[-1] == 0.05


def judged(*kinds: tuple[str, list[float]]) -> Candidate:
    """Return a candidate with these mean squares on the parts of each kind, of ten rows each."""
    errors = {
        name: Score(10.0 * np.array(squares), np.full(len(squares), 10.0))
        for name, squares in kinds
    }
    structure = Structure("growing", (), 1, 1e-8)
    basis = Basis(6, 0.0, 10.0)
    return Candidate(basis, structure, np.zeros(7), 1.0, 1.0, 100, errors)


def test_each_kind_of_parts_counts_once_and_by_its_ratio() -> None:
    one = judged(("cycles", [4.0, 4.0]), ("levels", [1.0, 1.0, 1.0]))
    assert one.score == pytest.approx(np.log(2.0) / 2.0)
    none = judged()
    assert none.score == pytest.approx(np.log(0.1))


def test_a_candidate_is_beaten_beyond_its_error_bar_alone() -> None:
    worse = judged(("cycles", [2.0, 2.0, 2.0, 2.0]))
    steady = judged(("cycles", [1.0, 1.0, 1.0, 1.0]))
    lucky = judged(("cycles", [2.3, 2.3, 2.3, 0.1]))
    assert worse.beaten_by(steady, 0.02)
    assert not worse.beaten_by(lucky, 0.02)  # one part alone makes the difference
    assert not worse.beaten_by(steady, 0.5)
    single = judged(("levels", [1.0]))
    # one part has no scatter
    assert not judged(("levels", [2.0])).beaten_by(single, 0.0)


def test_what_is_surely_better_is_so_by_two_standard_errors_of_each_kind() -> None:
    worse = judged(("cycles", [2.0, 2.0, 2.0, 1.8]), ("levels", [2.0, 2.0, 2.0, 1.8]))
    better = judged(("cycles", [1.8, 1.8, 1.8, 2.0]), ("levels", [1.8, 1.8, 1.8, 2.0]))
    assert worse.beaten_by(better, 0.0)  # by 0.0264; its error bar is 0.0259
    assert not worse.surely_beaten_by(better)
    assert worse.surely_beaten_by(
        judged(("cycles", [1.0, 1.0, 1.0, 0.9]), ("levels", [1.0, 1.0, 1.0, 0.9]))
    )
    assert not judged().surely_beaten_by(judged())


def test_few_gears_are_not_flat_either() -> None:
    basis = Basis(8, 0.0, 10.0, 4)
    fine = np.array([0.0, 0.0, 0.0, 0.0, 0.25, 0.25, 0.25, 0.25])
    widths = np.full(5, 2.0)
    heights = _few_heights(sine(1), basis, fine, widths)
    assert len(SHRUNK) > 3
    assert np.all(heights >= SLOPE_FLOOR * widths / 10.0 * (1.0 - 1e-9))


# --- choosing ---


def test_the_standard_error_is_that_of_the_mean() -> None:
    """Over ten folds it is a third of their scatter: a loss between the two is not excused."""
    scatter = np.tile([0.035, -0.005], 5)  # mean 0.015, deviation 0.02
    best = Score(np.ones(10), np.ones(10))
    candidate = Score(np.exp(2.0 * scatter), np.ones(10))
    assert not no_worse(candidate, best, indifference=0.0)
    # deviation 0.1
    wide = Score(np.exp(2.0 * (0.009 + 5.0 * (scatter - 0.015))), np.ones(10))
    assert no_worse(wide, best, indifference=0.0)
    # deviation 0.1
    wider = Score(np.exp(2.0 * (0.025 + 5.0 * (scatter - 0.015))), np.ones(10))
    assert not no_worse(wider, best, indifference=0.0)


@pytest.mark.parametrize("delay", [0.0063, 0.0213])
def test_the_delay_is_the_middle_of_those_that_explain_the_log(delay: float) -> None:
    rng = np.random.default_rng(12)
    voltage = sine(12, samples=200)
    seconds = 0.001 * np.arange(len(voltage))
    model = small_model()
    log = Recording("log", voltage, np.zeros(len(voltage)), time=seconds)
    late = np.interp(seconds - delay, seconds, predict(model, log))
    log = replace(log, displacement=late + 0.05 * rng.normal(size=len(voltage)))
    found = choose(
        prepare([log], 0.0),
        IdentificationOptions(gears=12, points=1, relaxation=()),
        0.2,
    )
    assert found.delay_interval is not None
    low, high = found.delay_interval
    assert high - low >= 0.0005
    assert low <= delay <= high
    assert found.basis.delay == pytest.approx((low + high) / 2.0, abs=0.000126)
    assert abs(found.basis.delay - low) >= 0.0002


def test_slopes_that_cannot_be_solved_refuse_no_log(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """More slopes, or finer gears, may have no solution where a log is late by more than is looked for."""
    judged = search.cross_validate

    def some(statistics: Statistics, structure: Structure) -> Score:
        if statistics.columns.gears > 64 or structure.smoothness < 1e-9:
            raise FitError("the least-squares solver did not converge")
        return judged(statistics, structure)

    monkeypatch.setattr(search, "cross_validate", some)
    voltage = np.tile(sine(6), 4)
    log = Recording("log", voltage, np.zeros(len(voltage)))
    log = replace(log, displacement=predict(small_model(), log))
    found = choose(prepare([log], 0.0), IdentificationOptions(), None)
    assert found.basis.gears == 64
    assert found.structure.smoothness >= 1e-9


# --- sign and scale ---


def test_the_sign_of_the_gain_is_read_from_all_logs_and_one_spike_does_not_turn_it() -> (
    None
):
    voltage = sine(3)
    rising, falling = (
        Recording("a", voltage, 0.5 * voltage),
        Recording("b", voltage, -0.5 * voltage),
    )
    assert (gain_sign([rising]), gain_sign([falling])) == (1.0, -1.0)
    spiked = 0.5 * voltage
    spiked[int(np.argmin(voltage))] = 1e6
    assert gain_sign([Recording("c", voltage, spiked)]) == 1.0
    assert np.ptp(without_outliers(spiked)) < 5.1


# --- drift or creep ---


def excited(
    preset: str, seed: int, seconds: float, rate: float, part: float, share: float
) -> Recording:
    """Return an ``excite`` log of a virtual actuator; its sensor warms up by this share of the stroke."""
    parameters = PRESETS[preset]
    time, voltage = Excitation(
        parameters.v_min, parameters.v_max, rate, seconds, 1.0, seed=seed + 1
    ).drive()
    warmth = share * parameters.stroke * (1.0 - np.exp(-time / (part * seconds)))
    seen = VirtualActuator(parameters).play(time, voltage, seed) + warmth
    return Recording(preset, voltage, seen, time, None, "V", "um")


@pytest.mark.parametrize(
    ("preset", "seed", "seconds", "rate"),
    [("stack", 0, 15.0, 500.0), ("creeping", 4, 30.0, 200.0)],
)
def test_an_actuator_that_only_creeps_does_not_drift(
    preset: str, seed: int, seconds: float, rate: float
) -> None:
    ready = prepare([excited(preset, seed, seconds, rate, 1.0, 0.0)], 0.0)
    assert ready.logs[0].drift.shape[1] == 1  # the offset alone


def test_a_warm_up_is_found_and_one_that_may_be_creep_is_said() -> None:
    found = prepare([excited("stack", 0, 30.0, 200.0, 0.25, 0.03)], 0.0)
    assert found.logs[0].drift.shape[1] == 2
    assert found.doubtful_drift == 0.0
    slow = excited("bender", 1, 30.0, 200.0, 0.5, 0.03)
    doubtful = prepare([slow], 0.0)
    assert doubtful.logs[0].drift.shape[1] == 1
    assert 0.0 < doubtful.doubtful_drift < 0.045
    assert any(
        "may be sensor drift or creep" in line
        for line in fit_notes("um", doubtful, 1.0, None)
    )
