"""A first fit to silhouettes alone: the body bends as its spine does, without material points.

The surface is carried along by the links and drawn, and its coverage is compared with the masks, both
blurred: widely first, so that silhouettes that do not overlap attract each other, then less. Bounded least
squares do the rest, since the difference is smooth in the joint angles. What the links leave out is then
taken from material points at rest at the parameters found, and the last fit repeated. Last come Gauss-Newton
steps with derivatives from material points: those of the links are too wrong to separate the joints.
"""

from dataclasses import dataclass, replace
from itertools import product

import cv2
import numpy as np
from scipy.optimize import least_squares, lsq_linear

from pneutac_sim.errors import InputError
from pneutac_sim.mpm.devices import BODIES
from pneutac_sim.photo_fit.equilibria import Bodies, BodyParameters, Equilibria, joint_targets
from pneutac_sim.photo_fit.objective import MaskedPhotograph, Outline
from pneutac_sim.splat.body import check_photograph
from pneutac_sim.splat.camera import Camera

BLURS = (0.12, 0.03, 0.01)  # standard deviations over the square root of the mask's area times 3
BENDS_RAD = np.linspace(-1.2, 2.4, 7)  # of a whole finger, tried at the lowest and the highest pressure
PARTICLES = 1500
PIXELS = 160  # of a body's length, to which photographs are reduced
LEAST_IOU = 0.4  # of silhouettes; with less in common the photograph is of something else
STEPS = 3  # of Gauss-Newton by material points
SMALL = 0.05  # of the first step, for differences
MOVE = 0.25  # the same by material points, which come to rest within a tolerance


@dataclass(frozen=True)
class Coarse:
    """What silhouettes determine."""

    x: np.ndarray  # (P,) coordinates; the material's are those of the twin
    # (P, P) of half the squared difference at the least blur, coordinates; material's rows are 0
    hessian: np.ndarray


class Skinned:
    """A body's surface that is carried along by its spine's links, at pressures (T, chambers) kPa.

    Candidates differ in `parameters`; `conditions` are what effects of the twin ask for.
    """

    def __init__(
        self,
        parameters: BodyParameters,
        pressures: np.ndarray,
        photographs: list[MaskedPhotograph],
        conditions: dict | None = None,
        device: str = "auto",
    ):
        self.parameters, self.pressures, self.conditions = parameters, pressures, conditions
        self.device = device
        self.photographs = [reduced(p) for p in photographs]
        self.spine = BODIES[parameters.twin.device](parameters.twin, particles=PARTICLES, device=device).spine
        self.outline = Outline(parameters.twin)
        self._left_out = 0.0

    def correct(self, x: np.ndarray) -> Equilibria:
        """Takes what the links leave out from material points at rest at `x` (P,)."""
        self._left_out = 0.0
        rest = Equilibria(self.parameters, x, self.pressures, self.conditions, PARTICLES, self.device)
        self._left_out = self.surfaces(rest, rest.first)[0] - self.positions(x)
        return rest

    def surfaces(self, rest: Equilibria, bodies: Bodies) -> np.ndarray:
        """(K, T, V, 3) m of bodies of material points."""
        follow = self.outline.on(rest.body)
        return np.stack([follow(*b) for b in zip(bodies.positions, bodies.gradients, strict=True)])

    def positions(self, x: np.ndarray) -> np.ndarray:
        """(T, V, 3) m of the surface of one candidate (P,)."""
        twin = self.parameters.twin_at(x)
        q = joint_targets(twin, self.pressures, self.conditions)
        return self.spine.skin(q, self.outline.vertices) + self._left_out

    def coverage(self, at: np.ndarray, photograph: MaskedPhotograph) -> np.ndarray:
        """(H, W) of surfaces at (T, V, 3) m as this reduced photograph's camera sees them."""
        return self.outline.coverage(at[photograph.state], photograph.camera)

    def differences(self, at: np.ndarray, blur: float) -> np.ndarray:
        """Coverage less mask of every photograph, blurred (see `BLURS`) and thinned, one long vector.

        Of surfaces at (T, V, 3) m.
        """
        parts = []
        for p in self.photographs:
            parts.append(thin(self.coverage(at, p) - p.mask, blur * reach(p.mask)).ravel())
        return np.concatenate(parts)


def reduced(photograph: MaskedPhotograph) -> MaskedPhotograph:
    """The photograph with fewer pixels, where the body is longer than `PIXELS`."""
    camera, factor = photograph.camera, max(1.0, reach(photograph.mask) / PIXELS)
    size = (round(camera.width / factor), round(camera.height / factor))
    scale = np.diag([size[0] / camera.width, size[1] / camera.height, 1.0])
    small = Camera(scale @ camera.intrinsics, camera.extrinsics, *size, camera.distortion)
    mask = cv2.resize(photograph.mask.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    return replace(photograph, camera=small, mask=mask)


def reach(mask: np.ndarray) -> float:
    """Roughly the length of a body in pixels: three times the square root of its area."""
    return 3 * float(np.sqrt(mask.sum()))


def thin(picture: np.ndarray, sigma: float) -> np.ndarray:
    """A picture (H, W) blurred by `sigma` px and sampled about once a `sigma`, of the same sum of squares."""
    stride = max(1, int(sigma))
    return stride * cv2.GaussianBlur(picture, (0, 0), sigma)[stride // 2 :: stride, stride // 2 :: stride]


def coarse_fit(
    parameters: BodyParameters,
    pressures: np.ndarray,
    photographs: list[MaskedPhotograph],
    conditions: dict | None = None,
    device: str = "auto",
) -> Coarse:
    """Actuation parameters from silhouettes at pressures (T, chambers) kPa; the material stays.

    Raises InputError: a photograph shows no such body.
    """
    model = Skinned(parameters, pressures, photographs, conditions, device)
    tried = [np.clip(x, parameters.lower, parameters.upper) for x in _starts(parameters, pressures)]
    x = min(tried, key=lambda x: np.square(model.differences(model.positions(x), BLURS[0])).sum())
    for blur in BLURS:
        x = _fit_skinned(model, x, blur)
    _check(model, x, photographs)
    model.correct(x)
    return _refine(model, _fit_skinned(model, x, BLURS[-1]))


def _fit_skinned(model: Skinned, x: np.ndarray, blur: float) -> np.ndarray:
    """(P,) from `x` on, by bounded least squares at one blur; the material's coordinates stay."""
    parameters = model.parameters
    free = parameters.of_pose

    def misfit(y):
        return model.differences(model.positions(_whole(parameters, x, y)), blur)

    def jacobian(y):
        steps, here = _steps(parameters, y, SMALL), misfit(y)
        return np.stack([misfit(y + s) - here for s in steps], 1) / np.diag(steps)

    found = least_squares(
        misfit,
        x[free],
        jacobian,
        bounds=(parameters.lower[free], parameters.upper[free]),
        x_scale=parameters.step[free],
        xtol=1e-4,
        ftol=1e-4,
        max_nfev=25,
    )
    return _whole(parameters, x, found.x)


def _refine(model: Skinned, x: np.ndarray) -> Coarse:
    parameters = model.parameters
    free, lower, upper = parameters.of_pose, parameters.lower, parameters.upper
    scale = parameters.step[free]
    least, hessian = np.inf, np.zeros((len(x), len(x)))
    rest = model.correct(x)
    for _ in range(STEPS):
        steps = _steps(parameters, x[free], MOVE)
        candidates = np.stack([x, *(_whole(parameters, x, x[free] + s) for s in steps)])
        surfaces = model.surfaces(rest, rest.solve(candidates))
        pictures = np.stack([model.differences(at, BLURS[-1]) for at in surfaces])
        if np.square(pictures[0]).sum() > least:
            break
        best, least = x, np.square(pictures[0]).sum()
        # min |J dx + r|^2 between the bounds, H = J^T J
        J = (pictures[1:] - pictures[0]).T / np.diag(steps)
        hessian[np.ix_(free, free)] = J.T @ J
        bounds = ((lower - x)[free] / scale, (upper - x)[free] / scale)
        x = _whole(parameters, x, x[free] + scale * lsq_linear(J * scale, -pictures[0], bounds).x)
    return Coarse(best, hessian)


def _whole(parameters: BodyParameters, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """`x` (P,) with the pose's coordinates (F,) in it, inside the bounds."""
    out = x.copy()
    out[parameters.of_pose] = y
    return np.clip(out, parameters.lower, parameters.upper)


def _steps(parameters: BodyParameters, y: np.ndarray, share: float) -> np.ndarray:
    """(F, F) a share of the first step along each of the pose's coordinates, to the inside of the bounds."""
    free = parameters.of_pose
    scale = parameters.step[free]
    return np.diag(share * np.where(y + share * scale < parameters.upper[free], scale, -scale))


def _check(model: Skinned, x: np.ndarray, photographs: list[MaskedPhotograph]) -> None:
    at = model.positions(x)
    for p, small in zip(photographs, model.photographs, strict=True):
        try:
            check_photograph(at[p.state], p.image, p.mask, p.camera)
        except InputError as e:
            raise InputError(f"{p.name}: {e}") from e
        drawn, mask = model.coverage(at, small) > 0.5, small.mask > 0.5
        iou = (drawn & mask).sum() / max((drawn | mask).sum(), 1)
        if iou < LEAST_IOU:
            raise InputError(
                f"{p.name}: the twin's silhouette overlaps the mask by {iou:.0%} at best; check the camera "
                "(extrinsics from base to camera, in metres), the twin's length and mesh, and the mask."
            )


def _starts(parameters: BodyParameters, pressures: np.ndarray) -> list[np.ndarray]:
    """The twin's own parameters, and a grid of bends (finger) or of gains and directions (arm)."""
    own = parameters.coordinates(parameters.twin)
    names = list(parameters.names)
    joints = len(parameters.twin.spine_joint_positions_mm)
    out = [own]
    if "rest_pressure_kpa" in names:
        low, high = pressures.min(), pressures.max()
        for first, last in product(BENDS_RAD, BENDS_RAD):
            if first == last:
                continue
            x = own.copy()
            gain = (last - first) / (joints * (high - low))
            x[names.index("gain_rad_per_kpa")] = gain
            x[names.index("rest_pressure_kpa")] = first / (joints * gain) - low
            out.append(x)
    else:
        for bend, angle in product((0.5, 1.2, 2.0), np.arange(6) * np.pi / 3):
            x = own.copy()
            x[names.index("gain_rad_per_kpa")] = bend / (joints * pressures.max())
            x[names.index("chamber_angle_rad")] = angle
            out.append(x)
    return out
