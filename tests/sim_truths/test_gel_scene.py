from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("mitsuba", reason="needs Mitsuba 3 (the dev extra)")
from pneutac_truths.gel.scene import Look, Sensor, grid, shine

SMALL = Sensor(image_px=(80, 60), gloss=0.0)
ONE = replace(SMALL, leds=SMALL.leds[:1], colours=SMALL.colours[:1])  # shines from -x
X, Y = grid(SMALL)
FLAT = np.zeros((*X.shape, 3))


@pytest.fixture(scope="module")
def rest():
    return shine(SMALL, FLAT, Look())


def moved(z):
    return np.stack([0 * z, 0 * z, z], -1)


def test_each_led_lights_its_own_side(rest):
    left, right, below = rest
    assert left[:, :20].mean() > 1.5 * left[:, -20:].mean()
    assert right[:, -20:].mean() > 1.5 * right[:, :20].mean()
    assert below[-15:].mean() > 1.5 * below[:15].mean()


def test_half_the_coat_sends_half_the_light(rest):
    """A little less for what met the face twice; two hundredths are the rays' noise."""
    worn = shine(ONE, FLAT, Look(coat=np.full(X.shape, 0.5)))[0]
    assert 0.45 < worn.mean() / rest[0].mean() < 0.52


def test_a_dent_shades_what_lies_behind_it(rest):
    ridge = moved(-1.0 * np.exp(-(((X + 1) / 0.6) ** 2)))
    change = shine(ONE, ridge, Look())[0] / rest[0] - 1
    facing, behind, before = (change[20:40, a:b].mean() for a, b in ((30, 34), (38, 44), (8, 16)))
    assert facing > 0.3
    assert behind < -0.3
    assert abs(before) < 0.1


def test_the_camera_sees_a_point_where_snells_law_puts_it(rest):
    coat = 1 - np.exp(-((X + 5) ** 2 + (Y - 3) ** 2) / 0.6**2)
    lost = rest[0] - shine(ONE, FLAT, Look(coat=coat))[0]
    lost[lost < 0.5 * lost.max()] = 0  # what is left elsewhere is the rays' noise
    rows, columns = np.indices(lost.shape) + 0.5
    seen = (columns * lost).sum() / lost.sum(), (rows * lost).sum() / lost.sum()
    assert seen == pytest.approx(SMALL.pixel(-5, 3), abs=0.5)


def test_dust_on_the_plate_hides_what_is_behind_it(rest):
    dusty = shine(ONE, FLAT, Look(specks_mm=np.array([[0.0, 0.0, 0.5]])))[0]
    assert dusty[28:32, 38:42].mean() < 0.5 * rest[0][28:32, 38:42].mean()
    assert dusty[:15].mean() == pytest.approx(rest[0][:15].mean(), rel=0.02)
