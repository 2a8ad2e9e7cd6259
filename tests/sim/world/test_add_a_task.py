"""The doorbell of docs/how_to/add_a_task.md, exactly as printed, installed beside the library."""

import re
import sys
import tomllib
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from draccus.utils import DecodingError
from installed import packages
from lerobot.envs.factory import make_env
from played import played

import pneutac_sim
from lerobot_pneutac.rl.env import PpoEnv
from lerobot_pneutac.rl.options import PpoConfig
from lerobot_pneutac.verbs.augment import AugmentConfig, DatasetRef
from lerobot_robot_pneutac.env import PneutacEnvConfig
from lerobot_robot_pneutac.robots.config_pneutac_sim import PneutacSimConfig
from lerobot_robot_pneutac.robots.pneutac_sim import PneutacSim
from lerobot_robot_pneutac.standin.world import GelTouch
from lerobot_robot_pneutac.teleoperators.base_teleop import PneutacScriptedConfig
from lerobot_robot_pneutac.teleoperators.pneutac_scripted import PneutacScripted
from pneutac_benchmarks.policy.main import BenchmarkPolicyConfig
from pneutac_sim.errors import InputError
from pneutac_sim.features import AREA, task_names
from pneutac_sim.world.expert import ScriptedExpert
from pneutac_sim.world.tasks import make_task, tasks_named
from pneutac_sim.world.world import World

DOC = Path(__file__).parents[3] / "docs" / "how_to" / "add_a_task.md"


def block(kind):
    return re.search(rf"```{kind}\n(.*?)```", DOC.read_text(), re.S)[1]


def edge():
    return next(b for b in re.findall(r"```python\n(.*?)```", DOC.read_text(), re.S) if "EdgeTask" in b)


@pytest.fixture
def install(tmp_path, monkeypatch):
    with packages(tmp_path, monkeypatch, "tasks", task_names) as install:
        before = set(gymnasium.registry)
        yield lambda code, points, module="pneutac_doorbell": install(module, code, points)
        for name in set(gymnasium.registry) - before:
            del gymnasium.registry[name]


@pytest.fixture
def doorbell(install):
    install(block("python"), tomllib.loads(block("toml"))["project"]["entry-points"]["pneutac.tasks"])
    pneutac_sim.register_tasks()


def test_it_is_short():
    assert len(block("python").splitlines()) < 60 > len(edge().splitlines())


def test_an_edge_is_followed_by_touch_and_lost_without(install):
    install(edge(), {"edge": "pneutac_edge:EdgeTask"}, "pneutac_edge")
    world = World("edge", touch="area")
    ends = []
    for seed in range(3):
        _, actions = played(world, seed, steps=180)
        assert world.success and len(actions) > 60, world.failure
        world.reset(seed + 100)
        for action in actions:  # what did one tilt, blindly on another
            if not (world.success or world.failure):
                world.step(action)
        ends.append(world.success)
    assert not all(ends)


def test_its_expert_rings_it_and_idleness_does_not(doorbell):
    world = World("doorbell", touch="area")
    for seed in range(3):
        seen, _ = played(world, seed, steps=150)
        assert world.success and max(o.state[AREA] for o in seen) > 0, world.failure
    world.reset(0)
    for _ in range(30):
        world.step(np.zeros(4))
    assert not world.success


def test_lerobots_environment_robot_and_teleoperator_take_it_by_its_name(doorbell, tmp_path):
    envs = make_env(PneutacEnvConfig(task="doorbell", fidelity="probe"), n_envs=1)
    env = next(iter(envs["pneutac"].values()))
    observation, _ = env.reset(seed=[3])
    assert observation["pixels"]["tactile"].shape == (1, 320, 240, 3)
    env.close()
    robot = PneutacSim(PneutacSimConfig(task="doorbell", fidelity="probe", calibration_dir=tmp_path))
    teleop = PneutacScripted(PneutacScriptedConfig(calibration_dir=tmp_path))
    robot.connect()
    teleop.connect()
    for _ in range(3):
        robot.send_action(teleop.get_action())
    assert robot.world.task.description == "Ring the doorbell."
    robot.disconnect()


def test_the_verbs_take_it_and_reinforcement_learning_sees_how_far_it_has_come(doorbell, tmp_path):
    data = DatasetRef("local/a", tmp_path / "a")
    assert AugmentConfig(data, data, task="doorbell", fidelity="probe").task == "doorbell"
    assert PpoConfig(tmp_path, task="doorbell").task == "doorbell"
    assert BenchmarkPolicyConfig(out=tmp_path, tasks=("doorbell",)).tasks == ("doorbell",)
    env = PpoEnv("doorbell")
    env.reset(seed=0)
    away = env.view.seen().distance_m
    for _ in range(8):
        env.step(np.array([1.0, 0.0, 0.0, -1.0]))
    assert env.view.seen().distance_m < away - 0.03 and env.view.seen().progress == pytest.approx(
        0.0, abs=0.05
    )
    env.world.data.joint("button").qpos = 0.003
    assert env.view.seen().progress == pytest.approx(0.75)


@pytest.mark.parametrize(
    ("goal", "says"), [("1 / 0", "fails .ZeroDivisionError"), ("float('nan')", "gives nan")]
)
def test_a_goal_that_gives_no_number_is_one_sentence(install, goal, says):
    code = block("python").replace("task.pressed_m / PRESSED_M", goal)
    install(code, {"doorbell": "pneutac_doorbell:DoorbellTask"})
    with pytest.raises(InputError, match=f"The task 'doorbell': the progress of its goal {says}"):
        PpoEnv("doorbell").reset(seed=0)


TASK = """
from pneutac_sim.world.tasks.base import Task
class Bell(Task):
    name, description, home_m = 'bell', 'Ring.', (0.4, 0, 0.3)
    def mjcf(self): return ''
    def reset(self, model, data, rng): pass
    def update(self, model, data, dt): pass
    def success(self): return False
"""


def test_a_broken_task_is_no_obstacle_to_another(install):
    install(TASK.replace("'Ring.'", "''"), {"bell": "bell_task:Bell"}, "bell_task")
    assert tasks_named("Flip the toggle switch.") == ["switch"] and tasks_named("ring the bell") == ["bell"]


def test_a_start_out_of_the_arms_reach_is_one_sentence(install):
    install(TASK.replace("(0.4, 0, 0.3)", "(4.0, 0, 0.3)"), {"bell": "bell_task:Bell"}, "bell_task")
    with pytest.raises(InputError, match="short of .4.*where the task 'bell' starts; .*another home_m"):
        World("bell", touch="none").reset(0)


@pytest.mark.parametrize(
    ("method", "gives", "says"),
    [
        ("success", "None", "success gives None, not True or False; correct its class"),
        ("success", "float('nan')", "success gives nan, not True or False"),
        ("failure", "3", "failure gives 3, not a text or None"),
        ("expert", "None", "expert gives None, not a velocity of three finite numbers, and a finite"),
        ("expert", "(0, 0), 3.0", "expert gives .*, not a velocity of three"),
        ("expert", "[float('nan')] * 3, 3.0", "expert gives .*, not a velocity of three"),
        ("expert", "[0, 0, 0], float('inf')", "expert gives .*, not a velocity of three"),
        ("expert", "[0, 0, 0], 3", None),
    ],
)
def test_what_a_task_must_not_give_is_one_sentence(install, method, gives, says):
    code = TASK.replace("return False", "return False\n    def failure(self): return None")
    code += "    def expert(self, *now): return [0, 0, 0], 3.0\n"
    code = re.sub(rf"(def {method}.*return ).*", rf"\g<1>{gives}", code)
    install(code, {"bell": "bell_task:Bell"}, "bell_task")
    given = {"expert": (None, None, 0.0)}.get(method, ())
    call = getattr(make_task("bell"), method)
    if says is None:
        assert call(*given) == ([0, 0, 0], 3)
        return
    with pytest.raises(InputError, match=f"^Entry point 'bell' .*: {says}"):
        call(*given)


def test_objects_that_mujoco_does_not_take_are_one_sentence(install):
    install(TASK.replace("''", "'<body'"), {"bell": "bell_task:Bell"}, "bell_task")
    with pytest.raises(InputError, match="MuJoCo does not take what the task 'bell' brings"):
        World("bell", touch="none")


@pytest.mark.parametrize(
    ("code", "says"),
    [
        ("import nothing_of_this_name", "does not load: No module named 'nothing_of_this_name'"),
        ("Bell = 3", "must be a class that extends"),
        (
            "from pneutac_sim.world.tasks.base import Task\nclass Bell(Task): name = 'gong'",
            "lacks description, home_m",
        ),
        ("raise SystemExit('bye')", "does not load: bye; correct its package, or uninstall it"),
        (TASK.replace("(0.4, 0, 0.3)", "(0.4, 0)"), "home_m is .0.4, 0.; give three finite numbers"),
        (TASK.replace("(0.4, 0, 0.3)", "(400, 0, 300)"), "home_m is .400.*can only be millimetres"),
        (TASK.replace("    def mjcf", "    starts_m = 3\n    def mjcf"), "fails .TypeError: .*iterable"),
        (TASK.replace("'Ring.'", "' '"), "has the description ' '"),
        (TASK.replace("''", "None"), "gives None from mjcf"),
        (TASK.replace("update", "go_on"), "has no method update"),
        (TASK.replace("return ''", "1 / 0"), "fails .ZeroDivisionError"),
    ],
)
def test_what_is_no_task_is_one_sentence(install, code, says):
    install(code, {"bell": "bell_task:Bell"}, "bell_task")
    assert "bell" in task_names()
    with pytest.raises(InputError, match=rf"Entry point 'bell' of pneutac.tasks \(bell_task:Bell\) {says}"):
        make_task("bell")
    with pytest.raises(DecodingError, match="must be one of switch, egg, card, bell"):
        PneutacEnvConfig(task="gong")


@pytest.mark.parametrize("name", ["reset", "update", "success", "expert"])
def test_own_code_that_fails_is_one_sentence_with_its_line(install, name):
    code = re.sub(rf"(    def {name}\(.*\n)", r"\1        [][3]\n", block("python"))
    install(code, {"doorbell": "pneutac_doorbell:DoorbellTask"})
    line = code.splitlines().index("        [][3]") + 1
    says = rf"Entry point 'doorbell' .*: {name} fails in .*pneutac_doorbell.py, line {line} \(IndexError"
    with pytest.raises(InputError, match=says) as caught:
        played(World("doorbell", touch="none"), 0, steps=2)
    assert isinstance(caught.value.__cause__, IndexError)


def test_without_an_expert_or_with_a_mesh_to_feel_it_says_what_to_do(install, tmp_path):
    bare = (
        block("python")
        .replace("    def expert(", "    def own_expert(")
        .replace("goal = Goal(", "gaol = Goal(")
    )
    install(bare, {"doorbell": "pneutac_doorbell:DoorbellTask"})
    with pytest.raises(
        InputError, match="'doorbell' has no scripted expert; give its class a method `expert`"
    ):
        ScriptedExpert(World("doorbell", touch="none"), np.random.default_rng(0))
    with pytest.raises(InputError, match="'doorbell' has no goal"):
        PpoEnv("doorbell")


def test_a_mesh_is_felt_unless_it_is_decor(install, tmp_path):
    mesh = tmp_path / "cube.obj"
    corners = [f"v {x} {y} {z}" for x in (0, 0.1) for y in (0, 0.1) for z in (0, 0.1)]
    faces = ["f 1 2 4 3", "f 5 7 8 6", "f 1 5 6 2", "f 3 4 8 7", "f 1 3 7 5", "f 2 6 8 4"]
    mesh.write_text("\n".join(corners + faces) + "\n")
    geom = '<geom name="post" class="decor" type="mesh" mesh="post"/>'
    code = block("python").replace('<body name="doorbell">', f'<body name="doorbell">{geom}')
    code += f'    def assets(self):\n        return \'<mesh name="post" file="{mesh}"/>\'\n'
    install(code, {"doorbell": "pneutac_doorbell:DoorbellTask"})
    assert len(World("doorbell").touch.sensor.triangles) == 0
    module = tmp_path / "pneutac_doorbell.py"
    module.write_text(code.replace('class="decor" type="mesh"', 'class="object" type="mesh"'))
    sys.modules.pop("pneutac_doorbell")
    world = World("doorbell")
    assert len(world.touch.sensor.triangles) == 12
    with pytest.raises(InputError, match="stand-in's gel feels no meshes"):
        GelTouch(world.model, "none", 12.0)
    module.write_text(
        code.replace('class="decor" type="mesh" mesh="post"', 'class="object" type="plane" size=".1 .1 .1"')
    )
    sys.modules.pop("pneutac_doorbell")
    with pytest.raises(InputError, match="cannot feel the shape of geom post"):
        World("doorbell")
