"""README, pages and ``--help`` held together: what a page shows exists, resolves and runs."""

import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from contract.program import LOG, MOVE, dbo, done, table, write

from dbo_cli.cli.app import COMMANDS, program

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
SAMPLES = ROOT / "sample_data"
GENERATED = {"commands.md", "reference.md"}  # made by ``make site``
PAGES = sorted(path for path in DOCS.glob("*.md") if path.name not in GENERATED)
TEXTS = [*PAGES, ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
OPTION = re.compile(r"(?<![\w`-])--[a-z][a-z-]+")
INLINE = re.compile(r"`(?:dbo )?([a-z]+) ([^`]*)`")  # a command within a sentence
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
NUMBER = re.compile(r"-?\d[\d,]*(?:\.\d+)?(?:e-?\d+)?")
UNEXPLAINED = frozenset(("--help", "--help-all", "--version", "--debug", "--output"))
OTHERS = {"--strict", "--cores", "--config", "--seed"}  # of other programs


@cache
def options_of(command):
    """Return every option of a command."""
    root = program()
    above = root.make_context("dbo", [], resilient_parsing=True)
    parameters = root.get_command(above, command).get_params(above)
    names = [name for one in parameters for name in one.opts if name.startswith("--")]
    return frozenset(names) | UNEXPLAINED


@cache
def all_options():
    return frozenset().union(*(options_of(command) for command in COMMANDS))


def command_lines(path):
    """Return the lines of a page that call the program."""
    text = re.sub(r"(?ms)^```text\n.*?^```$", "", path.read_text())
    found = []
    for line in text.replace("\\\n", " ").splitlines():
        if line.startswith(("    dbo ", "dbo ")):
            found.append(" ".join(line.partition("  #")[0].split()))
    return found


# --- options ---


def test_options_of_the_pages_exist():
    for path in TEXTS:
        used = set(OPTION.findall(re.sub(r"`+", " ", path.read_text())))
        assert used - all_options() - OTHERS == set(), path.name
        for line in command_lines(path):
            words = shlex.split(line)
            assert words[1] in COMMANDS, line
            typed = {word.split("=")[0] for word in words if word.startswith("--")}
            assert typed <= options_of(words[1]), line
        for command, rest in INLINE.findall(path.read_text()):
            if command in COMMANDS:
                assert set(OPTION.findall(rest)) <= options_of(command), (command, rest)


def test_every_option_is_explained_on_some_page():
    text = "\n".join(path.read_text() for path in TEXTS)
    missing = {option for option in all_options() if option not in text}
    assert missing - UNEXPLAINED == set()


# --- links and lengths ---


def anchors(path):
    """Return the anchors of a page's headings."""
    found = set()
    for heading in re.findall(r"^#+ (.+)$", path.read_text(), re.MULTILINE):
        plain = re.sub(r"[^\w\s-]", "", heading.lower())
        found.add(re.sub(r"[\s-]+", "-", plain).strip("-"))
    return found


def test_links_and_pictures_lead_somewhere():
    for path in TEXTS:
        for target in LINK.findall(path.read_text()):
            file, _, anchor = target.partition("#")
            page = path.parent / file if file else path
            if target.startswith("https://") or page.name in GENERATED:
                continue
            assert page.exists(), f"{path.name}: {target}"
            if anchor:
                assert anchor in anchors(page), f"{path.name}: {target}"


def test_links_of_the_first_page_lead_somewhere_on_a_package_index(
    tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    for name in ("README.md", "pyproject.toml"):
        shutil.copy(ROOT / name, name)
    monkeypatch.setenv("GITHUB_REPOSITORY", "owner/name")
    monkeypatch.setenv("GITHUB_SHA", "0123abc")
    shell(f"sh '{ROOT}/.github/absolute_links.sh'")
    links = LINK.findall(Path("README.md").read_text())
    assert len(links) == len(LINK.findall((ROOT / "README.md").read_text()))
    assert all("owner/name" in link and "0123abc" in link for link in links)
    urls = tomllib.loads(Path("pyproject.toml").read_text())["project"]["urls"]
    assert urls["Repository"] == "https://github.com/owner/name"


def test_every_figure_is_shown():
    text = "\n".join(path.read_text() for path in PAGES)
    for figure in (DOCS / "figures").iterdir():
        assert f"figures/{figure.name}" in text


def test_pages_are_short_and_name_no_place_of_a_machine():
    assert len((ROOT / "README.md").read_text().split()) <= 450
    assert sum(len(path.read_text().split()) for path in PAGES) <= 12_000
    for path in TEXTS:
        place = r"(?<![\w.])/(?:work|tmp|root|home|opt)/"
        assert not re.search(place, path.read_text()), path.name


# --- what is shown runs ---


def shell(line):
    """Run a line of a page that is none of the program; return what it printed."""
    line = re.sub(r"^python ", f"'{sys.executable}' ", line)
    ended = subprocess.run(["sh", "-c", line], capture_output=True, text=True)
    assert ended.returncode == 0, f"{line}\n{ended.stderr}"
    return ended.stdout


def blocks_with_output(path, language):
    """Return the blocks of a page in a language, each with the output that stands behind it."""
    found = []
    for kind, body in FENCE.findall(path.read_text()):
        if kind == language:
            found.append((body, None))
        elif kind == "text" and found:
            found[-1] = (found[-1][0], body)
    return found


@pytest.mark.usefixtures("unpainted")
def test_the_tutorial_runs_as_it_stands_and_shows_what_comes(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(SAMPLES, "sample_data")
    for block, shown in blocks_with_output(DOCS / "tutorial.md", "sh"):
        came = ""
        for line in block.replace("\\\n", " ").splitlines():
            if line.startswith("dbo "):
                outcome = done(*shlex.split(line)[1:])
                came += outcome.err + outcome.out
            elif "cd " in line:
                monkeypatch.chdir(shell(f"{line} && pwd").strip())
            else:
                shell(line)
        if shown:
            require_alike(shown, came)
    assert "<html" in Path("report.html").read_text()


def require_alike(shown, came):
    """Require each line of an example to have come, numbers of a message within a half."""
    lines = {form(line): line for line in came.splitlines()}
    for line in shown.splitlines():
        assert form(line) in lines, f"{line}\n--- came:\n{came}"
        if line.startswith("dbo: "):
            new = numbers(lines[form(line)])
            assert new == pytest.approx(numbers(line), rel=0.5), line


def form(line):
    """Return a line without its numbers and blanks."""
    return " ".join(NUMBER.sub("#", line).split())


def numbers(line):
    return [float(text.replace(",", "")) for text in NUMBER.findall(line)]


# What a stage would record while a drive is played.
RECORDED = {
    "played.csv": "drive.csv",
    "tracked.csv": "drive.csv",
    "tracked1.csv": "pass1.csv",
    "seen1.csv": "scan1.csv",
    "seen2.csv": "scan2.csv",
}
WITH_COMMANDS = "files index limits moves live batches comparison scanner".split()


@pytest.fixture
def logs(tmp_path, monkeypatch):
    """Work in a folder with the logs that the pages speak of, a second each."""
    monkeypatch.chdir(tmp_path)
    shutil.copy(SAMPLES / "trajectory.csv", "trajectory.csv")
    log = table(SAMPLES / "identification.csv")
    time, volts, moved = (column[:600:2] for column in log.values())
    for name in ("recorded.csv", "other.csv"):
        write(name, LOG, time, volts, moved)
    write("sensor.csv", MOVE, time, moved)
    write("drive.csv", "time_s,CH1_V", time, volts)
    columns = (time, volts, moved, volts, 0.8 * moved)
    write("axes.csv", "time_s,Vx_V,Dx_um,Vy_V,Dy_um", *columns)
    phase = 2.0 * np.pi * np.arange(250) / 250.0
    figure = 6.0 - 2.0 * np.cos(phase), 6.0 - 2.0 * np.sin(2.0 * phase)
    write("figure.csv", "time_s,x_um,y_um", time[:250], *figure)


def record(name, gain):
    """Play a drive on the simulated stage; the voltage is recorded before an amplifier."""
    from virtual_actuator import VirtualActuator

    drive = table(RECORDED[name])
    time, columns = drive["time_s"], {}
    for key, volts in drive.items():
        if key.startswith("voltage"):
            axis = key.removeprefix("voltage").removesuffix("_V")
            columns[f"voltage{axis}_V"] = volts / gain
            moved = VirtualActuator().play(time, volts, 3)
            columns[f"displacement{axis}_um"] = moved * (0.8 if axis == "_y" else 1.0)
    if len(columns) > 2:  # a recorder of its own
        time = time - time[0]
    write(name, ",".join(["time_s", *columns]), time, *columns.values())


@pytest.mark.usefixtures("logs", "unpainted")
def test_the_commands_of_the_pages_run(monkeypatch):
    """Identification stops at its first structures: here any model will do."""
    monkeypatch.setattr("dbo_cli.identification.search.ROUNDS", ())
    seen = set()
    pages = [DOCS / f"{name}.md" for name in WITH_COMMANDS]
    for path in [pages[0], ROOT / "README.md", *pages[1:]]:
        for line in command_lines(path):
            if line in seen:
                continue
            seen.add(line)
            words = shlex.split(line)
            if words[1] == "compare":  # seconds: ``tests/contract/test_compare.py``
                continue
            for name in set(words) & set(RECORDED):
                record(name, 20.0 if "--gain 20" in line else 1.0)
            outcome = dbo(*words[1:])
            assert outcome.code == 0, f"{path.name}: {line}\n{outcome.err}"


@pytest.mark.filterwarnings("ignore::dbo_cli.DboWarning")
def test_the_page_of_the_library_runs(tmp_path, monkeypatch, capsys):
    for path in SAMPLES.glob("*.csv"):
        shutil.copy(path, tmp_path)
    monkeypatch.chdir(tmp_path)
    names = {}
    for page in ("python.md", "live.md"):
        for code, output in blocks_with_output(DOCS / page, "python"):
            exec(compile(code, page, "exec"), names)
            printed = capsys.readouterr().out
            if output is not None:
                assert printed == output
