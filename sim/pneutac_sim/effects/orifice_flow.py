"""Orifice flow: filling and venting through a restriction by ISO 6358.

mdot = C rho0 p1 sqrt(T0/T1) psi, psi = 1 if p2/p1 <= b (choked) else sqrt(1 - ((p2/p1 - b) / (1 - b))^2),
and p' = n R T mdot / V. Only k = n R T C rho0 / V can be seen in a recording, so k is the parameter:
p' = k p1 psi with absolute pressures. The regulator's output p_cmd is upstream while filling, downstream
while venting.

With y = (p2/p1 - b) / (1 - b) = sin(phi), filling is phi' = k / (1 - b), exact; venting is
phi' = k (b + (1 - b) sin(phi)) / (1 - b), smooth, done by the midpoint rule. The square root's infinite slope
at p1 = p2, on which ordinary integrators stall, is gone in phi.
"""

import math

from pneutac_sim.effects import BodyEffect, Parameter, kernel

ATMOSPHERE_KPA = 101.325
_PIECES = 4  # the command is followed along a straight line between samples, in this many steps


@kernel
def fill(p, p1, k, b, h):
    """Chamber pressure after `h` seconds of inflow from constant `p1`, all absolute, p <= p1."""
    r = p / p1
    if r < b:
        choked = (b - r) / k
        if h <= choked:
            return p + k * p1 * h
        h -= choked
        r = b
    phi = math.asin(min((r - b) / (1 - b), 1.0)) + k * h / (1 - b)
    return p1 if phi >= 0.5 * math.pi else p1 * (b + (1 - b) * math.sin(phi))


@kernel
def vent(p, p2, k, b, h):
    """Chamber pressure after `h` seconds of outflow to constant `p2`, all absolute, p >= p2."""
    if p2 / p < b:
        choked = math.log(b * p / p2) / k
        if h <= choked:
            return p * math.exp(-k * h)
        h -= choked
        p = p2 / b
    phi = math.asin(min((p2 / p - b) / (1 - b), 1.0))
    steps = 1 + int(min(32.0 * k * h, 128.0))
    g = k * h / (1 - b) / steps
    for _ in range(steps):
        middle = phi + 0.5 * g * (b + (1 - b) * math.sin(phi))
        phi += g * (b + (1 - b) * math.sin(middle))
        if phi >= 0.5 * math.pi:
            return p2
    return p2 / (b + (1 - b) * math.sin(phi))


@kernel
def run(x, dt, theta, conditions, state):
    """State = per channel the gauge pressure and the command before."""
    fill_rate, vent_rate, b = theta[0], theta[1], theta[2]
    n, channels = x.shape
    p, before = state[:channels], state[channels:]
    for t in range(n):
        for c in range(channels):
            command = x[t, c]
            if math.isinf(dt[t]):
                p[c] = command
            else:
                for i in range(_PIECES):
                    target = command - (command - before[c]) * (_PIECES - 1 - i) / _PIECES
                    rate = fill_rate if target > p[c] else vent_rate
                    if p[c] == target or math.isinf(rate):
                        p[c] = target
                        continue
                    now, other = ATMOSPHERE_KPA + p[c], max(ATMOSPHERE_KPA + target, 1.0)
                    step = dt[t] / _PIECES
                    if target > p[c]:
                        after = fill(now, other, rate, b, step)
                    else:
                        after = vent(now, other, rate, b, step)
                    p[c] = target if after == other else after - ATMOSPHERE_KPA
            before[c] = command
            x[t, c] = p[c]


EFFECT = BodyEffect(
    name="orifice_flow",
    stage="pneumatics",
    parameters=(
        Parameter("fill_rate_1_per_s", "1/s", 0.5, 0.02, 300.0, neutral=math.inf, log=True),
        Parameter("vent_rate_1_per_s", "1/s", 0.5, 0.02, 300.0, neutral=math.inf, log=True),
        Parameter("critical_ratio", "", default=0.3, lower=0.1, upper=0.528, neutral=0.3, fixed=True),
    ),
    run=run,
    apart=True,
    state_size=lambda channels: 2 * channels,
    equation=r"\dot p = \pm k\,p_1\,\psi, \quad \psi = \sqrt{1 - \left(\frac{p_2/p_1 - b}{1 - b}\right)^2} "
    r"\text{ or, where } p_2/p_1 \le b, \; 1",
    cause="air flow through a narrow line",
    summary="Air flows through a narrow line: large steps take longer than small ones (filling rate "
    "{fill_rate_1_per_s:.2g} 1/s, venting {vent_rate_1_per_s:.2g} 1/s).",
    experiment="Step to several pressures and back and log the measured pressure: large steps take longer.",
)
