"""Where a file cannot be written to its end a verb ends in one sentence, and the same command then works."""

import resource
import shlex
import shutil
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest
from numba.core.caching import IndexDataCacheFile

from lerobot_pneutac.cli import _dispatch

GOLDEN = Path(__file__).parents[2] / "golden"
COMMANDS = {
    "new": "new --twin=new --recording=bench",
    "convert": "convert lab.csv --out=converted",
    "compare": "compare --twin=twin --recording=lab.csv --yes --out=out",
    "history": "history --twin=twin --restore=0",
    "calibrate": "calibrate --twin=bare --recording=bench --out=out",
    "export": "export --twin=twin --out=finger.py",
    "control": "control --twin=twin --hz=5 --out=out",
    "effects": "effects export thermal --out=effect.py",
    "report": "report twin --out=out",
}
LARGE = ("compare", "calibrate", "control", "report")  # whose page breaks off in the middle


@contextmanager
def files_of_at_most(size):
    """A file that grows beyond ends in an OSError, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.fixture
def lab(tmp_path, monkeypatch, no_soft_body):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(IndexDataCacheFile, "save", lambda *_: None)  # of compiled kernels, which is not ours
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # nor are modules, half of which would remain
    shutil.copytree(GOLDEN / "recordings" / "finger_creep", "bench")
    shutil.copytree(GOLDEN / "twins" / "finger", "twin")
    shutil.copytree("twin/history/000", "bare")
    shutil.copy("bench/samples.csv", "lab.csv")
    return tmp_path


def contents(folder):
    files = (p for p in folder.rglob("*") if p.is_file() and p.name != ".lock")
    return {p: p.read_bytes() for p in files}


@pytest.mark.parametrize("verb", COMMANDS)
def test_a_full_disk_costs_a_sentence_and_the_command_can_be_repeated(lab, capsys, verb):
    argv, before = shlex.split(COMMANDS[verb]), contents(lab)
    with files_of_at_most(20_000 if verb in LARGE else 100):
        try:
            _dispatch(argv)
        except SystemExit as e:
            assert str(e).startswith(f"pneutac {verb}: ") and "cannot be written (File too large)" in str(e)
            assert "\n" not in str(e)
        else:
            return
    assert before.items() <= contents(lab).items()
    _dispatch(argv)
