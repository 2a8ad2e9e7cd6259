"""Tactile images of many probe grids at once, as PyTorch tensors on a GPU or on the CPU.

The same equations as `gel.surface`, `gel.optics` and `gel.residual`, and the same numbers up to rounding:
a pixel differs by one level at most.
"""

import math

import cv2
import numpy as np
import torch
from torch.nn import functional as F

from pneutac_sim.effects.photometric_nonlinearity import ACROSS, ALONG, DEEP, DIRECT
from pneutac_sim.effects.shadow import EDGE, LEVEL, SLOPE
from pneutac_sim.errors import InputError
from pneutac_sim.gel import residual
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.optics import towards_light
from pneutac_sim.gel.probe import COLS, ROWS
from pneutac_sim.gel.residual import ResidualField
from pneutac_sim.gel.surface import over_relaxation, resolutions
from pneutac_sim.twin import Twin


class CastShadows:
    """`effects.shadow.cast` of some channels: all cells hand on the shadow's height at once, again and again.

    That is done as often as a shadow may be handed on across the window, or until one of the deepest imprint
    has ended.

    Args:
        towards: x and y in mm from each cell to each channel's light, (2, channels, 80, 59).
        slope: tan(elevation) of each light.
        cell_mm: grid spacing along x and y.
        device: of PyTorch.
    """

    def __init__(self, towards, slope, cell_mm, device):
        hx, hy = cell_mm
        k, i, j = np.indices(towards.shape[1:])
        ex, ey = towards
        di, dj = np.where(ey > 0, 1, -1), np.where(ex > 0, 1, -1)
        px, py = np.abs(ex) / hx, np.abs(ey) / hy
        wide = px >= py  # it leaves through the neighbouring column
        near_i, near_j = np.where(wide, i, i + di), np.where(wide, j + dj, j)
        leaves = (near_i < 0) | (near_i >= ROWS) | (near_j < 0) | (near_j >= COLS)

        def index(a, b):
            return (k * ROWS + a.clip(0, ROWS - 1)) * COLS + b.clip(0, COLS - 1)

        near, other = index(near_i, near_j), index(i + di, j + dj)
        outside = (i + di < 0) | (i + di >= ROWS) | (j + dj < 0) | (j + dj >= COLS)
        other = np.where(outside, near, other)
        steep = np.maximum(np.maximum(px, py), 1e-9)
        f = np.minimum(px, py) / steep
        drop = slope[:, None, None] * np.hypot(ex, ey) / steep

        def sent(a):
            return torch.tensor(a.reshape(-1, 1), dtype=torch.float32, device=device)

        self._cells = torch.tensor(np.stack([near, other]).reshape(-1), device=device)
        self._f, self._drop = sent(f), sent(np.where(leaves, np.inf, drop))
        # From all around a near light it goes to and fro between rows and columns.
        self._most = ROWS + COLS if np.ptp(towards, (2, 3)).any() else max(ROWS, COLS)
        self._least_mm = max(drop.min(initial=np.inf, where=~leaves), 1e-9)

    def cast(self, u: torch.Tensor, deepest: float) -> torch.Tensor:
        """Heights in mm over surfaces (B, rows, columns) of `deepest` mm, (B, channels, rows, columns)."""
        flat = u.reshape(len(u), -1).T
        channels = len(self._f) // len(flat)
        S = flat.repeat(channels, 1)
        for _ in range(min(self._most, math.ceil(deepest / self._least_mm))):
            near, other = S.index_select(0, self._cells).view(2, *S.shape)
            S = torch.maximum(S, torch.lerp(near, other, self._f).sub_(self._drop))
        return (S.T.reshape(len(u), channels, -1) - flat.T[:, None]).reshape(len(u), channels, *u.shape[1:])


DEPTH_LIGHT = 2  # c_d of a channel's row of coefficients, see `gel.optics`
WARM_UP = 3  # runs before a CUDA graph is recorded
DEEPER_MM = 0.5  # steps of the deepest imprint for which one is recorded


class TactileBatch:
    """`TactileSensor.image` of B probe grids.

    On CUDA the work is recorded once for each size of a batch and half millimetre of its deepest imprint, and
    played back, since it is many small steps.

    Args:
        twin: a twin with a gel, or its gel alone; the generated DIGIT where it is None or has none.
        device: of PyTorch, such as `cuda` or `cpu`.

    Attributes:
        model: the gel's sizes, mechanics and light.

    Raises InputError: an effect of another package acts on the surface or the light, or there is no such
    device.
    """

    def __init__(self, twin: Twin | GelModel | None = None, device: str | torch.device = "cuda"):
        self.model = m = twin if isinstance(twin, GelModel) else GelModel.from_twin(twin)
        foreign = [e.name for e, _ in m.acting if e.surface or e.light]
        if foreign:
            raise InputError(
                f"Effects of other packages do not act on a batch of tactile images: {', '.join(foreign)}; "
                "use TactileSensor, or take them out."
            )
        if torch.device(device).type == "cuda" and not torch.cuda.is_available():
            raise InputError("PyTorch finds no CUDA device; give device='cpu'.")
        self._device = torch.device(device)
        width, height = m.window_mm
        self._cell_mm = width / COLS, height / ROWS
        coefficients, _, residual_light = m.lighting
        self._light = _Light(coefficients, self._cell_mm, residual_light is not None, self._device)
        fields = [f for f in (m.prior_residual, m.residual) if f is not None]
        self._fields = [_Field(f, self._cell_mm, self._device) for f in fields]
        self._share = self._sent(m.field_share) if fields else None
        self._rest, self._weight = self._sent(m.rest_image), self._sent(m.weight)
        self._recorded: dict[tuple[int, float], tuple] = {}

    def image(self, depth_mm) -> torch.Tensor:
        """Tactile images, uint8 (B, H, W, 3) on the device, of probe grids (B, 80, 59), a tensor or array.

        On CUDA the next call with a batch of this size overwrites them.

        Raises ValueError: another shape.
        """
        depth = torch.as_tensor(depth_mm, dtype=torch.float32, device=self._device)
        if depth.ndim != 3 or depth.shape[1:] != (ROWS, COLS):
            raise ValueError(f"probe grids have shape (B, {ROWS}, {COLS}); got {tuple(depth.shape)}")
        with torch.no_grad():
            deepest = DEEPER_MM * math.ceil(depth.max().item() / DEEPER_MM) if len(depth) else 0.0
            if self._device.type != "cuda" or not len(depth):
                return self._image(depth, deepest)
            key = len(depth), deepest
            if key not in self._recorded:
                self._recorded[key] = self._record(depth, deepest)
            graph, given, image = self._recorded[key]
            given.copy_(depth)
            graph.replay()
            return image

    def _record(self, depth: torch.Tensor, deepest: float) -> tuple:
        """A CUDA graph, the tensor that it reads and the one that it writes."""
        given, aside = depth.clone(), torch.cuda.Stream(self._device)
        aside.wait_stream(torch.cuda.current_stream(self._device))
        with torch.cuda.stream(aside):
            for _ in range(WARM_UP):
                self._image(given, deepest)
        torch.cuda.current_stream(self._device).wait_stream(aside)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            image = self._image(given, deepest)
        return graph, given, image

    def _image(self, depth: torch.Tensor, deepest: float) -> torch.Tensor:
        return self.draw(self.surface(self.imprint(depth)), deepest)

    def surface(self, imprint_mm: torch.Tensor) -> torch.Tensor:
        """The analytic surface, `gel.surface.surface`, of imprints (B, 80, 59), mm."""
        return surfaces(imprint_mm, self._cell_mm, self.model.decay_mm)

    def imprint(self, depth_mm: torch.Tensor) -> torch.Tensor:
        """`GelModel.imprint` of probe grids (B, 80, 59), mm."""
        drawn_back = (1 - self.model.depth_scale) * depth_mm.amax((1, 2), keepdim=True)
        return (depth_mm - drawn_back).clamp(min=0)

    def light(self, displacement_mm: torch.Tensor, deepest: float) -> torch.Tensor:
        """Light (B, 3, 80, 59) in levels of surfaces (B, 80, 59) that are at most `deepest` mm pressed in."""
        light, shadows = self._light.of(displacement_mm, deepest)
        for field in self._fields:
            light += self._share * field.levels(displacement_mm, shadows)
        return light

    def draw(self, displacement_mm: torch.Tensor, deepest: float) -> torch.Tensor:
        """Images uint8 (B, H, W, 3) of surfaces, as `light` takes them."""
        light = self.light(displacement_mm, deepest)
        pixels = F.interpolate(
            light.contiguous(memory_format=torch.channels_last), self._rest.shape[:2], mode="bilinear"
        ).permute(0, 2, 3, 1)
        return torch.addcmul(self._rest + 0.5, self._weight, pixels).clamp_(0, 255).to(torch.uint8)

    def _sent(self, array: np.ndarray) -> torch.Tensor:
        return torch.tensor(array, dtype=torch.float32, device=self._device)


def surfaces(depth_mm: torch.Tensor, cell_mm: tuple[float, float], decay_mm: float) -> torch.Tensor:
    """`gel.surface.surface` of depths (B, rows, columns) mm, the same sweeps."""
    rows, cols = depth_mm.shape[1:]
    u = None
    for level in reversed(range(resolutions((rows, cols), cell_mm, decay_mm))):
        f = 1 << level
        o = depth_mm[:, None]
        if f > 1:
            o = F.avg_pool2d(o, f, ceil_mode=True, count_include_pad=False)
        o = o[:, 0]
        n, m = o.shape[1:]
        start, sweeps = o, 30
        if u is not None:
            finer = u.repeat_interleave(2, 1)[:, :n].repeat_interleave(2, 2)[:, :, :m]
            start, sweeps = torch.maximum(o, finer), 12
        kx, ky, omega = over_relaxation((cell_mm[0] * f, cell_mm[1] * f), decay_mm)
        scale = 1 / (1 + 2 * (kx + ky))
        odd = (torch.arange(n, device=o.device)[:, None] + torch.arange(m, device=o.device)) % 2
        steps = omega * odd, omega * (1 - odd)
        u = start
        for sweep in range(2 * sweeps):
            p = F.pad(u[:, None], (1, 1, 1, 1), mode="replicate")[:, 0]
            x = (p[:, 1:-1, :-2] + p[:, 1:-1, 2:]).mul_(kx * scale)
            x.add_(p[:, :-2, 1:-1] + p[:, 2:, 1:-1], alpha=ky * scale)
            u = torch.maximum(o, torch.lerp(u, x, steps[sweep % 2]))
    return u


class _Light:
    """`gel.optics.light` of three channels, without what effects of other packages make of it.

    With `all_shadows` also those of channels that they do not darken, which a residual field reads.
    """

    def __init__(self, coefficients, cell_mm, all_shadows, device):
        self._cell_mm = cell_mm
        towards = towards_light(coefficients, (ROWS, COLS), cell_mm)
        e = towards / np.maximum(np.hypot(*towards), 1e-9)
        columns = np.concatenate([coefficients, np.hypot(*coefficients[:, :2].T)[:, None]], 1)
        self._ex, self._ey = torch.tensor(e, dtype=torch.float32, device=device)
        self._c = torch.tensor(columns.T[..., None, None], dtype=torch.float32, device=device)
        self._linear = np.isinf(coefficients[:, DIRECT]).tolist()
        shadowed = coefficients[:, LEVEL] > 0
        cast = np.flatnonzero(shadowed | all_shadows)
        self._shadows = CastShadows(towards[:, cast], coefficients[cast, SLOPE], cell_mm, device)
        self._cast = torch.tensor(cast, device=device)
        self._dark = torch.tensor(shadowed[:, None, None], device=device)

    def of(self, u: torch.Tensor, deepest: float) -> tuple[torch.Tensor, torch.Tensor]:
        """Light and height in mm of the shadow, zero where none was asked for, (B, 3, rows, columns) each.

        Of surfaces (B, rows, columns) in mm that are at most `deepest` mm pressed in.
        """
        c, (gx, gy) = self._c, slopes(u, self._cell_mm)
        gx, gy, u = gx[:, None], gy[:, None], u[:, None]
        along, across = self._ex * gx + self._ey * gy, self._ex * gy - self._ey * gx
        t = -c[-1] * along
        shade = torch.rsqrt(1 + gx * gx + gy * gy)

        def of(k, direct):
            return direct * ((1 + t[:, k] / direct).clamp(min=0) * shade[:, 0] - 1)

        lit = [t[:, k] if linear else of(k, c[DIRECT, k]) for k, linear in enumerate(self._linear)]
        s = torch.stack(lit, 1)
        heights = torch.zeros_like(s)
        if len(self._cast):
            heights = heights.index_copy(1, self._cast, self._shadows.cast(u[:, 0], deepest))
            d = (heights.clamp(min=0) / c[EDGE]).clamp(max=1)
            s = torch.where(self._dark, s - d * d * (3 - 2 * d) * (s + c[LEVEL]), s)
        s += c[DEPTH_LIGHT] * u + c[ALONG] * along**2 + c[ACROSS] * across**2 + c[DEEP] * u**2
        return s, heights


class _Field:
    """`gel.residual.levels` of one field."""

    def __init__(self, field: ResidualField, cell_mm, device):
        def sent(a):
            return torch.tensor(a, dtype=torch.float32, device=device)

        squares = np.square(field.centres).sum(-1, keepdims=True)
        # so that one product of (z, -|z|^2 / 2, 1) with these is -|z - z_j|^2 / 2
        self._centres = sent(
            np.concatenate([field.centres, np.ones_like(squares), -squares / 2], -1).transpose(0, 2, 1)
        )
        self._weights, self._reach = sent(field.weights), sent(field.reach((ROWS, COLS), cell_mm))
        self._places = sent(residual.places((ROWS, COLS), cell_mm).transpose(2, 0, 1))
        self._blur = [
            sent(_blur(n, residual.BLUR_MM / h)) for n, h in ((ROWS, cell_mm[1]), (COLS, cell_mm[0]))
        ]
        self._cell_mm = cell_mm

    def levels(self, u: torch.Tensor, shadows: torch.Tensor) -> torch.Tensor:
        """(B, 3, rows, columns) of surfaces (B, rows, columns) and their shadows' heights, by channel."""
        gx, gy = slopes(u, self._cell_mm)
        blurred = self._blur[0] @ u @ self._blur[1].T
        x, y = self._places.expand(len(u), *self._places.shape).unbind(1)
        z = [gx / residual.SLOPE, gy / residual.SLOPE, u / residual.DEPTH_MM, blurred / residual.DEPTH_MM]
        share = (u / residual.MOVED_MM).clamp(max=1) * (u > residual.LEAST_MM)
        out = []
        for k in range(3):
            features = torch.stack([*z, shadows[:, k] / residual.SHADOW_MM, x, y], -1).view(
                -1, residual.FEATURES
            )
            half = -features.square().sum(-1, keepdim=True) / 2
            kernel = torch.cat([features, half, torch.ones_like(half)], -1) @ self._centres[k]
            out.append(share * self._reach[k] * (kernel.exp_() @ self._weights[k]).view(u.shape))
        return torch.stack(out, 1)


def _blur(n: int, sigma: float) -> np.ndarray:
    """OpenCV's Gaussian blur of n cells in a row, (n, n)."""
    return cv2.GaussianBlur(
        np.eye(n, dtype=np.float32), (1, 0), 1, sigmaY=sigma, borderType=cv2.BORDER_REFLECT
    )


def slopes(u: torch.Tensor, cell_mm: tuple[float, float]) -> tuple[torch.Tensor, torch.Tensor]:
    """du/dx and du/dy of surfaces (B, rows, columns); one-sided at the rim."""
    gy, gx = torch.gradient(u, spacing=(cell_mm[1], cell_mm[0]), dim=(1, 2))
    return gx, gy
