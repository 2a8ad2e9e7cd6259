"""The catalogue of effects, from the registry: sentence, equation, parameters, picture, experiment."""

import io
import sys
import textwrap
from dataclasses import replace

import numpy as np
from mkdocs.structure.files import File
from PIL import Image

from lerobot_pneutac.verbs.effects import tips
from pneutac_sim.effects.registry import all_effects, body_effects, get_effect, of_sensor, sensor_effects
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.sensor import TactileSensor

NEEDS = {  # conditions that the program varies for an effect that needs them
    "gravity": "the base is turned from hanging to lying",
    "payload": "50 g hang at the tip",
    "thermal": "it warms from 20 to 30 °C",
    "crosstalk": "a neighbouring chamber is at 8 kPa in the second half",
}


def on_files(files, config):
    """Adds concepts/effects.md and a picture an effect."""
    pictures = {f"{name}.svg": curve(name) for name in body_effects()}
    pictures |= {f"{name}.png": press(name) for name in sensor_effects()}
    pictures = {name: content for name, content in pictures.items() if content}
    for name, content in pictures.items():
        files.append(File.generated(config, f"concepts/effects/{name}", content=content))
    files.append(File.generated(config, "concepts/effects.md", content=page(pictures)))
    return files


def page(pictures: dict) -> str:
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
