"""Help of one screen, and the command line that typer refuses."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from dbo_cli.cli import say
from dbo_cli.cli.app import COMMANDS, main

PROGRAM = [sys.executable, "-m", "dbo_cli"]


def shown(*words: str, seed: str = "0") -> str:
    """Return what a process writes to standard output."""
    environment = {**os.environ, "PYTHONHASHSEED": seed}
    done = subprocess.run(
        [*PROGRAM, *words], capture_output=True, text=True, env=environment, check=True
    )
    return done.stdout


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_a_command_is_one_screen(command, capsys):
    assert main([command, "-h"]) == 0
    page = capsys.readouterr().out
    assert len(page.splitlines()) <= 40
    assert page.count("--help-all") == 2


def test_help_lists_each_command_on_one_line():
    lines = shown("-h").splitlines()
    rows = lines[lines.index("Commands:") + 1 :]
    assert [row.split()[0] for row in rows] == list(COMMANDS)
    assert shown("-h", seed="1") == shown("-h", seed="2")


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("simulate m.json a.csv --outsid hold", "did you mean --outside"),
        ("simulate m.json a.csv --foo 3", "no such option: --foo"),
        ("compensate m.json a.csv --from=", "--from is empty"),
        ("identify a.csv --samplerate 5", "did you mean --sample-rate"),
        ("compensate m.json a.csv --on-limit stop", "'auto', 'clip', 'error'"),
        ("compensate m.json", "'TRAJECTORY'"),
        ("report a.csv --lag soon", "integer"),
        ("identify a.csv --zero nan", "--zero nan: give none"),
    ],
)
def test_a_wrong_word_is_named(line, words, capsys):
    assert main(line.split()) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.startswith("dbo: error: ") and len(error) < 160


def test_a_default_line_has_at_most_120_characters(capsys, monkeypatch):
    monkeypatch.setattr(say.Level, "quiet", False)
    monkeypatch.setattr(say.Level, "verbose", False)
    say.say("x" * 300)
    assert len(capsys.readouterr().err.rstrip("\n")) == 120
    say.say("/a/long/folder" * 20 + "/run.h5::/scan/1: 5 rows; speed 3 V/s: fast")
    line = capsys.readouterr().err
    assert line.startswith("dbo: /a/long") and len(line) == 121
    assert line.endswith("/run.h5::/scan/1: 5 rows; speed 3 V/s: fast\n")
    monkeypatch.setattr(say.Level, "verbose", True)
    say.say("x" * 300)
    assert len(capsys.readouterr().err.rstrip("\n")) == 305


class Log:
    """A log of 100 rows."""

    remarks = ("a remark",)

    def __init__(self, name):
        self.name = name

    def line(self):
        """Return what was read."""
        return f"{self.name}: 100 rows"


def test_many_logs_are_one_line(capsys, monkeypatch):
    monkeypatch.setattr(say.Level, "quiet", False)
    monkeypatch.setattr(say.Level, "verbose", False)
    say.say_logs([Log("a"), Log("b")], 200, " (rising)")
    assert capsys.readouterr().err.count("\n") == 2
    say.say_logs([Log("a"), Log("b"), Log("c")], 300, " (rising)")
    line = capsys.readouterr().err
    assert line == "dbo: 3 logs, 300 rows (rising)\n"
