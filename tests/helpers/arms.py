"""Twins of soft bodies of three chambers, as calibration gives them; a body on a base that stands still."""

import mujoco

from pneutac_sim.twin import Twin, Value
from pneutac_sim.world.soft_finger import mjcf


def arm_twin(
    angle_rad: float = 0.0, gains: tuple[float, float] = (1.0, 1.0), joints: int = 6, **more
) -> Twin:
    """An arm of 100 mm that a chamber bends by 1.25 rad at 50 kPa, the first at an angle from +z to +y."""
    length = more.pop("length_mm", 100.0)
    values = {
        "gain_rad_per_kpa": 0.025 / joints,
        "gain_alpha": 0.05,
        "gain_beta": 0.02,
        "rest_pressure_z_kpa": 0.0,
        "rest_pressure_y_kpa": 0.0,
        "chamber_angle_rad": angle_rad,
        "chamber_2_gain": gains[0],
        "chamber_3_gain": gains[1],
        "joint_stiffness_nm_per_rad": 0.458,
    }
    parameters = {name: Value(value) for name, value in (values | more).items()}
    at = [length * (i + 0.5) / joints for i in range(joints)]
    return Twin("arm", length, at, parameters, pressure_range_kpa=(0.0, 50.0))


def alone(twin: Twin, step_s: float) -> mujoco.MjModel:
    """Without weight, in physics steps of that length."""
    finger = mjcf(twin)
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><option timestep="{step_s!r}" integrator="implicitfast"'
        f' gravity="0 0 0"/><default>{finger.defaults}</default><asset>{finger.materials}'
        f'<material name="arm_dark"/></asset><worldbody>{finger.body}</worldbody>'
        f"<actuator>{finger.actuators}</actuator>{finger.tendons}</mujoco>"
    )
