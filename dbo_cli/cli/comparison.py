"""Logs read as pairs to compare: desired and measured, or a model's prediction and measured."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from dbo_cli.cli import signals
from dbo_cli.cli.bundles import Reading
from dbo_cli.cli.messages import RowCounter, Voice
from dbo_cli.cli.streams import Clock, ModelStream

if TYPE_CHECKING:
    from dbo_cli.hysteresis.model import ActuatorModel
    from dbo_cli.logs.columns import ColumnWish
    from dbo_cli.logs.signal_log import SignalLog
    from dbo_cli.reports.report import LogReport, ReportOptions
    from dbo_cli.reports.sample_pairs import PairBlock
    from dbo_cli.reports.thinned_curves import Traces


@dataclass
class PairReader:
    """Compares logs one after the other, and keeps what the report and its figures need of each.

    ``desired``, ``measured`` and ``voltage`` are the columns the user named, None where they are guessed;
    ``names`` says how the report calls a log.
    """

    compared: ReportOptions
    reading: Reading
    voice: Voice
    model: ActuatorModel | None
    model_name: str
    traced: bool
    desired: str | None
    measured: str | None
    voltage: str | None
    names: Mapping[str, str]
    units: list[tuple[str, str | None]] = field(default_factory=list)
    traces: list[Traces] = field(default_factory=list)

    def evaluate(self, address: str) -> LogReport:
        """Compare one log, block by block."""
        from dbo_cli.reports.report import evaluate
        from dbo_cli.reports.sample_pairs import rows_with_lag

        reading = self.reading
        if isinstance(self.compared.lag, int):
            reading = replace(reading, rows=rows_with_lag(reading.rows, self.compared.lag))
        with signals.open_signals(address, self._want(), reading, self.voice) as log:
            self._note_units(log)
            traces = self._new_traces(log) if self.traced else None
            rate = self.reading.resample or log.sample_rate
            name = self.names.get(address, log.name)
            merit = evaluate(name, self._pairs(log), self.compared, sample_rate=rate, traces=traces)
        self.voice.notes(log.notes)
        return merit

    def _want(self) -> dict[str, ColumnWish]:
        from dbo_cli.logs.columns import ColumnWish

        want = {"measured": ColumnWish(self.measured, signals.DISPLACEMENT, option="measured")}
        if self.model is None:
            want["desired"] = ColumnWish(self.desired, signals.DESIRED, option="desired")
        needed = self.model is not None or self.voltage is not None
        want["voltage"] = ColumnWish(self.voltage, signals.VOLTAGE, required=needed, option="voltage")
        return want

    def _note_units(self, log: SignalLog) -> None:
        """Keep the units, and refuse a pair (or a log and a model) that speaks two."""
        from dbo_cli.reports.sample_pairs import check_alike

        measured = log.columns["measured"].unit
        if self.model is None:
            other = log.columns["desired"].unit
        else:
            other = self.model.output.unit
            signals.check_unit(log, "voltage", self.model.input, self.model_name)
        check_alike(log.name, self.compared.labels, (other, measured))
        self.units.append((log.name, measured or other))

    def _new_traces(self, log: SignalLog) -> Traces:
        from dbo_cli.reports.thinned_curves import Traces

        drive = log.columns.get("voltage")
        self.traces.append(Traces(None if drive is None else drive.unit))
        return self.traces[-1]

    def _pairs(self, log: SignalLog) -> Iterator[PairBlock]:
        from dbo_cli.reports.sample_pairs import PairBlock

        counter = RowCounter(self.voice, "compared")
        stream = None if self.model is None else self._predictor(self.model, log)
        for block in log.blocks():
            drive = block.values.get("voltage")
            if stream is None:
                wanted = block.values["desired"]
            else:
                wanted = stream.feed(block, block.values["voltage"])
            yield PairBlock(block.rows, wanted, block.values["measured"], block.time, drive)
            counter.add(len(block))
        counter.clear()
        if stream is not None:
            stream.tell(self.voice)

    def _predictor(self, model: ActuatorModel, log: SignalLog) -> ModelStream:
        why = "the model's lag, creep or delay depends on it" if model.needs_time else None
        return ModelStream(model, log, Clock(log, self.reading, why))
