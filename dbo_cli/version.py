"""The version of the program, for whoever must name it without importing all the rest."""

__version__ = "0.2.0"


def program_version_string() -> str:
    """Name the program and its version, for what it writes: ``dbo 0.1.0``."""
    return f"dbo {__version__}"
