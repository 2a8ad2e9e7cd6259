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
from pneutac_benchmarks.policy import run as benchmark_policy_run
from pneutac_benchmarks.policy.main import BenchmarkPolicyConfig
from pneutac_benchmarks.policy.plan import CONDITIONS, TEST_START, Unit, derived_seed, plan
from pneutac_benchmarks.policy.run import LOG, RESULT, _pool, finished, run_units
from pneutac_benchmarks.policy.table import rows, success
from pneutac_sim.errors import InputError
from pneutac_sim.features import TASK_NAMES
from pneutac_sim.twin import Twin

pytestmark = pytest.mark.slow


def config(*argv, out="unused"):
    return parse_options(BenchmarkPolicyConfig, [*argv, "--device=cpu", f"--out={out}"])


def by_kind(units, kind):
    return [u for u in units if u.kind == kind]


def test_plan_has_each_policy_and_shares_what_they_share():
    units = plan(config())
    names = [u.name for u in units]
    assert len(set(names)) == len(names)
    cells = 3 * 3  # tasks and seeds
    counts = {"record": 2, "augment": 1, "naive": 1, "ppo": 1, "student": 1, "train": 7, "evaluate": 7}
    assert {k: len(by_kind(units, k)) for k in counts} == {k: cells * n for k, n in counts.items()}
    for i, unit in enumerate(units):  # what is needed comes first
        assert set(unit.needs) <= set(names[:i])


def test_all_policies_of_a_seed_have_the_same_updates_network_and_trials():
    units = plan(config("--pretrain_updates=7", "--finetune_updates=5"))
    for task in TASK_NAMES:
        mine = [u for u in units if u.name.startswith(f"{task}/1/")]
        options = [u.options for u in by_kind(mine, "train")]
        assert len({(o["pretrain_updates"], o["finetune_updates"], o["seed"], o["lr"]) for o in options}) == 1
        assert [o["use_tactile"] for o in options].count(False) == 1
        assert len({json.dumps(u.options) for u in by_kind(mine, "evaluate")}) == 1


def test_no_two_purposes_share_a_seed_and_trials_start_elsewhere():
    units = plan(config("--seeds=[0,1,2,99999]", "--trials=1000"))
    seeds = [u.options["seed"] for u in units if u.kind not in ("train", "frames", "evaluate")]
    assert len(set(seeds)) == len(seeds) and max(seeds) < TEST_START
    starts = {(u.options["task"], u.options["start"]) for u in by_kind(units, "evaluate")}
    assert len(starts) == 3 * 4
    ordered = sorted({s for _, s in starts})
    assert ordered[0] >= TEST_START and min(np.diff(ordered)) >= 1000
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
        )
    )
    before, after = by_kind(units, "augment")
    assert (Path(before.options["twin"]).name, Path(after.options["twin"]).name) == ("a", "b")
    assert before.options | {"twin": ""} == after.options | {"twin": ""}
    needs = {u.name.split("/")[2]: u.needs for u in by_kind(units, "train")}
    assert needs["sim_only_before_policy"] == ("egg/4/augmented_before_frames",)
    assert needs["sim_real_policy"] == ("egg/4/augmented_frames", "egg/4/real_frames")


def test_table_has_mean_and_standard_error_over_seeds():
    cfg = config("--tasks=[switch,egg]", "--seeds=[0,1]", "--conditions=[real,ppo]")
    percent = {("switch", 0): 40.0, ("switch", 1): 60.0, ("egg", 0): 100.0, ("egg", 1): 80.0}
    done = {f"{t}/{s}/real_trials": {"result": {"success_percent": p}} for (t, s), p in percent.items()}
    done["egg/1/ppo_trials"] = {"result": {"success_percent": 30.0}}
    found = success(cfg, done, "real")
    assert found["switch"] == {"mean": 50.0, "sem": pytest.approx(10.0), "seeds": 2}
    assert found["overall"] == {"mean": 70.0, "sem": pytest.approx(0.0), "seeds": 2}  # 70 for both seeds
    chosen = {k: CONDITIONS[k] for k in cfg.conditions}
    real, ppo = rows(cfg, done, chosen)
    assert (real["switch"], real["egg"], real["overall"]) == ("50 ± 10", "90 ± 10", "70 ± 0")
    assert (ppo["switch"], ppo["egg"], ppo["overall"]) == ("-", "30 (1 of 2 seeds)", "-")


@pytest.mark.parametrize(
    ("option", "words"),
    [
        ("--tasks=[juggle]", "^tasks is"),
        ("--conditions=[real,real]", "each once"),
        ("--conditions=[]", "at least one"),
        ("--seeds=[1,1]", "different numbers"),
        ("--seeds=[-1]", "different numbers"),
        ("--demonstrations=1", "2 or more"),
        ("--select=best", "it must be one of last, held_out"),
        ("--trials=0", "^trials is 0"),
        ("--jobs=0", "^jobs is 0"),
        ("--lr=0", "^lr is 0"),
        ("--finetune_lr=nan", "^finetune_lr is nan"),
        ("--fidelity=exact", "^fidelity is 'exact'"),
        ("--twin=nowhere", "no twin.yaml"),
        ("--twin_before=nowhere", "no twin.yaml"),
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
    path.write_text(json.dumps({"unit": {"name": unit.name, "kind": "record", "options": {}, "needs": []}}))
    with pytest.raises(InputError, match="other options"):
        finished(tmp_path, unit)
    path.write_text("{")
    with pytest.raises(InputError, match="damaged"):
        finished(tmp_path, unit)


@pytest.mark.nightly
def test_a_unit_that_fails_costs_none_but_those_that_need_it(tmp_path):
    broken = Unit("switch/0/student", "student", {}, ())
    needing = Unit("switch/0/student_frames", "frames", {}, (broken.name,))
    sound = Unit("switch/0/real", "record", {"task": "switch", "twin": None, "episodes": 1, "seed": 3})
    done, failed, faults = run_units(tmp_path, [broken, needing, sound], 1, lambda share, words: None)
    assert set(done) == {sound.name}
    assert faults == [broken.name]  # and none that needs it
    assert "KeyError" in failed[broken.name] and "log.txt" in failed[broken.name]
    assert failed[needing.name] == f"needs {broken.name}"
    assert "Traceback" in (tmp_path / broken.name / LOG).read_text()


def test_an_interrupt_ends_at_once_what_runs():
    with pytest.raises(KeyboardInterrupt):
        with _pool(1) as pool:
            pool.submit(os.getpid).result()  # the process is there
            start = time.monotonic()
            running = pool.submit(time.sleep, 60)
            while not running.running():
                time.sleep(0.01)
            raise KeyboardInterrupt
    assert time.monotonic() - start < 30


def test_a_fault_writes_the_table_and_ends_the_command_with_an_error(tmp_path, monkeypatch):
    def faulty(out, units, jobs, progress):
        trials = {"success_percent": 100.0, "trials": [{"start": TEST_START, "success": True}]}
        unit = {"unit": {"kind": "evaluate"}, "seconds": 1.0, "result": trials}
        return {"switch/0/real_trials": unit}, {"switch/0/x": "OSError: full"}, ["switch/0/x"]

    monkeypatch.setattr(benchmark_policy_run, "run_units", faulty)
    argv = ["--conditions=[real]", "--tasks=[switch]", "--seeds=[0]", "--device=cpu", f"--out={tmp_path}"]
    with pytest.raises(InputError, match="switch/0/x ended in a fault"):
        run_verb("benchmark", ["policy", *argv])
    assert "OSError: full" in (tmp_path / "table.md").read_text()


COMMAND = "from lerobot_pneutac.cli.__main__ import main; main()"


@pytest.mark.nightly
@pytest.mark.timeout(1200)  # two busy cores
def test_a_killed_benchmark_goes_on_to_all_six_conditions(tmp_path):
    argv = ["--fast=true", "--select=held_out", "--device=cpu", "--jobs=1", f"--out={tmp_path}"]
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
    for name, cell in result["success"].items():
        if name == "ppo":  # so little training never succeeds
            assert cell["switch"] is None
            continue
        (trial,) = result["units"][f"switch/0/{name}_trials"]["result"]["trials"]
        assert trial["start"] == TEST_START
        assert cell["switch"]["mean"] == 100.0 * trial["success"]
    lacking = {f"switch/0/{name}" for name in ("student", "student_frames", "ppo_policy", "ppo_trials")}
    assert set(result["failures"]) == lacking
    assert "succeeded in 0 of" in result["failures"]["switch/0/student"]
    assert result["units"]["switch/0/real_20_frames"]["result"]["episodes"] == 4
    trained = result["units"]["switch/0/n_aug_policy"]["result"]
    assert trained["pretraining"]["curve"][-1]["update"] == 30
    assert trained["training"]["curve"][-1]["update"] == 10
    assert len(trained["held_out_episodes"]) == 1
    assert (Path(trained["checkpoint"]) / "model.safetensors").is_file()
    assert (trained["pretraining"]["lr"], trained["training"]["lr"]) == (3e-4, 3e-5)
    alone = result["units"]["switch/0/real_policy"]["result"]
    assert alone["training"]["lr"] == 3e-4
    assert "pretraining" not in alone and alone["training"]["curve"][-1]["update"] == 40
    assert "| n_aug |" in (tmp_path / "table.md").read_text()
    assert "Learning curves" in (tmp_path / "report.html").read_text()
