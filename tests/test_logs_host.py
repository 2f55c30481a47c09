"""The library leaves the process of its host alone; ``dbo`` as a process prepares its own."""

from __future__ import annotations

import ast
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import polars
import pytest

from dbo_cli.errors import InputError
from dbo_cli.logs.columns import column_wish
from dbo_cli.logs.sample_block import Column
from dbo_cli.logs.signal_log import open_log
from dbo_cli.logs.signal_writer import signal_writer
from dbo_cli.logs.whole_output import all_or_none, write_whole

posix = pytest.mark.skipif(os.name != "posix", reason="needs POSIX files and signals")
ROOT = Path(__file__).resolve().parent.parent
WANT = {"voltage": column_wish("voltage"), "displacement": column_wish("displacement")}
# Calls that change what belongs to the whole process, for whoever else runs in it.
PROCESS_WIDE = {
    "os.dup2", "os.putenv", "os.environ.setdefault", "os.environ.update", "os.environ.pop", "os.chdir",
    "os.umask", "signal.signal", "signal.siginterrupt", "signal.set_wakeup_fd", "signal.pthread_sigmask",
    "ctypes.CDLL",
    "os._exit", "sys.exit", "gc.set_threshold", "faulthandler.enable", "warnings.simplefilter",
}  # fmt: skip


def test_no_module_below_the_shell_touches_the_process() -> None:
    found = []
    for path in sorted((ROOT / "dbo_cli" / "logs").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and ast.unparse(node.func) in PROCESS_WIDE:
                found.append(f"{path.name}: {ast.unparse(node.func)}")
    assert found == []


@pytest.mark.whole
@posix
def test_four_threads_that_read_parquet_leave_standard_error_where_it_was(
    tmp_path: Path,
) -> None:
    values = [0.001 * k for k in range(3000)]
    polars.DataFrame(
        {"time_s": values, "voltage_V": values, "displacement_um": values}
    ).write_parquet(tmp_path / "log.parquet")
    before, problems = os.fstat(2), []

    def read() -> None:
        for _ in range(20):
            with open_log(str(tmp_path / "log.parquet"), WANT) as log:
                log.read()
            if not os.path.samestat(before, os.fstat(2)):
                problems.append("standard error leads elsewhere")

    threads = [threading.Thread(target=read) for _ in range(4)]
    for one in threads:
        one.start()
    for one in threads:
        one.join()
    assert problems == []
    assert os.path.samestat(before, os.fstat(2))


def test_writing_sets_no_handler(tmp_path: Path) -> None:
    numbers = [
        number
        for name in ("SIGINT", "SIGTERM", "SIGHUP")
        if (number := getattr(signal, name, None))
    ]
    before = [signal.getsignal(number) for number in numbers]
    with all_or_none():
        write_whole(str(tmp_path / "a.json"), b"{}")
        with signal_writer(str(tmp_path / "b.h5"), [Column("time", "s")]) as writer:
            writer.write([1.0])
            assert [signal.getsignal(number) for number in numbers] == before
    assert [signal.getsignal(number) for number in numbers] == before


@posix
def test_a_process_hears_interrupts_after_polars_and_ends_in_order(
    tmp_path: Path,
) -> None:
    """``prepare_process``: SIGTERM and SIGHUP unwind the stack; a signal that is ignored stays so."""
    script = (
        "import os, signal\n"
        "from dbo_cli.cli.app import prepare_process\n"
        "prepare_process()\n"
        "assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN\n"
        "try:\n"
        "    os.kill(os.getpid(), signal.SIGTERM)\n"
        "    signal.pause()\n"
        "except SystemExit as end:\n"
        "    print(end.code)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN), check=False,
    )  # fmt: skip
    assert (done.returncode, done.stdout, done.stderr) == (0, "143\n", "")


@pytest.mark.whole
def test_a_damaged_file_is_one_exception_in_a_host(tmp_path: Path) -> None:
    (tmp_path / "bad.parquet").write_bytes(b"PAR1" + bytes(40) + b"PAR1")
    with pytest.raises(InputError, match=r"bad\.parquet: damaged Parquet: "):
        open_log(str(tmp_path / "bad.parquet"), WANT)
