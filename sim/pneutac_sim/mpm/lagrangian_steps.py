"""Kernels that Python launches for the total-Lagrangian solver.

One substep is cells, nodes, spine. `within` does all substeps of a body with one thread (CPU) or one block
(GPU), for many or small bodies; `across` does one substep of all cells side by side, for a large body.
"""

from pneutac_sim.mpm import lagrangian_kernels as kern
from pneutac_sim.mpm import spine_kernels as spk
from pneutac_sim.mpm.lagrangian_kernels import arrays, floats, ints
from pneutac_sim.mpm.runtime import ti

GPU_LANES = 256
ROOM = 64  # pieces into which the CPU cuts a large body


@ti.func
def cell(
    b, c, t, room, cells, nodes, points, dx, load: arrays, u: arrays, tensor: arrays, force: arrays,
    cell_nodes: arrays, cell_mask: arrays, start: arrays, weights: arrays, contact: arrays,
    touching: ti.template(), soa: ti.template(),
):  # fmt: skip
    """All of one cell by one thread."""
    for d in range(3):
        kern.strain(b, c, t, d, room, cells, nodes, dx, u, tensor, cell_nodes, soa)
    for p in range(8):
        kern.stress(b, c, t, p, room, dx, load, tensor, cell_mask, soa)
    for d in range(3):
        kern.spread(b, c, t, d, room, cells, points, tensor, force, start, weights, contact, touching, soa)


@ti.kernel
def within(
    taken: int, substeps: int, blocks: int, gate: ints, bodies: int, cells: int, nodes: int, points: int,
    hinges: int, carried: int, dx: float, samples: int, soa: ti.template(), touching: ti.template(),
    load: floats, u: floats, v: floats, total: floats, before: floats, force: floats, tensor: floats,
    spot_cell: ints, cell_nodes: ints, cell_mask: ints, slots: ints, ghost: ints, role: ints,
    volume: floats, inertia: floats, rest: floats, start: ints, spot: floats, weights: floats,
    shape: ints, table: floats, anchor: floats, contact: floats, q: floats, qd: floats, drive: floats,
    chain: floats, lump: floats, pose: floats, wrench: floats, momentum: floats, work: floats,
    soft: floats, bound: ints, bound_link: ints, bound_start: ints,
):  # fmt: skip
    """All substeps of each body by one thread (CPU) or some blocks (GPU), whose `gate` (B,) must be zero."""
    spread = kern.SPREAD_CPU
    stride = 1
    if ti.static(soa):
        spread = GPU_LANES * blocks
        stride = spread
        ti.loop_config(block_dim=GPU_LANES)
    for t in range(bodies * spread):
        b, lane = t // spread, t % spread
        turn, first = 0, lane % GPU_LANES == 0
        if ti.static(soa) or lane == 0:
            for step in range(substeps):
                if ti.static(touching):
                    i = lane
                    while i < points:
                        kern.touch(
                            b, i, cells, nodes, points, dx, load, u, spot, cell_nodes, spot_cell, weights,
                            shape, table, samples, anchor, contact, taken + step, soa,
                        )  # fmt: skip
                        i += stride
                # On a GPU all gradients, all stresses, all forces; on the CPU one cell after another, which
                # stays in its cache.
                if ti.static(soa):
                    i = lane
                    while i < 3 * cells:
                        kern.strain(
                            b,
                            i % cells,
                            i % cells,
                            i // cells,
                            cells,
                            cells,
                            nodes,
                            dx,
                            u,
                            tensor,
                            cell_nodes,
                            soa,
                        )
                        i += stride
                    turn += 1
                    spk.meet(b, first, blocks, turn, gate, soa)
                    i = lane
                    while i < 8 * cells:
                        kern.stress(
                            b, i % cells, i % cells, i // cells, cells, dx, load, tensor, cell_mask, soa
                        )
                        i += stride
                    turn += 1
                    spk.meet(b, first, blocks, turn, gate, soa)
                    i = lane
                    while i < 3 * cells:
                        kern.spread(
                            b, i % cells, i % cells, i // cells, cells, cells, points, tensor, force,
                            start, weights, contact, touching, soa,
                        )  # fmt: skip
                        i += stride
                    turn += 1
                    spk.meet(b, first, blocks, turn, gate, soa)
                else:
                    for c in range(cells):
                        cell(
                            b, c, 0, ROOM, cells, nodes, points, dx, load, u, tensor, force, cell_nodes,
                            cell_mask, start, weights, contact, touching, soa,
                        )  # fmt: skip
                n = lane
                while n < nodes:
                    kern.move(
                        b, n, cells, nodes, load, u, v, total, before, force, slots, ghost, role, volume,
                        inertia, soa,
                    )  # fmt: skip
                    n += stride
                turn += 1
                spk.meet(b, first, blocks, turn, gate, soa)
                if hinges > 0:
                    if lane < GPU_LANES:
                        spk.step(
                            b, lane, ti.min(stride, GPU_LANES), nodes, hinges, carried, load, u, rest,
                            total, q, qd, drive, chain, lump, pose, wrench, momentum, work, soft, bound,
                            bound_link, bound_start, soa,
                        )  # fmt: skip
                    turn += 1
                    spk.meet(b, first, blocks, turn, gate, soa)


@ti.kernel
def across(
    taken: int, bodies: int, cells: int, nodes: int, points: int, hinges: int, carried: int, dx: float,
    samples: int, soa: ti.template(), touching: ti.template(), load: floats, u: floats, v: floats,
    total: floats, before: floats, force: floats, tensor: floats, spot_cell: ints, cell_nodes: ints,
    cell_mask: ints, slots: ints, ghost: ints, role: ints, volume: floats, inertia: floats, rest: floats,
    start: ints, spot: floats, weights: floats, shape: ints, table: floats, anchor: floats,
    contact: floats, q: floats, qd: floats, drive: floats, chain: floats, lump: floats, pose: floats,
    wrench: floats, momentum: floats, work: floats, soft: floats, bound: ints, bound_link: ints,
    bound_start: ints,
):  # fmt: skip
    """One substep, cells and then nodes side by side; `taken` counts those since the loads were set."""
    spread = kern.SPREAD_CPU
    stride = 1
    if ti.static(soa):
        spread = GPU_LANES
        stride = GPU_LANES
    if ti.static(touching):
        for t in range(bodies * points):
            kern.touch(
                t // points, t % points, cells, nodes, points, dx, load, u, spot, cell_nodes, spot_cell,
                weights, shape, table, samples, anchor, contact, taken, soa,
            )  # fmt: skip
    if ti.static(soa):
        for t in range(bodies * 3 * cells):
            b, i = t // (3 * cells), t % (3 * cells)
            kern.strain(
                b, i % cells, i % cells, i // cells, cells, cells, nodes, dx, u, tensor, cell_nodes, soa
            )
        for t in range(bodies * 8 * cells):
            b, i = t // (8 * cells), t % (8 * cells)
            kern.stress(b, i % cells, i % cells, i // cells, cells, dx, load, tensor, cell_mask, soa)
        for t in range(bodies * 3 * cells):
            b, i = t // (3 * cells), t % (3 * cells)
            kern.spread(
                b, i % cells, i % cells, i // cells, cells, cells, points, tensor, force, start, weights,
                contact, touching, soa,
            )  # fmt: skip
    else:
        for task in range(ROOM * kern.SPREAD_CPU):
            if task % kern.SPREAD_CPU == 0:
                t = task // kern.SPREAD_CPU
                for i in range(t * bodies * cells // ROOM, (t + 1) * bodies * cells // ROOM):
                    cell(
                        i // cells, i % cells, t, ROOM, cells, nodes, points, dx, load, u, tensor,
                        force, cell_nodes, cell_mask, start, weights, contact, touching, soa,
                    )  # fmt: skip
    for t in range(bodies * nodes):
        b, n = t // nodes, t % nodes
        kern.move(
            b, n, cells, nodes, load, u, v, total, before, force, slots, ghost, role, volume, inertia, soa
        )
    if hinges > 0:
        for t in range(bodies * spread):
            b, lane = t // spread, t % spread
            if ti.static(soa) or lane == 0:
                spk.step(
                    b, lane, stride, nodes, hinges, carried, load, u, rest, total, q, qd, drive, chain,
                    lump, pose, wrench, momentum, work, soft, bound, bound_link, bound_start, soa,
                )  # fmt: skip


@ti.kernel
def place(
    bodies: int, cells: int, nodes: int, points: int, hinges: int, carried: int, soa: ti.template(),
    q: floats, chain: floats, pose: floats, bound: ints, bound_link: ints, rest: floats, u: floats,
):  # fmt: skip
    """Links, and the nodes that they carry, where the joint angles put them."""
    for b in range(bodies):
        spk.bend(b, hinges, q, chain, pose)
        for k in range(carried):
            spk.carry(b, k, nodes, hinges, u, bound, bound_link, rest, pose, soa)


@ti.kernel
def measure(
    bodies: int, cells: int, nodes: int, points: int, hinges: int, carried: int, soa: ti.template(),
    load: floats, v: floats, total: floats, before: floats, contact: floats, role: ints, volume: floats,
    inertia: floats, sums: floats,
):  # fmt: skip
    """Per body: squared forces on free nodes, kinetic sum, softness sum, squared forces from outside."""
    for i in range(bodies * 4):
        sums[i] = 0.0
    for t in range(bodies * nodes):
        b, n = t // nodes, t % nodes
        rho = load[b * kern.LOAD + kern.RHO]
        f2, w, k, g2 = 0.0, 0.0, 0.0, 0.0
        for d in ti.static(range(3)):
            i = kern.place(b, n, d, nodes, soa)
            f2 += total[i] * total[i]
            w += v[i] * v[i] * rho * inertia[n]
            k -= v[i] * (total[i] - before[i])
            g2 += (rho * volume[n] * load[b * kern.LOAD + kern.GRAVITY + d]) ** 2
        if role[n] == -1:
            sums[b * 4] += f2
            sums[b * 4 + 1] += w
            sums[b * 4 + 2] += k
            sums[b * 4 + 3] += g2
        elif role[n] >= 0:
            sums[b * 4 + 3] += f2
    for t in range(bodies * points):
        for d in ti.static(range(3)):
            sums[t // points * 4 + 3] += contact[t * 4 + d] ** 2


@ti.kernel
def overlap(
    bodies: int, cells: int, nodes: int, points: int, hinges: int, carried: int, dx: float, samples: int,
    soa: ti.template(), load: floats, u: floats, v: floats, total: floats, before: floats, force: floats,
    tensor: floats, spot_cell: ints, cell_nodes: ints, cell_mask: ints, slots: ints, ghost: ints,
    role: ints, volume: floats, inertia: floats, rest: floats, start: ints, spot: floats, weights: floats,
    shape: ints, table: floats, anchor: floats, contact: floats, q: floats, qd: floats, drive: floats,
    chain: floats, lump: floats, pose: floats, wrench: floats, momentum: floats, work: floats,
    soft: floats, bound: ints, bound_link: ints, bound_start: ints,
):  # fmt: skip
    """Depth of every surface point, without any force."""
    for t in range(bodies * cells):
        b, c = t // cells, t % cells
        for s in range(start[c], start[c + 1]):
            contact[(b * points + s) * 4 + 3] = -kern.depth(
                b, c, s, cells, nodes, load, u, spot, cell_nodes, weights, shape, table, samples, soa
            )


@ti.kernel
def particles(
    bodies: int, cells: int, nodes: int, points: int, hinges: int, carried: int, count: int, dx: float,
    soa: ti.template(), u: floats, cell_nodes: ints, particle_cell: ints, local: ints, place: floats,
):  # fmt: skip
    """Position and deformation gradient of each particle, twelve numbers."""
    for t in range(bodies * count):
        b, p = t // count, t % count
        c = particle_cell[p]
        at = ti.Vector([0.0, 0.0, 0.0])
        G = ti.Matrix.identity(ti.f32, 3)
        side = ti.Vector([(local[p] >> 2) & 1, (local[p] >> 1) & 1, local[p] & 1])
        w, s = ti.Matrix.zero(ti.f32, 3, 3), ti.Matrix.zero(ti.f32, 3, 3)
        for d, i in ti.static(ti.ndrange(3, 3)):
            w[d, i] = kern.W[1][i] if side[d] == 1 else kern.W[0][i]
            s[d, i] = kern.D[1][i] if side[d] == 1 else kern.D[0][i]
        for i, j, k in ti.static(ti.ndrange(3, 3, 3)):
            move = kern.vector(u, b, kern.pick(cell_nodes, c, 9 * i + 3 * j + k, cells, soa), nodes, soa)
            at += w[0, i] * w[1, j] * w[2, k] * move
            slope = ti.Vector(
                [s[0, i] * w[1, j] * w[2, k], w[0, i] * s[1, j] * w[2, k], w[0, i] * w[1, j] * s[2, k]]
            )
            G += move.outer_product(slope) / dx
        for d in ti.static(range(3)):
            place[t * 12 + d] = at[d]
            for e in ti.static(range(3)):
                place[t * 12 + 3 + 3 * d + e] = G[d, e]
