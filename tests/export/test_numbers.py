"""Exports give the numbers of the library: double its bits, q31 within the bound that it states."""

from pathlib import Path

import numpy as np
import pytest

import dbo_cli.model
from dbo_cli.drive import Limits
from dbo_cli.errors import ModelError, UsageError
from dbo_cli.export import export_model
from dbo_cli.export.plan import with_fewer_gears
from dbo_cli.model import Delay, Relaxation, Scale
from tests.export import firmware as fw

pytestmark = pytest.mark.skipif(fw.NO_COMPILER, reason="needs a C compiler")
FREE = {}
LIMITED = {"v_min": 12.0, "v_max": 93.0, "max_slew": 1500.0}
BEYOND = {"v_min": -5.0, "v_max": 105.0, "extrapolate": True}
OWN = Path(dbo_cli.model.__file__).parent


def exported(model, tmp_path, kept=FREE, flags=(), **options):
    """Return limits, and an export that is compiled."""
    limits = Limits.within(model.input, **kept)
    made = export_model(model, limits, sample_rate=fw.RATE, **options)
    return limits, fw.Firmware(made, tmp_path / "fw", *flags)


def same_bits(found, expected):
    return np.array_equal(found.view(np.uint64), expected.view(np.uint64))


# ---- double

CASES = [(name, LIMITED, {}) for name in fw.MODELS if "beyond" not in name]
CASES += [(name, FREE, {}) for name in ("creep", "amplifier", "dynamics")]
CASES += [("negative gains", FREE, {})]
CASES += [(name, BEYOND, {}) for name in ("beyond", "beyond, soft")]
CASES += [("few", kept, {"lookup": True}) for kept in (FREE, LIMITED)]
CASES += [("many", FREE, {"flags": ["-DDBO_SMALL", "-DDBO_PLACE=uint16_t"]})]


@pytest.mark.parametrize(("name", "kept", "options"), CASES)
def test_double_gives_the_bits_of_the_library(name, kept, options, tmp_path):
    """The very files of the kernel, with tables; the self-test says the same."""
    model = fw.MODELS[name]
    limits, firmware = exported(model, tmp_path, kept, **options)
    found, expected = fw.played(model, limits, firmware)
    assert same_bits(found, expected)
    assert np.unique(found).size > 500
    assert firmware.self_test()[0] == 0
    files = firmware.export.files
    assert kept is not BEYOND or ("spare" in files["actuator.c"] and found.max() > 100)
    for file in files:
        if file.startswith("dbo_") and "lookup" not in file:
            assert files[file] == (OWN / file).read_text()


@pytest.mark.parametrize(
    "name", ["bent, falling", "few", "negative gains", "amplifier, all"]
)
def test_after_a_reset_the_state_is_that_of_a_settled_actuator(name, tmp_path):
    model = fw.MODELS[name]
    options = {"lookup": True} if name == "few" else {}
    limits, firmware = exported(model, tmp_path, **options)
    assert same_bits(*fw.played(model, limits, firmware, state="settled"))


# ---- q31

REFUSED = ("negative gains", "dynamics", "beyond, soft", "amplifier", "amplifier, all")


@pytest.mark.parametrize("name", [name for name in fw.MODELS if name not in REFUSED])
def test_q31_keeps_the_bound_that_it_states(name, tmp_path):
    model, options = fw.MODELS[name], {"arithmetic": "q31"}
    options["flags"] = ["-fsanitize=undefined"]
    limits, firmware = exported(model, tmp_path, **options)
    found, expected = fw.played(model, limits, firmware)
    error, stated = np.abs(found - expected), firmware.export.figures["bounds"]
    assert error.max() <= stated["close"]
    assert np.median(error) <= stated["same"] < 2e-5 * 100.0
    code, said = firmware.self_test()
    assert code == 0, said


def test_q31_keeps_limits_to_the_count(tmp_path):
    model, kept = fw.MODELS["creep"], LIMITED | {"max_slew": 4000.0}
    limits, firmware = exported(model, tmp_path, kept, arithmetic="q31")
    volts, expected = fw.played(model, limits, firmware)
    assert 12.0 <= volts.min() < 12.01 and 92.99 < volts.max() <= 93.0
    steps = np.abs(np.diff(volts))
    assert steps.max() <= 4.0 * (1.0 + 1e-12) and steps.max() > 3.9999
    slack = volts.size * 100.0 / 2**31  # a count a step where the slew limit binds
    stated = firmware.export.figures["bounds"]["close"]
    assert np.abs(volts - expected).max() <= stated + slack
    assert firmware.self_test()[0] == 0


@pytest.mark.parametrize("seed", range(4))
def test_the_bound_holds_for_random_gears_and_memories(seed, tmp_path):
    rng = np.random.default_rng(seed)
    n, terms = int(rng.integers(2, 400)), int(rng.integers(0, 4))
    memory = None
    if terms:
        tau, gain = 10.0 ** rng.uniform(-3, 1.5, terms), rng.uniform(0.0, 0.02, terms)
        memory = Relaxation(float(rng.normal() * 50.0), tuple(tau), tuple(gain))
    stages = [fw.gears(n, seed, memory), Scale(float(rng.choice([-3.0, 0.01])), 4.0)]
    model = fw.model_of(*stages, Delay(float(rng.uniform(0.0, 0.004))))
    limits, firmware = exported(model, tmp_path, arithmetic="q31")
    found, expected = fw.played(model, limits, firmware, seed=seed)
    stated = firmware.export.figures["bounds"]["close"]
    assert np.abs(found - expected).max() <= stated


def test_what_q31_cannot_hold_is_refused():
    still = fw.model_of(fw.gears(10, relaxation=Relaxation(0.0, (1e9,), (0.001,))))
    for model, kept, options, problem, named in (
        (fw.MODELS["dynamics"], FREE, {}, ModelError, "dynamics"),
        (fw.MODELS["amplifier"], FREE, {}, ModelError, "^amplifier: "),
        (fw.MODELS["creep"], FREE, {"lookup": True}, UsageError, "`lookup`"),
        (still, FREE, {}, ModelError, r"relaxation\.tau: .*`sample_rate`"),
        (fw.MODELS["gears"], {"max_slew": 1e-5}, {}, ModelError, "`max_slew`"),
    ):
        limits = Limits.within(model.input, **kept)
        options = {"sample_rate": fw.RATE, "arithmetic": "q31", **options}
        with pytest.raises(problem, match=named):
            export_model(model, limits, **options)


# ---- fewer gears


@pytest.mark.parametrize(("name", "before"), [("creep", ()), ("gears", (fw.LAG,))])
def test_fewer_gears_keep_the_loading_curve_and_say_what_is_lost(name, before):
    """An amplifier's lag alone asks for a clock, which the test moves have then."""
    model = fw.MODELS[name]
    model = model.with_stages((*before, *model.stages))
    fewer, loss = with_fewer_gears(model, 16)
    assert fewer.gears.n == 16 and fewer.amplifier == model.amplifier
    up = np.linspace(0.0, 100.0, 17)
    full, _ = model.static.simulate(up, dt=1e9, state="empty")
    coarse, _ = fewer.static.simulate(up, dt=1e9, state="empty")
    np.testing.assert_allclose(coarse, full, atol=1e-12)
    assert 0.0 < loss["rms"] < loss["max"] < 0.05 * model.output.span
    assert with_fewer_gears(model, 4)[1]["rms"] > 2.0 * loss["rms"]
    assert with_fewer_gears(model, model.gears.n) == (model, None)
    for gears in (0, model.gears.n + 1):
        with pytest.raises(UsageError, match="`gears`"):
            with_fewer_gears(model, gears)
