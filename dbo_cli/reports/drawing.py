"""Turn figures into PNG, SVG, or SVG fit to stand inside a page: the same values give the same bytes."""

from __future__ import annotations

import io
import re
import tempfile
import unicodedata
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from dbo_cli.errors import OutputError, UsageError
from dbo_cli.logs.plain_text import cleaned
from dbo_cli.logs.whole_output import write_whole
from dbo_cli.reports import drawing_library as library
from dbo_cli.reports import figure_style as style
from dbo_cli.reports.renderers import short_name

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Kind = Literal["png", "svg", "inline"]
FILES: tuple[Kind, ...] = ("png", "svg")

# What a log's name ends with and a figure's need not; ``run.1.csv`` and ``run.2.csv`` keep their numbers.
_ENDINGS = re.compile(r"\.(?:csv|tsv|txt|dat|lvm|asc|log|h5|hdf5?|nxs|mat|npy|npz|parquet|feather|xlsx?|tdms)"
                      r"(?:\.(?:gz|bz2|xz|zst))?$", re.IGNORECASE)  # fmt: skip
_NOTE_WIDTH = 40  # letters; beside a legend of two names they fill the width of a figure
_LONGEST_STEM = 100  # bytes: of the 255 of a file name, 60 are for the figure's key and a temporary ending


@dataclass(frozen=True)
class Plot:
    """One figure: the stem of its file name, its title, what it shows in words, and how it is drawn.

    ``size`` is width and height in inches; a legend of more than one line adds ``head`` inches above.
    """

    key: str
    title: str
    words: str
    size: tuple[float, float]
    paint: Callable[[Axes], None]
    head: float = 0.0


def draw(plot: Plot, kind: Kind, note: str = "", scope: str = "") -> bytes:
    """Return the figure as PNG, as SVG (letters as outlines), or as SVG to stand inside a page.

    ``note`` is set small above the axes, at the right. The inline form has letters as text, no background,
    the colours of ``figure_style.SCHEME`` as variables, and ids that begin with ``scope`` and the figure's
    key (they must differ within a page).
    """
    content = _saved(_painted(plot, note, as_outlines=kind != "inline"), kind)
    return _for_page(content.decode(), plot, f"{scope}-{plot.key}-").encode() if kind == "inline" else content


def _painted(plot: Plot, note: str, *, as_outlines: bool) -> Figure:
    with library.style(style.RC):
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        size = (plot.size[0], plot.size[1] + plot.head)
        figure = Figure(figsize=size)
        FigureCanvasAgg(figure)
        axes = figure.add_axes((0.1, 0.1, 0.8, 0.8))
        plot.paint(axes)
        headed = bool(note) or axes.get_legend() is not None
        axes.set_position(_frame(size, (0.32 if headed else 0.2) + plot.head))
        if note:
            shown = short_name(cleaned(note), _NOTE_WIDTH)
            axes.set_title(shown, loc="right", color=style.MUTED, fontsize=8.0, pad=5.0)
        library.show_plainly(figure, as_outlines=as_outlines)
        _fit_left(figure, axes)
    return figure


def _saved(figure: Figure, kind: Kind) -> bytes:
    """Return a painted figure in one form; no date or version in it, so the bytes repeat."""
    inline = kind == "inline"
    out = io.BytesIO()
    metadata: dict[str, Any] = {"Software": None} if kind == "png" else {"Date": None, "Creator": None}
    with library.style(style.RC | ({"svg.fonttype": "none"} if inline else {})):
        figure.savefig(out, format="png" if kind == "png" else "svg", metadata=metadata, transparent=inline)
    return out.getvalue()


_PICTURES = (".png", ".svg", ".pdf", ".jpg", ".jpeg", ".eps")


def refuse_picture(folder: str) -> None:
    """Refuse the name of one picture where a folder for several is meant (UsageError)."""
    path = Path(folder)
    if path.suffix.lower() in _PICTURES and not path.is_dir():
        raise UsageError(f"{folder}: there are several figures: name a folder (`figures` {path.stem})")


def check_folder(folder: str) -> Path:
    """Make the folder for figures and prove that files can be written there, before any long work.

    Raises OutputError with the folder's name.
    """
    refuse_picture(folder)
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
        figure = _painted(plot, note, as_outlines=True)
        for kind in FILES:
            path = folder / f"{stem}-{plot.key}.{kind}"
            write_whole(str(path), _saved(figure, kind))
            written.append(path)
    return written


def file_stems(names: Sequence[str]) -> list[str]:
    """Return a stem for the figure files of every log, all different, on every file system.

    The name without its folder and its ending, with the group of an HDF5 file; letters of every script stay,
    what a shell or a file system might take amiss becomes ``_``, and a long name loses its end.
    """
    stems: list[str] = []
    taken: set[str] = set()
    for name in names:
        stem = "stdin" if name == "-" else _plain_stem(name)
        count, unique = 2, stem
        while unique.casefold() in taken:
            unique = f"{stem}-{count}"
            count += 1
        taken.add(unique.casefold())
        stems.append(unique)
    return stems


def _plain_stem(name: str) -> str:
    path, _, group = name.partition("::")
    base = path.replace("\\", "/").rsplit("/", 1)[-1]
    base = _ENDINGS.sub("", base) or base
    group = group.strip("/")
    stem = unicodedata.normalize("NFC", f"{base}-{group}" if group else base)
    stem = re.sub(r"[^\w.-]+", "_", stem).strip(".")
    while len(stem.encode()) > _LONGEST_STEM:
        stem = stem[:-1]
    return stem or "log"


def _frame(size: tuple[float, float], top: float) -> tuple[float, float, float, float]:
    """Return left, bottom, width and height of the axes for margins fixed in inches."""
    left, right, bottom = 0.66, 0.12, 0.48
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
    return svg.replace("<svg ", f'<svg role="img" aria-label="{escape(cleaned(plot.words))}" ', 1).strip()
