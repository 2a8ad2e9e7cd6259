import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from lerobot_pneutac.cli import run_verb
from lerobot_pneutac.cli.options import parse_options
from lerobot_robot_pneutac.policy.configuration_pneutac_bc import HUBER_DELTA, NETWORKS
from pneutac_benchmarks.policy.main import BenchmarkPolicyConfig
from pneutac_benchmarks.policy.plan import (
    CONDITIONS,
    RESULT,
    TEST_START,
    Unit,
    derived_seed,
    plan,
    recordings,
)
from pneutac_benchmarks.policy.run import finished, run_units
from pneutac_benchmarks.policy.table import curve, difference, reasons, rows, success, worth
from pneutac_benchmarks.policy.units import STARTS_EACH, _why
from pneutac_sim.errors import InputError
from pneutac_sim.executor import ExecutorOptions
from pneutac_sim.features import TASK_NAMES
from pneutac_sim.twin import Twin, twin_digest

pytestmark = pytest.mark.slow


def config(*argv, out="unused"):
    return parse_options(BenchmarkPolicyConfig, [*argv, "--device=cpu", f"--out={out}"])


def by_kind(units, kind):
    return [u for u in units if u.kind == kind]


def test_plan_has_each_policy_and_shares_what_they_share():
    units = plan(config())
    names = [u.name for u in units]
    assert len(set(names)) == len(names)
    cells = 3 * 8  # tasks and seeds
    counts = {"record": 2, "augment": 12, "scenes": 1, "naive": 1, "ppo": 1, "student": 1, "train": 16}
    assert {k: len(by_kind(units, k)) for k in counts} == {k: cells * n for k, n in counts.items()}
    assert len(by_kind(units, "evaluate")) == cells * 16 * 5  # 50 trials in tens
    for i, unit in enumerate(units):  # what is needed comes first
        assert set(unit.needs) <= set(names[:i])
    library = CONDITIONS["library"]  # as pneutac_bc does after `augment`
    assert (library.huber_delta, library.networks) == (HUBER_DELTA, NETWORKS)


def test_all_policies_of_a_seed_have_the_same_updates_network_and_trials():
    units = plan(config("--pretrain_updates=7", "--finetune_updates=5"))
    for task in TASK_NAMES:
        mine = [u for u in units if u.name.startswith(f"{task}/1/")]
        options = [u.options for u in by_kind(mine, "train")]
        assert len({(o["pretrain_updates"], o["finetune_updates"], o["seed"], o["lr"]) for o in options}) == 1
        assert [o["use_tactile"] for o in options].count(False) == 1
        assert len({json.dumps(u.options) for u in by_kind(mine, "evaluate")}) == 5


def test_real_demonstrations_are_a_sets_own_first_and_then_its_neighbours():
    assert recordings(3, 1) == [(3, "real")]
    assert recordings(3, 2) == [(3, "real"), (3, "more")]
    assert recordings(8, 2) == [(8, "real"), (8, "more")]
    hundred = recordings(15, 10)
    assert hundred[:3] == [(15, "real"), (15, "more"), (8, "real")] and len(set(hundred)) == 10
    units = {u.name: u for u in plan(config("--tasks=[egg]", "--seeds=[3]", "--conditions=[real_3,real_50]"))}
    few, fifty = (units[f"egg/3/{name}_policy"] for name in ("real_3", "real_50"))
    assert (few.needs, few.options["episodes"]) == (("egg/3/real",), 3)
    assert len(fifty.needs) == fifty.options["real"] == 5 and fifty.options["episodes"] == 50


def test_no_two_purposes_share_a_seed_and_trials_start_elsewhere():
    units = plan(config("--seeds=[0,1,2,99999]", "--trials=1000", "--conditions=[real,n_aug,ppo]"))
    seeds = [u.options["seed"] for u in units if u.kind not in ("train", "evaluate")]
    assert len(set(seeds)) == len(seeds) and max(seeds) * STARTS_EACH + STARTS_EACH < TEST_START
    starts = {(u.options["task"], u.options["start"]) for u in by_kind(units, "evaluate")}
    assert len(starts) == 3 * 4 * 100
    ordered = sorted({s for _, s in starts})
    assert ordered[0] >= TEST_START and min(np.diff(ordered)) >= 10
    assert derived_seed(0, "switch", "real") != derived_seed(0, "switch", "more")


def test_compared_twins_differ_in_the_twin_alone(tmp_path):
    for name in ("a", "b"):
        Twin.builtin().save(tmp_path / name)
    units = plan(
        config(
            f"--twin_before={tmp_path / 'a'}",
            f"--twin={tmp_path / 'b'}",
            "--conditions=[]",
            "--tasks=[egg]",
            "--seeds=[4]",
            "--augmented=25",
        )
    )
    made = {u.name.split("/")[2]: u for u in by_kind(units, "augment")}
    before, after = made["library_before_000"].options, made["library_000"].options
    assert (Path(before["twin"]).name, Path(after["twin"]).name) == ("a", "b")
    assert before | {"twin": ""} == after | {"twin": ""}
    assert before["digest"] == twin_digest(Twin.builtin())  # another version's units are of other options
    needs = {u.name.split("/")[2]: u.needs for u in by_kind(units, "train")}
    assert needs["sim_only_before_policy"] == ("egg/4/library_before_000",)
    assert needs["library_policy"] == ("egg/4/library_000", "egg/4/real")


def trials(task, seed, name, successes, why="time-out, touch lost"):
    found = [
        {"start": 10 * seed + k, "success": bool(s), "steps": 9, "reason": "" if s else why}
        for k, s in enumerate(successes)
    ]
    unit = {"unit": {"kind": "evaluate"}, "seconds": 1.0, "result": {"trials": found}}
    return {f"{task}/{seed}/{name}_trials_000": unit}


def test_table_has_intervals_paired_differences_reasons_and_what_it_is_worth():
    cfg = config("--tasks=[switch,egg]", "--seeds=[0,1]", "--conditions=[real,real_20,library,ppo]")
    done = {}
    for task in cfg.tasks:
        for seed in cfg.seeds:
            done |= trials(task, seed, "real", [1, 0, 0, 0])
            done |= trials(task, seed, "real_20", [1, 1, 1, 0])
            done |= trials(task, seed, "library", [1, 1, 0, 0], "pressed too hard")
    found = success(cfg, done, "library")
    assert found["egg"]["mean"] == 50 and found["egg"]["trials"] == 8 and found["egg"]["seeds"] == 2
    assert found["egg"]["low"] == pytest.approx(21.5, abs=0.1)  # Wilson, 4 of 8
    assert success(cfg, done, "ppo")["overall"] is None
    less = difference(cfg, done, "library", "real")
    assert less["overall"]["mean"] == 25 and less["overall"]["pairs"] == 16
    assert 0 <= less["egg"]["low"] < 25 < less["egg"]["high"] <= 75
    assert difference(cfg, done, "ppo", "real") is None
    all_of_them = {name: success(cfg, done, name) for name in cfg.conditions}
    assert worth(all_of_them, "library", 10) == pytest.approx(10 * 2**0.5)
    assert worth(all_of_them, "real_20", 10) == pytest.approx(20)
    assert worth(all_of_them, "ppo", 10) is None
    table = {row["condition"]: row for row in rows(cfg, done, {k: CONDITIONS[k] for k in cfg.conditions})}
    assert table["library"]["egg"] == "50 (22-78, 8)" and table["library"]["mean"] == "50.0"
    assert table["library"]["minus real, mean"].startswith("+25.0 (")
    assert (table["library"]["worth so many real ones"], table["ppo"]["egg"]) == ("14", "-")
    why = {(r["condition"], r["task"]): (r["failed"], r["why"]) for r in reasons(cfg, done, CONDITIONS)}
    assert why["library", "egg"] == ("4 of 8", "4 pressed too hard")
    assert ("ppo", "egg") not in why
    assert [row["real demonstrations"] for row in curve(cfg, done)] == ["10", "20"]


def test_a_difference_is_over_starts_that_both_were_tried_from():
    cfg = config("--tasks=[egg]", "--seeds=[0,1]", "--conditions=[real,library]")
    done = trials("egg", 0, "real", [0, 0, 1, 1]) | trials("egg", 0, "library", [1, 1])
    done |= trials("egg", 1, "real", [1])
    assert difference(cfg, done, "library", "real")["overall"] == {
        "mean": 100.0,
        "low": 100.0,
        "high": 100.0,
        "pairs": 2,
    }


class World:
    failure, success = None, False


@pytest.mark.parametrize(
    ("touched", "failure", "why"),
    [
        ([], None, "time-out, never touched"),
        ([40], None, "time-out, touch lost"),
        ([40, 295], None, "time-out, in touch"),
        ([40], "pressed the wall", "pressed the wall"),
    ],
)
def test_a_failed_trial_has_its_reason(touched, failure, why):
    world, area = World(), np.zeros(300)
    area[touched], world.failure = 0.1, failure
    assert _why(world, area) == why


@pytest.mark.parametrize(
    ("option", "words"),
    [
        ("--seeds=[-1]", "different numbers"),
        ("--select=best", "it must be one of last, held_out"),
        ("--fidelity=exact", "^fidelity is 'exact'"),
    ],
)
def test_bad_options_end_in_a_sentence(option, words):
    with pytest.raises(InputError, match=words):
        config(option)


def test_units_of_other_options_are_refused(tmp_path):
    unit = Unit("switch/0/real", "record", {"task": "switch", "episodes": 2, "seed": 0})
    assert finished(tmp_path, unit) is None
    path = tmp_path / unit.name / RESULT
    path.parent.mkdir(parents=True)
    other = {"name": unit.name, "kind": "record", "options": {}, "needs": []}
    path.write_text(json.dumps({"unit": other, "failed": "no demonstration succeeded"}))
    assert finished(tmp_path, unit) is None  # and is tried again
    path.write_text(json.dumps({"unit": other, "result": {}}))
    with pytest.raises(InputError, match="other options"):
        finished(tmp_path, unit)
    path.write_text("{")
    with pytest.raises(InputError, match="damaged"):
        finished(tmp_path, unit)


def test_after_its_time_no_unit_is_begun(tmp_path):
    unit = Unit("switch/0/student", "student", {"episodes": 1})
    assert run_units(tmp_path, [unit], ExecutorOptions(), until=time.time() - 1) == ({}, {}, [])


COMMAND = "from lerobot_pneutac.cli.__main__ import main; main()"


@pytest.mark.nightly
@pytest.mark.timeout(1200)  # two busy cores
def test_a_killed_benchmark_goes_on_to_all_conditions(tmp_path):
    argv = ["--fast=true", "--films=1", "--select=held_out", "--device=cpu", "--workers=1"]
    argv.append(f"--out={tmp_path}")
    with subprocess.Popen(
        [sys.executable, "-c", COMMAND, "benchmark", "policy", *argv], stdout=subprocess.DEVNULL
    ) as process:
        first = tmp_path / "switch/0/real" / RESULT
        deadline = time.monotonic() + 240
        while not first.exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        os.kill(process.pid, signal.SIGKILL)
    kept = first.read_text()
    run_verb("benchmark", ["policy", *argv])
    assert first.read_text() == kept  # not recorded again
    result = json.loads((tmp_path / "result.json").read_text())
    assert set(result["success"]) == set(CONDITIONS)
    few = {"real_1", "real_3", "real_5"}  # of one demonstration none can be held out
    for name, cell in result["success"].items():
        if name in few | {"ppo"}:  # so little training never succeeds
            assert cell["switch"] is None
            continue
        (trial,) = result["units"][f"switch/0/{name}_trials_000"]["result"]["trials"]
        assert trial["start"] == TEST_START
        assert cell["switch"]["mean"] == 100.0 * trial["success"]
    lacking = {"student", "ppo_policy", "ppo_trials_000"}
    lacking |= {f"{name}_{what}" for name in few for what in ("policy", "trials_000")}
    lacking |= {f"{name}_films" for name in (*few, "ppo")}
    assert set(result["failures"]) == {f"switch/0/{name}" for name in lacking}
    assert "succeeded in 0 of" in result["failures"]["switch/0/student"]
    assert result["units"]["switch/0/real_20_policy"]["unit"]["options"]["episodes"] == 4
    trained = result["units"]["switch/0/n_aug_policy"]["result"]
    assert trained["pretraining"]["curve"][-1]["update"] == 30
    assert trained["training"]["curve"][-1]["update"] == 10
    assert len(trained["held_out_episodes"]) == 1
    assert (Path(trained["checkpoint"]) / "model.safetensors").is_file()
    assert (trained["pretraining"]["lr"], trained["training"]["lr"]) == (1e-3, 1e-4)
    alone = result["units"]["switch/0/real_policy"]["result"]
    assert alone["training"]["lr"] == 1e-3
    assert "pretraining" not in alone and alone["training"]["curve"][-1]["update"] == 40
    (shown,) = result["units"]["switch/0/n_aug_films"]["result"]["films"] or [None]
    assert shown is None or Path(shown["file"]).is_file()
    assert "| n_aug |" in (tmp_path / "table.md").read_text()
    assert "Learning curves" in (tmp_path / "report.html").read_text()
