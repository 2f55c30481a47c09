# ruff: noqa: E501  (a message of one line stands on one line here)
"""identify through the command line: models, messages, provenance and refusals."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import folder_content
from virtual_actuator import PRESETS, VirtualActuator

ROOT = Path(__file__).resolve().parent.parent
SAMPLE = ROOT / "sample_data" / "identification.csv"
QUICK = ["--gears", "32", "--points", "2", "--relaxation", "0", "--delay", "0"]


def write_log(name: str, voltage: Any, displacement: Any, rate: float = 100.0) -> Path:
    """Write a log with the usual header."""
    rows = zip(
        np.asarray(voltage, float).tolist(),
        np.asarray(displacement, float).tolist(),
        strict=True,
    )
    lines = [f"{k / rate!r},{v!r},{y!r}" for k, (v, y) in enumerate(rows)]
    path = Path(name)
    path.write_text("time_s,voltage_V,displacement_um\n" + "\n".join(lines) + "\n")
    return path


def cycles(count: int = 4, samples: int = 120, top: float = 10.0) -> Any:
    return top * (0.5 - 0.5 * np.cos(2 * np.pi * np.arange(count * samples) / samples))


@pytest.fixture
def small_log(dbo: Any) -> Path:
    """Return a log of 480 rows from the virtual actuator, in the working folder."""
    drive = cycles(top=100.0) * np.repeat([1.0, 1.0, 0.7, 0.4], 120)
    time = np.arange(len(drive)) / 100.0
    return write_log(
        "log.csv", drive, VirtualActuator(PRESETS["stack"]).play(time, drive, 7)
    )


def test_model_with_its_origin(dbo: Any, small_log: Path) -> None:
    done = dbo("identify", "log.csv", *QUICK, "-o", "model.json", "--quiet")
    assert done == (0, "", "")
    model = json.loads(Path("model.json").read_text())
    assert model["direction"] == "forward"
    assert (model["input"]["quantity"], model["input"]["unit"]) == ("voltage", "V")
    assert (model["output"]["quantity"], model["output"]["unit"]) == (
        "displacement",
        "um",
    )
    assert model["fit"]["rmse"] < 0.1
    assert model["provenance"]["program"] == "dbo 0.2.0"
    assert model["provenance"]["arguments"] == ["identify", "log.csv", *QUICK]
    [origin] = model["provenance"]["inputs"]
    assert (origin["name"], origin["rows"], len(origin["sha256"])) == (
        "log.csv",
        480,
        64,
    )


def test_what_was_wanted_is_no_measurement(dbo: Any, small_log: Path) -> None:
    lines = small_log.read_text().splitlines()
    Path("drive.csv").write_text(
        "\n".join(["time_s,voltage_V,desired_um", *lines[1:]]) + "\n"
    )
    refused = dbo("identify", "drive.csv", *QUICK, "-o", "model.json")
    assert refused.code == 1
    assert refused.err == (
        "dbo: error: drive.csv: no column is recognised as the displacement: 'desired_um' is what was wanted, not what "
        "was measured (play the drive and record the sensor beside it): it has 1 time_s, 2 voltage_V, 3 desired_um "
        "(choose with --displacement NAME or NUMBER)\n"
    )
    named = dbo(
        "identify",
        "drive.csv",
        *QUICK,
        "--displacement",
        "desired_um",
        "-o",
        "model.json",
    )
    assert named.code == 0
    assert (
        "warning: drive.csv: column 'desired_um' is what was wanted, by its name, not what was measured"
        in named.err
    )


def test_a_model_is_no_log(dbo: Any, small_log: Path) -> None:
    assert dbo("identify", "log.csv", *QUICK, "-o", "model.json", "-q").code == 0
    for words in (("identify", "model.json"), ("report", "model.json", "log.csv")):
        said = "dbo: error: model.json: this is a model, not a log (give a recording; a report takes a model as --model)\n"
        assert dbo(*words) == (1, "", said)


def test_the_same_log_and_options_give_the_same_bytes(
    dbo: Any, small_log: Path, tmp_path: Path
) -> None:
    dbo("identify", "log.csv", *QUICK, "-o", "a.json")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "log.csv").write_bytes(small_log.read_bytes())
    dbo(
        "identify",
        "elsewhere/log.csv",
        *QUICK,
        "--output",
        "b.json",
        "--quiet",
        "--verbose",
    )
    assert Path("a.json").read_bytes() == Path("b.json").read_bytes()


def test_the_model_predicts_the_log_with_its_level(dbo: Any, small_log: Path) -> None:
    """Not only changes: the displacement itself, offset included."""
    dbo("identify", "log.csv", *QUICK, "-o", "model.json", "-q")
    done = dbo("report", "log.csv", "--model", "model.json", "--format", "json")
    [log] = json.loads(done.out)["logs"]
    assert abs(log["mean"]) < 0.05
    assert log["rmse"] < 0.15


def test_what_was_found_is_said(dbo: Any, small_log: Path) -> None:
    done = dbo("identify", "log.csv", *QUICK, "-o", "model.json")
    assert (done.code, done.out) == (0, "")
    assert all(line.startswith("dbo: ") for line in done.err.splitlines())
    found = [
        line.removeprefix("dbo: ")
        for line in done.err.splitlines()
        if "warning: " not in line
    ]
    begins = ["expected on new moves inside the range: "]
    begins += ["in parts: ", "loop ", "lag ", "dbo show model.json says more; "]
    assert [line[: len(one)] for line, one in zip(found, begins, strict=True)] == begins
    assert max(map(len, found)) < 160
    assert "; fit RMSE " in done.err and " V; 32 gears, " in done.err
    assert (
        found[-1]
        == "dbo show model.json says more; dbo compensate model.json TRAJECTORY -o drive.csv uses it"
    )
    shown = " ".join(dbo("show", "model.json").out.split())
    assert " on cycles left out; a straight line leaves " in shown
    assert "expect: RMSE " in shown and " on new moves inside the range, from " in shown
    assert (
        " which the model undoes; growing slopes" in shown
        or " which the model undoes; free slopes" in shown
    )


def test_a_model_goes_to_standard_output(dbo: Any, small_log: Path) -> None:
    done = dbo("identify", "log.csv", *QUICK, "-q")
    assert json.loads(done.out)["format"] == "dbo-model"


def test_validation_says_how_well_another_log_is_predicted(
    dbo: Any, small_log: Path
) -> None:
    done = dbo(
        "identify",
        "log.csv",
        "--rows",
        "1:300",
        *QUICK,
        "--validate",
        "log.csv",
        "-o",
        "model.json",
    )
    assert "log.csv: predicts it to " in done.err
    model = json.loads(Path("model.json").read_text())
    assert model["fit"]["validation_rmse"] < 0.3
    assert [origin["rows"] for origin in model["provenance"]["inputs"]] == [300, 480]


def test_hdf5_gives_the_same_model_as_text(dbo: Any) -> None:
    words = ["--rows", "1:2000", *QUICK, "-q"]
    text = json.loads(dbo("identify", SAMPLE, *words).out)
    same = json.loads(dbo("identify", SAMPLE.with_suffix(".h5"), *words).out)
    assert text["input"] == same["input"]
    ours, theirs = (np.array(model["stages"][0]["dy"]) for model in (text, same))
    assert ours == pytest.approx(theirs, rel=1e-6)


REFUSED = {
    "none.csv": "none.csv: ",
    "empty.csv": "empty.csv: the file is empty",
    "header.csv": "header.csv: no data rows",
    "constant.csv": "constant.csv: the voltage is constant (5): ",
    "short.csv": "short.csv: 3 rows are too few to identify from: ",
    "ramp.csv": "ramp.csv: the voltage never turns back, so the log shows no loop: ",
    "word.csv": "word.csv:3: column 'voltage_V' is not a number: 'high' (--skip-bad drops such rows)",
    "hole.csv": "hole.csv:3: column 'displacement_um' is ",
    "nan.csv": "nan.csv:3: column 'displacement_um' is not finite: 'nan' (--skip-bad drops such rows)",
    "uneven.csv": "uneven.csv:3: ",
    "log.csv --voltage speed": "log.csv: there is no column 'speed': it has 1 time_s, 2 voltage_V, 3 displacement_um",
    "log.csv --voltage 7": "log.csv: there is no column 7: it has 3 columns",
    "log.csv -o none/m.json": "none/m.json: there is no folder 'none': create it first",
    "line.csv": "the model (RMSE ",
}


@pytest.mark.parametrize("line", REFUSED)
def test_refusals_are_one_line_and_leave_nothing(
    dbo: Any, small_log: Path, line: str
) -> None:
    Path("empty.csv").write_text("")
    Path("header.csv").write_text("time_s,voltage_V,displacement_um\n")
    header = "time_s,voltage_V,displacement_um\n0,1,2\n"
    Path("word.csv").write_text(header + "1,high,3\n2,3,4\n")
    Path("hole.csv").write_text(header + "1,2,\n2,3,4\n")
    Path("nan.csv").write_text(header + "1,2,nan\n2,3,4\n")
    Path("uneven.csv").write_text(header + "1,2\n2,3,4\n")
    ramp = np.linspace(0.0, 10.0, 200)
    write_log("constant.csv", np.full(200, 5.0), ramp)
    write_log("short.csv", [0.0, 1.0, 0.0], [0.0, 1.0, 0.1])
    write_log("ramp.csv", ramp, ramp)
    rng = np.random.default_rng(5)
    write_log("line.csv", cycles(), 2.0 * cycles() + rng.normal(0.0, 0.5, 480))
    before = folder_content(Path())
    done = dbo(
        "identify",
        *line.split(),
        *QUICK,
        *([] if "-o" in line else ["-o", "model.json"]),
    )
    assert (done.code, done.out) == (1, "")
    last = done.err.splitlines()[-1]
    assert last.startswith(f"dbo: error: {REFUSED[line]}")
    assert folder_content(Path()) == before


def test_force_keeps_what_would_be_refused(dbo: Any) -> None:
    rng = np.random.default_rng(5)
    write_log("line.csv", cycles(), 2.0 * cycles() + rng.normal(0.0, 0.5, 480))
    done = dbo("identify", "line.csv", *QUICK, "--force", "-o", "model.json")
    assert done.code == 0
    assert "dbo: warning: the model (RMSE " in done.err
    assert Path("model.json").exists()


def test_logs_of_different_units_are_not_mixed(dbo: Any, small_log: Path) -> None:
    text = small_log.read_text()
    Path("angle.csv").write_text(text.replace("displacement_um", "displacement_rad"))
    done = dbo("identify", "log.csv", "angle.csv", *QUICK)
    assert (done.code, done.out) == (1, "")
    assert "column 'displacement_rad' is in rad, but the first log is in um" in done.err


def test_logs_of_one_unit_in_two_sizes_are_brought_to_the_first_ones(
    dbo: Any, small_log: Path
) -> None:
    rows = [line.split(",") for line in small_log.read_text().splitlines()]
    at = rows[0].index("displacement_um")
    for row in rows[1:]:
        row[at] = repr(1000.0 * float(row[at]))
    rows[0][at] = "displacement_nm"
    Path("nano.csv").write_text("\n".join(",".join(row) for row in rows) + "\n")
    done = dbo("identify", "log.csv", "nano.csv", *QUICK, "-o", "two.json")
    assert done.code == 0
    assert "nano.csv: column 'displacement_nm' is converted from nm to um" in done.err
    assert json.loads(Path("two.json").read_text())["output"]["unit"] == "um"


def test_paper_method_takes_its_scale_from_one_cycle(dbo: Any, small_log: Path) -> None:
    done = dbo(
        "identify",
        "log.csv",
        "--rows",
        "1:120",
        "--method",
        "paper",
        "--zero",
        "mean",
        "-q",
    )
    assert (done.code, done.err) == (0, "")
    model = json.loads(done.out)
    table = np.loadtxt("log.csv", delimiter=",", skiprows=1)[:120]
    scale = next(stage for stage in model["stages"] if stage["type"] == "scale")
    gears = next(stage for stage in model["stages"] if stage["type"] == "backlash")
    assert scale["gain"] == pytest.approx(
        np.ptp(table[:, 2]) / np.ptp(table[:, 1]), rel=1e-12
    )
    assert scale["offset"] == pytest.approx(
        table[:, 2].min() - table[:, 2].mean(), rel=1e-12
    )
    assert (gears["x0"], len(gears["dx"])) == (table[:, 1].min(), 25)


def test_the_sign_is_the_first_thing_said_and_kept(
    whole_dbo: Any, small_log: Path
) -> None:
    _, voltage, displacement = np.loadtxt(small_log, delimiter=",", skiprows=1).T
    write_log("turned.csv", voltage, -displacement)
    for name, sign, verb in (
        ("log", "rising", "rises"),
        ("turned", "falling", "falls"),
    ):
        done = whole_dbo(
            "identify",
            f"{name}.csv",
            *QUICK,
            "--sign",
            sign,
            "-o",
            "m.json",
            "--summary",
            "s.json",
        )
        assert done.code == 0
        first = done.err.splitlines()[0]
        assert first.startswith(f"dbo: {name}.csv: 480 rows, ")
        assert first.endswith(f"; displacement {verb} as voltage rises")
        model = json.loads(Path("m.json").read_text())
        assert next(iter(model["fit"].items())) == ("sign", sign)
        assert model["provenance"]["arguments"][-2:] == ["--sign", sign]
        summary = json.loads(Path("s.json").read_text())
        assert (summary["format"], summary["version"], summary["sign"]) == (
            "dbo-summary",
            1,
            sign,
        )
        assert summary["command"].startswith(f"dbo identify {name}.csv")
        assert [one["file"] for one in summary["read"]] == [f"{name}.csv"]
        assert (
            summary["range"]
            == [model["input"]["min"], model["input"]["max"]]
            == [0.0, 100.0]
        )
        assert summary["expected_rmse"] == model["fit"]["expected_rmse"]
        shown = whole_dbo("show", "m.json").out.splitlines()
        assert shown[0].startswith("forward model: voltage 0 to 100 V to displacement ")
        assert shown[1] == f"displacement {verb} as voltage rises"
        assert (
            json.loads(whole_dbo("show", "m.json", "--format", "json").out)["sign"]
            == sign
        )


def test_the_other_sign_is_refused_before_anything_is_written(
    dbo: Any, small_log: Path
) -> None:
    before = folder_content(Path())
    done = dbo(
        "identify",
        "log.csv",
        *QUICK,
        "--sign",
        "falling",
        "-o",
        "m.json",
        "--summary",
        "s.json",
    )
    assert done.code == 3
    assert done.err == (
        "dbo: error: log.csv: displacement rises as voltage rises, and --sign is falling: check the actuator's leads and the sensor's sign (--scale displacement=-1 turns it)\n"
    )
    assert folder_content(Path()) == before
    done = dbo("identify", "log.csv", "--sign", "up", "-o", "m.json")
    assert done.code == 2 and "--sign" in done.err


@pytest.mark.parametrize("words", [("--skip-bad",), ("--rows", "4:"), ()])
def test_rows_are_named_as_the_file_counts_them(
    dbo: Any, small_log: Path, words: tuple[str, ...]
) -> None:
    """Where rows before them were dropped or not read, too."""
    header, *lines = small_log.read_text().splitlines()
    lines[300] = lines[300].rpartition(",")[0] + ",99"
    if words:
        lines[:3] = [line.rpartition(",")[0] + ",nan" for line in lines[:3]]
    Path("spike.csv").write_text("\n".join([header, *lines]) + "\n")
    done = dbo("identify", "spike.csv", *QUICK, *words, "-o", "m.json")
    assert done.code == 0, done.err
    assert (
        "1 outlying rows left out (spikes of the displacement; first at row 301)"
        in done.err
    )


def test_columns_whose_units_are_swapped_are_refused(dbo: Any, small_log: Path) -> None:
    swapped = ("--voltage", "displacement_um", "--displacement", "voltage_V")
    before = folder_content(Path())
    done = dbo("identify", "log.csv", *QUICK, *swapped, "-o", "m.json")
    assert done.code == 1
    assert done.err == (
        "dbo: error: log.csv: the drive is in um and the displacement in V: --voltage and --displacement seem "
        "to be swapped (--force takes them as they are)\n"
    )
    assert folder_content(Path()) == before
    assert (
        dbo("identify", "log.csv", *QUICK, *swapped, "--force", "-o", "m.json").code
        == 0
    )
    model = json.loads(Path("m.json").read_text())
    assert (model["input"]["unit"], model["output"]["unit"]) == ("um", "V")


def test_a_batch_of_logs_has_one_summary_whatever_happens(
    dbo: Any, small_log: Path
) -> None:
    """Of each log what was found, or why nothing was; and a log whose sign is not that of the others."""
    _, voltage, displacement = np.loadtxt(small_log, delimiter=",", skiprows=1).T
    write_log("turned.csv", voltage, -displacement)
    lines = small_log.read_text().splitlines()
    lines[100] = lines[100].rpartition(",")[0] + ",OVLD"
    Path("spoiled.csv").write_text("\n".join(lines) + "\n")
    logs = ("log.csv", "spoiled.csv", "turned.csv")
    done = dbo(
        "identify",
        *logs,
        *QUICK,
        "--keep-going",
        "-o",
        "{file}.json",
        "--summary",
        "all.json",
    )
    assert done.code == 1
    assert done.err.endswith(
        "dbo: error: 1 of 3 files failed (spoiled.csv): the others are written\n"
    )
    assert (
        "dbo: warning: displacement rises as voltage rises, but falls in file turned.csv: "
        "are leads exchanged, or does a sensor face away?\n"
    ) in done.err
    good, spoiled, turned = json.loads(Path("all.json").read_text())
    assert [one["file"] for one in (good, spoiled, turned)] == list(logs)
    assert spoiled["failed"].startswith(
        "spoiled.csv:101: column 'displacement_um' is not a number: 'OVLD' ("
    )
    assert "sign" not in spoiled
    assert (good["failed"], good["sign"], good["rows"]) == (None, "rising", 480)
    assert (turned["failed"], turned["sign"]) == (None, "falling")
    model = json.loads(Path("log.json").read_text())
    gain = (model["output"]["max"] - model["output"]["min"]) / 100.0
    assert good["gain"] == pytest.approx(gain, rel=1e-12)
    assert turned["gain"] == pytest.approx(-gain, rel=0.01)


def test_a_summary_of_each_file_has_its_own_name(dbo: Any, small_log: Path) -> None:
    Path("other.csv").write_bytes(small_log.read_bytes())
    words = (
        "identify",
        "log.csv",
        "other.csv",
        *QUICK,
        "-o",
        "{file}.json",
        "--summary",
    )
    assert dbo(*words, "s_{file}.json").code == 0
    for name in ("log", "other"):
        [read] = json.loads(Path(f"s_{name}.json").read_text())["read"]
        assert read["file"] == f"{name}.csv"
