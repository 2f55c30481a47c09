"""Text without end, and marks that may stand between thousands: refused, whatever stands around them."""

import re
from pathlib import Path

import numpy as np
import pytest

import dbo_cli.units
from dbo_cli.logs import Reading, cells, columns, dialect, names, open_log, settings

from .program import dbo, done, model, refused, simulated, table

ROLES = {"voltage": "2"}
MOST = 400  # characters of the longest text that an expression may meet: a line of two cells


# --- thousands or decimals ---


WAYS = {
    "commas": ("time_s,voltage_V", "{},{}"),
    "semicolons": ("time_s;voltage_V", "{};{}"),
    "tabs": ("time_s\tvoltage_V", "{}\t{}"),
    "blanks": ("time_s voltage_V", "  {}   {}"),
    "quotes": ('"time_s","voltage_V"', '"{}","{}"'),
    "a remark": ("time_s,voltage_V,remark", "{},{},ok"),
}
QUIET = 20_000  # rows that show nothing; 150 kB: more than is looked at for a layout


def write_numbers(numbers, way):
    """Write a log of numbers as they are spelled, at 2 kHz."""
    head, line = WAYS[way]
    rows = [line.format(f"{k / 2000:.4f}", x) for k, x in enumerate(numbers)]
    Path("log.csv").write_text("\n".join([head, *rows, ""]))


CASES = {
    "in the first rows": (["998", "999", "1.000", "1.001"], 0),
    "whole cells of 0": (["0", "0", "1.000", "97.360"], 0),
    "negative cells": (["-5", "-4", "1.000", "-97.360"], 0),
    "beyond the rows that are looked at": (["1.000", "97.360"], QUIET),
    "a whole cell at the end": (["97.360"] * 50 + ["999"], 0),
}


@pytest.mark.parametrize("way", WAYS)
def test_a_mark_that_may_be_of_thousands_is_asked_about(way):
    for numbers, quiet in CASES.values():
        numbers = [str(k % 7) for k in range(quiet)] + numbers
        write_numbers(numbers, way)
        error = refused(1, "simulate", model("small"), "log.csv", "-o", "out.csv")
        assert "thousands or decimals?" in error and "--decimal" in error
        words = ("--decimal", "point", "--outside", "extend")
        written = table(done("simulate", model("small"), "log.csv", *words))
        values = [float(x) for x in numbers]
        np.testing.assert_array_equal(list(written.values())[-2], values)


@pytest.mark.parametrize("way", WAYS)
def test_another_number_of_decimals_is_clear(way):
    """Beside ``1.5``, ``0.250``, ``1.0005`` or ``1234`` a mark stands before decimals."""
    for clear in ("1.5", "0.250", "1.0005", "1234", "1.000e0"):
        write_numbers(["999", "1.000", "97.360", clear], way)
        simulated("small", "log.csv", "--outside", "extend")
    write_numbers(["1.0005", *["999", "1.000"] * 10_000], way)
    with open_log("log.csv", ROLES) as log:
        assert log.read()["voltage"].max() == 999.0


def test_the_verdict_does_not_depend_on_how_a_pipe_is_filled():
    rows = [f"{k / 2000:.4f},{x}" for k, x in enumerate(["999", "1.000"] * 400)]
    text = "\n".join(["time_s,voltage_V", *rows, ""])
    for clear in ("", "1,1.5\n"):
        outcome = dbo("simulate", model("small"), "-", stdin=text + clear)
        assert outcome.code == 1 and "thousands or decimals?" in outcome.err
    words = ("--time", "1", "--input", "2", "--outside", "extend")
    text = "\n".join(rows[:350]) + "\n9,1.5\n"
    done("simulate", model("small"), "-", *words, stdin=text)


# --- text without end ---


class Watched:
    """An expression that notes the longest text it meets."""

    longest = 0
    expression = ""

    def __init__(self, pattern):
        self.source = pattern

    def __getattr__(self, name):
        function = getattr(self.source, name)
        if name not in ("match", "fullmatch", "search", "sub", "findall", "split"):
            return function
        return lambda *texts: self.noted(function, *texts)

    def noted(self, function, *texts):
        if isinstance(texts[-1], str) and len(texts[-1]) > Watched.longest:
            Watched.longest, Watched.expression = len(texts[-1]), self.source.pattern
        return function(*texts)


@pytest.fixture
def watched(monkeypatch):
    """Note the longest text that an expression of the readers meets."""
    for module in (cells, columns, dialect, names, settings, dbo_cli.units):
        for name, value in vars(module).items():
            if isinstance(value, re.Pattern):
                monkeypatch.setattr(module, name, Watched(value))
    Watched.longest = 0
    return Watched


ENDLESS = {
    "digits": "0" * 40_000 + "x",
    "a number": "1." + "0" * 40_000,
    "slashes": "/" * 8_000 + "_",
    "underscores": "_" * 8_000,
    "blanks": " " * 200_000 + "1",
    "blanks around": "1" + " " * 200_000,
    "brackets": "a(" * 20_000,
    "words": "a / " * 5_000,
    "equals": "a=" * 5_000,
}
PLACES = {
    "a cell": "time_s,voltage_V\n0,1.5\n0.001,{}\n0.002,2.5\n",
    "the last cell": "time_s,voltage_V\n0,1.5\n0.001,{}",
    "a name": "time_s,{}\n0,1.5\n0.001,2.5\n",
    "a unit": "time,voltage\ns,{}\n0,1.5\n0.001,2.5\n",
    "a comment": "# {}\ntime_s,voltage_V\n0,1.5\n0.001,2.5\n",
    "a setting": "Rate: {}\nvoltage_V,position_um\n0,1.5\n0.001,2.5\n",
    "a key": "{}: 5\nvoltage_V,position_um\n0,1.5\n0.001,2.5\n",
    "blank-delimited": "time_s voltage_V\n0 1.5\n0.001 {}\n0.002 2.5\n",
}


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("rows", [0, 1000])
def test_no_expression_meets_a_text_without_end(place, rows, watched):
    """A long cell is no number, no name and no unit, in small files and in large ones."""
    mark = " " if place == "blank-delimited" else ","
    for text, endless in ENDLESS.items():
        content = PLACES[place].format(endless)
        if content.endswith("\n"):
            content += f"1{mark}1.5\n" * rows
        Path("log.csv").write_text(content)
        outcome = dbo("simulate", model("small"), "log.csv", "--input", "2")
        assert watched.longest <= MOST, watched.expression
        assert "internal error" not in outcome.err
        is_number = text in ("a number", "blanks", "blanks around")
        if place in ("a cell", "the last cell"):
            assert outcome.code == 1 and "voltage_V" in outcome.err
            assert not is_number or "more than 200 characters" in outcome.err


def test_a_long_name_is_no_name():
    Path("log.csv").write_text("time_s," + "voltage " * 30 + "\n0,1\n0.001,2.5\n")
    with open_log("log.csv", ROLES, Reading()) as log:
        assert log.columns["voltage"].name == ""
        assert any("200 characters" in remark for remark in log.remarks)
