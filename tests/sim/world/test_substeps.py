"""Substeps in one call are those of a loop."""

import mujoco
import numpy as np

from pneutac_sim.world.world import Substeps, World


def test_one_call_is_the_loop_bit_for_bit():
    world = World("egg", touch="none")
    model, one = world.model, world.data
    for _ in range(3):  # moving, so that a warm start matters
        world.step(np.array([0.1, 0.0, -0.1, 20.0]))
    many = mujoco.MjData(model)
    mujoco.mj_copyData(many, model, one)
    for data in (one, many):  # pushed from outside, as tests and users of the world do
        data.qfrc_applied[7], data.xfrc_applied[-1, :3] = 0.01, (0.0, 0.02, 0.0)
    ctrl = one.ctrl + np.linspace(0, 0.01, 50)[:, None]
    Substeps(model, one).run(ctrl)
    for row in ctrl:
        many.ctrl[:] = row
        mujoco.mj_step(model, many)
    for name in ("time", "qpos", "qvel", "qacc_warmstart", "ctrl", "xpos", "qfrc_applied", "xfrc_applied"):
        np.testing.assert_array_equal(getattr(one, name), getattr(many, name))
