"""The pages without a browser: every effect, an arm, a passage that is jumped to."""

import shutil
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from arms import arm_twin
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.utils.constants import ACTION, OBS_STATE

from lerobot_pneutac.studio.app import Session, Studio
from lerobot_robot_pneutac.policy.configuration_pneutac_bc import PneutacBCConfig
from lerobot_robot_pneutac.policy.modeling_pneutac_bc import PneutacBCPolicy
from lerobot_robot_pneutac.policy.processor_pneutac_bc import make_pneutac_bc_pre_post_processors
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.finger import Pipeline
from pneutac_sim.twin import Twin, Value

GOLDEN = Path(__file__).parents[2] / "golden" / "recordings"


@pytest.fixture
def opened():
    studios = []

    def open_one(*session):
        studios.append(Studio(port=0))
        studios[-1].show(Session(*session))
        return studios[-1]

    yield open_one
    for studio in studios:
        studio.close()


def until(met, seconds=60):
    end = time.monotonic() + seconds
    while not met():
        assert time.monotonic() < end
        time.sleep(0.05)


def test_every_effect_bends_the_finger_or_leaves_it_and_none_breaks_the_page(opened, tmp_path):
    studio = opened(Twin.builtin().save(tmp_path / "finger"), None)
    page = studio.pages["Device"]
    page._pressures[0].value = 12.0
    for row in page._panel._rows:
        row._box.value = True
        page._rebuild()
        assert np.isfinite(page.step(0.1).markers).all(), row.effect.name
        row._box.value = False
    page._rebuild()
    assert studio.message.content == "" and page.step(0.1).bend_deg > 40


def test_a_load_whose_effect_is_off_is_told(opened, tmp_path):
    studio = opened(Twin.builtin().save(tmp_path / "finger"), None)
    page = studio.pages["Device"]
    page._payload.value = 100.0
    studio.safely(page._surroundings)()
    assert "`payload`, which is off" in studio.message.content


def arm(recording: Path, folder: Path) -> Path:
    told = Recording.load(recording)
    twin = Twin("arm", told.length_mm, told.spine_joint_positions_mm)
    twin.parameters = {"gain_rad_per_kpa": Value(0.01), "joint_stiffness_nm_per_rad": Value(1.0)}
    model = Pipeline.of(twin)
    twin = model.update(twin, model.theta(twin))  # the other parameters at their defaults
    return twin.save(folder)


def test_an_arm_opens_and_its_worst_passage_is_jumped_to(opened, tmp_path):
    recording = shutil.copytree(GOLDEN / "arm_creep", tmp_path / "bench")
    studio = opened(arm(recording, tmp_path / "arm"), recording)
    page = studio.pages["Measurement"]
    until(lambda: page.readout.content.startswith("**Off by"))
    worst = studio.session.comparison.worst[0]
    page.jump(worst)
    assert f"in trial {worst['trial']} at {worst['from_s']:.2f} s" in page.readout.content
    assert len(studio.pages["Device"]._pressures) == 3


class Bench:
    """Answers every program with the recording that it has."""

    pause_s = 12.0

    def follow(self, program, out, number):
        assert program.read_text().startswith("time_s,pressure_cmd_kpa,program")
        return Recording.load(shutil.copytree(GOLDEN / "arm_creep", out))


def test_what_the_bench_measures_is_weighed_from_then_on_and_only_the_button_writes(opened, tmp_path):
    recording = shutil.copytree(GOLDEN / "arm_creep", tmp_path / "bench")
    studio = opened(arm(recording, tmp_path / "arm"), recording, "", "", Bench())
    before, panel = studio.session.recording, studio.pages["Find it"].experiment
    studio.safely(panel.drive)()
    assert "Choose a program first" in studio.message.content
    program = SimpleNamespace(name="steps", seconds=2.0, kind="steps", conditions={})
    program.time_s, program.pressure_kpa = np.array([0.0, 1.0]), np.array([0.0, 5.0])
    panel._design, panel._out.value = SimpleNamespace(best=program), str(tmp_path / "next")
    assert not (tmp_path / "next").exists()
    panel.drive()
    until(lambda: "weighed with the recording" in studio.message.content)
    both = studio.session.recording
    assert (
        len(both) == 2 * len(before)
        and both.folder == before.folder
        and len(Recording.load(recording)) == len(before)
    )
    assert both.meta["trials"][str(len(before.trials()))] == {"start": "continues", "pause_s": 12.0}
    assert "and 1 measured here" in studio.title.content
    until(lambda: not studio.session.working)
    studio.safely(panel.drive)()
    assert "is not empty; give a new one" in studio.message.content


@pytest.mark.slow
def test_a_world_is_played_by_the_expert_and_moved_by_hand(opened, tmp_path):
    page = opened(Twin.builtin().save(tmp_path / "finger"), None).pages["World"]
    page._hold("up")
    page._pressures[0].value = 5.0
    np.testing.assert_allclose(page.action(), [0, 0, 0.05, 5.0])
    page.begin()
    until(lambda: "s of the task" in page.readout.content)
    assert page.readout.content.startswith("switch, ") and np.ptp(page._picture.image) > 100


@pytest.mark.slow
def test_a_body_of_three_chambers_has_three_sliders_and_moves_in_the_world(opened, tmp_path):
    page = opened(arm_twin().save(tmp_path / "body"), None).pages["World"]
    page._pressures[1].value = 20.0
    page._press(1)
    np.testing.assert_allclose(page.action(), [0, 0, 0, 1.0, 21.0, 1.0])
    page.begin()
    until(lambda: "s of the task" in page.readout.content)
    assert page.readout.content.startswith("switch, ") and np.ptp(page._picture.image) > 100


@pytest.mark.nightly
def test_a_policy_moves_the_world_and_what_is_none_is_told(opened, tmp_path):
    state, action = PolicyFeature(FeatureType.STATE, (20,)), PolicyFeature(FeatureType.ACTION, (4,))
    features = {"input_features": {OBS_STATE: state}, "output_features": {ACTION: action}}
    policy = PneutacBCPolicy(PneutacBCConfig(device="cpu", use_tactile=False, **features))
    for part in (policy, *make_pneutac_bc_pre_post_processors(policy.config)):
        part.save_pretrained(tmp_path / "policy")
    page = opened(Twin.builtin().save(tmp_path / "finger"), None, tmp_path / "policy").pages["World"]
    page._player.value = "a policy"
    page.begin()
    until(lambda: " s of the task" in page.readout.content)
    page._policy.value = str(tmp_path)
    page.begin()
    until(lambda: "there is no config.json" in page.readout.content)
