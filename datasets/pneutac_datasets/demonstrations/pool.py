"""Demonstrations with small tactile images, which train `pneutac_bc` several times faster on a CPU.

    python -m pneutac_datasets.demonstrations.pool --out=outputs/small outputs/demos outputs/augmented

The policy sees means over 80 x 60 cells, 4 x 4 pixels each of a DIGIT's. Reading and converting whole images
is most of what lerobot-train does for so small a network; a dataset of the means, as 8-bit PNG, says the same
but for their rounding. It also holds the previous action, an input of the policy, for
`--policy.previous_action_in_data=true`.
"""

import argparse
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata
from lerobot.utils.constants import ACTION, OBS_STATE

from lerobot_robot_pneutac.lerobot_inside import replaced
from lerobot_robot_pneutac.policy.configuration_pneutac_bc import ANSWER_DELAY, POOLED_FROM, PREVIOUS_ACTION
from lerobot_robot_pneutac.policy.tactile_encoder import grid, pool
from pneutac_datasets.demonstrations.episodes import (
    TACTILE,
    Episode,
    demonstration_features,
    load_episode,
    readable,
    save_episode,
)
from pneutac_datasets.demonstrations.reading import check_new
from pneutac_datasets.demonstrations.save import create_dataset, written
from pneutac_sim.dataset_files import Files
from pneutac_sim.errors import InputError
from pneutac_sim.files import whole
from pneutac_sim.world.arms import ArmFile
from pneutac_sim.world.station import Station, station_of


def pool_demonstrations(sources: list[Path], out: str | Path, repo_id: str) -> Path:
    """Writes the demonstrations of several datasets as one whose images are 80 x 60, lying ones 60 x 80.

    Raises InputError: a source is no dataset of this robot, rates, sizes or stations differ, or `out` exists.
    """
    check_new(Path(out), repo_id)
    for root in sources:
        Files(root).refuse_damaged()
    metas = [LeRobotDatasetMetadata(f"local/{Path(root).name}", root) for root in sources]
    features = demonstration_features(metas[0])
    size = tuple(features[TACTILE]["shape"])
    for meta in metas[1:]:
        demonstration_features(meta)
        if meta.fps != metas[0].fps:
            raise InputError(
                f"'{meta.root}' has {meta.fps} frames per second and '{metas[0].root}' has {metas[0].fps}; "
                "give datasets of equal rate."
            )
        for key in (TACTILE, OBS_STATE, ACTION):
            here, first = (tuple(m.features[key]["shape"]) for m in (meta, metas[0]))
            if here != first:
                raise InputError(
                    f"'{meta.root}' has '{key}' of the shape {here} and '{metas[0].root}' of {first};"
                    " give datasets of one sensor, arm and finger."
                )
    left = [station_of(root) for root in sources]
    stations = [station or Station() for station in left]
    for root, station in zip(sources, stations, strict=True):
        if _described(station) != _described(stations[0]):
            raise InputError(
                f"'{root}' has another meta/station.yaml than '{sources[0]}', or one of them has none; give"
                " datasets of one station, or store the file where it is missing."
            )
    small = (*grid(*size[:2]), size[2])
    if small[0] >= size[0]:
        raise InputError(f"'{metas[0].root}' has images of {size} already; train on it as it is.")
    info = {**(features[TACTILE].get("info") or {}), POOLED_FROM: list(size[:2])}
    features[TACTILE] = {**features[TACTILE], "dtype": "image", "shape": small, "info": info}
    infos = [m.features[ACTION].get("info") or {} for m in metas]
    if delays := [info[ANSWER_DELAY] for info in infos if ANSWER_DELAY in info]:
        features[ACTION]["info"] = {ANSWER_DELAY: max(delays)}
    features[PREVIOUS_ACTION] = dict(features[ACTION])
    # Without compression these small images are written in a sixth of the time and decoded in two thirds.
    how = "lerobot.datasets.image_writer", "save_kwargs_for_path", lambda *_: {"compress_level": 0}
    with whole(Path(out)) as part:
        new = create_dataset(repo_id, part, metas[0].fps, features, metas[0].robot_type, False, 1)
        with written(new), replaced(*how):
            for meta in metas:
                with readable(meta.root):
                    source = LeRobotDataset(meta.repo_id, meta.root, video_backend="pyav")
                for index in range(meta.total_episodes):
                    with readable(meta.root):
                        e = load_episode(source, index)
                    e.images = np.concatenate([_means(image) for image in e.images])
                    e.state, e.action = (x.astype(np.float32) for x in (e.state, e.action))
                    save_episode(new, e, {PREVIOUS_ACTION: previous_actions(e)})
        if any(left):
            stations[0].save(part / "meta")
    return Path(out)


def _described(station: Station) -> dict:
    """What it is made of; of an arm's own file, which each dataset has a copy of, the content."""
    out = asdict(station)
    if isinstance(station.arm, ArmFile):
        out["arm"]["urdf"] = Path(station.arm.urdf).read_bytes()
    return out


def _means(image: np.ndarray) -> np.ndarray:
    """An image (H, W, 3) as the network sees it (1, 80, 60, 3), uint8."""
    means = pool(torch.from_numpy(image).permute(2, 0, 1)[None].float())
    return means.permute(0, 2, 3, 1).round().byte().numpy()


def previous_actions(episode: Episode) -> np.ndarray:
    """Action of the frame before (T, 3 + C), float32; at first that of standing still."""
    hold = np.append(np.zeros(3), episode.state[0, episode.places.pressure])
    return np.vstack([hold, episode.action[:-1]]).astype(np.float32)


def main(argv: list[str] | None = None) -> None:
    """Command line of this module."""
    parser = argparse.ArgumentParser(
        prog="python -m pneutac_datasets.demonstrations.pool", description=__doc__
    )
    parser.add_argument("sources", nargs="+", type=Path, help="folders of LeRobotDatasets")
    parser.add_argument("--out", required=True, type=Path, help="folder of the new one")
    options = parser.parse_args(argv)
    try:
        pool_demonstrations(options.sources, options.out, f"local/{options.out.name}")
    except (InputError, OSError) as e:
        sys.exit(str(e))


if __name__ == "__main__":
    main()
