"""The attacks of ``benchmarks/`` in small: no row of a drive, no live voltage is ever beyond a limit."""

import os
from collections import Counter

import numpy as np
import pytest
from attack_drives import A_MODEL, DT, trial
from attack_live import ACTIONS, SHARES, machine
from random_actuators import random_actuator

from dbo_cli.drive.limits import GateError
from dbo_cli.errors import DboError

pytestmark = pytest.mark.filterwarnings("ignore::dbo_cli.errors.DboWarning")
DRIVES = int(os.environ.get("DBO_DRIVES", "100"))  # a seed
CALLS = 60  # of a controller


@pytest.mark.parametrize("seed", [0, 1, 2, 3, 4, 6])
def test_no_row_is_beyond_a_limit(seed):
    """Whole drives and blocks, channels, inverse models; what has left before a refusal counts, too."""
    outcomes = Counter()
    last = None
    for number in range(DRIVES):
        if number % A_MODEL == 0:
            model = random_actuator(np.random.default_rng([seed, number, 2]), DT)
            last = None
        rng = np.random.default_rng([seed, number, 3])
        try:
            wrong, last = trial(rng, number, model, last)
        except GateError:
            raise  # a fault of the program
        except DboError:
            outcomes["refused"] += 1
        else:
            assert not wrong, (seed, number, wrong)
            outcomes["written"] += 1
    assert outcomes["written"] > 0.3 * DRIVES


@pytest.mark.parametrize("seed", range(20))
def test_no_live_voltage_is_beyond_a_limit(seed):
    """Nor does a plan that is not committed, or a refused call, leave a trace."""
    rng = np.random.default_rng([seed, 4])
    live = machine(rng)
    while live is None:
        live = machine(rng)
    for action in rng.choice(ACTIONS, CALLS, p=SHARES):
        live.act(str(action))
