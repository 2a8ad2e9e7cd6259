import numpy as np
import pytest
from scipy.optimize import nnls

from pneutac_sim.errors import InputError
from pneutac_sim.gel.layer import LayerGel, compliance
from pneutac_sim.gel.sensor import TactileSensor

G, NU = 0.02, 0.49


def ball(radius, depth, window, n):
    """Imprint of a ball on an n x n grid over a square window, and the distance from its middle, mm."""
    x = (np.arange(n) + 0.5) / n * window - window / 2
    r = np.hypot(x, x[:, None])
    return np.maximum(depth - r**2 / (2 * radius), 0).astype(np.float32), r


def test_short_waves_see_a_half_space_and_long_ones_a_column():
    t = 2.5
    assert compliance(np.array(20.0), t, NU, G) == pytest.approx((1 - NU) / (G * 20.0), rel=1e-6)
    modulus = 2 * G * (1 - NU) / (1 - 2 * NU)
    assert compliance(np.array(0.0), t, NU, G) == pytest.approx(t / modulus)
    assert compliance(np.array(1e-3), t, NU, G) == pytest.approx(t / modulus, rel=1e-2)
    assert np.isfinite(compliance(np.array(1e4), t, NU, G))


def test_a_small_contact_on_a_thick_layer_is_hertz():
    radius, depth, window, n = 4.0, 0.04, 3.0, 120
    d, r = ball(radius, depth, window, n)
    layer = LayerGel((window, window), 12.0, NU, G, shape=(n, n))
    p = layer.pressure(d)
    modulus, a = 2 * G / (1 - NU), np.sqrt(radius * depth)
    assert np.sqrt((p > 0).sum() / np.pi) * window / n == pytest.approx(a, rel=0.04)
    hertz = 2 * modulus / (np.pi * radius) * np.sqrt(np.maximum(a**2 - r**2, 0))
    assert np.abs(p - hertz)[r < 0.9 * a].max() < 0.05 * hertz.max()
    assert p.sum() * (window / n) ** 2 == pytest.approx(
        4 / 3 * modulus * np.sqrt(radius) * depth**1.5, rel=0.05
    )
    # Outside the contact the face sags as on a half-space (Johnson, eq. 3.42a).
    off = (r > 1.2 * a) & (r < 1.4)
    sag = ((2 * a**2 - r**2) * np.arcsin(np.minimum(a / r, 1)) + a * np.sqrt(np.maximum(r**2 - a**2, 0))) / (
        np.pi * radius
    )
    assert np.abs(layer.displacement(d) - sag)[off].max() < 0.06 * depth


def test_a_wide_flat_punch_on_a_thin_layer_compresses_a_column():
    nu, t, depth, n = 0.3, 0.4, 0.05, 64
    layer = LayerGel((12.0, 12.0), t, nu, G, shape=(n, n))
    d = np.zeros((n, n), np.float32)
    d[12:-12, 12:-12] = depth
    modulus = 2 * G * (1 - nu) / (1 - 2 * nu)
    assert layer.pressure(d)[26:-26, 26:-26] == pytest.approx(depth * modulus / t, rel=0.01)
    assert np.abs(layer.displacement(d)[:6]).max() < 0.02 * depth  # nothing moves a few thicknesses away


@pytest.mark.parametrize("shape", ["ball", "two boxes"])
def test_no_tension_no_overlap_and_no_pressure_across_a_gap(shape):
    d = np.zeros((80, 59), np.float32)
    if shape == "ball":
        d[:59] = ball(3.0, 1.2, 12.0, 59)[0]
    else:
        d[20:30, 10:30], d[28:60, 35:45] = 0.4, 0.9
    layer = LayerGel()
    p, u = layer.pressure(d), layer.displacement(d)
    gap = u - d
    assert p.min() >= 0 and p.max() > 0
    assert not p[d == 0].any()
    assert gap[d > 0].min() > -2e-3 * d.max()
    assert np.abs(p * gap).max() < 2e-3 * p.max() * d.max()


def test_pressure_is_that_of_a_reference_solver():
    n = 16
    d, _ = ball(3.0, 0.5, 6.0, n)
    layer = LayerGel((6.0, 6.0), shape=(n, n))
    units = np.eye(n * n, dtype=np.float32).reshape(-1, n, n)
    C = np.array([layer._move(e).ravel() for e in units], float)
    L = np.linalg.cholesky((C + C.T) / 2)  # 1/2 p C p - d p over p >= 0 as least squares
    inside = (d > 0).ravel()
    reference = nnls(L.T[:, inside], np.linalg.solve(L, d.ravel()))[0]
    assert layer.pressure(d).ravel()[inside] == pytest.approx(reference, abs=0.02 * reference.max())


def test_an_almost_incompressible_gel_keeps_its_volume():
    d, _ = ball(3.0, 0.8, 16.0, 80)
    soft, kept = (LayerGel((16.0, 16.0), 2.5, nu, G, shape=(80, 80)).displacement(d) for nu in (0.3, 0.499))
    assert soft.min() > -0.01 > kept.min()  # it bulges instead
    assert 0 < kept.sum() < 0.25 * soft.sum()


def test_a_stiffening_gel_yields_less():
    d, _ = ball(3.0, 1.0, 12.0, 60)
    soft, stiff = (LayerGel((12.0, 12.0), stiffening_mm=s, shape=(60, 60)) for s in (np.inf, 4.0))
    assert stiff.displacement(d).max() == pytest.approx(0.8 * soft.displacement(d).max(), rel=0.02)
    assert stiff.displacement(0.1 * d).max() == pytest.approx(0.0976 * soft.displacement(d).max(), rel=0.03)


def test_it_serves_a_tactile_sensor():
    layer = LayerGel()
    own, other = TactileSensor(), TactileSensor(surface=layer.displacement)
    d = np.zeros((80, 59), np.float32)
    d[:59] = ball(3.0, 0.8, 12.0, 59)[0]
    assert other.displacement(d) == pytest.approx(layer.displacement(d))
    difference = np.abs(own.image(d).astype(int) - other.image(d)).max()
    assert difference > 5
    assert not other.displacement(0 * d).any()


@pytest.mark.parametrize(
    ("options", "said"),
    [({"thickness_mm": 0.0}, "thickness_mm is 0.0"), ({"poissons_ratio": 0.5}, "poissons_ratio is 0.5")],
)
def test_bad_numbers_are_named(options, said):
    with pytest.raises(InputError, match=said):
        LayerGel(**options)
    with pytest.raises(InputError, match="has shape"):
        LayerGel().displacement(np.zeros((3, 3), np.float32))
