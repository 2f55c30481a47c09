# ruff: noqa: E501  (a message of one line stands on one line here)
"""Patterns of columns, model sets, and runs over channels: what each channel would give alone."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from conftest import SMALL_MODEL, folder_content

from dbo_cli.errors import InputError, ModelError, UsageError
from dbo_cli.extras.channels.columns import ChannelReader
from dbo_cli.extras.channels.model_set import member_text, set_to_bytes
from dbo_cli.hysteresis import model_file
from dbo_cli.hysteresis.model_file import (
    Node,
    model_of,
    model_to_bytes,
    read_model,
    read_set,
)
from dbo_cli.logs.hdf5.store import matrix_writer
from dbo_cli.logs.request import ReadingOptions, parse_address
from dbo_cli.logs.sample_block import Column
from dbo_cli.logs.text.text_table import TextTable
from dbo_cli.runs.jobs import spread_line, summed_up

CHANNELS = ("a", "b", "c")
QUICK = ("--gears", 4, "--points", 0, "--relaxation", 0, "--delay", 0, "--dynamics", 0)
ROWS = 400


def model_of_gain(gain: float) -> dict[str, Any]:
    """Return the small model with another gain."""
    model = json.loads(json.dumps(SMALL_MODEL))
    model["stages"][1]["gain"] = gain
    model["output"]["max"] = 1.0 + 5.0 * gain
    return dict(model)


def drive() -> np.ndarray:
    """Return three triangles over the whole range, and a smaller one."""
    up = np.linspace(0.0, 10.0, ROWS // 8)
    return np.concatenate([up, up[::-1]] * 3 + [0.6 * up, 0.6 * up[::-1]])


@pytest.fixture
def mirror(dbo: Any) -> Any:
    """Return ``dbo`` in a folder with a set of three models, a log of all in text and in matrices, and a move."""
    models = {
        c: model_of(Node("", "", model_of_gain(1.6 + 0.2 * k)))
        for k, c in enumerate(CHANNELS)
    }
    Path("set.json").write_bytes(set_to_bytes(models))
    time, volts = np.arange(ROWS) * 0.01, drive()
    rng = np.random.default_rng(1)
    moved = {
        c: model.simulate(volts, model.start(0.0, "empty")).y
        + 0.01 * rng.normal(size=ROWS)
        for c, model in models.items()
    }
    wanted = {c: 3.0 + np.sin(6.0 * time + k) for k, c in enumerate(CHANNELS)}
    columns = {"time_s": time}
    for c in CHANNELS:
        columns |= {
            f"V_{c} (V)": volts,
            f"D_{c} (um)": moved[c],
            f"R_{c} (um)": wanted[c],
        }
    write_table("log.csv", columns)
    with h5py.File("log.h5", "w") as file:
        file["time"] = time
        for name, unit, of in (
            ("volts", "V", dict.fromkeys(CHANNELS, volts)),
            ("moved", "um", moved),
            ("wanted", "um", wanted),
        ):
            file[name] = np.column_stack(list(of.values()))
            file[name].attrs["units"] = unit
    return dbo


def write_table(name: str, columns: dict[str, np.ndarray]) -> None:
    """Write columns as text that reads back exactly."""
    lines = [
        ",".join(columns),
        *(
            ",".join(map(repr, row))
            for row in zip(*(c.tolist() for c in columns.values()), strict=True)
        ),
    ]
    Path(name).write_text("\n".join(lines) + "\n")


def without_provenance(model: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in model.items() if key != "provenance"}


def columns_of(text: str) -> dict[str, list[str]]:
    """Return the cells of a table by header."""
    header, *rows = [line.split(",") for line in text.splitlines()]
    return {name: [row[k] for row in rows] for k, name in enumerate(header)}


# --- identify ---


def test_channels_whose_sign_differs_are_named(mirror: Any, whole_dbo: Any) -> None:
    time, volts, *others = np.loadtxt("log.csv", delimiter=",", skiprows=1).T
    first, _, _, second, _, _, third, _ = others
    names = dict(zip(CHANNELS, (first, -second, third), strict=True))
    columns = {"time_s": time}
    for channel, moved in names.items():
        columns |= {f"V_{channel} (V)": volts, f"D_{channel} (um)": moved}
    write_table("turned.csv", columns)
    words = (
        "identify",
        "turned.csv",
        *QUICK,
        "--voltage",
        "V_{}",
        "--displacement",
        "D_{}",
        "-o",
        "m.json",
    )
    said = whole_dbo(*words, "--summary", "s.json")
    odd = CHANNELS[1]
    assert said.code == 0
    line = f"displacement rises as voltage rises, but falls in channel {odd}"
    assert said.err.splitlines()[0].endswith(
        f"; 3 channels: voltage 'V_{{}}', displacement 'D_{{}}'; {line}"
    )
    assert (
        f"warning: {line}: are leads exchanged, or does a sensor face away?\n"
        in said.err
    )
    signs = [
        (one["channel"], one["sign"]) for one in json.loads(Path("s.json").read_text())
    ]
    assert signs == [(CHANNELS[0], "rising"), (odd, "falling"), (CHANNELS[2], "rising")]
    Path("m.json").unlink()
    said = whole_dbo(*words, "--sign", "rising")
    assert said.code == 3 and not Path("m.json").exists()
    assert (
        f"dbo: error: channel {odd}: turned.csv: displacement falls as voltage rises"
        in said.err
    )


def test_identify_makes_the_models_that_the_columns_alone_give(mirror: Any) -> None:
    said = mirror(
        "identify",
        "log.csv",
        *QUICK,
        "--voltage",
        "V_{}",
        "--displacement",
        "D_{channel}",
        "-o",
        "made.json",
    )
    assert said.code == 0, said.err
    made = json.loads(Path("made.json").read_text())
    assert (made["format"], made["version"], list(made["models"])) == (
        "dbo-model-set",
        1,
        list(CHANNELS),
    )
    for channel in CHANNELS:
        mirror(
            "identify",
            "log.csv",
            *QUICK,
            "--voltage",
            f"V_{channel}",
            "--displacement",
            f"D_{channel}",
            "-o",
            "one.json",
        )
        assert made["models"][channel] == json.loads(Path("one.json").read_text())
    assert (
        "fit, RMSE of the model's range: 3 of 3 channels below 1 %; worst: a, "
        in said.err
    )


def test_each_channel_has_its_own_uncertainty(mirror: Any) -> None:
    lines = Path("log.csv").read_text().splitlines()
    deviations = 0.01 + 0.02 * (np.arange(ROWS) % 7)
    wide = [lines[0] + "".join(f",S_{c} (um)" for c in CHANNELS)]
    for line, deviation in zip(lines[1:], deviations.tolist(), strict=True):
        wide.append(line + f",{deviation!r}" * len(CHANNELS))
    Path("wide.csv").write_text("\n".join(wide) + "\n")
    words = ("identify", "wide.csv", *QUICK)
    patterns = ("--voltage", "V_{}", "--displacement", "D_{}", "--uncertainty", "S_{}")
    assert mirror(*words, *patterns, "-o", "all.json").code == 0
    first = CHANNELS[0]
    columns = (
        "--voltage",
        f"V_{first}",
        "--displacement",
        f"D_{first}",
        "--uncertainty",
        f"S_{first}",
    )
    assert mirror(*words, *columns, "-o", "one.json").code == 0
    one, of_set = (
        json.loads(Path(name).read_text()) for name in ("one.json", "all.json")
    )
    assert of_set["models"][first]["fit"] == one["fit"]
    done = mirror(*words, *patterns, "--shared-shape", "-o", "shared.json")
    assert (done.code, done.err) == (
        2,
        "dbo: error: --shared-shape and --uncertainty exclude each other: the shape is of the mean channel\n",
    )


def test_the_bytes_do_not_depend_on_the_number_of_processes(mirror: Any) -> None:
    words = (
        "identify",
        "log.csv",
        *QUICK,
        "--voltage",
        "V_{}",
        "--displacement",
        "D_{}",
        "-q",
        "-o",
    )
    assert (
        mirror(*words, "one.json").code == mirror(*words, "two.json", "-j", 2).code == 0
    )
    assert Path("one.json").read_bytes() == Path("two.json").read_bytes()


def test_a_file_for_each_channel(mirror: Any) -> None:
    words = (
        "identify",
        "log.csv",
        *QUICK,
        "--voltage",
        "V_{}",
        "--displacement",
        "D_{}",
        "-q",
        "-o",
    )
    assert mirror(*words, "models/{channel}.json").code == 0
    assert folder_content(Path("models")) == {"a.json", "b.json", "c.json"}
    mirror(*words, "set2.json")
    assert (
        model_to_bytes(read_model("set2.json::b")) == Path("models/b.json").read_bytes()
    )


def test_matrices_give_the_models_that_columns_give(mirror: Any) -> None:
    words = (
        "--voltage",
        "volts[{}]",
        "--displacement",
        "moved[{}]",
        "-q",
        "-o",
        "matrix.json",
    )
    assert mirror("identify", "log.h5", *QUICK, *words).code == 0
    mirror(
        "identify",
        "log.csv",
        *QUICK,
        "--voltage",
        "V_{}",
        "--displacement",
        "D_{}",
        "-q",
        "-o",
        "text.json",
    )
    matrix, text = (
        json.loads(Path(f"{name}.json").read_text())["models"]
        for name in ("matrix", "text")
    )
    for number, channel in enumerate(CHANNELS, 1):
        assert matrix[str(number)]["stages"] == text[channel]["stages"]


def test_twins_are_warned_of(mirror: Any) -> None:
    text = columns_of(Path("log.csv").read_text())
    text["D_c (um)"] = text["D_a (um)"]
    rows = zip(*text.values(), strict=True)
    Path("twins.csv").write_text(
        "\n".join([",".join(text), *(",".join(row) for row in rows)]) + "\n"
    )
    said = mirror(
        "identify",
        "twins.csv",
        *QUICK,
        "--voltage",
        "V_{}",
        "--displacement",
        "D_{}",
        "-o",
        "t.json",
    )
    assert said.code == 0
    assert (
        "dbo: warning: channels a, c hold the same displacements, sample by sample: is one channel's log another's?\n"
        in said.err
    )


# --- simulate, compensate, report ---


def test_compensate_writes_a_table_of_what_each_channel_gives(mirror: Any) -> None:
    assert (
        mirror(
            "compensate",
            "set.json",
            "log.csv",
            "--displacement",
            "R_{}",
            "-q",
            "-o",
            "drive.csv",
        ).code
        == 0
    )
    table = columns_of(Path("drive.csv").read_text())
    assert list(table) == [
        "time_s",
        *(
            f"{name}_{c}_{unit}"
            for c in CHANNELS
            for name, unit in (("desired", "um"), ("voltage", "V"))
        ),
    ]
    for channel in CHANNELS:
        mirror(
            "compensate",
            f"set.json::{channel}",
            "log.csv",
            "--displacement",
            f"R_{channel}",
            "-q",
            "-o",
            "one.csv",
        )
        one = columns_of(Path("one.csv").read_text())
        assert (one["time_s"], one["voltage_V"]) == (
            table["time_s"],
            table[f"voltage_{channel}_V"],
        )


def test_compensate_to_a_file_a_channel_gives_its_bytes(mirror: Any) -> None:
    words = (
        "compensate",
        "set.json",
        "log.csv",
        "--displacement",
        "R_{}",
        "-q",
        "--save-state",
        "{channel}.state.json",
        "--summary",
        "{channel}.summary.json",
        "-o",
        "out/{channel}.csv",
    )
    assert mirror(*words).code == 0
    first = {
        path.name: path.read_bytes()
        for path in [*Path("out").iterdir(), *Path().glob("*.state.json")]
    }
    assert mirror(*words, "-j", 2).code == 0
    for channel in CHANNELS:
        mirror(
            "compensate",
            f"set.json::{channel}",
            "log.csv",
            "--displacement",
            f"R_{channel}",
            "-q",
            "--save-state",
            "s.json",
            "-o",
            "one.csv",
        )
        for file in (Path("one.csv"), Path(f"out/{channel}.csv")):
            assert file.read_bytes() == first[f"{channel}.csv"]
        assert Path("s.json").read_bytes() == first[f"{channel}.state.json"]


def test_what_is_asked_of_the_table_comes_out_of_simulate(mirror: Any) -> None:
    mirror(
        "compensate",
        "set.json",
        "log.csv",
        "--displacement",
        "R_{}",
        "-q",
        "-o",
        "drive.csv",
    )
    said = mirror(
        "simulate", "set.json", "drive.csv", "--input", "voltage_{}", "-o", "back.csv"
    )
    assert said.code == 0, said.err
    drive_table, back = (
        columns_of(Path(f"{name}.csv").read_text()) for name in ("drive", "back")
    )
    assert list(back)[:3] == ["time_s", "voltage_a_V", "displacement_a_um"]
    for channel in CHANNELS:
        asked, given = (
            np.array(one, float)
            for one in (
                drive_table[f"desired_{channel}_um"],
                back[f"displacement_{channel}_um"],
            )
        )
        # the first may be where no actuator settles
        assert np.abs(asked - given)[1:].max() < 1e-12


def test_matrices_come_out_of_matrices(mirror: Any) -> None:
    models = json.loads(Path("set.json").read_text())
    models["models"] = {str(k): models["models"][c] for k, c in enumerate(CHANNELS, 1)}
    Path("numbers.json").write_text(json.dumps(models))
    words = (
        "compensate",
        "numbers.json",
        "log.h5",
        "--displacement",
        "wanted[{}]",
        "-q",
        "-o",
        "drive.h5",
    )
    assert mirror(*words).code == mirror(*words, "-j", 2).code == 0
    mirror(
        "compensate",
        "set.json",
        "log.csv",
        "--displacement",
        "R_{}",
        "-q",
        "-o",
        "drive.csv",
    )
    table = columns_of(Path("drive.csv").read_text())
    with h5py.File("drive.h5") as file:
        assert set(file) == {"time_s", "desired", "voltage"}
        assert dict(file["voltage"].attrs)["units"] == "V"
        for number, channel in enumerate(CHANNELS):
            assert file["voltage"][:, number].tolist() == [
                float(x) for x in table[f"voltage_{channel}_V"]
            ]
    assert (
        mirror(
            "simulate",
            "numbers.json",
            "drive.h5",
            "--input",
            "voltage[{}]",
            "-q",
            "-o",
            "back.h5",
        ).code
        == 0
    )
    with h5py.File("back.h5") as file:
        assert set(file) == {"time_s", "voltage", "displacement"}


def test_a_summary_of_channels_is_a_list(mirror: Any) -> None:
    assert (
        mirror(
            "compensate",
            "set.json",
            "log.csv",
            "--displacement",
            "R_{}",
            "-q",
            "-o",
            "d.csv",
            "--summary",
            "s.json",
        ).code
        == 0
    )
    found = json.loads(Path("s.json").read_text())
    assert [(one["channel"], one["format"], one["rows"]) for one in found] == [
        (c, "dbo-summary", ROWS) for c in CHANNELS
    ]


def test_report_has_a_line_a_channel(mirror: Any) -> None:
    words = (
        "report",
        "log.csv",
        "--model",
        "set.json",
        "--voltage",
        "V_{}",
        "--measured",
        "D_{}",
        "--format",
        "json",
    )
    said, twice = mirror(*words), mirror(*words, "-j", 2)
    assert said.out == twice.out
    logs = json.loads(said.out)["logs"]
    assert [log["name"] for log in logs] == list(CHANNELS)
    one = json.loads(
        mirror(
            "report",
            "log.csv",
            "--model",
            "set.json::c",
            "--voltage",
            "V_c",
            "--measured",
            "D_c",
            "--format",
            "json",
        ).out
    )
    assert {**logs[2], "name": "", "ratio_to_first": 1.0} == {
        **one["logs"][0],
        "name": "",
    }
    assert "channels below" in said.err
    assert mirror(*words, "--max-rmse", "1e-9").code == 3


def test_report_draws_all_channels_together(mirror: Any) -> None:
    words = (
        "report",
        "log.csv",
        "--desired",
        "R_{}",
        "--measured",
        "D_{}",
        "--figures",
    )
    said = mirror(*words, "pictures", "-o", "page.html")
    assert said.code == 0, said.err
    assert sorted(folder_content(Path("pictures"))) == [
        f"channels-{key}.{kind}"
        for key in ("histogram-percent", "histogram-rmse", "map")
        for kind in ("png", "svg")
    ]
    page = Path("page.html").read_text(encoding="utf-8")
    assert page.count("<figure>") == 3 and page.count("<section>") == 0
    assert page.index("<figure>") < page.index("<table>")
    assert all(f'<span class="name">{c}</span>' in page for c in CHANNELS)
    worst = max(
        json.loads(mirror(*words[:-1], "--format", "json").out)["logs"],
        key=lambda log: log["nrmse_percent"],
    )["name"]
    assert (
        f"for those of one name its columns: --desired 'R_{worst}', --measured 'D_{worst}'\n"
        in said.err
    )


def test_figures_of_channels_are_refused_before_anything_is_written(
    mirror: Any,
) -> None:
    words = ("report", "log.csv", "--measured", "D_{}", "-o", "page.html", "--figures")
    before = folder_content(Path())
    said = mirror(*words, "map.png", "--desired", "R_{}")
    assert (
        said.code == 2
        and "map.png: there are several figures: name a folder" in said.err
    )
    said = mirror(*words, "pictures", "--desired", "R_{}", "--trajectory", "log.csv")
    assert (
        said.code == 2
        and "holds one desired signal: a pattern takes --desired from the log itself"
        in said.err
    )
    said = mirror(*words, "pictures", "--desired", "R_{}", "--lag", ROWS)
    assert said.code == 1 and folder_content(Path()) == before


def test_show_lists_the_models_of_a_set(mirror: Any) -> None:
    said = mirror("show", "set.json")
    assert said.out.splitlines()[0] == "3 models (FILE::CHANNEL names one)"
    rows = [line.split() for line in said.out.splitlines()[2:]]
    assert [row[0] for row in rows] == ["channel", *CHANNELS]
    assert [row[rows[0].index("sign") + 6] for row in rows[1:]] == ["rising"] * 3
    assert (
        json.loads(mirror("show", "set.json", "--format", "json").out)["models"]["b"][
            "output"
        ]["max"]
        == 10.0
    )
    assert mirror("show", "set.json::b").out.startswith(
        "forward model: voltage 0 to 10 V to displacement 1 to 10 um\ndisplacement rises as voltage rises\n"
    )


# --- failing channels ---


def spoil(channel: str, row: int, cell: str, name: str = "bad.csv") -> None:
    """Put a text into a cell of a channel's displacement and desired columns."""
    table = columns_of(Path("log.csv").read_text())
    for column in (f"D_{channel} (um)", f"R_{channel} (um)"):
        table[column][row - 1] = cell
    rows = zip(*table.values(), strict=True)
    Path(name).write_text(
        "\n".join([",".join(table), *(",".join(row) for row in rows)]) + "\n"
    )


def test_one_bad_channel_ends_the_run_and_nothing_is_written(mirror: Any) -> None:
    spoil("b", 7, "nan")
    before = folder_content(Path())
    said = mirror(
        "compensate", "set.json", "bad.csv", "--displacement", "R_{}", "-o", "out.csv"
    )
    assert (said.code, said.err) == (
        1,
        "dbo: error: channel b: bad.csv:8: column 'R_b (um)' is not finite: 'nan' (--skip-bad drops such rows) (--keep-going writes the other channels)\n",
    )
    assert folder_content(Path()) == before


def test_keep_going_writes_the_others_and_names_the_one(mirror: Any) -> None:
    spoil("b", 7, "nan")
    said = mirror(
        "identify",
        "bad.csv",
        *QUICK,
        "--voltage",
        "V_{}",
        "--displacement",
        "D_{}",
        "--keep-going",
        "-o",
        "made.json",
    )
    assert said.code == 1
    assert (
        "dbo: warning: channel b: bad.csv:8: column 'D_b (um)' is not finite: 'nan' (--skip-bad drops such rows)\n"
        in said.err
    )
    assert said.err.endswith(
        "dbo: error: 1 of 3 channels failed (b): the others are written\n"
    )
    assert list(read_set("made.json")) == ["a", "c"]
    assert (
        mirror(
            "compensate",
            "set.json",
            "bad.csv",
            "--displacement",
            "R_{}",
            "--keep-going",
            "-q",
            "-o",
            "out.csv",
        ).code
        == 1
    )
    assert list(columns_of(Path("out.csv").read_text()))[1::2] == [
        "desired_a_um",
        "desired_c_um",
    ]


def test_a_bad_row_of_one_channel_is_dropped_from_that_one_alone(mirror: Any) -> None:
    spoil("b", 7, "nan")
    words = (
        "compensate",
        "set.json",
        "bad.csv",
        "--displacement",
        "R_{}",
        "--skip-bad",
        "-q",
        "-o",
    )
    assert mirror(*words, "{channel}.csv").code == 0
    assert [len(Path(f"{c}.csv").read_text().splitlines()) for c in CHANNELS] == [
        ROWS + 1,
        ROWS,
        ROWS + 1,
    ]
    said = mirror(*words, "all.csv")
    assert (said.code, said.err) == (
        1,
        "dbo: error: channel b: its 399 rows are not at the times of the first channel's 400: write a file a channel (-o 'out/{channel}.csv')\n",
    )


def test_a_dead_channel_is_named(mirror: Any) -> None:
    table = columns_of(Path("log.csv").read_text())
    table["D_c (um)"] = ["1.5"] * ROWS
    rows = zip(*table.values(), strict=True)
    Path("dead.csv").write_text(
        "\n".join([",".join(table), *(",".join(row) for row in rows)]) + "\n"
    )
    said = mirror(
        "identify",
        "dead.csv",
        *QUICK,
        "--voltage",
        "V_{}",
        "--displacement",
        "D_{}",
        "-o",
        "m.json",
    )
    assert said.code == 1
    assert said.err.startswith("dbo: error: channel c: dead.csv: ")


def test_text_is_read_once_for_all_channels(
    mirror: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = []
    whole = TextTable.__init__
    monkeypatch.setattr(
        TextTable,
        "__init__",
        lambda self, *words, **more: (opened.append(1), whole(self, *words, **more))[1],
    )
    assert (
        mirror(
            "compensate",
            "set.json",
            "log.csv",
            "--displacement",
            "R_{}",
            "-q",
            "-o",
            "out.csv",
        ).code
        == 0
    )
    assert len(opened) == 1


def test_halves_are_read_again_where_a_row_is_bad(mirror: Any) -> None:
    spoil("b", 7, "nan")
    reader = ChannelReader(
        parse_address("bad.csv"), ReadingOptions(), {"displacement": "R_{}"}
    )
    held = {channel: reader.log(channel).table is not None for channel in CHANNELS}
    reader.close()
    assert held == {"a": True, "b": False, "c": True}


# --- what is refused ---


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (("--input", "X{}"), 1, "log.csv: `input` 'X{}' matches no column: it has 1 time_s, 2 V_a (V), 3 D_a (um), 4 R_a (um), 5 V_b (V), 6 D_b (um), 7 R_b (um), 8 V_c (V), 9 D_c (um), 10 R_c (um)"),
        (("--input", "V_{}{}"), 2, "`input` 'V_{}{}': put {} once where the channel's name stands, as in every pattern beside it"),
        (("--input", "V_{}", "--flush"), 2, "`flush` follows a log row by row, and channels are read whole (leave one out)"),
        (("--input", "V_{}", "--save-state", "s.json"), 2, "`save_state` s.json: each channel has its own (put {channel} into it)"),
        (("--input", "V_a"), 1, "set.json: is a set of models: name one of them (set.json::CHANNEL), or the columns of all with a pattern ('V{}')"),
        (("--input", "V_a", "-o", "{channel}.csv"), 2, "{channel}.csv: {channel} stands for a channel's name: name the columns by a pattern, 'V{}'"),
        (("--input", "V_{}", "-o", "log.csv"), 2, "log.csv: this output is also an input: write to another file"),
    ],
)  # fmt: skip
def test_bad_words_to_simulate(
    mirror: Any, words: tuple[str, ...], code: int, message: str
) -> None:
    said = mirror("simulate", "set.json", "log.csv", *words)
    import re

    shown = re.sub(
        r"`([a-z_]+)`", lambda found: "--" + found[1].replace("_", "-"), message
    )
    assert (said.code, said.err) == (code, f"dbo: error: {shown}\n")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--voltage", "V_{}"), "--displacement is not given where --voltage 'V_{}' is many: give a pattern for both"),
        (("--voltage", "V_{}", "--displacement", "D_a"), "--displacement is one column, 'D_a', where --voltage 'V_{}' is many: give a pattern for both"),
        (("--voltage", "V_{}", "--displacement", "D_{}", "-o", "m.csv"), "m.csv: a model is written as JSON, not as .csv: call it m.json"),
    ],
)  # fmt: skip
def test_bad_words_to_identify(
    mirror: Any, words: tuple[str, ...], message: str
) -> None:
    said = mirror("identify", "log.csv", *QUICK, *words)
    assert (said.code, said.err) == (2, f"dbo: error: {message}\n")


def info(*names: str) -> list[Column]:
    from dbo_cli.logs.columns import parse_column

    return [parse_column(name, number) for number, name in enumerate(names, 1)]


@pytest.mark.parametrize(
    ("names", "patterns", "message"),
    [
        (["V1", "V2", "D1"], {"voltage": "V{}", "displacement": "D{}"}, "run: no column 'D2' (`displacement`) for channel '2' (columns found: `voltage` 2, `displacement` 1)"),
        (["V1", "D1", "D2", "D3"], {"voltage": "V{}", "displacement": "D{}"}, "run: no column 'V2' (`voltage`) for channel '2' nor for 3 (2 channels) (columns found: `voltage` 1, `displacement` 3)"),
        (["V1_V", "V1_mV", "D1"], {"voltage": "V{}", "displacement": "D{}"}, "run: `voltage` 'V{}': column 'V1_V' and column 'V1_mV' are both channel '1' (rename one, or make the pattern longer)"),
    ],
)  # fmt: skip
def test_sides_that_do_not_belong_together(
    names: list[str], patterns: dict[str, str], message: str
) -> None:
    from dbo_cli.extras.channels.columns import channels_of

    with pytest.raises(InputError) as refused:
        channels_of("run", info(*names), patterns)
    assert str(refused.value) == message


def test_patterns_see_units_and_case() -> None:
    from dbo_cli.extras.channels.columns import channels_of

    for pattern in ("V{}", "v{}", "V{}_V", "V{channel}"):
        assert list(
            channels_of("run", info("time_s", "V1_V", "V2_V"), {"input": pattern}, {1})
        ) == ["1", "2"]
    assert list(
        channels_of("run", info("t", "HV_x (V)", "HV_y (V)"), {"input": "HV_{}"})
    ) == ["x", "y"]
    assert list(
        channels_of("run", info("v[1]", "v[2]", "v2[1]"), {"input": "v[{}]"})
    ) == ["1", "2"]
    with pytest.raises(UsageError):
        channels_of("run", info("V1"), {"input": "V"})


def test_a_channel_that_would_lead_to_another_folder_is_refused(dbo: Any) -> None:
    Path("set.json").write_bytes(
        set_to_bytes({"x": model_of(Node("", "", dict(SMALL_MODEL)))})
    )
    Path("one.json").write_text(json.dumps(SMALL_MODEL))
    Path("log.csv").write_text("time_s,V../../x,V2\n0,1,1\n1,2,2\n")
    said = dbo(
        "simulate", "one.json", "log.csv", "--input", "V{}", "-o", "out/{channel}.csv"
    )
    assert (said.code, said.err) == (
        1,
        "dbo: error: channel '../../x' cannot be part of a file's name ('out/{channel}.csv')\n",
    )


def test_a_set_that_lacks_a_channel(mirror: Any) -> None:
    models = json.loads(Path("set.json").read_text())
    del models["models"]["b"]
    Path("less.json").write_text(json.dumps(models))
    said = mirror("simulate", "less.json", "log.csv", "--input", "V_{}")
    assert (said.code, said.err) == (
        1,
        "dbo: error: less.json: there is no model of channel b (it has a, c)\n",
    )


def test_a_wrong_key_of_a_set_is_named(dbo: Any) -> None:
    good = {"format": "dbo-model-set", "version": 1, "models": {"x": SMALL_MODEL}}
    for change, message in (
        (
            {"version": 3},
            "set.json: version: 3 is newer than this program reads, 2; upgrade dbo-cli",
        ),
        ({"models": {}}, "set.json: models: holds no model"),
        ({"extra": 1}, "set.json: extra: is not a known key"),
        (
            {"models": {"x": SMALL_MODEL | {"direction": "up"}}},
            "set.json: models[\"x\"].direction: 'up' is neither 'forward' nor 'inverse'",
        ),
        (
            {"models": {"x": {"format": "dbo-state"}}},
            'set.json: models["x"].format: must be "dbo-model"',
        ),
    ):
        Path("set.json").write_text(json.dumps(good | change))
        assert dbo("show", "set.json::x") == (1, "", f"dbo: error: {message}\n")
    Path("set.json").write_text(json.dumps(good))
    assert (
        dbo("show", "set.json::y").err
        == "dbo: error: set.json: there is no model of channel 'y' (x)\n"
    )
    assert (
        dbo("report", "set.json").err
        == "dbo: error: set.json: this is a model-set, not a log (give a recording)\n"
    )


def test_messages_that_differ_in_numbers_alone_are_one() -> None:
    texts = {
        "1": ["clipped 3 rows", "odd"],
        "2": ["clipped 14 rows"],
        "3": ["clipped 1 rows", "loose"],
    }
    assert summed_up(texts, "channel") == [
        "all 3 channels: clipped 3 rows (channel 1's)",
        "channel 1: odd",
        "channel 3: loose",
    ]
    assert summed_up(
        {"x": ["off by 0.5"], "y": ["off by 0.5"], "z": []}, "channel"
    ) == ["channels x, y: off by 0.5"]
    assert summed_up({"x": ["as it is"]}, "channel") == ["as it is"]


def test_a_spread_names_a_round_bound_and_the_worst() -> None:
    percents = {str(k): 0.05 for k in range(118)} | {"47": 0.9, "200": 0.3}
    assert (
        spread_line(percents, "channel", "fit", {"47": "hum"})
        == "fit: 117 of 119 channels below 0.1 %; worst: 47, 0.9 %: hum"
    )


def test_a_matrix_that_is_wider_than_long_is_read_by_its_time_stamps(
    mirror: Any,
) -> None:
    models = json.loads(Path("set.json").read_text())
    models["models"] = {str(k): models["models"]["a"] for k in range(1, 6)}
    Path("five.json").write_text(json.dumps(models))
    wanted = 2.0 + np.arange(15.0).reshape(3, 5) / 10.0
    with h5py.File("frames.h5", "w") as file:
        file["time_s"], file["wanted"] = [0.0, 0.1, 0.2], wanted
    words = (
        "compensate",
        "five.json",
        "frames.h5",
        "--displacement",
        "wanted[{}]",
        "-q",
        "-o",
        "drive.h5",
    )
    assert mirror(*words).code == 0
    with h5py.File("drive.h5") as file:
        assert file["voltage"].shape == (3, 5)
        assert file["desired"][()].tolist() == wanted.tolist()
    assert (
        mirror(
            "simulate",
            "five.json",
            "drive.h5",
            "--input",
            "voltage[{}]",
            "-q",
            "-o",
            "b.h5",
        ).code
        == 0
    )
    with h5py.File("frames.h5", "r+") as file:
        del file["time_s"]
    said = mirror(*words)
    assert (said.code, said.err) == (
        1,
        "dbo: error: five.json: has 5 models, and the matrix 3 columns; the longer axis of a matrix is taken for time where no time stamps stand beside it\n",
    )


def test_some_thousand_channels_fit_into_an_output(tmp_path: Path) -> None:
    channels, path = [str(k) for k in range(1, 4101)], tmp_path / "out.h5"
    columns = [Column("displacement", "um")]
    with matrix_writer(
        parse_address(str(path)), columns, channels, None, 2, attributes={}, protect=()
    ) as write:
        write(4099, [np.ones(2)])
    with h5py.File(path) as file:
        assert file["displacement"][:, 4099].tolist() == [1.0, 1.0]
        assert file["displacement"].attrs["channel_of_column"].split("\n") == channels


def whole(path: str) -> dict[str, bytes]:
    """Return the bytes of every model of a set, read as a whole."""
    models = json.loads(Path(path).read_bytes())["models"]
    return {
        name: model_to_bytes(model_of(Node("", "", values)))
        for name, values in models.items()
    }


@pytest.mark.parametrize(
    "names",
    [
        [str(k) for k in range(1, 301)],
        ["a", 'b"c', "d\\e", "é 1", "é 2", "é 10", "format"],
        ["x"],
    ],
)
def test_one_model_of_a_set_is_read_without_the_others(
    names: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = str(tmp_path / "set.json")
    models = {
        name: model_of(Node("", "", model_of_gain(1.0 + 0.01 * k)))
        for k, name in enumerate(names)
    }
    Path(path).write_bytes(set_to_bytes(models))
    expected = whole(path)

    def refused(*_: object) -> None:
        raise AssertionError("the file is read as a whole")

    monkeypatch.setattr(model_file, "load_document", refused)
    for name in names:
        assert model_to_bytes(read_model(f"{path}::{name}")) == expected[name]
    assert member_text(path, "none") is None


@pytest.mark.parametrize(
    "change",
    [
        lambda text: json.dumps(json.loads(text), indent=4),
        lambda text: json.dumps(json.loads(text)),
        lambda text: text + "\n",
        lambda text: text.replace('\n    "2": {', '\n    "0": {'),  # no longer in order
    ],
)
def test_a_set_of_another_layout_is_read_as_a_whole(
    change: Any, tmp_path: Path
) -> None:
    path = str(tmp_path / "set.json")
    models = {
        str(k): model_of(Node("", "", model_of_gain(1.0 + 0.01 * k)))
        for k in range(1, 40)
    }
    Path(path).write_text(change(set_to_bytes(models).decode()))
    for name, expected in whole(path).items():
        assert model_to_bytes(read_model(f"{path}::{name}")) == expected


def test_a_set_that_was_cut_off_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "set.json"
    models = {str(k): model_of(Node("", "", model_of_gain(1.0))) for k in range(1, 40)}
    path.write_bytes(set_to_bytes(models)[:-200])
    with pytest.raises(ModelError, match="is not JSON"):
        read_model(f"{path}::3")
