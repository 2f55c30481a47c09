"""Random tables, written in many ways and damaged, from a seed: what ``attack_files.py`` and a test read."""

from __future__ import annotations

import random
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dbo_cli.errors import DboError
from dbo_cli.logs import Reading, open_log

HEADERS = [
    ["time_s", "voltage_V", "displacement_um"],
    ["Time (s)", "Voltage (V)", "Displacement (µm)"],
    ["t", "u", "y"],
    ["Zeit/s", "Spannung/V", "Weg/nm"],
    ["x-axis", "CH1", "CH2"],
    [],
]
JUNK = [
    "Data Logger DL-7", "Serial: 1234", "Operator;N. N.", "# bench 4", "% COMSOL", "Rate: 1000 Hz",
    "Date,2026-01-02", "", "Range\t100\tV", "Sample Interval,1.0E-3,,", "*** header ***", "Gain = 2",
    "#SAMPLE_TIME = 0.001", "Channels\t2\t\t", "Model,MSO54", "!x y z", "1 2", "7",
]  # fmt: skip
DAMAGE = "0159.,;\t\n\r -+eE#%\"'abN\0/:"


@dataclass
class Written:
    """A table and how it is written: its lines, and what must come out."""

    text: str
    values: list[list[float]]
    first_line: int
    names: list[str]
    encoding: str


def table(rng: random.Random) -> Written:
    """Write a random table in a random way."""
    count = rng.choice([2, 3, 5, 8, 40, 300])
    delimiter, decimal = rng.choice([",.", ";.", ";,", "\t.", "\t,", " .", "|."])
    digits = rng.choice([0, 1, 3, 6])
    rows, values = [], []
    for number in range(count):
        row = [
            number * 0.001,
            50.0 + 40.0 * rng.uniform(-1, 1),
            10.0 * rng.uniform(-1, 1),
        ]
        style = rng.choice(["f", "f", "f", "e"]) if digits > 1 else "f"
        cells = [f"{row[0]:.3f}", *(f"{value:.{digits}{style}}" for value in row[1:])]
        values.append([float(cell) for cell in cells])
        rows.append([cell.replace(".", decimal) for cell in cells])
    names = rng.choice(HEADERS)
    lines = [rng.choice(JUNK) for _ in range(rng.choice([0, 0, 0, 1, 3, 6]))]
    if lines and rng.random() < 0.5:
        lines.append("")
    separator = delimiter if delimiter != " " else rng.choice([" ", "  ", "   "])
    mark = rng.choice(["", "", "# "])
    if names:
        cells = (
            [name.replace(" ", "_") for name in names] if delimiter == " " else names
        )
        lines.append(mark + separator.join(cells))
        if rng.random() < 0.2:
            lines.append(mark + separator.join(["s", "V", "um"]))
    first = len(lines)
    ending = rng.choice(["", "", "", delimiter if delimiter != " " else ""])
    quote = rng.choice(["", "", "", '"'])
    for cells in rows:
        lines.append(separator.join(quote + cell + quote for cell in cells) + ending)
    end = rng.choice(["\n", "\n", "\r\n"])
    encoding = rng.choice(["utf-8", "utf-8", "utf-8-sig", "cp1252", "utf-16"])
    return Written(end.join(lines) + end, values, first, names, encoding)


def damaged(text: str, rng: random.Random) -> tuple[str, tuple[int, int]]:
    """Change a letter or a few of a text; also give the first and the last line of them."""
    place = rng.randrange(len(text))
    way = rng.randrange(4)
    last = place + 1
    if way == 0:
        changed = text[:place] + text[place + 1 :]
    elif way == 1:
        changed = text[:place] + rng.choice(DAMAGE) + text[place:]
    elif way == 2:
        changed = text[:place] + rng.choice(DAMAGE) + text[place + 1 :]
    else:
        last = place + rng.randrange(1, 30)
        changed = text[:place] + text[last:]
    return changed, (text.count("\n", 0, place), text.count("\n", 0, last))


def read(path: Path, written: Written, rng: random.Random) -> list[list[float]] | None:
    """Read a file by names or numbers; None where it is refused."""
    roles: dict[str, str | None] = {"time": None, "voltage": None, "displacement": None}
    if not written.names or rng.random() < 0.5:
        roles = {"time": "1", "voltage": "2", "displacement": "3"}
    reading = Reading(time_unit=rng.choice([None, "s"]))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with open_log(str(path), roles, reading) as log:
                read = log.read()
    except DboError as problem:
        assert "\n" not in str(problem)
        return None
    time = read.time
    if time is None:  # its name was damaged
        time = np.array([row[0] for row in written.values[: len(read)]])
    return np.column_stack([time, read["voltage"], read["displacement"]]).tolist()


def misread(
    got: list[list[float]], written: Written, lines: tuple[int, int] | None
) -> bool:
    """Return whether rows are wrong that were not damaged, or are missing."""
    want = written.values
    if lines is None:
        return got != want
    if lines[1] < written.first_line:
        return not in_some_unit(got, want)
    before = max(0, lines[0] - written.first_line)
    after = want[lines[1] - written.first_line + 1 :]
    if got[:before] != want[:before]:
        return True
    if lines[0] < written.first_line:
        # a header torn into the rows: of the torn row nothing is left, or what stands there now
        last = want[lines[1] - written.first_line :]
        right = [without_time(rows) for rows in (want, after, last)]
        values = without_time(got)
        return values not in right and values[1:] != right[1]
    between = len(got) - before - len(after)
    # the damaged rows are one with other numbers, or none: a comment
    return (
        between not in (0, 1, lines[1] - lines[0] + 1)
        or got[len(got) - len(after) :] != after
    )


def without_time(rows: list[list[float]]) -> list[list[float]]:
    """Return rows without their times: a torn header may leave a stated rate as the clock."""
    return [row[1:] for row in rows]


def in_some_unit(got: list[list[float]], want: list[list[float]]) -> bool:
    """Return whether rows are those that were written; a torn header may state another unit of time."""
    if len(got) != len(want):
        return False
    read, written = np.array(got), np.array(want)
    factor = read[-1, 0] / written[-1, 0]
    same_time = np.allclose(read[:, 0], factor * written[:, 0], rtol=1e-12)
    return same_time and bool((read[:, 1:] == written[:, 1:]).all())


def once(seed: int, path: Path) -> str:
    """Write, damage and read one table; say what came of it."""
    rng = random.Random(seed)
    written = table(rng)
    text, lines = written.text, None
    if rng.random() < 0.7:
        text, lines = damaged(text, rng)
    path.write_bytes(text.encode(written.encoding, errors="replace"))
    got = read(path, written, rng)
    if got is None:
        return "refused" if lines is not None else "refused whole"
    return "wrong" if misread(got, written, lines) else "right"
