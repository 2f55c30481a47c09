"""docs/api.md is made from the docstrings of today, and these explain every public parameter."""

from __future__ import annotations

import importlib.util
import inspect
import re
from pathlib import Path
from typing import Any

import pytest

import dbo_cli

DOCS = Path(__file__).resolve().parents[2] / "docs"
spec = importlib.util.spec_from_file_location(
    "make_api_page", DOCS / "make_api_page.py"
)
assert spec is not None and spec.loader is not None
make_api_page = importlib.util.module_from_spec(spec)
spec.loader.exec_module(make_api_page)

CALLED = {name: getattr(dbo_cli, name) for name in make_api_page.FUNCTIONS} | {
    f"{one.__name__}.{key}": value
    for one in (dbo_cli.Model, dbo_cli.ModelSet, *make_api_page.RETURNED)
    for key, value in vars(one).items()
    if inspect.isfunction(value) and not key.startswith("_")
}


def explained(text: str) -> set[str]:
    """Return the names that the sections on parameters and attributes of a docstring explain."""
    found = [
        name.partition(" : ")[0].replace("*", "").split(", ")
        for title, body in make_api_page.sections(text)
        if title in ("Parameters", "Attributes")
        for name, meaning in make_api_page.entries(body)
        if meaning
    ]
    return {name for names in found for name in names}


def test_the_page_is_up_to_date() -> None:
    assert make_api_page.PAGE.read_text(encoding="utf-8") == make_api_page.page(), (
        "run docs/make_api_page.py"
    )


def test_every_public_name_is_on_the_page() -> None:
    page = make_api_page.page()
    for name in set(dbo_cli.__all__) - {"__version__"}:
        assert re.search(rf"^### {name}$|^\| `{name}` \|", page, re.MULTILINE), name


@pytest.mark.parametrize("name", CALLED)
def test_every_parameter_is_explained(name: str) -> None:
    called: Any = CALLED[name]
    text = inspect.getdoc(called) or ""
    wanted = set(inspect.signature(called).parameters) - {"self"}
    assert text and wanted - explained(text) == set()


@pytest.mark.parametrize("record", make_api_page.RECORDS, ids=lambda one: one.__name__)
def test_every_further_keyword_is_explained(record: Any) -> None:
    assert set(inspect.signature(record).parameters) == explained(
        inspect.getdoc(record) or ""
    )
