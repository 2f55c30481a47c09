"""Units: spellings, headers, ratios and figures with units."""

import pytest

from dbo_cli.units import drive_unit, quantity_name, split_header


@pytest.mark.parametrize(
    ("header", "name", "unit"),
    [
        ("voltage_V", "voltage", "V"),
        ("Weg/nm", "Weg", "nm"),
        ("Drive voltage, V", "Drive voltage", "V"),
        ("voltage in milli volts", "voltage", "mV"),
        ("Displacement (microns)", "Displacement", "um"),
        ("field_kA/m", "field", "kA/m"),
        ("drive voltage/kV", "drive voltage", "kV"),
        ("V_piezo/V", "V_piezo", "V"),
        ("Weg_x/µm", "Weg_x", "um"),
        ("velocity_nm/s", "velocity_nm/s", None),
        ("Speed/nm/s", "Speed/nm/s", None),
        ("sample rate 1/s", "sample rate 1/s", None),
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


def test_what_a_signal_is_called():
    assert quantity_name("voltage", "bar") == "pressure"
    assert quantity_name("displacement", "um") == "displacement"
    assert quantity_name("displacement", "ppm") == "strain"
    assert (drive_unit("4bar"), drive_unit("80"), drive_unit(80.0)) == ("bar", "V", "V")
