"""Independent pieces of work, each of which writes one file: on this machine, or on a Ray or Slurm cluster.

datatrove carries them out. A piece whose file is there is done, so that the same command goes on with a run
that was stopped, on any executor. `Progress` is how long work reports how far it is.
"""

import ctypes
import errno
import functools
import importlib.util
import io
import math
import multiprocessing
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import typing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager, redirect_stderr, suppress
from dataclasses import dataclass
from pathlib import Path

from threadpoolctl import threadpool_limits

from pneutac_sim.errors import InputError, check_between, check_choice, check_least
from pneutac_sim.files import read_fields, read_made

EXECUTORS = ("local", "ray", "slurm")
MOST_WORKERS, MOST_WORLDS = 10_000, 100_000  # a typo beyond would take all memory
OURS = (
    *("pipeline", "tasks", "workers", "tasks_per_job", "logging_dir", "skip_completed", "depends", "return"),
    *("job_name", "job_id_retriever", "job_id_position", "depends_job_id"),
)
LOOK_S = 1.0  # between two looks at what is done; longer where a look takes long, as on a network's disk
LOOKING_SHARE = 0.05
RAY_ANSWERS_S = 3.0  # how long a Ray cluster may take to answer
ENDED = "a process ended, out of memory perhaps"
PR_SET_PDEATHSIG = 1  # linux/prctl.h

Progress = Callable[[str, int, int], None]  # a few words, what is done and of how much


def no_progress(text: str, done: int, total: int) -> None:
    """Reports nothing."""


@dataclass(kw_only=True)
class ExecutorOptions:
    """Options of a command whose work is done in pieces."""

    # what carries out the work: `local`, processes on this machine; `ray`, a Ray cluster, or one that is
    # started here; `slurm`, jobs of a Slurm cluster, which shares its disk with this machine
    executor: str = "local"
    # number of processes or of jobs at a time; if omitted, one a core, and on a cluster no limit
    workers: int | None = None
    tasks_per_job: int = 1  # pieces of work that follow one another in one task, started once
    # YAML file of arguments of datatrove's Ray or Slurm executor, such as `partition`, `time` and
    # `mem_per_cpu_gb`
    executor_config: Path | None = None

    def check_executor(self) -> None:
        """Raises InputError where no such executor answers here, or it refuses the arguments of its file."""
        check_choice("executor", self.executor, EXECUTORS)
        check_least(1, tasks_per_job=self.tasks_per_job)
        check_between(1, MOST_WORKERS, workers=1 if self.workers is None else self.workers)
        if self.executor == "ray" and importlib.util.find_spec("ray") is None:
            raise InputError(
                "executor is 'ray', which is not installed; in a clone: uv pip install -e '.[ray]'"
            )
        if self.executor == "slurm" and shutil.which("sbatch") is None:
            raise InputError("executor is 'slurm', but there is no sbatch here; go to a login node of it.")
        given = self.executor_arguments()
        if self.executor == "slurm" and not {"partition", "time"} <= set(given):
            raise InputError(
                "executor is 'slurm', which needs --executor_config: a YAML file with its `partition` and "
                "`time`."
            )
        if self.executor == "ray":
            _find_ray()
        if self.executor == "slurm":
            _ask_slurm(self)

    def executor_arguments(self) -> dict:
        """What `executor_config` gives to datatrove's executor; raises InputError where that has no such."""
        if self.executor_config is None:
            return {}
        file = Path(self.executor_config)
        if self.executor == "local":
            raise InputError("executor_config is of `ray` or `slurm`; leave it out, or give --executor.")
        if not file.is_file():
            raise InputError(f"executor_config is '{file}', which is no file.")
        from datatrove.executor import RayPipelineExecutor, SlurmPipelineExecutor

        engine = RayPipelineExecutor if self.executor == "ray" else SlurmPipelineExecutor
        known = {n: kind for n, kind in typing.get_type_hints(engine.__init__).items() if n not in OURS}
        needed = ("partition", "time") if self.executor == "slurm" else ()
        given = read_fields(file, known, needed, "argument")
        for name, value in given.items():
            if isinstance(value, int | float) and not 0 <= value < math.inf:
                raise InputError(f"{file}: argument '{name}' is {value}; it must be 0 or more.")
        return given


@dataclass(frozen=True)
class Pieces:
    """A step of a datatrove pipeline: each task makes pieces that follow one another."""

    make: Callable[[int], object]  # writes the file of a number, whole or not at all
    numbers: tuple[int, ...]  # of the pieces that are missing
    per_task: int  # how many of them a task makes
    home: Path  # folder from which relative paths lead
    alone: bool  # whether a task starts a process of its own, which computes on one thread

    def __call__(self, data, rank: int, world_size: int) -> None:
        numbers = self.numbers[rank * self.per_task : (rank + 1) * self.per_task]
        if not self.alone:
            _make(self.make, numbers, self.home)
            return
        with process_pool(1) as pool:
            pool.submit(_make, self.make, numbers, self.home).result()


def _make(make: Callable[[int], object], numbers: Sequence[int], home: Path) -> None:
    os.chdir(home)
    for number in numbers:
        make(number)


def run_pieces(
    make: Callable[[int], object],
    files: Sequence[Path],
    logs: Path,
    options: ExecutorOptions | None = None,
    progress: Progress = no_progress,
    text: str = "",
    there: Callable[[Path], bool] = Path.exists,
) -> None:
    """Has `make(k)` called for every file `files[k]` that is missing, by `there`, which it writes.

    `make` can be pickled; what it needs for each piece alike it keeps between calls. `options` say where the
    work is done, on this machine where None. `logs` is a folder of datatrove's logs and completions, removed
    once all files are there. `progress` is called with `text`, a few words, how many files are there and of
    how many.

    Raises InputError: a JSON file is damaged, a piece has raised it, a process ended, no space is left, or
    the cluster refuses the work; what has been made is there, and another call goes on.
    """
    options = options or ExecutorOptions()
    for file in files:
        if file.suffix == ".json" and file.exists():
            read_made(file)
    missing = tuple(k for k, file in enumerate(files) if not there(file))
    if not missing:
        return
    shutil.rmtree(logs, ignore_errors=True)
    run = {"local": _local, "ray": _ray, "slurm": _slurm}[options.executor]
    tasks = -(-len(missing) // options.tasks_per_job)
    step = Pieces(make, missing, options.tasks_per_job, Path.cwd(), options.executor != "local")
    with faults_named(text, logs.parent), _shown(progress, text, files, missing, there):
        run([step], tasks, logs.absolute(), options)
    left = [k for k in missing if not there(files[k])]
    if left:
        raise InputError(
            f"{text or 'Work'}: {len(left)} of {len(files)} pieces were not made ({_reason(logs)}); their "
            f"logs are in {logs}, and the same command goes on."
        )
    shutil.rmtree(logs, ignore_errors=True)


@contextmanager
def faults_named(text: str, folder: Path) -> Iterator[None]:
    """While processes write into a folder: where one ends or no space is left, raises InputError."""
    try:
        yield
    except BrokenProcessPool as e:
        raise InputError(f"{text or 'Work'}: {ENDED}; repeat the command with fewer workers.") from e
    except OSError as e:
        if e.errno in (errno.ENOSPC, errno.EDQUOT):
            raise InputError(f"No space is left in {folder}; free some and repeat.") from e
        raise


@contextmanager
def _shown(progress: Progress, text: str, files: Sequence[Path], missing: Sequence[int], there: Callable):
    ended, total = threading.Event(), len(files)

    def look() -> None:
        left, pause_s = list(missing), 0.0
        while not ended.wait(pause_s):
            began = time.monotonic()
            left = [k for k in left if not there(files[k])]
            progress(text, total - len(left), total)
            pause_s = max(LOOK_S, (time.monotonic() - began) / LOOKING_SHARE)

    thread = threading.Thread(target=look, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def _reason(logs: Path) -> str:
    """How the first task ended that was not completed: the last line of its log, where that is an error."""
    for log in sorted((logs / "logs").glob("task_*.log")):
        if not (logs / "completions" / log.stem.removeprefix("task_")).exists():
            name, _, sentence = log.read_text(errors="replace").rstrip().rpartition("\n")[2].partition(": ")
            if name.endswith("BrokenProcessPool"):
                return ENDED
            return sentence.rstrip(".") if name.endswith(("Error", "Exception")) else ENDED
    return "their tasks did not end"


# ------------------------------------------------------------------ engines


def _local(pipeline: list, tasks: int, logs: Path, options: ExecutorOptions) -> None:
    """Tasks of datatrove in the pool below; its own waits for ever where one of its processes was killed."""
    engine = _quiet().LocalPipelineExecutor(pipeline, tasks, logging_dir=str(logs))
    with process_pool(min(options.workers or len(os.sched_getaffinity(0)), tasks)) as pool:
        for future in as_completed([pool.submit(_run_task, engine, rank) for rank in range(tasks)]):
            future.result()


def _run_task(engine, rank: int) -> None:
    with redirect_stderr(io.StringIO()):
        engine._run_for_rank(rank, local_rank=1)


def _find_ray() -> None:
    """Raises InputError where nothing answers at RAY_ADDRESS; Ray itself would wait for 40 s, and log."""
    address = os.environ.get("RAY_ADDRESS", "")
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not host:
        return
    try:
        socket.create_connection((host, int(port)), RAY_ANSWERS_S).close()
    except (OSError, ValueError) as e:
        raise InputError(
            f"executor is 'ray', but RAY_ADDRESS={address} does not answer ({e}); start it there with `ray"
            " start --head`, or unset RAY_ADDRESS, and one is started here."
        ) from e


def _ray(pipeline: list, tasks: int, logs: Path, options: ExecutorOptions) -> None:
    import datatrove.executor.ray as engines
    import ray

    class Worker(engines.RankWorker):
        """Runs a task in Ray's process; datatrove's forks it, with its threads, and waits for a lost one."""

        def run_for_rank(self, engine, ranks, node_ips, node_idx) -> None:
            for rank in ranks:
                _run_task(engine, rank)

    given = options.executor_arguments()
    with ExitStack() as stack:
        engines.RankWorker = Worker
        if not ray.is_initialized():
            ended_by = {s: signal.getsignal(s) for s in (signal.SIGINT, signal.SIGTERM)}
            try:
                ray.init(log_to_driver=False, logging_level="ERROR")
            except Exception as e:  # plain ones too, as where a node does not start in time
                raise InputError(f"Ray does not start: {(str(e) or repr(e)).splitlines()[0]}") from e
            stack.callback(ray.shutdown)
            if threading.current_thread() is threading.main_thread():
                for signum, handler in ended_by.items():
                    signal.signal(signum, handler)  # Ray's own aborts with a trace of its C++
        workers = options.workers or -1
        engine = _quiet().RayPipelineExecutor(pipeline, tasks, workers, logging_dir=str(logs), **given)
        engine.run()


def _slurm(pipeline: list, tasks: int, logs: Path, options: ExecutorOptions) -> None:
    """Waits for the jobs, which are cancelled where this ends before them."""
    engine = _slurm_engine(pipeline, tasks, logs, options)
    engine.launch_merge_stats = _nothing  # a job more to wait for
    try:
        engine.run()
    except subprocess.CalledProcessError:  # a job has failed; what is missing is found by its file
        pass
    except BaseException:
        with suppress(FileNotFoundError):  # what ended this counts, not that it cannot be called
            subprocess.run(["scancel", f"--name={engine.job_name}"], check=False)
        raise


def _slurm_engine(pipeline: list, tasks: int, logs: Path, options: ExecutorOptions):
    given, activate = options.executor_arguments(), Path(sys.prefix) / "bin" / "activate"
    defaults = {"qos": None, "with_srun": False, "venv_path": str(activate) if activate.is_file() else None}
    extra = {"sbatch_args": {**(given.pop("sbatch_args", None) or {}), "wait": ""}}
    extra["job_name"] = f"pneutac-{os.getpid()}"
    return _quiet().SlurmPipelineExecutor(
        pipeline, tasks, workers=options.workers or -1, logging_dir=str(logs), **defaults | given | extra
    )


def _ask_slurm(options: ExecutorOptions) -> None:
    """Raises InputError where sbatch would refuse the jobs; none is started."""
    with tempfile.TemporaryDirectory() as logs:
        args = _slurm_engine([], 1, Path(logs), options).get_sbatch_args()
        asked = [f"--{k}={v}" if v else f"--{k}" for k, v in args.items() if k != "wait"]
        tried = subprocess.run(
            ["sbatch", "--test-only", *asked, "--wrap=true"], capture_output=True, text=True, check=False
        )
    if tried.returncode:
        reason = tried.stderr.strip().rpartition("\n")[2].removeprefix("sbatch: ").removeprefix("error: ")
        raise InputError(f"{options.executor_config}: sbatch refuses it ({reason}).")


def _nothing() -> None:
    pass


def _quiet():
    from datatrove import executor
    from datatrove.utils.logging import logger

    logger.remove()
    return executor


# ------------------------------------------------------------------ processes of this machine


def check_device(device: str) -> None:
    """Raises InputError where CUDA is asked for and PyTorch finds no such device here."""
    if device.startswith("cuda"):
        import torch

        if not torch.cuda.is_available():
            raise InputError(f"device is '{device}', but PyTorch finds no CUDA device here; give cpu.")


def one_thread(function: Callable) -> Callable:
    """The function with its matrix products on one thread.

    With several they round differently, and a search that rests on them may end elsewhere.
    """

    @functools.wraps(function)
    def limited(*args, **kwargs):
        with threadpool_limits(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return limited


@contextmanager
def process_pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """A pool of new processes, each of which computes on one thread and ends within a second of its parent.

    Ctrl-C is the parent's, which ends them; so does whatever else is raised while they work.
    """
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), _begin) as pool:
        try:
            yield pool
        except BaseException:
            for process in list((pool._processes or {}).values()):
                process.kill()  # what they had begun is made again
            pool.shutdown(cancel_futures=True)
            raise


def _begin() -> None:
    """What a process does first; what else it needs is imported once it can end, since that takes seconds."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"  # for what is imported from here on
    threadpool_limits(limits=1)  # NumPy's has been
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _end_with_parent()
    if "torch" in sys.modules:  # by the program's main module
        sys.modules["torch"].set_num_threads(1)


def _end_with_parent() -> None:
    """Has the kernel end this process with its parent on Linux; a thread does elsewhere, and ends children.

    The thread alone would wait for compiled code that keeps Python's lock.
    """
    parent = multiprocessing.parent_process()
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent.pid:  # it ended just before
            os._exit(1)

    def wait() -> None:
        parent.join()
        for child in multiprocessing.active_children():
            child.kill()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()
