"""What the commands that read signals share: opening a log as the user asked, column by column."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from dbo_cli.cli.bundles import Reading
from dbo_cli.cli.messages import Voice
from dbo_cli.errors import InputError

if TYPE_CHECKING:
    from dbo_cli.hysteresis.model import Quantity
    from dbo_cli.logs.columns import ColumnWish
    from dbo_cli.logs.signal_log import SignalLog

VOLTAGE = ("voltage", "drive", "command", "u", "v", "volt", "volts")
DISPLACEMENT = ("displacement", "position", "measured", "sensor", "y", "disp", "pos")
DESIRED = ("desired", "reference", "setpoint", "target", "trajectory", "wanted", "ref")
GUESSES = {"voltage": VOLTAGE, "displacement": DISPLACEMENT}


def guesses_for(quantity: str) -> tuple[str, ...]:
    """Return the column names under which a model's quantity is looked for."""
    known = GUESSES.get(quantity, ())
    return (quantity.lower(), *(name for name in known if name != quantity.lower()))


def open_signals(
    address: str,
    want: Mapping[str, ColumnWish],
    reading: Reading,
    voice: Voice,
    *,
    live: bool = False,
    digest: bool = False,
) -> SignalLog:
    """Open a log as the reading options say."""
    from dbo_cli.logs.reading_options import ALL_ROWS, BLOCK_ROWS, ReadingOptions, parse_rows
    from dbo_cli.logs.signal_log import open_log

    options = ReadingOptions(
        time=reading.time,
        sample_rate=reading.sample_rate,
        rows=ALL_ROWS if reading.rows is None else parse_rows(reading.rows),
        skip_bad=reading.skip_bad,
        resample=reading.resample,
        format=format_for(address, reading.file_format),
        delimiter=reading.delimiter,
        decimal=reading.decimal,
        comment=reading.comment,
        skip_lines=reading.skip_lines,
        header_lines=reading.header_lines,
        encoding=reading.encoding,
        block_rows=reading.block_rows or BLOCK_ROWS,
    )
    log = open_log(address, want, options, live=live, digest=digest)
    voice.detail(log.describe())
    return log


def short_names(addresses: Sequence[str]) -> dict[str, str]:
    """Return the names of logs without their folders, where that tells them apart."""
    short = {address: os.path.basename(address) for address in addresses if address != "-"}
    return short if len(set(short.values())) == len(short) else {}


def format_for(address: str, named: str | None) -> str | None:
    """Return ``--format`` for an address whose own name does not tell its format, else None."""
    from dbo_cli.logs.addresses import parse_address

    return named if named is not None and parse_address(address).kind is None else None


def spoken(address: str) -> str:
    """Return how a message calls a file."""
    return "standard input" if address == "-" else address


def check_unit(log: SignalLog, role: str, wanted: Quantity, model: str) -> None:
    """Refuse a column whose unit is known and differs from the model's (InputError)."""
    column = log.columns[role]
    if column.unit is not None and wanted.unit is not None and column.unit != wanted.unit:
        raise InputError(
            f"{log.name}: column '{column.name}' is in {column.unit}, but {model} takes {wanted.quantity} in "
            f"{wanted.unit} (convert the column)"
        )
