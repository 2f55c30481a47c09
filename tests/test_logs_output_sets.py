"""Several outputs or none, no output over another file of the command, and what stands behind /dev/stdout."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from types import FrameType

import pytest

from dbo_cli.cli.app import CommandProcess
from dbo_cli.errors import OutputError, UsageError
from dbo_cli.logs.request import check_document
from dbo_cli.logs.sample_block import Column
from dbo_cli.logs.signal_writer import signal_writer
from dbo_cli.logs.whole_output import (
    all_or_none,
    check_outputs,
    descriptor_of,
    identity_of,
    make_folder,
    partial_path,
    remove_orphans,
    replacing,
    write_whole,
)

posix = pytest.mark.skipif(os.name != "posix", reason="needs POSIX files and signals")
ROOT = str(Path(__file__).resolve().parent.parent)


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def test_all_outputs_appear_together(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_bytes(b"old")
    with all_or_none():
        write_whole(str(tmp_path / "a.json"), b"new")
        with signal_writer(str(tmp_path / "b.csv"), [Column("time", "s")]) as writer:
            writer.write([1.0])
        with signal_writer(f"{tmp_path / 'c.h5'}::/g", [Column("time", "s")]) as writer:
            writer.write([1.0])
        assert (tmp_path / "a.json").read_bytes() == b"old"
        assert not (tmp_path / "b.csv").exists() and not (tmp_path / "c.h5").exists()
    assert set(content(tmp_path)) == {"a.json", "b.csv", "c.h5"}
    assert (tmp_path / "a.json").read_bytes() == b"new"


def test_a_failure_takes_everything_back(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_bytes(b"old")
    with pytest.raises(RuntimeError), all_or_none():
        write_whole(str(tmp_path / "a.json"), b"new")
        make_folder(str(tmp_path / "figures" / "all"))
        write_whole(str(tmp_path / "figures" / "all" / "one.png"), b"png")
        raise RuntimeError
    assert content(tmp_path) == {"a.json": b"old"}
    assert os.listdir(tmp_path) == ["a.json"]


def test_a_rename_that_fails_takes_the_others_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a.json").write_bytes(b"old")
    real = os.replace

    def replace(source: str, target: str) -> None:
        if target.endswith("c.json"):
            raise PermissionError(13, "Permission denied")
        real(source, target)

    monkeypatch.setattr(os, "replace", replace)
    with (
        pytest.raises(
            OutputError, match=r"c\.json: cannot be written: Permission denied"
        ),
        all_or_none(),
    ):
        for name in "abc":
            write_whole(str(tmp_path / f"{name}.json"), b"new")
    assert content(tmp_path) == {"a.json": b"old"}


def test_one_output_does_not_wait_for_another(tmp_path: Path) -> None:
    with signal_writer(str(tmp_path / "a.csv"), [Column("time", "s")]):
        write_whole(str(tmp_path / "state.json"), b"{}")
        assert (tmp_path / "state.json").exists()


def test_two_outputs_of_one_name_in_a_set(tmp_path: Path) -> None:
    with (
        pytest.raises(OutputError, match=r"a\.json: two outputs go there"),
        all_or_none(),
    ):
        write_whole(str(tmp_path / "a.json"), b"1")
        write_whole(str(tmp_path / "." / "a.json"), b"2")
    assert content(tmp_path) == {}


def hearing(number: int) -> None:
    """Let a process hear a signal that whoever started the tests (``nohup``, ``&``) may have silenced."""
    signal.signal(
        number,
        signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL,
    )


@posix
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_signal_takes_everything_back(tmp_path: Path, number: int) -> None:
    script = (
        "import sys, time\n"
        "from dbo_cli.cli.app import prepare_process\n"
        "from dbo_cli.logs.whole_output import all_or_none, make_folder, write_whole\n"
        "prepare_process()\n"
        "with all_or_none():\n"
        "    make_folder('figures')\n"
        "    write_whole('figures/a.png', b'x')\n"
        "    write_whole('b.json', b'x')\n"
        "    print('written', flush=True)\n"
        "    while True:\n"  # a signal right before one long sleep would be heard after it
        "        time.sleep(0.01)\n"
    )
    (tmp_path / "b.json").write_bytes(b"old")
    process = subprocess.Popen(
        [sys.executable, "-c", script],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": ROOT},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        preexec_fn=partial(hearing, number),
    )
    assert process.stdout is not None
    assert process.stdout.readline() == b"written\n"
    process.send_signal(number)
    assert process.wait(timeout=120.0) != 0
    process.stdout.close()
    assert os.listdir(tmp_path) == ["b.json"]
    assert content(tmp_path) == {"b.json": b"old"}


@contextlib.contextmanager
def ended_by_sigterm() -> Iterator[None]:
    """Let SIGTERM unwind the stack, as a process of ``dbo`` does."""

    def end(number: int, frame: FrameType | None) -> None:
        raise SystemExit(128 + number)

    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@posix
def test_a_signal_among_the_renames_waits_until_all_are_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = os.replace

    def replace(source: str, target: str) -> None:
        real(source, target)
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(0.01)

    monkeypatch.setattr(os, "replace", replace)
    monkeypatch.setattr("dbo_cli.logs.request._host", CommandProcess())
    with ended_by_sigterm(), pytest.raises(SystemExit) as raised, all_or_none():
        for name in "ab":
            (tmp_path / f"{name}.json").write_bytes(b"old")
            write_whole(str(tmp_path / f"{name}.json"), b"new")
    assert raised.value.code == 143
    assert content(tmp_path) == {"a.json": b"new", "b.json": b"new"}


@posix
def test_what_a_killed_writer_left_is_cleaned_up(tmp_path: Path) -> None:
    script = (
        "import os, sys\n"
        "from dbo_cli.logs.sample_block import Column\n"
        "from dbo_cli.logs.signal_writer import signal_writer\n"
        "with signal_writer(sys.argv[1], [Column('time', 's')]) as writer:\n"
        "    writer.write([0.0] * 100_000)\n"
        "    os.kill(os.getpid(), 9)\n"
    )
    for name in ("a.csv", "b.h5"):
        subprocess.run(
            [sys.executable, "-c", script, str(tmp_path / name)], check=False
        )
    # the second writer has cleaned up after the first
    assert len(os.listdir(tmp_path)) == 1
    mine = Path(partial_path(str(tmp_path / "mine.csv")))
    mine.write_bytes(b"being written by this very process")
    (tmp_path / ".notes.partial").write_bytes(b"not ours")
    write_whole(str(tmp_path / "c.json"), b"{}")
    assert sorted(os.listdir(tmp_path)) == sorted(
        [".notes.partial", "c.json", mine.name]
    )


@posix
def test_a_partial_file_that_is_locked_is_left_alone(tmp_path: Path) -> None:
    """Its writer may be one that cannot be seen from here: in another container, on another machine."""
    import fcntl

    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    path = tmp_path / f".a.csv.{gone.pid}-01234567.partial"
    with open(path, "wb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        remove_orphans(str(tmp_path))
        assert path.exists()
    remove_orphans(str(tmp_path))
    assert not path.exists()


@posix
def test_a_long_name_can_be_written(tmp_path: Path) -> None:
    for name in ("x" * 251 + ".csv", "長" * 83 + ".csv"):
        write_whole(str(tmp_path / name), b"x")
        assert (tmp_path / name).exists()
    with pytest.raises(OutputError, match="File name too long"):
        check_outputs([str(tmp_path / ("x" * 252 + ".csv"))])


def test_one_file_under_two_spellings_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    (tmp_path / "there.csv").write_text("x\n")
    (tmp_path / "link.csv").symlink_to("there.csv")
    (tmp_path / "ahead.csv").symlink_to("new.csv")
    (tmp_path / "same").symlink_to("folder")
    os.link("there.csv", "hard.csv")
    pairs = [
        ("new.csv", "./new.csv"), ("new.csv", str(tmp_path / "new.csv")), ("new.csv", "folder/../new.csv"),
        ("ahead.csv", "new.csv"), ("folder/new.csv", "same/new.csv"), ("there.csv", "link.csv"),
        ("there.csv", "hard.csv"), ("prec.h5::/g", "prec.h5"), ("prec.h5::/g", "prec.h5::/h"), ("-", "-"),
    ]  # fmt: skip
    for one, other in pairs:
        with pytest.raises(UsageError, match="one file, and two outputs go there"):
            check_outputs([one, other])
        with pytest.raises(UsageError, match="one file, and two outputs go there"):
            check_outputs([other, "other.csv", one])
    check_outputs(["new.csv", "other.csv", "folder/new.csv", "there.csv"])
    check_outputs(["/dev/null", "/dev/null"])
    with pytest.raises(UsageError, match=r"^link\.csv: this output is also an input"):
        check_outputs(["link.csv"], ["auto", "hard.csv"])
    with pytest.raises(UsageError, match="two inputs are standard input"):
        check_outputs(["-"], ["-", "-"])


def test_names_that_differ_in_case(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one, other = str(tmp_path / "New.csv"), str(tmp_path / "new.csv")
    assert (identity_of(one) == identity_of(other)) == (
        tmp_path.parent / tmp_path.name.swapcase()
    ).exists()
    monkeypatch.setattr("dbo_cli.logs.whole_output._ignores_case", lambda folder: True)
    assert identity_of(one) == identity_of(other)


@posix
def test_the_shells_own_redirections_are_seen(tmp_path: Path) -> None:
    """Standard output is a file, too: an input, or the other output."""
    (tmp_path / "log.csv").write_text("x\n")
    script = (
        "import sys\nfrom dbo_cli.logs.whole_output import check_outputs\n"
        "check_outputs([{}], ['log.csv'])\n"
    )
    cases = {
        "'-'": "standard output: this output is also an input",
        "'-', '/dev/stdout'": "also an input",
        "'/dev/fd/1'": "also an input",
    }
    for outputs, said in cases.items():
        with open(tmp_path / "log.csv", "a") as file:
            done = subprocess.run(
                [sys.executable, "-c", script.format(outputs)], stdout=file, stderr=subprocess.PIPE,
                env=os.environ | {"PYTHONPATH": ROOT}, cwd=tmp_path, text=True, check=False,
            )  # fmt: skip
        assert said in done.stderr
    with open(tmp_path / "out.csv", "w") as file:
        done = subprocess.run(
            [sys.executable, "-c", script.format("'out.csv', '-'")], stdout=file, stderr=subprocess.PIPE,
            env=os.environ | {"PYTHONPATH": ROOT}, cwd=tmp_path, text=True, check=False,
        )  # fmt: skip
    assert (
        "out.csv and standard output are one file, and two outputs go there"
        in done.stderr
    )


@posix
@pytest.mark.parametrize(
    "given",
    ["/dev/stdout", "/dev/fd/1", "/proc/self/fd/1", "/dev/../dev/stdout", "link"],
)
def test_what_stands_behind_standard_output_is_appended_to(
    tmp_path: Path, given: str
) -> None:
    if not os.path.exists("/proc/self/fd") and "proc" in given:
        pytest.skip("no /proc here")
    (tmp_path / "link").symlink_to("/dev/stdout")
    script = (
        "import sys\n"
        "from dbo_cli.logs.sample_block import Column\n"
        "from dbo_cli.logs.signal_writer import signal_writer\n"
        "from dbo_cli.logs.whole_output import write_whole\n"
        "with signal_writer(sys.argv[1], [Column('time', 's')]) as writer:\n"
        "    writer.write([1.0])\n"
        "write_whole(sys.argv[1], b'end\\n')\n"
    )
    path = tmp_path / "all.log"
    path.write_text("first\n")
    before = path.stat().st_ino
    with open(path, "a") as file:
        subprocess.run(
            [sys.executable, "-c", script, given], stdout=file, cwd=tmp_path, check=True,
            env=os.environ | {"PYTHONPATH": ROOT},
        )  # fmt: skip
    assert path.read_text() == "first\ntime_s\n1.0\nend\n"
    assert path.stat().st_ino == before


@posix
def test_another_descriptor_is_written_to(tmp_path: Path) -> None:
    path = tmp_path / "all.log"
    path.write_text("first\n")
    with open(path, "a") as file:
        name = f"/dev/fd/{file.fileno()}"
        assert descriptor_of(name) == file.fileno()
        write_whole(name, b"second\n")
        with pytest.raises(UsageError, match="HDF5 cannot be written to a pipe"):
            with signal_writer(name, [Column("time", "s")], format="hdf5"):
                pass
    assert path.read_text() == "first\nsecond\n"
    with (
        open(path) as file,
        pytest.raises(OutputError, match="is not open for writing"),
    ):
        write_whole(f"/dev/fd/{file.fileno()}", b"x")
    with pytest.raises(OutputError, match="file descriptor 987 is not open"):
        write_whole("/dev/fd/987", b"x")
    assert descriptor_of(str(path)) is None


def test_a_signal_group_is_no_place_for_a_model(tmp_path: Path) -> None:
    with pytest.raises(
        UsageError, match="names a group of an HDF5 file, and this output is no signal"
    ):
        write_whole(f"{tmp_path}/model.json::/x", b"{}")


def test_replacing_joins_a_set(tmp_path: Path) -> None:
    with all_or_none():
        with replacing(str(tmp_path / "a.png")) as temporary:
            Path(temporary).write_bytes(b"png")
        assert not (tmp_path / "a.png").exists()
    assert (tmp_path / "a.png").read_bytes() == b"png"


@pytest.mark.parametrize(
    ("name", "format", "said"),
    [
        (
            "drive.mat",
            None,
            "MATLAB's own files are not written: call it .h5, and MATLAB's h5read reads it",
        ),
        ("drive.mat::/g", None, "MATLAB's own files are not written"),
        ("x.h5.gz", None, "HDF5 is compressed inside: leave out .gz"),
        ("x.h5.gz::/g", None, "HDF5 is compressed inside: leave out .gz"),
        (
            "X.XLSX",
            None,
            ".xlsx files are not written: .csv, .tsv, .txt, .dat (also with .gz) and .h5 are",
        ),
        ("x.parquet", "csv", ".parquet files are not written"),
        ("x.csv.xz", None, ".xz files are not written"),
        ("x.csv", "h5", "`format` h5 contradicts this name: leave one of them out"),
        ("x.lvm", None, "LabVIEW's own files are not written: call it .txt"),
        ("x.json", None, ".json files are not written"),
        (
            "x.npy.gz",
            None,
            ".npy is a generator's file, which dbo waveform writes: call this one .csv",
        ),
        ("x.h5", "csv", "`format` csv contradicts this name: leave one of them out"),
        ("x.tsv", "csv", "`format` csv contradicts this name"),
        ("x.csv.gz", "tsv", "`format` tsv contradicts this name"),
    ],
)
def test_a_file_is_what_it_is_called(
    tmp_path: Path, name: str, format: str | None, said: str
) -> None:
    with pytest.raises(UsageError) as raised:
        with signal_writer(str(tmp_path / name), [Column("time", "s")], format=format):
            pass
    assert said in str(raised.value)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    ("name", "form", "said"),
    [
        (
            "model.csv",
            "json",
            "a model is written as JSON, not as .csv: call it model.json",
        ),
        (
            "model.json.gz",
            "json",
            "a model is written as JSON, not as .gz: call it model.json",
        ),
        ("M.H5", "json", "not as .h5: call it M.json"),
        ("model.xlsx", "json", "not as .xlsx: call it model.json"),
        (
            "report.pdf",
            "text",
            "a model is written as text, not as .pdf: call it report.txt",
        ),
        ("report.csv.gz", "csv", "written as CSV, not as .gz: call it report.csv"),
        ("report.json", "html", "written as HTML, not as .json: call it report.html"),
        ("model.txt.gz", "text", "not as .gz: call it model.txt"),
    ],
)
def test_a_document_is_what_it_is_called(name: str, form: str, said: str) -> None:
    with pytest.raises(UsageError) as raised:
        check_document(name, "a model", form)
    assert said in str(raised.value)


def test_a_document_may_have_any_name_that_says_nothing() -> None:
    for name in (
        "-",
        "model.json",
        "model",
        "model.v2",
        "model.txt",
        "/dev/fd/3",
        "a.csv/model",
    ):
        check_document(name, "a model", "json")
    check_document("r.htm", "a report", "html")
    check_document("r.csv", "a report", "csv")


def test_a_name_that_says_nothing_takes_any_format(tmp_path: Path) -> None:
    tabs, commas, hdf5 = b"time_s\tu", b"time_s,u", b"\x89HDF"
    cases = [
        ("x", "tsv", tabs),
        ("y.out", "h5", hdf5),
        ("z.txt", "tsv", tabs),
        ("a.csv", "csv", commas),
    ]
    for name, format, start in cases:
        with signal_writer(
            str(tmp_path / name),
            [Column("time", "s"), Column("u")],
            format=format,
        ):
            pass
        assert (tmp_path / name).read_bytes().startswith(start)


@pytest.mark.parametrize(
    ("name", "cell"),
    [
        ("=cmd|' /C calc'!A0", "'=cmd|' /C calc'!A0"),
        ("@SUM(1)", "'@SUM(1)"),
        ("-drive", "'-drive"),
        ("\x1b[31mred\x1b[0m\r\nname\x07", "[31mred [0m name"),
        ("\udcb5m\udcff", "µmÿ"),
        ("left\u202egnp.exe", "left gnp.exe"),
        ("位置", "位置"),
    ],
)
def test_headers_are_harmless(tmp_path: Path, name: str, cell: str) -> None:
    with signal_writer(str(tmp_path / "out.csv"), [Column(name)]) as writer:
        writer.write([1.0])
    assert (tmp_path / "out.csv").read_text(encoding="utf-8") == f"{cell}\n1.0\n"
    stated = {"command": name}
    with signal_writer(
        str(tmp_path / "out.h5"), [Column(name, name)], attributes=lambda: stated
    ) as h5:
        h5.write([1.0])


def test_a_rename_that_fails_leaves_no_second_copy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All were there before, so each has a second name while the others are renamed."""
    real = os.replace

    def replace(source: str, target: str) -> None:
        if (
            target.endswith("c.json")
            and source.endswith(".partial")
            and Path(source).read_bytes() == b"new"
        ):
            raise PermissionError(13, "Permission denied")
        real(source, target)

    for name in "abc":
        (tmp_path / f"{name}.json").write_bytes(b"old")
    monkeypatch.setattr(os, "replace", replace)
    with (
        pytest.raises(
            OutputError, match=r"c\.json: cannot be written: Permission denied"
        ),
        all_or_none(),
    ):
        for name in "abc":
            write_whole(str(tmp_path / f"{name}.json"), b"new")
    assert content(tmp_path) == {f"{name}.json": b"old" for name in "abc"}
