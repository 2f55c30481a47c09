"""The options of the core's commands that are for channels."""

from dbo_cli.cli.options import Option, whole

SHARED_SHAPE = Option(
    "--shared-shape",
    "Channels: one loop shape, gain, offset and lag of each; refused where channels left out speak against.",
)
COUPLING = Option(
    "--coupling",
    "Channels: find how much each shows in the others, from a log in which all move (excite --channels).",
)
CHANNELS = Option(
    "--channels N",
    "Drives of N channels, voltage_1 and so on: together with different turns, then one by one.",
    parse=whole(2),
)
