"""Formulas as MathML, which browsers draw by themselves: no script, no fonts from elsewhere."""

import html
import re

from latex2mathml.converter import convert

FORMULA = re.compile(r'<(span|div) class="arithmatex">\\([\[(])(.*?)\\[\])]</\1>', re.S)


def on_page_content(content, **_):
    """Replaces what `pymdownx.arithmatex` marked."""
    return FORMULA.sub(_mathml, content)


def _mathml(match) -> str:
    kind, latex = match.group(2), html.unescape(match.group(3))
    return convert(latex, display="block" if kind == "[" else "inline")
