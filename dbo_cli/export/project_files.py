"""The files around the sources: build files, an example, the Arduino layout, the page and its figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field

from dbo_cli.export.cascade_plan import CascadePlan
from dbo_cli.export.source_text import ModelCode, Values, fill, unit_behind
from dbo_cli.hysteresis.model import Quantity


@dataclass(frozen=True)
class ExportSummary:
    """Figures of one export; the README beside the sources shows the same.

    Attributes
    ----------
    folder, name, direction, arithmetic : str
        Where and what was exported.
    files : tuple of str
        Names in the folder.
    gears, table_rows, run : int
        Gears, rows of the gear table, and how many equal gears a row stands for.
    table_bytes, state_bytes : int
        Constant tables (flash), and the state (RAM) on a 32-bit target.
    worst_blocks, worst_gears : int
        A bound on the work of one step: the most blocks of 64 gears it looks at, and the most gears it
        crosses one by one.
    bounds : mapping
        Derived bounds on the error against the float64 model, in the output's unit and in % of its range;
        empty for double, which gives the same bits.
    gears_loss : mapping
        Where gears were taken away: the largest and the RMS difference this makes on test moves.
    vectors : int
        Samples in the self-test.
    notes, warnings : tuple of str
        What the caller must know or do, and what may spoil the result.
    """

    folder: str
    name: str
    direction: str
    arithmetic: str
    files: tuple[str, ...]
    gears: int
    table_rows: int
    run: int
    table_bytes: int
    state_bytes: int
    worst_blocks: int
    worst_gears: int
    vectors: int
    bounds: Mapping[str, float] = field(default_factory=dict)
    gears_loss: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def project_files(
    plan: CascadePlan, code: ModelCode, summary: ExportSummary, words: Values,
    sources: Mapping[str, str], test: str, arduino: bool,
) -> dict[str, str]:  # fmt: skip
    """Return every file by its path in the folder: the sources, and what stands around them."""
    name = summary.name
    values = {
        **build_values(words, code.number, sources, [f"{name}_test.c"]), "SAMPLE": code.vectors[0].inputs[10],
        "INPUT_TEXT": _capitalised(plan.model.input), "OUTPUT_TEXT": _capitalised(plan.model.output),
    }  # fmt: skip
    page = fill("README.md", {**values, **shown_figures(plan, summary)})
    if arduino:
        return {
            **{f"src/{file}": text for file, text in sources.items()},
            f"extras/{name}_test.c": test,
            f"examples/{name}/{name}.ino": fill("NAME.ino", values),
            "library.properties": fill("library.properties", values),
            "README.md": page,
        }
    example = fill("example_main.c", values)
    written = {f"{name}_test.c": test, "example_main.c": example, "README.md": page}
    return {**sources, **written, **build_files(values)}


def build_values(
    words: Values, number: str, sources: Mapping[str, str], tests: Sequence[str]
) -> dict[str, str | bool]:
    """Return what build files and pages know of an export's sources and of the files of its self-test."""
    small = number == "double"
    compiled = " ".join(file for file in _ordered(sources) if file.endswith(".c"))
    return {
        **words, "NUMBER": number, "small": small, "counts": number == "int32_t",
        "DEFINES": "-DDBO_SMALL" if small else "", "SOURCE_FILES": compiled,
        "COMPILED_FILES": f"-DDBO_SMALL {compiled}" if small else compiled,
        "HEADER_FILES": " ".join(file for file in _ordered(sources) if file.endswith(".h")),
        "TEST_FILES": " ".join(tests), "TEST_FILTERS": ", ".join(f'"-<{file}>"' for file in tests),
    }  # fmt: skip


def build_files(values: Values) -> dict[str, str]:
    """Return what builds the sources: for make, CMake, PlatformIO and Zephyr."""
    name = values["NAME"]
    target = {**values, "TARGET_NAME": name, "CONFIG_FILE": f"{name}Config.cmake"}
    del target["NAME"]  # a word of CMake's own
    return {
        "Makefile": fill("Makefile", values),
        "CMakeLists.txt": fill("CMakeLists.txt", target),
        "library.json": fill("library.json", values),
        "zephyr/module.yml": fill("zephyr_module.yml", target),
        "zephyr/CMakeLists.txt": fill("zephyr_CMakeLists.txt", target),
    }


def _ordered(sources: Mapping[str, str]) -> list[str]:
    """Return the sources' names, those of the model before those of the kernel."""
    return sorted(sources, key=lambda file: (file.startswith("dbo_"), file))


def _capitalised(quantity: Quantity) -> str:
    unit = f" ({quantity.unit})" if quantity.unit else ""
    return f"{quantity.quantity[:1].upper()}{quantity.quantity[1:]}{unit}"


def shown_figures(plan: CascadePlan, summary: ExportSummary) -> Values:
    """Return what README.md shows of an export's figures."""
    drive, result = plan.drive, plan.model.output
    figures = {key.upper(): str(value) for key, value in asdict(summary).items()}
    for key in ("same_gears", "after_close_turn"):
        most, percent = summary.bounds.get(key, 0.0), summary.bounds.get(f"{key}_percent", 0.0)
        figures[key.upper()] = f"{most:.3g}{unit_behind(result)} ({percent:.3g} %"
    figures["CLOSE_TURN"] = f"{summary.bounds.get('close_turn_fraction', 0.0):.2g}"
    figures["LOWEST_DRIVE"] = f"{drive.minimum!r}{unit_behind(drive)}"
    for way, quantity in (("INPUT", plan.model.input), ("OUTPUT", result)):
        ends = f"{quantity.minimum:.9g} to {quantity.maximum:.9g}{unit_behind(quantity)}"
        figures |= {f"{way}_NAME": quantity.quantity, f"{way}_RANGE": ends}
    return {
        **figures, "moving": plan.model.dynamics is not None,
        "duties": "".join(f"- {note}\n" for note in (*summary.notes, *summary.warnings)),
    }  # fmt: skip
