"""Errors of the two networks on motions and contacts of the full simulation that they have not seen."""

from collections.abc import Callable

import numpy as np

from pneutac_benchmarks.surrogate.options import BenchmarkSurrogateConfig
from pneutac_benchmarks.surrogate.rows import row
from pneutac_sim.errors import InputError
from pneutac_sim.surrogate.action import without_torque
from pneutac_sim.surrogate.collect import FRAME_S, Motion, Plan, collect_action, read_motions
from pneutac_sim.surrogate.finger import fingerprint, gel_fingerprint
from pneutac_sim.surrogate.gel_collect import Pairs, collect_gel, read_contacts
from pneutac_sim.surrogate.gel_train import evaluate_gel
from pneutac_sim.surrogate.network import ActionNetwork
from pneutac_sim.surrogate.perception import GelSurrogate
from pneutac_sim.twin import Twin

Progress = Callable[[str], None]


def finger_rows(
    cfg: BenchmarkSurrogateConfig, twin: Twin, network: ActionNetwork, progress: Progress
) -> list[dict]:
    """Joint angles and rates of the skeleton under the network, from the full finger's first state on."""
    plan = Plan(cfg.trajectories, cfg.seconds, cfg.particles, seed=cfg.seed)
    folder = cfg.out / f"motions_{fingerprint(twin)[:8]}_{plan.trajectories}x{plan.duration_s:g}s"
    progress(f"finger: {plan.trajectories} full motions of {plan.duration_s:g} s")
    collect_action(twin, folder, plan, cfg.device, lambda line: progress(f"finger: {line}"))
    _, motions = read_motions(folder, twin)
    found = np.array([motion_errors(network, m) for m in motions])
    bare = np.array([motion_errors(without_torque(network), m) for m in motions]).mean(0)
    inside = f"{100 * found[:, 2].mean():.0f}% of frames in the range of training"
    return [
        row("joint angle", "°", found[:, 0], float(bare[0]), "≤ 0.03", "0.051", inside),
        row("joint rate", "°/s", found[:, 1], float(bare[1]), "≤ 1.5", "2.76", "the same motions"),
    ]


def motion_errors(network: ActionNetwork, m: Motion) -> tuple[float, float, float]:
    """Mean absolute errors in degrees and degrees/s over joints and time, and share of frames in range."""
    q, q_vel, inside = network.roll(m.q[0], m.q_vel[0], m.target, m.pressure_kpa, (len(m.q) - 1) * FRAME_S)
    return (
        float(np.degrees(np.abs(q - m.q[1:]).mean())),
        float(np.degrees(np.abs(q_vel - m.q_vel[1:]).mean())),
        float(inside.mean()),
    )


def gel_rows(
    cfg: BenchmarkSurrogateConfig, twin: Twin, network: GelSurrogate, progress: Progress
) -> tuple[list[dict], tuple[Pairs, np.ndarray]]:
    """Displacement, tactile image and contact area at full depth; and a contact with what the network shows.

    Raises:
        InputError: no contact of an indenter that was held out from the training touches the window.
    """
    folder = cfg.out / f"contacts_{gel_fingerprint(twin)[:8]}"
    collected = collect_gel(
        twin,
        folder,
        cfg.contacts,
        cfg.seed,
        cfg.device,
        lambda n, of: progress(f"gel: full contact {n} of {of}"),
    )
    touching = [p for p in read_contacts(folder) if p.depth_mm[-1].any()]
    unseen = [p for p in touching if p.indenter in network.heldout]
    if not unseen:
        raise InputError(
            f"None of the {len(touching)} contacts is of an indenter that the network has not seen "
            f"({', '.join(network.heldout)}); give more with --contacts."
        )
    groups = [(f"unseen shapes ({', '.join(network.heldout)})", unseen)]
    seen = [p for p in touching if p.indenter not in network.heldout]
    if seen:
        groups.append(("shapes of the training, new sizes and places", seen))
    rows = []
    for name, contacts in groups:
        found = [evaluate_gel(network, [p], twin)["rows"][0] for p in contacts]
        depth = np.mean([f["depth_mm"] for f in found])
        note = f"{name}; mean depth {depth:.2f} mm, {collected.diverged} of {cfg.contacts} diverged"
        for measure, what, unit, goal, paper in (
            ("mae_mm", "gel displacement in contact", "mm", "≤ 0.04", "0.077"),
            ("around_mm", "gel displacement around it", "mm", None, None),
            ("image_rmse_levels", "tactile image, RMSE", "levels", None, None),
            ("area_error_px", "contact area, of 76,800", "px", None, None),
        ):
            probe = float(np.mean([f["probe"][measure] for f in found]))
            rows.append(row(what, unit, [f["network"][measure] for f in found], probe, goal, paper, note))
            note = name
    typical = sorted(unseen, key=lambda p: abs(float(p.depth_mm.max()) - 1.4))[0]
    return rows, (typical, network.displacement(typical.depth_mm[-1]))
