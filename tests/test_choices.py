"""docs/choices.md: the constants that it explains are those of the code, with these values."""

from __future__ import annotations

import ast
import importlib
import itertools
import re
from pathlib import Path

import pytest

pytestmark = pytest.mark.whole
ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "choices.md"


def entries() -> list[tuple[str, str, str]]:
    """Return module, names and value of each constant of the page."""
    found = []
    for part in PAGE.read_text(encoding="utf-8").split("\n## ")[1:]:
        path, _, text = part.partition("\n")
        module = path.removesuffix(".py").replace("/", ".")
        for names, value in re.findall(
            r"^\*\*`([^`]+)`\s=\s`([^`]+)`\.\*\*", text, re.MULTILINE
        ):
            found.append((module, names, " ".join(value.split())))
    return found


ENTRIES = entries()


def test_the_page_is_read_whole() -> None:
    assert len(ENTRIES) == PAGE.read_text(encoding="utf-8").count("\n**`") > 50


@pytest.mark.parametrize(("module", "names", "value"), ENTRIES)
def test_a_constant_has_the_value_that_the_page_explains(
    module: str, names: str, value: str
) -> None:
    space = vars(importlib.import_module(module))
    assert eval(names, dict(space)) == eval(value, dict(space))


def explained(path: Path) -> list[str]:
    """Return the names of a module's constants whose docstring points to the page."""
    body = ast.parse(path.read_text(encoding="utf-8")).body
    names = []
    for constant, behind in itertools.pairwise(body):
        if isinstance(constant, ast.Assign) and isinstance(behind, ast.Expr):
            if "docs/choices.md" in " ".join(
                str(ast.literal_eval(behind.value)).split()
            ):
                names.append(ast.unparse(constant.targets[0]).strip("()"))
    return names


def test_who_points_to_the_page_is_on_it() -> None:
    pointing = []
    for path in (ROOT / "dbo_cli").rglob("*.py"):
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        pointing += [(module, names) for names in explained(path)]
    assert sorted(pointing) == sorted((module, names) for module, names, _ in ENTRIES)
