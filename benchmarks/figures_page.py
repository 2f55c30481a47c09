"""The page of figures: what the programs of this folder print, one after the other.

    python benchmarks/figures_page.py [-o PAGE] [--only NAME,NAME] [--anyway]

Refuses to begin on a busy machine (benchmarks/machine.py) unless told to go on
`--anyway`; the page says how busy it was. It has the commit, the processor and every
program's output as it is.
"""

from __future__ import annotations

import argparse
import platform
import subprocess
import sys
from pathlib import Path

from machine import MOST_SLOWED, NOT_JUDGED, slowed

HERE = Path(__file__).resolve().parent
PROGRAMS = (
    "startup", "text_speed", "hdf5_speed", "format_speed", "large_files", "report_speed", "kernel_speed",
    "live_speed", "bank_speed", "hops", "exponents", "identification_cost", "relatives_cost", "drift",
    "round_trip", "dynamics_round_trip", "tracking",
)  # fmt: skip
VERDICTS = {
    0: "",
    1: "**A promise is not kept.**",
    NOT_JUDGED: "**Not judged: the machine was busy.**",
}


def processor() -> str:
    """Return what the system calls its processor."""
    listed = Path("/proc/cpuinfo")
    if listed.exists():
        for line in listed.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def commit() -> str:
    """Return the commit that is measured."""
    done = subprocess.run(
        ["git", "describe", "--always", "--dirty"],
        cwd=HERE,
        capture_output=True,
        text=True,
        check=False,
    )
    return done.stdout.strip() or "unknown"


def section(name: str) -> tuple[str, int]:
    """Run one program; return its part of the page and its exit code."""
    done = subprocess.run(
        [sys.executable, str(HERE / f"{name}.py")],
        capture_output=True,
        text=True,
        check=False,
    )
    verdict = VERDICTS.get(done.returncode, f"**Ended with {done.returncode}.**")
    output = "".join(
        f"    {line}\n" if line else "\n"
        for line in (done.stdout + done.stderr).splitlines()
    )
    text = f"## {name}\n\n`python benchmarks/{name}.py`\n\n{output}\n"
    if verdict:
        text += f"{verdict}\n\n"
    return text, done.returncode


def main() -> int:
    """Run the programs and write the page; 1 where a promise is not kept, 2 where figures are not judged."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("figures.md"))
    parser.add_argument("--only", default=",".join(PROGRAMS))
    parser.add_argument("--anyway", action="store_true")
    options = parser.parse_args()
    times = slowed()
    if times > MOST_SLOWED and not options.anyway:
        print(
            f"the machine is busy: `python -c pass` takes {times:.1f} times its usual time (--anyway)"
        )
        return NOT_JUDGED
    page = (
        f"# Figures\n\nCommit {commit()}, {processor()}, Python {platform.python_version()}."
        f" `python -c pass` took {times:.1f} times its usual time at the beginning.\n\n"
    )
    worst = 0
    for name in options.only.split(","):
        print(name, flush=True)
        text, code = section(name)
        page += text
        worst = max(worst, code)
        options.output.write_text(page)
    return worst


if __name__ == "__main__":
    sys.exit(main())
