"""Recordings, generated and real, and the mean scores of a baseline fitted to their one pair."""

import os
from pathlib import Path

import pytest

from pneutac_datasets.generate.gel import write_gel_recording
from pneutac_datasets.recording.gel import GelRecording
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.gel.metrics import ImageScores, score
from pneutac_sim.gel.pair import Pair


@pytest.fixture(scope="session")
def generated(tmp_path_factory):
    return GelRecording.load(write_gel_recording(tmp_path_factory.mktemp("gel"), heldout=4))


@pytest.fixture(scope="session")
def photographs():
    def load(name):
        if "PNEUTAC_DATA" not in os.environ:
            pytest.skip("PNEUTAC_DATA is unset: there are no real photographs to compare with")
        folder = Path(os.environ["PNEUTAC_DATA"]) / "tactile" / name
        return GelRecording.load(Recording.load(folder))

    return load


@pytest.fixture(scope="session")
def fit():
    def fit(baseline, data):
        c = data.calibration
        return baseline.fit(Pair(data.rest, c.image, c.press, data.px_per_mm, data.thickness_mm))

    return fit


@pytest.fixture(scope="session")
def scores(fit):
    def scores(model, data, role="heldout"):
        """Mean over the images of a role, of a fitted baseline or of a class that is fitted first."""
        model = fit(model, data) if isinstance(model, type) else model
        return ImageScores.mean(
            [
                score(model.image(s.press), s.image, data.rest, s.x_px, s.y_px, s.radius_px)
                for s in data.samples
                if s.role == role
            ]
        )

    return scores
