from dataclasses import replace

import numpy as np
import pytest
import torch

from pneutac_sim.effects import registry
from pneutac_sim.effects.effect import Parameter
from pneutac_sim.effects.sensor_effect import SensorEffect
from pneutac_sim.errors import InputError
from pneutac_sim.gel import layout
from pneutac_sim.gel.batch import TactileBatch
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.photograph import press_depth
from pneutac_sim.gel.sensor import TactileSensor

needs_cuda = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
PRESSES = (
    Press("sphere", 3.0, 0.5, 0.5, 0.9),
    Press("sphere", 2.0, 0.05, 0.9, 1.4),  # over the gel's rim
    Press("cube", 2.0, 0.3, 0.6, 0.7),
)


def gels() -> dict[str, GelModel]:
    plain = GelModel.builtin()
    lent = layout.DIGIT.lent(plain.rest_image, layout.Orientation()).times(20)
    shadow = {f"shadow_{c}_levels": 60.0 for c in ("red", "green", "blue")}
    shadow |= {"elevation_red": 0.2, "elevation_green": 0.3, "elevation_blue": 0.1, "edge_mm": 0.1}
    shadow["shadow_blue_levels"] = 0.0
    near = {"near_light": {"distance_red_mm": 9.0, "distance_green_mm": 12.0, "distance_blue_mm": 8.5}}
    return {
        "generated": plain,
        "linear": replace(plain, effects={}, depth_scale=0.8),
        "shadows": replace(plain, effects=plain.effects | {"shadow": shadow}),
        "lights above the gel": replace(plain, effects=plain.effects | near | {"shadow": shadow}),
        "lent field": replace(plain, lent=lent, effects=plain.effects | {"shadow": shadow}),
        "two fields": replace(plain, lent=lent, residual=lent.times(-0.5)),
        "wide cells": replace(plain, px_per_mm=12.0),
    }


GELS = gels()


def check(name: str, device: str) -> None:
    gel = GELS[name]
    depth = np.stack([press_depth(p, gel) for p in PRESSES] + [np.zeros((80, 59), np.float32)])
    sensor, many = TactileSensor(gel), TactileBatch(gel, device)
    for again in range(2):  # the second from what was recorded
        images = many.image(depth).cpu().numpy()
        off = np.abs(images.astype(int) - np.stack([sensor.image(d) for d in depth]))
        assert images.dtype == np.uint8
        assert off.max() <= 1, again
        assert np.mean(off > 0) < 1e-3
    assert (images[:3] != gel.rest_image).any((1, 2, 3)).all()


@pytest.mark.parametrize("name", GELS)
def test_a_batch_is_what_the_sensor_draws_one_by_one(name):
    check(name, "cpu")


@needs_cuda
@pytest.mark.parametrize("name", GELS)
def test_a_batch_on_cuda_is_what_the_sensor_draws_one_by_one(name):
    check(name, "cuda")


def test_probe_grids_of_another_shape_are_refused():
    with pytest.raises(ValueError, match=r"probe grids have shape \(B, 80, 59\); got \(80, 59\)"):
        TactileBatch(device="cpu").image(np.zeros((80, 59)))


def test_no_probe_grids_make_no_images():
    assert TactileBatch(device="cpu").image(np.zeros((0, 80, 59))).shape == (0, 320, 240, 3)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")
def test_a_missing_device_is_told():
    with pytest.raises(InputError, match="PyTorch finds no CUDA device; give device='cpu'"):
        TactileBatch(device="cuda")


def test_effects_of_other_packages_are_refused_by_name(monkeypatch):
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
    gel = replace(GELS["generated"], effects={"stretch": {"stretch": 1.2}})
    with pytest.raises(InputError, match="on a batch of tactile images: stretch; use TactileSensor"):
        TactileBatch(gel, "cpu")
