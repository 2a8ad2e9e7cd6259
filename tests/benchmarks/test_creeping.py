"""Creep of another form than ours, on a face and under a light that are not ours either."""

from dataclasses import replace

import numpy as np
import pytest

from lerobot_pneutac import Recording
from lerobot_pneutac.study.gel import noise
from pneutac_benchmarks.tactile.creeping import Memory, write_creeping
from pneutac_datasets.recording.gel import GelRecording
from pneutac_sim.effects import get_effect
from pneutac_sim.effects.gel_creep import share_left
from pneutac_sim.gel.fit import fit_photographs
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.pair import rmse
from pneutac_sim.gel.photograph import Predictor


def errors(folder):
    """Errors of the last four photographs without and with the effect, and the share that it leaves."""
    data = GelRecording.load(Recording.load(folder))
    photographs = data.samples
    known, unseen = photographs[:8], photographs[8:]
    gel = GelModel(data.rest, np.zeros((3, 2)), np.zeros(3), data.px_per_mm, data.thickness_mm)
    out, near = [], None
    for more in ((), ("gel_creep",)):
        near = fit_photographs(gel, known, ["near_light", *more], makes=(), near=near).gel
        predictor = Predictor(near)
        out.append([rmse(predictor.image(p.press, p.rest, 0.0, p.earlier), p.image) for p in unseen])
    left = share_left(get_effect("gel_creep").late(near.effects["gel_creep"]), 60.0, 5.0)
    return np.array(out), left


@pytest.mark.nightly  # every day: what earlier presses leave, below
def test_a_stretched_exponential_is_met_where_it_is_and_not_found_where_it_is_not(tmp_path):
    seen, left = errors(write_creeping(tmp_path / "creeps", 0.25, seed=1, presses=12))
    truth = Memory.drawn(0.25, np.random.default_rng(1)).left(60.0, 5.0)
    assert left == pytest.approx(truth, rel=0.35)
    assert (seen[1] < seen[0]).sum() >= 3 and seen[1].mean() < 0.97 * seen[0].mean()
    seen, left = errors(write_creeping(tmp_path / "does_not", 0.0, seed=1, presses=12))
    assert left < 0.01 and seen[1].mean() == pytest.approx(seen[0].mean(), rel=0.01)


@pytest.mark.slow
def test_what_is_left_of_earlier_presses_is_no_noise(tmp_path):
    floors = []
    for name, share in (("creeps", 0.25), ("does_not", 0.0)):
        data = GelRecording.load(Recording.load(write_creeping(tmp_path / name, share, seed=1, presses=6)))
        floors.append(noise(data.samples, data.px_per_mm))
        told = [replace(s, earlier=()) for s in data.samples]
        floors.append(noise(told, data.px_per_mm))
    creeps, taken_in, plain, all_of_it = floors
    assert creeps - plain < 0.5 * (taken_in - all_of_it), floors
    assert taken_in > 1.05 * all_of_it and plain == pytest.approx(all_of_it, rel=0.1), floors
