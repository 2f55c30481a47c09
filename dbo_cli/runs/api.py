"""The public functions; ``import dbo_cli as dbo`` finds them as ``dbo.identify`` and so on."""

from __future__ import annotations

import dataclasses
import os
import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from dbo_cli.errors import InputError, UsageError
from dbo_cli.hysteresis.model_set import is_set
from dbo_cli.logs.channels import is_pattern
from dbo_cli.logs.columns import wish
from dbo_cli.logs.request import ALL_ROWS, Address, ReadingOptions, parse_address, parse_rows
from dbo_cli.logs.signal_log import SignalLog, open_log
from dbo_cli.logs.sources import ArraySource, is_file, is_log
from dbo_cli.remarks import DboWarning
from dbo_cli.runs.files import recording_wishes, short_names
from dbo_cli.runs.model import Model, identify_set, read_model_set, record_of
from dbo_cli.runs.model import read_model as read_single_model

if TYPE_CHECKING:
    import pandas

    from dbo_cli.runs.identifying import IdentifyRun
    from dbo_cli.runs.reporting import TrackingOptions, TrackingReport

__all__ = ["Model", "compensate", "identify", "read_log", "read_model", "report", "simulate"]


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
    displacement: Any = None,
    *,
    voltage: str | None = None,
    time: Any = None,
    sample_rate: float | None = None,
    validate: Any = (),
    prior: Any = None,
    voltage_unit: str | None = None,
    displacement_unit: str | None = None,
    jobs: int = 1,
    shared_shape: bool = False,
    coupling: bool = False,
    **options: Any,
) -> Any:
    """Identify a model of an actuator from logs of its drive voltage and displacement.

    Parameters
    ----------
    log : array_like, DataFrame, file name, or a list of tables and files
        The drive voltage of shape (samples,) beside ``displacement``; or one or more logs of one actuator.
    displacement : array_like of shape (samples,), optional
        The measured displacement, where ``log`` is the voltage.
    voltage, displacement : str, optional
        The columns of tables and files, else guessed; patterns (``V{}``, ``D{}``) name many channels'.
    time, sample_rate
        Seconds of shape (samples,), of tables and files the column; or samples a second (Hz) without one.
    validate
        Another log, or a list of logs, to say how well the model predicts.
    prior : Model or file name, optional
        Keep the shape of this model, and find its gain, offset and lag again from a short log; for channels
        a ``ModelSet`` or the file of one.
    voltage_unit, displacement_unit : str, optional
        Units of arrays, for the model to carry.
    jobs, shared_shape, coupling
        For channels: processes (change no result; a script that asks for several needs the usual
        ``if __name__ == "__main__":``); one loop shape for all; and how much each shows in the others, from a
        log in which all move (``excite --channels``).
    **options
        What ``IdentificationOptions`` knows (``gears``, ``delay``, …); all else is found on data left out.

    Returns
    -------
    Model, or of patterns a ModelSet
        With ``summary`` and ``warnings``; warnings also go the way of Python's own (``DboWarning``).

    Raises
    ------
    InputError, FitError, UsageError
        A log cannot be read; nothing trustworthy can be identified; options contradict each other or a log.
    """
    from dbo_cli.hysteresis.identification import IdentificationOptions
    from dbo_cli.runs.identifying import IdentifyRun

    fixed = record_of(IdentificationOptions, options, "is no parameter of identify")
    logs, columns = _given(log, displacement, voltage, time, sample_rate, voltage_unit, displacement_unit)
    reading = ReadingOptions(time=_column(time), sample_rate=sample_rate)
    words = (logs, _addressed(validate), reading, fixed, *columns, prior, shared_shape, coupling, time)
    return _identified(IdentifyRun(*words), jobs)


def _given(
    log: Any, displacement: Any, voltage: str | None, time: Any, sample_rate: float | None, *units: str | None
) -> tuple[list[Any], tuple[str | None, str | None]]:
    """Return logs, or the one that two arrays are, and the columns that were named."""
    if displacement is None or voltage is not None or isinstance(displacement, str):
        return _addressed(log), (voltage, displacement)
    roles = ("voltage", "displacement")
    named = dict(zip(roles, units, strict=True))
    source = ArraySource(dict(zip(roles, (log, displacement), strict=True)), time, sample_rate, units=named)
    return [source], (None, None)


def _identified(asked: IdentifyRun, jobs: int) -> Any:
    """Identify a model, or a set of them where the columns are patterns."""
    from dbo_cli.runs.identifying import identify_recordings

    if is_pattern(asked.voltage) or is_pattern(asked.displacement):
        return identify_set(asked, jobs)
    asked.refuse_channels_options()
    kept = None if asked.prior is None else _model(asked.prior).actuator
    fitted, checks = asked.read(prior=kept)
    arguments = asked.arguments({}, os.fspath(asked.prior) if is_file(asked.prior) else None)
    found = identify_recordings(fitted, asked.options, checks, arguments, kept)
    for text in found.remarks.warnings:
        warnings.warn(text, DboWarning, stacklevel=3)
    return Model(found.model, found.summary, found.remarks)


def read_model(path: str | os.PathLike[str]) -> Any:
    """Read a model file, or a set of models.

    Parameters
    ----------
    path
        The file, ``FILE::CHANNEL`` of a set, or ``-`` for standard input.

    Returns
    -------
    Model, or of a set a ModelSet
        ``FILE::CHANNEL`` is one model of a set.

    Raises
    ------
    InputError, ModelError
        The file cannot be read, is no model, or contradicts itself; the message names file and key.
    """
    if is_set(os.fspath(path)):
        return read_model_set(path)
    return read_single_model(path)


def simulate(model: Model | str | os.PathLike[str], x: Any, **options: Any) -> Any:
    """Run a model over its input signal.

    Parameters
    ----------
    model : Model or file name
        What is run.
    x, **options
        As in ``Model.simulate``.
    """
    return _model(model).simulate(x, **options)


def compensate(model: Model | str | os.PathLike[str], wanted: Any, **options: Any) -> Any:
    """Return the drive that makes an actuator follow a trajectory.

    Parameters
    ----------
    model : Model or file name
        The forward model of the actuator.
    wanted, **options
        As in ``Model.compensate``.
    """
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
        Unit and name of arrays.
    **options
        What ``TrackingOptions`` knows: ``lag``, ``remove_offset``, ``segment``, ``dwell``, ``trajectory``,
        ``match``, ``count_sweep``, ``desired``; and how tables and files are to be read. ``rows`` are the
        desired rows that count; a model is run from the first row on.

    Returns
    -------
    TrackingReport
        ``report`` holds the numbers; ``to_frame()``, ``to_html()``, ``figures(folder)`` and so on show them.

    Raises
    ------
    InputError, UsageError
        There is nothing to compare, or units differ; the options contradict each other.
    """
    from dbo_cli.runs.reporting import TrackingRun

    logs = [] if measured is not None else _logs(wanted)
    asked = _tracking_options(options, logs, voltage, time)
    predicting = None if model is None else _model(model).actuator
    tracking = TrackingRun(asked.scoring(predicting is not None), predicting, traced=True)
    reading = _reading(_column(time), options.pop("rows", None), options | {"sample_rate": sample_rate})
    if not logs:
        first = "desired" if predicting is None else "voltage"
        logs = [_pair({first: wanted, "measured": measured}, voltage, time, reading.sample_rate, unit)]
    names = short_names(logs)
    for number, one in enumerate(logs, 1):
        called = name if len(logs) < 2 else f"{name} {number}"
        shown = names.get(one) if isinstance(one, Address) else called
        tracking.add(one, reading, asked, shown, time=time)
    return tracking.result()


def _pair(
    signals: dict[str, Any], drive: Any, time: Any, sample_rate: float | None, unit: str | None
) -> ArraySource:
    """Return two arrays as a log, and the drive beside them; refuse one alone (InputError)."""
    if signals["measured"] is None:
        raise InputError(
            "what was measured is missing: give two arrays, or a table or file with both columns"
        )
    signals |= {} if drive is None or "voltage" in signals else {"voltage": drive}
    return ArraySource(signals, time, sample_rate, units={"desired": unit, "measured": unit})


def _column(time: Any) -> str | None:
    return str(time) if isinstance(time, str | int) else None


def _tracking_options(
    options: dict[str, Any], logs: Sequence[Any], voltage: Any, time: Any
) -> TrackingOptions:
    """Take what belongs to ``TrackingOptions`` out of the options of ``report``; the others remain."""
    from dbo_cli.runs.reporting import TrackingOptions

    known = {field.name for field in dataclasses.fields(TrackingOptions)}
    asked = {key: options.pop(key) for key in known & options.keys()}
    if asked.get("trajectory") is not None:
        if not logs or not all(isinstance(one, Address) for one in logs):
            raise UsageError("`trajectory` belongs to a log in a file; of arrays, give both signals")
        asked["trajectory"] = parse_address(asked["trajectory"])
    for role, given in {"voltage": voltage, "time": time}.items():
        if logs and not isinstance(given, str | int | None):
            raise UsageError(f"`{role}`: beside tables and files give the name or number of their column")
    return TrackingOptions(**asked | {"voltage": voltage if logs else None})


def _model(model: Model | str | os.PathLike[str]) -> Model:
    return model if isinstance(model, Model) else read_single_model(model)


def _reading(time: str | None, rows: str | None, options: dict[str, Any]) -> ReadingOptions:
    given = options | {"time": time, "rows": ALL_ROWS if rows is None else parse_rows(rows)}
    return record_of(ReadingOptions, given, "says nothing about reading a log")


def _logs(given: Any) -> list[Any]:
    """Return the tables and files that were given, one or a list of them; none of anything else."""
    several = isinstance(given, list | tuple) and all(map(is_log, given))
    return _addressed(given) if is_log(given) or several else []


def _addressed(logs: Any) -> list[Any]:
    """Return logs, one or a list of them, the names of files taken apart."""
    return [parse_address(one) if is_file(one) else one for one in ([logs] if is_log(logs) else logs)]
