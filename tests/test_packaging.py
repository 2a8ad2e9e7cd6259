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


def python(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, text=True, capture_output=True, timeout=300)
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
    """At most 0.3 s of computing beyond LeRobot's own, and none of the heavy packages that its parts use."""
    code = """
import sys, time
import lerobot.scripts.lerobot_record
before = set(sys.modules)
start = time.process_time()
import lerobot_robot_pneutac
seconds = time.process_time() - start
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
    """Of the sdist, as whoever builds from source gets it."""
    out = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(out), str(ROOT)]
    done = subprocess.run(command, text=True, capture_output=True, timeout=300)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    (wheel,) = out.glob("*.whl")
    return wheel


def test_the_wheel_of_the_sdist_holds_every_file_of_the_tree(wheel):
    with zipfile.ZipFile(wheel) as archive:
        built = {i.filename: i.CRC for i in archive.infolist() if ".dist-info" not in i.filename}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    tree = {}
    for package in project["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]:
        for file in (ROOT / package).rglob("*"):
            if file.is_file() and file.suffix not in (".pyc", ".nbi", ".nbc"):
                name = file.relative_to((ROOT / package).parent).as_posix()
                tree[name] = zlib.crc32(file.read_bytes())
    assert tree == built


def test_wheel_holds_the_six_packages_under_the_name_that_lerobot_looks_for(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        header = email.message_from_bytes(archive.read(next(n for n in names if n.endswith("/METADATA"))))
    tops = {n.split("/")[0] for n in names if ".dist-info" not in n}
    assert tops == {
        "lerobot_pneutac",
        "lerobot_robot_pneutac",
        "pneutac_benchmarks",
        "pneutac_datasets",
        "pneutac_sim",
        "pneutac_truths",
    }
    # With a dash in the name LeRobot would not find it.
    assert header["Name"] == NAME
    assert header["License-Expression"] == "Apache-2.0"


def clean_environment(wheel: Path, folder: Path, without: tuple[str, ...] = ()):
    """A new environment with the wheel and without this source tree; returns a function that runs there.

    The gigabytes that the wheel needs are lent by links, but for the packages `without`; the editable install
    of this project is not lent.
    """
    env, lent = folder / "env", folder / "lent"
    venv.create(env, symlinks=True, with_pip=True)
    (site,) = env.glob("lib/python*/site-packages")
    lent.mkdir()
    for entry in SITE.iterdir():
        if NAME not in entry.name and entry.suffix != ".pth" and entry.name.split("-")[0] not in without:
            (lent / entry.name).symlink_to(entry)
    (site / "lent.pth").write_text(f"{lent}\n")
    variables = os.environ | {"PYTHONPATH": "", "HF_HOME": str(folder / "hf")}

    def execute(program: str, *arguments: str) -> str:
        command = [str(env / "bin" / program), *arguments]
        done = subprocess.run(command, cwd=folder, env=variables, text=True, capture_output=True, timeout=300)
        assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
        return done.stdout

    found = execute("python", "-c", f"import importlib.util as u; print(u.find_spec('{NAME}'))")
    assert found.strip() == "None"
    execute("python", "-m", "pip", "install", "-q", "--no-deps", "--no-index", str(wheel))
    return execute, site


def test_installed_wheel_is_discovered_by_lerobot(wheel, tmp_path):
    execute, site = clean_environment(wheel, tmp_path)
    names, *files = execute("python", "-c", DISCOVER).splitlines()
    assert names == "pneutac pneutac_scripted pneutac_bc"
    assert all(Path(f).is_relative_to(site) for f in files)


@pytest.mark.nightly
def test_bench_verbs_run_from_the_wheel_without_taichi_torch_and_lerobot(wheel, tmp_path):
    """From `new` to `add`, on a recording of two minutes."""
    execute, _ = clean_environment(wheel, tmp_path, without=("lerobot", "quadrants", "taichi", "torch"))
    assert execute("pneutac", "--version").split() == ["pneutac", version(NAME)]
    assert "demo" in execute("pneutac", "help")
    generate = ["-m", "pneutac_datasets.generate", "--effect=creep", "--seed=7", "--out=bench"]
    execute("python", *generate, "--minutes=2", "--hz=5")
    pair = ["--twin=finger", "--recording=bench"]
    execute("pneutac", "new", *pair)
    execute("pneutac", "calibrate", *pair, "--out=calibrated")
    execute("pneutac", "compare", *pair, "--out=compared")
    execute("pneutac", "diagnose", *pair, "--out=diagnosed")
    execute("pneutac", "add", *pair, "--effect=creep", "--out=added")
    results = {p.parent.name: json.loads(p.read_text()) for p in tmp_path.glob("*/result.json")}
    assert set(results) == {"calibrated", "compared", "diagnosed", "added"}
    error = results["compared"]["error"]["heldout"]
    assert results["diagnosed"]["after"]["heldout"] < 0.5 * error
    assert results["added"]["accepted"]
    assert results["added"]["after"]["heldout"] < 0.5 * error


def test_every_declared_package_is_in_the_table_of_licences():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    requirements = [*project["dependencies"], *sum(project["optional-dependencies"].values(), [])]
    declared = {re.match(r"[\w.-]+", r)[0] for r in requirements} - {NAME}
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
