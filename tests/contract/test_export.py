"""``dbo export``: C99 that compiles without a warning and gives the library's numbers."""

import json
import os
import re
from pathlib import Path
from types import SimpleNamespace

import pytest

import dbo_cli
from tests.export.firmware import NO_COMPILER, Firmware

from .program import dbo, done, load, model, refused, values_of

pytestmark = [
    pytest.mark.skipif(NO_COMPILER, reason="needs a C compiler"),
    pytest.mark.filterwarnings("ignore::dbo_cli.errors.DboWarning"),
]
RATE = 1000.0
WORDS = ("--sample-rate", RATE, "-q", "-o", "firmware")


def built():
    """Compile what lies in ``firmware``, outside it."""
    files = {path.name: path.read_text() for path in Path("firmware").iterdir()}
    figures = json.loads(files.pop("export.json"))
    export = SimpleNamespace(files=files, figures=figures)
    return Firmware(export, Path("built").resolve())


@pytest.mark.parametrize("name", ["late", "moving"])
def test_the_input_comes_so_many_samples_earlier_as_live(name):
    done("export", model(name), *WORDS)
    header = Path("firmware/actuator.h").read_text()
    ahead = int(re.search(r"#define ACTUATOR_AHEAD (\d+)", header)[1])
    options = {"sample_rate": RATE, "lookahead": "auto"}
    live = dbo_cli.read_model(model(name)).controller(**options)
    assert ahead == load("firmware/export.json")["ahead"] == live.lookahead > 0


@pytest.mark.parametrize("arithmetic", ["double", "q31"])
def test_the_self_test_passes_and_fails_where_a_table_differs(arithmetic):
    words = ("--arithmetic", arithmetic, *WORDS[:-3], *WORDS[-2:])
    outcome = done("export", model("creep"), *words)
    said = Path("firmware/README.md").read_text() + outcome.err
    assert arithmetic == "double" or re.search(r"\d(\.\d+)? ?%", said)  # its bound
    assert built().self_test()[0] == 0
    tables = Path("firmware/actuator.c")
    text = tables.read_text()
    first = re.search(r"gears\[.*?\{\s*\{(?:0x1\.|\d)(.)", text, re.DOTALL)
    assert first is not None, "no table of numbers"
    other = "2" if first[1] == "1" else "1"
    tables.write_text(text[: first.start(1)] + other + text[first.end(1) :])
    assert built().self_test()[0] == 1


def test_a_reset_beyond_the_limits_holds_them():
    done("export", model("small"), "--v-min", 1, "--v-max", 8, *WORDS)
    library = built()
    held = [library.play([1e300], reset=drive)[0] for drive in (9.5, 5.0, 0.5)]
    assert held == [8.0, 5.0, 1.0]


def test_fewer_gears_and_a_lookup_table():
    words = ("--sample-rate", RATE, "-q", "-o")
    done("export", model("creep"), "--gears", 10, *words, "firmware")
    figures = load("firmware/export.json")
    assert figures["gears"] == 10 and 0.0 < figures["loss"]["rms"] < 0.2
    done("export", model("small"), "--lookup", *words, "table")
    assert "corners[16]" in Path("table/actuator.c").read_text()


def test_the_same_model_gives_the_same_bytes_without_path_and_date():
    """Candidates are left out: a model with them is exported as the one without."""
    for folder in ("one", "two"):
        done("export", model("creep"), "--sample-rate", RATE, "-q", "-o", folder)
    first, second = (
        {path.name: path.read_text() for path in Path(folder).iterdir()}
        for folder in ("one", "two")
    )
    assert first == second and len(first) >= 5
    for text in first.values():
        assert str(Path.cwd()) not in text
        assert not re.search(r"20\d\d-\d\d-\d\d", text)
    done("export", model("known"), *WORDS)
    sources = [Path(folder).glob("*.c") for folder in ("one", "firmware")]
    sizes = [sum(path.stat().st_size for path in paths) for paths in sources]
    assert abs(sizes[0] - sizes[1]) < 100
    assert "candidates" not in done("invert", model("known")).json
    assert values_of("known")["candidates"]


def test_a_name_that_c_takes_and_a_rate_are_needed():
    for name in ("dbo_x", "9lives", "a-b", ""):
        assert "--name" in refused(2, "export", model("small"), "--name", name, *WORDS)
    outcome = dbo("export", model("creep"), "-o", "firmware")
    assert outcome.code in (1, 2) and "--sample-rate" in outcome.lines[-1]
    assert not Path("firmware").exists()


def test_an_export_replaces_one_of_another_arithmetic_and_name():
    done("export", model("creep"), "--arithmetic", "q31", "--name", "old", *WORDS)
    fixed = set(os.listdir("firmware"))
    for compiled in ("old.o", "old_test"):
        Path("firmware", compiled).write_text("")
    done("export", model("creep"), *WORDS)
    assert "old.c" in fixed and "old.c" not in os.listdir("firmware")
    done("export", model("creep"), "--arithmetic", "q31", "--name", "old", *WORDS)
    assert set(os.listdir("firmware")) == fixed
    Path("firmware/notes.txt").write_text("mine")
    assert "notes.txt" in refused(1, "export", model("creep"), *WORDS)


@pytest.mark.parametrize(
    ("name", "words", "key", "remedy"),
    [
        ("soft", "--arithmetic q31", "].relaxation.gain", "--arithmetic double"),
        ("creep", "--lookup --gears 12", "]", "--relaxation 0"),
        ("creep", "--lookup", "]", "--gears 12"),
    ],
)
def test_a_refusal_names_file_key_and_remedy(name, words, key, remedy):
    said = refused(1, "export", model(name), *words.split(), *WORDS)
    assert f"{name}.json: stages[" in said
    assert f"{key}: " in said and remedy in said
