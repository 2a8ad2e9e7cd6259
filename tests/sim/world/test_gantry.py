"""Sequences of actions tried together are each as tried alone."""

import numpy as np
import pytest
from played import until

from pneutac_sim.effects import get_effect
from pneutac_sim.twin import Twin, Value
from pneutac_sim.world.base import Variation
from pneutac_sim.world.gantry import Gantry
from pneutac_sim.world.station import Station
from pneutac_sim.world.world import World

pytestmark = pytest.mark.slow


def in_contact(task: str, twin=None, **kwargs) -> tuple[World, np.ndarray]:
    """A world whose gel touches the object, and the expert's last action (4,)."""
    world = World(task, twin, "area", **kwargs)
    for seed in range(3, 8):
        action = until(world, seed, lambda: world.touch.area > 0.01 or world.time_s > 12)
        if world.touch.area:
            return world, action
    raise AssertionError(f"the expert never touches the {task}")


def tilted() -> Twin:
    twin = Twin.builtin()
    values = {p.name: Value(p.default) for p in get_effect("base_tilt").parameters}
    twin.effects["base_tilt"] = values | {"pitch_rad": Value(0.02)}
    return twin


@pytest.mark.parametrize(
    ("task", "fidelity", "tilts"),
    [
        ("switch", "surrogate", False),
        ("switch", "probe", True),
        *(pytest.param(t, "probe", False, marks=pytest.mark.nightly) for t in ("egg", "card")),
    ],
)
def test_many_sequences_are_each_by_itself(task, fidelity, tilts):
    world, action = in_contact(task, tilted() if tilts else None, fidelity=fidelity)
    gantry = Gantry(world)
    gantry.mirror(world)
    rng = np.random.default_rng(0)
    tried = action + rng.normal(0, [0.02, 0.02, 0.02, 1.0], (5, 6, 4))
    tried[:, :, 3] = tried[:, :, 3].clip(0, 15)
    alone = [gantry.rollout(actions) for actions in tried]
    steps = gantry.steps
    flange, area = gantry.rollouts(tried)
    assert gantry.steps == steps + 30
    np.testing.assert_array_equal(flange, [f for f, _ in alone])
    # A network rounds a batch otherwise, by which a pixel at its threshold may fall on the other side.
    np.testing.assert_allclose(area, [a for _, a in alone], atol=2 / 76800 if fidelity == "surrogate" else 0)
    assert (area > 0).any() and len(np.unique(area.sum(1))) > 1
    # Nothing of them is left: fewer and shorter ones go the same way.
    np.testing.assert_array_equal(gantry.rollouts(tried[2:4, :4])[0], flange[2:4, :4])
    np.testing.assert_array_equal(gantry.rollout(tried[4])[1], area[4])


def moved() -> Twin:
    twin = tilted()
    for name in ("thermal", "elongation", "valve_lag"):
        twin.effects[name] = get_effect(name).start(15.0)
    return twin


@pytest.mark.parametrize(
    ("twin", "station", "action"),
    [
        (None, Station(control_hz=30), [0.05, 0.0, -0.02, 8.0]),
        (None, Station(latency_s=0.2), [0.0, 0.0, 0.0, 3.0]),  # what was sent before still acts
        (None, Station((0.35, -0.1, 0.2), (0.45, 0.1, 0.4), 50.0), [0.1, 0.0, 0.1, 0.0]),  # to its corner
        (moved(), Station(), [0.0, 0.0, 0.0, 4.0]),
    ],
    ids=["another rate", "latency", "a box of its own", "effects"],
)
def test_a_rollout_in_free_air_goes_where_the_world_goes(twin, station, action):
    world = World("switch", twin, "none", station=station, conditions=twin and {"temperature_c": 31.0})
    world.variation = Variation(shift_m=(0.0, 0.0, -5.0))
    world.reset(3)
    for pressure in np.linspace(0.0, 12.0, 12):
        world.step([0.05, 0.0, 0.02, pressure])
    gantry, actions = Gantry(world), np.tile(action, (20, 1))
    gantry.mirror(world)
    planned, _ = gantry.rollout(actions)
    gel = gantry.gel_m - gantry.flange_m
    np.testing.assert_array_equal(gantry.rollout(actions)[0], planned)
    start_m = world.flange_m
    for each in actions:
        world.step(each)
    np.testing.assert_allclose(planned[-1], world.flange_m, atol=2e-4)
    np.testing.assert_allclose(gel, world.gel_m - world.flange_m, atol=1e-4)
    assert station.latency_s == 0 or world.flange_m[0] > start_m[0] + 0.008


def test_the_reduced_world_has_nothing_to_look_at_but_the_same_physics():
    world = World("egg", touch="area")
    gantry = Gantry(world)
    names = [gantry.model.geom(i).name for i in range(gantry.model.ngeom)]
    assert (gantry.model.geom_contype | gantry.model.geom_conaffinity).all()
    assert {"pad", "carton_lid", "carton_tab", "carton_base"} <= set(names)
    for body in ("lid", "sensor", "pad"):
        assert gantry.model.body(body).mass == world.model.body(body).mass
