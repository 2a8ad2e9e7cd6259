"""What a cause is called: the same in every sentence, table, figure and file."""

from pneutac_sim.effects.laws import FAMILIES, curvature, family, is_law
from pneutac_sim.effects.registry import all_effects
from pneutac_sim.twin import Twin

PROFILE = "bend_profile"  # among known causes: the device bends by a profile of its own, which is no effect


def family_in(twin: Twin, effect: str) -> str:
    """The family of an effect, by the constants that a twin has for it and for its other static curves."""
    constants = {e: {k: v.value for k, v in values.items()} for e, values in twin.effects.items()}
    kind = family(effect, constants.get(effect))
    range_kpa = max((v.get("scale_kpa", 0.0) for v in constants.values()), default=0.0)
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
