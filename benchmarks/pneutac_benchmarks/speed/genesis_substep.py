"""Prints the seconds of one substep of Genesis' MPM on the beam of `pneutac benchmark speed`.

Run in a process of its own, as it starts a compiler's runtime:
`python -m pneutac_benchmarks.speed.genesis_substep cpu`.
"""

import os
import sys
import time

SUBSTEPS, DT = 50, 2e-5
COUNTS, SPACING_M = (50, 9, 9), 2.2e-3
MARGIN_M = 0.03  # of the box round the beam, which Genesis passes over whole


def main(device: str) -> None:
    """Builds the scene and prints the least of three timings."""
    os.environ.setdefault("QD_NUM_THREADS", str(os.cpu_count()))  # Genesis uses one thread else
    import genesis as gs

    gs.init(backend=gs.cuda if device == "cuda" else gs.cpu, precision="32", logging_level="error")
    size = tuple(n * SPACING_M for n in COUNTS)
    scene = gs.Scene(
        sim_options=gs.options.SimOptions(dt=DT * SUBSTEPS, substeps=SUBSTEPS, gravity=(0, 0, -1.0)),
        mpm_options=gs.options.MPMOptions(
            lower_bound=(-MARGIN_M,) * 3,
            upper_bound=tuple(s + MARGIN_M for s in size),
            grid_density=0.5 / SPACING_M,
            particle_size=SPACING_M,
        ),
        show_viewer=False,
    )
    material = gs.materials.MPM.Elastic(E=3e5, nu=0.45, rho=1100.0, model="neohooken")
    scene.add_entity(material=material, morph=gs.morphs.Box(lower=(0, 0, 0), upper=size))
    scene.build()
    scene.step()
    seconds = []
    for _ in range(3):
        began = time.perf_counter()
        scene.step()
        seconds.append(time.perf_counter() - began)
    print(f"SUBSTEP {min(seconds) / SUBSTEPS}")


if __name__ == "__main__":
    main(sys.argv[1])
