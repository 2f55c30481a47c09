"""The command line: options, a few calls into the rooms, and messages."""
