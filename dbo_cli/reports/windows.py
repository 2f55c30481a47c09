"""Figures in matplotlib's own windows, to zoom in and move about; files are drawn in ``drawing``."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

from dbo_cli.errors import UsageError
from dbo_cli.reports.drawing import Plot, styled

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
