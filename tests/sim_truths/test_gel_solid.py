from dataclasses import replace

import numpy as np
import pytest

from pneutac_benchmarks.tactile.drag import drag
from pneutac_truths.__main__ import main
from pneutac_truths.gel.scene import Look, Sensor, grid, shine
from pneutac_truths.gel.session import GEL_EFFECTS, _session, named, write_gel
from pneutac_truths.gel.solid import KINDS, Punch, Rubber, press
from pneutac_truths.light import (
    BOX,
    CAPSULE,
    CYLINDER,
    ELLIPSOID,
    SPHERE,
    Gel,
    HalfSpace,
    Lamps,
    light,
    love,
    reach_below,
)

pytest.importorskip("skfem", reason="needs scikit-fem (the dev extra)")


def test_every_indenter_stands_on_the_origin():
    for kind in KINDS:
        punch = Punch(kind, 3.0)
        below, above = punch.distance(np.array([[0, 0, -0.1], [0, 0, 0.1]]))
        assert below > 0 > above, kind
        assert punch.distance(np.array([[0.0, 0.0, 0.0]])) == pytest.approx(0.0, abs=1e-9)


def test_distances_grow_by_their_own_length():
    points = np.random.default_rng(0).uniform([-4, -4, -2], [4, 4, 0], (200, 3))
    for kind in KINDS:
        size = np.linalg.norm(Punch(kind, 3.0).outward(points), axis=1)
        assert np.median(size) == pytest.approx(1.0, abs=1e-6)
        assert size.max() < 1 + 1e-6


def hertz(radius, depth, rubber):
    """Force of a ball on a half-space, N (Johnson, Contact Mechanics, eq. 4.23)."""
    E = 2 * rubber.mu_kpa * (1 + rubber.poisson)
    return 4 / 3 * 1e-3 * E / (1 - rubber.poisson**2) * np.sqrt(radius) * depth**1.5


@pytest.mark.slow
def test_a_ball_on_a_bonded_layer_follows_hertz_with_the_layers_correction():
    """Dimitriadis et al., Biophys. J. 82 (2002) 2798, eq. 12, for a bonded incompressible layer."""
    rubber, radius, depth = Rubber(4.0, 40.0, 0.49), 3.0, 0.24
    face = press(Punch("sphere", radius), depth, rubber, 0.25)
    x = np.sqrt(radius * depth) / rubber.thickness_mm
    layer = 1 + 1.133 * x + 1.283 * x**2 + 0.769 * x**3 + 0.0975 * x**4
    assert face.force_n == pytest.approx(layer * hertz(radius, depth, rubber), rel=0.06)
    assert face.at(np.zeros(1), np.zeros(1))[0, 2] == pytest.approx(-depth, rel=0.02)


def test_a_wide_punch_on_a_thin_layer_compresses_a_column():
    """Bonded and narrow beside its width, it strains in z alone: F = M pi a^2 d / t."""
    rubber, a, depth = Rubber(0.6, 40.0, 0.3), 4.0, 0.03
    column = 2 * rubber.mu_kpa * 0.7 / 0.4 * np.pi * a**2 * depth / rubber.thickness_mm * 1e-3
    assert press(Punch("cylinder", a), depth, rubber, 0.25).force_n == pytest.approx(column, rel=0.08)


@pytest.mark.nightly  # every day: a ball on a layer follows Hertz, above
@pytest.mark.slow
def test_finer_elements_change_less_and_less():
    force = [press(Punch("sphere", 3.0), 0.24, Rubber(1.5), h).force_n for h in (0.5, 0.3, 0.2)]
    assert abs(force[2] - force[1]) < abs(force[1] - force[0])
    assert force[2] == pytest.approx(force[1], rel=0.1)


def test_rubber_that_is_pushed_away_bulges_beside_the_punch():
    face = press(Punch("cube", 2.0), 0.2, Rubber(2.0), 0.25)
    assert face.moved_mm[..., 2].max() > 0.003
    assert face.moved_mm[..., 2] == pytest.approx(face.moved_mm[::-1, :, 2])


@pytest.mark.nightly  # every day: a ball on a layer follows Hertz, above
@pytest.mark.slow
def test_a_dragged_ball_takes_the_face_along_and_piles_it_up_in_front():
    rubber = Rubber(2.0, 40.0, 0.49)
    before, after = drag(Punch("sphere", 3.0), 0.6, [0.0, 0.3], rubber, friction=1.0, fine_mm=0.8)
    (slid,) = drag(Punch("sphere", 3.0), 0.6, [0.3], rubber, friction=0.0, fine_mm=0.8)
    x, y = np.array([-2.5, 0.0, 3.1]), np.zeros(3)  # behind, under and in front of it, where it stands then
    assert np.allclose(before.at(x[1:2], y[1:2])[:, 0], 0, atol=1e-6)
    assert 0.2 < after.at(x[1:2], y[1:2])[0, 0] < 0.31 and slid.at(x[1:2], y[1:2])[0, 0] < 0.1
    up = after.at(x, y)[:, 2] - slid.at(x, y)[:, 2]
    assert up[2] > 0.005 and up[2] > up[0]


pytest.importorskip("mitsuba", reason="needs Mitsuba 3 (the dev extra)")

SMALL = Sensor(image_px=(80, 60), gloss=0.0)
ONE = replace(SMALL, leds=SMALL.leds[:1], colours=SMALL.colours[:1])  # shines from -x
X, Y = grid(SMALL)
FLAT = np.zeros((*X.shape, 3))


@pytest.fixture(scope="module")
def rest():
    return shine(SMALL, FLAT, Look())


def test_the_camera_sees_a_point_where_snells_law_puts_it(rest):
    coat = 1 - np.exp(-((X + 5) ** 2 + (Y - 3) ** 2) / 0.6**2)
    lost = rest[0] - shine(ONE, FLAT, Look(coat=coat))[0]
    lost[lost < 0.5 * lost.max()] = 0  # what is left elsewhere is the rays' noise
    rows, columns = np.indices(lost.shape) + 0.5
    seen = (columns * lost).sum() / lost.sum(), (rows * lost).sum() / lost.sum()
    assert seen == pytest.approx(SMALL.pixel(-5, 3), abs=0.5)


def acted(name):
    session = _session(Sensor(), 6, np.random.default_rng(1))
    parameters = GEL_EFFECTS[name].draw(np.random.default_rng(2))
    GEL_EFFECTS[name].act(session, **parameters)
    return session, parameters


def test_a_dim_led_dims_from_some_press_on():
    session, parameters = acted("dim_led")
    led = session.power[:, int(parameters["which"])]
    assert led[0] == 1.0
    assert led[-1] == parameters["share"]
    assert (np.delete(session.power, int(parameters["which"]), 1) == 1).all()


def test_a_warm_red_led_dims_most():
    power = acted("heating_drift")[0].power
    assert (np.diff(power, axis=0) < 0).all()
    assert power[-1, 0] < power[-1, 1] == power[-1, 2]


def test_bad_input_is_one_sentence(tmp_path, capsys):
    with pytest.raises(ValueError, match="no effect 'moth' of a gel; give one of worn_membrane"):
        named(["moth"])
    with pytest.raises(ValueError, match="1 presses are too few"):
        write_gel(["plain"], tmp_path / "a", presses=1)
    with pytest.raises(SystemExit):
        main(["--device=gel", "--effect=moth", f"--out={tmp_path / 'b'}"])
    assert "no effect 'moth' of a gel" in capsys.readouterr().err


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
