"""Outputs appear whole or not at all, whatever ends the work."""

from __future__ import annotations

import errno
import io
import os
import signal
import subprocess
import sys
import time as clock
from pathlib import Path

import h5py
import numpy as np
import pytest

from dbo_cli.errors import InputError, OutputError, UsageError
from dbo_cli.logs.columns import column_wish, header_of
from dbo_cli.logs.request import import_polars
from dbo_cli.logs.sample_block import Column
from dbo_cli.logs.signal_log import open_log
from dbo_cli.logs.signal_writer import _plain_rows, signal_writer, write_rows
from dbo_cli.logs.whole_output import check_output, reason_of, write_whole

COLUMNS = [Column("time", "s"), Column("voltage", "V")]


def test_an_error_leaves_the_old_file_and_no_litter(tmp_path: Path) -> None:
    for name in ("out.csv", "out.h5", "out.csv.gz"):
        path = tmp_path / name
        path.write_bytes(b"as it was")
        with (
            pytest.raises(RuntimeError, match="half way"),
            signal_writer(str(path), COLUMNS) as writer,
        ):
            writer.write(np.zeros(100_000), np.ones(100_000))
            raise RuntimeError("half way")
        assert path.read_bytes() == b"as it was"
    assert sorted(os.listdir(tmp_path)) == ["out.csv", "out.csv.gz", "out.h5"]


@pytest.mark.parametrize("name", ["out.csv", "out.h5"])
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_signal_leaves_the_old_file_and_no_litter(
    name: str, number: int, tmp_path: Path
) -> None:
    path = tmp_path / name
    path.write_bytes(b"as it was")
    script = (
        "import sys, time, numpy\n"
        "from dbo_cli.cli.app import prepare_process\n"
        "prepare_process()\n"
        "from dbo_cli.logs.sample_block import Column\n"
        "from dbo_cli.logs.signal_writer import signal_writer\n"
        "with signal_writer(sys.argv[1], [Column('voltage', 'V')]) as writer:\n"
        "    writer.write(numpy.zeros(100_000))\n"
        "    print('writing', flush=True)\n"
        "    while True:\n"  # a signal right before one long sleep would be heard after it
        "        time.sleep(0.01)\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", script, str(path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        preexec_fn=lambda: signal.signal(
            number, signal.SIG_DFL
        ),  # heard under nohup, too
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "writing\n"
    process.send_signal(number)
    process.wait(timeout=120.0)
    process.stdout.close()
    assert process.returncode != 0
    assert path.read_bytes() == b"as it was"
    assert os.listdir(tmp_path) == [name]


@pytest.mark.parametrize("name", ["out.csv", "out.h5", "model.json"])
def test_a_full_disk_leaves_the_old_file_and_no_litter(
    name: str, tmp_path: Path
) -> None:
    """A limit on the file size stands for the disk: the very write fails."""
    path = tmp_path / name
    path.write_bytes(b"as it was")
    script = (
        "import resource, sys, numpy\n"
        "from dbo_cli.errors import OutputError\n"
        "from dbo_cli.logs.whole_output import write_whole\n"
        "from dbo_cli.logs.sample_block import Column\n"
        "from dbo_cli.logs.signal_writer import signal_writer\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))\n"
        "try:\n"
        "    if sys.argv[1].endswith('.json'):\n"
        "        write_whole(sys.argv[1], bytes(1_000_000))\n"
        "    else:\n"
        "        with signal_writer(sys.argv[1], [Column('voltage', 'V')]) as writer:\n"
        "            for _ in range(4):\n"
        "                writer.write(numpy.random.default_rng(1).normal(size=100_000))\n"
        "except OutputError as problem:\n"
        "    print(problem)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, str(path)],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.stdout == f"{path}: cannot be written: File too large\n", done.stderr
    assert path.read_bytes() == b"as it was"
    assert os.listdir(tmp_path) == [name]


@pytest.mark.skipif(
    not os.path.exists("/dev/full"), reason="there is no /dev/full here"
)
def test_a_full_device_is_told() -> None:
    with pytest.raises(OutputError) as raised:
        write_whole("/dev/full", b"x" * 100_000)
    assert str(raised.value) == "/dev/full: the disk is full: nothing was written"


def test_reasons() -> None:
    assert (
        reason_of(OSError(errno.ENOSPC, "No space left on device"))
        == "the disk is full: nothing was written"
    )
    assert reason_of(
        OSError(
            "Can't write data (errno = 28, error message = 'No space left on device')"
        )
    ) == ("the disk is full: nothing was written")
    assert (
        reason_of(OSError("No space left on device (os error 28)"))
        == "the disk is full: nothing was written"
    )
    assert (
        reason_of(OSError(errno.EACCES, "Permission denied"))
        == "cannot be written: Permission denied"
    )


def test_a_missing_folder_is_told_before_the_work(tmp_path: Path) -> None:
    path = tmp_path / "nowhere" / "out.csv"
    with pytest.raises(OutputError) as raised:
        check_output(str(path))
    assert (
        str(raised.value)
        == f"{path}: there is no folder '{tmp_path}/nowhere': create it first"
    )


def test_a_folder_is_no_output(tmp_path: Path) -> None:
    with pytest.raises(OutputError) as raised:
        check_output(str(tmp_path))
    assert str(raised.value) == f"{tmp_path}: this is a folder: give a file name"


@pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write everywhere"
)
def test_a_folder_without_permission_is_told(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(OutputError) as raised:
        check_output(str(tmp_path / "out.csv"))
    tmp_path.chmod(0o700)
    assert str(raised.value) == f"{tmp_path}/out.csv: the folder is not writable"


def test_an_input_is_never_an_output(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    log.write_text("voltage\n1\n")
    (tmp_path / "other.csv").symlink_to(log)
    os.link(log, tmp_path / "hard.csv")
    for name in ("log.csv", "other.csv", "hard.csv"):
        path = tmp_path / name
        with (
            pytest.raises(UsageError) as raised,
            signal_writer(str(path), COLUMNS, protect=[str(log)]),
        ):
            pass
        assert (
            str(raised.value)
            == f"{path}: this output is also an input: write to another file"
        )
    with pytest.raises(UsageError), replacing_of(f"{log}::/group", str(log)):
        pass
    assert log.read_text() == "voltage\n1\n"


def replacing_of(address: str, protect: str):  # type: ignore[no-untyped-def]
    return signal_writer(address, COLUMNS, format="hdf5", protect=[protect])


def test_standard_input_is_protected_too(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    log.write_text("voltage\n1\n")
    load = "import sys; from dbo_cli.logs.whole_output import check_output"
    script = f"{load}; check_output(sys.argv[1], ['-'])"
    with open(log) as stdin:
        done = subprocess.run(
            [sys.executable, "-c", script, str(log)],
            stdin=stdin,
            capture_output=True,
            text=True,
            timeout=60,
        )
    assert "this output is also an input" in done.stderr


def test_a_symbolic_link_keeps_pointing(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    link = tmp_path / "out.csv"
    link.symlink_to(tmp_path / "real" / "out.csv")
    write_whole(str(link), b"new")
    assert link.is_symlink()
    assert (tmp_path / "real" / "out.csv").read_bytes() == b"new"


def test_permissions_are_kept_and_made_by_the_umask(tmp_path: Path) -> None:
    old = tmp_path / "old.json"
    old.write_bytes(b"")
    old.chmod(0o640)
    write_whole(str(old), b"{}")
    assert old.stat().st_mode & 0o777 == 0o640
    before = os.umask(0o027)
    try:
        write_whole(str(tmp_path / "new.json"), b"{}")
    finally:
        os.umask(before)
    assert (tmp_path / "new.json").stat().st_mode & 0o777 == 0o640


def test_several_writers_in_one_folder_do_not_disturb_each_other(
    tmp_path: Path,
) -> None:
    path = str(tmp_path / "out.csv")
    with (
        signal_writer(path, [Column("a")]) as one,
        signal_writer(path, [Column("b")]) as other,
    ):
        one.write(np.array([1.0]))
        other.write(np.array([2.0]))
    assert Path(path).read_text() == "a\n1.0\n"  # the one that ended last, whole
    assert os.listdir(tmp_path) == ["out.csv"]


def test_a_device_is_written_directly(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = subprocess.Popen(["cat", str(pipe)], stdout=subprocess.PIPE)
    write_whole(str(pipe), b"through")
    assert reader.communicate(timeout=30)[0] == b"through"
    assert os.listdir(tmp_path) == ["pipe"]


def test_a_pipe_closed_early_stays_a_broken_pipe() -> None:
    script = (
        "import numpy\n"
        "from dbo_cli.logs.sample_block import Column\n"
        "from dbo_cli.logs.signal_writer import signal_writer\n"
        "import os, sys\n"
        "try:\n"
        "    with signal_writer('-', [Column('voltage', 'V')]) as writer:\n"
        "        for _ in range(100):\n"
        "            writer.write(numpy.zeros(100_000))\n"
        "except BrokenPipeError:\n"
        "    print('broken', file=sys.stderr)\n"
        "    os._exit(0)\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert process.stdout is not None and process.stderr is not None
    assert process.stdout.readline() == b"voltage_V\n"
    process.stdout.close()
    assert process.stderr.read() == b"broken\n"
    process.stderr.close()
    assert process.wait(timeout=30) == 0


def test_flush_hands_every_row_on(tmp_path: Path) -> None:
    script = (
        "import sys, numpy\n"
        "from dbo_cli.logs.sample_block import Column\n"
        "from dbo_cli.logs.signal_writer import signal_writer\n"
        "with signal_writer('-', [Column('voltage', 'V')], flush=True) as writer:\n"
        "    for line in sys.stdin:\n"
        "        writer.write(numpy.array([float(line)]))\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", script],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdin is not None and process.stdout is not None
    assert process.stdout.readline() == "voltage_V\n"
    for number in ("1.5", "2.25"):
        process.stdin.write(number + "\n")
        process.stdin.flush()
        # while the input is still open
        assert process.stdout.readline() == number + "\n"
    process.stdin.close()
    process.stdout.close()
    assert process.wait(timeout=30) == 0


@pytest.mark.parametrize("name", ["out.csv", "out.tsv.gz", "out.h5"])
def test_the_same_signal_gives_the_same_bytes(name: str, tmp_path: Path) -> None:
    contents = []
    for number in range(2):
        path = tmp_path / str(number) / name
        path.parent.mkdir()
        with signal_writer(
            str(path), COLUMNS, attributes=lambda: {"sample_rate": 10.0}
        ) as writer:
            writer.write(np.arange(5) / 10, np.arange(5.0))
        contents.append(path.read_bytes())
        clock.sleep(0.01)
    assert contents[0] == contents[1]


def test_headers() -> None:
    assert header_of(Column("time", "s")) == "time_s"
    assert header_of(Column("voltage")) == "voltage"
    assert header_of(Column("voltage_V", "V")) == "voltage_V"
    assert header_of(Column("force", "furlong")) == "force (furlong)"


def test_a_header_that_needs_quotes_reads_back(tmp_path: Path) -> None:
    from dbo_cli.logs.columns import ColumnWish
    from dbo_cli.logs.signal_log import open_log

    path = str(tmp_path / "out.csv")
    with signal_writer(
        path, [Column('the "drive", raw', "V"), Column("#2", "um")]
    ) as writer:
        writer.write([1.0], [2.0])
    with open_log(
        path, {"one": ColumnWish('the "drive", raw_V'), "two": ColumnWish("#2_um")}
    ) as log:
        assert log.read().values["two"].tolist() == [2.0]


def test_hdf5_carries_units_rate_and_attributes(tmp_path: Path) -> None:
    path = str(tmp_path / "out.h5")
    attributes: dict[str, str | float] = {
        "sample_rate": 100.0,
        "model_sha256": "ab",
        "command": "dbo simulate",
    }
    with signal_writer(
        path + "::/run/1", COLUMNS, attributes=lambda: attributes
    ) as writer:
        for start in range(0, 200_000, 7_000):
            stop = min(200_000, start + 7_000)
            writer.write(np.arange(start, stop) / 100, np.arange(start, stop) * 0.1)
    with h5py.File(path) as file:
        group = file["run/1"]
        told = dict(group.attrs)
        assert told.pop("dbo_columns").tolist() == ["time_s", "voltage_V"]
        assert told == attributes
        assert dict(group["voltage_V"].attrs) == {"units": "V", "quantity": "voltage"}
        assert (group["voltage_V"][()] == np.arange(200_000) * 0.1).all()
        assert (group["time_s"][()] == np.arange(200_000) / 100).all()
        assert group["time_s"].chunks == (65536,)
        assert group["time_s"].compression == "gzip" and group["time_s"].shuffle


@pytest.mark.parametrize("step", [1, 3, 100])
def test_hdf5_tells_the_sample_rate_of_an_even_clock(step: int, tmp_path: Path) -> None:
    path = str(tmp_path / "out.h5")
    even = 5.0 + np.arange(100) / 3000
    gap = np.append(even, 7.0)
    for time, rate in (
        (even, 3000.0),
        (gap, None),
        (even[::-1], None),
        (even[:1], None),
    ):
        with signal_writer(path, COLUMNS) as writer:
            for start in range(0, len(time), step):
                writer.write(time[start : start + step], time[start : start + step])
        with h5py.File(path) as file:
            assert file.attrs.get("sample_rate") == rate


def test_hdf5_without_rows_is_whole(tmp_path: Path) -> None:
    path = str(tmp_path / "out.h5")
    with signal_writer(path, COLUMNS):
        pass
    with h5py.File(path) as file:
        assert file["time_s"].shape == (0,)


def test_hdf5_does_not_go_down_a_pipe() -> None:
    with (
        pytest.raises(UsageError) as raised,
        signal_writer("-", COLUMNS, format="hdf5"),
    ):
        pass
    assert (
        str(raised.value)
        == "HDF5 cannot be written to a pipe: name a file (-o FILE.h5)"
    )


def test_a_column_that_may_be_blank(tmp_path: Path) -> None:
    desired = Column("desired", "um", may_be_blank=True)
    columns = [Column("time", "s"), desired, Column("voltage", "V")]
    values = np.array([0.0, 1.0]), np.array([0.5, np.nan]), np.array([2.0, 3.0])
    rows, fast = b"0.0,0.5,2.0\n1.0,,3.0\n", io.BytesIO()
    import_polars()
    write_rows(fast, values, ",")
    assert (_plain_rows(values, ","), fast.getvalue()) == (rows, rows)
    for name, refusal in (
        ("out.csv", ":3: column 'desired_um' is empty ("),
        ("out.h5", ": row 2: column 'desired_um' is not finite: 'nan' ("),
    ):
        path = str(tmp_path / name)
        with signal_writer(path, columns) as writer:
            writer.write(*values)
        want = {
            "voltage": column_wish("voltage"),
            "desired": column_wish("desired", may_be_blank=True),
        }
        with open_log(path, want) as log:
            block = log.read()
        assert (list(block.rows), block.values["desired"], block.values["voltage"]) == (
            [1],
            [0.5],
            [2.0],
        )
        assert log.notes == log.warnings == []
        with (
            open_log(path, {"desired": column_wish("desired")}) as log,
            pytest.raises(InputError) as refused,
        ):
            log.read()
        assert str(refused.value).startswith(path + refusal)
        for wrong, bad in ((1, np.inf), (0, np.nan), (2, np.nan)):
            arrays = [*values]
            arrays[wrong] = np.array([0.0, bad])
            with pytest.raises(
                OutputError, match="would hold a number that is not finite"
            ):
                with signal_writer(path, columns) as writer:
                    writer.write(*arrays)
