"""Which optics effects a calibration of a gel fits."""

from collections.abc import Sequence

from pneutac_sim.effects.registry import of_sensor, sensor_effects
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin

EFFECTS, STANDARD = "effects", "standard"  # in the history of a twin whose effects nobody chose


def wanted(effects: Sequence[str] | None, twin: Twin) -> list[str] | None:
    """Optics effects to fit: those asked for, else those once chosen for the twin, else None (standard ones).

    An effect is chosen by `calibrate --effects` or `add`. What `pneutac new` writes are defaults, and what a
    calibration without `--effects` fits depends on its presses: neither binds the next one.

    Raises:
        InputError: a name is no optics effect, or acts on a session and not on one pair.
    """
    if effects is None:
        fits = [version for version in twin.history if version.get("unit") == "levels"]
        chosen = any(version.get(EFFECTS) != STANDARD for version in fits)
        return of_sensor(twin.effects) if twin.gel and chosen else None
    of_one_pair = [name for name, effect in sensor_effects().items() if not effect.of_session]
    for name in effects:
        if name not in of_one_pair:
            why = "needs more than one pair of images" if of_sensor([name]) else "is no optics effect"
            raise InputError(
                f"effects={','.join(effects)}: '{name}' {why}; give some of {','.join(of_one_pair)}, or "
                "none for the paper's linear model."
            )
    return list(dict.fromkeys(effects))
