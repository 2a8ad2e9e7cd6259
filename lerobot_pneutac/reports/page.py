"""Self-contained HTML reports: text, tables, pictures, videos and interactive figures that open offline."""

import base64
import html
import io
import json
import re
from pathlib import Path

import numpy as np
from PIL import Image

_STYLE = """
:root { --ink:#1b2430; --dim:#5b6775; --line:#dde3ea; --paper:#ffffff; --soft:#f5f7fa; --accent:#0b6e99; }
* { box-sizing: border-box; }
body { margin:0; background:var(--soft); color:var(--ink); font:16px/1.55 system-ui,sans-serif; }
main { max-width:1020px; margin:0 auto; padding:32px 28px 64px; background:var(--paper); min-height:100vh; }
h1 { font-size:1.75rem; line-height:1.2; margin:0 0 .6em; text-wrap:balance; }
h2 { font-size:1.2rem; margin:2em 0 .5em; padding-top:.9em; border-top:1px solid var(--line); }
p.lead { font-size:1.15rem; border-left:4px solid var(--accent); padding:.3em 0 .3em .9em; }
table { border-collapse:collapse; margin:.8em 0; font-variant-numeric:tabular-nums; font-size:.92rem; }
th,td { text-align:left; padding:.34em .9em .34em 0; border-bottom:1px solid var(--line); }
th { color:var(--dim); font-weight:600; }
.scroll { overflow-x:auto; }
figure { margin:1.2em 0; } figcaption { color:var(--dim); font-size:.9rem; margin-top:.3em; }
img,video { max-width:100%; border-radius:4px; }
pre { background:var(--soft); border:1px solid var(--line); padding:.8em 1em; overflow-x:auto;
  font-size:.84rem; }
code { background:var(--soft); padding:.08em .3em; border-radius:3px; font-size:.9em; }
"""


class Report:
    """Collects sections and writes one HTML file without outside references.

    Args:
        title: heading of the page.
    """

    def __init__(self, title: str):
        self.title = title
        self._parts: list[str] = []
        self._figures = 0

    def lead(self, text: str) -> None:
        """The one sentence that a reader should take away."""
        self._parts.append(f'<p class="lead">{_inline(text)}</p>')

    def heading(self, text: str) -> None:
        """A section's heading."""
        self._parts.append(f"<h2>{_inline(text)}</h2>")

    def text(self, text: str) -> None:
        """Paragraphs separated by blank lines; `code` and **bold** are understood, all else is literal."""
        for paragraph in re.split(r"\n\s*\n", text.strip()):
            self._parts.append(f"<p>{_inline(paragraph)}</p>")

    def code(self, text: str) -> None:
        """A block to copy."""
        self._parts.append(f"<pre>{html.escape(text.strip())}</pre>")

    def table(self, rows: list[dict], caption: str = "") -> None:
        """A table with one column a key of the first row; numbers get four significant digits."""
        if not rows:
            return
        head = "".join(f"<th>{_inline(str(k))}</th>" for k in rows[0])
        body = "".join(
            "<tr>" + "".join(f"<td>{_inline(_cell(r.get(k)))}</td>" for k in rows[0]) + "</tr>" for r in rows
        )
        self._parts.append(
            f'<figure class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>'
            f"{_caption(caption)}</figure>"
        )

    def image(self, image: np.ndarray, caption: str = "", width: int | None = None) -> None:
        """A picture, uint8 (H, W, 3) or (H, W); `width` in page pixels, its own where None."""
        size = f' width="{width}"' if width else ""
        data = _png(image)
        self._parts.append(
            f'<figure><img{size} src="data:image/png;base64,{data}">{_caption(caption)}</figure>'
        )

    def video(self, path: str | Path, caption: str = "", width: int = 640) -> None:
        """An MP4 file, embedded."""
        data = base64.b64encode(Path(path).read_bytes()).decode()
        self._parts.append(
            f'<figure><video width="{width}" controls loop autoplay muted '
            f'src="data:video/mp4;base64,{data}"></video>{_caption(caption)}</figure>'
        )

    def figure(self, figure, caption: str = "", height: int = 420) -> None:
        """An interactive plotly figure."""
        self._figures += 1
        figure.update_layout(
            template="plotly_white", height=height, margin={"l": 60, "r": 20, "t": 60, "b": 50}
        )
        name = f"figure{self._figures}"
        spec = figure.to_json().replace("</", "<\\/")
        self._parts.append(
            f'<figure><div id="{name}"></div>{_caption(caption)}'
            f"<script>(function(){{const f={spec};"
            f"Plotly.newPlot('{name}',f.data,f.layout,{{responsive:true}});}})();</script></figure>"
        )

    def write(self, path: str | Path) -> Path:
        """Writes the page to `path` (a file name ending in .html, or a folder for `report.html`)."""
        path = Path(path)
        if path.suffix != ".html":
            path = path / "report.html"
        path.parent.mkdir(parents=True, exist_ok=True)
        script = ""
        if self._figures:
            from plotly.offline import get_plotlyjs

            script = f"<script>{get_plotlyjs()}</script>"
        path.write_text(
            f'<!doctype html><html lang="en"><head><meta charset="utf-8">'
            f'<meta name="viewport" content="width=device-width,initial-scale=1">'
            f"<title>{html.escape(self.title)}</title><style>{_STYLE}</style>{script}</head>"
            f"<body><main><h1>{_inline(self.title)}</h1>{''.join(self._parts)}</main></body></html>",
            encoding="utf-8",
        )
        return path


def write_result(out: str | Path, result: dict) -> Path:
    """Writes `result.json` into folder `out`; raises ValueError where a number is NaN or infinite."""
    path = Path(out) / "result.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps(result, indent=2, allow_nan=False, default=_plain)
    path.write_text(text)
    return path


def _plain(x):
    if isinstance(x, np.ndarray):
        return x.tolist()
    if isinstance(x, np.generic):
        return x.item()
    if isinstance(x, Path):
        return str(x)
    raise TypeError(f"{type(x).__name__} has no place in a result.json")


def _inline(text: str) -> str:
    text = html.escape(text)
    text = re.sub(r"`([^`]+)`", r"<code>\1</code>", text)
    return re.sub(r"\*\*([^*]+)\*\*", r"<b>\1</b>", text)


def _cell(x) -> str:
    if x is None:
        return "-"
    if isinstance(x, bool | np.bool_):
        return "yes" if x else "no"
    if isinstance(x, float | np.floating):
        return f"{x:.4g}"
    return str(x)


def _caption(text: str) -> str:
    return f"<figcaption>{_inline(text)}</figcaption>" if text else ""


def _png(image: np.ndarray) -> str:
    if image.dtype != np.uint8:
        raise TypeError(f"a report's picture is uint8, not {image.dtype}")
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "PNG")
    return base64.b64encode(buffer.getvalue()).decode()
