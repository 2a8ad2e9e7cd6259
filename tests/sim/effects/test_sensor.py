"""Optics effects beside those of a body: known by name, kept in a twin, and no business of the finger's."""

from dataclasses import replace

import numpy as np
import pytest

from pneutac_sim.effects import Parameter, SensorEffect, body_effects, get_effect, registry, sensor_effects
from pneutac_sim.effects.registry import of_body
from pneutac_sim.errors import InputError
from pneutac_sim.finger import Pipeline
from pneutac_sim.gel.batch import TactileBatch
from pneutac_sim.gel.fit import standard_effects
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.sensor import TactileSensor
from pneutac_sim.twin import Twin, Value

OPTICS = sensor_effects()
SENSOR = tuple(standard_effects())
DEPTH = np.pad(np.full((20, 15), 0.6, np.float32), ((30, 30), (22, 22)))


def lit(effects=SENSOR):
    """A gel with these effects, each parameter a little above its least."""
    gel = GelModel.builtin()
    gel.effects = {
        e: {p.name: p.lower + 0.02 * (p.upper - p.lower) for p in OPTICS[e].parameters} for e in effects
    }
    return gel


def crept():
    twin = Twin.builtin()
    twin.effects["creep"] = {
        k: Value(v.value, (0.0, 1.0)) for k, v in get_effect("creep").start(15.0).items()
    }
    return twin


def test_optics_are_found_by_name_and_are_no_effects_of_a_body():
    for name, effect in OPTICS.items():
        assert get_effect(name) is effect
    assert not set(OPTICS) & set(body_effects()) and set(SENSOR) < set(OPTICS)
    assert of_body(["creep", *OPTICS, "leak"]) == ["creep", "leak"]
    with pytest.raises(InputError, match="near_light"):
        get_effect("near_lights")


@pytest.mark.parametrize("name", SENSOR)
def test_every_effect_of_a_sensor_leaves_a_gel_at_rest_alone(name):
    sensor = TactileSensor(lit((name,)))
    np.testing.assert_array_equal(sensor.image(np.zeros_like(DEPTH)), sensor.rest_image)


def test_a_gels_effects_go_into_a_twins_file_and_come_back(tmp_path):
    gel, twin = lit(OPTICS), Twin(device="gel", length_mm=16.0)
    gel.into_twin(twin)
    assert set(twin.effects) == set(OPTICS) and "effects" not in twin.gel
    twin.save(tmp_path)
    read = GelModel.from_twin(Twin.load(tmp_path))
    assert read.effects == gel.effects
    np.testing.assert_array_equal(TactileSensor(read).image(DEPTH), TactileSensor(gel).image(DEPTH))


def test_a_finger_keeps_its_bodys_effects_when_it_gets_another_gel():
    twin = crept()
    lit().into_twin(twin)
    assert list(twin.effects) == ["creep", *SENSOR]
    lit(("rest_colour",)).into_twin(twin)
    assert list(twin.effects) == ["creep", "rest_colour"]
    assert twin.effects["creep"] == crept().effects["creep"], "with its confidence intervals"
    assert GelModel.from_twin(twin).effects == lit(("rest_colour",)).effects


def test_the_fingers_pipeline_knows_nothing_of_light():
    twin, carrying = crept(), crept()
    lit(OPTICS).into_twin(carrying)
    plain, pipeline = Pipeline.of(twin), Pipeline.of(carrying)
    assert pipeline.names == plain.names and [e.name for e in pipeline.effects] == ["creep"]
    theta = pipeline.theta(carrying)
    np.testing.assert_array_equal(theta, plain.theta(twin))
    updated = pipeline.update(carrying, 1.01 * theta)
    assert set(updated.effects) == {"creep", *OPTICS}
    assert GelModel.from_twin(updated).effects == lit(OPTICS).effects


@pytest.mark.parametrize(
    "effect, values, says",
    [
        ("rest_colour", {"exponent_pink": Value(1.0)}, "rest_colour.*exponent_red"),
        ("rest_colour", {"exponent_red": Value(1.0)}, "rest_colour"),
        ("near_light", {f"distance_{c}_mm": Value(np.nan) for c in ("red", "green", "blue")}, "near_light"),
    ],
)
def test_broken_parameters_of_an_effect_are_named(effect, values, says):
    twin = Twin(device="gel", length_mm=16.0)
    lit().into_twin(twin)
    twin.effects[effect] = values
    with pytest.raises(InputError, match=says) as e:
        GelModel.from_twin(twin)
    assert "\n" not in str(e.value)


def malformed(**fields):
    p = Parameter("stretch", "", 1.1, 0.5, 1.5, neutral=1.0)
    SensorEffect(
        **{"name": "a", "parameters": (p,), "summary": "", "experiment": "", "prior_sd": (0.1,)} | fields
    )


@pytest.mark.parametrize(
    "fields, says",
    [
        ({"stage": "material"}, "stage 'material' must be one of gel, light"),
        ({"stage": "light", "prior_sd": ()}, "1 positive numbers"),
        ({"stage": "light", "surface": lambda u, cell_mm, v: u}, "no hook 'surface'"),
        ({"stage": "light", "gain": lambda clock, v: np.ones(3)}, "gain and estimate"),
    ],
)
def test_a_malformed_effect_of_a_sensor_is_refused(fields, says):
    with pytest.raises(InputError, match=says):
        malformed(**fields)


@pytest.fixture
def stretched(monkeypatch):
    """A gel with an effect of another package."""
    stretch = SensorEffect(
        name="stretch",
        stage="gel",
        parameters=(Parameter("stretch", "", 1.0, 0.5, 1.5, neutral=1.0),),
        prior_sd=(0.1,),
        surface=lambda u, cell_mm, v: v["stretch"] * u,
        summary="",
        experiment="",
    )
    known = registry.all_effects() | {"stretch": stretch}
    monkeypatch.setattr(registry, "all_effects", lambda: known)
    return replace(lit(()), effects={"stretch": {"stretch": 1.2}})


def test_an_effect_of_the_gel_changes_the_surface_that_light_falls_on(stretched):
    plain, sensor = TactileSensor(lit(())), TactileSensor(stretched)
    np.testing.assert_allclose(sensor.displacement(DEPTH), 1.2 * plain.displacement(DEPTH), rtol=1e-6)
    assert np.abs(sensor.image(DEPTH).astype(int) - plain.image(DEPTH)).max() > 5


def test_effects_of_other_packages_are_refused_by_name_for_batches(stretched):
    with pytest.raises(InputError, match="on a batch of tactile images: stretch; use TactileSensor"):
        TactileBatch(stretched, "cpu")
