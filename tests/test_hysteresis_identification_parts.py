"""The pieces of the identification, each against an obvious way to compute the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dbo_cli.errors import FitError
from dbo_cli.hysteresis.identification.cleaning import without_voltage_glitches
from dbo_cli.hysteresis.identification.normal_equations import (
    SLOPE_FLOOR,
    Columns,
    Structure,
    knot_map,
    solve,
    squared_error,
    squared_error_free_of,
)
from dbo_cli.hysteresis.identification.output_error import asymmetry
from dbo_cli.hysteresis.identification.preparation import (
    clipped_sensor,
    folds_of,
    prepare,
)
from dbo_cli.hysteresis.identification.recordings import (
    Recording,
    check_recordings,
    drive_shape,
    first_wiped_row,
    known_behind_gaps,
    one_amplitude,
    pieces_behind_gaps,
)
from dbo_cli.hysteresis.identification.search import (
    Score,
    no_worse,
    simplest_of,
    time_constant_grid,
)
from dbo_cli.hysteresis.identification.statistics import (
    BLOCK_ROWS,
    Basis,
    PreparedLog,
    drift_columns,
    drive_rows,
    fewer_rows,
    gather,
    hat_functions,
    relaxed_drive,
)
from dbo_cli.hysteresis.move_error import turning_points


def sine(
    cycles: int = 5, samples: int = 40, low: float = 0.0, high: float = 10.0
) -> np.ndarray:
    phase = 2.0 * np.pi * np.arange(cycles * samples + 1) / samples
    return low + (high - low) * (0.5 - 0.5 * np.cos(phase))


def rows_of(
    basis: Basis, voltage: np.ndarray, seconds: np.ndarray | None, start: str
) -> np.ndarray:
    return np.vstack(
        [rows for _, _, rows in drive_rows(basis, voltage, seconds, start)]
    )


def prepared(
    voltage: np.ndarray, output: np.ndarray, folds: int = 4, order: int = 0
) -> PreparedLog:
    seconds = np.arange(len(voltage)) * 0.01
    fold = np.arange(len(voltage)) * folds // len(voltage)
    return PreparedLog(
        "log", voltage, output, seconds, fold, drift_columns(seconds, order), "empty"
    )


def test_turning_points_pass_over_what_is_smaller_than_the_threshold() -> None:
    signal = np.array([0.0, 1.0, 3.0, 2.9, 5.0, 5.0, 4.0, 1.0, 1.2, 0.5, 4.0])
    assert turning_points(signal, 0.5).tolist() == [4, 9]
    assert turning_points(signal, 0.05).tolist() == [2, 3, 4, 7, 8, 9]
    assert turning_points(np.zeros(9), 0.1).tolist() == []
    assert turning_points(np.arange(9.0), 0.1).tolist() == []


def test_drive_shape_counts_cycles_and_amplitudes() -> None:
    shape = drive_shape(sine(5))
    assert shape.turns.tolist() == [20, 40, 60, 80, 100, 120, 140, 160, 180]
    assert shape.cycles.tolist() == [40, 80, 120, 160]
    assert shape.cycle_count == 3
    assert one_amplitude([shape])
    fading = drive_shape(sine(5) * np.linspace(1.0, 0.2, 201))
    assert not one_amplitude([fading])


def test_history_is_wiped_out_when_both_ends_were_visited() -> None:
    assert first_wiped_row(np.array([5.0, 0.0, 4.0, 10.0, 2.0])) == 3
    assert first_wiped_row(np.array([5.0, 10.0, 4.0, 0.0, 2.0])) == 3


def gapped(voltage: np.ndarray, begin: int, end: int, late: float = 0.0) -> Recording:
    """Return a log at 100 samples/s without the rows from ``begin`` to before ``end``, ``late`` s longer."""
    kept = np.delete(np.arange(len(voltage)), slice(begin, end))
    seconds = 0.01 * kept + late * (kept >= begin)
    return Recording("log", voltage[kept], 3.0 * voltage[kept], seconds)


def test_gaps_hide_turns_but_not_what_goes_straight_on_or_stands_still() -> None:
    triangle = np.concatenate(
        [np.linspace(0.0, 10.0, 100), np.linspace(10.0, 0.0, 100)] * 4
    )
    # 0 V is in it
    assert pieces_behind_gaps(gapped(triangle, 180, 320)) == [(180, 359, 660)]
    assert pieces_behind_gaps(gapped(triangle, 120, 180)) == []  # straight on
    # three samples hide nothing
    assert pieces_behind_gaps(gapped(triangle, 198, 201)) == []
    rests = np.concatenate(
        (triangle[:150], np.full(100, triangle[149]), triangle[150:])
    )
    # a logger that writes what changes
    assert pieces_behind_gaps(gapped(rests, 150, 249)) == []
    assert pieces_behind_gaps(gapped(triangle, 300, 300, 5.0)) == []
    # to the same voltage: it stood still if the displacement says so
    back = gapped(triangle, 180, 380)
    assert pieces_behind_gaps(back) == []
    moved = replace(
        back, displacement=back.displacement + 2.0 * (np.arange(600) >= 180)
    )
    assert pieces_behind_gaps(moved) == [(180, 299, 600)]
    assert pieces_behind_gaps(replace(back, time=None, sample_period=0.01)) == []
    slow = np.concatenate(
        (
            np.linspace(0.0, 2.0, 101),
            np.linspace(2.1, 10.0, 80),
            np.linspace(9.9, 0.0, 100),
        )
    )
    # as fast as before, not as after
    assert pieces_behind_gaps(gapped(slow, 101, 233)) == [(101, 148, 149)]


def test_rows_behind_gaps_are_kept_where_too_few_would_be_left() -> None:
    triangle = np.concatenate(
        [np.linspace(0.0, 10.0, 100), np.linspace(10.0, 0.0, 100)] * 4
    )
    log = gapped(triangle, 180, 320)
    every = np.ones(660, bool)
    assert np.flatnonzero(~known_behind_gaps(log, every)).tolist() == list(
        range(180, 359)
    )
    few = (np.arange(660) >= 160) & (np.arange(660) < 390)
    assert known_behind_gaps(log, few) is few


@pytest.mark.parametrize(
    ("voltage", "displacement", "message"),
    [
        (sine(1, 20), sine(1, 20), r"a: 21 rows are too few to identify from"),
        (np.full(90, 2.5), np.arange(90.0), r"a: the voltage is constant \(2.5\)"),
        (
            sine(),
            np.full(201, 7.0),
            r"a: the displacement is constant \(7\): check the sensor",
        ),
        (
            np.arange(90.0),
            np.arange(90.0),
            r"a: the voltage never turns back, so the log shows no loop",
        ),
    ],
)
def test_logs_that_show_nothing_are_refused(
    voltage: np.ndarray, displacement: np.ndarray, message: str
) -> None:
    with pytest.raises(FitError, match=f"^{message}"):
        check_recordings([Recording("a", voltage, displacement)])


@pytest.mark.parametrize(("slope", "last"), [(-1.0, "-199"), (0.0, "1")])
def test_a_clock_that_does_not_advance_is_refused(slope: float, last: str) -> None:
    message = rf"^a: time does not advance from the first row \(1 s\) to the last \({last} s\): repair"
    with pytest.raises(FitError, match=message):
        check_recordings(
            [Recording("a", sine(), sine(), 1.0 + slope * np.arange(201.0))]
        )


def test_a_number_no_instrument_measured_is_named() -> None:
    wrong = sine()
    wrong[7] = 1e308
    with pytest.raises(
        FitError,
        match=r"^a: the voltage in row 8 is 1e\+308, which no instrument measured",
    ):
        check_recordings([Recording("a", wrong, sine())])


def test_logs_of_different_units_are_refused() -> None:
    first = Recording("a", sine(), sine(), voltage_unit="V", displacement_unit="um")
    with pytest.raises(
        FitError, match=r"^b: its displacement is in nm, that of a in um"
    ):
        check_recordings([first, replace(first, name="b", displacement_unit="nm")])
    with pytest.raises(
        FitError, match=r"^b: its voltage is in no unit, that of a in V"
    ):
        check_recordings([first, replace(first, name="b", voltage_unit=None)])


def test_relaxed_drive_is_the_recursion() -> None:
    rng = np.random.default_rng(3)
    drive, seconds = rng.normal(size=50), np.cumsum(rng.uniform(0.0, 0.1, 50))
    taus = (0.02, 1.5)
    rows = relaxed_drive(drive, seconds, taus)
    for column, tau in enumerate(taus):
        memory = drive[0]
        for k in range(1, 50):
            keep = np.exp(-(seconds[k] - seconds[k - 1]) / tau)
            memory = keep * memory + (1.0 - keep) * drive[k]
            assert rows[k, column] == pytest.approx(memory, abs=1e-14)
    assert relaxed_drive(drive, None, ()).shape == (50, 0)


def test_hats_are_the_piecewise_linear_functions() -> None:
    at = np.array([-0.3, 0.0, 0.1, 0.25, 0.4, 0.74, 1.0, 1.2])
    hats = hat_functions(at, 4)
    values = np.array([0.3, -0.2, 0.5])
    straight = np.interp(at, [0, 0.25, 0.5, 0.75, 1], [0, *values, 0])
    assert hats[1:-1] @ values == pytest.approx(straight[1:-1])
    # the end segments go straight on
    assert hats[0] @ values == pytest.approx(-0.3 / 0.25 * 0.3)
    assert hats[-1] @ values == pytest.approx(-0.2 / 0.25 * 0.5)
    assert hat_functions(at, 1).shape == (8, 0)


def test_coarse_hats_are_sums_of_fine_ones() -> None:
    at = np.linspace(-0.1, 1.1, 61)
    for fine, coarse in ((8, 4), (8, 2), (12, 3), (4, 4)):
        assert hat_functions(at, fine) @ knot_map(fine, coarse) == pytest.approx(
            hat_functions(at, coarse)
        )


def test_lags_that_are_kept_are_those_of_the_basis_and_the_voltage() -> None:
    voltage = sine(10, 2000)
    whole = prepared(voltage, voltage / 10.0)
    one = Basis(4, 0.0, 10.0, 1, (0.1, 2.0))
    others = [
        replace(one, bend=0.1),
        replace(one, low=-1.0),
        replace(one, time_constants=(0.1,)),
    ]
    for log in (whole, *fewer_rows([whole], 2000)):
        for basis in (one, *others, replace(one, delay=0.002), one):
            assert np.array_equal(log.lags(basis), basis.lags(log.voltage, log.seconds))


def test_rows_of_a_delayed_log_are_those_of_the_moment_before() -> None:
    rng = np.random.default_rng(5)
    samples = 2 * BLOCK_ROWS + 77
    voltage = np.cumsum(rng.normal(size=samples))
    seconds = np.cumsum(rng.uniform(0.005, 0.015, samples))
    basis = Basis(6, float(voltage.min()), float(voltage.max()), 4, (0.05,))
    plain = rows_of(basis, voltage, seconds, "empty")
    delayed = rows_of(replace(basis, delay=0.027), voltage, seconds, "empty")
    ago = seconds - 0.027
    wanted = np.column_stack([np.interp(ago, seconds, column) for column in plain.T])
    assert np.abs(delayed - wanted).max() < 1e-12


def test_blocks_passed_over_change_no_row() -> None:
    rng = np.random.default_rng(6)
    voltage = np.cumsum(rng.normal(size=3 * BLOCK_ROWS + 5))
    seconds = np.arange(len(voltage)) * 0.01
    basis = Basis(8, float(voltage.min()), float(voltage.max()), 2, (0.1,), 0.013)
    everything = rows_of(basis, voltage, seconds, "settled")
    wanted = np.zeros(len(voltage), bool)
    wanted[2 * BLOCK_ROWS + 9] = True
    made = list(drive_rows(basis, voltage, seconds, "settled", wanted))
    [(first, last, rows)] = made
    assert (first, last) == (2 * BLOCK_ROWS, 3 * BLOCK_ROWS)
    assert np.array_equal(rows, everything[first:last])


def test_statistics_are_the_products_of_the_dense_table() -> None:
    rng = np.random.default_rng(7)
    voltage = sine(6) * rng.uniform(0.9, 1.0, 241)
    log = prepared(voltage, 0.1 * voltage + 0.01 * rng.normal(size=241), order=1)
    basis = Basis(5, 0.0, 10.0, 3, (0.05, 0.2))
    statistics = gather([log], basis, 4)
    drive = rows_of(basis, voltage, log.seconds, "empty")
    table = np.hstack(
        (drive, -hat_functions(log.output, 4), log.drift, log.output[:, None])
    )
    gram, rows = statistics.total()
    assert rows == 241
    assert np.abs(gram - table.T @ table).max() < 1e-10
    without, fewer = statistics.total(leave_out=2)
    kept = table[log.fold != 2]
    assert fewer == len(kept)
    assert np.abs(without - kept.T @ kept).max() < 1e-10
    vector = rng.normal(size=statistics.columns.total)
    left = table @ np.append(vector, -1.0)
    assert squared_error(gram, vector) == pytest.approx(left @ left)
    assert statistics.nuisance[2] == slice(
        statistics.columns.total, statistics.columns.total
    )
    nuisance = slice(statistics.columns.total - 2, statistics.columns.total)
    part = table[log.fold == 2]
    loose = part[:, nuisance]
    fixed = part @ np.append(
        np.where(np.isin(np.arange(len(vector)), np.r_[nuisance]), 0.0, vector), -1.0
    )
    best = fixed - loose @ np.linalg.lstsq(loose, fixed, rcond=None)[0]
    found = squared_error_free_of(statistics.grams[2], vector, nuisance)
    assert found == pytest.approx(best @ best, rel=1e-6)


@pytest.mark.parametrize("slopes", ["growing", "falling", "free"])
def test_bounded_problem_reaches_what_a_general_solver_reaches(slopes: str) -> None:
    from scipy.optimize import lsq_linear

    rng = np.random.default_rng(8)
    gears, memories, drift = 7, 2, 2
    table = rng.normal(size=(300, gears + memories + 3 + drift))
    target = rng.normal(size=300) + table[:, :gears] @ rng.uniform(0.0, 0.3, gears)
    gram = np.hstack((table, target[:, None]))
    gram = gram.T @ gram
    columns = Columns(gears, memories, 4, drift)
    structure = Structure(slopes, (0, 1), 4, 0.0, 0.0)
    solution = solve(gram, columns, structure, 300)
    step = {"growing": np.tril, "falling": np.triu, "free": np.diag}
    spread = (
        step[slopes](np.ones((gears, gears))) if slopes != "free" else np.eye(gears)
    )
    mixed = np.hstack((table[:, :gears] @ spread / gears, table[:, gears:]))
    low = np.r_[np.zeros(gears + memories), np.full(3 + drift, -np.inf)]
    base = table[:, :gears] @ np.full(gears, SLOPE_FLOOR / gears)
    reference = lsq_linear(
        mixed, target - base, bounds=(low, np.inf), tol=1e-14, max_iter=5000
    )
    left = table @ solution.vector - target
    assert left @ left == pytest.approx(2.0 * reference.cost, rel=1e-9)
    assert solution.heights.min() >= SLOPE_FLOOR / gears * (1.0 - 1e-9)
    rises = np.diff(solution.heights)
    if slopes == "growing":
        assert rises.min() >= -1e-12
    if slopes == "falling":
        assert rises.max() <= 1e-12


def test_asymmetry_is_interpolation_and_goes_straight_on() -> None:
    knots = np.array([0.0, 0.2, 0.7, 1.0])
    w = np.array([-0.1, 0.0, 0.1, 0.45, 0.9, 1.3])
    y, slope = asymmetry(w, knots)
    thirds = np.arange(4) / 3.0
    assert y[1:-1] == pytest.approx(np.interp(w[1:-1], knots, thirds))
    assert y[0] == pytest.approx(-0.1 / 0.2 / 3.0)
    assert y[-1] == pytest.approx(1.0 + 0.3 / 0.3 / 3.0)
    assert slope == pytest.approx(1.0 / np.array([0.6, 0.6, 0.6, 1.5, 0.9, 0.9]))


def test_folds_are_whole_cycles_dealt_out_in_turn() -> None:
    voltage = sine(7)
    usable = np.ones(len(voltage), bool)
    usable[:45] = False
    folds = folds_of(drive_shape(voltage), usable, 3, 2)
    assert set(folds[:45]) == {-1}
    assert set(folds[45:80]) == {3}
    assert set(folds[80:120]) == {4}
    assert set(folds[120:160]) == {3}
    few = folds_of(drive_shape(sine(2)), np.ones(81, bool), 0, 10)
    assert np.bincount(few).tolist() == [21, 20, 20, 20]


def test_a_cycle_of_most_rows_is_no_fold_of_its_own() -> None:
    """Left out as a whole it would be extrapolated: 10 % were expected of a model that erred by 0.03 %."""
    voltage = np.concatenate((sine(1, 800), sine(4, 50, 4.0, 6.0)))
    folds = folds_of(drive_shape(voltage), np.ones(len(voltage), bool), 0, 10)
    assert len(np.unique(folds[:800])) == 8
    assert np.unique(folds).tolist() == list(range(10))


def test_a_clipped_sensor_is_where_it_stands_while_the_drive_moves() -> None:
    voltage = sine(3)
    displacement = np.minimum(voltage, 9.0)
    stuck = clipped_sensor(displacement, voltage)
    assert stuck.sum() == (displacement == 9.0).sum()
    assert not clipped_sensor(voltage, voltage).any()


def test_fewer_rows_are_spread_over_the_whole_log() -> None:
    log = prepared(sine(50), sine(50), folds=8)
    [cut] = fewer_rows([log], limit=400)
    assert np.bincount(cut.fold[cut.used]).tolist() == pytest.approx([50] * 8, abs=12)
    assert np.diff(np.flatnonzero(cut.used)).max() <= 90
    assert np.array_equal(cut.fold[cut.used], log.fold[cut.used])
    assert fewer_rows([log], limit=10_000)[0] is log


def test_a_fold_that_loses_all_its_rows_is_no_fold() -> None:
    log = prepared(sine(100), sine(100))
    moved = np.where(log.fold < 2, log.fold, log.fold + 1)
    moved[10:20] = 2  # between the stretches that are kept
    [cut] = fewer_rows([replace(log, fold=moved)], limit=400)
    assert np.unique(cut.fold).tolist() == [-1, 0, 1, 2, 3]
    folds = gather([cut], Basis(4, 0.0, 10.0), 1)
    assert min(folds.rows) > 0  # nothing is divided by the rows of none


@pytest.mark.parametrize("rate", [200.0, 333.0, 5000.0])
def test_memories_reach_as_far_at_any_sample_rate(rate: float) -> None:
    clock = np.arange(round(30.0 * rate)) / rate
    voltage = 50.0 - 50.0 * np.cos(2.0 * np.pi * clock) * np.linspace(
        1.0, 0.2, len(clock)
    )
    log = Recording("log", voltage, voltage**1.1, clock)
    grid = time_constant_grid(prepare([log], 0.0), 1.0 / rate, 100.0)
    assert grid[0] == 1.0 / rate
    assert grid[-1] == pytest.approx(15.0, rel=1e-3)  # half the log
    ratios = np.divide(grid[1:], grid[:-1])
    assert ratios[:-1] == pytest.approx(3.0)
    assert 3.0 <= ratios[-1] < 9.0


def test_single_wrong_voltages_are_replaced_and_steps_are_not() -> None:
    voltage = sine(5)
    wrong = voltage.copy()
    wrong[[33, 90]] = [60.0, -300.0]
    notes: list[str] = []
    clean = without_voltage_glitches(Recording("a", wrong, voltage), notes)
    assert np.abs(clean.voltage - voltage).max() < 0.05
    assert notes == [
        "a: 2 single voltages that jump away and back replaced by the mean of their neighbours "
        "(first at row 34: 60)"
    ]
    steps = np.repeat([0.0, 10.0, 2.0, 7.0], 30)
    for drive in (steps, sine(30, 6), voltage):
        notes = []
        same = without_voltage_glitches(Recording("a", drive, drive), notes)
        assert (same.voltage is drive, notes) == (True, [])


def test_simplest_that_is_no_worse() -> None:
    rows = np.ones(4)
    best = Score(np.array([1.0, 1.1, 0.9, 1.0]), rows)
    # 1.5 % of the RMSE: within the indifference
    near = Score(best.squares * 1.03, rows)
    far = Score(best.squares * 1.3, rows)
    noisy = Score(best.squares * np.array([1.4, 0.8, 1.2, 0.75]), rows)
    assert no_worse(near, best)
    assert not no_worse(far, best)
    assert no_worse(noisy, best)  # the folds do not agree which is better
    assert simplest_of([far, near, best]) == 1
    assert simplest_of([far, best, near]) == 1
