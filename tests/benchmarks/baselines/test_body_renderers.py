"""What the three baselines make of one photograph of a finger: the front, a held-out pressure, the back."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from pneutac_benchmarks.baselines.deformable_nerf import DeformableNerf
from pneutac_benchmarks.baselines.particle_splat import ParticleSplat
from pneutac_benchmarks.baselines.textured_mesh import TexturedMesh
from pneutac_sim.errors import InputError
from pneutac_sim.splat.camera import Camera

pytestmark = [pytest.mark.slow, pytest.mark.nightly]

FITS = {
    "mesh": TexturedMesh.fit,
    "disks": ParticleSplat.fit,
    "nerf": lambda *a: DeformableNerf.fit(*a, iterations=80),
}


@pytest.fixture(scope="module")
def small(photographed):
    """The same photographs with a quarter of the pixels."""
    p = photographed

    def half(image, mask):
        return tuple(
            cv2.resize(a, (320, 240), interpolation=cv2.INTER_AREA) for a in (image, mask.astype(np.float32))
        )

    def seen(camera):
        return Camera(camera.intrinsics * [[0.5], [0.5], [1]], camera.extrinsics, 320, 240)

    pictures = {v: [(i, m > 0.5) for i, m in (half(*q) for q in p.pictures[v])] for v in p.pictures}
    return SimpleNamespace(
        **vars(p) | {"pictures": pictures, "cameras": {v: seen(c) for v, c in p.cameras.items()}}
    )


@pytest.fixture(scope="module", params=FITS)
def renderer(request, small):
    p = small
    image, mask = p.pictures["front"][0]
    return FITS[request.param](p.body, p.positions[0], p.gradients[0], image, mask, p.cameras["front"])


def picture(p, renderer, view, state):
    return renderer.image(p.positions[state], p.gradients[state], p.cameras[view])


def test_front_is_better_than_one_flat_colour(small, renderer):
    p = small
    image, mask = p.pictures["front"][0]
    drawn = picture(p, renderer, "front", 0)
    flat = drawn._replace(image=mask[..., None] * image[mask].mean(0) / 255)
    assert p.rmse(drawn, image, mask) < 0.85 * p.rmse(flat, image, mask)


def test_bad_input_is_named(small, renderer):
    p = small
    image, mask = p.pictures["front"][0]
    state = p.body, p.positions[0], p.gradients[0]
    with pytest.raises(InputError, match="mask covers 0.0%"):
        type(renderer).fit(*state, image, np.zeros_like(mask), p.cameras["front"])
