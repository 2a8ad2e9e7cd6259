"""The same bodies in motion: a dynamic Cosserat rod, integrated by PyElastica.

Source: Gazzola, Dudte, McCormick and Mahadevan, R. Soc. Open Sci. 5 (2018) 171628. The device lies on an
air-bearing table, so weight does not bend it; its stand may shake and a wall may be in its way.
"""

import math

import numpy as np

from pneutac_truths.programs import DT_S
from pneutac_truths.rod import BEND_Y, BEND_Z, SET_Y, SET_Z, SOFT, STRETCH, TWIST, Rod, place
from pneutac_truths.world import World, seconds

ELEMENTS = 60
DENSITY = 1100.0  # kg/m^3, silicone
THICKNESS = 0.18  # radius over length of a bellows body; a thicker rod allows longer time steps
STABLE = 0.7  # of the time that a wave takes through one element
SETTLE_S = 1.5  # of motion before each trial


def elastica():
    """PyElastica, which only moving rods need; raises ImportError where it is not installed."""
    try:
        import elastica as ea
    except ImportError as e:
        raise ImportError("Moving rods need PyElastica; in a clone: uv pip install -e '.[dev]'") from e
    return ea


def stiffness_of(period_s: float, length_m: float, mass_kg: float, tip_kg: float) -> float:
    """Bending stiffness, N m^2, of a cantilever that swings with this period.

    Source: Rayleigh, Theory of Sound (1877) art. 173: 0.2427 of the mass acts at the tip.
    """
    return (2 * math.pi / period_s) ** 2 * length_m**3 * (tip_kg + 0.2427 * mass_kg) / 3


class Moving:
    """A clamped round rod that PyElastica moves on from step to step, with a mass `tip_kg` at its free end.

    Its lowest bending mode has this period, by `stiffness_of`, and this ratio of damping; `forces` is a class
    of PyElastica's, if any acts. `rod` is PyElastica's, in metres, its directors' rows z, -y and x of a
    straight device; `bending` (3, 3, elements - 1) the bending matrix of the plain material.
    """

    def __init__(self, length_m, radius_m, period_s, damping, tip_kg=0.0, elements=ELEMENTS, forces=None):
        ea = elastica()
        mass = DENSITY * math.pi * radius_m**2 * length_m
        stiff = stiffness_of(period_s, length_m, mass, tip_kg)
        modulus = stiff / (math.pi * radius_m**4 / 4)
        kinds = (ea.BaseSystemCollection, ea.Constraints, ea.Forcing, ea.Damping)
        self._system = type("System", kinds, {})()
        frame = np.zeros(3), np.array([1.0, 0, 0]), np.array([0, 0, 1.0])
        moduli = {"youngs_modulus": modulus, "shear_modulus": modulus / 3}
        self.rod = ea.CosseratRod.straight_rod(elements, *frame, length_m, radius_m, DENSITY, **moduli)
        self.rod.mass[-1] += tip_kg
        wave = length_m / elements / math.sqrt(modulus / DENSITY)
        self.parts = max(1, math.ceil(DT_S / (STABLE * wave)))
        self._dt = np.float64(DT_S / self.parts)
        self._system.append(self.rod)
        ends = {"constrained_position_idx": (0,), "constrained_director_idx": (0,)}
        self._system.constrain(self.rod).using(ea.OneEndFixedBC, **ends)
        if forces is not None:
            self._system.add_forcing_to(self.rod).using(forces)
        if damping > 0:
            constant = 2 * damping * 2 * math.pi / period_s
            how = {"uniform_damping_constant": constant, "time_step": self._dt}
            self._system.dampen(self.rod).using(ea.AnalyticalLinearDamper, **how)
        self._system.finalize()
        self.bending = self.rod.bend_matrix.copy()
        self._stepper = ea.PositionVerlet()
        self.time_s = np.float64(0.0)

    def advance(self) -> None:
        for _ in range(self.parts):
            self.time_s = self._stepper.step(self._system, self.time_s, self._dt)

    def marker_mm(self, tip_mm: float) -> np.ndarray:
        """(3,) end of the rigid tip piece."""
        return 1e3 * self.rod.position_collection[:, -1] + tip_mm * self.rod.director_collection[2, :, -1]


def move(w: World) -> np.ndarray:
    """Marker (m, 3) in mm in all rows of the fine grid that belong to trials.

    Raises ImportError where PyElastica is not installed, ArithmeticError where the motion is not finite.
    """
    line, d, outside = w.body.rod, w.dynamics, _outside(w, w.body.rod)
    inputs, length = w.rod_inputs(np.arange(len(w.time_s))), 1e-3 * line.length_mm
    tip_kg = d.get("tip_share", 0.1) * DENSITY * math.pi * (THICKNESS * length) ** 2 * length
    body = Moving(length, THICKNESS * length, d["period_s"], d["damping"], tip_kg, forces=outside)
    outside.body = body
    at_voronoi, at_element = _fields(line)
    out, k = np.empty((int((w.plan.trial >= 0).sum()), 3)), 0
    last = np.full(inputs.shape[1], np.nan)
    for a, b in zip(w.plan.starts, w.plan.ends, strict=True):
        for i in range(max(0, a - seconds(SETTLE_S)), b):
            if not np.array_equal(inputs[i], last):
                _set_inputs(body, inputs[i], at_voronoi, at_element)
                last = inputs[i]
            outside.now_s = w.time_s[i]
            body.advance()
            if i >= a:
                out[k] = body.marker_mm(line.tip_mm)
                k += 1
    if not np.isfinite(out).all():
        raise ArithmeticError("The moving rod did not stay finite.")
    return out


def _fields(line: Rod) -> tuple[np.ndarray, np.ndarray]:
    """Curvatures (3, ELEMENTS - 1) per radian in 1/m, and strain per unit of stretch (ELEMENTS,)."""
    s = (np.arange(line.shapes.shape[1]) + 0.5) / line.shapes.shape[1]
    shapes = np.stack([np.interp(np.arange(1, ELEMENTS) / ELEMENTS, s, x) for x in line.shapes])
    h = 1e-3 * line.length_mm / ELEMENTS
    middles = (np.arange(ELEMENTS) + 0.5) / ELEMENTS
    return shapes / (shapes.sum(1, keepdims=True) * h), np.interp(middles, s, line.stretched)


def _set_inputs(body: Moving, u: np.ndarray, at_voronoi: np.ndarray, at_element: np.ndarray) -> None:
    air, memory, twist = at_voronoi
    body.rod.rest_kappa[0] = u[BEND_Y] * air + u[SET_Y] * memory
    body.rod.rest_kappa[1] = u[BEND_Z] * air + u[SET_Z] * memory
    body.rod.rest_kappa[2] = u[TWIST] * twist
    body.rod.rest_sigma[2] = u[STRETCH] * at_element
    body.rod.bend_matrix[:] = body.bending / u[SOFT]


def _outside(w: World, line: Rod):
    """A class of forces: the shaking stand, and a wall that nodes and marker press into."""
    ea = elastica()
    wall = None
    if w.contact is not None:
        at, ahead, compliance, _ = place(line, float(w.body.bend_rad[0]), w.contact)
        wall = 1e-3 * at, ahead, w.contact["stiffness"] / compliance  # 1/mm^3: over bending stiffness
    shake = w.dynamics.get("shake")

    class Outside(ea.NoForces):
        now_s, body = 0.0, None

        def apply_forces(self, system, time=0.0):
            if shake is not None:
                pull = shake["acceleration"] * math.sin(2 * math.pi * shake["hz"] * Outside.now_s)
                system.external_forces[2] += pull * system.mass
            if wall is not None:
                _press(system, *wall, 1e-3 * line.tip_mm, Outside.body)

    return Outside


def _press(system, at, ahead, stiffness, tip_m, body) -> None:
    """The wall pushes the marker, which turns the last element too; it damps what moves into it."""
    stiff = body.bending[0, 0, 0] * stiffness * 1e9
    arm = tip_m * system.director_collection[2, :, -1]
    depth = (system.position_collection[:, -1] + arm - at) @ ahead
    if depth <= 0:
        return
    into = system.velocity_collection[:, -1] @ ahead
    push = max(stiff * depth * (1 + 0.5 * math.tanh(into / 0.05)), 0.0)
    system.external_forces[:, -1] -= push * ahead
    system.external_torques[:, -1] += system.director_collection[..., -1] @ np.cross(arm, -push * ahead)
