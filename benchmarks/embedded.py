"""Exports on emulated microcontrollers: the self-test, and instructions, code, tables, RAM and stack.

    python benchmarks/embedded.py [--chips m0plus,m4f,m7,rv32] [--gears
    8,25,64,256,1152]
        [--arithmetics double,float,q31] [--csv FILE] [--before FILE]

Needs (Debian, Ubuntu): apt install gcc-arm-none-eabi libnewlib-arm-none-eabi
gcc-riscv64-unknown-elf qemu-system-arm qemu-system-misc. Chips whose tools are missing
are left out and named.

An inverse model of n gears (64 slopes at most, points, a scale, limits; with four
relaxation terms or none) follows a smooth move of 400 samples a cycle, then jumps from
either end to 32 places and back, then from the state of `NAME_reset` in the middle to
either end, which wipes out a turn every other gear. Instructions are what QEMU counts
(-icount), -O2, soft float where the chip has none for the type; code holds the soft
float that it needs. `--before` takes the CSV of another state of the program, and adds
ratios to it. Beside it n play operators (the inverse of Prandtl-Ishlinskii) without
points, limits or memory.
"""

from __future__ import annotations

import argparse
import csv
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "tests" / "extras")]

from exported import made_model  # noqa: E402

from dbo_cli.extras.export.export import export_model  # noqa: E402
from dbo_cli.extras.export.source_text import array, hex_double, hex_float, integer  # noqa: E402

HERE = Path(__file__).resolve().parent / "embedded"
ARITHMETICS = ("double", "float", "q31")
TYPES = {"double": "double", "float": "float", "q31": "int32_t"}


@dataclass(frozen=True)
class Chip:
    """A microcontroller: compiler, flags, board file, linker script and emulator."""

    name: str
    compiler: str
    flags: str
    board: str
    memory: tuple[str, str]
    emulator: str


ARM = "qemu-system-arm -M {} -nographic -semihosting-config enable=on,target=native -icount shift=6 -kernel"
CHIPS = {
    "m0plus": Chip("Cortex-M0+", "arm-none-eabi-gcc", "-mcpu=cortex-m0plus -mthumb -mfloat-abi=soft", "arm",
                   ("256K", "16K"), ARM.format("microbit")),
    "m4f": Chip("Cortex-M4F", "arm-none-eabi-gcc",
                "-mcpu=cortex-m4 -mthumb -mfloat-abi=hard -mfpu=fpv4-sp-d16", "arm", ("4M", "4M"),
                ARM.format("mps2-an386")),
    "m7": Chip("Cortex-M7", "arm-none-eabi-gcc",
               "-mcpu=cortex-m7 -mthumb -mfloat-abi=hard -mfpu=fpv5-d16", "arm", ("4M", "4M"),
               ARM.format("mps2-an500")),
    "rv32": Chip("RV32IMAC", "riscv64-unknown-elf-gcc",
                 "-march=rv32imac -mabi=ilp32 -mcmodel=medany -msmall-data-limit=0", "riscv", ("", ""),
                 "qemu-system-riscv32 -M virt -bios none -nographic -semihosting-config"
                 " enable=on,target=native -icount shift=0 -kernel"),
}  # fmt: skip


def missing(chip: Chip) -> list[str]:
    """Return the tools a chip needs that are not here."""
    return [
        tool
        for tool in (chip.compiler, chip.emulator.split()[0])
        if shutil.which(tool) is None
    ]


def moves_header(
    low: float, high: float, arithmetic: str, drive: tuple[float, float]
) -> str:
    """Return smooth moves over the range, 400 samples a cycle, jumps from its ends and drives to reset to.

    A jump costs most where it ends inside the last gears: places lie denser towards the
    ends.
    """
    k = np.arange(800)
    values = low + (high - low) * (
        0.5 - 0.5 * np.cos(k * np.pi / 200.0) * (1.0 - k / 1600.0)
    )
    places = low + (high - low) * (0.5 - 0.5 * np.cos(np.arange(32) * np.pi / 31.0))
    jumps = np.column_stack([np.repeat([low, high], 32), np.tile(places, 2)]).ravel()
    resets = [f"{drive[0] + part * (drive[1] - drive[0])!r}" for part in (0.49, 0.51)]
    if arithmetic == "q31":
        resets = [str(round(2.0**31 * (part - 0.5))) for part in (0.49, 0.51)]
        text = [
            [integer(round(2.0**31 * ((v - low) / (high - low) - 0.5))) for v in row]
            for row in (values, jumps)
        ]
    else:
        spell = hex_double if arithmetic == "double" else hex_float
        text = [[spell(v) for v in row] for row in (values.tolist(), jumps.tolist())]
    kind = TYPES[arithmetic]
    return (
        ("" if arithmetic is None else f"#ifndef PLAYS\ntypedef {kind} number_type;\n#endif\n")
        + f"#define MOVES {len(values)}u\n#define JUMPS {len(jumps)}u\n"
        + array(kind, "moves", text[0]) + array(kind, "jumps", text[1])
        + f"#ifndef PLAYS\n{array(kind, 'resets', resets)}#endif\n"
    )  # fmt: skip


def build(
    chip: Chip, folder: Path, sources: list[str], defines: list[str]
) -> dict[str, int]:
    """Compile and link; return bytes of code, constants and RAM of the whole program."""
    script = (HERE / f"{chip.board}.ld").read_text().replace("@FLASH@", chip.memory[0])
    (folder / "memory.ld").write_text(script.replace("@RAM@", chip.memory[1]))
    subprocess.run(
        [chip.compiler, *chip.flags.split(), "-std=gnu99", "-O2", "-ffp-contract=off", "-ffreestanding",
         "-ffunction-sections", "-fdata-sections", f"-I{HERE}", "-I.", *defines, *sources,
         str(HERE / f"{chip.board}.c"), "-nostdlib", "-Wl,--gc-sections", "-T", "memory.ld", "-lgcc", "-o",
         "program.elf"],
        cwd=folder, check=True,
    )  # fmt: skip
    tool = chip.compiler.replace("gcc", "size")
    listed = subprocess.run(
        [tool, "-A", "program.elf"],
        cwd=folder,
        capture_output=True,
        text=True,
        check=True,
    )
    sizes = {
        row.split()[0]: int(row.split()[1])
        for row in listed.stdout.splitlines()
        if row.startswith(".")
    }
    return {"code": sizes.get(".text", 0), "constants": sizes.get(".rodata", 0)}


def run(chip: Chip, folder: Path) -> list[int]:
    """Run the program; return wrong samples, instructions (mean, worst, full step, after reset), stack."""
    done = subprocess.run(
        [*chip.emulator.split(), "program.elf"], cwd=folder, capture_output=True, text=True, timeout=300,
        check=False, stdin=subprocess.DEVNULL,
    )  # fmt: skip
    found = [
        row
        for row in (done.stdout + done.stderr).splitlines()
        if row.startswith("result")
    ]
    if not found:
        raise SystemExit(f"{chip.name}: no result: {done.stdout} {done.stderr}")
    return [int(v) for v in found[0].split()[1:]]


def measured(chip: Chip, gears: int, terms: int, arithmetic: str) -> dict[str, Any]:
    """Export, build, run; code is what step, init and reset add to an empty program."""
    model = made_model(0, gears=gears, slopes=min(gears, 64), terms=terms)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "x"
        ends = model.drive.minimum, model.drive.maximum
        summary = export_model(
            model, str(folder), name="x", arithmetic=arithmetic, sample_rate=1000.0
        )  # type: ignore[arg-type]
        moves = moves_header(
            model.output.minimum, model.output.maximum, arithmetic, ends
        )
        (folder / "moves.h").write_text(moves)
        own = ["x.c", "dbo_kernel.c"]
        flags = ["-DDBO_NO_MAIN", '-DTEST="x_test.c"', "-DDBO_SMALL"]
        build(chip, folder, [str(HERE / "measure.c"), *own], flags)
        wrong, mean, worst, full, settled, stack = run(chip, folder)
        caller = '#include "x.h"\nx_state s;\nvolatile {0} v;\nint main(void) {{ {1} return 0; }}\n'
        calls = "x_init(&s); x_reset(&s, v); v = x_step(&s, v);"
        (folder / "size.c").write_text(caller.format(TYPES[arithmetic], calls))
        with_it = build(chip, folder, ["size.c", *own], flags)
        (folder / "size.c").write_text(caller.format(TYPES[arithmetic], ""))
        without = build(chip, folder, ["size.c", *own], flags)
    return {
        "chip": chip.name, "gears": gears, "terms": terms, "arithmetic": arithmetic, "wrong": wrong,
        "mean": mean, "worst": worst, "full_step": full, "after_reset": settled,
        "code_bytes": with_it["code"] - without["code"],
        "table_bytes": summary.table_bytes, "ram_bytes": summary.state_bytes, "stack_bytes": stack,
    }  # fmt: skip


def plays(chip: Chip, count: int, arithmetic: str) -> int:
    """Return the mean instructions of a step of ``count`` play operators."""
    spell = {"double": hex_double, "float": hex_float, "q31": integer}[arithmetic]
    scale = 2.0**29 if arithmetic == "q31" else 1.0
    kind = TYPES[arithmetic]
    near = [scale * 0.5 * i / count for i in range(count)]
    weights = [2.0**30 / count if arithmetic == "q31" else 1.0 / count] * count
    text = [
        [spell(int(v) if arithmetic == "q31" else v) for v in row]
        for row in (near, weights)
    ]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "moves.h").write_text(moves_header(0.0, 1.0, arithmetic, (0.0, 1.0)))
        (folder / "tables.c").write_text(
            "#include <stdint.h>\n"
            + "".join(
                f"extern const {kind} {key}[{count}];\nconst {kind} {key}[{count}] = {{{', '.join(row)}}};\n"
                for key, row in zip(("thresholds", "weights"), text, strict=True)
            )
        )
        number = ARITHMETICS.index(arithmetic) + 1
        build(
            chip,
            folder,
            [str(HERE / "measure.c"), "tables.c"],
            [f"-DPLAYS={number}", f"-DN={count}"],
        )
        return run(chip, folder)[1]


Case = tuple[str, str, str, str]


def case_of(row: dict[str, Any]) -> Case:
    """Return what a row is about."""
    return (
        str(row["chip"]),
        str(row["gears"]),
        str(row["arithmetic"]),
        str(row["terms"]),
    )


def rows_of(path: Path) -> dict[Case, dict[str, Any]]:
    """Return the rows of another run's CSV."""
    with path.open(newline="") as file:
        return {case_of(row): row for row in csv.DictReader(file)}


def ratios(row: dict[str, Any], before: dict[Case, dict[str, Any]]) -> str:
    """Return jump, flash and RAM against another run, where it has the case."""
    old = before.get(case_of(row))
    if old is None:
        return ""
    flash = row["code_bytes"] + row["table_bytes"]
    old_flash = int(old["code_bytes"]) + int(old["table_bytes"])
    more = row["ram_bytes"] - int(old["ram_bytes"])
    jump = row["full_step"] / int(old["full_step"])
    a_gear = more / row["gears"]
    return f"  jump x {jump:.2f}, flash x {flash / old_flash:.2f}, RAM {more:+d} ({a_gear:.2f} a gear)"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--chips", default=",".join(CHIPS))
    parser.add_argument("--gears", default="8,25,64,256,1152")
    parser.add_argument("--arithmetics", default=",".join(ARITHMETICS))
    parser.add_argument("--csv", type=Path)
    parser.add_argument("--before", type=Path)
    options = parser.parse_args()
    rows = []
    before = {} if options.before is None else rows_of(options.before)
    print(
        "chip        gears arithmetic memory  wrong    mean   worst  full step  after reset    plays    code"
        "  tables   RAM  stack"
    )
    for key in options.chips.split(","):
        chip = CHIPS[key]
        if missing(chip):
            print(f"{chip.name}: left out, no {' and no '.join(missing(chip))}")
            continue
        for gears in (int(v) for v in options.gears.split(",")):
            for arithmetic in options.arithmetics.split(","):
                fits = chip.memory[1] != "16K" or gears * 8 < 12_000
                rival = plays(chip, gears, arithmetic) if fits else None
                for terms in (0, 4):
                    row = measured(chip, gears, terms, arithmetic) | {"plays": rival}
                    rows.append(row)
                    print(
                        f"{row['chip']:11} {gears:5} {arithmetic:10} {terms:6}  {row['wrong']:5}"
                        f"  {row['mean']:6,}"
                        f"  {row['worst']:6,}  {row['full_step']:9,}  {row['after_reset']:11,}"
                        f"  {rival or 0:7,}  {row['code_bytes']:6,}  {row['table_bytes']:6,}"
                        f"  {row['ram_bytes']:4,}  {row['stack_bytes']:5,}{ratios(row, before)}",
                        flush=True,
                    )
    if options.csv and rows:
        with options.csv.open("w", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)
    if any(row["wrong"] for row in rows):
        raise SystemExit("some self-tests fail")


if __name__ == "__main__":
    main()
