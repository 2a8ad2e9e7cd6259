import numpy as np
import pytest
from PIL import Image

from lerobot_robot_pneutac.standin.gel import new_gel
from pneutac_datasets.generate.standin import write_finger, write_gel
from pneutac_datasets.recording.gel import GelRecording
from pneutac_sim.finger import BodyData
from pneutac_sim.finger.fit import fit
from pneutac_sim.twin import Twin


@pytest.fixture(scope="module")
def finger(tmp_path_factory):
    return write_finger(tmp_path_factory.mktemp("standin") / "finger", seed=1, minutes=1)


@pytest.mark.slow
def test_the_seed_decides_the_finger(finger, tmp_path):
    again, other = (write_finger(tmp_path / str(s), seed=s, minutes=1) for s in (1, 2))
    assert again.samples.equals(finger.samples)
    assert not other.samples["tip_x_mm"].equals(finger.samples["tip_x_mm"])


def test_it_is_no_mirror_of_the_twins_effects(finger):
    """Creep by the library explains much of it, and never all: a told error stays above the noise."""
    assert set(finger.trials()) == {0, 1, 2}
    bench = BodyData.of(finger, Twin.builtin())
    plain = fit(Twin.builtin(), bench, effects=[])
    creeping = fit(Twin.builtin(), bench, effects=["creep"])
    assert creeping.train < 0.97 * plain.train
    assert creeping.train > 1.1 * np.sqrt(3) * 0.3  # mm, of the marker
    command, gauge = finger.column("pressure_cmd_kpa"), finger.column("pressure_kpa")
    assert np.sqrt(np.mean((command - gauge) ** 2)) > 0.3  # the air


def test_the_gel_recording_loads_and_shows_its_presses(tmp_path):
    data = GelRecording.load(write_gel(tmp_path / "gel", seed=1))
    assert data.calibration.press.depth_mm == 0.9
    assert sum(s.role == "heldout" for s in data.samples) >= 10
    assert data.warnings == []
    for s in data.samples[:4]:
        change = np.abs(s.image.astype(int) - s.rest).mean(2)
        inside = s.photograph.near(data.px_per_mm, 1.0)
        assert change[inside].mean() > 3 * change[~s.photograph.near(data.px_per_mm)].mean()
    rest = np.asarray(Image.open(tmp_path / "gel" / "rest.png"))
    assert (rest == new_gel().rest_image).all()
