"""Pieces of work on each executor: equal files, what goes on after a fault, and what is refused first."""

import os
import signal
import stat
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import pieces
import pytest
import scipy.linalg
from threadpoolctl import threadpool_info, threadpool_limits

from pneutac_benchmarks.robustness.killed_parent import kill_parents
from pneutac_sim.errors import InputError
from pneutac_sim.executor import ExecutorOptions, one_thread, process_pool, run_pieces

HELPERS = Path(pieces.__file__).parent
# Knows one partition, and carries out a job at once, each task of its array in turn.
SBATCH = """#!/bin/bash
case "$*" in *--test-only*) [[ "$*" == *--partition=cpu* ]] ||
    { echo "sbatch: error: invalid partition specified: gpu" >&2; exit 1; }; exit 0;; esac
script="${@: -1}"
last=$(sed -n 's/^#SBATCH --array=0-\\([0-9]*\\).*/\\1/p' "$script")
echo "Submitted batch job 1"
for task in $(seq 0 "$last"); do
    SLURM_ARRAY_TASK_ID=$task SLURM_NODELIST=here bash "$script" >>"$(dirname "$0")/log" 2>&1 || failed=1
done
exit ${failed:-0}
"""


@pytest.fixture
def cluster(tmp_path, monkeypatch):
    """Slurm's commands, and options for it; what a job starts finds the tests' pieces."""
    programs = tmp_path / "bin"
    programs.mkdir()
    for name, text in {"sbatch": SBATCH, "scontrol": "#!/bin/bash\necho here\n"}.items():
        (programs / name).write_text(text)
        (programs / name).chmod(stat.S_IRWXU)
    monkeypatch.setenv("PATH", f"{programs}:{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", str(HELPERS))
    config = tmp_path / "slurm.yaml"
    config.write_text("partition: cpu\ntime: '1:00:00'\n")
    return config


def run(folder: Path, options: ExecutorOptions | None = None, number: int = 5) -> dict[str, str]:
    folder.mkdir(exist_ok=True)
    files = [folder / f"{k}.txt" for k in range(number)]
    run_pieces(partial(pieces.make, folder), files, folder / "logs", options, text="texts")
    assert not (folder / "logs").exists()
    return {f.name: f.read_text() for f in files}


@pytest.mark.slow
def test_the_pieces_are_equal_whoever_makes_them(tmp_path, cluster):
    one = run(tmp_path / "one", ExecutorOptions(workers=1, tasks_per_job=5))
    assert len(set(one.values())) == 5
    assert run(tmp_path / "two", ExecutorOptions(workers=2, tasks_per_job=2)) == one
    jobs = ExecutorOptions(executor="slurm", tasks_per_job=3, executor_config=cluster)
    jobs.check_executor()
    assert run(tmp_path / "slurm", jobs) == one


@pytest.mark.parametrize(
    ("fault", "sentence"),
    [
        ("refuse", "^piece 2 has no seed; give one.$"),
        ("kill", "texts: a process ended, out of memory perhaps; repeat the command with fewer workers"),
    ],
)
def test_a_fault_is_one_sentence_and_the_same_call_goes_on(tmp_path, fault, sentence, capfd):
    (tmp_path / f"{fault}_2").touch()
    with pytest.raises(InputError, match=sentence):
        run(tmp_path, ExecutorOptions(workers=1))
    assert "Traceback" not in capfd.readouterr().err
    made = {f: f.stat().st_mtime_ns for f in tmp_path.glob("*.txt")}
    assert {f.name for f in made} >= {"0.txt", "1.txt"} and tmp_path / "2.txt" not in made
    (tmp_path / f"{fault}_2").unlink()
    shown = []
    run_pieces(
        partial(pieces.make, tmp_path),
        [tmp_path / f"{k}.txt" for k in range(5)],
        tmp_path / "logs",
        progress=lambda *a: shown.append(a),
    )
    assert shown[0] == ("", len(made), 5)
    assert made.items() <= {f: f.stat().st_mtime_ns for f in tmp_path.glob("*.txt")}.items()


def test_a_piece_that_is_cut_in_half_is_named_before_work_starts(tmp_path):
    files = [tmp_path / f"{k}.json" for k in range(2)]
    files[0].write_text('{"rows": [1,')
    with pytest.raises(InputError, match=r"0\.json' is damaged; delete it, and the same command makes it"):
        run_pieces(partial(pieces.make, tmp_path), files, tmp_path / "logs")
    assert list(tmp_path.iterdir()) == files[:1]


@pytest.mark.nightly  # every day: on this machine, above
def test_a_lost_process_of_a_job_of_slurm_is_one_sentence_too(tmp_path, cluster):
    (tmp_path / "kill_1").touch()
    options = ExecutorOptions(executor="slurm", tasks_per_job=2, executor_config=cluster)
    with pytest.raises(InputError, match=r"texts: 1 of 3 pieces were not made \(a process ended, .*logs"):
        run(tmp_path, options, 3)


@pytest.mark.nightly  # Ray takes a minute to begin; every day: the same on this machine and on Slurm
@pytest.mark.timeout(300, method="thread")  # ends the process: no signal ends a wait in Ray itself
def test_ray_makes_equal_pieces_and_reports_what_was_wrong(tmp_path, monkeypatch):
    pytest.importorskip("ray")
    monkeypatch.setenv("PYTHONPATH", str(HELPERS))
    options = ExecutorOptions(executor="ray", workers=2, tasks_per_job=3)
    options.check_executor()
    (tmp_path / "ray").mkdir()
    (tmp_path / "ray" / "refuse_4").touch()
    with pytest.raises(InputError, match=r"1 of 5 pieces were not made \(piece 4 has no seed; give one\)"):
        run(tmp_path / "ray", options)
    (tmp_path / "ray" / "refuse_4").unlink()
    assert run(tmp_path / "ray") == run(tmp_path / "local")


def test_what_is_wrong_with_an_executor_is_one_sentence(tmp_path, cluster, monkeypatch):
    def refused(match: str, **options) -> None:
        with pytest.raises(InputError, match=match):
            ExecutorOptions(**options).check_executor()

    refused("executor is 'dask'; it must be one of local, ray, slurm", executor="dask")
    refused("workers is 0", workers=0)
    refused("workers is 1e[+]06; give 1 to 10000", workers=1_000_000)
    refused("tasks_per_job is 0", tasks_per_job=0)
    refused("leave it out, or give --executor", executor_config=cluster)
    refused("which is no file", executor="ray", executor_config=tmp_path / "none.yaml")
    refused("needs --executor_config: .* `partition` and `time`", executor="slurm")
    cluster.write_text("partition: gpu\ntime: '1:00:00'\n")
    said = r"slurm.yaml: sbatch refuses it \(invalid partition specified: gpu\)"
    refused(said, executor="slurm", executor_config=cluster)
    cluster.write_text("partitions: cpu\n")
    said = "slurm.yaml: unknown argument 'partitions'; did you mean 'partition'"
    refused(said, executor="slurm", executor_config=cluster)
    for line, said in (
        ("cpus_per_task: many", "'cpus_per_task' is 'many'; it must be of the type int"),
        ("cpus_per_task: -1", "'cpus_per_task' is -1; it must be 0 or more"),
        ("sbatch_args: [a]", r"'sbatch_args' is \['a'\]; it must be of the type dict"),
        ("qos: yes", "'qos' is True; it must be of the type str"),
        ("job_name: mine", "unknown argument 'job_name'"),
    ):
        cluster.write_text(f"partition: cpu\ntime: 1:00:00\n{line}\n")
        refused(f"slurm.yaml: (argument )?{said}", executor="slurm", executor_config=cluster)
    monkeypatch.setenv("PATH", str(tmp_path))
    refused("no sbatch here", executor="slurm", executor_config=cluster)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: name)
    for address in ("127.0.0.1:9", "ray://127.0.0.1:9"):
        monkeypatch.setenv("RAY_ADDRESS", address)
        refused(f"RAY_ADDRESS={address} does not answer .* `ray start --head`, or unset", executor="ray")
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    refused("'ray', which is not installed; in a clone: uv pip install", executor="ray")


def test_what_ends_a_command_is_not_left_to_ray(tmp_path, monkeypatch):
    """Ray's own handler aborts with a trace, and the command could not say that it goes on."""
    ray, executor = pytest.importorskip("ray"), pytest.importorskip("datatrove.executor")
    ended_by = {s: signal.signal(s, lambda *_: None) for s in (signal.SIGTERM, signal.SIGINT)}
    ours, found = {s: signal.getsignal(s) for s in ended_by}, {}

    def init(**_) -> None:
        for s in ours:
            signal.signal(s, signal.SIG_DFL)

    monkeypatch.setattr(ray, "init", init)
    monkeypatch.setattr(ray, "shutdown", lambda: None)
    run_of = executor.RayPipelineExecutor
    monkeypatch.setattr(run_of, "run", lambda _: found.update({s: signal.getsignal(s) for s in ours}))
    try:
        with pytest.raises(InputError, match="5 of 5 pieces were not made"):
            run(tmp_path, ExecutorOptions(executor="ray"))
    finally:
        for s, handler in ended_by.items():
            signal.signal(s, handler)
    assert found == ours


def test_ray_that_does_not_start_is_one_sentence(tmp_path, monkeypatch):
    ray = pytest.importorskip("ray")

    def init(**_) -> None:
        raise Exception("The current node timed out during startup.\nLook at its logs.")

    monkeypatch.setattr(ray, "init", init)
    with pytest.raises(InputError, match="^Ray does not start: The current node timed out during startup.$"):
        run(tmp_path, ExecutorOptions(executor="ray"))


@pytest.mark.parametrize("installed", [True, False])
def test_an_interrupt_cancels_the_jobs_of_slurm_and_stays_one(tmp_path, cluster, monkeypatch, installed):
    def interrupt(_) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("datatrove.executor.SlurmPipelineExecutor.run", interrupt)
    if installed:
        scancel = tmp_path / "bin" / "scancel"
        scancel.write_text(f"#!/bin/bash\necho $* >{tmp_path / 'cancelled'}\n")
        scancel.chmod(stat.S_IRWXU)
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path / "jobs", ExecutorOptions(executor="slurm", executor_config=cluster))
    if installed:
        assert (tmp_path / "cancelled").read_text() == f"--name=pneutac-{os.getpid()}\n"


def test_an_interrupt_ends_at_once_what_runs(tmp_path):
    def interrupt(*_) -> None:
        raise KeyboardInterrupt

    began = time.monotonic()
    with pytest.MonkeyPatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr("pneutac_sim.executor.as_completed", interrupt)
        run_pieces(pieces.rest, [tmp_path / str(k) for k in range(2)], tmp_path / "logs")
    assert time.monotonic() - began < 200


def test_a_process_of_the_pool_is_another_one():
    with process_pool(1) as pool:
        assert pool.submit(os.getpid).result() != os.getpid()


def test_a_process_of_the_pool_computes_on_one_thread(monkeypatch):
    """With several, sums round differently from one computer to the next."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        monkeypatch.setenv(name, "2")
    with process_pool(1) as pool:
        used = pool.submit(pieces.threads).result()
    assert len(used) > 2 and set(used) == {1}


@pytest.mark.realtime
@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a worker ends when its compiled code returns")
@pytest.mark.parametrize("number", [2, pytest.param(50, marks=pytest.mark.nightly)])
def test_workers_end_within_a_second_of_a_killed_parent(number):
    assert kill_parents(number).broken == ()


def test_products_of_matrices_use_one_thread():
    scipy.linalg.svdvals(np.eye(3))  # its own library is loaded
    with threadpool_limits(limits=2, user_api="blas"):
        used = [x["num_threads"] for x in one_thread(threadpool_info)() if x["user_api"] == "blas"]
    assert used and set(used) == {1}
