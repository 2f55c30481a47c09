"""Usual command lines are read as the command-line library reads them; all others are left to it."""

from __future__ import annotations

import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dbo_cli.cli import options, typer_adapter
from dbo_cli.cli.commands import COMMANDS, Command, Given
from dbo_cli.cli.options import Option
from dbo_cli.errors import DboError

TEXTS = (
    "1",
    "0",
    "auto",
    "a.csv",
    "-",
    "2:3",
    "x=2",
    "-3",
    "1.5",
    "",
    "a=b",
    "--",
    "--quiet",
    "none",
    "clip",
    "free",
)


def by_library(words: list[str], monkeypatch: pytest.MonkeyPatch) -> dict[str, object] | None:
    """Return the values that the library hands to the command; None where it refuses them."""
    got: list[Given] = []
    taken = {name: Command(got.append, one.options) for name, one in COMMANDS.items()}
    with monkeypatch.context() as patched:
        patched.setattr(typer_adapter, "COMMANDS", taken)
        try:
            typer_adapter.run(words)
        except DboError:
            return None
        except Exception as problem:
            assert typer_adapter.complaint(problem) is not None
            return None
    return vars(got[0]) if got else None


def words_of(option: Option) -> st.SearchStrategy[list[str]]:
    """Return ways to write an option."""
    if not option.names:
        return st.sampled_from(TEXTS).map(lambda text: [text])
    names = st.sampled_from(option.names)
    if option.metavar is None:
        return names.map(lambda name: [name])
    offered = [*option.metavar.split("|"), "1", "2:3", "0.5"]
    text = st.sampled_from([*offered, *offered, *TEXTS])
    apart = st.tuples(names, text).map(list)
    return apart | st.tuples(names, text).map(lambda pair: ["=".join(pair)])


@st.composite
def lines(draw: st.DrawFn) -> list[str]:
    name = draw(st.sampled_from(sorted(COMMANDS)))
    declared = COMMANDS[name].options
    arguments = [words_of(one) for one in declared if not one.names]
    needed = [words_of(one) for one in declared if one.names and one.default is options.REQUIRED]
    parts = [draw(one) for one in arguments + needed if draw(st.integers(0, 19))]
    parts += draw(st.lists(st.sampled_from(declared).flatmap(words_of), max_size=6))
    return [name, *(word for part in draw(st.permutations(parts)) for word in part)]


@given(lines())
def test_a_usual_line_means_what_it_means_to_the_library(words: list[str]) -> None:
    read = options.read_line(words[1:], COMMANDS[words[0]].options)
    if read is not None:
        with pytest.MonkeyPatch.context() as monkeypatch:
            assert {"typed": tuple(words), **read} == by_library(words, monkeypatch)


def test_what_is_usual() -> None:
    words = "m.json a.csv - --rows=2:3 -q --scale voltage=2 --scale input=-3 -o b.csv --jobs 2 --jobs 3"
    values = options.read_line(words.split(), COMMANDS["simulate"].options)
    assert values is not None
    assert [one.text for one in values["log"]] == ["a.csv", "-"] and values["output"].text == "b.csv"
    assert (values["rows"], values["quiet"], values["verbose"]) == ((2, 3), True, False)
    assert (values["scale"], values["jobs"], values["time"]) == (["voltage=2", "input=-3"], 3, None)


@pytest.mark.parametrize(
    "line",
    ["m.json", "a b --help", "-h", "a b -oout.csv", "a b -o", "a b --quiet=1", "a b --outp x", "-- a b",
     "a b --jobs 0", "a b -qv", "a b --outside never"],
)  # fmt: skip
def test_what_is_left_to_the_library(line: str) -> None:
    assert options.read_line(line.split(), COMMANDS["simulate"].options) is None


def test_a_usual_line_loads_no_command_line_library() -> None:
    script = (
        "import sys; from dbo_cli.cli.app import main\n"
        "code = main(['simulate', 'none.json', 'none.csv'])\n"
        "assert code == 1 and 'numpy' in sys.modules and 'typer' not in sys.modules\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, check=False, text=True)
    assert (done.returncode, done.stderr.count("\n")) == (0, 1), done.stderr
