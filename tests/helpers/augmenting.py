"""Options of an augmentation whose datasets are never opened."""

from pathlib import Path

from pneutac_datasets.demonstrations.augment.episode import AugmentSetup
from pneutac_datasets.demonstrations.augment.options import AugmentConfig, DatasetRef


def config_of(source: Path, new: Path, **options) -> AugmentConfig:
    """Of datasets that are named after their folders."""
    refs = {"dataset": DatasetRef(f"local/{source.name}", source)}
    return AugmentConfig(**refs, output=DatasetRef(f"local/{new.name}", new), **options)


def setup_of(references: list, task: str = "switch", candidates: int = 48, **options) -> AugmentSetup:
    """Of references; with the planner, formulas and seed 1 where the options do not say."""
    options = {"method": "planner", "fidelity": "probe", "seed": 1} | options
    config = config_of(Path("recorded"), Path("new"), **options)
    return AugmentSetup(config, references, task, candidates=candidates)
