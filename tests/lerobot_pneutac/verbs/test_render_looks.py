"""`pneutac render` in a twin's own looks: beside photographs, and from any side."""

import json

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from lerobot_pneutac.cli import run_verb
from lerobot_pneutac.rendering.view import HEIGHT
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.errors import InputError
from pneutac_sim.mpm import devices
from pneutac_sim.mpm.loads import Loads
from pneutac_sim.mpm.solve import solve_equilibrium
from pneutac_sim.splat.body import looks_into_twin
from pneutac_sim.splat.camera import Camera
from pneutac_sim.splat.follow import blank_looks, carried
from pneutac_sim.splat.render import rasterise
from pneutac_sim.twin import Twin, Value

pytestmark = pytest.mark.slow

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
    run_verb("render", [f"--twin={drawn / twin}", *common, *options])
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
        pictures[azimuth] = run(drawn, tmp_path / str(azimuth), *view)[0]["picture"][:HEIGHT]
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
    Twin("arm", 200.0).save(tmp_path / "arm")
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
        with pytest.raises(InputError, match=said):
            run_verb(
                "render", [f"--twin={twin}", f"--recording={folder}", f"--out={tmp_path / 'out'}", *options]
            )
    assert not (tmp_path / "out").exists()
