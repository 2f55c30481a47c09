"""Matplotlib as this program needs it: the same on every machine, and silent about where it runs."""

from __future__ import annotations

import contextlib
import functools
import logging
import os
import sys
import tempfile
import warnings
from collections.abc import Iterator
from typing import TYPE_CHECKING

from dbo_cli.logs.plain_text import cleaned

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Left alone: what the host has chosen for its own windows.
_OF_THE_HOST = ("backend", "backend_fallback", "interactive", "toolbar", "webagg.", "timezone")
# Installed fonts to try for what the shipped one lacks: those of the systems, and the free ones.
_MORE_FONTS = (
    "Noto Sans CJK JP", "Noto Sans JP", "Hiragino Sans", "Yu Gothic", "MS Gothic", "IPAexGothic",
    "IPAGothic", "VL Gothic", "TakaoPGothic", "PingFang SC", "Microsoft YaHei", "SimHei",
    "Noto Sans CJK SC", "WenQuanYi Zen Hei", "Apple SD Gothic Neo", "Malgun Gothic", "NanumGothic",
    "Arial Unicode MS", "Noto Sans", "Segoe UI", "Leelawadee UI", "Noto Sans Devanagari", "Noto Sans Thai",
)  # fmt: skip


@functools.cache
def load() -> None:
    """Import matplotlib, unless a host program has done so already.

    A notebook sets MPLBACKEND to a module that need not be installed here; this program draws into memory
    and needs no window. Where its configuration cannot be written, matplotlib complains in three lines and
    may leave a folder behind; here it gets a folder of its own, for as long as it looks for fonts.
    """
    if "matplotlib" in sys.modules:
        return
    wanted = {name: os.environ.pop(name, None) for name in ("MPLBACKEND", "MPLCONFIGDIR")}
    log = logging.getLogger("matplotlib")
    level = log.level
    log.setLevel(logging.CRITICAL)
    try:
        with contextlib.ExitStack() as stack:
            folder = wanted["MPLCONFIGDIR"]
            if not all(_is_writable(path) for path in _configuration_folders(folder)):
                folder = stack.enter_context(tempfile.TemporaryDirectory(ignore_cleanup_errors=True))
            if folder is not None:
                os.environ["MPLCONFIGDIR"] = folder
            import matplotlib
            import matplotlib.font_manager
    finally:
        log.setLevel(level)
        os.environ.pop("MPLCONFIGDIR", None)
        os.environ.update({name: value for name, value in wanted.items() if value is not None})
    with contextlib.suppress(ValueError):  # what the host wants for its own figures, where that exists
        if wanted["MPLBACKEND"]:
            matplotlib.rcParams["backend"] = wanted["MPLBACKEND"]


def _configuration_folders(named: str | None) -> list[str]:
    """Return where matplotlib keeps its configuration and its list of fonts, as its manual says."""
    home = os.path.expanduser("~")
    if named:
        return [named]
    if not sys.platform.startswith(("linux", "freebsd")):
        return [os.path.join(home, ".matplotlib")]
    return [
        os.path.join(os.environ.get(variable) or os.path.join(home, usual), "matplotlib")
        for variable, usual in (("XDG_CONFIG_HOME", ".config"), ("XDG_CACHE_HOME", ".cache"))
    ]


def _is_writable(folder: str) -> bool:
    """Make a folder where it is missing, and tell whether files can be written there."""
    try:
        os.makedirs(folder, exist_ok=True)
    except (OSError, ValueError):
        return False
    return os.access(folder, os.W_OK)


@contextlib.contextmanager
def style(settings: dict[str, object]) -> Iterator[None]:
    """Draw with matplotlib's defaults and ``settings``, whatever the user's own configuration says."""
    load()
    from matplotlib import rc_context, rcParamsDefault

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # settings that a later release of matplotlib gives up
        defaults = {key: value for key, value in rcParamsDefault.items() if not key.startswith(_OF_THE_HOST)}
        with rc_context({**defaults, **settings}):
            yield


def show_plainly(figure: Figure, *, as_outlines: bool) -> None:
    """Clean all texts of a figure; as outlines, keep what the fonts at hand can draw.

    Letters that the shipped font lacks are taken from an installed one; what no font has becomes a box. Text
    that stays text is left to the fonts of whoever shows it.
    """
    from matplotlib.text import Text

    for text in figure.findobj(Text):
        shown = cleaned(text.get_text())
        if as_outlines and not shown.isascii():
            missing = _missing(shown, "DejaVu Sans")
            if missing:
                family = _family_for("".join(sorted(missing)))
                text.set_fontfamily(["DejaVu Sans", *family])
                for name in family:
                    missing = {sign for sign in missing if _missing(sign, name)}
                shown = "".join("□" if sign in missing else sign for sign in shown)
        if shown != text.get_text():
            text.set_text(shown)


@functools.cache
def _family_for(signs: str) -> list[str]:
    """Return an installed font that has all of ``signs``, or the one that has most of them."""
    from matplotlib.font_manager import fontManager

    installed = {font.name for font in fontManager.ttflist}
    found = [(len(_missing(signs, name)), name) for name in _MORE_FONTS if name in installed]
    fewest = min(found, default=(len(signs), ""), key=lambda pair: pair[0])
    return [fewest[1]] if fewest[0] < len(signs) else []


def _missing(signs: str, font: str) -> set[str]:
    """Return the characters that a font has no shape for."""
    known = _shapes(font)
    return {sign for sign in signs if ord(sign) not in known and sign != "\n"}


@functools.cache
def _shapes(font: str) -> frozenset[int]:
    from matplotlib.font_manager import FontProperties, findfont, get_font

    return frozenset(get_font(findfont(FontProperties(family=[font]))).get_charmap())
