"""Files for generators: what they say when they are read back, and what is refused."""

import math

import numpy as np
import pytest

from dbo_cli.drive.limits import Limits
from dbo_cli.errors import UsageError
from dbo_cli.model import Quantity
from dbo_cli.moves.waveform import GENERATORS, waveform

RATE = 1000.0
TIME = np.arange(1000) / RATE
DRIVE = 50.0 - 40.0 * np.cos(2.0 * np.pi * 4.0 * TIME)


def within(low=-math.inf, high=math.inf, slew=None):
    return Limits((low, high), Quantity("voltage", "V", low, high), slew)


def made(to, drive=DRIVE, limits=None, **options):
    if GENERATORS[to].volts_needed:
        options.setdefault("volts", (0.0, 5.0))
    return waveform(drive, RATE, to, limits or within(), **options)


@pytest.mark.parametrize("gain", [20.0, -3.0])
@pytest.mark.parametrize("to", ["npy", "wav", "keysight-arb", "pi-gcs"])
def test_no_code_lies_outside_the_limits(to, gain):
    low, high = float(DRIVE.min()), float(DRIVE.max())
    slew = float(np.abs(np.diff(DRIVE)).max()) * RATE * (1.0 + 1e-12)
    written = made(to, limits=within(low, high, slew), gain=gain)
    ends = sorted((low / gain, high / gain))
    assert written.volts.min() >= ends[0] and written.volts.max() <= ends[1]


def test_a_constant_drive_needs_volts():
    with pytest.raises(UsageError, match="`volts` 3:3"):
        made("wav", np.full(5, 3.0))
    written = made("wav", np.full(5, 3.0), volts=(0.0, 6.0))
    assert written.volts == pytest.approx(3.0, abs=1e-4)
