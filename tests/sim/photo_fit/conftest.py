"""A small finger photographed by the twin's own renderer, so that the truth fits exactly."""

from types import SimpleNamespace

import numpy as np
import pytest


@pytest.fixture(scope="session")
def drawn():
    """Parameters, coordinates of the truth, bodies at 0, 7 and 14 kPa, looks and photographs."""
    from pneutac_sim.photo_fit.objective import Equilibria, MaskedPhotograph, Objective, body_parameters
    from pneutac_sim.splat.body import blank_looks
    from pneutac_sim.splat.camera import Camera
    from pneutac_sim.twin import Twin

    twin = Twin.builtin()
    parameters = body_parameters(twin, 14.0)
    truth = parameters.coordinates(twin)
    pressures = np.array([[0.0], [7.0], [14.0]])
    equilibria = Equilibria(parameters, truth, pressures, particles=800, device="cpu")
    looks = blank_looks(equilibria.body)
    looks.colours[:] = np.random.default_rng(0).uniform(0.2, 0.8, looks.colours.shape)
    camera = Camera.look_at((0.055, -0.4, 0.02), (0.055, 0, 0.02), (-1, 0, 0), 22.0, 240, 240)
    blank = Objective(equilibria, [], looks)
    photographs = []
    surfaces = blank.surface(equilibria.first.positions[0], equilibria.first.gradients[0])
    for state, positions in enumerate(equilibria.first.positions[0]):
        image = (255 * blank.render(positions, camera).image.clip(0, 1)).round().astype(np.uint8)
        mask = blank.outline.coverage(surfaces[state], camera) > 0.5
        photographs.append(MaskedPhotograph(state, camera, image, mask))
    return SimpleNamespace(
        parameters=parameters,
        truth=truth,
        pressures=pressures,
        equilibria=equilibria,
        looks=looks,
        photographs=photographs,
    )
