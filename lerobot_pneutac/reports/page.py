"""Self-contained HTML reports: text, tables, pictures, videos and interactive figures that open offline.

Colours of all pages and of the studio, one for each meaning, distinct for the colour-blind.
"""

import base64
import io
import re
from collections.abc import Iterable, Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from operator import attrgetter
from pathlib import Path
from string import Formatter

import jinja2
import numpy as np
from markupsafe import Markup, escape
from PIL import Image

from pneutac_sim.files import whole, write_json, write_text


class Report:
    """Collects sections and writes one HTML file without outside references."""

    def __init__(self, title: str):
        self.title = title
        self.about = ""  # of what, a line under the title
        self._sections: list[dict] = []
        self._next_at: int | None = None

    def _add(self, kind: str, text: str = "", **content) -> None:
        self._sections.append({"kind": kind, "text": text, **content})

    def lead(self, text: str) -> None:
        self._add("lead", text)

    def heading(self, text: str) -> None:
        self._add("heading", text)

    def text(self, text: str) -> None:
        """Paragraphs separated by blank lines; `code` and **bold** are understood, all else is literal."""
        for paragraph in re.split(r"\n\s*\n", text.strip()):
            self._add("text", paragraph)

    def bullets(self, heading: str, items: Sequence[str]) -> None:
        if items:
            self._add("list", heading, entries=items)

    def found(self, findings: Sequence[str]) -> None:
        if findings:
            self.heading("What the checks found")
            self.text("\n\n".join(findings))

    def next_here(self) -> None:
        """The place of the next step, if there is one; without it that is the end of the page."""
        self._next_at = len(self._sections)

    def next_step(self, text: str) -> None:
        """What to do next, a command or a sentence; empty for nothing."""
        at = len(self._sections) if self._next_at is None else self._next_at
        kind = "code" if text.startswith(("pneutac", "lerobot")) else "text"
        new = [{"kind": "heading", "text": "Do next"}, {"kind": kind, "text": text}]
        self._sections[at:at] = new if text else []

    def code(self, text: str) -> None:
        self._add("code", text.strip())

    def table(self, rows: list[dict], caption: str = "") -> None:
        """A table with one column a key of the first row; numbers get four significant digits."""
        if rows:
            self._add("table", caption, rows=rows)

    def image(self, image: np.ndarray, caption: str = "", width: int | None = None) -> None:
        """A picture, uint8 (H, W, 3) or (H, W); `width` in page pixels, its own where None."""
        if image.dtype != np.uint8:
            raise TypeError(f"a report's picture is uint8, not {image.dtype}")
        buffer = io.BytesIO()
        Image.fromarray(image).save(buffer, "PNG")
        self._add("image", caption, width=width, data=_base64(buffer.getvalue()))

    def film(self, frames: list[np.ndarray], seconds: float, caption: str, width: int) -> None:
        """Pictures, uint8 (H, W, 3), each shown for so many seconds, as animated WebP."""
        buffer, (first, *rest) = io.BytesIO(), [Image.fromarray(f) for f in frames]
        how = {"duration": round(1e3 * seconds), "loop": 0, "quality": 60}
        first.save(buffer, "WEBP", save_all=True, append_images=rest, **how)
        self._add("film", caption, width=width, data=_base64(buffer.getvalue()))

    def videos(self, paths: Sequence[str | Path], caption: str = "", width: int = 470) -> None:
        films = [_base64(Path(path).read_bytes()) for path in paths]
        self._add("video", caption, width=width, films=films)

    def figure(self, figure, caption: str = "", height: int = 420) -> None:
        from plotly.io import to_html

        margin = {"l": 60, "r": 20, "t": 60, "b": 50}
        figure.update_layout(template="plotly_white", height=height, margin=margin)
        name = f"figure{1 + sum(s['kind'] == 'figure' for s in self._sections)}"
        data = to_html(figure, include_plotlyjs=False, full_html=False, div_id=name)
        self._add("figure", caption, data=data)

    def fragment(self) -> str:
        """The sections without a page around them, for a notebook; figures need plotly there."""
        return _template().render(sections=self._sections, fragment=True)

    def write(self, path: str | Path) -> Path:
        """Writes the page to `path` (a file name ending in .html, or a folder for `report.html`)."""
        path = Path(path)
        if path.suffix != ".html":
            path = path / "report.html"
        script = ""
        if any(s["kind"] == "figure" for s in self._sections):
            from plotly.offline import get_plotlyjs

            script = get_plotlyjs()
        content = {"title": self.title, "about": self.about, "sections": self._sections}
        write_text(path, _template().render(**content, plotly=script))
        return path


@cache
def _template() -> jinja2.Template:
    def marked(text: str) -> Markup:
        text = re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(text)))
        return Markup(re.sub(r"\*\*([^*]+)\*\*", r"<b>\1</b>", text))

    environment = jinja2.Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.filters |= {"marked": marked, "cell": cell}
    return environment.from_string(Path(__file__).with_name("page.html.jinja").read_text(encoding="utf-8"))


made_by: dict[str, str] = {}  # what every result holds by which it can be repeated, while a benchmark runs


def write_result(out: str | Path, result: dict) -> Path:
    """Writes `result.json` into folder `out`; raises ValueError where a number is NaN or infinite."""
    path = Path(out) / "result.json"
    write_json(path, plain(result | made_by))
    return path


def save_table(file: Path, table: list[dict] | dict) -> None:
    """Writes rows or columns as CSV."""
    import pandas as pd  # which many pages do not need

    with whole(file) as part:
        pd.DataFrame(table).to_csv(part, index=False, float_format="%.6g")


def plain(x):
    """The same of dicts, lists, texts, numbers and None alone, as JSON gives it back."""
    if isinstance(x, dict):
        return {str(k): plain(v) for k, v in x.items()}
    if isinstance(x, list | tuple):
        return [plain(v) for v in x]
    if isinstance(x, np.ndarray | np.generic):
        return x.tolist()
    if isinstance(x, Path):
        return str(x)
    if is_dataclass(x):
        return {f.name: plain(getattr(x, f.name)) for f in fields(x)}
    if x is None or type(x) in (bool, int, float, str):
        return x
    raise TypeError(f"{type(x).__name__} has no place in a result.json")


def cell(x, none: str = "-") -> str:
    """A value in a table: four significant digits, yes or no, `none` where there is none."""
    if x is None:
        return none
    if isinstance(x, bool | np.bool_):
        return "yes" if x else "no"
    if isinstance(x, float | np.floating):
        return f"{x:.4g}"
    return str(x)


class _Blanks(Formatter):
    """A format in which None is nothing."""

    def format_field(self, value, format_spec: str) -> str:
        return "" if value is None else super().format_field(value, format_spec)


def rows_of(items: Iterable, columns: dict[str, str]) -> list[dict]:
    """A table with a row an item.

    Each column is an attribute, with dots, or a format such as `{0.error:.3g} {0.unit}` where None is blank.
    """
    return [
        {k: _Blanks().format(c, item) if "{" in c else attrgetter(c)(item) for k, c in columns.items()}
        for item in items
    ]


def span(ci95, unknown: str = "") -> str:
    """An interval, `0.12 to 0.34`; `unknown` where there is none."""
    return "{:.4g} to {:.4g}".format(*ci95) if ci95 else unknown


def interval(parameter: dict, unknown: str = "") -> str:
    """The interval of a parameter as results have it, or why there is none."""
    return parameter.get("note") or span(parameter["ci95"], unknown)


def parameter_rows(parameters: dict[str, dict], **first) -> list[dict]:
    """A table of parameters as results have them; `first` are columns before."""
    return [
        first | {"parameter": k, "value": v["value"], "95 % interval": interval(v, "held")}
        | {"unit": v["unit"] or "(a ratio)"}
        for k, v in parameters.items()
    ]  # fmt: skip


def side_by_side(
    images: Iterable[np.ndarray], height: int | None = None, width: int | None = None, gap: int = 6
) -> np.ndarray:
    """Pictures, uint8 (H, W, 3), of one height or one width each, px, with white between them."""
    import cv2

    out = []
    for image in images:
        h, w = image.shape[:2]
        size = (width, round(width * h / w)) if width else (round((height or h) * w / h), height or h)
        small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        out += [np.full((size[1], gap, 3), 255, np.uint8), small]
    return np.concatenate(out[1:], axis=1)


def difference(image: np.ndarray, reference: np.ndarray, times: float) -> np.ndarray:
    """An image minus another, so many times as large, uint8 (H, W, 3); grey is no difference."""
    return np.clip(128 + times * (image.astype(float) - reference), 0, 255).astype(np.uint8)


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode()


MEASURED = "#1b2430"
MODEL = BEFORE = "#d1495b"  # the twin as it is
KNOWN = "#8a6fb3"  # with known causes
AFTER = "#0b6e99"  # with all that was found
TRAIN, HELDOUT = "#9bb1c4", "#2a9d8f"
FLOOR = "#e0a100"  # the noise
COMMAND = OTHER = "#9aa5b1"
SHADE = "rgba(155, 177, 196, 0.35)"  # behind the worst passages
CHAMBERS = (AFTER, FLOOR, MODEL)  # of one chamber the first
BAND = "rgba(42, 157, 143, 0.3)"  # of the test part
WHISKER = "#333333"  # of intervals
SERIES = (AFTER, "#c2410c", "#15803d", "#7e22ce")  # of things without a meaning of their own
