"""The version of the program, for whoever must name it without importing all the rest."""

__version__ = "0.2.0"
