"""Anisotropic 3D Gaussians that follow a deforming body."""

from dataclasses import dataclass, replace

import numpy as np
from numba import njit

from pneutac_sim.errors import InputError, finite_array


@dataclass
class Gaussians:
    """n Gaussians."""

    means: np.ndarray  # (n, 3) m
    scales: np.ndarray  # (n, 3) m, standard deviations along the Gaussian's own axes
    rotations: np.ndarray  # (n, 3, 3), own axes to world, as columns
    colours: np.ndarray  # (n, 3) red, green, blue, 0 to 1
    opacities: np.ndarray  # (n,) 0 to 1

    def __post_init__(self):
        n = len(self.means)
        shapes = {
            "means": (n, 3),
            "scales": (n, 3),
            "rotations": (n, 3, 3),
            "colours": (n, 3),
            "opacities": (n,),
        }
        for name, shape in shapes.items():
            value = finite_array(f"The {name} of {n} Gaussians", getattr(self, name), shape, np.float32)
            setattr(self, name, value)
        if n and self.scales.min() < 0:
            raise InputError("The scales of Gaussians must not be negative.")
        for name in ("colours", "opacities"):
            if n and not (getattr(self, name).min() >= 0 and getattr(self, name).max() <= 1):
                raise InputError(f"The {name} of Gaussians must lie between 0 and 1.")

    def __len__(self):
        return len(self.means)

    def covariances(self) -> np.ndarray:
        """R diag(s^2) R^T, float32 (n, 3, 3) m^2."""
        axes = self.rotations * self.scales[:, None, :]
        return axes @ axes.transpose(0, 2, 1)

    def moved(self, means, deformation_gradients=None) -> "Gaussians":
        """The same Gaussians carried along by their body to means (n, 3) in m, of unchanged scales.

        With deformation gradients F (n, 3, 3) each turns by the rotation U of F = U P, P symmetric positive
        definite.

        Raises InputError: a shape is wrong, a number not finite, or a determinant of F not positive.
        """
        if deformation_gradients is None:
            return replace(self, means=means)
        F = np.ascontiguousarray(deformation_gradients, np.float64)
        if F.shape != (len(self), 3, 3) or not np.isfinite(F).all():
            raise InputError(
                f"Deformation gradients of {len(self)} Gaussians must be finite numbers of shape (n, 3, 3)."
            )
        turn = np.empty(F.shape)
        if not _polar(F, turn):
            raise InputError(
                "A deformation gradient turns its particle inside out; its determinant must be > 0."
            )
        return replace(self, means=means, rotations=turn @ self.rotations)


@njit(cache=True)
def _polar(F, turn):
    """Writes the rotation of each F by Newton's iteration X <- (X + X^-T) / 2 (Higham 1986).

    Returns whether every determinant is positive.
    """
    for i in range(len(F)):
        X = F[i].copy()
        for _ in range(20):
            # rows of the cofactor matrix, det X^-T
            c0 = np.cross(X[1], X[2])
            c1 = np.cross(X[2], X[0])
            c2 = np.cross(X[0], X[1])
            det = X[0, 0] * c0[0] + X[0, 1] * c0[1] + X[0, 2] * c0[2]
            if det <= 0:
                return False
            change = 0.0
            for j in range(3):
                for k, c in enumerate((c0[j], c1[j], c2[j])):
                    new = 0.5 * (X[k, j] + c / det)
                    change = max(change, abs(new - X[k, j]))
                    X[k, j] = new
            if change < 1e-9:
                break
        turn[i] = X
    return True
