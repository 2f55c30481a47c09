"""Imports point downwards: rooms below know nothing of rooms above, nor model and logs of each other."""

import ast
import pathlib
import subprocess
import sys

import pytest

PACKAGE = pathlib.Path(__file__).resolve().parent.parent / "dbo_cli"
LEVELS = {
    "errors": 0,
    "units": 0.5,
    "version": 0,
    "model": 1,
    "logs": 1,
    "identification": 2,
    "drive": 2,
    "reports": 2.5,
    "export": 3,
    "compare": 3,
    "moves": 3,
    "recordings": 4,
    "channels": 4,
    "library": 5,
    "cli": 6,
}
ARRAYS_ONLY = {
    "model",
    "identification",
    "drive",
    "reports",
    "export",
    "compare",
    "moves",
}
FILES = sorted(PACKAGE.rglob("*.py"))


def room_of(path: pathlib.Path) -> str:
    first = path.relative_to(PACKAGE).parts[0]
    return first.removesuffix(".py")


def imported_rooms(path: pathlib.Path) -> set[str]:
    rooms = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module == "dbo_cli":
            names = [f"dbo_cli.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module]
        for name in names:
            if name.startswith("dbo_cli."):
                rooms.add(name.split(".")[1])
    return rooms


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_point_downwards(path):
    room = room_of(path)
    if room in ("__init__", "__main__"):
        return
    for other in imported_rooms(path) - {room}:
        assert LEVELS[other] < LEVELS[room], f"{room} imports {other}"
    if room in ARRAYS_ONLY:
        assert "logs" not in imported_rooms(path)


def test_asking_for_help_loads_nothing_heavy():
    code = (
        "import sys; from dbo_cli.cli.app import main; main(['compensate', '-h']);"
        "print(sorted({'numpy', 'polars', 'pandas', 'scipy', 'h5py', 'matplotlib'} & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-1] == "[]"


def test_importing_the_package_loads_nothing_heavy():
    code = "import sys, dbo_cli; print('numpy' in sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "False"
