"""Faults of sensors and loggers: what is mended, what is left out, what is left alone, and what is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dbo_cli.errors import UsageError
from dbo_cli.hysteresis.identification import IdentificationOptions, Recording
from dbo_cli.hysteresis.identification.cleaning import (
    Sensor,
    mended,
    slope,
    spiked_rows,
    stuck_rows,
)
from dbo_cli.hysteresis.identification.preparation import clipped_sensor

STEP = 0.005


def drive(cycles: int = 12, samples: int = 200) -> np.ndarray:
    phase = 2.0 * np.pi * np.arange(cycles * samples) / samples
    return (50.0 - 50.0 * np.cos(phase)) * np.interp(
        phase, [0.0, phase[-1]], [1.0, 0.4]
    )


def moved(voltage: np.ndarray, noise: float = 0.01) -> np.ndarray:
    rng = np.random.default_rng(3)
    return 0.2 * voltage + 0.0005 * voltage**2 + noise * rng.normal(size=len(voltage))


def log(voltage: np.ndarray, displacement: np.ndarray) -> Recording:
    return Recording("a", voltage, displacement, None, STEP, "V", "um")


def mended_and_notes(recording: Recording) -> tuple[Recording, list[str]]:
    notes: list[str] = []
    return mended(recording, notes), notes


def test_a_clean_log_is_left_alone() -> None:
    voltage = drive()
    recording = log(voltage, moved(voltage))
    found, notes = mended_and_notes(recording)
    assert found.voltage is recording.voltage
    assert found.displacement is recording.displacement
    assert found.faulty is not None and found.faulty.sum() == 0
    assert notes == []
    coarse = log(voltage, np.round(moved(voltage) / 0.5) * 0.5)
    assert mended_and_notes(coarse)[1] == []
    held = log(voltage, np.repeat(moved(voltage)[::4], 4))
    assert mended_and_notes(held)[1] == []


@pytest.mark.parametrize("size", [0.02, 1.0])
def test_hum_is_said_and_taken_off(size: float) -> None:
    voltage = drive()
    clean = moved(voltage, 0.005)
    time = STEP * np.arange(len(voltage))
    found, notes = mended_and_notes(
        log(voltage, clean + size * np.sin(2.0 * np.pi * 50.0 * time + 0.4))
    )
    inside = slice(100, -100)
    assert float(np.std((found.displacement - clean)[inside])) < 0.003 + 0.02 * size
    assert float(notes[0].split()[3]) == pytest.approx(size, rel=0.05)
    assert " um at 50 Hz, which the drive does not have" in notes[0]


def test_what_the_drive_has_is_no_hum() -> None:
    voltage = drive()
    time = STEP * np.arange(len(voltage))
    humming = voltage + 2.0 * np.sin(2.0 * np.pi * 50.0 * time)
    assert not any(
        "hum" in note for note in mended_and_notes(log(humming, moved(humming)))[1]
    )
    square = 50.0 + 50.0 * np.sign(np.sin(2.0 * np.pi * time))
    assert not any(
        "hum" in note for note in mended_and_notes(log(square, moved(square)))[1]
    )


def test_noise_of_the_read_back_is_smoothed() -> None:
    voltage = drive()
    noisy = voltage + 0.5 * np.random.default_rng(1).normal(size=len(voltage))
    found, notes = mended_and_notes(log(noisy, moved(voltage)))
    assert float(np.std(found.voltage - voltage)) < 0.2
    assert "the voltage's read-back is noisy (0.5" in notes[0]
    jumps = np.repeat([10.0, 90.0, 30.0, 70.0, 0.0, 100.0], 400)
    assert mended_and_notes(log(jumps, moved(jumps)))[1] == []


def test_many_spikes_are_left_out_and_turns_are_not() -> None:
    voltage = drive()
    clean = moved(voltage)
    rng = np.random.default_rng(2)
    rows = np.sort(rng.choice(len(clean), len(clean) // 20, replace=False))
    spiky = clean.copy()
    spiky[rows] += rng.choice([-1.0, 1.0], len(rows)) * rng.uniform(
        2.0, 12.0, len(rows)
    )
    found, notes = mended_and_notes(log(voltage, spiky))
    assert found.faulty[rows].mean() > 0.9
    assert found.faulty.sum() < 1.1 * len(rows)
    assert f"first at row {int(np.argmax(found.faulty)) + 1}" in notes[0]
    triangle = np.abs((np.arange(2000) / 10.0) % 2.0 - 1.0)
    assert not spiked_rows(triangle).any()


def test_a_sensor_that_stands_still_is_left_out() -> None:
    voltage = drive()
    stuck = moved(voltage)
    stuck[900:1000] = stuck[900]
    assert np.flatnonzero(stuck_rows(stuck, voltage)).tolist() == list(range(900, 1000))
    assert (
        "100 rows left out: the displacement stands still"
        in mended_and_notes(log(voltage, stuck))[1][0]
    )


def test_a_plateau_of_the_actuator_is_not_a_clipped_sensor() -> None:
    voltage = drive()
    clipped = np.round(np.minimum(moved(voltage, 0.0), 15.0), 3)
    assert clipped_sensor(clipped, voltage).sum() == (clipped == 15.0).sum()
    wing = np.round(10.0 / (1.0 + np.exp(-(voltage - 50.0) / 4.0)), 2)
    assert (wing == wing.min()).sum() > 100
    assert not clipped_sensor(wing, voltage).any()


def test_the_sensors_delay_and_lag_are_taken_off() -> None:
    rate, tau, delay = 2000.0, 0.004, 0.0105
    time = np.arange(6000) / rate
    true = (
        10.0
        + 5.0 * np.sin(2.0 * np.pi * 3.0 * time)
        + 2.0 * np.sin(2.0 * np.pi * 7.0 * time)
    )
    seen = np.interp(time - delay, time, true)
    decay = np.exp(-1.0 / (rate * tau))
    hold = (1.0 - decay) * rate * tau  # of a signal that is straight between samples
    late = seen.copy()
    for k in range(1, len(seen)):
        late[k] = (
            decay * late[k - 1] + (1.0 - hold) * seen[k] + (hold - decay) * seen[k - 1]
        )
    seen = late
    sensor = Sensor(delay, tau)
    for clock in (
        Recording("a", true, seen, time),
        Recording("a", true, seen, None, 1.0 / rate),
    ):
        mended = sensor.taken_off(clock)
        assert len(mended.voltage) == len(mended.displacement) == 6000 - 21
        inside = slice(100, -100)
        assert np.abs(mended.displacement - true[: 6000 - 21])[inside].max() < 0.02
    assert Sensor().taken_off(clock) is clock
    uneven = time + 1e-4 * np.random.default_rng(1).uniform(size=len(time))
    assert (
        np.abs(slope(np.sin(uneven), uneven, 0.01) - np.cos(uneven))[20:-20].max()
        < 1e-3
    )


def test_a_sensor_that_is_none_is_refused() -> None:
    with pytest.raises(
        UsageError,
        match=r"^`sensor_delay` 1 s is more than a quarter of a cycle of the logs",
    ):
        Sensor(delay=1.0).check(2.0)
    with pytest.raises(
        UsageError, match=r"^`sensor_delay` and `sensor_lag` need a clock"
    ):
        Sensor(lag=0.1).check(None)
    Sensor().check(None)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"gears": 2.5}, "`gears` 2.5: is a whole number, at least 1"),
        ({"gears": True}, "`gears` True: is a whole number"),
        ({"points": -1}, "`points` -1: is a whole number, at least 0"),
        ({"delay": float("nan")}, "`delay` nan: is a time in seconds, not negative"),
        ({"delay": "fast"}, "`delay` 'fast': is a time"),
        ({"relaxation": "auto"}, "`relaxation` 'auto': give a list"),
        (
            {"relaxation": (0.1, float("nan"))},
            "`relaxation` nan: time constants are positive",
        ),
        (
            {"slopes": "sideways"},
            "`slopes` 'sideways': is one of growing, falling, free",
        ),
        ({"method": "magic"}, "`method` 'magic': is one of least-squares, paper"),
        (
            {"zero": "middle"},
            "`zero` 'middle': is one of none, mean, first or a displacement",
        ),
        ({"zero": float("inf")}, "`zero` inf: is one of"),
        ({"rated": (5.0, 5.0)}, r"`rated` \(5.0, 5.0\): the lower end"),
        ({"rated": 5.0}, "`rated` 5.0: give both ends"),
        ({"skip_seconds": -1}, "`skip` -1: is a time"),
        ({"force": "yes"}, "`force` 'yes': is one of False, True"),
        (
            {"sensor_delay": -0.1},
            "`sensor_delay` -0.1: is a time in seconds, not negative",
        ),
        ({"sensor_lag": None}, "`sensor_lag` None: is a time"),
        (
            {"method": "paper", "slopes": "free"},
            "`slopes` does not go with `method` paper",
        ),
        (
            {"method": "paper", "skip_seconds": 1.0},
            "`skip` does not go with `method` paper",
        ),
        (
            {"method": "paper", "rated": (0, 5)},
            "`rated` does not go with `method` paper",
        ),
        ({"method": "paper", "delay": 0.1}, "`delay` does not go with `method` paper"),
    ],
)
def test_options_that_make_no_sense_are_refused(
    wrong: dict[str, object], message: str
) -> None:
    with pytest.raises(UsageError, match=f"^{message}"):
        IdentificationOptions(**wrong)  # type: ignore[arg-type]


def test_options_that_mean_nothing_more_are_taken() -> None:
    taken = IdentificationOptions(
        gears=25, relaxation=[], delay=0, method="paper", zero=2
    )
    assert (taken.relaxation, Sensor.of(taken)) == ((), Sensor())
    assert replace(taken, method="least-squares", relaxation=[0.1, 1]).relaxation == (
        0.1,
        1.0,
    )
