"""The firmware's states and what leads from one to another, found by bringing each about in the simulator.

python tests/helpers/controller_states.py writes the table of the controller's promise anew.
"""

import os
import tempfile

from pressure_rig import FIRMWARE, SimulatedTime, build

from lerobot_robot_pneutac.hardware import pneutac_serial as wire
from lerobot_robot_pneutac.hardware.pneutac_serial import Flag

PAGE = FIRMWARE.parent / "docs" / "concepts" / "controllers_promise.md"
PICTURE = FIRMWARE.parent / "docs" / "pictures" / "controller_states.svg"
FAULTS = Flag.OVER_PRESSURE | Flag.SENSOR_FAULT | Flag.STUCK_VALVE | Flag.BURST_LINE | Flag.TOO_MUCH_AIR
STATES = ("waiting", "ready", "following", "heartbeat lost", "fault")
BEGIN, END = "<!-- table -->\n", "<!-- end of table -->\n"


class Bench:
    """A firmware in simulated time with the numbers that a host keeps."""

    def __init__(self, program):
        self.rig = SimulatedTime(program, "--seed", 1)
        self.session, self.number = 0, 0
        self.rig.run(20)

    def steps(self, ms, beating=True):
        for _ in range(0, ms, 10):
            self.number += 1
            if beating:
                self.rig.send(wire.heartbeat(self.session, self.number))
            self.rig.run(10)

    def hello(self, clear_faults):
        self.session += 1
        self.rig.open(self.session, clear_faults)

    def set_point(self, pa):
        self.number += 1
        self.rig.send(wire.set_point(self.session, self.number, pa))

    def vent(self):
        self.number += 1
        self.rig.send(wire.vent(self.session, self.number))

    def state(self) -> str:
        frame = next(f for f in reversed(self.rig.frames) if wire.read_status(f))
        flags = wire.read_status(frame).flags
        assert (Flag.VENTED in flags) == (self.rig.trace[-1][3:] == (0, 1))
        if flags & FAULTS:
            return "fault"
        if Flag.HEARTBEAT_LOST in flags:
            return "heartbeat lost"
        if Flag.VENTED not in flags:
            return "following"
        return "ready" if frame.session else "waiting"


EVENTS = {
    "hello with the nonce": lambda b: b.hello(False),
    "the same, clearing faults": lambda b: b.hello(True),
    "any other hello": lambda b: b.rig.send(wire.hello(b.session + 1, True, 1)),
    "set-point within the limits": lambda b: b.set_point(5000),
    "set-point outside": lambda b: b.set_point(15001),
    "vent": lambda b: b.vent(),
    "80 ms without a heartbeat": lambda b: b.steps(100, beating=False),
    "a fault": lambda b: b.rig.see(16501),
}
WAYS = {
    "waiting": (),
    "ready": ("hello with the nonce",),
    "following": ("hello with the nonce", "set-point within the limits"),
    "heartbeat lost": ("hello with the nonce", "80 ms without a heartbeat"),
    "fault": ("hello with the nonce", "a fault"),
}


def transitions(program) -> dict[tuple[str, str], str]:
    """{(state, event): state after it}."""
    found = {}
    for state, way in WAYS.items():
        for event, do in EVENTS.items():
            bench = Bench(program)
            for step in way:
                EVENTS[step](bench)
                bench.steps(20)
            assert bench.state() == state, f"{bench.state()} is not {state}"
            do(bench)
            bench.steps(20)
            found[state, event] = bench.state()
            bench.rig.close()
    return found


def table(found) -> str:
    lines = [f"| event | {' | '.join(STATES)} |", "|---|" + "---|" * len(STATES)]
    for event in EVENTS:
        after = (found[state, event] for state in STATES)
        cells = ["-" if new == state else new for state, new in zip(STATES, after, strict=True)]
        lines.append(f"| {event} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        os.environ["PNEUTAC_TEST_RECORDINGS"] = folder
        found = transitions(build())
    before, rest = PAGE.read_text().split(BEGIN)
    PAGE.write_text(before + BEGIN + "\n" + table(found) + "\n" + END + rest.split(END)[1])


if __name__ == "__main__":
    main()
