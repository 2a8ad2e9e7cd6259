"""One cause has one name: in headline, next experiment, tables and history."""

from types import SimpleNamespace

import pytest

from lerobot_pneutac.diagnosis.verdict import called, hardly_bends
from lerobot_pneutac.study.base import EffectStudy
from lerobot_pneutac.verbs.history import report
from pneutac_sim.effects import get_effect
from pneutac_sim.effects.laws import law_names
from pneutac_sim.effects.registry import all_effects
from pneutac_sim.twin import Twin

NAMES = [*all_effects(), *law_names()]


def twin_with(name, **constants):
    twin = Twin.builtin()
    twin.effects = {name: get_effect(name).start(12.0)}
    for constant, value in constants.items():
        twin.effects[name][constant].value = value
    return twin


def test_every_name_is_one_of_its_own():
    assert len(set(map(called, NAMES))) == len(NAMES)
    assert called("lag(p)") == "creep (lag(p))" and called("creep") == "creep"
    assert called("lag(p)", twin_with("lag(p)", time_s=0.05)) == "a slow valve (lag(p))"
    assert called("compliance") == "compliance"  # of a study of demonstrations, no effect


@pytest.mark.parametrize("name", ["creep", "lag(p)", "power_law_memory(p)", "tip_x += z^2", "gravity"])
def test_headline_and_history_call_it_the_same(name):
    twin = twin_with(name)
    values = {k: {"value": v.value} for k, v in twin.effects[name].items()}
    study = SimpleNamespace(parameters=lambda m, e: values, recording=SimpleNamespace(device="finger"))
    cause = EffectStudy.cause(study, SimpleNamespace(twin=twin), name)
    assert cause == called(name, twin) or cause.startswith(f"{called(name, twin)}, ")
    assert f"with {called(name, twin)}" in report(twin).sentence


def test_a_dead_zone_is_told_where_the_device_hardly_bends():
    hinge = {"weight": 9.0, "scale_kpa": 20.0, "threshold_kpa": 8.0}
    assert hardly_bends(twin_with("hinge(p)", **hinge), "hinge(p)") == "it hardly bends below 8 kPa"
    wall = hinge | {"weight": -0.9}
    assert hardly_bends(twin_with("hinge(p)", **wall), "hinge(p)") == "it hardly bends above 8 kPa"
    # p - 5 tanh((p - 6) / 5) rises by nothing at 6 kPa, and by a quarter of its mean from 4.6 to 7.4 kPa
    step = {"weight": -0.25, "scale_kpa": 20.0, "centre_kpa": 6.0, "slope_kpa": 5.0}
    twin = twin_with("step(p)", **step)
    assert hardly_bends(twin, "step(p)").startswith("it hardly bends between ")
    study = SimpleNamespace(
        parameters=lambda m, e: {k: {"value": v.value} for k, v in twin.effects[e].items()},
        recording=SimpleNamespace(device="finger"),
    )
    cause = EffectStudy.cause(study, SimpleNamespace(twin=twin), "step(p)")
    assert cause == f"{called('step(p)', twin)}: {hardly_bends(twin, 'step(p)')}"
    assert not hardly_bends(twin_with("step(p)", **step | {"weight": 0.25}), "step(p)")
    assert not hardly_bends(twin_with("lag(p)"), "lag(p)")
