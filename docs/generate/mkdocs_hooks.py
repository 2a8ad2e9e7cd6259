"""Pages from files next to docs/ (benchmarks/, CHANGELOG, CONTRIBUTING), formulas, and fields of the API.

Formulas become MathML, which browsers draw by themselves: no script, no fonts from elsewhere.
"""

import ast
import html
import re
from itertools import takewhile
from pathlib import Path

import griffe
from latex2mathml.converter import convert
from mkdocs.structure.files import File

ROOT = Path(__file__).parents[2]
PAGES = {"CHANGELOG.md": "changes.md", "CONTRIBUTING.md": "contributing.md"}
PICTURES = (".png", ".webp", ".svg")
# Pages that are made from code: in the repository, links to them lead to that code.
SOURCES = {
    "sim/pneutac_sim/effects": "concepts/effects.md",
    "sim/pneutac_sim/effects/laws.py": "concepts/laws.md",
    "generate/catalogue.py": "concepts/places.md",
}
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\([\[(])(.*?)\\[\])]</\1>', re.S)


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


def on_page_markdown(markdown, page, **_):
    """Links of a page in docs/ to results and to generated pages, which resolve in the repository too."""
    up = "../" * page.file.src_uri.count("/")
    for source, place in SOURCES.items():
        markdown = re.sub(rf"\]\((?:\.\./)*{source}([#)])", rf"]({up}{place}\1", markdown)
    return _results(markdown, up)


def _results(text: str, up: str) -> str:
    text = re.sub(r"\]\((?:\.\./)*benchmarks/README\.md", f"]({up}results/index.md", text)
    return re.sub(r"\]\((?:\.\./)*benchmarks/", f"]({up}results/", text)


def _linked(text: str, place: str) -> str:
    """Links as the site has them: docs/ is its root, benchmarks/ its results, and the code is not on it."""
    up = "../" * place.count("/")
    text = _results(re.sub(r"\]\((?:\.\./)*docs/", f"]({up}", text), up)
    text = re.sub(r"\]\((?:\.\./)*README\.md(#[\w-]+)?\)", f"]({up}index.md)", text)
    return re.sub(r"\[([^\]]+)\]\((?:\.\./)*(?:[\w/.]+\.(?:py|toml|cff)|SECURITY\.md)\)", r"\1", text)


def on_page_content(content, **_):
    """Replaces what `pymdownx.arithmatex` marked."""
    return FORMULA.sub(_mathml, content)


def _mathml(match) -> str:
    kind, latex = match.group(2), html.unescape(match.group(3))
    return convert(latex, display="block" if kind == "[" else "inline")


class FieldComments(griffe.Extension):
    """Makes the comments of a class' fields their docstrings, since griffe reads no comments."""

    def on_attribute_instance(self, *, node, attr: griffe.Attribute, **_) -> None:
        """Describes an annotated field of a class."""
        if attr.docstring or not attr.parent.is_class or not isinstance(node, ast.AnnAssign):
            return
        lines = [line.strip() for line in attr.lines_collection[attr.filepath][: attr.lineno]]
        above = [*takewhile(lambda line: line.startswith("# "), reversed(lines[:-1]))][::-1]
        behind = lines[-1].partition("  # ")[2]
        texts = [line[2:] for line in above] + [behind] * ("pyright:" not in behind)
        if text := " ".join(texts).strip():
            attr.docstring = griffe.Docstring(f"{text[:1].upper()}{text[1:].rstrip('.')}.", parent=attr)
