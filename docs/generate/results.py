"""Pages from files beside docs/: the tables of benchmarks/, CHANGELOG and CONTRIBUTING."""

import re
from pathlib import Path

from mkdocs.structure.files import File

ROOT = Path(__file__).parents[2]
PAGES = {"CHANGELOG.md": "changes.md", "CONTRIBUTING.md": "contributing.md"}
PICTURES = (".png", ".webp", ".svg")


def on_files(files, config):
    """Adds them to the site; benchmarks/README.md becomes results/index.md."""
    for path in sorted((ROOT / "benchmarks").rglob("*")):
        if path.suffix not in (".md", *PICTURES):
            continue
        place = "results/" + path.relative_to(ROOT / "benchmarks").as_posix().replace("README.md", "index.md")
        if path.suffix == ".md":
            files.append(File.generated(config, place, content=_linked(path.read_text(), place)))
        else:
            files.append(File.generated(config, place, abs_src_path=str(path)))
    for name, place in PAGES.items():
        files.append(File.generated(config, place, content=_linked((ROOT / name).read_text(), place)))
    return files


def _linked(text: str, place: str) -> str:
    """Links as the site has them: docs/ is its root, benchmarks/ its results, and the code is not on it."""
    up = "../" * place.count("/")
    text = re.sub(r"\]\((?:\.\./)*docs/", f"]({up}", text)
    text = re.sub(r"\]\((?:\.\./)*benchmarks/README\.md", f"]({up}results/index.md", text)
    text = re.sub(r"\]\((?:\.\./)*benchmarks/", f"]({up}results/", text)
    text = re.sub(r"\]\((?:\.\./)*README\.md(#[\w-]+)?\)", f"]({up}index.md)", text)
    return re.sub(r"\[([^\]]+)\]\((?:\.\./)*[\w/.]+\.(?:py|toml|cff)\)", r"\1", text)
