"""What a hand changes between programs: how the base is turned, a weight at the tip, how warm it is."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from pneutac_sim.errors import InputError, refuse_given

HANDS = ("flip", "payload", "warm")
GRAVITY = ("gravity_x", "gravity_y", "gravity_z")


def _nobody(sentence: str) -> None:
    raise InputError(f"{sentence} There is no terminal to ask.")


@dataclass(frozen=True)
class Hands:
    """What may be changed, and who does it."""

    # condition columns and their values while nothing is changed; empty where nothing may be
    usual: Mapping[str, float] = field(default_factory=dict)
    # name to the conditions that are in force instead for a whole program
    changes: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    ask: Callable[[str], None] = _nobody  # called with a sentence for a person; returns once it is done

    @classmethod
    def of(
        cls,
        names: Sequence[str],
        usual: Mapping[str, float],
        payload_g: float,
        warm_c: float = 35.0,
        ask: Callable[[str], None] = _nobody,
    ) -> "Hands":
        """The changes of these names.

        Args:
            names: of `HANDS`.
            usual: conditions of the bench, with `gravity_x`, `gravity_y`, `gravity_z` of length 1 in the
                base's frame, and for `warm` with `temperature_c`.
            payload_g: weight that can be hung at the tip.
            warm_c: to which it can be warmed.
            ask: see the class.

        Raises:
            InputError: a name is unknown, or the direction of gravity or the temperature is not given.
        """
        if not names:
            return cls()
        for name in names:
            if name not in HANDS:
                raise InputError(f"hands={name} must be none, or some of {', '.join(HANDS)}.")
        if not set(GRAVITY) <= set(usual):
            raise InputError(
                "hands needs the direction of gravity in the base's frame: columns gravity_x, gravity_y and "
                "gravity_z, which `conditions: {gravity_x: 1, gravity_y: 0, gravity_z: 0}` of a bench writes."
            )
        if "warm" in names and "temperature_c" not in usual:
            raise InputError("hands=warm needs temperature_c, which `conditions` of a bench writes.")
        usual = dict(usual) | ({"payload_g": 0.0} if "payload" in names else {})
        known = {
            "flip": {g: -usual[g] + 0.0 for g in GRAVITY},
            "payload": {"payload_g": payload_g},
            "warm": {"temperature_c": warm_c},
        }
        return cls(usual, {n: usual | known[n] for n in names}, ask)


def named(text: str) -> tuple[str, ...]:
    """Names out of an option such as `flip,payload`; none of `none`."""
    return () if text == "none" else tuple(n.strip() for n in text.split(","))


def refuse_unused(options) -> None:
    """Raises InputError where the options of a command give a weight or a warmth that no hand brings."""
    for hand, name in (("payload", "payload_g"), ("warm", "warm_c")):
        if hand not in named(options.hands):
            refuse_given(options, (name,), f"is of --hands={hand}, which is not given")


def instructions(before: Mapping[str, float], after: Mapping[str, float]) -> list[str]:
    """What a person does between two programs, a sentence each."""
    steps = []
    if any(before.get(g) != after.get(g) for g in GRAVITY) and set(GRAVITY) <= set(after):
        toward = ", ".join(f"{after[g]:g}" for g in GRAVITY)
        steps.append(f"Turn the base so that gravity points along ({toward}) in its own frame.")
    weight = after.get("payload_g", 0.0)
    if before.get("payload_g", 0.0) != weight:
        steps.append(f"Hang {weight:g} g at the tip." if weight else "Take the weight off the tip.")
    warmth = after.get("temperature_c")
    if warmth is not None and before.get("temperature_c") != warmth:
        steps.append(f"Bring the finger to {warmth:g} °C.")
    return steps
