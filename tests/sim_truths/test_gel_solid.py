import numpy as np
import pytest

from pneutac_truths.gel import solid
from pneutac_truths.gel.punches import KINDS, Punch, polygon_distance

pytest.importorskip("skfem", reason="needs scikit-fem (the dev extra)")
from pneutac_benchmarks.tactile.drag import drag
from pneutac_truths.gel.solid import Rubber, press

TRIANGLE = ((-1.5, -1.0), (1.5, -1.0), (0.0, 1.6))


def test_every_indenter_stands_on_the_origin():
    for kind in KINDS:
        punch = Punch(kind, 3.0, TRIANGLE if kind == "outline" else ())
        below, above = punch.distance(np.array([[0, 0, -0.1], [0, 0, 0.1]]))
        assert below > 0 > above, kind
        assert punch.distance(np.array([[0.0, 0.0, 0.0]])) == pytest.approx(0.0, abs=1e-9)


def test_distances_grow_by_their_own_length():
    points = np.random.default_rng(0).uniform([-4, -4, -2], [4, 4, 0], (200, 3))
    for kind in KINDS:
        size = np.linalg.norm(Punch(kind, 3.0, TRIANGLE if kind == "outline" else ()).outward(points), axis=1)
        assert np.median(size) == pytest.approx(1.0, abs=1e-6)
        assert size.max() < 1 + 1e-6


def test_a_polygon_knows_its_inside():
    square = np.array([(-1.0, -1), (1, -1), (1, 1), (-1, 1)])
    found = polygon_distance(np.array([[0.0, 0], [0.5, 0], [2, 0], [2, 2]]), square)
    assert found == pytest.approx([-1, -0.5, 1, np.sqrt(2)])


def test_half_or_a_quarter_of_the_gel_will_do_where_it_mirrors():
    assert Punch("cube").mirrored == (True, True)
    assert Punch("outline", outline_mm=TRIANGLE).mirrored == (True, False)
    assert Punch("outline", outline_mm=((0, 0), (2, 0), (0, 1))).mirrored == (False, False)


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


def test_finer_elements_change_less_and_less():
    force = [press(Punch("sphere", 3.0), 0.24, Rubber(1.5), h).force_n for h in (0.5, 0.3, 0.2)]
    assert abs(force[2] - force[1]) < abs(force[1] - force[0])
    assert force[2] == pytest.approx(force[1], rel=0.1)


def test_rubber_that_is_pushed_away_bulges_beside_the_punch():
    face = press(Punch("cube", 2.0), 0.2, Rubber(2.0), 0.25)
    assert face.moved_mm[..., 2].max() > 0.003
    assert face.moved_mm[..., 2] == pytest.approx(face.moved_mm[::-1, :, 2])


def test_a_step_that_finds_no_equilibrium_is_halved(monkeypatch):
    settle, tried = solid.Mesh.settle, [0.0]

    def timid(self, u, punch, depth_mm):
        if depth_mm - tried[-1] > 0.15:
            raise ArithmeticError("too far")
        tried.append(depth_mm)
        return settle(self, u, punch, depth_mm)

    monkeypatch.setattr(solid.Mesh, "settle", timid)
    found = press(Punch("sphere", 3.0), 0.4, Rubber(2.5, 40.0, 0.49), 0.8, 0.2)
    np.testing.assert_allclose(tried, [0.0, 0.1, 0.2, 0.3, 0.4], atol=1e-12)
    assert found.force_n > 0
    with pytest.raises(ArithmeticError, match="too far"):
        tried[:] = [-9.0]
        press(Punch("sphere", 3.0), 0.4, Rubber(2.5, 40.0, 0.49), 0.8, 0.2)


def test_a_dragged_ball_takes_the_face_along_and_piles_it_up_in_front():
    rubber = Rubber(2.0, 40.0, 0.49)
    before, after = drag(Punch("sphere", 3.0), 0.6, [0.0, 0.3], rubber, friction=1.0, fine_mm=0.8)
    (slid,) = drag(Punch("sphere", 3.0), 0.6, [0.3], rubber, friction=0.0, fine_mm=0.8)
    x, y = np.array([-2.5, 0.0, 3.1]), np.zeros(3)  # behind, under and in front of it, where it stands then
    assert np.allclose(before.at(x[1:2], y[1:2])[:, 0], 0, atol=1e-6)
    assert 0.2 < after.at(x[1:2], y[1:2])[0, 0] < 0.31 and slid.at(x[1:2], y[1:2])[0, 0] < 0.1
    up = after.at(x, y)[:, 2] - slid.at(x, y)[:, 2]
    assert up[2] > 0.005 and up[2] > up[0]
