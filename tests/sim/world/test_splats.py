"""Splats where people look: the touch by the gel's, the finger by the twin's over MuJoCo's scene."""

import numpy as np
import pytest

from pneutac_sim.errors import InputError
from pneutac_sim.mpm.solid import bending_body
from pneutac_sim.splat.body import looks_into_twin
from pneutac_sim.splat.follow import blank_looks
from pneutac_sim.twin import Twin
from pneutac_sim.world.splats import SplatFinger, camera_of
from pneutac_sim.world.view import Renderer, require_gl
from pneutac_sim.world.world import World


def has_gl() -> bool:
    try:
        require_gl()
    except InputError:
        return False
    return True


needs_gl = pytest.mark.skipif(not has_gl(), reason="needs OpenGL")


@pytest.fixture(scope="module")
def worlds():
    """The same bent finger, drawn in both ways."""
    both = [World("switch", fidelity="probe", render=render) for render in ("mesh", "splats")]
    for world in both:
        world.reset(0)
        for _ in range(20):
            world.step([0.0, 0.0, 0.0, 12.0])
    return both


@pytest.mark.parametrize("away", [0.0057, 0.0062])
def test_both_ways_show_the_same_touch(worlds, away):
    images = []
    for world in worlds:
        site = world.model.site("gel").id
        normal = world.data.site_xmat[site].reshape(3, 3)[:, 2]
        world.data.geom_xpos[world.model.geom("bar").id] = world.data.site_xpos[site] + away * normal
        world.touch.sense(world.data)
        images.append(world.touch.image.astype(float))
    assert worlds[0].touch.depth_mm.max() > 0.2
    contrast = np.sqrt(np.mean((images[0] - worlds[0].sensor.rest_image) ** 2))
    assert 0 < np.sqrt(np.mean((images[1] - images[0]) ** 2)) < 2 < contrast


def test_a_twin_with_looks_is_drawn_in_them(worlds):
    twin = Twin.builtin()
    looks = blank_looks(bending_body(twin))
    looks.colours[:] = [1.0, 0.0, 0.0]
    looks_into_twin(twin, looks)
    world = worlds[0]
    camera = camera_of(world.model, world.data, 160, 120)
    image, alpha, _ = SplatFinger(world.model, twin).picture(world.data, camera)
    assert (alpha > 0.9).sum() > 100
    np.testing.assert_allclose(
        image[alpha > 0.9] / alpha[alpha > 0.9][:, None], [[1, 0, 0]] * (alpha > 0.9).sum(), atol=1e-3
    )


@needs_gl
def test_the_scene_has_the_finger_where_mujoco_has_it_and_hides_it_behind_objects(worlds):
    mesh, splats = worlds
    camera = camera_of(mesh.model, mesh.data, 320, 240)
    _, alpha, depth = SplatFinger(mesh.model, mesh.twin).picture(mesh.data, camera)
    gl = Renderer(splats.model)
    bare = gl.render_depth(splats.data, 320, 240, (0, 1, 2))[1]
    skin = gl.render_depth(splats.data, 320, 240, (0, 1, 2, 4))[1] < bare - 1e-4
    gl.close()
    solid = (alpha > 0.5) & (depth < bare)
    assert (solid & skin).sum() / (solid | skin).sum() > 0.75
    free = splats.render(320, 240).astype(int)
    lever = splats.model.geom("bar").id  # brought half way to the camera
    place = 0.5 * (
        splats.data.xpos[splats.model.body("spine_3").id]
        + splats.data.cam_xpos[splats.model.camera("close").id]
    )
    splats.data.geom_xpos[lever] = place
    covered = splats.render(320, 240).astype(int)
    (x, y), _ = (v[0] for v in camera.project(place[None]))
    assert solid[int(y), int(x)] and np.abs(covered - free)[int(y), int(x)].max() > 20


def test_without_opengl_it_says_what_to_do(monkeypatch):
    def no_gl(*args):
        raise RuntimeError("no EGL here")

    world = World("switch", touch="none", fidelity="probe", render="splats")
    monkeypatch.setattr("pneutac_sim.world.splats.Renderer", no_gl)
    with pytest.raises(InputError, match=r"needs OpenGL.*\(no EGL here\); install .*or choose render=mesh"):
        world.render(64, 48)


def test_an_unknown_way_is_named():
    with pytest.raises(InputError, match="mesh, splats"):
        World("switch", render="oil")
