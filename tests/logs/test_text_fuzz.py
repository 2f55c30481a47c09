"""The files of ``benchmarks/attack_files.py`` in small: read right or refused, never wrong in silence."""

from collections import Counter

import pytest
from attack_files import Files


@pytest.mark.parametrize("block", range(3))
def test_nothing_is_misread(block, tmp_path):
    files = Files(tmp_path)
    seeds = range(200 * block, 200 * block + 200)
    outcomes = Counter(files.tables(seed) for seed in seeds)
    assert outcomes["wrong"] == 0 and outcomes["right"] > 60


@pytest.mark.filterwarnings("ignore::dbo_cli.errors.DboWarning")
@pytest.mark.parametrize("kind", ["texts_mutated", "models_mutated"])
def test_damage_is_read_or_refused_in_one_line(kind, tmp_path):
    attempt = getattr(Files(tmp_path), kind)
    assert len({attempt(seed) for seed in range(300)}) > 1
