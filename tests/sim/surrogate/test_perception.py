"""Perception network: contacts, training, the shipped weights, and what becomes of bad input."""

from importlib.resources import files

import numpy as np
import pytest
import torch

from pneutac_sim.errors import InputError
from pneutac_sim.gel.indenter import INDENTERS, Press
from pneutac_sim.gel.probe import COLS, ROWS, probe_grid
from pneutac_sim.gel.sensor import TactileSensor
from pneutac_sim.gel.surface import surface
from pneutac_sim.mpm import devices
from pneutac_sim.mpm.solve import MpmDiverged
from pneutac_sim.surrogate import gel_collect
from pneutac_sim.surrogate.finger import gel_fingerprint
from pneutac_sim.surrogate.gel_collect import (
    Contact,
    Pairs,
    collect_gel,
    random_contact,
    read_contacts,
)
from pneutac_sim.surrogate.gel_train import UNet, evaluate_gel, split, train_gel
from pneutac_sim.surrogate.perception import GelSurrogate
from pneutac_sim.twin import Twin

WINDOW_MM = (12.0, 16.0)


@pytest.fixture(scope="module")
def builtin():
    return GelSurrogate.load(files("pneutac_sim.surrogate") / "builtin_perception.safetensors")


def grid(indenter="sphere", size_mm=3.0, x_mm=1.0, y_mm=-2.0, depth_mm=1.3, yaw_rad=0.4):
    return probe_grid(*Press(indenter, size_mm, x_mm, y_mm, depth_mm, yaw_rad).shapes())


def soft(depth_mm):
    """A made-up gel that a network can learn: it follows what presses it and sags around."""
    return surface(depth_mm, decay_mm=0.8)


@pytest.fixture
def quick(monkeypatch):
    """Collecting with the made-up gel instead of material points; counts the presses."""
    pressed = []

    def press(solver, contact, model):
        pressed.append(contact)
        depth = np.stack([probe_grid(*contact.at(contact.press.depth_mm * s).shapes()) for s in (0.5, 1.0)])
        return Pairs(contact.press.indenter, depth, np.stack([soft(d) for d in depth]))

    monkeypatch.setattr(gel_collect, "press", press)
    monkeypatch.setattr(devices, "gel", lambda twin, device: "a gel")
    return pressed


# ---------------------------------------------------------------- contacts


@pytest.mark.parametrize("indenter", INDENTERS)
def test_probe_grid_and_material_points_get_the_same_indenter(indenter):
    """Points of the probe grid's contact surface lie on the surface of the indenter of the loads."""
    contact = Contact(Press(indenter, 4.0, 0.7, -1.1, 1.3, 0.5), 0.15, 1.9)
    loads, depth = contact.loads(), probe_grid(*contact.shapes())
    i, j = np.nonzero(depth > 0.2)
    points = np.column_stack([(j + 0.5) * 12 / COLS - 6, (i + 0.5) * 16 / ROWS - 8, -depth[i, j]])
    own = (1e-3 * points - loads.position_m) @ loads.rotation  # tip at the origin, body towards +z
    x, y, z = own.T
    size, s = loads.size_m, 4e-3
    height = {
        "sphere": lambda: s - np.sqrt(s**2 - x**2 - y**2),
        "cylinder": lambda: np.where(np.hypot(x, y) < 0.98 * s, 0.0, z),
        "cone": lambda: np.hypot(x, y),
        "cube": lambda: np.where(np.maximum(abs(x), abs(y)) < 0.97 * size[0], 0.0, z),
        "edge": lambda: np.where(abs(y) < 0.97 * size[1], abs(x), z),
    }[indenter]()
    assert len(points) > 20 and np.abs(z - height).max() < 2e-6


# ---------------------------------------------------------------- collecting


def test_collecting_goes_on_after_an_interruption_without_doubling(tmp_path, quick):
    def interrupt(done, total):
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        collect_gel(Twin.builtin(), tmp_path, 6, progress=interrupt)
    calls = []
    found = collect_gel(Twin.builtin(), tmp_path, 6, progress=lambda *a: calls.append(a))
    assert (found.contacts, found.diverged) == (6, 0) and calls[-1] == (6, 6)
    assert quick == [random_contact(0, n, WINDOW_MM) for n in range(6)]
    pairs = read_contacts(tmp_path)
    np.testing.assert_array_equal(pairs[4].displacement_mm[1], soft(pairs[4].depth_mm[1]))
    assert [p.indenter for p in pairs] == [*INDENTERS, INDENTERS[0]]


def test_a_contact_that_diverges_is_left_out_and_counted(tmp_path, quick, monkeypatch):
    working = gel_collect.press

    def press(solver, contact, model):
        if contact.press.indenter == "cube":
            raise MpmDiverged("Body 'gel' left the finite numbers", "load it less")
        return working(solver, contact, model)

    monkeypatch.setattr(gel_collect, "press", press)
    for _ in range(2):  # it is not tried again
        assert collect_gel(Twin.builtin(), tmp_path, 10) == gel_collect.Collected(8, 2)
    assert len(read_contacts(tmp_path)) == 8 == len(quick)


def test_a_folder_of_another_gel_or_seed_is_refused(tmp_path, quick):
    collect_gel(Twin.builtin(), tmp_path, 1)
    with pytest.raises(InputError, match="another seed; give another folder"):
        collect_gel(Twin.builtin(), tmp_path, 1, seed=1)
    other = Twin.builtin()
    other.parameters["gel_poissons_ratio"] = type(other.parameters["gain_alpha"])(0.4)
    with pytest.raises(InputError, match="another gel"):
        collect_gel(other, tmp_path, 1)


def test_a_damaged_contact_is_named(tmp_path, quick):
    collect_gel(Twin.builtin(), tmp_path, 2)
    file = tmp_path / "contact_0001.npz"
    file.write_bytes(file.read_bytes()[:2000])
    with pytest.raises(InputError, match="contact_0001.npz' is damaged; .*pneutac surrogate"):
        read_contacts(tmp_path)


# ---------------------------------------------------------------- training


def test_too_few_contacts_are_refused(tmp_path, quick):
    with pytest.raises(InputError, match="no collection.json.*pneutac surrogate"):
        train_gel(tmp_path / "nowhere", "")
    collect_gel(Twin.builtin(), tmp_path, 5)
    with pytest.raises(InputError, match="3 gel contacts .* too few .*pneutac surrogate"):
        train_gel(tmp_path, "")
    with pytest.raises(InputError, match="no indenter 'ball' to hold out; there are sphere"):
        train_gel(tmp_path, "", heldout=["ball"])
    with pytest.raises(InputError, match="device is 'tpu'; it must be one of auto, cpu, cuda"):
        train_gel(tmp_path, "", device="tpu")


def test_heldout_indenters_are_never_trained_on(tmp_path, quick):
    collect_gel(Twin.builtin(), tmp_path, 40)
    contacts = read_contacts(tmp_path)
    train, check, unseen = split(contacts, ["edge"])
    assert {p.indenter for p in unseen} == {"edge"} and len(unseen) == 8
    assert "edge" not in {p.indenter for p in train + check}
    assert len(train) + len(check) + len(unseen) == 40 and not {map(id, train)} & {map(id, check)}


@pytest.mark.nightly
@pytest.mark.slow
def test_another_gels_network_to_begin_with_is_kept_where_nothing_is_better(tmp_path, quick, builtin):
    gel_collect.collect_gel(Twin.builtin(), tmp_path, 12)
    _, check, unseen = split(read_contacts(tmp_path))
    same = train_gel(tmp_path, "x", epochs=0, start=builtin)
    assert all(np.array_equal(same.weights[k], w) for k, w in builtin.weights.items())
    assert same.fingerprint == "x" and same.deepest_mm < builtin.deepest_mm

    def error(network):
        depth = np.concatenate([p.depth_mm for p in check + unseen])
        moved = np.concatenate([p.displacement_mm for p in check + unseen])
        return np.abs(network.displacement(depth) - moved).mean()

    assert error(train_gel(tmp_path, "x", epochs=2, start=builtin)) < error(builtin)


# ---------------------------------------------------------------- the network


def test_nothing_touching_moves_nothing(builtin):
    nothing = np.zeros((ROWS, COLS), np.float32)
    assert not builtin.displacement(nothing).any()
    both = builtin.displacement(np.stack([nothing, grid()]))
    assert not both[0].any() and both[1].any()
    assert not builtin.out_of_range(nothing)


def test_what_is_compiled_is_the_network_that_was_trained():
    """Also where contacts reach over the window's rim, whose missing column is filled with zeros."""
    torch.manual_seed(3)
    network = UNet((4, 6, 8))
    gel = GelSurrogate(network.weights(), "", 2.0, 1.0)
    depth = np.stack([grid(), grid("cube", 6.0, 6.0, 8.0), np.full((ROWS, COLS), 0.7, np.float32)])
    with torch.inference_mode():
        g = network(torch.from_numpy(np.concatenate([depth, 0 * depth[:1]]))[:, None])[:, 0].numpy()
    np.testing.assert_allclose(gel.displacement(depth), depth + g[:-1] - g[-1], atol=2e-6)


def test_beyond_what_was_trained_is_flagged_and_stays_finite(builtin):
    usual, deep = grid(), np.full((ROWS, COLS), 2.5, np.float32)
    assert not builtin.out_of_range(usual)
    np.testing.assert_array_equal(builtin.out_of_range(np.stack([usual, deep])), [False, True])
    assert builtin.out_of_range(grid("sphere", 50.0, depth_mm=1.0)), "contact over the whole window"
    assert np.isfinite(builtin.displacement(deep)).all()
    with pytest.raises(ValueError, match="no finite number"):
        builtin.displacement(np.full((ROWS, COLS), np.nan))
    with pytest.raises(ValueError, match="probe grids have shape"):
        builtin.displacement(np.zeros((COLS, ROWS)))


def test_weights_survive_their_file(tmp_path):
    gel = GelSurrogate(UNet().weights(), "a gel", 1.9, 0.2, ("cone",), {"rows": [{"indenter": "cone"}]})
    gel.save(tmp_path / "gel.safetensors")
    read = GelSurrogate.load(tmp_path / "gel.safetensors")
    np.testing.assert_array_equal(read.displacement(grid()), gel.displacement(grid()))
    about = ("fingerprint", "deepest_mm", "largest_share", "heldout", "errors")
    assert [getattr(read, a) for a in about] == [getattr(gel, a) for a in about]


@pytest.mark.parametrize("damage", ["missing", "cut", "flipped", "other"])
def test_a_damaged_file_is_named(tmp_path, damage):
    file = tmp_path / "gel.safetensors"
    GelSurrogate(UNet().weights(), "", 1.9, 0.2).save(file)
    content = file.read_bytes()
    if damage == "missing":
        file.unlink()
    elif damage == "cut":
        file.write_bytes(content[:-100])
    elif damage == "flipped":
        file.write_bytes(content[:-4] + np.array([np.nan], np.float32).tobytes())
    else:
        file.write_bytes(content.replace(b"pneutac-gel-surrogate/1", b"pneutac-gel-surrogate/9"))
    with pytest.raises(InputError, match="gel.safetensors'.*`pneutac surrogate`"):
        GelSurrogate.load(file)


# ---------------------------------------------------------------- errors


def test_errors_are_those_against_the_contacts(builtin):
    """Of a gel that moves as the network says, but 0.01 mm deeper in every contact."""
    contacts = []
    for indenter in ("sphere", "cone"):
        depth = np.stack([grid(indenter, depth_mm=d) for d in (0.5, 1.2)])
        contacts.append(Pairs(indenter, depth, builtin.displacement(depth) + np.float32(0.01) * (depth > 0)))
    rows = evaluate_gel(builtin, contacts, Twin.builtin())["rows"]
    assert [row["indenter"] for row in rows] == ["sphere", "cone", "unseen"]
    for row in rows:
        assert row["contacts"] == 1 and row["depth_mm"] == pytest.approx(1.2, abs=0.15)
        assert row["network"]["mae_mm"] == pytest.approx(0.01, abs=1e-5)
        assert row["network"]["around_mm"] == pytest.approx(0.0, abs=1e-6)
        assert 0 < row["network"]["image_rmse_levels"] < row["probe"]["image_rmse_levels"]
        assert row["network"]["area_error_px"] < row["surface"]["area_error_px"]
    with pytest.raises(InputError, match="anything touches"):
        evaluate_gel(builtin, [Pairs("cone", 0 * depth, 0 * depth)], Twin.builtin())


# ---------------------------------------------------------------- the shipped weights


def test_shipped_weights_are_of_the_builtin_gel(builtin):
    assert builtin.fingerprint == gel_fingerprint(Twin.builtin())
    rows = {row["indenter"]: row for row in builtin.errors["rows"]}
    assert rows["unseen"]["network"]["mae_mm"] < min(0.04, 0.6 * rows["unseen"]["probe"]["mae_mm"])
    assert (files("pneutac_sim.surrogate") / "builtin_perception.safetensors").stat().st_size < 300_000


def test_a_sensor_takes_the_network_as_its_surface(builtin):
    sensor = TactileSensor(surface=builtin.displacement)
    depth = grid()
    np.testing.assert_array_equal(sensor.displacement(depth), builtin.displacement(depth))
    assert sensor.contact_from_depth(depth) == sensor.contact(sensor.image(depth))
