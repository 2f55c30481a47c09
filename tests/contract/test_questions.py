"""What is asked where columns are not clear: what a refusal proposes is right to type, or it is NAME."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from .program import refused, write

TIME = np.arange(600) / 500.0
VOLTS = np.round(50.0 - 50.0 * np.cos(2.0 * np.pi * 2.5 * TIME), 4)
MOVED = np.round(0.1 * VOLTS + 0.3 * np.sin(2.0 * np.pi * 2.5 * TIME), 5)
COUNT = np.arange(1.0, 601.0)
HELD = np.full(600, 50.0)


def asked(header: str, *columns: np.ndarray, words: tuple[object, ...] = ()) -> str:
    """Return what is asked, and require that a proposal, once typed, asks no more or is NAME."""
    write("log.csv", header, *columns)
    return refused(1, "identify", "log.csv", *words)


def proposal(message: str) -> dict[str, str]:
    """Return the options of the example, by role."""
    example = message.partition("(for example ")[2].partition(")")[0]
    pairs = re.findall(r"--(\w+) ('[^']*'|\S+)", example)
    return {role: text.strip("'") for role, text in pairs}


BOTH = {"voltage": "NAME", "displacement": "NAME"}


@pytest.mark.parametrize(
    ("header", "columns", "options"),
    [
        ("seq_num,time,setpoint,piezo,offset", (COUNT, TIME, VOLTS, MOVED, 0 * HELD), BOTH),
        ("Time(s),Voltage(V):Stage,Voltage(V)", (TIME, VOLTS, MOVED), BOTH),
        ("t[s],Vx[V],Vy[V],x[nm],y[nm]", (TIME, VOLTS, HELD, MOVED, MOVED / 9), BOTH),
        ("time_s,a,b", (TIME, VOLTS, MOVED), BOTH),
        ("time_s,voltage_V,a,b", (TIME, VOLTS, MOVED, HELD), {"displacement": "NAME"}),
        ("time_s,voltage_V,CH2", (TIME, VOLTS, MOVED), {"displacement": "CH2"}),
        ("time_s,voltage_V,CH2", (TIME, VOLTS, COUNT), {"displacement": "NAME"}),
        ("time_s,voltage_V,CH2", (TIME, VOLTS, HELD), {"displacement": "NAME"}),
        ("time_s,index,displacement_um", (TIME, COUNT, MOVED), {"voltage": "NAME"}),
    ],
)  # fmt: skip
def test_a_proposal_is_right_or_a_name_to_fill_in(
    header: str, columns: tuple[np.ndarray, ...], options: dict[str, str]
) -> None:
    message = asked(header, *columns)
    assert proposal(message) == options
    for name in header.split(","):
        assert name in message


def test_channels_are_proposed_where_names_pair() -> None:
    columns = (TIME, VOLTS, HELD, MOVED, MOVED / 9)
    message = asked("t[s],Vx[V],Vy[V],x[nm],y[nm]", *columns)
    assert "--voltage 'V{}[V]' --displacement '{}[nm]'" in message
    message = asked("t[s],Vx[V],Vy[V],a[nm],b[nm]", *columns)
    assert "{}" not in message


def test_the_names_of_the_data_stand_right_above_the_numbers() -> None:
    triples = zip(VOLTS, MOVED, TIME, strict=True)
    rows = "".join(f"{v:+09.4f}\t{x:+09.4f}\t{t:08.3f}\n" for v, x, t in triples)
    above = "R,Ohm\tC,nF\tTemp,C\n0000000000\t0000001000\t+024.50\n"
    Path("log.txt").write_text(f"{above}Drive,V\tGap,um\tTime,s\n{rows}")
    message = refused(1, "identify", "log.txt")
    assert "log.txt:3: " in message and "--skip-lines 2" in message
    message = refused(1, "identify", "log.txt", "--skip-lines", 2, "--voltage", "x")
    assert "1 Drive,V, 2 Gap,um, 3 Time,s" in message
