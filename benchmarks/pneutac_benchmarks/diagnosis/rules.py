"""How a diagnosis of a truth is scored; written before any result was seen.

Four counts, each on its own:

- *removed*: the share of the avoidable squared error that is gone on another day; 90 % counts.
- *near*: the error of that day within 1.5 times the noise floor.
- *right physics*: the headline is one of the names that `COUNTS` lists, with a verdict that names it. Of two,
  both must be found. Where the list is empty the grammar has no name for such physics, and right is not to
  claim one. Where the list holds `BASE`, how a body bends covers it, and to name nothing is right as well.
- *quiet*: where a disturbance is no physics of the device, nothing is named but the measurement itself.
"""

from collections.abc import Sequence

from pneutac_sim.effects.laws import family

COUNTS_AS_REMOVED = 0.9
COUNTS_AS_NEAR = 1.5
LEAST_ROOM = 0.05  # of the floor's square; with less there was nothing to remove
NAMED = ("missing_effect", "insufficient_form")
BASE = "how it bends"

# Truth -> families, effects or single laws that count as its physics, from the truth's own sentence.
COUNTS: dict[str, tuple[str, ...]] = {
    # air and command
    "fill_orifice": ("orifice_flow", "valve_lag"),
    "valve_slew": ("valve_slew", "orifice_flow"),  # choked air is a ramp, too
    "line_second_order": ("air_resonance", "ringing"),  # without a gauge the pose cannot tell which swings
    "leak": ("leak", "gain_saturation"),  # against a finite flow it is a droop that grows with pressure
    "hunting": (),
    "supply_sag": ("supply_sag", "rate", "orifice_flow", "valve_lag"),
    # p + w (lag(p) - p) with w < 0 is its equation, which counted as creep before it had a name of its own
    "gas_heat": ("relaxation", "creep"),
    "vent_slow": ("valve_lag", "orifice_flow"),
    "tube_kink": ("orifice_flow", "valve_lag", "lag(p; time moves with p)"),
    "dead_time": ("dead_time",),
    "valve_deadband": ("dead_band", "hysteresis"),
    "regulator_zero": (),
    "regulator_bow": ("stiffening", "gain_saturation"),
    "coarse_steps": ("quantisation",),
    "regulator_warm_up": ("warm_up", "self_heating", "thermal"),
    "valve_stiction": ("hysteresis", "friction"),
    "stalls": (),
    # chamber and body
    "unfolding": ("stiffening",),
    "chain_locking": ("gain_saturation", "stiffening"),
    "balloon_softening": ("stiffening", "gain_saturation"),
    "slack_chamber": ("contact", "stiffening"),
    "bellows_touch": ("contact", "gain_saturation", "stiffening"),
    "seam_snap": ("snap", "hysteresis"),
    "delamination": ("cyclic_softening",),
    "uneven_directions": ("crosstalk", BASE),
    "unequal_chambers": ("stiffening", "gain_saturation", BASE),
    "chamber_cross": ("crosstalk",),
    # material
    "creep_fractional": ("creep",),
    "standard_solid": ("creep",),
    "hysteresis_preisach": ("hysteresis",),
    "friction_maxwell": ("friction", "hysteresis"),
    "rate_stiffening": ("rate", "creep", "tanh(dp/dt)"),
    "mullins": ("cyclic_softening",),
    "set_norton": ("creep",),
    "filler_network": ("cyclic_softening", "self_heating"),  # p lag(|dp/dt|) is its equation
    "stretched_relaxation": ("creep",),
    "self_heating": ("self_heating", "thermal"),
    "temperature_drift": ("thermal",),
    "temperature_lag": ("thermal",),
    "humidity_swelling": (),
    "fatigue": ("cyclic_softening",),
    # load and base
    "gravity": ("gravity",),
    "payload": ("payload",),
    "stretch": ("elongation",),
    "out_of_plane": ("tip_y += z^2", "tip_y += x z"),
    "twist": ("twist", "tip_y += z^2", "tip_y += x z"),
    "mount_play": ("hysteresis",),
    "soft_clamp": ("base_tilt", BASE),
    "tube_drag": ("friction", "hysteresis"),
    "wall_lean": ("contact", "gain_saturation"),
    "wall_snap": ("snap", "contact", "hysteresis"),
    # a body that moves
    "ringing": ("ringing", "air_resonance"),
    "overdamped": ("creep", "valve_lag", "ringing"),  # a mode with a damping ratio above one
    "obstacle": ("contact", "gain_saturation"),
    # no physics of the device: what may be named is the measurement
    "gauge_clipping": (),
    "gauge_quantised": (),
    "gauge_late": (),
    "gauge_drifting": ("sensor_offset",),
    "gauge_span": ("sensor_offset",),
    "tracker_lowpass": ("tracker",),
    "tracker_latency": ("tracker",),
    "clock_jitter": (),
    "marker_slip": (),
    "tracker_outliers": (),
    "tracker_crosstalk": ("tracker", "camera_misalignment"),
    "lens_distortion": ("tracker", "camera_misalignment"),
    "mount_knock": (),
    "mount_turned": (),
    "tracker_freezes": (),
    "camera_warm_up": ("tracker",),
    "stand_shakes": (),
}


def removed(before: float, constant: float, after: float, floor: float) -> float | None:
    """Share of the avoidable squared error of another day that is gone; None where there was none.

    Args:
        before: root mean square error of the twin as it is, fitted to the first day.
        constant: of the day's own mean.
        after: of the twin with what was found.
        floor: noise.
    """
    room = min(before, constant) ** 2 - floor**2
    if room <= LEAST_ROOM * floor**2:
        return None
    return 1 - max(after**2 - floor**2, 0.0) / room


def counts(name: str, accepted: Sequence[str]) -> bool:
    """Whether a name that was found is one of those accepted, by itself or by its family."""
    return bool({name, name.partition(" #")[0], family(name)} & set(accepted))


def names_right(truth: Sequence[str], verdict: str, selected: Sequence[str], ratio: float) -> bool:
    """Whether the physics was named rightly.

    Args:
        truth: names of the truth's effects that are physics; none of a plain device.
        verdict: of the diagnosis.
        selected: effects and laws found, the most important first.
        ratio: error of another day over the floor.
    """
    if not truth:
        return not selected
    named = verdict in NAMED and bool(selected)
    accepted = [COUNTS[t] for t in truth if COUNTS[t]]
    covered = not selected and ratio <= COUNTS_AS_NEAR
    if len(truth) > 2:  # a whole device: the headline is one of its effects
        return named and any(counts(selected[0], a) for a in accepted)
    if not accepted:
        return verdict != "missing_effect"
    headline = not named or any(counts(selected[0], a) for a in accepted)
    parts = [(named and any(counts(s, a) for s in selected)) or (BASE in a and covered) for a in accepted]
    return headline and all(parts)


def names_too_much(disturbance: Sequence[str], physics: Sequence[str], selected: Sequence[str]) -> list[str]:
    """What was named that neither the physics nor the disturbance of the measurement allows."""
    allowed = [n for t in (*disturbance, *physics) for n in COUNTS[t]]
    return [s for s in selected if not counts(s, allowed)]
