# ruff: noqa: E501  (a message of one line stands on one line here)
"""Drives as generators' files: each read back by the library that owns it, or byte for byte."""

from __future__ import annotations

import dataclasses
import json
import re
import struct
from pathlib import Path
from typing import Any

import nptdms
import numpy as np
import pytest
import scipy.io.wavfile
from conftest import ROOT
from virtual_actuator import PRESETS, VirtualActuator

from dbo_cli.drives.gate import GateError
from dbo_cli.errors import OutputError
from dbo_cli.extras.moves import waveform as waveform_files
from dbo_cli.extras.moves.command import GENERATOR_FILES
from dbo_cli.extras.moves.generators import FORMATS, Coding, Signals, at_points, written

TIME = np.arange(200) / 1000.0
DRIVE = 50.0 + 40.0 * np.sin(2.0 * np.pi * 5.0 * TIME)


def write(name: str, *columns: Any, header: str = "time_s,voltage_V") -> None:
    rows = "".join(
        ",".join(map(repr, map(float, row))) + "\n"
        for row in zip(*columns, strict=True)
    )
    Path(name).write_text(header + "\n" + rows)


@pytest.fixture
def bench(dbo: Any) -> Any:
    write("drive.csv", TIME, DRIVE)
    write("small.csv", np.arange(4) / 100.0, [0.0, 1.0, 3.0, 4.0])
    return dbo


def ok(done: Any) -> str:
    assert done.code == 0, done.err
    return str(done.err)


def test_the_help_names_the_formats_that_there_are() -> None:
    assert tuple(FORMATS) == GENERATOR_FILES


# --- read by the libraries that own the formats ---


def test_numpy_reads_npy(bench: Any) -> None:
    ok(bench("waveform", "drive.csv", "--to", "npy", "--gain", 20, "-o", "drive.npy"))
    assert np.array_equal(np.load("drive.npy"), DRIVE / 20.0)
    ok(bench("waveform", "drive.csv", "drive.csv", "--to", "npy", "-o", "two.npy"))
    assert np.array_equal(np.load("two.npy"), [DRIVE, DRIVE])


def test_scipy_reads_wav(bench: Any) -> None:
    write("other.csv", TIME, 0.5 * DRIVE)
    ok(
        bench(
            "waveform",
            "drive.csv",
            "other.csv",
            "--to",
            "wav",
            "--volts",
            "0:100",
            "-o",
            "drive.wav",
        )
    )
    rate, frames = scipy.io.wavfile.read("drive.wav")
    assert rate == 1000 and frames.dtype == np.int16 and frames.shape == (200, 2)
    volts = (frames.T + 32767.0) / 65534.0 * 100.0
    assert np.abs(volts - [DRIVE, 0.5 * DRIVE]).max() <= 0.5 * 100.0 / 65534.0 * (
        1.0 + 1e-9
    )


def test_nptdms_reads_tdms(bench: Any) -> None:
    ok(bench("waveform", "drive.csv", "--to", "tdms", "-o", "drive.tdms"))
    channel = nptdms.TdmsFile.read("drive.tdms")["drive"]["voltage"]
    assert np.array_equal(channel[:], DRIVE)
    assert np.array_equal(
        channel.time_track(), np.arange(200) * channel.properties["wf_increment"]
    )
    assert channel.properties["wf_increment"] == pytest.approx(1e-3, rel=1e-12)
    first = Path("drive.tdms").read_bytes()
    ok(bench("waveform", "drive.csv", "--to", "tdms", "-o", "drive.tdms"))
    assert Path("drive.tdms").read_bytes() == first


# --- byte for byte against the descriptions that docs/instruments-out.md names ---

BYTES = {
    "keysight-arb": (
        b"File Format:1.10\r\nChannel Count:1\r\nColumn Char:TAB\r\nSample Rate:100\r\nHigh Level:2\r\nLow Level:0\r\n"
        b'Data Type:"Short"\r\nFilter:"OFF"\r\nData Points:4\r\nData:\r\n-32767\r\n-16383\r\n16383\r\n32767\r\n'
    ),
    "tektronix-tfw": (
        b"TEKAFG3000" + bytes(6) + struct.pack(">3I", 20050114, 4, 0) + bytes(484)
        + struct.pack(">4H", 0, 4096, 12286, 16382)
    ),
    "rigol-raf": struct.pack("<4H", 0, 4096, 12287, 16383),
    "pi-gcs": b"WAV 1 X PNT 1 4 0 0.5 1.5 2\n",
}  # fmt: skip


@pytest.mark.parametrize("form", BYTES)
def test_files_of_generators_byte_for_byte(bench: Any, form: str) -> None:
    name = "small" + FORMATS[form].endings[0]
    ok(bench("waveform", "small.csv", "--to", form, "--gain", 2, "-o", name))
    assert Path(name).read_bytes() == BYTES[form]


def test_codes_of_a_converter(bench: Any) -> None:
    ok(
        bench(
            "waveform",
            "small.csv",
            "--to",
            "uint16",
            "--codes",
            "0:4095",
            "--volts",
            "0:4",
            "-o",
            "s.bin",
        )
    )
    assert Path("s.bin").read_bytes() == struct.pack("<4H", 0, 1024, 3071, 4095)
    ok(
        bench(
            "waveform", "small.csv", "--to", "int16", "--volts", "-10:10", "-o", "s.i16"
        )
    )
    assert np.fromfile("s.i16", "<i2").tolist() == [0, 3276, 9830, 13106]


def test_picoscope_and_long_wave_tables(bench: Any) -> None:
    write("ten.csv", np.arange(11) / 100.0, np.arange(11.0))
    ok(bench("waveform", "ten.csv", "--to", "picoscope", "-o", "ten.txt"))
    lines = Path("ten.txt").read_text().splitlines()
    assert (
        lines[0] == "-1"
        and lines[-1] == "1"
        and np.allclose([*map(float, lines)], np.linspace(-1.0, 1.0, 11))
    )
    ok(bench("waveform", "ten.csv", "ten.csv", "--to", "pi-gcs", "-o", "t.gcs"))
    assert Path("t.gcs").read_text().splitlines() == [
        "WAV 1 X PNT 1 10 0 1 2 3 4 5 6 7 8 9", "WAV 1 & PNT 11 1 10",
        "WAV 2 X PNT 1 10 0 1 2 3 4 5 6 7 8 9", "WAV 2 & PNT 11 1 10",
    ]  # fmt: skip


def test_channels_come_from_files_or_from_columns_of_one(bench: Any) -> None:
    write("xy.csv", TIME, DRIVE, 0.5 * DRIVE, header="time_s,voltage_x_V,voltage_y_V")
    columns = ["--voltage", "voltage_x_V", "--voltage", "voltage_y_V"]
    said = ok(bench("waveform", "xy.csv", *columns, "--to", "npy", "-o", "xy.npy"))
    assert np.array_equal(np.load("xy.npy"), [DRIVE, 0.5 * DRIVE])
    assert [line[:28] for line in said.splitlines()] == [
        "dbo: xy.csv, voltage_x_V: 20",
        "dbo: xy.csv, voltage_y_V: 20",
    ]
    ok(
        bench(
            "waveform",
            "xy.csv",
            "drive.csv",
            "--voltage",
            "voltage_y_V",
            "--voltage",
            2,
            "--to",
            "npy",
            "-o",
            "xy.npy",
        )
    )
    assert np.array_equal(np.load("xy.npy"), [0.5 * DRIVE, DRIVE])
    done = bench(
        "waveform",
        "xy.csv",
        "drive.csv",
        "xy.csv",
        *columns,
        "--to",
        "npy",
        "-o",
        "no.npy",
    )
    assert (done.code, done.err) == (
        2, "dbo: error: --voltage: 2 columns of 3 files (one for each, or one for all)\n"
    )  # fmt: skip
    done = bench("waveform", "xy.csv", "--to", "npy", "-o", "no.npy")
    assert "which column is the voltage, 'voltage_x_V' or 'voltage_y_V'?" in done.err


# --- what is said, and what is held ---


def test_one_line_says_what_to_set(bench: Any) -> None:
    words = [
        "waveform",
        "drive.csv",
        "--to",
        "tektronix-tfw",
        "--gain",
        20,
        "--loop",
        "--points",
        4096,
    ]
    assert ok(bench(*words, "-o", "d.tfw")) == (
        "dbo: drive.csv: 4,096 points at 20480 a second, 0.2 s, repeated at 5 Hz; amplitude 4 Vpp, offset 2.5 V before "
        "a gain of 20; rounding moves it by at most 0.000122 V, another rate 0.000481 V of the drive; 0 to 16382 mean "
        "0.5 to 4.5 V\n"
    )
    assert ok(bench("waveform", "drive.csv", "--to", "npy", "-o", "d.npy")) == (
        "dbo: drive.csv: 200 points at 1000 a second, 0.2 s, played once; amplitude 80 Vpp, offset 50 V; rounding moves "
        "it by at most 0 V\n"
    )


def test_codes_next_to_a_limit_stay_inside_it() -> None:
    coding = Coding((0, 10), (0.0, 1.0))
    assert coding.encode(np.array([0.06, 0.94]), (0.06, 0.94)).tolist() == [1, 9]
    assert coding.encode(np.array([0.06, 0.94]), (-1.0, 2.0)).tolist() == [1, 9]
    assert coding.encode(np.array([0.16, 0.84]), (0.16, 0.84)).tolist() == [2, 8]
    assert coding.encode(np.array([0.14, 0.86]), (0.14, 0.86)).tolist() == [2, 8]


@pytest.mark.parametrize("gain", [20.0, -20.0, 3.3])
def test_what_was_written_passes_the_gate_at_the_very_limits(
    bench: Any, gain: float
) -> None:
    low, high = float(DRIVE.min()), float(DRIVE.max())
    fastest = float(np.abs(np.diff(DRIVE)).max()) * 1000.0
    limits = [
        "--v-min",
        repr(low),
        "--v-max",
        repr(high),
        "--max-slew",
        repr(fastest * (1.0 + 1e-9)),
    ]
    volts = "0:30" if gain > 0 else "-30:0"
    for form, more in (
        ("rigol-raf", []),
        ("uint16", ["--volts", volts, "--codes", "0:1023"]),
        ("npy", []),
    ):
        name = "d" + FORMATS[form].endings[0]
        ok(
            bench(
                "waveform",
                "drive.csv",
                "--to",
                form,
                "--gain",
                gain,
                *limits,
                *more,
                "-o",
                name,
            )
        )


def test_a_file_that_reads_back_as_something_else_is_not_written(
    bench: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    right = FORMATS["rigol-raf"]
    wrong = dataclasses.replace(right, read=lambda data: right.read(data) + 1)
    monkeypatch.setitem(FORMATS, "rigol-raf", wrong)
    with pytest.raises(
        OutputError, match="the rigol-raf file would not read back as it was written"
    ):
        written("rigol-raf", Signals(np.array([[0, 1]]), 1.0, (0.0, 1.0)))
    monkeypatch.setattr(
        waveform_files, "_rounded", lambda volts, *_: (volts, volts + 51.0, 0.0)
    )
    words = ["--to", "npy", "--v-max", 100, "--max-rounding", 100, "-o", "d.npy"]
    done = bench("waveform", "drive.csv", *words)
    assert done.code == GateError.exit_code and not Path("d.npy").exists()
    assert "this program computed a drive that breaks its limits" in done.err


def test_another_number_of_points_keeps_the_ends_or_the_period() -> None:
    once = at_points(DRIVE[None], 1000.0, 399, None, False)
    assert (
        once.rate == pytest.approx(2000.0)
        and np.array_equal(once.volts[0, ::2], DRIVE)
        and once.moved == 0.0
    )
    assert np.allclose(once.volts[0, 1::2], 0.5 * (DRIVE[:-1] + DRIVE[1:]))
    loop = at_points(DRIVE[None], 1000.0, 100, None, True)
    assert loop.rate == pytest.approx(500.0) and np.allclose(loop.volts[0], DRIVE[::2])
    moved = np.abs(np.append(loop.volts[0], DRIVE[0])[[0, 1]].mean() - DRIVE[1])
    assert 0.0 < moved <= loop.moved == pytest.approx(0.0197, abs=1e-4)
    held = at_points(DRIVE[None], 1000.0, 256, 1000.0, False)
    assert held.held == 56 and np.array_equal(
        held.volts[0], np.append(DRIVE, np.full(56, DRIVE[-1]))
    )
    same = at_points(DRIVE[None], 1000.0, 200, None, True)
    assert same.volts.base is DRIVE or np.array_equal(same.volts[0], DRIVE)


ODD = TIME + 0.0003 * (np.arange(200) % 3)
GAP = TIME + np.where(np.arange(200) > 50, 0.01, 0.0)


@pytest.mark.parametrize(
    ("line", "code", "message"),
    [
        ("gap.csv --to npy -o o.npy", 3, "gap.csv: row 52: a gap in time (--rows A:B plays a part, --resample HZ goes straight through)"),
        ("odd.csv --to npy -o o.npy", 1, "odd.csv: the samples are not evenly spaced in time, and a generator plays even steps (--resample HZ interpolates)"),
        ("bad.csv --to npy -o o.npy", 1, "bad.csv:5: column 'voltage_V' is not a number: 'OVLD' (--skip-bad drops such rows)"),
        ("notime.csv --to npy -o o.npy", 1, "notime.csv: no time column and no sample rate, and a generator plays even steps (--time COLUMN or --sample-rate HZ)"),
        ("drive.csv --rows 1:50 --to npy --loop -o o.npy", 3, "drive.csv: from the last row, 89.9803 V, to the first, 50 V, is a step of 40 V where the largest inside is 1.26 V: the loop does not close (compensate's --periodic makes one that does; without --loop it is played once)"),
        ("drive.csv --to int16 -o o.bin", 2, "--volts LOW:HIGH: say what the lowest and the highest code of int16 mean"),
        ("drive.csv --to int16 --volts -10:10 -o o.bin", 3, "drive.csv: the drive takes 10 to 90 V of the generator, and --volts gives -10 to 10 (wider --volts, or the amplifier's --gain, which is 1)"),
        ("drive.csv --to npy --gain 0 -o o.npy", 2, "--gain 0: an amplifier of no gain moves nothing (give its volts out per volt in)"),
        ("drive.csv --to npy --codes 0:10 -o o.npy", 2, "--codes: npy files hold volts, no codes"),
        ("drive.csv --to tdms --volts 0:10 -o o.tdms", 2, "--volts: tdms files hold volts, no codes"),
        ("drive.csv --to uint16 --volts 0:100 --codes -5:10 -o o.bin", 2, "--codes -5:10: give whole numbers from 0 to 65535"),
        ("drive.csv --to keysight-arb -o o.csv", 2, "o.csv: a keysight-arb file is called *.arb"),
        ("drive.csv --to keysight-arb --points 32 -o o.arb", 3, "drive.csv: 32 points move the drive by up to 0.205 V, more than 0.08 V (more --points, a higher --rate, or --tolerance VOLT)"),
        ("drive.csv --to keysight-arb --rate 10000 --points 1000 -o o.arb", 2, "--points 1,000: the drive takes 1,991 at 10000 a second (leave --rate out, or at most 5020.1)"),
        ("drive.csv --to keysight-arb --loop --rate 10000 --points 4000 -o o.arb", 2, "--rate 10000: the loop of 0.2 s is 2000 points (a --rate of 20000 makes 4,000)"),
        ("drive.csv --to keysight-arb --loop --rate 10001 -o o.arb", 2, "--rate 10001: the loop of 0.2 s is 2000.2 points (a --rate of 10000 makes 2,000)"),
        ("drive.csv drive.csv --to rigol-raf -o o.raf", 2, "a rigol-raf file holds one drive, not 2 (one file each)"),
        ("drive.csv small.csv --to npy -o o.npy", 1, "small.csv: has other rows or another rate than drive.csv: play them apart"),
        ("drive.csv --to wav --rate 2000.5 -o o.wav", 2, "a WAV file has whole points a second, not 2000.5 (--rate 2001)"),
        ("drive.csv --to picoscope --points 9000 -o o.txt", 2, "a picoscope file takes 10 to 8,192 points, not 9,000 (--points 8192)"),
        ("flat.csv --to rigol-raf -o o.raf", 2, "--volts LOW:HIGH: the drive is constant, so say what the codes mean"),
        ("drive.csv --to rigol-raf --v-max 89 -o o.raf", 3, "drive.csv: row 44: 89.0366705 V is outside -inf to 89 V (15 rows in all)"),
        ("drive.csv --to rigol-raf --max-slew 1000 -o o.raf", 3, "drive.csv: row 2: from 50 to 51.2564304 V in one row is faster than 1000 V per second (83 rows in all)"),
        ("drive.csv --to matlab -o o.mat", 2, "--to: 'matlab' is none of npy, wav, int16, uint16, tdms, pi-gcs, keysight-arb, tektronix-tfw, rigol-raf, picoscope"),
        ("drive.csv -o o.npy", 2, "--to is missing (dbo waveform --help lists what there is)"),
    ],
)  # fmt: skip
def test_what_would_play_something_else_is_refused(
    bench: Any, line: str, code: int, message: str
) -> None:
    write("gap.csv", GAP, DRIVE)
    write("odd.csv", ODD, DRIVE)
    write("flat.csv", TIME, np.full(200, 5.0))
    write("notime.csv", DRIVE, header="voltage_V")
    Path("bad.csv").write_text("time_s,voltage_V\n0,1\n0.1,2\n0.2,3\n0.3,OVLD\n")
    before = set(Path().iterdir())
    done = bench("waveform", *line.split())
    assert (done.code, done.out) == (code, "")
    assert done.err.startswith(f"dbo: error: {message}"), done.err
    assert done.err.count("\n") == 1 and set(Path().iterdir()) == before


# --- on the virtual bench ---


@pytest.fixture(scope="module")
def model() -> Any:
    import dbo_cli as dbo_api

    return dbo_api.identify(str(ROOT / "sample_data" / "identification.csv"))


def test_what_codes_of_16_14_and_12_bits_cost_in_displacement(model: Any) -> None:
    import dbo_cli as dbo_api

    scan = dbo_api.trajectory(
        "raster",
        rate=2000.0,
        range=(2.0, 10.0),
        lines=4,
        frequency=4.0,
        bandwidth=40.0,
        model=model,
    )
    drive = model.compensate(
        scan["x"].to_numpy(), time=scan["time"].to_numpy(), details=True
    ).values
    bench = VirtualActuator(PRESETS["stack"])
    exact = bench.displacement(scan["time"], drive)
    page = (ROOT / "docs" / "instruments-out.md").read_text(encoding="utf-8")
    for bits in (16, 14, 12):
        coding = Coding((0, 2**bits - 1), (0.0, 100.0))
        played = coding.decode(coding.encode(drive, (0.0, 100.0)))
        away = 1e3 * (bench.displacement(scan["time"], played) - exact)
        rms, most = float(np.sqrt(np.mean(away**2))), float(np.abs(away).max())
        assert (
            f"| {bits} | {coding.step * 1e3:.2g} mV | {rms:#.2g} nm | {most:#.2g} nm |"
            in page
        )


def played(name: str, amplitude: float = 1.0) -> tuple[float, Any]:
    """Return points a second and the volts that a generator makes of a .arb file, as its description says."""
    head, _, body = Path(name).read_text().partition("Data:\n")
    values = dict(line.split(":") for line in head.splitlines())
    low, high = float(values["Low Level"]), float(values["High Level"])
    codes = np.array(body.split(), dtype=float)
    assert codes.size == int(values["Data Points"])
    return float(values["Sample Rate"]), amplitude * (
        0.5 * (low + high) + codes / 32767.0 * 0.5 * (high - low)
    )


def test_the_circle_from_a_trajectory_to_the_report_closes(
    dbo: Any, model: Any
) -> None:
    model.save("model.json")
    scan = [
        "--rate",
        2000,
        "--range",
        "3:9",
        "--lines",
        4,
        "--frequency",
        2,
        "--bandwidth",
        20,
        "--rest",
        0.1,
    ]
    ok(dbo("trajectory", "raster", *scan, "--model", "model.json", "-o", "scan.csv"))
    limits = ["--v-min", 0, "--v-max", 100, "--max-slew", 2000]
    way = [
        "--displacement",
        "x_um",
        "--from",
        0,
        "--approach",
        "auto",
        "--return",
        "auto",
    ]
    ok(dbo("compensate", "model.json", "scan.csv", *way, *limits, "-o", "drive.csv"))
    ok(
        dbo(
            "waveform",
            "drive.csv",
            "--to",
            "keysight-arb",
            "--gain",
            20,
            "--points",
            16384,
            *limits,
            "-o",
            "d.arb",
        )
    )

    rate, volts = played("d.arb")
    time = np.arange(volts.size) / rate
    early = int(0.0137 * rate)  # the recording begins before the drive
    monitor = np.concatenate([np.full(early, volts[0]), volts])
    noisy = monitor + np.random.default_rng(3).normal(0.0, 2e-4, monitor.size)
    write(
        "played.csv", np.arange(monitor.size) / rate, noisy, header="time_s,monitor_V"
    )
    done = dbo("check", "played.csv", "--against", "drive.csv", "--gain", 20)
    assert done.code == 0, done.err + done.out
    assert re.search(
        rf"played: 16,38\d rows, {early} later \(13\.6\d ms\), gain 1, offset .*e-05 V, largest",
        done.out,
    )
    assert "V, at another rate, times the amplifier's 20" in done.out
    first = np.loadtxt("drive.csv", delimiter=",", skiprows=1, usecols=0)[0]
    measured = VirtualActuator(PRESETS["stack"]).play(time, 20.0 * volts, seed=4)
    write("tracked.csv", time + first, measured, header="time_s,sensor_um")
    done = dbo(
        "report", "tracked.csv", "--trajectory", "drive.csv", "--max-nrmse-percent", 0.6
    )
    assert done.code == 0, done.err + done.out

    _, wrong = played("d.arb", amplitude=1.05)  # typed wrong at the generator
    write("wrong.csv", time, wrong, header="time_s,monitor_V")
    done = dbo("check", "wrong.csv", "--against", "drive.csv", "--gain", 20)
    assert (
        done.code == 3
        and "before the amplifier an amplitude of 105 % and an offset of" in done.err
    ), done.err


def test_a_summary_of_each_drive(bench: Any) -> None:
    words = (
        "--to",
        "int16",
        "--volts",
        "0:5",
        "--gain",
        20,
        "-o",
        "two.bin",
        "--summary",
        "two.json",
    )
    ok(bench("waveform", "drive.csv", *words))
    done = json.loads(Path("two.json").read_text())
    back = np.fromfile("two.bin", "<i2")
    assert (done["format"], done["rows"], done["clipped"]) == (
        "dbo-summary",
        len(DRIVE),
        0,
    )
    assert done["read"][0]["file"] == "drive.csv" and done["read"][0]["rows"] == len(
        DRIVE
    )
    assert done["range"] == pytest.approx(
        [DRIVE.min() / 20.0, DRIVE.max() / 20.0], abs=5.0 / 65535
    )
    assert done["largest_step"] == pytest.approx(
        np.abs(np.diff(back.astype(float))).max() * 5.0 / 65535
    )
    assert any("amplitude" in note for note in done["notes"])
    assert bench("waveform", "drive.csv", *words[:-1], "drive.csv").code == 2
    ok(
        bench(
            "trajectory",
            "raster",
            "--rate",
            1000,
            "--range",
            "0:5",
            "--frequency",
            5,
            "--lines",
            4,
            "--unit",
            "um",
            "-o",
            "r.csv",
            "--summary",
            "r.json",
        )
    )
    table = np.loadtxt("r.csv", delimiter=",", skiprows=1)
    both = json.loads(Path("r.json").read_text())
    assert [one["range"] for one in both] == [
        [column.min(), column.max()] for column in table[:, 1:].T
    ]
    assert {one["rows"] for one in both} == {len(table)}


# --- what would not be the drive any more ---


def test_rounding_that_takes_the_move_away_is_refused(bench: Any) -> None:
    words = ["--to", "uint16", "--codes", "0:10", "--volts", "0:100", "-o", "d.bin"]
    done = bench("waveform", "drive.csv", *words)
    assert (done.code, Path("d.bin").exists()) == (3, False)
    assert done.err == (
        "dbo: error: drive.csv: rounding moves it by up to 4.99 V, 6.23 % of its 80 V and more than 1 % "
        "(narrower --volts, a wider span of --codes, or --max-rounding PERCENT)\n"
    )
    assert bench("waveform", "drive.csv", *words, "--max-rounding", 6.2).code == 3
    ok(bench("waveform", "drive.csv", *words, "--max-rounding", 6.3))
    assert set(np.fromfile("d.bin", "<u2")) == set(range(1, 10))
    write("constant.csv", TIME, np.full(200, 3.0))  # no move that could be rounded away
    ok(bench("waveform", "constant.csv", *words))


def test_each_of_several_drives_has_to_outlast_its_rounding(bench: Any) -> None:
    write("other.csv", TIME, 50.0 + 0.0005 * (DRIVE - 50.0))
    done = bench("waveform", "drive.csv", "other.csv", "--to", "wav", "-o", "d.wav")
    assert done.code == 3 and done.err.startswith(
        "dbo: error: other.csv: rounding moves it by up to 0.0006"
    )


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        ("--to npy --gain 1e-320", 2, "--gain 9.99989e-321: the drive over it is beyond the range of the arithmetic"),
        ("--to npy --rate 1e308", 2, "--rate 1e+308: a drive of 0.199 s becomes more than 1,000,000,000 points"),
        ("--to npy --points 10000000000", 2, "--points 10,000,000,000: a drive of 0.199 s becomes more than 1,000,000,000 points"),
        ("--to uint16 --volts -1e308:1e308", 2, "--volts -1e+308:1e+308: the span is beyond the range of the arithmetic"),
    ],
)  # fmt: skip
def test_figures_beyond_the_arithmetic_are_refused(
    bench: Any, words: str, code: int, message: str
) -> None:
    done = bench(
        "waveform",
        "drive.csv",
        *words.split(),
        "-o",
        f"d.{'bin' if '16' in words else 'npy'}",
    )
    assert (done.code, done.err) == (code, f"dbo: error: {message}\n")
