"""Make docs/api.md, the reference of the public names, from their docstrings.

    python docs/make_api_page.py

tests/extras/test_api_page.py holds that it is up to date, and that every parameter is
explained.
"""

from __future__ import annotations

import functools
import inspect
import re
from pathlib import Path
from typing import Any

import dbo_cli
from dbo_cli import errors
from dbo_cli.drives.options import DriveOptions
from dbo_cli.extras.live.controller import Controller
from dbo_cli.extras.moves.shapes import TrajectoryOptions
from dbo_cli.hysteresis.identification import IdentificationOptions
from dbo_cli.hysteresis.model_state import Quantity
from dbo_cli.logs.request import ReadingOptions
from dbo_cli.runs.api import Result
from dbo_cli.runs.reporting import TrackingOptions, TrackingReport

PAGE = Path(__file__).resolve().parent / "api.md"
HEAD = """# Reference of the Python API

Made from the docstrings by `python docs/make_api_page.py`; [python.md](python.md) is the walk through it.
The functions are reached as `dbo.NAME` after `import dbo_cli as dbo`, `Model` and the errors, too; the other
objects are what functions and methods return, and the records name the further keywords that these take.
"""
FUNCTIONS = (
    "read_log",
    "identify",
    "read_model",
    "simulate",
    "compensate",
    "report",
    "trajectory",
)
RETURNED = (Controller, Result, TrackingReport, Quantity)
RECORDS = (
    IdentificationOptions,
    DriveOptions,
    ReadingOptions,
    TrackingOptions,
    TrajectoryOptions,
)
TITLE = re.compile(r"^(\w[\w ]*)\n-{3,}\n", re.MULTILINE)


def sections(text: str) -> list[tuple[str, str]]:
    """Return the parts of a numpy docstring by their titles; the first has none."""
    parts = TITLE.split(text)
    return [
        ("", parts[0].strip()),
        *zip(parts[1::2], (one.strip("\n") for one in parts[2::2]), strict=True),
    ]


def entries(text: str) -> list[tuple[str, str]]:
    """Return the entries of a section: the line that names something, and what is indented below it."""
    found: list[tuple[str, str]] = []
    for line in text.splitlines():
        if line and not line.startswith(" "):
            found.append((line.strip(), ""))
        elif line.strip():
            name, meaning = found.pop()
            found.append((name, f"{meaning} {line.strip()}".strip()))
    return found


def markdown(text: str) -> str:
    """Return paragraphs of reStructuredText as Markdown."""
    return re.sub(r"``(.+?)``", r"`\1`", text)


def described(text: str) -> str:
    """Return a docstring as Markdown."""
    written = []
    for title, body in sections(text):
        if not title:
            written.append(markdown(body))
            continue
        lines = []
        for name, meaning in entries(body):
            term, _, kind = name.partition(" : ")
            shown = f"`{term}`" + (f" ({markdown(kind)})" if kind else "")
            lines.append(
                f"- {shown}: {markdown(meaning)}" if meaning else f"- {markdown(name)}"
            )
        written.append(f"**{title}**\n\n" + "\n".join(lines))
    return "\n\n".join(written)


def signature(called: Any, name: str) -> str:
    """Return how something is called, a parameter a line where it is long; types are in the text."""
    bare = [
        one.replace(annotation=inspect.Parameter.empty)
        for one in inspect.signature(called).parameters.values()
        if one.name != "self"
    ]
    line = name + str(inspect.Signature(bare)).replace("'", '"')
    if len(line) > 100:
        inner = line[len(name) + 1 : -1].split(", ")
        line = f"{name}(\n    " + ",\n    ".join(inner) + ",\n)"
    return f"```python\n{line}\n```"


def function_part(called: Any, name: str, level: str = "###") -> str:
    """Return the part about a function or a method."""
    text = described(inspect.getdoc(called) or "")
    return f"{level} {name.rpartition('.')[2]}\n\n{signature(called, name)}\n\n{text}\n"


def record_part(one: type) -> str:
    """Return the part about a record: what it is, and its fields."""
    return f"### {one.__name__}\n\n{described(inspect.getdoc(one) or '')}\n"


def class_part(one: type) -> str:
    """Return the part about a class: what it is, its properties, its methods."""
    parts = [record_part(one)]
    public = {
        key: value
        for base in reversed(one.__mro__)
        if base.__module__.startswith("dbo_cli.")
        for key, value in vars(base).items()
        if not key.startswith("_")
    }
    known = [
        f"- `{key}`: {markdown(' '.join((inspect.getdoc(value) or '').split()))}"
        for key, value in public.items()
        if isinstance(value, property | functools.cached_property)
    ]
    parts += ["**Properties**\n\n" + "\n".join(known) + "\n"] if known else []
    methods = {key: value for key, value in public.items() if inspect.isfunction(value)}
    called = one.__name__.lower()
    parts += [
        function_part(value, f"{called}.{key}", "####")
        for key, value in methods.items()
    ]
    return "\n".join(parts)


def error_rows() -> str:
    """Return a table of the exceptions and the warning."""
    rows = ["| name | exit code | what it is |", "|---|---|---|"]
    for name in dbo_cli.__all__:
        one = getattr(errors, name, None)
        if one is not None:
            code = getattr(one, "exit_code", "")
            rows.append(
                f"| `{name}` | {code} | {markdown((inspect.getdoc(one) or '').partition(chr(10))[0])} |"
            )
    return "\n".join(rows) + "\n"


def page() -> str:
    """Return the page."""
    parts = [HEAD, "## Functions\n"]
    parts += [
        function_part(getattr(dbo_cli, name), f"dbo.{name}") for name in FUNCTIONS
    ]
    parts += ["## Objects\n", class_part(dbo_cli.Model), class_part(dbo_cli.ModelSet)]
    parts += [class_part(one) for one in RETURNED]
    parts += ["## Further keywords\n", *map(record_part, RECORDS)]
    parts += ["## Errors and warnings\n", error_rows()]
    return "\n".join(parts)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8", newline="\n")
