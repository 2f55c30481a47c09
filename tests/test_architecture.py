"""docs/architecture.md: the two walks are what the program does, in that order."""

from __future__ import annotations

import ast
import re
import sys
from pathlib import Path
from types import FrameType

import pytest

import dbo_cli
from dbo_cli.cli.app import main

pytestmark = pytest.mark.whole
ROOT = Path(__file__).resolve().parent.parent
PACKAGE = Path(dbo_cli.__file__).parent
Step = tuple[str, str]


def walk(command: str) -> list[Step]:
    """Return file and function of each line of a command's walk."""
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    screen = re.search(
        rf"### `{command}` on one screen\n.*?```text\n(.*?)```", page, re.DOTALL
    )
    assert screen is not None
    lines = [line.split() for line in screen[1].splitlines()]
    return [(words[0], words[1]) for words in lines]


def calls_of(words: list[str]) -> list[Step]:
    """Run a command line and return its functions, each where it is first called."""
    calls: dict[Step, None] = {}

    def note(frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(str(PACKAGE)):
            file = Path(code.co_filename).relative_to(PACKAGE).as_posix()
            calls.setdefault((file, code.co_qualname))

    sys.setprofile(note)
    try:
        assert main(words) == 0
    finally:
        sys.setprofile(None)
    return list(calls)


def in_order(steps: list[Step], calls: list[Step]) -> None:
    places = [calls.index(step) for step in steps]
    assert places == sorted(places)
    assert len({file for file, _ in steps}) <= 16


def test_the_walks_are_what_the_commands_do(tmp_path: Path) -> None:
    model = str(tmp_path / "model.json")
    log = str(ROOT / "sample_data" / "identification.csv")
    trajectory = str(ROOT / "sample_data" / "trajectory.csv")
    in_order(
        walk("identify"), calls_of(["identify", log, "--rows", "1:2400", "-o", model])
    )
    drive = str(tmp_path / "drive.csv")
    in_order(
        walk("compensate"), calls_of(["compensate", model, trajectory, "-o", drive])
    )


def test_the_story_of_identify_is_quoted_as_it_stands() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    screen = re.search(r"### `identify` on.*?```python\n(.*?)```", page, re.DOTALL)
    assert screen is not None
    quoted = screen[1].splitlines()
    file = PACKAGE / "hysteresis" / "identification" / "identify.py"
    lines = file.read_text(encoding="utf-8").splitlines()
    assert len(quoted) == 8
    assert [line for line in lines if line in quoted] == quoted


def names_of(path: Path) -> set[str]:
    """Return what a file defines: functions, classes, their methods and fields, constants."""
    names = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        if isinstance(node, ast.ClassDef):
            for part in ast.walk(node):
                if isinstance(part, ast.FunctionDef):
                    names.add(f"{node.name}.{part.name}")
                elif isinstance(part, ast.AnnAssign):
                    names.add(f"{node.name}.{ast.unparse(part.target)}")
        if isinstance(node, ast.Assign):
            names.update(ast.unparse(target) for target in node.targets)
        if isinstance(node, ast.AnnAssign):
            names.add(ast.unparse(node.target))
    return names


def test_the_names_in_the_text_are_those_of_the_code() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    text = re.sub(r"```.*?```", "", page, flags=re.DOTALL)
    names = {}
    for path in PACKAGE.rglob("*.py"):
        place = path.relative_to(PACKAGE).with_suffix("").as_posix()
        names[place] = names_of(path)
    everywhere = set().union(*names.values())
    unknown = []
    for word in re.findall(r"`([\w/.]+)`", text):
        place, _, name = word.partition(".")
        if "/" in place and name not in (
            "",
            "py",
            "md",
        ):  # `drives/gate.DriveGate.admit`
            known = any(name in names[file] for file in names if file.endswith(place))
        elif re.fullmatch(r"[A-Z]\w*[a-z]\w*\.\w+", word):  # `DriveGate.admit`
            known = word in everywhere
        elif "/" in place:  # `drives/gate`, `runs/`, `tests/test_rooms.py`
            inside = any(f"/{place.rstrip('/')}" in f"/{file}" for file in names)
            known = inside or (ROOT / word).exists()
        else:
            continue
        if not known:
            unknown.append(word)
    assert unknown == []
