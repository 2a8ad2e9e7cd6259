"""The soft body round the world's spine by the action network, in place of `world.mpm_finger.MpmFinger`.

The chamber drives the spine with a controller of finite stiffness K_c, the body resists with its own:

    M q'' + D q' = K_c (q_free - q) + f_r(q, 0, p) - f_r(q_free, 0, p)

where q_free is the bend that the twin's pipeline commands. It was calibrated with the body on the spine, so
what that takes back of the free bend is in q_free already. Swing and mass are the world's own. Motion of the
finger alone over time is `ActionNetwork.roll`.

How the stiffness of a finger's joints is shared between the chamber's controller and the soft body.

The two networks of a twin: its own, or those that are shipped for the built-in finger and gel.
"""

import hashlib
import json
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path

import numpy as np

from pneutac_sim.errors import InputError, option
from pneutac_sim.finger.equilibrium import share_of_controller
from pneutac_sim.finger.stages import joint_command
from pneutac_sim.gel.force import MATERIAL, MODULUS
from pneutac_sim.gel.model import GelModel
from pneutac_sim.mpm.solid import parameter
from pneutac_sim.mpm.user_mesh import FACES, VERTICES
from pneutac_sim.surrogate.network import ActionNetwork
from pneutac_sim.surrogate.perception import GelSurrogate
from pneutac_sim.twin import NETWORKS, Twin


def bending_pressure(twin: Twin, q_cmd: np.ndarray) -> np.ndarray:
    """Bending pressure (...) in kPa of joint targets `q_cmd` (..., N) in rad."""
    gain = twin.parameter("gain_rad_per_kpa")
    return np.asarray(q_cmd).mean(-1) / gain - twin.parameter("rest_pressure_kpa")


def joint_targets(twin: Twin, pressure_kpa: np.ndarray) -> np.ndarray:
    """Joint targets (..., N) in rad at bending pressures (...)."""
    shape = ("gain_alpha", "gain_beta")
    alpha, beta = (twin.parameters[k].value if k in twin.parameters else 0.0 for k in shape)
    gain, rest_kpa = twin.parameter("gain_rad_per_kpa"), twin.parameter("rest_pressure_kpa")
    return joint_command(pressure_kpa, gain, alpha, beta, rest_kpa, len(twin.spine_joint_positions_mm))


def controller_stiffness(twin: Twin, body: np.ndarray) -> float:
    """K_c in N m/rad: what is left of the twin's `joint_stiffness_nm_per_rad` without its soft body.

    `body` (N, N) is the derivative J of the body's torques by the joint angles at rest, N m/rad.

    Raises InputError where the body alone is stiffer than the whole.
    """
    whole = twin.parameter("joint_stiffness_nm_per_rad")
    levers = twin.length_mm - np.asarray(twin.spine_joint_positions_mm)
    controller = share_of_controller(whole, -body, levers)
    if controller == 0.0:
        alone = (levers @ levers) / (levers @ np.linalg.solve(-body, levers))
        raise InputError(
            f"The soft body alone resists a load at the tip with {alone:.3g} N m/rad a joint, more than the "
            f"twin's joint_stiffness_nm_per_rad of {whole:.3g}: 'youngs_modulus_mpa' is too high or that "
            "too low; calibrate with rows that hang a weight on the tip (payload_g)."
        )
    return controller


def network_of(twin: Twin, network: ActionNetwork) -> ActionNetwork | None:
    """The network for a twin's own Young's modulus; None where it was trained for another body.

    At given angles an elastic body's torque is proportional to its modulus. That f_r also holds by how much
    the body lags behind its spine, which is not, is left aside. A file of an earlier version does not state
    its modulus and is good for that of its training alone.
    """
    if network.fingerprint != fingerprint(twin, network.modulus_mpa):
        return None
    modulus = parameter(twin, "youngs_modulus_mpa")
    if network.modulus_mpa in (None, modulus):
        return network
    ratio = modulus / network.modulus_mpa
    scaled = {name: ratio * getattr(network, name) for name in ("slope", "torque_mean", "torque_scale")}
    return replace(network, **scaled, fingerprint=fingerprint(twin), modulus_mpa=modulus)


class SurrogateFinger:
    """The soft body of one finger, by a network that was trained for it, see `network_of`.

    Attributes:
        controller_nm_per_rad: K_c, see `controller_stiffness`.
        in_range: whether the last step was in the range in which the network was trained. Where it was not,
            the body's torque goes on straight.

    Raises InputError: the network was trained for another body, or the body is stiffer than the whole finger.
    """

    def __init__(self, twin: Twin, network: ActionNetwork):
        own = network_of(twin, network)
        if own is None:
            raise InputError(
                "The action network was trained for another body, or for this one before its shape or "
                "material changed; train it again with `pneutac surrogate`."
            )
        self.network = own
        rest = joint_targets(twin, 0.0)
        self.controller_nm_per_rad = controller_stiffness(twin, self.torque(rest, rest)[1])
        self.reset()

    def reset(self) -> None:
        """Does nothing: a network has no state."""
        self.in_range = True

    def torque(self, q_free: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Torques of the body at joint angles `q` beyond those at `q_free`, where it rests unloaded.

        Of (N,) rad both; returns torques (N,) in N m and their symmetric derivative (N, N) by `q` in N m/rad.

        Raises InputError where an angle is not a finite number.
        """
        q_free, q = np.asarray(q_free, float), np.asarray(q, float)
        if not (np.isfinite(q_free).all() and np.isfinite(q).all()):
            raise InputError("A joint angle of the finger is not a finite number.")
        torque, J, self.in_range = self.network.resistance(q_free, q)
        return torque, J


_LOAD = {"action": ActionNetwork.load, "perception": GelSurrogate.load}
_OF = {"action": "finger", "perception": "gel"}


def builtin(name: str) -> Path:
    """File of the network that is shipped for the built-in twin, one of `NETWORKS`."""
    return Path(str(files("pneutac_sim.surrogate") / f"builtin_{name}.safetensors"))


def fits(file: Path, name: str, twin: Twin) -> bool:
    """Whether a network was trained for this twin, or for one of another modulus, by which it is scaled."""
    return _of(twin, _LOAD[name](file)) is not None


def _of(twin: Twin, network: ActionNetwork | GelSurrogate):
    if isinstance(network, ActionNetwork):
        return network_of(twin, network)
    return network if network.fingerprint == gel_fingerprint(twin) else None


@dataclass(frozen=True)
class Networks:
    """What stands in for the material points of one twin."""

    action: ActionNetwork  # f_r, of the finger
    gel: GelSurrogate  # f_m, of the gel

    @classmethod
    def of(cls, twin: Twin) -> "Networks":
        """The networks of a twin.

        Raises InputError where it has none, they are damaged, or they were trained for another one.
        """
        found = {}
        for name in NETWORKS:
            own = twin.networks.get(name)
            network = _of(twin, _LOAD[name](own or builtin(name)))
            if network is None:
                why = (
                    f"{own} was trained for another {_OF[name]}, or before its shape or material changed"
                    if own
                    else f"The twin has no {name} network, and its {_OF[name]} is not the built-in one"
                )
                raise InputError(
                    f"{why}; run `pneutac surrogate {option('twin', own.parent if own else 'DIR')}`, "
                    "or choose `probe` by --fidelity, --robot.fidelity or --env.fidelity, which needs none."
                )
            found[name] = network
        return cls(found["action"], found["perception"])

    def finger(self, twin: Twin) -> SurrogateFinger:
        """The finger of this twin, bent by the action network."""
        return SurrogateFinger(twin, self.action)


MODEL = 1  # raised where the material points themselves change, so that networks are trained again
BODY = "youngs_modulus_mpa", "poissons_ratio", "density_kg_m3", "width_mm"
BODY += "spine_stiffness_nm_per_rad", "spine_damping_nms_per_rad"
GEL = ("gel_poissons_ratio", "gel_density_kg_m3")


def fingerprint(twin: Twin, modulus_mpa: float | None = None) -> str:
    """SHA-256 of what the action network of a finger depends on: its geometry, mesh and material.

    The body knows only how it is bent. Drive, effects and history decide how far, and `in_range` shows where
    that is farther than in training. `modulus_mpa` takes the place of the twin's own.
    """
    body = {n: parameter(twin, n) for n in BODY}
    if modulus_mpa is not None:
        body["youngs_modulus_mpa"] = modulus_mpa
    what = {"model": MODEL, "device": twin.device, "length_mm": twin.length_mm, "body": body}
    what["spine_joint_positions_mm"] = list(twin.spine_joint_positions_mm)
    arrays = [np.ascontiguousarray(twin.arrays[n]) for n in (VERTICES, FACES) if n in twin.arrays]
    return _sha256(what, arrays)


def gel_fingerprint(twin: Twin) -> str:
    """SHA-256 of what the perception network of a gel depends on: material, window and thickness.

    Its modulus scales all forces and moves nothing: the default is hashed in its place, as networks of
    earlier versions have it.
    """
    gel = GelModel.from_twin(twin)
    body = {n: parameter(twin, n) for n in GEL} | {MODULUS: MATERIAL[MODULUS]}
    what = {"model": MODEL, "body": body, "window_mm": list(gel.window_mm), "thickness_mm": gel.thickness_mm}
    return _sha256(what, [])


def _sha256(what: dict, arrays: list[np.ndarray]) -> str:
    h = hashlib.sha256(json.dumps(_floats(what), sort_keys=True).encode())
    for a in arrays:
        h.update(f"{a.dtype}{a.shape}".encode())
        h.update(a.tobytes())
    return h.hexdigest()


def _floats(x):
    if isinstance(x, dict):
        return {k: _floats(v) for k, v in x.items()}
    if isinstance(x, list):
        return [_floats(v) for v in x]
    return x if isinstance(x, str) else float(x)
