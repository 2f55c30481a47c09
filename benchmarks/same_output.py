"""Two hundred command lines: what two versions of the program write and return, compared to the byte.

    python benchmarks/same_output.py --against CHECKOUT
    python benchmarks/same_output.py --record FILE

Every line runs in this process, in a folder with small models and logs: standard
output, standard error, exit code and the bytes of every file written are kept. CHECKOUT
is another version with its kernel built; what differs is printed, and the exit code is
1. FILE takes what this version does as JSON.
"""

# ruff: noqa: E501  (a command line stands on one line)
from __future__ import annotations

import hashlib
import json
import math
import os
import shlex
import subprocess
import sys
import tempfile
import warnings
from itertools import product
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent / "attack"))
from arena import MODEL, ROOT, fill, inside, run

# before the gears, and behind the scale
STAGES: dict[str, tuple[list[Any], list[Any]]] = {
    "ring": (
        [],
        [{"type": "dynamics", "sections": [{"frequency": 8.0, "damping": 0.1}]}],
    ),
    "lagged": ([{"type": "dynamics", "sections": [{"lag": 0.03}]}], []),
    "bent": (
        [{"type": "point", "x0": 0.0, "y0": 0.0, "dx": [4.0, 6.0], "dy": [3.0, 7.0]}],
        [],
    ),
}
WISHES = ("wish.csv", "rest.csv")
MODELS = ("model", "late", "ring", "lagged", "bent")
COMPENSATED = [
    "", "--v-min 1 --v-max 6", "--max-slew 20", "--max-slew 20 --on-limit error", "--condition",
    "--condition --max-slew 50", "--from 0 --approach auto", "--from 12 --approach 2 --max-slew 40 --lead auto",
    "--lead 0.5 --return auto", "--state empty --return 1.5", "--bandwidth 5 --settle 0.01",
    "--max-current 0.001 --capacitance 1e-5 --return auto --from 3", "--state full --rows 20:200 --verbose",
]  # fmt: skip
LOOPED = [
    "", "--passes 2", "--max-slew 30 --on-limit error", "--passes 1 --from 2 --approach auto", "--bandwidth 6",
    "--from 9 --approach 1", "--v-max 6 --passes 1 --state empty", "--state full",
]  # fmt: skip
OTHERS = """
compensate late.json wish.csv --save-state s.json -o a.csv && compensate late.json wish.csv --state s.json
compensate ring.json rest.csv --save-state s.json -o a.csv && compensate ring.json rest.csv --state s.json --approach 1 --from 1
compensate late.json wish.csv --summary s.json --flush
compensate late.json wish.csv -o d.h5 --block-rows 7 --summary s.json --return auto
compensate model.json wish.csv -o no/where.csv
compensate model.json nowhere.csv
compensate wish.csv model.json
compensate model.json wish.csv --state nowhere
compensate model.json wish.csv --v-min 5 --v-max 5
compensate model.json wish.csv --v-min nan
compensate model.json wish.csv --approach auto
compensate model.json wish.csv --approach -1
compensate model.json wish.csv --condition --state empty
compensate model.json wish.csv --periodic --condition
compensate model.json wish.csv --periodic --lead auto
compensate model.json wish.csv --passes 2
compensate model.json wish.csv --history h.json
compensate model.json wish.csv --max-current 1
compensate model.json bare.txt
compensate model.json bare.txt --max-slew 20
compensate late.json bare.txt
compensate model.json bare.txt --sample-rate 100 --max-slew 20 --from 1 --approach auto
compensate model.json wish.csv --on-limit maybe
compensate model.json wish.csv --from 1 --max-slew 10
compensate model.json wish.csv --displacement 7
compensate model.json wish.csv --resample 50 --bandwidth 5
compensate late.json wish.csv --time-unit ms
compensate ring.json wish.csv --rows 1:9
compensate model.json wish.csv --scale displacement=100
compensate model.json loop.csv --periodic --rows 1:150
compensate model.json loop.csv --periodic --rows 1:3
compensate late.json loop.csv --periodic --passes 1 --max-slew 8
compensate late.json wish.csv -o a.csv && simulate late.json a.csv --state empty -o b.csv && compensate late.json wish.csv --tracked b.csv --measured 3
compensate late.json wish.csv --tracked run.csv
compensate ring.json rest.csv --tracked tracked.csv --absolute --history h.json -o a.csv && compensate ring.json rest.csv --tracked tracked.csv --history h.json
compensate ring.json rest.csv --tracked tracked.csv --tracked tracked.csv --bandwidth 2 --lead auto
compensate ring.json loop.csv --tracked looped.csv --periodic --passes 1
compensate ring.json loop.csv --tracked rest.csv --periodic
invert late.json -o inverse.json && compensate inverse.json wish.csv
invert late.json -o inverse.json && simulate inverse.json wish.csv --rows 5:100
invert ring.json -o inverse.json && simulate inverse.json rest.csv --block-rows 50 --summary s.json
invert bent.json
invert nowhere.json
invert model.json -o a.csv
simulate model.json run.csv --outside error
simulate bent.json run.csv --outside hold --state full
simulate late.json run.csv --save-state s.json -o a.csv && simulate late.json run.csv --state s.json
simulate late.json run.csv --save-state s.json -o a.csv && simulate ring.json run.csv --state s.json
simulate ring.json run.csv -o o.h5 --summary s.json
simulate lagged.json run.csv --rows 10:40
simulate model.json bare.txt
simulate late.json bare.txt
simulate late.json bare.txt --sample-rate 100 --flush
simulate run.csv model.json
simulate model.json -
simulate - -
simulate model.json run.csv -o run.csv
simulate model.json odd.csv
simulate late.json odd.csv
simulate model.json run.csv --input displacement_um
simulate model.json run.csv --rows 9000:
check run.csv
check run.csv --v-min 1 --v-max 9 --max-slew 10 --from 3 --loop
check run.csv -o c.json --format json --max-slew 1e4
check run.csv -o c.csv
check odd.csv --v-max 100
check loop.csv --voltage displacement_um --loop
check bare.txt --voltage 1 --max-slew 5
check bare.txt --voltage 1 --sample-rate 100 --max-slew 5
check tracked.csv --against rest.csv
check run.csv --against run.csv --tolerance 0.1 --format json
check bad.csv --voltage voltage_V
check run.csv --against tracked.csv
report pair.csv
report pair.csv pair.csv --lag auto --segment 1 --format json
report pair.csv --lag 2 --remove-offset --rows 10:300 --format csv
report run.csv --model late.json --rows 50:200 --format json
report run.csv --model late.json --trajectory wish.csv
report pair.csv --max-rmse 0.001
report run.csv --trajectory wish.csv --match rows
report run.csv --trajectory wish.csv --match time --format json
report pair.csv -o r.html
report pair.csv -o r.json --format csv
report pair.csv --segment x
report pair.csv --lag x
report run.csv
report tracked.csv --desired displacement_um --measured displacement_um
identify run.csv --gears 8 --points 0 --relaxation 0 --delay 0 --dynamics 0 -o m.json
identify run.csv --gears 8 --points 0 --relaxation 0 --delay 0 --validate late.csv --rows 1:300 --slopes free
identify late.csv --gears 10 --relaxation 0.01,0.3 --points 2 --delay auto --zero mean --force -o m.json
identify identification.csv --rows 1:2500 --gears 10 --points 2 --relaxation 0 --delay 0 --skip 0.2
identify run.csv --v-min 0
identify bare.txt
identify wish.csv
identify run.csv -o m.csv
identify run.csv --method paper --gears 8
identify run.csv --rows 1:5
show model.json
show late.json --format json
show ring.json -o s.json
show nowhere.json
show run.csv
export ring.json -o out
export late.json -o out --sample-rate 100
export model.json -o out --arithmetic q31 --name a --v-max 8
export model.json -o out --gears 99
excite --v-max 10 --sample-rate 50 --duration 20
excite --v-max 10 --sample-rate 400 --sweep-to 100 --max-slew 100 -o e.csv
excite --v-max 0 --v-min 1
compare run.csv --no-timings --models line,dbo --validate late.csv
compare run.csv --models nothing
compare run.csv --no-timings --models line,pi --format json --save-models m
"""


def lines() -> list[str]:
    """Return the command lines; " && " stands between those that follow one another."""
    driven = (
        f"compensate {m}.json {w} {o}"
        for m, w, o in product(MODELS, WISHES, COMPENSATED)
    )
    looped = (
        f"compensate {m}.json loop.csv --periodic {o}"
        for m, o in product(MODELS, LOOPED)
    )
    return [*list(driven)[::2], *looped, *OTHERS.strip().splitlines()]


def prepare(folder: Path) -> None:
    """Write the models and logs."""
    fill(folder)
    for name, (before, behind) in STAGES.items():
        model: dict[str, Any] = json.loads(json.dumps(MODEL)) | {
            "version": 2,
            "fit": {"expected_rmse": 0.02},
        }
        model["stages"] = [*before, *model["stages"], *behind]
        (folder / f"{name}.json").write_text(json.dumps(model))
    (folder / "identification.csv").write_bytes(
        (ROOT / "sample_data" / "identification.csv").read_bytes()
    )
    wave = [4.0 - 2.5 * math.cos(2 * math.pi * n / 200) for n in range(200)]
    tables = {"loop": wave, "rest": [wave[0]] * 60 + wave * 2 + [wave[0]] * 60}
    for name, moved in tables.items():
        rows = [f"{n / 100:.2f},{x:.6f}" for n, x in enumerate(moved)]
        (folder / f"{name}.csv").write_text(
            "\n".join(["time_s,displacement_um", *rows, ""])
        )
    (folder / "odd.csv").write_text(
        "time_s,voltage_V\n0,1\n0.1,2\n0.1,3\n0.05,4\n0.9,300\n"
    )
    (folder / "bad.csv").write_text(
        "time_s,voltage_V\n0,1\n0.1,x\n0.2,3\n0.3,4\n0.4,2\n"
    )
    # recordings of drives: what these models make of them, a little off
    with inside(folder):
        for wish, drive in (("rest", "tracked"), ("loop --periodic", "looped")):
            name, *more = wish.split()
            run(["compensate", "ring.json", f"{name}.csv", *more, "-o", "drive.csv"])
            run(
                [
                    "simulate",
                    "bent.json",
                    "drive.csv",
                    "--state",
                    "empty",
                    "-o",
                    f"{drive}.csv",
                ]
            )
        run(
            [
                "simulate",
                "late.json",
                "run.csv",
                "--input",
                "voltage_V",
                "-o",
                "late.csv",
            ]
        )
        os.remove("drive.csv")


def record() -> dict[str, Any]:
    """Run every line; return what came of each: exit codes, both streams, and digests of the files."""
    warnings.simplefilter("ignore")
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as name, inside(Path(name)):
        prepare(Path(name))
        inputs = {str(path) for path in Path().rglob("*")}
        for line in lines():
            done = [run(shlex.split(part)) for part in line.split(" && ")]
            written = sorted(
                (path for path in Path().rglob("*") if str(path) not in inputs),
                reverse=True,
            )
            digests = {
                str(p): hashlib.sha256(p.read_bytes()).hexdigest()
                for p in written
                if p.is_file()
            }
            found[line] = [[one.code, one.out.decode(), one.err] for one in done] + [
                digests
            ]
            for path in written:
                path.rmdir() if path.is_dir() else path.unlink()
    return found


def main() -> int:
    """Record, or compare with another checkout."""
    if sys.argv[1:2] == ["--record"] and len(sys.argv) > 2:
        # the other checkout's package, before anything of it is imported
        if len(sys.argv) > 3:
            sys.path.insert(0, sys.argv[3])
        Path(sys.argv[2]).write_text(json.dumps(record(), indent=1))
        return 0
    if sys.argv[1:2] != ["--against"] or len(sys.argv) != 3:
        print(__doc__, file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory() as folder:
        kept = []
        for number, checkout in enumerate((sys.argv[2], str(ROOT))):
            file = Path(folder) / f"{number}.json"
            subprocess.run(
                [sys.executable, __file__, "--record", str(file), checkout], check=True
            )
            kept.append(json.loads(file.read_text()))
    before, after = kept
    unlike = [line for line in before if before[line] != after[line]]
    for line in unlike:
        print(
            f"dbo {line}\n  before: {str(before[line])[:2000]}\n  after:  {str(after[line])[:2000]}"
        )
    codes = [one[0] for results in after.values() for one in results[:-1]]
    print(f"{len(after)} lines ({sum(map(bool, codes))} refused), {len(unlike)} differ")
    return 1 if unlike else 0


if __name__ == "__main__":
    sys.exit(main())
