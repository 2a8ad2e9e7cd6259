"""Where each effect acts, computed from the code: pipeline, material points, world and so on."""

from mkdocs.structure.files import File

from pneutac_sim.effects import SensorEffect, all_effects, get_effect
from pneutac_sim.effects.laws import law_names
from pneutac_sim.errors import InputError
from pneutac_sim.finger.online import COMPUTED, PressurePipeline
from pneutac_sim.mpm.devices import joint_targets
from pneutac_sim.twin import Twin

LEAD = """# Where effects act

An effect acts on the *joints* (all that bends the finger: air, drive, loads, material), on the *tip*
(stretch, sideways bend, the mount: base and gel of the world's finger are moved), or on a *reading* (what
a camera or tracker shows of the tip, `World.markers`), which never moves the body. Which of them follows
from its stage and signal, so an effect of [your own](../how_to/add_an_effect.md) has its place too. A
slow sweep in free air moves the tip in the world as in the bench pipeline, within 0.3 % of the finger's
length (`tests/sim/world/test_effects_act.py`).

- *Networks* means the fidelity `surrogate`. Their inputs are deformations of body and gel, not effects, so a
  twin keeps them when effects are added; another shape or material needs others (`pneutac surrogate`).
- *No pictures*: `render` and the fit to photographs stop and name the effect, since the shape of the material
  points follows the joints alone; `compare --fidelity=mpm` and the world have it.
- What an effect needs is given as [conditions](fidelity.md#conditions); without them a world stops and names
  effect and condition. The direction of gravity is the world's own where it is not given.
"""
PLACES = ("bench pipeline", "material points", "networks", "world", "planner")


def on_files(files, config):
    """Adds concepts/places.md."""
    files.append(File.generated(config, "concepts/places.md", content=page()))
    return files


def page() -> str:
    """Markdown of all effects and laws; laws that act in the same places share a row."""
    lines = [
        LEAD,
        f"| effect | needs | {' | '.join(PLACES)} |",
        "|---|---|" + "---|" * len(PLACES),
    ]
    lines += [_row(f"`{name}`", name) for name in all_effects()]
    alike: dict[tuple, list[str]] = {}
    for name in law_names():
        alike.setdefault((_needs(name), places(name)), []).append(name)
    for names in alike.values():
        shown = ", ".join(f"`{n}`".replace("|", r"\|") for n in names[:3])
        rest = f" and {len(names) - 3} more" if len(names) > 3 else ""
        lines.append(_row(f"{'laws' if len(names) > 1 else 'law'} {shown}{rest}", names[0]))
    return "\n".join([*lines, ""])


def _row(label: str, name: str) -> str:
    return f"| {label} | {_needs(name) or '-'} | {' | '.join(places(name))} |"


def _needs(name: str) -> str:
    columns = getattr(get_effect(name), "columns", ())
    return ", ".join(f"`{c}`" for c in columns if c not in COMPUTED)


def places(name: str) -> tuple[str, ...]:
    """What the effect acts on in each of `PLACES`."""
    effect, twin = get_effect(name), Twin.builtin()
    twin.effects[name] = effect.start(15.0)
    if isinstance(effect, SensorEffect):
        if effect.of_session:
            return ("photographs", *("-",) * (len(PLACES) - 1))
        if effect.late is not None:  # what was before is known step by step alone
            return ("photographs", "-", "-", "image", "-")
        return ("image", "image", "image", "image", "area")
    given = dict.fromkeys(effect.columns, 1.0)
    pipeline = PressurePipeline(twin, given)
    on = "tip" if pipeline.moves else "reading" if pipeline.measures else "joints"
    try:
        joint_targets(twin, [5.0], conditions={c: 1.0 for c in effect.columns if c not in COMPUTED})
        full = on
    except InputError:
        full = f"{on}; no pictures"
    return (on, full, on, on, "-" if on == "reading" else on)
