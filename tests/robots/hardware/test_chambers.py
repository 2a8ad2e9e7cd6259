"""Controllers side by side: one command for all chambers, and whatever goes wrong with one vents all."""

from contextlib import ExitStack

import numpy as np
import pytest
from pressure_rig import terminal, until

from lerobot_robot_pneutac.hardware.parts import Chambers, HardwareFault
from lerobot_robot_pneutac.hardware.pneutac_serial import PneutacSerial
from lerobot_robot_pneutac.hardware.simulated import SimulatedPressure
from lerobot_robot_pneutac.robots.config_pneutac import PressureConfig
from pneutac_sim.errors import InputError

TARGETS = np.array([3.0, 8.0, 5.0])


def follows(chambers, kpa, within=0.3):
    """Whether it gets there, past readings that are merely too old on a busy computer."""

    def there():
        try:
            chambers.set_pressure(kpa)
            return np.abs(chambers.pressure() - kpa).max() < within
        except HardwareFault as e:
            assert " s old" in str(e)
            return False

    return until(there, 15.0)


def empty(chambers):
    """Likewise."""
    try:
        return np.abs(chambers.pressure()).max() < 0.5
    except HardwareFault as e:
        assert " s old" in str(e)
        return False


def rigs(stack, program, folder, **faulty):
    """Three firmwares in real time, and the options that reach them; `b` etc. name one's own options."""
    ports = []
    for name in "abc":
        stack.enter_context(terminal(program, folder / name, *faulty.get(name, ())))
        ports.append(str(folder / name))
    return PressureConfig(type="pneutac_serial", ports=tuple(ports), options={"reconnect_s": 10.0})


@pytest.mark.realtime
@pytest.mark.slow
def test_three_firmwares_follow_three_set_points_and_are_vented_together(program, tmp_path):
    with ExitStack() as stack:
        chambers = rigs(stack, program, tmp_path).make()
        chambers.connect()
        stack.callback(chambers.disconnect)
        assert follows(chambers, TARGETS)
        assert follows(chambers, TARGETS[::-1])
        chambers.vent()
        assert until(lambda: empty(chambers), 5.0)
        assert follows(chambers, TARGETS)
        assert until(lambda: empty(chambers), 5.0)  # nobody commands any more


@pytest.mark.realtime
@pytest.mark.slow
def test_a_burst_in_one_chamber_vents_the_others(program, tmp_path):
    with terminal(program, tmp_path / "b", "--burst", "--fault-at-s", 2):
        burst = PneutacSerial(str(tmp_path / "b"), reconnect_s=10.0)
        chambers = Chambers([SimulatedPressure(), burst, SimulatedPressure()])
        chambers.connect()
        fault = ""

        def failed():
            nonlocal fault
            try:
                chambers.set_pressure(TARGETS)
                chambers.pressure()
            except HardwareFault as e:
                fault = str(e)
            return "burst finger" in fault

        assert until(failed, 10.0) and str(tmp_path / "b") in fault
        first, _, third = chambers.controllers
        assert first._target_kpa == third._target_kpa == 0.0
        chambers.disconnect()
        assert not first._connected and not third._connected


@pytest.mark.realtime
@pytest.mark.slow
def test_a_controller_with_another_limit_is_reported_before_anything_fills(program, tmp_path):
    with ExitStack() as stack:
        config = rigs(stack, program, tmp_path, b=("--max-kpa", 10))
        with pytest.raises(HardwareFault, match="different limits, 15, 10, 15 kPa; give one for all"):
            config.make().connect()
        config.options |= {"max_kpa": [15.0, 10.0, 12.0]}
        chambers = config.make()
        chambers.connect()
        stack.callback(chambers.disconnect)
        np.testing.assert_allclose(chambers.max_kpa, [15, 10, 12])
        with pytest.raises(InputError, match="0 ... 10 kPa"):
            chambers.set_pressure(np.array([12.0, 12.0, 12.0]))


def test_a_set_point_that_one_refuses_leaves_none_filled():
    now = [0.0]
    parts = [SimulatedPressure(clock=lambda: now[0]) for _ in range(3)]
    chambers = Chambers(parts)
    chambers.connect()
    chambers.set_pressure(np.array([5.0, 5.0, 5.0]))
    now[0] += 0.2
    assert (chambers.pressure() > 3).all()
    with pytest.raises(InputError, match="outside this controller"):
        chambers.set_pressure(np.array([6.0, 6.0, 60.0]))
    assert [p._target_kpa for p in parts] == [0.0, 0.0, 0.0]
    with pytest.raises(ValueError, match="zip"):
        chambers.set_pressure(np.array([6.0, 6.0]))
    assert [p._target_kpa for p in parts] == [0.0, 0.0, 0.0]


def test_one_that_cannot_be_opened_lets_the_others_go():
    parts = [SimulatedPressure(), SimulatedPressure()]
    parts[1].connect = lambda: (_ for _ in ()).throw(HardwareFault("It is not there."))
    with pytest.raises(HardwareFault, match="not there"):
        Chambers(parts).connect()
    assert not parts[0]._connected


def test_all_are_vented_where_one_cannot_be():
    parts = [SimulatedPressure() for _ in range(3)]
    chambers = Chambers(parts)
    chambers.connect()
    chambers.set_pressure(TARGETS)
    parts[0].vent = lambda: (_ for _ in ()).throw(OSError("gone"))
    with pytest.raises(OSError, match="gone"):
        chambers.vent()
    assert [p._target_kpa for p in parts[1:]] == [0.0, 0.0]


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"ports": ("/a", "/b", "/a")}, "ports names /a for chambers 1 and 3; each chamber needs"),
        ({"ports": tuple("/a,/b,/c")}, "ports is '/a,/b,/c'; write a list in brackets, such as"),
        ({"ports": ("/a", "/b")}, "2 controllers are given; a finger has one chamber, an arm three"),
        ({"ports": ("/a", "/b", "/c"), "port": "/a"}, "port and ports are both given"),
        ({"ports": ("/a", "/b", "/c"), "chambers": 2}, "ports has 3 for chambers=2"),
        ({"port": "a", "chambers": 3}, "port is one for chambers=3; give ports"),
        (
            {"chambers": 3, "options": {"max_kpa": [1.0, 2.0]}},
            "options.max_kpa has 2 values for 3 controllers",
        ),
    ],
)
def test_options_that_do_not_fit_are_one_sentence(options, sentence):
    with pytest.raises(InputError, match=sentence):
        PressureConfig(type="simulated", **options).make()
