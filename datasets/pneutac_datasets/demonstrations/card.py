"""The card of a dataset of demonstrations: its README.md, with features, units, station and licence."""

import json
from pathlib import Path

from pneutac_sim.features import unit_of
from pneutac_sim.files import write_text
from pneutac_sim.pace import DONE, OUTCOME_FILE, read_info, read_outcomes
from pneutac_sim.world.station import Station, station_of


def write_card(
    folder: str | Path, licence: str = "apache-2.0", source: str = "Recorded by a teleoperator."
) -> Path:
    """Writes `README.md` into the folder of a LeRobotDataset; returns it.

    `licence` is by the Hub's identifiers, `source` who or what made it; of a dataset of `pneutac augment` the
    card says so itself. Raises InputError where `info.json` or the station is damaged.
    """
    folder = Path(folder)
    write_text(folder / "README.md", dataset_card(folder, licence, source))
    return folder / "README.md"


def dataset_card(folder: Path, licence: str, source: str) -> str:
    """The card as Markdown with the Hub's header."""
    info = read_info(folder / "meta/info.json")
    left, outcomes = station_of(folder), read_outcomes(folder / "meta")
    station = left or Station()
    arm = station.arm if isinstance(station.arm, str) else "described in `meta/station.yaml`"
    low, high = (", ".join(f"{x:g}" for x in c) for c in (station.workspace_low_m, station.workspace_high_m))
    failed = [str(k) for k, why in sorted(outcomes.items()) if why != DONE]
    rows = [row for key, feature in info["features"].items() for row in _rows(key, feature)]
    episodes = f"{info['total_episodes']} episode{'s' * (info['total_episodes'] != 1)}"
    made = (folder / "meta/provenance.jsonl").is_file()
    return "\n".join(
        [
            "---", f"license: {licence}", "task_categories: [robotics]", "tags: [LeRobot, pneutac, tactile]",
            "configs:", "- config_name: default", "  data_files: data/*/*.parquet", "---", "",
            "# Demonstrations with a soft finger and a touch sensor", "",
            f"{episodes}, {info['total_frames']} frames at {info['fps']} Hz, robot"
            f" type `{info.get('robot_type')}`, LeRobot dataset format {info.get('codebase_version')}.",
            "Made by `pneutac augment`; `meta/provenance.jsonl` names method and source of each episode."
            if made else source,
            *([f"Episodes that failed: {', '.join(failed)} (`meta/{OUTCOME_FILE}`)."] if failed else []),
            "", "## Features", "", "| feature | name or shape | unit |", "|---|---|---|", *rows, "",
            "## Station", "",
            f"Arm {arm}, mount {station.mount_mm:g} mm, control rate {station.control_hz} Hz, workspace"
            f" of the flange from ({low}) to ({high}) m"
            + ("." if left else ", the paper's: no `station.yaml` was left here."),
            "", "## Licence", "", f"{licence}; LeRobot's default where its owner gave no other.", "",
        ]
    )  # fmt: skip


def _rows(key: str, feature: dict) -> list[str]:
    names = feature.get("names")
    if feature["dtype"] in ("video", "image"):
        return [f"| `{key}` | {' x '.join(map(str, feature['shape']))} {feature['dtype']}, RGB | 0 to 255 |"]
    if isinstance(names, list) and key in ("observation.state", "action"):
        return [f"| `{key}` | `{name}` | {unit_of(name)} |" for name in names]
    units = ", ".join(dict.fromkeys((feature.get("info") or {}).get("units", [])))
    unit = units or {"timestamp": "s"}.get(key, "")
    return [f"| `{key}` | {json.dumps(list(feature['shape']))} {feature['dtype']} | {unit} |"]
