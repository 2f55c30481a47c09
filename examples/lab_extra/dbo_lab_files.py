"""A recorder's file, a generator's file and a command of a laboratory's own."""

from __future__ import annotations

import numpy as np

from dbo_cli.cli.commands import Arguments, Command
from dbo_cli.cli.options import MODEL, REPORTING
from dbo_cli.errors import InputError
from dbo_cli.extras.moves.generators import GeneratorFormat, Signals
from dbo_cli.hysteresis.model_file import read_model
from dbo_cli.logs.clock import Statement
from dbo_cli.logs.column_table import ColumnTable, array_source
from dbo_cli.logs.request import Request

# --- a reader: four bytes of name, the sample rate in Hz, then pairs of volts and
# micrometres ---

MAGIC = b"REC1"


def open_recording(request: Request) -> ColumnTable:
    """Open a file of our recorder.

    Raises
    ------
    InputError
        It is none, or ends early.
    """
    place = request.address.name
    with open(request.address.path, "rb") as file:
        content = file.read()
    if not content.startswith(MAGIC) or (len(content) - 12) % 16:
        raise InputError(
            f"{place}: no file of our recorder, or one that ends early (record it again)"
        )
    rate = float(np.frombuffer(content[4:12], "<f8")[0])
    rows = np.frombuffer(content[12:], "<f8").reshape(-1, 2)
    columns = [
        array_source("voltage", rows[:, 0], "V"),
        array_source("displacement", rows[:, 1], "um"),
    ]
    return ColumnTable(
        request,
        "a recording",
        columns,
        clock=[Statement(f"sample rate {rate:g} Hz", rate)],
    )


# --- a generator's file: one line of text a point ---


def _write_steps(signals: Signals) -> bytes:
    return "".join(f"STEP {volts!r}\n" for volts in signals.values[0].tolist()).encode()


def _read_steps(content: bytes) -> np.ndarray:
    lines = content.decode().splitlines()
    return np.array([[float(line.removeprefix("STEP ")) for line in lines]])


LAB_STEPS = GeneratorFormat((".steps",), _write_steps, _read_steps)


# --- a command ---


def rest(given: Arguments) -> None:
    """Say at which voltage an actuator is left over night: the lower end of its model's range.

    Writes
    ------
    One line on standard error.

    Examples
    --------
    Where to leave it:
        dbo rest model.json
    Of one channel of a set:
        dbo rest mirror.json::47
    """
    model = read_model(given.model)
    given.reporter.note(f"leave it at {model.input.minimum:g}{model.input.suffix}")


REST = Command(rest, (MODEL, *REPORTING))


# --- a name of the Python API ---


def millivolts(volts: float) -> float:
    """Return volts in millivolts: dbo.millivolts(1.5)."""
    return 1000.0 * volts
