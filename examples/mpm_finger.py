"""The full finger: about 1,500 material points round the driven spine, in equilibrium at three pressures."""

import numpy as np

from pneutac_sim.mpm.devices import finger, joint_targets, spine_points
from pneutac_sim.mpm.solve import solve_equilibrium
from pneutac_sim.mpm.total_lagrangian import Loads
from pneutac_sim.twin import Twin

twin = Twin.builtin()
pressures_kpa = [0.0, 6.0, 12.0]
solver = finger(twin, batch=len(pressures_kpa), particles=1500, device="cpu")
state = solve_equilibrium(solver, Loads(q_cmd=joint_targets(twin, pressures_kpa)))

tips_mm = 1e3 * spine_points(solver, state.q)[:, -1]  # finger base frame
stretch = np.linalg.norm(state.gradients, axis=(2, 3)).max(axis=1) / np.sqrt(3)
for pressure, tip, most in zip(pressures_kpa, tips_mm, stretch, strict=True):
    print(f"{pressure:4.0f} kPa: tip at x {tip[0]:6.1f} mm, z {tip[2]:6.1f} mm; stretched {most:.2f} times")
