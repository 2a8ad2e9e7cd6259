"""Dead time: the pressure follows the command only after a delay, p(t) = p_cmd(t - L)."""

import math

from pneutac_sim.effects import BodyEffect, Parameter, kernel

# Samples that are stored, a power of two: 1.5 s, the longest delay, at 1.3 kHz. Older ones are
# forgotten, which shortens the delay.
_KEPT = 2048


@kernel
def run(x, dt, theta, conditions, state):
    """State = a ring buffer: clock, oldest sample in use, newest + 1, slots' times, then their channels."""
    delay = theta[0]
    n, channels = x.shape
    clock, tail, head = state[0], int(state[1]), int(state[2])
    times, held = state[3 : 3 + _KEPT], state[3 + _KEPT :].reshape(_KEPT, channels)
    for t in range(n):
        if math.isinf(dt[t]):
            clock, tail, head = 0.0, 0, 0
        else:
            clock += dt[t]
        slot = head & (_KEPT - 1)
        times[slot] = clock
        for c in range(channels):
            held[slot, c] = x[t, c]
        head += 1
        tail = max(tail, head - _KEPT)
        wanted = clock - delay
        a = b = tail & (_KEPT - 1)
        while tail + 1 < head:
            b = (tail + 1) & (_KEPT - 1)
            if times[b] > wanted:
                break
            tail, a = tail + 1, b
        share = (wanted - times[a]) / (times[b] - times[a]) if wanted > times[a] and b != a else 0.0
        for c in range(channels):
            x[t, c] = held[a, c] + share * (held[b, c] - held[a, c])
    state[0], state[1], state[2] = clock, tail, head


EFFECT = BodyEffect(
    name="dead_time",
    stage="pneumatics",
    parameters=(Parameter("delay_s", "s", default=0.15, lower=0.0, upper=1.5, step=0.003, jump=0.12),),
    run=run,
    apart=True,
    state_size=lambda channels: 3 + _KEPT * (channels + 1),
    equation=r"p(t) = p_{cmd}(t - L)",
    cause="dead time, {delay_s:.2g} s",
    summary="Nothing happens for {delay_s:.2g} s after a logged command: your pressure starts late, or rows "
    "hold commands that are sent after their pose.",
    experiment="Command single steps and log the measured pressure at 50 Hz or more: it stays flat first.",
)
