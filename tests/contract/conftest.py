"""Shared fixtures: an empty working folder for each test, and one model of the sample log a session."""

from pathlib import Path

import numpy as np
import pytest

import dbo_cli

from .program import DRIVE, LOG, MOVE, SAMPLES, done, model, simulated, write

RATE = 1000.0


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Work in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="session")
def sample_model(tmp_path_factory):
    """Return the model that the sample log identifies."""
    path = tmp_path_factory.mktemp("sample") / "model.json"
    done("identify", SAMPLES / "identification.csv", "-o", path, "-q")
    return path


@pytest.fixture
def creep():
    """Return the stored model ``creep`` as the library has it."""
    return dbo_cli.read_model(model("creep"))


@pytest.fixture
def drive():
    """Return half a second of drive, 0 to 10 V and back in shrinking swings, at 1 kHz."""
    time = np.arange(500) / RATE
    swing = np.linspace(5.0, 1.0, 500)
    volts = 5.0 - swing * np.cos(2.0 * np.pi * 10.0 * time)
    return write("drive.csv", DRIVE, time, volts)


@pytest.fixture
def wish():
    """Return half a second of displacement within 2 to 8 um, from 2 um, at 1 kHz."""
    time = np.arange(500) / RATE
    wanted = 5.0 - 3.0 * np.cos(2.0 * np.pi * 4.0 * time)
    return write("wish.csv", MOVE, time, wanted)


@pytest.fixture
def log():
    """Return a log of drive and displacement of the stored model ``creep``, four swings, at 500 Hz."""
    return creep_log("log.csv")


def creep_log(name, seed=1):
    """Write what the stored model ``creep`` does in some swings, with 2 nm of noise."""
    time = np.arange(1600) / 500.0
    swing = np.concatenate([np.full(800, 50.0), np.full(400, 32.0), np.full(400, 18.0)])
    voltage = 50.0 - swing * np.cos(2.0 * np.pi * 1.25 * time)
    moved = simulated("creep", write("played.csv", DRIVE, time, voltage))
    Path("played.csv").unlink()
    noise = np.random.default_rng(seed).normal(0.0, 0.002, len(time))
    return write(name, LOG, time, voltage, moved + noise)
