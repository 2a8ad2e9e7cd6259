"""What laws are called, and what to record to see each apart from its neighbours, by what it remembers."""

from pneutac_sim.effects import memories as by

# Family to what such physics does to a device.
WORDS = {
    "stiffening": "does not bend in proportion to the pressure",
    "gain_saturation": "saturates (each further kPa bends it less)",
    "contact": "bends otherwise above a pressure, as if it met something",
    "hysteresis": "has hysteresis (at one pressure it bends otherwise on the way up than on the way down)",
    "snap": "snaps over at a pressure and back at a lower one",
    "creep": "creeps (it goes on bending while the pressure is held)",
    "valve_lag": "fills and vents slower than it is commanded",
    "ringing": "rings (it swings on after a step)",
    "leak": "loses pressure while it is held",
    "friction": "is held back by friction",
    "rate": "bends less or more the faster it moves",
    "cyclic_softening": "is softer or stiffer after high pressures or many cycles",
    "self_heating": "bends otherwise the more it moves, as if it warmed itself",
    "thermal": "bends more or less when it is warm",
    "dead_band": "stays where it is until its command has moved enough",
    "warm_up": "bends otherwise in the first minutes of a session",
}

# Family to what it is called in a list of causes, and how a constant is shown there.
CAUSES = {
    "stiffening": "a gain that changes with pressure",
    "gain_saturation": "saturation",
    "contact": "another gain above a pressure",
    "hysteresis": "hysteresis",
    "snap": "snap-through",
    "creep": "creep",
    "valve_lag": "a slow valve",
    "ringing": "oscillation after a step",
    "leak": "loss of pressure during holds",
    "friction": "friction",
    "rate": "dependence on the rate",
    "cyclic_softening": "softening with use",
    "self_heating": "dependence on recent motion",
    "thermal": "temperature",
    "dead_band": "a dead band",
    "warm_up": "change over the first minutes",
}
CONSTANTS = {
    "time_s": "time constant {time_s:.2g} s",
    "frequency_rad_per_s": "{hz:.2g} Hz",
    "damping_ratio": "damping ratio {damping_ratio:.2g}",
    "fill_time_s": "{fill_time_s:.2g} s to fill",
    "vent_time_s": "{vent_time_s:.2g} s to vent",
    "threshold_kpa": "from {threshold_kpa:.2g} kPa",
    "width_kpa": "width {width_kpa:.2g} kPa",
    "centre_kpa": "at {centre_kpa:.2g} kPa",
}

_FORM = "Go up and down in ten equal stairs: what depends on the pressure alone is the same on both ways."
_TURNS = (
    "Go back and forth by small and by large steps, slowly and quickly: the loop is as wide at both paces."
)
_PACES = "Go up and down at three paces, a factor of three apart, and stop: it differs by the pace alone."
_SEEN_BY = {
    **dict.fromkeys((by.PLAIN, by.CUBE, by.POWER, by.TANH, by.STEP), _FORM),
    **dict.fromkeys((by.PLAY, by.PLAY_TWO, by.PLAY_CUBED, by.LOOP), _TURNS),
    by.HINGE: "Go up in small stairs through the threshold: each step differs above it, none below.",
    by.LAG: "Step to half and to full pressure, hold three time constants each, vent as long: the bend goes "
    "on and then stops.",
    by.LAG_PRESSURE: "Step to half and to full pressure and hold each: the bend goes on at another pace.",
    by.LAG_WARM: "Step and hold, cold and warm: the bend goes on at another pace.",
    by.SPECTRUM: "Step, hold 100 s, vent as long: the bend still goes on from 10 to 100 s.",
    by.HELD: "Hold a pressure for long: the bend falls at a steady pace, and not while the pressure moves.",
    by.FILL_VENT: "Step up and down to two levels, at 20 Hz or more: filling and venting take other times.",
    by.MODE: "Step up and down at ten samples a swing or more: it swings about where it ends.",
    **dict.fromkeys((by.TANH_OF, by.ROOT_LAG), _PACES),
    by.FADING: "Small strokes, one to the top, small ones again for three time constants: the change fades.",
    by.BELOW: "Small strokes, one to the top, small ones again, also after a rest: the change stays.",
    by.PATH: "After a night's rest make many equal strokes: each differs a little less from the one before.",
    by.FLIP: "Go slowly through the snap and back: it comes at a higher pressure on the way up.",
    by.DEAD_BAND: "Go up and down by steps smaller than the band: nothing moves until they add up to it.",
    by.FADING_TIME: "After a night's rest make a stroke now and then: it changes with the time alone.",
}


def seen_by(input: int, memory: int, role: int) -> str:
    """What to record to see a law, from its codes (see `memories`)."""
    if input == by.CONDITION:
        return (
            "Make equal strokes while it warms, for several time constants: they follow the temperature late."
        )
    if memory == by.LAG and input in (by.SPEED, by.WORK):
        where = "more so about high pressures" if input == by.WORK else "alike about low and high pressures"
        return f"Make quick strokes, then hold: what the motion changed comes back, {where}."
    if memory == by.LAG and role == by.GAIN:
        return "Hold the full pressure, then go to half of it: it bends otherwise there than after a rest."
    if memory == by.LAG and input == by.P_SQUARED:
        return _SEEN_BY[memory][:-1] + ", four times as much at the full pressure."
    return _SEEN_BY[memory]
