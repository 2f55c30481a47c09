"""Identify, invert and compensate the hysteresis of piezo actuators with the Discrete Backlash Operator."""

from __future__ import annotations

__version__ = "0.1.0"
