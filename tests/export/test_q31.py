"""Exports in whole numbers stay within the bound that they state."""

import firmware as fw
import numpy as np
import pytest

from dbo_cli.errors import ModelError, UsageError
from dbo_cli.export import export_model
from dbo_cli.model import Delay, Relaxation, Scale

pytestmark = pytest.mark.skipif(fw.NO_COMPILER, reason="needs a C compiler")
REFUSED = ("negative gains", "dynamics")
LIMITED = {"v_min": 12.0, "v_max": 93.0, "max_slew": 4000.0}


def exported(model, tmp_path, limits=None, flags=(), **options):
    made = export_model(
        model,
        limits or fw.limits_of(model),
        sample_rate=fw.RATE,
        arithmetic="q31",
        **options,
    )
    return fw.Firmware(made, tmp_path / "fw", *flags)


def apart(model, firmware, limits, wanted):
    """Return by how much each row of an export is off the library's, in volts."""
    low, high = model.output.min, model.output.max
    wanted = fw.with_rest(firmware.export, np.clip(wanted, low, high))
    counts = fw.counts_of(wanted, model.output)
    expected = fw.driven(model, fw.values_of(counts, model.output), limits)
    found = firmware.play(counts[firmware.export.figures["ahead"] :])
    volts = fw.values_of(found, model.input)
    assert volts.min() >= limits.move[0] and volts.max() <= limits.move[1]
    return np.abs(volts - expected[: volts.size])


@pytest.mark.parametrize("name", [name for name in fw.MODELS if name not in REFUSED])
def test_the_bound_holds(name, tmp_path):
    model = fw.MODELS[name]
    limits = fw.limits_of(model)
    firmware = exported(model, tmp_path, limits, ["-fsanitize=undefined"])
    off = apart(model, firmware, limits, fw.wish(model))
    stated = firmware.export.figures["bounds"]
    assert off.max() <= stated["close"]
    assert np.median(off) <= stated["same"]
    assert stated["same"] < 2e-5 * 100.0
    code, said = firmware.self_test()
    assert code == 0, said


def test_limits_are_kept_to_the_count(tmp_path):
    model = fw.MODELS["creep"]
    limits = fw.limits_of(model, **LIMITED)
    firmware = exported(model, tmp_path, limits)
    counts = fw.counts_of(fw.wish(model), model.output)
    volts = fw.values_of(firmware.play(counts), model.input)
    assert volts.min() >= 12.0 and volts.max() <= 93.0
    assert volts.max() > 92.99 and volts.min() < 12.01
    steps = np.abs(np.diff(volts))
    assert steps.max() <= 4.0 * (1.0 + 1e-12) and steps.max() > 3.9999
    assert firmware.self_test()[0] == 0
    off = apart(model, firmware, limits, fw.wish(model))
    slack = off.size * 100.0 / 2**31  # a count a step where the slew limit binds
    assert off.max() <= firmware.export.figures["bounds"]["close"] + slack


def test_gears_beyond_the_range(tmp_path):
    model = fw.wide_model()
    limits = fw.limits_of(model)
    firmware = exported(model, tmp_path, limits)
    assert "spare" in firmware.export.files["actuator.c"]
    off = apart(model, firmware, limits, fw.wish(model))
    assert off.max() <= firmware.export.figures["bounds"]["close"]


@pytest.mark.parametrize("seed", range(4))
def test_the_bound_holds_for_random_gears_and_memories(seed, tmp_path):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 400))
    terms = int(rng.integers(0, 4))
    memory = None
    if terms:
        tau = 10.0 ** rng.uniform(-3, 1.5, terms)
        gain = rng.uniform(0.0, 0.02, terms)
        memory = Relaxation(float(rng.normal() * 50.0), tuple(tau), tuple(gain))
    stages = [fw.gears(n, seed, memory), Scale(float(rng.choice([-3.0, 0.01])), 4.0)]
    model = fw.model_of(*stages, Delay(float(rng.uniform(0.0, 0.004))))
    limits = fw.limits_of(model)
    firmware = exported(model, tmp_path, limits)
    off = apart(model, firmware, limits, fw.wish(model, seed=seed))
    assert off.max() <= firmware.export.figures["bounds"]["close"]


def test_refusals(tmp_path):
    with pytest.raises(ModelError, match="dynamics"):
        exported(fw.MODELS["dynamics"], tmp_path)
    with pytest.raises(UsageError, match="`lookup`"):
        exported(fw.MODELS["creep"], tmp_path, lookup=True)
    still = fw.model_of(fw.gears(10, relaxation=Relaxation(0.0, (1e9,), (0.001,))))
    with pytest.raises(ModelError, match=r"relaxation\.tau: .*`sample_rate`"):
        exported(still, tmp_path)
    slow = fw.limits_of(fw.MODELS["gears"], max_slew=1e-5)
    with pytest.raises(ModelError, match="`max_slew`"):
        exported(fw.MODELS["gears"], tmp_path, slow)
