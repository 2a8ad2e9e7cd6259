"""The models between which a diagnosis could not yet choose, in a folder."""

import json
from collections.abc import Sequence
from pathlib import Path

from lerobot_pneutac.diagnosis.result import Candidate
from pneutac_sim.errors import InputError
from pneutac_sim.files import write_json
from pneutac_sim.twin import Twin

FILE = "contenders.json"


def save_contenders(folder: str | Path, contenders: Sequence[Candidate]) -> None:
def described(contenders: Sequence[Contender]) -> list[dict]:
    """Terms and probability of each."""
    return [{"terms": list(c.terms), "probability": c.probability} for c in contenders]

def save_contenders(folder: str | Path, contenders: Sequence[Contender]) -> None:
    """Writes their twins, and last what they are."""
    for i, c in enumerate(contenders):
        c.twin.save(Path(folder) / "contenders" / str(i))
    write_json(Path(folder) / FILE, described(contenders))


def load_contenders(folder: str | Path) -> list[Candidate]:
    """What `save_contenders` wrote; raises InputError where there is nothing."""
    file = Path(folder) / FILE
    if not file.is_file():
        raise InputError(f"There is no {file}; give the folder that `pneutac diagnose --out=` wrote.")
    told = json.loads(file.read_text())
    return [
        Candidate(Twin.load(Path(folder) / "contenders" / str(i)), tuple(c["terms"]), c["probability"])
        for i, c in enumerate(told)
    ]
