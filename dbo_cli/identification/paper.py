"""Identification as in Section V of Aye and Ang (2018): one cycle, few gears, no lag.

The gain is the range of the cycle's displacement over that of its voltage, the origin
the least displacement and the least voltage; the gears map volts to volts. The paper
does not say how its 25 gears were placed and fitted beyond "least squares". Here their
edges are spaced as a sine is in time, narrow where the drive turns. A turn inside a
gear retraces it, so few gears that are fitted to one cycle alone predict smaller loops
badly. Hence a fine operator is fitted to the cycle first, and the few gears to what it
does on the cycle and on the cycle shrunk about its middle.
"""

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.errors import FitError
from dbo_cli.identification.basis import Structure
from dbo_cli.identification.recording import Options, Recording
from dbo_cli.identification.solve import Equations, FittedRows, Solution, nonnegative
from dbo_cli.identification.stages import with_reach, zero_of
from dbo_cli.model import Cascade, Gears, Points, Quantity, Scale

PAPER_GEARS = 25  # the paper's
FINE_WIDTHS, GROUP = np.full(1280, 1.0 / 1280), 20
"""Of the fine operator's gears, and how many of them share a slope."""
PAPER_SEGMENTS = 2
"""Of the curve behind the gears: 1, 2 and 4 leave 0.89, 0.90, 1.04 um on the authors' other log."""
SHRUNK = tuple(k / 20 for k in range(20, 5, -1))  # amplitudes, over the cycle's
CYCLE_WEIGHT = 10.0  # of the cycle's own amplitude, over each smaller one
FLATTEST_GEAR = 0.3  # of a gear, of the mean slope


def identify_paper(recording: Recording, options: Options) -> Cascade:
    """Return the model of one cycle.

    Parameters
    ----------
    recording
        One whole cycle.
    options
        ``gears``, ``points`` and ``zero`` count.

    Raises
    ------
    FitError
        The displacement falls where the voltage rises: the paper's rule takes K > 0.
    """
    voltage, displacement = recording.voltage, recording.displacement
    if float(np.cov(voltage, displacement)[0, 1]) < 0.0:
        raise FitError(
            f"{recording.name}: the displacement falls as the voltage rises: use `method` "
            "least-squares"
        )
    count = PAPER_GEARS if options.gears == "auto" else options.gears
    segments = PAPER_SEGMENTS if options.points == "auto" else max(options.points, 1)
    low, swing = float(voltage.min()), float(np.ptp(voltage))
    lowest, stroke = float(displacement.min()), float(np.ptp(displacement))
    drive = (voltage - low) / swing
    output = (displacement - lowest) / stroke
    fine = _fine_fit(drive, output, segments)
    edges = 0.5 - 0.5 * np.cos(np.pi * np.arange(count + 1) / count)
    heights = _few_heights(drive, fine.slopes, np.diff(edges))

    gears = Gears(swing * np.diff(edges), swing * heights, low, 0.0)
    stages: list[Gears | Points | Scale] = [gears]
    if segments > 1:
        parts = np.full(segments, swing / segments)
        stages.append(Points(parts, parts * fine.curve, 0.0, 0.0))
    shift = zero_of(recording, options)
    stages.append(Scale(stroke / swing, lowest - shift))
    fit = {
        "method": "paper",
        "expected_rmse": None,
        "gears": count,
        "range": [low, low + swing],
    }
    model = Cascade(
        direction="forward",
        input=Quantity(*recording.input, low, low + swing),
        output=Quantity(*recording.output, 0.0, 1.0),
        stages=tuple(stages),
        fit=fit,
    )
    return with_reach(model)


def _fine_fit(drive: Floats, output: Floats, segments: int) -> Solution:
    """Fit a fine operator and a curve behind it to a cycle, both 0 to 1; slopes may only grow."""
    engaged = _engaged(FINE_WIDTHS, np.tile(drive, 2), GROUP)[drive.size :]
    count, cells = engaged.shape
    weights, shares = np.full(count, 1.0 / count), np.full(cells, 1.0 / cells)
    rows = FittedRows(engaged / cells, output, weights, np.zeros((count, 0)), shares)
    smooth = 0.0 if segments > 1 else np.inf
    structure = Structure("growing", "", 0.0, smooth, segments=segments)
    return Equations(rows, structure).solve()


def _engaged(widths: Floats, drive: Floats, group: int) -> Floats:
    """Return the engaged part of each group of gears of slope 1."""
    return Gears(widths, widths, 0.0, 0.0).engagement(drive, group)


def _few_heights(drive: Floats, slopes: Floats, widths: Floats) -> Floats:
    """Return heights of gears of given widths that do what the fine operator does, at all amplitudes.

    Each amplitude has an offset of its own. The first of two cycles of each only sets
    the state.
    """
    rows, count = drive.size, widths.size
    shrunk = [np.tile(0.5 + amplitude * (drive - 0.5), 2) for amplitude in SHRUNK]
    repeated = np.concatenate(shrunk)
    counts = np.tile(np.repeat([False, True], rows), len(SHRUNK))
    target = (_engaged(FINE_WIDTHS, repeated, GROUP) @ slopes)[counts] / len(slopes)
    parts = _engaged(widths, repeated, 1)[counts]
    growing = (parts * widths) @ np.tril(np.ones((count, count)))
    offsets = np.repeat(np.eye(len(SHRUNK)), rows, axis=0)
    table = np.hstack([growing, offsets, -offsets])
    squares = np.ones(len(SHRUNK))
    squares[0] = CYCLE_WEIGHT
    weight = np.sqrt(np.repeat(squares, rows))
    bound = weight * (target - FLATTEST_GEAR * (parts @ widths))
    unknown = nonnegative(weight[:, None] * table, bound)
    return widths * (FLATTEST_GEAR + np.cumsum(unknown[:count]))
