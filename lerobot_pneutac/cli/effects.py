"""`pneutac effects list | show NAME | export NAME`: what a twin may have, and files to begin with."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from rich.console import Console
from rich.table import Table

from lerobot_pneutac.cli.options import parse_options
from lerobot_pneutac.cli.show import finish
from lerobot_pneutac.verbs.effect_file import effect_source, file_name
from lerobot_pneutac.verbs.effects import list_effects, show_effect
from pneutac_sim.errors import InputError
from pneutac_sim.files import write_text

ACTIONS = "list, show NAME, export NAME --out=FILE"


@dataclass
class EffectsConfig:
    """Options of `pneutac effects`.

    Attributes:
        out: folder for `result.json` and `report.html` (of `show`), or the Python file to write (of `export`;
            where left out, the effect's name here).
    """

    names_a_file: ClassVar[bool] = True

    out: Path | None = None


def main(argv: list[str]) -> None:
    """Runs the verb."""
    action = argv[0] if argv else ""
    if action in ("-h", "--help"):
        print(f"usage: pneutac effects ACTION\n\nACTION is {ACTIONS}.\n")
        parse_options(EffectsConfig, argv)
    if action not in ("list", "show", "export"):
        raise InputError(f"'{action}' is no action of effects; give one of {ACTIONS}.")
    names = [] if action == "list" else argv[1:2]
    if action != "list" and (not names or names[0].startswith("--")):
        raise InputError(f"Name the effect: pneutac effects {action} NAME; `pneutac effects list` has all.")
    cfg, console = parse_options(EffectsConfig, argv[1 + len(names) :]), Console()
    if action == "list":
        table = Table("name", "stage", "family", "equation")
        for row in list_effects():
            table.add_row(*row.values())
        console.print(table)
    elif action == "show":
        if cfg.out is not None and cfg.out.is_file():
            raise InputError(f"--out={cfg.out} is a file; give a folder.")
        result = show_effect(names[0])
        finish(result, console, cfg.out, "effects", argv)
    else:
        _export(names[0], cfg.out or Path(f"{file_name(names[0])}.py"), console)


def _export(name: str, out: Path, console: Console) -> None:
    text = effect_source(name)
    if out.suffix != ".py" or out.exists():
        raise InputError(f"--out={out} must name a new file that ends in .py.")
    write_text(out, text)
    console.print(f"effect: {out}; its first lines say how a package offers it", highlight=False)
