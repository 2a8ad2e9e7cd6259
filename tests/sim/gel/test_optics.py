"""Light of the gel: slopes, Lambert's cosine, near lights, cast shadows and the colour at rest."""

import numpy as np
import pytest
from scipy.ndimage import binary_dilation, map_coordinates

from pneutac_sim.gel import optics
from pneutac_sim.gel.model import GelModel

CELL = (0.2, 0.2)
FAR = (np.nan, np.nan)
DIRECTIONS = np.radians([0, 30, 45, 80, 90, 150, 200, 270, 315, 340])


def grid(rows=81, cols=61, cell=CELL):
    """x and y (rows, columns) in mm from the window's centre."""
    x, y = ((np.arange(n) + 0.5 - n / 2) * h for n, h in ((cols, cell[0]), (rows, cell[1])))
    return np.meshgrid(x, y)


def coefficients(
    light=(0.0, 0.0), depth=0.0, place=FAR, direct=np.inf, shadow=0.0, elevation=0.25, edge=0.02
):
    """A channel's row, what is not given at neutral."""
    c = np.array(optics.NEUTRAL)
    c[:2], c[2], c[3:5], c[5], c[6:9] = light, depth, place, direct, (shadow, elevation, edge)
    return c


def bump(x0=0.0, y0=0.0, width=1.2, height=0.8):
    x, y = grid()
    return (height * np.exp(-((x - x0) ** 2 + (y - y0) ** 2) / width**2)).astype(np.float32)


def pillar(height, x0=0.0, y0=0.0, radius=0.5):
    x, y = grid()
    return np.where(np.hypot(x - x0, y - y0) < radius, height, 0.0).astype(np.float32)


def beside(u):
    """The figure and the cells that touch it."""
    return binary_dilation(u > 0, np.ones((3, 3)))


def dark(u, towards, elevation, place=FAR):
    """Where a light from direction `towards` (2,), or from a place, is shadowed: bool (rows, columns)."""
    c = coefficients(-1e-6 * np.asarray(towards), 0.0, place, np.inf, 50.0, elevation)
    return optics.channel(u, CELL, c) < -1.0


# ---------------------------------------------------------------- slopes and Lambert's cosine


@pytest.mark.parametrize("direct", [np.inf, 50.0])
@pytest.mark.parametrize("place", [FAR, (1.5, -0.4)])
def test_all_terms_together_are_the_equations_on_cells_of_any_shape(place, direct):
    """Evaluated plainly in float64: t = -|L| e . grad u, Lambert's cosine of it, depth and the squares."""
    cell = (0.2, 0.3)
    x, y = grid(9, 7, cell)
    u = np.random.default_rng(0).uniform(0, 0.3, x.shape).astype(np.float32)
    c = coefficients((-30.0, 40.0), 5.0, place, direct)
    c[9:] = 7.0, -11.0, 13.0
    gy, gx = np.gradient(u.astype(float), cell[1], cell[0])
    ex, ey = (0.6, -0.8) if place is FAR else (place[0] - x, place[1] - y)
    r = np.hypot(ex, ey)
    along, across = (ex * gx + ey * gy) / r, (ex * gy - ey * gx) / r
    t = -50 * along
    if np.isfinite(direct):
        t = direct * (np.maximum(0, 1 + t / direct) / np.sqrt(1 + gx**2 + gy**2) - 1)
    expected = t + 5 * u + 7 * along**2 - 11 * across**2 + 13 * u.astype(float) ** 2
    np.testing.assert_allclose(optics.channel(u, cell, c), expected, atol=1e-3)


def test_other_packages_effects_change_the_light_of_their_channel_in_order():
    u, rows = bump(), np.stack([coefficients((k, 2.0), 5.0) for k in range(3)])

    def add(k, s, u, cell_mm):
        return s + k + u + cell_mm[0]

    def double(k, s, u, cell_mm):
        return 2.0 * s

    plain, changed = optics.light(u, CELL, rows), optics.light(u, CELL, rows, (add, double))
    assert changed.dtype == np.float32
    for k in range(3):
        np.testing.assert_allclose(changed[k], 2 * (plain[k] + k + u + CELL[0]), rtol=1e-5, atol=1e-5)
    np.testing.assert_array_equal(optics.channel(u, CELL, rows[0], further=(add, double)), changed[0])


@pytest.mark.parametrize("shape", [(4, optics.SIZE), (3, optics.SIZE - 1)])
def test_coefficients_of_another_shape_are_refused(shape):
    with pytest.raises(ValueError, match="three channels"):
        optics.light(bump(), CELL, np.zeros(shape))


@pytest.mark.parametrize("effects", [{}, {"shadow": 30.0, "direct": 60.0}])
@pytest.mark.parametrize("angle", DIRECTIONS)
def test_a_near_light_far_away_is_a_far_light(effects, angle):
    towards = np.array([np.cos(angle), np.sin(angle)])
    near = optics.channel(bump(), CELL, coefficients(-80 * towards, 2.0, 1e5 * towards, **effects))
    far = optics.channel(bump(), CELL, coefficients(-80 * towards, 2.0, **effects))
    np.testing.assert_allclose(near, far, atol=0.05)


@pytest.mark.parametrize("place", [FAR, (3.0, -4.0)])
def test_a_side_that_turns_away_goes_dark_and_no_darker(place):
    direct = 35.0
    u = bump(width=0.6, height=2.0)
    s = optics.channel(u, CELL, coefficients((-90.0, 120.0), 0.0, place, direct))
    assert s.min() >= -direct - 1e-4 and s.min() == pytest.approx(-direct, abs=1e-3)
    assert optics.channel(u, CELL, coefficients((-90.0, 120.0), 0.0, place)).min() < -3 * direct


# ---------------------------------------------------------------- shadows


@pytest.mark.parametrize("angle", DIRECTIONS)
def test_a_pillar_casts_a_shadow_of_its_height_over_the_lights_slope(angle):
    """On the side away from the light, as wide as itself, and none on the near side."""
    x, y = grid()
    towards, elevation, radius = np.array([np.cos(angle), np.sin(angle)]), 0.25, 1.2
    along, across = -(x * towards[0] + y * towards[1]), -x * towards[1] + y * towards[0]
    beam = np.abs(across) < 0.11
    u = pillar(0.8, radius=radius)
    shade = dark(u, towards, elevation)
    start = along[beam & (u > 0)].max()
    end = start + 0.8 / elevation - CELL[0] / 2  # cells beyond the tip are lit: half a cell on average
    assert along[shade & beam].max() == pytest.approx(end, abs=CELL[0])
    assert shade[beam & (along > start) & (along < end - CELL[0])].all()
    assert not shade[(along < 0) & ~beside(u)].any()
    assert np.abs(across[shade]).max() < radius + 1.2 * CELL[0]


@pytest.mark.parametrize("axis", [0, 1])
def test_a_walls_shadow_is_as_long_in_mm_on_cells_of_any_shape_and_as_dark_as_it_says(axis):
    cell = (0.1, 0.2)
    at = grid(41, 81, cell)[axis]
    u = np.where(np.abs(at) < 0.3, 0.5, 0.0).astype(np.float32)
    towards = -np.eye(2)[axis]
    s = optics.channel(u, cell, coefficients(-1e-6 * towards, shadow=0.5, elevation=0.25))
    assert s[(at > 0.5) & (at < 0.3 + 2 - 0.25)] == pytest.approx(-0.5, abs=1e-4)
    assert s[(at < -0.5) | (at > 0.3 + 2 + 0.25)] == pytest.approx(0, abs=1e-4)


@pytest.mark.parametrize("angle", DIRECTIONS)
def test_what_is_narrower_than_a_contact_never_casts_too_long_a_shadow(angle):
    """Passing from cell to cell rounds off narrow tips: the shadow of 5 cells may lose a fifth."""
    x, y = grid()
    towards = np.array([np.cos(angle), np.sin(angle)])
    shade = dark(pillar(0.8), towards, 0.25)
    length = (-(x * towards[0] + y * towards[1]))[shade].max() - 0.5
    assert 0.75 * 0.8 / 0.25 < length < 0.8 / 0.25 + CELL[0]


@pytest.mark.parametrize("place", [(4.0, 5.0), (-5.0, 1.0), (9.0, -12.0), (-11.0, -3.0)])
def test_shadows_of_a_near_light_point_away_from_it(place):
    x, y = grid()
    x0, y0, radius = 1.0, -2.0, 1.2
    away = np.array([x0, y0]) - place
    r0 = np.hypot(*away)
    away /= r0
    u = pillar(0.5, x0, y0, radius)
    shade = dark(u, -away, 0.25, place)
    dx, dy = x - place[0], y - place[1]
    r = np.hypot(dx, dy)
    angle = np.arctan2(np.abs(dx * away[1] - dy * away[0]), dx * away[0] + dy * away[1])
    assert not shade[(r < r0) & ~beside(u)].any(), "nothing is dark between the light and the pillar"
    assert angle[shade].max() < np.arcsin((radius + 1.2 * CELL[0]) / r0)
    beam = angle < 0.11 / r0
    end = r[beam & (u > 0)].max() + 0.5 / 0.25 - CELL[0] / 2
    assert r[shade & beam].max() == pytest.approx(end, abs=CELL[0])


# ---------------------------------------------------------------- colour at rest, whole images


def test_the_exponent_of_the_rest_colour_is_none_linear_or_a_power():
    def weight(rest, *exponents):
        gel = GelModel.builtin()
        gel.effects = {"rest_colour": dict(zip(gel.effects["rest_colour"], exponents, strict=True))}
        return gel.weight_on(rest)

    rest = np.random.default_rng(0).integers(10, 250, (32, 24, 3)).astype(np.uint8)
    relative = rest / rest.mean((0, 1))
    np.testing.assert_allclose(weight(rest, 0, 0, 0), 1)
    np.testing.assert_allclose(weight(rest, 1, 1, 1), relative, rtol=1e-5)
    np.testing.assert_allclose(weight(rest, 2, 0.5, 0), relative ** [2, 0.5, 0], rtol=1e-5)
    assert np.isfinite(weight(np.zeros((4, 4, 3), np.uint8), -1, -1, -1)).all()


def between_cells(grid, height, width):
    """Bilinear interpolation of (rows, columns) to pixel centres, level beyond the outer cells' centres."""
    rows, cols = grid.shape
    at = np.meshgrid(
        *((np.arange(n) + 0.5) * m / n - 0.5 for n, m in ((height, rows), (width, cols))), indexing="ij"
    )
    return map_coordinates(grid.astype(float), at, order=1, mode="nearest")


def small_renderer(height, width):
    """On a random rest image, so that light saturates it; weights differ by channel and place."""
    rng = np.random.default_rng(height)
    rest = rng.integers(0, 256, (height, width, 3), dtype=np.uint8)
    weight = rng.uniform(0.2, 2.0, (height, width, 3)) * [0.5, 1.0, 3.0]
    weight[:, :3] = 0.1
    rows = np.stack([coefficients((20.0 * k - 10, 15.0), 40.0) for k in range(3)])
    return rest, weight, rows, optics.Renderer(rest, weight, (0.4, 0.3), (9, 7), rows)


@pytest.mark.parametrize(("height", "width"), [(30, 44), (40, 21)])
def test_an_image_is_rest_plus_weighted_light_rounded_and_within_its_range(height, width):
    rest, weight, rows, renderer = small_renderer(height, width)
    u = np.random.default_rng(1).uniform(-1, 1, (9, 7)).astype(np.float32)
    u[5:] = 0
    s = np.stack([between_cells(c, height, width) for c in optics.light(u, (0.4, 0.3), rows)], -1)
    image = renderer.image(u)
    expected = np.clip(rest + weight * s, 0, 255)
    assert np.abs(image - expected).max() < 0.501 and (image == 0).any() and (image == 255).any()
    assert (image[-3:] == rest[-3:]).all() and (image != rest).mean() > 0.3
    np.testing.assert_array_equal(renderer.image(np.zeros_like(u)), rest)


@pytest.mark.parametrize(("height", "width"), [(30, 44), (40, 21)])
@pytest.mark.parametrize("pressed", [np.s_[:, :], np.s_[:, 0], np.s_[:, -1], np.s_[3:5, 2:4], np.s_[-1, 3]])
def test_contact_pixels_are_those_of_the_image_that_differ_by_more_than_the_limit(height, width, pressed):
    rest, _, _, renderer = small_renderer(height, width)
    u = np.zeros((9, 7), np.float32)
    u[pressed] = np.random.default_rng(2).uniform(0, 1, u[pressed].shape)
    differ = np.abs(renderer.image(u).astype(int) - rest).sum(-1)
    assert differ.any()
    for limit in (0, 1, 2, 5, 10, 20, 40, 80, 1000):
        assert renderer.contact_pixels(u, limit) == (differ > limit).sum()
