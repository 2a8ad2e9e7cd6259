"""Dead time: the pressure follows the command only after a delay, p(t) = p_cmd(t - L)."""

import math

from pneutac_sim.effects.body_effect import BodyEffect, kernel
from pneutac_sim.effects.effect import Parameter

# Samples that are stored, a power of two: 1.5 s, the longest delay, at 1.3 kHz. Older ones are
# forgotten, which shortens the delay.
_KEPT = 2048


@kernel
def run(x, dt, theta, conditions, state):
    """State = a ring buffer: clock, oldest sample in use, newest + 1, then per slot time and channels."""
    delay = theta[0]
    n, channels = x.shape
    width = channels + 1
    clock, tail, head = state[0], int(state[1]), int(state[2])
    for t in range(n):
        if math.isinf(dt[t]):
            clock, tail, head = 0.0, 0, 0
        else:
            clock += dt[t]
        slot = 3 + (head & (_KEPT - 1)) * width
        state[slot] = clock
        for c in range(channels):
            state[slot + 1 + c] = x[t, c]
        head += 1
        tail = max(tail, head - _KEPT)
        wanted = clock - delay
        a = b = 3 + (tail & (_KEPT - 1)) * width
        while tail + 1 < head:
            b = 3 + ((tail + 1) & (_KEPT - 1)) * width
            if state[b] > wanted:
                break
            tail, a = tail + 1, b
        share = (wanted - state[a]) / (state[b] - state[a]) if wanted > state[a] and b != a else 0.0
        for c in range(channels):
            x[t, c] = state[a + 1 + c] + share * (state[b + 1 + c] - state[a + 1 + c])
    state[0], state[1], state[2] = clock, tail, head


EFFECT = BodyEffect(
    name="dead_time",
    stage="pneumatics",
    parameters=(Parameter("delay_s", "s", default=0.15, lower=0.0, upper=1.5, step=0.003, jump=0.12),),
    run=run,
    apart=True,
    state_size=lambda channels: 3 + _KEPT * (channels + 1),
    equation=r"p(t) = p_{cmd}(t - L)",
    cause="a dead time of {delay_s:.2g} s",
    summary="Your pressure starts late: nothing happens for {delay_s:.2g} s after a command.",
    experiment="Command single steps and log the measured pressure at 50 Hz or more: it stays flat first.",
)
