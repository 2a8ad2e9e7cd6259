"""Rate-independent hysteresis: Prandtl-Ishlinskii, a sum of plays that trail behind the pressure.

y = (p + sum_i w_i play(p, r_i)) / (1 + sum_i w_i) (Krasnosel'skii and Pokrovskii, Systems with Hysteresis,
1989; Kuhnen, European Journal of Control 9, 2003), with r_i = half-width x (0.04, 0.12, 0.3, 0.6, 1) and
w_i >= 0. On the way back the bend is larger than on the way out: it lags the pressure. The plays keep their
memory from trial to trial.
"""

import numpy as np

from pneutac_sim.effects import BodyEffect, Parameter, kernel

_SHARES = np.array([0.04, 0.12, 0.3, 0.6, 1.0])


@kernel
def run(x, dt, theta, conditions, state):
    """State = per channel the five plays."""
    n, channels = x.shape
    width, w = theta[0], theta[1:]
    total = 1.0 + w.sum()
    for t in range(n):
        for c in range(channels):
            p = x[t, c]
            y = p
            for i in range(len(w)):
                r = width * _SHARES[i]
                play = min(max(state[i * channels + c], p - r), p + r)
                state[i * channels + c] = play
                y += w[i] * play
            x[t, c] = y / total if total != 1.0 else p


EFFECT = BodyEffect(
    name="hysteresis",
    stage="drive",
    parameters=(
        Parameter("width_kpa", "kPa", 0.5, 0.01, 1.0, neutral=1.0, fixed=True, range_power=1),
        *(Parameter(f"weight_{i + 1}", "", default=0.05, lower=0.0, upper=1.5) for i in range(5)),
    ),
    run=run,
    apart=True,
    state_size=lambda channels: 5 * channels,
    equation=r"p \to \frac{p + \sum_i w_i\,\mathrm{play}_{r_i}(p)}{1 + \sum_i w_i}",
    cause="hysteresis, loop of {percent:.0f} % of the bend",
    summary="Your {device} has hysteresis: it bends differently when pressure rises and falls, however "
    "slowly (loop of {percent:.0f} % of the bend).",
    experiment="Run one loop up and down at two speeds, ten times apart: a loop that stays is hysteresis.",
    derive=lambda v: {"percent": _loop_percent(v)},
)


def _loop_percent(v: dict[str, float]) -> float:
    """Widest opening of the loop between zero and twice `width_kpa`, in percent of the travel."""
    top = 2 * v["width_kpa"]
    p = np.r_[np.linspace(0, top, 101), np.linspace(top, 0, 101)]
    y = EFFECT.apply(p, np.ones(202), v)
    return 100 * float(np.max(y[101:][::-1] - y[:101])) / top
