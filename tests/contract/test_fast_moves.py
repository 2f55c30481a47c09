"""Fast moves of a stage behind a slow amplifier: its lag is told from a sweep, and undone."""

from __future__ import annotations

import numpy as np
import pytest

from .program import LOG, MOVE, SAMPLES, done, load, rms, table, write

RATE = 2_500.0
AMPLIFIER = 1.5e-3  # s
MODES = ((200.0, 0.03, 1.0),)


def test_an_amplifier_is_told_from_a_sweep_and_undone_in_fast_moves(monkeypatch):
    """A lag behind the gears instead leaves 1.7 % of the move at a fifth of the resonance."""
    monkeypatch.syspath_prepend(str(SAMPLES))
    from virtual_positioner import PositionerParameters, VirtualPositioner

    stage = VirtualPositioner(
        PositionerParameters(modes=MODES, amplifier_lag=AMPLIFIER, creep=())
    )
    words = "--v-max 100 --sample-rate 2500 --duration 6 --sweep-to 250".split()
    drive = table(done("excite", *words))
    time, voltage = drive["time_s"], drive["voltage_V"]
    log = write("log.csv", LOG, time, voltage, stage.play(voltage, RATE))
    plain = "--relaxation 0 --points 0 --dynamics 1".split()
    done("identify", log, *plain, "-o", "model.json")
    first = load("model.json")["stages"][0]
    assert first["type"] == "amplifier"
    assert first["seconds"] == pytest.approx(AMPLIFIER, rel=0.1)

    rows = np.arange(3500)
    up = 0.5 - 0.5 * np.cos(np.pi * np.clip((rows - 200) / 1000.0, 0.0, 1.0))
    grown = np.clip(np.minimum(rows - 1500, 3300 - rows) / 300.0, 0.0, 1.0)
    swing = 3.0 * (0.5 - 0.5 * np.cos(np.pi * grown))
    desired = 0.05 + 4.95 * up + swing * np.sin(2.0 * np.pi * 40.0 * rows / RATE)
    move = write("move.csv", MOVE, rows / RATE, desired)
    words = "--from 0 --state empty --lead auto -o drive.csv".split()
    done("compensate", "model.json", move, *words)
    played = table("drive.csv")
    moved = stage.displacement(played["voltage_V"], RATE)
    middle = slice(2000, 3000)  # rows of the move, which stands last
    error = (moved - played["desired_um"])[-3500:][middle]
    assert rms(error) < 0.0025 * 6.0
