"""Ends in one sentence where LeRobot is too old, whose imports here would end in tracebacks."""

import re
import sys
from importlib.metadata import version

OLDEST = "0.6.1"

if [int(n) for n in re.findall(r"\d+", version("lerobot"))[:3]] < [int(n) for n in OLDEST.split(".")]:
    sys.exit(
        f"LeRobot {version('lerobot')} is too old for lerobot_camera_digit and lerobot_robot_pneutac; they"
        f" need {OLDEST} or later; pip install 'lerobot>={OLDEST},<0.7'."
    )
