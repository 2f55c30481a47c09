"""The options of ``compensate`` for moves that are repeated."""

from dbo_cli.cli.options import COLUMN, READING_LOGS, Option, text, whole

PERIODIC = Option(
    "--periodic",
    "The trajectory is one period of a loop: write the settled loop's drive.",
)
PASSES = Option(
    "-n, --passes N",
    "With --periodic, passes of run-in before it (time < 0).",
    "0",
    parse=whole(0),
)
TRACKED = Option(
    "--tracked LOG",
    "The last pass of this trajectory, recorded: write the next, better drive; repeatable.",
    repeated=True,
)
ABSOLUTE = Option(
    "--absolute",
    "With --tracked, learn the mean of the error, too (else it is taken for the sensor's zero).",
)
HISTORY = Option(
    "--history FILE",
    "With --tracked, keep the error of each pass there (JSON), so that growth is seen.",
    parse=text,
)
VOLTAGE = Option(
    f"--voltage {COLUMN}",
    "The drive in a --tracked log; guessed by name.",
    heading=READING_LOGS,
)
MEASURED = Option(
    f"--measured {COLUMN}",
    "What was measured in a --tracked log; guessed by name.",
    heading=READING_LOGS,
)
