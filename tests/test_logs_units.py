"""Units are converted within a kind, to the last digit; unlike kinds are refused, missing ones warned of."""

from __future__ import annotations

import re
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from dbo_cli.errors import InputError, UsageError
from dbo_cli.logs.columns import column_wish, parse_column
from dbo_cli.logs.request import ReadingOptions
from dbo_cli.logs.signal_log import Source, open_log
from dbo_cli.logs.units import (
    kind_of_unit,
    parse_scale,
    parse_time_unit,
    require_unit,
    unit_factor,
)


@pytest.mark.parametrize(
    ("unit", "wanted", "ratio"),
    [
        ("mV", "V", Fraction(1, 1000)),
        ("V", "mV", Fraction(1000)),
        ("um", "nm", Fraction(1000)),
        ("angstrom", "nm", Fraction(1, 10)),
        ("cm", "um", Fraction(10000)),
        ("kV", "V", Fraction(1000)),
        ("h", "ms", Fraction(3_600_000)),
        ("bar", "Pa", Fraction(100_000)),
        ("furlong", "furlong", Fraction(1)),
        (None, "V", Fraction(1)),
    ],
)
def test_a_unit_becomes_another_of_its_kind(
    unit: str | None, wanted: str, ratio: Fraction
) -> None:
    factor = unit_factor(unit, wanted)
    assert factor is not None
    assert Fraction(factor.numerator, factor.denominator) == ratio


@pytest.mark.parametrize(
    ("unit", "wanted"), [("um", "V"), ("degC", "K"), ("furlong", "um"), ("counts", "V")]
)
def test_unlike_units_have_no_factor(unit: str, wanted: str) -> None:
    assert unit_factor(unit, wanted) is None


def test_degrees_become_milliradians() -> None:
    assert float(unit_factor("deg", "mrad") or 0) == pytest.approx(
        17.453292519943297, rel=1e-15
    )
    assert kind_of_unit("arcsec") == "angle"


def test_a_conversion_keeps_the_digits() -> None:
    """1.1 mV is the float64 nearest to 0.0011 V: dividing gives it, multiplying by 0.001 does not always."""
    factor = unit_factor("mV", "V")
    assert factor is not None
    figures = np.array([1.1, 3.3, 5.5, 1234.567])
    assert factor.apply(figures).tolist() == [0.0011, 0.0033, 0.0055, 1.234567]
    same = unit_factor("V", "V")
    assert same is not None
    assert same.apply(figures) is figures


def converted(header: str, wanted: str | None, taker: str) -> tuple[Source, float]:
    """Return a source after a conversion, and what it makes of 1."""
    source = Source("run.csv", {"x": parse_column(header, 2)}, False, None, None)
    source.warns_of_units = True
    source.convert("x", wanted, taker)
    return source, float(source.in_units({"x": np.ones(1)})["x"][0])


def test_a_column_is_matched_with_a_model() -> None:
    source, one = converted("drive_mV", "V", "model.json takes voltage")
    assert (one, source.columns["x"].unit) == (0.001, "V")
    assert (source.notes, source.warnings) == (
        ["run.csv: column 'drive_mV' is converted from mV to V"],
        [],
    )
    for header, wanted in (("drive_mV", "mV"), ("u", None)):
        source, one = converted(header, wanted, "it")
        assert (one, source.notes, source.warnings) == (1.0, [], [])
    source, one = converted("drive", "V", "model.json takes voltage")
    assert (one, source.notes) == (1.0, [])
    assert source.warnings == [
        "run.csv: column 'drive' has no unit, but model.json takes voltage in V: its figures are taken as V "
        "(name the unit in the header, or convert with `scale`)"
    ]
    source, one = converted("drive_mV", None, "model.json takes voltage")
    assert (one, source.notes) == (1.0, [])
    assert "is in mV, but model.json takes voltage without a unit" in source.warnings[0]
    with pytest.raises(InputError) as raised:
        converted("sensor (V)", "um", "model.json gives displacement")
    assert str(raised.value) == (
        "run.csv: column 'sensor (V)' is in V, but model.json gives displacement in um "
        "(`scale` ROLE=FACTORum/V converts it)"
    )


@pytest.mark.parametrize(
    ("text", "role", "factor", "units"),
    [
        ("voltage=20", "voltage", 20.0, (None, None)),
        ("displacement=10um/V", "displacement", 10.0, ("um", "V")),
        ("x = -1.5e-3 µm / mV", "x", -0.0015, ("um", "mV")),
        ("Voltage=.05", "voltage", 0.05, (None, None)),
    ],
)
def test_scales(
    text: str, role: str, factor: float, units: tuple[str | None, str | None]
) -> None:
    scale = parse_scale(text)
    assert (scale.role, float(scale.factor), (scale.unit_out, scale.unit_in)) == (
        role,
        factor,
        units,
    )


@pytest.mark.parametrize(
    "text",
    ["voltage", "voltage=", "=20", "voltage=x", "voltage=10um", "voltage=1,5", "a=."],
)
def test_what_is_no_scale_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="give ROLE=FACTOR or ROLE=FACTORUNIT/UNIT"):
        parse_scale(text)
    with pytest.raises(UsageError, match="a factor of 0 leaves nothing"):
        ReadingOptions(scale=("voltage=0",))
    with pytest.raises(UsageError, match="too large or too small"):
        ReadingOptions(scale=("voltage=1e999",))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "voltage=" + "7" * 5000,
            "voltage=" + "7" * 29 + "...: the factor is too large or too small",
        ),
        (
            "voltage=1e" + "7" * 5000,
            "voltage=1e" + "7" * 27 + "...: the factor is too large or too small",
        ),
        ("voltage=1e-260", "voltage=1e-260: the factor is too large or too small"),
        (
            "voltage=1e260nm/V",
            "voltage=1e260nm/V: the factor is too large or too small",
        ),
        (
            "voltage=0." + "0" * 5000,
            "voltage=0." + "0" * 27 + "...: a factor of 0 leaves nothing of the signal",
        ),
    ],
)
def test_a_factor_beyond_the_arithmetic_is_refused(text: str, message: str) -> None:
    with pytest.raises(UsageError) as raised:
        parse_scale(text)
    assert str(raised.value) == f"`scale` {message}"


def test_a_factor_may_have_many_digits() -> None:
    assert float(parse_scale("voltage=1." + "0" * 700).factor) == 1.0
    assert float(parse_scale("voltage=" + "0" * 700 + "2").factor) == 2.0


@pytest.mark.parametrize(
    "text", ["9" * 5000 + "s", "1" + "0" * 300 + "h", "0." + "0" * 5000 + "1s"]
)
def test_a_time_unit_beyond_the_arithmetic_is_refused(text: str) -> None:
    with pytest.raises(UsageError) as raised:
        ReadingOptions(time_unit=text)
    assert str(raised.value) == (
        f"`time_unit` {text[:37]}...: give s, ms, us, ns, ps, min, h or d, or a number of them such as 10us"
    )


def read(
    folder: Path, header: str, *scale: str
) -> tuple[list[float], list[float], str]:
    path = folder / "log.csv"
    path.write_text(f"time_s,{header}\n0,1,3\n0.001,2,5\n")
    want = {
        role: column_wish(role, option=role) for role in ("voltage", "displacement")
    }
    with open_log(str(path), want, ReadingOptions(scale=scale)) as log:
        block = log.read()
    units = f"{log.columns['voltage'].unit} {log.columns['displacement'].unit}"
    return (
        block.values["voltage"].tolist(),
        block.values["displacement"].tolist(),
        units,
    )


def test_scales_are_applied_to_their_role(tmp_path: Path) -> None:
    assert read(tmp_path, "monitor voltage_V,sensor_V", "voltage=20", "displacement=10um/V") == (
        [20.0, 40.0], [30.0, 50.0], "V um",
    )  # fmt: skip
    assert read(tmp_path, "u,sensor_mV", "displacement=10um/V") == (
        [1.0, 2.0],
        [0.03, 0.05],
        "None um",
    )
    with pytest.raises(
        InputError,
        match=r"'sensor_nm' is in nm, but `scale` displacement=10um/V takes V",
    ):
        read(tmp_path, "u,sensor_nm", "displacement=10um/V")
    with pytest.raises(
        UsageError, match="there is no drive here, but voltage, displacement"
    ):
        read(tmp_path, "u,sensor_V", "drive=20")
    with pytest.raises(UsageError, match="voltage is scaled twice"):
        read(tmp_path, "u,sensor_V", "voltage=20", "voltage=2")


def test_doubtful_units_are_warned_of(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("voltage_mV,displacement\nV,furlong\n1,2\n3,4\n")
    want = {
        role: column_wish(role, option=role) for role in ("voltage", "displacement")
    }
    with open_log(str(path), want, ReadingOptions(header_lines=2)) as log:
        assert log.warnings == [
            f"{path}: column 'voltage_mV' is in mV by its name and in V by its unit: "
            "V is taken (`scale` converts)",
            f"{path}: the unit 'furlong' of column 'displacement' is not known and carried as it is "
            "(`scale` ROLE=FACTORUNIT/UNIT converts)",
        ]


@pytest.mark.parametrize(
    ("unit", "wanted", "factor"),
    [
        ("cm", "mm", 10.0), ("angstrom", "nm", 0.1), ("min", "s", 60.0), ("h", "min", 60.0),
        ("deg", "rad", 0.017453292519943295), ("arcsec", "urad", 4.84813681109536),
        ("uF", "nF", 1000.0), ("nF", "pF", 1000.0), ("F", "uF", 1e6),
        ("bar", "Pa", 1e5), ("mbar", "Pa", 100.0), ("psi", "Pa", 6894.757293168),
        ("kA/m", "A/m", 1000.0), ("Nm", "mNm", 1000.0), ("kV", "V", 1000.0), ("mV", "uV", 1000.0),
    ],
)  # fmt: skip
def test_units_are_what_the_tables_of_the_si_say(
    unit: str, wanted: str, factor: float
) -> None:
    """Definitions: psi of 0.45359237 kg, 9.80665 m/s2 and (0.0254 m)2; a second of arc is pi/648,000 rad."""
    there, back = unit_factor(unit, wanted), unit_factor(wanted, unit)
    assert there is not None and back is not None
    assert float(there) == pytest.approx(factor, rel=1e-12)
    assert float(back) == pytest.approx(1.0 / factor, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "unit", "seconds"),
    [("s", "s", 1.0), ("ms", "ms", 1e-3), ("us", "us", 1e-6), ("ns", "ns", 1e-9), ("min", "min", 60.0),
     ("h", "h", 3600.0), ("d", "d", 86400.0)],
)  # fmt: skip
def test_a_unit_of_time_in_seconds(text: str, unit: str, seconds: float) -> None:
    name, factor = parse_time_unit(text)
    assert name == unit
    assert float(factor) == pytest.approx(seconds, rel=1e-12)


def test_a_plain_limit_of_a_drive_in_kilovolts_is_refused_with_both_meanings() -> None:
    message = (
        "`v_max` 100: the drive is in kV, and a plain number may be meant in V "
        "(`v_max` 0.1kV or `v_max` 100kV)"
    )
    with pytest.raises(UsageError, match="^" + re.escape(message) + "$"):
        require_unit("v_max", 100.0, "kV")
