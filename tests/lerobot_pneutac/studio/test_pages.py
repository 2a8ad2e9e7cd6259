"""The pages without a browser: every effect, an arm, a passage that is jumped to."""

import shutil
import time
from pathlib import Path

import numpy as np
import pytest

from lerobot_pneutac.studio.app import Studio
from lerobot_pneutac.studio.session import Session
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.twin import Twin, Value

GOLDEN = Path(__file__).parents[2] / "golden" / "recordings"


@pytest.fixture
def opened():
    studios = []

    def open_one(*session):
        studios.append(Studio(Session(*session), port=0))
        return studios[-1]

    yield open_one
    for studio in studios:
        studio.close()


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
    assert studio.said.content == "" and page.step(0.1).bend_deg > 40


def test_a_load_whose_effect_is_off_is_told(opened, tmp_path):
    studio = opened(Twin.builtin().save(tmp_path / "finger"), None)
    page = studio.pages["Device"]
    page._payload.value = 100.0
    studio.safely(page._surroundings)()
    assert "`payload`, which is off" in studio.said.content


def test_an_arm_opens_and_its_worst_passage_is_jumped_to(opened, tmp_path):
    recording = shutil.copytree(GOLDEN / "arm_creep", tmp_path / "bench")
    told = Recording.load(recording)
    twin = Twin("arm", told.length_mm, told.spine_joint_positions_mm)
    twin.parameters = {"gain_rad_per_kpa": Value(0.01), "joint_stiffness_nm_per_rad": Value(1.0)}
    studio = opened(twin.save(tmp_path / "arm"), recording)
    page = studio.pages["Measurement"]
    for _ in range(200):
        if page.readout.content.startswith("**Off by"):
            break
        time.sleep(0.05)
    worst = studio.session.comparison.worst[0]
    page.jump(worst)
    assert f"in trial {worst['trial']} at {worst['from_s']:.2f} s" in page.readout.content
    assert len(studio.pages["Device"]._pressures) == 3


@pytest.mark.slow
def test_a_world_is_played_by_the_expert_and_moved_by_hand(opened, tmp_path):
    page = opened(Twin.builtin().save(tmp_path / "finger"), None).pages["World"]
    page._hold("up")
    page._pressure.value = 5.0
    np.testing.assert_allclose(page.action(), [0, 0, 0.05, 5.0])
    page.begin()
    for _ in range(600):
        if "s of the task" in page.readout.content:
            break
        time.sleep(0.05)
    assert page.readout.content.startswith("switch, ") and np.ptp(page._picture.image) > 100
