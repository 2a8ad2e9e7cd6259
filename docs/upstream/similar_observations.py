"""LeRobot's policy server drops the observations of a motion that is slow in the unit of the state."""

from lerobot.async_inference.configs import PolicyServerConfig
from lerobot.async_inference.helpers import TimedObservation
from lerobot.async_inference.policy_server import PolicyServer

HZ, SECONDS = 15, 10
CREEP_RAD = 0.2  # of a joint at constant pressure, in all


def used(unit_per_rad: float, must_go: bool = False) -> int:
    """How many observations of a creeping joint the server would give to the policy."""
    server, count = PolicyServer(PolicyServerConfig(fps=HZ)), 0
    names = ["joint.pos"]
    server.lerobot_features = {"observation.state": {"dtype": "float32", "shape": (1,), "names": names}}
    for k in range(HZ * SECONDS):
        angle = unit_per_rad * CREEP_RAD * k / (HZ * SECONDS)
        seen = TimedObservation(
            timestamp=k / HZ, timestep=k, observation={"joint.pos": angle}, must_go=must_go
        )
        if server._enqueue_observation(seen):
            server.last_processed_obs = server.observation_queue.get_nowait()  # as `GetActions` does
            count += 1
    return count


if __name__ == "__main__":
    total = HZ * SECONDS
    print(
        f"A joint creeps by {CREEP_RAD} rad in {SECONDS} s. In rad {used(1)} of {total} observations is used,"
    )
    print(f"in degrees {used(57.3)}, in thousandths of a rad {used(1000)}; with must_go {used(1, True)}.")
