"""Make what is generated: reference.md, commands.md and man pages, which the site takes along.

    python docs/make_reference.py

The reference is made from the docstrings, the commands from ``--help-all``. Neither is
kept in the repository.
"""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import dbo_cli
from dbo_cli import library
from dbo_cli.cli.app import COMMANDS
from dbo_cli.drive import Drive
from dbo_cli.drive.live import Controller
from dbo_cli.reports import Report

FOLDER = Path(__file__).resolve().parent
MAN = FOLDER / "man"
TITLE = re.compile(r"^(\w[\w ]*)\n-{3,}\n", re.MULTILINE)
FUNCTIONS = (
    library.read_log,
    library.identify,
    library.read_model,
    library.read_models,
    library.report,
)
CLASSES = (library.Model, library.ModelSet, Drive, Controller, Report)


# --- the library ---


def markdown(text: str) -> str:
    """Return a paragraph of a docstring as Markdown."""
    return re.sub(r"``(.+?)``", r"`\1`", text)


def entries(text: str) -> str:
    """Return the entries of a section of a docstring as a list."""
    lines: list[str] = []
    for line in text.splitlines():
        if line and not line.startswith(" "):
            name, _, kind = line.partition(" : ")
            lines.append(f"- `{name}`" + (f" ({kind})" if kind else ""))
        elif line.strip() and lines:
            mark = "" if lines[-1].endswith(":") or ": " in lines[-1] else ":"
            lines[-1] += f"{mark} {line.strip()}"
    return markdown("\n".join(lines))


def described(called: Any) -> str:
    """Return a docstring as Markdown."""
    parts = TITLE.split(inspect.getdoc(called) or "")
    written = [markdown(parts[0].strip())]
    for title, body in zip(parts[1::2], parts[2::2], strict=True):
        written.append(f"**{title}**\n\n{entries(body.strip(chr(10)))}")
    return "\n\n".join(written)


def signature(called: Any, name: str) -> str:
    """Return how something is called; types are in the text."""
    bare = []
    for parameter in inspect.signature(called).parameters.values():
        if parameter.name != "self":
            bare.append(parameter.replace(annotation=inspect.Parameter.empty))
    return f"```python\n{name}{inspect.Signature(bare)}\n```"


def class_part(one: type) -> str:
    """Return the part about a class: what it is, and its methods."""
    parts = [f"## {one.__name__}\n\n{described(one)}"]
    for name, method in vars(one).items():
        if inspect.isfunction(method) and not name.startswith("_"):
            call = signature(method, name)
            parts.append(f"### {one.__name__}.{name}\n\n{call}\n\n{described(method)}")
    return "\n\n".join(parts)


def reference() -> str:
    """Return the page of the library."""
    parts = [
        "# Reference of the library",
        f"`import dbo_cli as dbo`, version {dbo_cli.__version__}. [Python](python.md) shows it at work.",
    ]
    for function in FUNCTIONS:
        name = function.__name__
        call = signature(function, f"dbo.{name}")
        parts.append(f"## {name}\n\n{call}\n\n{described(function)}")
    parts += [class_part(one) for one in CLASSES]
    return "\n\n".join(parts) + "\n"


# --- the commands ---


@cache
def help_text(name: str) -> str:
    """Return what ``dbo NAME --help-all`` prints."""
    words = [sys.executable, "-m", "dbo_cli", name, "--help-all"]
    return subprocess.run(
        words, check=True, capture_output=True, text=True
    ).stdout.strip()


def commands() -> str:
    """Return the page of the commands."""
    parts = ["# Commands", "What `--help-all` prints. `-h` is a screen of the usual."]
    for name in COMMANDS:
        parts.append(f"## dbo {name}\n\n```text\n{help_text(name)}\n```")
    return "\n\n".join(parts) + "\n"


def man_page(name: str) -> str:
    """Return the help of a command as a page for man; it names no day."""
    text = help_text(name).replace("\\", "\\e").replace("-", "\\-")
    lines = [
        "\\&" + line if line[:1] in (".", "'") else line for line in text.split("\n")
    ]
    head = f'.TH DBO\\-{name.upper()} 1 "" "dbo {dbo_cli.__version__}" "dbo"'
    return "\n".join(
        [head, ".SH NAME", f"dbo\\-{name}", ".SH HELP", ".nf", *lines, ".fi", ""]
    )


def main() -> None:
    """Write all of it."""
    (FOLDER / "reference.md").write_text(reference(), encoding="utf-8")
    (FOLDER / "commands.md").write_text(commands(), encoding="utf-8")
    MAN.mkdir(parents=True, exist_ok=True)
    for name in COMMANDS:
        page = MAN / f"dbo-{name}.1"
        page.write_text(man_page(name), encoding="utf-8")


if __name__ == "__main__":
    main()
