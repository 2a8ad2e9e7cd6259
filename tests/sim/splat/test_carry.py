"""Points that follow particles: affine deformations exactly, bending to second order of the spacing."""

import numpy as np

from pneutac_sim.splat.carry import carry


def lattice(spacing):
    axes = (np.arange(0, 0.04, spacing), np.arange(0, 0.012, spacing), np.arange(0, 0.012, spacing))
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)


def test_affine_motion_is_met_exactly_also_outside():
    rng = np.random.default_rng(0)
    rest = lattice(0.002)
    F = np.eye(3) + 0.3 * rng.normal(size=(3, 3))
    points = rng.uniform(-0.004, 0.045, (200, 3))
    gradients = np.broadcast_to(F, (len(rest), 3, 3))
    moved = carry(points, rest, rest @ F.T + [1, 2, 3], gradients)
    np.testing.assert_allclose(moved, points @ F.T + [1, 2, 3], atol=1e-12)


def bend(points, radius=0.03):
    """Rolls a bar up: x becomes the angle, z the distance from the middle line."""
    angle, r = points[:, 0] / radius, radius - points[:, 2]
    return np.stack([r * np.sin(angle), points[:, 1], radius - r * np.cos(angle)], -1)


def gradient(points, radius=0.03):
    angle, r = points[:, 0] / radius, radius - points[:, 2]
    F = np.zeros((len(points), 3, 3))
    F[:, 0, 0], F[:, 0, 2] = r / radius * np.cos(angle), -np.sin(angle)
    F[:, 2, 0], F[:, 2, 2] = r / radius * np.sin(angle), np.cos(angle)
    F[:, 1, 1] = 1
    return F


def test_bending_converges_with_the_spacing():
    points = np.random.default_rng(1).uniform([0.004, 0.002, 0.002], [0.034, 0.009, 0.009], (300, 3))
    errors = []
    for spacing in (0.002, 0.001):
        rest = lattice(spacing)
        moved = carry(points, rest, bend(rest), gradient(rest))
        errors.append(np.linalg.norm(moved - bend(points), axis=1).max())
    assert errors[0] < 1e-4
    assert errors[1] < 0.35 * errors[0]
