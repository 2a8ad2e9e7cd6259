"""Files are written whole or not at all.

The bounded least squares against closed forms.
"""

import errno
import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pneutac_sim.errors import InputError
from pneutac_sim.files import LOCK, locked, read_image, together, whole, write_image, write_json, write_text
from pneutac_sim.least_squares import minimise


def test_a_file_takes_its_place_when_it_is_finished(tmp_path):
    file = tmp_path / "a.json"
    with whole(file) as part:
        part.write_text("1")
        assert not file.exists()
    assert file.read_text() == "1" and list(tmp_path.iterdir()) == [file]


def test_what_was_there_stays_where_the_writing_stops(tmp_path):
    file = tmp_path / "a.json"
    file.write_text("old")
    with pytest.raises(KeyboardInterrupt), whole(file) as part:
        part.write_text("ne")
        raise KeyboardInterrupt
    assert file.read_text() == "old"


def held(folder):
    return {str(p.relative_to(folder)): p.read_text() for p in folder.rglob("*") if p.suffix}


def earlier(folder):
    (folder / "twin").mkdir(parents=True)
    for name in ("page.txt", "gone.txt", "mine.txt", "twin/a.txt", "twin/b.txt"):
        (folder / name).write_text("old")
    return held(folder)


def write_anew(part):
    (part / "twin").mkdir()
    (part / "page.txt").write_text("new")
    (part / "twin" / "a.txt").write_text("new")


NEW = {"page.txt": "new", "twin/a.txt": "new", "mine.txt": "old"}


def test_what_belongs_together_takes_its_place_together(tmp_path):
    before = earlier(tmp_path / "out")
    with together(tmp_path / "out", ["gone.txt", "twin"]) as part:
        write_anew(part)
        assert before.items() <= held(tmp_path / "out").items()
    assert held(tmp_path / "out") == NEW
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"page.txt", "twin", "mine.txt", LOCK}


def test_a_stop_while_it_is_written_leaves_what_was_there(tmp_path):
    before = earlier(tmp_path / "out")
    for folder in ("out", "new"):
        with pytest.raises(KeyboardInterrupt), together(tmp_path / folder, ["gone.txt"]) as part:
            write_anew(part)
            raise KeyboardInterrupt
    assert held(tmp_path / "out") == before and not (tmp_path / "new").exists()


@pytest.mark.parametrize("stop", range(4))
def test_a_stop_while_it_takes_its_place_leaves_what_is_new(tmp_path, monkeypatch, stop):
    """The old files and folders that go, and the new ones that come, are moved one by one."""
    earlier(tmp_path / "out")
    moves = {name: getattr(Path, name) for name in ("rename", "replace")}
    left = [stop]

    def stopped(name):
        def move(path, target):
            left[0] -= 1
            if left[0] == -1:
                raise KeyboardInterrupt
            return moves[name](path, target)

        return move

    with monkeypatch.context() as m, pytest.raises(KeyboardInterrupt):
        for name in moves:
            m.setattr(Path, name, stopped(name))
        with together(tmp_path / "out", ["gone.txt"]) as part:
            write_anew(part)
    assert held(tmp_path / "out") == NEW and left[0] == stop - 5  # one of the four moves is made twice


def test_who_writes_into_a_folder_may_lock_it_again(tmp_path):
    with locked(tmp_path, wait_s=0.0), together(tmp_path) as part:
        write_anew(part)
    assert held(tmp_path) == {"page.txt": "new", "twin/a.txt": "new"}


@pytest.mark.parametrize(
    "write",
    [
        lambda file: write_text(file.with_suffix(".html"), "new"),
        lambda file: write_json(file.with_suffix(".json"), {"new": 1}),
        lambda file: write_image(file.with_suffix(".png"), np.zeros((4, 5, 3), np.uint8)),
        lambda file: write_image(file.with_suffix(".jpg"), np.zeros((4, 5), np.uint8), quality=95),
    ],
)
def test_each_writer_leaves_the_old_file_where_the_disk_is_full(tmp_path, monkeypatch, write):
    def full(_):
        raise OSError(errno.ENOSPC, "full")

    write(tmp_path / "a")
    (file,) = tmp_path.iterdir()
    file.write_bytes(b"old")
    with monkeypatch.context() as m:
        m.setattr(os, "fsync", full)
        with pytest.raises(InputError, match=f"No space is left to write .*{file.name}"):
            write(tmp_path / "a")
    assert file.read_bytes() == b"old" and list(tmp_path.iterdir()) == [file]
    write(tmp_path / "a")
    assert file.read_bytes() != b"old"


def test_a_number_that_is_none_replaces_nothing(tmp_path):
    file = tmp_path / "a.json"
    write_json(file, {"a": 1.0})
    with pytest.raises(ValueError, match="JSON"):
        write_json(file, {"a": float("nan")})
    assert file.read_text() == '{\n "a": 1.0\n}\n'


@pytest.fixture
def linear():
    rng = np.random.default_rng(0)
    A, truth = rng.normal(size=(60, 4)), np.array([0.4, 0.6, 0.5, 0.45])
    return A, A @ truth + 0.1 * rng.normal(size=60)


def solve(A, b, start, **options):
    return minimise(lambda v: A @ v - b, lambda v: A, np.full(A.shape[1], start), **options)


def test_with_a_prior_it_is_ridge_regression(linear):
    A, b = linear
    centre = np.array([0.5, 0.5, 0.2, 0.8])
    W = np.diag([3.0, 30.0, 300.0, 0.0]) + 1.0
    expected = np.linalg.solve(A.T @ A + W, A.T @ b + W @ centre)
    assert ((expected > 0) & (expected < 1)).all()
    found = solve(A, b, 0.3, prior=(centre, W))
    np.testing.assert_allclose(found.v, expected, atol=1e-4)
    cost = ((A @ expected - b) ** 2).sum() + (expected - centre) @ W @ (expected - centre)
    assert found.cost == pytest.approx(cost, rel=1e-4)
    np.testing.assert_allclose(solve(A, b, 0.3).v, np.linalg.lstsq(A, b, rcond=None)[0], atol=1e-3)


def test_what_the_data_leave_open_stays_at_the_centre(linear):
    A, b = linear
    A = np.c_[A, np.zeros(60)]
    prior = (np.array([0.5, 0.5, 0.5, 0.5, 0.7]), np.diag([0.0, 0, 0, 0, 1.0]))
    assert solve(A, b, 0.3, prior=prior).v[4] == pytest.approx(0.7, abs=1e-4)
    assert solve(A, b, 0.3).v[4] == pytest.approx(0.3)


def test_bounds_hold_with_a_prior(linear):
    A, b = linear
    found = solve(A, b + A @ np.array([1.0, 0, 0, 0]), 0.3, prior=(np.full(4, 0.5), 0.1 * np.eye(4)))
    assert found.v[0] == 1.0 and ((found.v >= 0) & (found.v <= 1)).all()


@pytest.mark.parametrize(
    ("orientation", "refused"), [(None, False), (1, False), (6, True), (3, True), (99, False)]
)
@pytest.mark.parametrize("ending", ["jpg", "png"])
def test_a_picture_that_viewers_turn_is_refused(tmp_path, ending, orientation, refused):
    picture, file = Image.new("RGB", (6, 4)), tmp_path / f"ball.{ending}"
    exif = picture.getexif()
    if orientation is not None:
        exif[0x0112] = orientation
    picture.save(file, exif=exif)
    if not refused:
        assert read_image(file, plain=True).shape == (4, 6, 3)
        return
    with pytest.raises(InputError, match=rf"ball.{ending} is stored turned.*EXIF orientation {orientation}"):
        read_image(file)
