"""`pneutac diagnose` where trials differ: for a reason that is on record, or by a zero of their own."""

import numpy as np
import pytest

from lerobot_pneutac.verbs.diagnose import diagnose
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.twin import Twin
from pneutac_truths import generate, write

pytestmark = pytest.mark.slow


def found(truth, folder):
    recording = Recording.load(write(generate("rod", [truth], 12), folder / "day"))
    return diagnose(Twin("finger", recording.length_mm), recording, jobs=1)


@pytest.mark.nightly
def test_zeros_of_trials_do_not_swallow_weight_and_payload(tmp_path):
    """They are constant in each trial, so zeros explain them as well until a trial is left out."""
    d = found("gravity_and_payload", tmp_path)
    assert {"gravity", "payload"} <= set(d.selected)
    assert d.after["heldout"] < 0.4 * d.before["heldout"]


def test_a_marker_that_slips_is_told_with_its_moment_and_is_no_law(tmp_path):
    d = found("marker_slip", tmp_path)
    truth = generate("rod", ["marker_slip"], 12)
    at = int(np.linalg.norm(np.diff(truth.pose - truth.true_pose, axis=0), axis=1).argmax()) + 1
    (told,) = [f for f in d.study.findings if "slipped" in f]
    row = int(told.partition("rows from ")[2].split()[0])
    assert abs(row - 1 - at) <= 2
    assert (d.verdict, d.selected) == ("adequate", [])
    assert d.after["heldout"] < 1.2 * truth.noise_floor
