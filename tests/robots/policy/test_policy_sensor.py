"""Which rest images a policy takes when it is fine-tuned, and which datasets it refuses before training."""

import os
from pathlib import Path

import cv2
import numpy as np
import pyarrow
import pyarrow.parquet as parquet
import pytest
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.datasets import LeRobotDatasetMetadata
from lerobot.policies import make_policy
from lerobot.utils.constants import ACTION, OBS_STATE

from lerobot_robot_pneutac.policy.configuration_pneutac_bc import TACTILE, PneutacBCConfig
from lerobot_robot_pneutac.policy.rest_image import check_same_sensor, likeness
from lerobot_robot_pneutac.standin.gel import new_gel
from pneutac_datasets.demonstrations.save import create_dataset, quiet_encoders
from pneutac_sim.errors import InputError
from pneutac_sim.features import ACTION_NAMES, IMAGE_SHAPE, STATE_NAMES
from pneutac_sim.gel.builtin import rest_image


def tensor(image: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(image)).permute(2, 0, 1) / 255


GENERATED = rest_image(IMAGE_SHAPE)
STANDIN = new_gel().rest_image


def write_dataset(root, image=GENERATED, spoilt=None, episodes=1, untouched=()):
    """Episodes of two frames in touch; `spoilt` is (key, channel, value) of the last frame."""
    features = {
        OBS_STATE: {"dtype": "float32", "shape": (len(STATE_NAMES),), "names": list(STATE_NAMES)},
        ACTION: {"dtype": "float32", "shape": (4,), "names": list(ACTION_NAMES)},
        TACTILE: {"dtype": "image", "shape": IMAGE_SHAPE, "names": ["height", "width", "channels"]},
    }
    dataset = create_dataset(f"local/{root.name}", root, 15, features, "pneutac", False, 2)
    with quiet_encoders():
        for episode in range(episodes):
            for last in (False, True):
                frame = {OBS_STATE: np.zeros(20, np.float32), ACTION: np.zeros(4, np.float32)}
                frame[OBS_STATE][STATE_NAMES.index("contact_area.pos")] = 0.1 * (episode not in untouched)
                if spoilt and last:
                    frame[spoilt[0]][spoilt[1]] = spoilt[2]
                dataset.add_frame({**frame, TACTILE: np.ascontiguousarray(image), "task": "touch"})
            dataset.save_episode()
        dataset.finalize()
    return LeRobotDatasetMetadata(dataset.repo_id, root)


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
        (STANDIN[::-1], "mirrored top to bottom"),
        (STANDIN[::-1, ::-1], "turned upside down"),
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


@pytest.mark.parametrize(
    ("spoilt", "said"),
    [
        (
            (OBS_STATE, 3, np.nan),
            r"'observation.state' contains NaN or infinity in joint_4.pos, first in episode 0;",
        ),
        ((ACTION, 1, np.inf), r"'action' contains NaN or infinity in dy.vel, first in episode 0;"),
    ],
)
def test_numbers_that_are_none_are_found_before_training(tmp_path, spoilt, said):
    meta = write_dataset(tmp_path / "spoilt", spoilt=spoilt, episodes=2)
    with pytest.raises(InputError, match=said):
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
