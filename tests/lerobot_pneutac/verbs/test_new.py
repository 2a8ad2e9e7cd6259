"""`pneutac new`: geometry that is written, and a user's mesh that comes in and travels with the twin."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import trimesh
from verbs import refused, verb

from lerobot_pneutac.verbs.new import new_twin
from lerobot_pneutac.verbs.result import measured_range
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError
from pneutac_sim.finger import Pipeline
from pneutac_sim.mpm.solid import body_mesh
from pneutac_sim.mpm.user_mesh import stored_mesh
from pneutac_sim.twin import Twin


@pytest.fixture
def capsule(tmp_path):
    """A file in metres, 70 mm long, that stands on its tip along y somewhere in space."""
    mesh = trimesh.creation.capsule(height=0.054, radius=0.008, count=(24, 24))
    mesh.vertices = np.roll(mesh.vertices, -1, axis=1) + [0.3, 0.1, -0.2]
    mesh.export(tmp_path / "capsule.obj")
    return tmp_path / "capsule.obj"


@pytest.mark.parametrize(
    ("commanded", "found"),
    [
        ([0.0, 59.6, 30.0], (0.0, 60.0)),
        ([-38.2, 12.0], (-39.0, 12.0)),
        ([3.0, 14.8], (0.0, 15.0)),
        ([-8.0, -0.5], (-8.0, 0.0)),
        ([0.0, 0.0], None),
    ],
)
def test_the_range_measured_is_that_of_the_commands_with_zero_rounded_outwards(commanded, found):
    n = len(commanded)
    samples = {"trial": [0] * n, "time_s": range(n), "pressure_cmd_kpa": commanded, "tip_x_mm": [80.0] * n}
    recording = Recording(Path("bench"), {"length_mm": 80.0}, pd.DataFrame(samples), "finger")
    assert measured_range(recording) == found
    assert new_twin("finger", recording).pressure_range_kpa == (found or (0.0, 15.0))


@pytest.mark.parametrize(("device", "files"), [("finger", 2), ("arm", 1), ("gel", 1)])
def test_geometry_is_written_in_millimetres(tmp_path, device, files):
    verb("new", twin=tmp_path / "twin", device=device)
    twin = Twin.load(tmp_path / "twin")
    stl = trimesh.load_mesh(tmp_path / "twin" / "geometry.stl")
    assert stl.is_watertight
    assert stl.volume == pytest.approx(1e9 * body_mesh(twin).volume, rel=1e-4)
    assert stl.extents.max() == pytest.approx({"finger": 110, "arm": 110, "gel": 16}[device], rel=0.02)
    assert len(list((tmp_path / "twin").glob("*.stl"))) == files
    assert stored_mesh(twin) is None


@pytest.mark.parametrize("device", ["finger", "arm"])
def test_written_geometry_comes_back_as_the_same_body(tmp_path, device):
    verb("new", twin=tmp_path / "a", device=device)
    stl = tmp_path / "a" / "geometry.stl"
    verb("new", twin=tmp_path / "b", device=device, mesh=stl)
    a, b = (Twin.load(tmp_path / n) for n in "ab")
    assert b.device == device and b.length_mm == a.length_mm
    assert b.spine_joint_positions_mm == pytest.approx(a.spine_joint_positions_mm)
    assert stored_mesh(b).volume == pytest.approx(body_mesh(a).volume, rel=1e-4)


def test_a_mesh_travels_with_its_twin_and_bends(tmp_path, capsule, capsys):
    verb("new", twin=tmp_path / "twin", mesh=capsule, mesh_unit="m", mesh_axis="y")
    said = " ".join(capsys.readouterr().out.split())
    assert "70 mm long with 4 spine joints" in said and "y became x" in said
    # the file's y begins at 0.1 - 0.035 m, its z (here y) is at -0.2, its x (here z) at 0.3
    volume = 1e6 * trimesh.load_mesh(capsule).volume
    assert f"70 x 16 x 16 mm along x, y and z, {volume:.4g} cm³" in said
    assert "moved by (-65.00, 200.00, -300.00) mm" in said
    twin = Twin.load(tmp_path / "twin")
    assert twin.device == "finger" and twin.length_mm == pytest.approx(70, abs=1e-3)
    # what a calibration writes elsewhere keeps the mesh
    pipeline = Pipeline.of(twin)
    again = Twin.load(pipeline.update(twin, pipeline.theta(twin)).save(tmp_path / "again"))
    np.testing.assert_array_equal(stored_mesh(again).vertices, stored_mesh(twin).vertices)
    np.testing.assert_allclose(stored_mesh(again).bounds, [[0, -8e-3, -8e-3], [70e-3, 8e-3, 8e-3]], atol=1e-6)
    out = tmp_path / "out"
    verb(
        "render",
        twin=tmp_path / "again",
        pressure_kpa="[0,12]",
        seconds="0.2",
        particles=600,
        device="cpu",
        out=out,
    )
    still = json.loads((out / "result.json").read_text())["stills"]
    tips = np.array([[r["tip_x_mm"], r["tip_z_mm"]] for r in still])
    assert tips[1, 1] > tips[0, 1] + 5 and (np.hypot(*tips.T) < 70).all()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--length_mm=80"], "--length_mm is the mesh's own"),
        (["--mesh_unit=cm"], "^unit is 'cm'; it must be one of mm, m"),
        ([], "read in mm is 0.07 mm long.*give the unit m"),
    ],
)
def test_bad_options_are_named_and_write_nothing(tmp_path, capsule, options, said):
    refused(said, "new", *options, twin=tmp_path / "twin", mesh=capsule)
    assert not (tmp_path / "twin").exists()


def recorded(folder, length_mm: float):
    """A recording of a finger with one trial at rest."""
    folder.mkdir()
    meta = {"device": "finger", "length_mm": length_mm, "samples": "samples.csv"}
    meta["spine_joint_positions_mm"] = [10.0, 25.0, 40.0, 55.0]
    (folder / "recording.json").write_text(json.dumps(meta))
    rows = ["trial,time_s,pressure_cmd_kpa,bend_angle_rad"]
    rows += [f"0,{0.1 * k:.1f},{0.5 * k:.1f},{0.02 * k:.2f}" for k in range(30)]
    (folder / "samples.csv").write_text("\n".join(rows))
    return folder


@pytest.mark.parametrize("content", [b"", b"\x89PNG\r\n", bytes(80) + b"\x00\xca\x9a\x3b" + bytes(50)])
def test_a_mesh_that_is_cut_short_is_not_called_empty_alone(tmp_path, content):
    (tmp_path / "m.stl").write_bytes(content)
    refused(
        "holds no triangles: it is empty, cut short or no mesh",
        "new",
        twin=tmp_path / "t",
        mesh=tmp_path / "m.stl",
    )
    assert not (tmp_path / "t").exists()


def test_a_recording_gives_the_joints_of_a_mesh_of_its_length(tmp_path, capsule):
    mesh = [f"--mesh={capsule}", "--mesh_unit=m"]
    verb("new", *mesh, twin=tmp_path / "twin", recording=recorded(tmp_path / "r", 70.5))
    twin = Twin.load(tmp_path / "twin")
    assert twin.spine_joint_positions_mm == [10.0, 25.0, 40.0, 55.0] and stored_mesh(twin) is not None
    with pytest.raises(InputError, match="is 70 mm long, but length_mm is 90 in .*recording.json"):
        verb("new", *mesh, twin=tmp_path / "other", recording=recorded(tmp_path / "s", 90.0))
