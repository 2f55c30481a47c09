"""The public functions; ``import dbo_cli as dbo`` finds them as ``dbo.identify`` and so on."""

from __future__ import annotations

import dataclasses
import hashlib
import os
import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dbo_cli.errors import InputError, UsageError
from dbo_cli.logs.addresses import parse_address
from dbo_cli.logs.column_names import wish
from dbo_cli.logs.reading_options import ALL_ROWS, ReadingOptions, parse_rows
from dbo_cli.logs.signal_log import SignalLog, open_log
from dbo_cli.logs.sources import ArraySource, is_file, is_table, table_source
from dbo_cli.remarks import DboWarning, Remarks
from dbo_cli.runs.model import Model, read_model, require_known
from dbo_cli.runs.roles import recording_wishes, short_names

if TYPE_CHECKING:
    import pandas

    from dbo_cli.hysteresis.model import ActuatorModel
    from dbo_cli.runs.identifying import RecordedLog
    from dbo_cli.runs.tracking import TrackingOptions, TrackingReport, TrackingRun

__all__ = ["Model", "compensate", "identify", "read_log", "read_model", "report", "simulate"]

Floats = NDArray[np.float64]


def read_log(
    path: str | os.PathLike[str],
    *,
    voltage: str | None = None,
    displacement: str | None = None,
    desired: str | None = None,
    time: str | None = None,
    rows: str | None = None,
    **reading: Any,
) -> pandas.DataFrame:
    """Read a log as the commands read it.

    Parameters
    ----------
    path
        A file, or ``FILE::/group`` of an HDF5 file.
    voltage, displacement, desired, time
        The columns: a header name, a dataset path, or a number counted from 1; guessed where not given.
    rows
        ``A:B``, data rows counted from 1, both ends included.
    **reading
        Whatever else ``ReadingOptions`` knows: ``sample_rate``, ``skip_bad``, ``delimiter``, …

    Returns
    -------
    DataFrame
        Columns ``time`` (s), ``voltage``, ``displacement``, ``desired``, as far as they are there. ``attrs``:
        ``units`` (by column), ``sample_rate`` (Hz, where no stamps tell the time), ``notes``, and
        ``provenance`` (name, sha256 and rows).

    Raises
    ------
    InputError
        The log is absent, unreadable or empty, or holds neither voltage nor displacement.
    UsageError
        An option is senseless.
    """
    options = _reading(time, rows, reading)
    want = {
        "voltage": wish("voltage", voltage, required=False, option="voltage"),
        "desired": wish("desired", desired, required=False, option="desired"),
        "displacement": wish("displacement", displacement, required=False, option="displacement"),
    }
    with open_log(path, want, options, digest=True) as log:
        if not log.columns:  # refused by this, with what there is to choose from
            open_log(path, recording_wishes(voltage, displacement), options).close()
        return _frame(log)


def _frame(log: SignalLog) -> pandas.DataFrame:
    """Read a log whole into a table."""
    import pandas as pd

    block = log.read()
    stamps = {"time": block.time} if block.time is not None and log.even_rate is None else {}
    frame = pd.DataFrame(stamps | dict(block.values))
    units = {role: column.unit for role, column in log.columns.items()}
    frame.attrs |= {
        "units": ({"time": "s"} if stamps else {}) | units,
        "notes": list(log.notes),
        "warnings": list(log.warnings),
        "read": [log.reading_line()],
        "provenance": dict(log.record()) | {"read": log.reading_record()},
    }
    if log.even_rate is not None:
        frame.attrs["sample_rate"] = log.even_rate
    return frame


def identify(
    log: Any,
    displacement: ArrayLike | None = None,
    *,
    time: Any = None,
    sample_rate: float | None = None,
    validate: Any = (),
    prior: Model | str | os.PathLike[str] | None = None,
    voltage_unit: str | None = None,
    displacement_unit: str | None = None,
    **options: Any,
) -> Model:
    """Identify a model of an actuator from logs of its drive voltage and displacement.

    Parameters
    ----------
    log : array_like, DataFrame, file name, or a list of tables and files
        The drive voltage of shape (samples,) beside ``displacement``; or one or more logs of one actuator.
    displacement : array_like of shape (samples,), optional
        The measured displacement, where ``log`` is the voltage.
    time, sample_rate
        Seconds of shape (samples,), or samples a second (Hz), for arrays; for tables and files a column's
        name or number, or the rate of a log without time.
    validate
        Another log, or a list of logs, to say how well the model predicts.
    prior : Model or file name, optional
        Keep the shape of this model, and find its gain, offset and lag again from a short log.
    voltage_unit, displacement_unit : str, optional
        Units of arrays, for the model to carry.
    **options
        What ``IdentificationOptions`` knows (``gears``, ``points``, ``relaxation``, ``delay``, ``slopes``,
        ``skip_seconds``, ``method``, ``zero``, ``rated``, ``force``); all else is found on data left out.

    Returns
    -------
    Model
        With ``summary`` and ``warnings``; warnings also go the way of Python's own (``DboWarning``).

    Raises
    ------
    InputError
        A log cannot be read, or an array is none of finite numbers.
    FitError
        Nothing trustworthy can be identified.
    UsageError
        The options contradict each other or the logs.
    """
    from dbo_cli.hysteresis.identification import IdentificationOptions
    from dbo_cli.runs.identifying import arguments_of, chosen_of, identify_recordings

    require_known(IdentificationOptions, options, "is no parameter of identify")
    asked = IdentificationOptions(**options)
    kept = None if prior is None else _model(prior).actuator
    if displacement is not None:
        units = {"voltage": voltage_unit, "displacement": displacement_unit}
        logs = [_recorded_arrays(log, displacement, time, sample_rate, units, kept)]
    else:
        logs = [_recorded(one, time, sample_rate, kept) for one in _listed(log)]
    checks = [_recorded(one, time, sample_rate, kept) for one in _listed(validate)]
    named = {"prior": os.path.basename(prior)} if isinstance(prior, str | os.PathLike) else {}
    arguments = arguments_of(_names(logs), _names(checks), chosen_of(asked) | named)
    found = identify_recordings(logs, asked, checks, arguments, kept)
    for text in found.remarks.warnings:
        warnings.warn(text, DboWarning, stacklevel=2)
    return Model(found.model, found.summary, found.remarks)


def simulate(model: Model | str | os.PathLike[str], x: Any, **options: Any) -> Any:
    """Run a model, or the model in a file, over its input signal: ``Model.simulate``."""
    return _model(model).simulate(x, **options)


def compensate(model: Model | str | os.PathLike[str], wanted: Any, **options: Any) -> Any:
    """Return the drive that makes an actuator follow a trajectory: ``Model.compensate``."""
    return _model(model).compensate(wanted, **options)


def report(
    wanted: Any,
    measured: Any = None,
    *,
    time: Any = None,
    sample_rate: float | None = None,
    voltage: Any = None,
    model: Model | str | os.PathLike[str] | None = None,
    unit: str | None = None,
    name: str = "log",
    **options: Any,
) -> TrackingReport:
    """Report how well what was measured follows what was wanted, or what a model predicts.

    Parameters
    ----------
    wanted : array_like of shape (samples,), DataFrame, file name, or a list of tables and file names
        The desired displacement beside ``measured``; with ``model`` the drive voltage it predicts from; or
        one or several tables and logs that hold both columns.
    measured : array_like of shape (samples,), optional
        The measured displacement.
    time, sample_rate
        Seconds of shape (samples,), or samples a second (Hz).
    voltage : array_like or column, optional
        The drive beside the two, for the figures.
    model : Model, optional
        Compare its prediction with the measurement.
    unit, name : str, optional
        Unit of arrays, and what the report calls them.
    **options
        What ``TrackingOptions`` knows: ``lag``, ``remove_offset``, ``segment``, ``trajectory``, ``match``,
        ``count_sweep``, ``desired``; and how tables and files are to be read. ``rows`` are the desired rows
        that count; a model is run from the first row on.

    Returns
    -------
    TrackingReport
        ``report`` holds the numbers; ``to_frame()``, ``to_html()``, ``figures(folder)`` and so on show them.

    Raises
    ------
    InputError
        There is nothing to compare, or units differ.
    UsageError
        The options contradict each other.
    """
    logs = [] if measured is not None else _logs(wanted)
    asked = _tracking_options(options, logs, voltage)
    predicting = None if model is None else _model(model).actuator
    from dbo_cli.runs.tracking import TrackingRun

    tracking = TrackingRun(asked.scoring(predicting is not None), predicting, traced=True)
    options["sample_rate"] = sample_rate
    reading = _reading(time if isinstance(time, str) else None, options.pop("rows", None), options)
    if logs:
        _add_logs(tracking, logs, asked, reading, time, name)
    else:
        _add_arrays(tracking, (wanted, measured, voltage), asked, reading, time, unit, name)
    return tracking.result()


def _tracking_options(options: dict[str, Any], logs: Sequence[Any], voltage: Any) -> TrackingOptions:
    """Take what belongs to ``TrackingOptions`` out of the options of ``report``; the others remain."""
    from dbo_cli.runs.tracking import TrackingOptions

    known = {field.name for field in dataclasses.fields(TrackingOptions)}
    asked = {key: options.pop(key) for key in known & options.keys()}
    if asked.get("trajectory") is not None:
        if not logs or not all(map(is_file, logs)):
            raise UsageError("`trajectory` belongs to a log in a file; of arrays, give both signals")
        asked["trajectory"] = parse_address(asked["trajectory"])
    asked |= {"lag": _lag(asked.get("lag", 0)), "segment": _segment(asked.get("segment"))}
    return TrackingOptions(**asked | {"voltage": voltage if logs else None})


def _add_logs(
    tracking: TrackingRun,
    logs: Sequence[Any],
    options: TrackingOptions,
    reading: ReadingOptions,
    time: Any,
    name: str,
) -> None:
    """Compare tables and files."""
    from dbo_cli.runs.reporting import add_file, rows_to_score

    with_model = tracking.model is not None
    own, score = rows_to_score(reading, options.lag, from_first=with_model)
    files = {number: parse_address(one) for number, one in enumerate(logs, 1) if is_file(one)}
    names = short_names(list(files.values()))
    for number, one in enumerate(logs, 1):
        if number in files:
            add_file(tracking, files[number], reading, options, names.get(files[number]))
            continue
        table = table_source(one, options.wishes(with_model), time, reading.sample_rate, own.rows)
        sweep = options.count_sweep or reading.rows != ALL_ROWS
        called = name if len(logs) == 1 else f"{name} {number}"
        tracking.add(table, called, score_rows=score, count_sweep=sweep)


def _add_arrays(
    tracking: TrackingRun,
    signals: tuple[Any, Any, Any],
    options: TrackingOptions,
    reading: ReadingOptions,
    time: Any,
    unit: str | None,
    name: str,
) -> None:
    """Compare arrays: what was wanted (with a model: the drive), what was measured, perhaps the drive."""
    from dbo_cli.runs.reporting import rows_to_score

    wanted, measured, voltage = signals
    if measured is None:
        raise InputError(
            "what was measured is missing: give two arrays, or a table or file with both columns"
        )
    values = {"desired" if tracking.model is None else "voltage": wanted, "measured": measured}
    if voltage is not None and tracking.model is None:
        values["voltage"] = voltage
    own, score = rows_to_score(reading, options.lag, from_first=tracking.model is not None)
    source = ArraySource(values, time, reading.sample_rate, rows=own.rows)
    source.columns = {
        role: dataclasses.replace(column, unit=None if role == "voltage" else unit)
        for role, column in source.columns.items()
    }
    sweep = options.count_sweep or reading.rows != ALL_ROWS
    tracking.add(source, name, score_rows=score, count_sweep=sweep)


def _model(model: Model | str | os.PathLike[str]) -> Model:
    return model if isinstance(model, Model) else read_model(model)


def _reading(time: str | None, rows: str | None, options: dict[str, Any]) -> ReadingOptions:
    require_known(ReadingOptions, options, "says nothing about reading a log")
    return ReadingOptions(time=time, rows=ALL_ROWS if rows is None else parse_rows(rows), **options)


def _logs(given: Any) -> list[Any]:
    """Return the tables and files that were given, one or a list of them; none of anything else."""
    if is_file(given) or is_table(given):
        return [given]
    several = isinstance(given, list | tuple) and all(is_file(one) or is_table(one) for one in given)
    return list(given) if several else []


def _listed(logs: Any) -> Sequence[Any]:
    return [logs] if is_file(logs) or is_table(logs) else list(logs)


def _names(logs: Sequence[RecordedLog]) -> list[str]:
    return [str(one.record["name"]) for one in logs]


def _recorded(
    log: Any, time: Any, sample_rate: float | None, prior: ActuatorModel | None = None
) -> RecordedLog:
    """Return one log, a table or a file, ready to be identified from, in the units of a prior."""
    from dbo_cli.runs.identifying import RecordedLog, bring_to_prior, read_recordings, recording_of

    if is_file(log):
        options = ReadingOptions(time=time, sample_rate=sample_rate)
        return read_recordings([parse_address(log)], [], options, prior=prior)[0][0]
    if not is_table(log):
        raise InputError("a log is a table or a file's name; give two arrays as voltage and displacement")
    source = table_source(log, recording_wishes(None, None), time, sample_rate)
    bring_to_prior(source, prior)
    record = log.attrs.get("provenance") or _record(source)
    remarks = Remarks(**{key: list(log.attrs.get(key, [])) for key in ("notes", "warnings", "read")})
    return RecordedLog(recording_of(source, record["name"]), record, remarks)


def _recorded_arrays(
    voltage: ArrayLike,
    displacement: ArrayLike,
    time: ArrayLike | None,
    sample_rate: float | None,
    units: dict[str, str | None],
    prior: ActuatorModel | None,
) -> RecordedLog:
    from dbo_cli.runs.identifying import RecordedLog, bring_to_prior, recording_of

    source = ArraySource({"voltage": voltage, "displacement": displacement}, time, sample_rate)
    source.columns = {
        role: dataclasses.replace(column, unit=units[role]) for role, column in source.columns.items()
    }
    bring_to_prior(source, prior)
    return RecordedLog(recording_of(source, "arrays"), _record(source), Remarks(list(source.notes)))


def _record(source: ArraySource) -> dict[str, Any]:
    """Return what a model keeps of arrays it was identified from: a digest of their numbers."""
    digest = hashlib.sha256()
    for values in source.values.values():
        digest.update(values.astype("<f8").tobytes())
    count = next(iter(source.values.values())).size
    return {"name": "arrays", "sha256": digest.hexdigest(), "rows": count}


def _lag(lag: int | str) -> Any:
    if lag == "auto" or (isinstance(lag, int) and not isinstance(lag, bool)):
        return lag
    raise UsageError(f"`lag` {lag}: neither a whole number of samples nor 'auto'")


def _segment(segment: float | str | None) -> Any:
    if segment is None or segment == "cycles":
        return segment
    if isinstance(segment, int | float) and 0.0 < segment < float("inf"):
        return float(segment)
    raise UsageError(f"`segment` {segment}: neither 'cycles' nor a number of seconds above 0")
