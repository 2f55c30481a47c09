"""The man pages in docs/man are those of today's options, and troff has nothing against them."""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
from pathlib import Path

import pytest

from dbo_cli.cli import commands

DOCS = Path(__file__).resolve().parent.parent / "docs"
spec = importlib.util.spec_from_file_location(
    "make_man_pages", DOCS / "make_man_pages.py"
)
assert spec is not None and spec.loader is not None
make_man_pages = importlib.util.module_from_spec(spec)
spec.loader.exec_module(make_man_pages)


@pytest.mark.whole
def test_the_pages_are_up_to_date() -> None:
    kept = {
        path.name: path.read_text(encoding="utf-8") for path in (DOCS / "man").iterdir()
    }
    assert kept.keys() == {"dbo.1", *(f"dbo-{name}.1" for name in commands.names())}
    assert kept == make_man_pages.pages(), "run docs/make_man_pages.py"


def test_what_troff_would_obey_is_printed() -> None:
    assert (
        make_man_pages.roff(".so x\n'quoted' -a \\n")
        == "\\&.so x\n\\&'quoted' \\-a \\en"
    )


@pytest.mark.skipif(shutil.which("groff") is None, reason="groff is not here")
def test_a_page_reads_as_it_should() -> None:
    words = [
        "groff",
        "-man",
        "-Tascii",
        "-P-c",
        "-ww",
        "-rLL=90n",
        str(DOCS / "man" / "dbo-identify.1"),
    ]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert done.stderr == ""
    page = " ".join(
        subprocess.run(
            ["col", "-b"], input=done.stdout, capture_output=True, text=True, check=True
        ).stdout.split()
    )
    assert "dbo-identify - Identify a model of an actuator from logs" in page
    assert "SYNOPSIS dbo identify [OPTIONS] LOG... DESCRIPTION" in page
    assert (
        "--gears N|auto Gears: steps into which the loop is cut; more are finer" in page
    )
    assert "EXIT STATUS 0 Done; also when the reader of a pipe leaves early." in page
