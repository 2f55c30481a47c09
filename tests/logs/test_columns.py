"""Which column has which role, and what is asked where that is not clear."""

import pytest

from dbo_cli.errors import InputError, UsageError
from dbo_cli.logs import Reading, open_log
from dbo_cli.logs.columns import _candidates, role_of
from dbo_cli.logs.table import Column
from dbo_cli.units import split_header

BOTH = {"voltage": None, "displacement": None}


def columns(*headers):
    return [
        Column(n, header, split_header(header)[1])
        for n, header in enumerate(headers, 1)
    ]


def found(role, *headers, unit=None):
    return [
        column.number for column in _candidates(columns(*headers), role_of(role, unit))
    ]


def write(folder, header, rows=3):
    path = folder / "run.csv"
    cells = header.count(",") + 1
    lines = [",".join(str(n / 1000 + k) for k in range(cells)) for n in range(rows)]
    path.write_text("\n".join([header, *lines]) + "\n")
    return str(path)


@pytest.mark.parametrize(
    ("role", "headers", "numbers"),
    [
        ("voltage", ["time_s", "voltage_V", "displacement_um"], [2]),
        ("voltage", ["t", "u", "y"], [2]),
        ("voltage", ["t", "CH1 [V]", "CH2 [um]"], [2]),
        ("displacement", ["t", "CH1 [V]", "CH2 [um]"], [3]),
        ("displacement", ["t", "drive", "sensor_V"], [3]),
        ("displacement", ["Time", "Piezo Voltage", "Target Position", "Current Position"], [4]),
        ("displacement", ["desired_um", "measured_um"], [2]),
        ("desired", ["desired_um", "measured_um"], [1]),
        ("trajectory", ["desired_um", "position_um"], [1]),
        ("trajectory", ["position_um"], [1]),
        ("voltage", ["CH1 [V]", "CH2 [V]"], [1, 2]),
        ("voltage", ["drive", "u"], [1, 2]),
        ("voltage", ["sensor_V", "piezo_V"], [2]),
        ("voltage", ["temperature_degC", "supply voltage"], []),
        ("displacement", ["x [um]", "y [um]", "z [um]"], [1, 2, 3]),
        ("displacement", ["temp", "height_nm"], [2]),
        ("voltage", ["pressure_bar", "stroke_mm"], [1]),
        ("voltage", ["voltage_um", "CH1 [V]"], []),
    ],
)  # fmt: skip
def test_a_role_is_found(role, headers, numbers):
    assert sorted(found(role, *headers)) == numbers


def test_a_unit_of_a_model_says_what_is_looked_for():
    assert found("voltage", "voltage_V", "pressure_bar", unit="bar") == [2]
    assert found("input", "voltage_V", "position_um", unit="um") == [2]
    assert found("input", "voltage_V", "position_um", unit="V") == [1]
    with pytest.raises(UsageError):
        role_of("colour", None)


def test_scales(tmp_path):
    path = write(tmp_path, "time_s,voltage_V,sensor_V")
    reading = Reading(scale={"voltage": "20", "displacement": "10um/V"})
    with open_log(path, BOTH, reading, {"displacement": "nm"}) as log:
        table = log.read()
        assert [column.unit for column in log.columns.values()] == ["V", "nm"]
    assert table["voltage"].tolist() == pytest.approx([20.0, 20.02, 20.04], rel=1e-15)
    assert table["displacement"][0] == 20000.0
    with pytest.raises(InputError, match="`scale`"):
        open_log(path, BOTH, Reading(scale={"voltage": "2um/A"}))
    with pytest.raises(
        InputError, match="which column is voltage and which displacement"
    ):
        open_log(path, {"voltage": "1", "displacement": "1"})
