"""Probe grids and springs of the gel in many worlds at once: Warp kernels and PyTorch tensors on one device.

The shapes' equations are those of `gel.probe`, compiled by Warp from the same functions; the springs solve
the contact problem of `gel.spring` for all worlds together. Everything is in single precision: depths agree
within 1e-3 mm; of 80 random presses three quarters of the forces agree within 0.5 % and all within 5 %.
"""

import math
import types

import numpy as np
import torch
import warp as wp

from pneutac_sim.errors import InputError
from pneutac_sim.gel import probe, spring
from pneutac_sim.gel.force import RIM, RIM_SHARE, STICKS, GelForce
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.optics import _cells as _cells_of
from pneutac_sim.gel.probe import BOX, CAPSULE, COLS, CYLINDER, ELLIPSOID, ROWS, SPHERE

KINDS = (SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX)
SLOTS = 144  # cells of a contact: `CELLS` of a disc fill a square of 102, and each edge is rounded up
GROW, GROWTHS = 1.1, 12  # by which cells are enlarged, and how often, where a contact would need more
CHECK_EVERY = 5  # iterations between questions whether all contacts are solved
LEAST_SIZE = 32  # of a recorded part; further ones are twice as large each
NOWHERE_MM = -1e6
wp.set_module_options({"enable_backward": False})  # nobody asks for gradients, and they take long to compile


def _compiled(function, **known) -> wp.Function:
    """A function that Numba compiles, as Warp compiles it; `known` are those that it calls."""
    code = function.py_func.__code__
    new = types.FunctionType(code, function.py_func.__globals__ | known, code.co_name)
    names = code.co_varnames[: code.co_argcount]
    new.__annotations__ = {name: wp.vec3 if name == "s" else float for name in names}
    new.__module__ = __name__
    return wp.func(new)


_solids = {"_roots": _compiled(probe._roots), "_slab": _compiled(probe._slab)}
_sphere, _capsule, _ellipsoid, _cylinder, _box = (
    _compiled(f, **_solids)
    for f in (probe._sphere, probe._capsule, probe._ellipsoid, probe._cylinder, probe._box)
)


@wp.struct
class _Scene:
    """Objects that the gel of every world may feel, and the gel's site."""

    kinds: wp.array(dtype=int)
    sizes: wp.array(dtype=wp.vec3)
    geoms: wp.array(dtype=int)
    positions: wp.array2d(dtype=wp.vec3)
    rotations: wp.array2d(dtype=wp.mat33)
    gel_positions: wp.array2d(dtype=wp.vec3)
    gel_rotations: wp.array2d(dtype=wp.mat33)
    gel: int


@wp.func
def _depth_mm(scene: _Scene, world: int, x: float, y: float, ahead: float, reach: float) -> float:
    """How deep in mm the shapes lie below a place (x, y) m of the face; from `ahead` m before it."""
    R_gel, deepest = scene.gel_rotations[world, scene.gel], float(0.0)
    at = scene.gel_positions[world, scene.gel] + R_gel @ wp.vec3(x, y, ahead)
    along = R_gel @ wp.vec3(0.0, 0.0, 1.0)
    for k in range(scene.kinds.shape[0]):
        size, kind, geom = scene.sizes[k], scene.kinds[k], scene.geoms[k]
        R = wp.transpose(scene.rotations[world, geom])
        o, d = R @ (at - scene.positions[world, geom]), R @ along
        for i in range(3):  # no slab divides by zero
            if wp.abs(d[i]) < 1e-6:
                d[i] = 1e-6
        lo, hi = float(1.0), float(0.0)
        if kind == wp.static(BOX):
            lo, hi = _box(size, o[0], o[1], o[2], d[0], d[1], d[2])
        elif kind == wp.static(CAPSULE):
            lo, hi = _capsule(size, o[0], o[1], o[2], d[0], d[1], d[2])
        elif kind == wp.static(ELLIPSOID):
            lo, hi = _ellipsoid(size, o[0], o[1], o[2], d[0], d[1], d[2])
        elif kind == wp.static(CYLINDER):
            lo, hi = _cylinder(size, o[0], o[1], o[2], d[0], d[1], d[2])
        else:
            lo, hi = _sphere(size, o[0], o[1], o[2], d[0], d[1], d[2])
        if lo <= hi and hi > -reach:
            deepest = wp.max(deepest, wp.min(-lo, reach))
    return 1e3 * (deepest - ahead)


@wp.kernel
def _grids(
    scene: _Scene, cell_x: float, cell_y: float, ahead: float, reach: float, out: wp.array3d(dtype=float)
):
    """Into `out` (worlds, rows, columns) mm below the face; from `ahead` m before it and less that."""
    world, i, j = wp.tid()
    x = (float(j) + 0.5 - 0.5 * float(out.shape[2])) * cell_x
    y = (float(i) + 0.5 - 0.5 * float(out.shape[1])) * cell_y
    out[world, i, j] = _depth_mm(scene, world, x, y, ahead, reach)


@wp.kernel
def _cells(
    scene: _Scene,
    worlds: wp.array(dtype=wp.int64),
    boxes: wp.array2d(dtype=float),
    ahead: float,
    reach: float,
    out: wp.array3d(dtype=float),
):
    """Into `out` (contacts, SLOTS, FINE^2) mm below the face at samples of each cell of a contact's box."""
    b, k, s = wp.tid()
    rows, cols = int(boxes[b, 6]), int(boxes[b, 7])
    if k >= rows * cols:
        out[b, k, s] = wp.static(NOWHERE_MM)
        return
    wide, high, fine = boxes[b, 4] * boxes[b, 5], boxes[b, 4], float(wp.static(spring.FINE))  # mm
    i, j = k / cols, k % cols
    u = float(j) + (float(s % wp.static(spring.FINE)) + 0.5) / fine - 0.5 * float(cols)
    v = float(i) + (float(s / wp.static(spring.FINE)) + 0.5) / fine - 0.5 * float(rows)
    u, v = boxes[b, 2] + wide * u, boxes[b, 3] + high * v
    c, n = boxes[b, 0], boxes[b, 1]
    x, y = 1e-3 * (c * u - n * v), 1e-3 * (n * u + c * v)
    out[b, k, s] = _depth_mm(scene, int(worlds[b]), x, y, ahead, reach)


@wp.kernel
def _compliances(
    near: wp.array3d(dtype=float),
    hidden: wp.array(dtype=float),
    boxes: wp.array2d(dtype=float),
    out: wp.array3d(dtype=float),
):
    """Into `out` (contacts, SLOTS, SLOTS) mm/N between cells; the diagonal, which depends on depth, is 0."""
    b, k, m = wp.tid()
    cols, h, aspect = int(boxes[b, 7]), boxes[b, 4], boxes[b, 5]
    i, j = wp.abs(k / cols - m / cols), wp.abs(k % cols - m % cols)
    out[b, k, m] = 0.0
    if k != m and wp.max(k, m) < int(boxes[b, 6]) * cols:
        r = h * wp.sqrt(float(i * i) + aspect * aspect * float(j * j)) / wp.static(spring.STEP_MM)
        n = wp.min(int(r), hidden.shape[0] - 2)
        kept = hidden[n] + (r - float(n)) * (hidden[n + 1] - hidden[n])
        out[b, k, m] = near[int(aspect) / 2, i, j] / h + kept  # aspects 1, 2, 4 are tables 0, 1, 2


@wp.kernel
def _pixels(
    light: wp.array4d(dtype=float),
    rest: wp.array3d(dtype=wp.uint8),
    weight: wp.array3d(dtype=float),
    at_row: wp.array(dtype=int),
    share_row: wp.array(dtype=float),
    at_col: wp.array(dtype=int),
    share_col: wp.array(dtype=float),
    sum_limit: int,
    out: wp.array(dtype=int),
):
    """Adds to `out` (B,) the pixels of a row that differ from rest, as `gel.optics` draws and counts them."""
    b, p = wp.tid()
    i, f, n = at_row[p], share_row[p], int(0)
    for q in range(at_col.shape[0]):
        j, e, total = at_col[q], share_col[q], int(0)
        for k in range(3):
            upper = wp.lerp(light[b, k, i, j], light[b, k, i, j + 1], e)
            lower = wp.lerp(light[b, k, i + 1, j], light[b, k, i + 1, j + 1], e)
            c = int(rest[p, q, k])
            level = float(c) + weight[p, q, k] * wp.lerp(upper, lower, f) + 0.5
            total += wp.abs(int(wp.clamp(level, 0.0, 255.0)) - c)
        if total > sum_limit:
            n += 1
    if n > 0:
        wp.atomic_add(out, b, n)


class Playback:
    """Calls functions whose tensors stay the same ones; on CUDA they are recorded as graphs and played back.

    A function launches hundreds of small kernels, each of which takes longer to launch than to run. It may
    have a size, the number of worlds that need it: it is recorded for powers of two, in which worlds that do
    not need it fill up. It must not wait for the GPU.
    """

    def __init__(self, device: torch.device):
        self._device, self._graphs, self._pool = device, {}, None

    def __call__(self, function, *size: int) -> None:
        """Calls a function on the current stream."""
        if self._device.type != "cuda":
            function(*size)
            return
        key = function.__func__, id(function.__self__), *size
        if key in self._graphs:
            self._graphs[key].replay()
            return
        function(*size)  # compiles; recording does nothing yet
        torch.cuda.synchronize(self._device)
        self._pool = self._pool or torch.cuda.graph_pool_handle()
        self._graphs[key], stream = torch.cuda.CUDAGraph(), torch.cuda.current_stream(self._device)
        with torch.cuda.graph(self._graphs[key], self._pool, stream, "thread_local"):
            function(*size)

    def some(self, function, needed: torch.Tensor) -> None:
        """Calls a function with the size for the worlds (N,) that need it, where any do."""
        if count := int(needed.count_nonzero()):
            self(function, min(max(LEAST_SIZE, 1 << (count - 1).bit_length()), len(needed)))


def first(needed: torch.Tensor, size: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Indices (size,) of the worlds (N,) that need something, then of others, and which of them do."""
    worlds = torch.argsort(needed.to(torch.uint8), descending=True, stable=True)[:size]
    return worlds, needed[worlds]


class PixelCount:
    """Counts pixels in contact of light on the probe grid without drawing images.

    Args:
        model: of the gel.
        device: of Warp.
    """

    def __init__(self, model: GelModel, device):
        h, w = model.rest_image.shape[:2]
        (i, f), (j, e) = _cells_of(h, ROWS), _cells_of(w, COLS)
        self._device, self._limit, self._shape = device, int(3 * model.threshold_levels), (h,)
        arrays = (model.rest_image, model.weight, i, f, j, e)
        types = (wp.uint8, float, int, float, int, float)
        pairs = zip(arrays, types, strict=True)
        self._image = [wp.array(np.ascontiguousarray(a), dtype=t, device=device) for a, t in pairs]

    def of(self, light: torch.Tensor) -> torch.Tensor:
        """Pixels (B,), int32, of `TactileBatch.light` (B, 3, 80, 59)."""
        out = torch.zeros(len(light), dtype=torch.int32, device=light.device)
        inputs = [wp.from_torch(light.contiguous()), *self._image, self._limit, wp.from_torch(out)]
        wp.launch(_pixels, (len(light), *self._shape), inputs, device=self._device)
        return out


class ContactBatch:
    """What the gel of one twin feels of the same objects in N worlds.

    Args:
        law: force of the gel.
        window_mm: of the probe grid.
        thickness_mm: of it.
        geoms: ids (n,) of the objects in MuJoCo's model.
        kinds: (n,) shapes, see `gel.probe`.
        sizes: (n, 3) m.
        gel: id of the gel's site.
        data: MuJoCo Warp's, whose kinematics are read.
        device: of Warp.
        free: spring where nothing is near.

    Raises InputError: an object is a mesh or a cone.
    """

    def __init__(
        self, law: GelForce, window_mm, thickness_mm, geoms, kinds, sizes, gel: int, data, device, free
    ):
        if not np.isin(kinds, KINDS).all():
            raise InputError(
                "Many worlds at once feel boxes, capsules, cylinders, ellipsoids and spheres; this task has a"
                " mesh. Use the single world, `World`."
            )
        self._scene = scene = _Scene()
        scene.kinds = wp.array(np.asarray(kinds), dtype=int, device=device)
        scene.sizes = wp.array(np.asarray(sizes, np.float32), dtype=wp.vec3, device=device)
        scene.geoms = wp.array(np.asarray(geoms), dtype=int, device=device)
        scene.positions, scene.rotations, scene.gel = data.geom_xpos, data.geom_xmat, gel
        scene.gel_positions, scene.gel_rotations = data.site_xpos, data.site_xmat
        self._device, self._torch, n = device, wp.device_to_torch(device), data.nworld
        self._window, self._reach = window_mm, 1e-3 * thickness_mm
        self._law, self._gel_window = law, law.window_mm
        nu, G = law.poissons_ratio, law.shear_modulus_mpa
        near = np.stack([(1 - nu) / (2 * np.pi * G) * spring._near(a) for a in (1, 2, 4)])
        hidden = spring._hidden(law.thickness_mm, nu) / G
        self._near = wp.array(near.astype(np.float32), dtype=float, device=device)
        self._hidden = wp.array(hidden.astype(np.float32), dtype=float, device=device)
        self._hidden_0 = float(hidden[0])
        self._near_0 = self._sent(near[:, 0, 0])
        self._grid, self._first = (
            wp.empty((n, *s), dtype=float, device=device) for s in ((ROWS, COLS), spring.LOOK)
        )
        self.depth_mm = wp.to_torch(self._grid)  # (N, 80, 59), of the last `look`
        self._free, self._ahead = free, (1e-3 * spring.REACH_MM, 1e-3 * (law.thickness_mm + spring.REACH_MM))
        self.spring = tuple(torch.zeros(n, device=self._torch) for _ in range(3))
        self._no_cells = self._sent([1, 0, 0, 0, 1, 1, 0, 1])  # no rows, see `_place`
        self._deepest = torch.zeros(n, device=self._torch)
        self._near_face = torch.zeros(n, dtype=torch.bool, device=self._torch)

    def _sent(self, array) -> torch.Tensor:
        return torch.tensor(np.asarray(array), dtype=torch.float32, device=self._torch)

    def _launch(self, out: wp.array, window_mm, ahead: float, reach: float) -> None:
        cell = [1e-3 * window_mm[0] / out.shape[2], 1e-3 * window_mm[1] / out.shape[1]]
        wp.launch(_grids, out.shape, [self._scene, *cell, ahead, reach, out], device=self._device)

    def look(self) -> torch.Tensor:
        """Probe grids (N, 80, 59) in mm of the present kinematics; the next call overwrites them."""
        self._launch(self._grid, self._window, 0.0, self._reach)
        return self.depth_mm

    def springs(self, play: Playback) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Springs of the face, as `GelSpring.of` finds them: k1 (N,) N/m, k3 (N,) N/m^3, depth (N,) m.

        The same tensors each time. `play` calls the parts.
        """
        play(self._look_ahead)
        play.some(self._solve, self._near_face)
        return self.spring

    def _look_ahead(self) -> None:
        self._launch(self._first, self._gel_window, *self._ahead)
        self._deepest.copy_(wp.to_torch(self._first).amax((1, 2)))
        self._near_face.copy_(self._deepest > -spring.REACH_MM)
        free = self._free.k1, self._free.k3, self._free.depth_m
        for tensor, value in zip(self.spring, free, strict=True):
            tensor.fill_(value)

    def _solve(self, count: int) -> None:
        """Springs of the worlds with something near, of which there are at most `count`."""
        worlds, near = first(self._near_face, count)
        seen, deepest = wp.to_torch(self._first)[worlds], self._deepest[worlds]
        x = deepest.clamp(spring.LEAST_MM, spring.DEEPEST_MM)
        boxes = _place(seen > (deepest - spring.FURTHER * x)[:, None, None], self._gel_window)
        boxes = torch.where(near[:, None], boxes, self._no_cells)
        box, C = (x.new_empty((count, SLOTS, n)) for n in (spring.FINE**2, SLOTS))
        boxes_wp, worlds_wp, box_wp, C_wp = map(wp.from_torch, (boxes, worlds, box, C))
        fine = [self._scene, worlds_wp, boxes_wp, *self._ahead, box_wp]
        wp.launch(_cells, box.shape, fine, device=self._device)
        wp.launch(_compliances, C.shape, [self._near, self._hidden, boxes_wp, C_wp], device=self._device)
        deepest = box.amax((1, 2))
        held, load = self._held(boxes), torch.zeros_like(box[..., 0])
        here, load = self._force(box + (x - deepest)[:, None, None], C, boxes, held, load)
        there, _ = self._force(box + (spring.FURTHER * x - deepest)[:, None, None], C, boxes, held, load)
        power = (torch.log(there / here) / math.log(spring.FURTHER)).clamp(1.0, 3.0)  # F ~ x^power
        x = 1e-3 * x
        secant = here / x
        found = secant * (3 - power) / 2, secant * (power - 1) / 2 / x**2, x
        for tensor, value in zip(self.spring, found, strict=True):
            tensor[worlds] = torch.where(near, value, tensor[worlds])

    def _held(self, boxes: torch.Tensor) -> torch.Tensor:
        """`gel.spring._held` of the cells (contacts, SLOTS)."""
        c, s, u, v, h, aspect, rows, cols = (b[:, None] for b in boxes.T)
        k = torch.arange(SLOTS, device=boxes.device)[None]
        i, j = torch.div(k, cols, rounding_mode="floor"), k % cols
        u, v = u + (j + 0.5 - cols / 2) * aspect * h, v + (i + 0.5 - rows / 2) * h
        out, fades = torch.ones_like(u), RIM_SHARE * self._law.thickness_mm
        for at, size in zip(((c * u - s * v).abs(), (s * u + c * v).abs()), self._gel_window, strict=True):
            near = 1 - RIM * torch.exp((at - size / 2).clamp(max=0) / fades)
            out *= near * (1 - RIM * torch.exp(-(size / 2 + at) / fades))
        return out

    def _force(self, z, C, boxes, held, load) -> tuple[torch.Tensor, torch.Tensor]:
        """`gel.spring._force` at depths z (contacts, SLOTS, FINE^2) mm: N (contacts,) and cells' loads."""
        h, aspect = boxes[:, 4:5], boxes[:, 5:6]
        touched = (z > 0).sum(2)
        d, part = z.clamp(min=0).sum(2) / touched.clamp(min=1), touched / spring.FINE**2
        on = touched > 0
        side = part.clamp(min=1 / spring.FINE**2).sqrt()
        diagonal = self._near_0[(aspect / 2).long()] / (h * side) + self._hidden_0
        load = torch.where(on, load, 0.0)
        f = _contact(C, diagonal, d, on, torch.where(load.sum(1, keepdim=True) > 0, load, d * part))
        total, weighted = f.sum(1), (f * d).sum(1)
        squares = (f * f / (part.clamp(min=1 / spring.FINE**2) * aspect * h * h)).sum(1)
        radius = total / (squares * math.pi).sqrt()
        stuck = STICKS * weighted / total * radius / self._law.thickness_mm**2
        return (f * held).sum(1) * (1 + stuck), f


def _place(touched: torch.Tensor, window_mm) -> torch.Tensor:
    """`gel.spring._place` of touched cells (B, rows, columns).

    Returns:
        (B, 8): cosine and sine of the longer axis, the box's middle along both axes in mm, a cell's shorter
        edge in mm and how many times longer the other is, and the rows and columns of cells, at most `SLOTS`.
    """
    rows, cols = touched.shape[1:]
    cell_x, cell_y = window_mm[0] / cols, window_mm[1] / rows
    on, device = touched.float(), touched.device
    u = ((torch.arange(cols, device=device) + 0.5 - cols / 2) * cell_x).expand(rows, cols)
    v = ((torch.arange(rows, device=device) + 0.5 - rows / 2) * cell_y)[:, None].expand(rows, cols)
    n, x, y, xx, yy, xy = ((on * q).sum((1, 2)) for q in (u * 0 + 1, u, v, u * u, v * v, u * v))
    turn = 0.5 * torch.atan2(2 * (xy - x * y / n), xx - x * x / n - yy + y * y / n)
    c, s = torch.cos(turn), torch.sin(turn)
    a = c[:, None, None] * u + s[:, None, None] * v
    b = c[:, None, None] * v - s[:, None, None] * u
    # Half of a cell's shadow on the axes.
    shadows = 0.5 * (c.abs() * cell_x + s.abs() * cell_y), 0.5 * (s.abs() * cell_x + c.abs() * cell_y)
    ends = [
        (torch.where(touched, q, 1e9).amin((1, 2)) - half, torch.where(touched, q, -1e9).amax((1, 2)) + half)
        for q, half in zip((a, b), shadows, strict=True)
    ]
    middle, (long, short) = [0.5 * (low + high) for low, high in ends], [high - low for low, high in ends]
    aspect = torch.where(long > 8 * short, 4.0, torch.where(long > 2 * short, 2.0, 1.0))
    size = (n * (cell_x * cell_y / spring.CELLS) / aspect).sqrt()
    size = torch.maximum(size, torch.maximum(long / aspect, short) / spring.MOST)

    def edges(size):
        cells = short / size, long / (aspect * size)
        return [torch.ceil(n - 1e-4).clamp(min=1) for n in cells]

    for _ in range(GROWTHS):
        high, wide = edges(size)
        size = torch.where(high * wide > SLOTS, GROW * size, size)
    return torch.stack([c, s, *middle, size, aspect, *edges(size)], 1).contiguous()


def _contact(C, diagonal, d, on, p) -> torch.Tensor:
    """`gel.spring._contact` of B contacts: loads p (B, SLOTS) >= 0 with gaps >= 0, one of them zero.

    Args:
        C: (B, SLOTS, SLOTS) compliances without their diagonal.
        diagonal: (B, SLOTS).
        d: depths (B, SLOTS).
        on: (B, SLOTS) bool, the cells that are touched.
        p: first guess, zero where untouched.
    """

    def moved(p):
        return torch.bmm(C, p[..., None])[..., 0] + diagonal * p

    p = p * ((p * d).sum(1) / (p * moved(p)).sum(1))[:, None]
    tolerance = spring.TOLERANCE * d.amax(1)
    t, before = torch.zeros_like(p), torch.zeros_like(tolerance)
    for n in range(spring.ITERATIONS):
        g = torch.where(on, moved(p) - d, 0.0)
        carries = p > 0
        inside = torch.where(carries, g, 0.0)
        worst = torch.where(carries, g.abs(), -g).amax(1)
        active = worst >= tolerance
        asks = n % CHECK_EVERY == CHECK_EVERY - 1 and C.device.type == "cpu"  # a GPU would be waited for
        if asks and not active.any():
            break
        norm = (inside * inside).sum(1)
        share = torch.where(before > 0, norm / before.clamp(min=1e-30), 0.0)
        t = inside + torch.where(carries, share[:, None] * t, 0.0)
        length = ((t * g).sum(1) / (t * moved(t)).sum(1).clamp(min=1e-30))[:, None]
        new = (p - length * t).clamp(min=0)
        joins = on & (new == 0) & (g < 0)  # and the directions of search start afresh
        new = torch.where(joins, -length * g, new)
        before = torch.where(joins.any(1), 0.0, norm)
        p = torch.where(active[:, None], new, p)
    return p
