"""The paper's last step: light refined through the splat renderer."""

from dataclasses import replace

import numpy as np
import pytest

from pneutac_sim.gel.fit import fit_presses
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.pair import PressPhotograph
from pneutac_sim.gel.sensor import TactileSensor
from pneutac_sim.splat import gel as splat_gel
from pneutac_sim.splat.gel import SplatSensor, Viewed, refine_fit, refine_light

PRESS = Press("sphere", 4.0, 2.0, 3.0, 1.0)


@pytest.fixture(scope="module")
def sensor():
    """Splats of a gel of the paper's linear model, coarse enough that they blur what contact adds."""
    return SplatSensor(replace(GelModel.builtin().resized(160, 120), effects={}))


def pressed(press, share):
    gel = GelModel.builtin()
    part = replace(press, depth_mm=share * press.depth_mm)
    return TactileSensor(gel).displacement(part.depths(gel.window_mm, gel.thickness_mm))


def photographed(sensor, press=PRESS):
    rest = sensor.model.rest_image
    return PressPhotograph(press, sensor.image(pressed(press, 1.0)), rest)


def fitted(sensor, photographs):
    gel = sensor.model
    fit = fit_presses(photographs, gel.px_per_mm, (), gel.thickness_mm, (), pressed)
    fit.gel.depth_scale = 1.0  # the hidden one, so that light alone is judged
    return fit


def off(gel, hidden):
    return float(np.linalg.norm(gel.light - hidden.light) / np.linalg.norm(hidden.light))


def test_hidden_light_is_found_through_the_renderer_that_drew_it(sensor):
    photograph = photographed(sensor)
    fit = fitted(sensor, [photograph])
    viewed = [Viewed(sensor, pressed(PRESS, 1.0), photograph)]
    refined = refine_light(fit.gel, fit.channels, viewed)
    assert off(refined, sensor.model) < 0.6 * off(fit.gel, sensor.model)
    before = fit.gel
    refine_fit(fit, [photograph], pressed)
    assert fit.refined and np.array_equal(fit.gel.light, refined.light)
    assert fit.gel.effects == before.effects and fit.gel.decay_mm == before.decay_mm


def test_what_held_back_parts_do_not_bear_out_is_not_taken(sensor, monkeypatch):
    photograph = photographed(sensor)
    fit = fitted(sensor, [photograph])
    before = fit.gel

    def wrong(gel, *rest):
        return replace(gel, light=0.8 * gel.light)

    monkeypatch.setattr(splat_gel, "refine_light", wrong)
    refine_fit(fit, [photograph], pressed)
    assert fit.refined is False and fit.gel is before


def test_refined_light_is_least_squares_of_the_rendered_picture(sensor):
    photograph = photographed(sensor)
    fit = fitted(sensor, [photograph])
    for c in fit.channels:
        c.prior = {name: (start, np.inf, low, high) for name, (start, _, low, high) in c.prior.items()}
    view = Viewed(sensor, pressed(PRESS, 1.0), photograph)
    best = refine_light(fit.gel, fit.channels, [view])

    def loss(gel):
        return float(np.square(view.off(gel)[view.near]).sum())

    for name in ("light", "depth_light"):
        for index in np.ndindex(getattr(best, name).shape):
            for step in (-0.5, 0.5):
                moved = getattr(best, name).copy()
                moved[index] += step
                assert loss(replace(best, **{name: moved})) > loss(best)
