"""What holds for every test: one thread for small matrices, and properties that repeat themselves."""

import gc
import os
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# As the program itself does: threads only wait for each other in the many small
# factorisations.
for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "POLARS_MAX_THREADS"):
    os.environ.setdefault(name, "1")
os.environ.setdefault("MPLBACKEND", "agg")

# Compiled once: where bytecode is not kept, each of some hundred processes compiles the package again.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

ROOT = Path(__file__).resolve().parent.parent
sys.path += [str(ROOT / "sample_data"), str(ROOT / "benchmarks")]

settings.register_profile(
    "suite",
    derandomize=True,
    deadline=None,
    database=None,
    suppress_health_check=[
        HealthCheck.too_slow,
        HealthCheck.function_scoped_fixture,
        HealthCheck.filter_too_much,
    ],
)
settings.load_profile("suite")


def pytest_collection_finish():
    """Leave the libraries and what was collected out of every later search for garbage."""
    gc.freeze()


@pytest.fixture
def unpainted(monkeypatch):
    """Leave figures without paint where their files count and not their looks."""
    save = "matplotlib.figure.Figure.savefig"
    monkeypatch.setattr(save, lambda _, file, **__: file.write(b"unpainted"))
