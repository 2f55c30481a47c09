"""A record cut in the middle of a number is not believed; a whole file without a final line end is read."""

from __future__ import annotations

import gzip
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dbo_cli.errors import InputError
from dbo_cli.logs.columns import ColumnWish
from dbo_cli.logs.request import ReadingOptions
from dbo_cli.logs.signal_log import open_log

WANT = {"displacement": ColumnWish(None, ("displacement",), option="displacement")}
ROOT = str(Path(__file__).resolve().parent.parent)


def read(path: Path, **options: object) -> tuple[list[float], list[str]]:
    with open_log(str(path), WANT, ReadingOptions(**options)) as log:  # type: ignore[arg-type]
        values = log.read().values["displacement"].tolist()
        return values, log.notes


def fixed(value: float) -> str:
    return f"{value:.4f}"


def padded(value: float) -> str:
    return f"{value:12.4f}"


def scientific(value: float) -> str:
    return f"{value:.6e}"


def shortest(value: float) -> str:
    return repr(value)


def rounded(value: float) -> str:
    return repr(round(value, 4))


def general(value: float) -> str:
    return f"{value:.6g}"


def whole(value: float) -> str:
    return str(round(1000 * value))


def decimal_comma(value: float) -> str:
    return f"{value:.3f}".replace(".", ",")


WAYS = [fixed, padded, scientific, shortest, rounded, general, whole, decimal_comma]


def table(way: Callable[[float], str], values: list[float]) -> str:
    lines = [f"{number / 100:.2f};{way(value)}" for number, value in enumerate(values)]
    text = "\n".join(["time_s;displacement_um", *lines])
    return text.replace(".", ",") if way is decimal_comma else text


@pytest.mark.parametrize("way", WAYS)
def test_no_cut_passes_in_silence(way: Callable[[float], str], tmp_path: Path) -> None:
    values = (50.0 + 40.0 * np.sin(np.arange(60) / 7.0)).tolist()
    text, path = table(way, values), tmp_path / "run.csv"
    good = [float(way(value).replace(",", ".")) for value in values]
    for size in range(text.rindex("\n") + 2, len(text) + 1):
        path.write_text(text[:size])
        try:
            got, notes = read(path)
        except InputError as problem:
            assert "run.csv:61: " in str(problem)
            assert size < len(text)
            continue
        assert got[:-1] == good[:-1]
        assert notes == [
            f"{path}:61: the last line has no line end: was the record cut there?"
        ]
        # what is believed with a warning goes on from the sample before: nothing falls
        # from 84 V to 0
        assert abs(got[-1] - good[-1]) < 3.0 * np.abs(np.diff(good)).max()


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("seed", range(20))
def test_a_whole_file_is_read(
    way: Callable[[float], str], seed: int, tmp_path: Path
) -> None:
    """Descending through 100 to 99, ending in 0.0, noise: only many-digit noise may by chance end short."""
    rng = np.random.default_rng(seed)
    kinds = [
        np.linspace(103.0, 97.0, 61),
        np.abs(np.linspace(-1.0, 0.0, 51)) * 30.0,
        100.0 + rng.normal(0.0, 3.0, 200),
        np.round(rng.uniform(0.0, 2000.0) + np.cumsum(rng.normal(0.0, 0.3, 200)), 3),
    ]
    values = kinds[seed % 4].tolist()
    path = tmp_path / "run.csv"
    path.write_text(table(way, values))
    assert read(path)[0] == [float(way(value).replace(",", ".")) for value in values]


def test_the_messages(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    text = "displacement_um\n" + "10.5012\n10.5021\n10.5032\n"
    path.write_text(text + "1")
    with pytest.raises(InputError) as raised:
        read(path)
    assert str(raised.value) == (
        f"{path}:5: the last line has no line end, and its last cell '1' is shorter than those above "
        "('10.5032'): the record was cut there (`skip_bad` or `rows` :3 leaves it out; end the line if it is "
        "whole)"
    )
    assert read(path, rows=(1, 3))[0] == [10.5012, 10.5021, 10.5032]
    got, notes = read(path, skip_bad=True)
    assert got == [10.5012, 10.5021, 10.5032]
    assert notes[0].endswith("the record was cut there: 1 row dropped")
    path.write_text(text + "# end")
    assert read(path) == ([10.5012, 10.5021, 10.5032], [])
    path.write_text(text)
    assert read(path) == ([10.5012, 10.5021, 10.5032], [])


@pytest.mark.parametrize("block_rows", [1, 1000])
def test_the_verdict_does_not_depend_on_the_block_size(
    block_rows: int, tmp_path: Path
) -> None:
    path = tmp_path / "run.csv"
    still = f"{0.0:.700f}"  # wide: 400 rows are more than the head of 256 kB
    rows = "".join(f"{still},{100.0 + number / 7:.3f}\n" for number in range(400))
    path.write_text("still,displacement_um\n" + rows + f"{still},157.1")
    with pytest.raises(
        InputError, match=r"run\.csv:402: .* '157\.1' is shorter than those above"
    ):
        read(path, block_rows=block_rows)
    path.write_text("still,displacement_um\n" + rows + f"{still},157.143")
    assert len(read(path, block_rows=block_rows)[0]) == 401


def test_compressed_data_end_their_lines(tmp_path: Path) -> None:
    path = tmp_path / "run.csv.gz"
    path.write_bytes(gzip.compress(b"displacement_um\n10.5\n10.6"))
    with pytest.raises(
        InputError,
        match="3: the last line has no line end, in compressed data: the record was cut",
    ):
        read(path)
    path.write_bytes(gzip.compress(b"displacement_um\n10.5\n10.6\n"))
    assert read(path) == ([10.5, 10.6], [])


@pytest.mark.skipif(os.name != "posix", reason="needs named pipes")
def test_a_stream_ends_its_lines(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.csv"
    os.mkfifo(pipe)
    for text, good in (
        ("displacement_um\n10.5\n10.6", False),
        ("displacement_um\n10.5\n10.6\n", True),
    ):
        writer = threading.Thread(target=pipe.write_text, args=(text,))
        writer.start()
        if good:
            assert read(pipe) == ([10.5, 10.6], [])
        else:
            with pytest.raises(
                InputError, match="3: the last line has no line end, in a stream"
            ):
                read(pipe)
        writer.join()


def test_a_file_on_standard_input_is_no_stream(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("displacement_um\n10.5\n10.6")
    script = (
        "from dbo_cli.logs.columns import ColumnWish\n"
        "from dbo_cli.logs.request import ReadingOptions\n"
        "from dbo_cli.logs.signal_log import open_log\n"
        "with open_log('-', {'d': ColumnWish('1')}, ReadingOptions()) as log:\n"
        "    print(log.read().values['d'].tolist(), log.notes)\n"
    )
    with open(path) as file:
        done = subprocess.run(
            [sys.executable, "-c", script], stdin=file, capture_output=True, text=True, check=True,
            env=os.environ | {"PYTHONPATH": ROOT},
        )  # fmt: skip
    assert done.stdout.startswith(
        "[10.5, 10.6] ['standard input:3: the last line has no line end"
    )


def test_a_file_that_is_still_growing(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("displacement_um\n10.5\n10.6")
    with open_log(str(path), WANT, ReadingOptions()) as log:
        with open(path, "a") as recorder:
            recorder.write("1\n10.62\n")
        time.sleep(0.01)
        with pytest.raises(
            InputError,
            match="the last line has no line end, in a file that is still growing",
        ):
            log.read()
