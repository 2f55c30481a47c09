"""Moves that are repeated: the settled drive of a loop, and learning from recordings of the last pass."""
