"""From touch alone: the gel's light at rest is taken again from demonstrations."""

import time
from dataclasses import dataclass

import numpy as np

from lerobot_pneutac.verbs.result import Calibration
from pneutac_datasets.demonstrations.replay.imprint import Dragging, LightDrift, light_drift, rest_image
from pneutac_datasets.demonstrations.replay.reading import Demonstrations
from pneutac_sim.errors import InputError
from pneutac_sim.gel.model import GelModel
from pneutac_sim.twin import Twin

COLOURS = ("red", "green", "blue")
LEAST = 2  # episodes: one to take the light from, one to test it


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class LightCalibration(Calibration):
    """A twin whose gel is lit at rest as in demonstrations."""

    light: LightDrift  # how the light had changed since the twin was made
    before: float  # error of the twin's own rest image on the held-out episodes, levels
    task: str
    dragging: Dragging | None = None  # how imprints turned where the finger was dragged sideways; None if not
    dragged_before: Dragging | None = None  # the same as the twin knew it

    heading = "The gel's light at rest"

    @property
    def sentence(self) -> str:
        if self.error["heldout"] == self.before:
            return f"{self.light.sentence} The rest image is unchanged: it is {self.before:.2f} levels off."
        return (
            f"{self.light.sentence.split(';')[0].rstrip('.')}. On rest frames of held-out episodes the "
            f"twin's own rest image is {self.before:.2f} levels off, the new one {self.error['heldout']:.2f}."
        )

    def rows(self) -> list[dict]:
        parts = zip(COLOURS, self.light.gain, self.light.levels, strict=True)
        return [{"colour": name, "factor": gain, "levels": level} for name, gain, level in parts]

    def remarks(self) -> list[str]:
        out = [
            "How the light changes under a press stays as it was calibrated; presses of known objects on the "
            f"bench calibrate that{self._now()}."
        ]
        return out + ([self.dragging.sentence(self.dragged_before)] if self.dragging else [])

    def _noted(self) -> dict:
        return {"dragging": self.dragging.to_history(self.task)} if self.dragging else {}

    def content(self) -> dict:
        return super().content() | {"light": self.light.to_dict(), "before": self.before}


def calibrate_demonstrations(twin: Twin, given: Demonstrations, seed: int = 0) -> LightCalibration:
    """Takes the gel's rest image from the frames before the first touches, of two episodes at least."""
    began = time.perf_counter()
    if len(given.episodes) < LEAST:
        raise InputError(f"{given.folder} has {len(given.episodes)} episode; a rest image takes {LEAST}.")
    model = GelModel.from_twin(twin)
    rests = np.stack([rest_image(e) for e in given.episodes]).astype(float)
    if rests.shape[1:] != model.rest_image.shape:
        raise InputError(
            f"{given.folder}: the images are {rests.shape[1:]} and the gel's {model.rest_image.shape}; "
            "calibrate the gel on its own camera first."
        )
    order = np.random.default_rng([seed, 6]).permutation(len(rests))
    heldout, used = np.split(order, [max(1, len(rests) // 3)])
    new = np.median(rests[used], axis=0).round().astype(np.uint8)
    out = twin.copy()
    if not out.gel:
        raise InputError("The twin has no gel of its own yet; calibrate one with a bench recording first.")

    def off(image: np.ndarray, which: np.ndarray) -> float:
        return float(np.sqrt(np.mean((rests[which] - image.astype(float)) ** 2)))

    light, before = light_drift(given.episodes, model.rest_image), off(model.rest_image, heldout)
    if off(new, heldout) >= before:  # nothing has changed by more than the camera wanders
        new = model.rest_image
    out.arrays = out.arrays | {"rest_image": new}
    return LightCalibration(
        twin=out,
        parameters={
            f"{c}_factor": {"value": g, "unit": ""} for c, g in zip(COLOURS, light.gain, strict=True)
        },
        error={"train": off(new, used), "heldout": off(new, heldout)},
        unit="levels",
        evaluations=1,
        seconds=time.perf_counter() - began,
        recording=str(given.folder),
        change="light at rest",
        seed=seed,
        light=light,
        before=before,
        task=given.task,
        dragging=Dragging.of(given.episodes),
        dragged_before=Dragging.known(twin.history, given.task),
    )
