"""`pneutac studio`: its options, and the server that runs until it is interrupted."""

import threading
from dataclasses import dataclass
from pathlib import Path

from lerobot_pneutac.cli.terminal import Terminal
from lerobot_pneutac.verbs.benches import check_bench, make_bench
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin


@dataclass
class StudioConfig:
    """Options of `pneutac studio`."""

    twin: Path  # folder of the twin; nothing is written to it unless a button that says so is pressed
    recording: Path | None = None  # folder of a bench recording of the same finger, arm or gel
    policy: str = ""  # folder of a trained policy, or its name on the Hub, for the world page
    demonstrations: str = ""  # folder of a LeRobotDataset, or its name on the Hub, likewise
    # where the next experiment is driven, by a button that says so: `none`, `standin`, the finger that stands
    # in for a real one, or `measure`, your bench
    bench: str = "none"
    measure: Path | None = None  # YAML file of `pneutac measure` for your bench, without `program` and `out`
    port: int = 8080  # of this machine to listen on; 0 for any that is free

    def __post_init__(self):
        if not 0 <= self.port < 65536:
            raise InputError(f"port={self.port} must be between 0 and 65535.")
        if self.bench != "none" or self.measure is not None:
            check_bench(self.bench, self.measure)


def command(cfg: StudioConfig, terminal: Terminal) -> None:
    device = Twin.load(cfg.twin).device  # before there is an address: a misspelt folder has none
    try:
        from lerobot_pneutac.studio.app import Studio
    except ModuleNotFoundError as e:
        if e.name != "viser":
            raise
        raise InputError("The studio needs viser; in a clone: uv pip install -e '.[studio]'") from e
    from lerobot_pneutac.studio.app import Session

    bench = None if cfg.bench == "none" else make_bench(cfg.measure, Path("outputs/studio"), 0, device)[0]
    session = Session(cfg.twin, cfg.recording, cfg.policy, cfg.demonstrations, bench)
    studio = Studio(cfg.port)
    terminal.say(f"The studio opens at {studio.address} (Ctrl+C ends it)")
    try:
        studio.show(session)
        threading.Event().wait()
    finally:
        studio.close()
