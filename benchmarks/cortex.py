"""Exports on emulated microcontrollers: the self-test, instructions a step, flash and RAM.

    python benchmarks/cortex.py

Needs (Debian, Ubuntu): apt install gcc-arm-none-eabi qemu-system-arm. A model of so
many gears in 64 slopes, four memories and points follows a smooth move of 400 samples a
cycle, then jumps from either end to 32 places and back. Instructions are what QEMU
counts (-icount), with the call and the reading of the clock; compiled by -O2 and
-DDBO_SMALL. Flash is code and tables of the export, without soft float and self-test.
Exit 1 where a self-test fails, or a step of 1,152 gears costs more than three times
that of 64.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dbo_cli.drive import Limits
from dbo_cli.export import export_model
from dbo_cli.export.text import array, real, whole
from dbo_cli.model import Cascade, Gears, Points, Quantity, Relaxation

HERE = Path(__file__).resolve().parent / "cortex"
GEARS = (64, 1152)
SLOPES = 64
MOST = 3.0
TOOLS = ("arm-none-eabi-gcc", "arm-none-eabi-size", "qemu-system-arm")
FLAGS = "-mthumb -std=gnu99 -O2 -ffp-contract=off -ffreestanding -ffunction-sections -DDBO_NO_MAIN"


class Chip(NamedTuple):
    """A microcontroller: its compiler flags, flash and RAM, and the board that QEMU emulates."""

    name: str
    flags: str
    memory: tuple[str, str]
    board: str


CHIPS = (
    Chip(
        "Cortex-M0+",
        "-mcpu=cortex-m0plus -mfloat-abi=soft",
        ("256K", "16K"),
        "microbit",
    ),
    Chip(
        "Cortex-M4F",
        "-mcpu=cortex-m4 -mfloat-abi=hard -mfpu=fpv4-sp-d16",
        ("4M", "4M"),
        "mps2-an386",
    ),
    Chip(
        "Cortex-M7",
        "-mcpu=cortex-m7 -mfloat-abi=hard -mfpu=fpv5-d16",
        ("4M", "4M"),
        "mps2-an500",
    ),
)


def actuator(gears: int) -> Cascade:
    """Return a model of a piezo stage of 100 V and some 12 um."""
    slopes = np.repeat(np.linspace(0.05, 0.15, SLOPES), gears // SLOPES)
    width = np.full(gears, 100.0 / gears)
    memory = Relaxation(0.0, (0.002, 0.02, 0.2, 2.0), (0.0008, 0.0008, 0.0008, 0.0008))
    height = width * slopes
    bend = np.full(8, height.sum() * 1.1 / 8)
    stages = (
        Gears(width, height, 0.0, 0.0, memory),
        Points(bend, bend * np.linspace(1.2, 1.6, 8), 0.0, 0.0),
    )
    voltage = Quantity("voltage", "V", 0.0, 100.0)
    return Cascade(
        "forward", voltage, Quantity("displacement", "um", 0.0, 12.0), stages
    )


def moves_header(arithmetic: str) -> str:
    """Return a smooth move and jumps, as parts of the range in the numbers of an export."""
    k = np.arange(800)
    moves = 0.5 - 0.5 * np.cos(k * np.pi / 200.0) * (1.0 - k / 1600.0)
    places = 0.5 - 0.5 * np.cos(np.arange(32) * np.pi / 31.0)
    jumps = np.column_stack([np.repeat([0.0, 1.0], 32), np.tile(places, 2)]).ravel()
    kind, text = "double", f"#define MOVES {moves.size}u\n#define JUMPS {jumps.size}u\n"
    if arithmetic == "q31":
        kind = "int32_t"
    text += f"typedef {kind} number;\n"
    for name, parts in (("moves", moves), ("jumps", jumps)):
        values = [real(12.0 * part) for part in parts]
        if arithmetic == "q31":
            values = [whole(round(2.0**31 * (part - 0.5))) for part in parts]
        text += array(kind, name, values)
    return text


def measured(chip: Chip, gears: int, arithmetic: str) -> list[int]:
    """Export, build and run; return failures, instructions (mean, worst, jump), and bytes (RAM, flash)."""
    model = actuator(gears)
    made = export_model(
        model,
        Limits.within(model.input),
        name="x",
        arithmetic=arithmetic,
        sample_rate=1000.0,
    )
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file, text in made.files.items():
            (folder / file).write_text(text)
        (folder / "moves.h").write_text(moves_header(arithmetic))
        layout = (HERE / "board.ld").read_text().replace("@FLASH@", chip.memory[0])
        (folder / "board.ld").write_text(layout.replace("@RAM@", chip.memory[1]))
        sources = [file for file in made.files if file.endswith(".c")]
        sources.remove("x_test.c")  # measure.c includes it
        compiler = [TOOLS[0], *chip.flags.split(), *FLAGS.split(), "-DDBO_SMALL", "-I."]
        output_of(folder, [*compiler, "-c", *sources])
        objects = [source.replace(".c", ".o") for source in sources]
        sizes = output_of(folder, [TOOLS[1], "-t", *objects])
        flash = int(sizes.splitlines()[-1].split()[0])
        linked = ["-nostdlib", "-Wl,--gc-sections", "-T", "board.ld", "-o", "x.elf"]
        program = [str(HERE / "measure.c"), *objects, "-lgcc"]
        output_of(folder, [*compiler, *linked, *program])
        emulator = [TOOLS[2], "-M", chip.board, "-nographic", "-icount", "shift=6"]
        hosted = ["-semihosting-config", "enable=on,target=native", "-kernel", "x.elf"]
        figures = output_of(folder, [*emulator, *hosted])
    return [*(int(word) for word in figures.split()), flash]


def output_of(folder: Path, words: list[str]) -> str:
    """Run a program and return what it prints."""
    done = subprocess.run(
        words, cwd=folder, capture_output=True, text=True, stdin=subprocess.DEVNULL,
        timeout=300, check=False,
    )  # fmt: skip
    if done.returncode != 0:
        raise SystemExit(f"{' '.join(words)}: {done.stdout}{done.stderr}")
    return done.stdout + done.stderr


def main() -> int:
    """Print a line for each chip, arithmetic and number of gears."""
    absent = [tool for tool in TOOLS if shutil.which(tool) is None]
    if absent:
        print(f"not run without {', '.join(absent)} (the first lines of this file)")
        return 0
    head = f"{'chip':<12}{'numbers':<10}{'gears':>6}{'mean':>8}{'worst':>8}{'jump':>8}"
    print(f"{head}{'RAM B':>8}{'flash B':>9}")
    failed = False
    for chip in CHIPS:
        for arithmetic in ("double", "q31"):
            steps = []
            for gears in GEARS:
                wrong, *figures = measured(chip, gears, arithmetic)
                mean, worst, jump, ram, flash = figures
                steps.append(max(worst, jump))
                failed = failed or wrong > 0
                line = f"{chip.name:<12}{arithmetic:<10}{gears:>6}{mean:>8}{worst:>8}{jump:>8}"
                print(f"{line}{ram:>8}{flash:>9}", flush=True)
                if wrong:
                    print(f"  the self-test fails: {wrong} samples differ")
            failed = failed or steps[-1] > MOST * steps[0]
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
