"""Moves: trajectories that people write by hand, how long a step takes to settle, and generators' files."""
