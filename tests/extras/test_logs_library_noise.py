"""Damaged files at which a compiled library panics or aborts: one line of this program, and nothing else."""

from __future__ import annotations

import io
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import openpyxl
import polars
import pytest

from dbo_cli.cli.app import CommandProcess
from dbo_cli.errors import InputError
from dbo_cli.logs.request import GAVE_UP

PATH = {"PYTHONPATH": str(Path(__file__).parents[2])}


def frame() -> polars.DataFrame:
    values = [0.001 * k for k in range(2000)]
    return polars.DataFrame(
        {"time_s": values, "voltage_V": values, "displacement_um": values}
    )


def test_no_byte_of_a_parquet_file_brings_the_library_to_the_terminal(
    tmp_path: Path,
) -> None:
    """In a process of its own, which the library may end."""
    frame().write_parquet(tmp_path / "good.parquet", compression="uncompressed")
    script = (
        "import sys\n"
        "from pathlib import Path\n"
        "from dbo_cli.errors import InputError\n"
        "from dbo_cli.logs.columns import column_wish\n"
        "from dbo_cli.logs.signal_log import open_log\n"
        "from dbo_cli.cli.app import prepare_process\n"
        "prepare_process()\n"
        "want = {'voltage': column_wish('voltage'), 'displacement': column_wish('displacement')}\n"
        "good = Path('good.parquet').read_bytes()\n"
        "for at in range(len(good) - 700, len(good) - 8, 3):\n"  # the footer: a byte leads furthest astray
        "    Path('bad.parquet').write_bytes(good[:at] + b'\\xff' + good[at + 1:])\n"
        "    try:\n"
        "        open_log('bad.parquet', want).read()\n"
        "    except InputError as problem:\n"
        "        print(problem)\n"
    )
    run = [sys.executable, "-c", script]
    done = subprocess.run(
        run, capture_output=True, text=True, cwd=tmp_path, env=os.environ | PATH
    )
    assert "bad.parquet: damaged Parquet: " in done.stdout
    assert done.stderr == ""


def test_a_library_that_panics_and_one_that_aborts(tmp_path: Path) -> None:
    """In a process of its own, which the abort ends."""
    script = (
        "import os, sys\n"
        "from dbo_cli.cli.app import CommandProcess\n"
        "contained = CommandProcess().contained\n"
        "try:\n"
        "    with contained('a', 'Parquet'):\n"
        "        os.write(2, b'panicked')\n"
        "        raise ValueError('one')\n"
        "except ValueError as problem:\n"
        "    print(problem, file=sys.stderr, flush=True)\n"
        "with contained('a', 'Parquet'):\n"
        "    os.write(2, b'two\\n')\n"
        "with contained('b\\x1b[31m.parquet', 'Parquet'):\n"
        "    os.write(2, b'memory allocation failed')\n"
        "    os.abort()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True
    )
    line = f"dbo: error: b [31m.parquet: damaged Parquet: {GAVE_UP}"
    assert done.stderr.splitlines() == ["one", "two", line]
    assert done.returncode == 1


def test_a_workbook_that_asks_for_all_memory(tmp_path: Path) -> None:
    """A cell far to the right and down: the library asks for a sheet of that size, and aborts."""
    book = openpyxl.Workbook()
    for row in (
        ["time_s", "voltage_V", "displacement_um"],
        *([k, k, k] for k in range(9)),
    ):
        book.active.append(row)
    whole = io.BytesIO()
    book.save(whole)
    with (
        zipfile.ZipFile(whole) as packed,
        zipfile.ZipFile(tmp_path / "bad.xlsx", "w") as out,
    ):
        for name in packed.namelist():
            data = packed.read(name)
            out.writestr(name, data.replace(b'r="C10"', b'r="ZZZZZZZ99999999"'))
    words = ["identify", str(tmp_path / "bad.xlsx"), "-o", str(tmp_path / "model.json")]
    done = subprocess.run(
        [sys.executable, "-m", "dbo_cli", *words], capture_output=True, text=True
    )
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1
    assert done.stderr.startswith(
        f"dbo: error: {tmp_path}/bad.xlsx: damaged workbook: "
    )
    assert os.listdir(tmp_path) == ["bad.xlsx"]


def test_nothing_is_held_back_where_standard_error_is_closed() -> None:
    script = (
        "import os\n"
        "from dbo_cli.cli.app import CommandProcess\n"
        "contained = CommandProcess().contained\n"
        "os.close(2)\n"
        "with contained('a', 'Parquet'):\n"
        "    print('read')\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True
    )
    assert (done.returncode, done.stdout) == (0, "read\n")


def test_errors_of_this_program_come_through() -> None:
    with (
        pytest.raises(InputError, match="mine"),
        CommandProcess().contained("a", "Parquet"),
    ):
        raise InputError("mine")
