"""Imports point downwards: rooms below know nothing of rooms above, nor model and logs of each other."""

import ast
import subprocess
import sys
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent.parent / "dbo_cli"
LEVELS = {
    "errors": 0,
    "arrays": 0,
    "version": 0,
    "files": 0.5,
    "signals": 0.5,
    "units": 0.5,
    "alignment": 0.75,
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
ARRAYS_ONLY = "model identification drive reports export compare moves".split()
HEAVY = {"numpy", "polars", "pandas", "scipy", "h5py", "matplotlib"}


@cache
def imports():
    """Return what each module imports, at its top or in a function: modules, and names of them."""
    found = {}
    for path in PACKAGE.rglob("*.py"):
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        names = []
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names += [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module:
                names += [f"{node.module}.{alias.name}" for alias in node.names]
        found[".".join(parts).removesuffix(".__init__")] = names
    return found


def test_imports_point_downwards():
    for module, names in imports().items():
        room = module.split(".")[1] if "." in module else "__init__"
        if room in ("__init__", "__main__"):
            continue
        rooms = {name.split(".")[1] for name in names if name.startswith("dbo_cli.")}
        for below in rooms - {room}:
            assert LEVELS[below] < LEVELS[room], f"{module} imports {below}"
        assert room not in ARRAYS_ONLY or "logs" not in rooms, module


def test_no_two_files_import_each_other():
    """Types that are imported for a checker alone count, too."""
    modules, imported = imports(), {}
    for module, names in modules.items():
        files = {name if name in modules else name.rpartition(".")[0] for name in names}
        imported[module] = files & set(modules) - {module}
    pairs = set()
    for module, files in imported.items():
        pairs |= {f"{module} {file}" for file in files if module in imported[file]}
    assert pairs == set()


def loaded_by(code):
    """Return the heavy libraries that are loaded after some lines of Python."""
    line = [sys.executable, "-c", f"import sys; {code}; print(*sys.modules)"]
    ended = subprocess.run(line, capture_output=True, text=True, check=True)
    return HEAVY & set(ended.stdout.splitlines()[-1].split())


def test_the_package_and_its_help_load_no_library():
    assert loaded_by("import dbo_cli") == set()
    help_page = "from dbo_cli.cli.app import main; main(['compensate', '-h'])"
    assert loaded_by(help_page) == set()
