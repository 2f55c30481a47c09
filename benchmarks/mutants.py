"""Plant faults in the mathematics, one at a time, and say which of them no test finds.

    python benchmarks/mutants.py [--jobs N] [TEXT ...]

A copy of the project gets one fault of ``planted_faults.py``, and the tests that should
find it run there. A fault that lives is a test that is missing. With TEXT only faults
whose file or meaning holds one of these texts are tried. Exit code 1 where one lives.
"""

from __future__ import annotations

import argparse
import os
import queue
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from planted_faults import FAULTS, Fault

ROOT = Path(__file__).resolve().parent.parent
LEFT_OUT = shutil.ignore_patterns(
    ".git",
    ".venv",
    "__pycache__",
    ".*_cache",
    ".hypothesis",
    "build",
    "demo",
    "paper",
    "*.egg-info",
)
LONGEST = 1800.0  # s; a fault that makes the tests run for ever is found, too
BUILD = "from setuptools import setup; setup()"


class Copy:
    """A copy of the project in which one fault stands at a time."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        shutil.copytree(ROOT, folder, ignore=LEFT_OUT)
        # The copy goes before the installed package; bytecode could outlive a fault of
        # the same length.
        self.environment = os.environ | {
            "PYTHONPATH": str(folder),
            "PYTHONDONTWRITEBYTECODE": "1",
        }
        self.environment |= {"OPENBLAS_NUM_THREADS": "1"}
        self.build()

    def run(self, *words: str) -> subprocess.CompletedProcess[str]:
        """Run Python in the copy."""
        return subprocess.run(
            [sys.executable, *words],
            cwd=self.folder,
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=LONGEST,
        )

    def build(self) -> None:
        """Compile the kernel."""
        done = self.run("-c", BUILD, "-q", "build_ext", "--inplace", "--force")
        if done.returncode:
            raise SystemExit(f"the kernel cannot be built:\n{done.stderr}")

    def failing(self, tests: Sequence[str]) -> str | None:
        """Return the first test that fails, or None."""
        files = []
        for name in tests:
            files += [
                str(path.relative_to(ROOT))
                for path in (ROOT / "tests").rglob(f"test_{name}.py")
            ]
        try:
            done = self.run(
                "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *files
            )
        except subprocess.TimeoutExpired:
            return "(does not end)"
        if done.returncode == 0:
            return None
        lines = [
            line
            for line in done.stdout.splitlines()
            if line.startswith(("FAILED", "ERROR"))
        ]
        return (
            lines[0].split(" - ")[0].partition("::")[2] or lines[0]
            if lines
            else "(no test runs)"
        )

    def try_fault(self, fault: Fault) -> str | None:
        """Plant a fault, return the test that finds it, and take the fault out again."""
        path = self.folder / fault.file
        sound = path.read_text(encoding="utf-8")
        path.write_text(fault.planted(sound), encoding="utf-8")
        compiled = path.suffix == ".c"
        try:
            if compiled:
                self.build()
            return self.failing(fault.tests)
        finally:
            path.write_text(sound, encoding="utf-8")
            if compiled:
                self.build()


def main() -> None:
    """Try every fault that is asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("texts", nargs="*", metavar="TEXT")
    asked = parser.parse_args()
    chosen = [
        fault
        for fault in FAULTS
        if not asked.texts
        or any(text in fault.file + ": " + fault.breaks for text in asked.texts)
    ]
    with tempfile.TemporaryDirectory() as folder:
        copies: queue.Queue[Copy] = queue.Queue()
        for number in range(asked.jobs):
            copies.put(Copy(Path(folder) / f"copy{number}"))
        sound = copies.queue[0].failing(
            sorted({name for fault in chosen for name in fault.tests})
        )
        if sound is not None:
            raise SystemExit(f"without any fault this fails already: {sound}")

        def attempt(fault: Fault) -> bool:
            copy = copies.get()
            try:
                found = copy.try_fault(fault)
            finally:
                copies.put(copy)
            verdict, where = (
                "LIVES" if found is None else "found",
                fault.file.removeprefix("dbo_cli/"),
            )
            print(
                f"{verdict}  {where}: {fault.breaks}\n       {found or fault.text}",
                flush=True,
            )
            return found is None

        with ThreadPoolExecutor(asked.jobs) as pool:
            living = sum(pool.map(attempt, chosen))
    print(f"{len(chosen)} faults, {len(chosen) - living} found, {living} live")
    sys.exit(1 if living else 0)


if __name__ == "__main__":
    main()
