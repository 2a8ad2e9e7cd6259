"""LeRobot's whole loop as its users run it: real commands, no display, no network."""

import json
import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
from awake import undisturbed
from doc_blocks import ROOT, blocks
from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata
from lerobot.utils.constants import OBS_STATE
from warm_commands import WarmCommands

from pneutac_sim.features import EE, STATE_NAMES

STEPS = 75  # 5 s at 15 Hz


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Runs a LeRobot command in a working folder of its own and returns its output."""
    work = tmp_path_factory.mktemp("loop")
    # Two processes at a time on two cores: more threads would only stand in each other's way.
    commands = WarmCommands(
        work, {"HF_HOME": str(work / "hf"), "HF_HUB_OFFLINE": "1", "OMP_NUM_THREADS": "1"}
    )

    def call(text: str) -> str:
        command, *options = shlex.split(text)
        code, output = commands.run(command, *options)
        assert code == 0, f"{text}\n{output[-8000:]}"
        return output

    call.work, call.commands = work, commands
    return call


def dataset_options(name: str, work: Path, episodes: int, seconds: float) -> str:
    return (
        f"--dataset.repo_id=local/{name} --dataset.root={work / name} --dataset.no_stamp=true"
        " --dataset.single_task='Flip the toggle switch.'"
        f" --dataset.fps=15 --dataset.episode_time_s={seconds}"
        f" --dataset.reset_time_s=0 --dataset.num_episodes={episodes} --dataset.streaming_encoding=true"
        " --dataset.push_to_hub=false --play_sounds=false"
    )


SIMULATED = "--robot.type=pneutac_sim --robot.id=twin"


@pytest.fixture(scope="module")
def trained(run):
    """Two demonstrations, and the folder of a policy that was trained on them for a few steps."""
    work = run.work
    policy = work / "train/checkpoints/last/pretrained_model"

    def recorded():
        shutil.rmtree(work / "demo", ignore_errors=True)
        # Of seed 6 the object is met within the 5 s.
        run(
            f"lerobot-record {SIMULATED} --robot.seed=6 --teleop.type=pneutac_scripted --teleop.id=script "
            + dataset_options("demo", work, 2, STEPS / 15)
        )
        demo = LeRobotDatasetMetadata("local/demo", work / "demo")
        assert demo.total_episodes == 2
        # A busy computer may miss ticks at an episode's end, but not many.
        assert 2 * STEPS - 10 <= demo.total_frames <= 2 * STEPS
        return demo

    demo = undisturbed(recorded, tries=3)
    assert demo.robot_type == "pneutac"

    frames = LeRobotDataset("local/demo", work / "demo", video_backend="pyav").hf_dataset
    state = np.array(frames.with_format("numpy")[OBS_STATE])
    assert state[0, STATE_NAMES.index("pressure.pos")] == 0
    assert state[:, STATE_NAMES.index("contact_area.pos")].max() > 0.01
    within = np.diff(np.array(frames.with_format("numpy")["episode_index"])) == 0
    assert np.linalg.norm(np.diff(state[:, EE], axis=0), axis=1)[within].max() < 0.02  # m; no scene anew

    log = run(
        f"lerobot-train --policy.type=pneutac_bc --dataset.repo_id=local/demo --dataset.root={work / 'demo'}"
        f" --output_dir={work / 'train'} --steps=20 --log_freq=10 --policy.device=cpu --batch_size=8"
        " --num_workers=0 --save_freq=0 --env_eval_freq=0 --wandb.enable=false"
    )
    assert "motion_mm2" in log
    assert (policy / "model.safetensors").is_file()
    return demo, policy


@pytest.mark.slow
def test_record_train_eval(run, trained):
    work, (_, policy) = run.work, trained
    run(
        f"lerobot-eval --policy.path={policy} --policy.device=cpu --env.type=pneutac --env.task=switch"
        " --env.episode_length=20 --eval.n_episodes=2 --eval.batch_size=2 --eval.use_async_envs=false"
        f" --output_dir={work / 'eval'}"
    )
    overall = json.loads((work / "eval/eval_info.json").read_text())["overall"]
    assert overall["n_episodes"] == 2
    assert 0 <= overall["pc_success"] <= 100
    assert list((work / "eval").rglob("*.mp4"))


@pytest.mark.nightly  # every day: the policy acts in lerobot-eval, above
def test_rollout_replay_merge(run, trained):
    work, (demo, policy) = run.work, trained

    def rolled_out():
        shutil.rmtree(work / "rollout_demo", ignore_errors=True)
        run(
            f"lerobot-rollout --strategy.type=episodic --policy.path={policy} --device=cpu {SIMULATED}"
            " --fps=15 --task='Flip the toggle switch.' " + dataset_options("rollout_demo", work, 2, 2)
        )
        rollout = LeRobotDatasetMetadata("local/rollout_demo", work / "rollout_demo")
        assert rollout.total_episodes == 2
        assert 40 <= rollout.total_frames <= 60
        return rollout

    rollout = undisturbed(rolled_out, tries=3)
    assert {k: f["shape"] for k, f in rollout.features.items()} == {
        k: f["shape"] for k, f in demo.features.items()
    }

    run(
        f"lerobot-replay {SIMULATED} --dataset.repo_id=local/demo --dataset.root={work / 'demo'}"
        " --dataset.episode=1 --play_sounds=false"
    )
    run(
        f"lerobot-edit-dataset --new_repo_id=local/merged --new_root={work / 'merged'} --operation.type=merge"
        " --operation.repo_ids=\"['local/demo','local/rollout_demo']\""
        f" --operation.roots=\"['{work / 'demo'}','{work / 'rollout_demo'}']\""
    )
    merged = LeRobotDatasetMetadata("local/merged", work / "merged")
    assert merged.total_frames == demo.total_frames + rollout.total_frames


SMALL = {
    "act": {"policy.dim_model": 64, "policy.n_heads": 2, "policy.dim_feedforward": 128},
    "diffusion": {
        "policy.down_dims": "[32,64]",
        "policy.diffusion_step_embed_dim": 32,
        "policy.num_train_timesteps": 20,
        "policy.num_inference_steps": 5,
        "policy.spatial_softmax_num_keypoints": 8,
    },
    "smolvla": {
        "policy.load_vlm_weights": "false",
        "policy.num_vlm_layers": 2,
        "policy.resize_imgs_with_padding": "[128,128]",
        "policy.num_steps": 2,
    },
}


def small_language_model(folder: Path) -> Path:
    """Configuration, tokenizer and image processor of a SmolVLM of two layers, whose weights are random."""
    from tokenizers import Tokenizer, models, pre_tokenizers
    from transformers import (
        PreTrainedTokenizerFast,
        SmolVLMConfig,
        SmolVLMImageProcessor,
        SmolVLMProcessor,
        SmolVLMVideoProcessor,
    )

    special = {
        "fake_image_token": "<fake_token_around_image>",
        "global_image_token": "<global-img>",
        "image_token": "<image>",
        "end_of_utterance_token": "<end_of_utterance>",
    }
    words = ["<unk>", "<pad>", *special.values(), "Flip", "the", "switch"]
    known = Tokenizer(models.WordLevel({word: k for k, word in enumerate(words)}, unk_token="<unk>"))
    known.pre_tokenizer = pre_tokenizers.Whitespace()
    tokenizer = PreTrainedTokenizerFast(
        tokenizer_object=known, unk_token="<unk>", pad_token="<pad>", extra_special_tokens=special
    )
    images, videos = SmolVLMImageProcessor(), SmolVLMVideoProcessor()
    SmolVLMProcessor(images, tokenizer, videos, image_seq_len=16).save_pretrained(folder)
    heads = {"num_attention_heads": 4, "num_key_value_heads": 2, "head_dim": 16}
    text = {"vocab_size": len(words), "hidden_size": 64, "intermediate_size": 64, "num_hidden_layers": 2}
    eye = {"hidden_size": 32, "intermediate_size": 32, "num_hidden_layers": 1, "num_attention_heads": 2}
    SmolVLMConfig(
        vision_config=eye | {"image_size": 128, "patch_size": 32},
        text_config={"model_type": "llama"} | text | heads,
        scale_factor=2,
        image_token_id=words.index("<image>"),
    ).save_pretrained(folder)
    return folder


@pytest.mark.nightly
@pytest.mark.parametrize("policy", SMALL)
def test_other_policies_train_and_evaluate_by_the_pages_commands(run, policy):
    """With a small network, two steps and one short trial in place of the page's numbers."""
    page = [b for b in blocks("docs/how_to/which_policy.md") if f"policy.type={policy} " in b.text]
    train, evaluate = (shlex.split(c) for c in page[0].text.replace("\\\n", "").strip().split("\n"))
    outputs, more = run.work / policy, dict(SMALL[policy])
    if policy == "smolvla":
        pytest.importorskip("num2words", reason="LeRobot's extra `smolvla` is not installed")
        more["policy.vlm_model_name"] = small_language_model(outputs / "vlm")
    shutil.copytree(ROOT / "tests/golden/recordings/demos", outputs / "switch/demos")
    trial = {"eval.n_episodes": 1, "env.episode_length": 10, "policy.device": "cpu"}
    trial["eval.use_async_envs"] = "true"
    small = {
        "steps": 2,
        "batch_size": 2,
        "num_workers": 0,
        "save_freq": 0,
        "policy.device": "cpu",
    }
    if policy != "smolvla":
        small["policy.pretrained_backbone_weights"] = "null"
    for (command, *options), other in ((train, small | more), (evaluate, trial)):
        given = dict(o.removeprefix("--").split("=", 1) for o in options) | other
        given = {k: str(v).replace("outputs/", f"{outputs}/") for k, v in given.items()}
        run(shlex.join([command, *(f"--{k}={v}" for k, v in given.items())]))
    (result,) = outputs.rglob("eval_info.json")
    assert json.loads(result.read_text())["overall"]["n_episodes"] == 1


DEMOS = ROOT / "tests/golden/recordings/demos"
ON_DEMOS = f"--dataset.repo_id=local/demos --dataset.root={DEMOS}"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "sentence"),
    [
        (
            "lerobot-train --policy.type=act --dataset.repo_id=local/a --dataset.root=nowhere",
            "error: --dataset.root: 'nowhere' holds no LeRobotDataset",
        ),
        (
            "lerobot-train --policy.type=act --dataset.repo_id=local/a --dataset.root=old",
            "codebase_version is 'v2.1', and v3.0 is read here; convert it with",
        ),
        (
            "lerobot-train --policy.type=act --policy.push_to_hub=false --dataset.repo_id=local/a"
            " --dataset.root=torn",
            "error: torn/meta/stats.json is not valid JSON",
        ),
        (
            "lerobot-train --policy.type=act --policy.push_to_hub=false --dataset.repo_id=local/a"
            " --dataset.root=torn_arm",
            "error: LeRobot fails at the dataset torn_arm (",
        ),
        (
            f"lerobot-train --policy.type=pneutac_bc {ON_DEMOS} --policy.device=cpu --policy.control_hz=30",
            "error: Dataset 'local/demos' has 15 frames per second and the policy's control_hz is 30;",
        ),
        (
            "lerobot-eval --policy.path=old --env.type=pneutac",
            "error: --policy.path=old holds no policy (no config.json)",
        ),
        (
            "lerobot-record --robot.type=pneutac_sim --teleop.type=pneutac_scripted --dataset.single_task=x"
            " --dataset.repo_id=local/a --dataset.root=old",
            "error: --dataset.root=old exists; give a new folder (--resume=true adds episodes to a dataset).",
        ),
    ],
)
def test_what_a_user_gave_wrongly_ends_in_one_sentence(run, command, sentence):
    (run.work / "file").touch()
    info = (DEMOS / "meta/info.json").read_text().replace('"v3.0"', '"v2.1"')
    (run.work / "old/meta").mkdir(parents=True, exist_ok=True)
    (run.work / "old/meta/info.json").write_text(info)
    if torn := re.search(r"torn\w*", command):
        root = Path(shutil.copytree(DEMOS, run.work / torn[0]))
        (root / "meta/stats.json").write_text("{")
        robot = "so101_follower" if torn[0] == "torn_arm" else "pneutac"
        (root / "meta/info.json").write_text(info.replace("v2.1", "v3.0").replace('"pneutac"', f'"{robot}"'))
    code, output = run.commands.run(*shlex.split(command))
    assert code == 1 and "Traceback" not in output
    assert sentence in output.splitlines()[-1]
