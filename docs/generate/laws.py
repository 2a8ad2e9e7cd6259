"""The table of laws, from the code: name, equation, family, constants with units and bounds."""

from mkdocs.structure.files import File

from lerobot_pneutac.verbs.effects import units
from pneutac_sim.effects.laws import family, law, law_names, plain_name

HELD = ("scale_kpa",)  # of every law on pressure; stated once, above the table


def on_files(files, config):
    """Adds concepts/laws.md."""
    files.append(File.generated(config, "concepts/laws.md", content=page()))
    return files


def page() -> str:
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
        lines += [_row(name) for name in names if family(name) == kind]
        lines.append("")
    return "\n".join(lines)


def _row(name: str) -> str:
    effect = law(name)
    told = [
        f"`{r['parameter']}` {r['bounds']}" + (f" {r['unit']}" if r["unit"] != "(a ratio)" else "")
        for r in units(effect)
        if r["parameter"] not in (*HELD, "weight")
    ]
    needs = ", ".join(f"`{c}`" for c in effect.columns if c not in ("length_mm", "session_time_s"))
    equation = effect.equation.replace("|", r"\vert ")
    shown = name.replace("|", r"\|")
    return (
        f"| `{shown}` | {plain_name(name)} | \\({equation}\\) | {', '.join(told) or '-'} | {needs or '-'} |"
    )
