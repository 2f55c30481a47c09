"""The command ``fringes``: its options, one call, its messages."""

from __future__ import annotations

from dbo_cli.cli.commands import Arguments, Command
from dbo_cli.cli.options import (
    HEADER,
    OUTPUT,
    READING,
    REPORTING,
    SCALE_UNCERTAINTY,
    SUMMARY,
    VOLTAGE,
    Option,
    figure_above_0,
)

LOG = Option("LOG", "The recording; FILE::/group in HDF5; - is stdin.")
FRINGES = (  # the fields of ``FringeOptions``
    VOLTAGE,
    Option("--signal COLUMN", "The photodiode; guessed by name."),
    Option(
        "--quadrature COLUMN",
        "A second photodiode, a quarter of a fringe behind the first.",
    ),
    Option(
        "--wavelength LENGTH",
        "Of the light: 632.8nm; a fringe is half of it (to the mirror and back).",
        parse=figure_above_0,
    ),
    Option(
        "--per-fringe LENGTH",
        "Displacement of a fringe instead: 316.4nm; plain: um.",
        parse=figure_above_0,
    ),
    Option(
        "--sign rising|falling",
        "How the displacement runs with the voltage [default: rising; --quadrature: as it is seen].",
    ),
    SCALE_UNCERTAINTY._replace(
        meaning="Of the wavelength, common to all rows; said beside the result."
    ),
    Option(
        "--splice",
        "Parts between breaks as one log, as if nothing had moved meanwhile.",
    ),
    Option("--figures DIR", "Draw the figures, PNG and SVG, into this folder."),
)


def fringes(arguments: Arguments) -> None:
    """Turn the fringes of an interferometer into the displacement that identify reads.

    One photodiode: the intensity gives the phase but for its direction; that is the
    drive's, and behind each turn of the drive a model of the actuator says which fringe
    follows. The model chooses fringes only: values and standard deviations come from
    the light. Where the odds of a turn are below 100:1 it is said; a log in which that
    happens often is refused. Two photodiodes in quadrature (--quadrature) need no
    model.

    Writes
    ------
    Time, voltage, displacement (um, 0 at the first row) and its standard deviation
    (um). Where fringes could not be counted for a while (a dark beam, a gap in the
    record, a rest of the drive in which the mirror moved by itself), -o
    'recorded-{part}.csv' writes a log of each part, or --splice one of all.

    Usual options
    -------------
    --voltage --signal --quadrature --wavelength --per-fringe --sign --figures -o

    Examples
    --------
    One photodiode and a helium-neon laser:
        dbo fringes run.csv --voltage HV --signal PD1 --wavelength 632.8nm -o rec.csv
    Two in quadrature:
        dbo fringes run.csv --signal PD1 --quadrature PD2 --per-fringe 316.4nm -o
        rec.csv
    """
    from dbo_cli.extras.fringes.run import FringeOptions, write_displacement

    options = FringeOptions(**arguments.of(FRINGES))
    destination = arguments.destination([arguments.log])
    reporter = arguments.reporter
    remarks = write_displacement(
        arguments.log, destination, arguments.reading, options, reporter
    )
    reporter.remarks(remarks)


COMMAND = Command(
    fringes, (LOG, *READING, *REPORTING, *FRINGES, HEADER, SUMMARY, OUTPUT)
)
EXCITE_FRINGES = Option(
    "--fringes WAVELENGTH",
    "A drive whose fringes can be counted (dbo fringes): 632.8nm, with --stroke.",
    parse=figure_above_0,
)
EXCITE_STROKE = Option(
    "--stroke LENGTH",
    "With --fringes, displacement of the whole range: 12um; plain: um.",
    parse=figure_above_0,
)
