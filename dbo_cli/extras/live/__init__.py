"""Live control: one row at a time, of one actuator or of many, past the same limits."""
