"""Turn figures into PNG, SVG, or SVG fit to stand inside a page: the same values give the same bytes.

The look of every figure is here and in ``figures.mplstyle``. The two colours of a
comparison differ in lightness as well as in hue (they survive a grey print and the
common colour blindnesses), and in the pattern of the line. ``SCHEME`` names the
variable that stands for each colour where a page brings its own light and dark values.

Matplotlib is imported when something is drawn. It draws the same on every machine and
writes no message.
"""

from __future__ import annotations

import contextlib
import functools
import io
import logging
import os
import re
import sys
import tempfile
import unicodedata
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

from dbo_cli.errors import OutputError, UsageError, cleaned
from dbo_cli.logs.whole_output import make_folder, write_whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend
    from matplotlib.text import Text

SCHEME = {
    "#1b1d22": "ink",
    "#5d646f": "muted",
    "#d5d9df": "rule",
    "#00508f": "first",
    "#e0751a": "second",
    "#1b7f5c": "third",
    "#9c4697": "fourth",
    "#8a6d00": "fifth",
    "#7fa8cc": "fill",
}
INK, MUTED, RULE, FIRST, SECOND, THIRD, FOURTH, FIFTH, FILL = SCHEME

DOTS = 220  # an inch of a PNG: 1,100 across, sharp in print and on a dense screen

# Widths in points, dashes in widths: chosen for the sizes below.
SOLID: dict[str, Any] = {"color": FIRST, "linestyle": "-", "linewidth": 1.3}
DASHED: dict[str, Any] = {
    "color": SECOND,
    "linestyle": (0, (3.2, 1.4)),
    "linewidth": 1.3,
}
ALONE: dict[str, Any] = {"color": INK, "linestyle": "-", "linewidth": 0.9}
DOTTED: dict[str, Any] = {"color": INK, "linestyle": (0, (1, 1.6)), "linewidth": 0.9}
POINTS: dict[str, Any] = {
    "color": SECOND,
    "linestyle": "none",
    "marker": "o",
    "markersize": 3.2,
}
SEVERAL: tuple[dict[str, Any], ...] = tuple(
    ALONE | {"color": color} for color in (SECOND, FIRST, THIRD, FOURTH, FIFTH, INK)
)
WIDE = (5.0, 2.8)  # inches: two side by side fill a page in print, one a phone
TALL = (5.0, 4.0)  # inches: as wide as those; chosen for loops
STYLE_FILE = Path(__file__).with_name("figures.mplstyle")

Kind = Literal["png", "svg", "inline"]
FILES: tuple[Kind, ...] = ("png", "svg")

# What a log's name ends with and a figure's need not; ``run.1.csv`` and ``run.2.csv``
# keep their numbers.
_ENDINGS = re.compile(r"\.(?:csv|tsv|txt|dat|lvm|asc|log|h5|hdf5?|nxs|mat|npy|npz|parquet|feather|xlsx?|tdms)"
                      r"(?:\.(?:gz|bz2|xz|zst))?$", re.IGNORECASE)  # fmt: skip
# letters; beside a legend of two names they fill the width of a figure
_NOTE_WIDTH = 40
_NOTE_PAD = 5.0  # points between the axes and a note
# inches of a line of its own, for a note that has no room beside the legend
_NOTE_LINE = 0.22
_NOTE_GAP = 0.1  # inches between a legend and a note in the same line
# bytes: of the 255 of a file name, 60 are for the figure's key and a temporary ending
_LONGEST_STEM = 100
# Left alone: what the host has chosen for its own windows.
_OF_THE_HOST = (
    "backend",
    "backend_fallback",
    "interactive",
    "toolbar",
    "webagg.",
    "timezone",
)
_SHIPPED_FONT = "DejaVu Sans"  # with matplotlib, so that it is there on every machine
# Installed fonts to try for what the shipped one lacks: those of the systems, and the
# free ones.
_MORE_FONTS = (
    "Noto Sans CJK JP", "Noto Sans JP", "Hiragino Sans", "Yu Gothic", "MS Gothic", "IPAexGothic",
    "IPAGothic", "VL Gothic", "TakaoPGothic", "PingFang SC", "Microsoft YaHei", "SimHei",
    "Noto Sans CJK SC", "WenQuanYi Zen Hei", "Apple SD Gothic Neo", "Malgun Gothic", "NanumGothic",
    "Arial Unicode MS", "Noto Sans", "Segoe UI", "Leelawadee UI", "Noto Sans Devanagari", "Noto Sans Thai",
)  # fmt: skip


@dataclass(frozen=True)
class Plot:
    """One figure: the stem of its file name, its title, what it shows in words, and how it is drawn.

    ``size`` is width and height in inches; a legend of more than one line adds ``head``
    inches above.
    """

    key: str
    title: str
    words: str
    size: tuple[float, float]
    paint: Callable[[Axes], None]
    head: float = 0.0


def draw(plot: Plot, kind: Kind, note: str = "", scope: str = "") -> bytes:
    """Return the figure as PNG, as SVG (letters as outlines), or as SVG to stand inside a page.

    ``note`` is set small above the axes, at the right. The inline form has letters as
    text, no background, the colours of ``SCHEME`` as variables, and ids that begin with
    ``scope`` and the figure's key (they must differ within a page).
    """
    if kind != "inline":
        with styled():
            return _saved(_painted(plot, note, as_outlines=True), kind)
    with styled({"svg.fonttype": "none"}):
        content = _saved(_painted(plot, note, as_outlines=False), kind)
    return _for_page(content.decode(), plot, f"{scope}-{plot.key}-").encode()


def save(plots: Sequence[Plot], folder: Path, stem: str, note: str = "") -> list[Path]:
    """Write every figure as ``STEM-KEY.png`` and ``.svg``; each appears whole or not at all."""
    written: list[Path] = []
    for plot in plots:
        with styled():
            figure = _painted(plot, note, as_outlines=True)
            contents = {
                folder / f"{stem}-{plot.key}.{kind}": _saved(figure, kind)
                for kind in FILES
            }
        for path, content in contents.items():
            write_whole(str(path), content)
        written += contents
    return written


def _painted(plot: Plot, note: str, *, as_outlines: bool) -> Figure:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    width, height = plot.size[0], plot.size[1] + plot.head
    figure = Figure(figsize=(width, height))
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.1, 0.1, 0.8, 0.8))
    plot.paint(axes)
    # margins in inches
    left, right, bottom, top = 0.66, 0.12, 0.48, 0.2 + plot.head
    if note or axes.get_legend() is not None:
        top = 0.32 + plot.head
    frame = (
        left / width,
        bottom / height,
        (width - left - right) / width,
        (height - bottom - top) / height,
    )
    axes.set_position(frame)
    if note:
        shown = short_name(cleaned(note), _NOTE_WIDTH)
        title = axes.set_title(
            shown, loc="right", color=MUTED, fontsize=8.0, pad=_NOTE_PAD
        )
        _show_plainly([title], as_outlines=as_outlines)
    legend = axes.get_legend()
    named = [axes.xaxis.label, axes.yaxis.label, *axes.texts]
    if legend is not None:
        named += legend.get_texts()
    _show_plainly(named, as_outlines=as_outlines)  # what is on the ticks are numbers
    _fit_left(figure, axes)
    if note and legend is not None and _meet(figure, title, legend):
        _add_line_above(figure, axes)
        above = _NOTE_PAD + 72.0 * _NOTE_LINE
        axes.set_title(
            title.get_text(), loc="right", color=MUTED, fontsize=8.0, pad=above
        )
    return figure


def _meet(figure: Figure, note: Text, legend: Legend) -> bool:
    """Whether a note at the right and a legend at the left have too little room in one line."""
    renderer = figure.canvas.get_renderer()  # type: ignore[attr-defined]
    gap = _NOTE_GAP * figure.dpi
    return bool(
        legend.get_window_extent(renderer).x1 + gap
        > note.get_window_extent(renderer).x0
    )


def _add_line_above(figure: Figure, axes: Axes) -> None:
    """Make a figure higher by a line for its note; the axes keep their size and their place from below."""
    width, height = figure.get_size_inches()
    place = axes.get_position()
    part = height / (height + _NOTE_LINE)
    figure.set_size_inches(width, height + _NOTE_LINE)
    axes.set_position((place.x0, part * place.y0, place.width, part * place.height))


def _saved(figure: Figure, kind: Kind) -> bytes:
    """Return a painted figure in one form; no date or version in it, so the bytes repeat."""
    out = io.BytesIO()
    if kind == "png":
        # The figure is opaque, so it needs no fourth channel; that and the lower level
        # of compression halve the time of writing for 3 % more bytes.
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from PIL.Image import frombuffer

        figure.set_dpi(DOTS)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        image = frombuffer(
            "RGBA", canvas.get_width_height(), canvas.buffer_rgba(), "raw", "RGBA", 0, 1
        )
        image.convert("RGB").save(out, "png", compress_level=3, dpi=(DOTS, DOTS))
        FigureCanvasAgg(figure)  # the other canvas goes, and its pixels with it
    else:
        metadata = {"Date": None, "Creator": None}
        figure.savefig(
            out, format="svg", metadata=metadata, transparent=kind == "inline"
        )
    return out.getvalue()


_PICTURES = (".png", ".svg", ".pdf", ".jpg", ".jpeg", ".eps")


def check_folder(folder: str) -> Path:
    """Make the folder for figures and prove that files can be written there, before any long work.

    It goes again where all outputs of a run are given up. Raises OutputError with the
    folder's name, and UsageError for the name of one picture where a folder for several
    is meant.
    """
    path = Path(folder)
    if path.suffix.lower() in _PICTURES and not path.is_dir():
        raise UsageError(
            f"{folder}: there are several figures: name a folder (`figures` {path.stem})"
        )
    with contextlib.suppress(OutputError):  # what follows has the better message
        make_folder(folder)
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


def file_stems(names: Sequence[str]) -> list[str]:
    """Return a stem for the figure files of every log, all different, on every file system.

    The name without its folder and its ending, with the group of an HDF5 file; letters
    of every script stay, what a shell or a file system might take amiss becomes ``_``,
    and a long name loses its end.
    """
    stems: list[str] = []
    taken: set[str] = set()
    for name in names:
        stem = "stdin" if name == "-" else _plain_stem(name)
        count = 2
        unique = stem
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
    if group:
        base = f"{base}-{group}"
    stem = unicodedata.normalize("NFC", base)
    stem = re.sub(r"[^\w.-]+", "_", stem).strip(".")
    return stem.encode()[:_LONGEST_STEM].decode(errors="ignore") or "log"


def short_name(name: str, width: int) -> str:
    """Return a name cut in its middle where it is too long; its end, the file, tells more than its start."""
    if text_width(name) <= width:
        return name
    tail = (width - 1) * 2 // 3
    head = width - 1 - tail
    start, end = name[:head], name[-tail:]
    while text_width(start) > head:
        start = start[:-1]
    while text_width(end) > tail:
        end = end[1:]
    return f"{start}…{end}"


def text_width(text: str) -> int:
    """Return how many columns of a terminal a text takes: Chinese and Japanese letters take two."""
    wide = sum(unicodedata.east_asian_width(sign) in "WF" for sign in text)
    return len(text) + wide - sum(unicodedata.combining(sign) > 0 for sign in text)


def _fit_left(figure: Figure, axes: Axes) -> None:
    """Give tick labels wider than usual the room they need."""
    renderer = figure.canvas.get_renderer()  # type: ignore[attr-defined]
    boxes = []
    for axis in (axes.xaxis, axes.yaxis):
        box = axis.get_tightbbox(renderer)
        if box is not None:
            boxes.append(box)
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

    def own_id(match: re.Match[str]) -> str:
        """Return an id with the prefix; nothing for one that nothing refers to."""
        if match[1] not in used:
            return ""
        return f' id="{prefix}{match[1]}"'

    svg = re.sub(r' id="([^"]+)"', own_id, svg)
    svg = re.sub(r"(url\(#|href=\"#)", lambda match: match[1] + prefix, svg)
    for color, name in SCHEME.items():
        svg = svg.replace(color, f"var(--{name})")
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    for side in ("width", "height"):
        svg = re.sub(rf'<svg ([^>]*?){side}="[^"]*"', r"<svg \1", svg, count=1)
    return svg.replace(
        "<svg ", f'<svg role="img" aria-label="{escape(cleaned(plot.words))}" ', 1
    ).strip()


@functools.cache
def _load() -> None:
    """Import matplotlib, unless a host program has done so already.

    A notebook sets MPLBACKEND to a module that need not be installed here; this program
    draws into memory and needs no window. Where its configuration cannot be written,
    matplotlib complains in three lines and may leave a folder behind; here it gets a
    folder of its own, for as long as it looks for fonts.
    """
    if "matplotlib" in sys.modules:
        return
    wanted = {
        name: os.environ.pop(name, None) for name in ("MPLBACKEND", "MPLCONFIGDIR")
    }
    log = logging.getLogger("matplotlib")
    level = log.level
    log.setLevel(logging.CRITICAL)
    try:
        with contextlib.ExitStack() as stack:
            folder = wanted["MPLCONFIGDIR"]
            if not all(_is_writable(path) for path in _configuration_folders(folder)):
                folder = stack.enter_context(
                    tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
                )
            if folder is not None:
                os.environ["MPLCONFIGDIR"] = folder
            import matplotlib
            import matplotlib.font_manager
    finally:
        log.setLevel(level)
        os.environ.pop("MPLCONFIGDIR", None)
        for name, value in wanted.items():
            if value is not None:
                os.environ[name] = value
    # what the host wants for its own figures, where that exists
    with contextlib.suppress(ValueError):
        if wanted["MPLBACKEND"]:
            matplotlib.rcParams["backend"] = wanted["MPLBACKEND"]


def _configuration_folders(named: str | None) -> list[str]:
    """Return where matplotlib keeps its configuration and its list of fonts, as its manual says."""
    home = os.path.expanduser("~")
    if named:
        return [named]
    if not sys.platform.startswith(("linux", "freebsd")):
        return [os.path.join(home, ".matplotlib")]
    folders = []
    for variable, usual in (
        ("XDG_CONFIG_HOME", ".config"),
        ("XDG_CACHE_HOME", ".cache"),
    ):
        folder = os.environ.get(variable) or os.path.join(home, usual)
        folders.append(os.path.join(folder, "matplotlib"))
    return folders


def _is_writable(folder: str) -> bool:
    """Make a folder where it is missing, and tell whether files can be written there."""
    try:
        os.makedirs(folder, exist_ok=True)
    except (OSError, ValueError):
        return False
    return os.access(folder, os.W_OK)


@functools.cache
def _settings() -> dict[str, object]:
    """Return matplotlib's defaults and this program's look; the user's own configuration is left out."""
    from matplotlib import rc_params_from_file, rcParamsDefault

    defaults = {
        key: value
        for key, value in rcParamsDefault.items()
        if not key.startswith(_OF_THE_HOST)
    }
    return {**defaults, **rc_params_from_file(STYLE_FILE, use_default_template=False)}


@contextlib.contextmanager
def styled(settings: Mapping[str, object] = MappingProxyType({})) -> Iterator[None]:
    """Draw in this program's look, whatever the user's own configuration says."""
    _load()
    from matplotlib import rc_context

    with warnings.catch_warnings():
        # settings that a later release of matplotlib gives up
        warnings.simplefilter("ignore")
        with rc_context({**_settings(), **settings}):
            yield


def _show_plainly(texts: Iterable[Text], *, as_outlines: bool) -> None:
    """Clean texts of a figure; as outlines, keep what the fonts at hand can draw.

    Letters that the shipped font lacks are taken from an installed one; what no font
    has becomes a box. Text that stays text is left to the fonts of whoever shows it.
    """
    for text in texts:
        shown = cleaned(text.get_text())
        if as_outlines and not shown.isascii():
            missing = _missing(shown, _SHIPPED_FONT)
            if missing:
                family = _family_for("".join(sorted(missing)))
                text.set_fontfamily([_SHIPPED_FONT, *family])
                for name in family:
                    missing = {sign for sign in missing if _missing(sign, name)}
                for sign in missing:
                    shown = shown.replace(sign, "□")
        if shown != text.get_text():
            text.set_text(shown)


@functools.cache
def _family_for(signs: str) -> list[str]:
    """Return an installed font that has all of ``signs``, or the one that has most of them."""
    from matplotlib.font_manager import fontManager

    installed = {font.name for font in fontManager.ttflist}
    fonts = [
        (len(_missing(signs, name)), name) for name in _MORE_FONTS if name in installed
    ]
    missing, best = min(fonts, default=(len(signs), ""), key=lambda pair: pair[0])
    if missing == len(signs):
        return []
    return [best]


def _missing(signs: str, font: str) -> set[str]:
    """Return the characters that a font has no shape for."""
    known = _shapes(font)
    return {sign for sign in signs if ord(sign) not in known and sign != "\n"}


@functools.cache
def _shapes(font: str) -> frozenset[int]:
    from matplotlib.font_manager import FontProperties, findfont, get_font

    return frozenset(get_font(findfont(FontProperties(family=[font]))).get_charmap())


# --- figures in matplotlib's own windows, to zoom in and move about ---

TOOLKITS = ("QtAgg", "TkAgg", "GTK4Agg", "GTK3Agg", "WxAgg")
"""Matplotlib's ways to a window, in the order in which they are tried; the one of macOS is its own."""
SCALE = 1.6  # a window is so many times as large as a figure on a page


def require_display() -> None:
    """Refuse where no window can be opened (UsageError): before any long work."""
    displays = [name for name in ("DISPLAY", "WAYLAND_DISPLAY") if os.environ.get(name)]
    if sys.platform.startswith(("linux", "freebsd")) and not displays:
        raise UsageError(
            "`show`: there is no display to open a window on (`figures` DIR writes files)"
        )


def show_in_windows(plots: Sequence[Plot]) -> None:
    """Open a window for each figure; return when the last one is closed.

    Raises
    ------
    UsageError
        There is no display, or no toolkit that opens windows is installed.
    """
    require_display()
    with styled():
        from matplotlib import pyplot

        _switch_to_windows()
        for plot in plots:
            width, height = plot.size[0], plot.size[1] + plot.head
            figure = pyplot.figure(
                plot.title, figsize=(SCALE * width, SCALE * height), layout="tight"
            )
            plot.paint(figure.add_subplot())
        pyplot.show(block=True)
        pyplot.close("all")


def _switch_to_windows() -> None:
    """Choose the first toolkit that is installed."""
    from matplotlib import pyplot

    toolkits = ("macosx",) if sys.platform == "darwin" else TOOLKITS
    for toolkit in toolkits:
        try:
            pyplot.switch_backend(toolkit)
        except ImportError:
            continue
        return
    raise UsageError(
        "`show`: nothing that opens windows is installed for matplotlib (pip install PyQt6; `figures` DIR "
        "writes files)"
    )
