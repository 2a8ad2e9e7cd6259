import logging

import numpy as np
import pytest
from lerobot.teleoperators.keyboard import teleop_keyboard
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

from lerobot_robot_pneutac.hardware import safety
from lerobot_robot_pneutac.teleoperators import velocity_teleop


class Key:
    """A key event's key as the listener gives it: letters have `char`, others do not."""

    def __init__(self, char):
        self.char = char


class Special:
    name = "esc"


@pytest.mark.parametrize(
    ("key", "axis", "sign"), [("w", 0, 1), ("s", 0, -1), ("a", 1, 1), ("d", 1, -1), ("i", 2, 1), ("k", 2, -1)]
)
def test_a_held_key_moves_and_its_release_stops(teleop, act, key, axis, sign):
    keyboard = teleop("pneutac_keyboard", speed_m_s=0.04)
    keyboard.listener.press(Key(key))
    expected = np.zeros(4)
    expected[axis] = sign * 0.04
    np.testing.assert_allclose(act(keyboard, 3), expected)
    keyboard.listener.release(Key(key))
    np.testing.assert_array_equal(act(keyboard), np.zeros(4))


def test_diagonals_are_not_faster_and_opposed_keys_cancel(teleop, act):
    keyboard = teleop("pneutac_keyboard", speed_m_s=0.04)
    for key in "wi":
        keyboard.listener.press(Key(key))
    assert np.linalg.norm(act(keyboard)[:3]) == pytest.approx(0.04)
    for key in "sk":
        keyboard.listener.press(Key(key))
    np.testing.assert_array_equal(act(keyboard), np.zeros(4))


def test_a_release_counts_also_when_shift_came_in_between(teleop, act):
    keyboard = teleop("pneutac_keyboard")
    keyboard.listener.press(Key("w"))
    keyboard.listener.release(Key("W"))
    np.testing.assert_array_equal(act(keyboard), np.zeros(4))


def test_pressure_rises_at_its_rate_is_held_and_stays_in_its_limits(teleop, act):
    keyboard = teleop("pneutac_keyboard", pressure_rate_kpa_s=3.0, max_pressure_kpa=6.0)
    keyboard.listener.press(Key("l"))
    assert act(keyboard, 15)[3] == pytest.approx(3.0)
    keyboard.listener.release(Key("l"))
    np.testing.assert_allclose(act(keyboard, 30), [0, 0, 0, 3.0])
    keyboard.listener.press(Key("l"))
    assert act(keyboard, 45)[3] == 6.0
    keyboard.listener.release(Key("l"))
    keyboard.listener.press(Key("j"))
    assert act(keyboard, 15)[3] == pytest.approx(3.0)
    assert act(keyboard, 45)[3] == 0.0


def test_a_bend_is_led_from_its_smallest_to_its_largest_in_three_seconds(teleop, act):
    keyboard = teleop("pneutac_keyboard", bend_range_rad=(0.5, 1.1))
    assert "bend.pos" in keyboard.action_features and "pressure.pos" not in keyboard.action_features
    assert act(keyboard)[3] == 0.5
    keyboard.listener.press(Key("l"))
    assert act(keyboard, 15)[3] == pytest.approx(0.7)
    assert act(keyboard, 45)[3] == pytest.approx(1.1)


def test_after_a_slow_tick_the_pressure_does_not_jump(teleop, act, clock):
    keyboard = teleop("pneutac_keyboard", pressure_rate_kpa_s=5.0)
    keyboard.listener.press(Key("l"))
    before = act(keyboard, 15)[3]
    clock.now_s += 0.5
    assert before < act(keyboard)[3] <= before + 5.0 * velocity_teleop.MAX_TICK_S


def test_after_a_pause_in_which_the_robot_vents_the_pressure_starts_at_zero(teleop, act, clock):
    keyboard = teleop("pneutac_keyboard")
    keyboard.listener.press(Key("l"))
    act(keyboard, 30)
    keyboard.listener.release(Key("l"))
    clock.now_s += safety.VENT_S
    np.testing.assert_array_equal(act(keyboard), np.zeros(4))


def test_escape_leaves_the_keyboard_connected_for_the_episodes_last_ticks(teleop, act):
    keyboard = teleop("pneutac_keyboard")
    keyboard.listener.press(Special())
    keyboard.listener.release(Special())
    np.testing.assert_array_equal(act(keyboard), np.zeros(4))


def test_no_key_of_the_map_is_one_of_lerobot_records():
    from lerobot_robot_pneutac.teleoperators.velocity_teleop import KEYS

    assert not set(KEYS) & {"n", "r", "q"}


def test_lost_keyboard_stops_holds_the_pressure_and_says_so_once(teleop, act, caplog):
    keyboard = teleop("pneutac_keyboard", pressure_rate_kpa_s=3.0)
    for key in "wl":
        keyboard.listener.press(Key(key))
    act(keyboard, 15)
    keyboard.listener.alive = False
    np.testing.assert_allclose(act(keyboard, 5), [0, 0, 0, 3.0])
    assert [r.message for r in caplog.records if r.levelno == logging.ERROR] == [
        "The keyboard can no longer be read: the arm is stopped and the pressure held; end the command and"
        " start it again."
    ]


def test_where_keys_cannot_be_read_connecting_says_so(teleop, monkeypatch):
    monkeypatch.setattr(teleop_keyboard, "pynput_can_capture", lambda: False)
    keyboard = teleop("pneutac_keyboard", connect=False)
    with pytest.raises(DeviceNotConnectedError, match="needs an X11 session.*use pneutac_gamepad"):
        keyboard.connect()
    assert not keyboard.is_connected


def test_connection_is_asked_for(teleop, act):
    keyboard = teleop("pneutac_keyboard")
    with pytest.raises(DeviceAlreadyConnectedError):
        keyboard.connect()
    keyboard.disconnect()
    with pytest.raises(DeviceNotConnectedError):
        keyboard.get_action()
