"""A twin's folder survives what can stop its writing, and what is wrong in it ends in one sentence."""

import errno
import multiprocessing
import os
import random
from pathlib import Path

import numpy as np
import pytest

from pneutac_sim import files
from pneutac_sim.errors import InputError
from pneutac_sim.finger.pipeline import Pipeline
from pneutac_sim.gel.model import GelModel
from pneutac_sim.twin import Twin

FORK = multiprocessing.get_context("fork")
SAVED = Path(__file__).parents[1] / "golden" / "twins" / "finger"
TOKENS = (
    ".nan -1 1e400 null [] {} true [1,2] &a *a !!python/object:os.system 2020-01-01 # 0 : ? - é " + "[" * 90
).split()


def first(folder) -> Twin:
    twin = Twin.builtin()
    twin.arrays["rest_image"] = np.zeros((4, 4))
    twin.save_version(folder, "first", "bench", {})
    return twin


def second(folder) -> None:
    twin = Twin.load(folder)
    twin.arrays["rest_image"] = np.ones((4, 4))
    twin.save_version(folder, "second", "bench", {})


def stopped_at(operation: int, folder) -> None:
    """A process that ends without a word at its n-th operation on files, as SIGKILL would."""
    left = [operation]

    def counted(do):
        def done(*args, **kwargs):
            left[0] -= 1
            if left[0] < 0:
                os._exit(9)
            return do(*args, **kwargs)

        return done

    for owner, names in ((Path, ("replace", "write_text", "write_bytes", "mkdir")), (os, ("fsync", "open"))):
        for name in names:
            setattr(owner, name, counted(getattr(owner, name)))
    second(folder)
    os._exit(0)


def test_a_save_that_is_killed_at_any_operation_leaves_the_old_twin_or_the_new(tmp_path):
    for operation in range(99):
        folder = tmp_path / f"{operation}"
        first(folder)
        process = FORK.Process(target=stopped_at, args=(operation, folder))
        process.start()
        process.join(20)
        twin = Twin.load(folder)
        changes = [e["change"] for e in twin.history]
        assert changes in (["first"], ["first", "second"])
        assert (twin.arrays["rest_image"] == len(changes) - 1).all()
        for number in range(len(changes)):
            old = files.read_yaml(folder / "history" / f"{number:03d}" / "twin.yaml")
            assert len(old["history"]) == number + 1 and (folder / old["arrays"]).is_file()
        if process.exitcode == 0:
            break
        if changes == ["first"]:
            second(folder)
            assert len(Twin.load(folder).history) == 2
    assert 10 < operation < 98 and process.exitcode == 0


def test_nothing_takes_a_files_place_before_the_disk_holds_it(tmp_path, monkeypatch):
    first(tmp_path)
    done = []
    fsync, replace = os.fsync, Path.replace

    def noted_fsync(handle):
        done.append(("held", os.readlink(f"/proc/self/fd/{handle}")))
        fsync(handle)

    def noted_replace(part, file):
        done.append(("renamed", str(part), str(file)))
        return replace(part, file)

    monkeypatch.setattr(os, "fsync", noted_fsync)
    monkeypatch.setattr(Path, "replace", noted_replace)
    second(tmp_path)
    renamed = [i for i, d in enumerate(done) if d[0] == "renamed"]
    assert Path(done[renamed[-1]][2]) == tmp_path / "twin.yaml" and len(renamed) == 4
    for i in renamed:
        assert done[i - 1] == ("held", done[i][1])
        assert done[i + 1] == ("held", str(Path(done[i][2]).parent))


def save_many(folder, name) -> None:
    kept = 0
    while kept < 12:
        try:
            Twin.load(folder).save_version(folder, f"{name} {kept}", "bench", {})
            kept += 1
        except InputError as e:
            assert "changed by another process" in str(e)


def test_of_two_processes_that_save_none_loses_a_version(tmp_path):
    first(tmp_path)
    processes = [FORK.Process(target=save_many, args=(tmp_path, name)) for name in "ab"]
    for process in processes:
        process.start()
    for process in processes:
        process.join(60)
        assert process.exitcode == 0
    history = Twin.load(tmp_path).history
    assert sorted(e["change"] for e in history) == sorted(
        ["first", *(f"{n} {k}" for n in "ab" for k in range(12))]
    )
    assert [e["version"] for e in history] == list(range(25))


def test_a_full_disk_is_one_sentence_and_leaves_nothing_behind(tmp_path, monkeypatch):
    first(tmp_path)
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}

    def full(*args):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InputError, match="No space is left to write .*; free some and repeat"):
        second(tmp_path)
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before


def mutated(lines: list[str], rng: random.Random) -> str:
    lines = list(lines)
    for _ in range(rng.randint(1, 3)):
        at = rng.randrange(len(lines))
        line = lines[at]
        cut = rng.randrange(len(line) + 1)
        lines[at] = rng.choice(
            (
                f"{line.split(':')[0]}: {rng.choice(TOKENS)}",
                line[:cut] + rng.choice(TOKENS) + line[cut:],
                line[:cut] + line[cut + 1 :],
                f"{line}\n{rng.choice(lines)}",
                "  " * rng.randrange(4) + line.strip(),
            )
        )
    return "\n".join(lines)


@pytest.mark.parametrize("number", [150, pytest.param(10_000, marks=pytest.mark.nightly)])
def test_a_damaged_twin_is_read_or_refused_in_a_sentence(tmp_path, number):
    lines = (SAVED / "twin.yaml").read_text().splitlines()
    arrays = tmp_path / "arrays.safetensors"
    arrays.write_bytes((SAVED / arrays.name).read_bytes())
    rng, refused = random.Random(5), 0
    for _ in range(number):
        (tmp_path / "twin.yaml").write_text(mutated(lines, rng))
        try:
            twin = Twin.load(tmp_path)
            Pipeline.of(twin).theta(twin)
            GelModel.from_twin(twin)
        except InputError as e:
            refused += 1
            assert 20 < len(str(e)) < 400 and "\n" not in str(e)
    assert 0.3 * number < refused < number


def test_yaml_has_limits(tmp_path):
    file = tmp_path / "twin.yaml"
    for text, why in (
        ("a: " + "[" * 5000, "nested too deeply|not valid YAML"),
        ("a: &x [1]\nb: *x", "aliases are not read"),
        ("a: " + "1" * 2**20, "larger than"),
    ):
        file.write_text(text)
        with pytest.raises(InputError, match=why):
            Twin.load(tmp_path)


def test_what_a_twin_holds_twice_is_written_twice_and_read_again(tmp_path):
    twin, errors = Twin.builtin(), {"train": 1.0}
    twin.save_version(tmp_path, "first", "bench", {"by": errors, "again": errors})
    twin.save_version(tmp_path, "second", "bench", {"by": errors})
    assert Twin.load(tmp_path).history == twin.history
