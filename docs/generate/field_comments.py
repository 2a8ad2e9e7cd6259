"""The comments of a class' fields, above or behind them, as their descriptions on the page of the API."""

import ast
from itertools import takewhile

import griffe


class FieldComments(griffe.Extension):
    """Gives fields a docstring, since griffe reads no comments."""

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
