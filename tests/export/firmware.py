"""Models to export, and exports compiled and called from here."""

import ctypes
import itertools
import os
import shutil
import subprocess
import tempfile
import warnings
from pathlib import Path

import numpy as np

import dbo_cli.model as dm
from dbo_cli.drive import Driver, Lead
from dbo_cli.export.plan import Grid

CC = os.environ.get("CC", "cc")
NO_COMPILER = shutil.which(CC) is None
FLAGS = "-std=c99 -pedantic -Wall -Wextra -Werror -ffp-contract=off".split()
RATE = 1000.0
LOW, HIGH = 0.0, 100.0
KEPT = tempfile.TemporaryDirectory()
COMPILED = {}
NUMBERS = itertools.count()
MORE_REST = 8  # rows before a move, from which on a delay knows its past


def gears(n, seed=1, relaxation=None, run=1):
    """Return n uneven gears, in runs of equal ones, whose slopes grow."""
    rng = np.random.default_rng(seed)
    parts = -(-n // run)
    dx = np.repeat(rng.uniform(0.5, 1.5, parts), run)[:n]
    slope = np.repeat(np.linspace(0.04, 0.09, parts), run)[:n]
    dx *= (HIGH - LOW) / dx.sum()
    return dm.Gears(dx, dx * slope, LOW, 0.3, relaxation)


def curve(low, high, bend):
    """Return points from a range to itself."""
    x = np.linspace(0.0, 1.0, 7)
    y = x + bend * x * (1.0 - x)
    return dm.Points(np.diff(x) * (high - low), np.diff(y) * (high - low), low, low)


def model_of(*stages):
    """Return a forward model whose displacement range is what it reaches slowly."""
    voltage = dm.Quantity("voltage", "V", LOW, HIGH)
    guess = dm.Quantity("displacement", "um", -1e3, 1e3)
    wide = dm.Cascade("forward", voltage, guess, stages)
    y, _ = wide.static.simulate([LOW, HIGH], dt=1e9)
    ends = sorted(y.tolist())
    reached = dm.Quantity("displacement", "um", *ends)
    return dm.Cascade("forward", voltage, reached, stages)


def beyond(relaxation=None):
    """Return gears that go on beyond both ends of the range: those come last in the table."""
    inside = gears(30, relaxation=relaxation)
    dx = np.concatenate([inside.dx, np.full(6, 2.5)])
    dy = np.concatenate([inside.dy, np.full(6, 0.2)])
    return dm.Gears(dx, dy, LOW - 3 * 2.5, 0.3 - 3 * 0.2, relaxation)


CREEP = dm.Relaxation(0.0, (0.01, 0.3), (0.004, 0.006))
SOFT = dm.Relaxation(10.0, (0.02, 0.5), (-0.015, 0.006))
SWINGING = dm.Dynamics(
    (
        dm.Lag(2e-4),
        dm.Resonance(150.0, 0.05),
        dm.Resonance(210.0, 0.04, dm.Mode(180.0, 0.03)),
    )
)
LAG = dm.Amplifier(7e-4)
MODELS = {
    "one gear": model_of(gears(1)),
    "gears": model_of(gears(40)),
    "runs": model_of(gears(600, run=20)),
    "many": model_of(gears(1280)),
    "bent, falling": model_of(curve(LOW, HIGH, 0.3), gears(40), dm.Scale(-2.0, 5.0)),
    "points behind": model_of(gears(40), curve(0.3, 7.0, -0.2), dm.Scale(3.0, 0.0)),
    "few": model_of(curve(LOW, HIGH, 0.3), gears(12), dm.Delay(0.0007)),
    "beyond": model_of(beyond()),
    "beyond, soft": model_of(beyond(SOFT)),
    "creep": model_of(gears(64, relaxation=CREEP)),
    "negative gains": model_of(gears(64, relaxation=SOFT), dm.Scale(2.0, 0.0)),
    "delay": model_of(gears(40, relaxation=CREEP), dm.Delay(0.0043)),
    "whole delay": model_of(gears(40), dm.Delay(0.003)),
    "amplifier": model_of(LAG, curve(LOW, HIGH, 0.3), gears(40, relaxation=SOFT)),
    "amplifier, all": model_of(
        LAG, dm.Scale(-1.0, HIGH), gears(40), SWINGING, dm.Delay(0.0012)
    ),
    "dynamics": model_of(gears(40, relaxation=SOFT), SWINGING, dm.Delay(0.0012)),
}  # fmt: skip


def wish(model, rows=1500, seed=3):
    """Return a displacement from rest at the drive's lower end that turns often, and goes a little beyond."""
    low, high = model.output.min, model.output.max
    rng = np.random.default_rng(seed)
    rows_risen = np.arange(rows)
    walk = np.cumsum(rng.normal(0.0, 0.05, rows) + 0.05 * np.sin(rows_risen / 40.0))
    way = np.abs((walk + 4.0) % 2.0 - 1.0) * np.minimum(1.0, rows_risen / 200.0)
    way[rows // 2 : rows // 2 + 30] = way[rows // 2]
    jumps = rng.uniform(0.0, 1.0, 60)
    part = np.concatenate([np.zeros(80), way, jumps, [1.0, 0.0, 1.02, 0.5, -0.01, 0.2]])
    if model.sign == "falling":
        part = 1.0 - part
    return low + (high - low) * part


def played(model, limits, firmware, seed=3, state="empty"):
    """Return what an export and the library drive for one move, from ``empty`` or after a reset."""
    figures, wanted = firmware.export.figures, wish(model, seed=seed)
    ahead, is_whole = figures["ahead"], figures["arithmetic"] == "q31"
    wanted = np.concatenate([np.full(ahead + MORE_REST, wanted[0]), wanted])
    source, drive = Grid.of(model.output), Grid.of(model.input)
    if is_whole:
        wanted = np.clip(wanted, model.output.min, model.output.max)
        wanted = np.array([source.value(source.count(x)) for x in wanted])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        driver = Driver(Lead(model, limits, state), on_limit="clip")
        expected = driver.whole(wanted, 1.0 / RATE).voltage
    if state != "empty":  # the first row is where it rests
        found = firmware.play(wanted[1 + ahead :], reset=expected[0])
        return found, expected[1 : 1 + found.size]
    if is_whole:
        found = firmware.play([source.count(x) for x in wanted[ahead:]])
        found = np.array([drive.value(count) for count in found])
    else:
        found = firmware.play(wanted[ahead:])
    return found, expected[: found.size]


class Firmware:
    """An export, compiled."""

    def __init__(self, export, folder, *flags):
        folder.mkdir(exist_ok=True)
        for file, text in export.files.items():
            (folder / file).write_text(text)
        self.folder, self.export = folder, export
        name, number = export.figures["name"], "double"
        self.kind = ctypes.c_double
        if export.figures["arithmetic"] == "q31":
            number, self.kind = "int32_t", ctypes.c_int32
        (folder / "play.c").write_text(
            f'#include "{name}.h"\n'
            f"static {name}_state s;\n"
            f"void init(void); void reset({number} d); {number} step({number} x);\n"
            f"void init(void) {{ {name}_init(&s); }}\n"
            f"void reset({number} d) {{ {name}_reset(&s, d); }}\n"
            f"{number} step({number} x) {{ {name}_state t = s; {number} y = {name}_step(&t, x);"
            f" s = t; return y; }}\n"
        )
        self.flags = [*FLAGS, "-O0", "-fPIC", *flags]
        self.compiled = {}
        # a name of its own: a library of a path that is loaded already is not loaded again
        output = folder / f"play_{next(NUMBERS)}.so"
        self._compile([*self._objects("_test"), "-shared", "-o", output])
        self.library = ctypes.CDLL(str(output))
        self.library.step.argtypes = [self.kind]
        self.library.step.restype = self.kind
        self.library.reset.argtypes = [self.kind]

    def _objects(self, left_out):
        """Compile the sources once; those of the kernel once for all exports."""
        objects = []
        for path in sorted(self.folder.glob("*.c")):
            if left_out not in path.name:
                objects.append(self._object(path))
        return objects

    def _object(self, path):
        key, compiled = (path.read_text(), *self.flags), self.compiled
        output = path.with_suffix(".o")
        if path.name.startswith("dbo_"):
            compiled = COMPILED
            output = Path(KEPT.name) / f"{len(COMPILED)}.o"
        if key not in compiled:
            self._compile(["-c", path, "-o", output])
            compiled[key] = output
        return compiled[key]

    def _compile(self, words):
        subprocess.run([str(word) for word in [CC, *self.flags, *words]], check=True)

    def play(self, inputs, reset=None):
        """Return the output for each input; the state is copied before each step."""
        if reset is None:
            self.library.init()
        else:
            self.library.reset(reset)
        return np.array([self.library.step(x) for x in inputs])

    def self_test(self):
        """Compile and run the self-test; return its exit code and what it says."""
        program = self.folder / "self"
        self._compile([*self._objects("play.c"), "-o", program])
        done = subprocess.run([str(program)], capture_output=True, text=True)
        return done.returncode, done.stdout
