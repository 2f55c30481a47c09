"""HDF5 files that others use: nobody's data are lost, whoever writes at the same time."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from dbo_cli.errors import OutputError, UsageError
from dbo_cli.logs.hdf5 import store
from dbo_cli.logs.sample_block import Column
from dbo_cli.logs.signal_writer import signal_writer

posix = pytest.mark.skipif(os.name != "posix", reason="needs POSIX locks")

RECORDER = """
import sys, h5py
with h5py.File(sys.argv[1], "a", locking={locking}) as file:
    data = file.create_dataset("record", shape=(0,), maxshape=(None,), chunks=(512,), dtype="f8")
    file.flush()
    print("recording", flush=True)
    for number in range(4_000):
        data.resize((number + 1,))
        data[number] = number
        if number % 500 == 0:
            file.flush()
        if number == 2_000:
            file.flush()
            print("half", flush=True)
            sys.stdin.readline()
"""

APPENDERS = """
import os, signal, sys, numpy
from dbo_cli.errors import OutputError
from dbo_cli.logs.hdf5 import store
from dbo_cli.logs.sample_block import Column
from dbo_cli.logs.signal_writer import signal_writer
store._PATIENCE = store._QUEUE = 1e9  # on a busy machine another may hold the lock for long
ready, go = os.pipe()
running = []
for number in range(12):
    running.append(os.fork())
    if running[-1] == 0:
        signal.alarm(600)  # who waits for ever is ended, and the test fails
        os.close(go)
        os.read(ready, 1)  # until all are there
        with signal_writer(f"{sys.argv[1]}::/run{number}", [Column("time", "s")]) as writer:
            writer.write(numpy.full(1000, float(number)))
        sys.exit(0)
os.close(go)
sys.exit(any([os.waitpid(one, 0)[1] for one in running]))
"""


@pytest.fixture(autouse=True)
def hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dbo_cli.logs.hdf5.store._PATIENCE", 0.1)


def write(address: str, value: float = 1.0) -> None:
    with signal_writer(address, [Column("time", "s")]) as writer:
        writer.write(np.full(4, value))


def process(script: str, *words: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", script, *words],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).resolve().parent.parent)},
    )


@posix
@pytest.mark.parametrize("address", ["store.h5::/added", "store.h5"])
@pytest.mark.parametrize("locking", ["True", "False"])
def test_a_recorder_loses_no_row(tmp_path: Path, address: str, locking: str) -> None:
    """Locked or (HDF5_USE_FILE_LOCKING=FALSE, usual on network drives) not, the open file is not replaced."""
    if locking == "False" and sys.platform != "linux":
        pytest.skip("only Linux tells who has a file open")
    path = tmp_path / "store.h5"
    recorder = process(RECORDER.format(locking=locking), str(path))
    assert recorder.stdout is not None
    assert [recorder.stdout.readline() for _ in range(2)] == ["recording\n", "half\n"]
    with pytest.raises(OutputError) as raised:
        write(str(tmp_path / address))
    assert str(raised.value) == (
        f"{path}: the file is open in another program: close it there, or write to another file"
    )
    recorder.communicate("\n", timeout=60)
    assert recorder.returncode == 0
    with h5py.File(path) as file:
        assert file["record"][:].tolist() == list(range(4_000))
    assert os.listdir(tmp_path) == ["store.h5"]


@posix
@pytest.mark.parametrize("existing", [True, False])
def test_twelve_appenders_at_once_all_find_their_group(
    tmp_path: Path, existing: bool
) -> None:
    path = tmp_path / "store.h5"
    if existing:
        write(f"{path}::/first")
    appenders = process(APPENDERS, str(path))
    assert appenders.communicate() == ("", "")
    assert appenders.returncode == 0
    with h5py.File(path) as file:
        assert [file[f"run{number}/time_s"][0] for number in range(12)] == list(
            range(12)
        )
        assert len(file) == 12 + existing
    assert os.listdir(tmp_path) == ["store.h5"]


def test_a_file_marked_as_open_is_not_touched(tmp_path: Path) -> None:
    """A writer in SWMR mode holds no lock, but the file says that it is being written."""
    path = tmp_path / "store.h5"
    with h5py.File(path, "w", libver="latest") as file:
        data = file.create_dataset("record", shape=(0,), maxshape=(None,), dtype="f8")
        file.swmr_mode = True
        data.resize((5,))
        with pytest.raises(OutputError, match="the file is open in another program"):
            write(f"{path}::/added")
    write(f"{path}::/added")


@pytest.mark.parametrize(
    ("place", "said"),
    [
        (
            "",
            "::/ holds 'run1' and 1 more, which this output did not write and would be lost",
        ),
        (
            "::/",
            "::/ holds 'run1' and 1 more, which this output did not write and would be lost",
        ),
        (
            "::/run1",
            "::/run1 holds 'mine', which this output did not write and would be lost",
        ),
        ("::/voltage", "::/voltage is a dataset, not a group"),
        ("::/voltage/new", "::/voltage is a dataset, not a group"),
        (
            "::/.",
            "::/ holds 'run1' and 1 more, which this output did not write and would be lost",
        ),
    ],
)
def test_what_others_wrote_is_not_replaced(
    tmp_path: Path, place: str, said: str
) -> None:
    path = tmp_path / "store.h5"
    with h5py.File(path, "w") as file:
        file["run1/mine"] = np.arange(3.0)
        file["voltage"] = np.arange(3.0)
    before = path.read_bytes()
    with pytest.raises(OutputError) as raised:
        write(f"{path}{place}")
    assert str(raised.value).startswith(
        f"{path}{said}: name a group of its own ({path}::/NAME)"
    )
    assert path.read_bytes() == before


def test_links_are_not_followed(tmp_path: Path) -> None:
    write(f"{tmp_path}/other.h5::/group")
    path = tmp_path / "store.h5"
    with h5py.File(path, "w") as file:
        file["outside"] = h5py.ExternalLink("other.h5", "/group")
    with pytest.raises(OutputError, match="::/outside is a link to elsewhere"):
        write(f"{path}::/outside")


def test_what_this_program_wrote_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "store.h5"
    with h5py.File(path, "w") as file:
        file["mine"] = np.arange(3.0)
    for value in (1.0, 2.0):
        write(f"{path}::/run/a", value)
        write(f"{path}:://run/./b/", value)
        write(f"{tmp_path}/whole.h5", value)
        with h5py.File(path) as file:
            assert file["run/a/time_s"][0] == file["run/b/time_s"][0] == value
            assert file["mine"][:].tolist() == [0.0, 1.0, 2.0]
    with pytest.raises(OutputError, match="::/run holds 'a' and 1 more"):
        write(f"{path}::/run")


def test_a_group_that_goes_up_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"'\.\.' is no group of an HDF5 file"):
        write(f"{tmp_path}/store.h5::/a/../b")


def test_columns_of_one_name_and_with_slashes(tmp_path: Path) -> None:
    columns = [
        Column("time", "s"),
        Column("time", "s"),
        Column("rate (V/s)"),
        Column("."),
    ]
    with signal_writer(f"{tmp_path}/out.h5", columns) as writer:
        writer.write([1.0], [2.0], [3.0], [4.0])
    with h5py.File(tmp_path / "out.h5") as file:
        assert {name: file[name][0] for name in file} == {
            "time_s": 1.0, "time_s_2": 2.0, "rate (V_s)": 3.0, "column_4": 4.0,
        }  # fmt: skip


@posix
@pytest.mark.parametrize("mode", [0o604, 0o640, 0o666])
def test_a_store_keeps_its_permissions(tmp_path: Path, mode: int) -> None:
    path = tmp_path / "store.h5"
    with h5py.File(path, "w") as file:
        file["mine"] = np.arange(3.0)
    path.chmod(mode)
    write(f"{path}::/added")
    assert path.stat().st_mode & 0o777 == mode


@posix
@pytest.mark.parametrize("turn", [1, -1])
def test_who_waits_asks_all_writers_beside_a_store(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, turn: int
) -> None:
    """One that was killed does not hide one that lives, in whichever order the folder lists them."""
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    alive = process("import sys; sys.stdin.read()")
    names = [f".store.h5.{one.pid}-01234567.partial" for one in (gone, alive)][::turn]
    monkeypatch.setattr(os, "listdir", lambda folder: names)
    assert store._is_being_added_to(str(tmp_path / "store.h5"))
    alive.communicate("")
    assert not store._is_being_added_to(str(tmp_path / "store.h5"))
    assert not store._is_being_added_to(str(tmp_path / "other.h5"))
