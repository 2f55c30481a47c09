"""Identification: recordings read whole, a model with its provenance out; or a table of rivals beside it."""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
import os
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dbo_cli.errors import (
    SILENT,
    InputError,
    Listener,
    Remarks,
    UsageError,
    cleaned,
    plain,
)
from dbo_cli.hysteresis.identification import IdentificationOptions, Recording
from dbo_cli.hysteresis.identification import identify as identify_model
from dbo_cli.hysteresis.identification.recordings import LARGEST, LEAST_DEVIATION
from dbo_cli.hysteresis.model import SIGN_VERBS, ActuatorModel, Sign
from dbo_cli.hysteresis.model_file import model_to_bytes, read_model
from dbo_cli.logs import request
from dbo_cli.logs.columns import ColumnWish, is_order
from dbo_cli.logs.request import ALL_ROWS, Address, ReadingOptions
from dbo_cli.logs.sample_block import SampleBlock, joined
from dbo_cli.logs.signal_log import SignalLog, Source, remarks_of
from dbo_cli.logs.sources import ArraySource, is_table
from dbo_cli.logs.units import in_unit, kind_of_unit, quantity_name
from dbo_cli.logs.whole_output import all_or_none, check_outputs, write_whole
from dbo_cli.runs.files import (
    bring_to,
    opened,
    read_record,
    recording_wishes,
    short_names,
    write_summary,
)
from dbo_cli.runs.jobs import named
from dbo_cli.version import program_version_string

Recordings = tuple[Sequence[Recording], Sequence[Recording]]
"""Of one actuator: what is fitted, and what its model is judged on."""


@dataclass(frozen=True)
class IdentifyResult:
    """A model, what was found (``summary``), and the remarks of the run."""

    model: ActuatorModel
    summary: list[str]
    remarks: Remarks


def recording_of(
    source: Source, name: str | None = None, listener: Listener = SILENT
) -> Recording:
    """Read a source whole."""
    blocks = []
    for block in source.blocks():
        _check_uncertainty(block, source)
        blocks.append(block)
        listener.progressed(len(block), "read")
    whole = joined(blocks)
    rate = source.even_rate
    units = {role: source.columns[role].unit for role in ("voltage", "displacement")}
    return Recording(
        name or source.name,
        whole.values["voltage"],
        whole.values["displacement"],
        time=whole.time if rate is None else None,
        sample_period=None if rate is None else 1.0 / rate,
        voltage_unit=units["voltage"],
        displacement_unit=units["displacement"],
        voltage_quantity=quantity_name("voltage", units["voltage"]),
        displacement_quantity=quantity_name("displacement", units["displacement"]),
        rows=np.asarray(whole.rows),
        uncertainty=whole.values.get("uncertainty"),
    )


def _check_uncertainty(block: SampleBlock, source: Source) -> None:
    """Refuse standard deviations that are none (InputError), naming the first by its row."""
    values = block.values.get("uncertainty")
    if values is None:
        return
    valid = (values >= LEAST_DEVIATION) & (values <= LARGEST)
    if valid.all():
        return
    place = int(np.argmin(valid))
    column = source.columns["uncertainty"].name
    raise InputError(
        f"{block.place(source.name, place)}: column '{column}' is {values[place]:g}: a standard deviation is "
        f"a number from {LEAST_DEVIATION:g} to {LARGEST:g} (`rows` leaves such rows out)"
    )


def identify_recordings(
    logs: Sequence[Recording],
    options: IdentificationOptions,
    validation: Sequence[Recording] = (),
    arguments: Sequence[str] = (),
    prior: ActuatorModel | None = None,
) -> IdentifyResult:
    """Identify a model, and keep in it what it was identified from.

    Parameters
    ----------
    logs, validation
        What is fitted, and what the model's prediction is judged on.
    options
        What is fixed beforehand.
    arguments
        How the identification was called; folders differ between machines and are taken
        off.
    prior
        A model whose shape is kept; what it was identified from stays in
        ``provenance``.

    Raises
    ------
    FitError
        Nothing trustworthy can be identified.
    InputError
        The units of a recording say that its columns are swapped.
    UsageError
        The options contradict each other or the recordings.
    """
    for log in [*logs, *validation]:
        if not options.force:
            _refuse_swapped_units(log)
    if options.rated is not None:
        unit, (low, high) = logs[0].voltage_unit, options.rated
        rated = in_unit("v_min", low, unit), in_unit("v_max", high, unit)
        options = dataclasses.replace(options, rated=rated)
    result = identify_model(logs, options, validation, prior)
    provenance: dict[str, Any] = {
        "program": program_version_string(),
        "arguments": list(arguments),
        "inputs": [dict(log.record) for log in [*logs, *validation]],
    }
    if prior is not None:
        provenance["prior"] = dict(prior.provenance)
    remarks = Remarks(warnings=result.warnings)
    for log in [*logs, *validation]:
        remarks.add(log.remarks)
    return IdentifyResult(
        dataclasses.replace(result.model, provenance=provenance),
        result.summary,
        remarks,
    )


def _warn_of_order(source: Source, wish: ColumnWish) -> None:
    """Warn of a displacement that by its name is what was wanted."""
    column = source.columns["displacement"]
    if isinstance(source, SignalLog) and is_order(column, wish):
        source.warnings.append(
            f"{source.name}: column '{column.name}' is what was wanted, by its name, not what was "
            "measured: what is identified is how the drive was computed, not the actuator"
        )


def _bring_to_units(
    source: Source, units: Mapping[str, str | None], prior: ActuatorModel | None
) -> None:
    """Bring a log to the units of a prior, else of the first log; its uncertainty to the displacement's."""
    if prior is not None:
        bring_to(source, "voltage", prior.input, "the prior")
        bring_to(source, "displacement", prior.output, "the prior")
    for role in ("voltage", "displacement"):
        if role in units:
            source.convert(role, units[role], "the first log is")
    if "uncertainty" in source.columns:
        unit = source.columns["displacement"].unit
        source.convert("uncertainty", unit, "the displacement is")


def _remarks_of(source: Source, log: Any) -> Remarks:
    """Return what was said as a log was read, and what ``read_log`` left in a table."""
    remarks = remarks_of(source)
    if is_table(log):
        kinds = {kind: list(log.attrs.get(kind, [])) for kind in vars(remarks)}
        remarks.add(Remarks(**kinds))
    return remarks


def _refuse_shared_columns(source: Source) -> None:
    """Refuse one column in two roles (InputError)."""
    for first, second in itertools.combinations(source.columns, 2):
        if source.columns[first].number == source.columns[second].number:
            raise _two_roles(source, second, first)


def _refuse_one_signal(recording: Recording, source: Source) -> None:
    """Refuse one column as drive and displacement, found by way of two names of its file (InputError)."""
    names = [
        source.columns[role].name.rpartition("::")[2]
        for role in ("voltage", "displacement")
    ]
    if names[0] == names[1] and np.array_equal(
        recording.voltage, recording.displacement
    ):
        raise _two_roles(source, "voltage", "displacement")


def _two_roles(source: Source, role: str, taken: str) -> InputError:
    return InputError(
        f"{source.name}: column '{source.columns[role].name}' cannot be the {role}: it is the {taken} "
        f"(`{role}` or `{taken}` names another)"
    )


def _refuse_swapped_units(recording: Recording) -> None:
    """Refuse a drive in a length or an angle beside an output in volts."""
    if kind_of_unit(recording.voltage_unit) not in ("length", "angle"):
        return
    if kind_of_unit(recording.displacement_unit) != "voltage":
        return
    raise InputError(
        f"{recording.name}: the drive is in {recording.voltage_unit} and the displacement in "
        f"{recording.displacement_unit}: `voltage` and `displacement` seem to be swapped (`force` takes "
        "them as they are)"
    )


def sign_line(models: Mapping[str, ActuatorModel], noun: str = "channel") -> str:
    """Return in words whether displacement rises or falls as voltage rises, of the models of channels."""
    names: dict[Sign, list[str]] = {}
    for name, model in models.items():
        names.setdefault(model.sign, []).append(name)
    ways = sorted(names, key=lambda sign: -len(names[sign]))
    first = next(iter(models.values()))
    line = (
        f"{first.output.quantity} {SIGN_VERBS[ways[0]]} as {first.input.quantity} rises"
    )
    if len(ways) > 1:
        opposite = names[ways[1]]
        plural = "s" if len(opposite) > 1 else ""
        line += f", but {SIGN_VERBS[ways[1]]} in {noun}{plural} {named(opposite)}"
    return line


def with_sign(read: Sequence[str], line: str) -> list[str]:
    """Return the lines that say what was read, with the sign in the first."""
    if not read:
        return [line]
    return [f"{read[0]}; {line}", *read[1:]]


def sign_warning(models: Mapping[str, ActuatorModel], noun: str) -> str | None:
    """Return a warning where the displacement of some models rises with the voltage, and of others falls."""
    if len({model.sign for model in models.values()}) < 2:
        return None
    return (
        f"{sign_line(models, noun)}: are leads exchanged, or does a sensor face away?"
    )


def summary_of_model(result: IdentifyResult, command: str) -> dict[str, Any]:
    """Return what was identified as plain values (``dbo-summary``).

    Errors are in the displacement's unit; the gain is displacement per voltage, end to
    end, with its sign.
    """
    model, fit = result.model, result.model.fit
    gain = model.output.span / model.input.span
    if model.sign == "falling":
        gain = -gain
    inputs: Any = model.provenance["inputs"]
    checks: Any = fit.get("validation", ())
    fitted = inputs[: len(inputs) - len(checks)]
    figures = ["rmse", "rmse_percent", "expected_rmse", "expected_percent"]
    figures += ["expected_shape_rmse", "expected_zero"]
    return {
        "format": "dbo-summary",
        "version": 1,
        "command": command,
        "read": [read_record(log["name"], log.get("read", log)) for log in inputs],
        "rows": sum(log["rows"] for log in fitted),
        "samples": fit.get("samples"),
        "sign": model.sign,
        "gain": gain,
        "gain_uncertainty": fit.get("gain_uncertainty"),
        "range": [model.input.minimum, model.input.maximum],
        **{key: fit.get(key) for key in figures},
        "notes": [plain(text) for text in [*result.remarks.notes, *result.summary]],
        "warnings": [plain(text) for text in result.remarks.warnings],
    }


def chosen_of(options: IdentificationOptions) -> dict[str, Any]:
    """Return the parameters that are not at their default, under the command line's names."""
    changed: dict[str, Any] = {}
    for option in dataclasses.fields(options):
        value = getattr(options, option.name)
        if value == option.default:
            continue
        if option.name == "rated":
            changed |= {"v_min": value[0], "v_max": value[1]}
        else:
            changed[{"skip_seconds": "skip"}.get(option.name, option.name)] = value
    return changed


def _option_words(name: str, value: object) -> list[str]:
    """Return an option as a shell spells it: once for each of several texts, without a value for True."""
    items: list[object] = [value]
    if isinstance(value, tuple) and value:
        if all(isinstance(item, str) for item in value):
            items = list(value)
    words = []
    for item in items:
        words.append("--" + name.replace("_", "-"))
        if item is not True:
            words.append(_word(item))
    return words


def _word(value: object) -> str:
    if isinstance(value, float):
        short = f"{value:g}"
        return short if float(short) == value else repr(value)
    if isinstance(value, tuple):
        return ",".join(map(_word, value)) or "0"
    return str(value)


@dataclass(frozen=True)
class IdentifyRun:
    """What is asked of ``identify``, from the shell or from Python.

    Attributes
    ----------
    logs, validation
        Addresses of what is fitted, and of what the model is judged on; from Python
        tables and arrays, too; and what was read already.
    reading
        How logs are read; its rows are not those of the validation's.
    options
        What is fixed beforehand.
    voltage, displacement
        The columns, guessed where not given; patterns (``V{}``) name those of many
        channels.
    uncertainty
        The column of the displacement's standard deviation in what is fitted; None: all
        rows count alike.
    prior
        The file of a model whose shape is kept; from Python a mapping of models by
        channel, too.
    brought
        Options that an extra brings, by name: of channels ``shared_shape`` and
        ``coupling``.
    time
        From Python: the column or the seconds of tables.
    summary, command
        A file for what was found, as JSON, and the command line that it names.
    """

    logs: Sequence[Any]
    validation: Sequence[Any]
    reading: ReadingOptions
    options: IdentificationOptions
    voltage: str | None = None
    displacement: str | None = None
    uncertainty: str | None = None
    prior: Any = None
    brought: Mapping[str, Any] = field(default_factory=dict)
    time: Any = None
    summary: Address | None = None
    command: str = ""

    def refuse_channels_options(self) -> None:
        """Refuse what is for channels where no pattern names them (UsageError)."""
        for name in self.brought:
            raise UsageError(
                f"`{name}` is for channels: name their columns by patterns, 'V{{}}' and 'D{{}}'"
            )

    def arguments(
        self, columns: Mapping[str, str], prior: object = None, checked: bool = True
    ) -> list[str]:
        """Return how the identification of ``columns`` was called, as a shell spells it, without folders."""
        chosen = chosen_of(self.options) | self.reading.chosen()
        chosen |= self.brought
        chosen |= columns
        if isinstance(prior, str):
            chosen["prior"] = os.path.basename(prior)
        words = ["identify"]
        words += [os.path.basename(_name_of(log)) for log in self.logs]
        if checked:
            for log in self.validation:
                words += ["--validate", os.path.basename(_name_of(log))]
        for name, value in chosen.items():
            words += _option_words(name, value)
        return [cleaned(request.without_folder(word)) for word in words]

    def read(
        self, listener: Listener = SILENT, prior: str | ActuatorModel | None = None
    ) -> Recordings:
        """Read what is fitted and what is judged on, in the units of a prior, else of the first log."""
        prior_model = read_model(prior) if isinstance(prior, str) else prior
        names = short_names([*self.logs, *self.validation])
        units: dict[str, str | None] = {}

        def read(
            log: Any, reading: ReadingOptions, wishes: Mapping[str, ColumnWish]
        ) -> Recording:
            if isinstance(log, Recording):
                return log
            name = names.get(log) if isinstance(log, Address) else _name_of(log)
            opened_log = opened(
                log, wishes, reading, listener, time=self.time, digest=True
            )
            with closing(opened_log) as source:
                _refuse_shared_columns(source)
                _warn_of_order(source, wishes["displacement"])
                _bring_to_units(source, units, prior_model)
                recording = recording_of(source, name, listener)
                _refuse_one_signal(recording, source)
                for role, column in source.columns.items():
                    units[role] = column.unit
                return dataclasses.replace(
                    recording,
                    record=_record_of(source, log),
                    remarks=_remarks_of(source, log),
                )

        fitted = recording_wishes(self.voltage, self.displacement, self.uncertainty)
        judged = recording_wishes(self.voltage, self.displacement)
        whole = dataclasses.replace(self.reading, rows=ALL_ROWS)
        return (
            [read(log, self.reading, fitted) for log in self.logs],
            [read(log, whole, judged) for log in self.validation],
        )

    def run(self, output: Address, listener: Listener = SILENT) -> IdentifyResult:
        """Identify a model of one actuator from logs and write it."""
        request.check_document(output, "a model", "json")
        inputs = [*self.logs, *self.validation]
        self.check_outputs([output], [*inputs, *self._files_beside()])
        request.check_format(self.reading.format, inputs)
        prior = None if self.prior is None else read_model(self.prior)
        fitted, checks = self.read(listener, prior)
        arguments = self.arguments(self._named_columns(), self.prior)
        rows = sum(len(log.voltage) for log in fitted)
        listener.working(f"fitting {rows:,} rows")
        try:
            result = identify_recordings(fitted, self.options, checks, arguments, prior)
        finally:
            listener.finished()
        with all_or_none():
            write_whole(output, model_to_bytes(result.model))
            if self.summary is not None:
                write_summary(self.summary, [summary_of_model(result, self.command)])
        result.remarks.read = with_sign(
            result.remarks.read, sign_line({"": result.model})
        )
        return result

    def _files_beside(self) -> list[Any]:
        """Return the files that are read beside the logs: those of columns, and the prior's."""
        selectors = self.voltage, self.displacement, self.uncertainty, self.reading.time
        files: list[Any] = [*request.selected_files(*selectors)]
        if self.prior is not None:
            files.append(self.prior)
        return files

    def _named_columns(self) -> dict[str, str]:
        """Return the columns that were named, by role."""
        columns = {
            "voltage": self.voltage,
            "displacement": self.displacement,
            "uncertainty": self.uncertainty,
        }
        return {role: name for role, name in columns.items() if name is not None}

    def check_outputs(self, outputs: Sequence[Address], inputs: Sequence[Any]) -> None:
        """Refuse a model's or a summary's file that cannot be written, before any work starts."""
        if self.summary is not None:
            request.check_document(self.summary, "a summary", "json")
            outputs = [*outputs, self.summary]
        check_outputs(outputs, inputs)


def _name_of(log: Any) -> str:
    """Return what a log is called where its model says how it was identified."""
    if is_table(log):
        return str((log.attrs.get("provenance") or {}).get("name", "arrays"))
    return log.text if isinstance(log, Address) else "arrays"


def _record_of(source: Source, log: Any) -> Mapping[str, Any]:
    """Return what a model keeps of a log that was read; of arrays a digest of their numbers."""
    if isinstance(source, SignalLog):
        return dict(source.record()) | {"read": source.reading_record()}
    assert isinstance(source, ArraySource)
    known: Mapping[str, Any] | None = None
    if is_table(log):
        known = log.attrs.get("provenance")
    if known:
        return known
    digest = hashlib.sha256()
    for values in source.values.values():
        digest.update(values.astype("<f8").tobytes())
    count = next(iter(source.values.values())).size
    return {"name": "arrays", "sha256": digest.hexdigest(), "rows": count}
