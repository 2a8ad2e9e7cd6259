"""Frames of a finger or an arm: brought to rest pressure by pressure, drawn by Gaussian splats.

Frames of a gel under an indenter: the cut through its material points and the tactile image.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np

from lerobot_pneutac.diagnosis.thresholds import LEVEL_KPA
from lerobot_pneutac.rendering.options import FPS, RenderConfig, RenderView, deepest_press
from lerobot_pneutac.study.photographs import held_levels, masked_cameras, mean_conditions, read_held
from pneutac_datasets.recording.photographs import read_camera
from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.wording import an
from pneutac_sim.errors import InputError, option
from pneutac_sim.features import CHAMBERS
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.mpm.body import Body
from pneutac_sim.photo_fit.objective import SOLID, MaskedPhotograph, Objective
from pneutac_sim.splat import body as S
from pneutac_sim.splat.camera import Camera
from pneutac_sim.splat.render import Gaussians, rasterise
from pneutac_sim.twin import Twin

STRETCH = "Colour is the largest stretch of the material, from calm to warm."


@dataclass
class FilmFrame:
    """One picture of the film; where `row` is a line of the table, the picture is a still too."""

    picture: np.ndarray
    row: dict | None = None


class Film(NamedTuple):
    """A film that is yet to be drawn."""

    device: str  # of the twin
    frames: Iterator[FilmFrame]  # computed one by one
    count: int  # how many there will be
    lead: str  # what they show, in a sentence
    about: str = ""  # which twin and recording, for the report


class Pose(NamedTuple):
    """A body at rest."""

    pressure: np.ndarray  # (chambers,) kPa
    positions: np.ndarray  # (P, 3) of the particles, m
    gradients: np.ndarray  # (P, 3, 3) deformation gradients
    spine: np.ndarray  # (K, 3) base, joints and tip, m


# Draws a pose; the dictionary is what it adds to the table.
Painter = Callable[[Pose], tuple[np.ndarray, dict]]


def pressure_text(pressure: np.ndarray) -> str:
    return f"{', '.join(f'{p:.1f}' for p in pressure)} kPa"


def caption(pose: Pose) -> str:
    tip = 1e3 * pose.spine[-1]
    return f"{pressure_text(pose.pressure)}   tip x {tip[0]:.1f}  y {tip[1]:.1f}  z {tip[2]:.1f} mm"


BODY_PX, GEL_PX = (640, 480), (800, 480)  # width and height of pictures
PAPER, INK = (246, 248, 250), (27, 36, 48)


def blank(width: int, height: int) -> np.ndarray:
    return np.full((height, width, 3), PAPER, np.uint8)


def write(image: np.ndarray, text: str, x: int, y: int, size: float = 0.5) -> None:
    cv2.putText(image, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, size, INK, 1, cv2.LINE_AA)


def gel_picture(
    moved_mm, particles_mm, strains, spacing_mm, window_mm, top_mm, top_strain, caption
) -> np.ndarray:
    """The face of a gel from above, lit from one side, and a cut along its deepest row.

    The face (rows, columns) has moved into the gel by so many mm; the cut has particles (K, 3) mm in the gel
    frame and their strains (K,). Colours are warmest at `top_mm` and at `top_strain`.
    """
    width, height = GEL_PX
    image = blank(width, height)
    face_height = height - 90
    face_width = round(face_height * window_mm[0] / window_mm[1])
    rows, cols = moved_mm.shape
    slope_y, slope_x = np.gradient(-moved_mm, window_mm[1] / rows, window_mm[0] / cols)
    normal = np.stack([-slope_x, -slope_y, np.ones_like(slope_x)], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    light = np.array([-0.45, -0.55, 0.70])
    shade = np.clip(normal @ light / 0.70, 0.25, 1.35)[..., None]
    face = np.clip(S.stretch_colours(moved_mm, top_mm) * shade, 0, 255).astype(np.uint8)
    face = cv2.resize(face, (face_width, face_height), interpolation=cv2.INTER_CUBIC)
    image[24 : 24 + face_height, 16 : 16 + face_width] = face
    line = 24 + round((np.unravel_index(moved_mm.argmax(), moved_mm.shape)[0] + 0.5) / rows * face_height)
    cv2.line(image, (16, line), (16 + face_width, line), (255, 255, 255), 1, cv2.LINE_AA)
    left = 16 + face_width + 36
    scale = (width - left - 16) / (1.06 * window_mm[0])
    at = (left + 0.53 * window_mm[0] * scale, 0.5 * height) + scale * particles_mm[:, [0, 2]] * (1, -1)
    radius, colours = max(1, round(0.55 * scale * spacing_mm)), S.stretch_colours(strains, top_strain)
    for centre, colour in zip(at.round().astype(int).tolist(), colours.tolist(), strict=True):
        cv2.circle(image, centre, radius, colour, -1, cv2.LINE_AA)
    write(image, "cut along the white line", left, 40)
    write(image, caption, 16, height - 22, 0.55)
    return image


def with_tactile(picture: np.ndarray, tactile: np.ndarray) -> np.ndarray:
    """A gel's picture with a tactile image (H, W, 3) uint8 to its right, as high as the face."""
    height = len(picture) - 90
    width = round(height * tactile.shape[1] / tactile.shape[0])
    panel = blank(width + 16 + width % 2, len(picture))
    panel[24 : 24 + height, :width] = cv2.resize(tactile, (width, height), interpolation=cv2.INTER_AREA)
    write(panel, "tactile image", 0, len(picture) - 22, 0.55)
    return np.concatenate([picture, panel], 1)


VIEW_CAPTION = 44  # px below a picture from a view
FOV_DEG = 20.0  # so that four lengths away the straight body fills seven tenths of the height


def view_painter(twin: Twin, body: Body, view: RenderView, spines: np.ndarray) -> tuple[Painter, str]:
    """Draws poses from a view, and says what one sees; in the middle is that of `spines` (T, K, 3) m.

    The body hangs, and at no angle bends to the right.
    """
    points = spines.reshape(-1, 3)
    aim, away = (points.min(0) + points.max(0)) / 2, 1e-3 * twin.length_mm * view.distance_lengths
    around, above = np.radians([view.azimuth_deg, view.elevation_deg])
    side, base = np.array([0.0, -np.cos(around), np.sin(around)]), np.array([-1.0, 0.0, 0.0])
    eye, up = np.cos(above) * side + np.sin(above) * base, np.cos(above) * base - np.sin(above) * side
    camera = Camera.look_at(aim + away * eye, aim, up, FOV_DEG, *BODY_PX)
    looks_of = body_looks(twin, body)

    def paint(pose: Pose) -> tuple[np.ndarray, dict]:
        now = looks_of(pose.positions, pose.gradients)
        seen = rasterise(now, camera, np.array(PAPER) / 255)
        width, height = BODY_PX
        image = blank(width, height + VIEW_CAPTION)
        image[:height] = (255 * seen.image.clip(0, 1)).round()
        write(image, caption(pose), 16, height + VIEW_CAPTION - 18, 0.55)
        return image, {}

    own = "The body in its own looks, by Gaussian splats on the particles."
    return paint, own if has_looks(twin) else STRETCH


def has_looks(twin: Twin) -> bool:
    """Whether a photograph gave the twin its looks."""
    return all(array in twin.arrays for array in S.ARRAYS)


def body_looks(twin: Twin, body: Body) -> Callable[[np.ndarray, np.ndarray], Gaussians]:
    """What gives the Gaussians of a body for its particles' positions (P, 3), m, and gradients (P, 3, 3).

    They are in the twin's looks, or coloured by stretch where it has none.
    """
    own = has_looks(twin)
    looks = S.looks_from_twin(twin) if own else S.blank_looks(body)

    def now(positions: np.ndarray, gradients: np.ndarray) -> Gaussians:
        moved = S.carried(looks, body, positions, gradients)
        return moved if own else replace(moved, colours=S.stretch_colours(S.strain(gradients)) / 255)

    return now


SILHOUETTE_HEIGHT = 220  # px of a picture


def strip(objective: Objective, positions: np.ndarray, photographs: list[MaskedPhotograph]) -> np.ndarray:
    """Photographs above, renderings below and differing silhouettes last, uint8 (H, W, 3).

    `positions` are (T, P, 3) m of the particles at each pressure, counted by the photographs' `state`.
    """
    columns, masks = [], np.concatenate([np.argwhere(p.mask) for p in photographs])
    low = np.maximum(masks.min(0) - 12, 0)
    high = np.minimum(masks.max(0) + 12, photographs[0].mask.shape)
    for p in photographs:
        drawn = objective.render(positions[p.state], p.camera)
        edges = differing(p.mask, drawn.alpha > SOLID)
        real = np.where(p.mask[..., None], p.image, 255)
        stack = [a[low[0] : high[0], low[1] : high[1]] for a in (real, on_white(drawn), edges)]
        size = (round(SILHOUETTE_HEIGHT * (high[1] - low[1]) / (high[0] - low[0])), SILHOUETTE_HEIGHT)
        small = [cv2.resize(a.astype(np.uint8), size, interpolation=cv2.INTER_AREA) for a in stack]
        columns.append(np.concatenate(small))
    return np.concatenate(columns, 1)


def differing(photograph: np.ndarray, drawn: np.ndarray) -> np.ndarray:
    """Silhouettes, bool (H, W), as uint8 (H, W, 3): grey where both are, red and blue where only one is."""
    image = np.full((*photograph.shape, 3), 255, np.uint8)
    image[photograph & drawn] = (222, 226, 230)
    image[photograph & ~drawn] = (194, 65, 12)
    image[~photograph & drawn] = (11, 110, 153)
    return image


def on_white(drawn) -> np.ndarray:
    """A rendering (H, W, 3) over white, of 255."""
    return 255 * (drawn.image.clip(0, 1) + (1 - drawn.alpha.clip(0, 1))[..., None]).clip(0, 1)


HEIGHT, GAP, CAPTION = 400, 8, 40  # px of a panel, between panels, and below
MARGIN = 0.12  # round the body, over its length
LEAD = (
    "Left the photograph at the nearest pressure, in the middle the twin in its own looks from the same "
    "camera, right their silhouettes: red where only the photograph, blue where only the twin."
)


@dataclass(frozen=True)
class Recorded:
    """What one camera of a recording saw."""

    pressures: np.ndarray  # (T, chambers) kPa, rising
    photographs: list[MaskedPhotograph]  # (T,) the last one at each
    camera: Camera  # from where
    conditions: dict[str, float]  # means of the recording's other columns


def read_recorded(twin: Twin, config: RenderConfig) -> Recorded:
    """Reads the photographs of the chosen camera, the first one where none is chosen."""
    recording = Recording.load(config.recording)
    if recording.device != twin.device:
        both = f"{recording.folder} is of {an(recording.device)} and {config.twin} of {an(twin.device)}"
        raise InputError(f"{both}; give a recording of the twin's own device.")
    try:
        S.looks_from_twin(twin)
    except InputError as e:
        fit = f"{option('twin', config.twin)} --recording={recording.folder} --by=images"
        raise InputError(
            f"The twin at {config.twin} has no looks; fit them with `pneutac calibrate {fit}`."
        ) from e
    names = masked_cameras(recording)
    if not names:
        raise InputError(f"{recording.folder} has no photographs with masks; give a recording that has.")
    name = config.camera or next(iter(names))
    if name not in names:
        has = f"it has {', '.join(names)}"
        raise InputError(f"{recording.folder} has no camera '{name}' with masks; {has}.")
    camera = read_camera(recording, name)
    levels, rows, state = held_levels(recording)
    last = {int(s): int(row) for row, s in zip(rows, state, strict=True)}
    photographs = [read_held(recording, last[s], s, name, camera) for s in range(len(levels))]
    return Recorded(levels, photographs, camera, mean_conditions(recording))


def photograph_painter(twin: Twin, body: Body, recorded: Recorded, spines: np.ndarray) -> tuple[Painter, str]:
    """Draws poses next to photographs, and describes them; the spine will be about `spines` (T, K, 3) m."""
    camera, looks = recorded.camera, S.looks_from_twin(twin)
    window = _window(recorded, spines, 1e-3 * twin.length_mm)

    def paint(pose: Pose) -> tuple[np.ndarray, dict]:
        nearest = int(np.abs(recorded.pressures - pose.pressure).sum(1).argmin())
        photograph, pressure = recorded.photographs[nearest], recorded.pressures[nearest]
        seen = rasterise(S.carried(looks, body, pose.positions, pose.gradients), camera)
        mask, solid = photograph.mask, seen.alpha > SOLID
        panels = (photograph.image, on_white(seen), differing(mask, solid))
        iou = float((mask & solid).sum() / (mask | solid).sum())
        same = bool(np.abs(pressure - pose.pressure).max() < LEVEL_KPA)
        captions = [f"photograph, {pressure_text(pressure)}", f"twin, {pressure_text(pose.pressure)}"]
        captions.append(f"overlap {iou:.1%}" if same else "silhouettes")
        parts = []
        for panel, below in zip(panels, captions, strict=True):
            cut = np.ascontiguousarray(panel[window], np.uint8)
            width = round(HEIGHT * cut.shape[1] / cut.shape[0])
            part = blank(width + width % 2 + GAP, HEIGHT + CAPTION)
            part[:HEIGHT, :width] = cv2.resize(cut, (width, HEIGHT), interpolation=cv2.INTER_AREA)
            write(part, below, 4, HEIGHT + CAPTION - 14)
            parts.append(part)
        return np.concatenate(parts, 1), {"iou": iou if same else None}

    return paint, LEAD


def _window(recorded: Recorded, spines: np.ndarray, length_m: float) -> tuple[slice, slice]:
    camera = recorded.camera
    pixels, depth = camera.project(spines.reshape(-1, 3))
    size = np.array([camera.width, camera.height])
    seen = (depth > 0) & (pixels >= 0).all(1) & (pixels < size).all(1)
    if not seen.any():
        check = "check that its extrinsics in recording.json lead from base to camera, in metres"
        raise InputError(f"The camera does not see the body; {check}.")
    masks = np.concatenate([np.argwhere(p.mask)[:, ::-1] for p in recorded.photographs])
    corners = np.concatenate([pixels[seen], masks.min(0)[None], masks.max(0)[None]])
    margin = MARGIN * length_m * camera.intrinsics[0, 0] / float(np.median(depth[seen]))
    low = np.maximum(corners.min(0) - margin, 0).astype(int)
    high = np.minimum(corners.max(0) + margin, size).astype(int)
    return slice(low[1], high[1]), slice(low[0], high[0])


def body_film(twin: Twin, config: RenderConfig) -> Film:
    from pneutac_sim.mpm import devices

    recorded = None if config.recording is None else read_recorded(twin, config)
    given = config.pressure_kpa
    if given is not None and len(given) % CHAMBERS[twin.device]:
        raise InputError(f"pressure_kpa has {len(given)} numbers; an arm takes three for each pose.")
    points = recorded.pressures if given is None else np.reshape(given, (-1, CHAMBERS[twin.device]))
    each = max(2, round(config.seconds * FPS))
    share = np.minimum(np.arange(1, each + 1) / (each // 2), 1.0)[:, None]
    steps = [a + share * (b - a) for a, b in zip(points[:-1], points[1:], strict=True)]
    program = np.concatenate([points[:1], *steps])
    # A body was photographed at rest, so there each pressure has been held for long.
    time_s = np.arange(len(program)) / FPS if recorded is None else None
    conditions = config.conditions if recorded is None else recorded.conditions | config.conditions
    q_cmd = devices.joint_targets(twin, program, time_s, conditions)
    make = devices.BODIES[twin.device]
    solver = make(twin, particles=config.particles, device=config.device)
    spines = np.concatenate([devices.spine_points(solver, q[None]) for q in q_cmd])
    if recorded is not None:
        painter, lead = photograph_painter(twin, solver.body, recorded, spines)
    else:
        painter, lead = view_painter(twin, solver.body, config.view or RenderView(), spines)
    return Film(twin.device, _frames(solver, program, q_cmd, each, painter), len(program), lead)


def _frames(
    solver, program: np.ndarray, q_cmd: np.ndarray, each: int, painter: Painter
) -> Iterator[FilmFrame]:
    from pneutac_sim.mpm import devices
    from pneutac_sim.mpm.solve import solve_equilibrium
    from pneutac_sim.mpm.total_lagrangian import Loads

    spent, rest = 0.0, None
    for k, (pressure, q) in enumerate(zip(program, q_cmd, strict=True)):
        start = time.perf_counter()
        if rest is None or not np.array_equal(q, q_cmd[k - 1]):
            rest = solve_equilibrium(solver, Loads(q_cmd=q[None]), warm=k > 0)
        spent += time.perf_counter() - start
        spine = devices.spine_points(solver, rest.q)[0]
        picture, more = painter(Pose(pressure, rest.positions[0], rest.gradients[0], spine))
        row = None
        if k % each == 0:
            row = {"pressure_kpa": pressure_text(pressure)[:-4] if len(pressure) > 1 else float(pressure[0])}
            row |= {f"tip_{a}_mm": float(1e3 * x) for a, x in zip("xyz", spine[-1], strict=True)}
            row |= more | {"seconds": spent}
            spent = 0.0
        yield FilmFrame(picture, row)


PRESS_FRAMES = 8  # depths on the way down
GEL_STRAIN = 0.8  # of the warmest colour
SIZE = {"cube": "side", "edge": "side", "outline": "reach", "mesh": "reach"}  # size_mm; of others the radius


def gel_film(twin: Twin, config: RenderConfig) -> Film:
    press = deepest_press(config, GelModel.from_twin(twin))
    lead = f"{STRETCH} Right: the tactile image, by Gaussian splats on the particles."
    return Film("gel", _press_frames(twin, config, press), PRESS_FRAMES, lead)


def _press_frames(twin: Twin, config: RenderConfig, press: Press) -> Iterator[FilmFrame]:
    from pneutac_sim.mpm import devices
    from pneutac_sim.mpm.indenter import distances_m
    from pneutac_sim.mpm.solve import solve_equilibrium
    from pneutac_sim.splat.gel import SplatSensor

    table = None if press.figure is None else distances_m(press.figure)
    solver = devices.gel(twin, device=config.device, table=table)
    model = GelModel.from_twin(twin)
    window, sensor = model.window_mm, SplatSensor(model)
    cells = solver.body.cells
    named = f"{press.indenter}, {SIZE.get(press.indenter, 'radius')} {press.size_mm:.3g} mm"
    spent = 0.0
    for k in range(PRESS_FRAMES):
        depth = config.depth_mm * (k + 1) / PRESS_FRAMES
        start = time.perf_counter()
        rest = solve_equilibrium(solver, devices.press_loads(replace(press, depth_mm=depth)), warm=k > 0)
        spent += time.perf_counter() - start
        moved = devices.surface_displacement(solver, window)[0]
        row = np.argmin(np.abs(solver.body.positions[:, 1] - 1e-3 * press.y_mm))
        cut = cells[:, 1] == cells[row, 1]
        force = float(np.linalg.norm(rest.contact_force[0]))
        shown = 1e3 * rest.positions[0, cut], S.strain(rest.gradients[0, cut]), 1e3 * solver.body.spacing_m
        text = f"{named}   depth {depth:.2f} mm   force {force:.2f} N"
        picture = gel_picture(moved, *shown, window, config.depth_mm, GEL_STRAIN, text)
        picture = with_tactile(picture, sensor.image(moved))
        values = {"depth_mm": depth, "face_mm": float(moved.max()), "force_n": force}
        values |= {"penetration_um": float(1e6 * rest.penetration_m[0]), "seconds": spent}
        shown = k in (PRESS_FRAMES // 2 - 1, PRESS_FRAMES - 1)
        yield FilmFrame(picture, values if shown else None)
