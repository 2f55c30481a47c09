# ruff: noqa: E501  (a message of one line stands on one line here)
"""A set in one folder of C: one kernel, the bits of each channel's own export, and what is refused."""

from __future__ import annotations

import ctypes
import json
import re
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from compiling import COMPILERS, WARNINGS, compile_c
from exported import TYPES, as_given, compiled, made_model, random_moves
from test_export import delayed

from dbo_cli.errors import DboError
from dbo_cli.extras.channels.model_set import set_to_bytes
from dbo_cli.extras.export.export import export_model, export_set
from dbo_cli.hysteresis.dynamics import DynamicsStage, Lag
from dbo_cli.hysteresis.model import ActuatorModel

RATE = 1000.0
FLAGS = [
    *WARNINGS,
    "-O1",
    "-fPIC",
]  # the same for the self-test and the library: the kernel is compiled once
GEARS = 64
CHANNELS = ("1", "tip z", "3")


def actuators(moving: bool) -> dict[str, ActuatorModel]:
    """Return models of which each needs something else: points, memory, a delay and (``moving``) a lag."""
    made = [
        made_model(k, gears=GEARS, slopes=16, terms=k, points=2 * k, bend=k < 2)
        for k in range(3)
    ]
    made[1] = delayed(made[1], 0.0015)
    if moving:
        lagging = (*made[2].stages, DynamicsStage((Lag(0.004),)))
        made[2] = ActuatorModel("forward", made[2].input, made[2].output, lagging)
    return dict(zip(CHANNELS, made, strict=True))


def loaded(folder: Path, name: str, arithmetic: str) -> Any:
    """Return a function of inputs (samples, channels) and first drives, if any, of the set's own calls."""
    number = {"double": "double", "q31": "int32_t"}[arithmetic]
    (folder / "all.c").write_text(
        f'#include "{name}.h"\n#include <stddef.h>\nvoid play({number} *in_out, size_t count, const {number} *drives);\n'
        f"void play({number} *in_out, size_t count, const {number} *drives) {{\n    {name}_state state;\n"
        f"    if (drives) {name}_reset(&state, drives); else {name}_init(&state);\n"
        f"    for (size_t k = 0; k < count; k++, in_out += {name.upper()}_CHANNELS)\n"
        f"        {name}_step(&state, in_out, in_out);\n}}\n"
    )
    sources = re.search(r"SOURCES = (.*)", (folder / "Makefile").read_text())
    assert sources is not None
    compile_c(folder, *FLAGS, "-shared", "all.c", *sources[1].split(), "-o", "all.so")
    library = ctypes.CDLL(str(folder / "all.so"))
    library.play.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p]

    def play(inputs: Any, drives: Any) -> Any:
        found = np.array(inputs, TYPES[arithmetic], order="C")
        first = None if drives is None else np.asarray(drives, TYPES[arithmetic])
        library.play(
            found.ctypes.data, len(found), None if first is None else first.ctypes.data
        )
        return found

    return play


@pytest.mark.skipif(not COMPILERS, reason="no C compiler")
@pytest.mark.parametrize("arithmetic", ["double", "q31"])
def test_a_set_has_one_kernel_and_the_bits_of_each_channel(
    arithmetic: Any, tmp_path: Path
) -> None:
    models = actuators(moving=arithmetic == "double")
    folder = tmp_path / "fw"
    made = export_set(
        models, str(folder), name="stage", arithmetic=arithmetic, sample_rate=RATE
    )
    assert len(list(folder.glob("dbo_kernel*.c"))) == 1
    assert {
        f"stage_{word}.{kind}" for word in ("1", "tip_z", "3") for kind in "ch"
    } <= {path.name for path in folder.iterdir()}
    tested = subprocess.run(
        ["make", "test", "example", f"CC={COMPILERS[0]}", f"CFLAGS={' '.join(FLAGS)}"],
        cwd=folder, capture_output=True, text=True, check=True,
    )  # fmt: skip
    vectors = sum(one.vectors for one in made.values())
    assert (
        f"\nstage: {vectors} samples of 3 channels, every bit as expected\n"
        in tested.stdout
    )
    assert len(subprocess.check_output(["./example"], cwd=folder).split()) == 600

    rng = np.random.default_rng(4)
    wanted = [one.output for one in models.values()]
    moves = [
        as_given(random_moves(rng, q.minimum, q.maximum, 2000), q, arithmetic)[0]
        for q in wanted
    ]
    play = loaded(folder, "stage", arithmetic)
    middles = [0.5 * (one.input.minimum + one.input.maximum) for one in models.values()]
    drives = middles if arithmetic == "double" else [0, 1000, -7]
    together = [play(np.column_stack(moves), first) for first in (None, drives)]
    for k, (model, move) in enumerate(zip(models.values(), moves, strict=True)):
        alone = tmp_path / str(k)
        export_model(
            model, str(alone), name="x", arithmetic=arithmetic, sample_rate=RATE
        )
        others = tuple(path.name for path in alone.glob("dbo_dynamics.c"))
        assert bool(others) == (arithmetic == "double" and k == 2)
        own = compiled(alone, "x", arithmetic, GEARS, ("-O1",), others)
        for found, first in zip(together, (None, drives[k]), strict=True):
            expected = own(move, first)[0]
            assert np.unique(expected).size > 1000
            assert found[:, k].tobytes() == expected.tobytes()


@pytest.mark.skipif(not COMPILERS, reason="no C compiler")
def test_the_self_test_of_a_set_names_the_channel_that_differs(tmp_path: Path) -> None:
    folder = tmp_path / "fw"
    export_set(
        actuators(False), str(folder), name="stage", arithmetic="q31", sample_rate=RATE
    )
    path = folder / "stage_tip_z_test.c"
    text = path.read_text()
    row = text.index("{\n", text.index("expected_0")) + 2
    path.write_text(text[:row] + "    1" + text[row:].lstrip())
    done = subprocess.run(
        ["make", "test", f"CC={COMPILERS[0]}"],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode != 0
    assert "stage_tip_z: after init, sample 1: " in done.stdout
    assert "stage: 1 of " in done.stdout


def contents(folder: str) -> dict[str, bytes]:
    files = (path for path in Path(folder).rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def test_the_command_writes_one_folder(dbo: Any) -> None:
    Path("set.json").write_bytes(set_to_bytes(actuators(False), None))
    words = ("export", "set.json", "--name", "tip", "--sample-rate", 1000)
    said = dbo(*words, "-o", "fw")
    assert said.code == 0, said.err
    first = contents("fw")
    listed = json.loads(first["export.json"])
    assert sorted(first) == sorted(listed["files"])
    assert list(listed["channels"]) == list(CHANNELS)
    page = first["README.md"].decode()
    assert "| tip z | `tip_tip_z_...` |" in page
    assert "Read 0.0015 s (1.5 samples) ahead" in page and "(channel tip z)\n" in page
    assert dbo(*words, "-o", "fw", "-q").code == 1  # the folder exists
    assert dbo(*words, "-o", "fw", "-q", "--overwrite").code == 0
    assert contents("fw") == first
    assert dbo(*words, "-o", "other", "--fmu") == (
        2, "", "dbo: error: --fmu is of one model: export a folder a channel (-o 'other/{channel}')\n"
    )  # fmt: skip
    assert dbo("export", "set.json", "-o", "other").err.startswith(
        "dbo: error: channel tip z: "
    )
    assert not Path("other").exists()


@pytest.mark.parametrize(
    ("channels", "message"),
    [
        (("a b", "a-b"), "channel 'a-b': x_a_b is what files of the set or of another channel are called: rename the channel"),
        (("a", "A"), "channel 'A': x_A is what"),
        (("y_test", "y"), "channel 'y': x_y is what"),
        (("names",), "channel 'names': x_names is what"),
        (("dbo_kernel",), "channel 'dbo_kernel': x_dbo_kernel is what"),
        (("n" * 40,), f"channel {'n' * 40}: `name` 'x_{'n' * 40}': has 42 characters; at most 40 are allowed"),
    ],
)  # fmt: skip
def test_channels_that_cannot_stand_side_by_side_are_refused(
    channels: tuple[str, ...], message: str, tmp_path: Path
) -> None:
    models = dict.fromkeys(channels, made_model(0, gears=8, slopes=8, terms=0))
    with pytest.raises(DboError, match=re.escape(message)):
        export_set(models, str(tmp_path / "fw"), name="x")
    assert list(tmp_path.iterdir()) == []
