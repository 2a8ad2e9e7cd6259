"""What is installed, what answers, and what to do where something does not."""

import importlib.metadata
import os
import platform
import shutil
import sys
from importlib.util import find_spec
from pathlib import Path

from rich.markup import escape
from rich.table import Table

from lerobot_pneutac.cli import INSTALL, PLUGIN
from lerobot_pneutac.cli.terminal import Terminal

OK, NOTE, FAIL = "ok", "note", "missing"
DEV = Path("/dev")
LEROBOT = "0.6"  # series that `lerobot_robot_pneutac` is tried on; it names the exact version
BENCH_PACKAGES = ("mujoco", "numba", "gymnasium", "numpy")  # what the distribution `pneutac` needs
PACKAGES = ("lerobot", "torch", *BENCH_PACKAGES, "pyserial")
Check = tuple[str, str, str, str]  # name, state, what was found, remedy


def check_package(name: str) -> Check:
    try:
        version, remedy = importlib.metadata.version(name), ""
    except importlib.metadata.PackageNotFoundError:
        version, remedy = "not installed", f"uv pip install {name}"
    if name == "lerobot" and not remedy and not version.startswith(f"{LEROBOT}."):
        remedy = f"PneuTac is made for LeRobot {LEROBOT}: uv pip install 'lerobot=={LEROBOT}.*'"
    return (name, FAIL if remedy else OK, version, remedy)


def check_plugin() -> Check:
    from lerobot.robots import RobotConfig
    from lerobot.utils.import_utils import register_third_party_plugins

    register_third_party_plugins()
    if "pneutac_sim" in RobotConfig.get_known_choices():
        return ("LeRobot plugin", OK, "--robot.type=pneutac_sim is known to LeRobot", "")
    remedy = "install this distribution into LeRobot's environment: uv pip install -e ."
    return ("LeRobot plugin", FAIL, "LeRobot does not list pneutac_sim", remedy)


def check_gpu() -> Check:
    import torch

    if torch.cuda.is_available():
        return ("GPU", OK, torch.cuda.get_device_name(0), "")
    return ("GPU", NOTE, "none; everything runs on the CPU", "")


def check_rendering() -> Check:
    from pneutac_sim.world import World

    world = World("switch", touch="none")
    world.reset(seed=0)
    world.render(64, 48)
    if world.renders_with_gl:
        return ("3-D rendering", OK, f"MuJoCo with MUJOCO_GL={os.environ.get('MUJOCO_GL', 'default')}", "")
    remedy = "install libegl1 and libgl1 (Mesa) for camera views; a drawing is shown until then"
    return ("3-D rendering", NOTE, "no OpenGL", remedy)


def check_ports() -> Check:
    from serial.tools import list_ports

    ports = [p.device for p in list_ports.comports()]
    return _devices("serial ports", ports, "dialout", "needed only for a real pressure controller")


def check_cameras() -> Check:
    devices = sorted(str(p) for p in DEV.glob("video*"))
    return _devices("cameras", devices, "video", "needed only for a real DIGIT or a bench camera")


def _devices(name: str, devices: list[str], group: str, use: str) -> Check:
    if not devices:
        return (name, NOTE, "none", use)
    blocked = [d for d in devices if not os.access(d, os.R_OK | os.W_OK)]
    if blocked:
        remedy = f"sudo usermod -aG {group} $USER, then log in again"
        return (name, FAIL, f"no permission on {', '.join(blocked)}", remedy)
    return (name, OK, ", ".join(devices), "")


def check_digit() -> Check:
    from lerobot_camera_digit.digit import find_digits

    digits = find_digits()
    if not digits:
        return ("DIGIT", NOTE, "none", "needed only on the bench; plug it in, without a hub")
    return ("DIGIT", OK, ", ".join(f"{d.serial} at {d.path}" for d in digits), "")


def check_arm() -> Check:
    try:
        return ("Panda", OK, f"franky {importlib.metadata.version('franky-control')}", "")
    except importlib.metadata.PackageNotFoundError:
        remedy = "needed only for a real arm: uv pip install -e './robots[panda]' in PneuTac's folder"
        return ("Panda", NOTE, "franky is not installed", remedy)


def check_home() -> Check:
    """LeRobot keeps calibration and datasets in HF_HOME, which must be writable."""
    from huggingface_hub.constants import HF_HOME

    home = Path(HF_HOME)
    parent = next(p for p in (home, *home.parents) if p.exists())
    free = shutil.disk_usage(parent).free / 1e9
    if not os.access(parent, os.W_OK):
        return ("HF_HOME", FAIL, f"{home} is not writable", "set HF_HOME to a folder of your own")
    return ("HF_HOME", OK if free > 5 else NOTE, f"{home}, {free:.0f} GB free", "")


CHECKS = (
    check_plugin, check_gpu, check_rendering, check_ports, check_cameras, check_digit, check_arm, check_home
)  # fmt: skip
BENCH_CHECKS = check_rendering, check_cameras


def check_all() -> list[Check]:
    rows = [("Python", OK if sys.version_info >= (3, 12) else FAIL, platform.python_version(), "")]
    bench = find_spec(PLUGIN) is None
    rows += map(check_package, BENCH_PACKAGES if bench else PACKAGES)
    if bench:
        rows.append(("LeRobot's half", NOTE, "not installed", INSTALL))
    for check in BENCH_CHECKS if bench else CHECKS:
        try:
            rows.append(check())
        except (ImportError, OSError) as e:  # a package or a system's library: what is looked for
            name = check.__name__.removeprefix("check_")
            do = "install what is missing, then run this again"
            rows.append((name, FAIL, f"{type(e).__name__}: {e}", do))
    return rows


COLOURS = {OK: "green", NOTE: "yellow", FAIL: "red"}


def command(argv: list[str], terminal: Terminal) -> None:
    if argv in (["-h"], ["--help"]):
        print("usage: pneutac doctor\n\nLists what is installed and which devices answer; takes no options.")
        return
    if argv:
        sys.exit("pneutac doctor takes no options.")
    rows = check_all()
    table = Table("", "state", "found", "remedy", box=None, header_style="dim")
    for name, state, found, remedy in rows:
        table.add_row(name, f"[{COLOURS[state]}]{state}[/]", escape(found), escape(remedy))
    terminal.console.print(table)
    if any(state == FAIL for _, state, _, _ in rows):
        sys.exit(1)
