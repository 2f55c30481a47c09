"""Names, units and guesses; what is said about an input in a model."""

from __future__ import annotations

import hashlib
import sys
from pathlib import Path

import pytest

from dbo_cli.errors import InputError, UsageError
from dbo_cli.logs.columns import (
    ColumnWish,
    choose_columns,
    column_label,
    column_wish,
    list_columns,
    matching_columns,
    parse_column,
    split_header,
)
from dbo_cli.logs.request import ReadingOptions, parse_address
from dbo_cli.logs.signal_log import input_record, open_log
from dbo_cli.logs.units import normalise_unit
from dbo_cli.version import program_version_string


@pytest.mark.parametrize(
    ("header", "quantity", "unit"),
    [
        ("voltage_V", "voltage", "V"),
        ("displacement (µm)", "displacement", "um"),
        ("Position [μm]", "Position", "um"),
        ("drive voltage, V", "drive voltage", "V"),
        ("Voltage/V", "Voltage", "V"),
        ("time in ms", "time", "ms"),
        ("Time (seconds)", "Time", "s"),
        ("pos <nm>", "pos", "nm"),
        ("sensor_y", "sensor_y", None),
        ("voltage_in", "voltage_in", None),
        ("Channel A", "Channel A", None),
        ("ch_A", "ch_A", None),
        ("voltage ()", "voltage", None),
        ("(V)", "(V)", None),
        ("V", "V", None),
        ("u", "u", None),
        ("temperature (°C)", "temperature", "degC"),
        ("load (furlong)", "load", "furlong"),
        ("drive milli volts", "drive", "mV"),
        ("напряжение (В)", "напряжение", "V"),
        ("перемещение, мкм", "перемещение", "um"),
        ("Time / milli seconds", "Time", "ms"),
        ("pos_micro_meters", "pos", "um"),
    ],
)
def test_headers(header: str, quantity: str, unit: str | None) -> None:
    assert split_header(header) == (quantity, unit)


def test_units_are_spelled_plainly() -> None:
    assert [normalise_unit(text) for text in ("[µm]", "Volts", "microns", "sec", "", "(-)")] == [
        "um", "V", "um", "s", None, "-",
    ]  # fmt: skip


def test_a_units_line_goes_before_the_name() -> None:
    assert parse_column("drive_mV", 2, "(V)").unit == "V"
    assert parse_column("", 2).name == "2"
    assert column_label(parse_column("", 2)) == "column 2"
    assert column_label(parse_column("u_V", 2)) == "column 'u_V'"


def test_guesses() -> None:
    names = ["time_s", "Drive Voltage (V)", "sensorPosition_um", "index"]
    columns = [parse_column(name, number) for number, name in enumerate(names, start=1)]
    want = {
        "voltage": ColumnWish(None, ("voltage", "u")),
        "displacement": ColumnWish(None, ("position",)),
    }
    assert {
        role: one.number for role, one in choose_columns("log", columns, want).items()
    } == {
        "voltage": 2,
        "displacement": 3,
    }
    assert (
        choose_columns(
            "log", columns, {"x": ColumnWish(None, ("nothing",), required=False)}
        )
        == {}
    )
    only = choose_columns(
        "log",
        columns[:2],
        {"input": ColumnWish(None, ("nothing",))},
        reserved=columns[:1],
    )
    assert only["input"].number == 2  # the only column left is what is meant


def test_a_column_is_not_guessed_twice() -> None:
    columns = [
        parse_column(name, number)
        for number, name in enumerate(("u", "v", "y"), start=1)
    ]
    want = {"desired": ColumnWish("1"), "voltage": ColumnWish(None, ("u", "v"))}
    assert choose_columns("log", columns, want)["voltage"].number == 2


def test_a_column_by_name_case_or_quantity() -> None:
    columns = [
        parse_column(name, number)
        for number, name in enumerate(("Drive (V)", "y"), start=1)
    ]
    for selector in ("Drive (V)", "drive (v)", "drive", " Drive  (V) ", "1"):
        assert (
            choose_columns("log", columns, {"u": ColumnWish(selector)})["u"].number == 1
        )


def test_long_lists_are_shortened() -> None:
    columns = [parse_column(f"c{number}", number) for number in range(1, 31)]
    assert list_columns(columns).endswith("20 c20, … (30 in all)")


def test_addresses(tmp_path: Path) -> None:
    assert parse_address("a.h5::/run/1").group == "/run/1"
    assert parse_address("a.h5::").group == "/"
    assert parse_address("a.csv.gz").compressed
    assert parse_address("a.dat").kind == "text"
    assert parse_address("-").name == "standard input"
    assert parse_address("-", "hdf5").kind == "hdf5"
    odd = tmp_path / "a::b.csv"
    odd.write_text("")
    assert parse_address(str(odd)).path == str(odd)
    with pytest.raises(UsageError, match="an empty file name"):
        parse_address("")


def test_provenance(tmp_path: Path) -> None:
    assert program_version_string().startswith("dbo ")
    path = tmp_path / "log.csv"
    path.write_text("voltage\n1\n2\nx\n")
    with open_log(
        str(path), {"voltage": ColumnWish("1")}, ReadingOptions(skip_bad=True)
    ) as log:
        log.read()
        record = log.record()
    assert record == {
        "name": "log.csv",
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        "rows": 2,
    }
    assert input_record(f"{path}", 2) == record
    with pytest.raises(InputError, match="cannot be read: No such file"):
        input_record(str(tmp_path / "none.csv"), 1)


def test_the_digest_is_that_of_the_whole_file_though_few_rows_of_it_are_read(
    tmp_path: Path,
) -> None:
    path = tmp_path / "log.csv"
    # longer than what is read ahead
    path.write_text("voltage\n" + "1.234567\n" * 50_000)
    with open_log(
        str(path),
        {"voltage": ColumnWish("1")},
        ReadingOptions(rows=(1, 5)),
        digest=True,
    ) as log:
        log.read()
        record = log.record()
    assert record == {
        "name": "log.csv",
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        "rows": 5,
    }


def calls_to_match(columns: int) -> int:
    """How many functions are called to find the displacement among columns called x."""
    given = [
        parse_column("stage displacement", 1, "um"),
        *(parse_column("x (um)", n + 2) for n in range(columns)),
    ]
    calls = 0

    def count(frame: object, event: str, argument: object) -> None:
        nonlocal calls
        calls += event == "call"

    sys.setprofile(count)
    try:
        found = matching_columns(given, column_wish("displacement"))
    finally:
        sys.setprofile(None)
    assert found == given
    return calls


def test_the_work_grows_with_the_number_of_columns_not_with_its_square() -> None:
    assert calls_to_match(800) < 4.1 * calls_to_match(200)


def test_a_message_names_twenty_columns_at_most(tmp_path: Path) -> None:
    columns = [parse_column("position (um)", n + 1) for n in range(30)]
    with pytest.raises(InputError) as raised:
        choose_columns(
            "log.csv",
            columns,
            {"displacement": column_wish("displacement", option="displacement")},
        )
    assert str(raised.value) == (
        "log.csv: which column is the displacement, "
        + "'position (um)' or " * 20
        + "… (30 in all)? (choose with `displacement` NAME or NUMBER)"
    )
    with pytest.raises(InputError) as raised:
        choose_columns(
            "log.csv",
            columns,
            {"displacement": column_wish("displacement", "position")},
        )
    assert str(raised.value) == (
        "log.csv: column 'position' occurs more than once: give its number (`column` "
        + " or ".join(str(n + 1) for n in range(20))
        + " or … (30 in all))"
    )


@pytest.mark.parametrize(
    ("text", "format", "path", "group", "kind", "delimiter"),
    [
        ("run.csv", None, "run.csv", None, "text", ","),
        ("RUN.TSV.GZ", None, "RUN.TSV.GZ", None, "text", "\t"),
        ("run.txt", "tsv", "run.txt", None, "text", "\t"),
        ("xtsv", None, "xtsv", None, None, ","),
        ("run", "csv", "run", None, "text", ","),
        ("-", "h5", "-", None, "hdf5", ","),
        ("store.h5::", None, "store.h5", "/", "hdf5", ","),
        ("store::/run/1", None, "store", "/run/1", "hdf5", ","),
    ],
)
def test_an_address_is_taken_apart_once(
    text: str,
    format: str | None,
    path: str,
    group: str | None,
    kind: str | None,
    delimiter: str,
) -> None:
    address = parse_address(text, format)
    assert (address.path, address.group, address.kind, address.delimiter) == (
        path,
        group,
        kind,
        delimiter,
    )
    assert parse_address(address) is address
    assert parse_address(address, format) is address
    assert address.is_stream == (text == "-")
    assert parse_address(address, "h5").kind == "hdf5"


def taken(
    header: str, role: str = "displacement", **more: object
) -> tuple[dict[str, str], list[str]]:
    """Return what the columns of a header are taken for, and what is said of it."""
    columns = [
        parse_column(name, number)
        for number, name in enumerate(header.split(","), start=1)
    ]
    want = {
        "voltage": column_wish("voltage", option="voltage"),
        "displacement": column_wish(role, option="displacement"),
    }
    if role == "trajectory":
        del want["voltage"]
    notes: list[str] = []
    chosen = choose_columns("log", columns, want, [columns[0]], notes=notes)
    return {name: column.name for name, column in chosen.items()}, notes


@pytest.mark.parametrize(
    "axes",
    [
        "x_um,y_um",
        "X (um),Y (um)",
        "X [mrad],Y [mrad]",
        "x_nm,y_nm,z_nm",
        "x,y",
        "z_um,y_um",
    ],
)
def test_axes_are_asked_about_in_logs_and_trajectories(axes: str) -> None:
    names = " or ".join(f"'{name}'" for name in axes.split(","))
    for header, role in (
        (f"time_s,{axes}", "trajectory"),
        (f"time_s,voltage_V,{axes}", "displacement"),
    ):
        with pytest.raises(InputError) as raised:
            taken(header, role)
        assert str(raised.value) == (
            f"log: which column is the displacement, {names}? (choose with `displacement` NAME or NUMBER)"
        )


def test_one_axis_and_a_whole_name_beside_axes_need_no_question() -> None:
    assert taken("time_s,y_um", "trajectory") == ({"displacement": "y_um"}, [])
    assert taken("time_s,voltage_V,x_um")[0]["displacement"] == "x_um"
    assert (
        taken("time_s,voltage_V,x_um,displacement_um")[0]["displacement"]
        == "displacement_um"
    )


def test_the_only_column_of_a_unit_or_of_a_card_is_taken_with_a_note() -> None:
    found, notes = taken("time_s,HV [V],Tip angle (mrad)")
    assert found == {"voltage": "HV [V]", "displacement": "Tip angle (mrad)"}
    assert notes == [
        "log: 'HV [V]' is taken for the drive: no other column is in a unit of voltage (`voltage` names "
        "another)",
        "log: 'Tip angle (mrad)' is taken for the displacement: no other column is in a unit of angle "
        "(`displacement` names another)",
    ]
    found, notes = taken("time_s,Dev1/ao0,Dev1/ai0")
    assert found == {"voltage": "Dev1/ao0", "displacement": "Dev1/ai0"}
    assert (
        notes[0]
        == "log: 'Dev1/ao0' is taken for the drive: the only analog output (`voltage` names another)"
    )


@pytest.mark.parametrize(
    "header",
    [
        "time_s,HV [V],Bias [V],position_um",  # two in volts
        "time_s,HV monitor [V],temp,position_um",  # a scale of its own
        "time_s,voltage_V,current_A",  # what the amplifier delivers
        "time_s,displacement_um,tilt (mrad)",
        "time_s,displacement_um,temperature (degC),x1",
        "time_s,Photodiode [V],position_um",
        "time_s,drive (mA),HV [V],position_um",  # the drive is there, in a unit that cannot be meant
        "time_s,ao0,ao1,ai0",
        "time_s,ai0,ai1",
        "time_s,voltage_V,Temperature drift (mrad)",
        "time_s,voltage_V,Setpoint angle (mrad)",
        "time_s,voltage_V,Tip (mrad),Tilt (mrad)",
    ],
)
def test_what_may_be_something_else_is_not_taken(header: str) -> None:
    with pytest.raises(InputError, match="no column is recognised as the"):
        taken(header)


@pytest.mark.parametrize(
    ("header", "role"),
    [
        ("time_s,drive temperature,displacement_um", "voltage"),
        ("time_s,Temp drive,displacement_um", "voltage"),
        ("time_s,voltage_V,sensor temperature", "displacement"),
        ("time_s,voltage_V,Temperatur Sensor", "displacement"),
        ("time_s,voltage_V,thermistor y", "displacement"),
    ],
)
def test_a_temperature_is_neither_voltage_nor_displacement(
    header: str, role: str
) -> None:
    names = ", ".join(
        f"{number} {name}" for number, name in enumerate(header.split(","), start=1)
    )
    with pytest.raises(InputError) as raised:
        taken(header)
    assert str(raised.value) == (
        f"log: no column is recognised as the {role}: it has {names} (choose with `{role}` NAME or NUMBER)"
    )


OTHER_ACTUATORS = {
    "time_s,pressure (bar),angle (deg)": ("pressure (bar)", "angle (deg)"),
    "time_s,force (N),displacement_um": ("force (N)", "displacement_um"),
    "time_s,force (N),angle (deg)": ("force (N)", "angle (deg)"),
    "time_s,torque (Nm),force (N)": ("force (N)", "torque (Nm)"),
    "time_s,B (mT),current (A)": ("current (A)", "B (mT)"),
    "time_s,field (kA/m),strain (ppm)": ("field (kA/m)", "strain (ppm)"),
    "time_s,temperature,strain": ("temperature", "strain"),
    "time_s,T (degC),elongation (%)": ("T (degC)", "elongation (%)"),
    "time_s,charge (uC),position (um)": ("charge (uC)", "position (um)"),
    "time_s,current (mA),desired_mm,position (mm)": ("current (mA)", "position (mm)"),
    "time_s,pressure (kPa),flow (l/min)": ("pressure (kPa)", "flow (l/min)"),
    "time_s,PWM (%),angle (deg)": ("PWM (%)", "angle (deg)"),
    "time_s,valve,position_um": ("valve", "position_um"),
    "time_s,voltage_V,level": ("voltage_V", "level"),
}


@pytest.mark.parametrize("header", OTHER_ACTUATORS)
def test_any_drive_and_any_output_is_known_by_its_quantity_or_by_what_is_left(
    header: str,
) -> None:
    columns, notes = taken(header)
    assert (columns["voltage"], columns["displacement"]) == OTHER_ACTUATORS[header]
    assert notes or header == "time_s,PWM (%),angle (deg)"


def test_a_monitor_that_alone_is_left_is_taken_with_a_word_on_its_scale() -> None:
    columns, notes = taken("time_s,hv_monitor_V,position_um")
    assert columns["voltage"] == "hv_monitor_V"
    assert notes == [
        "log: 'hv_monitor_V' is taken for the drive: no other column is left; a monitor's scale is its own "
        "(`scale` gives it) (`voltage` names another)"
    ]


def test_where_two_columns_can_be_either_both_commands_are_shown() -> None:
    with pytest.raises(InputError) as raised:
        taken("time_s,force (N),force2 (N)")
    assert str(raised.value) == (
        "log: no column is recognised as the voltage nor as the displacement: it has 1 time_s, 2 force (N), "
        "3 force2 (N) (`voltage` 'force (N)' `displacement` 'force2 (N)', or `voltage` 'force2 (N)' "
        "`displacement` 'force (N)')"
    )


def test_a_temperature_beside_the_signals_needs_no_question() -> None:
    signals = {"voltage": "voltage_V", "displacement": "displacement_um"}
    header = "time_s,drive temperature,voltage_V,sensor temperature,displacement_um"
    assert taken(header) == (signals, [])
    header = "time_s,target temperature,displacement_um"
    assert taken(header, "trajectory") == ({"displacement": "displacement_um"}, [])


def test_a_name_of_which_only_brackets_are_left_may_be_meant() -> None:
    """It stood beside 'Sensor voltage', which was taken for the displacement without a word."""
    headers = (") (mm)", "time (hours)", "Voltage (V)", "Sensor voltage (V)")
    columns = [
        parse_column(name, number) for number, name in enumerate(headers, start=1)
    ]
    assert [
        one.number for one in matching_columns(columns, column_wish("displacement"))
    ] == [1, 4]
