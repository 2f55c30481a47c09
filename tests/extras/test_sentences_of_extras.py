# ruff: noqa: E501  (a sentence stands on one line here)
"""The table of sentences, of the extras: fast and repeated moves, loops, exports, fringes, channels, moves.

Each test holds what a sentence claims against a simulated case, and that it is silent
in one of its opposite. More stand in ``test_sentences.py`` and
``test_sentences_of_files.py``.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_fringes import FRINGE, simulated, write
from test_runs_coupling import GAINS, QUICK, WORDS, drives, write_log
from test_runs_repeated import RATE, TIME, WIDE, actuator, move, period, played, rms
from trials import Floats

from dbo_cli.runs.api import Model


def texts_of(done: Any) -> str:
    return "\n".join([*done.notes, *done.warnings])


def figures(pattern: str, text: str) -> list[float]:
    """Return the groups of the one place where a sentence stands, as numbers."""
    found = re.search(pattern, text)
    assert found is not None, text
    return [float(group.replace(",", "")) for group in found.groups()]


# --- fast moves ---


def test_what_a_bandwidth_takes_off_is_what_is_missed() -> None:
    corner = np.interp(TIME, [0.0, 0.1, 0.15, 0.2, TIME[-1]], [3.0, 3.0, 7.0, 3.0, 3.0])
    done = Model(actuator()).compensate(corner, bandwidth=100.0, **WIDE)
    reached, _ = played(actuator(), done.values)
    off, most = figures(
        r"`bandwidth` 100 takes off (\S+) um \(RMS\), (\S+) um at most", texts_of(done)
    )
    assert off == pytest.approx(rms(reached - corner), rel=0.02)
    assert most == pytest.approx(float(np.abs(reached - corner).max()), rel=0.02)
    assert "takes off" not in texts_of(Model(actuator()).compensate(corner, **WIDE))


def test_a_move_that_begins_on_the_move_rings_by_what_is_said() -> None:
    wanted = 6.0 + 3.0 * np.sin(2.0 * np.pi * 20.0 * TIME)
    done = Model(actuator()).compensate(wanted, **WIDE | {"on_limit": "clip"})
    [rings] = figures(
        r"begins on the move, .* it rings at first, by about (\S+) um", texts_of(done)
    )
    reached, _ = played(actuator(), done.values)
    worst = float(np.abs(reached - wanted)[:200].max())
    assert 0.3 * rings < worst < 3.0 * rings
    assert "begins on the move" not in texts_of(
        Model(actuator()).compensate(move(), **WIDE)
    )


# --- learning ---


def learned(
    model: Model, plant: Any, shift: float = 0.0, **more: Any
) -> tuple[Any, Floats]:
    """Return the second pass and what was measured of the first, its zero shifted."""
    first = model.compensate(move(), **WIDE)
    measured = played(plant, first.values)[1] + shift
    return model.compensate(
        move(), tracked=(first.values, measured), **WIDE | more
    ), measured


def test_the_error_of_the_last_pass_is_the_one_that_was_measured() -> None:
    done, measured = learned(Model(actuator(0.36)), actuator())
    error = move() - measured
    off, percent, taken, cutoff = figures(
        r"the last pass was (\S+) um off \(RMS, (\S+) % of the move\), (\S+) um of it below (\S+) Hz",
        texts_of(done),
    )
    assert off == pytest.approx(float(np.std(error)), rel=0.01) or off == pytest.approx(
        rms(error), rel=0.01
    )
    assert percent == pytest.approx(100.0 * off / float(np.ptp(move())), rel=0.05)
    assert cutoff > 40.0
    reached, _ = played(actuator(), done.values)
    left = float(np.std(reached - move()))
    assert left < 0.7 * off  # what the pass takes off is gone
    assert taken <= off
    assert "the last pass was" not in texts_of(
        Model(actuator()).compensate(move(), **WIDE)
    )


def test_what_is_taken_for_the_sensor_s_zero_is_the_mean_of_the_error() -> None:
    done, measured = learned(Model(actuator(0.36)), actuator(), 2.5)
    [zero] = figures(
        r"the mean of the error, (\S+) um, is taken for the sensor's zero",
        texts_of(done),
    )
    assert zero == pytest.approx(float(np.mean(move() - measured)), rel=0.01)
    assert zero == pytest.approx(-2.5, abs=0.2)
    assert "sensor's zero" not in texts_of(
        learned(Model(actuator(0.36)), actuator(), absolute=True)[0]
    )


# --- loops ---


def test_the_step_at_the_seam_is_that_of_the_drive() -> None:
    done = Model(actuator()).compensate(period(), periodic=True, passes=0, **WIDE)
    seam, inside = figures(
        r"step at the loop's seam is (\S+) V, the largest inside (\S+) V",
        texts_of(done),
    )
    assert seam == pytest.approx(abs(float(done.values[0] - done.values[-1])), rel=0.01)
    assert inside == pytest.approx(float(np.abs(np.diff(done.values)).max()), rel=0.01)


def test_a_loop_settles_in_the_passes_and_to_the_limit_that_are_said() -> None:
    slow = period(4000)
    done = Model(actuator()).compensate(slow, periodic=True, passes=1, **WIDE)
    passes, seconds, first, within = figures(
        r"the loop settles in (\S+) pass\w*, (\S+) s: the mean of the first is (\S+) um off, then within .*, (\S+) um",
        texts_of(done),
    )
    assert seconds == pytest.approx(passes * slow.size / RATE, rel=0.01)
    drive = done.values[-slow.size :]
    repeated = np.concatenate([done.values, np.tile(drive, int(passes) + 1)])
    reached, _ = played(actuator(), repeated, 0.0)
    means = [
        abs(float(np.mean(part - slow)))
        for part in np.split(reached[done.values.size - slow.size :], int(passes) + 2)
    ]
    assert means[0] == pytest.approx(abs(first), rel=0.1)
    assert means[-1] <= 1.02 * within < means[0]


def test_the_first_pass_from_either_end_is_off_by_what_is_said() -> None:
    model, wanted = Model(actuator(frequency=None)), period(4000)
    free = {key: value for key, value in WIDE.items() if key != "state"}
    done = model.compensate(wanted, periodic=True, passes=1, **free)
    lower, upper = figures(
        r"from its lower end the actuator's first pass is (\S+) um off \(RMS\), from its upper end (\S+) um",
        texts_of(done),
    )
    for start, said in (("empty", lower), ("full", upper)):
        reached, _ = played(actuator(frequency=None), done.values, 0.0, start=start)
        assert rms(reached[-wanted.size :] - wanted) == pytest.approx(said, rel=0.03)
    known = model.compensate(wanted, periodic=True, passes=1, **WIDE)
    assert "from its lower end" not in texts_of(known)


# --- exports ---


@pytest.mark.parametrize("arithmetic", ["float", "q31"])
def test_the_tables_of_an_export_are_as_large_and_as_near_as_is_said(
    arithmetic: str, dbo: Any, model_file: Path
) -> None:
    words = ("--sample-rate", "1000", "--arithmetic", arithmetic)
    said = dbo("export", model_file, "-o", "firmware", *words).err
    same, close, width = figures(
        r"error at most (\S+) % of the range while both cross the same gears, (\S+) % after a turn within (\S+) % of a gear's width",
        said,
    )
    assert 0.0 < same <= close < 100.0
    assert 0.0 < width < 1.0
    gears, _ = figures(r"in \w+, (\d+) gears in (\d+) rows", said)
    assert gears == len(json.loads(model_file.read_text())["stages"][0]["dx"])
    exact = dbo("export", model_file, "-o", "exact", "--sample-rate", "1000").err
    assert "in double," in exact
    assert "error at most" not in exact


# --- fringes ---


def test_what_is_said_of_fringes_is_what_moved(dbo: Any) -> None:
    log = simulated()
    write("run.csv", time_s=log.time, voltage_V=log.drive, signal_V=log.signal)
    said = dbo("fringes", "run.csv", "--wavelength", "632.8nm", "-o", "out.csv").err
    count, moved, noise, typical, worst = figures(
        r"(\S+) fringes, (\S+) um; noise (\S+) % of the fringes; standard deviation (\S+) nm \(median\), (\S+) nm at most",
        said,
    )
    assert moved == pytest.approx(float(np.ptp(log.displacement)), abs=0.02)
    assert count == pytest.approx(moved / FRINGE, rel=0.01)
    assert noise == pytest.approx(2.0, rel=0.3)  # of an amplitude of about 1
    error = 1000.0 * (
        np.loadtxt("out.csv", delimiter=",", skiprows=1)[:, 2] - log.displacement
    )
    assert (
        0.3 * typical
        < float(np.median(np.abs(error - np.median(error))))
        < 3.0 * typical
    )
    assert float(np.std(error)) < worst
    turns, odds = figures(
        r"(\d+) turns of the drive, the branch taken at each at least (\S+) times", said
    )
    inside = np.diff(np.sign(np.diff(log.drive)[np.diff(log.drive) != 0.0])) != 0.0
    assert turns == np.count_nonzero(inside)
    assert odds > 100.0
    assert "photodiode's range" not in said


def test_rows_at_the_end_of_a_photodiode_are_counted(dbo: Any) -> None:
    log = simulated()
    top = float(np.quantile(log.signal, 0.97))
    write(
        "run.csv",
        time_s=log.time,
        voltage_V=log.drive,
        signal_V=np.minimum(log.signal, top),
    )
    said = dbo("fringes", "run.csv", "--wavelength", "632.8nm", "-o", "out.csv").err
    [clipped] = figures(
        r"(\S+) rows at the end of a photodiode's range say nothing", said
    )
    assert clipped == pytest.approx(np.count_nonzero(log.signal >= top), rel=0.05)


# --- channels ---


def test_how_channels_show_in_each_other_is_what_was_put_in(dbo: Any) -> None:
    write_log("log.csv", drives())
    said = dbo(
        "identify", "log.csv", *QUICK, *WORDS, "--coupling", "-o", "mirror.json"
    ).err
    count, of, seen, other, percent = figures(
        r"coupling: (\d+) of (\d+) gains are not 0; largest: (\d+) shows in (\d+), (\S+) %",
        said,
    )
    beside = GAINS - np.eye(3)
    assert (count, of) == (np.count_nonzero(beside), 6)
    row, column = np.unravel_index(np.abs(beside).argmax(), beside.shape)
    assert (other, seen) == (row + 1, column + 1)
    assert percent == pytest.approx(100.0 * beside[row, column], rel=0.1)
    alone = dbo("identify", "log.csv", *QUICK, *WORDS, "-o", "alone.json").err
    assert "coupling:" not in alone


def test_channels_that_hold_the_same_displacements_are_named(dbo: Any) -> None:
    write_log("log.csv", drives())
    assert (
        "hold the same displacements"
        not in dbo("identify", "log.csv", *QUICK, *WORDS, "-o", "a.json").err
    )
    lines = [line.split(",") for line in Path("log.csv").read_text().splitlines()]
    first, third = lines[0].index("D1_um"), lines[0].index("D3_um")
    for line in lines[1:]:
        line[third] = line[first]
    Path("log.csv").write_text("\n".join(map(",".join, lines)) + "\n")
    said = dbo("identify", "log.csv", *QUICK, *WORDS, "--force", "-o", "b.json").err
    assert re.search(
        r"channels 1, 3 hold the same displacements, sample by sample", said
    ), said


# --- moves ---


def test_a_raster_is_as_linear_as_is_said(dbo: Any) -> None:
    words = (
        "--rate",
        "1000",
        "--range",
        "2:10",
        "--lines",
        "8",
        "--frequency",
        "2",
        "--bandwidth",
        "30",
    )
    said = dbo("trajectory", "raster", *words, "--unit", "um", "-o", "scan.csv").err
    lines, each, line, linear = figures(
        r"raster: (\d+) lines, one in (\S+) s; of a line's (\S+) s (\S+) % are linear and inside the range",
        said,
    )
    assert (lines, each) == (8, 0.5)
    fast = np.loadtxt("scan.csv", delimiter=",", skiprows=1)[:, 1]
    speed = np.abs(np.diff(fast))
    usual = float(np.median(speed[speed > 0.0]))
    even = np.abs(speed - usual) < 1e-3 * usual
    assert 100.0 * np.count_nonzero(even) / (lines * line * 1000.0) == pytest.approx(
        linear, abs=3.0
    )


def test_a_step_has_settled_when_it_is_said_to_have() -> None:
    from dbo_cli.extras.moves.settling import settling_seconds

    plant = actuator()
    seconds = settling_seconds(plant, 20.0, 60.0, 0.01)
    drive = np.concatenate(
        [np.full(100, 20.0), np.full(int(1.5 * seconds * RATE), 60.0)]
    )
    rest = plant.simulate(
        np.full(8_000, 20.0), plant.start(20.0, "settled"), time_step=0.01
    ).state
    reached = plant.simulate(drive, rest, time_step=1.0 / RATE).y[100:]
    final = plant.simulate(
        np.full(8_000, 60.0),
        plant.simulate(drive[:101], rest, time_step=1.0 / RATE).state,
        time_step=0.01,
    ).y[-1]
    inside = np.abs(reached - final) <= 0.01
    begin = int(np.flatnonzero(~inside).max()) + 1
    assert begin / RATE == pytest.approx(seconds, rel=0.05)
