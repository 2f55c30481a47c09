"""The relatives that the paper names, on the same logs, model file and commands: to compare with."""
