"""`pneutac surrogate`: a twin's own body and effect reach the world, interrupted runs go on, bad input."""

import json
import subprocess
import sys

import numpy as np
import pytest
from verbs import verb

from lerobot_pneutac.verbs.surrogate import CARD, DATA
from pneutac_sim.errors import InputError
from pneutac_sim.surrogate import collect
from pneutac_sim.twin import Twin, Value
from pneutac_sim.world.world import World

pytestmark = pytest.mark.slow

TINY = ["--trajectories=6", "--seconds=0.1", "--particles=600", "--device=cpu"]
STIFFENING = {"linear_1_per_kpa": Value(0.02), "quadratic_1_per_kpa2": Value(0.0)}


def train(twin, *options) -> None:
    verb("surrogate", *TINY, *options, twin=twin)


def other_body() -> Twin:
    """A finger that stiffens, of another material than the built-in one."""
    twin = Twin.builtin()
    twin.effects["stiffening"] = dict(STIFFENING)
    twin.parameters["poissons_ratio"] = Value(0.42)
    return twin


def bend_rad(twin: Twin | None, fidelity: str) -> float:
    """Sum of the joint angles in free air at 15 kPa."""
    world = World("switch", twin, touch="none", fidelity=fidelity)
    for _ in range(30):
        world.step(np.array([0.0, 0.0, 0.02, 15.0]))
    return float(world.spine_rad.sum())


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A body of its own, trained in two goes: the first is interrupted after four trajectories."""
    folder = tmp_path_factory.mktemp("stiffening") / "twin"
    other_body().save(folder)
    whole, moved = collect._move, []

    def once(twin, plan, batch, device):
        if moved:
            raise KeyboardInterrupt
        moved.append(batch)
        return whole(twin, plan, batch, device)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(collect, "_move", once)
        with pytest.raises(KeyboardInterrupt):
            train(folder)
    kept = {f: f.stat().st_mtime_ns for f in folder.glob("surrogate_data/*/action_*.safetensors")}
    assert len(kept) == 4 and not (folder / "action.safetensors").exists()
    train(folder, f"--out={folder.parent / 'out'}")
    return folder, kept


def test_a_body_of_its_own_has_a_world(trained):
    twin = Twin.load(trained[0])
    assert 0.2 < bend_rad(twin, "surrogate") < 3.0
    with pytest.raises(InputError, match="has no action network"):
        World("switch", other_body(), touch="none", fidelity="surrogate")


def test_an_effect_that_is_added_is_seen_in_the_world_with_the_networks_of_the_body():
    twin = Twin.builtin()
    twin.effects["stiffening"] = dict(STIFFENING)
    change = bend_rad(twin, "surrogate") - bend_rad(None, "surrogate")
    wanted = bend_rad(twin, "probe") - bend_rad(None, "probe")
    assert abs(wanted) > 0.05
    assert change == pytest.approx(wanted, rel=0.1)


def test_an_interrupted_run_goes_on_with_what_it_has(trained):
    folder, kept = trained
    assert all(f.stat().st_mtime_ns == then for f, then in kept.items())
    assert len(list(folder.glob("surrogate_data/*/action_*.safetensors"))) == 6


def test_the_result_tells_errors_and_where_the_networks_are_from(trained):
    folder, _ = trained
    networks = json.loads((folder.parent / "out" / "result.json").read_text())["networks"]
    assert networks["action"]["source"] == "trained" and networks["perception"]["source"].startswith(
        "shipped"
    )
    errors = networks["action"]["errors"]
    assert errors["trajectories"] == 1 and 0 < errors["position_deg"] < errors["bare_position_deg"]
    assert "| joint angle, held out |" in (folder / CARD).read_text()
    assert (folder.parent / "out" / "report.html").is_file()


def test_shipped_networks_are_taken_for_the_finger_that_they_were_trained_for(tmp_path):
    Twin.builtin().save(tmp_path / "twin")
    verb("surrogate", twin=tmp_path / "twin")
    stored = Twin.load(tmp_path / "twin")
    assert set(stored.networks) == {"action", "perception"}
    assert not (tmp_path / "twin" / DATA).exists()
    assert bend_rad(stored, "surrogate") == bend_rad(None, "surrogate")


def test_a_damaged_network_of_the_twin_is_refused(tmp_path):
    Twin.builtin().save(tmp_path / "twin")
    verb("surrogate", twin=tmp_path / "twin")
    for name in ("action", "perception"):
        file = tmp_path / "twin" / f"{name}.safetensors"
        whole = file.read_bytes()
        file.write_bytes(whole[: len(whole) // 2])
        with pytest.raises(InputError, match=f"{name}.safetensors.* train .*with `pneutac surrogate`"):
            World("switch", Twin.load(tmp_path / "twin"), touch="none", fidelity="surrogate")
        file.write_bytes(whole)


def test_two_at_once_on_one_twin_are_refused(tmp_path):
    other_body().save(tmp_path / "twin")
    other = (
        "import sys, time; from pathlib import Path; from pneutac_sim.files import locked\n"
        "with locked(Path(sys.argv[1])): print('locked', flush=True); time.sleep(60)"
    )
    command = [sys.executable, "-c", other, str(tmp_path / "twin" / DATA)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        process.stdout.readline()
        with pytest.raises(InputError, match=f"Another command is writing into '.*twin/{DATA}'; wait for it"):
            train(tmp_path / "twin")
        process.kill()
