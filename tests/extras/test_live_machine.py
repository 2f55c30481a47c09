"""A short, seeded run of the state machine of live control; ``benchmarks/attack/live.py`` has a long one."""

from __future__ import annotations

from hypothesis import HealthCheck, settings
from live_machine import LiveMachine

LiveMachine.TestCase.settings = settings(
    max_examples=20,
    stateful_step_count=25,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=list(HealthCheck),
)
TestLiveControl = LiveMachine.TestCase
