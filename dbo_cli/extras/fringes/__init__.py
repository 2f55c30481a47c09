"""An extra: the displacement of an actuator from the fringes of an interferometer."""
