"""The paper's own method: its scale by its rule, its gears, and what they predict."""

import dataclasses
import os
from pathlib import Path

import numpy as np
import pytest
from random_actuators import undone

from dbo_cli.errors import FitError
from dbo_cli.identification.paper import identify_paper
from dbo_cli.identification.recording import Options, Recording
from dbo_cli.model import Gears, Scale, State

PAPER = Path(
    os.environ.get(
        "DBO_PAPER_DATA", Path(__file__).resolve().parents[3] / "shared/data/paper"
    )
)


def sine(amplitude=1.0, cycles=1, rows=200):
    phase = 2.0 * np.pi * np.arange(rows * cycles) / rows
    return 1.8 - 1.8 * amplitude * np.cos(phase)


def played(voltage):
    """Displacement of a fine operator that was at its lower end."""
    count = 300
    widths = np.full(count, 3.6 / count)
    gears = Gears(widths, widths * np.linspace(6.0, 14.0, count), 0.0, -20.0)
    moved = gears.run(voltage, State(0)).y
    return np.asarray(moved)


def of_cycle(**options):
    moved = played(sine(cycles=2))[200:]
    recording = Recording("cycle.csv", sine(), moved)
    return identify_paper(recording, dataclasses.replace(Options(), **options)), moved


def test_scale_and_origins_follow_the_papers_rule():
    model, moved = of_cycle(zero="mean")
    gears, scale = model.gears, model.stages[-1]
    assert isinstance(scale, Scale)
    assert scale.gain == pytest.approx(np.ptp(moved) / np.ptp(sine()), rel=1e-12)
    assert scale.offset == pytest.approx(moved.min() - moved.mean(), rel=1e-12)
    assert (gears.n, gears.x0, gears.y0) == (25, float(sine().min()), 0.0)
    assert gears.dx.sum() == pytest.approx(np.ptp(sine()), rel=1e-9)


def test_few_gears_follow_the_cycle_and_smaller_ones():
    model, moved = of_cycle()
    for amplitude in (1.0, 0.6, 0.35):
        voltage = np.concatenate([sine(), sine(amplitude, cycles=2)])
        truth = played(voltage)[-200:]
        found, _ = model.simulate(voltage, state="empty")
        assert np.std(found[-200:] - truth) < 0.01 * np.ptp(moved)


def test_the_inverse_is_exact_and_gears_are_as_asked_for():
    model, _ = of_cycle(gears=9, points=1)
    assert model.gears.n == 9
    assert len(model.stages) == 2
    voltage = sine(0.8, cycles=3)
    moved, _ = model.simulate(voltage, state="empty")
    back, _ = undone(model, moved, None, "empty")
    assert np.abs(back - voltage).max() < 1e-9


def test_a_falling_displacement_is_refused():
    recording = Recording("cycle.csv", sine(), -played(sine()))
    with pytest.raises(FitError, match=r"cycle\.csv"):
        identify_paper(recording, Options())


@pytest.mark.skipif(not PAPER.exists(), reason=f"the authors' logs are not in {PAPER}")
def test_the_published_scale_comes_out():
    table = np.loadtxt(PAPER / "identification.dat", usecols=(0, 4))[3151:3351]
    recording = Recording("identification.dat", table[:, 0], table[:, 1])
    model = identify_paper(recording, Options(zero="mean"))
    scale = model.stages[-1]
    assert isinstance(scale, Scale)
    found = round(scale.gain, 4), round(scale.offset, 4), model.gears.x0, model.gears.n
    assert found == (12.5335, -22.9726, 0.0, 25)
    other = np.loadtxt(PAPER / "uncompensated.dat", usecols=(0, 4))
    moved, _ = model.simulate(other[:, 0], state="empty")
    assert np.std((other[:, 1] - moved)[600:7000]) < 1.0
