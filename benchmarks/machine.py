"""Whether this machine is quiet enough to judge figures of time on it.

    python benchmarks/machine.py            exit code 2 where it is not

A process that does nothing, `python -c pass`, takes about as long as the processor
works on it where nothing else runs. Where the middle one of several takes more than
twice the processor's time of the fastest, other programs take turns with it, and a
figure of time says more about them than about what is measured.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import time

STARTS = 15
"""Processes that are started, one after the other: about a second."""

MOST_SLOWED = 2.0
"""Times its usual time that a process may take where figures are still judged."""

NOT_JUDGED = 2
"""The exit code of a program whose figures are not judged."""


def slowed() -> float:
    """Return how many times its usual time `python -c pass` takes now."""
    seconds, work = [], []
    for _ in range(STARTS):
        before, begin = os.times(), time.perf_counter()
        subprocess.run([sys.executable, "-c", "pass"], check=True)
        seconds.append(time.perf_counter() - begin)
        after = os.times()
        user = after.children_user - before.children_user
        system = after.children_system - before.children_system
        work.append(user + system)
    # The processor's time is counted in ticks of 10 ms on some systems: no less than
    # one of them.
    usual = max(min(work), 0.01)
    return statistics.median(seconds) / usual


def verdict(kept: bool) -> int:
    """Return the exit code of a program that judges figures of time: not judged on a busy machine."""
    times = slowed()
    if times > MOST_SLOWED:
        print(f"not judged: `python -c pass` takes {times:.1f} times its usual time")
        return NOT_JUDGED
    return 0 if kept else 1


if __name__ == "__main__":
    sys.exit(verdict(True))
