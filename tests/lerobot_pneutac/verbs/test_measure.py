"""`pneutac measure`: tip poses from rendered markers, camera calibration, what an end keeps."""

import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
from lerobot.cameras import Camera, CameraConfig
from lerobot.cameras import utils as camera_utils
from verbs import refused, verb

from lerobot_pneutac.cli import run_verb
from lerobot_pneutac.measuring import DICTIONARY, Intrinsics, MarkerTracker, calibrate_camera
from lerobot_pneutac.verbs import measure as library
from lerobot_pneutac.verbs.compare import compare as compare_library
from lerobot_pneutac.verbs.new import new_twin
from lerobot_robot_pneutac.hardware import pressure as pressure_module
from lerobot_robot_pneutac.hardware.simulated import SimulatedPressure
from pneutac_datasets.recording.axes import command_columns, measured_columns
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError

SIZE = (640, 480)
K = np.array([[900.0, 0, 320], [0, 900.0, 240], [0, 0, 1]])
DISTORTION = np.array([0.05, -0.1, 0.001, -0.001, 0.0])
LENGTH, MARKER, OFFSET = 110.0, 14.0, np.array([-8.0, -2.0, 3.0])
# The camera looks along y of the base frame from 330 mm away, a little askew: x to the right, z upwards.
TURN = cv2.Rodrigues(np.array([0.12, -0.2, 0.1]))[0] @ np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
SHIFT = np.array([-55.0, 20.0, 330.0])
FACE = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # a marker's axes in the base frame, facing -y


def paste(image, picture, side_mm, centre_mm, turn):
    """Draws a square picture (n, n) whose frame is `turn` (marker to base) at a centre in the base frame."""
    h = side_mm / 2
    corners = np.array([[-h, h, 0], [h, h, 0], [h, -h, 0], [-h, -h, 0]]) @ turn.T + centre_mm
    seen, _ = cv2.projectPoints(corners, cv2.Rodrigues(TURN)[0], SHIFT, K, DISTORTION)
    n = len(picture) - 0.5
    source = np.array([[-0.5, -0.5], [n, -0.5], [n, n], [-0.5, n]], np.float32)
    H = cv2.getPerspectiveTransform(source, seen.reshape(4, 2).astype(np.float32))
    warped = cv2.warpPerspective(picture, H, (image.shape[1], image.shape[0]), flags=cv2.INTER_AREA)
    inside = cv2.warpPerspective(np.full_like(picture, 255), H, (image.shape[1], image.shape[0]))
    image[:] = (image * (1 - inside / 255.0) + warped * (inside / 255.0)).astype(np.uint8)


def marker(number):
    """Marker with a white border, and its side in units of the black square's."""
    dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARY)
    return cv2.copyMakeBorder(
        dictionary.generateImageMarker(number, 120), *[20] * 4, cv2.BORDER_CONSTANT, value=255
    )


def tip_at(kpa):
    """Tip (3,) mm and its turn in the bending plane, a constant curvature of 0.08 rad/kPa."""
    a = max(0.08 * kpa, 1e-6)
    return LENGTH / a * np.array([np.sin(a), 0, 1 - np.cos(a)]), a


def picture(kpa, seed=0):
    """What the camera sees, RGB (480, 640, 3), with 2 levels of noise and a soft lens."""
    image = np.full((3 * SIZE[1], 3 * SIZE[0]), 190, np.uint8)
    tip, a = tip_at(kpa)
    bend = np.array([[np.cos(a), 0, -np.sin(a)], [0, 1, 0], [np.sin(a), 0, np.cos(a)]])
    with Fine():
        paste(image, marker(0), MARKER * 160 / 120, OFFSET, FACE)
        paste(image, marker(1), MARKER * 160 / 120, tip, bend @ FACE)
    image = cv2.resize(cv2.GaussianBlur(image, (0, 0), 1.5), SIZE, interpolation=cv2.INTER_AREA)
    noisy = image + np.random.default_rng(seed).normal(0, 2, image.shape)
    return np.repeat(np.clip(noisy, 0, 255).astype(np.uint8)[..., None], 3, axis=2)


class Fine:
    """Within it, K is that of an image three times as fine."""

    def __enter__(self):
        self.k = K.copy()
        K[:2, :2] *= 3
        K[:2, 2] = 3 * (K[:2, 2] + 0.5) - 0.5

    def __exit__(self, *_):
        K[:] = self.k


def intrinsics():
    return Intrinsics(K.copy(), DISTORTION, SIZE, 0.1)


@CameraConfig.register_subclass("bench_rendered")
@dataclass(kw_only=True)
class BenchRenderedConfig(CameraConfig):
    fps: int = 30
    width: int = SIZE[0]
    height: int = SIZE[1]


class Clock:
    """In place of the module `time`: it moves only when one sleeps, so that no busy computer is late."""

    def __init__(self):
        self.now_s = 0.0

    def monotonic(self):
        return self.now_s

    def sleep(self, seconds):
        self.now_s += seconds


class BenchRendered(Camera):
    """Sees a finger that follows the pressure in the chamber; writes down the true tips."""

    chamber: SimulatedPressure
    clock: Clock
    truth: list
    ends: BaseException | None = None
    ends_after = 10**9

    def __init__(self, config):
        super().__init__(config)
        self.is_open = False

    @property
    def is_connected(self):
        return self.is_open

    @staticmethod
    def find_cameras():
        return []

    def connect(self, warmup=True):
        self.is_open = True

    def read(self):
        return self.async_read()

    def async_read(self, timeout_ms=200):
        cls = BenchRendered
        if len(cls.truth) >= cls.ends_after:
            raise cls.ends
        cls.clock.sleep(0.01)
        kpa = round(cls.chamber.pressure(), 1)  # few pictures, each drawn once
        cls.truth.append(tip_at(kpa)[0])
        if kpa not in PICTURES:
            PICTURES[kpa] = picture(kpa)
        return PICTURES[kpa]

    def disconnect(self):
        self.is_open = False


PICTURES: dict = {}


@pytest.fixture
def bench(tmp_path, monkeypatch):
    """Options of a run on simulated parts."""
    BenchRendered.clock = clock = Clock()
    monkeypatch.setattr(library, "time", clock)
    BenchRendered.chamber = SimulatedPressure(time_constant_s=0.05, clock=clock.monotonic)
    BenchRendered.truth, BenchRendered.ends, BenchRendered.ends_after = [], None, 10**9
    monkeypatch.setattr(pressure_module, "make_pressure_controller", lambda type, **_: BenchRendered.chamber)
    make = camera_utils.make_device_from_device_class
    monkeypatch.setattr(
        camera_utils,
        "make_device_from_device_class",
        lambda config: BenchRendered(config) if isinstance(config, BenchRenderedConfig) else make(config),
    )
    intrinsics().save(tmp_path / "camera.json")
    rows = [(n, t, p) for n in range(3) for t, p in ((0, 0), (0.3, 4.0), (0.8, 9.0), (1.3, 9.0))]
    table = pd.DataFrame(rows, columns=["trial", "time_s", "pressure_cmd_kpa"])
    table.to_csv(tmp_path / "stairs.csv", index=False)
    return [
        "--pressure.type=simulated",
        "--camera.type=bench_rendered",
        f"--intrinsics={tmp_path / 'camera.json'}",
        f"--program={tmp_path / 'stairs.csv'}",
        f"--out={tmp_path / 'run'}",
        f"--length_mm={LENGTH}",
        f"--marker_mm={MARKER}",
        f"--base_offset_mm={OFFSET.tolist()}",
        "--rest_s=0.3",
    ]


# ---------------------------------------------------------------- where the tip is


def test_tip_poses_agree_with_the_truth_to_a_fraction_of_a_millimetre():
    tracker = MarkerTracker(intrinsics(), MARKER, 0, 1, OFFSET)
    tracker.see_base([picture(0.0, seed) for seed in range(6)])
    pressures = np.linspace(0, 12, 9)
    error = np.array([tracker.tip_mm(picture(p, 7)) - tip_at(p)[0] for p in pressures])
    in_plane = np.linalg.norm(error[:, [0, 2]], axis=1)
    assert in_plane.max() < 0.3, in_plane
    assert np.sqrt((in_plane**2).mean()) < 0.1
    assert np.abs(error[:, 1]).max() < 1.0  # along the line of sight
    true = np.eye(4)
    true[:3, :3], true[:3, 3] = TURN, SHIFT / 1000
    assert np.abs(tracker.extrinsics() - true)[:3, 3].max() < 0.001
    assert tracker.tip_mm(np.full((480, 640, 3), 128, np.uint8)) is None


def test_a_marker_at_the_pictures_border_is_right_or_not_seen():
    tracker = MarkerTracker(Intrinsics(K, np.zeros(5), SIZE, 0.1), MARKER, 0, 1, np.zeros(3))
    side_px = marker(1).shape[0] * 48 / 120
    seen = 0
    for degrees in range(1, 90, 8):
        a = np.radians(degrees)
        turn = np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]])
        for x in np.arange(14.0, 40.0, 1.0):
            place = (np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * side_px / 2 @ turn + [x, 240]).astype(
                "f4"
            )
            n = marker(1).shape[0]
            corners = np.array([[0, 0], [n, 0], [n, n], [0, n]], "f4") - 0.5
            H = cv2.getPerspectiveTransform(corners, place)
            image = cv2.warpPerspective(marker(1), H, SIZE, flags=cv2.INTER_AREA, borderValue=190)
            found = tracker._corners(np.repeat(image[..., None], 3, axis=2), 1)
            if found is None:
                continue
            seen += 1
            dark = np.array([[20, 20], [140, 20], [140, 140], [20, 140]], "f4")[None] - 0.5
            true = cv2.perspectiveTransform(dark, H)[0]
            assert np.abs(found - true).max() < 3
    assert seen > 50


def test_a_base_marker_that_is_not_seen_and_a_wrong_size_are_named():
    tracker = MarkerTracker(intrinsics(), MARKER, 5, 1, OFFSET)
    with pytest.raises(InputError, match="base marker 5 is seen in 0 of 1"):
        tracker.see_base([picture(0.0)])
    with pytest.raises(InputError, match="320 x 240"):
        tracker.see_base([np.zeros((240, 320, 3), np.uint8)])


def chessboard(path, poses):
    board = np.full((8 * 40, 11 * 40), 255, np.uint8)
    for i in range(7):
        for j in range(10):
            if (i + j) % 2 == 0:
                board[20 + 40 * i : 60 + 40 * i, 20 + 40 * j : 60 + 40 * j] = 0
    mm = 20 / 40
    corners = np.array([[0, 0], [11, 0], [11, 8], [0, 8]], float) * 20
    corners = np.c_[corners - [110, 80], np.zeros(4)]
    source = (corners[:, :2] + [110, 80]) / mm - 0.5
    path.mkdir()
    for k, (turn, shift) in enumerate(poses):
        seen, _ = cv2.projectPoints(corners, np.array(turn, float), np.array(shift, float), K, None)
        H = cv2.getPerspectiveTransform(source.astype(np.float32), seen.reshape(4, 2).astype(np.float32))
        image = cv2.warpPerspective(board, H, SIZE, flags=cv2.INTER_AREA, borderValue=255)
        cv2.imwrite(str(path / f"{k:02d}.png"), cv2.GaussianBlur(image, (0, 0), 0.7))


@pytest.mark.slow
def test_a_chessboard_gives_the_camera_back(tmp_path, capsys):
    rng = np.random.default_rng(2)
    poses = [
        (rng.uniform(-0.5, 0.5, 3), [*rng.uniform(-25, 25, 2), rng.uniform(450, 700)]) for _ in range(12)
    ]
    chessboard(tmp_path / "board", poses)
    file = tmp_path / "camera.json"
    verb("measure", chessboard=tmp_path / "board", intrinsics=file)
    found = Intrinsics.load(file)
    np.testing.assert_allclose(found.matrix, K, rtol=0.01, atol=6)
    assert found.size_px == SIZE and found.rms_px < 0.2
    assert "12 photographs" in " ".join(capsys.readouterr().out.split())
    for photograph in sorted((tmp_path / "board").iterdir())[2:]:
        photograph.unlink()
    with pytest.raises(InputError, match="whole in 2 of 2 photographs; 8 are needed"):
        calibrate_camera(tmp_path / "board", (9, 6), 20.0)
    file.write_text("{}")
    with pytest.raises(InputError, match="no camera calibration"):
        Intrinsics.load(file)


# ---------------------------------------------------------------- a run


@pytest.mark.slow
def test_a_run_is_a_recording_with_true_tips_that_compare_accepts(bench, tmp_path):
    verb("measure", *bench, "--digit.type=digit_generated")
    r = Recording.load(tmp_path / "run")
    assert r.device == "finger" and r.length_mm == LENGTH and not r.warnings
    assert len(r.trials()) == 3
    tips = np.stack([r.column(f"tip_{a}_mm") for a in "xyz"], axis=1)
    truth = np.array(BenchRendered.truth[library.BASE_IMAGES :])
    error = np.linalg.norm((tips - truth)[:, [0, 2]], axis=1)
    assert error.max() < 0.3
    assert r.column("pressure_kpa").max() == pytest.approx(9.0, abs=0.5)
    np.testing.assert_array_equal(np.unique(r.column("pressure_cmd_kpa")), [0, 4, 9])
    assert r.image(r.column("image_tactile")[5]).shape == (320, 240, 3)
    assert r.image(r.column("image_camera")[5]).shape == (480, 640, 3)
    assert BenchRendered.chamber._target_kpa == 0.0
    sent, t = r.column("time_sent_s"), r.column("time_s")
    for rows in r.trials().values():
        assert (sent[rows] <= t[rows]).all() and (sent[rows][1:] >= t[rows][:-1]).all()
        at = sent[rows] - np.round(sent[rows] * 15) / 15  # each just after the program's grid of 15 Hz
        assert np.median(np.abs(at)) < 0.02
    assert [s.start for s in r.starts.values()] == ["unknown", "continues", "continues"]
    assert all(0.3 <= r.starts[k].pause_s < 0.6 for k in (1, 2))

    verb("new", twin=tmp_path / "twin", recording=tmp_path / "run")
    verb("compare", twin=tmp_path / "twin", recording=tmp_path / "run", out=tmp_path / "c")
    assert json.loads((tmp_path / "c/result.json").read_text())["unit"] == "mm"


@pytest.mark.slow
def test_three_chambers_on_three_controllers_are_an_arm(bench, tmp_path, monkeypatch):
    parts = {
        port: SimulatedPressure(12.0, time_constant_s=0.05, clock=BenchRendered.clock.monotonic)
        for port in ("/a", "/b", "/c")
    }
    BenchRendered.chamber.connect()  # which stays empty: one picture, drawn once
    monkeypatch.setattr(pressure_module, "make_pressure_controller", lambda type, port, **_: parts[port])
    columns = command_columns(3)
    rows = [(0, t, *p) for t, p in ((0, (0, 0, 0)), (0.3, (4, 0, 8)), (1.5, (9, 6, 3)), (3, (0, 0, 0)))]
    pd.DataFrame(rows, columns=["trial", "time_s", *columns]).to_csv(tmp_path / "stairs.csv", index=False)
    verb("measure", *bench, "--pressure.ports=/a,/b,/c", "--max_kpa=10,8,9")
    r = Recording.load(tmp_path / "run")
    assert r.device == "arm" and r.pressure_columns == columns
    np.testing.assert_allclose(r.samples[columns].max(), [9, 6, 8])
    assert (r.samples[measured_columns(3)].max() > [5, 3, 5]).all()
    assert [p._target_kpa for p in parts.values()] == [0.0, 0.0, 0.0]
    with pytest.raises(InputError, match="to 8 kPa in chamber 3; --min_kpa and --max_kpa allow 0 to 7"):
        verb(
            "measure",
            *bench[:4],
            f"--out={tmp_path / 'b'}",
            *bench[5:],
            "--pressure.ports=/a,/b,/c",
            "--max_kpa=10,8,7",
        )


def test_the_stand_in_answers_a_program_of_three_chambers(tmp_path):
    columns = command_columns(3)
    t = np.arange(0, 6, 0.1)
    table = pd.DataFrame({"time_s": t} | {c: 20 * (1 + np.sin(t + i)) for i, c in enumerate(columns)})
    table.to_csv(tmp_path / "p.csv", index=False)
    options = ["--bench=standin", f"--program={tmp_path / 'p.csv'}", "--max_kpa=40", "--repeat=2"]
    verb("measure", *options, f"--out={tmp_path / 'r'}")
    r = Recording.load(tmp_path / "r")
    assert r.device == "arm" and len(r.trials()) == 2 and r.pressure_columns == columns
    np.testing.assert_allclose(r.samples[columns].max(), table[columns].max(), rtol=0.01)
    assert 0 < compare_library(new_twin("arm", r), r).heldout < 100
    with pytest.raises(InputError, match=r"in chamber 1; --min_kpa and --max_kpa allow 0 to 15"):
        verb("measure", *options[:2], f"--out={tmp_path / 's'}")
    with pytest.raises(InputError, match="'steps' leaves 0 to 65.2 kPa, the range of the stand-in"):
        verb("measure", bench="standin", program="steps", max_kpa="70,20,20", out=tmp_path / "s")


@pytest.mark.slow
def test_a_command_whose_picture_was_lost_keeps_the_time_at_which_it_was_sent(bench, tmp_path, monkeypatch):
    seen, unseen = library.MarkerTracker.tip_mm, []

    def hidden(self, image):
        if not unseen and BenchRendered.chamber._target_kpa == 4.0:  # the step's first picture
            unseen.append(image)
            return None
        return seen(self, image)

    monkeypatch.setattr(library.MarkerTracker, "tip_mm", hidden)
    run_verb("measure", bench)
    r = Recording.load(tmp_path / "run")
    sent, t = r.column("time_sent_s"), r.column("time_s")
    after = int(np.argmax(r.column("pressure_cmd_kpa") == 4.0))
    assert unseen and t[after] - sent[after] > 0.9 / 15 and sent[after] >= t[after - 1]


@pytest.mark.slow
def test_a_trial_after_one_that_was_never_seen_starts_unknown(bench, tmp_path, monkeypatch):
    run, seen, driven = library.BenchDriver.drive, library.MarkerTracker.tip_mm, []

    def drive(self, number, trial):
        driven.append(number)
        return run(self, number, trial)

    monkeypatch.setattr(library.BenchDriver, "drive", drive)
    monkeypatch.setattr(
        library.MarkerTracker, "tip_mm", lambda self, i: None if driven[-1:] == [1] else seen(self, i)
    )
    run_verb("measure", bench)
    r = Recording.load(tmp_path / "run")
    assert {k: s.start for k, s in r.starts.items()} == {0: "unknown", 2: "unknown"}


@pytest.mark.slow
@pytest.mark.parametrize("end", [KeyboardInterrupt(), OSError("unplugged")])
def test_an_end_within_a_trial_keeps_those_before_it_and_vents(bench, tmp_path, monkeypatch, end):
    run, taken = library.BenchDriver.drive, []

    def ends_in_the_third(self, number, trial):
        if number == 2:
            BenchRendered.ends, BenchRendered.ends_after = end, len(BenchRendered.truth) + 1
        taken.append(run(self, number, trial)[0])
        return taken[-1], taken[-1]

    monkeypatch.setattr(library.BenchDriver, "drive", ends_in_the_third)
    with pytest.raises(KeyboardInterrupt if isinstance(end, KeyboardInterrupt) else InputError):
        run_verb("measure", bench)
    r = Recording.load(tmp_path / "run")
    assert list(r.trials()) == [0, 1] and len(r) == sum(taken)
    assert sorted(p.name for p in (tmp_path / "run/images").iterdir()) == ["trial_000", "trial_001"]
    assert BenchRendered.chamber._target_kpa == 0.0
    assert not BenchRendered.chamber._connected


@pytest.mark.slow
def test_ctrl_c_just_after_a_trial_came_into_the_table_keeps_its_pictures(bench, tmp_path, monkeypatch):
    replace = Path.replace

    def pressed(self, target):
        replace(self, target)
        if self.name == "samples.csv":
            raise KeyboardInterrupt

    monkeypatch.setattr(Path, "replace", pressed)
    with pytest.raises(KeyboardInterrupt):
        run_verb("measure", bench)
    r = Recording.load(tmp_path / "run")
    assert list(r.trials()) == [0]
    assert r.image(r.column("image_camera")[-1]).shape == (480, 640, 3)


@pytest.mark.slow
def test_a_slow_camera_costs_samples_and_not_the_programs_pace(bench, tmp_path, monkeypatch, capsys):
    read = BenchRendered.async_read

    def slow(self, timeout_ms=200):
        BenchRendered.clock.sleep(0.2)
        return read(self)

    monkeypatch.setattr(BenchRendered, "async_read", slow)
    run_verb("measure", bench)
    r = Recording.load(tmp_path / "run")
    assert len(r) < 0.5 * 3 * 21
    late = r.column("time_s")[r.column("trial") == 1].max() - 1.3
    assert late < 2.0  # 21 samples of 0.2 s each would end 2.9 s late
    assert "samples are missing" in " ".join(capsys.readouterr().out.split())


def test_a_camera_that_cannot_be_opened_is_one_sentence(bench, monkeypatch):
    def connect(self, warmup=True):
        raise ConnectionError("No device at 0.")

    monkeypatch.setattr(BenchRendered, "connect", connect)
    with pytest.raises(InputError, match="The camera 'camera' cannot be opened: No device at 0."):
        run_verb("measure", bench)


def test_an_end_within_the_first_trial_leaves_nothing(bench, tmp_path):
    BenchRendered.ends, BenchRendered.ends_after = KeyboardInterrupt(), library.BASE_IMAGES + 3
    with pytest.raises(KeyboardInterrupt):
        run_verb("measure", bench)
    assert not (tmp_path / "run").exists()


def test_a_pressure_far_above_the_program_ends_the_run(bench, monkeypatch):
    true = SimulatedPressure.pressure
    monkeypatch.setattr(
        SimulatedPressure, "pressure", lambda self: true(self) + 30 * (BenchRendered.chamber._target_kpa > 3)
    )
    with pytest.raises(InputError, match="pressure reads"):
        run_verb("measure", bench)
    assert BenchRendered.clock.now_s < 5
    assert BenchRendered.chamber._target_kpa == 0.0


@pytest.mark.parametrize(
    ("option", "said"),
    [
        ("--hz=2", "hz is 2; give 8 to 1000"),
        ("--program=dance", "neither a file nor one of"),
        ("--intrinsics=/nowhere.json", "no camera calibration"),
    ],
)
def test_bad_options_are_one_sentence(bench, option, said):
    refused(said, "measure", *bench, option)
