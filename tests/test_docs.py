"""The pages for people hold: the Python page runs as it stands there, links lead somewhere, names exist."""

from __future__ import annotations

import ast
import contextlib
import io
import itertools
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import dbo_cli as dbo
from dbo_cli import __version__
from dbo_cli.cli.app import main

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
PAGES = [*sorted(DOCS.glob("*.md")), ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
NUMBER = re.compile(r"(?<![\w.])-?\d[\d,]*(?:\.\d+)?(?:e[-+]?\d+)?")
FENCED = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def steps(page: str) -> Iterator[tuple[int, str, str]]:
    """Return the line, the code and the output shown of every Python block of a page."""
    blocks = list(FENCED.finditer(page))
    for place, block in enumerate(blocks):
        if block[1] == "python":
            shown = blocks[place + 1] if place + 1 < len(blocks) else None
            expected = shown[2] if shown is not None and shown[1] == "text" else ""
            yield page.count("\n", 0, block.start()) + 2, block[2], expected


def differs(shown: str, printed: str) -> bool:
    """Tell whether what was printed is not what is shown.

    Numbers with a fraction may differ by one in the last digit that is shown: a
    library's sums differ in their last bits from machine to machine.
    """
    if NUMBER.sub("#", shown) != NUMBER.sub("#", printed):
        return True
    for one, other in zip(NUMBER.findall(shown), NUMBER.findall(printed), strict=True):
        decimals = len(one.partition(".")[2])
        step = 10.0**-decimals if decimals and "e" not in one else 0.0
        if (
            abs(float(one.replace(",", "")) - float(other.replace(",", "")))
            > 1.001 * step
        ):
            return True
    return False


@pytest.mark.whole
@pytest.mark.usefixtures("identified_once")
def test_the_python_page_runs_as_it_stands_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("identification.csv", "trajectory.csv"):
        shutil.copy(ROOT / "sample_data" / name, tmp_path)
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    blocks = list(steps((DOCS / "python.md").read_text(encoding="utf-8")))
    assert len(blocks) > 12
    for line, code, shown in blocks:
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec(compile("\n" * (line - 1) + code, "docs/python.md", "exec"), names)
        assert not differs(shown, printed.getvalue()), (
            f"docs/python.md:{line}:\n{printed.getvalue()}"
        )


def test_what_is_shown_may_differ_in_its_last_digit_alone() -> None:
    assert not differs("fit 0.006 um\n", "fit 0.007 um\n")
    assert differs("fit 0.006 um\n", "fit 0.008 um\n")
    assert differs("64 gears\n", "65 gears\n")
    assert differs("64 gears\n", "64 wheels\n")


@pytest.mark.whole
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if target.startswith(("http://", "https://")):
            continue
        name, _, anchor = target.partition("#")
        file = page.parent / name if name else page
        assert file.exists(), f"{page.name}: {target}"
        if anchor:
            headings = re.findall(
                r"^#+ (.*)$", file.read_text(encoding="utf-8"), re.MULTILINE
            )
            known = {
                re.sub(r"[^\w\- ]", "", one.lower()).replace(" ", "-")
                for one in headings
            }
            assert anchor in known, f"{page.name}: {target}"


def test_the_version_stands_everywhere_alike() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))[
        "project"
    ]
    assert project["version"] == __version__
    for name in ("CITATION.cff", "packaging/recipe.yaml"):
        text = (ROOT / name).read_text(encoding="utf-8")
        assert re.findall(r"^ *version: (\d.*)$", text, re.MULTILINE) == [
            __version__
        ], name


def test_the_conda_recipe_asks_for_what_the_package_needs() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))[
        "project"
    ]
    needs = {"python" + project["requires-python"], *project["dependencies"]}
    recipe = (ROOT / "packaging" / "recipe.yaml").read_text(encoding="utf-8")
    run = recipe.partition("\n  run:\n")[2].partition("\n\n")[0]
    asked = {
        line.strip("- ").replace(" ", "").replace("matplotlib-base", "matplotlib")
        for line in run.split("\n")
    }
    assert asked == needs


@pytest.mark.whole
def test_files_that_the_architecture_names_are_there() -> None:
    text = (DOCS / "architecture.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`((?:\w+/)*\w+(?:\.\w+)*\.(?:py|md|json|toml))`", text))
    places = [
        ROOT,
        DOCS,
        ROOT / "dbo_cli",
        *(one for one in (ROOT / "dbo_cli").rglob("*") if one.is_dir()),
    ]
    assert len(named) >= 15
    assert {
        name for name in named if not any((place / name).exists() for place in places)
    } == set()


def uncommented(path: Path) -> Iterator[str]:
    """Yield the constants of a module (numbers but 0 and 1; no tables) no word beside, above, below."""
    text = path.read_text(encoding="utf-8")
    lines, body = text.splitlines(), ast.parse(text).body
    for node, after in itertools.zip_longest(body, body[1:]):
        if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
            continue
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        names = [
            part.id
            for one in targets
            for part in ast.walk(one)
            if isinstance(part, ast.Name)
        ]
        found = [
            part.value
            for part in ast.walk(node.value)
            if isinstance(part, ast.Constant)
        ]
        numbers = [
            value
            for value in found
            if type(value) in (int, float) and value not in (0, 1)
        ]
        if (
            not all(map(str.isupper, names))
            or not numbers
            or any(isinstance(one, str) for one in found)
        ):
            continue
        has_word = "#" in "".join(lines[node.lineno - 1 : node.end_lineno])
        has_word |= lines[node.lineno - 2].startswith("#")
        if not has_word and not (
            isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
        ):
            yield f"{path}:{node.lineno}: {', '.join(names)}"


def uncommented_in_c(path: Path) -> Iterator[str]:
    """Yield the defines of a C file (numbers but 0 and 1) with no word beside them, or above their group."""
    lines = ["", *path.read_text(encoding="utf-8").splitlines()]
    for number, line in enumerate(lines):
        found = re.match(r"#define (\w+) ([^/]*)(/\*)?", line)
        if (
            not found
            or found[3]
            or set(re.findall(r"(?<![\w.])\d[\w.+-]*", found[2])) <= {"0", "1"}
        ):
            continue
        above = next(
            before
            for before in reversed(lines[:number])
            if not before.startswith("#define")
        )
        if not above.endswith("*/"):
            yield f"{path}:{number}: {found[1]}"


def test_every_constant_says_where_it_comes_from(tmp_path: Path) -> None:
    bare = tmp_path / "bare.py"
    bare.write_text(
        "WIDE, TALL = 5.0, 4.0  # inches\nFEW = 3\n\nMANY: int = 30\n\n# rows\nMOST = 300\n"
    )
    assert [one.split(":")[-2:] for one in uncommented(bare)] == [
        ["2", " FEW"],
        ["4", " MANY"],
    ]
    assert [
        one for path in (ROOT / "dbo_cli").rglob("*.py") for one in uncommented(path)
    ] == []
    bare = tmp_path / "bare.c"
    bare.write_text(
        "#define FEW 3\n#define NAMED other2\n#define BEYOND (1.0e300 * 2.0)\n#define ONE 1\n"
        "#define MANY 30 /* rows */\n\n/* Two\n * lines. */\n#define HIGH 4\n#define WIDE (1 << 60)\n"
    )
    assert [one.split(":")[-2:] for one in uncommented_in_c(bare)] == [
        ["1", " FEW"],
        ["3", " BEYOND"],
    ]
    sources = [
        path for ending in ("*.c", "*.h") for path in (ROOT / "dbo_cli").rglob(ending)
    ]
    assert [one for path in sources for one in uncommented_in_c(path)] == []


def test_the_readme_is_read_in_five_minutes() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").split()) <= 900


MISTAKES = {
    "scope.csv": "identify scope.csv",
    "noclock.csv": "identify noclock.csv",
    "ms.csv": "identify ms.csv",
    "tenth.csv": "identify tenth.csv --v-min 0 --v-max 100",
    "junk.csv": "identify junk.csv",
    "minus.csv": "identify minus.csv --sign rising",
    "big.csv": "compensate model.json big.csv",
    "trajectory.csv": "compensate model.json trajectory.csv",
    "played.csv": "check played.csv --against drive.csv",
    "drive.csv": "report drive.csv",
}
"""The ten mistakes of docs/questions.md in the order of the page, each with its command."""


def write_mistakes(folder: Path) -> None:
    """Write the logs of the ten mistakes, made of the sample data."""
    header = "time_s,voltage_V,displacement_um"
    log = np.loadtxt(
        ROOT / "sample_data" / "identification.csv", delimiter=",", skiprows=1
    )
    move = np.loadtxt(
        ROOT / "sample_data" / "trajectory.csv", delimiter=",", skiprows=1
    )
    noise = np.random.default_rng(5).uniform(0.0, 10.0, len(log))
    tables = {
        "scope.csv": ("time_s,CH1 (V),CH2 (V)", log),
        "noclock.csv": ("voltage_V,displacement_um", log[:, 1:]),
        "ms.csv": ("time,voltage_V,displacement_um", log * [1000.0, 1.0, 1.0]),
        "tenth.csv": (header, log * [1.0, 0.1, 1.0]),
        "junk.csv": (header, np.column_stack((log[:, :2], noise))),
        "minus.csv": (header, log * [1.0, 1.0, -1.0]),
        "big.csv": ("time_s,displacement_um", move * [1.0, 1.4]),
        "trajectory.csv": ("time_s,displacement_um", move),
    }
    for name, (names, table) in tables.items():
        np.savetxt(
            folder / name, table, delimiter=",", header=names, comments="", fmt="%.9g"
        )


@pytest.mark.whole
def test_the_ten_mistakes_print_what_the_page_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = (DOCS / "questions.md").read_text(encoding="utf-8")
    shown = re.findall(r"^ {8}(dbo: .*)$", page, re.MULTILINE)
    assert len(shown) == len(MISTAKES)
    monkeypatch.chdir(tmp_path)
    write_mistakes(tmp_path)
    sample = ROOT / "sample_data" / "identification.csv"
    assert main(["identify", str(sample), "-o", "model.json", "-q"]) == 0
    assert (
        main(["compensate", "model.json", "trajectory.csv", "-o", "drive.csv", "-q"])
        == 0
    )
    rows = Path("drive.csv").read_text().splitlines()
    cells = [row.split(",") for row in rows[1:]]
    louder = [
        f"{time},{wanted},{float(volts) * 1.02!r}" for time, wanted, volts in cells
    ]
    Path("played.csv").write_text("\n".join([rows[0], *louder]) + "\n")
    for line, command in zip(shown, MISTAKES.values(), strict=True):
        capsys.readouterr()
        endings = {
            "identify": "json",
            "compensate": "csv",
            "check": "txt",
            "report": "txt",
        }
        main([*command.split(), "-o", f"out.{endings[command.split()[0]]}"])
        printed = capsys.readouterr().err.splitlines()
        masked = [NUMBER.sub("#", text) for text in printed]
        assert NUMBER.sub("#", line) in masked, "\n".join([command, line, *printed])


@pytest.mark.usefixtures("identified_once")
def test_the_picture_shows_the_numbers_of_the_demo(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """``make picture`` draws docs/demo.png; its description holds the errors that stand in it."""
    data = ROOT / "sample_data"
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.stderr", io.StringIO())
    assert main(["identify", str(data / "identification.csv"), "-o", "model.json"]) == 0
    assert (
        main(
            [
                "compensate",
                "model.json",
                str(data / "trajectory.csv"),
                "-o",
                "drive.csv",
            ]
        )
        == 0
    )
    straight_line = (str(data / "identification.csv"), str(data / "trajectory.csv"))
    subprocess.run(
        [sys.executable, data / "straight_line.py", *straight_line, "-o", "line.csv"],
        check=True,
    )
    drives = (("line.csv", "1", "before.csv"), ("drive.csv", "2", "after.csv"))
    for drive, seed, log in drives:
        bench = [
            sys.executable,
            data / "virtual_actuator.py",
            drive,
            "--seed",
            seed,
            "-o",
            log,
        ]
        subprocess.run(bench, check=True)
    errors = dbo.report(["before.csv", "after.csv"]).to_frame()["rmse"]
    before, after = (f"{one:.2g} µm RMSE" for one in errors)
    picture = (ROOT / "docs" / "demo.png").read_bytes()
    shown = re.search(rb"tEXtDescription\0(.*?RMSE; .*? RMSE)", picture)
    assert shown is not None
    assert (
        shown[1].decode("latin-1")
        == f"straight-line drive: {before}; compensated by dbo: {after}"
    )


@pytest.mark.whole
def test_every_benchmark_is_named_on_their_page() -> None:
    folder = ROOT / "benchmarks"
    named = set(
        re.findall(
            r"`(\w+\.py|attack/)`", (folder / "README.md").read_text(encoding="utf-8")
        )
    )
    programs = {path.name for path in folder.glob("*.py")}
    assert named == programs | {"attack/"}
