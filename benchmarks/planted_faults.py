"""Faults in the mathematics for ``mutants.py``: where, the text there, the faulty text, what it breaks.

The text must stand exactly once in its file (tests/test_planted_faults.py holds that). Take faults that a
person could make: a wrong end, a lost sign, a tolerance left out, a special case forgotten.  Which segment of
the points a breakpoint belongs to is none: widths and heights stand on a binary grid, so both give the same bits.
"""

from __future__ import annotations

from dataclasses import dataclass

# The quick tests of each part: a fault that only a whole identification finds is a unit test that is missing.
KERNEL = ("hysteresis_operators", "hysteresis_kernel")
MODEL = ("hysteresis_model", "hysteresis_operators", "runs_states", "runs_controller")
IDENTIFICATION = ("hysteresis_identification_parts", "hysteresis_identification_rules")
REPORTS = ("reports_figures_of_merit", "reports_loop_and_lag", "reports_sample_pairs", "reports_report",
           "reports_trajectory_match")
FIGURES = ("reports_figures",)


@dataclass(frozen=True)
class Fault:
    """One planted fault; ``tests`` are the files that must find it, ``tests/test_NAME.py``."""

    file: str
    text: str
    faulty: str
    breaks: str
    tests: tuple[str, ...]


def _faults(file: str, tests: tuple[str, ...], *table: tuple[str, str, str]) -> list[Fault]:
    return [Fault(f"dbo_cli/{file}", text, faulty, breaks, tests) for text, faulty, breaks in table]


FAULTS: list[Fault] = [
    *_faults(
        "hysteresis/dbo_kernel.c",
        KERNEL,
        ("*low = least < limits->low ? limits->low : least > limits->high ? limits->high : least;",
         "*low = least < limits->low ? limits->low : least;",
         "the range wins over the slew limit, from below"),
        ("*high = most > limits->high ? limits->high : most < limits->low ? limits->low : most;",
         "*high = most > limits->high ? limits->high : most;",
         "the range wins over the slew limit, from above"),
        ("if ((z & 63) == 0) w->some[k >> 6] |= (uint64_t)1 << (k & 63);", "",
         "the index of words that hold a one, for more than 64 gears"),
        ("if ((s & 63) == 0) w->full[k >> 6] &= ~((uint64_t)1 << (k & 63));", "",
         "the index of full words, for more than 64 gears"),
        ("return d >= 0.0 ? up->slope : slope;", "return up->slope;",
         "a gear crossed by the tolerance serves its sample, upward"),
        ("return d <= 0.0 ? down->slope : slope;", "return down->slope;",
         "a gear crossed by the tolerance serves its sample, downward"),
        ("*outside = d >= up->reach;", "*outside = 0;", "samples above the range are counted"),
        ("*outside = -d >= down->reach;", "*outside = 0;", "samples below the range are counted"),
        ("if ((bits_of(d) ^ turned) >= reach) break;", "if ((bits_of(d) ^ turned) > reach) break;",
         "a gear travelled exactly to the tolerance counts as crossed"),
        ("sum += op->gain[j] * memory[j];", "sum += op->gain[j] * drive;", "lag and creep are remembered"),
        ("*clipped = y - high > slack;", "*clipped = 1;", "clipping by less than the slack does not count"),
        ("return d >= 0.0 ? high : low;", "return d >= 0.0 ? low : high;",
         "an output on the wrong side of the limits goes to the nearer one"),
        ("if (last < op->n && (rising ? d < 0.0 : d > 0.0)) gear = last;", "",
         "the identification sees the gear that was crossed by the tolerance"),
    ),
    *_faults(
        "hysteresis/kernel.py",
        KERNEL,
        ("return min(max(towards(last, -step), low), high), max(min(towards(last, step), high), low)",
         "return max(towards(last, -step), low), min(towards(last, step), high)",
         "the range wins over the slew limit, in Python"),
        ("outside = (d if rising else -d) >= width * (1.0 - fraction)", "outside = d >= width * (1.0 - fraction)",
         "samples below the range are counted, in Python"),
    ),
    *_faults(
        "hysteresis/gear_table.py",
        KERNEL,
        ("CROSSING_TOLERANCE = 1e-9", "CROSSING_TOLERANCE = 0.0", "a turn on a breakpoint, forward and inverse"),
        ("rounded: Floats = np.rint(widths / grid) * grid", "rounded: Floats = widths + 0.0",
         "no drift after many transitions"),
        ("_ROUNDING_STEPS = 64.0 *", "_ROUNDING_STEPS = 0.0 *", "narrow gears beside large numbers"),
    ),
    *_faults(
        "hysteresis/operators.py",
        KERNEL,
        ("(self.dy, self.dx, self.y0, self.x0, self.relaxation, other)",
         "(self.dy, self.dx, self.x0, self.y0, self.relaxation, other)",
         "the inverse exchanges the origins (18)"),
        ("if target - low >= high - target - CROSSING_TOLERANCE * span:", "if target - low >= high - target:",
         "a tie of the settled state is decided by a tolerance"),
        ("first_outside=self.first_outside + samples if self.outside else 0,", "first_outside=self.first_outside,",
         "the first sample outside is named by its place in the block"),
        ("rest = np.zeros((1, terms))", "rest = np.ones((1, terms))", "relaxation is at rest at the first sample"),
    ),
    *_faults(
        "hysteresis/delay.py",
        MODEL,
        ("part = max(samples - whole, 0.0)", "part = 0.0", "a delay of parts of a sample"),
        ("part = np.where(part < _WHOLE, 0.0, part)", "pass",
         "shifting by whole samples on a stamped clock is exact, where the time is a little late"),
        ("return np.where(part > 1.0 - _WHOLE, values[second], between), int(first[-1])",
         "return between, int(first[-1])",
         "shifting by whole samples on a stamped clock is exact, where the time is a little early"),
        ("past_values = history.values if history else (float(x[0]),)",
         "past_values = history.values if history else (0.0,)",
         "before the first sample the first value holds"),
        ("whole = math.floor(samples + _WHOLE)", "whole = math.floor(samples)",
         "a delay of a whole number of samples shifts exactly"),
    ),
    *_faults(
        "hysteresis/relaxation.py",
        MODEL,
        ("np.exp(-steps / np.array(self.tau))", "1.0 / (1.0 + steps / np.array(self.tau))",
         "a_j = exp(-dt/tau_j)"),
        ("rows[0] = held[:] = drive[0] - self.reference", "rows[0] = held[:] = 0.0",
         "memories are at rest at the first sample, in the fit"),
    ),
    *_faults(
        "hysteresis/initial_states.py",
        MODEL,
        ("return min(ends, key=", "return max(ends, key=", "the nearer side of a step is taken"),
        ("off = CROSSING_TOLERANCE * (operator.x_range[1] - operator.x_range[0])", "off = 0.0",
         "a start beside a step survives rounding"),
    ),
    *_faults(
        "hysteresis/model.py",
        MODEL,
        ("slew *= least_slope(stage)", "slew *= 1.0", "the slew limit holds through points behind the gears"),
        ("y = np.clip(y, limits.v_min, limits.v_max)", "pass", "the range holds to the last bit behind points"),
        ("0 if state == \"empty\" else 1", "1 if state == \"empty\" else 0",
         "the slew limit holds from the first sample on"),
        ("clipped = short and limits is not None and first.voltage in (limits.v_min, limits.v_max)",
         "clipped = False", "a first sample beyond the limits counts as clipped"),
        ("miss * self._input_per_stage_input()", "miss", "what the start misses is told in the user's unit"),
        ("            steps[0] = 0.0\n", "            pass\n", "the step before the very first sample does not matter"),
    ),
    *_faults(
        "hysteresis/cascade.py",
        MODEL,
        ("return min(ends), max(ends)", "return ends[1], ends[0]", "a negative gain exchanges the ends of the range"),
        ('parts.append([f"{stage.gain:.9e}", f"{stage.offset:.9e}"])', "parts.append([stage.gain, stage.offset])",
         "a state serves model and inverse"),
    ),
    *_faults(
        "hysteresis/stepper.py",
        KERNEL,
        ("words, memory, y = self._words.copy(), self._memory.copy(), np.empty(1)",
         "words, memory, y = self._words, self._memory, np.empty(1)", "a plan that is not committed leaves no trace"),
    ),
    *_faults(
        "hysteresis/identification/search.py",
        IDENTIFICATION,
        ("middle = round((interval[0] + interval[1]) / 2.0 / self._period * 4.0) / 4.0 * self._period", "middle = interval[0]",
         "the middle of the delays that explain the logs"),
        ("return min(held), max(held)", "return held[0], held[0]", "the interval of delays"),
    ),
    *_faults(
        "hysteresis/identification/evaluation.py",
        IDENTIFICATION,
        ("left - left.mean()", "left", "validation takes the sensor's offset off"),
        ("keep[:wiped] = False", "pass", "validation leaves the unknown history out"),
    ),
    *_faults(
        "hysteresis/identification/refinement.py",
        IDENTIFICATION,
        ("MARGIN = 0.125", "MARGIN = 0.0", "gears beyond the range of the logs"),
        ("(fitted.gains[acting] / basis.span)", "(fitted.gains[acting])", "the unit of the memories' gains"),
        ("prepared.scale * level - shift", "prepared.scale * level + shift", "what displacement counts as zero"),
    ),
    *_faults(
        "hysteresis/identification/normal_equations.py",
        IDENTIFICATION,
        ("(SLOPE_FLOOR + steps) / gears", "steps / gears", "no gear is flat"),
        ("steps = np.cumsum(heights, axis=0)", "steps = heights", "slopes that fall"),
        ("gears**3 * np.einsum", "gears**2 * np.einsum",
         "one smoothness means the same for any number of gears"),
    ),
    *_faults(
        "hysteresis/identification/regressors.py",
        IDENTIFICATION,
        ("np.clip(share, 0.0, 1.0)", "np.zeros(samples)", "delays of parts of a sample, in the fit"),
    ),
    *_faults(
        "hysteresis/identification/search.py",
        IDENTIFICATION,
        ("/ np.sqrt(max(len(excess) - 1, 1))", "", "the standard error of the mean, not of one fold"),
    ),
    *_faults(
        "hysteresis/identification/statistics.py",
        IDENTIFICATION,
        ("slice(begin if len(mine) < 2 else end - log.stretches, end)", "slice(begin, end)",
         "a fold left out has its log's offset in common with the others"),
    ),
    *_faults(
        "hysteresis/identification/preparation.py",
        IDENTIFICATION,
        ("return -1.0 if together < 0.0 else 1.0", "return 1.0", "the sign of the gain"),
        ("return cut if np.ptp(cut) > 0.0 else values", "return values", "one spike turns neither sign nor scale"),
    ),
    *_faults(
        "hysteresis/identification/refinement.py",
        IDENTIFICATION,
        ("+ slope * from_drive - hats @ moved", "+ slope * from_drive", "the linearised output error"),
    ),
    *_faults(
        "hysteresis/identification/paper_method.py",
        IDENTIFICATION,
        ("heights: Floats = floor + shares * np.cumsum(", "heights: Floats = shares * np.cumsum(",
         "no gear of the paper's method is flat"),
    ),
    *_faults(
        "reports/figures_of_merit.py",
        REPORTS,
        ("rmse = math.sqrt(variance + (mean - offset) ** 2)", "rmse = math.sqrt(variance)",
         "a constant error is an error"),
        ("key=lambda extreme: abs(extreme[0] - offset))", "key=lambda extreme: abs(extreme[0]))",
         "the largest error once the offset is off"),
        ("extreme[0]) for end in (min, max)]", "extreme[0]) for end in (max, max)]", "the largest error may be negative"),
        ("lag[0] * (self._hold or 1.0) if lag", "lag[0] if lag", "the lag of a held signal, in samples of the log"),
        ("prepend=self._last_desired)", "prepend=math.nan)", "a value held from one batch into the next counts once"),
        ("/ (samples - 1)", "/ samples", "n samples last n - 1 periods"),
        ("min(self._range[0], float(desired.min()))", "float(desired.min())", "the range is that of all batches"),
    ),
    *_faults(
        "reports/running_statistics.py",
        REPORTS,
        ("math.ceil(fraction * self.count)", "math.floor(fraction * self.count) + 1", "95 % of the samples, no more"),
        ("return self._sum + self._lost", "return self._sum", "long sums keep their digits"),
        ("odd = self.first % 2", "odd = 0", "bins that are doubled keep their places"),
        ("self._count(self._bins, self._first)", "pass", "the first batch is in the distribution of a long log"),
    ),
    *_faults(
        "reports/loop_and_lag.py",
        REPORTS,
        ("widths = down_sum / down_count - up_sum / up_count", "widths = up_sum / up_count - down_sum / down_count",
         "the sign of the loop that is left"),
        ("math.atan2(-across * math.sin(step), along)", "math.atan2(across * math.sin(step), along)",
         "the sign of the lag that is left"),
        ("return phase / step * self._spacing, math.degrees(phase)", "return phase / step, math.degrees(phase)",
         "the lag of a held or noisy signal, in samples"),
        ("self._sums[_UP if directions.earlier > 0 else _DOWN] += self._sums[_OPEN]", "pass",
         "what is open at the end of a batch counts once its way is known"),
        ("self._tail = (desired[-2 * h :].copy(), measured[-2 * h :].copy())",
         "self._tail = (desired[-h:].copy(), measured[-h:].copy())", "the lag loses no sample between two batches"),
        ("least = min(TURN_IN_NOISE * self._noise.deviation, LARGEST_TURN * (self._high - self._low))",
         "least = TURN_IN_NOISE * self._noise.deviation", "turns of a signal of few samples a cycle"),
    ),
    *_faults(
        "reports/sample_pairs.py",
        REPORTS,
        ("late, early = max(lag, 0), max(-lag, 0)", "late, early = max(lag, 0), 0", "a lag below 0"),
        ("return int(lags[best[np.argmin(np.abs(lags[best]))]])", "return int(lags[best[0]])",
         "of equal lags the smallest"),
        ('int(np.searchsorted(times, reached, side="right")) - 2, 0)',
         'int(np.searchsorted(times, reached, side="right")) - 1, 0)', "two samples of the trajectory stay after a block"),
        ("inside &= block.time >= onward[:-1]", "pass", "a recording's clock that steps back"),
        ("(self.count == 0 and not block.time[0] < 0.0)", "not block.time[0] < 0.0",
         "a conditioning sweep that ends with a block"),
        ('int(np.searchsorted(numbers, last, side="right"))', 'int(np.searchsorted(numbers, last, side="left"))',
         "the last row asked for counts"),
    ),
    *_faults(
        "reports/report.py",
        REPORTS,
        ("np.fmax.accumulate(np.concatenate", "(np.concatenate", "a clock that restarts opens no segment twice"),
        ("value is not None and value <= limit", "value is not None and value < limit", "a limit that is just met is met"),
        ("if first > 0.0 else None", "if first >= 0.0 else None", "no ratio to a first log without error"),
        ("lag, rows = self.options.lag, self.score_rows", "lag, rows = self.options.lag, None",
         "with a model only the rows asked for count"),
    ),
    *_faults(
        "reports/renderers.py",
        REPORTS,
        ("best = min(others,", "best = max(others,", "the sentence names the log with the least error"),
        ('("=", "+", "@")', '("=", "+")', "no name is a formula to a spreadsheet"),
    ),
    *_faults(
        "reports/thinned_curves.py",
        FIGURES,
        ("rows[:, 3].argmax(axis=2)", "rows[:, 3].argmin(axis=2)", "the greatest value of every stretch is kept"),
        ("self._last = (x[-1:], y[-1:])", "self._last = (x[:0], y[:0])", "a curve goes on from batch to batch"),
        ("self._tail = error[count * hop :].copy()", "self._tail = np.empty(0)",
         "the windows of a spectrum overlap from batch to batch"),
    ),
    *_faults(
        "reports/figures.py",
        FIGURES,
        ("bottom + up * (rows[0] - 1) - shift", "bottom + up * (rows[0] - 1)", "the offset is off the pixels of a long log"),
    ),
    *_faults(
        "reports/drawing.py",
        FIGURES,
        ("while unique.casefold() in taken:", "while unique in taken:", "file names differ where letters' size does not"),
    ),
    *_faults(
        "logs/binary/arrow.py",
        ("logs_values",),
        ("return None if name == _INDEX and kind.is_integer() else source", "return source",
         "row numbers of pandas are no column"),
        ('label="time" if name == _INDEX else name', "label=name", "stamps of pandas are the time"),
    ),
    *_faults(
        "logs/column_table.py",
        ("logs_values",),
        ("missing=missing or ((NETCDF_FILL,) if filled else ()),", "missing=missing,",
         "what was never written to netCDF is no number"),
    ),
    *_faults(
        "logs/hdf5/columns.py",
        ("logs_values",),
        ('filled = dataset.dtype.kind == "f" and dataset.fillvalue == NETCDF_FILL', "filled = False",
         "what was never written to netCDF-4 is no number"),
    ),
    *_faults(
        "logs/byte_source.py",
        ("logs_changing_files",),
        ("now.st_size < self._largest or", "False or", "a text log that is cut while it is read"),
        ("now.st_mtime_ns != self._begun.st_mtime_ns)", "False)", "a text log that is written over while it is read"),
        ("return found.st_ino, found.st_size, found.st_mtime_ns", "return found.st_ino, found.st_size, 0",
         "a binary log that is written over while it is read"),
    ),
    *_faults(
        "logs/hdf5/safety.py",
        ("logs_changing_files",),
        ("    root.watch.add(target)\n", "", "a file behind a link is watched, too"),
        ("        watch.add(source)\n", "", "a source of a virtual dataset is watched, too"),
    ),
    *_faults(
        "logs/hdf5/store.py",
        ("logs_stores",),
        ("return any(process != os.getpid() and is_running(process) for process in writers)",
         "return all(process != os.getpid() and is_running(process) for process in writers)",
         "who waits for a store asks all writers beside it"),
    ),
    *_faults(
        "logs/whole_output.py",
        ("logs_outputs", "logs_output_sets", "logs_stores", "logs_windows"),
        ("os.chmod(one.temporary, stat.S_IMODE(os.stat(one.target).st_mode))", "pass",
         "a file that is replaced, or a store that a group is added to, keeps its permissions"),
        ("_bring_to_disk(one.temporary, os.O_RDWR)", "_bring_to_disk(one.temporary, os.O_RDONLY)",
         "Windows stores a file through a handle that may write"),
        ("            _remove(one.backup)  # still there", "            pass  # still there",
         "no second copy is left where a rename fails"),
    ),
]  # fmt: skip
