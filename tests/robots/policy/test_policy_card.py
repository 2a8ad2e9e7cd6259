"""Which rest images a policy takes when it is fine-tuned, and which datasets it refuses before training."""

import os
import re
import shlex
from dataclasses import fields
from pathlib import Path

import cv2
import numpy as np
import pyarrow
import pyarrow.parquet as parquet
import pytest
import torch
from demonstration_sets import touching, write_episodes
from huggingface_hub import ModelCard
from lerobot.configs import PipelineFeatureType, PreTrainedConfig
from lerobot.configs.default import DatasetConfig, EvalConfig
from lerobot.configs.eval import EvalPipelineConfig
from lerobot.configs.train import TrainPipelineConfig
from lerobot.datasets import LeRobotDatasetMetadata
from lerobot.policies import make_policy
from lerobot.processor import ProcessorStepRegistry
from lerobot.rollout.configs import BaseStrategyConfig, RolloutConfig
from lerobot.utils.constants import ACTION, OBS_STATE

from lerobot_robot_pneutac.env import PneutacEnvConfig
from lerobot_robot_pneutac.policy.configuration_pneutac_bc import TACTILE, PneutacBCConfig
from lerobot_robot_pneutac.policy.tactile_encoder import (
    DIFFERENCE_SCALE,
    TactileEncoder,
    check_same_sensor,
    likeness,
)
from lerobot_robot_pneutac.policy.touch_processor import NAMES, TouchProcessorStep
from lerobot_robot_pneutac.robots.config_pneutac_sim import PneutacSimConfig
from lerobot_robot_pneutac.standin.world import new_gel
from pneutac_sim.errors import InputError
from pneutac_sim.features import IMAGE_SHAPE
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.model import GelModel, rest_image
from pneutac_sim.gel.sensor import TactileSensor
from pneutac_sim.twin import Twin

GENERATED = rest_image(IMAGE_SHAPE)
STANDIN = new_gel().rest_image


def write_dataset(root, image=GENERATED, spoilt=None, episodes=1, untouched=(), task="touch"):
    """Episodes of two frames in touch; `spoilt` is (key, channel, value) of the last frame."""

    def frame(episode, last):
        values = {OBS_STATE: touching(0.1 * (episode not in untouched)), ACTION: np.zeros(4)}
        if spoilt and last:
            values[spoilt[0]][spoilt[1]] = spoilt[2]
        return *values.values(), image

    write_episodes(root, [[frame(e, False), frame(e, True)] for e in range(episodes)], task=task)
    return LeRobotDatasetMetadata(f"local/{root.name}", root)


@pytest.fixture(scope="module")
def demonstrations(tmp_path_factory):
    colour = np.broadcast_to(np.array([90, 110, 70], np.uint8), IMAGE_SHAPE)
    return write_dataset(
        tmp_path_factory.mktemp("card") / "demos", colour, episodes=3, task="flip the switch"
    )


def test_a_checkpoint_says_what_it_is(demonstrations, tmp_path):
    policy = make_policy(PneutacBCConfig(device="cpu", license="mit", tags=["press"]), demonstrations)
    folder = tmp_path / "checkpoints" / "000200" / "pretrained_model"
    policy.save_pretrained(folder)
    card = ModelCard.load(folder / "README.md")
    assert card.data.license == "mit"
    assert card.data.library_name == "lerobot"
    assert card.data.datasets == ["local/demos"]
    assert {"press", "pneutac_bc", "robotics"} <= set(card.data.tags)
    assert "`local/demos`, 3 episodes, 6 frames" in card.text
    assert "Task: flip the switch" in card.text
    assert "Steps: 200\n" in card.text
    assert "the first frames of `local/demos` (mean R, G, B: 90, 110, 70 of 255)" in card.text
    assert "Control rate: 15 Hz" in card.text
    for name, unit in (("joint_3.vel", "rad/s"), ("ee_z.pos", "m"), ("contact_pixels.pos", "log(1 + pixels")):
        assert f"| `observation.state` | `{name}` | {unit}" in card.text
    low, high = (demonstrations.stats["action"][k][3] for k in ("min", "max"))
    assert f"| `action` | `pressure.pos` | kPa, {min(low, 0):g} to {max(high, 0):g} |" in card.text
    assert f"| `{TACTILE}` | 240 x 320 pixels" in card.text


def test_a_policy_without_touch_says_so(demonstrations, tmp_path):
    policy = make_policy(PneutacBCConfig(device="cpu", use_tactile=False), demonstrations)
    policy.save_pretrained(tmp_path / "policy")
    text = (tmp_path / "policy" / "README.md").read_text()
    assert "without touch" in text
    assert TACTILE not in text and "Rest image" not in text
    assert "`contact_area.pos` | share of the image's pixels that are in contact (not looked at)" in text
    assert "Steps" not in text


def test_the_cards_commands_are_of_the_policys_task(tmp_path):
    meta = write_dataset(tmp_path / "eggs", episodes=2, task="Open the egg carton.")
    text = make_policy(PneutacBCConfig(device="cpu"), meta).generate_model_card().text
    assert "--env.task=egg" in text and "--robot.task=egg" in text


def test_the_cards_commands_name_options_that_exist(demonstrations):
    policy = make_policy(PneutacBCConfig(device="cpu"), demonstrations)
    block = re.search(r"```bash\n(.*?)```", policy.generate_model_card().text, re.S).group(1)
    commands = [shlex.split(c) for c in block.replace("\\\n", " ").strip().split("\n\n")]
    whole = {
        "lerobot-eval": EvalPipelineConfig,
        "lerobot-rollout": RolloutConfig,
        "lerobot-train": TrainPipelineConfig,
    }
    parts = {
        "policy": PneutacBCConfig,
        "env": PneutacEnvConfig,
        "eval": EvalConfig,
        "robot": PneutacSimConfig,
        "dataset": DatasetConfig,
        "strategy": BaseStrategyConfig,
    }
    assert [c[0] for c in commands] == list(whole)
    for program, *options in commands:
        assert "--policy.path=THIS" in options
        for option in options:
            head, *rest = option.removeprefix("--").split("=")[0].split(".")
            assert head in {f.name for f in fields(whole[program])}
            if rest and rest != ["path"]:
                assert rest == ["type"] or rest[0] in {f.name for f in fields(parts[head])}, option


def tensor(image: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(image)).permute(2, 0, 1) / 255


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """Folder of a policy that knows the generated DIGIT."""
    folder = tmp_path_factory.mktemp("trained")
    make_policy(PneutacBCConfig(device="cpu"), write_dataset(folder / "first")).save_pretrained(
        folder / "policy"
    )
    return folder / "policy"


def fine_tune(trained, meta):
    config = PreTrainedConfig.from_pretrained(trained)
    config.pretrained_path = trained
    return make_policy(config, meta)


def test_fine_tuning_takes_another_sensor_of_the_same_make(trained, tmp_path):
    policy = fine_tune(trained, write_dataset(tmp_path / "standin", STANDIN))
    assert torch.allclose(policy.encoder.rest_image, tensor(STANDIN), atol=1e-6)


@pytest.mark.parametrize(
    ("image", "how"),
    [
        (STANDIN[:, ::-1], "mirrored left to right"),
        (STANDIN[..., ::-1], "BGR instead of RGB"),
    ],
)
def test_fine_tuning_refuses_turned_images_and_says_how(trained, tmp_path, image, how):
    meta = write_dataset(tmp_path / "other", image)
    with pytest.raises(InputError, match=f"'local/other'.* seems {how}.*--policy.type=pneutac_bc"):
        fine_tune(trained, meta)


def test_another_kind_of_sensor_is_refused():
    """Six coloured lights around the window instead of three at its sides."""
    y, x = np.mgrid[: IMAGE_SHAPE[0], : IMAGE_SHAPE[1]] / np.array(IMAGE_SHAPE[:2])[:, None, None] * 2 * np.pi
    other = np.stack([np.cos(3 * x + p) * np.sin(2 * y + p) for p in (0, 2, 4)], 2)
    with pytest.raises(InputError, match="another kind of sensor"):
        check_same_sensor(tensor(GENERATED), tensor((128 + 60 * other).astype(np.uint8)), "local/x")


def test_brightness_exposure_noise_and_small_shifts_are_no_other_sensor():
    rng = np.random.default_rng(0)
    base = GENERATED.astype(float)
    across = np.linspace(0.9, 1.1, IMAGE_SHAPE[1])[None, :, None]
    for image in (
        base * 0.6,
        base * 1.3,
        base * (1.2, 0.8, 1.1),
        base * across + 12,
        base + rng.normal(0, 12, base.shape),
        np.roll(base, (8, -8), (0, 1)),
    ):
        image = tensor(image.clip(0, 255).astype(np.uint8))
        assert likeness(tensor(GENERATED), image) > 0.9
        check_same_sensor(tensor(GENERATED), image, "local/x")


@pytest.mark.skipif("PNEUTAC_DATA" not in os.environ, reason="PNEUTAC_DATA names no folder of photographs")
def test_photographs_of_two_digits_are_alike_and_a_gelsight_is_not():
    folder = Path(os.environ["PNEUTAC_DATA"]) / "tactile"

    def read(name):
        image = cv2.imread(str(folder / name))[..., ::-1]
        return cv2.resize(image, IMAGE_SHAPE[1::-1], interpolation=cv2.INTER_AREA)

    digits = [GENERATED, STANDIN, read("digit_nagoya/rest_sphere.jpg"), read("digit_fots/rest.png")]
    gelsight = tensor(read("gelsight_thu/rest.png"))
    for i, a in enumerate(digits):
        for b in digits[:i]:
            check_same_sensor(tensor(a), tensor(b), "local/x")
            for wrong in (b[:, ::-1], b[::-1], b[..., ::-1]):
                with pytest.raises(InputError):
                    check_same_sensor(tensor(a), tensor(wrong), "local/x")
        with pytest.raises(InputError, match="another kind of sensor"):
            check_same_sensor(tensor(a), gelsight, "local/x")


@pytest.mark.parametrize("spoilt", [(OBS_STATE, 3, np.nan), (ACTION, 1, np.inf)])
def test_numbers_that_are_none_are_found_before_training(tmp_path, spoilt):
    meta = write_dataset(tmp_path / "spoilt", spoilt=spoilt, episodes=2)
    with pytest.raises(InputError, match=r"Each of the episodes \[0, 1\] holds numbers that are not finite"):
        make_policy(PneutacBCConfig(device="cpu"), meta)


def test_statistics_that_are_no_numbers_are_found_before_training(tmp_path):
    meta = write_dataset(tmp_path / "spoilt")
    meta.stats[ACTION]["max"][1] = np.nan
    with pytest.raises(InputError, match=r"stats.json has NaN or infinity for 'action' in dy.vel, and no"):
        make_policy(PneutacBCConfig(device="cpu"), meta)


def test_images_that_cannot_be_read_are_named(tmp_path):
    meta = write_dataset(tmp_path / "broken")
    file = next((meta.root / "data").rglob("*.parquet"))
    table = parquet.read_table(file)
    broken = [{"bytes": row["bytes"][:100], "path": row["path"]} for row in table[TACTILE].to_pylist()]
    column = pyarrow.array(broken, table.schema.field(TACTILE).type)
    parquet.write_table(table.set_column(table.column_names.index(TACTILE), TACTILE, column), file)
    with pytest.raises(InputError, match=f"'local/broken': no rest image, for the first '{TACTILE}'"):
        make_policy(PneutacBCConfig(device="cpu"), meta)


def test_an_episode_that_touches_nothing_stops_a_training_with_touch(tmp_path):
    meta = write_dataset(tmp_path / "demos", episodes=3, untouched=(1,))
    with pytest.raises(InputError, match="no touch in episode 1 .*or train with"):
        PneutacBCConfig(device="cpu").check_dataset(meta)
    PneutacBCConfig(device="cpu", use_tactile=False).check_dataset(meta)
    PneutacBCConfig(device="cpu").check_dataset(write_dataset(tmp_path / "touched"))


def test_a_dataset_without_episodes_is_named(tmp_path):
    meta = write_dataset(tmp_path / "empty", episodes=0)
    with pytest.raises(InputError, match="'local/empty' has no episodes"):
        make_policy(PneutacBCConfig(device="cpu"), meta)


@pytest.fixture
def step(tmp_path):
    twin = Twin("gel", 16.0)
    GelModel.builtin().into_twin(twin)
    twin.save(tmp_path / "touch")
    return TouchProcessorStep(str(tmp_path / "touch"))


def test_a_press_is_told_beside_the_rest_of_the_observation(step):
    image = TactileSensor().image(Press("sphere", 3.0, 1.5, -2.0, 0.8).depths())
    seen = step.observation({"tactile": image, "pressure.pos": 3.0})
    assert seen["touch_depth_mm"] == pytest.approx(0.8, rel=0.1) and seen["pressure.pos"] == 3.0
    assert (seen["touch_x_mm"], seen["touch_y_mm"]) == pytest.approx((1.5, -2.0), abs=0.2)
    assert 0.2 < seen["touch_force_n"] < 1.0 and seen["touch_area_mm2"] > 4
    nothing = step.observation({"tactile": TactileSensor().rest_image})
    assert all(nothing[name] == 0 for name in NAMES), "no NaN goes on"


def test_lerobot_finds_it_by_name_and_builds_it_from_its_own_config(step):
    made = ProcessorStepRegistry.get("pneutac_touch")(**step.get_config())
    assert made.twin == step.twin
    features = made.transform_features({PipelineFeatureType.OBSERVATION: {}})
    assert set(features[PipelineFeatureType.OBSERVATION]) == set(NAMES)


def test_a_twin_without_a_gel_and_an_observation_without_the_image_are_refused(step, tmp_path):
    Twin.builtin().save(tmp_path / "finger")
    with pytest.raises(InputError, match="has no gel"):
        TouchProcessorStep(str(tmp_path / "finger"))
    with pytest.raises(InputError, match="no image 'tactile'"):
        step.observation({"wrist": np.zeros((2, 2, 3), np.uint8)})


@pytest.fixture
def encoder() -> TactileEncoder:
    encoder = TactileEncoder()
    encoder.rest_image.fill_(0.4)
    return encoder


def test_camera_noise_is_no_touch(encoder):
    """Noise of single pixels averages out before the sign is dropped."""
    rest = encoder.rest_image
    noisy = rest + 2 / 255 * torch.randn(rest.shape, generator=torch.Generator().manual_seed(0))
    seen = encoder.difference(noisy[None]).abs().mean() * 32  # levels
    assert seen < 0.35 * 2 * np.sqrt(2 / np.pi)  # of the mean that single pixels would have


def test_a_drift_of_the_light_is_no_touch_and_hides_none(encoder):
    rest = encoder.rest_image
    touched = rest.clone()
    touched[:, 100:200, 60:160] += torch.tensor([20.0, -15.0, 10.0])[:, None, None] / 255
    drift = torch.tensor([1.04, 0.97, 1.02])[:, None, None]
    dark, shown = encoder.difference(torch.stack([rest * drift, touched * drift])) * 32  # levels
    assert dark.abs().max() < 0.01
    expected = encoder.difference(touched[None])[0] * 32
    np.testing.assert_allclose(shown, (expected * drift).numpy(), atol=0.02)
    assert expected.abs().max() > 19


@pytest.mark.parametrize(
    ("shape", "small"), [((480, 640), (60, 80)), ((240, 320), (60, 80)), ((333, 250), (80, 60))]
)
def test_a_touch_is_where_it_is_at_any_size(shape, small):
    """A press over the upper left quarter is seen there, as strong as it is."""
    encoder = TactileEncoder((3, *shape))
    encoder.rest_image.fill_(0.4)
    touched = encoder.rest_image.clone()
    touched[:, : shape[0] // 2, : shape[1] // 2] += 20 / 255
    seen = encoder.difference(touched[None])[0] * 32  # levels
    assert seen.shape == (3, *small)
    expected = torch.zeros(small)
    expected[: small[0] // 2, : small[1] // 2] = 20
    inner = (seen.mean(0) - expected).abs() < 0.1
    assert inner.float().mean() > 0.97  # but for cells on the edge
    assert encoder(encoder.difference(touched[None])).shape == (1, 64)


def test_a_covered_camera_does_not_look_untouched(encoder):
    dark = encoder.difference(0.02 * encoder.rest_image[None]).abs().mean()
    assert dark > 0.4 * (encoder.rest_image.mean() / DIFFERENCE_SCALE)
