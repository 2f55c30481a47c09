"""Logs whose truth is known, their time, unit and header lines changed by the hundred thousand.

    python benchmarks/header_fuzz.py [COUNT] [SEED]

Every log holds the same kind of samples: volts, micrometres, seconds. It is written
with names, units, clocks and lines as instruments and people write them, sometimes with
a slip of the pen, and read without being told how. What comes out must be the truth, or
something must have been said: a refusal or a warning. Told apart is what only the line
"what was read" says, where the file does not hold the answer (a bare ``time`` at half a
millisecond a step is a log at 2 samples a second as well). The same seed gives the same
logs.
"""

from __future__ import annotations

import datetime
import random
import re
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from dbo_cli.errors import DboError  # noqa: E402
from dbo_cli.logs.columns import column_wish  # noqa: E402
from dbo_cli.logs.request import ReadingOptions  # noqa: E402
from dbo_cli.logs.signal_log import SignalLog, open_log  # noqa: E402

# Written down apart from the program's own tables: what people write, and what it
# means.
SECONDS = {
    "s": 1.0, "S": 1.0, "sec": 1.0, "Sec": 1.0, "secs": 1.0, "seconds": 1.0, "Sekunden": 1.0, "ms": 1e-3,
    "mS": 1e-3, "MS": 1e-3, "msec": 1e-3, "msecs": 1e-3, "milliseconds": 1e-3, "us": 1e-6, "µs": 1e-6,
    "μs": 1e-6, "usec": 1e-6, "microseconds": 1e-6, "ns": 1e-9, "nanoseconds": 1e-9, "ps": 1e-12,
    "min": 60.0, "minutes": 60.0, "h": 3600.0, "hours": 3600.0, "days": 86400.0,
}  # fmt: skip
VOLTS = {
    "V": 1.0, "mV": 1e-3, "kV": 1e3, "uV": 1e-6, "µV": 1e-6, "volts": 1.0, "Volt": 1.0, "millivolts": 1e-3,
}  # fmt: skip
MICROMETRES = {
    "um": 1.0, "µm": 1.0, "μm": 1.0, "nm": 1e-3, "mm": 1e3, "m": 1e6, "micron": 1.0, "microns": 1.0,
    "micrometer": 1.0, "nanometers": 1e-3, "pm": 1e-6, "cm": 1e4,
}  # fmt: skip
ANY = {
    prefix + unit: size * base
    for prefix, size in {
        "": 1.0,
        "p": 1e-12,
        "n": 1e-9,
        "u": 1e-6,
        "m": 1e-3,
        "k": 1e3,
        "M": 1e6,
    }.items()
    for unit, base in (("V", 1.0), ("m", 1e6))
} | {name: size for table in (VOLTS, MICROMETRES) for name, size in table.items()}
ANY |= {"μV": 1e-6, "meter": 1e6, "meters": 1e6, "metre": 1e6, "%": 1.0}
NO_TIMES = (
    "ticks", "samples", "counts", "cycles", "frames", "furlongs", "V", "m", "pts", "a.u.", "100us", "1",
)  # fmt: skip
TIMES = (
    "time",
    "Time",
    "TIME",
    "t",
    "Zeit",
    "Elapsed",
    "timestamp",
    "Timestamp",
    "X_Value",
)
DRIVES = (
    "voltage", "Voltage", "drive", "Drive voltage", "command", "u", "Spannung", "Piezo voltage", "Volts",
)  # fmt: skip
PLACES = (
    "displacement", "Displacement", "position", "Position", "measured", "sensor", "y", "Weg", "z", "disp",
)  # fmt: skip
OTHERS = (
    "Current (mA)", "Temperature (degC)", "temp", "n", "index", "Force [N]", "x", "Vx", "Desired (um)",
    "target position (um)", "frequency_Hz", "CH3 (A)", "Sensor voltage (V)", "HV monitor (V)", "position 2",
    "Humidity (%)", "flag",
)  # fmt: skip
LETTERS = "abcdefgmnpstuvxyzVTS_ ()[]/.,;0123µ%#-"
BASE = datetime.datetime(2024, 3, 9, 23, 59, 59, 900000)


@dataclass
class Case:
    """One log: its text, how it is opened, and the truth (s, V, um; figures as they stand in the file)."""

    text: str
    seconds: np.ndarray
    volts: np.ndarray
    micrometres: np.ndarray
    figures: dict[str, np.ndarray]
    stamps: list[str]
    options: dict[str, Any] = field(default_factory=dict)
    kind: str = ""


class HeaderFuzz:
    """Writes logs, reads them, and counts what came of them."""

    def __init__(self, seed: int, folder: Path) -> None:
        self.random = random.Random(seed)
        self.path = folder / "log.csv"
        self.outcomes: Counter[str] = Counter()
        self.kinds: Counter[tuple[str, str]] = Counter()
        self.failures: list[str] = []

    def run(self, count: int) -> None:
        """Try ``count`` logs."""
        for number in range(count):
            case = self.case()
            self.path.write_text(case.text, encoding="utf-8")
            outcome = self.outcome(case)
            self.outcomes[outcome.partition(":")[0]] += 1
            self.kinds[case.kind, outcome.partition(":")[0]] += 1
            if outcome.startswith("WRONG"):
                self.failures.append(
                    f"{number} ({case.kind}) {outcome}\n{case.text[:600]}"
                )

    def case(self) -> Case:
        """Write one log."""
        pick = self.random
        rows = pick.randrange(30, 60)
        step = pick.choice([1e-5, 1e-4, 5e-4, 1e-3, 2e-3, 5e-3, 0.01, 0.02, 0.1])
        phase = np.arange(rows) / 7.0
        volts, places = (
            np.round(50 - 40 * np.cos(phase), 3),
            np.round(8 - 7 * np.cos(phase - 0.2), 4),
        )
        seconds = np.arange(rows) * step
        stamps, name, unit, kind, options = self.clock(seconds)
        drive, drive_unit = pick.choice(DRIVES), pick.choice(list(VOLTS))
        place, place_unit = pick.choice(PLACES), pick.choice(list(MICROMETRES))
        shown_volts, shown_places = (
            volts / VOLTS[drive_unit],
            places / MICROMETRES[place_unit],
        )
        columns: list[tuple[str, str, list[str]]] = [
            (name, unit, stamps),
            (drive, drive_unit, [repr(float(v)) for v in shown_volts]),
            (place, place_unit, [repr(float(v)) for v in shown_places]),
        ]
        figures = {
            "voltage": np.array(shown_volts),
            "displacement": np.array(shown_places),
        }
        for _ in range(pick.choice([0, 0, 0, 1, 1, 2])):
            noise = [repr(round(pick.uniform(0, 9), 3)) for _ in range(rows)]
            columns.insert(
                pick.randrange(len(columns) + 1), (pick.choice(OTHERS), "", noise)
            )
        if pick.random() < 0.3:
            pick.shuffle(columns)
        text, mutation = self.written(columns, options)
        return Case(
            text,
            seconds,
            volts,
            places,
            figures,
            stamps,
            options,
            f"{kind}, {mutation}",
        )

    def clock(
        self, seconds: np.ndarray
    ) -> tuple[list[str], str, str, str, dict[str, Any]]:
        """Choose how the time is written: its cells, the column's name and unit, and what this is called."""
        pick = self.random
        name = pick.choice(TIMES)
        way = pick.randrange(12)
        if way < 4:
            unit = pick.choice(list(SECONDS))
            begin = pick.choice([0.0, 0.0, 3.7, -0.5])
            return (
                [f"{v:.17g}" for v in (seconds + begin) / SECONDS[unit]],
                name,
                unit,
                "unit",
                {},
            )
        if way == 4:
            unit = pick.choice(NO_TIMES)
            return (
                [f"{v:.12g}" for v in seconds / 1e-4],
                name,
                unit,
                "no unit of time",
                {},
            )
        if way == 5:
            size = pick.choice([1.0, 1e-3, 1e-6, 1e-9, 60.0])
            return [f"{v:.12g}" for v in seconds / size], name, "", "bare", {}
        if way == 6:
            return [str(k) for k in range(len(seconds))], name, "", "rows counted", {}
        if way == 7:
            size = pick.choice([1, 10**3, 10**6, 10**9])
            if size == 1:
                return [f"{1709999999.25 + v}" for v in seconds], name, "", "epoch", {}
            whole = [round((1709999999.25 + v) * 1e6) * size // 10**6 for v in seconds]
            return [str(v) for v in whole], name, "", "epoch", {}
        if way == 8:
            origin = pick.choice([25569.0, 719529.0])
            days = [origin + 19791.43 + v / 86400 for v in seconds]
            return (
                [f"{v:.12f}" for v in days],
                pick.choice(["Date", name]),
                "",
                "days",
                {},
            )
        if way == 9:
            unit = pick.choice(["seconds", "milliseconds", "nanoseconds", "days"])
            cells = [f"{v:.17g}" for v in seconds / SECONDS[unit]]
            return cells, name, f"{unit} since 2024-03-09 10:15:00", "since", {}
        stamps = [
            BASE + datetime.timedelta(microseconds=round(v * 1e6)) for v in seconds
        ]
        style = pick.choice(
            ["%Y-%m-%dT%H:%M:%S.%f", "%Y-%m-%d %H:%M:%S.%fZ", "%H:%M:%S.%f", "%d.%m.%Y %H:%M:%S.%f",
             "%M:%S.%f", "%d-%b-%Y %H:%M:%S.%f", "%Y/%m/%d %I:%M:%S.%f %p", "%Y%m%dT%H%M%S.%f", "%H:%M:%S"]
        )  # fmt: skip
        return (
            [stamp.strftime(style) for stamp in stamps],
            name,
            "",
            f"stamps {style}",
            {},
        )

    def written(
        self, columns: list[tuple[str, str, list[str]]], options: dict[str, Any]
    ) -> tuple[str, str]:
        """Write the columns as a file, with a header of some kind and sometimes a slip."""
        pick = self.random
        mark = pick.choice([",", ",", ";", "\t"])
        way = pick.choice(["(%s)", "[%s]", "_%s", " in %s", "/%s", "line", "line"])
        if (
            any(" " in unit or unit in ("1", "100us") for _, unit, _ in columns)
            and way[0] in "_ /"
        ):
            way = "(%s)"  # no one writes these behind an underscore
        names = [name + (" " if way[0] in "([" else "") + (way % unit if unit and way != "line" else "")
                 for name, unit, _ in columns]  # fmt: skip
        names = [
            name if mark not in name else f'"{name}"' for name in map(str.strip, names)
        ]
        head = [mark.join(names)]
        if way == "line":
            wrap = pick.choice(["%s", "(%s)", "[%s]"])
            head.append(
                mark.join(wrap % unit if unit else "" for _, unit, _ in columns)
            )
        rows = [
            mark.join(cells)
            for cells in zip(*(cells for _, _, cells in columns), strict=True)
        ]
        above = pick.choice(
            [[], [], [], ["# bench 3", "# 2024"], ["Device;E-709", "Serial 12", ""]]
        )
        mutation = pick.choice(
            ["as written"] * 3
            + ["slip", "slip", "text inside", "text inside, rate", "units lost"]
        )
        if mutation == "slip":
            line = self.slipped(head[0])
            cells = line.split(mark)
            kept = [at for at, (name, _, _) in enumerate(columns) if name in OTHERS]
            if len(cells) != len(names) or all(cells[at] == names[at] for at in kept):
                # a slip in another column's name may make it a signal's: that is no
                # slip then
                head[0] = line
        elif mutation == "units lost" and len(head) > 1:
            head.pop()
        elif mutation.startswith("text inside"):
            counted = mark.join(["Channels", "2", "3", "4", "5"][: len(columns)])
            worded = mark.join(["X_Dimension", *["Time"] * (len(columns) - 1)])
            inside = pick.choice(
                [head, head[:1], [counted], [worded], ["# pause"], [""]]
            )
            at = pick.randrange(1, len(rows))
            rows[at:at] = inside
            if mutation.endswith("rate"):
                options["sample_rate"] = 1000.0
        return "\n".join([*above, *head, *rows]) + "\n", f"{mutation}, units {way}"

    def slipped(self, line: str) -> str:
        """Change one or two characters of a line."""
        pick = self.random
        for _ in range(pick.choice([1, 1, 2])):
            here = pick.randrange(len(line) + 1)
            way = pick.randrange(4)
            if way == 0:
                line = line[:here] + pick.choice(LETTERS) + line[here:]
            elif way == 1:
                line = line[:here] + line[here + 1 :]
            elif way == 2:
                line = line[:here] + pick.choice(LETTERS) + line[here + 1 :]
            else:
                line = (
                    line[:here]
                    + line[here + 1 : here + 2]
                    + line[here : here + 1]
                    + line[here + 2 :]
                )
        return line

    def outcome(self, case: Case) -> str:
        """Read a log and say what came of it."""
        want = {
            role: column_wish(role, option=role) for role in ("voltage", "displacement")
        }
        try:
            with open_log(str(self.path), want, ReadingOptions(**case.options)) as log:
                block = log.read()
        except DboError as problem:
            if "\n" in str(problem) or not str(problem).strip():
                return f"WRONG: not one line: {problem!r}"
            return "refused"
        wrong = self.wrong_time(log, block.time, case)
        for role, truth, units in (
            ("voltage", case.volts, VOLTS),
            ("displacement", case.micrometres, MICROMETRES),
        ):
            wrong += self.wrong_values(
                log, role, block.values[role], truth, units, case
            )
        if not wrong:
            return "right"
        if log.warnings or log.notes:
            return "warned"
        line = log.reading_line()
        if wrong == ["time"] and re.search(r"no unit, read as s\)|, no time;", line):
            return "said in the line"
        return f"WRONG: {', '.join(wrong)}: {line}"

    def wrong_values(
        self,
        log: SignalLog,
        role: str,
        got: np.ndarray,
        truth: np.ndarray,
        units: dict[str, float],
        case: Case,
    ) -> list[str]:
        """Hold a signal against the truth; where no unit was read, against the file's figures."""
        unit = log.columns[role].unit
        restated = stated_in(log.columns[role].name, ANY)
        # the slip made another true statement
        if restated is not None and "slip" in case.kind:
            same = unit is None or ANY.get(unit) == ANY[restated]
            return [] if np.allclose(got, case.figures[role]) and same else [role]
        if unit is None:
            expected = case.figures[role]
        else:
            if unit not in units:
                return [f"{role} in {unit}"]
            expected, got = truth, got * units[unit]
        if len(got) != len(expected):
            return [f"{role}: {len(got)} rows"]
        return [] if np.allclose(got, expected, rtol=1e-9, atol=1e-12) else [role]

    def wrong_time(
        self, log: SignalLog, got: np.ndarray | None, case: Case
    ) -> list[str]:
        """Hold the steps of the clock against the truth (stamps since 1970 resolve 0.24 us)."""
        if "sample_rate" in case.options:
            return []
        if got is None:
            return ["time"]
        if len(got) != len(case.seconds):
            return ["rows"]
        expected = case.seconds
        restated = None if log.time is None else stated_in(log.time.name, SECONDS)
        if (
            restated is not None
            and "slip" in case.kind
            and all(map(is_figure, case.stamps))
        ):
            figures = np.array(case.stamps, dtype=float)
            expected = (figures - figures[0]) * SECONDS[restated]
        return (
            []
            if np.allclose(got - got[0], expected, rtol=1e-6, atol=1.1e-6)
            else ["time"]
        )


def stated_in(name: str, units: dict[str, float]) -> str | None:
    """Return the unit that a header cell states, read without the program."""
    found = re.search(r"[\[(]\s*([^\[\]()]+?)\s*[\])]\s*$", name) or re.search(
        r"[/_ ]([^/_ ]+)$", name
    )
    return found[1] if found and found[1] in units else None


def is_figure(cell: str) -> bool:
    """Tell whether a cell is a plain number."""
    return re.fullmatch(r"-?[\d.]+(e[-+]?\d+)?", cell) is not None


def main() -> None:
    """Try many logs, and exit with 1 where one was read wrong without a word."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 100_000
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    begin = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        fuzz = HeaderFuzz(seed, Path(folder))
        fuzz.run(count)
    for outcome, times in fuzz.outcomes.most_common():
        print(f"{times:8,}  {outcome}")
    for failure in fuzz.failures[:10]:
        print(failure)
    wrong = len(fuzz.failures)
    print(
        f"{count:,} logs, {time.perf_counter() - begin:.0f} s: {wrong} read wrong without a word"
    )
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
