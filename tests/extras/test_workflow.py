"""The batch workflows make everything, then nothing, then only what changed."""

from __future__ import annotations

import csv
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

WORKFLOW = Path(__file__).resolve().parents[2] / "workflow"
MAKE, SNAKEMAKE = shutil.which("make"), shutil.which("snakemake")
DBO = f"{sys.executable} -m dbo_cli"
NAMES = ("left", "right", "spare")
OPTIONS = "--gears 8 --points 0 --delay 0 --relaxation 0"
KINDS = ("model.json", "drive.csv", "drive.json", "report.json", "report.csv")


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    """A folder with three small logs of different forms and a trajectory."""
    from dbo_cli.logs.sample_block import Column
    from dbo_cli.logs.signal_writer import signal_writer

    (tmp_path / "logs").mkdir()
    seconds = np.arange(600) / 100
    drive = 5.0 - 5.0 * np.cos(2 * np.pi * seconds)
    for name, ending, gain in zip(
        NAMES, (".csv", ".h5", ".csv.gz"), (1.0, 1.2, 0.8), strict=True
    ):
        columns = [
            Column("time", "s"),
            Column("voltage", "V"),
            Column("displacement", "um"),
        ]
        with signal_writer(str(tmp_path / "logs" / (name + ending)), columns) as writer:
            displacement = gain * (
                drive
                + 0.02 * drive**2
                + 0.3 * np.sign(np.gradient(drive)) * np.sqrt(drive * (10 - drive))
            )
            writer.write(seconds, drive, displacement)
    with signal_writer(
        str(tmp_path / "trajectory.csv"),
        [Column("time", "s"), Column("displacement", "um")],
    ) as out:
        out.write(seconds, 2.0 + np.sin(seconds))
    return tmp_path


def by_make(folder: Path, read: str = "", code: int = 0, flag: str = "-j2") -> str:
    words = [
        str(MAKE),
        "-f",
        str(WORKFLOW / "Makefile"),
        flag,
        f"PYTHON={sys.executable}",
    ]
    return finished(
        [*words, f"DBO={DBO}", f"READ={read}", f"IDENTIFY={OPTIONS}"], folder, code
    )


def by_make_that_goes_on(folder: Path, read: str = "", code: int = 0) -> str:
    return by_make(folder, read, code, flag="-kj2")


def by_snakemake(folder: Path, read: str = "", code: int = 0) -> str:
    settings = [f"dbo={DBO}", f"read={read}", f"identify={OPTIONS}"]
    words = [
        str(SNAKEMAKE),
        "-s",
        str(WORKFLOW / "Snakefile"),
        "--cores",
        "2",
        "--rerun-triggers",
        "mtime",
    ]
    return finished([*words, "--config", *settings], folder, 1 if code else 0)


def finished(words: list[str], folder: Path, code: int = 0) -> str:
    environment = os.environ | {"PYTHONPATH": str(WORKFLOW.parent), "MAKEFLAGS": ""}
    done = subprocess.run(
        words, cwd=folder, env=environment, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == code, done.stderr
    return done.stdout + done.stderr


needs_make = pytest.mark.skipif(MAKE is None, reason="make is not here")
needs_snakemake = pytest.mark.skipif(SNAKEMAKE is None, reason="Snakemake is not here")


def listed_by_one_command(folder: Path) -> dict[str, dict[str, Any]]:
    """Identify from all logs by one command, of which one fails, and return the list by file."""
    logs = sorted(f"logs/{path.name}" for path in (folder / "logs").iterdir())
    words = [
        *DBO.split(),
        "identify",
        *logs,
        *OPTIONS.split(),
        "--keep-going",
        "-o",
        "models/{file}.json",
    ]
    finished([*words, "--summary", "all.json"], folder, code=1)
    lines = json.loads((folder / "all.json").read_text())
    return {Path(line["file"]).name: line for line in lines}


def made_at(folder: Path) -> dict[str, int]:
    return {
        path.name: path.stat().st_mtime_ns
        for path in (folder / "results").iterdir()
        if path.is_file()
    }


def table_in(folder: Path) -> dict[str, dict[str, str]]:
    with (folder / "results" / "summary.csv").open(newline="") as file:
        return {line["name"]: line for line in csv.DictReader(file)}


@pytest.mark.parametrize(
    "engine",
    [
        pytest.param(by_make, marks=needs_make, id="make"),
        pytest.param(by_snakemake, marks=needs_snakemake, id="snakemake"),
    ],
)
def test_only_what_changed_is_made_again(engine, bench: Path) -> None:  # type: ignore[no-untyped-def]
    engine(bench)
    first = made_at(bench)
    assert set(first) == {f"{name}.{kind}" for name in NAMES for kind in KINDS} | {
        "summary.csv"
    }
    summary = (bench / "results" / "summary.csv").read_text().splitlines()
    assert len(summary) == 1 + len(NAMES)
    assert [line.split(",")[0] for line in summary[1:]] == [
        "left.csv",
        "right.h5",
        "spare.csv.gz",
    ]
    assert summary[0].endswith(",clipped,expected_rmse,expected_percent")
    for name, line in zip(NAMES, summary[1:], strict=True):
        told = json.loads((bench / "results" / f"{name}.drive.json").read_text())
        keys = ("clipped", "expected_rmse", "expected_percent")
        assert line.split(",")[-3:] == [
            "" if told[key] is None else str(told[key]) for key in keys
        ]
        assert told["clipped"] == 0
    for line in table_in(bench).values():
        assert (line["failed"], line["sign"], line["rows"]) == ("", "rising", "600")
    gains = [float(line["gain"]) for line in table_in(bench).values()]
    assert gains == pytest.approx([1.2, 1.44, 0.96], rel=0.01)

    engine(bench)
    assert made_at(bench) == first

    with open(bench / "logs" / "left.csv", "a") as log:
        log.write("6.0,0.0,0.0\n")
    engine(bench)
    changed = {name for name, stamp in made_at(bench).items() if stamp != first[name]}
    assert changed == {f"left.{kind}" for kind in KINDS} | {"summary.csv"}


@pytest.mark.parametrize(
    "engine",
    [
        pytest.param(by_make, marks=needs_make, id="make"),
        pytest.param(by_make_that_goes_on, marks=needs_make, id="make -k"),
        pytest.param(by_snakemake, marks=needs_snakemake, id="snakemake"),
    ],
)
def test_a_batch_ends_in_a_table_whatever_happens(engine, bench: Path) -> None:  # type: ignore[no-untyped-def]
    """A broken file, a swapped sign and a log without a clock: a line for each, and an exit code."""
    good = (bench / "logs" / "left.csv").read_text().splitlines()
    spoiled = [*good[:300], good[300].rpartition(",")[0] + ",OVLD", *good[301:]]
    (bench / "logs" / "spoiled.csv").write_text("\n".join(spoiled) + "\n")
    cells = [line.split(",") for line in good[1:]]
    turned = [f"{time},{volts},{-float(x)!r}" for time, volts, x in cells]
    (bench / "logs" / "turned.csv").write_text("\n".join([good[0], *turned]) + "\n")
    clockless = [line.partition(",")[2] for line in good]
    (bench / "logs" / "clockless.csv").write_text("\n".join(clockless) + "\n")

    said = engine(bench, code=2)
    table = table_in(bench)
    assert list(table) == [
        "clockless.csv", "left.csv", "right.h5", "spare.csv.gz", "spoiled.csv", "turned.csv",
    ]  # fmt: skip
    why = (
        "identify: logs/spoiled.csv:301: column 'displacement_um' is not a number: 'OVLD' "
        "(--skip-bad drops such rows)"
    )
    assert table["spoiled.csv"]["failed"] == why
    for name in ("clockless.csv", "left.csv", "right.h5", "spare.csv.gz"):
        assert table[name]["failed"] == ""
    assert table["spoiled.csv"]["rows"] == ""
    assert not list((bench / "results").glob("spoiled.*"))
    assert table["turned.csv"]["sign"] == "falling"
    assert table["turned.csv"]["failed"].startswith("compensate: trajectory.csv: ")
    assert float(table["turned.csv"]["gain"]) == pytest.approx(-1.2, rel=0.01)
    assert table["clockless.csv"]["rows"] == "600"
    assert "results/summary.csv: 6 logs, 2 failed\n" in said
    by_one_command = listed_by_one_command(bench)
    assert list(by_one_command) == list(table)
    for name, line in table.items():
        one = by_one_command[name]
        if line["failed"].startswith("identify: "):
            assert line["failed"] == f"identify: {one['failed']}"
            continue
        assert one["failed"] is None
        assert (line["sign"], line["rows"]) == (one["sign"], str(one["rows"]))
        assert float(line["gain"]) == one["gain"]
        assert line["model_expected_rmse"] == (
            "" if one["expected_rmse"] is None else str(one["expected_rmse"])
        )
    assert (
        "warning: displacement is rising with the voltage in 4 logs, and falling in turned.csv: "
        "are leads exchanged, or does a sensor face away?\n"
    ) in said

    # What the message names goes into one variable, for identification and report
    # alike.
    (bench / "logs" / "turned.csv").unlink()
    time.sleep(1.1)  # the file system's clock
    os.utime(bench / "logs" / "spoiled.csv")
    engine(bench, read="--skip-bad")
    table = table_in(bench)
    assert (table["spoiled.csv"]["failed"], table["spoiled.csv"]["samples"]) == (
        "",
        "599",
    )


@needs_make
def test_a_log_that_is_spoiled_later_leaves_no_old_model(bench: Path) -> None:
    by_make(bench)
    with open(bench / "logs" / "left.csv", "a") as log:
        log.write("6.0,0.0,OVLD\n")
    by_make(bench, code=2)
    assert table_in(bench)["left.csv"]["failed"].startswith(
        "identify: logs/left.csv:602: "
    )
    assert not list((bench / "results").glob("left.*"))


@needs_make
def test_what_cannot_be_followed_is_refused_or_counted(bench: Path) -> None:
    rows = "".join(f"{k / 100},{2.0 + k / 100}\n" for k in range(1000))
    (bench / "trajectory.csv").write_text("time_s,displacement_um\n" + rows)
    words = [
        str(MAKE),
        "-f",
        str(WORKFLOW / "Makefile"),
        "-k",
        f"DBO={DBO}",
        f"IDENTIFY={OPTIONS}",
    ]
    environment = os.environ | {"PYTHONPATH": str(WORKFLOW.parent), "MAKEFLAGS": ""}
    done = subprocess.run(
        words, cwd=bench, env=environment, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 2
    table = table_in(bench)
    assert [line["failed"].partition(":")[0] for line in table.values()] == [
        "compensate",
        "",
        "compensate",
    ]
    assert (
        "dbo: error: trajectory.csv: " in done.stderr
        and "(--on-limit clip goes on)" in done.stderr
    )
    assert not (bench / "results" / "spare.drive.csv").exists()
    finished([*words, "COMPENSATE=--on-limit clip"], bench)
    lines = (bench / "results" / "summary.csv").read_text().splitlines()
    clipped = [int(line.split(",")[-3]) for line in lines[1:]]
    assert clipped[1] == 0 < clipped[0] < clipped[2]


def small_log(folder: Path, name: str) -> None:
    (folder / "logs").mkdir(exist_ok=True)
    seconds = np.arange(600) / 100
    drive = 5.0 - 5.0 * np.cos(2 * np.pi * seconds)
    bent = drive + 0.3 * np.sign(np.gradient(drive)) * np.sqrt(drive * (10 - drive))
    rows = zip(seconds.tolist(), drive.tolist(), bent.tolist(), strict=True)
    text = "".join(f"{t},{v},{x}\n" for t, v, x in rows)
    (folder / "logs" / name).write_text("time_s,voltage_V,displacement_um\n" + text)


@pytest.mark.skipif(MAKE is None or os.name != "posix", reason="make is not here")
def test_file_names_are_not_shell(tmp_path: Path) -> None:
    names = ["x&touch>PWNED&y", "-v,~^{µ}+@"]
    for name in names:
        small_log(tmp_path, f"{name}.csv")
    (tmp_path / "trajectory.csv").write_text(
        "time_s,displacement_um\n0,1\n0.01,2\n0.02,1.5\n"
    )
    by_make(tmp_path)
    assert sorted(os.listdir(tmp_path)) == ["logs", "results", "trajectory.csv"]
    results = {path.name for path in (tmp_path / "results").iterdir() if path.is_file()}
    assert results == {f"{name}.{kind}" for name in names for kind in KINDS} | {
        "summary.csv"
    }
    assert len((tmp_path / "results" / "summary.csv").read_text().splitlines()) == 3


@pytest.mark.skipif(MAKE is None or os.name != "posix", reason="make is not here")
@pytest.mark.parametrize("letter", list(" :#$%;|=*?!\\\"'`()[]\t\n"))
def test_names_that_make_cannot_hold_are_refused_in_a_sentence(
    letter: str, tmp_path: Path
) -> None:
    small_log(tmp_path, f"a{letter}b.csv")
    (tmp_path / "trajectory.csv").write_text("time_s,displacement_um\n0,1\n")
    words = [str(MAKE), "-f", str(WORKFLOW / "Makefile"), f"DBO={DBO}"]
    environment = os.environ | {"MAKEFLAGS": ""}
    done = subprocess.run(
        words,
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    shown = "a b.csv" if letter in "\t\n" else f"a{letter}b.csv"
    assert (
        f"logs/{shown}: make cannot hold this name (blanks, quotes and :" in done.stderr
    )
    assert done.returncode == 2
    assert sorted(os.listdir(tmp_path)) == ["logs", "trajectory.csv"]


@pytest.mark.skipif(MAKE is None or os.name != "posix", reason="make is not here")
def test_two_logs_of_one_name_are_refused(tmp_path: Path) -> None:
    for ending in ("csv", "dat"):
        small_log(tmp_path, f"left.{ending}")
    words = [str(MAKE), "-f", str(WORKFLOW / "Makefile"), f"DBO={DBO}"]
    done = subprocess.run(
        words, cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert (
        "two logs in logs/ are called left, and their results would be the same files"
        in done.stderr
    )


@pytest.mark.skipif(MAKE is None or os.name != "posix", reason="make is not here")
def test_two_makes_in_one_folder_both_succeed(bench: Path) -> None:
    """Above all when only the summary is left to make: once, 40 of 40 runs lost it."""
    for other in ("right.h5", "spare.csv.gz"):
        (bench / "logs" / other).unlink()
    by_make(bench)
    summary = bench / "results" / "summary.csv"
    expected = summary.read_text()
    words = [
        str(MAKE),
        "-f",
        str(WORKFLOW / "Makefile"),
        f"DBO={DBO}",
        f"IDENTIFY={OPTIONS}",
    ]
    environment = os.environ | {"PYTHONPATH": str(WORKFLOW.parent), "MAKEFLAGS": ""}
    for _ in range(4):
        summary.unlink()
        both = [
            subprocess.Popen(
                words, cwd=bench, env=environment, stdout=subprocess.DEVNULL
            )
            for _ in range(3)
        ]
        assert [one.wait(120) for one in both] == [0, 0, 0]
        assert summary.read_text() == expected
        assert not list((bench / "results").glob("*.partial"))
