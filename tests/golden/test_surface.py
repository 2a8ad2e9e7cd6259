"""What users and their programs meet, as it was: options, names, an episode, simulated numbers.

`PNEUTAC_GOLDEN=write pytest tests/golden/test_surface.py` writes what `surface/` has not got yet; delete a
file there first where a change is meant. Nothing may be lost; more may come.
"""

import dataclasses
import importlib
import inspect
import json
import os
import re
import types
import typing
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from doc_blocks import ROOT
from lerobot.utils.feature_utils import hw_to_dataset_features

import lerobot_pneutac
import lerobot_robot_pneutac
import pneutac_sim.effects
import pneutac_sim.finger
import pneutac_sim.world
from lerobot_pneutac.cli import VERBS, options_class
from lerobot_pneutac.cli.benchmark import TABLES
from lerobot_robot_pneutac import PneutacSimConfig
from lerobot_robot_pneutac.robots.pneutac_sim import PneutacSim
from pneutac_sim.effects import body_effects, get_effect, sensor_effects
from pneutac_sim.effects.laws import law_names
from pneutac_sim.features import task_names
from pneutac_sim.finger import Inputs, Pipeline
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.pair import Earlier
from pneutac_sim.gel.photograph import Predictor
from pneutac_sim.twin import Twin
from pneutac_sim.world import World

SURFACE = Path(__file__).parent / "surface"


def expect(name: str, found: dict, rel: float = 1e-6, least: float = 1e-6) -> None:
    """Fails where anything of that golden file is missing or differs, numbers by more than that."""
    found, file = json.loads(json.dumps(found)), SURFACE / f"{name}.json"
    if os.environ.get("PNEUTAC_GOLDEN") == "write" and not file.exists():
        rows = (f"{json.dumps(k)}: {json.dumps(v)}" for k, v in found.items())
        file.parent.mkdir(exist_ok=True)
        file.write_text("{\n" + ",\n".join(rows) + "\n}\n")
    wrong = list(differences("", json.loads(file.read_text()), found, rel, least))
    assert not wrong, f"{name}: {len(wrong)} differ\n" + "\n".join(wrong[:20])


def differences(path: str, then, now, rel: float, least: float):
    """Yields a line for each leaf that differs; dicts may have grown."""
    if isinstance(then, dict) and isinstance(now, dict):
        for key, value in then.items():
            yield from differences(f"{path}/{key}", value, now.get(key, "(missing)"), rel, least)
    elif isinstance(then, list) and isinstance(now, list) and len(then) == len(now):
        for i, (a, b) in enumerate(zip(then, now, strict=True)):
            yield from differences(f"{path}/{i}", a, b, rel, least)
    elif isinstance(then, float) and isinstance(now, float | int):
        if not abs(then - now) <= max(least, rel * abs(then)):
            yield f"{path}: was {then!r}, is {now!r}"
    elif then != now:
        yield f"{path}: was {then!r}, is {now!r}"


def rounded(values) -> list:
    """An array as nested lists, to nine digits."""
    return [rounded(v) if np.ndim(v) else float(f"{v:.9g}") for v in np.asarray(values, float)]


# ---------------------------------------------------------------- options and names


def options_of(config: type) -> dict[str, list]:
    """Name, with that of its group, to type and default of each field of an options dataclass."""
    if hasattr(config, "get_known_choices"):
        return {
            f"{choice}:{name}": option
            for choice, kind in sorted(config.get_known_choices().items())
            for name, option in fields_of(kind).items()
        }
    return fields_of(config)


def fields_of(config: type) -> dict[str, list]:
    found, hints = {}, typing.get_type_hints(config)
    for field in dataclasses.fields(config):
        if not field.init:
            continue
        kinds = typing.get_args(hints[field.name]) if is_union(hints[field.name]) else (hints[field.name],)
        groups = [k for k in kinds if dataclasses.is_dataclass(k)]
        if groups:
            more = options_of(groups[0])
            found |= {f"{field.name}.{name}": option for name, option in more.items()}
        else:
            found[field.name] = [type_name(hints[field.name]), default_of(field)]
    return found


def is_union(hint) -> bool:
    return typing.get_origin(hint) in (types.UnionType, typing.Union)


def type_name(hint) -> str:
    return hint.__name__ if isinstance(hint, type) and not typing.get_args(hint) else str(hint)


def default_of(field: dataclasses.Field):
    """As JSON; `required` where there is none."""
    value = field.default
    if field.default_factory is not dataclasses.MISSING:
        value = field.default_factory()
    return "required" if value is dataclasses.MISSING else plain(value)


def plain(value):
    """A default as JSON: paths and others by their text."""
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    return value if isinstance(value, bool | int | float | str | None) else str(value)


def test_options_of_every_verb():
    commands = [*VERBS, *(f"benchmark {table}" for table in TABLES)]
    classes = {command: options_class(command) for command in commands}
    expect("options", {c: options_of(kind) if kind else {} for c, kind in classes.items()})


def test_options_of_every_device_environment_and_policy():
    named = {n: getattr(lerobot_robot_pneutac, n) for n in lerobot_robot_pneutac.__all__}
    expect("devices", {n: {"type": c.get_choice_name(c)} | fields_of(c) for n, c in named.items()})


def parameters_of(function) -> dict:
    """Name to default of each parameter that may be given;"""
    given = inspect.signature(function).parameters.values()
    return {
        p.name: "required" if p.default is p.empty else shown(p.default) for p in given if p.name != "self"
    }


def shown(value):
    plain_values = bool | int | float | str | None
    if isinstance(value, tuple):
        return [shown(v) for v in value]
    return value if isinstance(value, plain_values) else "a default"


# By which a result builds its own table and page; nobody else calls them.
BUILDING = set("findings_shown next_after page parameter_rows pictures remarks rows subject title".split())


def api_of(thing) -> dict:
    """Parameters of a function; of a class also its fields and public names with their parameters."""
    if not inspect.isclass(thing):
        return parameters_of(thing)
    if issubclass(thing, Exception):
        return {}
    members = {n: inspect.getattr_static(thing, n) for n in dir(thing) if not n.startswith("_")}
    members = {n: getattr(m, "__func__", m) for n, m in members.items()}
    own = {n: parameters_of(m) if inspect.isfunction(m) else "value" for n, m in members.items()}
    if dataclasses.is_dataclass(thing):
        own |= {f.name: "value" for f in dataclasses.fields(thing)}
    if {"report", "to_dict"} <= own.keys():  # results are made by the verbs alone
        return {n: v for n, v in own.items() if n not in BUILDING}
    return {"()": parameters_of(thing), **own}


def documented() -> dict[str, object]:
    """Everything that the page of the Python API describes, by its name."""
    paths = re.findall(r"^::: (\S+)$", (ROOT / "docs/reference/api.md").read_text(), re.M)
    return {
        path: getattr(importlib.import_module(path.rpartition(".")[0]), path.rpartition(".")[2])
        for path in paths
    }


def test_names_and_parameters_of_the_public_api():
    things = {path.rpartition(".")[2]: thing for path, thing in documented().items()}
    for face in (lerobot_pneutac, pneutac_sim.effects, pneutac_sim.finger, pneutac_sim.world):
        things |= {f"{face.__name__}.{name}": getattr(face, name) for name in face.__all__}
    expect("api", {name: api_of(thing) if callable(thing) else {} for name, thing in things.items()})


# ---------------------------------------------------------------- LeRobot


def test_keys_of_an_episode_of_the_simulated_robot():
    robot = PneutacSim(PneutacSimConfig(id="golden", seed=1, tactile_points=True))
    robot.connect()
    try:
        sent = robot.send_action(dict.fromkeys(robot.action_features, 0.0))
        seen = robot.get_observation()
    finally:
        robot.disconnect()
    kinds = {k: list(v.shape) if np.ndim(v) else "float" for k, v in seen.items()}
    columns = hw_to_dataset_features(robot.observation_features, "observation")
    columns |= hw_to_dataset_features(robot.action_features, "action")
    expect("episode", {"observation": kinds, "columns": columns, "sent": sorted(sent)})


# ---------------------------------------------------------------- the world

# Velocity in m/s by which the finger touches a task's object within the 20 steps.
WAYS = dict.fromkeys(task_names(), (0.08, 0.0, -0.06)) | {
    "switch": (0.05, 0.03, -0.1),
    "button": (0.08, 0.0, -0.08),
}


def moved(task: str, fidelity: str) -> dict:
    """States, spine, colours and touch of a task's world under fixed actions."""
    world = World(task, fidelity=fidelity)
    seen, rows, touch_mm = [world.reset(1)], [], [0.0]
    for step in range(20):
        seen.append(world.step(np.array([*WAYS[task], 0.6 * step])))
        rows.append([*world.spine_rad.ravel(), *seen[-1].tactile.mean((0, 1))])
        touch_mm.append(float(world.touch.depth_mm.max()))
    assert max(touch_mm) > 0.05, f"{task}: nothing is touched"
    found = {f"state {i}": rounded(seen[i].state) for i in (0, 7, 14, 20)}
    found |= {f"spine and picture {i}": rounded(rows[i - 1]) for i in (7, 14, 20)}
    return found | {"touch_mm": rounded(touch_mm), "clipped": world.clipped}


@pytest.mark.parametrize("fidelity", ["probe", "surrogate"])
def test_worlds_move_as_they_did(fidelity):
    expect(f"worlds_{fidelity}", {task: moved(task, fidelity) for task in task_names()})


# ---------------------------------------------------------------- touch

PRESSES = (
    Press("sphere", 3.0, 0.5, -0.5, 0.8),
    Press("sphere", 2.0, -4.0, 5.0, 0.3),
    Press("cylinder", 2.5, 2.0, 3.0, 0.6),
    Press("cube", 3.0, -3.0, 2.0, 0.5, yaw_rad=0.4),
    Press("edge", 4.0, 0.0, 0.0, 0.7, yaw_rad=-0.3),
    Press("cone", 3.0, 1.0, -6.0, 1.0),
    Press("cylinder", 2.0, 0.0, 0.0, 0.4, tilt_x_rad=0.1, tilt_y_rad=-0.05),
    Press("cube", 5.0, 5.0, -7.0, 0.9),
)


def felt(twin: Twin, effects: dict, press: Press) -> list:
    """Change of levels from the image at rest: mean over 4 x 3 blocks, a channel each, and its size."""
    gel = dataclasses.replace(GelModel.from_twin(twin), effects=effects)
    image = Predictor(gel).image(press, gel.rest_image, 0.6, (Earlier(PRESSES[0], 30.0, 8.0),))
    change = image.astype(float) - gel.rest_image
    blocks = change.reshape(4, image.shape[0] // 4, 3, image.shape[1] // 3, 3).mean((1, 3))
    return np.round([*blocks.ravel(), np.abs(change).mean()], 3).tolist()


def values_of(effect, scale: float = 1.0) -> dict[str, float]:
    """The effect's starting values, and a tenth of the way to the largest where they do nothing."""
    rows = {p.name: (p, *p.limits(scale)) for p in effect.parameters}
    return {
        n: start if p.default != p.neutral else start + 0.1 * (high - start)
        for n, (p, start, _, high) in rows.items()
    }


def test_pictures_of_presses_without_effects_with_each_and_with_all():
    twin, known = Twin.builtin(), {n: values_of(e) for n, e in sensor_effects().items()}
    sets = {"none": {}, "all": known}
    found = {f"{i} {name}": felt(twin, s, p) for i, p in enumerate(PRESSES) for name, s in sets.items()}
    found |= {f"1 {name}": felt(twin, {name: values}, PRESSES[1]) for name, values in known.items()}
    expect("touch", found, least=0.02)  # a pixel's level may round the other way


# ---------------------------------------------------------------- finger and arm

DEVICES = {"finger": ("pressure_cmd_kpa",), "arm": tuple(f"pressure_cmd_{i}_kpa" for i in (1, 2, 3))}
OUTPUTS = {
    "finger": ("tip_x_mm", "tip_y_mm", "tip_z_mm", "bend_angle_rad", "pressure_kpa"),
    "arm": ("tip_x_mm", "tip_y_mm", "tip_z_mm", "bend_angle_rad", "pressure_1_kpa", "pressure_3_kpa"),
}


def bench(device: str) -> pd.DataFrame:
    """Two trials of a second at 20 Hz and more, in which every condition changes."""
    t = np.tile(np.arange(40) / 20.0, 2)
    session = np.arange(80) / 79.0
    table = {"trial": np.repeat([0, 1], 40), "time_s": t, "temperature_c": 20.0 + 12.0 * session}
    table |= {"payload_g": 10.0 * session, "gravity_x": 9.81 * np.cos(session)}
    table |= {"gravity_y": 2.0 * session, "gravity_z": -9.81 * np.sin(session)}
    for i, name in enumerate(DEVICES[device]):
        table[name] = 6.0 + 5.0 * np.sin(2.0 * t * (1 + i) + i) * np.sign(np.sin(5.0 * t) + 0.3) - 0.8 * i
    return pd.DataFrame(table)


@pytest.mark.parametrize("device", DEVICES)
def test_a_body_bends_as_it_did_with_every_effect_and_law(device):
    twin = Twin(device, 110.0 if device == "finger" else 180.0)
    inputs = Inputs.from_samples(bench(device), device, twin.length_mm, start="vented")
    found = {}
    for name in ("", *body_effects(), *law_names()):
        values = values_of(get_effect(name), inputs.pressure_range_kpa) if name else {}
        pipeline = Pipeline.of(twin, inputs, [name] if name else [])
        theta = pipeline.theta(twin, inputs.pressure_range_kpa)
        for parameter, value in values.items():
            theta[pipeline.names.index(f"{name}.{parameter}")] = value
        outputs = pipeline.outputs(pipeline.run(inputs, theta), OUTPUTS[device])
        assert np.isfinite(outputs).all(), name
        found[name or "none"] = rounded(outputs[[7, 30, 39, 45, 70, 79]])
    expect(f"bends_{device}", found)
