"""What ``--help`` and the man pages say beside description and options: output, examples, exit codes."""

from __future__ import annotations

from typing import NamedTuple


class Page(NamedTuple):
    """What a command writes, examples (what for, and the command line), and what exit code 3 means."""

    writes: str
    examples: tuple[tuple[str, str], ...]
    missed: str = ""


EXIT_CODES = (
    ("0", "Done; also when the reader of a pipe leaves early."),
    ("1", "The input, the model or the fit failed; one line on standard error says what to do."),
    ("2", "The command line is wrong."),
    ("130", "Interrupted."),
)
_LIMIT = "3"

PAGES = {
    "identify": Page(
        "The model as JSON; with several logs and -o 'models/{file}.json' one model each.",
        (
            ("A log becomes a model:", "dbo identify recorded.csv -o model.json"),
            (
                "Two channels of an oscilloscope; the sensor gives 10 um a volt:",
                "dbo identify run.csv --voltage CH1 --displacement CH2 --scale displacement=10um/V -o m.json",
            ),
        ),
    ),
    "show": Page(
        "A page of text, or JSON; with --figures the model's curves as PNG and SVG.",
        (
            ("What is in a model, and what it is worth:", "dbo show model.json"),
            ("The expected error as a number:", "dbo show model.json --format json | jq .fit.expected_rmse"),
        ),
    ),
    "invert": Page(
        "The inverse model as JSON.",
        (
            ("The model that turns displacement into voltage:", "dbo invert model.json -o inverse.json"),
            (
                "Run it over a trajectory:",
                "dbo invert model.json | dbo simulate - trajectory.csv -o drive.csv",
            ),
        ),
    ),
    "simulate": Page(
        "Time (when known), the input column and the result, in the form that the name of the output says; "
        "several logs with -o 'out/{file}.csv'.",
        (
            ("What a drive would do:", "dbo simulate model.json drive.csv -o predicted.csv"),
            ("Of a stream that never ends:", "tail -f drive.log | dbo simulate model.json - --flush"),
        ),
    ),
    "compensate": Page(
        "Time (when known), the desired displacement and the drive; rows that this program puts before or "
        "after the move have times of their own, before it negative ones.",
        (
            (
                "A trajectory becomes a drive, with a ramp to its first row:",
                "dbo compensate model.json move.csv --max-slew 2000 --from 0 --approach auto -o drive.csv",
            ),
            (
                "One period of a loop becomes the settled loop's drive:",
                "dbo compensate model.json period.csv --periodic -o loop.csv",
            ),
        ),
        "A limit is met and --on-limit is error, or the drive cannot begin, close or return within its "
        "limits; no drive is written.",
    ),
    "check": Page(
        "What was found, as text or JSON.",
        (
            (
                "Another program's drive, before it is played:",
                "dbo check drive.csv --v-min 0 --v-max 100 --max-slew 2000 --from 0",
            ),
            ("Was it what was played?", "dbo check played.csv --against drive.csv --v-min 0 --v-max 100"),
        ),
        "A limit is broken, or with --against the two differ by more than --tolerance.",
    ),
    "report": Page(
        "The report as text, JSON, CSV or an HTML page, by the name of the output; with --figures pictures.",
        (
            (
                "Without and with compensation, side by side:",
                "dbo report uncompensated.csv compensated.csv --figures figures -o report.html",
            ),
            (
                "A check that a script can rely on:",
                "dbo report tracked.csv --trajectory drive.csv --max-nrmse-percent 1",
            ),
        ),
        "A limit (--max-rmse, --max-abs, --max-nrmse-percent) is missed; the report is written all the same.",
    ),
    "excite": Page(
        "Time and drive voltage.",
        (
            (
                "15 s of drive from 0 to 100 V:",
                "dbo excite --v-max 100 --sample-rate 5000 -o excitation.csv",
            ),
            (
                "For fast moves, with a sweep for the resonances:",
                "dbo excite --v-max 100 --sample-rate 20000 --sweep-to 1000 -o excitation.csv",
            ),
        ),
    ),
    "export": Page(
        "A folder with NAME.h, NAME.c, NAME_test.c, the kernel, build files and README.md; it appears "
        "whole or not at all.",
        (
            ("For a controller of 10 kHz:", "dbo export model.json -o firmware --sample-rate 10000"),
            (
                "In 32-bit floats, with a bound on the error:",
                "dbo export model.json -o firmware --arithmetic float --sample-rate 10000",
            ),
        ),
    ),
    "compare": Page(
        "A table as text, JSON, CSV or an HTML page, by the name of the output; with --figures pictures.",
        (
            (
                "Fitted to one log, judged on another:",
                "dbo compare recorded.csv --validate other.csv --figures figures",
            ),
            (
                "Two of them, the same bytes every time:",
                "dbo compare recorded.csv --models dbo,pi --no-timings -o table.csv",
            ),
        ),
    ),
    "trajectory": Page(
        "Time and displacement, or time, x and y: dbo compensate --displacement x_um takes one of them.",
        (
            (
                "A raster that a model can follow:",
                "dbo trajectory raster --rate 10000 --range 2:9 --lines 64 --frequency 5 --model m.json "
                "-o s.csv",
            ),
            (
                "Levels up and down:",
                "dbo trajectory staircase --rate 500 --range 1:9 --steps 9 --dwell 1 --model m.json -o s.csv",
            ),
        ),
    ),
    "waveform": Page(
        "The generator's file; one line on standard error says what to set there.",
        (
            (
                "For a generator before an amplifier of gain 20:",
                "dbo waveform drive.csv --to keysight-arb --gain 20 --v-min 0 --v-max 100 -o drive.arb",
            ),
            (
                "Codes of a 16-bit converter from 0 to 5 V:",
                "dbo waveform drive.csv --to uint16 --gain 20 --volts 0:5 -o drive.bin",
            ),
        ),
        "The drive breaks a limit, or the generator's rate or range would change it by more than allowed.",
    ),
}


def exit_codes(command: str) -> list[tuple[str, str]]:
    """Return the exit codes of a command and what they mean."""
    missed = PAGES[command].missed
    codes = [*EXIT_CODES, *([(_LIMIT, missed)] if missed else [])]
    return sorted(codes, key=lambda code: int(code[0]))
