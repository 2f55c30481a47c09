"""The style sheet of the HTML report: light, dark and print, from a phone to a desk.

The variables ``ink`` to ``fill`` are those of ``figure_style.SCHEME``: the figures inside the page follow.
"""

from __future__ import annotations

from dbo_cli.reports import figure_style as style

LIGHT = {name: color for color, name in style.SCHEME.items()} | {
    "page": "#ffffff",
    "panel": "#f5f6f8",
    "image": "none",
}
DARK = {
    "ink": "#e8eaee",
    "muted": "#9aa2ae",
    "rule": "#363c45",
    "first": "#74b4ee",
    "second": "#f2994a",
    "third": "#4cc79b",
    "fourth": "#d48fd0",
    "fifth": "#d2b23c",
    "fill": "#44698f",
    "page": "#14161a",
    "panel": "#1d2026",
    "image": "brightness(1.1)",
}


def style_sheet() -> str:
    """Return the style sheet, the same on every call."""
    sheet = _SHEET.replace("LIGHT", _variables(LIGHT)).replace("DARK", _variables(DARK))
    for table in (".summary", ".segments"):
        sheet = sheet.replace(f"CARDS({table})", _CARDS.replace("TABLE", table))
    return sheet


def _variables(colors: dict[str, str]) -> str:
    return " ".join(f"--{name}: {value};" for name, value in colors.items())


_SHEET = """
:root { color-scheme: light dark; LIGHT }
@media (prefers-color-scheme: dark) { :root { DARK } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--page); color: var(--ink);
  font: 16px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
main { max-width: 76rem; margin: 0 auto; padding: 2rem 1.5rem 3rem; }
h1 { font-size: 1.6rem; line-height: 1.2; margin: 0 0 .4rem; }
h2 { font-size: 1.2rem; line-height: 1.3; margin: 2.4rem 0 .8rem; }
h3 { font-size: 1rem; margin: 1.6rem 0 .5rem; }
p { margin: .4rem 0; max-width: 46rem; }
.muted, figcaption, footer { color: var(--muted); }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; margin: .8rem 0; }
th, td { text-align: right; padding: .35rem .5rem; white-space: nowrap;
  border-bottom: 1px solid var(--rule); }
th { font-weight: 600; color: var(--muted); font-size: .85rem; vertical-align: bottom;
  white-space: normal; }
th:first-child, td:first-child { text-align: left; padding-left: 0; }
td:first-child { white-space: normal; }
.name { white-space: nowrap; }
.chief { font-weight: 700; }
.figures { display: grid; gap: 1.6rem;
  grid-template-columns: repeat(auto-fit, minmax(min(100%, 30rem), 1fr)); }
figure { margin: 0; }
figure svg { display: block; width: 100%; height: auto; max-width: 40rem; }
figure svg image { filter: var(--image); }
figcaption { font-size: .85rem; margin-bottom: .3rem; }
.notes { background: var(--panel); border-left: 3px solid var(--second); padding: .6rem 1rem; }
.notes p { overflow-wrap: anywhere; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .25rem 1.2rem; max-width: 60rem; }
dt { font-weight: 600; }
dd { margin: 0; }
footer { margin-top: 3rem; font-size: .85rem; overflow-wrap: anywhere; }
@media screen and (max-width: 1180px) { CARDS(.summary) }
@media screen and (max-width: 860px) { CARDS(.segments)
  main { padding: 1.2rem 1rem 2rem; }
  .segments tr { display: grid; grid-template-columns: repeat(2, minmax(0, 1fr)); column-gap: 1.4rem; }
  dl { grid-template-columns: 1fr; }
  dd { margin-bottom: .5rem; }
}
@media print {
  :root { color-scheme: light; LIGHT }
  body { font-size: 10pt; }
  main { max-width: none; padding: 0; }
  table { font-size: 7.5pt; }
  th { font-size: 7.5pt; }
  th, td { padding: .25rem .3rem; }
  .figures { grid-template-columns: 1fr 1fr; }
  figure, tr { break-inside: avoid; }
  h2, h3 { break-after: avoid; }
}
"""

# A table that is too wide for the screen: every row becomes a card, every cell knows its heading.
_CARDS = """
  TABLE { display: block; }
  TABLE thead { position: absolute; width: 1px; height: 1px; overflow: hidden; clip-path: inset(50%); }
  TABLE tbody { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(100%, 20rem), 1fr));
    gap: .6rem; }
  TABLE tr, TABLE td { display: block; }
  TABLE tr { border: 1px solid var(--rule); border-radius: 6px; padding: .5rem .8rem; }
  TABLE td { display: flex; justify-content: space-between; flex-wrap: wrap; gap: 0 1rem;
    border: 0; padding: .15rem 0; }
  TABLE td::before { content: attr(data-label); color: var(--muted); }
  TABLE td:first-child { font-weight: 600; display: block; }
  TABLE td:first-child::before { content: none; }
"""
