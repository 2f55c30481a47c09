"""The ends of a drive's range: those of the amplifier, without the noise with which they were read back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from dbo_cli.hysteresis.excitation import Excitation
from dbo_cli.hysteresis.identification import IdentificationOptions, Recording, identify
from dbo_cli.hysteresis.identification.cleaning import (
    drive_range,
    read_back_noise,
    within,
)

Floats = NDArray[np.float64]
RANDOM = np.random.default_rng(5)

EXCITED = Excitation(0.0, 1.0, 1000.0, 15.0, 1.0).drive()[1]
TRIANGLES = 1.0 - np.abs(2.0 * (np.arange(6000) % 400) / 400.0 - 1.0)
SINES = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(6000) / 300.0)
GROWING = SINES * np.linspace(0.3, 1.0, 6000)
STAIRS = np.repeat(np.arange(0.0, 1.05, 0.1)[[0, 4, 9, 10, 2, 7, 0, 5, 10, 3]], 50)
ONE_WAY = np.concatenate([np.linspace(0.0, 1.0, 1500), np.linspace(1.0, 0.0, 1500)])
DRIVES = {
    "excite": EXCITED,
    "triangles": TRIANGLES,
    "sines": SINES,
    "growing": GROWING,
    "stairs": STAIRS,
    "one way": ONE_WAY,
}


def log_of(voltage: Floats) -> Recording:
    return Recording("log", voltage, voltage, sample_period=1e-3)


def read_back(drive: Floats, noise: float, seed: int = 1) -> Floats:
    noisy: Floats = drive + noise * np.random.default_rng(seed).standard_normal(
        drive.size
    )
    return noisy


@pytest.mark.parametrize("drive", DRIVES.values(), ids=list(DRIVES))
@pytest.mark.parametrize(("low", "high"), [(0.0, 100.0), (-20.0, 130.0), (0.0, 3.6)])
@pytest.mark.parametrize("share", [0.001, 0.005, 0.02])
def test_ends_are_those_of_the_drive_within_its_noise(
    drive: Floats, low: float, high: float, share: float
) -> None:
    applied = low + (high - low) * (drive - drive.min()) / np.ptp(drive)
    noise = share * (high - low)
    measured = read_back(applied, noise)
    assert read_back_noise(measured) == pytest.approx(noise, rel=0.15)
    found = drive_range([log_of(measured)])
    assert np.abs(np.subtract(found, (low, high))).max() <= 2.0 * noise
    assert found[0] >= measured.min() and found[1] <= measured.max()


@pytest.mark.parametrize("share", [0.0002, 0.001, 0.005])
def test_zero_and_the_rating_stay_after_excite(share: float) -> None:
    for seed in range(10):
        measured = read_back(100.0 * EXCITED, 100.0 * share, seed)
        assert measured.min() < -250.0 * share
        low, high = drive_range([log_of(measured)])
        assert low == 0.0
        assert high == pytest.approx(100.0, abs=200.0 * share)


def test_ends_that_are_no_round_number_are_not_made_one() -> None:
    ends = [
        drive_range([log_of(read_back(13.37 + 84.04 * EXCITED, 0.02, seed))])
        for seed in range(5)
    ]
    assert np.abs(np.subtract(ends, (13.37, 97.41))).max() < 0.04


ROUNDED = {
    "digits": lambda drive: np.round(100.0 * drive, 2),
    "10 bits": lambda drive: np.round(1023.0 * drive) / 1023.0 * 100.0,
    "single precision": lambda drive: (
        (100.0 * drive).astype(np.float32).astype(np.float64)
    ),
    "as computed": lambda drive: 100.0 * drive,
    "far away": lambda drive: 1e6 + drive,
}


@pytest.mark.parametrize("drive", DRIVES.values(), ids=list(DRIVES))
@pytest.mark.parametrize("change", ROUNDED.values(), ids=list(ROUNDED))
def test_a_drive_without_noise_keeps_every_digit(drive: Floats, change: object) -> None:
    voltage = change(drive)  # type: ignore[operator]
    assert read_back_noise(voltage) == 0.0
    assert drive_range([log_of(voltage)]) == (voltage.min(), voltage.max())
    [same] = within([log_of(voltage)], (voltage.min(), voltage.max()))
    assert same.voltage.tobytes() == voltage.tobytes()


def test_a_random_drive_is_no_noise() -> None:
    steps = RANDOM.uniform(0.0, 100.0, 5000)
    spectrum = np.zeros(2501, complex)
    spectrum[1:1200] = RANDOM.standard_normal(1199) + 1j * RANDOM.standard_normal(1199)
    for voltage in (steps, np.repeat(steps[:500], 10), np.fft.irfft(spectrum)):
        assert drive_range([log_of(voltage)]) == (voltage.min(), voltage.max())


def test_of_several_logs_the_widest_ends_count_each_without_its_noise() -> None:
    clean, noisy = log_of(80.0 * SINES - 5.0), log_of(read_back(100.0 * SINES, 0.3))
    low, high = drive_range([clean, noisy])
    assert low == -5.0
    assert high == pytest.approx(100.0, abs=0.6)


def test_a_model_has_the_range_of_the_amplifier() -> None:
    voltage = 10.0 * GROWING[::3]
    displacement = 2.0 * voltage + 0.4 * np.gradient(voltage, 1e-2)
    log = Recording("log", voltage, displacement, sample_period=1e-2)
    noisy = replace(log, voltage=read_back(voltage, 0.01))
    options = IdentificationOptions(gears=16, points=0, relaxation=(), delay=0.0)
    model = identify([noisy], options).model
    assert (model.input.minimum, model.input.maximum) == (
        0.0,
        pytest.approx(voltage.max(), abs=0.02),
    )
    assert noisy.voltage.min() < -0.01
    # An actuator at rest at the lower end starts with no gear engaged.
    assert model.start(0.0, "auto") == model.start(0.0, "empty")
