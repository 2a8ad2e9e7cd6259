"""Validation of the material point solver at full size: python benchmarks/mpm_validation.py.

Writes benchmarks/mpm.md and its pictures; a few minutes on two cores. Tests check the same physics smaller.
"""

from pathlib import Path

import cv2
import numpy as np
from rich.progress import Progress

from pneutac_sim.mpm.body import Body, Material, Spine
from pneutac_sim.mpm.solve import simulate, solve_equilibrium
from pneutac_sim.mpm.total_lagrangian import Loads, TotalLagrangian

HERE = Path(__file__).parent
INK, GRID, FONT = (60, 50, 45), (232, 228, 224), cv2.FONT_HERSHEY_DUPLEX
COLOURS = [(180, 110, 40), (60, 120, 230), (90, 160, 60)]  # BGR


def marks(low, high, log) -> np.ndarray:
    """(8,) round places of grid lines between two ends, the last one repeated."""
    if log:
        places = np.linspace(low, high, 5)
    else:
        step = 10.0 ** np.floor(np.log10((high - low) / 3))
        step *= next(f for f in (1, 2, 5, 10) if (high - low) / (f * step) <= 8)
        places = np.arange(np.ceil(low / step), high / step) * step
    return np.concatenate([places, np.full(8, places[-1])])[:8]


def chart(path, title, across, up, curves, log=False) -> None:
    """Draws curves (name, x, y, style `line` or `dots`) into a PNG."""
    w, h, left, top, right, low = 900, 560, 100, 90, 870, 480
    image = np.full((h, w, 3), 255, np.uint8)
    move = np.log10 if log else np.asarray
    xs = move(np.concatenate([c[1] for c in curves]).astype(float))
    ys = move(np.concatenate([c[2] for c in curves]).astype(float))
    x0, x1, y0, y1 = xs.min(), xs.max(), (ys.min() if log else min(0, ys.min())), ys.max()
    pad = 0.06 * (x1 - x0), 0.08 * (y1 - y0)
    x0, x1, y1 = x0 - pad[0], x1 + pad[0], y1 + pad[1]
    y0 = y0 - pad[1] if log or y0 < 0 else y0

    def at(x, y):
        return int(left + (x - x0) / (x1 - x0) * (right - left)), int(
            low - (y - y0) / (y1 - y0) * (low - top)
        )

    for x, y in zip(*(marks(*ends, log) for ends in ((x0, x1), (y0, y1))), strict=True):
        cv2.line(image, at(x, y0), at(x, y1), GRID, 1, cv2.LINE_AA)
        cv2.line(image, at(x0, y), at(x1, y), GRID, 1, cv2.LINE_AA)
        for value, place in ((x, (at(x, y0)[0] - 20, low + 24)), (y, (left - 74, at(x0, y)[1] + 5))):
            cv2.putText(
                image,
                f"{10**value if log else round(value, 9) + 0.0:.3g}",
                place,
                FONT,
                0.5,
                INK,
                1,
                cv2.LINE_AA,
            )
    for k, (name, x, y, style) in enumerate(curves):
        points = [
            at(a, b) for a, b in zip(move(np.asarray(x, float)), move(np.asarray(y, float)), strict=True)
        ]
        colour = COLOURS[k % len(COLOURS)]
        if style == "line":
            cv2.polylines(image, [np.array(points)], False, colour, 2, cv2.LINE_AA)
        for p in points if style == "dots" else []:
            cv2.circle(image, p, 6, colour, -1, cv2.LINE_AA)
        x = left + 250 * k
        cv2.rectangle(image, (x, 62), (x + 20, 70), colour, -1)
        cv2.putText(image, name, (x + 30, 72), FONT, 0.5, INK, 1, cv2.LINE_AA)
    cv2.putText(image, title, (left, 36), FONT, 0.75, INK, 1, cv2.LINE_AA)
    cv2.putText(
        image, across, ((left + right) // 2 - 6 * len(across), h - 24), FONT, 0.6, INK, 1, cv2.LINE_AA
    )
    cv2.putText(image, up, (10, 36), FONT, 0.5, INK, 1, cv2.LINE_AA)
    cv2.imwrite(str(path), image, [cv2.IMWRITE_PNG_COMPRESSION, 9])


def cloud(image, points, values, view, scale, centre, radius) -> None:
    """Paints particles as shaded balls, far ones first.

    Args:
        image: (h, w, 3) uint8, painted on.
        points: (P, 3) m.
        values: (P,) in [0, 1], the colour.
        view: (3, 3) rows right, up, towards the eye.
        scale: px/m.
        centre: (3,) m, shown in the middle.
        radius: of a ball, px.
    """
    p = (points - centre) @ view.T
    ramp = (60 + 195 * np.clip(values, 0, 1)).astype(np.uint8)  # not the darkest
    colour = cv2.applyColorMap(ramp[:, None], cv2.COLORMAP_VIRIDIS)[:, 0].astype(float)
    depth = (p[:, 2] - p[:, 2].min()) / max(np.ptp(p[:, 2]), 1e-12)
    for i in np.argsort(p[:, 2]):
        x = int(image.shape[1] / 2 + scale * p[i, 0])
        y = int(image.shape[0] / 2 - scale * p[i, 1])
        tone = colour[i] * (0.72 + 0.28 * depth[i])
        cv2.circle(image, (x, y), radius, tone.tolist(), -1, cv2.LINE_AA)
        light = np.minimum(tone * 1.25 + 20, 255).tolist()
        cv2.circle(image, (x - radius // 3, y - radius // 3), max(radius // 3, 1) + 1, light, -1, cv2.LINE_AA)


def small(path, image) -> None:
    """Writes a PNG of 64 colours: a picture of many balls stays below 150 kB."""
    from PIL import Image

    picture = Image.fromarray(image[..., ::-1]).quantize(64, dither=Image.Dither.NONE)
    picture.save(path, optimize=True)


def view(turn, tilt):
    """(3, 3) rows right, up, to the eye, for a camera turned about z and tilted down, rad."""
    eye = np.array([np.cos(tilt) * np.sin(turn), -np.cos(tilt) * np.cos(turn), np.sin(tilt)])
    right = np.array([np.cos(turn), np.sin(turn), 0])
    return np.stack([right, np.cross(eye, right), eye])


def hertz(tick) -> list[str]:
    """Force against depth on a thick slab."""
    nu, young, radius, h, n, nz = 0.3, 1e5, 6e-3, 0.3e-3, 44, 22
    body = Body.box("slab", (n, n, nz), h, Material(young, nu), (-n * h / 2, -n * h / 2, -nz * h), "z-")
    solver = TotalLagrangian(body, device="cpu")
    depths, forces = np.array([0.1, 0.15, 0.2, 0.3, 0.4, 0.5]) * 1e-3, []
    for depth in depths:
        loads = Loads(
            indenter="sphere",
            size_m=np.array([radius, 1, 1]),
            position_m=np.array([0, 0, -depth]),
            friction=0.0,
        )
        forces.append(-solve_equilibrium(solver, loads, tolerance=1e-3).contact_force[0, 2])
        tick()
    chi = np.sqrt(radius * depths) / (nz * h)
    a = -(1.2876 - 1.4678 * nu + 1.3442 * nu**2) / (1 - nu)
    b = (0.6387 - 1.0277 * nu + 1.5164 * nu**2) / (1 - nu)
    layer = 1 - 2 * a / np.pi * chi + 4 * a**2 / np.pi**2 * chi**2
    layer -= 8 / np.pi**3 * (a**3 + 4 * np.pi**2 / 15 * b) * chi**3
    layer += 16 * a / np.pi**4 * (a**3 + 3 * np.pi**2 / 5 * b) * chi**4
    half_space = 4 / 3 * young / (1 - nu**2) * np.sqrt(radius) * depths**1.5
    chart(
        HERE / "mpm_hertz.png",
        "Sphere of 6 mm on a slab of 6.6 mm",
        "depth (mm)",
        "force (N)",
        [
            ("Hertz, half space", depths * 1e3, half_space, "line"),
            ("Dimitriadis, bonded layer", depths * 1e3, half_space * layer, "line"),
            ("material points", depths * 1e3, forces, "dots"),
        ],
    )
    error = np.abs(np.array(forces) / (half_space * layer) - 1)
    return [f"| sphere on a bonded layer, force at 0.1 to 0.5 mm | {100 * error.max():.1f} % (largest) |"]


def cantilever(tick) -> list[str]:
    """Sag of a cantilever over the resolution."""
    length, side, young, g = 0.08, 0.01, 1e6, 2.0
    load = 1000 * g * side**2
    expected = load * length**4 / (8 * young * side**4 / 12) + load * length**2 / (
        5 / 3 * young / 2 * side**2
    )
    across, errors = np.array([2, 4, 6, 8, 10]), []
    for n in across:
        body = Body.box("beam", (8 * n, n, n), side / n, Material(young, 0.0, 1000.0), clamp="x-")
        loads = Loads(gravity=np.array([0, 0, -g]))
        # Settles as a motion damped critically for the lowest bending mode.
        slowest = 1.875**2 * np.sqrt(young * side**2 / 12 / 1000) / length**2
        solver = TotalLagrangian(body, device="cpu")
        out = simulate(solver, loads, 10 / slowest, 10 / slowest, damping=2 * slowest)
        u = (out.positions[-1, 0] - body.positions)[:, 2].reshape(8 * n, -1).mean(1)
        errors.append(abs(-(1.5 * u[-1] - 0.5 * u[-2]) / expected - 1))
        tick()
    order = np.polyfit(np.log(across), np.log(errors), 1)[0]
    second = errors[0] * (across / across[0]) ** -2.0
    chart(
        HERE / "mpm_cantilever.png",
        "Cantilever's sag against Timoshenko's beam",
        "particles over the height",
        "error",
        [("second order", across, second, "line"), ("material points", across, errors, "dots")],
        log=True,
    )
    rows = ", ".join(f"{100 * e:.1f}" for e in errors)
    return [
        f"| cantilever's sag with 2, 4, 6, 8, 10 particles over the height | {rows} % (order {-order:.1f}) |"
    ]


def gel(tick) -> list[str]:
    """Depth field of the tactile gel, pressed by 1.4 mm."""
    h = 0.26e-3
    body = Body.box("gel", (59, 80, 13), h, Material(1e5, 0.46), (-59 * h / 2, -40 * h, -13 * h), "z-")
    solver = TotalLagrangian(body, device="cpu")
    loads = Loads(indenter="sphere", size_m=np.array([3e-3, 1, 1]), position_m=np.array([0, 0, -1.4e-3]))
    e = solve_equilibrium(solver, loads)
    tick()
    x, top = e.positions[0], body.cells[:, 2] == 12
    sunk = -(x - body.positions)[:, 2]
    image = np.full((560, 900, 3), 255, np.uint8)
    half = body.cells[:, 1] >= 40  # cut through the middle
    cloud(image, x[half], sunk[half] / 1.4e-3, view(0.35, 0.5), 44e3, x[half].mean(0), 6)
    cv2.putText(image, "Gel under a ball, cut; colour: sinking, 0 to 1.4 mm", (40, 40), FONT, 0.7, INK, 1, 16)
    small(HERE / "mpm_gel.png", image)
    field = sunk[top].reshape(59, 80)
    ramp = np.uint8(np.clip((field - field.min()) / np.ptp(field), 0, 1) * 255)
    wide = cv2.resize(ramp, (800, 590), interpolation=cv2.INTER_CUBIC)
    small(HERE / "mpm_gel_depth.png", cv2.applyColorMap(wide, cv2.COLORMAP_VIRIDIS))
    share = 1e3 * e.penetration_m[0] / 0.26
    return [
        f"| gel at 1.4 mm, deepest penetration | {100 * share:.1f} % of a spacing |",
        f"| gel at 1.4 mm, force | {-e.contact_force[0, 2]:.3f} N |",
    ]


def finger(tick) -> list[str]:
    """Bends of a finger with four joints under its weight."""
    h = 2.2e-3
    body = Body.box("finger", (45, 9, 10), h, Material(3e5, 0.45), (0, -4.5 * h, -5 * h), clamp="x-")
    length = 45 * h
    spine = Spine(tuple(length * (np.arange(4) + 0.5) / 4), length, 0, 0, 3e-3, stiffness_nm_per_rad=20.0)
    solver = TotalLagrangian(body, spine, device="cpu")
    image = np.full((620, 900, 3), 255, np.uint8)
    worst, centre = 0.0, np.array([0.045, 0, 0.032])
    for q in (0.0, 0.15, 0.3, 0.45):
        e = solve_equilibrium(
            solver, Loads(q_cmd=np.full((1, 4), q), gravity=np.array([9.81, 0, 0])), tolerance=1e-3
        )
        gap = np.abs(e.controller_torque + e.body_torque).max() / np.abs(e.body_torque).max()
        worst = max(worst, gap if q else 0.0)
        strain = np.linalg.norm(np.einsum("pji,pjk->pik", *[e.gradients[0]] * 2) - np.eye(3), axis=(1, 2)) / 2
        layer = np.full_like(image, 255)
        cloud(layer, e.positions[0], strain / 0.35, view(0.25, 0.2), 6600, centre, 9)
        seen = (layer < 250).any(2)
        image[seen] = layer[seen] if q == 0.45 else (0.75 * layer[seen] + 0.25 * 255).astype(np.uint8)
        tick()
    cv2.putText(
        image, "Finger at 0, 34, 69, 103 deg of target; colour: strain", (40, 40), FONT, 0.7, INK, 1, 16
    )
    small(HERE / "mpm_finger.png", image)
    return [f"| finger at rest, torques of controller and body | {100 * worst:.2f} % apart |"]


def bar(tick) -> list[str]:
    """Motion of a bar that was stretched and let go."""
    solid = Material(1e5, 0.0, 1000.0)
    body = Body.box("bar", (60, 2, 2), 1e-3, solid, clamp="x-")
    solver = TotalLagrangian(body, device="cpu")
    u = np.zeros_like(solver.grid.nodes)
    u[:, 0] = 2e-4 * np.sin(np.pi * solver.grid.nodes[:, 0] / 0.12)
    solver.set_nodes((solver.grid.nodes + u)[None])
    period = 4 * 0.06 / solid.sound_speed
    out = simulate(solver, Loads(), 3 * period, period / 100)
    tick()
    tip = (out.positions[:, 0, -1, 0] - body.positions[-1, 0]) * 1e3
    exact = tip[0] * np.cos(2 * np.pi * out.time_s / period)
    chart(
        HERE / "mpm_bar.png",
        "A bar rings at the frequency of pressure waves",
        "time (ms)",
        "tip (mm)",
        [
            ("closed form", out.time_s * 1e3, exact, "line"),
            ("material points", out.time_s[::5] * 1e3, tip[::5], "dots"),
        ],
    )
    return [
        f"| ringing bar over three periods | {100 * np.abs(tip - exact).max() / tip[0]:.1f} % of amplitude |"
    ]


PAGE = """# Material points against closed forms

**Claim.** The material points agree with closed forms to the errors below
(total-Lagrangian solver, one CPU, single precision).

**Command.** It writes this page.

    python benchmarks/mpm_validation.py

**Limitations.** Bending is too soft with fewer than six particles over the height.

| case | error or value |
|---|---|
{rows}

`tests/sim/mpm` checks these and more, smaller: stress, momentum, skeleton, friction, batches.

![Finger](mpm_finger.png)

![Gel under a ball](mpm_gel.png)

Sinking of the gel's upper face, 15.3 x 20.8 mm:

![Depth field](mpm_gel_depth.png)

## Curves

Hertz' half space is too soft for a slab of finite thickness: the bonded layer's force is the reference.

![Hertz](mpm_hertz.png)

A coarse body is too soft in bending: a cell's eight points lie nearer its middle than Gauss' points.

![Cantilever](mpm_cantilever.png)

![Ringing bar](mpm_bar.png)
"""


def main() -> None:
    """Runs every case and writes the page."""
    cases, rows = [(hertz, 6), (cantilever, 5), (gel, 1), (finger, 4), (bar, 1)], []
    with Progress() as progress:
        task = progress.add_task("validation", total=sum(n for _, n in cases))
        for case, _ in cases:
            rows += case(lambda: progress.advance(task))
    (HERE / "mpm.md").write_text(PAGE.format(rows="\n".join(rows)), encoding="utf-8")


if __name__ == "__main__":
    main()
