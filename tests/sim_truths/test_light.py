import numpy as np
import pytest

from pneutac_truths.light import Gel
from pneutac_truths.light.contact import HalfSpace, love
from pneutac_truths.light.objects import BOX, CAPSULE, CYLINDER, ELLIPSOID, SPHERE, reach_below
from pneutac_truths.light.rays import Lamps, light

UPRIGHT = [np.eye(3)]
XS = np.linspace(-5.75, 5.75, 47)
YS = np.linspace(-7.75, 7.75, 63)


@pytest.fixture(scope="module")
def gel():
    return Gel()


def ball(radius, depth, x=0.0, y=0.0):
    return [SPHERE], [[radius, 0, 0]], [[x, y, radius - depth]], UPRIGHT


def plane(depth):
    return [BOX], [[30, 30, 10]], [[0, 0, 10 - depth]], UPRIGHT


def test_an_even_pressure_on_a_square_dents_its_middle_as_love_says():
    """Johnson, Contact Mechanics (1985) sec. 3.3: 1.122 p a / E* for a square of side a."""
    assert love(0.0, 0.0, 1.0, 1.0) / np.pi == pytest.approx(1.122 * 2, rel=1e-3)


def test_far_away_a_rectangle_is_boussinesqs_point():
    assert love(30.0, 40.0, 0.5, 0.25) == pytest.approx(0.5 / 50.0, rel=1e-3)


@pytest.mark.parametrize(("radius", "depth"), [(3.0, 0.9), (4.0, 0.5), (2.0, 0.6)])
def test_a_ball_is_pressed_in_as_hertz_says(radius, depth):
    modulus, cell = 100.0, 0.2
    x = (np.arange(60) - 29.5) * cell
    r = np.hypot(x[None, :], x[:, None])
    below = depth - r**2 / (2 * radius)
    u, force = HalfSpace(modulus, (cell, cell), (60, 60)).press(below)
    assert force == pytest.approx(4 / 3 * 1e-3 * modulus * np.sqrt(radius) * depth**1.5, rel=0.02)
    # Outside the contact, of radius a = sqrt(R d): Johnson eq. 3.42b
    a, out = np.sqrt(radius * depth), r > 1.3 * np.sqrt(radius * depth)
    s = a / r[out]
    hertz = depth / np.pi * ((2 - 1 / s**2) * np.arcsin(s) + np.sqrt(1 / s**2 - 1))
    assert u[out] == pytest.approx(hertz, abs=0.02 * depth)
    held = r < 0.9 * a
    assert u[held] == pytest.approx(below[held], abs=5e-3 * depth)


def test_nothing_in_front_leaves_the_face_at_rest(gel):
    u, force = gel.press(*plane(-0.1))
    assert force == 0.0
    assert not u.any()
    assert (gel.image(u) == gel.rest_image).all()


def lowest(kind, size, turn=UPRIGHT[0]):
    """How far a shape reaches below its own centre, which lies 2 mm above the plane, and where."""
    reach = reach_below([kind], [size], [[0.5, -1.0, 2.0]], [turn], XS, YS)
    i, j = np.unravel_index(reach.argmax(), reach.shape)
    return reach.max() + 2.0, XS[j], YS[i]


@pytest.mark.parametrize(
    ("kind", "size", "low"),
    [
        (SPHERE, (3.0, 0, 0), 3.0),
        (CAPSULE, (1.0, 1.5, 0), 2.5),
        (ELLIPSOID, (2.0, 4.0, 2.6), 2.6),
        (CYLINDER, (1.0, 2.4, 0), 2.4),
        (BOX, (1.0, 2.0, 3.0), 3.0),
    ],
)
def test_shapes_reach_as_far_as_they_are_long(kind, size, low):
    found, x, y = lowest(kind, size)
    assert found == pytest.approx(low, abs=0.01)
    if kind not in (CYLINDER, BOX):
        assert (x, y) == pytest.approx((0.5, -1.0), abs=0.26)


def test_a_slope_towards_a_lamp_is_brighter_in_its_colour(gel):
    """Red shines from the left; a dent stands out towards the camera, so its left side faces red."""
    u, _ = gel.press(*ball(3.0, 0.8))
    change = gel.image(u).astype(float) - gel.rest_image
    left, right = change[150:170, 92:108].mean((0, 1)), change[150:170, 132:148].mean((0, 1))
    assert left[0] > 10 > -10 > right[0]
    assert right[1] > 10 > -5 > left[1]


def test_a_dent_throws_a_shadow_away_from_the_lamp():
    """Flat ground behind a ridge is darker than without it, in front of it it is not."""
    red = Lamps(places=np.array([[-9.0, 0.0, -2.0]]), colours=np.array([[80.0, 0, 0]]))
    flat = np.zeros((len(YS), len(XS)))
    ridge = flat - 1.2 * np.exp(-((XS / 0.6) ** 2))
    change = (light(ridge, XS, YS, red) - light(flat, XS, YS, red))[..., 0]
    row = change[len(YS) // 2]
    assert row[np.searchsorted(XS, 2.5)] < -15
    assert abs(row[np.searchsorted(XS, -4.0)]) < 1


def test_corners_are_darker_by_the_fourth_power_of_the_cosine():
    even = Lamps(places=np.zeros((0, 3)), colours=np.zeros((0, 3)))
    out = -np.log(1 - light(np.zeros((len(YS), len(XS))), XS, YS, even) / 255)[..., 0]
    corner = 1 / (1 + (XS[0] ** 2 + YS[0] ** 2) / even.camera_mm**2) ** 2
    assert out[0, 0] / out[31, 23] == pytest.approx(corner, rel=1e-3)


def test_a_touch_beyond_arithmetic_is_none():
    body = HalfSpace(100.0, (0.25, 0.25), (40, 40))
    u, force = body.press(np.full((40, 40), 1e-170))
    assert force == 0 and not u.any()
