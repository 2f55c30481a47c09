"""The look of every figure, in one place: sizes, colours, lines. Needs no drawing library.

The two colours of a comparison differ in lightness as well as in hue (they survive a grey print and the
common colour blindnesses), and in the pattern of the line. ``SCHEME`` names the variable that stands for
each colour where a page brings its own light and dark values.
"""

from __future__ import annotations

from typing import Any

INK = "#1b1d22"
MUTED = "#5d646f"
RULE = "#d5d9df"
FIRST = "#00508f"
SECOND = "#e0751a"
FILL = "#7fa8cc"

THIRD = "#1b7f5c"
FOURTH = "#9c4697"
FIFTH = "#8a6d00"

SCHEME = {
    INK: "ink",
    MUTED: "muted",
    RULE: "rule",
    FIRST: "first",
    SECOND: "second",
    THIRD: "third",
    FOURTH: "fourth",
    FIFTH: "fifth",
    FILL: "fill",
}

SOLID: dict[str, Any] = {"color": FIRST, "linestyle": "-", "linewidth": 1.3}
DASHED: dict[str, Any] = {"color": SECOND, "linestyle": (0, (3.2, 1.4)), "linewidth": 1.3}
ALONE: dict[str, Any] = {"color": INK, "linestyle": "-", "linewidth": 0.9}
SEVERAL: tuple[dict[str, Any], ...] = tuple(
    {"color": color, "linestyle": "-", "linewidth": 0.9}
    for color in (SECOND, FIRST, THIRD, FOURTH, FIFTH, INK)
)
HIGH_DPI = 220

WIDE = (5.0, 2.8)
TALL = (5.0, 4.0)

RC: dict[str, object] = {
    "text.parse_math": False,  # a dollar in a name or a unit is a dollar
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "axes.labelsize": 9.0,
    "axes.labelcolor": INK,
    "axes.edgecolor": MUTED,
    "axes.linewidth": 0.7,
    "axes.facecolor": "none",
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.xmargin": 0.01,
    "axes.ymargin": 0.04,
    "axes.unicode_minus": True,
    "grid.color": RULE,
    "grid.linewidth": 0.6,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.major.size": 3.0,
    "ytick.major.size": 3.0,
    "xtick.minor.size": 0.0,
    "ytick.minor.size": 0.0,
    "text.color": INK,
    "legend.frameon": False,
    "legend.fontsize": 9.0,
    "legend.handlelength": 2.2,
    "legend.borderaxespad": 0.0,
    "lines.solid_capstyle": "round",
    "lines.dash_capstyle": "butt",
    "path.simplify": True,
    "path.simplify_threshold": 0.2,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "savefig.dpi": HIGH_DPI,
    "svg.hashsalt": "dbo",
    "svg.fonttype": "path",
}
