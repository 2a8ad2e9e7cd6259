"""`pneutac calibrate --by=images`: a twin from photographs alone, its result and report, bad recordings."""

import io
import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from generated import once
from PIL import Image
from rich.console import Console

from lerobot_pneutac.cli.terminal import Terminal
from lerobot_pneutac.study.photographs import photo_study
from lerobot_pneutac.verbs import calibrate as verb
from lerobot_pneutac.verbs.calibrate import CalibrateConfig, run, training_levels
from lerobot_pneutac.verbs.fit_photographs import search_key
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError
from pneutac_sim.splat.body import looks_from_twin
from pneutac_sim.twin import Twin

pytestmark = pytest.mark.slow

LEVELS = (0.0, 7.0, 14.0)
PRESSURES = np.array([[0.0], [4.0], [7.0], [14.0]])


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """A recording of four photographs by the renderer, from the front and from behind, with markers."""
    from pneutac_sim.photo_fit.objective import Equilibria, Objective, body_parameters
    from pneutac_sim.splat.body import blank_looks
    from pneutac_sim.splat.camera import Camera

    folder = tmp_path_factory.mktemp("photographs") / "finger"
    twin = Twin.builtin()
    parameters = body_parameters(twin, 14.0)
    truth = parameters.coordinates(twin)
    rest = Equilibria(parameters, truth, PRESSURES, particles=1000, device="cpu")
    looks = blank_looks(rest.body)
    looks.colours[:] = np.random.default_rng(0).uniform(0.2, 0.8, looks.colours.shape)
    blank = Objective(rest, [], looks)
    surfaces = blank.surface(rest.first.positions[0], rest.first.gradients[0])
    eyes = {"front": -0.4, "back": 0.4}
    cameras = {
        n: Camera.look_at((0.055, y, 0.02), (0.055, 0, 0.02), (-1, 0, 0), 22.0, 240, 240)
        for n, y in eyes.items()
    }
    rows = []
    folder.mkdir(parents=True)
    for i, (positions, tip) in enumerate(zip(rest.first.positions[0], rest.first.tips[0], strict=True)):
        row = {"trial": i, "time_s": 0.0, "pressure_cmd_kpa": PRESSURES[i, 0]}
        for name, camera in cameras.items():
            picture = blank.render(positions, camera)
            mask = blank.outline.coverage(surfaces[i], camera) > 0.5
            row |= {f"{kind}_{name}": f"{i}_{kind}_{name}.png" for kind in ("image", "mask")}
            image = (255 * picture.image.clip(0, 1)).round().astype(np.uint8)
            Image.fromarray(image).save(folder / row[f"image_{name}"])
            Image.fromarray(np.uint8(255) * mask).save(folder / row[f"mask_{name}"])
        rows.append(row | {f"tip_{a}_mm": 1e3 * v for a, v in zip("xyz", tip, strict=True)})
    told = {
        n: {"intrinsics": c.intrinsics.tolist(), "extrinsics": c.extrinsics.tolist()}
        for n, c in cameras.items()
    }
    joints = list(twin.spine_joint_positions_mm)
    meta = {"device": "finger", "length_mm": 110.0, "spine_joint_positions_mm": joints, "cameras": told}
    Recording(folder, meta, pd.DataFrame(rows), "finger").write(folder)
    return Recording.load(folder)


def config(tmp_path, recording, **options):
    twin = tmp_path / "twin"
    if not twin.exists():
        Twin("finger", 110.0).save(twin)
    options = {"by": "images", "train_kpa": "0,7,14", "evaluations": 7, "particles": 1000} | options
    return CalibrateConfig(twin=twin, recording=recording.folder, **options)


def altered(recording, folder, **changes):
    """A copy in another folder with columns changed, or removed where None."""
    samples = recording.samples.copy()
    for name, values in changes.items():
        samples = samples.drop(columns=name) if values is None else samples.assign(**{name: values})
    Recording(folder, recording.meta, samples, "finger").write(folder)
    for file in recording.folder.glob("*.png"):
        (folder / file.name).write_bytes(file.read_bytes())
    return Recording.load(folder)


def calibrate(cfg, scratch, console):
    """As the command does; returns what is in `result.json`."""
    terminal = Terminal("calibrate", [])
    terminal.console = console
    result = run(cfg, scratch, terminal)
    if not result.worse:
        result = result.save(cfg.twin)
    if cfg.out is not None:
        result.report(cfg.out)
    return result.to_dict()


@pytest.fixture(scope="module")
def calibrated(drawn, tmp_path_factory):
    """Folder of twin and report, and the result."""
    folder = tmp_path_factory.mktemp("calibrated")
    return folder, calibrate(config(folder, drawn, out=folder / "out"), folder, Console(quiet=True))


@pytest.mark.nightly
def test_a_finger_is_calibrated_and_told(calibrated):
    folder, result = calibrated
    out = folder / "out"
    assert json.loads((out / "result.json").read_text())["parameters"] == result["parameters"]
    assert result["tip_error_mm"]["heldout"] < 0.015 * 110
    assert result["iou"]["heldout"] > 0.95 and result["iou"]["train"] > 0.95
    assert result["cameras"] == ["front"] and result["evaluations"] == 7
    assert {"youngs_modulus_mpa", "poissons_ratio"} == set(result["not_identified"])
    assert "gain_rad_per_kpa" not in result["not_identified"]
    for row in result["parameters"].values():
        assert row["ci95"][0] <= row["value"] <= row["ci95"][1]
    twin = Twin.load(folder / "twin")
    assert twin.history[-1]["change"] == "calibrated by images" and twin.history[-1]["unit"] == "8-bit levels"
    assert len(looks_from_twin(twin)) > 900
    assert "Photographs and renderings" in (out / "report.html").read_text()
    assert (out / "best.png").is_file()


def test_without_markers_photographs_are_fitted(drawn, tmp_path, monkeypatch):
    without = altered(drawn, tmp_path / "without", **{f"tip_{a}_mm": None for a in "xyz"})

    def fit_by(way):
        def fit(*_, **__):
            raise NotImplementedError(way)

        return fit

    monkeypatch.setattr("lerobot_pneutac.verbs.fit_photographs.calibrate_photographs", fit_by("images"))
    monkeypatch.setattr("lerobot_pneutac.verbs.fit_body.calibrate_body", fit_by("markers"))
    for recording, by, used in (
        (without, None, "images"),
        (drawn, None, "markers"),
        (drawn, "images", "images"),
    ):
        with pytest.raises(NotImplementedError, match=used):
            verb.calibrate(Twin("finger", 110.0), recording, by=by)


def test_bad_recordings_are_told_in_a_sentence(drawn, tmp_path):
    shape = (240, 240)

    def refused(match, recording, levels=LEVELS):
        with pytest.raises(InputError, match=match):
            photo_study(recording, levels)

    for name, value, match in (("empty", 0, "covers 0.0%"), ("full", 255, "covers 100.0%")):
        bad = altered(drawn, tmp_path / name)
        Image.fromarray(np.full(shape, value, np.uint8)).save(bad.folder / "2_mask_front.png")
        refused(f"mask_front of row 3 {match}", bad)
    refused("choose at least two by train_kpa", drawn, (0.0, 3.0))
    refused("mask_<camera>", altered(drawn, tmp_path / "none", mask_front=None, mask_back=None))
    nothing = replace(drawn, samples=drawn.samples.assign(pressure_cmd_kpa=[0, np.nan, 7, 14]))
    refused("row 2 has no pressure", nothing)
    for text in ("3", "a,b", "0,nan"):
        with pytest.raises(InputError, match="at least two pressures"):
            training_levels(text)


def test_masks_are_found_by_segmentation_where_there_are_none(tmp_path):
    from pneutac_datasets.generate.photographs import write_photographs

    made = once(write_photographs, tmp_path / "hidden", seed=2, pressures_kpa=[0, 12], particles=3000)
    masked = photo_study(made, (0.0, 12.0))
    without = [c for c in made.samples if c.startswith("mask")]
    assert masked.findings == () and without
    bare = replace(made, samples=made.samples.drop(columns=without))
    found = photo_study(bare, (0.0, 12.0))
    assert found.cameras == masked.cameras
    assert "found by segmentation" in found.findings[0] and "front" in found.findings[0]
    for a, b in zip(masked.photographs, found.photographs, strict=True):
        assert (a.mask & b.mask).sum() / (a.mask | b.mask).sum() > 0.95


def test_a_camera_that_looks_elsewhere_is_told(drawn, tmp_path):
    meta = json.loads(json.dumps(drawn.meta))
    extrinsics = np.array(meta["cameras"]["front"]["extrinsics"])
    extrinsics[:3, 3] *= 1000  # millimetres
    meta["cameras"]["front"]["extrinsics"] = extrinsics.tolist()
    bad = altered(replace(drawn, meta=meta), tmp_path / "mm")
    with pytest.raises(InputError, match="row 1: the twin's silhouette overlaps the mask by 0%"):
        calibrate(config(tmp_path, bad), tmp_path, Console(quiet=True))


def test_the_only_camera_needs_no_name_in_the_columns(drawn, tmp_path):
    front = {"image": drawn.column("image_front"), "mask": drawn.column("mask_front")}
    gone = {f"{kind}_{name}": None for kind in ("image", "mask") for name in ("front", "back")}
    one = replace(drawn, meta=drawn.meta | {"cameras": {"front": drawn.meta["cameras"]["front"]}})
    named, plain = (
        photo_study(drawn, LEVELS),
        photo_study(altered(one, tmp_path / "one", **front, **gone), LEVELS),
    )
    assert plain.cameras == ["front"] and plain.train.tolist() == named.train.tolist()
    for a, b in zip(named.photographs, plain.photographs, strict=True):
        assert np.array_equal(a.image, b.image) and np.array_equal(a.mask, b.mask) and a.state == b.state
        assert np.array_equal(a.camera.extrinsics, b.camera.extrinsics)
    several = altered(drawn, tmp_path / "several", **front, **gone)
    with pytest.raises(InputError, match="describes front, back; name the columns image_<camera> and mask_"):
        photo_study(several, LEVELS)
    none = altered(replace(drawn, meta=drawn.meta | {"cameras": {}}), tmp_path / "none", **front, **gone)
    with pytest.raises(InputError, match="describes none; describe it"):
        photo_study(none, LEVELS)
    Image.fromarray(np.zeros((240, 240), np.uint8)).save(
        plain_folder := tmp_path / "one" / "2_mask_front.png"
    )
    with pytest.raises(InputError, match="mask of row 3 covers 0.0%"):
        photo_study(Recording.load(plain_folder.parent), LEVELS)


def test_an_interrupted_search_says_what_is_kept(drawn, tmp_path, monkeypatch):
    cfg = config(tmp_path, drawn, out=tmp_path / "out")
    before = (cfg.twin / "twin.yaml").read_bytes()
    for generations, said in (
        (0, "Stopped before the first"),
        (2, "Stopped after 14 evaluations, stored in"),
    ):

        def stopped(*_, file, generations=generations, **__):
            file.parent.mkdir(exist_ok=True)
            file.write_text(json.dumps({"key": "", "evaluations": [{}] * 7 * generations}))
            raise KeyboardInterrupt

        monkeypatch.setattr("lerobot_pneutac.verbs.fit_photographs.calibrate_photographs", stopped)
        console = Console(record=True, width=200, file=io.StringIO())
        with pytest.raises(KeyboardInterrupt):
            calibrate(cfg, tmp_path, console)
        assert said in console.export_text()
    assert (cfg.twin / "twin.yaml").read_bytes() == before


def test_a_search_goes_on_only_with_the_same_photographs(drawn):
    session, twin = photo_study(drawn, LEVELS), Twin.builtin()
    key = search_key(drawn, twin, session.photographs, 1000)
    assert key == search_key(drawn, twin, photo_study(drawn, LEVELS).photographs, 1000)
    first, *others = session.photographs
    for other in (replace(first, image=255 - first.image), replace(first, mask=~first.mask)):
        assert search_key(drawn, twin, [other, *others], 1000) != key
    assert search_key(drawn, twin, session.photographs, 2000) != key
