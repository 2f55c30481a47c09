"""Exports in double give the bits of the library, whatever the model."""

from pathlib import Path

import firmware as fw
import numpy as np
import pytest

import dbo_cli.model
from dbo_cli.errors import UsageError
from dbo_cli.export import export_model
from dbo_cli.export.plan import with_fewer_gears

pytestmark = pytest.mark.skipif(fw.NO_COMPILER, reason="needs a C compiler")
LIMITS = {"free": {}, "limited": {"v_min": 12.0, "v_max": 93.0, "max_slew": 1500.0}}


def same_bits(a, b):
    return np.array_equal(a.view(np.uint64), b.view(np.uint64))


def exported(model, tmp_path, limits=None, flags=(), **options):
    limits = limits or fw.limits_of(model)
    made = export_model(model, limits, sample_rate=fw.RATE, **options)
    return fw.Firmware(made, tmp_path / "fw", *flags)


def compared(model, firmware, limits):
    """Return what an export and the library make of one move from ``empty``."""
    wanted = fw.with_rest(firmware.export, fw.wish(model))
    expected = fw.driven(model, wanted, limits)
    found = firmware.play(wanted[firmware.export.figures["ahead"] :])
    return found, expected[: found.size]


CASES = [(name, "limited") for name in fw.MODELS]
CASES += [(name, "free") for name in ("creep", "negative gains", "dynamics")]


@pytest.mark.parametrize(("name", "kept"), CASES)
def test_the_bits_of_the_library(name, kept, tmp_path):
    model = fw.MODELS[name]
    limits = fw.limits_of(model, **LIMITS[kept])
    firmware = exported(model, tmp_path, limits)
    found, expected = compared(model, firmware, limits)
    assert same_bits(found, expected)
    assert np.unique(found).size > 500
    assert firmware.self_test()[0] == 0


@pytest.mark.parametrize("memory", [None, "soft"])
def test_gears_beyond_the_range(memory, tmp_path):
    model = fw.wide_model(fw.SOFT if memory else None)
    limits = fw.limits_of(model, v_min=-5.0, v_max=105.0, extrapolate=True)
    firmware = exported(model, tmp_path, limits)
    assert "spare" in firmware.export.files["actuator.c"]
    found, expected = compared(model, firmware, limits)
    assert same_bits(found, expected)
    assert found.max() > 100.0
    assert firmware.self_test()[0] == 0


@pytest.mark.parametrize("name", ["bent, falling", "negative gains", "dynamics"])
def test_after_a_reset_the_state_is_that_of_a_settled_actuator(name, tmp_path):
    model = fw.MODELS[name]
    limits = fw.limits_of(model)
    firmware = exported(model, tmp_path, limits)
    wanted = fw.with_rest(firmware.export, fw.wish(model)[300:])
    expected = fw.driven(model, wanted, limits, state="settled")
    later = firmware.export.figures["ahead"]
    found = firmware.play(wanted[1 + later :], reset=expected[0])
    if name == "dynamics":  # which begin one row later at rest
        expected = expected[: found.size + 1]
    assert same_bits(found, expected[1 : 1 + found.size])


@pytest.mark.parametrize("flags", [["-DDBO_SMALL"], ["-DDBO_PLACE=uint16_t"]])
def test_less_code_and_less_memory_change_no_bit(flags, tmp_path):
    model = fw.MODELS["many"]
    firmware = exported(model, tmp_path, flags=flags)
    assert same_bits(*compared(model, firmware, fw.limits_of(model)))


# ---- fewer gears


def test_fewer_gears_keep_the_loading_curve_and_say_what_is_lost():
    model = fw.MODELS["creep"]
    fewer, loss = with_fewer_gears(model, 16)
    assert fewer.gears.n == 16
    up = np.linspace(0.0, 100.0, 17)
    full, _ = model.static.simulate(up, dt=1e9, state="empty")
    coarse, _ = fewer.static.simulate(up, dt=1e9, state="empty")
    np.testing.assert_allclose(coarse, full, atol=1e-12)
    assert 0.0 < loss["rms"] < loss["max"] < 0.05 * model.output.span
    worse = with_fewer_gears(model, 4)[1]
    assert worse["rms"] > 2.0 * loss["rms"]
    assert with_fewer_gears(model, 64) == (model, None)


@pytest.mark.parametrize("gears", [0, 65])
def test_more_gears_than_there_are_are_refused(gears):
    with pytest.raises(UsageError, match="`gears`"):
        with_fewer_gears(fw.MODELS["creep"], gears)


def test_files_of_the_kernel_are_the_very_files():
    limits = fw.limits_of(fw.MODELS["gears"])
    made = export_model(fw.MODELS["dynamics"], limits, sample_rate=fw.RATE)
    own = Path(dbo_cli.model.__file__).parent
    names = "dbo_kernel.c dbo_kernel.h dbo_dynamics.c dbo_interpolation.h"
    for name in names.split():
        assert made.files[name] == (own / name).read_text()
