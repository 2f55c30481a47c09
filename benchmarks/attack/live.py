"""A state machine of live control against a slow, obvious model of it, for a given time.

    python benchmarks/attack/live.py [SECONDS] [SEED]

Plans, refused plans, commits, applied voltages and codes, knobs turned, states saved
and gone on from: of a controller, and of banks of 1, 2 and 55 channels, with and
without converter, slew limit, dynamics and look-ahead
(``tests/extras/live_machine.py``). Each round has a seed of its own. Counts are printed
at the end; exit 1 where the two differ, with the steps that lead there.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT / "tests"))
sys.path.insert(0, str(ROOT / "tests" / "extras"))
sys.path.insert(0, str(ROOT))

import hypothesis  # noqa: E402
from hypothesis.stateful import run_state_machine_as_test  # noqa: E402
from live_machine import TALLY, LiveMachine  # noqa: E402

MACHINES = 40  # a round
STEPS = 40  # of a machine


def main() -> None:
    """Run rounds until the time is over."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 60.0
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    settings = hypothesis.settings(
        max_examples=MACHINES,
        stateful_step_count=STEPS,
        deadline=None,
        database=None,
        suppress_health_check=list(hypothesis.HealthCheck),
        phases=[
            hypothesis.Phase.generate
        ],  # the steps as they were: shrinking them takes minutes
    )
    end, rounds, failed = time.monotonic() + seconds, 0, 0
    while time.monotonic() < end and not failed:
        machine = type("LiveMachine", (LiveMachine,), {})
        try:
            run_state_machine_as_test(
                hypothesis.seed(seed + rounds)(machine), settings=settings
            )
        except Exception as problem:
            failed += 1
            print(f"seed {seed + rounds}: {type(problem).__name__}: {problem}")
            print(*getattr(problem, "__notes__", []), sep="\n", flush=True)
        rounds += 1
    for what, count in sorted(TALLY.items()):
        print(f"{count:8,} {what}")
    print(f"{rounds} rounds of {MACHINES} machines from seed {seed}, {failed} failed")
    sys.exit(failed > 0)


if __name__ == "__main__":
    main()
