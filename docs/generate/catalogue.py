"""Pages made from the registries: the catalogue of effects, the table of laws, and where each acts."""

import io
import sys
import textwrap
from dataclasses import replace

import numpy as np
from mkdocs.structure.files import File
from PIL import Image

from lerobot_pneutac.verbs.effects import tips, units
from pneutac_sim.effects import SensorEffect
from pneutac_sim.effects.laws import family, law, law_names, plain_name
from pneutac_sim.effects.registry import all_effects, body_effects, get_effect, of_sensor, sensor_effects
from pneutac_sim.errors import InputError
from pneutac_sim.finger.online import COMPUTED, PressurePipeline
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.sensor import TactileSensor
from pneutac_sim.mpm.devices import joint_targets
from pneutac_sim.twin import Twin

NEEDS = {  # conditions that the program varies for an effect that needs them
    "gravity": "the base is turned from hanging to lying",
    "payload": "50 g hang at the tip",
    "thermal": "it warms from 20 to 30 °C",
    "crosstalk": "a neighbouring chamber is at 8 kPa in the second half",
}
HELD = ("scale_kpa",)  # of every law on pressure; stated once, above the table
PLACES = ("bench pipeline", "material points", "networks", "world", "planner")
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


def on_files(files, config):
    """Adds concepts/effects.md with a picture an effect, concepts/laws.md and concepts/places.md."""
    pictures = {f"{name}.svg": curve(name) for name in body_effects()}
    pictures |= {f"{name}.png": press(name) for name in sensor_effects()}
    pictures = {name: content for name, content in pictures.items() if content}
    for name, content in pictures.items():
        files.append(File.generated(config, f"concepts/effects/{name}", content=content))
    files.append(File.generated(config, "concepts/effects.md", content=effects_page(pictures)))
    files.append(File.generated(config, "concepts/laws.md", content=laws_page()))
    files.append(File.generated(config, "concepts/places.md", content=places_page()))
    return files


def effects_page(pictures: dict) -> str:
    """Markdown of the catalogue."""
    lines = [
        "# Effects",
        "",
        "Each effect is one physical mechanism in one file. `pneutac diagnose` tries them all, `pneutac add` "
        "switches one on, and it then acts wherever the twin does. The pictures show the built-in twin with "
        "the effect at the size with which a fit starts: on the left the tip's deflection without it (grey) "
        "and with it (orange), on the right their difference. For light: without, with, and four "
        "times the difference. [Add one of your own](../how_to/add_an_effect.md).",
        "",
    ]
    stage = None
    for effect in all_effects().values():
        if effect.stage != stage:
            stage = effect.stage
            lines += [f"## Stage: {stage}", ""]
        lines += [f"### {effect.name}", "", _sentence(effect), "", *_equation(effect), ""]
        picture = next((p for p in pictures if p.startswith(f"{effect.name}.")), None)
        lines += [f"![{effect.name}](effects/{picture})", ""] if picture else []
        if effect.name in NEEDS:
            lines += [f"In the picture {NEEDS[effect.name]}.", ""]
        lines += [f"**Seen by:** {effect.experiment}", "", *_parameters(effect)]
    return "\n".join(lines)


def _sentence(effect) -> str:
    values = {p.name: p.limits(15.0)[0] for p in effect.parameters}
    device = "gel" if of_sensor([effect.name]) else "finger"
    return f"*{effect.describe_any(values, device)}*"


def _equation(effect) -> list[str]:
    """The formula; where it comes from and what else the code says lies folded below, since it repeats it."""
    module = sys.modules.get(f"pneutac_sim.effects.{effect.name}")
    words = (module.__doc__ or "").strip().replace("*", r"\*") if module else ""
    if not effect.equation:
        return [words]
    folded = ['??? quote "Sources and details, as in the code"', "", textwrap.indent(words, "    ")]
    return [rf"\[ {effect.equation} \]", "", *(folded if words else [])]


def _parameters(effect) -> list[str]:
    rows = []
    for p in effect.parameters:
        default, lower, upper = p.limits(15.0)
        rows.append(f"| `{p.name}` | {p.unit} | {default:.3g} | {lower:.3g} ... {upper:.3g} |")
    return ["| parameter | unit | start of a fit | bounds |", "|---|---|---|---|", *rows, ""]


# ---------------------------------------------------------------- a finger under pressure


def curve(name: str) -> str:
    """Deflection of the built-in finger without and with one effect, as an SVG."""
    t, _, a, b = tips(name)
    z = [(a[:, 2], "thin"), (b[:, 2], "thick")]
    left = _panel(0, t, "deflection, mm", z, min(a[:, 2].min(), b[:, 2].min()))
    right = _panel(370, t, "difference, mm", [(np.linalg.norm(b - a, axis=1), "thick")], 0.0)
    return (
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 730 200"'
        ' font-family="sans-serif" font-size="12">'
        "<style>path{fill:none}.thin{stroke:#888;stroke-width:1}.thick{stroke:#e65100;stroke-width:1.6}"
        ".axis{stroke:#888;stroke-width:.6}text{fill:#888}</style>"
        f"{left}{right}</svg>"
    )


def _panel(x0: int, t, label: str, curves, least: float) -> str:
    top = max(max(c.max() for c, _ in curves), least + 1e-6)
    x, width, height = x0 + 45, 300, 150
    out = [
        f'<path class="axis" d="M{x} 20V{20 + height}H{x + width}"/>',
        f'<text x="{x - 40}" y="12">{label}</text>',
        f'<text x="{x + width - 25}" y="{height + 40}">{t[-1]:.0f} s</text>',
        f'<text x="{x - 5}" y="28" text-anchor="end">{top:.3g}</text>',
        f'<text x="{x - 5}" y="{20 + height}" text-anchor="end">{least:.3g}</text>',
    ]
    for values, style in curves:
        y = 20 + height * (1 - (values - least) / (top - least))
        points = " ".join(f"{x + width * a / t[-1]:.1f},{b:.1f}" for a, b in zip(t[::3], y[::3], strict=True))
        out.append(f'<path class="{style}" d="M{points}"/>')
    return "".join(out)


# ---------------------------------------------------------------- a ball on the gel


def press(name: str) -> bytes | None:
    """Tactile images without and with one effect of the light and their difference, four times; PNG.

    None where the effect is not of the sensor's own light: how it drifts, and where presses are.
    """
    gel = GelModel.builtin()
    own = {p.name: p.default for p in get_effect(name).parameters}
    sensors = [TactileSensor(replace(gel, effects=effects)) for effects in ({}, {name: own})]
    depth = sensors[0].probe(*Press("sphere", 4.0, x_mm=1.5, y_mm=-2.0, depth_mm=1.0).shapes())
    without, with_it = (sensor.image(depth) for sensor in sensors)
    if (without == with_it).all():
        return None
    apart = np.clip(128 + 4 * (with_it.astype(int) - without), 0, 255).astype(np.uint8)
    out = io.BytesIO()
    Image.fromarray(np.concatenate([without, with_it, apart], axis=1)).save(out, "png")
    return out.getvalue()


# ---------------------------------------------------------------- laws


def laws_page() -> str:
    """Markdown of all laws, by family."""
    names = law_names()
    lines = [
        "# Laws",
        "",
        f"The {len(names)} laws that `pneutac diagnose` may add to a model, in addition to the "
        "[effects](effects.md). Each adds a term to the pressure that bends a body, with a weight \\(w\\) "
        "between -3 and 3, to where the tip is, or to what is read of it. \\(P\\) is the largest pressure of "
        "the recording "
        "(`scale_kpa`), \\(\\Delta T\\) the temperature above 23 °C in tens of kelvin, lag a "
        "first-order lag, springpot a power-law spectrum, play the backlash operator, loop a Bouc-Wen "
        "loop. A law may act twice; the second is called `lag(p) #2`. [How they are searched](diagnosis.md). "
        "`pneutac effects show 'lag(p^2)'` has one of them with a picture, "
        "`pneutac effects export 'lag(p^2)'` makes a Python file of it.",
        "",
    ]
    for kind in dict.fromkeys(map(family, names)):
        lines += [f"## {kind}", "", "| law | equation | constants | needs |", "|---|---|---|---|"]
        lines += [_law_row(name) for name in names if family(name) == kind]
        lines.append("")
    return "\n".join(lines)


def _law_row(name: str) -> str:
    effect = law(name)
    ways = [
        f"`{r['parameter']}` {r['bounds']}" + (f" {r['unit']}" if r["unit"] != "(a ratio)" else "")
        for r in units(effect)
        if r["parameter"] not in (*HELD, "weight")
    ]
    needs = ", ".join(f"`{c}`" for c in effect.columns if c not in ("length_mm", "session_time_s"))
    equation = effect.equation.replace("|", r"\vert ")
    shown = name.replace("|", r"\|")
    return (
        f"| `{shown}` | {plain_name(name)} | \\({equation}\\) | {', '.join(ways) or '-'} | {needs or '-'} |"
    )


# ---------------------------------------------------------------- where effects and laws act


def places_page() -> str:
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
