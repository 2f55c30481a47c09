"""What is particular to Windows, tried on Linux by refusing what Windows refuses (tests/windows.py)."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from dbo_cli.errors import OutputError
from dbo_cli.logs.sample_block import Column
from dbo_cli.logs.signal_writer import signal_writer
from dbo_cli.logs.whole_output import all_or_none, check_outputs, write_whole
from tests import windows

pytestmark = pytest.mark.skipif(
    sys.platform != "linux", reason="Windows itself runs the other tests"
)


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture(autouse=True)
def pretending(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    windows.pretend(monkeypatch)


def test_the_shim_refuses_what_windows_refuses(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"x")
    with open(path, "rb") as file:
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.fsync(file.fileno())
        with pytest.raises(PermissionError, match="it is in use"):
            os.replace(path, tmp_path / "b")
        with pytest.raises(PermissionError, match="it is in use"):
            os.unlink(path)
    with open(path, "r+b") as file:
        os.fsync(file.fileno())
    for name in ("con.csv", "a:b", "a.", "what?"):
        with pytest.raises(OSError, match="Invalid argument"):
            open(tmp_path / name, "wb")
    with pytest.raises(PermissionError):
        os.open(tmp_path, os.O_RDONLY)
    os.replace(path, tmp_path / "b")


@pytest.mark.parametrize(
    "name", ["out.csv", "out.csv.gz", "out.tsv", "out.h5", "out.h5::/run/1"]
)
def test_every_kind_of_signal_is_written_and_replaced(
    tmp_path: Path, name: str
) -> None:
    for value in (1.0, 2.0):
        with signal_writer(f"{tmp_path}/{name}", [Column("time", "s")]) as writer:
            writer.write(np.full(100_000, value))
    assert os.listdir(tmp_path) == [name.partition("::")[0]]


def test_a_group_is_added_to_a_store(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "store.h5", "w") as file:
        file["mine"] = np.arange(3.0)
    for group in ("a", "b", "a"):
        with signal_writer(
            f"{tmp_path}/store.h5::/{group}", [Column("time", "s")]
        ) as writer:
            writer.write([1.0, 2.0])
    with h5py.File(tmp_path / "store.h5") as file:
        assert sorted(file) == ["a", "b", "mine"]
        assert file["a/time_s"][:].tolist() == [1.0, 2.0]
    assert os.listdir(tmp_path) == ["store.h5"]


def test_a_store_that_is_open_elsewhere_is_left_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "store.h5"
    with signal_writer(f"{path}::/a", [Column("time", "s")]) as writer:
        writer.write([1.0])
    before = path.read_bytes()
    with (
        open(path, "rb"),
        pytest.raises(OutputError, match=r"store\.h5: cannot be written: ") as raised,
    ):
        with signal_writer(f"{path}::/b", [Column("time", "s")]) as writer:
            writer.write([1.0])
    assert "cannot be written: Permission denied" in str(raised.value)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["store.h5"]


def test_several_outputs_appear_together(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_bytes(b"old")
    with all_or_none():
        write_whole(str(tmp_path / "a.json"), b"new")
        write_whole(str(tmp_path / "b.json"), b"new")
    assert content(tmp_path) == {"a.json": b"new", "b.json": b"new"}


def test_an_output_that_another_program_has_open(tmp_path: Path) -> None:
    """A spreadsheet keeps its file open: one line, the old file and the other outputs as they were."""
    (tmp_path / "a.json").write_bytes(b"old")
    (tmp_path / "b.json").write_bytes(b"old")
    with (
        open(tmp_path / "b.json", "rb"),
        pytest.raises(OutputError) as raised,
        all_or_none(),
    ):
        write_whole(str(tmp_path / "a.json"), b"new")
        write_whole(str(tmp_path / "b.json"), b"new")
    assert (
        str(raised.value) == f"{tmp_path}/b.json: cannot be written: Permission denied"
    )
    assert content(tmp_path) == {"a.json": b"old", "b.json": b"old"}


@pytest.mark.parametrize(
    "name",
    [
        "CON",
        "con.csv",
        "Prn.h5",
        "AUX.json",
        "com1",
        "LPT9.txt",
        "nul.csv",
        "a.csv.",
        "a ",
        "run:1.csv",
    ],
)
def test_a_name_that_windows_gives_to_no_file(tmp_path: Path, name: str) -> None:
    with pytest.raises(OutputError) as raised:
        check_outputs([f"{tmp_path}/{name}"])
    assert (
        str(raised.value)
        == f"{tmp_path}/{name}: Windows has no file of this name: give another one"
    )


@pytest.mark.parametrize(
    "name",
    ["console.csv", "com.csv", "com10.csv", "null", "a.b.csv", "x con.csv", "COM1.d/x"],
)
def test_a_name_that_only_looks_like_it(tmp_path: Path, name: str) -> None:
    (tmp_path / "COM1.d").mkdir()
    check_outputs([f"{tmp_path}/{name}"])


@pytest.mark.parametrize("output", ["out.csv", "out.h5", "out.h5::/run"])
def test_commands_write_their_files(
    dbo: Any, tmp_path: Path, model_file: Path, output: str
) -> None:
    (tmp_path / "drive.csv").write_text(
        "time_s,voltage_V\n" + "".join(f"{k},{k % 11}\n" for k in range(30))
    )
    done = dbo(
        "simulate", model_file, "drive.csv", "-o", output, "--save-state", "state.json"
    )
    assert done == (0, "", "")
    done = dbo(
        "compensate",
        model_file,
        f"{output}",
        "--displacement",
        "displacement_um",
        "-o",
        "back.csv",
    )
    assert done.code == 0
    assert dbo("invert", model_file, "-o", "inverse.json") == (0, "", "")
    assert json.loads((tmp_path / "inverse.json").read_text())["direction"] == "inverse"
    assert (
        dbo(
            "simulate", model_file, "drive.csv", "--state", "state.json", "-o", output
        ).code
        == 0
    )
    assert [name for name in os.listdir(tmp_path) if name.endswith(".partial")] == []


def test_where_there_are_no_links_the_rename_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file system without hard links (FAT, some network drives)."""

    def link(source: str, target: str) -> None:
        raise OSError(1, "Operation not permitted")

    monkeypatch.setattr(os, "link", link)
    for value in (1.0, 2.0):
        with signal_writer(f"{tmp_path}/new.h5", [Column("time", "s")]) as writer:
            writer.write([value])
    assert os.listdir(tmp_path) == ["new.h5"]
