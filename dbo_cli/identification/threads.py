"""One thread of linear algebra while a log is identified."""

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy
import scipy

SETTER = "openblas_set_num_threads_local"  # returns how many there were


@contextmanager
def one_thread() -> Iterator[None]:
    """Let OpenBLAS, which the wheels of numpy and scipy bring, have one thread meanwhile.

    In many small factorisations threads only wait for each other (five times the CPU,
    measured), and their number would change digits. Other libraries stay as they are.
    """
    changed = []
    for package in (numpy, scipy):
        folder = Path(str(package.__file__)).parent
        for path in folder.parent.glob(f"{folder.name}.libs/*openblas*"):
            set_threads = getattr(ctypes.CDLL(str(path)), SETTER, None)
            if set_threads is not None:
                changed.append((set_threads, set_threads(1)))
    try:
        yield
    finally:
        for set_threads, before in changed:
            set_threads(before)
