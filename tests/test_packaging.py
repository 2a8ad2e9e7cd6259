"""The distribution as a user gets it: found by LeRobot, light to import, and shadowing nobody's package."""

import email
import json
import os
import re
import subprocess
import sys
import sysconfig
import tomllib
import venv
import zipfile
import zlib
from importlib.metadata import PackageNotFoundError, metadata, version
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
SITE = Path(sysconfig.get_path("purelib"))
UV = str(Path(sys.executable).parent / "uv")  # which `make` links there
NAME = "lerobot_robot_pneutac"
CAMERA = "lerobot_camera_digit"
FOLDERS = {"pneutac": ".", NAME: "robots", CAMERA: "packages/lerobot_camera_digit"}
# What the bench's distribution does without.
PLUGIN = tuple("av datasets datatrove lerobot pyarrow quadrants rerun serial taichi torch".split())

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


CAMERA_ALONE = """
import importlib.util
from lerobot.utils.import_utils import register_third_party_plugins
register_third_party_plugins()
from lerobot.cameras import CameraConfig
from lerobot.cameras.utils import make_cameras_from_configs
from lerobot.processor import ProcessorStepRegistry
config = CameraConfig.get_choice_class("digit")(serial="D20001")
camera = make_cameras_from_configs({"tactile": config})["tactile"]
CameraConfig.get_choice_class("elastomer")
assert "digit_touch" in ProcessorStepRegistry.list()
assert not any(importlib.util.find_spec(name) for name in ("pneutac_sim", "lerobot_pneutac"))
import lerobot_camera_digit
print(camera, "digit_touch", lerobot_camera_digit.__file__)
"""


def python(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, text=True, capture_output=True, timeout=300)
    assert done.returncode == 0, done.stderr[-4000:]
    return done.stdout


def test_importing_the_plugin_is_light_and_the_folder_datasets_shadows_nothing():
    """At most 0.3 s of computing beyond LeRobot's own, and none of the heavy packages that its parts use.

    It runs in the project's folder, where Python looks first for Hugging Face's package of the same name.
    """
    assert not (ROOT / "datasets" / "__init__.py").exists()
    code = """
import sys, time
import datasets
import lerobot.scripts.lerobot_record
before = set(sys.modules)
start = time.process_time()
import lerobot_robot_pneutac
seconds = time.process_time() - start
heavy = {"mujoco", "numba", "pygame", "plotly", "scipy"} & (set(sys.modules) - before)
print(datasets.__file__, seconds, *heavy)
"""
    for _ in range(2):  # the first may compile bytecode
        file, seconds, *heavy = python(code).split()
        assert heavy == [] and Path(file).is_relative_to(SITE)
        if float(seconds) < 0.3:
            break
    else:
        pytest.fail(f"importing the plugin takes {seconds} s")

    import datasets  # under pytest

    assert Path(datasets.__file__) == Path(file)


def test_an_older_lerobot_is_one_sentence():
    code = """
import importlib.metadata as metadata
version = metadata.version
metadata.version = lambda name: "0.5.0" if name == "lerobot" else version(name)
import lerobot_robot_pneutac
"""
    done = subprocess.run([sys.executable, "-c", code], text=True, capture_output=True, timeout=300)
    assert done.returncode == 1 and done.stderr.startswith("LeRobot 0.5.0 is too old for")
    assert done.stderr.count("\n") == 1


@pytest.fixture(scope="module")
def wheels(tmp_path_factory) -> dict[str, Path]:
    """Each of its sdist, as whoever builds from source gets it; by the name of the distribution."""
    out = tmp_path_factory.mktemp("dist")
    for folder in FOLDERS.values():
        command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(out), str(ROOT / folder)]
        done = subprocess.run(command, text=True, capture_output=True, timeout=300)
        assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    return {w.name.split("-")[0]: w for w in out.glob("*.whl")}


@pytest.mark.nightly  # every day: the tests run from an editable install of the same three distributions
@pytest.mark.parametrize("name", FOLDERS)
def test_the_wheel_of_the_sdist_holds_every_file_of_the_tree(wheels, name):
    with zipfile.ZipFile(wheels[name]) as archive:
        built = {i.filename: i.CRC for i in archive.infolist() if ".dist-info" not in i.filename}
        header = email.message_from_bytes(
            archive.read(next(n for n in archive.namelist() if n.endswith("/METADATA")))
        )
    assert header["Name"] == name  # with a dash in the name LeRobot would not find a plugin
    assert header["License-Expression"] == "Apache-2.0"
    folder = ROOT / FOLDERS[name]
    tree = {}
    for package in project(name)["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]:
        for file in (folder / package).rglob("*"):
            if file.is_file() and file.suffix not in (".pyc", ".nbi", ".nbc"):
                tree[file.relative_to((folder / package).parent).as_posix()] = zlib.crc32(file.read_bytes())
    assert tree == built


def test_the_distributions_share_one_version_and_the_plugin_pins_it():
    versions = {project(name)["project"]["version"] for name in FOLDERS}
    assert len(versions) == 1
    version = versions.pop()
    pinned = {f"pneutac=={version}", f"{CAMERA}=={version}"}
    assert pinned <= set(project(NAME)["project"]["dependencies"])


def project(name: str) -> dict:
    return tomllib.loads((ROOT / FOLDERS[name] / "pyproject.toml").read_text())


def clean_environment(wheels: list[Path], folder: Path, without: tuple[str, ...] = ()):
    """A new environment with the wheels and without this source tree; returns a function that runs there.

    The gigabytes that they need are lent by links, but for the packages `without`; the editable install
    of this project is not lent.
    """
    env, lent = folder / "env", folder / "lent"
    venv.create(env, symlinks=True)
    (site,) = env.glob("lib/python*/site-packages")
    lent.mkdir()
    for entry in SITE.iterdir():
        if (
            not any(own in entry.name for own in ("pneutac", CAMERA))
            and entry.suffix != ".pth"
            and entry.name.split("-")[0] not in without
        ):
            (lent / entry.name).symlink_to(entry)
    (site / "lent.pth").write_text(f"{lent}\n")
    variables = os.environ | {"PYTHONPATH": "", "HF_HOME": str(folder / "hf")}

    def execute(program: str, *arguments: str, **more: str) -> str:
        command = [str(env / "bin" / program), *arguments]
        done = subprocess.run(
            command, cwd=folder, env=variables | more, text=True, capture_output=True, timeout=300
        )
        assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
        return done.stdout

    found = execute("python", "-c", f"import importlib.util as u; print(u.find_spec('{NAME}'))")
    assert found.strip() == "None"
    install = [UV, "pip", "install", "-q", "--no-deps", "--offline", "--python", env / "bin/python"]
    subprocess.run([*install, *wheels], check=True, timeout=300)
    return execute, site


@pytest.mark.nightly  # every day: LeRobot's commands find the editable install, in test_plugin_loop
def test_installed_wheel_is_discovered_by_lerobot(wheels, tmp_path):
    execute, site = clean_environment([*wheels.values()], tmp_path)
    names, *files = execute("python", "-c", DISCOVER).splitlines()
    assert names == "pneutac pneutac_scripted pneutac_bc"
    assert all(Path(f).is_relative_to(site) for f in files)


@pytest.mark.nightly  # every day: the import contract "the camera imports nothing of ours"
def test_the_camera_alone_is_found_by_lerobot(wheels, tmp_path):
    """Without `pneutac`, of which it imports nothing."""
    execute, site = clean_environment([wheels[CAMERA]], tmp_path)
    shown = execute("python", "-c", CAMERA_ALONE).split()
    assert shown[:3] == ["DIGIT", "D20001", "digit_touch"] and Path(shown[3]).is_relative_to(site)


# By this tree, of which the wheel holds every file and whose kernels are compiled.
TREE = os.pathsep.join(str(ROOT / part) for part in (".", "sim", "datasets"))


@pytest.mark.nightly  # every day: a fit without the plugin, below, and a diagnosis by README's block
def test_the_quick_demo_runs_without_the_plugin(wheels, tmp_path):
    """From `new` to `add`, judged on another day."""
    execute, _ = clean_environment([wheels["pneutac"]], tmp_path, without=PLUGIN)
    execute("pneutac", "demo", "--quick", "--minutes=2", PYTHONPATH=TREE)
    result = json.loads((tmp_path / "outputs/quick/result.json").read_text())
    assert result["tip_error_mm"]["after"] < 0.5 * result["tip_error_mm"]["before"]
    assert "another day" in (tmp_path / "outputs/quick/report.html").read_text()


WITHOUT = """
import shlex, sys
missing, lines = sys.argv[1].split(), sys.argv[2:]
class Without:
    def __init__(self, finder):
        self.finder = finder
    def __getattr__(self, name):
        return getattr(self.finder, name)
    def find_spec(self, name, *more):
        return None if name.partition(".")[0] in missing else self.finder.find_spec(name, *more)
sys.meta_path[:] = map(Without, sys.meta_path)
from lerobot_pneutac.cli import main
for line in lines:
    sys.argv = ["pneutac", *shlex.split(line)]
    try:
        main()
    except SystemExit as e:
        print(e)
    print("----")
"""


def test_the_bench_works_without_the_plugin(tmp_path):
    """The commands that need the plugin say what to install; one process, which cannot import the plugin."""
    given = f"--twin=twin --recording={ROOT / 'tests/golden/recordings/finger_creep'}"
    lines = ["--version", "help", "augment --help", "demo", f"new {given}", f"calibrate {given} --out=page"]
    command = [sys.executable, "-c", WITHOUT, " ".join([NAME, CAMERA, *PLUGIN]), *lines, "doctor"]
    done = subprocess.run(command, cwd=tmp_path, text=True, capture_output=True, timeout=300)
    assert done.returncode == 0, done.stderr[-4000:]
    shown, helped, augment, demo, _, calibrate, doctor, _ = done.stdout.split("----\n")
    assert shown.split() == ["pneutac", version("pneutac")]
    assert helped.index("demo") < helped.index("With lerobot_robot_pneutac also") < helped.index("augment")
    needs = "pneutac augment: This needs LeRobot's half of PneuTac; in a clone: pip install"
    assert augment.startswith(needs)
    assert re.search("The whole demo needs .*`pneutac demo --quick`", demo)
    assert "test error" in calibrate and "LeRobot's half" in doctor


def test_every_declared_package_is_in_the_table_of_licences():
    tables = [project(name)["project"] for name in FOLDERS]
    requirements = [
        r for t in tables for r in [*t["dependencies"], *sum(t.get("optional-dependencies", {}).values(), [])]
    ]
    declared = {re.match(r"[\w.-]+", r)[0] for r in requirements} - set(FOLDERS)
    page = (ROOT / "docs" / "reference" / "licences.md").read_text()
    table = dict(re.findall(r"^\| ([\w-]+) \| ([\w.-]+) \|", page, re.MULTILINE))
    assert table.pop("package") == "licence"
    assert set(table) == declared
    for name, licence in table.items():
        assert declares(name, licence.split("-")[0]), f"{name} is not {licence}"


def declares(name: str, family: str) -> bool:
    """Whether the package's metadata name this family of licences; True where it is not installed."""
    try:
        header = metadata(name)
    except PackageNotFoundError:
        return True
    fields = ("License-Expression", "License", "Classifier")
    return any(family in value for key, value in header.items() if key in fields)
