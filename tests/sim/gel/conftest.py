"""Photographs of generated gels, and a gel with every optics effect of a sensor."""

import numpy as np
import pytest

from pneutac_sim.effects import get_effect
from pneutac_sim.effects.sensor_effect import CHANNELS
from pneutac_sim.gel.force import GelForce
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.pair import PressPhotograph
from pneutac_sim.gel.photograph import gains, press_depth, registered
from pneutac_sim.gel.sensor import TactileSensor
from pneutac_sim.twin import Twin


@pytest.fixture(scope="session")
def law():
    return GelForce.of(Twin.builtin())


@pytest.fixture(scope="session")
def imprint(law):
    """How deep an indenter lies in the window of the law's gel, (80, 59) mm."""
    return lambda press: press.depths(law.window_mm, law.thickness_mm)


PLACES = [(0.6, -1.0, 0.9), (-3.0, 4.0, 0.8), (3.0, 4.5, 0.7), (-3.0, -5.0, 1.0), (3.0, -4.5, 0.8)]


@pytest.fixture(scope="session")
def photograph():
    """Image of a press, whose place and light are as the gel's session effects say."""

    def take(gel, press, noise=0.0, seed=0, gain=1.0, clock=0.0):
        image = TactileSensor(gel).image(press_depth(registered(press, gel), gel)) * gains(gel, clock) * gain
        image += noise * np.random.default_rng(seed).standard_normal(image.shape)
        return np.clip(image, 0, 255).round().astype(np.uint8)

    return take


@pytest.fixture(scope="session")
def session(photograph):
    """n photographs of a ball at several places, noise of 2 levels, evenly spaced in time."""

    def take(gel, n):
        presses = [Press("sphere", 3.0, *p) for p in PLACES[:n]]
        clocks = np.linspace(0, 1, n)
        return [
            PressPhotograph(p, photograph(gel, p, 2, i, 1.0, c), gel.rest_image, c)
            for i, (p, c) in enumerate(zip(presses, clocks, strict=True))
        ]

    return take


def each(name, values):
    return dict(zip((name.format(c) for c in CHANNELS), values, strict=True))


def neutral(effect):
    return {p.name: p.neutral for p in get_effect(effect).parameters}


@pytest.fixture
def linear():
    """The generated DIGIT under the paper's linear model."""
    gel = GelModel.builtin()
    gel.effects, gel.decay_mm = {}, 1.1
    return gel


@pytest.fixture
def bent(linear):
    """The same with every optics effect of a sensor, its lights not where a DIGIT's are."""
    linear.depth_scale = 0.85
    linear.effects = {
        "near_light": each("distance_{}_mm", (14.0, 20.0, 60.0)),
        "photometric_nonlinearity": neutral("photometric_nonlinearity")
        | each("direct_{}_levels", (50.0, 70.0, 90.0)),
        "shadow": each("shadow_{}_levels", (30.0, 40.0, 25.0))
        | each("elevation_{}", (0.2, 0.25, 0.3))
        | {"edge_mm": 0.15},
        "rest_colour": each("exponent_{}", (0.9, 1.2, 0.5)),
    }
    return linear
