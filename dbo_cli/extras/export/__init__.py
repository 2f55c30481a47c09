"""A model as source code for the controller that runs it: C in the arithmetic of the chip, and an FMU."""
