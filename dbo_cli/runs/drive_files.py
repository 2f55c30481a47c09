"""Drives written to files: compensation of a trajectory, and the drive that identifies well."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

from dbo_cli.drives.gate import DriveGate
from dbo_cli.drives.loops import compensation
from dbo_cli.drives.model_run import reads_ahead
from dbo_cli.drives.options import DriveOptions
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_set import read_model
from dbo_cli.hysteresis.model_state import DriveLimits
from dbo_cli.logs.addresses import Address, check_document, check_format
from dbo_cli.logs.reading_options import ALL_ROWS, ReadingOptions
from dbo_cli.logs.signal_writer import OutColumn, signal_writer
from dbo_cli.logs.whole_output import all_or_none, check_outputs
from dbo_cli.remarks import SILENT, Listener, Remarks
from dbo_cli.runs.files import Destination, check_order, opened, shown_name, write_response
from dbo_cli.runs.roles import bring_to, quantity_wish, start_of, tracked_of, tracked_wishes

if TYPE_CHECKING:
    from dbo_cli.drives.learning import Tracked
    from dbo_cli.hysteresis.excitation import Excitation


def compensate_trajectory(
    model_file: str,
    trajectory: Address,
    destination: Destination,
    reading: ReadingOptions,
    options: DriveOptions,
    *,
    column: str | None = None,
    state: str = "auto",
    tracked: Sequence[Address] = (),
    voltage: str | None = None,
    measured: str | None = None,
    listener: Listener = SILENT,
) -> Remarks:
    """Write the drive that makes an actuator follow a trajectory: time (when known), desired, drive."""
    destination = destination.beside(column, voltage, measured, reading.time)
    destination.check()
    if options.history is not None:
        check_document(options.history, "a history", "json")
        check_outputs([destination.output, options.history], destination.protect)
    check_order(model_file, trajectory.text)
    check_format(reading.format, [trajectory, destination.output])
    model = read_model(model_file)
    model.require("forward", shown_name(model_file))
    wanted = model.output
    want = {wanted.quantity: quantity_wish(wanted, column, option="displacement", trajectory=True)}
    ahead = (reads_ahead(model) or options.bandwidth is not None) and not (tracked or options.periodic)
    recordings = [_recorded(one, model, reading, voltage, measured, listener) for one in tracked]
    with opened(trajectory, want, reading, destination.live, listener, ahead) as log:
        bring_to(log, wanted.quantity, wanted, shown_name(model_file))
        options = dataclasses.replace(options, state=start_of(state, model))
        run = compensation(model, log, options, recordings, reading.rows[1] if ahead else None)
        # Not under the name of what will be measured: a drive must not be taken for a recording.
        unit = log.columns[wanted.quantity].unit or wanted.unit
        given = OutColumn("desired", unit, "desired", may_be_blank=True)
        with all_or_none():
            remarks = write_response(run, log, given, destination, reading, listener)
            run.keep_history()
        return remarks


def _recorded(
    address: Address,
    model: ActuatorModel,
    reading: ReadingOptions,
    voltage: str | None,
    measured: str | None,
    listener: Listener,
) -> Tracked:
    """Read the recording of a pass; ``rows`` are the trajectory's."""
    want = tracked_wishes(model, voltage, measured)
    with opened(address, want, dataclasses.replace(reading, rows=ALL_ROWS), False, listener) as log:
        return tracked_of(log, model)


def write_excitation(output: Address, excitation: Excitation, form: str | None = None) -> int:
    """Write the drive that identifies well; returns its rows."""
    time, voltage = excitation.drive()
    limits = DriveLimits(excitation.v_min, excitation.v_max, excitation.max_slew)
    DriveGate(limits).admit(voltage, 1.0 / excitation.sample_rate)
    check_format(form, [output])
    columns = [OutColumn("time", "s"), OutColumn("voltage", "V")]
    attributes = {"sample_rate": excitation.sample_rate}
    with signal_writer(output.or_format(form), columns, attributes=attributes) as writer:
        writer.write(time, voltage)
    return len(time)
