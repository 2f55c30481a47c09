"""What is read and written back: logs, model files, states."""
