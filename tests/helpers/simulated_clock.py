"""A clock for `lerobot_camera_digit.parts` on which waiting takes no time."""

from lerobot_camera_digit import parts


class SimulatedClock:
    """Its sleeps last what they should, but for those in `stalls_s`, by number."""

    def __init__(self, stalls_s=()):
        self.time_s, self.sleeps, self.stalls_s = 100.0, 0, dict(stalls_s)

    def now(self):
        return self.time_s

    def sleep(self, seconds):
        self.sleeps += 1
        self.time_s += self.stalls_s.get(self.sleeps, seconds)


def simulate_clock(monkeypatch) -> SimulatedClock:
    """Puts a simulated clock in the place of the computer's until the test ends."""
    clock = SimulatedClock()
    monkeypatch.setattr(parts, "clock", clock)
    return clock
