"""The parts of a page without script and without network: its style and its figures are inside it."""

from collections.abc import Sequence
from html import escape
from importlib import resources
from string import Template

from dbo_cli.reports.plots import Plot, image


def framed(parts: Sequence[str]) -> str:
    """Return a page of some parts."""
    folder = resources.files("dbo_cli.reports")
    frame = Template(folder.joinpath("page.html").read_text("utf-8"))
    style = folder.joinpath("page.css").read_text("utf-8")
    return frame.substitute(style=style, body="\n".join(parts))


def paragraph(kind: str, text: str) -> str:
    """Return a paragraph of a kind that the style knows."""
    return f'<p class="{kind}">{escape(text)}</p>'


def table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table whose cells know their heading: a narrow screen shows a row as a card."""
    cells = "".join(f'<th scope="col">{escape(title)}</th>' for title in headings)
    lines = []
    for row in rows:
        line = ""
        for title, cell in zip(headings, row, strict=True):
            line += f'<td data-label="{escape(title)}">{escape(cell)}</td>'
        lines.append(f"<tr>{line}</tr>")
    body = "\n".join(lines)
    return f"<table><thead><tr>{cells}</tr></thead><tbody>\n{body}\n</tbody></table>"


def figures(plots: Sequence[Plot]) -> str:
    """Return figures as part of a page."""
    drawn = []
    for plot in plots:
        caption = f"<figcaption>{escape(plot.title)}</figcaption>"
        drawn.append(f"<figure>{caption}{image(plot)}</figure>")
    return '<div class="figures">' + "\n".join(drawn) + "</div>"
