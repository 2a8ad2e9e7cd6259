"""The action network f_r(q, q', p): what the soft body does to the spine's joints, and motion under it.

Two hidden layers of 128 in float32. It is asked up to a thousand times a simulated second, so it is evaluated
inside the compiled loop over the skeleton's steps, where a call takes about 2 us.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numba import njit
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from pneutac_sim.errors import InputError
from pneutac_sim.files import refuse_pointer, whole
from pneutac_sim.surrogate.skeleton import G, Skeleton, advance

# Compiled loops of the action network: its value, and motion of the skeleton under it.
#
# `numbers` are the layers and, in float64, normalisation and box; `x` and `f` are work space in float32.


FASTEST_RAD_S = 100.0  # fifteen times what commands bring about


@njit(cache=True)
def residual(numbers, q, qd, p, x, f):
    """f_r into f[2] (N,); returns whether the state lies in the box, to which the layers' inputs are clipped.

    The straight part goes on beyond it, as an elastic body does.
    """
    (w1, b1, w2, b2, w3, b3), (slope, mean, scale, torque_mean, torque_scale, low, high) = numbers
    n = len(q)
    h1, h2, out = f
    inside, straight = True, torque_mean.copy()
    for i in range(2 * n + 1):
        v = q[i] if i < n else (qd[i - n] if i < 2 * n else p)
        for j in range(n):
            straight[j] += (v - mean[i]) / scale[i] * slope[i, j]
        if not low[i] <= v <= high[i]:
            inside = False
            v = min(max(v, low[i]), high[i])
        x[i] = (v - mean[i]) / scale[i]  # of unit variance
    _layer(x, w1, b1, h1)
    _softsign(h1)
    _layer(h1, w2, b2, h2)
    _softsign(h2)
    _layer(h2, w3, b3, out)
    for i in range(n):
        out[i] = straight[i] + torque_scale[i] * out[i]
    return inside


@njit(cache=True)
def _layer(x, w, b, y):
    for i in range(len(y)):
        y[i] = b[i]
    for j in range(len(x)):
        a = x[j]
        for i in range(len(y)):  # along memory, so that it becomes vector instructions
            y[i] += a * w[j, i]


@njit(cache=True)
def _softsign(y):
    for i in range(len(y)):  # y / (1 + |y|): smooth enough, and cheaper than tanh
        y[i] /= np.float32(1) + abs(y[i])


@njit(cache=True)
def roll(A, inertia, K, D, loss, numbers, x, f, q, qd, targets, pressure, substeps, h, out_q, out_v, inside):
    """Motion over S targets of `substeps` steps of `h` seconds each; see `ActionNetwork.roll`."""
    n = len(q)
    extra, target, end = np.empty(n), np.empty(n), np.empty(n)
    for s in range(len(out_q)):
        for k in range(substeps):
            # targets and pressure run straight from one control step to the next
            middle, last = (k + 0.5 * G) / substeps, (k + 1) / substeps
            p = pressure[s] + middle * (pressure[s + 1] - pressure[s])
            residual(numbers, q + 0.5 * h * qd, qd, p, x, f)
            for i in range(n):
                extra[i] = f[2][i]
                rise = targets[s + 1, i] - targets[s, i]
                target[i] = targets[s, i] + middle * rise
                end[i] = targets[s, i] + last * rise
            advance(A, inertia, K, D, loss, q, qd, target, end, extra, h, FASTEST_RAD_S)
        inside[s] = residual(numbers, q, qd, pressure[s + 1], x, f)
        for i in range(n):
            out_q[s, i], out_v[s, i] = q[i], qd[i]


@njit(cache=True)
def resistance(numbers, q_free, q, p, near, x, f, torque, J):
    """Into `torque` and `J`, see `ActionNetwork.resistance`; returns whether `q` lies in the box."""
    n = len(q)
    still, at = np.zeros(n), q.copy()
    for i in range(n):
        at[i] = q[i] + near
        residual(numbers, at, still, p, x, f)
        for j in range(n):
            J[j, i] = f[2][j]
        at[i] = q[i] - near
        residual(numbers, at, still, p, x, f)
        for j in range(n):
            J[j, i] = (J[j, i] - f[2][j]) / (2.0 * near)
        at[i] = q[i]
    for i in range(n):
        for j in range(i):
            J[i, j] = J[j, i] = 0.5 * (J[i, j] + J[j, i])
    residual(numbers, q_free, still, p, x, f)
    for i in range(n):
        torque[i] = -f[2][i]
    inside = residual(numbers, q, still, p, x, f)
    for i in range(n):
        torque[i] += f[2][i]
    return inside


FORMAT = "pneutac-action-network/2"
HIDDEN = 128
LAYERS = ("w1", "b1", "w2", "b2", "w3", "b3")
MARGIN = 0.05  # of the width of what was seen in training, still counted as in range
STEP_S = 0.002
NEAR_RAD = 0.02  # over which its slope is taken


@dataclass(frozen=True)
class ActionNetwork:
    """A trained network with the skeleton that it drives.

    Inputs are q (N), q' (N) and the bending pressure in kPa; outputs torques (N) in N m. The body knows of no
    pressure, only of how it is bent: one network serves a body whatever drives it, and the bending pressure
    is that of the drive with which it was trained, p = mean(q_cmd) / G - p0.
    """

    # float32 `w1` (2 N + 1, 128), `b1`, `w2` (128, 128), `b2`, `w3` (128, N), `b3`, with softsign between
    # them
    layers: tuple[np.ndarray, ...]
    # (2 N + 1, N) N m by normalised inputs: the straight part of the torque, which is most of an elastic
    # body's, besides the layers. Layers alone smear it over joints that mostly move together.
    slope: np.ndarray
    # mean, scale: (2 N + 1,) that normalise inputs
    mean: np.ndarray
    scale: np.ndarray
    # torque_mean, torque_scale: (N,) that undo the normalisation of outputs, N m
    torque_mean: np.ndarray
    torque_scale: np.ndarray
    # low, high: (2 N + 1,) box of the inputs seen in training
    low: np.ndarray
    high: np.ndarray
    drive: np.ndarray  # (2,) G in rad/kPa and p0 in kPa
    skeleton: Skeleton  # of the same finger
    fingerprint: str  # of the twin, see `surrogate.fingerprint`
    # Young's modulus of the body in training; None where an earlier version wrote the file
    modulus_mpa: float | None = None

    @property
    def joints(self) -> int:
        return len(self.torque_mean)

    def torque(self, q: np.ndarray, q_vel: np.ndarray, pressure_kpa: np.ndarray) -> np.ndarray:
        """f_r (T, N) in N m at states (T, N), (T, N), (T,); outside the box its straight part goes on."""
        q, q_vel = np.asarray(q, float), np.asarray(q_vel, float)
        out = np.empty(q.shape)
        x, f = self._work
        for t in range(len(q)):
            residual(self._numbers, q[t], q_vel[t], float(pressure_kpa[t]), x, f)
            out[t] = f[2]
        return out

    def pressure_kpa(self, q_cmd: np.ndarray) -> np.ndarray:
        """Bending pressure (...) in kPa that stands for joint targets (..., N) in rad."""
        return np.asarray(q_cmd).mean(-1) / self.drive[0] - self.drive[1]

    def resistance(self, q_free: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, bool]:
        """f_r(q, 0, p) - f_r(q_free, 0, p) (N,) in N m, its derivative, and whether `q` is in range.

        The body is bent by pressure alone at `q_free` (N,) rad. The derivative (N, N) by `q`, N m/rad, is
        symmetric, as that of an elastic body is.
        """
        J = np.empty((self.joints, self.joints))
        p, x, (h1, h2, f) = float(self.pressure_kpa(q_free)), *self._work
        torque = np.empty(self.joints)
        inside = resistance(self._numbers, q_free, q, p, NEAR_RAD, x, (h1, h2, f), torque, J)
        return torque, J, inside

    def roll(
        self,
        q: np.ndarray,
        q_vel: np.ndarray,
        targets: np.ndarray,
        pressure_kpa: np.ndarray,
        duration_s: float,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Moves the skeleton under M (q'' + d q') + c + D q' + K q = K q_target + f_r(q, q', p).

        It begins at q (N,) rad and q' (N,) rad/s. Targets (S + 1, N) rad and bending pressures (S + 1,) kPa
        follow at equal distances over the duration, with straight lines between them. Returns q (S, N) and q'
        (S, N) at the targets from the second on, and (S,) whether those states were in range.
        """
        s = self.skeleton
        targets = np.ascontiguousarray(targets, float)
        each = duration_s / (len(targets) - 1)
        substeps = max(1, math.ceil(each / STEP_S - 1e-9))
        out_q, out_v = np.empty(targets[1:].shape), np.empty(targets[1:].shape)
        inside = np.empty(len(out_q), np.bool_)
        roll(
            s.coupling, s.inertia, s.stiffness_nm_per_rad, s.damping_nms_per_rad, s.loss_per_s,
            self._numbers, *self._work,
            np.array(q, float), np.array(q_vel, float), targets, np.asarray(pressure_kpa, float), substeps,
            each / substeps, out_q, out_v, inside,
        )  # fmt: skip
        return out_q, out_v, inside

    @cached_property
    def _numbers(self):
        wide = MARGIN * (self.high - self.low)
        box = [a.astype(np.float64) for a in (self.low - wide, self.high + wide)]
        scales = self.slope, self.mean, self.scale, self.torque_mean, self.torque_scale
        scales = [a.astype(np.float64) for a in scales]
        return tuple(np.ascontiguousarray(a, np.float32) for a in self.layers), tuple(scales + box)

    @cached_property
    def _work(self):
        n = self.joints
        h = tuple(np.empty(k, np.float32) for k in (HIDDEN, HIDDEN, n))
        return np.empty(2 * n + 1, np.float32), h

    # ---------------------------------------------------------------- files

    def save(self, file: str | Path) -> Path:
        """Writes weights, normalisation, range and skeleton as safetensors; returns the file."""
        file, s = Path(file), self.skeleton
        arrays = {n: np.ascontiguousarray(getattr(self, n), np.float64) for n in _VECTORS}
        arrays |= {n: np.ascontiguousarray(a, np.float32) for n, a in zip(LAYERS, self.layers, strict=True)}
        arrays |= {
            "coupling": np.stack([s.coupling.real, s.coupling.imag]),
            "inertia": s.inertia,
            "controller": np.array([s.stiffness_nm_per_rad, s.damping_nms_per_rad, s.loss_per_s]),
        }
        label = {"format": FORMAT, "fingerprint": self.fingerprint}
        if self.modulus_mpa is not None:
            label["modulus_mpa"] = repr(float(self.modulus_mpa))
        with whole(file) as part:
            part.write_bytes(save(arrays, label))
        return file

    @classmethod
    def load(cls, file: str | Path) -> "ActionNetwork":
        """Reads a network; raises InputError where it is missing, corrupted, or of another format."""
        file = Path(file)
        if not file.is_file():
            raise InputError(f"There is no action network '{file}'; train it with `pneutac surrogate`.")
        refuse_pointer(file)
        try:
            with safe_open(file, "np") as f:
                label = f.metadata() or {}
                arrays = {k: f.get_tensor(k) for k in f.keys()}  # noqa: SIM118
        except (SafetensorError, OSError) as e:
            raise InputError(f"{file} is corrupted ({e}); train it again with `pneutac surrogate`.") from e
        if label.get("format") != FORMAT or "fingerprint" not in label:
            raise InputError(
                f"{file} is no action network of the format '{FORMAT}'; train it again with "
                "`pneutac surrogate`."
            )
        n = arrays["inertia"].size if "inertia" in arrays else 0
        for name, shape in _shapes(n).items():
            if name not in arrays or arrays[name].shape != shape or not np.isfinite(arrays[name]).all():
                raise InputError(f"{file}: array '{name}' must be finite numbers of shape {shape}.")
        real, imaginary = arrays["coupling"]
        controller = arrays["controller"].tolist()
        return cls(
            layers=tuple(arrays[k] for k in LAYERS),
            **{name: arrays[name] for name in _VECTORS},
            skeleton=Skeleton(real + 1j * imaginary, arrays["inertia"], *controller),
            fingerprint=label["fingerprint"],
            modulus_mpa=_modulus(label, file),
        )


def _modulus(label: dict[str, str], file: Path) -> float | None:
    if "modulus_mpa" not in label:
        return None
    try:
        modulus = float(label["modulus_mpa"])
    except ValueError:
        modulus = math.nan
    if not (math.isfinite(modulus) and modulus > 0):
        raise InputError(f"{file}: 'modulus_mpa' is {label['modulus_mpa']!r}; it must be a positive number.")
    return modulus


_VECTORS = ("slope", "mean", "scale", "torque_mean", "torque_scale", "low", "high", "drive")


def _shapes(n: int) -> dict[str, tuple[int, ...]]:
    inputs = 2 * n + 1
    layers = ((inputs, HIDDEN), (HIDDEN,), (HIDDEN, HIDDEN), (HIDDEN,), (HIDDEN, n), (n,))
    vectors = ((inputs, n), (inputs,), (inputs,), (n,), (n,), (inputs,), (inputs,), (2,))
    shapes = dict(zip((*LAYERS, *_VECTORS), (*layers, *vectors), strict=True))
    return shapes | {"coupling": (2, n, n), "inertia": (n,), "controller": (3,)}
