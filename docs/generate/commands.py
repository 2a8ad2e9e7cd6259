"""The page of commands, from the dataclasses that the commands read their options into."""

import dataclasses
import inspect

from lerobot.cameras import CameraConfig
from lerobot.configs.policies import PreTrainedConfig
from lerobot.envs.configs import EnvConfig
from lerobot.robots import RobotConfig
from lerobot.teleoperators import TeleoperatorConfig
from mkdocs.structure.files import File

import lerobot_robot_pneutac
from lerobot_pneutac.cli import VERBS, options_class
from lerobot_pneutac.cli.benchmark import TABLES
from lerobot_pneutac.cli.options import list_options

# What LeRobot's own commands take from this package: prefix of the option, registry.
REGISTRIES = {
    "robot": RobotConfig,
    "teleop": TeleoperatorConfig,
    "robot.digit": CameraConfig,
    "env": EnvConfig,
    "policy": PreTrainedConfig,
}


def on_files(files, config):
    """Adds reference/commands.md."""
    files.append(File.generated(config, "reference/commands.md", content=page()))
    return files


def page() -> str:
    """Markdown of all commands."""
    lines = [
        "# Commands",
        "",
        "`pneutac VERB --name=value ...`; a flag may stand without `=true`; `--config_path=FILE.yaml` reads "
        "options from a file. `pneutac VERB --help` prints the same as this page.",
        "",
    ]
    lines += ["| command | does |", "|---|---|"]
    lines += [f"| [`pneutac {verb}`](#pneutac-{verb}) | {text} |" for verb, text in VERBS.items()]
    lines.append("")
    for verb, text in VERBS.items():
        lines += [f"## pneutac {verb}", "", text[:1].upper() + text[1:] + ".", ""]
        found = options_class(verb)
        lines += _table(found, "") if found else []
        if verb == "benchmark":
            for name in TABLES:
                command = f"benchmark {name}"
                lines += [f"### pneutac {command}", "", *_table(options_class(command), "")]
    return "\n".join([*lines, "## Options of LeRobot's commands", "", *_lerobot()])


def _lerobot() -> list[str]:
    lines = []
    for group, registry in REGISTRIES.items():
        for kind, found in registry.get_known_choices().items():
            if found.__module__.startswith(lerobot_robot_pneutac.__name__):
                sentence = " ".join(inspect.cleandoc(found.__doc__ or "").split("\n\n")[0].split())
                lines += [f"### --{group}.type={kind}", "", sentence, ""]
                lines += _table(found, f"{group}.", own=True)
    return lines


def _table(found: type, prefix: str, own: bool = False) -> list[str]:
    """Options of a class; `own`: without those that LeRobot's base class has and nobody here explains."""
    rows = []
    for option in list_options(found):
        if dataclasses.is_dataclass(option.kind) or (own and not option.text):
            continue
        default = f"`{option.shown}`" if option.shown else ""
        text = option.text.replace("|", "\\|")
        rows.append(f"| `--{prefix}{option.name}` | {default} | {text} |")
    return ["| option | default | meaning |", "|---|---|---|", *rows, ""] if rows else []
