"""Make the man pages, docs/man/*.1, from the tables that ``--help`` is made from.

    python docs/make_man_pages.py

The wheel installs them under share/man/man1. tests/test_man_pages.py holds that they
are up to date.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from dbo_cli.cli import commands
from dbo_cli.cli.commands import EXIT_CODES, Command
from dbo_cli.cli.typer_adapter import root_command
from dbo_cli.version import __version__

FOLDER = Path(__file__).resolve().parent / "man"
MISSED = ("3", "Computed, but outside a limit that was set.")
FILES = """Logs are text of any dialect, HDF5 and what else docs/instruments-formats.md lists; FILE::/group
names a part of an HDF5 file. Models and states are JSON, docs/model-file.md. Every output appears whole or
not at all."""


def roff(text: str) -> str:
    """Return a text that troff prints as it is."""
    escaped = text.replace("\\", "\\e").replace("-", "\\-")
    return "\n".join(
        "\\&" + line if line[:1] in (".", "'") else line for line in escaped.split("\n")
    )


def paragraphs(text: str) -> str:
    """Return paragraphs that are divided by empty lines."""
    return "\n.PP\n".join(roff(" ".join(one.split())) for one in text.split("\n\n"))


def listed(rows: list[tuple[str, str]]) -> str:
    """Return terms and what they mean."""
    return "\n".join(f".TP\n.B {roff(term)}\n{roff(meaning)}" for term, meaning in rows)


def examples(command: Command) -> str:
    """Return the examples of a command."""
    return "\n".join(
        f".PP\n{roff(purpose)}\n.PP\n.nf\n.RS\n{roff(line)}\n.RE\n.fi"
        for purpose, line in command.examples
    )


def page(name: str, heading: str, parts: list[tuple[str, str]]) -> str:
    """Return a page of some sections; it names no day, so that the same program gives the same bytes."""
    title = name.replace(" ", "-")
    sections = "".join(f".SH {title}\n{text}\n" for title, text in parts if text)
    about = f".SH NAME\n{roff(title)} \\- {roff(heading)}\n"
    return f'.TH {roff(title.upper())} 1 "" "dbo {__version__}" "dbo"\n.ad l\n.nh\n{about}{sections}'


def also(name: str) -> str:
    """Return the other pages."""
    titles = ["dbo", *(f"dbo-{one}" for one in commands.names())]
    return ",\n".join(f".BR {roff(one)} (1)" for one in titles if one != name)


def command_page(name: str, command: Command) -> str:
    """Return the page of a command."""
    heading, _, text = command.section().partition("\n")
    context: Any = root_command().make_context("dbo", [], resilient_parsing=True)
    built: Any = root_command().get_command(context, name)
    inner = built.make_context(name, [], parent=context, resilient_parsing=True)
    arguments = " ".join(
        f"{one.metavar}{'...' if one.repeated else ''}"
        for one in command.options
        if not one.names
    )
    parts = [("SYNOPSIS", f".B dbo {name}\n[OPTIONS] {roff(arguments)}".rstrip())]
    parts += [("DESCRIPTION", paragraphs(text.strip() or heading))]
    parts += [("OUTPUT", roff(command.writes)), ("EXAMPLES", examples(command))]
    parts += [(title.upper(), listed(rows)) for title, rows in built.sections(inner)]
    parts += [
        ("EXIT STATUS", listed(command.exit_codes)),
        ("SEE ALSO", also(f"dbo-{name}")),
    ]
    return page(f"dbo {name}", heading.rstrip("."), parts)


def first_page() -> str:
    """Return the page of the program."""
    root: Any = root_command()
    heading, _, text = (root.help or "").partition("\n")
    rows = [(f"dbo {name}", one.summary) for name, one in commands.every().items()]
    codes = sorted([*EXIT_CODES, MISSED], key=lambda code: int(code[0]))
    parts = [
        ("SYNOPSIS", ".B dbo\nCOMMAND [OPTIONS] ..."),
        ("DESCRIPTION", paragraphs(text.strip())),
    ]
    parts += [
        ("COMMANDS", listed(rows)),
        ("FILES", paragraphs(FILES)),
        ("EXIT STATUS", listed(codes)),
    ]
    return page("dbo", heading.rstrip("."), [*parts, ("SEE ALSO", also("dbo"))])


def pages() -> dict[str, str]:
    """Return all pages by the names of their files."""
    made = {"dbo.1": first_page()}
    return made | {
        f"dbo-{name}.1": command_page(name, command)
        for name, command in commands.every().items()
    }


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for file, text in pages().items():
        (FOLDER / file).write_text(text, encoding="utf-8", newline="\n")
