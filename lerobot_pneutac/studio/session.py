"""What the studio knows: the twin, its recording, what was found, and the one work that is under way.

It lives in the server, so that any number of browsers see the same and none takes anything with it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from lerobot_pneutac.verbs.history import restore
from pneutac_sim.errors import InputError
from pneutac_sim.progress import Progress
from pneutac_sim.twin import Twin

if TYPE_CHECKING:
    from lerobot_pneutac.verbs.add import Addition
    from lerobot_pneutac.verbs.benches import Bench
    from lerobot_pneutac.verbs.diagnose import Diagnosis
    from lerobot_pneutac.verbs.result import Comparison
    from pneutac_datasets.recording.recording import Recording


class Session:
    """One twin at work; raises InputError where twin and recording do not go together.

    `twin` is as it lies on the disk, or the earlier `version` that is looked at (None for the newest);
    `working` is what is being done, and `measured` counts the programs that were driven at the bench.
    """

    def __init__(
        self,
        twin: Path,
        recording: Path | None,
        policy: str | Path = "",
        demonstrations: str | Path = "",
        bench: Bench | None = None,
    ):
        self.bench, self.measured = bench, 0
        self.policy, self.demonstrations = str(policy), str(demonstrations)
        self.folder, self.twin, self.version = twin, Twin.load(twin), None
        self.recording = None
        if recording is not None:
            # pandas and what fits recordings; without one the picture does not wait for them
            from lerobot_pneutac.study.pair import same_body
            from pneutac_datasets.recording.recording import Recording

            if (recording / "meta" / "info.json").is_file():
                remedy = "give it by --demonstrations=, and a bench recording here"
                raise InputError(f"recording={recording} is a LeRobotDataset; {remedy}.")
            self.recording = Recording.load(recording)
            same_body(self.twin, self.recording, "open")
        self.comparison: Comparison | None = None
        self.diagnosis: Diagnosis | None = None
        self.addition: Addition | None = None
        self.working = ""
        self._lock = threading.Lock()
        self._listeners: list[Callable[[], None]] = []

    def when_changed(self, listener: Callable[[], None]) -> None:
        self._listeners.append(listener)

    def needs_recording(self) -> Recording:
        """The recording; raises InputError where there is none."""
        if self.recording is None:
            start = f"start `pneutac studio --twin={self.folder} --recording=DIR`"
            raise InputError(f"There is no recording to weigh the twin against; {start}.")
        return self.recording

    def look_at(self, version: int | None = None) -> None:
        """Shows the twin as it lies on the disk, or an earlier version of it; nothing is written."""
        self.twin, self.version = Twin.load(self.folder, version), version
        self.comparison = self.diagnosis = None
        for listener in self._listeners:
            listener()

    def measure(self, recording: Recording) -> None:
        """From now on the twin is weighed against this recording, of which a bench measured the last part."""
        self.recording, self.measured = recording, self.measured + 1
        self.look_at(self.version)

    def keep(self) -> int:
        """Writes the version that is looked at as the newest; returns its number."""
        if self.version is None:
            raise InputError("The newest version is shown; choose an earlier one to go back to it.")
        twin = restore(self.folder, self.version)
        self.look_at()
        return len(twin.history) - 1

    def begin(
        self, what: str, work: Callable[[Progress], None], show: Progress, failed: Callable[[str], None]
    ) -> None:
        """Does a work, called with `show`, in a thread of its own; InputError where another is under way.

        `what` is such as `diagnosing`; `failed` is called with the sentence of an InputError.
        """
        with self._lock:
            if self.working:
                raise InputError(f"Still {self.working}; wait until that is done.")
            self.working = what

        def run() -> None:
            try:
                work(show)
            except InputError as e:
                failed(str(e))
            finally:
                self.working = ""

        threading.Thread(target=run, daemon=True, name=what).start()
