"""The files that generators, wave tables and converters take: volts to bytes, and back."""
