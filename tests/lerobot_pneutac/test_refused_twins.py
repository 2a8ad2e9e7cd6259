"""A twin of which no world can be made is refused in one sentence, wherever a user names it."""

import pytest
from draccus.utils import DecodingError

from lerobot_pneutac.rl.options import PpoConfig
from lerobot_pneutac.verbs.augment import AugmentConfig, DatasetRef
from lerobot_robot_pneutac.env import PneutacEnvConfig
from lerobot_robot_pneutac.robots.config_pneutac_sim import PneutacSimConfig
from pneutac_sim.effects import get_effect
from pneutac_sim.errors import InputError
from pneutac_sim.gel.model import GelModel
from pneutac_sim.twin import Twin, Value

PLACES = {
    "env": lambda twin: PneutacEnvConfig(twin=twin),
    "robot": lambda twin: PneutacSimConfig(twin=twin),
    "ppo": lambda twin: PpoConfig(out=twin / "ppo", twin=twin),
    "augment": lambda twin: AugmentConfig(DatasetRef("a", twin), DatasetRef("b", twin), twin=twin),
}


def without_its_condition(twin: Twin) -> None:
    twin.effects["thermal"] = get_effect("thermal").start(15.0)


def older_networks(twin: Twin) -> None:
    gel = GelModel.builtin()
    gel.thickness_mm = 2.0
    gel.into_twin(twin)


def too_soft(twin: Twin) -> None:
    twin.parameters["joint_stiffness_nm_per_rad"] = Value(1e-3)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (
            without_its_condition,
            "effect 'thermal' needs the condition 'temperature_c'; give it, as in",
        ),
        (older_networks, "run `pneutac surrogate --twin="),
        (too_soft, "more than the twin's joint_stiffness_nm_per_rad of 0.001"),
    ],
)
def test_no_work_begins_with_such_a_twin(tmp_path, place, spoil, says):
    twin = Twin.builtin()
    spoil(twin)
    twin.save(tmp_path)
    with pytest.raises((InputError, DecodingError)) as refused:
        PLACES[place](tmp_path)
    message = getattr(refused.value, "message", None) or str(refused.value)
    assert says in message
    if place in ("env", "robot"):
        option = "conditions" if spoil is without_its_condition else "twin"
        assert message.startswith(f"--{place}.{option}: ")


def test_a_stand_in_needs_no_networks_of_the_twin(tmp_path):
    twin = Twin.builtin()
    older_networks(twin)
    twin.save(tmp_path)
    PneutacSimConfig(twin=tmp_path, standin=True)
    PneutacEnvConfig(twin=tmp_path, fidelity="probe")
