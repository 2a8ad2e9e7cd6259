"""Registry, simulated controller, and the worked example of docs/how_to/add_a_pressure_controller.md."""

import importlib
import math
import re
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from installed import install

from lerobot_robot_pneutac.hardware.parts import COMMAND_S, HardwareFault
from lerobot_robot_pneutac.hardware.pneutac_serial import PneutacSerial
from lerobot_robot_pneutac.hardware.pressure import make_pressure_controller, pressure_controller_types
from lerobot_robot_pneutac.hardware.pressure_check import check_pressure_controller
from lerobot_robot_pneutac.hardware.serial_pressure import TextSerial
from lerobot_robot_pneutac.hardware.simulated import SimulatedPressure
from pneutac_sim.errors import InputError

DOC = Path(__file__).parents[3] / "docs" / "how_to" / "add_a_pressure_controller.md"


def blocks(kind):
    return re.findall(rf"```{kind}\n(.*?)```", DOC.read_text(), re.S)


@pytest.fixture
def example(tmp_path, monkeypatch):
    code, test = blocks("python")
    project = tomllib.loads(blocks("toml")[0])["project"]
    (tmp_path / "check_my_regulator.py").write_text(test)
    points = project["entry-points"]["pneutac.pressure_controllers"]
    install(tmp_path, "pneutac_my_regulator", "pressure_controllers", points, code)
    monkeypatch.syspath_prepend(tmp_path)
    yield importlib.import_module("check_my_regulator")
    for name in ("pneutac_my_regulator", "check_my_regulator"):
        sys.modules.pop(name, None)


@pytest.mark.realtime
def test_the_guides_example_is_found_and_passes_the_guides_own_test(example):
    assert pressure_controller_types()[3:] == ["my_regulator"]
    example.test_regulator()
    made = make_pressure_controller("my_regulator", port="none", max_kpa=10)
    made.connect()
    with pytest.raises(InputError, match="0 ... 10 kPa"):
        made.set_pressure(11)
    made.disconnect()


def test_built_in_types_are_made_with_their_options():
    assert pressure_controller_types() == ["pneutac_serial", "text_serial", "simulated"]
    assert isinstance(make_pressure_controller("pneutac_serial", port="/dev/x", max_kpa=10), PneutacSerial)
    assert isinstance(make_pressure_controller("text_serial", port="/dev/x", max_kpa="10"), TextSerial)
    assert make_pressure_controller("simulated", max_kpa=10).max_kpa == 10


@pytest.mark.parametrize(
    "type, options, said",
    [
        ("festo", {}, "no pressure controller 'festo'; there are pneutac_serial, text_serial, simulated"),
        ("pneutac_serial", {}, "'pneutac_serial': option 'port' is missing"),
        ("simulated", {"port": "/dev/x"}, "unknown option 'port'"),
        ("text_serial", {"port": "/dev/x", "max_kpa": math.nan}, "max_kpa is nan"),
        ("text_serial", {"port": "/dev/x", "max_kpa": "much"}, "max_kpa is 'much'"),
        ("pneutac_serial", {"port": "/dev/x", "reconnect_s": -1}, "reconnect_s is -1"),
    ],
)
def test_bad_types_and_options_are_named(type, options, said):
    with pytest.raises(InputError) as e:
        make_pressure_controller(type, **options)
    assert said in str(e.value)


def test_what_other_packages_offer_is_checked(tmp_path, monkeypatch):
    points = {"dictionary": "collections:OrderedDict"}
    install(tmp_path, "pneutac_dict", "pressure_controllers", points)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InputError, match="'dictionary' has no method connect, set_pressure"):
        make_pressure_controller("dictionary")
    install(tmp_path, "pneutac_other", "pressure_controllers", {"simulated": "collections:OrderedDict"})
    with pytest.raises(InputError, match="Two packages offer a pressure controller 'simulated'"):
        make_pressure_controller("simulated")


@pytest.mark.realtime
@pytest.mark.slow
def test_the_check_tells_what_a_controller_fails(monkeypatch):
    monkeypatch.setattr("lerobot_robot_pneutac.hardware.pressure_check.REACH_S", 0.6)

    class Holds(SimulatedPressure):
        def pressure(self):
            self._void_s = math.inf
            return super().pressure()

    class Leaks(SimulatedPressure):
        def pressure(self):
            return 0.5 * super().pressure()

    with pytest.raises(HardwareFault, match="keeps its pressure"):
        check_pressure_controller(Holds(), 5.0)
    with pytest.raises(HardwareFault, match="does not reach 5 kPa"):
        check_pressure_controller(Leaks(), 5.0)


@pytest.mark.realtime
def test_the_simulated_controller_passes_the_check():
    check_pressure_controller(SimulatedPressure(), 5.0)


def test_the_simulated_chamber_follows_the_exact_exponential_until_its_command_is_void():
    now = [0.0]
    chamber = SimulatedPressure(time_constant_s=0.1, clock=lambda: now[0])
    chamber.connect()
    chamber.set_pressure(10.0)
    times = np.linspace(0, 0.6, 61)
    kpa = []
    for now[0] in times:
        kpa.append(chamber.pressure())
    peak = 10 * (1 - math.exp(-COMMAND_S / 0.1))
    rising, falling = 10 * (1 - np.exp(-times / 0.1)), peak * np.exp(-(times - COMMAND_S) / 0.1)
    np.testing.assert_allclose(kpa, np.where(times <= COMMAND_S, rising, falling), atol=1e-9)


@pytest.mark.parametrize(
    "bad, said", [(math.nan, "nan"), (math.inf, "inf"), (-0.1, "-0.1"), ("soft", "'soft'"), (15.1, "15.1")]
)
def test_a_set_point_that_is_none_is_refused_by_name(bad, said):
    chamber = SimulatedPressure()
    chamber.connect()
    with pytest.raises(ValueError, match=said):
        chamber.set_pressure(bad)
    assert chamber.pressure() == 0


def test_a_controller_without_its_highest_set_point_fails_the_check():
    controller = SimulatedPressure()
    del controller.max_kpa
    with pytest.raises(HardwareFault, match="no max_kpa"):
        check_pressure_controller(controller, 5.0)
