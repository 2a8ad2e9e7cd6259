import pytest
from pressure_rig import SimulatedTime, build


@pytest.fixture(scope="session")
def program():
    return build()


@pytest.fixture
def start(program):
    """Starts the firmware on a simulated chamber and, unless the session is None, opens it."""
    rigs = []

    def make(*options, session=7):
        rigs.append(SimulatedTime(program, *options))
        if session:
            rigs[-1].open(session)
        return rigs[-1]

    yield make
    for rig in rigs:
        rig.close()
