"""Units: spellings, headers, ratios and figures with units."""

import pytest

from dbo_cli.errors import UsageError
from dbo_cli.units import drive_unit, parse_quantity, quantity_name, split_header


@pytest.mark.parametrize(
    ("header", "name", "unit"),
    [
        ("voltage_V", "voltage", "V"),
        ("Position [µm]", "Position", "um"),
        ("Weg/nm", "Weg", "nm"),
        ("time (ms)", "time", "ms"),
        ("CH1 in V", "CH1", "V"),
        ("Drive voltage, V", "Drive voltage", "V"),
        ("voltage in milli volts", "voltage", "mV"),
        ("Displacement (microns)", "Displacement", "um"),
        ("field_kA/m", "field", "kA/m"),
        ("Voltage (Volts)", "Voltage", "V"),
        ("U <VDC>", "U", "V"),
        ("in s", "in", "s"),
        ("sine_2", "sine_2", None),
        ("Channel A", "Channel A", None),
        ("V(drive)", "V(drive)", None),
        ("data[2]", "data[2]", None),
        ("Position (raw)", "Position (raw)", None),
        ("Posi)tion (mm", "Posi)tion (mm", None),
        ("", "", None),
    ],
)
def test_a_header_is_split_at_its_unit(header, name, unit):
    assert split_header(header) == (name, unit)


def test_figures():
    assert parse_quantity("4bar", "bar") == parse_quantity(4, "bar") == 4.0
    assert parse_quantity("2V/ms", "V/s") == 2000.0
    assert parse_quantity("3kA/m/s", "A/m/s") == 3000.0
    assert parse_quantity("-1.5e-3 kV", "V") == -1.5
    assert parse_quantity("7", None) == 7.0
    for figure in ("4bar", "nan", "x", "2V/s", "1 2", float("inf")):
        with pytest.raises(UsageError, match="`v_max`"):
            parse_quantity(figure, "V", "v_max")


def test_what_a_signal_is_called():
    assert quantity_name("voltage", "bar") == "pressure"
    assert quantity_name("displacement", "um") == "displacement"
    assert quantity_name("displacement", "ppm") == "strain"
    assert (drive_unit("4bar"), drive_unit("80"), drive_unit(80.0)) == ("bar", "V", "V")
