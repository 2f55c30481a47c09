"""One interpolator for every clock: delays, reading ahead, another rate, files that are joined by time."""
