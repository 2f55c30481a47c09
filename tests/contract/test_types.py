"""Types of the library, as a user's type checker sees them: never Any."""

from __future__ import annotations

import inspect
from pathlib import Path

import pytest
from mypy import api

import dbo_cli as dbo
from dbo_cli.library import Move

ROOT = Path(__file__).parents[2]
USE = """\
import numpy as np
import dbo_cli as dbo

model = dbo.read_model("model.json")
time = np.linspace(0.0, 1.0, 500)
wanted = 5.0 - 3.0 * np.cos(2.0 * np.pi * time)
"""
ARRAY = "numpy.ndarray[tuple[Any, ...], numpy.dtype[numpy.float64]]"
REVEALED = {
    "model": "dbo_cli.library.Model",
    "model.input": "dbo_cli.model.state.Quantity",
    "model.output.unit": "str | None",
    "model.fit['rmse']": "float",
    "model.fit['expected_rmse']": "float | None",
    "model.sign": "Literal['rising'] | Literal['falling']",
    "model.digest": "str",
    "model.inverse()": "dbo_cli.library.Model",
    "dbo.read_models('set.json')['x']": "dbo_cli.library.Model",
    "dbo.identify('log.csv', delay=0.0)": "dbo_cli.library.Model",
    "model.simulate(wanted, time=time)": ARRAY,
    "model.simulate(wanted, return_state=True)": f"tuple[{ARRAY}, dbo_cli.model.state.State]",
    "model.compensate(wanted, time=time, v_max='100V')": ARRAY,
    "model.compensate(wanted, details=True)": "dbo_cli.drive.drive.Drive",
    "model.compensate(wanted, details=True).expected_error": "float | None",
    "model.controller(5000, lookahead='auto').plan(1.0)": "float",
    "dbo.report(wanted, wanted, time=time)": "dbo_cli.reports.report.Report",
    "dbo.report(wanted, wanted).rmse": "float",
}
WRONG = {
    "model.colour": "attr-defined",
    "model.compensate(wanted, vmax=100)": "call-overload",
    "model.simulate(wanted, outside='drop')": "call-overload",
    "dbo.identify('log.csv', delays=0.0)": "call-arg",
    "dbo.report(wanted, wanted, model='model.json')": "arg-type",
}


def test_a_type_checker_knows_what_comes_out(tmp_path: Path) -> None:
    lines = [f"reveal_type({expression})" for expression in REVEALED]
    script = tmp_path / "use.py"
    script.write_text(USE + "\n".join([*lines, *WRONG]) + "\n")
    # the package's own configuration: what ``mypy`` found out before, it need not again
    options = [
        f"--config-file={ROOT / 'pyproject.toml'}",
        f"--cache-dir={ROOT / '.mypy_cache'}",
    ]
    said = api.run([*options, "--strict", "--no-error-summary", str(script)])[0]
    first = USE.count("\n") + 1
    for number, (expression, kind) in enumerate(REVEALED.items(), first):
        assert f'use.py:{number}: note: Revealed type is "{kind}"' in said, (
            expression,
            said,
        )
    for number, (expression, code) in enumerate(WRONG.items(), first + len(REVEALED)):
        found = [
            line for line in said.splitlines() if f"use.py:{number}: error" in line
        ]
        assert found and all(f"[{code}]" in line for line in found), (expression, said)


CALLS = [
    dbo.read_log, dbo.read_model, dbo.read_models, dbo.identify, dbo.report, dbo.Model.simulate,
    dbo.Model.compensate, dbo.Model.controller, dbo.Model.save, dbo.Model.save_state,
]  # fmt: skip


@pytest.mark.parametrize("call", CALLS, ids=lambda call: call.__name__)
def test_a_signature_names_what_there_is(call: object) -> None:
    assert callable(call)
    signature = inspect.signature(call)
    for parameter in signature.parameters.values():
        assert parameter.kind is not inspect.Parameter.VAR_KEYWORD
        if parameter.name != "self":
            assert parameter.annotation not in ("Any", inspect.Parameter.empty)
        if parameter.kind is inspect.Parameter.KEYWORD_ONLY:
            assert parameter.name in (call.__doc__ or "")
    assert signature.return_annotation not in ("Any", inspect.Signature.empty)


def test_the_types_of_a_move_are_those_of_compensate() -> None:
    """Overloads take the keywords from one table, which must hold every one."""
    named = set(inspect.signature(dbo.Model.compensate).parameters)
    assert set(Move.__annotations__) == named - {"self", "wanted", "time", "details"}
