"""Parameters of the soft solid of a finger, an arm or a gel."""

from pneutac_sim.gel.force import MATERIAL
from pneutac_sim.twin import PAPER_FINGER, Twin

WIDTH_MM = {"finger": 20.0, "arm": 40.0}
# A twin's parameters where it has none. Moduli of the finger: the paper's calibrated ones;
# density: Agilus30's data sheet; the gel's are in `gel.force`.
DEFAULTS = {
    "youngs_modulus_mpa": PAPER_FINGER["youngs_modulus_mpa"],
    "poissons_ratio": PAPER_FINGER["poissons_ratio"],
    "density_kg_m3": 1145.0,
    "spine_damping_nms_per_rad": 0.01,
    **MATERIAL,
    "gel_density_kg_m3": 1070.0,
}
# The controller is stiff against the body (0.07 to 0.29 N m/rad a joint of the finger), which takes back
# 1.6 % of its bend; with a soft one the search for rest takes far longer.
BY_DEVICE = {
    "width_mm": WIDTH_MM,
    "spine_stiffness_nm_per_rad": {"finger": 20.0, "arm": 200.0},
}


def parameter(twin: Twin, name: str) -> float:
    """The twin's value, or the default of `DEFAULTS` or `BY_DEVICE`."""
    if name in twin.parameters:
        return twin.parameters[name].value
    return BY_DEVICE[name][twin.device] if name in BY_DEVICE else DEFAULTS[name]
