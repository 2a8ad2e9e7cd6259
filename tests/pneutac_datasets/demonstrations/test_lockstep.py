"""Demonstrations of many worlds together are those of the single world until contacts part them."""

from functools import partial

import numpy as np
import pytest

pytest.importorskip("mujoco_warp", reason="the extra `warp` is not installed")
torch = pytest.importorskip("torch")

from augmenting import demonstrations, setup_of  # noqa: E402

from pneutac_datasets.demonstrations.augment.episode import Generator  # noqa: E402
from pneutac_datasets.demonstrations.augment.lockstep import Lockstep  # noqa: E402
from pneutac_datasets.demonstrations.augment.planner import PlannerConfig  # noqa: E402
from pneutac_datasets.demonstrations.augment.run import Work, save_sensed  # noqa: E402
from pneutac_datasets.demonstrations.augment.scene import Scene  # noqa: E402
from pneutac_sim.executor import no_progress, process_pool  # noqa: E402
from pneutac_sim.features import EE  # noqa: E402

pytestmark = pytest.mark.nightly
DEVICE = "cuda" if torch.cuda.is_available() else "cpu"
JOINTS, RATES = slice(0, 7), slice(7, 14)


def test_they_agree_until_the_touch(tmp_path):
    setup = setup_of(demonstrations("switch", 2), method="library", start_range=(0.004, 0.004, 0.004))
    setup.config.device, setup.config.worlds = DEVICE, 2
    work = Work(tmp_path)
    with process_pool(1) as pool:
        Lockstep(setup).make([0], pool, partial(save_sensed, setup, work.folder), no_progress)
    one, line = Generator(setup).episode(0, [])
    many, provenance, _ = work.load_episode(0)
    assert provenance.keys() == line.keys() and provenance["attempt"] == line["attempt"]
    assert many.start == one.start and many.state.dtype == one.state.dtype
    assert many.images.shape == (provenance["frames"], *one.images.shape[1:])
    assert provenance["path"][0] == line["path"][0]
    free = min(np.flatnonzero(np.r_[a.area, 1.0])[0] for a in (one, many))
    off = np.abs(many.state[:free] - one.state[:free])
    assert free > 10 and off[:, EE].max() < 1e-4
    assert off[:, JOINTS].max() < 1e-3 and off[:, RATES].max() < 0.02
    assert np.abs(many.action[:free] - one.action[:free]).max() < 1e-3
    # An imprint may be too faint to count as contact.
    assert np.abs(many.images[:free].astype(int) - one.images[:free]).max() < 4


@pytest.mark.timeout(3000)  # on a CPU
def test_the_planner_does_the_task_there_too():
    """Two variants: both are done, and where touch comes in the same frame the first plan is the same."""
    shown, quick = demonstrations("switch", 2), PlannerConfig(horizon=6, samples=4, elites=2, iterations=1)
    scenes = [Scene(r.source, (0.0, 0.0, 0.0), True, 0.0, 0.0) for r in shown]
    setup, ended = setup_of(shown, planner=quick, attempts=1), {}
    setup.config.device, setup.config.worlds = DEVICE, 4  # one plan at a time, of two attempts
    many, one = Lockstep(setup, scenes), Generator(setup, "area")

    def decide(run):
        ended[run.index] = run
        many._open.discard(run.index)

    many._decide = decide
    many.make([1, 2], None, None, no_progress)
    planned = 0
    for index, run in ended.items():
        variant, where, rng = one.variant(index, 0)
        alone = one.carry_out(variant, scenes[variant.source], rng)
        assert run.where == where and run.start == alone.start
        assert alone.reason is run.reason is None
        assert run.scores.keys() == {"cost", "area_rmse", "scene"} and np.isfinite(run.scores["cost"])
        touch, there = (int(np.flatnonzero(a)[0]) for a in (alone.area, run.sensed.states[:, 6]))
        off, early = np.abs(run.sensed.actions[: touch + 3] - alone.action[: touch + 3]), min(touch, there)
        assert early > 5 and off[: early - 1].max() < 2e-3
        if touch == there:
            planned += 1
            assert off[:, :3].max() < 2e-3 and off[:, 3].max() < 0.2
    assert ended.keys() == {1, 2} and planned
