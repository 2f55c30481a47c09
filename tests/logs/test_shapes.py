"""Files of instruments and programs: each is read right, or refused with what to type.

The files are data (``tests/shapes/text.json``): what is in them, what is asked for, and
what must come out, or the options that the refusal must name.
"""

import base64
import json
import re
from pathlib import Path

import numpy as np
import pytest

from dbo_cli.errors import DboError
from dbo_cli.logs import Reading, open_log

SHAPES = Path(__file__).resolve().parent.parent / "shapes" / "text.json"
CASES = json.loads(SHAPES.read_text(encoding="utf-8"))


def write(case, folder):
    path = folder / f"run{case['ending']}"
    if "text" in case:
        path.write_bytes(case["text"].encode())
    else:
        path.write_bytes(base64.b64decode(case["base64"]))
    return str(path) + case.get("part", "")


@pytest.mark.parametrize("case", CASES, ids=[case["name"] for case in CASES])
@pytest.mark.filterwarnings("ignore::dbo_cli.errors.DboWarning")
def test_a_shape_is_right_or_refused(case, tmp_path):
    path = write(case, tmp_path)
    options = case.get("reading", {})
    if "refused" in case:
        with (
            pytest.raises(DboError) as raised,
            open_log(path, case["roles"], Reading(**options)) as log,
        ):
            log.read()
        message = str(raised.value)
        assert "\n" not in message
        assert set(case["refused"]) <= set(re.findall(r"`\w+`", message))
        if "line" in case:
            assert f":{case['line']}:" in message
        return
    with open_log(path, case["roles"], Reading(**options)) as log:
        table = log.read()
    for role in ("voltage", "displacement"):
        if role in case:
            np.testing.assert_allclose(table[role], case[role], rtol=1e-15)
    if case["time"] is None:
        assert table.time is None
    else:
        np.testing.assert_allclose(table.time, case["time"], rtol=1e-12, atol=1e-15)
    stamp = log.clock.first_stamp
    is_dated = stamp is not None and stamp >= 86_400 * 10**9
    began = stamp / 1e9 if is_dated else None
    assert began == pytest.approx(case.get("origin"), abs=1e-6)
    assert [column.unit for column in log.columns.values()] == case["units"]
