"""The options of the core's commands that moves bring."""

from dbo_cli.cli.options import Option

COMPENSATE_SETTLE = Option(
    "--settle DISTANCE",
    "Say how long creep and ringing take to stay within it after a step (5nm; plain: the model's unit).",
)
SHOW_SETTLE = Option(
    "--settle DISTANCE",
    "Say how long a step over the whole drive takes to stay within it (5nm, 0.005).",
)
