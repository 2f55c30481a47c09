"""The drive from which a model is identified well: random turns over the whole range at many speeds.

It is made of half-cosine swings between turning points: the speed is zero at each turn,
so a drive turns exactly where it says, and a slew limit only makes a swing longer. A
small sweep about the middle of the range may follow, from which an actuator's dynamics
are identified.

Why this shape. (1) It begins at the lower end and goes over the whole range: that wipes
out the past, so the state of every gear is known. (2) It turns at random levels, some
at the ends: loops of every size, so that gears and asymmetry come apart. (3) Every
swing has a speed of its own, from eight times that of the first swing to a quarter, and
some turns are held: lag, creep and loop width come apart. (4) It returns and rests
where it began, so that the sensor's drift shows as a difference between equal voltages.
"""

import math
import random

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.drive.limits import rounded_down, rounded_up
from dbo_cli.drive.smooth import MOST_SIGNAL_ROWS, swing_rows, swings
from dbo_cli.errors import LimitError, UsageError, require_positive

# a turning point as a part of the range, and the rows on the way there
Leg = tuple[float, int]

SAMPLE_RATE = 1000.0  # Hz, the default
FREQUENCY = 1.0
"""Hz: swings over the whole range and back; less where the slew is limited."""
CYCLES = 30.0  # of that frequency, where no duration is given
FEWEST_CYCLES = 6
"""Two swings over the range, the return and the rest leave four for the turns."""
ROWS_A_CYCLE = 20
"""With fewer, interpolation between rows no longer shows where a swing turns."""
FASTEST, SLOWEST = -0.9, 0.6
"""log10 of a swing's time in that of a swing over the range; slower in longer drives."""
AT_AN_END = 0.12  # chance that a turn lies at an end of the range
HOLD_CHANCE, HOLD = 0.15, 0.4  # chance that a turn is held, and for how many periods
REST_PERIODS = 0.5  # periods at rest at the end; all three longer in longer drives
SEED = 1
SWEEP_FASTER = 10.0  # a sweep's highest frequency over that of the swings, at least
SWEEP_SECONDS, SWEEP_PERIODS = 2.0, 120.0  # a sweep lasts the longer of both
SWEEP_FROM = 100.0  # a sweep begins at its end over this
SWEEP_AMPLITUDE = 0.01  # of the range, middle to crest, at its lower end
SWEEP_FADED = 0.25  # of that amplitude at its upper end
SWEEP_ROWS_A_PERIOD = 10.0
SWEEP_TAPER = 0.05  # of the sweep at either end, over which it rises and falls
SETTLE = 0.3  # s at rest before and after a sweep


def excite(
    v_min: float,
    v_max: float,
    *,
    sample_rate: float = SAMPLE_RATE,
    duration: float | None = None,
    rest: float | None = None,
    max_slew: float | None = None,
    sweep_to: float | None = None,
    sweep_amplitude: float | None = None,
) -> tuple[Floats, Floats]:
    """Return time (s) and voltage of a drive that identifies well.

    Parameters
    ----------
    v_min, v_max : float
        The drive's range; it is never left.
    sample_rate : float
        Rows a second.
    duration : float, optional
        Seconds of the swings; 30 periods where not given.
    rest : float, optional
        Seconds at rest behind the swings: as long as a move may hold a position.
    max_slew : float, optional
        Fastest change, per second.
    sweep_to : float, optional
        Highest frequency (Hz) of a small sweep that follows in the middle of the range.
    sweep_amplitude : float, optional
        Of the sweep, middle to crest; 1 % of the range where not given.

    Returns
    -------
    time, voltage : array of shape (rows,)
        The same arguments give the same rows.

    Raises
    ------
    UsageError
        The values contradict each other; the message says which would do.
    LimitError
        The slew limit does not allow the sweep.
    """
    if not v_min < v_max:
        raise UsageError(f"`v_min` {v_min:g} must be below `v_max` {v_max:g}")
    require_positive(sample_rate=sample_rate, duration=duration, rest=rest)
    require_positive(max_slew=max_slew, sweep_to=sweep_to)
    if sweep_amplitude is not None and sweep_to is None:
        raise UsageError("`sweep_amplitude` needs `sweep_to` HZ")
    span, slew = v_max - v_min, None
    frequency = min(FREQUENCY, sample_rate / ROWS_A_CYCLE)
    if sweep_to is not None:
        frequency = min(frequency, sweep_to / SWEEP_FASTER)
    if max_slew is not None:
        frequency = min(frequency, max_slew / (math.pi * span))
        slew = max_slew / span
    seconds, shortest = duration or CYCLES / frequency, FEWEST_CYCLES / frequency
    longest = MOST_SIGNAL_ROWS / sample_rate
    if not shortest * (1.0 - 1e-9) <= seconds <= longest:
        raise UsageError(
            f"`duration` {seconds:g}: give {math.ceil(shortest)} ({FEWEST_CYCLES} swings over the range) to "
            f"{longest:g} ({MOST_SIGNAL_ROWS:,} rows)"
        )
    rows = round(seconds * sample_rate) - 1
    longer = max((duration or 0.0) * frequency / CYCLES, 1.0)
    legs = _legs(rows, 1.0 / sample_rate, 1.0 / frequency, slew, longer)
    if rest is not None:
        legs.append((0.0, round(rest * sample_rate)))
    level_of_row = swings(
        [0.0, *(turn for turn, _ in legs)], [rows for _, rows in legs]
    )
    voltage = np.clip(v_min + span * level_of_row, v_min, v_max)
    voltage[level_of_row == 1.0] = v_max
    if sweep_to is not None:
        crest = SWEEP_AMPLITUDE * span if sweep_amplitude is None else sweep_amplitude
        sweep = _sweep(v_min, span, sample_rate, sweep_to, crest, max_slew)
        voltage = np.concatenate([voltage, sweep])
    return np.arange(voltage.size) / sample_rate, voltage


def _legs(
    rows: int, step: float, period: float, slew: float | None, longer: float
) -> list[Leg]:
    """Return two swings over the range, random turns and holds, the return and the rest: ``rows`` in all.

    ``step`` and ``period`` in s, ``slew`` in ranges a second; ``longer``: times the usual
    drive, in which rests and the slowest swings are longer, too.
    """
    # the one generator whose numbers Python never changes
    chance = random.Random(SEED).random

    def swing(distance: float, slowness: float = 1.0) -> int:
        count = swing_rows(distance, step, 0.5 * period * distance * slowness, slew)
        return max(count, ROWS_A_CYCLE // 2)

    first, still = swing(1.0), round(longer * REST_PERIODS * period / step)
    slowest = SLOWEST + math.log10(longer)
    turns: list[Leg] = []
    level, used = 0.0, 0
    while True:
        turn = float(chance() < 0.5) if chance() < AT_AN_END else chance()
        slowness = 10.0 ** (FASTEST + (slowest - FASTEST) * chance())
        legs = [(turn, swing(abs(turn - level), slowness))]
        if chance() < HOLD_CHANCE:
            legs.append((turn, round(longer * HOLD * period / step)))
        used += sum(count for _, count in legs)
        if turns and used + swing(turn) > rows - 2 * first - still:
            break
        turns += legs
        level = turn
    back = swing(turns[-1][0])
    # the turns fill what is left: each leg takes longer by the same part
    ends = np.cumsum([count for _, count in turns])
    ends = ends * (rows - 2 * first - back - still) // ends[-1]
    counts = np.diff(ends, prepend=0).tolist()
    turns = [(turn, count) for (turn, _), count in zip(turns, counts, strict=True)]
    return [(1.0, first), (0.0, first), *turns, (0.0, back), (0.0, still)]


def _sweep(
    begin: float,
    span: float,
    rate: float,
    sweep_to: float,
    crest: float,
    max_slew: float | None,
) -> Floats:
    """Return the way to the middle, a logarithmic sweep there, and the way back.

    A sweep is refused that the rate does not resolve, or that range or slew do not allow.
    """
    least_rate = SWEEP_ROWS_A_PERIOD * sweep_to
    if rate < least_rate * (1.0 - 1e-9):
        raise UsageError(
            f"`sweep_to` {sweep_to:g}: needs `sample_rate` {rounded_up(least_rate, 4):.9g} or more, not "
            f"{rate:g}"
        )
    if not 0.0 < crest <= 0.5 * span:
        raise UsageError(
            f"`sweep_amplitude` {crest:g}: give more than 0, at most "
            f"{rounded_down(0.5 * span, 6):.6g}"
        )
    fastest = 2.0 * math.pi * sweep_to * crest * SWEEP_FADED
    if max_slew is not None and fastest > max_slew:
        raise LimitError(
            f"`sweep_amplitude` {crest:g}: needs {fastest:.6g}/s at {sweep_to:g} Hz, more than `max_slew`; "
            f"{rounded_down(crest * max_slew / fastest, 3):.9g} fits"
        )
    ramp = swing_rows(0.5 * span, 1.0 / rate, SETTLE, max_slew)
    seconds = max(SWEEP_SECONDS, SWEEP_PERIODS / sweep_to)
    count = round(seconds * rate)
    fraction = np.arange(count) / count
    grown = math.log(SWEEP_FROM)
    periods = sweep_to / SWEEP_FROM * seconds / grown * np.expm1(grown * fraction)
    edge = np.clip(np.minimum(fraction, 1.0 - fraction) / SWEEP_TAPER, 0.0, 1.0)
    size = crest * SWEEP_FADED**fraction * (0.5 - 0.5 * np.cos(np.pi * edge))
    still, middle = round(SETTLE * rate), begin + 0.5 * span
    up = swings([begin, middle, middle], [ramp, still])
    down = swings([middle, middle, begin, begin], [still, ramp, still])
    return np.concatenate([up[1:], middle + size * np.sin(2.0 * np.pi * periods), down])
