"""What this package brings to dbo, and where it is found; nothing is imported until it is asked for."""

from dbo_cli.extensions import Extra

EXTRA = Extra(
    "lab",
    "files of our recorder and our generator",
    {
        "reader": {".rec": "dbo_lab_files:open_recording"},
        "generator": {"lab-steps": "dbo_lab_files:LAB_STEPS"},
        "command": {"rest": "dbo_lab_files:REST"},
        "api": {"millivolts": "dbo_lab_files:millivolts"},
    },
)
