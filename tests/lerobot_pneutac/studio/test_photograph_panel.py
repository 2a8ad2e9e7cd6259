"""The outline of the model on a photograph, against the splats of the same body from the same camera."""

import numpy as np

from lerobot_pneutac.studio.live import Skin
from lerobot_pneutac.studio.measurement_page import silhouette
from pneutac_sim.mpm.solid import bending_body
from pneutac_sim.splat.camera import Camera
from pneutac_sim.splat.follow import blank_looks
from pneutac_sim.splat.render import rasterise
from pneutac_sim.twin import Twin


def test_the_outline_is_where_the_splats_are():
    twin = Twin.builtin()
    middle = np.array([5e-4 * twin.length_mm, 0.0, 0.0])
    camera = Camera.look_at(middle + [0.0, -0.4, 0.05], middle, [-1.0, 0.0, 0.0], 20.0, 320, 240)
    skin = Skin.of(twin)
    drawn = silhouette(skin.vertices_mm, skin.faces, camera)
    splats = rasterise(blank_looks(bending_body(twin)), camera).alpha > 0.5
    assert (drawn & splats).sum() / (drawn | splats).sum() > 0.9
