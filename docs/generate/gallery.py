"""The picture of all tasks, `docs/pictures/tasks.webp`: `python docs/generate/gallery.py`.

Each task at the widest touch of its scripted expert; the tactile image of that moment is in the corner.
"""

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from pneutac_sim.features import task_names
from pneutac_sim.world.expert import ScriptedExpert
from pneutac_sim.world.world import World

PICTURE = Path(__file__).parents[1] / "pictures/tasks.webp"
COLUMNS, SIZE, STEPS = 3, (360, 270), 300


def tile(task: str) -> Image.Image:
    """The scene, with the tactile image in its corner, at the widest touch of a demonstration."""
    world = World(task, touch="image")
    world.reset(1)
    expert, widest, shown = ScriptedExpert(world, np.random.default_rng(1)), -1.0, None
    for _ in range(STEPS):
        world.step(expert.action())
        if world.touch.area > widest:
            widest, shown = world.touch.area, world.render(*SIZE)
        if world.success:
            break
    world.close()
    out = Image.fromarray(shown)
    ImageDraw.Draw(out).text((8, 6), task, fill="white", stroke_fill="black", stroke_width=2, font_size=20)
    return out


def main() -> None:
    """Writes the picture."""
    names, (width, height) = task_names(), SIZE
    sheet = Image.new("RGB", (COLUMNS * width, -(-len(names) // COLUMNS) * height), "white")
    for i, name in enumerate(names):
        sheet.paste(tile(name), (i % COLUMNS * width, i // COLUMNS * height))
    sheet.save(PICTURE, quality=70, method=6)


if __name__ == "__main__":
    main()
