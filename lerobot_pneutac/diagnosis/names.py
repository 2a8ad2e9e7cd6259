"""What a cause is called: the same in every sentence, table, figure and file."""

import numpy as np

from lerobot_pneutac.diagnosis import thresholds as T
from pneutac_sim.effects.laws import FAMILIES, curvature, curve, family, is_law
from pneutac_sim.effects.registry import all_effects
from pneutac_sim.twin import Twin

PROFILE = "bend_profile"  # among known causes: the device bends by a profile of its own, which is no effect

CURVES = ("stiffening", "gain_saturation", "contact")  # families of static curves


def _constants(twin: Twin) -> tuple[dict[str, dict[str, float]], float]:
    """The constants of a twin's effects, and the range of pressure that they name; 0 where none does."""
    constants = {e: {k: v.value for k, v in values.items()} for e, values in twin.effects.items()}
    return constants, max((v.get("scale_kpa", 0.0) for v in constants.values()), default=0.0)


def family_in(twin: Twin, effect: str) -> str:
    """The family of an effect, by the constants that a twin has for it and for its other static curves."""
    constants, range_kpa = _constants(twin)
    kind = family(effect, constants.get(effect))
    if not curvature(effect, constants.get(effect, {}), range_kpa):
        return kind
    bent = sum(curvature(e, v, range_kpa) for e, v in constants.items())
    return "stiffening" if bent > 0 else "gain_saturation"


def called(name: str, twin: Twin | None = None) -> str:
    """The family of an effect, a law or a cause in plain words, by the constants of a twin that has it.

    A law's own name follows, as of an effect that acts as another family: `creep (lag(p))`.
    """
    if name == PROFILE:
        return "a bend that is uneven along its length"
    kind = family_in(twin, name) if twin is not None and name in twin.effects else family(name)
    effect = all_effects().get(kind)
    words = effect.plain_cause if effect else kind.replace("_", " ")
    words = FAMILIES[kind][1] if kind in FAMILIES else words
    return f"{words} ({name})" if is_law(name) or kind != name else words


def hardly_bends(twin: Twin, effect: str) -> str:
    """Where a twin with a static curve hardly bends on slow strokes, such as `it hardly bends below 7 kPa`.

    By all its effects, since one may compensate for another; empty where it bends everywhere, and for an
    effect that is no such curve.
    """
    constants, range_kpa = _constants(twin)
    if not range_kpa or effect not in constants or family(effect, constants[effect]) not in CURVES:
        return ""
    smooth = {e: v for e, v in constants.items() if family(e, v) != "quantisation"}
    effective = np.linspace(0, 1, 101) + sum(curve(e, v, range_kpa) for e, v in smooth.items())
    weak = np.diff(effective) * 100 < T.WEAK_GAIN * (effective[-1] - effective[0])
    begin, end = max(
        np.flatnonzero(np.diff(np.r_[False, weak, False])).reshape(-1, 2),
        key=lambda e: e[1] - e[0],
        default=(0, 0),
    )
    if end - begin < T.WEAK_RANGE * 100:
        return ""
    low, high = f"{begin / 100 * range_kpa:.2g}", f"{end / 100 * range_kpa:.2g}"
    where = f"below {high}" if begin == 0 else f"above {low}" if end == 100 else f"between {low} and {high}"
    return f"it hardly bends {where} kPa"
