"""What a camera behind the gel sees, traced by Mitsuba 3 (Jakob et al., 2022).

The gel and the plate that carries it are one block of one index of refraction. LEDs shine into it from its
walls as area lights; its face has a coat that is part matt, part glossy metal; the camera stands below in
air and looks in through the plate. Shadows, refraction and light between walls, plate and face follow.
Each LED is traced alone: light adds up. Light that was reflected more than once varies slowly along the face;
it is traced at fewer pixels with more rays and smoothed over 0.6 mm.
"""

import tempfile
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

VARIANT = "scalar_rgb"  # the same picture on every machine
DIRECT_RAYS, INDIRECT_RAYS = 16, 144
COARSE = 8  # pixels in one where light was reflected more than once
SMOOTH_MM = 0.6
MESH_MM = 0.1
ROOM_MM = 3.0  # from the window's edge to the walls


@dataclass(frozen=True)
class Sensor:
    """One sensor; millimetres in the gel's frame: x along columns, y along rows, z out of the sensor."""

    image_px: tuple[int, int] = (320, 240)  # width and height
    window_mm: tuple[float, float] = (16.0, 12.0)  # what the camera sees of the face
    block_mm: float = 10.0  # thickness of gel and plate together
    index: float = 1.43  # of refraction of both
    camera_mm: float = 14.0  # of the pinhole below the plate
    # (side, z_mm, half length in mm) of each; side is -x, x, -y or y
    leds: tuple[tuple[str, float, float], ...] = (("-x", -7.0, 4.0), ("x", -6.6, 4.0), ("y", -7.4, 5.0))
    # (leds, 3) what the chip's channels see of each
    colours: tuple[tuple[float, float, float], ...] = ((1, 0.08, 0.06), (0.09, 1, 0.12), (0.05, 0.14, 1))
    reflectance: float = 0.55  # of the coat's matt part
    gloss: float = 0.25  # share of metal in the coat
    roughness: float = 0.4  # of that metal

    @property
    def px_per_mm(self) -> float:
        """Scale in the middle of the picture."""
        return self.image_px[0] / self.window_mm[0]

    def pixel(self, x_mm: float, y_mm: float) -> tuple[float, float]:
        """Column and row at which the camera sees a point of the resting face, by Snell's law."""
        r = float(np.hypot(x_mm, y_mm))
        steep = np.linspace(0, 1.2, 2000)  # tangent of the ray's angle in air
        sine = steep / np.sqrt(1 + steep**2)
        radius = self.camera_mm * steep + self.block_mm * sine / np.sqrt(self.index**2 - sine**2)
        scale = np.interp(r, radius, steep) * self.focal_px / max(r, 1e-9)
        return self.image_px[0] / 2 + x_mm * scale, self.image_px[1] / 2 + y_mm * scale

    @property
    def focal_px(self) -> float:
        """Focal length of the pinhole, px."""
        return self.px_per_mm * (self.camera_mm + self.block_mm / self.index)


@dataclass(frozen=True)
class Look:
    """How the sensor is at one moment."""

    # (rows, columns) share of the coat's reflectance that is left over the window and its rim; empty for all
    # of it
    coat: np.ndarray = field(default_factory=lambda: np.ones((0, 0)))
    # (n, 3) x, y and radius of dust on the plate
    specks_mm: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    tilt_rad: tuple[float, float] = (0.0, 0.0)  # turn of the camera about x and y

    @property
    def plain(self) -> bool:
        """Whether it is neither worn nor dusty nor tilted."""
        return not (self.coat.size or self.specks_mm.size or any(self.tilt_rad))


def grid(sensor: Sensor) -> tuple[np.ndarray, np.ndarray]:
    """Where the face's mesh rests: x (rows, columns) and y, mm, up to the walls."""
    x, y = (
        np.linspace(-w / 2 - ROOM_MM, w / 2 + ROOM_MM, int(round((w + 2 * ROOM_MM) / MESH_MM)) + 1)
        for w in sensor.window_mm
    )
    return np.meshgrid(x, y)


def shine(sensor: Sensor, moved_mm: np.ndarray, look: Look, seed: int = 0) -> np.ndarray:
    """(LEDs, H, W) radiance, in units of its own; linear in the LED's power.

    Of a face displaced by (rows, columns, 3) mm at the points of `grid`, with wear, dust and tilt; `seed` is
    the rays'.
    """
    import mitsuba as mi

    before = mi.variant()
    mi.set_variant(VARIANT)
    try:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "face.ply"
            _write_face(file, sensor, moved_mm)
            return np.stack([_one(mi, sensor, look, file, k, seed) for k in range(len(sensor.leds))])
    finally:
        if before:
            mi.set_variant(before)


def _one(mi, sensor: Sensor, look: Look, face: Path, led: int, seed: int) -> np.ndarray:
    w, h = sensor.image_px
    direct = _traced(mi, sensor, look, face, led, (w, h), 3, DIRECT_RAYS, seed)
    small = (w // COARSE, h // COARSE)
    all_, once = (_traced(mi, sensor, look, face, led, small, n, INDIRECT_RAYS, seed) for n in (7, 3))
    indirect = cv2.GaussianBlur(all_ - once, (0, 0), SMOOTH_MM * sensor.px_per_mm / COARSE)
    return direct + cv2.resize(indirect, (w, h), interpolation=cv2.INTER_CUBIC)


def _traced(mi, sensor: Sensor, look: Look, face: Path, led: int, size, depth: int, rays: int, seed: int):
    """(H, W) light of one LED that was bent or reflected less than `depth` times."""
    scene = _block(mi, sensor, look, face) | {
        "integrator": {"type": "path", "max_depth": depth},
        "camera": _camera(mi, sensor, look, size, rays),
        "led": _led(mi, sensor, *sensor.leds[led]),
    }
    return np.array(mi.render(mi.load_dict(scene), seed=1 + 7 * seed + led))[..., 0]


def _camera(mi, sensor: Sensor, look: Look, size: tuple[int, int], rays: int) -> dict:
    T = mi.ScalarTransform4f
    stand = [0, 0, -sensor.block_mm - sensor.camera_mm]
    aim = T().look_at(origin=stand, target=[0, 0, 0], up=[0, -1, 0])
    about_x, about_y = map(float, np.degrees(look.tilt_rad))
    turn = T().rotate([1, 0, 0], about_x) @ T().rotate([0, 1, 0], about_y)
    film = {"type": "hdrfilm", "width": size[0], "height": size[1], "pixel_format": "luminance"}
    return {
        "type": "perspective",
        "fov_axis": "x",
        "fov": float(2 * np.degrees(np.arctan(sensor.image_px[0] / 2 / sensor.focal_px))),
        "to_world": aim @ turn,
        "film": film | {"rfilter": {"type": "gaussian", "stddev": 0.6}},
        "sampler": {"type": "independent", "sample_count": rays},
    }


def _block(mi, sensor: Sensor, look: Look, face: Path) -> dict:
    a, b = (w / 2 + ROOM_MM for w in sensor.window_mm)
    low, half = -sensor.block_mm, sensor.block_mm / 2
    value = sensor.reflectance
    matt = {"type": "diffuse", "reflectance": {"type": "rgb", "value": value}}
    if look.coat.size:
        shade = np.repeat((value * look.coat)[..., None], 3, 2).astype(np.float32)
        matt["reflectance"] = {"type": "bitmap", "bitmap": mi.Bitmap(shade), "raw": True}
    metal = {"type": "roughconductor", "material": "Al", "alpha": sensor.roughness}
    coat = {"type": "blendbsdf", "weight": sensor.gloss, "matt": matt, "metal": metal}
    dark = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.1}}
    glass = {"type": "dielectric", "int_ior": sensor.index, "ext_ior": 1.0}
    out = {
        "type": "scene",
        "face": {"type": "ply", "filename": str(face), "bsdf": {"type": "twosided", "coat": coat}},
        "plate": _sheet(mi, [0, 0, low], [0, 0, -1], [0, 1, 0], (0.7 * a, 0.7 * b)) | {"bsdf": glass},
    }
    sides = ([-a, 0], [1, 0], b), ([a, 0], [-1, 0], b), ([0, -b], [0, 1], a), ([0, b], [0, -1], a)
    for i, (at, inward, wide) in enumerate(sides):
        wall = _sheet(mi, [*at, -half], [*inward, 0], [0, 0, 1], (wide, half))
        out[f"wall_{i}"] = wall | {"bsdf": dark}
    black = {"type": "twosided", "dark": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.02}}}
    T = mi.ScalarTransform4f
    for i, (x, y, r) in enumerate(look.specks_mm.tolist()):
        disk = T().translate([x, y, low + 0.02]) @ T().scale([r, r, 1])
        out[f"speck_{i}"] = {"type": "disk", "to_world": disk, "bsdf": black}
    return out


def _led(mi, sensor: Sensor, side: str, z_mm: float, half_mm: float) -> dict:
    """An area light 1 mm high just off the wall, of the same power whatever its length."""
    sign, k = (-1 if side[0] == "-" else 1), "xy".index(side[-1])
    at, inward = np.zeros(3), np.zeros(3)
    at[k], at[2] = sign * (sensor.window_mm[k] / 2 + ROOM_MM - 0.05), z_mm
    inward[k] = -sign
    radiance = 600.0 / half_mm
    return _sheet(mi, at.tolist(), inward.tolist(), [0, 0, 1], (half_mm, 0.5)) | {
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": radiance}}
    }


def _sheet(mi, at, normal, up, half) -> dict:
    T = mi.ScalarTransform4f
    target = [float(p + n) for p, n in zip(at, normal, strict=True)]
    place = T().look_at(origin=[float(p) for p in at], target=target, up=up)
    return {"type": "rectangle", "to_world": place @ T().scale([float(half[0]), float(half[1]), 1])}


def _write_face(file: Path, sensor: Sensor, moved_mm: np.ndarray) -> None:
    """A binary PLY of the displaced face with its place on the coat."""
    x, y = grid(sensor)
    p = np.stack([x, y, np.zeros_like(x)], -1) + moved_mm
    rows, columns = x.shape
    u, v = np.meshgrid(np.linspace(0, 1, columns), np.linspace(0, 1, rows))
    vertex = np.concatenate([p, u[..., None], v[..., None]], -1).reshape(-1, 5).astype("<f4")
    i = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = i[:-1, :-1].ravel(), i[:-1, 1:].ravel(), i[1:, 1:].ravel(), i[1:, :-1].ravel()
    corners = np.concatenate([np.stack([a, c, b], 1), np.stack([a, d, c], 1)])
    faces = np.empty(len(corners), dtype=[("n", "u1"), ("i", "<i4", 3)])
    faces["n"], faces["i"] = 3, corners
    names = "".join(f"property float {n}\n" for n in "xyzuv")
    head = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertex)}\n{names}"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    file.write_bytes(head.encode() + vertex.tobytes() + faces.tobytes())
