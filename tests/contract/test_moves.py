"""``trajectory``, ``waveform``, ``excite``: moves, files for generators, a drive that identifies well."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.io import wavfile

from .program import DRIVE, compensated, dbo, done, model, refused, table, write

TIME = np.arange(1000) / 1000.0
VOLTS = 50.0 - 40.0 * np.cos(2.0 * np.pi * 4.0 * TIME)


@pytest.fixture(autouse=True)
def drive_file(folder):
    return write("drive.csv", DRIVE, TIME, VOLTS)


# --- trajectory ---

SMALL = ("--model", model("small"))
WORDS = ("--rate", 1000, "--range", "2:8", "--frequency", 5)


def shape(*words):
    return table(done("trajectory", *words, *SMALL, "-q"))


@pytest.mark.parametrize("kind", ["sine", "triangle"])
def test_periodic_shapes(kind):
    time, moved = shape(kind, *WORDS, "--duration", 1).values()
    assert moved.min() == pytest.approx(2.0, abs=0.1)
    assert moved.max() == pytest.approx(8.0, abs=0.1)
    np.testing.assert_allclose(np.diff(time), 0.001, rtol=1e-9)
    assert 900 <= len(time) <= 1300
    crossings = np.sum(np.diff(np.sign(moved - 4.999)) != 0)
    assert 9 <= crossings <= 12


def test_a_staircase_dwells_at_each_level():
    _, moved = shape("staircase", *WORDS[:4], "--steps", 4, "--dwell", 0.1).values()
    levels, counts = np.unique(np.round(moved, 9), return_counts=True)
    dwelt = levels[counts >= 95]
    assert dwelt[0] == pytest.approx(2.0) and dwelt[-1] == pytest.approx(8.0)
    assert len(dwelt) in (4, 5)


@pytest.mark.parametrize("kind", ["raster", "spiral"])
def test_two_axes(kind):
    size = ("--lines", 8) if kind == "raster" else ("--duration", 2)
    written = shape(kind, *WORDS, *size)
    assert [name.split("_")[0] for name in written] == ["time", "x", "y"]
    for moved in list(written.values())[1:]:
        assert 1.5 <= moved.min() and moved.max() <= 8.5
    assert np.ptp(written["x_um"]) > 4.0


@pytest.mark.parametrize("kind", ["raster", "triangle", "sine"])
def test_a_loop_goes_on_where_it_ended(kind):
    size = ("--lines", 8) if kind == "raster" else ()
    for moved in list(shape(kind, *WORDS, *size, "--loop").values())[1:]:
        inside = np.abs(np.diff(moved)).max()
        assert abs(moved[0] - moved[-1]) <= 2.0 * inside + 1e-9


def test_the_turns_of_a_raster_are_said():
    words = ("raster", *WORDS, "--lines", 8, *SMALL, "-o", "move.csv")
    assert "turns from" not in done("trajectory", *words).said[-1]
    said = done("trajectory", *words, "--bandwidth", 50).said[-1]
    least, greatest = re.search(r"turns from (\S+) to (\S+);", said).groups()
    moved = table("move.csv")["x_um"]
    assert moved.min() == pytest.approx(float(least), abs=1e-4)
    assert moved.max() == pytest.approx(float(greatest), abs=1e-4)


def test_a_set_of_models_holds_those_of_the_axes():
    words = ("trajectory", "raster", *WORDS, "--lines", 4, "--range")
    both = ("--model", f"{model('set')}::x", "--model", f"{model('set')}::y")
    apart = done(*words, "2:3", *both)
    assert done(*words, "2:3", "--model", model("set")).raw == apart.raw
    more = ("--model", model("small"), *both)
    assert "MODEL::CHANNEL" in refused(2, *words, "2:3", *more)


def test_what_the_model_reaches_is_compensated_as_it_is_and_more_is_refused():
    done("trajectory", "sine", *WORDS, *SMALL, "-o", "move.csv", "-q")
    assert compensated("small", wish="move.csv")["voltage_V"].max() <= 10.0
    words = ("--rate", 1000, "--range", "2:12", "--frequency", 5, *SMALL)
    outcome = dbo("trajectory", "sine", *words)
    assert outcome.code in (1, 2, 3) and "9" in outcome.lines[-1]


# --- waveform ---


def waveform(form, name, *words):
    done("waveform", "drive.csv", "--to", form, *words, "-o", name, "-q")
    return Path(name).read_bytes()


def test_numpy_reads_npy_and_the_gain_is_divided_out():
    waveform("npy", "d.npy")
    np.testing.assert_allclose(np.load("d.npy").ravel(), VOLTS, rtol=1e-12)
    waveform("npy", "d.npy", "--points", 500)
    points = np.load("d.npy").ravel()
    assert len(points) == 500 and points.min() >= 9.9 and points.max() <= 90.1
    words = ("--to", "npy", "--gain", 20, "-o", "d.npy")
    outcome = done("waveform", "drive.csv", *words)
    written = np.load("d.npy").ravel()
    np.testing.assert_allclose(written, VOLTS / 20.0, rtol=1e-12)
    said = re.search(r"([\d.]+) Vpp, offset ([\d.]+) V at gain 20", outcome.err)
    assert float(said[1]) == pytest.approx(np.ptp(written), rel=1e-4)
    middle = 0.5 * (written.max() + written.min())
    assert float(said[2]) == pytest.approx(middle, rel=1e-4)


def test_scipy_reads_wav():
    waveform("wav", "d.wav")
    rate, samples = wavfile.read("d.wav")
    assert rate == 1000 and len(samples) == 1000
    codes = samples.astype(float).ravel()
    ends = [codes.min(), codes.max()], [VOLTS.min(), VOLTS.max()]
    assert np.abs(np.interp(codes, *ends) - VOLTS).max() < 0.01


@pytest.mark.parametrize(
    ("form", "kind", "first", "last"),
    [
        ("int16", "<i2", -32768, 32767),
        ("uint16", "<u2", 0, 65535),
        ("uint16", "<u2", 0, 4095),
    ],
)
def test_codes_of_a_converter(form, kind, first, last):
    """0 to 5 V before an amplifier of 20 are all the codes."""
    words = ("--gain", 20, "--volts", "0:5", "--codes", f"{first}:{last}")
    written = waveform(form, "d.bin", *words)
    assert done("waveform", "drive.csv", "--to", form, *words).raw == written
    codes = np.frombuffer(written, dtype=kind).astype(float)
    assert codes.size == 1000 and codes.max() <= last
    step = 100.0 / (last - first)
    assert np.abs((codes - first) * step - VOLTS).max() <= step


def test_keysight_arb_is_text():
    text = waveform("keysight-arb", "d.arb", "--gain", 20).decode()
    head, body = text.split("Data:\r\n")
    assert head.startswith("File Format:1.10\r\n")
    assert "Sample Rate:1000\r\n" in head and "High Level:4.5\r\n" in head
    codes = [int(line) for line in body.split()]
    assert (len(codes), min(codes), max(codes)) == (1000, -32767, 32767)


def test_pi_gcs_is_text():
    lines = waveform("pi-gcs", "d.txt", "--gain", 20).decode().splitlines()
    assert lines[0].startswith("WAV 1 X PNT 1 10 0.5 ")
    assert lines[1].startswith("WAV 1 & PNT 11 10 ")
    points = [float(word) for line in lines for word in line.split()[6:]]
    np.testing.assert_allclose(points, VOLTS / 20.0, rtol=1e-12)


@pytest.mark.parametrize("limits", ["--v-max 89", "--v-min 11", "--max-slew 900"])
def test_no_file_of_a_drive_beyond_limits(limits):
    words = ("drive.csv", "--to", "npy", *limits.split(), "-o", "d.npy")
    refused(3, "waveform", *words)


def test_codes_that_do_not_reach_or_round_too_far_are_refused():
    words = ("waveform", "drive.csv", "--to", "uint16", "-o", "d.bin")
    error = refused(3, *words, "--gain", 20, "--volts", "0:4")
    assert "--volts" in error and "0.5 to 4.5 V" in error
    coarse = ("--volts", "0:100", "--codes", "0:31")
    refused(3, *words, *coarse, "--max-rounding", 0.1)
    assert "--max-rounding" in refused(3, *words, *coarse)
    done(*words, *coarse, "--max-rounding", 3)
    npy = ("waveform", "drive.csv", "--to", "npy", "-o", "d.npy")
    assert "--points" in refused(3, *npy, "--points", 30)


# --- excite ---


@pytest.mark.parametrize(
    "words",
    [
        "--v-max 100",
        "--v-min -20 --v-max 120 --sample-rate 5000 --max-slew 2000",
        "--v-max 60 --duration 8 --sample-rate 2kHz",
        "--v-max 100 --sample-rate 5000 --sweep-to 500 --sweep-amplitude 2",
    ],
)
def test_an_excitation_keeps_its_limits(words):
    typed = dict(zip(words.split()[::2], words.split()[1::2], strict=True))
    outcome = done("excite", *words.split(), "-o", "drive.csv")
    written = table("drive.csv")
    voltage, time = written["voltage_V"], written["time_s"]
    low, high = float(typed.get("--v-min", 0.0)), float(typed["--v-max"])
    assert voltage.min() >= low and voltage.max() <= high
    assert voltage.min() == pytest.approx(low, abs=0.02 * (high - low))
    assert voltage.max() == pytest.approx(high, abs=0.02 * (high - low))
    rate = 1.0 / np.diff(time)
    np.testing.assert_allclose(rate, rate[0], rtol=1e-6)
    if "--max-slew" in typed:
        slew = np.abs(np.diff(voltage)) * rate
        assert slew.max() <= float(typed["--max-slew"]) * (1.0 + 1e-9)
    if "--duration" in typed:
        assert time[-1] == pytest.approx(8.0, rel=0.1)
    assert outcome.said
    done("check", "drive.csv", "--v-min", low, "--v-max", high, "-o", "c.txt")


def test_an_excitation_has_several_amplitudes_and_levels():
    done("excite", "--v-max", 100, "-o", "drive.csv")
    voltage = table("drive.csv")["voltage_V"]
    slope = np.sign(np.diff(voltage))
    turns = voltage[1:-1][slope[1:] * slope[:-1] < 0.0]
    assert len(np.unique(np.round(turns))) >= 6


def test_other_units_of_drive_and_limits_that_are_too_slow():
    written = table(done("excite", "--v-max", "4bar"))
    name = next(reversed(written))
    assert name.endswith("_bar") and written[name].max() <= 4.0
    words = ("excite", "--v-max", 100, "--max-slew", 1, "--duration", 5)
    assert dbo(*words).code in (2, 3)


@pytest.mark.parametrize("sweep_to", [116.8441693, 33.3333, 77.0])
def test_what_a_refused_sweep_names_does(sweep_to):
    words = ("excite", "--v-min", 0, "--v-max", 10, "--sweep-to", sweep_to)
    error = refused(2, *words, "--sample-rate", 100)
    rate = re.search(r"--sample-rate (\S+) or more", error)[1]
    words = (*words, "--sample-rate", rate, "--max-slew", 7.7)
    crest = re.search(r"; (\S+) fits", refused(3, *words, "--sweep-amplitude", 1))[1]
    done(*words, "--sweep-amplitude", crest)
