"""The distribution as a user gets it: found by LeRobot, light to import, and shadowing nobody's package."""

import email
import os
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SITE = Path(sysconfig.get_path("purelib"))
NAME = "lerobot_robot_pneutac"

DISCOVER = """
from lerobot.utils.import_utils import register_third_party_plugins
register_third_party_plugins()
from lerobot.configs import PreTrainedConfig
from lerobot.envs.configs import EnvConfig
from lerobot.policies import get_policy_class
from lerobot.robots import RobotConfig, make_robot_from_config
from lerobot.teleoperators import TeleoperatorConfig, make_teleoperator_from_config
robot = make_robot_from_config(RobotConfig.get_choice_class("pneutac_sim")(id="r"))
teleop = make_teleoperator_from_config(TeleoperatorConfig.get_choice_class("pneutac_scripted")(id="t"))
EnvConfig.get_choice_class("pneutac")()
PreTrainedConfig.get_choice_class("pneutac_bc")
import lerobot_robot_pneutac, pneutac_datasets, pneutac_sim
print(robot.name, teleop.name, get_policy_class("pneutac_bc").name)
for module in (lerobot_robot_pneutac, pneutac_datasets, pneutac_sim):
    print(module.__file__)
"""


def python(code: str, executable=sys.executable, cwd=ROOT, **env) -> str:
    done = subprocess.run(
        [str(executable), "-c", code],
        cwd=cwd,
        env=os.environ | env,
        text=True,
        capture_output=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr[-4000:]
    return done.stdout


def test_datasets_folder_does_not_shadow_hugging_face():
    """Neither from the project's folder, where Python looks first, nor under pytest."""
    assert not (ROOT / "datasets" / "__init__.py").exists()
    here = python("import datasets; print(datasets.__file__)").strip()
    assert Path(here).is_relative_to(SITE)

    import datasets

    assert Path(datasets.__file__) == Path(here)


def test_importing_the_plugin_is_light():
    """At most 0.3 s beyond LeRobot's own, and none of the heavy packages that its parts use."""
    code = """
import sys, time
import lerobot.scripts.lerobot_record
before = set(sys.modules)
start = time.perf_counter()
import lerobot_robot_pneutac
seconds = time.perf_counter() - start
heavy = {"mujoco", "numba", "pygame", "plotly", "scipy"} & (set(sys.modules) - before)
print(seconds, *heavy)
"""
    for _ in range(2):  # the first may compile bytecode
        seconds, *heavy = python(code).split()
        assert heavy == []
        if float(seconds) < 0.3:
            return
    pytest.fail(f"importing the plugin takes {seconds} s")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(out), str(ROOT)]
    done = subprocess.run(build, text=True, capture_output=True, timeout=300)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    (path,) = out.glob("*.whl")
    return path


def test_wheel_holds_the_four_packages_under_the_name_that_lerobot_looks_for(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        metadata = email.message_from_bytes(archive.read(next(n for n in names if n.endswith("/METADATA"))))
    tops = {n.split("/")[0] for n in names if ".dist-info" not in n}
    assert tops == {"lerobot_pneutac", "lerobot_robot_pneutac", "pneutac_datasets", "pneutac_sim"}
    # With a dash in the name LeRobot would not find it.
    assert metadata["Name"] == NAME
    assert metadata["License-Expression"] == "Apache-2.0"


def test_installed_wheel_is_discovered_by_lerobot(wheel, tmp_path):
    """A new environment with LeRobot and its needs, without this source tree."""
    env = tmp_path / "env"
    venv.create(env, symlinks=True, with_pip=True)
    (site,) = env.glob("lib/python*/site-packages")
    # LeRobot's gigabytes are lent by links; the editable install of this project is not.
    lent = tmp_path / "lent"
    lent.mkdir()
    for entry in SITE.iterdir():
        if NAME not in entry.name and entry.suffix != ".pth":
            (lent / entry.name).symlink_to(entry)
    (site / "lent.pth").write_text(f"{lent}\n")
    executable = env / "bin" / "python"

    def isolated(code: str) -> str:
        return python(code, executable, tmp_path, PYTHONPATH="", HF_HOME=str(tmp_path / "hf"))

    missing = "import importlib.util as u; print(u.find_spec('lerobot_robot_pneutac'))"
    assert isolated(missing).strip() == "None"

    pip = [str(executable), "-m", "pip", "install", "-q", "--no-deps", "--no-index", str(wheel)]
    subprocess.run(pip, check=True, timeout=300)
    names, *files = isolated(DISCOVER).splitlines()
    assert names == "pneutac pneutac_scripted pneutac_bc"
    assert all(Path(f).is_relative_to(site) for f in files)
    out = subprocess.run([env / "bin" / "pneutac", "help"], text=True, capture_output=True, check=True)
    assert "demo" in out.stdout
