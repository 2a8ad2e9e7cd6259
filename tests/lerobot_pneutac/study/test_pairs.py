"""Terms that only help together are tried as a pair."""

import numpy as np

from lerobot_pneutac.study import study_of
from lerobot_pneutac.study.body_base import base_effects
from lerobot_pneutac.study.body_model import BodyFitter, InputModel
from lerobot_pneutac.study.body_space import BodySpace
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.twin import Twin
from pneutac_truths.truth import generate, write


def test_a_weight_and_a_payload_that_bend_a_finger_sideways_are_tried_together(tmp_path):
    # Three of eight trials lie on their side, each under another load: one sideways law alone predicts the
    # later of them worse than none.
    truth = generate("rod", ["gravity_and_payload"], 16843, minutes=6)
    recording = Recording.load(write(truth, tmp_path / "recording"))
    twin = Twin("finger", recording.length_mm)
    study = study_of(twin, recording, 16843)
    fitter = BodyFitter(study.recording, twin, np.flatnonzero(study.parts.learnt)[::4])
    space = BodySpace(fitter, base_effects(study), [study.joints], study.candidates, ((),), InputModel())
    model = space.fit(space.bases()[0], 12)
    pair = {"tip_y += g_y", "tip_y += m g_y"}
    tried = [
        set(structure.effects) - set(model.structure.effects) for structure, _ in space.grow(model, 12, 4)
    ]
    assert pair in tried
