"""What LeRobot logs, said in one line where it has a hundred."""

import importlib.util
import logging

from lerobot.utils import import_utils

from lerobot_robot_pneutac.lerobot_inside import NO_FFMPEG


def test_a_missing_ffmpeg_is_one_line_and_said_once(monkeypatch, caplog):
    def fails(name):
        raise RuntimeError("Could not load libtorchcodec.\n" + "\n".join(map(str, range(100))))

    monkeypatch.setattr(importlib.util, "find_spec", lambda name: name)
    monkeypatch.setattr(importlib, "import_module", fails)
    logger = logging.getLogger("lerobot.utils.import_utils")
    for found in [f for f in logger.filters if hasattr(f, "shown")]:
        monkeypatch.setattr(found, "shown", False)
    with caplog.at_level(logging.WARNING):
        assert [import_utils.get_safe_default_video_backend() for _ in range(3)] == ["pyav"] * 3
        logger.warning("Anything else %s.", "stays")
    assert caplog.messages == [NO_FFMPEG, "Anything else stays."]
