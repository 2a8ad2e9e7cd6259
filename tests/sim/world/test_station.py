"""A lab's own station: workspace and mount.

Splats where people look: the touch by the gel's, the finger by the twin's over MuJoCo's scene.
"""

from pathlib import Path

import numpy as np
import pytest
from played import press_bar

from pneutac_sim.errors import InputError
from pneutac_sim.mpm.solid import bending_body
from pneutac_sim.splat.body import blank_looks, looks_into_twin
from pneutac_sim.twin import Twin
from pneutac_sim.world.arms import ARMS
from pneutac_sim.world.splats import SplatFinger, camera_of
from pneutac_sim.world.station import Station, station_faults
from pneutac_sim.world.view import Renderer, require_gl
from pneutac_sim.world.world import World


def written(folder, text="", form="pneutac-station/1"):
    file = folder / "station.yaml"
    file.write_text(f"format: {form}\n{text}\n")
    return file


def test_an_empty_station_and_a_twins_file_are_named(tmp_path):
    for name, says in (
        ("station.yaml", "is empty; its first line is `format"),
        ("twin.yaml", "is a twin's; give"),
    ):
        (tmp_path / name).write_text("")
        (fault,) = station_faults(tmp_path / name)
        assert says in fault


def test_what_is_left_out_is_the_papers(tmp_path):
    assert Station.load(written(tmp_path)) == Station()
    assert Station.load(written(tmp_path, "mount_mm: 35")).mount_mm == 35


def test_a_longer_mount_keeps_the_gel_where_it_was_and_the_box_holds_the_flange():
    station = Station((0.35, -0.1, 0.2), (0.45, 0.1, 0.4), 50.0)
    paper, own = (World("switch", touch="none", station=s) for s in (None, station))
    for world in (paper, own):
        world.reset(3)
    np.testing.assert_allclose(own.gel_m, paper.gel_m, atol=1e-3)
    np.testing.assert_allclose(own.flange_m - paper.flange_m, [0, 0, 0.03], atol=1e-3)
    for _ in range(40):
        own.step([0.1, 0.0, 0.1, 0.0])
    np.testing.assert_allclose(own.flange_m[[0, 2]], [0.45, 0.4], atol=2e-3)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("mount_m: 20", "unknown field 'mount_m'; did you mean 'mount_mm'"),
        ("mount_mm: 0.02", "mount_mm is 0.02; give 1 to 200"),
        ("workspace_low_m: [0.3, 0.1, .nan]", "workspace_low_m is .* three finite numbers"),
        ("latency_s: -1", "latency_s is -1; give 0 to 1"),
        ("control_hz: 4", "control_hz is 4; give a whole number from 5 to 60 Hz"),
        ("home_m: [0.9, 0, 0.3]", "home_m is .* outside the workspace"),
        ("base_m: {1: x, 2: y, 3: z}", "base_m is .* three finite numbers"),
        ("arm: {urdf: a, flange: b, home_rad: '0000'}", "arm.home_rad is '0000'; give a finite angle"),
        ("workspace_low_m: [0.7, -0.1, 0.2]", "each number of the first must be below"),
        ("arm: ur6", "arm is 'ur6'; give panda, ur5, so101, or a mapping with exactly urdf, flange"),
        ("arm: {urdf: ur5.urdf, flange: tool1, home_rad: [0]}", "no link 'tool1'; it has base, shoulder"),
        ("arm: {urdf: ur5.urdf, flange: tool0, home_rad: [0]}", "6 joints .* home_rad has 1 angles"),
        ("arm: {urdf: ur5.urdf, flange: tool0, home_rad: [0, 0, 0, 0, 0, 0]}", "points along .* points down"),
        ("arm: {urdf: broken.urdf, flange: tool0, home_rad: [0]}", "no URDF or MJCF that MuJoCo reads"),
        ("arm: {urdf: slide.urdf, flange: tool0, home_rad: [0]}", "joint 'elbow' .* is no hinge"),
    ],
)
def test_a_bad_station_or_arm_is_one_sentence(tmp_path, text, says):
    ur5 = Path(ARMS["ur5"][0].urdf).read_text()
    (tmp_path / "ur5.urdf").write_text(ur5)
    (tmp_path / "broken.urdf").write_text("<robot")
    (tmp_path / "slide.urdf").write_text(ur5.replace('"elbow" type="revolute"', '"elbow" type="prismatic"'))
    with pytest.raises(InputError, match=rf"(station.yaml: |\w+.urdf).*{says}"):
        Station.load(written(tmp_path, text)).make_arm()


def test_another_format_or_no_file_is_named(tmp_path):
    with pytest.raises(InputError, match="'format' must be 'pneutac-station/1'"):
        Station.load(written(tmp_path, form="other"))
    with pytest.raises(InputError, match="There is no file"):
        Station.load(tmp_path / "none.yaml")


def test_commands_act_late_by_the_stations_latency_and_it_starts_at_its_home():
    station = Station(home_m=(0.42, 0.02, 0.33), latency_s=0.2)
    stations = station, Station(home_m=(0.42, 0.02, 0.33))
    late, prompt = (World("card", touch="none", station=s) for s in stations)
    for world in (late, prompt):
        world.reset(0)
    np.testing.assert_allclose(late.flange_m, [0.42, 0.02, 0.33], atol=0.007)
    path = [[world.step([0.05, 0.0, 0.0, 3.0]).state for _ in range(8)] for world in (late, prompt)]
    flange, pressure = slice(-6, -3), -1
    np.testing.assert_allclose(np.array(path[0])[3:, flange], np.array(path[1])[:-3, flange], atol=1e-4)
    assert path[0][2][pressure] == 0 < path[0][3][pressure]


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
        press_bar(world, away)
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
    monkeypatch.setattr("pneutac_sim.world.view.Renderer", no_gl)
    with pytest.raises(InputError, match=r"needs OpenGL.*\(no EGL here\); install .*or choose render=mesh"):
        world.render(64, 48)
