"""Code blocks of a Markdown page, and how a reader would run them: in order, in one folder."""

import os
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
FENCE = re.compile(
    r"(?:<!-- not run: (?P<why>[^\n]+) -->\n)?^```(?P<kind>\w*)\n(?P<text>.*?)^```$", re.M | re.S
)
RUN = ("bash", "python")
SHOWN = ("json", "toml", "yaml", "text", "bibtex")  # nothing to run


@dataclass(frozen=True)
class Block:
    """One code block: `kind` as after the fence, `why` it is not run."""

    kind: str
    text: str
    why: str | None


def blocks(page: str) -> list[Block]:
    """Of a page, such as `docs/tutorials/missing_effect.md`."""
    return [Block(m["kind"], m["text"], m["why"]) for m in FENCE.finditer((ROOT / page).read_text())]


def run_page(page: str, work: Path) -> None:
    """Runs its blocks one after the other in `work`; fails at the first that ends in an error."""
    found = blocks(page)
    assert any(b.kind in RUN and not b.why for b in found), f"{page} has nothing to run"
    for block in found:
        assert block.kind in RUN + SHOWN, f"{page}: a block of '{block.kind}'; mark it as not run, or name it"
        if not block.why and block.kind in RUN:
            run_block(page, block, work)


def run_block(page: str, block: Block, work: Path) -> str:
    """Runs one block in `work` and returns what it prints; fails where it ends in an error."""
    env = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY", "PNEUTAC_DATA")}
    env |= {"HF_HOME": str(work / "hf"), "HF_HUB_OFFLINE": "1", "OMP_NUM_THREADS": "1"}
    env["PNEUTAC_PRIORS"] = str(work / "priors")
    env["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{env['PATH']}"
    command = [sys.executable, "script.py"]
    if block.kind == "bash":
        command = ["bash", "-euo", "pipefail", "-c", block.text]
    else:
        (work / "script.py").write_text(block.text)
    done = subprocess.run(command, cwd=work, env=env, capture_output=True, text=True)
    assert done.returncode == 0, f"{page}\n{block.text}\n{done.stdout[-2000:]}\n{done.stderr[-4000:]}"
    return done.stdout
