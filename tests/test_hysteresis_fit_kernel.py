"""The loops of an identification: compiled and in Python, bit for bit; the optimum is one."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from dbo_cli.hysteresis.identification import normal_equations
from dbo_cli.hysteresis.identification.normal_equations import (
    ABSENT,
    AT_ZERO,
    FREE,
    POSITIVE,
)

compiled: Any = pytest.importorskip("dbo_cli.hysteresis._fit")


@pytest.mark.parametrize("columns", [1, 3, 4, 17, 90])
def test_products_are_the_same_bits(columns: int) -> None:
    table = np.random.default_rng(columns).normal(size=(1000, columns))
    one, other = np.zeros((2, columns, columns))
    compiled.add_products(table, columns, one)
    normal_equations.add_products(table, columns, other)
    assert np.array_equal(np.triu(one), np.triu(other))
    assert np.triu(one) == pytest.approx(np.triu(table.T @ table), rel=1e-12, abs=1e-9)


@pytest.mark.parametrize("seed", range(12))
def test_minima_are_the_same_bits_and_meet_the_conditions_of_an_optimum(
    seed: int,
) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 60))
    table = rng.normal(size=(3 * count, count)) @ (
        np.tri(count) if seed % 2 else np.eye(count)
    )
    matrix = np.einsum("ki,kj->ij", table, table)
    size = np.sqrt(np.diagonal(matrix))
    matrix, right = matrix / size / size[:, None], rng.normal(size=count)
    begin = np.full(count, POSITIVE, np.uint8)
    begin[: count // 8], begin[-1] = FREE, ABSENT
    found, states = [], []
    for kernel in (compiled, normal_equations):
        state, x = begin.copy(), np.zeros(count)
        assert kernel.minimise(matrix, right, state, x, 1e-10, 500) > 0
        found.append(x)
        states.append(state)
    assert np.array_equal(found[0], found[1]) and np.array_equal(states[0], states[1])
    gradient = matrix @ found[0] - right
    assert found[0][states[0] == ABSENT].tolist() == [0.0]
    assert (found[0][states[0] == POSITIVE] >= 0.0).all()
    assert (gradient[states[0] == AT_ZERO] >= -1e-10).all()
    assert (
        np.abs(gradient[(states[0] == POSITIVE) | (states[0] == FREE)]).max(initial=0.0)
        < 1e-6
    )


@pytest.mark.parametrize("kernel", [compiled, normal_equations])
def test_what_has_no_minimum_is_told(kernel: Any) -> None:
    state, x = np.full(2, FREE, np.uint8), np.zeros(2)
    assert (
        kernel.minimise(
            np.array([[1.0, 2.0], [2.0, 1.0]]), np.ones(2), state, x, 0.0, 10
        )
        == -1
    )


def test_wrong_lengths_are_refused() -> None:
    with pytest.raises(ValueError, match="buffer of the wrong length: products"):
        compiled.add_products(np.zeros(7), 2, np.zeros(4))
    with pytest.raises(ValueError, match="buffer of the wrong length: minimise"):
        compiled.minimise(
            np.zeros(4), np.zeros(3), np.zeros(3, np.uint8), np.zeros(3), 0.0, 1
        )


def test_the_compiled_loops_are_chosen() -> None:
    python = os.environ.get("DBO_KERNEL") == "python"
    expected = normal_equations if python else compiled
    assert normal_equations.CHOSEN is expected


SCRIPT = """
import hashlib, numpy as np
from dbo_cli.hysteresis.identification import Recording, identify
from dbo_cli.hysteresis.model_file import model_to_bytes
t = np.arange(12000) / 500.0
v = 50.0 - 50.0 * np.exp(-t / 20.0) * np.cos(2.0 * np.pi * t)
x = 0.1 * v + 0.004 * np.roll(v, 40) + 0.01 * np.random.default_rng(1).normal(size=t.size)
print(hashlib.sha256(model_to_bytes(identify([Recording("a", v, x, t)]).model)).hexdigest())
"""


def test_the_number_of_threads_changes_no_bit(
    capsys: pytest.CaptureFixture[str],
) -> None:
    # not those of this process
    threads = "1" if os.environ["OPENBLAS_NUM_THREADS"] == "2" else "2"
    exec(SCRIPT, {})
    one = capsys.readouterr().out
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], env={**os.environ, **dict.fromkeys(names, threads)},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert one == done.stdout != ""
