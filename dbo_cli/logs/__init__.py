"""What is read and written back: logs, model files, states."""

from __future__ import annotations
