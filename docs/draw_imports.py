"""Draw which room of the package imports which, for architecture.md: ``python docs/draw_imports.py``.

The imports are read from the source with ``ast``, those inside functions and those for
types alone included; tests/test_rooms.py holds that no module is in a circle of
imports, that no arrow points up, and that the picture shows the arrows there are.
"""

from __future__ import annotations

import ast
import functools
import io
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "dbo_cli"
FIGURE = ROOT / "docs" / "figures" / "imports.svg"
NAMES = "dbo_cli"
"""The package's own file, which holds the public names."""

PLACES: dict[str, tuple[int, float, float, str]] = {
    # level from below, left and right end of the box, what the room is for
    "errors": (0, 0.0, 3.4, "what users meet: one class a kind"),
    "interpolation": (0, 4.5, 7.5, "between samples"),
    "version": (0, 8.5, 10.0, ""),
    "extensions": (1, 0.0, 10.0, "the table where core and extras meet"),
    "hysteresis": (2, 0.0, 4.8, "operators, model, states, their files"),
    "logs": (2, 5.2, 10.0, "formats, columns, units, clocks, outputs"),
    "identification": (3, 0.0, 3.1, "a model from logs"),
    "drives": (
        4,
        0.0,
        6.5,
        "what leaves for an amplifier: pieces, one state, one gate",
    ),
    "reports": (4, 6.9, 10.0, "figures of merit, pages"),
    "runs": (
        5,
        0.0,
        10.0,
        "the use cases: blocks in, blocks out; what must be said comes back as data",
    ),
    "cli": (6, 0.0, 10.0, "options, one call, output"),
    "extras": (
        7,
        0.0,
        10.0,
        "what may be left out, a folder each; nothing below knows them",
    ),
    NAMES: (8, 0.0, 4.8, "the public names, loaded when asked for"),
}
"""The rooms; an arrow may only lead to a lower level."""


@dataclass(frozen=True)
class Import:
    """One module imports another; ``late``: inside a function, or for types alone."""

    importer: str
    imported: str
    late: bool


def module_files() -> dict[str, Path]:
    """Return every module of the package with its file."""
    files = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        files[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return files


@functools.cache
def imports() -> list[Import]:
    """Return every import of one module of the package by another."""
    files = module_files()
    found = set()
    for importer, path in files.items():
        for node, late in _statements(
            ast.parse(path.read_text(encoding="utf-8")), False
        ):
            for name in _named(node):
                imported = name if name in files else name.rpartition(".")[0]
                if imported in files and imported != importer:
                    found.add(Import(importer, imported, late))
    return sorted(found, key=lambda one: (one.importer, one.imported, one.late))


def room(module: str) -> str:
    """Return the room that a module belongs to."""
    parts = module.split(".")[1:]
    if not parts or parts == ["__main__"]:
        return NAMES if not parts else "cli"
    return (
        "identification" if parts[:2] == ["hysteresis", "identification"] else parts[0]
    )


def arrows() -> dict[tuple[str, str], bool]:
    """Return which room imports which, and whether only late."""
    found: dict[tuple[str, str], bool] = {}
    for one in imports():
        pair = room(one.importer), room(one.imported)
        if pair[0] != pair[1]:
            found[pair] = found.get(pair, True) and one.late
    return found


def arrow_id(importer: str, imported: str) -> str:
    """Return what an arrow is called inside the picture."""
    return f"arrow-{importer}-{imported}"


def ids(svg: str) -> set[str]:
    """Return the names of what a picture shows."""
    return set(re.findall(r'id="([a-z_-]+)"', svg))


def _statements(node: ast.AST, late: bool) -> Iterator[tuple[ast.AST, bool]]:
    """Return the import statements below a node, and whether they take effect later than the module."""
    for child in ast.iter_child_nodes(node):
        if not isinstance(child, ast.stmt | ast.excepthandler | ast.match_case):
            continue  # no expression holds an import
        if isinstance(child, ast.Import | ast.ImportFrom):
            yield child, late
        typing_only = isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(
            child.test
        )
        inside = isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef)
        yield from _statements(child, late or inside or typing_only)


def _named(node: ast.AST) -> list[str]:
    if isinstance(node, ast.ImportFrom):
        return [f"{node.module}.{alias.name}" for alias in node.names]
    assert isinstance(node, ast.Import)
    return [alias.name for alias in node.names]


def paint(axes: Axes) -> None:
    """Draw the rooms that are there as boxes and the imports between them as arrows."""
    from matplotlib.patches import FancyBboxPatch

    from dbo_cli.reports import drawing as style

    there = {room(module) for module in module_files()}
    found = {pair: late for pair, late in arrows().items() if set(pair) <= there}
    ports = _ports(list(found))
    for pair, late in found.items():
        (x, y), (to_x, to_y) = ports[pair]
        line: dict[str, Any] = {
            "color": style.SECOND if late else style.FIRST,
            "linewidth": 1.1,
        }
        line |= {
            "linestyle": (0, (3.2, 1.4)) if late else "-",
            "shrinkA": 0.0,
            "shrinkB": 0.0,
        }
        drawn = axes.annotate(
            "", (to_x, to_y), (x, y), arrowprops={"arrowstyle": "-|>", **line}, zorder=1
        )
        assert drawn.arrow_patch is not None
        drawn.arrow_patch.set_gid(arrow_id(*pair))
    for name in sorted(there & PLACES.keys()):
        level, left, right, what = PLACES[name]
        box = FancyBboxPatch(
            (left, 2.0 * level), right - left, 1.0, boxstyle="round,pad=0,rounding_size=0.12",
            facecolor="white", edgecolor=style.INK, linewidth=0.9, zorder=2,
        )  # fmt: skip
        box.set_gid(f"room-{name}")
        axes.add_patch(box)
        spot: dict[str, Any] = {"ha": "center", "va": "center", "zorder": 3}
        middle = 2.0 * level + 0.5
        axes.text(
            (left + right) / 2,
            middle + (0.2 if what else 0.0),
            name,
            weight="bold",
            **spot,
        )
        axes.text(
            (left + right) / 2,
            middle - 0.22,
            what,
            color=style.MUTED,
            fontsize=7.5,
            **spot,
        )
    axes.set(xlim=(-0.1, 10.1), ylim=(-0.1, 17.1))
    axes.axis("off")


def _ports(
    pairs: list[tuple[str, str]],
) -> dict[tuple[str, str], tuple[tuple[float, float], ...]]:
    """Return where each arrow leaves and enters its boxes: evenly spread, in the order of the other ends."""

    def middle(name: str) -> float:
        _, left, right, _ = PLACES[name]
        return (left + right) / 2

    def spread(name: str, others: list[str]) -> dict[str, float]:
        _, left, right, _ = PLACES[name]
        ordered = sorted(others, key=lambda other: (middle(other), PLACES[other][0]))
        gap = (right - left) / (len(ordered) + 1)
        return {other: left + gap * (k + 1) for k, other in enumerate(ordered)}

    leaving = {
        name: spread(name, [b for a, b in pairs if a == name]) for name in PLACES
    }
    entering = {
        name: spread(name, [a for a, b in pairs if b == name]) for name in PLACES
    }
    return {
        (a, b): (
            (leaving[a][b], 2.0 * PLACES[a][0]),
            (entering[b][a], 2.0 * PLACES[b][0] + 1.0),
        )
        for a, b in pairs
    }


def picture() -> bytes:
    """Return the picture as SVG; the same imports give the same bytes."""
    from matplotlib import rc_context, rc_params_from_file
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from dbo_cli.reports import drawing as style

    content = io.BytesIO()
    with rc_context(rc_params_from_file(style.STYLE_FILE, use_default_template=False)):
        figure = Figure(figsize=(7.2, 9.4))
        FigureCanvasAgg(figure)
        paint(figure.add_axes((0.0, 0.0, 1.0, 1.0)))
        figure.savefig(content, format="svg", metadata={"Date": None, "Creator": None})
    return content.getvalue()


if __name__ == "__main__":
    FIGURE.write_bytes(picture())
