"""`pneutac render`: pictures of material points, a film, and what is kept when it is interrupted.

`pneutac render` in a twin's own looks: beside photographs, and from any side.
"""

import json
from functools import partial

import av
import numpy as np
import pandas as pd
import pytest
from PIL import Image
from verbs import refused, verb

from lerobot_pneutac.rendering import body as particle_picture
from lerobot_pneutac.rendering.body import BODY_PX, Film, FilmFrame
from lerobot_pneutac.rendering.options import FPS, RenderConfig, deepest_press, filled
from lerobot_pneutac.verbs.new import new_twin
from lerobot_pneutac.verbs.render import draw_film
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.errors import InputError
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.probe import BOX, CONE, CYLINDER, SPHERE
from pneutac_sim.mpm import devices, solve
from pneutac_sim.mpm.solve import solve_equilibrium
from pneutac_sim.mpm.total_lagrangian import Loads
from pneutac_sim.splat.body import blank_looks, carried, looks_into_twin
from pneutac_sim.splat.camera import Camera
from pneutac_sim.splat.render import rasterise
from pneutac_sim.twin import PAPER_FINGER, Twin, Value

pytestmark = pytest.mark.slow


@pytest.fixture
def finger(tmp_path):
    return Twin.builtin().save(tmp_path / "finger")


def inked(path) -> np.ndarray:
    """(H, W) where a picture is not paper, without the caption below."""
    image = np.asarray(Image.open(path)).astype(int)
    return (np.abs(image - particle_picture.PAPER).sum(-1) > 60)[:-50]


def test_finger_is_seen_bending(finger, tmp_path):
    out = tmp_path / "out"
    verb("render", twin=finger, pressure_kpa="[0,15]", seconds="0.4", particles=600, out=out)
    result = json.loads((out / "result.json").read_text())
    assert result["complete"] and result["frames"] == 7
    still = result["stills"]
    bend = 4 * PAPER_FINGER["gain_rad_per_kpa"] * (np.array([0, 15]) + PAPER_FINGER["rest_pressure_kpa"])
    assert [r["pressure_kpa"] for r in still] == [0, 15]
    assert np.array([r["tip_z_mm"] for r in still]) == pytest.approx(110 * bend / 2, rel=0.15)  # small arcs
    # the drawn body goes to the right, where +z is, and up
    a, b = (inked(out / r["picture"]) for r in still)
    assert np.flatnonzero(b.any(0)).max() > np.flatnonzero(a.any(0)).max() + 50
    assert np.flatnonzero(b.any(1)).max() < np.flatnonzero(a.any(1)).max() - 20
    with av.open(str(out / "film.mp4")) as film:
        assert sum(1 for _ in film.decode(video=0)) == 7 + FPS
    assert "data:video/mp4" in (out / "report.html").read_text()


@pytest.mark.nightly
def test_gel_shows_the_imprint_where_it_is(tmp_path, monkeypatch):
    twin = Twin("gel", 16.0)
    GelModel.builtin().into_twin(twin)
    twin.save(tmp_path / "gel")
    monkeypatch.setattr(devices, "gel", partial(devices.gel, counts=(30, 41, 7)))
    monkeypatch.setattr("lerobot_pneutac.rendering.body.PRESS_FRAMES", 2)
    out = tmp_path / "out"
    verb("render", twin=tmp_path / "gel", depth_mm="1.0", x_mm=2, y_mm=-3, out=out)
    still = json.loads((out / "result.json").read_text())["stills"]
    assert [r["depth_mm"] for r in still] == [0.5, 1.0]
    assert still[1]["face_mm"] == pytest.approx(1.0, abs=0.06)
    assert still[1]["force_n"] > 2 * still[0]["force_n"] > 0
    # the white line of the cut lies at the row of the press: y = -3 of 16 mm
    image = np.asarray(Image.open(out / still[1]["picture"])).astype(int)
    line = np.flatnonzero((image[24:-66, 20:40] > 225).all((1, 2)))
    assert len(line) and line.mean() / (480 - 90) == pytest.approx(0.5 - 3 / 16, abs=0.03)


def test_what_is_finished_is_kept_when_interrupted(tmp_path):
    def frames():
        picture = particle_picture.blank(64, 48)
        yield FilmFrame(picture, {"pressure_kpa": 0.0})
        yield FilmFrame(picture)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        draw_film(Film("finger", frames(), 9, "Nothing."), tmp_path)
    result = json.loads((tmp_path / "result.json").read_text())
    assert not result["complete"] and result["frames"] == 2 and len(result["stills"]) == 1
    assert (tmp_path / "finger_1.png").is_file() and (tmp_path / "film.mp4").is_file()


@pytest.mark.parametrize("indenter", ["sphere", "cube", "cone"])
def test_a_press_is_refused_just_where_the_indenter_leaves_the_window(indenter):
    """Against the lowest points of the indenter's own surface, as the probe grid sees it."""
    gel = GelModel.builtin()
    given = partial(RenderConfig, "twin", indenter=indenter, size_mm=3.0, depth_mm=1.0)
    press = deepest_press(given(x_mm=0.0, y_mm=0.0), gel)
    reach = np.abs(below_surface(press)).max(0)
    for axis, name in enumerate(("x_mm", "y_mm")):
        edge = gel.window_mm[axis] / 2 + reach[axis]
        at = {"x_mm": 0.0, "y_mm": 0.0}
        deepest_press(given(**at | {name: edge - 0.1}), gel)
        with pytest.raises(InputError, match=f"^{name} is .*{indenter} misses"):
            deepest_press(given(**at | {name: edge + 0.1}), gel)


def below_surface(press) -> np.ndarray:
    """(P, 2) places in mm, near the press, where the indenter reaches below z = 0."""
    kinds, sizes, positions, rotations = press.shapes()
    x = np.linspace(-5, 5, 201)
    grid = np.stack(np.meshgrid(x, x, np.linspace(-press.depth_mm, 0, 51)), -1).reshape(-1, 3)
    local = (grid - 1e3 * positions[0]) @ rotations[0]
    size = 1e3 * sizes[0]
    across, z = np.hypot(local[:, 0], local[:, 1]), local[:, 2]
    inside = {
        SPHERE: np.linalg.norm(local, axis=1) <= size[0],
        CYLINDER: (across <= size[0]) & (np.abs(z) <= size[1]),
        CONE: (across <= z + size[1]) & (z <= size[1]),
        BOX: (np.abs(local) <= size + 1e-9).all(1),
    }[kinds[0]]
    return grid[inside, :2]


def test_conditions_that_effects_ask_for_are_taken_and_others_named(tmp_path):
    twin = Twin.builtin()
    twin.effects["thermal"] = {p.name: Value(p.default) for p in get_effect("thermal").parameters}
    folder = twin.save(tmp_path / "twin")
    config = RenderConfig(folder, conditions={"temperature_c": 30.0})
    assert filled(config, twin).conditions == {"temperature_c": 30.0}
    with pytest.raises(InputError, match="'temperatur', which .* ask for temperature_c"):
        filled(RenderConfig(folder, conditions={"temperatur": 30.0}), twin)


@pytest.mark.parametrize(
    ("device", "said"),
    [
        ("finger", "lower --pressure_kpa, more --particles, or a thicker mesh"),
        pytest.param("gel", "--depth_mm", marks=pytest.mark.nightly),
    ],
)
def test_where_no_rest_is_found_the_options_that_help_are_named(tmp_path, monkeypatch, device, said):
    twin = Twin.builtin() if device == "finger" else Twin("gel", 16.0)
    folder = twin.save(tmp_path / "twin")
    monkeypatch.setattr(devices, "gel", partial(devices.gel, counts=(30, 41, 7)))
    monkeypatch.setattr(solve, "solve_equilibrium", partial(solve.solve_equilibrium, max_substeps=25))
    few = ["--particles=600"] if device == "finger" else []
    with pytest.raises(InputError, match=f"is not at rest after .* is the tolerance; .*{said}") as refused:
        verb("render", *few, twin=folder, device="cpu", out=tmp_path / "out")
    assert "warm" not in str(refused.value) and "substeps, or" not in str(refused.value)


PRESSURES = (0.0, 6.0, 12.0)
RED, BLUE = (194, 65, 12), (11, 110, 153)


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """A twin with looks, red at its base and green at its tip, and photographs of it by the renderer."""
    root = tmp_path_factory.mktemp("looks")
    twin = Twin.builtin()
    solver = devices.finger(twin, batch=len(PRESSURES), particles=600, device="cpu")
    looks = blank_looks(solver.body)
    tip = solver.body.positions[:, 0] > 0.055
    looks.colours[:] = np.where(tip[:, None], (0.0, 0.7, 0.0), (0.7, 0.0, 0.0))
    looks_into_twin(twin, looks)
    twin.save(root / "twin")
    rest = solve_equilibrium(solver, Loads(q_cmd=devices.joint_targets(twin, PRESSURES)))
    camera = Camera.look_at((0.055, -0.4, 0.02), (0.055, 0, 0.02), (-1, 0, 0), 22.0, 240, 240)
    folder, rows = root / "recording", []
    folder.mkdir()
    for i, pressure in enumerate(PRESSURES):
        seen = rasterise(carried(looks, solver.body, rest.positions[i], rest.gradients[i]), camera)
        Image.fromarray((255 * seen.image.clip(0, 1)).astype(np.uint8)).save(folder / f"{i}.png")
        Image.fromarray(np.uint8(255) * (seen.alpha > 0.5)).save(folder / f"{i}_mask.png")
        row = {"trial": i, "time_s": 0.0, "pressure_cmd_kpa": pressure}
        rows.append(row | {"image_front": f"{i}.png", "mask_front": f"{i}_mask.png"})
    told = {"intrinsics": camera.intrinsics.tolist(), "extrinsics": camera.extrinsics.tolist()}
    meta = {"device": "finger", "length_mm": 110.0, "cameras": {"front": told}}
    Recording(folder, meta, pd.DataFrame(rows[::-1]), "finger").write(folder)
    return root


def run(drawn, out, *options, twin="twin") -> list[dict]:
    """Rows of the stills, each with its picture (H, W, 3)."""
    common = ["--particles=600", "--seconds=0.2", "--device=cpu", f"--out={out}"]
    verb("render", *common, *options, twin=drawn / twin)
    rows = json.loads((out / "result.json").read_text())["stills"]
    return [r | {"picture": np.asarray(Image.open(out / r["picture"])).astype(int)} for r in rows]


def area(picture: np.ndarray, colour: tuple) -> int:
    """Pixels of about a colour."""
    return int((np.abs(picture - colour).max(-1) < 25).sum())


def test_photographs_of_a_twin_are_its_renderings(drawn, tmp_path):
    rows = run(drawn, tmp_path / "out", f"--recording={drawn / 'recording'}", "--camera=front")
    assert [r["pressure_kpa"] for r in rows] == list(PRESSURES)  # rising, though the table falls
    assert min(r["iou"] for r in rows) > 0.99
    for picture in (r["picture"] for r in rows):
        third = picture.shape[1] // 3
        photograph, twin, edges = (picture[:-50, k * third : (k + 1) * third - 8] for k in range(3))
        same = photograph.sum(-1) > 120  # where the photograph is not black
        assert np.abs(photograph - twin)[same].mean() < 12
        assert area(edges, RED) + area(edges, BLUE) < 0.02 * area(edges, (222, 226, 230))
    assert (tmp_path / "out" / "film.mp4").is_file()


def test_effects_of_the_twin_act(drawn, tmp_path):
    twin = Twin.load(drawn / "twin")
    twin.effects["stiffening"] = {p.name: Value(p.default) for p in get_effect("stiffening").parameters}
    twin.save(drawn / "stiff")
    ious = [
        run(drawn, tmp_path / name, f"--recording={drawn / 'recording'}", twin=name)[-1]["iou"]
        for name in ("twin", "stiff")
    ]
    assert ious[1] < ious[0] - 0.02


def test_looks_are_seen_from_any_side(drawn, tmp_path):
    pictures = {}
    for azimuth in (0, 90, 180):
        view = [f"--view.azimuth_deg={azimuth}", "--view.elevation_deg=0", "--pressure_kpa=[12]"]
        pictures[azimuth] = run(drawn, tmp_path / str(azimuth), *view)[0]["picture"][: BODY_PX[1]]
    places = {}
    for azimuth, p in pictures.items():
        base, tip = p[..., 0] - p[..., 1] > 60, p[..., 1] - p[..., 0] > 60
        (y0, x0), (y1, x1) = (np.argwhere(m).mean(0) for m in (base, tip))
        assert y1 > y0 + 80  # it hangs
        places[azimuth] = x1 - x0
    assert places[0] > 30 and places[180] == pytest.approx(-places[0], abs=6) and abs(places[90]) < 5


def test_what_cannot_be_shown_is_told(drawn, tmp_path):
    recording = Recording.load(drawn / "recording")
    Twin.builtin().save(tmp_path / "plain")
    new_twin("arm", length_mm=200.0).save(tmp_path / "arm")
    meta = json.loads(json.dumps(recording.meta))
    meta["cameras"]["front"]["extrinsics"][0][3] += 10.0
    away = Recording(tmp_path, meta, recording.samples, "finger").write(tmp_path / "away")
    for file in recording.folder.glob("*.png"):
        (away / file.name).write_bytes(file.read_bytes())
    for twin, folder, options, said in (
        (drawn / "twin", recording.folder, ["--camera=top"], "has no camera 'top' with masks; it has front"),
        (tmp_path / "plain", recording.folder, [], "has no looks; fit them with `pneutac calibrate"),
        (tmp_path / "arm", recording.folder, [], "is of a finger and .* of an arm; give a recording of"),
        (drawn / "twin", away, [], "The camera does not see the body"),
    ):
        refused(said, "render", *options, twin=twin, recording=folder, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()
