"""README, pages and ``--help`` held together: what a page shows exists, resolves and runs."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from dbo_cli.cli.app import COMMANDS, program

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
GENERATED = {"commands.md", "reference.md"}  # made by ``make site``
PAGES = sorted(path for path in DOCS.glob("*.md") if path.name not in GENERATED)
TEXTS = [*PAGES, ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
OPTION = re.compile(r"(?<![\w`-])--[a-z][a-z-]+")
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
WITHDRAWN = (
    "--settle --flush --sensor-lag --uncertainty --scale-uncertainty --max-current --capacitance --max-abs "
    "--segment --header --shared-shape --coupling --keep-going --fmu --dwell-left --block-rows --fringes"
).split()
UNEXPLAINED = frozenset(("--help", "--help-all", "--version", "--debug", "--output"))
OTHERS = {"--strict", "--cores", "--config", "--seed"}  # of other programs


def named(path: Path) -> str:
    return path.name


@cache
def options_of(command: str) -> frozenset[str]:
    """Return every option of a command."""
    root: Any = program()
    above = root.make_context("dbo", [], resilient_parsing=True)
    parameters = root.get_command(above, command).get_params(above)
    names = [name for one in parameters for name in one.opts if name.startswith("--")]
    return frozenset(names) | UNEXPLAINED


@cache
def all_options() -> frozenset[str]:
    return frozenset().union(*(options_of(command) for command in COMMANDS))


def blocks(path: Path, language: str) -> list[str]:
    """Return the fenced blocks of a page in a language."""
    return [body for kind, body in FENCE.findall(path.read_text()) if kind == language]


def command_lines(path: Path) -> list[str]:
    """Return every line of a page that calls the program, without its comment."""
    text = re.sub(
        r"^```text\n.*?^```$", "", path.read_text(), flags=re.MULTILINE | re.DOTALL
    )
    text = text.replace("\\\n", " ")
    lines = []
    for line in text.splitlines():
        plain = line.strip().removeprefix("@")
        if plain.startswith("dbo ") and (line.startswith(("    ", "dbo ", "\t"))):
            lines.append(plain.partition("  #")[0])
    return lines


# --- options ---


@pytest.mark.parametrize("path", TEXTS, ids=named)
def test_every_option_of_a_page_exists(path: Path) -> None:
    used = set(OPTION.findall(re.sub(r"`+", " ", path.read_text())))
    assert used - all_options() - OTHERS == set()


@pytest.mark.parametrize("path", TEXTS, ids=named)
def test_every_command_line_has_options_of_its_command(path: Path) -> None:
    for line in command_lines(path):
        parts = [part.strip() for part in re.split(r"\s\|\s", line)]
        for part in parts:
            if not part.startswith("dbo ") or part.split()[1] == "COMMAND":
                continue
            words = shlex.split(part)
            assert words[1] in COMMANDS, line
            typed = {word.split("=")[0] for word in words if word.startswith("--")}
            assert typed <= options_of(words[1]), line


def test_no_withdrawn_option_is_anywhere() -> None:
    assert not set(WITHDRAWN) & all_options()
    for path in TEXTS:
        words = set(re.findall(r"--[a-z][a-z-]+", path.read_text()))
        assert not words & set(WITHDRAWN), path.name


def test_every_option_is_explained_on_some_page() -> None:
    text = "\n".join(path.read_text() for path in TEXTS)
    missing = {option for option in all_options() if option not in text}
    assert missing - UNEXPLAINED == set()


# --- links ---


def anchors(path: Path) -> set[str]:
    """Return the anchors of a page's headings."""
    found = set()
    for heading in re.findall(r"^#+ (.+)$", path.read_text(), re.MULTILINE):
        plain = re.sub(r"[^\w\s-]", "", heading.lower())
        found.add(re.sub(r"[\s-]+", "-", plain).strip("-"))
    return found


@pytest.mark.parametrize("path", TEXTS, ids=named)
def test_links_and_pictures_lead_somewhere(path: Path) -> None:
    for target in LINK.findall(path.read_text()):
        if target.startswith(("http://", "https://")):
            continue
        file, _, anchor = target.partition("#")
        page = path.parent / file if file else path
        if page.name in GENERATED:
            continue
        assert page.exists(), target
        if anchor:
            assert anchor in anchors(page), target


def test_every_figure_is_shown() -> None:
    text = "\n".join(path.read_text() for path in PAGES)
    for figure in (DOCS / "figures").iterdir():
        assert f"figures/{figure.name}" in text


def test_the_first_page_is_short() -> None:
    assert len((ROOT / "README.md").read_text().split()) <= 450


def test_pages_name_no_place_of_a_machine() -> None:
    for path in TEXTS:
        assert not re.search(
            r"(?<![\w.])/(?:work|tmp|root|home|opt)/", path.read_text()
        )


# --- what is shown runs ---


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the sample logs, as the pages want it."""
    folder = tmp_path_factory.mktemp("docs")
    shutil.copytree(ROOT / "sample_data", folder / "sample_data")
    return folder


@pytest.fixture(scope="module")
def environment() -> dict[str, str]:
    """Return an environment in which ``dbo`` and ``python`` are those of the tests."""
    import os

    places = [str(Path(sys.executable).parent), os.environ.get("PATH", "")]
    return {**os.environ, "PATH": os.pathsep.join(places)}


def test_the_tutorial_runs_as_it_stands(
    bench: Path, environment: dict[str, str]
) -> None:
    script = "\n".join(["set -e", *blocks(DOCS / "tutorial.md", "sh")])
    done = subprocess.run(
        ["sh", "-c", script], cwd=bench, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert "<html" in (bench / "bench" / "report.html").read_text()


def test_the_day_of_the_first_page_runs(
    bench: Path, environment: dict[str, str]
) -> None:
    """Run the commands of README, a simulated bench between them."""
    folder = bench / "day"
    folder.mkdir()
    for name in ("identification.csv", "trajectory.csv"):
        shutil.copy(ROOT / "sample_data" / name, folder / name)
    shutil.move(folder / "identification.csv", folder / "recorded.csv")
    play = f"python {ROOT}/sample_data/virtual_actuator.py drive.csv --seed 3 -o"
    for line in command_lines(ROOT / "README.md"):
        words = line.split()
        if words[1] == "COMMAND":
            continue
        if words[1] == "excite":
            line += " --duration 6"
        if words[1] == "check":
            line = f"{play} played.csv && cp played.csv tracked.csv && {line}"
        done = subprocess.run(
            ["sh", "-c", line],
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, f"{line}\n{done.stderr}"
    assert {"model.json", "drive.csv", "report.html"} <= {
        p.name for p in folder.iterdir()
    }


def examples(path: Path) -> list[tuple[str, str | None]]:
    """Return the Python blocks of a page, each with the output that stands behind it."""
    found: list[tuple[str, str | None]] = []
    for kind, body in FENCE.findall(path.read_text()):
        if kind == "python" and "import expand" not in body:
            found.append((body, None))
        elif kind == "text" and found:
            found[-1] = (found[-1][0], body)
    return found


@pytest.mark.filterwarnings("ignore::dbo_cli.DboWarning")
def test_the_page_of_the_library_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for path in (ROOT / "sample_data").glob("*.csv"):
        shutil.copy(path, tmp_path)
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    for code, output in [*examples(DOCS / "python.md"), *examples(DOCS / "live.md")]:
        exec(compile(code, "page", "exec"), names)
        printed = capsys.readouterr().out
        if output is not None:
            assert printed == output
