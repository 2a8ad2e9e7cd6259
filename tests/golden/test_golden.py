"""The verbs' `result.json` on small recordings, compared with those of an earlier version of the code.

`PNEUTAC_GOLDEN=write pytest tests/golden/test_golden.py` writes what `results/` has not got yet; delete a
file there first where a change of its numbers is meant.

Left out: `measure` (it runs in real time and writes a recording), `ppo` (it writes an actor; the smallest
training takes minutes), `demo` and `benchmark` (minutes and more, and times are what they tell), `surrogate`
where it trains, `calibrate --by=images` (photographs with masks are large), and `render` of a gel (a minute,
for one press). `new` writes no result; its twin is compared.
"""

import json
import os
import re
import shutil
import sys
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

import pytest
import yaml

from lerobot_pneutac.cli import main

pytestmark = pytest.mark.slow

HERE = Path(__file__).parent
WRITE = os.environ.get("PNEUTAC_GOLDEN") == "write"

# Keys that differ from run to run, at any depth. A search's number of evaluations depends on the processor.
IGNORED = {"seconds", "time", "wall_s", "demonstrations_per_minute", "evaluations"}

# What was changed on purpose: golden -> {pattern of json paths: reason}, such as
# {"gel_add": {"*": "photographs to select by are others than those to test by"},
#  "finger_add": {"reduction*": "of test blocks alone"}}.
ALL_FITTED = "all twelve photographs are fitted and not six; each is judged by a fit that did not see it"
NO_SLIPS = "what the device does in the rows after a step is no slip of its marker"
CHANGED: dict[str, dict[str, str]] = {
    "finger_compare": {"checks": NO_SLIPS},
    "finger_compare_added": {"checks": NO_SLIPS},
    "finger_compare_mpm": {"checks": NO_SLIPS},
    "finger_add": {"checks": NO_SLIPS},
    "finger_diagnose": {"warnings": NO_SLIPS, "findings": NO_SLIPS},
    "gel_add": {
        "before.*": ALL_FITTED,
        "after.*": ALL_FITTED,
        "parameters.*.value": ALL_FITTED,
    },
    "gel_diagnose": {
        "stored": ALL_FITTED,
        "baseline.*": ALL_FITTED,
        "after.*": ALL_FITTED,
        "ladder.*.train": ALL_FITTED,
        "ladder.*.heldout*": ALL_FITTED,
        "ladder.0.change": "one wording for all devices",
        "effects.*.train": ALL_FITTED,
        "effects.*.heldout*": ALL_FITTED,
        "effects.*.reduction*": ALL_FITTED,
        "effects.*.parameters.*": ALL_FITTED,
        "trained_on": ALL_FITTED,
        "tested_on": ALL_FITTED,
        "next_experiment": "a missing effect is to be confirmed",
        "effects": "gel_creep is told to be untested where no hold_s is recorded",
    },
    "gel_twin_gel": {"arrays": "a twin names the file of its arrays, so that both change at once"},
}

# (pattern of "golden:json path", relative, absolute); the first that matches counts. With the wider vector
# instructions of NumPy, Numba, OpenBLAS and OpenCV switched off only a gel's numbers move by more than 2e-5.
TOLERANCES = [
    ("*reduction*", 1e-3, 1e-3),  # shares of one, many of them next to nothing
    ("gel_diagnose:*parameters*", 1e-2, 1e-4),  # of effects that are not there: 3e-3 were seen
    ("*coverage", 0.0, 1e-2),  # a share of rows: two of 700 fell on the other side on another machine
    ("finger_diagnose:*", 3e-2, 2e-3),  # a share of a sample, 0.6275 or 0.6405, from machine to machine
    ("arm_diagnose:base_model*", 1e-3, 2e-5),  # kPa and rad of next to nothing: 7e-6 from machine to machine
    ("finger_compare_mpm:*", 3e-3, 1e-4),  # material points come to rest within a tolerance
    ("render_finger:*", 3e-3, 1e-2),
    ("*", 1e-3, 1e-6),
]


@dataclass
class Case:
    """Command lines, run one after the other in an empty folder.

    Attributes:
        given: recordings and twins of this folder that are copied there.
        lines: of `pneutac`; each `--out=NAME` leaves `NAME/result.json`.
        twins: whose `twin.yaml` is compared at the end.
    """

    given: tuple[str, ...]
    lines: tuple[str, ...]
    twins: tuple[str, ...] = ()


FINGER = "--twin=finger --recording=finger_creep"
ARM = "--twin=arm --recording=arm_creep"
ARM_FITTED = (f"new {ARM}", f"calibrate {ARM} --out=arm_calibrate", f"compare {ARM} --out=arm_compare")
GEL = "--twin=gel --recording=gel_presses"
NAIVE = "--output.repo_id=local/naive --output.root=naive --method=naive --out=augment_naive"
PLANNED = "--output.repo_id=local/more --output.root=more --fidelity=probe --method=planner --out=augment"
AUGMENT = "augment --dataset.repo_id=local/demos --dataset.root=demos --workers=1 --seed=5 --episodes=2"
QUICK = "--planner.samples=4 --planner.elites=2 --planner.iterations=1 --planner.horizon=6"

CASES = {
    "new": Case(
        (),
        (
            "new --twin=finger",
            "new --twin=arm --device=arm --length_mm=180",
            "new --twin=gel --device=gel",
            "surrogate --twin=finger --out=surrogate",
        ),
        ("finger", "arm", "gel"),
    ),
    "finger": Case(
        ("recordings/finger_creep",),
        (
            f"new {FINGER}",
            f"calibrate {FINGER} --out=finger_calibrate",
            f"compare {FINGER} --out=finger_compare",
            f"diagnose {FINGER} --out=finger_diagnose --jobs=1",
            f"add {FINGER} --out=finger_add --effect=creep",
            f"compare {FINGER} --out=finger_compare_added",
        ),
        ("finger",),
    ),
    "arm_fitted": Case(("recordings/arm_creep",), ARM_FITTED),
    "arm": Case(
        ("recordings/arm_creep",),
        (
            *ARM_FITTED,
            f"diagnose {ARM} --out=arm_diagnose --jobs=1",
            f"add {ARM} --out=arm_add --effect=creep",
        ),
        ("arm",),
    ),
    "gel": Case(
        ("recordings/gel_presses",),
        (
            f"calibrate {GEL} --out=gel_calibrate --effects=none",
            f"diagnose {GEL} --out=gel_diagnose --jobs=1",
            f"add {GEL} --out=gel_add --effect=shadow",
            f"compare {GEL} --out=gel_compare",
        ),
        ("gel",),
    ),
    "alone": Case(
        ("twins/finger",),
        (
            "report --twin=finger --out=report",
            "control --twin=finger --out=control",
            "effects show creep --out=effects_creep",
            "effects show lag(p) --out=effects_lag",
        ),
    ),
    "compare_mpm": Case(
        ("recordings/finger_creep", "twins/finger"),
        (f"compare {FINGER} --out=finger_compare_mpm --fidelity=mpm --samples=4",),
    ),
    "render": Case(
        ("twins/finger",),
        (
            "render --twin=finger --out=render_finger --pressure_kpa=[0,10] --seconds=0.2 --particles=500 "
            "--device=cpu",
        ),
    ),
    "augment": Case(
        ("recordings/demos",),
        (f"{AUGMENT} {NAIVE}", f"{AUGMENT} {PLANNED} {QUICK}"),
    ),
}


LONG = ("augment", "compare_mpm", "finger", "gel", "render")  # half a minute each


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.nightly) if n in LONG else n for n in CASES]
)
def test_results_are_as_they_were(name, tmp_path, monkeypatch):
    case = CASES[name]
    for given in case.given:
        shutil.copytree(HERE / given, tmp_path / Path(given).name)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PNEUTAC_DATA", raising=False)
    for line in case.lines:
        monkeypatch.setattr(sys, "argv", ["pneutac", *line.split()])
        main()
    wrong = []
    for out in re.findall(r"--out=(\S+)", " ".join(case.lines)):
        wrong += changes(out, json.loads((tmp_path / out / "result.json").read_text()))
    for twin in case.twins:
        wrong += changes(f"{name}_twin_{twin}", yaml.safe_load((tmp_path / twin / "twin.yaml").read_text()))
    assert not wrong, "\n" + "\n".join(wrong)


def changes(golden: str, found: dict) -> list[str]:
    """How a result differs from the golden one of that name: json path, then and now."""
    file = HERE / "results" / f"{golden}.json"
    found = without_ignored(found)
    if WRITE and not file.exists():
        file.parent.mkdir(exist_ok=True)
        file.write_text(json.dumps(found, indent=1) + "\n")
    wrong = []
    for path, then, now in differences("", without_ignored(json.loads(file.read_text())), found, golden):
        if not any(fnmatch(path, pattern) for pattern in CHANGED.get(golden, {})):
            wrong.append(f"{golden}: {path}: was {then!r}, is {now!r}")
    return wrong


def without_ignored(x):
    """Also, what has names is compared by name and not by its place."""
    if isinstance(x, list) and x and all(isinstance(v, dict) and "name" in v for v in x):
        x = sorted(x, key=lambda v: str(v["name"]))
    if isinstance(x, dict):
        return {k: without_ignored(v) for k, v in x.items() if k not in IGNORED}
    return [without_ignored(v) for v in x] if isinstance(x, list) else x


def differences(path: str, then, now, golden: str):
    """Yields (path, then, now) of what differs; keys may be added, none may be lost."""
    if isinstance(then, dict) and isinstance(now, dict):
        for key, value in then.items():
            at = f"{path}.{key}" if path else str(key)
            if key not in now:
                yield at, value, "(missing)"
            else:
                yield from differences(at, value, now[key], golden)
    elif isinstance(then, list) and isinstance(now, list) and len(then) == len(now):
        for i, (a, b) in enumerate(zip(then, now, strict=True)):
            yield from differences(f"{path}.{i}", a, b, golden)
    elif not same(f"{golden}:{path}", then, now):
        yield path, then, now


def same(where: str, then, now) -> bool:
    """Whether two leaves are equal, numbers and those within texts up to their tolerance."""
    if is_number(then) and is_number(now):
        rel, least = next((r, a) for pattern, r, a in TOLERANCES if fnmatch(where, pattern))
        return abs(then - now) <= max(least, rel * abs(then))
    if isinstance(then, str) and isinstance(now, str):
        return then.count(" ") >= SENTENCE_SPACES or same_text(then, now)
    return type(then) is type(now) and then == now


SENTENCE_SPACES = 4  # texts with more words are sentences, which may be written anew
NUMBER = re.compile(r"\d+(?:\.\d+)?(?:e-?\d+)?")


def same_text(then: str, now: str) -> bool:
    """Whether two sentences are, save the last digit of the numbers in them: they are rounded."""
    if NUMBER.split(then) != NUMBER.split(now):
        return False
    for a, b in zip(NUMBER.findall(then), NUMBER.findall(now), strict=True):
        last = 10.0 ** -len(a.partition("e")[0].partition(".")[2]) if "." in a else 1.0
        if a != b and ("e" in a or abs(float(a) - float(b)) > max(1.01 * last, 1e-2 * float(a))):
            return False
    return True


def is_number(x) -> bool:
    return isinstance(x, int | float) and not isinstance(x, bool)


def test_a_lost_key_and_a_changed_number_are_found():
    then = {"a": 1.0, "b": [{"c": "0.52 mm off"}], "d": True, "e": None}
    now = {"a": 1.0005, "b": [{"c": "0.53 mm off"}], "d": True, "e": None, "new": 1}
    assert not list(differences("", then, now, "x"))
    now = {"a": 1.1, "b": [{"c": "0.52 mm away"}], "d": 1}
    found = [path for path, _, _ in differences("", then, now, "x")]
    assert found == ["a", "b.0.c", "d", "e"]
