"""What a user's type checker knows of the library; mypy reads this (``make test``), nothing runs it.

``assert_type`` is exact, so nothing here is ``Any``; an ignored error that does not come is an error.
"""

from typing import Literal, assert_type

import numpy as np
from numpy.typing import NDArray

import dbo_cli as dbo
from dbo_cli.drive.drive import Drive
from dbo_cli.model.state import Quantity, State
from dbo_cli.reports.report import Report

Array = NDArray[np.float64]

model = dbo.read_model("model.json")
time = np.linspace(0.0, 1.0, 500)
wanted = 5.0 - 3.0 * np.cos(2.0 * np.pi * time)

assert_type(model, dbo.Model)
assert_type(model.input, Quantity)
assert_type(model.output.unit, str | None)
assert_type(model.fit["rmse"], float)
assert_type(model.fit["expected_rmse"], float | None)
assert_type(model.sign, Literal["rising", "falling"])
assert_type(model.digest, str)
assert_type(model.inverse(), dbo.Model)
assert_type(dbo.read_models("set.json")["x"], dbo.Model)
assert_type(dbo.identify("log.csv", delay=0.0), dbo.Model)
assert_type(model.simulate(wanted, time=time), Array)
assert_type(model.simulate(wanted, return_state=True), tuple[Array, State])
assert_type(model.compensate(wanted, time=time, v_max="100V"), Array)
assert_type(model.compensate(wanted, details=True), Drive)
assert_type(model.compensate(wanted, details=True).expected_error, float | None)
assert_type(model.controller(5000, lookahead="auto").plan(1.0), float)
assert_type(dbo.report(wanted, wanted, time=time), Report)
assert_type(dbo.report(wanted, wanted).rmse, float)

print(model.colour)  # type: ignore[attr-defined]
model.compensate(wanted, vmax=100)  # type: ignore[call-overload]
model.simulate(wanted, outside="drop")  # type: ignore[call-overload]
dbo.identify("log.csv", delays=0.0)  # type: ignore[call-arg]
dbo.report(wanted, wanted, model="model.json")  # type: ignore[arg-type]
