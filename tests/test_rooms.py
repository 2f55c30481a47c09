"""The rooms of the package: imports point one way, and a command loads what it needs, no more."""

from __future__ import annotations

import ast
import functools
import graphlib
import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "dbo_cli"
ORDER = [
    "version", "errors", "interpolation", "extensions", "hysteresis", "logs", "drives",
    "reports", "runs", "cli", "extras",
]  # fmt: skip
SIBLINGS = [
    {"hysteresis", "logs"}, {"drives", "reports"},
]  # fmt: skip
TO_BE_CUT = {"runs/api.py"}
"""Modules of the core that still import an extra."""
MODULES = sorted(PACKAGE.rglob("*.py"))
HEAVY = {
    "numpy",
    "scipy",
    "pandas",
    "matplotlib",
    "h5py",
    "pyarrow",
    "polars",
    "pydantic",
    "rich",
}
spec = importlib.util.spec_from_file_location(
    "draw_imports", ROOT / "docs" / "draw_imports.py"
)
assert spec is not None and spec.loader is not None
draw_imports = importlib.util.module_from_spec(spec)
sys.modules["draw_imports"] = draw_imports
spec.loader.exec_module(draw_imports)
COMMANDS = [
    "identify", "show", "invert", "simulate", "compensate", "check", "report", "excite", "export", "compare",
    "trajectory", "waveform",
]  # fmt: skip


@functools.cache
def nodes(path: Path) -> list[ast.Import | ast.ImportFrom | ast.Call | ast.FunctionDef]:
    """Return every import, every call and every function in a file."""
    kinds = ast.Import | ast.ImportFrom | ast.Call | ast.FunctionDef
    return [
        node
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, kinds)
    ]


def imported(path: Path) -> set[str]:
    """Return the absolute names of all modules that a file imports, anywhere in it."""
    names: set[str] = set()
    for node in nodes(path):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names |= {f"{node.module}.{alias.name}" for alias in node.names} | {
                str(node.module)
            }
    return names


def room(path: Path) -> str | None:
    """Return the room that a file belongs to; None for the package's own two files."""
    first = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
    return first if first in ORDER else None


def test_every_file_has_a_room() -> None:
    assert {path.name for path in MODULES if room(path) is None} == {
        "__init__.py",
        "__main__.py",
    }


@pytest.mark.parametrize(
    "path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE))
)
def test_imports_point_one_way(path: Path) -> None:
    own = room(path)
    if own is None:
        return
    rooms = {
        name.split(".")[1] for name in imported(path) if name.startswith("dbo_cli.")
    }
    above = set(ORDER[ORDER.index(own) + 1 :])
    if str(path.relative_to(PACKAGE)) in TO_BE_CUT:
        above.discard("extras")
    assert not rooms & above, f"{own} imports {sorted(rooms & above)}"


def test_the_command_line_library_stays_in_its_room() -> None:
    users = {
        room(path)
        for path in MODULES
        if {name.split(".")[0] for name in imported(path)} & {"typer", "click"}
    }
    assert users == {"cli"}


def test_only_the_shell_prints_and_exits() -> None:
    for path in MODULES:
        if room(path) == "cli":
            continue
        for node in nodes(path):
            if isinstance(node, ast.Call):
                called = ast.unparse(node.func)
                assert called not in {"print", "sys.exit", "exit", "quit"}, (
                    f"{path}:{node.lineno}: {called}"
                )


def lines_of(node: ast.FunctionDef) -> int:
    """Return how many lines a function has, its docstring aside."""
    assert node.end_lineno is not None
    lines = node.end_lineno - node.lineno + 1
    first = node.body[0]
    if ast.get_docstring(node) is not None:
        assert first.end_lineno is not None
        lines -= first.end_lineno - first.lineno + 1
    return lines


def test_no_function_is_longer_than_a_page() -> None:
    long = [
        f"{path.relative_to(PACKAGE)}: {node.name}"
        for path in MODULES
        for node in nodes(path)
        if isinstance(node, ast.FunctionDef) and lines_of(node) > 80
    ]
    assert long == []


def test_siblings_know_nothing_of_each_other() -> None:
    for path in MODULES:
        rooms = {
            name.split(".")[1] for name in imported(path) if name.startswith("dbo_cli.")
        }
        for siblings in SIBLINGS:
            if room(path) in siblings:
                assert not rooms & (siblings - {room(path)}), path


def circle(edges: dict[str, set[str]]) -> list[str]:
    """Return modules that import each other in a circle, the first of them twice; nothing where none do."""
    try:
        graphlib.TopologicalSorter(edges).prepare()
    except graphlib.CycleError as found:
        return list(found.args[1])
    return []


def test_no_module_is_in_a_circle_of_imports() -> None:
    """Neither at run time, nor through imports inside functions, nor through those for types alone."""
    edges: dict[str, set[str]] = {
        module: set() for module in draw_imports.module_files()
    }
    for one in draw_imports.imports():
        edges[one.importer].add(one.imported)
    assert len(edges) == len(MODULES)
    assert sum(map(len, edges.values())) > 2 * len(edges)  # the imports were found
    assert circle(edges) == []
    edges["dbo_cli.errors"].add("dbo_cli.hysteresis.model")  # and a circle would be
    assert set(circle(edges)) >= {"dbo_cli.errors", "dbo_cli.hysteresis.model"}


@pytest.mark.whole
def test_the_picture_of_the_imports_has_no_arrow_up_and_is_up_to_date() -> None:
    arrows, places = draw_imports.arrows(), draw_imports.PLACES
    assert {name for pair in arrows for name in pair} <= places.keys()
    up = [pair for pair in arrows if places[pair[0]][0] <= places[pair[1]][0]]
    assert set(up) <= {("runs", "extras")}  # see TO_BE_CUT
    drawn = draw_imports.FIGURE.read_text(encoding="utf-8")
    shown = {name for name in draw_imports.ids(drawn) if name.startswith("arrow-")}
    assert shown == {draw_imports.arrow_id(*pair) for pair in arrows}, (
        "run docs/draw_imports.py"
    )


@pytest.mark.whole
def test_asking_for_help_loads_nothing_heavy() -> None:
    """One command after the other in one process: what the first loads, all show."""
    lines = [
        "--version",
        "--help",
        "help show",
        *(f"{name} --help" for name in COMMANDS),
    ]
    script = (
        "import sys; from dbo_cli.cli.app import main\n"
        "for line in sys.argv[1:]:\n"
        "    code = main(line.split())\n"
        f"    print(line, code, sorted(set({sorted(HEAVY)!r}) & set(sys.modules)), file=sys.stderr)"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, *lines],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stderr.splitlines() == [f"{line} 0 []" for line in lines]
