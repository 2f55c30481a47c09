"""A short, seeded part of the fuzz: nothing but the program's own one-line errors comes of any input."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "benchmarks"))

from fuzz import Fuzzer


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_no_input_breaks_the_readers(seed: int, tmp_path: Path) -> None:
    fuzzer = Fuzzer(seed, tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fuzzer.run(500)
    assert fuzzer.failures == []
    assert len(fuzzer.seen) > 60
