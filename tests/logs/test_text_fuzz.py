"""The tables of ``benchmarks/attack_files.py`` in small: read right or refused, never wrong in silence."""

import pytest
from random_tables import once


@pytest.mark.parametrize("block", range(3))
def test_nothing_is_misread(block, tmp_path):
    outcomes = {}
    for seed in range(300 * block, 300 * block + 300):
        outcome = once(seed, tmp_path / "run.csv")
        assert outcome != "wrong", f"seed {seed}"
        outcomes[outcome] = outcomes.get(outcome, 0) + 1
    assert outcomes["right"] > 90
