"""An arm that keeps its orientation, as three slides: MJCF, and inverse kinematics that are the identity."""

import mujoco
import numpy as np

from pneutac_sim.world.panda import HOME_JOINTS, SERVO_LAG_S, forward_kinematics

SLIDES = ("slide_x", "slide_y", "slide_z")
STIFFNESS_N_M = 40000.0  # of the flange: about 12 kN m/rad at the arm's half metre
INERTIA_KG = 1.0


def body(payload: str = "") -> str:
    """MJCF of three slides whose positions are the flange's in the world; `payload` as for the arm."""
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, forward_kinematics(HOME_JOINTS)[:3, :3].ravel())
    slides = "".join(
        f'<joint name="{name}" type="slide" axis="{axis}" armature="{INERTIA_KG}"/>'
        for name, axis in zip(SLIDES, ("1 0 0", "0 1 0", "0 0 1"), strict=True)
    )
    site = '<site name="flange" size=".001" group="5"/>'
    # The joints' axes are in the frame of their body: the turned flange is a body of its own.
    flange = f'<body name="flange" quat="{" ".join(map(repr, quat.tolist()))}">{site}{payload}</body>'
    return f'<body name="gantry" gravcomp="1">{slides}{flange}</body>'


def actuators() -> str:
    """MJCF position servos of the slides."""
    kv = SERVO_LAG_S * STIFFNESS_N_M
    return "".join(f'<position name="servo_{j}" joint="{j}" kp="{STIFFNESS_N_M}" kv="{kv}"/>' for j in SLIDES)


class Straight:
    """Inverse kinematics of the slides."""

    missing_m = 0.0

    def reset(self) -> None:
        """Nothing to start from."""

    def solve(self, position: np.ndarray) -> np.ndarray:
        """Slide positions (3,), metres: the flange's own."""
        return np.array(position, float)
