import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from pneutac_sim.gel import probe
from pneutac_sim.gel.probe import (
    BOX,
    CAPSULE,
    CONE,
    CYLINDER,
    ELLIPSOID,
    MESH,
    SPHERE,
    probe_grid,
    probe_grids,
)

EYE = np.eye(3)


def grid_mm():
    x = (np.arange(59) + 0.5) * 12 / 59 - 6
    y = (np.arange(80) + 0.5) * 16 / 80 - 8
    return np.meshgrid(x, y)


def inside(kind, size, p):
    """Whether points (..., 3) in the shape's frame are inside, from the definition of the shape."""
    s, r = size, np.linalg.norm
    if kind == SPHERE:
        return r(p, axis=-1) <= s[0]
    if kind == ELLIPSOID:
        return r(p / s, axis=-1) <= 1
    if kind == BOX:
        return (np.abs(p) <= s).all(-1)
    if kind == CYLINDER:
        return (r(p[..., :2], axis=-1) <= s[0]) & (np.abs(p[..., 2]) <= s[1])
    if kind == CAPSULE:
        axis = p * [0, 0, 1]
        return r(p - np.clip(axis, -s[1], s[1]), axis=-1) <= s[0]
    return (r(p[..., :2], axis=-1) <= s[0] * (p[..., 2] + s[1]) / (2 * s[1])) & (np.abs(p[..., 2]) <= s[1])


def test_sphere_depth_is_the_closed_form():
    x, y = grid_mm()
    depth = probe_grid([SPHERE], [[0.003, 0, 0]], [[0.001, -0.002, 0.0021]], [EYE])
    r2 = (x - 1) ** 2 + (y + 2) ** 2
    expected = np.maximum(0, np.sqrt(np.maximum(9 - r2, 0)) - 2.1) * (r2 < 9)
    assert depth.shape == (80, 59) and depth.dtype == np.float32
    assert depth.max() > 0.85
    np.testing.assert_allclose(depth, expected, atol=1e-5)


@pytest.mark.parametrize("kind", [k for k in probe.KINDS if k != MESH])
def test_every_shape_agrees_with_marching_along_the_line(kind):
    rng = np.random.default_rng(kind)
    x, y = grid_mm()
    z = -np.arange(0, 2.5, 0.01)
    deepest, apart = 0.0, []
    for _ in range(4):
        size = rng.uniform(1, 4, 3)
        rotation = Rotation.random(random_state=rng)
        position = np.array([*rng.uniform(-3, 3, 2), rng.uniform(0.5, 2)])
        gel = Rotation.random(random_state=rng)
        gel_position = rng.normal(size=3)
        depth = probe_grid(
            [kind],
            [size * 1e-3],
            [(gel.apply(position) + gel_position) * 1e-3],
            [(gel * rotation).as_matrix()],
            gel_position * 1e-3,
            gel.as_matrix(),
        )
        p = np.stack([np.broadcast_to(v[..., None], (80, 59, len(z))) for v in (x, y)], -1)
        p = np.concatenate([p, np.broadcast_to(z[:, None], (80, 59, len(z), 1))], -1)
        hit = inside(kind, size, rotation.inv().apply((p - position).reshape(-1, 3)).reshape(p.shape))
        marched = np.where(hit, -z, 0).max(-1)
        apart.append(np.abs(depth - marched))
        deepest = max(deepest, depth.max())
    assert deepest > 0.5
    # one marching step apart, but where a grazing line is inside for less than a step
    assert np.mean(np.concatenate(apart) > 0.0101) < 1e-3


@pytest.mark.parametrize("kind", [CAPSULE, CYLINDER, CONE])
def test_axes_along_the_gels_own_axes_have_no_singularity(kind):
    for euler in ([0, 0, 0], [np.pi / 2, 0, 0], [0, np.pi / 2, 0], [np.pi, 0, 0]):
        R = Rotation.from_euler("xyz", euler).as_matrix()
        depth = probe_grid([kind], [[0.002, 0.002, 0]], [[0, 0, 0.0015]], [R])
        assert np.isfinite(depth).all() and 0 < depth.max() <= 2.5


def test_deepest_object_wins_thickness_clips_and_what_is_behind_is_ignored():
    two = probe_grid(
        [SPHERE, BOX], [[0.003, 0, 0], [0.001] * 3], [[0, 0, 0.0025], [0, 0, -0.0005]], [EYE, EYE]
    )
    assert two.max() == pytest.approx(1.5, abs=1e-5) and (two > 0.01).mean() > 0.04
    deep = probe_grid([BOX], [[0.1, 0.1, 0.1]], [[0, 0, 0.05]], [EYE])
    np.testing.assert_allclose(deep, probe.THICKNESS_MM)
    assert probe_grid([BOX], [[0.1, 0.1, 0.1]], [[0, 0, -0.2]], [EYE]).max() == 0
    assert probe_grid([], [], [], []).max() == 0


@pytest.mark.parametrize(("kind", "size", "mesh"), [
    (BOX, (3, 2, 4), trimesh.creation.box((6, 4, 8))),
    (CYLINDER, (3, 5, 0), trimesh.creation.cylinder(3, 10, 256)),
    (SPHERE, (4, 0, 0), trimesh.creation.icosphere(4, 4.0)),
])  # fmt: skip
def test_a_mesh_is_what_it_is_a_mesh_of(kind, size, mesh):
    """Turned any way, at the second place of the triangles, seen through a turned gel, and in many states."""
    rng = np.random.default_rng(kind)
    triangles = 1e-3 * np.concatenate([rng.normal(size=(5, 3, 3)), mesh.triangles])
    own = [5, len(mesh.triangles), 1e-3 * np.linalg.norm(mesh.vertices, axis=1).max()]
    at, gel_at = rng.uniform(-2e-3, 2e-3, (2, 8, 3)) + [[[0, 0, 2.5e-3]], [[0, 0, 0]]]
    turn, gel_turn = Rotation.random(8, rng=rng), Rotation.random(8, rng=rng)
    at = gel_turn.apply(at) + gel_at
    states = [a[:, None] for a in (at, (gel_turn * turn).as_matrix())] + [gel_at, gel_turn.as_matrix()]
    plain = [probe_grid([kind], [np.multiply(1e-3, size)], *state) for state in zip(*states, strict=True)]
    found = [probe_grid([MESH], [own], *state, triangles=triangles) for state in zip(*states, strict=True)]
    assert np.mean([p.max() for p in plain]) > 0.5
    apart = np.abs(np.subtract(plain, found))
    assert apart.max() < 0.05 and np.quantile(apart, 0.999) < 0.01
    states[1], states[3] = states[1].reshape(8, 1, 9), states[3].reshape(8, 9)
    window = probe.WINDOW_MM, probe.THICKNESS_MM
    out = np.empty((8, 80, 59), np.float32)
    together = probe_grids([MESH], [own], *states, *window, out, triangles)
    np.testing.assert_array_equal(together, found)


def test_many_states_are_each_by_itself_and_leave_the_other_rows_alone():
    kinds, sizes = [SPHERE, BOX], np.array([[0.004, 0, 0], [0.003, 0.002, 0.001]])
    rng, buffer = np.random.default_rng(0), np.full((4, 80, 59), 7.0, np.float32)
    at, gel = rng.normal(0, 0.003, (3, 2, 3)), rng.normal(0, 0.001, (3, 3))
    at[1] += 1.0  # out of reach
    turns, gel_turns = (Rotation.random(n, rng=rng).as_matrix() for n in (6, 3))
    turns = turns.reshape(3, 2, 3, 3)
    window = probe.WINDOW_MM, probe.THICKNESS_MM
    grids = probe_grids(
        kinds, sizes, at, turns.reshape(3, 2, 9), gel, gel_turns.reshape(3, 9), *window, buffer
    )
    alone = [probe_grid(kinds, sizes, *state) for state in zip(at, turns, gel, gel_turns, strict=True)]
    assert grids.any((1, 2)).tolist() == [True, False, True]
    np.testing.assert_array_equal(grids, alone)
    assert (buffer[3] == 7).all()
    with pytest.raises(ValueError, match="knows shapes"):
        probe_grids([1, 2], sizes, at, turns, gel, gel_turns, *window, buffer)
