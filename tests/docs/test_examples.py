"""The examples run as they are, in an empty folder, and stay short."""

import os
import subprocess
import sys

import pytest
from doc_blocks import ROOT

EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
# Half a minute and more each; the front page and a tutorial do the same by commands.
LONG = {
    "augment",
    "calibrate_digit",
    "environment",
    "find_missing_effect",
    "hub_dry_run",
    "mpm_finger",
    "splat_gel",
}


def test_there_are_nine():
    assert len(EXAMPLES) == 9


@pytest.mark.slow
@pytest.mark.parametrize(
    "path", [pytest.param(p, marks=[pytest.mark.nightly] * (p.stem in LONG), id=p.stem) for p in EXAMPLES]
)
def test_it_runs(path, tmp_path, *options):
    env = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "PNEUTAC_DATA")}
    env |= {"HF_HOME": str(tmp_path / "hf"), "HF_HUB_OFFLINE": "1", "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, path, *options], cwd=tmp_path, env=env, capture_output=True, text=True
    )
    assert done.returncode == 0, f"{done.stdout[-2000:]}\n{done.stderr[-4000:]}"
    assert done.stdout.strip()


@pytest.mark.nightly
def test_what_would_be_pushed_loads_offline_from_its_folder(tmp_path):
    from huggingface_hub import DatasetCard, ModelCard
    from lerobot.datasets import LeRobotDataset
    from lerobot.policies import get_policy_class, make_pre_post_processors

    import lerobot_robot_pneutac  # noqa: F401

    test_it_runs(
        ROOT / "examples/hub_dry_run.py", tmp_path, "--episodes=1", "--steps=2", "--licence=cc-by-4.0"
    )
    hub = (tmp_path / "outputs/hub").rename(tmp_path / "elsewhere")
    frame = LeRobotDataset("you/pneutac_switch", hub / "dataset", video_backend="pyav")[0]
    policy = get_policy_class("pneutac_bc").from_pretrained(hub / "policy")
    before, after = make_pre_post_processors(policy.config, pretrained_path=str(hub / "policy"))
    action = after(policy.select_action(before(frame)))
    assert action.shape == (1, 4) and action.isfinite().all()
    card = DatasetCard.load(hub / "dataset/README.md")
    assert card.data.license == ModelCard.load(hub / "policy/README.md").data.license == "cc-by-4.0"
    assert all(part in card.text for part in ("| kPa |", "## Station", "in simulation"))
    texts = [f.read_text() for f in hub.rglob("*") if f.suffix in (".json", ".md")]
    assert len(texts) > 7 and not any(str(tmp_path) in text for text in texts)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: p.stem)
def test_it_is_short(path):
    assert len(path.read_text().splitlines()) < 60
