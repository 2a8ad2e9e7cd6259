"""Everything in demonstrations that `augment` or a training would refuse, at once and without the images."""

import difflib
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as parquet

from pneutac_datasets.demonstrations.info import ACTION, STATE, read_info
from pneutac_sim.features import (
    CHAMBERS,
    CONTROL_HZ,
    IMAGE_NAME,
    POINTS_KEY,
    PRESSURES,
    Places,
    action_names,
    chamber_count,
    state_names_like,
)
from pneutac_sim.gel.contact import without_specks
from pneutac_sim.gel.model import GelModel
from pneutac_sim.pace import pace_notes
from pneutac_sim.twin import Twin
from pneutac_sim.world.cameras import SCENE_CAMERAS

TACTILE = f"observation.images.{IMAGE_NAME}"
# Which demonstrations may have too.
FURTHER = (f"observation.{POINTS_KEY}", *(f"observation.images.{name}" for name in SCENE_CAMERAS))
OWN = ("timestamp", "frame_index", "episode_index", "index", "task_index")  # LeRobot's, in every dataset
ROUNDING_KPA = 0.01  # share of the range by which a command may be beyond it


def demonstration_faults(folder: str | Path, twin: Twin, control_hz: int = CONTROL_HZ) -> list[str]:
    """One sentence for each fault of recorded demonstrations.

    Args:
        folder: root of the LeRobotDataset.
        twin: on which they are to be augmented.
        control_hz: of the station.
    """
    folder = Path(folder)
    file = folder / "meta" / "info.json"
    if not file.is_file():
        return [f"'{folder}' holds no LeRobotDataset (no meta/info.json)."]
    info = read_info(file)
    chambers = CHAMBERS.get(twin.device, 1)
    found = _of_features(info.get("features", {}), file, GelModel.from_twin(twin).rest_image.shape, chambers)
    if info.get("fps") != control_hz:
        found.append(f"{file}: {wrong_rate(info.get('fps'), control_hz)}")
    parts = sorted((folder / "data").glob("**/*.parquet"))
    if not parts:
        return [*found, f"{folder / 'data'} holds no .parquet file; record at least two demonstrations."]
    if any(name in sentence for sentence in found for name in (f"'{STATE}'", f"'{ACTION}'")):
        return found  # which numbers are which is not known
    tables = [parquet.read_table(p, columns=["episode_index", STATE, ACTION]) for p in parts]
    episode = np.concatenate([t["episode_index"].to_numpy() for t in tables])
    state, action = (np.concatenate([np.stack(t[k].to_numpy()) for t in tables]) for k in (STATE, ACTION))
    episodes = np.unique(episode)
    if len(episodes) < 2:
        found.append(
            f"{folder} has {len(episodes)} demonstration; the spread of the contacts needs two or more."
        )
    return found + _of_episodes(
        {int(e): (state[episode == e], action[episode == e]) for e in episodes},
        twin.pressure_range_kpa,
        Places.of(chambers).area,
    )


def wrong_rate(fps: Any, control_hz: int) -> str:
    """What is said of demonstrations at another rate than the station's."""
    return (
        f"{fps} fps, but the station's control rate is {control_hz} Hz; give the station.yaml that they were"
        f" recorded in by --station=, or record with --dataset.fps={control_hz}."
    )


def demonstration_notes(folder: str | Path) -> list[str]:
    """What is poor but usable: episodes whose control loop fell short of the dataset's rate."""
    meta = Path(folder) / "meta"
    return pace_notes(meta, float(read_info(meta / "info.json").get("fps") or CONTROL_HZ))


def _of_features(features: dict, file: Path, image_shape: tuple[int, ...], chambers: int) -> list[str]:
    found = []
    wanted = [STATE, ACTION, TACTILE]
    for key in wanted:
        if key not in features:
            found.append(
                f"{file}: feature '{key}' is missing{_close(key, features)}; record it with this robot."
            )
    more = [k for k in features if k not in (*wanted, *FURTHER, *OWN)]
    if more:
        found.append(
            f"{file}: feature {', '.join(more)} is none of a demonstration's; take it out with"
            " lerobot-edit-dataset --operation.type=remove_feature."
        )
    for key in (STATE, ACTION):
        there = (features.get(key) or {}).get("names") or []
        there = list(there.values())[0] if isinstance(there, dict) else list(there)
        there_are = chamber_count(there)
        names = state_names_like(map(str, there)) if key == STATE else action_names(there_are)
        if there_are != chambers:
            found.append(
                f"{file}: '{key}' has {there_are} pressure{'s' * (there_are > 1)} and the twin"
                f" {chambers} chamber{'s' * (chambers > 1)}; give the twin of the body that was recorded."
            )
        elif key in features and there != list(names):
            missing = [f"'{n}'{_close(n, there)}" for n in names if n not in there]
            what = f"lacks {', '.join(missing)}" if missing else f"has the names {there} in another order"
            found.append(f"{file}: '{key}' {what}; it must have {list(names)}.")
    shape = tuple((features.get(TACTILE) or {}).get("shape", image_shape))
    if shape != image_shape:
        found.append(
            f"{file}: the images '{TACTILE}' are {shape} and those of the twin's sensor {image_shape}; give"
            " the twin of the sensor that recorded them, at their size."
        )
    return found


def _of_episodes(
    episodes: dict[int, tuple[np.ndarray, np.ndarray]], range_kpa: tuple[float, float], area: int
) -> list[str]:
    """Faults of single episodes, those with the same fault in one sentence."""
    low, high = range_kpa
    slack = ROUNDING_KPA * (high - low)
    kinds: dict[str, list[int]] = {
        "holds numbers that are not finite": [],
        "has one frame only": [],
        "never touches anything (contact_area.pos is 0 throughout)": [],
        f"commands pressures beyond the {low:g} to {high:g} kPa that the twin was measured over": [],
    }
    broken, short, untouched, beyond = kinds.values()
    for number, (state, action) in episodes.items():
        if not (np.isfinite(state).all() and np.isfinite(action).all()):
            broken.append(number)
        elif len(action) < 2:
            short.append(number)
        elif not without_specks(state[:, area]).any():
            untouched.append(number)
        elif action[:, PRESSURES].min() < low - slack or action[:, PRESSURES].max() > high + slack:
            beyond.append(number)
    return [
        f"{f'Episode {which[0]}' if len(which) == 1 else f'Each of the episodes {which}'} {fault};"
        " leave out with lerobot-edit-dataset --operation.type=delete_episodes"
        f' --operation.episode_indices="{which}".'
        for fault, which in kinds.items()
        if which
    ]


def _close(name: str, names) -> str:
    close = difflib.get_close_matches(name, [str(n) for n in names], n=1, cutoff=0.75)
    return f" (there is '{close[0]}')" if close else ""
