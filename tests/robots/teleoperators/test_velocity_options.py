import pytest
from draccus.utils import DecodingError
from lerobot.teleoperators import TeleoperatorConfig


@pytest.mark.parametrize(
    ("kind", "options", "text"),
    [
        ("pneutac_keyboard", {"speed_m_s": 0.2}, "speed_m_s is 0.2; it must be above 0 and at most 0.1"),
        ("pneutac_keyboard", {"max_pressure_kpa": -20.0}, "max_pressure_kpa is -20.0.*must be 0 or above"),
        ("pneutac_keyboard", {"max_pressure_kpa": 0.0}, "and not both 0"),
        ("pneutac_keyboard", {"bend_range_rad": (1.2, 0.5)}, "give the smaller bend first"),
        (
            "pneutac_spacemouse",
            {"pressure_rate_kpa_s": 0.0},
            "pressure_rate_kpa_s is 0.0; it must be positive",
        ),
        ("pneutac_gamepad", {"dead_zone": 1.0}, "dead_zone is 1.0"),
        ("pneutac_gamepad", {"speed_m_s": float("nan")}, "speed_m_s is nan"),
    ],
)
def test_bad_options_are_one_sentence(kind, options, text):
    with pytest.raises(DecodingError, match=text):
        TeleoperatorConfig.get_choice_class(kind)(**options)
