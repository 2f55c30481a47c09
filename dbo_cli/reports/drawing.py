"""Turn figures into PNG, SVG, or SVG fit to stand inside a page: the same values give the same bytes."""

from __future__ import annotations

import io
import re
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from dbo_cli.errors import OutputError
from dbo_cli.logs.whole_output import write_whole
from dbo_cli.reports import figure_style as style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Kind = Literal["png", "svg", "inline"]
FILES: tuple[Kind, ...] = ("png", "svg")


@dataclass(frozen=True)
class Plot:
    """One figure: the stem of its file name, its title, what it shows in words, and how it is drawn."""

    key: str
    title: str
    words: str
    size: tuple[float, float]
    paint: Callable[[Axes], None]


def draw(plot: Plot, kind: Kind, note: str = "", scope: str = "") -> bytes:
    """Return the figure as PNG, as SVG (letters as outlines), or as SVG to stand inside a page.

    ``note`` is set small above the axes, at the right. The inline form has letters as text, no background,
    the colours of ``figure_style.SCHEME`` as variables, and ids that begin with ``scope`` and the figure's
    key (they must differ within a page).
    """
    content = _saved(_painted(plot, note), kind)
    return _for_page(content.decode(), plot, f"{scope}-{plot.key}-").encode() if kind == "inline" else content


def _painted(plot: Plot, note: str) -> Figure:
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with rc_context(style.RC):
        figure = Figure(figsize=plot.size)
        FigureCanvasAgg(figure)
        axes = figure.add_axes((0.1, 0.1, 0.8, 0.8))
        plot.paint(axes)
        axes.set_position(_frame(plot.size, headed=bool(note) or axes.get_legend() is not None))
        if note:
            axes.set_title(note, loc="right", color=style.MUTED, fontsize=8.0, pad=5.0)
        _fit_left(figure, axes)
    return figure


def _saved(figure: Figure, kind: Kind) -> bytes:
    """Return a painted figure in one form; no date or version in it, so the bytes repeat."""
    from matplotlib import rc_context

    inline = kind == "inline"
    out = io.BytesIO()
    metadata: dict[str, Any] = {"Software": None} if kind == "png" else {"Date": None, "Creator": None}
    with rc_context(style.RC | ({"svg.fonttype": "none"} if inline else {})):
        figure.savefig(out, format="png" if kind == "png" else "svg", metadata=metadata, transparent=inline)
    return out.getvalue()


def check_folder(folder: str) -> Path:
    """Make the folder for figures and prove that files can be written there, before any long work.

    Raises OutputError with the folder's name.
    """
    path = Path(folder)
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
    except OSError as problem:
        reason = problem.strerror or str(problem)
        raise OutputError(
            f"{folder}: figures cannot be written there: {reason} (`figures` with another folder)"
        ) from problem
    return path


def save(plots: Sequence[Plot], folder: Path, stem: str, note: str = "") -> list[Path]:
    """Write every figure as ``STEM-KEY.png`` and ``.svg``; each appears whole or not at all."""
    written = []
    for plot in plots:
        figure = _painted(plot, note)
        for kind in FILES:
            path = folder / f"{stem}-{plot.key}.{kind}"
            write_whole(str(path), _saved(figure, kind))
            written.append(path)
    return written


def file_stems(names: Sequence[str]) -> list[str]:
    """Return a stem for the figure files of every log: its name without folder and ending, all different."""
    stems: list[str] = []
    for name in names:
        base = name.split("::")[0].replace("\\", "/").rsplit("/", 1)[-1]
        stem = re.sub(r"[^A-Za-z0-9._-]+", "_", base.split(".")[0] or base) or "log"
        if name == "-":
            stem = "stdin"
        count, unique = 2, stem
        while unique in stems:
            unique = f"{stem}-{count}"
            count += 1
        stems.append(unique)
    return stems


def _frame(size: tuple[float, float], headed: bool) -> tuple[float, float, float, float]:
    """Return left, bottom, width and height of the axes for margins fixed in inches."""
    left, right, bottom, top = 0.66, 0.12, 0.48, 0.32 if headed else 0.2
    width, height = size
    return left / width, bottom / height, (width - left - right) / width, (height - bottom - top) / height


def _fit_left(figure: Figure, axes: Axes) -> None:
    """Give tick labels wider than usual the room they need."""
    renderer = figure.canvas.get_renderer()  # type: ignore[attr-defined]
    boxes = [box for axis in (axes.xaxis, axes.yaxis) if (box := axis.get_tightbbox(renderer)) is not None]
    if not boxes:
        return
    left, right = min(box.x0 for box in boxes), max(box.x1 for box in boxes)
    width = figure.get_size_inches()[0] * figure.dpi
    place = axes.get_position()
    x0 = max(place.x0 + (0.06 * figure.dpi - left) / width, 0.0)
    x1 = min(place.x1, place.x1 - (right - width + 0.06 * figure.dpi) / width)
    axes.set_position((x0, place.y0, x1 - x0, place.height))


def _for_page(svg: str, plot: Plot, prefix: str) -> str:
    """Turn a whole SVG file into an element of a page: own ids, colours as variables, no fixed size."""
    svg = svg[svg.index("<svg") :]
    used = set(re.findall(r"(?:url\(#|href=\"#)([^)\"]+)", svg))
    svg = re.sub(r' id="([^"]+)"', lambda found: f' id="{prefix}{found[1]}"' if found[1] in used else "", svg)
    svg = re.sub(r"(url\(#|href=\"#)", lambda found: found[1] + prefix, svg)
    for color, name in style.SCHEME.items():
        svg = svg.replace(color, f"var(--{name})")
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r'<svg ([^>]*?)width="[^"]*"', r"<svg \1", svg, count=1)
    svg = re.sub(r'<svg ([^>]*?)height="[^"]*"', r"<svg \1", svg, count=1)
    return svg.replace("<svg ", f'<svg role="img" aria-label="{escape(plot.words)}" ', 1).strip()
