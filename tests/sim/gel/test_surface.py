import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import k0, k1

from pneutac_datasets.generate.gel import hertz
from pneutac_sim.gel.surface import surface

CELL = (12 / 59, 16 / 80)


def radius_grid(x0=0.0, y0=0.0):
    x = (np.arange(59) + 0.5) * CELL[0] - 6
    y = (np.arange(80) + 0.5) * CELL[1] - 8
    return np.hypot(*np.meshgrid(x - x0, y - y0))


def ball(r, depth, radius):
    return np.maximum(0, depth - r**2 / (2 * radius)).astype(np.float32)


def closed_form(r, depth, radius, decay):
    """The obstacle problem of a parabola: contact where parabola and K0 meet with one slope."""
    rim = np.sqrt(2 * radius * depth)
    a = brentq(
        lambda a: a / radius / (depth - a * a / (2 * radius)) - k1(a / decay) / (decay * k0(a / decay)),
        1e-6 * rim,
        (1 - 1e-9) * rim,
    )
    outside = (depth - a * a / (2 * radius)) * k0(np.maximum(r, a) / decay) / k0(a / decay)
    return np.where(r < a, depth - r**2 / (2 * radius), outside)


@pytest.mark.parametrize("depth, radius, decay", [(0.9, 3, 1.2), (0.3, 3, 1.2), (0.9, 3, 0.6), (0.5, 6, 1.0)])
def test_a_ball_sags_as_the_closed_form_of_the_layer(depth, radius, decay):
    r = radius_grid(0.3, -0.2)
    u = surface(ball(r, depth, radius), CELL, decay)
    np.testing.assert_allclose(u, closed_form(r, depth, radius, decay), atol=0.03 * depth)


def test_a_ball_sags_nearly_as_on_hertz_half_space():
    """With the best single decay length the layer stays within 5 % of the depth up to two contact radii."""
    r, depth, radius = radius_grid(), 0.9, 3.0
    a = np.sqrt(radius * depth)
    u, u_hertz = surface(ball(r, depth, radius), CELL, 2.0), hertz(r, depth, radius)
    np.testing.assert_allclose(u[r < 2 * a], u_hertz[r < 2 * a], atol=0.05 * depth)
    thin = surface(ball(r, depth, radius), CELL, 1.2)
    np.testing.assert_allclose(thin[r < a], u_hertz[r < a], atol=0.01 * depth)
    assert (thin[r > 2 * a] < u_hertz[r > 2 * a]).all(), "a bonded layer hides the half-space's far field"


def test_the_obstacle_conditions_hold_for_several_flat_and_round_contacts():
    depth = np.maximum(ball(radius_grid(2, 4), 0.8, 3), ball(radius_grid(-2, -3), 0.4, 5))
    depth[10:20, 40:50] = 0.5
    u = surface(depth, CELL, 1.2).astype(np.float64)
    assert (u >= depth - 1e-6).all()
    kx, ky = (1.2 / CELL[0]) ** 2, (1.2 / CELL[1]) ** 2
    v = np.pad(u, 1, mode="edge")
    pressure = u - kx * (v[1:-1, 2:] + v[1:-1, :-2] - 2 * u) - ky * (v[2:, 1:-1] + v[:-2, 1:-1] - 2 * u)
    off = u > depth + 0.02
    assert off.mean() > 0.5
    # the residual is measured against the diagonal of the operator: an error of u times 1 + 2 (kx + ky)
    assert np.abs(pressure[off]).max() / (1 + 2 * (kx + ky)) < 0.003
    assert pressure.min() / (1 + 2 * (kx + ky)) > -0.003
