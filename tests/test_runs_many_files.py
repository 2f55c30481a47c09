# ruff: noqa: E501  (a message of one line stands on one line here)
"""Many files in one command: each as if it had been run alone, those that fail named at the end."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import SMALL_MODEL, folder_content

QUICK = ("--gears", 4, "--points", 0, "--relaxation", 0, "--delay", 0, "--dynamics", 0)


@pytest.fixture
def folder(dbo: Any) -> Any:
    """Return ``dbo`` in a folder with a model and three drives, one of them in HDF5."""
    import h5py

    Path("model.json").write_text(json.dumps(SMALL_MODEL))
    Path("logs").mkdir()
    for name, top in (("a", 10.0), ("b", 6.0)):
        Path(f"logs/{name}.csv").write_text(
            f"time_s,voltage_V\n0,0\n0.1,{top}\n0.2,3\n"
        )
    with h5py.File("logs/c.h5", "w") as file:
        file["run/time_s"], file["run/voltage_V"] = [0.0, 0.1, 0.2], [0.0, 8.0, 2.0]
    return dbo


def test_each_file_is_what_it_would_be_alone(folder: Any) -> None:
    logs = ["logs/a.csv", "logs/b.csv", "logs/c.h5::/run"]
    said = folder(
        "simulate",
        "model.json",
        *logs,
        "-q",
        "--save-state",
        "out/{file}.state.json",
        "-o",
        "out/{file}.csv",
    )
    assert (said.code, said.err) == (0, "")
    assert folder_content(Path("out")) == {
        f"{name}{end}"
        for name in ("a", "b", "c_run")
        for end in (".csv", ".state.json")
    }
    for log, name in zip(logs, ("a", "b", "c_run"), strict=True):
        folder(
            "simulate",
            "model.json",
            log,
            "-q",
            "--save-state",
            "one.json",
            "-o",
            "one.csv",
        )
        assert Path("one.csv").read_bytes() == Path(f"out/{name}.csv").read_bytes()
        assert (
            Path("one.json").read_bytes() == Path(f"out/{name}.state.json").read_bytes()
        )


def test_a_packed_log_gives_its_name_without_both_endings(folder: Any) -> None:
    Path("logs/d.csv.gz").write_bytes(gzip.compress(Path("logs/a.csv").read_bytes()))
    words = ("simulate", "model.json", "logs/b.csv", "logs/d.csv.gz", "-q")
    assert (
        folder(*words, "--summary", "out/{file}.json", "-o", "out/{file}.csv.gz").code
        == 0
    )
    assert folder_content(Path("out")) == {"b.csv.gz", "d.csv.gz", "b.json", "d.json"}
    alone = folder("simulate", "model.json", "logs/a.csv", "-q")
    assert gzip.decompress(Path("out/d.csv.gz").read_bytes()).decode() == alone.out


def test_comments_are_written_by_every_process(folder: Any) -> None:
    words = (
        "simulate",
        "model.json",
        "logs/a.csv",
        "logs/b.csv",
        "--header",
        "comment",
        "-q",
    )
    assert folder(*words, "-j", 2, "-o", "out/{file}.csv").code == 0
    first = [Path(f"out/{name}.csv").read_text().partition("\n")[0] for name in "ab"]
    assert first[0] == first[1]
    assert first[0].endswith(
        "; command: dbo simulate model.json logs/a.csv logs/b.csv --header comment -q -j 2 -o 'out/{file}.csv'"
    )


def test_processes_change_no_byte(folder: Any) -> None:
    words = (
        "compensate",
        "model.json",
        "logs/a.csv",
        "logs/b.csv",
        "--displacement",
        "voltage_V",
        "--scale",
        "displacement=0.5um/V",
        "--on-limit",
        "clip",
        "-q",
        "-o",
    )
    assert (
        folder(*words, "one/{file}.csv").code
        == folder(*words, "two/{file}.csv", "-j", 2).code
        == 0
    )
    assert folder_content(Path("one")) == {"a.csv", "b.csv"}
    for name in ("a.csv", "b.csv"):
        assert Path(f"one/{name}").read_bytes() == Path(f"two/{name}").read_bytes()


def test_files_that_fail_are_named_and_the_others_kept(folder: Any) -> None:
    Path("logs/b.csv").write_text("time_s,voltage_V\n0,0\n0.1,OVLD\n")
    said = folder(
        "simulate",
        "model.json",
        "logs/a.csv",
        "logs/b.csv",
        "logs/none.csv",
        "-o",
        "out/{file}.csv",
    )
    assert said.code == 1
    assert said.err == (
        "dbo: warning: logs/b.csv:3: column 'voltage_V' is not a number: 'OVLD' (--skip-bad drops such rows)\n"
        "dbo: warning: logs/none.csv: no such file\n"
        "dbo: error: 2 of 3 files failed (logs/b.csv, logs/none.csv): the others are written\n"
    )
    assert folder_content(Path("out")) == {"a.csv"}


def test_messages_of_many_files_are_summed_up(folder: Any) -> None:
    for name in ("a", "b"):
        Path(f"logs/{name}.csv").write_text("time_s,voltage_V\n0,0\n0.1,12\n0.2,3\n")
    said = folder(
        "simulate", "model.json", "logs/a.csv", "logs/b.csv", "-o", "out/{file}.csv"
    )
    assert said.err == (
        "dbo: warning: all 2 files: logs/a.csv: 1 of 3 samples (row 2) outside the range of the model (voltage 0 to 10 V): extended with the last slope (file logs/a.csv's)\n"
    )


def test_identify_makes_a_model_of_each_log(folder: Any) -> None:
    up = np.linspace(0.0, 10.0, 50)
    volts = np.concatenate([up, up[::-1]] * 3)
    rng = np.random.default_rng(2)
    for name, gain in (("x", 1.0), ("y", 1.3)):
        moved = gain * (volts + 0.6 * np.sin(0.3 * volts)) + 0.01 * rng.normal(
            size=volts.size
        )
        rows = (
            f"{0.01 * k!r},{v!r},{d!r}"
            for k, (v, d) in enumerate(zip(volts.tolist(), moved.tolist(), strict=True))
        )
        Path(f"logs/{name}.csv").write_text(
            "\n".join(["time_s,voltage_V,displacement_um", *rows]) + "\n"
        )
    said = folder(
        "identify",
        "logs/x.csv",
        "logs/y.csv",
        *QUICK,
        "--force",
        "-o",
        "models/{file}.json",
    )
    assert said.code == 0, said.err
    assert "fit, RMSE of the model's range: " in said.err
    folder("identify", "logs/y.csv", *QUICK, "--force", "-q", "-o", "one.json")
    assert Path("one.json").read_bytes() == Path("models/y.json").read_bytes()
    together = folder(
        "identify", "logs/x.csv", "logs/y.csv", *QUICK, "--force", "-o", "both.json"
    )
    assert (
        "different actuators, loads or temperatures? identify each by itself (--output 'models/{file}.json' does)\n"
        in together.err
    )


def test_files_and_channels_together(folder: Any) -> None:
    for name in ("a", "b"):
        Path(f"logs/{name}.csv").write_text("time_s,V1,V2\n0,0,1\n0.1,5,6\n0.2,3,2\n")
    said = folder(
        "simulate",
        "model.json",
        "logs/a.csv",
        "logs/b.csv",
        "--input",
        "V{}",
        "-o",
        "out/{file}.csv",
    )
    assert (said.code, said.err) == (
        2,
        "dbo: error: 2 logs, and a pattern of columns of one: give one log\n",
    )


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (("logs/a.csv", "logs/b.csv"), 2, "2 logs and one output, -: put {file} into its name (-o 'out/{file}.csv')"),
        (("logs/a.csv", "logs/b.csv", "-o", "out.csv"), 2, "2 logs and one output, out.csv: put {file} into its name (-o 'out/{file}.csv')"),
        (("logs/a.csv", "a.csv", "-o", "out/{file}.csv"), 2, "logs/a.csv and a.csv would both be written to out/a.csv: rename one, or run them apart"),
        (("logs/a.csv", "logs/b.csv", "-o", "logs/{file}.csv"), 2, "logs/a.csv: this output is also an input: write to another file"),
        (("logs/a.csv", "logs/b.csv", "-o", "{file}.csv", "--save-state", "s.json"), 2, "--save-state s.json: each log has its own (put {file} into its name)"),
        (("logs/a.csv", "logs/b.csv", "-o", "{file}.csv", "--flush"), 2, "--flush follows one log row by row: give one"),
    ],
)  # fmt: skip
def test_what_is_refused(
    folder: Any, words: tuple[str, ...], code: int, message: str
) -> None:
    before = folder_content(Path())
    said = folder("simulate", "model.json", *words)
    assert (said.code, said.err) == (code, f"dbo: error: {message}\n")
    assert folder_content(Path()) - {"out"} == before - {"out"}
