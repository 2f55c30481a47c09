"""Displacement from fringes: counts, odds, values and deviations; refusals; the command."""

from __future__ import annotations

import dataclasses
import functools
import json
from typing import Any, NamedTuple

import numpy as np
import pytest
from virtual_actuator import PRESETS, VirtualActuator

from dbo_cli.extras.fringes import branches
from dbo_cli.extras.fringes.light import clipped_rows, dark_parts
from dbo_cli.extras.fringes.one_signal import track_one_signal
from dbo_cli.extras.fringes.phase_smoother import diagonal_of_inverse, penalty_bands
from dbo_cli.extras.fringes.quadrature import track_quadrature
from dbo_cli.extras.fringes.swings import crossings, turning_points
from dbo_cli.extras.fringes.whole_counts import search
from dbo_cli.hysteresis.excitation import swings

FRINGE = 0.3164  # um: half the wavelength of a helium-neon laser
TURNS = (0.0, 1.0, 0.0, 0.7, 0.2, 0.9, 0.45, 0.8, 0.1, 0.6, 0.0)


class Simulated(NamedTuple):
    """A log whose displacement (um) is known; ``second`` is in quadrature."""

    time: Any
    drive: Any
    displacement: Any
    signal: Any
    second: Any


@functools.cache
def simulated(
    fringes: float = 6.0,
    noise: float = 0.02,
    samples: float = 20.0,
    plant: str = "stack",
) -> Simulated:
    """Return some swings of an actuator before an interferometer; ``samples`` in its fastest fringe."""
    parameters = dataclasses.replace(
        PRESETS[plant], stroke=fringes * FRINGE, offset=0.0
    )
    slowness = 1.0 + np.arange(len(TURNS) - 1) % 3
    counts = np.abs(np.diff(TURNS)) * fringes * samples * 0.5 * np.pi * slowness
    level = swings(TURNS, [int(count) + 10 for count in counts])
    drive = parameters.v_min + (parameters.v_max - parameters.v_min) * level
    time = np.arange(drive.size) / 2000.0
    displacement = VirtualActuator(parameters).displacement(time, drive)
    phase = 2.0 * np.pi * displacement / FRINGE + 1.0
    chance = np.random.default_rng(7)
    place = np.linspace(0.0, 1.0, drive.size)
    contrast = 1.0 + 0.1 * np.sin(5.0 * place)
    signal = (
        1.4
        + 0.1 * place
        + contrast * np.cos(phase)
        + noise * chance.standard_normal(drive.size)
    )
    second = (
        1.1
        + 0.8 * contrast * np.sin(phase + 0.15)
        + noise * chance.standard_normal(drive.size)
    )
    return Simulated(time, drive, displacement, signal, second)


def error_nm(phase: Any, log: Simulated) -> Any:
    """Return the error of a phase in nm, its mean taken off."""
    error = 1000.0 * (phase / (2.0 * np.pi) * FRINGE - log.displacement)
    return error - np.mean(error)


def write(path: Any, **columns: Any) -> None:
    """Write columns as CSV."""
    rows = np.column_stack(list(columns.values()))
    np.savetxt(
        path, rows, delimiter=",", header=",".join(columns), comments="", fmt="%.9g"
    )


# --- the mathematics ---


@pytest.mark.parametrize("plant", ["stack", "bender", "creeping"])
def test_one_photodiode_gives_the_displacement_without_a_slip(plant: str) -> None:
    log = simulated(plant=plant)
    track = track_one_signal(log.time, log.drive, log.signal)
    error = error_nm(track.phase, log)
    assert np.sqrt(np.mean(error**2)) < 4.0
    assert np.max(np.abs(error)) < 40.0
    assert track.noise == pytest.approx(0.02, rel=0.15)
    assert [turn.row for turn in track.turns] == list(
        turning_points(log.drive, 1.0)[1:-1]
    )
    assert min(turn.odds for turn in track.turns) > 1000.0


def test_the_deviation_is_about_the_error() -> None:
    log = simulated(noise=0.05)
    track = track_one_signal(log.time, log.drive, log.signal)
    ratio = error_nm(track.phase, log) / (
        1000.0 * FRINGE / (2.0 * np.pi) * track.deviation
    )
    assert 0.5 < np.sqrt(np.mean(ratio**2)) < 2.5


def test_two_photodiodes_need_no_drive() -> None:
    log = simulated()
    track = track_quadrature(
        log.time, np.linspace(0.0, 1.0, log.time.size), log.signal, log.second
    )
    sign = 1.0 if np.corrcoef(track.phase, log.displacement)[0, 1] > 0.0 else -1.0
    assert np.sqrt(np.mean(error_nm(sign * track.phase, log) ** 2)) < 3.0
    assert track.turns == []


def test_a_wrong_count_of_several_turns_is_put_right_by_the_others() -> None:
    """Two up and one down a fringe too far, as integers of a correlated estimate."""
    truth = np.array([1.0, 0.0, 2.0])
    joint = np.array([[0.5, 0.49, 0.48], [0.49, 0.5, 0.49], [0.48, 0.49, 0.5]])
    best, vectors, costs, complete = search(truth + 0.04, joint)
    assert complete
    assert best.tolist() == [1, 0, 2]
    assert costs.min() == pytest.approx(
        0.04 * np.ones(3) @ np.linalg.solve(joint, 0.04 * np.ones(3))
    )
    second = vectors[np.argsort(costs)[1]]
    # all together: what they do not know
    assert second.tolist() in ([2, 1, 3], [0, -1, 1])


def test_the_best_integers_are_those_of_trying_all() -> None:
    chance = np.random.default_rng(3)
    for _ in range(20):
        root = chance.normal(size=(3, 3)) * 0.4
        joint = root @ root.T + 0.01 * np.eye(3)
        value = chance.normal(size=3) * 2.0
        best = search(value, joint)[0]
        inverse = np.linalg.inv(joint)
        near = np.round(value)
        trials = [
            near + np.array([a, b, c])
            for a in range(-3, 4)
            for b in range(-3, 4)
            for c in range(-3, 4)
        ]
        costs = [(value - trial) @ inverse @ (value - trial) for trial in trials]
        cost = (value - best) @ inverse @ (value - best)
        assert cost <= min(costs) + 1e-9


def test_the_diagonal_of_the_inverse_is_that_of_the_dense_matrix() -> None:
    time = np.cumsum(np.random.default_rng(1).uniform(0.5, 1.5, 40))
    bands = penalty_bands(time, np.full(38, 0.1))
    bands[2] += 0.3
    dense = np.diag(bands[2]) + np.diag(bands[1, 1:], 1) + np.diag(bands[0, 2:], 2)
    dense = dense + np.triu(dense, 1).T
    assert diagonal_of_inverse(bands) == pytest.approx(
        np.diag(np.linalg.inv(dense)), rel=1e-9
    )


def test_a_likelihood_of_blocks_is_the_sum_over_their_rows() -> None:
    chance = np.random.default_rng(2)
    signal, phase = chance.normal(size=12), chance.normal(size=12)
    light = branches.Light(np.full(12, 0.2), np.full(12, 1.1), 0.3, np.ones(12))
    nodes = branches.Nodes(np.array([0, 5]), np.array([0, 1]))
    grid = np.array([-0.4, 0.0, 0.7])
    logs = branches.block_likelihood(nodes, signal, light, phase, grid)
    squares = (signal[:5, None] - 0.2 - 1.1 * np.cos(phase[:5, None] + grid)) ** 2
    variance = 0.3**2 + branches.GRID_NOISE**2 * 5 * 1.1**2
    assert logs[0] == pytest.approx(-0.5 * squares.sum(axis=0) / variance)


def test_crossings_and_turns() -> None:
    phase = np.linspace(0.0, 4.0 * np.pi, 400)
    places, slopes = crossings(np.cos(phase), np.zeros(400), np.ones(400))
    assert places * phase[1] == pytest.approx(
        np.pi * np.array([0.5, 1.5, 2.5, 3.5]), abs=0.02
    )
    assert slopes.tolist() == [-1, 1, -1, 1]
    assert turning_points(np.array([0.0, 2, 1.9, 3, 3, 1, 4]), 0.5).tolist() == [
        0,
        3,
        5,
        6,
    ]


def test_a_clipped_photodiode_is_left_out_where_it_is_clipped() -> None:
    log = simulated()
    signal = np.minimum(log.signal, 2.2)
    track = track_one_signal(log.time, log.drive, signal)
    assert track.clipped == clipped_rows(signal).sum() > 100
    assert np.sqrt(np.mean(error_nm(track.phase, log) ** 2)) < 12.0
    assert not clipped_rows(log.signal).any()


def test_an_interrupted_beam_is_seen() -> None:
    log = simulated()
    signal = log.signal.copy()
    signal[1000:1040] = -1.0
    assert dark_parts(signal) == [(1000, 1040)]
    assert dark_parts(log.signal) == []


# --- the command ---


def test_the_command_writes_what_identify_reads(whole_dbo: Any) -> None:
    log = simulated()
    write("run.csv", time_s=log.time, HV_V=log.drive, PD1_V=log.signal)
    done = whole_dbo("fringes", "run.csv", "--voltage", "HV_V", "--signal", "PD1_V", "--wavelength",
                     "632.8nm", "--summary", "sum.json", "-o", "out.csv")  # fmt: skip
    assert done.code == 0
    assert "9 turns of the drive, the branch taken at each at least" in done.err
    with open("out.csv", encoding="utf-8") as file:
        assert (
            file.readline()
            == "time_s,voltage_V,displacement_um,standard_deviation_um\n"
        )
    table = np.loadtxt("out.csv", delimiter=",", skiprows=1)
    assert table[0, 2] == 0.0
    error = 1000.0 * (table[:, 2] - log.displacement)
    assert np.std(error) < 4.0
    with open("sum.json", encoding="utf-8") as file:
        summary = json.load(file)
    assert len(summary["turns"]) == 9
    assert summary["fringes"] == pytest.approx(
        np.ptp(log.displacement) / FRINGE, abs=0.05
    )
    assert whole_dbo("identify", "out.csv", "-o", "model.json").code == 0


def test_sign_and_fringe_can_be_given(dbo: Any) -> None:
    log = simulated()
    write(
        "run.csv",
        time_s=log.time,
        voltage_V=log.drive,
        signal_V=log.signal,
        other_V=log.second,
    )
    assert (
        dbo(
            "fringes",
            "run.csv",
            "--per-fringe",
            "0.3164",
            "--sign",
            "falling",
            "-o",
            "a.csv",
        ).code
        == 0
    )
    assert dbo("fringes", "run.csv", "--per-fringe", "316.4nm", "--quadrature", "other_V", "--sign",
               "falling", "-o", "b.csv").code == 0  # fmt: skip
    first = np.loadtxt("a.csv", delimiter=",", skiprows=1)[:, 2]
    second = np.loadtxt("b.csv", delimiter=",", skiprows=1)[:, 2]
    assert np.std(first + log.displacement) < 0.004
    assert np.std(second + log.displacement) < 0.003


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        (
            lambda log: {
                "signal_V": 0.1
                * np.random.default_rng(1).standard_normal(log.time.size)
            },
            "% of the fringes' amplitude is left unexplained, and 20 % is the most",
        ),
        (
            lambda log: {"signal_V": np.cos(log.drive / 40.0)},
            "run.csv: it crosses its middle ",
        ),
        (
            lambda log: {"signal_V": log.drive, "voltage_V": log.signal},
            "run.csv: the voltage goes through half its range ",
        ),
        (
            lambda log: {"signal_V": np.zeros(log.time.size)},
            "run.csv: the signal is 0 in every row: no light moves there",
        ),
        (
            lambda log: {
                "signal_V": np.cos(2.0 * np.pi * 40.0 * log.displacement / FRINGE)
            },
            "run.csv: at {} s the signal changes by more than a quarter of a fringe from row to row",
        ),
    ],
)
def test_what_has_no_fringes_to_count_is_refused(
    dbo: Any, columns: Any, message: str
) -> None:
    log = simulated()
    write("run.csv", **({"time_s": log.time, "voltage_V": log.drive} | columns(log)))
    done = dbo("fringes", "run.csv", "--voltage", "voltage_V", "--signal", "signal_V", "--wavelength",
               "633nm", "-o", "out.csv")  # fmt: skip
    assert done.code == 1
    for part in message.split("{}"):
        assert part in done.err


def test_one_of_wavelength_and_fringe(dbo: Any) -> None:
    done = dbo("fringes", "run.csv", "-o", "out.csv")
    assert done == (
        2,
        "",
        "dbo: error: give the light's --wavelength (632.8nm; a fringe is half of it) or the displacement "
        "--per-fringe (316.4nm)\n",
    )


def test_parts_of_an_interrupted_log_have_their_own_zero(dbo: Any) -> None:
    log = simulated()
    signal = log.signal.copy()
    begin, end = 1500, 1560
    signal[begin:end] = -1.0
    write("run.csv", time_s=log.time, voltage_V=log.drive, signal_V=signal)
    done = dbo("fringes", "run.csv", "--wavelength", "632.8nm", "-o", "out.csv")
    assert done.code == 1
    assert f"or --rows 1:{begin} or {end + 1}:{log.time.size})" in done.err
    done = dbo("fringes", "run.csv", "--wavelength", "632.8nm", "-o", "out-{part}.csv")
    assert done.code == 0
    assert "each of the 2 parts has its own zero" in done.err
    for number, rows in ((1, slice(0, begin)), (2, slice(end, None))):
        values = np.loadtxt(f"out-{number}.csv", delimiter=",", skiprows=1)[:, 2]
        assert values[0] == 0.0
        assert np.std(values - log.displacement[rows]) < 0.004


def resting(log: Simulated) -> Simulated:
    """Return a log before and behind which the drive rests, and warmth moves the mirror by a fringe."""
    rows = 600
    away = np.linspace(0.0, 1.2 * FRINGE, rows)
    ends = (
        log.displacement[0] - away[::-1],
        log.displacement,
        log.displacement[-1] + away,
    )
    displacement = np.concatenate(ends)
    drive = np.concatenate(
        [np.full(rows, log.drive[0]), log.drive, np.full(rows, log.drive[-1])]
    )
    noise = 0.02 * np.random.default_rng(3).standard_normal(drive.size)
    signal = 1.4 + np.cos(2.0 * np.pi * displacement / FRINGE + 1.0) + noise
    return Simulated(
        np.arange(drive.size) / 2000.0, drive, displacement, signal, signal
    )


def test_rests_in_which_the_mirror_moved_by_itself_are_left_out(dbo: Any) -> None:
    log = resting(simulated())
    write("run.csv", time_s=log.time, voltage_V=log.drive, signal_V=log.signal)
    done = dbo("fringes", "run.csv", "--wavelength", "632.8nm", "-o", "out.csv")
    assert done.code == 0
    why = "the mirror moved by itself by some 2 half fringes while the drive stood still, 0 s to 0."
    assert f"dbo: warning: run.csv: {why}" in done.err
    table = np.loadtxt("out.csv", delimiter=",", skiprows=1)
    first = int(np.searchsorted(log.time, table[0, 0]))
    assert 500 < first < 620
    error = table[:, 2] - log.displacement[first : first + len(table)]
    assert np.std(error) < 0.004


def test_parts_on_both_sides_of_a_gap_are_spliced_where_that_is_asked_for(
    dbo: Any,
) -> None:
    log = simulated()
    row = 1500
    time = log.time + np.where(np.arange(log.time.size) < row, 0.0, 60.0)
    write("run.csv", time_s=time, voltage_V=log.drive, signal_V=log.signal)
    words = ("fringes", "run.csv", "--wavelength", "632.8nm", "-o", "out.csv")
    done = dbo(*words)
    assert done.code == 1
    gap = f"nothing was recorded from {log.time[row - 1]:.6g} s to {log.time[row] + 60.0:.6g} s"
    assert done.err.endswith(
        f"dbo: error: run.csv: {gap}, and nobody counted the fringes meanwhile: each part has a zero of its "
        "own (-o 'recorded-{part}.csv' writes a log of each, --splice takes them for one, or --rows "
        f"1:{row} or {row + 1}:{log.time.size})\n"
    )
    rows = slice(row - 1, row + 1)
    assert np.ptp(log.drive[rows]) < 2.0
    done = dbo(*words, "--splice", "--figures", "f")
    assert done.code == 0
    assert (
        f"{gap}: the 2 parts are spliced, as if neither drive nor mirror had moved meanwhile"
        in done.err
    )
    table = np.loadtxt("out.csv", delimiter=",", skiprows=1)
    assert len(table) == log.time.size
    np.testing.assert_allclose(table[:, 0], log.time, atol=1e-9)
    assert np.std(table[:row, 2] - log.displacement[:row]) < 0.004
    assert np.std(table[row:, 2] - log.displacement[row:]) < 0.004
    assert table[row, 2] == table[row - 1, 2]


def test_a_drive_that_moved_meanwhile_is_not_spliced(dbo: Any) -> None:
    log = simulated()
    signal = log.signal.copy()
    begin, end = 1500, 1560
    signal[begin:end] = -1.0
    write("run.csv", time_s=log.time, voltage_V=log.drive, signal_V=signal)
    done = dbo(
        "fringes", "run.csv", "--wavelength", "632.8nm", "--splice", "-o", "out.csv"
    )
    between = log.drive[begin - 1 : end + 1]
    when = f"from {log.time[begin - 1]:.6g} s to {log.time[end]:.6g} s"
    moved = f"between {between.min():.6g} V and {between.max():.6g} V"
    assert (done.code, done.err.splitlines()[-1]) == (
        1,
        f"dbo: error: run.csv: while nobody counted, {when}, the drive moved {moved}: --splice takes it for "
        "still (-o 'recorded-{part}.csv' writes a log of each part)",
    )


def test_figures_are_drawn(dbo: Any, blank_figures: None, tmp_path: Any) -> None:
    log = simulated()
    write("run.csv", time_s=log.time, voltage_V=log.drive, signal_V=log.signal)
    assert (
        dbo(
            "fringes",
            "run.csv",
            "--wavelength",
            "632.8nm",
            "--figures",
            "f",
            "-o",
            "out.h5",
        ).code
        == 0
    )
    names = {path.name for path in (tmp_path / "f").iterdir()}
    kinds = ("intensity", "displacement", "loop", "deviation", "odds")
    assert names == {f"run-{kind}.{form}" for kind in kinds for form in ("png", "svg")}


# --- the drive ---


def test_excite_makes_a_drive_whose_fringes_can_be_counted(dbo: Any) -> None:
    done = dbo("excite", "--v-max", "100", "--sample-rate", "4000", "--frequency", "2", "--duration", "4",
               "--fringes", "632.8nm", "--stroke", "2um", "-o", "drive.csv")  # fmt: skip
    assert done.code == 0
    assert (
        done.err
        == "dbo: 14,310 rows, 3.5775 s at 4000 rows a second, from 0 to 100 V, at most 628 V/s\n"
    )
    drive = np.loadtxt("drive.csv", delimiter=",", skiprows=1)[:, 1]
    assert drive.min() == drive[0] == drive[-1] == 0.0
    assert drive.max() == 100.0
    fringes = 2.0 / FRINGE
    assert np.max(np.abs(np.diff(drive))) / 100.0 * fringes < 1.0 / 30.0
    turns = drive[turning_points(drive, 0.5)][3:-1] / 100.0 * fringes
    assert len(turns) >= 6
    # every quarter of a fringe has one
    assert len({int(4.0 * (turn % 1.0)) for turn in turns}) == 4


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            "--sample-rate 1000 --fringes 632.8nm --stroke 12um",
            "--sample-rate 1000: a sweep of 37.9 fringes at 1 Hz needs 3575 rows a second for 20 in the "
            "fastest fringe (that, or --frequency 0.28)",
        ),
        (
            "--fringes 632.8nm",
            "--fringes WAVELENGTH and --stroke LENGTH belong together",
        ),
        (
            "--fringes 632.8nm --stroke 2um --channels 2",
            "--fringes excludes --points, --channels and --sweep-to",
        ),
    ],
)
def test_a_drive_that_cannot_be_counted_is_refused(
    dbo: Any, words: str, message: str
) -> None:
    done = dbo("excite", "--v-max", "100", *words.split(), "-o", "drive.csv")
    assert done.code == 2
    assert (
        message in done.err or "--channels and --fringes exclude each other" in done.err
    )
